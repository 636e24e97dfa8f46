"""What a model promises at construction: names that resolve, equations that are complete."""

from __future__ import annotations

from collections.abc import Mapping

from oed_sysid.errors import ModelError
from oed_sysid.physics import Effect
from oed_sysid.physics.parameters import check_unique
from oed_sysid.physics.structure import Structure
from oed_sysid.text import callables, expressions
from oed_sysid.text.callables import Function, Table

CLOCK = ("t", "h")
RESERVED = {"t": "time", "h": "step", "pi": "3.14159..."}


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
    if not model.states or not model.outputs:
        raise ModelError(f"Model {model.name!r} needs at least one state and one output.")
    if not model.step > 0:
        raise ModelError(f"Model {model.name!r} has step {model.step}. Give seconds above zero.")
    if model.integrator not in ("explicit", "implicit"):
        raise ModelError(
            f"Model {model.name!r} has integrator {model.integrator!r}. Choose explicit, or "
            "implicit for a stiff model."
        )
    states = list(model.state_names)
    driven = [*model.kinematics, *model.axes.values()]
    for name in states:
        if driven.count(name) != 1:
            raise ModelError(
                f"State {name!r} of model {model.name!r} has {driven.count(name)} equations, "
                "expected one: name it in kinematics or as the velocity of one axis."
            )
    for name in driven:
        if name not in states:
            raise ModelError(f"Model {model.name!r} has an equation for unknown state {name!r}.")
    for axis, state in model.inertia:
        if axis not in model.axes or state not in model.axes.values():
            raise ModelError(
                f"Inertia entry ({axis!r}, {state!r}) of model {model.name!r} does not belong to "
                f"the axes {dict(model.axes)}."
            )
    outputs = list(model.output_names)
    for name in {n for n in outputs if outputs.count(n) > 1}:
        raise ModelError(f"Model {model.name!r} has two outputs {name!r}. Rename or remove one.")
    columns: dict[str, str] = {}
    for output in model.outputs:
        column = output.column or output.name
        if column in columns:
            raise ModelError(
                f"Outputs {columns[column]!r} and {output.name!r} of model {model.name!r} both "
                f"read the column {column!r}: one measurement would count twice. Give one of them "
                "another column, or remove it."
            )
        columns[column] = output.name
    parameters = set(model.parameter_names)
    base = [*states, *model.input_names, *parameters]
    for name in {n for n in base if base.count(n) > 1}:
        raise ModelError(f"Model {model.name!r} uses the name {name!r} for two things.")
    for name in RESERVED:
        if name in base:
            raise ModelError(f"The name {name!r} is reserved ({RESERVED[name]}). Rename it.")
    extra = [state.name for effect in model.effects for state in effect.states]
    tables = _callable(model)
    commands = {*model.input_names, *parameters, *CLOCK}
    where = f"Model {model.name!r}"
    for signal, text in model.actuator_signals.items():
        expressions.check(text, commands, where=f"{where}, actuator {signal!r}", tables=tables)
    known = {*states, *extra, *model.actuator_signals, *parameters, *CLOCK}
    for signal, text in model.signals.items():
        expressions.check(text, known, where=f"{where}, signal {signal!r}", tables=tables)
        known.add(signal)
    for state, text in model.kinematics.items():
        expressions.check(text, known, where=f"{where}, rate of {state!r}", tables=tables)
    for key, text in model.inertia.items():
        expressions.check(text, known, where=f"{where}, inertia {key}", tables=tables)
    seen = known | rates_and_forces(model)
    for output in model.outputs:
        sensor = f"{where}, output {output.name!r}"
        expressions.check(output.source, seen, where=sensor, tables=tables)
    for effect in model.effects:
        _validate_effect(model, effect, seen if effect.stage == "sensor" else known, tables)


def _validate_effect(
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
    for text in effect.terms.values():
        expressions.check(text, scope, where=where, tables=tables)
    for memory in effect.memory:
        expressions.check(memory.update, scope, where=where, tables=tables)
    for state in effect.states:
        expressions.check(state.rate, scope, where=where, tables=tables)
        start = {*model.state_names, *commands}
        expressions.check(state.initial, start, where=where, tables=tables)
