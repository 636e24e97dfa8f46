"""Parts of a model, their names, and what a model promises of them at construction.

Each part is of its own kind, no definition goes in a circle, every state has one equation, and
every name in a text resolves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.physics import Effect
from oed_sysid.physics.channels import Channels, Input, Output, State, check_kinds
from oed_sysid.physics.parameters import Parameter, check_unique
from oed_sysid.text import callables, expressions
from oed_sysid.text.callables import Function, Table

CLOCK = ("t", "h")
RESERVED = {"t": "time", "h": "step", "pi": "3.14159..."}

_TUPLES: Mapping[str, type] = {
    "states": State,
    "inputs": Input,
    "outputs": Output,
    "effects": Effect,
    "parameters": Parameter,
    "functions": Function,
}
_MAPPINGS = ("kinematics", "axes", "inertia", "actuators", "signals", "tables")


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


# -- promises ---------------------------------------------------------------------------


def settle_parts(model: Any) -> None:
    """Turn the parts of a new model into tuples and dictionaries, or refuse them.

    Parameters
    ----------
    model : Model
        Under construction.

    Raises
    ------
    ModelError
        If a part is of another kind, or definitions refer to each other in a circle.
    """
    owner = f"Model {model.name!r:.60}"
    if not isinstance(model.name, str):
        raise ModelError(f"{owner}: its name is a {type(model.name).__name__}. Give text.")
    for what, kind in _TUPLES.items():
        value = getattr(model, what)
        if isinstance(value, kind | str | bytes | Mapping) or not hasattr(value, "__iter__"):
            raise ModelError(
                f"{owner}: {what} is a {type(value).__name__}, expected a tuple of "
                f"{kind.__name__}(...). One alone is written ({kind.__name__}(...),)."
            )
        parts = tuple(value)
        check_kinds(owner, what, parts, kind)
        object.__setattr__(model, what, parts)
    for what in _MAPPINGS:
        value = getattr(model, what)
        if not isinstance(value, Mapping):
            raise ModelError(
                f"{owner}: {what} is a {type(value).__name__}, expected a mapping such as "
                "{'psi': 'r'}."
            )
        object.__setattr__(model, what, dict(value))
    tables = {name: callables.check_table(name, table) for name, table in model.tables.items()}
    object.__setattr__(model, "tables", tables)
    for key in model.inertia:
        if not (isinstance(key, tuple) and len(key) == 2):
            raise ModelError(f"{owner}: inertia has the key {key!r:.60}, expected ('Z', 'w').")
    check_order(f"{owner}, signal", model.signals)
    for effect in model.effects:
        check_order(f"{owner}, effect {effect.name!r}, definition", effect.definitions)


def check_order(owner: str, definitions: Mapping[str, str]) -> None:
    """Refuse a definition that uses itself or one that comes after it."""
    names = list(definitions)
    for position, (name, text) in enumerate(definitions.items()):
        for later in names[position:]:
            if later in expressions.names(text):
                circle = later == name or name in expressions.names(definitions[later])
                raise ModelError(
                    f"{owner} {name!r} is {text!r:.80}, which uses {later!r}: "
                    + ("they are defined in a circle." if circle else "that is defined after it.")
                    + " Definitions are evaluated in order; use only what stands above."
                )


def is_sampled(model: Structure, effect: Effect) -> bool:
    """Whether an actuator effect answers to commands alone, once in each step.

    An effect that sees states, or has states of its own, acts on the signal that
    the sampled ones leave, continuously and within the equations of motion.
    """
    names = {*model.input_names, *model.parameter_names, *CLOCK, *model.actuator_signals}
    return not effect.states and effect.uses() <= names


def rates_and_forces(model: Structure) -> set[str]:
    """What only sensors see: ``dot(state)``, ``force(axis)`` and ``force(axis, effect)``."""
    states = [*model.state_names, *(s.name for effect in model.effects for s in effect.states)]
    names = {f"dot({state})" for state in states}
    names |= {f"force({key})" for key in (*model.axes, *model.kinematics)}
    for effect in model.effects:
        if effect.stage == "force":
            names |= {f"force({key}, {effect.name})" for key in effect.terms}
    return names


def _callable(model: Structure) -> dict[str, int]:
    """Number of arguments of every table and function; the same name means the same thing."""
    found: dict[str, tuple[str, ...]] = {}
    counts: dict[str, int] = {}
    owners: tuple[Structure | Effect, ...] = (model, *model.effects)
    for owner in owners:
        entries: list[tuple[str, Table | Function]]
        entries = [*owner.tables.items(), *((f.name, f) for f in owner.functions)]
        for name, entry in entries:
            digest = callables.digest(entry)
            if name in expressions.FUNCTIONS:
                raise ModelError(
                    f"{owner.name!r} declares {name!r}, which is a function of every text already. "
                    "Give it another name."
                )
            if found.setdefault(name, digest) != digest:
                raise ModelError(
                    f"Model {model.name!r} holds two different tables or functions called "
                    f"{name!r}. Rename one."
                )
            counts[name] = callables.n_arguments(entry)
    return counts


def validate(model: Structure) -> None:
    """Check names, references and completeness of a model."""
    check_unique(model.all_parameters, owner=f"Model {model.name!r}")
    _check_settings(model)
    _check_equations(model)
    _check_outputs(model)
    _check_names(model)
    _check_texts(model)


def _check_settings(model: Structure) -> None:
    """The least that a model has, its step and its integrator."""
    step = model.step
    if not model.states or not model.outputs:
        raise ModelError(f"Model {model.name!r} needs at least one state and one output.")
    is_number = isinstance(step, int | float) and not isinstance(step, bool)
    if not is_number or not 0 < step < math.inf:
        raise ModelError(f"Model {model.name!r} has step {step!r:.40}. Give seconds above zero.")
    if model.integrator not in ("explicit", "implicit"):
        raise ModelError(
            f"Model {model.name!r} has integrator {model.integrator!r}. Choose explicit, or "
            "implicit for a stiff model."
        )


def _check_equations(model: Structure) -> None:
    """One equation for each state; inertia between axes and their velocities."""
    driven = [*model.kinematics, *model.axes.values()]
    for name in model.state_names:
        if driven.count(name) != 1:
            raise ModelError(
                f"State {name!r} of model {model.name!r} has {driven.count(name)} equations, "
                "expected one: name it in kinematics or as the velocity of one axis."
            )
    for name in driven:
        if name not in model.state_names:
            raise ModelError(f"Model {model.name!r} has an equation for unknown state {name!r}.")
    for axis, state in model.inertia:
        if axis not in model.axes or state not in model.axes.values():
            raise ModelError(
                f"Inertia entry ({axis!r}, {state!r}) of model {model.name!r} does not belong to "
                f"the axes {dict(model.axes)}."
            )


def _check_outputs(model: Structure) -> None:
    """No measurement counts twice."""
    columns: dict[str, str] = {}
    for output in model.outputs:
        if output.name in columns.values():
            raise ModelError(
                f"Model {model.name!r} has two outputs {output.name!r}. Rename or remove one."
            )
        column = output.column or output.name
        if column in columns:
            raise ModelError(
                f"Outputs {columns[column]!r} and {output.name!r} of model {model.name!r} both "
                f"read the column {column!r}: one measurement would count twice. Give one of them "
                "another column, or remove it."
            )
        columns[column] = output.name


def _check_names(model: Structure) -> None:
    """A name means one thing."""
    base = [*model.state_names, *model.input_names, *dict.fromkeys(model.parameter_names)]
    for name in base:
        if base.count(name) > 1:
            raise ModelError(f"Model {model.name!r} uses the name {name!r} for two things.")
        if name in RESERVED:
            raise ModelError(f"The name {name!r} is reserved ({RESERVED[name]}). Rename it.")


def _check_texts(model: Structure) -> None:
    """Every name in a text resolves, in the order of evaluation."""
    where, tables = f"Model {model.name!r}", _callable(model)
    parameters = set(model.parameter_names)
    commands = {*model.input_names, *parameters, *CLOCK}
    for signal, text in model.actuator_signals.items():
        expressions.check(text, commands, where=f"{where}, actuator {signal!r}", tables=tables)
    extra = [state.name for effect in model.effects for state in effect.states]
    # Forces see actuators' signals, not commands: what reaches them is the actuators' matter.
    known = {*model.state_names, *extra, *model.actuator_signals, *parameters, *CLOCK}
    for signal, text in model.signals.items():
        expressions.check(text, known, where=f"{where}, signal {signal!r}", tables=tables)
        known.add(signal)
    for state, text in model.kinematics.items():
        expressions.check(text, known, where=f"{where}, rate of {state!r}", tables=tables)
    for key, text in model.inertia.items():
        expressions.check(text, known, where=f"{where}, inertia {key}", tables=tables)
    # Sensors come last in the chain: only they see accelerations and forces.
    seen = known | rates_and_forces(model)
    for output in model.outputs:
        sensor = f"{where}, output {output.name!r}"
        expressions.check(output.source, seen, where=sensor, tables=tables)
    for effect in model.effects:
        _check_effect(model, effect, seen if effect.stage == "sensor" else known, tables)


def _check_effect(
    model: Structure, effect: Effect, known: set[str], tables: Mapping[str, int]
) -> None:
    """Check one effect of a model: its targets exist and its names resolve."""
    where = f"Effect {effect.name!r} in model {model.name!r}"
    targets: dict[str, set] = {
        "actuator": set(model.actuator_signals),
        "environment": set(model.signals),
        "force": {*model.axes, *model.kinematics},
        "inertia": {(axis, state) for axis in model.axes for state in model.axes.values()},
        "sensor": set(model.output_names),
    }
    for key in effect.terms:
        if key not in targets[effect.stage]:
            raise ModelError(
                f"{where} acts on {key!r}, which no {effect.stage} effect can change here. "
                f"Choose among: {', '.join(sorted(map(str, targets[effect.stage])))}."
            )
    commands = {*model.input_names, *model.parameter_names, *CLOCK, *model.actuator_signals}
    scope = set(known)
    if effect.stage == "actuator":
        scope = commands if is_sampled(model, effect) else known - set(model.signals)
    if effect.stage == "sensor":
        scope |= set(model.output_names)
    scope = scope | {memory.name for memory in effect.memory}
    scope |= {state.name for state in effect.states}
    for name, text in effect.definitions.items():
        expressions.check(text, scope, where=where, tables=tables)
        scope.add(name)
    texts = [*effect.terms.values(), *(memory.update for memory in effect.memory)]
    for text in (*texts, *(state.rate for state in effect.states)):
        expressions.check(text, scope, where=where, tables=tables)
    for state in effect.states:
        start = {*model.state_names, *commands}
        expressions.check(state.initial, start, where=where, tables=tables)
