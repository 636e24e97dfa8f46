r"""What a problem is: a system, what may be missing in its model, and how to test it.

It can be wrong although every part of it is well formed.

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

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from dataclasses import KW_ONLY, dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import OedSysidError, ProblemError, listed, located
from oed_sysid.experiments import SAYS
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.physics import Effect
from oed_sysid.physics.channels import Channels, settle
from oed_sysid.physics.model import Model
from oed_sysid.physics.structure import Line, effect_lines, lines
from oed_sysid.text import expressions, notation
from oed_sysid.text.dimensions import Deduction
from oed_sysid.text.units import Dimension, dimension

DEFAULT = "default"
_SECOND = dimension("s")
_NAME = re.compile(r"[A-Za-z]\w*")


# What a description says where no candidate effects are named.
USUAL = "none named: usual ones are made from the records"


_KINDS: Mapping[str, Any] = {
    **{"name": str, "title": str, "description": str, "model": Model, "limits": Limits},
    **{"effects": [Effect], "references": [str], "experiments": {str: Experiment}},
    **{"models": {str: Model}, "published": {str: object}},
    "truth": (Mapping | None, "a mapping from names to numbers"),
    "length": (float | int | None, "a length in m"),
    "draught": (float | int | None, "a draught in m"),
    "records": (Callable | None, "a function without arguments that returns the Dataset"),
}


@dataclass(frozen=True)
class Problem:
    """One system to identify.

    Parameters
    ----------
    name : str
        Identifier: letters, digits and underscores.
    model : Model
        What is believed before the data.
    title : str
        The same in words.
    effects : tuple of Effect
        Candidates for what the model lacks.
    experiments : mapping of str to Experiment
        Runs that make sense for this system, by name.
    limits : Limits
        What any experiment has to keep.
    truth : mapping of str to float, optional
        True parameter values, where the data is simulated.
    models : mapping of str to Model
        Other models of the same system, by name; ``"default"`` is ``model``.
    others : mapping of str to Problem
        Problems of the same system with other channels or candidates, such as
        a ship seen as a heading response and as a body in three degrees of
        freedom. :meth:`variant` finds them by name too.
    records : callable, optional
        Returns the measured records, ``() -> Dataset``; called when they are
        wanted.
    published : mapping
        Numbers from the literature to compare with.
    length, draught : float, optional
        Of the vehicle, m: waves are averaged over them.
    references : tuple of str
        Citations.
    left_out : tuple of str
        Candidates of ready-made lists that act on what the model lacks.
    description : str
        What the system is, and what success means.

    Raises
    ------
    ProblemError
        If the parts do not fit together.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Output, State
    >>> decay = Model("decay", (State("x", "m"),), (), (Output("x", "m"),), {"x": "-x"})
    >>> Problem("decay", decay, title="A decay").channels.output_names
    ('x',)
    """

    name: str
    model: Model
    _: KW_ONLY
    title: str = ""
    effects: tuple[Effect, ...] = ()
    experiments: Mapping[str, Experiment] = field(default_factory=dict)
    limits: Limits = field(default_factory=Limits)
    truth: Mapping[str, float] | None = None
    models: Mapping[str, Model] = field(default_factory=dict)
    others: Mapping[str, Problem] = field(default_factory=dict)
    records: Callable[[], Dataset] | None = None
    published: Mapping[str, Any] = field(default_factory=dict)
    references: tuple[str, ...] = ()
    description: str = ""
    length: float | None = None
    draught: float | None = None
    left_out: tuple[str, ...] = field(default=(), init=False)
    _lacking: tuple[str, ...] = field(default=(), init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._check_kinds()
        if not _NAME.fullmatch(self.name):
            raise ProblemError(SAYS["no_identifier"].format(self))
        if self.models.get(DEFAULT, self.model) != self.model:
            raise ProblemError(
                f"Problem {self.name!r} has two default models. Leave {DEFAULT!r} out of models."
            )
        object.__setattr__(self, "title", self.title or self.name.replace("_", " "))
        object.__setattr__(self, "models", {DEFAULT: self.model, **self.models})
        if twice := sorted(set(self.others) & set(self.models)):
            raise ProblemError(
                f"Problem {self.name!r} has a model and a problem called {twice[0]!r}. Rename one."
            )
        self._check_effects()
        self._check_truth()
        try:
            self.limits.check_names(self.model)
            for experiment in self.experiments.values():
                experiment.check_model(self.model)
                self._check_constants(experiment)
        except OedSysidError as error:
            raise ProblemError(f"Problem {self.name!r}: {error}") from None

    def _check_constants(self, experiment: Experiment) -> None:
        """Refuse an input that is held outside the limits of every experiment."""
        for name, value in experiment.constants.items():
            lower, upper = self.limits.inputs.get(name, (-math.inf, math.inf))
            if not lower <= value <= upper:
                raise ProblemError(
                    f"Experiment {experiment.name!r} holds {name!r} at {value:g}, outside the "
                    f"problem's limits [{lower:g}, {upper:g}]. Correct one of them."
                )

    def _check_kinds(self) -> None:
        """Refuse parts of another kind before anything is asked of them."""
        owner = f"Problem {self.name!r:.60}"
        settle(self, owner, {**_KINDS, "others": {str: Problem}}, ProblemError)
        for key, value in (self.truth or {}).items():
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not number or not math.isfinite(value):
                raise ProblemError(
                    f"{owner}: the truth of {key!r} is {value!r:.40}. Give a number."
                )

    def _check_effects(self) -> None:
        seen: set[str] = set()
        kept, left = list[Effect](), dict[str, str]()
        for effect in self.effects:
            if effect.name in seen:
                raise ProblemError(
                    f"Problem {self.name!r} has two candidates called {effect.name!r}. Rename one."
                )
            seen.add(effect.name)
            if effect.name in self.model.effect_names:
                raise ProblemError(SAYS["contained_already"].format(self, effect=effect))
            try:
                self.model + effect
                kept.append(effect)
            except OedSysidError as error:
                if not effect.optional:
                    raise ProblemError(
                        f"Problem {self.name!r}: the candidate {effect.name!r} does not fit the "
                        f"model. {error} Remove it, or give the model what it acts on."
                    ) from None
                left[effect.name] = f"{effect.name} ({str(error).partition('. ')[0]})"
        object.__setattr__(self, "effects", tuple(kept))
        object.__setattr__(self, "left_out", tuple(left))
        object.__setattr__(self, "_lacking", tuple(left.values()))

    def _check_truth(self) -> None:
        """Refuse true values of parameters that there are not, or beyond their bounds."""
        own = (owner.all_parameters for owner in self.models.values())
        everything = [*chain(*own, *(effect.parameters for effect in self.effects))]
        known, truth = [p.name for p in everything], self.truth or {}
        lacking = f"Problem {self.name!r} has neither model nor candidate with the parameter"
        located(ProblemError, lacking, truth, dict.fromkeys(known), "Correct its truth.")
        for parameter in everything:
            true = truth.get(parameter.name)
            if true is not None and not parameter.lower <= true <= parameter.upper:
                raise ProblemError(
                    f"Problem {self.name!r} states the truth of {parameter.name!r} as {true:g}, "
                    f"outside its bounds [{parameter.lower:g}, {parameter.upper:g}]: it could "
                    "never be found. Correct one of them."
                )

    @property
    def channels(self) -> Channels:
        """Inputs and outputs that a record of this system holds."""
        return self.model.channels

    @property
    def variants(self) -> tuple[str, ...]:
        """Names of the models, then of the other problems of the same system."""
        return (*self.models, *self.others)

    def variant(self, name: str) -> Problem:
        """Return the problem with another of its models as the nominal one.

        Candidates that this model contains already are left out.
        """
        if name in self.others:
            return self.others[name]
        lacking, advice = f"Problem {self.name!r} has no model", f"{DEFAULT} is the nominal one."
        located(ProblemError, lacking, [name], self.variants, advice)
        if name == DEFAULT:
            return self
        model = self.models[name]
        others = {key: other for key, other in self.models.items() if key not in (DEFAULT, name)}
        effects = tuple(e for e in self.effects if e.name not in model.effect_names)
        return replace(self, model=model, models=others, effects=effects)

    def true_model(self) -> Model:
        """Return the model that made simulated data: true values, and the candidates they need.

        Raises
        ------
        ProblemError
            If the truth is not known.
        """
        if self.truth is None:
            raise ProblemError(
                f"The truth of problem {self.name!r} is not known: its data was measured."
            )
        truth, model = self.truth, self.model
        hidden = [e for e in self.effects if any(truth.get(p.name) for p in e.parameters)]
        model = model + hidden
        return model.with_values({n: v for n, v in truth.items() if n in model.parameter_names})

    def effect(self, name: str) -> Effect:
        """Return one candidate effect by name."""
        known = {effect.name: effect for effect in self.effects}
        located(ProblemError, f"Problem {self.name!r} has no candidate", [name], known)
        return known[name]

    def experiment(self, name: str) -> Experiment:
        """Return one experiment by name."""
        located(ProblemError, f"Problem {self.name!r} has no experiment", [name], self.experiments)
        return self.experiments[name]

    def data(self) -> Dataset:
        """Return the measured records of this problem.

        Raises
        ------
        ProblemError
            If it comes without records.
        """
        if self.records is None:
            raise ProblemError(SAYS["no_records"].format(self))
        try:
            found = self.records()
        except OedSysidError:
            raise
        except Exception as error:
            raise ProblemError(
                f"The records of problem {self.name!r} cannot be had: its function failed with "
                f"{type(error).__name__}: {str(error) or 'no message'}."
            ) from error
        if not isinstance(found, Dataset):
            raise ProblemError(SAYS["no_dataset"].format(self, kind=type(found).__name__))
        return found

    def notes(self) -> tuple[str, ...]:
        """Say in which units the bare numbers of its models and candidates were read.

        ``0.5*1025*2500*U*v`` is a force if its numbers stand for a density and an
        area; what unit a number stands for follows from where it stands.
        """
        problems = (self, *self.others.values())
        found = [line for one in problems for line in notes(one.models.values(), one.effects)]
        return tuple(dict.fromkeys(found))

    @property
    def lacking(self) -> str:
        """Which candidates of its lists the problem has left out, and why; often empty."""
        return "; ".join(self._lacking)

    def describe(self) -> str:
        """Return what the problem holds, in words."""
        inputs, outputs = ", ".join(self.model.input_names), ", ".join(self.model.output_names)
        lines = [
            f"{self.name}: {self.title}",
            self.description,
            f"model        {self.model.name}: {len(self.model.free_names)} parameters to "
            f"estimate, {len(self.model.state_names)} states",
            f"inputs       {inputs or 'none'}",
            f"outputs      {outputs}",
            f"models       {', '.join(self.variants)}",
            f"candidates   {', '.join(effect.name for effect in self.effects) or USUAL}",
            f"experiments  {listed(self.experiments)}",
            f"left out     {self.lacking}" if self.left_out else "",
            *(f"[{number}] {text}" for number, text in enumerate(self.references, start=1)),
            *(f"note: {text}" for text in self.notes()),
        ]
        return "\n".join(line for line in lines if line)


# -- what is wrong although every part is well formed ---------------------------------------


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
    read = [_Units(model) for model in models]
    for effect in effects:
        extended = read[0].copy()
        list(extended.of_effect(effect))
        read.append(extended)
    return tuple(dict.fromkeys(line for units in read for line in units.notes()))


class _Units:
    """The dimension of every name of a model, derived in the order of evaluation."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.units = Deduction()
        self.masses: dict[str, Dimension | None] = {}
        self.known: dict[str, Dimension | None] = {"t": _SECOND, "h": _SECOND}
        self.known |= {state.name: dimension(state.unit) for state in model.states}
        self.known |= {channel.name: dimension(channel.unit) for channel in model.inputs}
        self.known |= {p.name: _stated(p.unit) for p in model.all_parameters}
        self.outputs = {output.name: dimension(output.unit) for output in model.outputs}
        self.faults = tuple(self._faults())

    def copy(self) -> _Units:
        """The same, to be extended by one effect."""
        other = copy(self)
        other.units = self.units.copy()
        other.known, other.masses = dict(self.known), dict(self.masses)
        return other

    def notes(self) -> tuple[str, ...]:
        """Say which bare numbers were given a unit."""
        for axis in self.model.axes:
            # An inertia of bare numbers: forces are in newton unless the other terms say more.
            force, usual = self._force(axis), _usual_force(axis)
            if force is not None and usual is not None:
                self.units.equal(force, usual)
        return self.units.notes()

    def _faults(self) -> Iterator[str]:
        """Yield what is wrong in a model and its effects."""
        for effect in self.model.effects:
            self.known |= {state.name: _stated(state.unit) for state in effect.states}
        for line in lines(self.model):
            yield from self._line(line, line.where)
        for effect in self.model.effects:
            yield from self.of_effect(effect)

    def of_effect(self, effect: Effect) -> Iterator[str]:
        """Yield what is wrong in one effect."""
        outer = dict(self.known)
        self.known |= {p.name: _stated(p.unit) for p in effect.parameters}
        self.known |= {state.name: _stated(state.unit) for state in effect.states}
        if effect.stage == "sensor":
            self.known |= self.outputs
        for line in effect_lines(self.model, effect):
            yield from self._line(line, f"effect {effect.name!r}{line.where}", effect)
        self.known = outer

    def _line(self, line: Line, where: str, effect: Effect | None = None) -> Iterator[str]:
        """Yield what is wrong in one text, and keep the dimension of what it defines."""
        found = needed = self._needed(line, effect)
        try:
            found = self.units.form(line.text, self.known, where=where)
        except OedSysidError as error:
            yield f"{where}: {error}"
        if needed is not None and found is not None and not self.units.equal(found, needed):
            yield (
                f"{where}: {line.text!r} is in {self.units.dimension(found)}, expected "
                f"{self.units.dimension(needed)}."
            )
        if line.role == "value":
            self.known[line.key] = found

    def _rate(self, name: str) -> Dimension | None:
        own = self.known.get(name)
        return None if own is None else own / _SECOND

    def _needed(self, line: Line, effect: Effect | None) -> Dimension | None:
        """Dimension that a text has to have; None where nothing says one."""
        key = line.key
        place = effect.stage if effect and line.role == "term" else line.role
        if place in ("output", "sensor"):
            return self.outputs.get(key)
        if place in ("update", "start", "actuator", "environment"):
            return self.known.get(key)
        if place in ("rate", "value"):
            return self._rate(key) if place == "rate" else None
        axis, state = key if isinstance(key, tuple) else (key, self.model.axes.get(key))
        if state is None:
            return self._rate(axis)
        force, rate = self._force(axis), self._rate(state)
        return force if place == "force" or force is None or rate is None else force / rate

    def _force(self, axis: str) -> Dimension | None:
        """Dimension of an axis: inertia times acceleration, or by the name of the axis."""
        state = self.model.axes[axis]
        if (rate := self._rate(state)) is None:
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


