r"""Propose a term for what no known effect explains.

Every term of a dictionary is a force along the filtered trajectory. At frozen gain the filter
carries it to the innovations (:mod:`oed_sysid.likelihood.smoother`), the unknowns that the model
has already are projected out, and the statistic

.. math:: T = (s' M r)^2 / s' M s

is computed as in :mod:`oed_sysid.evidence.score`. The most promising terms are refitted as real
effects. What is proposed is a hypothesis that explains the records, in the equation where it is
needed, together with those they cannot tell from it.

A dictionary of terms that an equation may lack: products of states and inputs.

Up to three factors, each as it is or as its absolute value (flow separates on
both sides), velocities through the water where the model knows them; of
angles the trigonometric functions that gravity and buoyancy bring; of commands
what reaches the forces.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, product

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.chance import threshold
from oed_sysid.evidence.rank import N_REFITS, Refit, refitted
from oed_sysid.evidence.residual_forces import let_in
from oed_sysid.evidence.score import Rows, Score
from oed_sysid.evidence.study import Study
from oed_sysid.information.shifts import GROUP_WIDTH
from oed_sysid.likelihood.disturbances import disturbed_equations, equation_units
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.fit import ALIKE
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.projection import ABSORBED
from oed_sysid.likelihood.smoother import Path, smoothable
from oed_sysid.physics import Effect, Force
from oed_sysid.physics.channels import Output
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.physics.table import POLYNOMIAL, factor_of
from oed_sysid.runtime.constants import MATERIAL
from oed_sysid.text import dimensions, expressions, notation
from oed_sysid.text.units import Dimension, dimension

# Of a product: expansions of hydrodynamic forces end at third order (Abkowitz 1964).
MOST_FACTORS = 3
# With more signals than this a product of three has at most two different ones.
MANY_SIGNALS = 6
# An absolute value, of a function too.
ABSOLUTE = re.compile(r"abs\(((?:[^()]|\([^()]*\))*)\)")
# Positions on which no force in homogeneous water depends.
HORIZONTAL = ("x", "y", "xi", "eta")


Factors = tuple[tuple[str, bool], ...]


@dataclass(frozen=True)
class Signal:
    """Something that terms are made of.

    Attributes
    ----------
    name : str
        As it stands in an expression.
    unit : str
    kind : str
        ``motion`` (velocities and deflections), ``angle``, ``thrust`` (a
        command that is no angle) or ``position``.
    one_sided : bool
        Whether it keeps its sign throughout the records.
    """

    name: str
    unit: str
    kind: str
    one_sided: bool


@dataclass(frozen=True)
class Term:
    """One product, in one equation.

    Attributes
    ----------
    equation : str
        Axis, or state whose rate is meant.
    expression : str
        The product, for instance ``abs(w_r)*w_r``.
    factors : tuple of (str, bool)
        Signals and whether their absolute value is meant; empty where the
        expression is no product of signals.
    """

    equation: str
    expression: str
    factors: Factors = ()

    @property
    def complexity(self) -> int:
        """Number of factors, absolute values of anything but a squared one counted again."""
        names = [name for name, _ in self.factors]
        odd = sum(
            absolute and not (names.count(name) == 2 and (name, False) in self.factors)
            for name, absolute in self.factors
        )
        return max(len(names), 2 if "*" in self.expression else 1) + odd

    @property
    def symbol(self) -> str:
        """Name of the coefficient, in the manner of hydrodynamic derivatives."""
        if self.factors:
            text = "".join(f"{'abs' if a else ''}{factor_of(n)}" for n, a in self.factors)
            return f"{self.equation}_{text}"
        if self.expression == "1":
            return f"{self.equation}_0"
        kept = "".join(c if c.isalnum() else " " for c in self.expression.replace("**", ""))
        return f"{self.equation}_{''.join(kept.split())}"

    @property
    def derivative(self) -> str | None:
        """The symbol, where it is that of a hydrodynamic derivative and means the same."""
        if not (self.factors or self.expression == "1") or not notation.is_derivative(self.symbol):
            return None
        parsed = tuple((f.symbol, f.absolute) for f in notation.parse(self.symbol).factors)
        meant = tuple((factor_of(name), absolute) for name, absolute in self.factors)
        return self.symbol if parsed == meant else None

    @property
    def text(self) -> str:
        """The term for a reader, for instance ``M_qqq q^3``."""
        if self.derivative is not None:
            return notation.term_text(self.derivative)
        written = self.expression.replace("**", "^").replace("*", " ")
        return self.symbol + " " + ABSOLUTE.sub(r"|\1|", written)

    def effect(self, model: Model, units: Mapping[str, str], scale: float) -> Force:
        """The term as an effect, absent, its coefficient named and given a unit."""
        name = self.symbol
        if name in model.parameter_names or name in units:
            name = f"E_{name}"
        unit = _coefficient_unit(self, model, units)
        size = Parameter(name, 0.0, unit, scale=scale, description=f"proposed: {self.text}")
        return Force(
            f"term_{self.symbol}",
            {self.equation: name if self.expression == "1" else f"{name}*{self.expression}"},
            (size,),
            description=f"{self.text} in the {self.equation} equation, proposed from records",
            source=POLYNOMIAL,
        )


def _coefficient_unit(term: Term, model: Model, units: Mapping[str, str]) -> str:
    if term.derivative is not None:
        return notation.unit(term.derivative)
    known: dict[str, Dimension | None] = {
        name: dimension(unit) for name, unit in units.items() if unit
    }
    factor = (
        Dimension() if term.expression == "1" else dimensions.dimension_of(term.expression, known)
    )
    force = dimension(equation_units(model)[term.equation])
    # Radians are dropped, as in the units of derivatives.
    return "" if factor is None else str((force / factor).plain)


class Signals:
    """What terms are made of, along given trajectories.

    Parameters
    ----------
    model : Model
        Its actuators and environment are respected.
    dataset : Dataset
        Gives times and inputs.
    states : sequence of ndarray (n_times, n_full)
        Full states, per record.

    Attributes
    ----------
    signals : tuple of Signal
    values : list of dict
        ``name -> ndarray (n_times,)`` halfway between samples, per record.
    """

    def __init__(self, model: Model, dataset: Dataset, states: Sequence[np.ndarray]) -> None:
        kinds = [*_kinds(model)]
        shown = replace(
            model,
            outputs=tuple(Output(f"term_{name}", unit, expression=name) for name, unit, _ in kinds),
            effects=tuple(effect for effect in model.effects if effect.stage != "sensor"),
        )
        shown = shown.fix(*shown.free_names)
        compiled = kernel(shown)
        self.values = []
        for record, full in zip(dataset, states, strict=True):
            middle = full.copy()
            middle[:-1] = 0.5 * (full[:-1] + full[1:])
            run = compiled.run(
                record.times,
                record.inputs,
                shown.value_vector,
                middle[:, : compiled.n_full],
                starts=np.arange(record.n_samples, dtype=np.intc),
            )
            self.values.append({name: run.outputs[:, i] for i, (name, _, _) in enumerate(kinds)})
        signals = []
        for name, unit, kind in kinds:
            pooled = np.concatenate([part[name] for part in self.values])
            low, high = np.quantile(pooled, [0.01, 0.99])
            # No deflection goes beyond a quarter of a turn: a direction, counted from anywhere.
            direction = unit == "rad" and np.abs(pooled).max(initial=0.0) > 0.5 * np.pi
            kind = "angle" if direction else kind
            if np.ptp(pooled) > 1e-9 * np.abs(pooled).max(initial=0.0):
                signals.append(Signal(name, unit, kind, bool(low > 0 or high < 0)))
        self.signals = tuple(signals)

    @property
    def units(self) -> dict[str, str]:
        """Unit of every signal."""
        return {signal.name: signal.unit for signal in self.signals}


def _kinds(model: Model) -> Iterator[tuple[str, str, str]]:
    """Name, unit and kind of everything that terms may be made of."""
    velocities = set(model.axes.values())
    through_water = {text: signal for signal, text in model.signals.items()}
    still = cyclic(model)
    for state in model.states:
        if state.name in still:
            continue
        name = through_water.get(state.name, state.name)
        if state.name in velocities or not model.axes:
            yield name, state.unit, "motion"
        elif state.unit == "rad":
            yield state.name, state.unit, "angle"
        elif state.name not in HORIZONTAL:
            yield state.name, state.unit, "position"
    inputs = {channel.name: channel.unit for channel in model.inputs}
    for signal, text in model.actuator_signals.items():
        unit = inputs.get(text, "")
        yield signal, unit, "motion" if unit == "rad" or not model.axes else "thrust"


def cyclic(model: Model) -> set[str]:
    """Coordinates that merely integrate velocities, and on which no equation of forces depends.

    Calm water is the same at every place and heading: a heading of a steering model is no cause of
    a force, nor are positions that it turns velocities into. Depth, which no heading turns, may be.
    """
    held = {state: expressions.names(text) for state, text in model.kinematics.items()}
    known = set(model.state_names)
    left = set() if model.axes else {state for state, names in held.items() if names <= known}
    found = set[str]()
    while found != left:
        found = left
        felt = _felt(model, found)
        left = {state for state in found - felt if _is_still(model, state, held[state], found)}
    return found


def _felt(model: Model, found: set[str]) -> set[str]:
    """What equations, signals and effects hold, those of some coordinates left out."""
    texts = [text for state, text in model.kinematics.items() if state not in found]
    felt = set[str]().union(*map(expressions.names, (*texts, *model.signals.values())))
    return felt.union(*(effect.uses() for effect in model.effects))


def _is_still(model: Model, state: str, held: frozenset[str], found: set[str]) -> bool:
    """Whether it integrates a velocity alone, turns, or is a place that what was found turns."""
    unit = model.states[model.state_names.index(state)].unit
    alone = model.kinematics[state] in model.state_names
    return state not in held and (alone or unit != "m" or bool(held & found))


def terms(model: Model, signals: Sequence[Signal]) -> list[Term]:
    """Every term of the dictionary, equation by equation.

    Parameters
    ----------
    model : Model
    signals : sequence of Signal
        Of :class:`Signals`.
    """
    products = [(), *_products([s for s in signals if s.kind == "motion"])]
    found = [(factors, product_text(factors)) for factors in products]
    for signal in signals:
        found += _of_signal(model, signal, signals, products)
    return [
        Term(equation, text or "1", factors)
        for equation in disturbed_equations(model)
        for factors, text in found
    ]


def _of_signal(
    model: Model, signal: Signal, signals: Sequence[Signal], products: Sequence[Factors]
) -> list[tuple[Factors, str]]:
    """What a command that is no angle, an angle or a position brings besides products."""
    name, plain = signal.name, ((signal.name, False),)
    factors, texts = list[Factors](), list[str]()
    if signal.kind == "thrust":
        factors = [(*of, *plain) for of in products if len(of) < MOST_FACTORS]
    elif signal.kind == "angle":  # what gravity and buoyancy bring
        sine, cosine = f"sin({name})", f"cos({name})"
        texts = [sine, cosine, f"{sine}*{cosine}", f"{sine}*abs({sine})"]
    elif signal.kind == "position":
        factors = [plain]
        # Powers where a force depends on it as a mooring's does.
        if any(name in _forces_depend_on(effect) for effect in model.effects):
            factors = [plain, *filter(lambda of: len(of) > 1, _products([signal]))]
            texts = [f"{name}*sin({one.name})" for one in signals if one.kind == "angle"]
    return [*((of, product_text(of)) for of in factors), *(((), text) for text in texts)]


def _forces_depend_on(effect: Effect) -> set[str]:
    """Names in the force terms of an effect."""
    if effect.stage != "force":
        return set()
    return {name for text in effect.terms.values() for name in expressions.names(text)}


def _products(signals: Sequence[Signal]) -> Iterator[Factors]:
    """Factors of products of up to three signals, absolute values included."""
    ways = {s.name: (False,) if s.one_sided else (False, True) for s in signals}
    most = MOST_FACTORS if len(signals) <= MANY_SIGNALS else 2
    for count in range(1, MOST_FACTORS + 1):
        for names in combinations_with_replacement(ways, count):
            powers = Counter(names)
            if len(powers) <= most:
                choices = product(*(ways[name] for name in powers))
                yield from (_factors(powers, absolute) for absolute in choices)


def _factors(powers: Mapping[str, int], absolute: Sequence[bool]) -> Factors:
    """Powers of signals as factors, of each the first or none an absolute value."""
    pairs = zip(powers.items(), absolute, strict=True)
    return tuple((name, of and not used) for (name, n), of in pairs for used in range(n))


def product_text(factors: Factors) -> str:
    """Text of a product; ``abs(w)*w`` and ``abs(q)*q**2`` where a factor is absolute.

    >>> product_text((("u", False), ("q", True), ("q", False), ("q", False)))
    'u*abs(q)*q**2'
    """
    texts = []
    for name in dict.fromkeys(name for name, _ in factors):
        texts += [f"abs({name})"] * factors.count((name, True))
        plain = factors.count((name, False))
        if plain:
            texts.append(name if plain == 1 else f"{name}**{plain}")
    return "*".join(texts)


@dataclass(frozen=True, eq=False)
class Proposal:
    """One term that would explain the records.

    Attributes
    ----------
    term : Term
    refit : Refit
        With the term as a real effect.
    alike : tuple of str
        Terms that were not refitted because their signature is almost the same.
    """

    term: Term
    refit: Refit
    alike: tuple[str, ...]

    @property
    def effect(self) -> Effect:
        """The term at its fitted value, ready to be added to a model."""
        return self.refit.score.effect.with_values(self.refit.fit.values)

    @property
    def evidence(self) -> float:
        """Gain less what a more complicated term has to be worth: one for every factor."""
        return self.refit.gain - self.term.complexity


@dataclass(frozen=True, eq=False)
class Proposals:
    """Terms that would explain what no known effect explains, best first.

    Attributes
    ----------
    proposals : tuple of Proposal
    needed : float
        Gain that a claim needs, so many terms looked at.
    """

    proposals: tuple[Proposal, ...]
    needed: float

    @property
    def best(self) -> Proposal | None:
        """The best proposal; None where chance explains its gain."""
        return next((one for one in self.proposals[:1] if one.refit.gain > self.needed), None)

    @property
    def group(self) -> tuple[str, ...]:
        """The best term and all that these records cannot tell from it."""
        if self.best is None:
            return ()
        top = self.best.evidence
        near = [one for one in self.proposals if top - one.evidence < GROUP_WIDTH]
        return tuple(dict.fromkeys(text for one in near for text in (one.term.text, *one.alike)))


def propose(study: Study, fit: FilteredSolution, *, n_refits: int = N_REFITS) -> Proposals:
    """Propose terms for what the present model lacks.

    Parameters
    ----------
    study : Study
    fit : FilteredSolution
        The present model, with estimated noise levels.
    n_refits : int
        How many terms to refit.
    """
    first = TermScores(*let_in(fit, study.unit))
    needed = threshold(len(first.scores), 1)
    found = _refitted(study, fit, first.signals, first.representatives(n_refits), needed)
    if found and found[0].refit.gain > needed:
        # Parameters bend to what is missing. With the best term they have straightened,
        # and its noise is small: seen from there, a rival may be better still.
        best = found[0].refit.fit
        again = let_in(fit, study.unit, best)
        second = TermScores(*again, first.signals)
        own = next((s.statistic for s in second.scores if s.term == found[0].term), 0.0)
        # Less by a material share of the statistic is no rival.
        present = {proposal.term for proposal in found}
        rivals = [
            one
            for one in second.representatives(n_refits)
            if one.statistic > (1.0 - MATERIAL) * own and one.term not in present
        ]
        found += _refitted(study, fit, first.signals, rivals, needed, best)
    return Proposals(tuple(sorted(found, key=lambda p: -p.evidence)), needed)


def _refitted(
    study: Study,
    fit: FilteredSolution,
    signals: Signals,
    chosen: Sequence[TermScore],
    needed: float,
    near: FilteredSolution | None = None,
) -> list[Proposal]:
    """Refits of terms, each alone, best first; begun at parameters of a nearby fit where given."""
    if not chosen:
        return []
    scores = [one.of_effect(fit.problem.model, signals.units) for one in chosen]
    # One structure with all of them and none of the other candidates: compiled once.
    held = replace(study, candidates=study.effects_of(fit))
    wide = held.with_candidates([score.effect for score in scores])
    given = {score.effect.name: one for score, one in zip(scores, chosen, strict=True)}
    refits = refitted(wide, fit, [((score,), needed) for score in scores], near)
    found = (Proposal(given[one.name].term, one, given[one.name].alike) for one in refits)
    return sorted(found, key=lambda p: -p.evidence)


@dataclass(frozen=True, eq=False)
class TermScore:
    """Evidence for one term before refitting.

    Attributes
    ----------
    term : Term
    statistic : float
        Chi-squared statistic of its coefficient.
    estimate, std_error : float
        One-step estimate of the coefficient, and its standard error.
    distinct : float
        Share of its signature that free parameters cannot imitate.
    alike : tuple of str
        Terms for which it stands, their signatures almost the same.
    """

    term: Term
    statistic: float
    estimate: float
    std_error: float
    distinct: float
    alike: tuple[str, ...] = ()

    def of_effect(self, model: Model, units: Mapping[str, str]) -> Score:
        """The score of the term as an effect."""
        effect = self.term.effect(model, units, max(abs(self.estimate), self.std_error))
        name, nothing = effect.parameters[0].name, np.zeros((0, 1))
        size, error = {name: self.estimate}, {name: self.std_error}
        return Score(effect, self.statistic, 1, size, error, self.distinct, nothing)


class TermScores:
    """Scores of every term of the dictionary; those that free parameters imitate are left out.

    Parameters
    ----------
    problem : Filtered
        With a disturbance in every equation, and no level unknown.
    unknowns : ndarray (n_unknowns,)
        Where.
    signals : Signals, optional
        What terms are made of; by default along the filtered path.

    Attributes
    ----------
    scores : tuple of TermScore
        Largest statistic first.
    likeness : ndarray (n_compared, n_compared)
        Correlation of the projected signatures of the first ones.
    signals : Signals
        What they are made of.
    """

    def __init__(
        self, problem: Filtered, unknowns: np.ndarray, signals: Signals | None = None
    ) -> None:
        passes, paths = smoothable(problem, unknowns)
        if signals is None:
            states = [part.path[:, problem.own] for part in passes]
            signals = Signals(problem.model, problem.dataset, states)
        dictionary = terms(problem.model, signals.signals)
        known = Rows(problem, unknowns, passes)
        basis = known.basis()
        residual = known.residual - basis @ (basis.T @ known.residual)
        n_terms = len(dictionary)
        shadow, along = np.zeros((basis.shape[1], n_terms)), np.zeros(n_terms)
        full, kept_rows = np.zeros(n_terms), []
        for part, path, scope in zip(known.parts, paths, signals.values, strict=True):
            driven = _driven(problem, path, dictionary, scope)
            rows = path.responses(driven).reshape(-1, n_terms)
            shadow += basis[part].T @ rows
            along -= rows.T @ residual[part]
            full += np.sum(rows**2, axis=0)
            # Thousands of terms: single precision serves to tell which of them are alike.
            kept_rows.append(rows.astype(np.float32))
        left = np.sqrt(np.maximum(full - np.sum(shadow**2, axis=0), 0.0))
        usable = np.flatnonzero((left > ABSORBED * np.sqrt(full)) & (full > 0))
        root = np.zeros(n_terms)
        # Signed root of the score statistic: its square is chi-squared of one degree of freedom.
        root[usable] = along[usable] / left[usable]
        order = usable[np.argsort(-(root[usable] ** 2))]
        first = order[:60]  # likeness of the strongest is looked at
        # Squares of a force in newtons, and of its powers, are beyond single precision.
        strongest = np.concatenate([rows[:, first].astype(float) for rows in kept_rows])
        likeness = strongest.T @ strongest - shadow[:, first].T @ shadow[:, first]
        columns = (root**2, root / np.maximum(left, 1e-300), 1.0 / np.maximum(left, 1e-300))
        facts = np.array([*columns, left / np.sqrt(np.maximum(full, 1e-300))]).T
        self.scores = tuple(TermScore(dictionary[i], *facts[i].tolist()) for i in order)
        self.likeness = likeness / left[first][:, None] / left[first]
        self.signals = signals

    def representatives(self, count: int) -> list[TermScore]:
        """The best terms that differ; of those that are alike, the simplest stands for all."""
        families: list[list[int]] = []
        for index in range(len(self.likeness)):
            near = [own for own in families if abs(self.likeness[own[0], index]) > ALIKE]
            if near:
                near[0].append(index)
            elif len(families) < count:
                families.append([index])
        found = []
        for own in families:
            scores = (self.scores[index] for index in own)
            first, *others = sorted(scores, key=lambda s: s.term.complexity - s.statistic)
            found.append(replace(first, alike=tuple(one.term.text for one in others)))
        return found


def _driven(
    problem: Filtered, path: Path, dictionary: Sequence[Term], scope: dict[str, np.ndarray]
) -> np.ndarray:
    """What a unit of every coefficient adds between samples, ``(n_times, n, n_terms)``."""
    n = len(path.drive)
    texts = dict.fromkeys(term.expression for term in dictionary)
    values = {text: np.broadcast_to(expressions.to_numpy(text, scope), (n,)) for text in texts}
    place = {name: index for index, name in enumerate(problem.levels.noise.places)}
    drive = np.empty((*path.drive.shape[:2], len(dictionary)))
    for index, term in enumerate(dictionary):
        # A term is a force on its equation: it acts as the disturbance there does, times its
        # value.
        force = path.drive[:, :, place[f"force {term.equation}"]]
        drive[:, :, index] = force * values[term.expression][:, None]
    return drive
