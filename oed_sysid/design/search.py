r"""From rough manoeuvres to an optimum: linear programs within moving bounds.

The pace of each rough manoeuvre (samples between changes) is drawn from a log-uniform
distribution,

.. math:: \log p \sim U\left(\log 2, \log \tfrac{n}{4}\right)

for ``n`` samples, so that slow and quick ones are as frequent; then the wave :math:`g_k \in [-1,
1]` of one of five kinds becomes :math:`\delta_k = \delta_0 + s\, g_k\, (\delta_{max} -
\delta_0)`, with the largest share ``s`` of a falling sequence at which all limits hold.

The best commands lie mostly on limits of the actuators or of the vehicle, in the corners that a
linear program finds at once. Each step :math:`d` therefore maximises the linearised criterion
subject to the linearised limits of every sample, with one elastic variable,

.. math::
    \max_{d, e}\ \nabla\varphi' d - \pi e \quad\text{subject to}\quad
    h_k + \nabla h_k' d \le e, \quad |d_i| \le \rho_i, \quad e \ge 0

within bounds :math:`\rho` around the present commands that shrink where the steps swing back and
grow where they go on. A step counts where the merit :math:`\varphi - \pi \max(h, 0)` rises by a
part of what was predicted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from oed_sysid.design.objective import Objective, Score, Slope
from oed_sysid.design.trial import Search
from oed_sysid.design.waveforms import SIZES, Grid
from oed_sysid.runtime.constants import NEGLIGIBLE, THREE_DIGITS
from oed_sysid.runtime.journal import Journal


def rough_commands(grid: Grid, rng: np.random.Generator) -> np.ndarray:
    """Return one random manoeuvre ``(n_times, n_inputs)`` between -1 and 1.

    Random telegraph, square wave, random levels, multisine or 3-2-1-1 blocks,
    each at a random pace between two samples and a quarter of the duration.
    """
    n_times = len(grid.times)
    index, columns = np.arange(n_times), []
    for _ in grid.inputs:
        pace = float(np.exp(rng.uniform(np.log(2.0), np.log(max(n_times / 4, 3.0)))))
        kind = rng.integers(5)
        if kind == 0:
            switches = rng.random(n_times) < 1.0 / pace
            column = np.where(np.cumsum(switches) % 2, 1.0, -1.0)
        elif kind == 1:
            column = np.sign(np.sin(np.pi * (index / pace + rng.random())) + 1e-12)
        elif kind == 2:
            column = rng.uniform(-1, 1, n_times)[(index // max(int(pace), 1))]
        elif kind == 3:
            lines = np.exp(rng.uniform(np.log(0.2), np.log(2.0), 6)) * np.pi / pace
            column = np.cos(np.outer(index, lines) + rng.uniform(0, 2 * np.pi, 6)).sum(axis=1)
            column /= np.abs(column).max()
        else:
            unit = max(int(pace / 2), 1)
            block = np.repeat([1.0, -1.0, 1.0, -1.0], np.array([3, 2, 1, 1]) * unit)
            pause = np.zeros(int(rng.uniform(0, 4) * unit))
            column = np.resize(np.concatenate([block, pause, -block, pause]), n_times)
        columns.append(column * rng.choice([-1.0, 1.0]))
    return np.column_stack(columns)


def starts(
    objective: Objective, search: Search, rng: np.random.Generator, given: Sequence[np.ndarray]
) -> list[Score]:
    """Evaluate rough manoeuvres and return the best, different ones.

    Parameters
    ----------
    objective : Objective
        Criterion and limits.
    search : Search
        How many manoeuvres are tried, and kept.
    rng : numpy.random.Generator
    given : sequence of ndarray (n_times, n_inputs)
        Manoeuvres of the designed inputs that are tried first, at full size.
    """
    members = [one for one in map(objective.shape.start, given) if one is not None]
    members += [_rough(objective, rng) for _ in range(search.n_candidates)]
    tried = (_largest(objective, one, with_scenarios=False) for one in members)
    found = [score for scores in tried for score in scores]
    found.sort(key=lambda score: (not score.feasible, -score.value))
    kept = _different(found)[: search.n_starts]
    # Many vehicles take time: only what is kept is shrunk until they keep the limits too.
    return again(objective, kept) if objective.scenarios is not None else kept


def _different(scores: Sequence[Score]) -> list[Score]:
    """Members in their order, without those that hardly differ from one before."""
    kept: list[Score] = []
    for score in scores:
        apart = [np.sqrt(np.mean((score.numbers - other.numbers) ** 2)) for other in kept]
        if np.isfinite(score.value) and min(apart, default=1.0) > 0.05:
            kept.append(score)
    return kept


def _rough(objective: Objective, rng: np.random.Generator) -> np.ndarray:
    """Numbers nearest to a rough manoeuvre; in a family that is too narrow, any."""
    shape, grid = objective.shape, objective.task.grid
    unit = rough_commands(grid, rng)
    room = np.where(unit > 0, grid.upper - grid.trim, grid.trim - grid.lower)
    numbers = shape.start(grid.limited((grid.trim + room * unit)[None])[0])
    return rng.random(shape.size) if numbers is None else numbers


def again(objective: Objective, before: Sequence[Score]) -> list[Score]:
    """Return members of the same family, shrunk until they keep the limits of this objective."""
    if objective.scenarios is not None and before:
        objective.scenarios.waive(objective.score(before[0].numbers).scenarios)
    found = (_largest(objective, one.numbers, with_scenarios=True) for one in before)
    return [score for scores in found for score in scores]


def _largest(objective: Objective, numbers: np.ndarray, *, with_scenarios: bool) -> list[Score]:
    """Shrink a manoeuvre towards the trim command until all limits are kept."""
    grid = objective.task.grid
    # Towards the trim command, at which nothing moves and most limits are kept.
    still = objective.shape.start(np.tile(grid.trim, (len(grid.times), 1)))
    if still is None:
        score = objective.score(numbers, with_scenarios=with_scenarios)
        return [score] if np.isfinite(score.value) else []
    last: list[Score] = []
    for share in SIZES:
        score = objective.score(still + share * (numbers - still), with_scenarios=with_scenarios)
        if score.feasible:
            return [score]
        if np.isfinite(score.value):
            last = [score]
    return last


# Inner distance kept from the limits while searching, as a share of their width.
_MARGIN = 5e-4
# Loss of criterion that weighs as much as an excess of the whole width of a limit.
_PRICE = 300.0
# Of the first step, in shares of the range of the numbers searched: larger ones only cost retries.
_FIRST_RADIUS = 0.2


@dataclass(frozen=True)
class Progress:
    """What a design search reports.

    Examples
    --------
    >>> Progress(start=0, round=3, value=12.5, excess=0.0).value
    12.5
    """

    start: int
    round: int
    value: float
    excess: float


class _Progressed:
    """Where a refinement stands: the present member, the best, and the bounds of its steps."""

    def __init__(self, start: Score) -> None:
        self.current, self.best, self.nearest = start, start if start.feasible else None, start
        self.radius = np.full(len(start.numbers), _FIRST_RADIUS)
        self.last_step = np.zeros(len(start.numbers))
        self.merits = [_merit(start)]

    def step(self, objective: Objective) -> bool:
        """Take one step that raises the merit; False where none is found."""
        slope = objective.linearise(self.current)
        for _ in range(6):
            trial, step, predicted = self._tried(objective, slope)
            gained = _merit(trial) - _merit(self.current)
            if trial.feasible and (self.best is None or trial.value > self.best.value):
                self.best = trial
            if trial.excess < self.nearest.excess:
                self.nearest = trial
            if gained > 0.05 * predicted and gained > 0:
                # Bounds widen or narrow; where the linear program promises too much they are too
                # wide.
                turned = step * self.last_step
                factor = np.where(turned < 0, 0.6, np.where(turned > 0, 1.3, 1.0))
                shrunk, grown = gained < 0.3 * predicted, gained > 0.8 * predicted
                factor = factor * (0.6 if shrunk else 1.4 if grown else 1)
                self.radius = np.maximum(factor * self.radius, THREE_DIGITS)
                self.current, self.last_step = trial, step
                self.merits.append(_merit(trial))
                return True
            # The linear program promised what the vehicle does not do: a smaller region.
            self.radius = 0.4 * self.radius
        return False

    def _tried(self, objective: Objective, slope: Slope) -> tuple[Score, np.ndarray, float]:
        """Member at the end of the best linear step, the step, and the merit it promised."""
        current = self.current
        step, predicted = self._program(objective, slope)
        trial = objective.score(np.clip(current.numbers + step, 0.0, 1.0))
        poor = _merit(trial) - _merit(current) < 0.5 * predicted
        if poor and trial.evaluations and trial.excess > -_MARGIN:
            # Limits bend: once more, with their values at the end of the step.
            bent, _ = self._program(objective, slope, after=(trial, step))
            second = objective.score(np.clip(current.numbers + bent, 0.0, 1.0))
            if _merit(second) > _merit(trial):
                return second, bent, predicted
        return trial, step, predicted

    def _program(
        self, objective: Objective, slope: Slope, after: tuple[Score, np.ndarray] | None = None
    ) -> tuple[np.ndarray, float]:
        """Best step of the linearised problem, and the merit that it promises.

        ``after`` holds a trial and its step: the limits are then linearised
        through the values found there (second-order correction).
        """
        score, radius = self.current, self.radius
        lower = np.maximum(-radius, -score.numbers)
        upper = np.minimum(radius, 1.0 - score.numbers)
        rows: list[np.ndarray] = []
        rights: list[np.ndarray] = []

        def limit(excess: np.ndarray, by_numbers: np.ndarray, *, thin: bool = False) -> None:
            # The most that a step within the region can change a signal, to first order.
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
        for i, evaluation in enumerate(basis.evaluations):
            excess = objective.bounds.excess(objective.bounds.limited(evaluation.signals))
            limit(excess, slope.signals[i] / objective.bounds.width[:, None])
        for i, by_numbers in slope.scenarios.items():
            if objective.scenarios is not None and np.isfinite(basis.scenarios[i].excess):
                bounds = objective.scenarios.bounds
                excess = bounds.excess(basis.scenarios[i].signals)
                limit(excess, by_numbers / bounds.width[:, None], thin=True)
        matrix, right = np.vstack(rows), np.concatenate(rights)
        present = max(0.0, float(-right.min(initial=0.0)))
        if not len(right):
            # Without limits the best vertex is that of the signs of the gradient.
            step = np.where(slope.criterion > 0, upper, lower)
            return step, float(slope.criterion @ step)
        # One elastic variable, the largest excess, keeps the program solvable.
        solved = linprog(
            np.append(-slope.criterion, _PRICE),
            A_ub=np.hstack([matrix, -np.ones((len(right), 1))]),
            b_ub=right,
            bounds=[*zip(lower, upper, strict=True), (0.0, None)],
            method="highs",
        )
        if solved.x is None:
            return np.zeros_like(radius), 0.0
        step = solved.x[:-1]
        return step, float(slope.criterion @ step + _PRICE * (present - solved.x[-1]))


def _merit(score: Score) -> float:
    """Criterion less the price of what is outside the limits."""
    if not np.isfinite(score.value):
        return -np.inf
    return score.value - _PRICE * max(score.excess + _MARGIN, 0.0)


def _telling(excess: np.ndarray) -> np.ndarray:
    """Peaks of each column, and every fourth sample: enough where there are many vehicles."""
    padded = np.pad(excess, ((1, 1), (0, 0)), constant_values=-np.inf)
    telling = (excess >= padded[:-2]) & (excess >= padded[2:])
    telling[::4] = True
    return telling


def refine_all(
    objective: Objective,
    begin: list[Score],
    *,
    n_steps: int,
    progress: Callable[[Progress], None] | None,
    keep: Journal,
) -> tuple[tuple[Score, ...], Score, tuple[float, ...]]:
    """Refine several starts roughly, the best one further, by sequential linear programming.

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
    keep : Journal
        Keeps every refined start, and where the search stands within one.

    Returns
    -------
    reached : tuple of Score
        What was reached from each start and keeps the limits, the best last; empty where nothing
        does.
    nearest : Score
        Smallest excess met, for words about what cannot be kept.
    values : tuple of float
        Criterion reached from each start.

    References
    ----------
    R. Fletcher, E. Sainz de la Maza, Nonlinear programming and nonsmooth
    optimization by successive linear programming, *Mathematical Programming*
    43 (1989) 235-256: exact penalty and trust region.
    K. Svanberg, The method of moving asymptotes, *Int. J. Numerical Methods in
    Engineering* 24 (1987) 359-373: bounds that follow the sign of the steps.
    """

    def refined(number: int, start: Score, n_steps: int) -> tuple[Score | None, Score]:
        """Best member met that keeps all limits, and the one with the smallest excess."""

        def work() -> tuple[Score | None, Score, int]:
            begin, state, objective.n_evaluations = keep.state() or (
                0, _Progressed(start), objective.n_evaluations
            )  # fmt: skip
            for index in range(begin, n_steps):
                if not state.step(objective):
                    break
                if progress is not None:
                    score = state.current
                    progress(Progress(number, index, score.value, score.excess))
                # Enough where the last five steps together gained too little.
                if len(state.merits) > 6 and state.merits[-1] - state.merits[-6] < NEGLIGIBLE:
                    break
                keep.keep((index + 1, state, objective.n_evaluations))
            return state.best, state.best or state.nearest, objective.n_evaluations

        best, close, objective.n_evaluations = keep.once(f"start {number + 1}", work)
        return best, close

    ends = [refined(number, start, n_steps) for number, start in enumerate(begin)]
    reached, closest = zip(*ends, strict=True)
    rough = [*filter(None, reached)]
    values = tuple(-np.inf if found is None else found.value for found in reached)
    nearest = min((*begin, *closest), key=lambda score: score.excess)
    if not rough:
        return (), nearest, values
    best = max(rough, key=lambda score: score.value)
    for number in range(len(begin), len(begin) + 3):
        # From slightly smaller commands other corners come within reach.
        first, inner = number == len(begin), 0.5 + SIZES[1] * (best.numbers - 0.5)
        start = best if first else objective.score(inner)
        found = refined(number, start, 2 * n_steps)[0] if start.evaluations else None
        best = max(filter(None, (best, found)), key=lambda score: score.value)
    return (*rough, best), nearest, values
