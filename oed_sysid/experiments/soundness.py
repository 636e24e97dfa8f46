r"""What can be wrong with a problem although every part of it is well formed.

*Dimensions.* Every expression of a model is in the unit of what it gives: the
rate of a state in that state's unit per second, a force in that of inertia
times acceleration, an output in its own unit. A parameter without a stated unit
may have any; what cannot be derived is not judged. A bare number may have any unit
too: which one, follows from where it stands, and is said in a note.

*Absence.* A candidate effect with zero amplitudes is absent: what it adds is 0,
what it replaces stays. Both are tried with random numbers in the place of every
signal.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping

import numpy as np

from oed_sysid.errors import OedSysidError
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.text import expressions, notation
from oed_sysid.text.dimensions import Deduction, Form
from oed_sysid.text.units import dimension

_N_TRIALS = 3
_SECOND = Form(dimension("s"))


def dimension_faults(model: Model) -> tuple[str, ...]:
    """Say which expressions of a model are not in the unit of what they give."""
    return tuple(_Units(model).faults())


def effect_faults(effects: Iterable[Effect], model: Model) -> tuple[str, ...]:
    """Say which expressions of effects are not in the unit of what they change.

    Parameters
    ----------
    effects : iterable of Effect
        The effects.
    model : Model
        A model that can carry each of them, with or without it.
    """
    units = _Units(model)
    list(units.faults())
    return tuple(fault for effect in effects for fault in units.copy().of_effect(effect))


def notes(models: Iterable[Model], effects: Iterable[Effect]) -> tuple[str, ...]:
    """Say in which unit the bare numbers of models and candidates were read, where not in 1.

    Parameters
    ----------
    models : iterable of Model
        The models of a problem; the first is the one that the candidates extend.
    effects : iterable of Effect
        The candidates.
    """
    found: list[str] = []
    nominal = None
    for model in models:
        units = _Units(model)
        list(units.faults())
        nominal = nominal or units
        found += units.notes()
    if nominal is not None:
        for effect in effects:
            units = nominal.copy()
            list(units.of_effect(effect))
            found += units.notes()
    return tuple(dict.fromkeys(found))


class _Units:
    """The dimension of every name of a model, derived in the order of evaluation."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.units = Deduction()
        self.masses: dict[str, Form | None] = {}
        self.known: dict[str, Form | None] = {"t": _SECOND, "h": _SECOND}
        self.known |= {state.name: Form(dimension(state.unit)) for state in model.states}
        self.known |= {channel.name: Form(dimension(channel.unit)) for channel in model.inputs}
        self.known |= {p.name: _stated(p.unit) for p in model.all_parameters}
        self.outputs = {output.name: Form(dimension(output.unit)) for output in model.outputs}

    def copy(self) -> _Units:
        """The same, to be extended by one effect."""
        other = _Units(self.model)
        other.units, other.known, other.masses = (
            self.units.copy(),
            dict(self.known),
            dict(self.masses),
        )
        return other

    def notes(self) -> tuple[str, ...]:
        """Say which bare numbers were given a unit."""
        for axis in self.model.axes:
            # An inertia of bare numbers: forces are in newton unless the other terms say more.
            force, usual = self._force(axis), _usual_force(axis)
            if force is not None and usual is not None:
                self.units.equal(force, usual)
        return self.units.notes()

    def faults(self) -> Iterator[str]:
        """Yield what is wrong in a model and its effects."""
        model, known = self.model, self.known
        for effect in model.effects:
            known |= {state.name: _stated(state.unit) for state in effect.states}
        for name, text in (*model.actuator_signals.items(), *model.signals.items()):
            known[name] = yield from self._derived(f"signal {name!r}", text)
        for axis, state in model.inertia:
            text = model.inertia[axis, state]
            force, rate = self._force(axis), self._rate(state)
            needed = None if force is None or rate is None else force / rate
            yield from self._derived(f"inertia {(axis, state)}", text, needed)
        for name, text in model.kinematics.items():
            yield from self._derived(f"rate of {name!r}", text, self._rate(name))
        for output in model.outputs:
            needed = self.outputs[output.name]
            yield from self._derived(f"output {output.name!r}", output.source, needed)
        for effect in model.effects:
            yield from self.of_effect(effect)

    def of_effect(self, effect: Effect) -> Iterator[str]:
        """Yield what is wrong in one effect."""
        outer = dict(self.known)
        known = self.known
        known |= {p.name: _stated(p.unit) for p in effect.parameters}
        known |= {state.name: _stated(state.unit) for state in effect.states}
        where = f"effect {effect.name!r}"
        if effect.stage == "sensor":
            known |= self.outputs
        for memory in effect.memory:
            known[memory.name] = yield from self._derived(where, memory.initial)
        for name, text in effect.definitions.items():
            known[name] = yield from self._derived(where, text)
        for key, text in effect.terms.items():
            yield from self._derived(f"{where}, {key}", text, self._needed(effect, key))
        for memory in effect.memory:
            yield from self._derived(where, memory.update, known[memory.name])
        for state in effect.states:
            yield from self._derived(
                f"{where}, rate of {state.name!r}", state.rate, self._rate(state.name)
            )
            yield from self._derived(
                f"{where}, start of {state.name!r}", state.initial, known[state.name]
            )
        self.known = outer

    def _derived(
        self, where: str, text: str, needed: Form | None = None
    ) -> Generator[str, None, Form | None]:
        """Yield a fault if there is one, and return the dimension."""
        try:
            found = self.units.form(text, self.known, where=where)
        except OedSysidError as error:
            yield f"{where}: {error}"
            return needed
        if needed is not None and found is not None and not self.units.equal(found, needed):
            yield (
                f"{where}: {text!r} is in {self.units.dimension(found)}, expected "
                f"{self.units.dimension(needed)}."
            )
        return found

    def _rate(self, name: str) -> Form | None:
        own = self.known.get(name)
        return None if own is None else own / _SECOND

    def _needed(self, effect: Effect, key: str | tuple[str, str]) -> Form | None:
        """Dimension of a term of an effect."""
        if effect.stage == "sensor":
            return self.outputs.get(str(key))
        if effect.stage in ("actuator", "environment"):
            return self.known.get(str(key))
        axis, state = key if isinstance(key, tuple) else (key, self.model.axes.get(key))
        if state is None:
            return self._rate(axis)
        force, rate = self._force(axis), self._rate(state)
        if effect.stage == "force" or force is None or rate is None:
            return force
        return force / rate

    def _force(self, axis: str) -> Form | None:
        """Dimension of an axis: inertia times acceleration, or by the name of the axis."""
        state = self.model.axes[axis]
        rate = self._rate(state)
        if rate is None:
            return None
        if not any(row == axis for row, _ in self.model.inertia):
            return rate
        entry = self.model.inertia.get((axis, state))
        if axis not in self.masses:
            where = f"inertia {(axis, state)}"
            try:
                mass = None if entry is None else self.units.form(entry, self.known, where=where)
            except OedSysidError:  # said where the inertia is looked at
                return None
            self.masses[axis] = mass
        mass = self.masses[axis]
        return _usual_force(axis) if mass is None else mass * rate


