"""Parts of a model, their names, and what a model promises of them at construction.

Each part is of its own kind, no definition goes in a circle, every state has one equation, and
every name in a text resolves.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from oed_sysid.errors import ModelError, located
from oed_sysid.physics import Effect
from oed_sysid.physics.channels import SAYS, Channels, Input, Output, State, settle
from oed_sysid.physics.parameters import Parameter, check_unique
from oed_sysid.text import callables, expressions
from oed_sysid.text.callables import Function, Table

CLOCK = ("t", "h")
RESERVED = {"t": "time", "h": "step", "pi": "3.14159..."}

_TEXTS = {str: object}  # an expression that is no text is refused where it is read
_KINDS: Mapping[str, Any] = {
    **{"name": str, "states": [State], "inputs": [Input], "outputs": [Output]},
    **{"effects": [Effect], "parameters": [Parameter], "functions": [Function]},
    **{"kinematics": _TEXTS, "axes": _TEXTS, "actuators": _TEXTS, "signals": _TEXTS},
    **{"inertia": {object: object}, "tables": {str: object}},
}


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
    def all_state_names(self) -> tuple[str, ...]:
        """Names of the model's own states, then of those that effects add."""
        return (*self.state_names, *(s.name for effect in self.effects for s in effect.states))

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

    @cached_property
    def library(self) -> dict[str, Table | Function]:
        """Tables and functions that texts may call; one name means one thing."""
        found: dict[str, Table | Function] = {}
        owners: tuple[Structure | Effect, ...] = (self, *self.effects)
        for owner in owners:
            for name, entry in owner.callable.items():
                if name in expressions.FUNCTIONS:
                    raise ModelError(SAYS["known_function"].format(owner=owner, name=name))
                if callables.digest(found.setdefault(name, entry)) != callables.digest(entry):
                    raise ModelError(SAYS["two_of_one_name"].format(self, name=name))
        return found

    @property
    def callable(self) -> dict[str, Table | Function]:
        """Tables and functions of its own, by name."""
        return {**self.tables, **{function.name: function for function in self.functions}}

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
    def shared_names(self) -> tuple[str, ...]:
        """Names of the free parameters that all records share, in order."""
        return tuple(p.name for p in self.free_parameters if not p.per_record)

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
        lacking = f"Model {self.name!r} has no parameter"
        return self.all_parameters[located(ModelError, lacking, [name], self.parameter_names)[0]]

    def effect(self, name: str) -> Effect:
        """Return one effect by name."""
        lacking = f"Model {self.name!r} has no effect"
        return self.effects[located(ModelError, lacking, [name], self.effect_names)[0]]


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
    settle(model, owner, _KINDS)
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
    names = {f"dot({state})" for state in model.all_state_names}
    names |= {f"force({key})" for key in (*model.axes, *model.kinematics)}
    for effect in model.effects:
        if effect.stage == "force":
            names |= {f"force({key}, {effect.name})" for key in effect.terms}
    return names


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
    known, advice = ("explicit", "implicit"), "Implicit is for stiff models."
    located(ModelError, "There is no integrator", [model.integrator], known, advice)


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
    pairs = "an axis and a velocity: name axes first, such as {'Z': 'w'}"
    if model.axes:
        pairs = f"one of the axes {', '.join(model.axes)} and of {', '.join(model.axes.values())}"
    for axis, state in model.inertia:
        if axis not in model.axes or state not in model.axes.values():
            raise ModelError(
                f"Model {model.name!r}: inertia has the key ({axis!r}, {state!r}), which does not "
                f"belong to the model. Expected (axis, state), {pairs}."
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


@dataclass(frozen=True)
class Line:
    """One text of a model.

    Parameters
    ----------
    where : str
        Its place, for messages.
    text : str
        The expression.
    scope : collection of str
        Names that it may use.
    role : str
        What it is: ``value`` of a name, ``rate`` or ``start`` of a state, ``update`` of a memory,
        entry of the ``inertia``, ``output``, or ``term`` of an effect.
    key : str or tuple of str
        What it belongs to.
    """

    where: str
    text: str
    scope: Collection[str]
    role: str
    key: Any


def lines(model: Structure) -> Iterator[Line]:
    """Texts of a model without its effects, in the order of evaluation."""
    commands = {*model.input_names, *model.parameter_names, *CLOCK}
    for name, text in model.actuator_signals.items():
        yield Line(f"actuator {name!r}", text, commands, "value", name)
    known = _known(model) - set(model.signals)
    for name, text in model.signals.items():
        yield Line(f"signal {name!r}", text, known, "value", name)
        known = known | {name}
    for key, text in model.inertia.items():
        yield Line(f"inertia {key}", text, known, "inertia", key)
    for name, text in model.kinematics.items():
        yield Line(f"rate of {name!r}", text, known, "rate", name)
    seen = known | rates_and_forces(model)
    for output in model.outputs:
        yield Line(f"output {output.name!r}", output.source, seen, "output", output.name)


def effect_lines(model: Structure, effect: Effect) -> Iterator[Line]:
    """Texts of an effect of a model, in the order of evaluation."""
    commands = {*model.input_names, *model.parameter_names, *CLOCK, *model.actuator_signals}
    scope = _known(model)
    if effect.stage == "actuator":
        scope = commands if is_sampled(model, effect) else scope - set(model.signals)
    elif effect.stage == "sensor":
        # Sensors come last in the chain: only they see accelerations and forces.
        scope = scope | rates_and_forces(model) | set(model.output_names)
    for memory in effect.memory:
        yield Line("", memory.initial, scope, "value", memory.name)
    scope = scope | {one.name for one in effect.memory} | {one.name for one in effect.states}
    for name, text in effect.definitions.items():
        yield Line("", text, scope, "value", name)
        scope = scope | {name}
    for key, text in effect.terms.items():
        yield Line(f", {key}", text, scope, "term", key)
    for memory in effect.memory:
        yield Line("", memory.update, scope, "update", memory.name)
    for state in effect.states:
        yield Line(f", rate of {state.name!r}", state.rate, scope, "rate", state.name)
        begin = {*model.state_names, *commands}
        yield Line(f", start of {state.name!r}", state.initial, begin, "start", state.name)


def _known(model: Structure) -> set[str]:
    """What equations of motion see: actuators' signals, not commands, which are their matter."""
    own = {*model.all_state_names, *model.actuator_signals, *model.signals}
    return own | {*model.parameter_names, *CLOCK}


def _check_texts(model: Structure) -> None:
    """Every effect changes what there is, and every name in a text resolves."""
    library = model.library
    for line in lines(model):
        where = f"Model {model.name!r}, {line.where}"
        expressions.check(line.text, line.scope, where=where, tables=library)
    targets: dict[str, set] = {
        "actuator": set(model.actuator_signals),
        "environment": set(model.signals),
        "force": {*model.axes, *model.kinematics},
        "inertia": {(axis, state) for axis in model.axes for state in model.axes.values()},
        "sensor": set(model.output_names),
    }
    for effect in model.effects:
        where = f"Effect {effect.name!r} in model {model.name!r}"
        for key in effect.terms:
            if key not in targets[effect.stage]:
                raise ModelError(
                    f"{where} acts on {key!r}, which no {effect.stage} effect can change here. "
                    f"Choose among: {', '.join(sorted(map(str, targets[effect.stage])))}."
                )
        for line in effect_lines(model, effect):
            expressions.check(line.text, line.scope, where=where + line.where, tables=library)
