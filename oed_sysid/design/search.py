"""From rough manoeuvres to an optimum: linear programs within moving bounds.

The best commands lie mostly on limits of the actuators or of the vehicle, in
the corners that a linear program finds at once. Each step therefore maximises
the linearised criterion subject to the linearised limits of every sample,
within bounds around the present commands that shrink where the steps swing
back and grow where they go on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import linprog

from oed_sysid.batch.journal import Journal
from oed_sysid.design.objective import Objective, Score, Slope

# Inner distance kept from the limits while searching, as a share of their width.
_MARGIN = 5e-4
# Loss of criterion that weighs as much as an excess of the whole width of a limit.
_PRICE = 300.0
_FIRST_RADIUS, _LARGEST_RADIUS, _SMALLEST_RADIUS = 0.2, 0.5, 2e-3
# The search ends when five steps together gain less than this.
_WORTH_MORE = 0.01
_N_FINISHES, _INWARD = 3, 0.85


@dataclass(frozen=True)
class Progress:
    """What a design search reports."""

    start: int
    round: int
    value: float
    excess: float


@dataclass(frozen=True, eq=False)
class Found:
    """Best member that keeps all limits, and how the search went.

    Attributes
    ----------
    best : Score or None
        None where nothing keeps the limits.
    nearest : Score
        Smallest excess met, for words about what cannot be kept.
    values : tuple of float
        Criterion reached from each start.
    others : tuple of Score
        What was reached from each start and keeps the limits, the best included.
    """

    best: Score | None
    nearest: Score
    values: tuple[float, ...]
    others: tuple[Score, ...] = ()


def refine(
    objective: Objective,
    start: Score,
    *,
    n_steps: int = 40,
    report: Callable[[int, Score], None] | None = None,
    journal: Journal | None = None,
) -> tuple[Score | None, Score]:
    """Maximise from one start by sequential linear programming.

    Parameters
    ----------
    objective : Objective
        Criterion and limits.
    start : Score
        Where to begin; it may break limits.
    n_steps : int
        Largest number of linearisations.
    report : callable, optional
        Called with step and score.
    journal : Journal, optional
        Keeps where the search stands while it is a step of a longer one.

    Returns
    -------
    best : Score or None
        Best member met that keeps all limits.
    nearest : Score
        The member with the smallest excess.

    References
    ----------
    R. Fletcher, E. Sainz de la Maza, Nonlinear programming and nonsmooth
    optimization by successive linear programming, *Mathematical Programming*
    43 (1989) 235-256: exact penalty and trust region.
    K. Svanberg, The method of moving asymptotes, *Int. J. Numerical Methods in
    Engineering* 24 (1987) 359-373: bounds that follow the sign of the steps.
    """
    current = start
    best = start if start.feasible else None
    nearest = start
    radius = np.full(len(start.numbers), _FIRST_RADIUS)
    last_step = np.zeros(len(start.numbers))
    merits = [_merit(start)]
    begin = 0
    if journal is not None and (kept := journal.state()) is not None:
        begin, current, best, nearest, radius, last_step, merits, objective.n_evaluations = kept
    for index in range(begin, n_steps):
        slope = objective.linearise(current)
        for _ in range(6):
            step, predicted = _program(objective, current, slope, radius)
            trial = objective.score(np.clip(current.numbers + step, 0.0, 1.0))
            gained = _merit(trial) - _merit(current)
            if gained < 0.5 * predicted and trial.views and trial.excess > -_MARGIN:
                # Limits bend: once more, with their values at the end of the step.
                bent, _ = _program(objective, current, slope, radius, after=(trial, step))
                second = objective.score(np.clip(current.numbers + bent, 0.0, 1.0))
                if _merit(second) > _merit(trial):
                    trial, step = second, bent
                    gained = _merit(trial) - _merit(current)
            if trial.feasible and (best is None or trial.value > best.value):
                best = trial
            if trial.excess < nearest.excess:
                nearest = trial
            if gained > 0.05 * predicted and gained > 0:
                break
            radius *= 0.4
        else:
            break
        turned = step * last_step
        radius = np.where(turned < 0, 0.6 * radius, np.where(turned > 0, 1.3 * radius, radius))
        if gained < 0.3 * predicted:
            radius *= 0.6
        elif gained > 0.8 * predicted:
            radius *= 1.4
        radius = np.clip(radius, _SMALLEST_RADIUS, _LARGEST_RADIUS)
        current, last_step = trial, step
        merits.append(_merit(current))
        if report is not None:
            report(index, current)
        if len(merits) > 6 and merits[-1] - merits[-6] < _WORTH_MORE:
            break
        if journal is not None:
            standing = (index + 1, current, best, nearest, radius, last_step, merits)
            journal.keep((*standing, objective.n_evaluations))
    return best, nearest if best is None else best


def _merit(score: Score) -> float:
    """Criterion less the price of what is outside the limits."""
    if not np.isfinite(score.value):
        return -np.inf
    return score.value - _PRICE * max(score.excess + _MARGIN, 0.0)


def _program(
    objective: Objective,
    score: Score,
    slope: Slope,
    radius: np.ndarray,
    after: tuple[Score, np.ndarray] | None = None,
) -> tuple[np.ndarray, float]:
    """Best step of the linearised problem, and the merit that it promises.

    ``after`` holds a trial and its step: the limits are then linearised
    through the values found there (second-order correction).
    """
    lower = np.maximum(-radius, -score.numbers)
    upper = np.minimum(radius, 1.0 - score.numbers)
    rows: list[np.ndarray] = []
    rights: list[np.ndarray] = []

    def limit(excess: np.ndarray, by_numbers: np.ndarray, *, thin: bool = False) -> None:
        reach = np.abs(by_numbers) @ radius
        for side, sign in enumerate((-1.0, 1.0)):
            beyond = excess[:, :, side] + _MARGIN
            if after is not None:
                beyond = beyond - sign * (by_numbers @ after[1])
            # Other samples cannot reach their limit within this step.
            near = beyond + reach > 0
            if thin:
                near &= _telling(beyond)
            rows.append(sign * by_numbers[near])
            rights.append(-beyond[near])

    basis = score if after is None else after[0]
    for i, view in enumerate(basis.views):
        excess = objective.corridor.excess(view.signals, n_times=len(view.signals))
        limit(excess, slope.signals[i] / objective.corridor.width[:, None])
    for i, by_numbers in slope.guards.items():
        if objective.guards is not None and np.isfinite(basis.guards[i].excess):
            corridor, signals = objective.guards.corridor, basis.guards[i].signals
            excess = corridor.excess(signals, n_times=len(signals))
            limit(excess, by_numbers / corridor.width[:, None], thin=True)
    matrix, right = np.vstack(rows), np.concatenate(rights)
    present = max(0.0, float(-right.min(initial=0.0)))
    if not len(right):
        step = np.where(slope.criterion > 0, upper, lower)
        return step, float(slope.criterion @ step)
    # One elastic variable, the largest excess, keeps the program solvable.
    elastic = -np.ones((len(right), 1))
    solved = linprog(
        np.append(-slope.criterion, _PRICE),
        A_ub=np.hstack([matrix, elastic]),
        b_ub=right,
        bounds=[*zip(lower, upper, strict=True), (0.0, None)],
        method="highs",
    )
    if solved.x is None:
        return np.zeros_like(radius), 0.0
    step = solved.x[:-1]
    return step, float(slope.criterion @ step + _PRICE * (present - solved.x[-1]))


def _telling(excess: np.ndarray) -> np.ndarray:
    """Peaks of each column, and every fourth sample: enough where there are many vehicles."""
    padded = np.pad(excess, ((1, 1), (0, 0)), constant_values=-np.inf)
    telling = (excess >= padded[:-2]) & (excess >= padded[2:])
    telling[::4] = True
    return telling


def search(
    objective: Objective,
    begin: list[Score],
    *,
    n_steps: int = 40,
    progress: Callable[[Progress], None] | None = None,
    journal: Journal | None = None,
) -> Found:
    """Refine several starts roughly, the best one further.

    Parameters
    ----------
    objective : Objective
        Criterion and limits.
    begin : list of Score
        Starts; at least one.
    n_steps : int
        Linearisations for each start; up to twice as many for each finish of
        the best.
    progress : callable, optional
        Called with a :class:`Progress` after each step.
    journal : Journal, optional
        Keeps every refined start.
    """
    keep = journal or Journal()
    nearest = min(begin, key=lambda score: score.excess)
    rough: list[Score] = []

    def tell(number: int, index: int, score: Score) -> None:
        if progress is not None:
            progress(Progress(number, index, score.value, score.excess))

    def refined(number: int, start: Score, n_steps: int) -> tuple[Score | None, Score]:
        def work() -> tuple[Score | None, Score, int]:
            report = partial(tell, number)
            best, close = refine(objective, start, n_steps=n_steps, report=report, journal=keep)
            return best, close, objective.n_evaluations

        best, close, objective.n_evaluations = keep.once(f"start {number + 1}", work)
        return best, close

    values = []
    for number, start in enumerate(begin):
        found, close = refined(number, start, n_steps)
        values.append(float("-inf") if found is None else found.value)
        if found is not None:
            rough.append(found)
        nearest = min(nearest, close, key=lambda score: score.excess)
    if not rough:
        return Found(None, nearest, tuple(values))
    best = max(rough, key=lambda score: score.value)
    for index in range(_N_FINISHES):
        # From slightly smaller commands other corners come within reach.
        inner = best if index == 0 else objective.score(0.5 + _INWARD * (best.numbers - 0.5))
        if not inner.views:
            continue
        found, _ = refined(len(begin) + index, inner, 2 * n_steps)
        if found is not None and found.value > best.value:
            best = found
    return Found(best, nearest, tuple(values), (*rough, best))
