"""Parts of a model and their names: what its promises are checked on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.physics import Effect
from oed_sysid.physics.channels import Channels, Input, Output, State
from oed_sysid.physics.parameters import Parameter
from oed_sysid.text.callables import Function, Table


@dataclass(frozen=True)
class Structure:
    """What a :class:`oed_sysid.physics.model.Model` consists of; see there for the parts."""

    name: str
    states: tuple[State, ...]
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    kinematics: Mapping[str, str] = field(default_factory=dict)
    axes: Mapping[str, str] = field(default_factory=dict)
    inertia: Mapping[tuple[str, str], str] = field(default_factory=dict)
    actuators: Mapping[str, str] = field(default_factory=dict)
    signals: Mapping[str, str] = field(default_factory=dict)
    effects: tuple[Effect, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    step: float = 0.1
    integrator: str = "explicit"
    tables: Mapping[str, Table] = field(default_factory=dict)
    functions: tuple[Function, ...] = ()

    @property
    def channels(self) -> Channels:
        """Inputs and outputs that a record of this model holds."""
        return Channels(self.inputs, self.outputs)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the model's own states, those that effects add excluded."""
        return tuple(state.name for state in self.states)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the measured signals."""
        return tuple(output.name for output in self.outputs)

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the commanded signals."""
        return tuple(channel.name for channel in self.inputs)

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Names of the effects, in order."""
        return tuple(effect.name for effect in self.effects)

    @property
    def actuator_signals(self) -> dict[str, str]:
        """Ideal actuator signals; the inputs themselves unless stated otherwise."""
        return dict(self.actuators) or {name: name for name in self.input_names}

    @property
    def library(self) -> dict[str, Table | Function]:
        """Tables and functions that the texts of the model and its effects may call."""
        found: dict[str, Table | Function] = {}
        owners: tuple[Structure | Effect, ...] = (self, *self.effects)
        for owner in owners:
            found |= owner.tables
            found |= {function.name: function for function in owner.functions}
        return found

    @cached_property
    def all_parameters(self) -> tuple[Parameter, ...]:
        """Shared parameters first, then those of each effect in order."""
        own = [parameter for effect in self.effects for parameter in effect.parameters]
        return (*self.parameters, *own)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of all parameters, in order."""
        return tuple(parameter.name for parameter in self.all_parameters)

    @cached_property
    def free_parameters(self) -> tuple[Parameter, ...]:
        """Parameters that an estimator may change, in order."""
        return tuple(parameter for parameter in self.all_parameters if not parameter.fixed)

    @cached_property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters, in order."""
        return tuple(parameter.name for parameter in self.free_parameters)

    @property
    def values(self) -> dict[str, float]:
        """Present value of every parameter."""
        return {parameter.name: parameter.value for parameter in self.all_parameters}

    @property
    def value_vector(self) -> np.ndarray:
        """Values of all parameters, shape ``(n_parameters,)``."""
        return np.array([parameter.value for parameter in self.all_parameters], dtype=float)

    def parameter(self, name: str) -> Parameter:
        """Return one parameter by name."""
        for parameter in self.all_parameters:
            if parameter.name == name:
                return parameter
        raise ModelError(
            f"Model {self.name!r} has no parameter {name!r}. It has: "
            f"{', '.join(self.parameter_names)}."
        )

    def effect(self, name: str) -> Effect:
        """Return one effect by name."""
        for effect in self.effects:
            if effect.name == name:
                return effect
        raise ModelError(
            f"Model {self.name!r} has no effect {name!r}. It has: "
            f"{', '.join(self.effect_names) or 'none'}."
        )