def _usual_force(axis: str) -> Dimension | None:
    """Force or moment, by the name of the axis."""
    return dimension("N" if axis in "XYZ" else "N m") if axis in notation.AXES else None


def _stated(unit: str) -> Dimension | None:
    """Dimension of a stated unit; an empty one is unknown."""
    return dimension(unit) if unit else None


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
    for p in effect.parameters:
        if p.name in effect.amplitude_names and not p.lower <= 0.0 <= p.upper:
            return (f"its amplitude {p.name!r} cannot be zero within [{p.lower:g}, {p.upper:g}]",)
    rng = np.random.default_rng(0)
    absent = effect.absent().parameters
    values = model.values | {parameter.name: parameter.value for parameter in absent}
    texts = tuple(effect_lines(model, effect))
    names = sorted({name for line in texts for name in line.scope})
    library = {**model.library, **effect.callable}
    present: dict[str, float] = {}
    for _ in range(3):  # a term may vanish at one place by chance
        scope: dict[str, Any] = {name: rng.normal() for name in names}
        scope |= values | {"t": rng.uniform(0, 10), "h": model.step}
        present = _changed(effect, texts, scope, library) | present
    return tuple(
        f"with zero amplitudes ({', '.join(effect.amplitude_names)}) it still changes {key!r} by "
        f"{size:.3g}"
        for key, size in present.items()
    )


