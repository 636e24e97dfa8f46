r"""Does what was taken for random follow motion and commands? A score test of unknown laws.

Of a disturbance :math:`d` the filter tells what it may be; a law that the model lacks makes it a
function of motion and commands. At the estimate,

.. math:: d_k = \sum_j a_j f_j(x_{k|k}, u_k) + w_k , \qquad a = 0,

with :math:`f_j` piecewise linear functions of every state on the filtered path and of every command
that moves, and these after lags of first order, and of the time since the record began, alone and
times each command: what fades, warms up or fails for some time is one, too. With the derivatives
:math:`G` of the whitened innovations :math:`e` by the :math:`a_j`, and :math:`K` those by
everything that was estimated,

.. math::
    s = -G'e + G'K (K'K)^{+} K'e, \qquad M = G'G - G'K (K'K)^{+} K'G, \qquad T = s' M^{+} s

is what the best such law would gain in twice the log-likelihood (Rao 1948; White 1982 for the mean
square of :math:`e` by which it is divided where it exceeds one). Of all signals together it has
many freedoms, among which a law of one of them is lost: each is asked alone, too, with knots twice
as close, and so is, where there are several records, a step at the same time of each. An innovation
knows nothing of
what was measured or commanded before it, so that :math:`T` is a chi-squared variable where no law
is missing: also where a helmsman, an autopilot or the rule of a zigzag answers the disturbance,
which runs without measurements do not bear. Where waves are faster than two samples of what they
move (Nyquist), commands may answer motion that the log does not hold, and tell of innovations to
come: there it is not asked.

Motion that a disturbance moves is itself random, and where it wanders (a position without a spring)
:math:`T` is larger than chi-squared, by a third for three such equations (Dickey & Fuller 1979 for
one). What stands is divided by the mean of :math:`T` over its freedom in records drawn from the
filter itself, with innovations :math:`\tilde e` in place of :math:`e` (Bartlett 1937):

.. math:: \delta_{k|k} = \delta_{k|k-1} + g_k (\tilde e_k - e_k), \qquad
    \delta_{k+1|k} = F_k \delta_{k|k}
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.special import chdtri

from oed_sysid.compiled.filtering import FilterPass, filter_kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import MINIMUM_SAMPLES, Record
from oed_sysid.errors import SimulationError
from oed_sysid.likelihood.departures import (
    ACTING,
    LEVERS,
    SHAPES,
    acting,
    asked_of,
    off_origin,
    smoothed_inputs,
    values_of,
)
from oed_sysid.likelihood.disturbances import DISTURBANCE, chosen_places, commands
from oed_sysid.likelihood.estimate import Departure, Estimate, once_a_fit
from oed_sysid.likelihood.filtered import Filtered, disturbed_model
from oed_sysid.likelihood.gauss_newton import solve_filtered
from oed_sysid.likelihood.noise_levels import RARE, first_order
from oed_sysid.likelihood.noise_model import Levels, NoiseModel, correlation_times
from oed_sysid.likelihood.projection import ABSORBED
from oed_sysid.likelihood.score_test import Scored, Setting
from oed_sysid.likelihood.smoother import Path, smoothable
from oed_sysid.likelihood.unknowns import KnownStarts
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import MATERIAL
from oed_sysid.runtime.display import as_dict
from oed_sysid.text import expressions

# Knots of a piecewise linear function, and lags of first order, of every signal; knots of one that
# is asked alone, and parts of a run between which a force may step.
KNOTS, LAGS = 5, 3
FINER, PARTS = 2 * KNOTS - 1, 32
# Records drawn at once; and at most, until it is clear, to see how large a statistic is by chance.
CHUNK = 20
# How time since the start of a record is called among the signals.
IN_THE_RUN = "the time in the run"
STEP = f"{IN_THE_RUN}, a step at "
# How the slow noise of a sensor is called in the place of a force.
SLOW = "noise of "


@dataclass(frozen=True)
class Law:
    """A disturbance, or slow noise of a sensor, that is a function of motion and commands.

    Attributes
    ----------
    place : str
        ``"force Z"``, or ``"noise of q"``.
    signals : tuple of str
        One or two signals that tell most of it.
    statistic : float
        What a law of all signals, or where that is not clear of one, would gain in twice the
        log-likelihood.
    freedom : int
        Functions of which that law is made.
    needed : float
        Statistic that chance exceeds in one of a thousand fits, all places together; of one signal
        all signals together.
    """

    place: str
    signals: tuple[str, ...]
    statistic: float
    freedom: int
    needed: float

    @property
    def text(self) -> str:
        """In words, for instance ``force Z follows z (score 515; by chance 81)``."""
        score = f"score {self.statistic:.0f}; by chance {self.needed:.0f}"
        return f"{self.place} follows {' and '.join(self.signals)} ({score})"

    to_dict = as_dict("place", "signals", "statistic", "freedom", "needed")


@once_a_fit
def laws_of(fit: Estimate) -> tuple[Law, ...] | None:
    """Laws that the process noise of a fit holds; None where that cannot be asked."""
    return laws(*posed_again(fit)) if _has_starts(fit) else None


def _has_starts(fit: Estimate) -> bool:
    """Whether a fit knows where every record began, so that its likelihood can be posed again."""
    return len(fit.initial_states) == len(fit.local_values) == len(fit.dataset)


def posed_again(
    fit: Estimate, known_starts: KnownStarts | None = None, *, levels: bool = False
) -> tuple[Filtered, np.ndarray]:
    """The likelihood of a fit, and the unknowns at its end; its noise ``levels`` may be unknown."""
    noise = fit.noise.on(*fit.dataset.names)
    # The filter with which the fit was made, so that it need not be compiled again.
    setting = Setting(
        fit.model,
        fit.dataset,
        chosen_places(fit.model, "all"),
        noise.white,
        np.zeros(len(noise.white), dtype=bool),
        logged=commands(fit.model),
    )
    unknown = Levels.of(
        noise,
        noise,
        white=fit.sigma_estimated & levels,
        colour=(noise.colour > 0) & levels,
        force=(noise.force > 0) & levels,
        own_times=noise.has_own_times,
        times=correlation_times(fit.dataset),
        seas=None if levels else noise.seas,
    )
    names = dict.fromkeys((*setting.disturbances, *unknown.disturbances))
    kernel = filter_kernel(disturbed_model(fit.model, tuple(names)))
    problem = Filtered(fit.model, fit.dataset, unknown, kernel=kernel, known_starts=known_starts)
    return problem, problem.point(fit.initial_states, fit.local_values).unknowns


@once_a_fit
def departures_beside(fit: Estimate) -> tuple[Departure, ...]:
    r"""Departures of single signals, each asked on its own beside the process noise of a fit.

    The score is that of a law, :math:`G` the derivatives of whitened innovations by the departures:
    what an autopilot does about waves comes late in the residuals of whole runs, and in no
    innovation.

    Parameters
    ----------
    fit : Estimate
        With process noise.

    Returns
    -------
    tuple of Departure
        Of every output and input; empty where it cannot be asked.
    """
    if not (fit.names and _has_starts(fit)):
        return ()
    problem, unknowns = posed_again(fit)
    point = Scored(problem, unknowns, problem.passes(unknowns, levels=False, rows=True))
    asked, columns = asked_of(fit.model), list[list[np.ndarray]]()
    calm = Dataset(tuple(one.with_inputs(smoothed_inputs(one)) for one in fit.dataset))
    smoothed = problem.posed(dataset=calm).passes(unknowns, columns=False)
    for signals, kind in asked:
        spoilt, unit = _spoilt(fit, signals, kind, problem, smoothed)
        columns.append(_moved(problem.posed(dataset=spoilt), point, unit))
    rows = (np.stack(of_record, axis=2) for of_record in zip(*columns, strict=True))
    left, scores, own = point.score(rows, len(asked))
    information = np.maximum(np.diag(left), ABSORBED * own)
    with np.errstate(divide="ignore", invalid="ignore"):
        sizes, std = scores / information, information**-0.5
    gains = point.scatter * sizes * scores
    errors = np.concatenate([part[np.isfinite(part)] for part in fit.whitened])
    shares = np.minimum(gains / max(float(errors @ errors) - len(errors), 1e-9), 1.0)
    numbers = zip(*(one.tolist() for one in (sizes, std, gains, shares)), strict=True)
    return tuple(
        replace(Departure(signals[0], kind, *own), together=signals[1:])
        for (signals, kind), own in zip(asked, numbers, strict=True)
        if np.isfinite(own).all()
    )


def _moved(problem: Filtered, point: Scored, unit: float) -> list[np.ndarray]:
    """How far innovations are from those at a point, in standard deviations and for a unit."""
    passes = problem.passes(point.unknowns, columns=False)
    return [
        (other.innovations - part.innovations) / np.sqrt(part.variances) / unit
        for part, other in zip(point.passes, passes, strict=True)
    ]


def _spoilt(
    fit: Estimate,
    signals: Sequence[str],
    kind: str,
    problem: Filtered,
    smoothed: Sequence[FilterPass],
) -> tuple[Dataset, float]:
    """Records with some more of a departure undone, and how much that is.

    It is a departure of what is expected where noise of inputs is ``smoothed``.
    """
    if kind in ACTING:
        column = fit.model.input_names.index(signals[0])
        # Commands are steps: late by less than a sample they would move nothing.
        unit = min(record.sample_time for record in fit.dataset)
        return Dataset(tuple(acting(one, column, kind, unit) for one in fit.dataset)), unit
    records = []
    for index, record in enumerate(fit.dataset):
        outputs, expected = record.outputs.copy(), record.outputs - smoothed[index].innovations
        if kind in LEVERS and not record.independent:
            states = smoothed[index].path[:, problem.own]
            values = values_of(fit, index)
            added = off_origin(fit.model, kind, values, states, record.times)
            outputs -= added * np.isin(fit.model.output_names, signals)
        for column in map(fit.model.output_names.index, () if kind in LEVERS else signals):
            seen = np.isfinite(outputs[:, column]) & (not record.independent)
            if seen.sum() > 1:
                outputs[seen, column] -= SHAPES[kind](expected[seen, column], record.times[seen])
        records.append(record.with_outputs(outputs))
    return Dataset(tuple(records)), 1.0


def loss_without(fit: Estimate, place: str) -> float:
    """Likelihood-ratio statistic of the disturbance at one place of a fit, levels free."""
    problem, unknowns = posed_again(fit, levels=True)
    gone = np.isin(fit.noise.places, place)
    without = problem.posed(problem.levels.without_forces(gone))
    end = solve_filtered(without, without.beside(unknowns), polish=0)
    return end.objective - problem.objective(unknowns)


def with_sea_of_its_records(fit: Estimate) -> NoiseModel:
    """Noise of a fit, seas as its records tell them beside the shared parameters that it has."""
    problem, unknowns = posed_again(fit, levels=True)
    shared = np.arange(len(problem.layout.shared))
    held = problem.holding(shared, unknowns[shared])
    found = solve_filtered(held, held.beside(unknowns), polish=0).finite
    return fit.noise if found is None else replace(fit.noise, seas=found.noise.seas)


def laws(problem: Filtered, unknowns: np.ndarray) -> tuple[Law, ...] | None:
    """Disturbances of a problem that follow motion and commands, one entry each.

    Of sensors with slow noise the same is asked where nothing disturbs the vehicle.

    Parameters
    ----------
    problem : Filtered
    unknowns : ndarray (n_unknowns,)

    Returns
    -------
    tuple of Law or None
        None where it cannot be asked: the filter diverges, nothing moves, or waves are too fast
        for the samples.
    """
    if unresolved(problem.model, problem.records, problem.noise(unknowns)):
        return None
    try:
        passes, paths = smoothable(problem, unknowns)
    except SimulationError:
        return None
    end = _End(Scored(problem, unknowns, passes), paths)
    if (asked := end.asked()) is None:
        return None
    if standing := [one for one in asked if one.stands]:
        usual = end.usual(standing)
        standing = [replace(one, usual=usual.get(one.key, 1.0)) for one in standing]
    # Of each place the law of all signals, else that of the one farthest beyond chance.
    standing = [one for one in standing if one.stands]
    standing.sort(key=lambda one: (one.signal != "", one.needed - one.statistic()))
    found = dict[str, Law]()
    for one in standing:
        found.setdefault(one.place, one.law())
    return tuple(found.values())


def unresolved(model: Model, records: Iterable[Record], noise: NoiseModel) -> str:
    """Waves faster than two samples of every sensor of what they move, in words; often empty."""
    for sea in noise.seas:
        for place in (p for p, level in (sea.levels or {}).items() if level > 0):
            equation = place.removeprefix("force ")
            state = model.axes.get(equation, equation)
            moved = {state, *(of for of, text in model.kinematics.items() if text == state)}
            told = [bool(moved & expressions.names(output.source)) for output in model.outputs]
            apart = _intervals(records)[told if any(told) else slice(None)]
            if sea.period < 2.0 * apart.min(initial=np.inf) < np.inf:
                return (
                    f"waves of {sea.period:.2g} s move {state}, of which there is a sample every "
                    f"{apart.min():.2g} s: two in each wave would show whether forces or commands "
                    "lead"
                )
    return ""


def _intervals(records: Iterable[Record]) -> np.ndarray:
    """Median time between samples of each output, where records have most, s; else infinite."""
    found = [
        [
            float(np.median(np.diff(record.times[seen]))) if seen.sum() > 1 else np.inf
            for seen in np.isfinite(record.outputs).T
        ]
        for record in records
    ]
    return np.min(found, axis=0)


@dataclass(frozen=True, eq=False)
class _End:
    """Where an estimation ended, and what can be asked there of one place after the other."""

    point: Scored
    paths: Sequence[Path]

    def asked(self, places: Container[str] | None = None) -> list[_Asked] | None:
        """What is asked of all or some places that act: a law of all signals, and of each alone.

        None where nothing moves.
        """
        features, owners, alone = _features(self.point.problem, self.point.passes)
        if len(owners) == 1:
            return None
        found = []
        for place, responses in self._responses(features):
            if places is None or place in places:
                left, score, own = self.point.score(responses, len(owners))
                found.append(_Asked(place, score, left, np.sqrt(own), owners, alone))
        return [part for one in found for part in one.parts(RARE / len(found))]

    def usual(self, standing: Sequence[_Asked]) -> dict[tuple[str, ...], float]:
        """Mean statistic over its freedom by chance, of all that stands; one at least."""
        rng, found = np.random.default_rng(0), defaultdict[tuple[str, ...], list[float]](list)
        places = {one.place for one in standing}
        for count in range(1, CHUNK + 1):
            for one in self._drawn(rng, places):
                found[one.key].append(one.statistic() / one.freedom)
            if count >= MINIMUM_SAMPLES and all(one.clear(found[one.key]) for one in standing):
                break
        drawn = ((one.key, found[one.key]) for one in standing)
        return {key: max(float(np.mean(few)), 1.0) for key, few in drawn if few}

    def _drawn(self, rng: np.random.Generator, places: Container[str]) -> list[_Asked]:
        """Some places, where drawn records tell something of them; none where one is lost."""
        drawn = [_drawn(self.point.problem, part, rng) for part in self.point.passes]
        if not all(np.isfinite(part.path).all() for part in drawn):
            return []
        there = replace(self, point=replace(self.point, passes=drawn))
        return [one for one in there.asked(places) or () if one.freedom]

    def _responses(
        self, features: Sequence[np.ndarray]
    ) -> Iterator[tuple[str, Iterator[np.ndarray]]]:
        """Every place that acts, and whitened innovations by the functions there, per record."""
        problem = self.point.problem
        noise, levels = problem.noise(self.point.unknowns), problem.levels
        acting = _acting(noise, levels.disturbances)
        pairs = [*zip(self.paths, features, strict=True)]
        # Of one record at a time: columns of long records are large.
        for place, at in acting.items():
            yield (
                place,
                (path.responses(path.drive[:, :, at, None] * own[:, None]) for path, own in pairs),
            )
        for at, column in enumerate(() if acting else levels.coloured):
            lasts = float(noise.colour_time[column])
            found = (
                path.responses(_of_colour(path, own, record.times, lasts, at))
                for record, (path, own) in zip(problem.records, pairs, strict=True)
            )
            yield f"{SLOW}{noise.outputs[column]}", found


def _drawn(problem: Filtered, part: FilterPass, rng: np.random.Generator) -> FilterPass:
    """A pass with innovations drawn as the filter says they are, its path moved by them."""
    seen, n = np.isfinite(part.innovations), len(part.gram) - 1
    white = np.where(seen, rng.standard_normal(seen.shape), np.nan)
    innovations = white * np.sqrt(part.variances)
    pushes = np.einsum(
        "koj,ko->kj", part.gains[:, :, 1], np.nan_to_num(innovations - part.innovations)
    )
    away, path = np.zeros(pushes.shape[1]), part.path.copy()
    for k, (push, move) in enumerate(zip(pushes, part.moves, strict=True)):
        away = away + push
        path[k, problem.active] += away[: len(problem.active)]
        away = move[: len(away)] @ away
    rows, gram = part.rows[seen], part.gram.copy()
    gram[:n, -1] = gram[-1, :n] = rows[:, :n].T @ white[seen]
    slope = 0.5 * rows[:, n:].T @ (1.0 - white[seen] ** 2)
    return replace(part, innovations=innovations, path=path, gram=gram, level_slope=slope)


@dataclass(frozen=True, eq=False)
class _Asked:
    """Score and information of functions at one place, everything estimated projected out.

    ``size`` are the roots of the information before, ``owners`` the signals of the functions,
    ``alone`` whether these are of a law of one signal only, ``signal`` the one that is asked,
    ``usual`` is what chance makes of the statistic over its freedom, ``chance`` how often it may
    exceed what is needed.
    """

    place: str
    score: np.ndarray
    matrix: np.ndarray
    size: np.ndarray
    owners: np.ndarray
    alone: np.ndarray
    signal: str = ""
    usual: float = 1.0
    chance: float = RARE

    @property
    def key(self) -> tuple[str, ...]:
        """What tells it from all others."""
        return self.place, self.signal

    @property
    def signals(self) -> list[str]:
        """Those of the functions."""
        return list(dict.fromkeys(self.owners[self.owners != ""].tolist()))

    def parts(self, chance: float) -> Iterator[_Asked]:
        """A law of all signals together, then one of each."""
        yield replace(self._where(~self.alone), chance=chance)
        rare = chance / len(self.signals)
        yield from (replace(self._of(n), signal=n, chance=rare) for n in self.signals)

    def _of(self, *signals: str) -> _Asked:
        """The same of some signals, and a constant."""
        return self._where(np.isin(self.owners, ("", *signals)))

    def _where(self, chosen: np.ndarray) -> _Asked:
        names = ("score", "size", "owners", "alone")
        vectors = {name: getattr(self, name)[chosen] for name in names}
        return replace(self, matrix=self.matrix[np.ix_(chosen, chosen)], **vectors)

    def statistic(self) -> float:
        """What the best of its functions would gain in twice the log-likelihood."""
        return float(np.sum((self._onto.T @ self.score) ** 2)) / self.usual

    @cached_property
    def _onto(self) -> np.ndarray:
        """Coordinates of unit information, of what is not estimated already."""
        size = np.where(self.size > 0, self.size, 1.0)
        values, vectors = np.linalg.eigh(self.matrix / size[:, None] / size)
        told = values > ABSORBED**2
        return np.asarray(vectors[:, told] / size[:, None] / np.sqrt(values[told]))

    @property
    def freedom(self) -> int:
        """Number of functions of which anything is told."""
        return self._onto.shape[1]

    @property
    def stands(self) -> bool:
        """Whether chance rarely gives as much."""
        return bool(self.freedom and self.statistic() > self.needed)

    @property
    def needed(self) -> float:
        """Statistic that chance exceeds rarely."""
        return float(chdtri(self.freedom, self.chance))

    def clear(self, ratios: Sequence[float]) -> bool:
        """Whether drawn statistics over their freedom tell if it stands."""
        error = np.std(ratios) / np.sqrt(len(ratios)) if ratios else np.inf
        return bool(abs(self.statistic() / self.needed - np.mean(ratios)) > 3.0 * error)

    def law(self) -> Law:
        """The law, by the signal or the two that tell most of it."""

        def best(count: int) -> tuple[float, tuple[str, ...]]:
            sets = combinations(self.signals, count)
            return max(((self._of(*one).statistic(), one) for one in sets), default=(0.0, ()))

        whole, alone, pair = self.statistic(), best(1), best(2)
        # Two signals only where the second tells a material share of what the first leaves.
        both = pair[0] - alone[0] > MATERIAL * (whole - alone[0])
        return Law(self.place, (pair if both else alone)[1], whole, self.freedom, self.needed)


def _acting(noise: NoiseModel, disturbances: Sequence[str]) -> dict[str, int]:
    """Places with a disturbance, and its position among all; of two in one place the first."""
    acts = dict(zip(noise.places, noise.force, strict=True))
    for sea in noise.seas:
        acts |= {p: one for p, one in zip(sea.places, sea.level, strict=True) if one > 0}
    places = dict[str, int]()
    for index, name in enumerate(disturbances):
        places.setdefault(name.removeprefix(DISTURBANCE).replace("_", " ", 1), index)
    return {place: index for place, index in places.items() if acts.get(place, 0.0) > 0}


def _of_colour(
    path: Path, functions: np.ndarray, times: np.ndarray, lasts: float, index: int
) -> np.ndarray:
    """What adds functions to the colour of a sensor, ``(n_times, n, n_functions)``.

    A sample late, since a function of the path holds the innovation of its own sample.
    """
    fades = np.exp(-np.diff(times, append=np.inf) / lasts)
    before = np.vstack([np.zeros_like(functions[:1]), functions[:-1]])
    drive = np.zeros((len(functions), path.closed.shape[1], functions.shape[1]))
    drive[:, path.first + path.drive.shape[2] + index] = functions - fades[:, None] * before
    return drive


def _features(
    problem: Filtered, passes: Sequence[FilterPass]
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Functions of every signal, and a constant, ``(n_times, n_functions)``.

    Whose each is, and whether it is of a law of that signal alone.
    """
    pairs = zip(problem.records, passes, strict=True)
    signals = [_signals(problem, record, part.path) for record, part in pairs]
    longest = max(record.duration for record in problem.records)
    into = [(record.times - record.times[0]) / longest for record in problem.records]
    times = [_hats(own, np.linspace(0.0, 1.0, KNOTS)) for own in into]
    blocks: list[_Block] = [("", False, [np.ones((len(own), 1)) for own in into])]
    for name in signals[0]:
        blocks += _of_signal(problem, name, [own[name] for own in signals], times)
    if len(blocks) > 1:
        blocks += _of_the_run(into, times, longest)
    owners, alone, columns = zip(*blocks, strict=True)
    counts = [of_first.shape[1] for of_first, *_ in columns]
    found = list(map(np.hstack, zip(*columns, strict=True)))
    return found, np.repeat(owners, counts), np.repeat(alone, counts)