def _usual_force(axis: str) -> Form | None:
    """Force or moment, by the name of the axis."""
    return Form(dimension("N" if axis in "XYZ" else "N m")) if axis in notation.AXES else None


def _stated(unit: str) -> Form | None:
    """Dimension of a stated unit; an empty one is unknown."""
    return Form(dimension(unit)) if unit else None


def presence_at_zero(effect: Effect, model: Model) -> tuple[str, ...]:
    """Say which terms of an effect do something although its amplitudes are zero.

    Parameters
    ----------
    effect : Effect
        With amplitudes; one without is present by intention.
    model : Model
        A model that can carry it.
    """
    if not effect.amplitude_names:
        return ()
    for parameter in effect.parameters:
        if parameter.name in effect.amplitude_names and not (
            parameter.lower <= 0.0 <= parameter.upper
        ):
            return (
                f"its amplitude {parameter.name!r} cannot be zero within "
                f"[{parameter.lower:g}, {parameter.upper:g}]",
            )
    rng = np.random.default_rng(0)
    absent = effect.absent().parameters
    values = model.values | {parameter.name: parameter.value for parameter in absent}
    names = tuple(_signals(model, effect))
    present: dict[str, float] = {}
    for _ in range(_N_TRIALS):
        scope: dict[str, float] = {name: rng.normal() for name in names}
        scope |= values | {"t": rng.uniform(0, 10), "h": model.step}
        for key, text in effect.terms.items():
            with np.errstate(all="ignore"):
                inner = dict(scope)
                for name, definition in effect.definitions.items():
                    inner[name] = expressions.to_numpy(definition, inner, effect.tables)  # type: ignore[assignment]
                value = expressions.to_numpy(text, inner, effect.tables)
            expected = 0.0 if effect.stage in ("force", "inertia") else scope[str(key)]
            gap = float(np.abs(value - expected))
            if np.isfinite(gap) and gap > 1e-9 * (1.0 + abs(expected)):
                present.setdefault(str(key), float(value) - expected)
    return tuple(
        f"with zero amplitudes ({', '.join(effect.amplitude_names)}) it still changes {key!r} by "
        f"{size:.3g}"
        for key, size in present.items()
    )


def _signals(model: Model, added: Effect) -> Iterator[str]:
    """Every name that varies in a model with one effect more."""
    yield from model.state_names
    yield from model.input_names
    yield from model.actuator_signals
    yield from model.signals
    yield from model.output_names
    for effect in (*model.effects, added):
        yield from (state.name for state in effect.states)
        yield from (memory.name for memory in effect.memory)


def faults(name: str, models: Mapping[str, Model], effects: tuple[Effect, ...]) -> tuple[str, ...]:
    """Say what is wrong with the models and the candidates of a problem.

    Parameters
    ----------
    name : str
        Of the problem.
    models : mapping of str to Model
        Its models; the first is the nominal one, which the candidates extend.
    effects : tuple of Effect
        Its candidates.
    """
    found = [
        f"Problem {name!r}, model {which!r}, {fault}"
        for which, model in models.items()
        for fault in dimension_faults(model)
    ]
    nominal = next(iter(models.values()))
    found += [f"Problem {name!r}, {fault}" for fault in effect_faults(effects, nominal)]
    for effect in effects:
        found += [
            f"Problem {name!r}, effect {effect.name!r}: {fault}. A candidate has to be absent "
            "there."
            for fault in presence_at_zero(effect, nominal)
        ]
    return tuple(dict.fromkeys(found))