def _changed(
    effect: Effect, texts: Iterable[Line], scope: Mapping[str, Any], library: Mapping[str, Any]
) -> dict[str, float]:
    """What each term of an effect changes at one place, where that is more than rounding."""
    inner, found = dict(scope), dict[str, float]()
    for line in texts:
        if line.key not in (*effect.definitions, *effect.terms):
            continue  # memories and states are anywhere
        with np.errstate(all="ignore"):
            value = expressions.to_numpy(line.text, inner, library)
        if line.role == "value":
            inner[line.key] = value
            continue
        expected = 0.0 if effect.stage in ("force", "inertia") else scope[str(line.key)]
        change = float(value) - expected
        if math.isfinite(change) and abs(change) > 1e-9 * (1.0 + abs(expected)):
            found[str(line.key)] = change
    return found


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
    nominal, found = next(iter(models.values())), list[str]()
    for which, model in models.items():
        found += [f"model {which!r}, {fault}" for fault in _Units(model).faults]
    found += effect_faults(effects, nominal)
    for effect in effects:
        found += [
            f"effect {effect.name!r}: {fault}. A candidate has to be absent there."
            for fault in presence_at_zero(effect, nominal)
        ]
    return tuple(dict.fromkeys(f"Problem {name!r}, {fault}" for fault in found))