# Functions of a signal: which, whether they are asked of it alone, and their columns per record.
_Block = tuple[str, bool, list[np.ndarray]]


def _of_signal(
    problem: Filtered, name: str, series: list[np.ndarray], times: list[np.ndarray]
) -> Iterator[_Block]:
    """Functions of one signal; of one that never moves there are none."""
    pooled = np.concatenate(series)
    knots, finer = _knots(pooled)
    if len(knots) < 2:
        return
    scaled = [one / np.std(pooled) for one in series]
    pairs = zip(problem.records, scaled, strict=True)
    # All hats but one: they add up to the constant.
    yield name, False, [_hats(one, knots) for one in series]
    yield name, False, [_lagged(record.times, one) for record, one in pairs]
    yield name, True, [_hats(one, knots, finer) for one in series]
    if name in problem.model.input_names:  # which may fade in the run
        faded = zip(times, scaled, strict=True)
        yield IN_THE_RUN, False, [time * one[:, None] for time, one in faded]


def _of_the_run(
    into: list[np.ndarray], times: list[np.ndarray], longest: float
) -> Iterator[_Block]:
    """Functions of the time in the run; of steps each is a signal of its own.

    One jump of a force in one record is no law.
    """
    yield IN_THE_RUN, False, times
    for step in np.arange(1, PARTS) / PARTS if len(into) > 1 else ():
        yield f"{STEP}{step * longest:.3g} s", True, [own[:, None] >= step for own in into]


def _knots(pooled: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Knots at quantiles of a signal, and what a finer law has besides, but the first."""
    few, many = (np.unique(np.quantile(pooled, np.linspace(0, 1, n))) for n in (KNOTS, FINER))
    return few, np.setdiff1d(many[1:], few)


def _hats(series: np.ndarray, knots: np.ndarray, finer: np.ndarray | None = None) -> np.ndarray:
    """Piecewise linear functions, one at every knot but the first, ``(n_times, n_knots - 1)``.

    Of ``finer`` knots among these in place of them, ``(n_times, n_finer)``.
    """
    every = knots if finer is None else np.union1d(knots, finer)
    wanted = every[1:] if finer is None else finer
    hats = [np.interp(series, every, every == knot) for knot in wanted]
    return np.column_stack(hats) if hats else np.zeros((len(series), 0))


def _signals(problem: Filtered, record: Record, path: np.ndarray) -> dict[str, np.ndarray]:
    """States along the filtered path, and inputs, by name."""
    found = {}
    for state, column in zip(problem.model.states, problem.own, strict=False):
        series = path[:, column]
        # A heading that goes round is the same after a turn.
        turns = state.unit == "rad" and np.ptp(series) > np.pi
        found[state.name] = np.angle(np.exp(1j * series)) if turns else series
    return found | dict(zip(record.channels.input_names, record.inputs.T, strict=True))


def _lagged(times: np.ndarray, series: np.ndarray) -> np.ndarray:
    """A signal after lags of first order, from some samples to a tenth of the record."""
    step, length = float(np.median(np.diff(times))), float(times[-1] - times[0])
    lags = np.geomspace(3.0 * step, max(0.1 * length, 3.0 * step), LAGS)
    return np.column_stack([first_order(series, -np.expm1(-step / lag)) for lag in lags])
