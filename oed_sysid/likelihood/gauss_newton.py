"""Damped Gauss-Newton steps for multiple shooting, with an exact-penalty line search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.filtered_iterates import Differentiated, Whitened
from oed_sysid.likelihood.iterates import Exact, Gathered, Iterate
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.projection import bounded_step
from oed_sysid.likelihood.shooting import Linearisation, Point, Shooting

# Lengths of a step that are tried, and the ratio of one to the one before.
LINE_SEARCH_STEPS, SHORTER = 5, 0.4
# A trajectory whose scaled jumps sum to less is continuous.
CLOSED = 1e-8
# Rounding errors grow along an unstable trajectory. Jumps below the first number that no longer
# shrink are theirs, and then so are gains below a share of the cost, or a cost, of the others:
# estimates are within 0.04 standard errors of where they would end.
NEARLY_CLOSED, ROUNDING_SHARE, ROUNDING_COST = 1e-6, 1e-8, 1e-3
# With random forces: the step that ends the iterations at frozen gain, the rise of the cost that
# its gradient may cause near the end, most steps of the exact one, the gain below which the last
# of these was enough, and its equations serve where it led, and the promised gain below which a
# search without a way on has arrived.
FROZEN_TOLERANCE, SLACK, POLISH_STEPS, SETTLED, STALLED_NEAR = 1e-3, 0.1, 8, 0.1, 0.1
# Where the frozen gradient promises what no step keeps, few trials show it.
MOST_DAMPING, FEW_LENGTHS = 10.0, 3
# Steps at frozen gain after which one looks back, and the fall of the cost over these that is too
# small to go on for, least and in tolerances: its gradient then leads to and fro.
LOOK_BACK, LEAST_FALL, FALL_TOLERANCES = 3, 0.05, 10.0

Evaluate = Callable[[Any, Point], Any]
Trust = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Progress:
    """What a solver reports after each iteration."""

    iteration: int
    cost: float
    defect: float
    decrement: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the iterations ended.

    ``reason`` is ``"converged"``, ``"stalled"``, ``"iterations"``, ``"interrupted"``,
    ``"enough"`` or, from constrained solvers, ``"infeasible"``.
    """

    point: Point
    linearisation: Linearisation
    cost: float
    iterations: int
    reason: str


def solve(
    shooting: Shooting,
    point: Point,
    *,
    max_iterations: int = 60,
    tolerance: float = 1e-6,
    callback: Callable[[Progress], None] | None = None,
    enough: Callable[[Progress], bool] | None = None,
) -> Solution | None:
    """Minimise by damped Gauss-Newton steps with an exact-penalty line search.

    Parameters
    ----------
    shooting : Shooting
        The problem.
    point : Point
        Where to start.
    max_iterations : int
        Most Gauss-Newton iterations.
    tolerance : float
        Stop when the step would change the cost by less than this and the
        trajectory is continuous; costs are in units of half a squared standard
        deviation, so 1e-6 leaves estimates 0.001 standard errors off.
    callback : callable, optional
        Called after each iteration.
    enough : callable, optional
        Whether to stop after an iteration, before the end is reached.

    Returns
    -------
    Solution or None
        None where even the start trajectory is not finite. A keyboard
        interrupt ends the iterations and keeps the best point.
    """
    # Robust weights need residuals sample by sample.
    evaluate: Evaluate = Gathered.at if shooting.loss is None else Exact.at
    begin = evaluate(shooting, point)
    if begin is None:
        return None
    search = _Search(shooting, begin, evaluate, Exact.at)
    reason, iteration = "iterations", 0
    try:
        for iteration in range(1, max_iterations + 1):
            outcome = search.advance(tolerance)
            if outcome and search.confirm():
                outcome = search.advance(tolerance)
            if outcome:
                reason = outcome
                break
            progress = Progress(iteration, search.now.cost, search.now.defect, search.decrease)
            if callback is not None:
                callback(progress)
            if enough is not None and enough(progress):
                reason = "enough"
                break
    except KeyboardInterrupt:
        reason = "interrupted"
    search.confirm()
    now = search.now
    if not isinstance(now, Exact):
        return None
    return Solution(now.point, now.linearisation, now.cost, iteration, reason)


@dataclass(frozen=True, eq=False)
class FilteredSolution:
    """Where the iterations of a likelihood with random forces ended.

    ``matrix`` is the information of all unknowns there, ``right`` half the negative
    gradient, priors excluded.
    """

    problem: Filtered
    point: Point
    cost: float
    matrix: np.ndarray
    right: np.ndarray
    iterations: int
    reason: str

    @property
    def objective(self) -> float:
        """Minus twice the log-likelihood, priors included, up to a constant."""
        return 2.0 * self.cost

    @property
    def promise(self) -> float:
        """Fall of the cost that the last equations promise."""
        limits, unknowns = self.problem.limits, self.point.unknowns
        right = self.right + limits.prior_weight * (limits.prior_mean - unknowns)
        matrix = self.matrix + np.diag(limits.prior_weight)
        step = bounded_step(matrix, right, limits.lower - unknowns, limits.upper - unknowns, 0.0)
        return float(right @ step - 0.5 * step @ matrix @ step)

    @property
    def noise(self) -> NoiseModel:
        """Noise model at the end."""
        return self.problem.noise(self.point.unknowns)

    @property
    def values(self) -> dict[str, float]:
        """Value of every parameter of the model; those of each record at their mean."""
        layout, model = self.problem.layout, self.problem.model
        free = [layout.parameters(self.point.unknowns, i) for i in range(layout.n_records)]
        # The mean of equal numbers may miss them, and then a bound, by rounding.
        means = np.clip(np.mean(free, axis=0), np.min(free, axis=0), np.max(free, axis=0))
        return model.values | dict(zip(layout.free_names, map(float, means), strict=True))

    @property
    def initial(self) -> list[np.ndarray]:
        """Start states of every record."""
        count = self.problem.layout.n_records
        return [self.problem.initial_state(self.point.unknowns, i).copy() for i in range(count)]

    @property
    def local(self) -> list[dict[str, float]]:
        """Values of per-record parameters, by record."""
        layout = self.problem.layout
        found = []
        for index in range(layout.n_records):
            own = layout.parameters(self.point.unknowns, index)
            found.append({layout.free_names[i]: float(own[i]) for i in layout.local})
        return found


def solve_filtered(
    problem: Filtered,
    point: Point,
    *,
    max_iterations: int = 40,
    tolerance: float = FROZEN_TOLERANCE,
    polish: int = POLISH_STEPS,
    callback: Callable[[Progress], None] | None = None,
) -> FilteredSolution | None:
    """Minimise the likelihood of innovations: frozen gain first, then the filter as it is.

    Parameters
    ----------
    problem : Filtered
    point : Point
        Where to start.
    max_iterations : int
        Most iterations at frozen gain.
    tolerance : float
        Stop when a step would change the cost by less.
    polish : int
        Most steps with the gradient of the filter as it is; with none, errors are
        those of the frozen gain.
    callback : callable, optional
        Called after each iteration.

    Returns
    -------
    FilteredSolution or None
        None where the filter leaves the numbers at the start.
    """
    begin = Whitened.at(problem, point)
    if begin is None:
        return None
    search = _Search(problem, begin, Whitened.at, Differentiated.at if polish else Whitened.at)
    search.slack, search.most_damping, search.lengths = SLACK, MOST_DAMPING, FEW_LENGTHS
    search.trust, search.cheap = problem.trusted, Differentiated.at
    reason, iteration = "iterations", 0
    best: Iterate = begin
    costs = [begin.cost]
    fall = max(LEAST_FALL, FALL_TOLERANCES * tolerance)
    try:
        for iteration in range(1, max_iterations + 1):
            outcome = search.advance(tolerance)
            if outcome:
                reason = outcome
                break
            best = min(best, search.now, key=lambda point: point.cost)
            costs.append(best.cost)
            if callback is not None:
                callback(Progress(iteration, search.now.cost, 0.0, search.decrease))
            if costs[-1 - LOOK_BACK :][0] - best.cost < fall and iteration >= LOOK_BACK:
                reason = "converged"
                break
        search.now = best
        if polish and search.confirm():
            search.slack = 0.0
            for _ in range(polish):
                iteration += 1
                before = search.now
                if search.advance(tolerance):
                    break
                if search.decrease < SETTLED:
                    search.settled = _shifted(before, search.now.point)
                    break
            # The exact gradient has the last word, whatever the frozen one ended with.
            if reason == "iterations" and search.decrease < STALLED_NEAR:
                reason = "converged"
    except KeyboardInterrupt:
        reason = "interrupted"
    # The frozen gain is not the exact gradient: where it finds no way on, the end is near.
    if reason == "stalled" and search.decrease < STALLED_NEAR:
        reason = "converged"
    now = search.now
    matrix, right = search.settled or now.equations()
    return FilteredSolution(problem, now.point, now.cost, matrix, right, iteration, reason)


def _shifted(before: Iterate, point: Point) -> tuple[np.ndarray, np.ndarray]:
    """Equations of an iterate as they hold at a point close by, for the cost of a product."""
    matrix, right = before.equations()
    return matrix, right - matrix @ (point.unknowns - before.point.unknowns)


class _Search:
    """State of the iterations: where they are, how they evaluate, damping and penalty."""

    def __init__(self, shooting: Any, begin: Iterate, evaluate: Evaluate, exact: Evaluate) -> None:
        self.shooting, self.now, self.evaluate, self.exact = shooting, begin, evaluate, exact
        self.slack, self.most_damping, self.lengths = 0.0, 1e8, LINE_SEARCH_STEPS
        self.damping, self.penalty, self.decrease = 0.0, 1.0, np.inf
        self.at_floor, self.length = False, 1.0
        self.trust: Trust | None = None
        self.cheap: Evaluate | None = None
        self.settled: tuple[np.ndarray, np.ndarray] | None = None

    def confirm(self) -> bool:
        """Go on with exact sensitivities at the same point; return whether that is news."""
        if self.evaluate is self.exact:
            return False
        exact = self.exact(self.shooting, self.now.point)
        if exact is None:
            return False
        self.now, self.evaluate, self.damping = exact, self.exact, 0.0
        return True

    def advance(self, tolerance: float) -> str:
        """Take one step; return why there is none, or an empty string."""
        now, limits = self.now, self.shooting.limits
        unknowns = now.point.unknowns
        matrix, right = now.equations()
        right = right + limits.prior_weight * (limits.prior_mean - unknowns)
        matrix = matrix + np.diag(limits.prior_weight)
        lower, upper = limits.lower - unknowns, limits.upper - unknowns
        if self.trust is not None:
            lower, upper = self.trust(unknowns, matrix, lower, upper)
        closed = now.defect < CLOSED or self.at_floor
        if self.at_floor:
            tolerance = max(tolerance, min(ROUNDING_SHARE * abs(now.cost), ROUNDING_COST))
        while self.damping < self.most_damping:
            step = bounded_step(matrix, right, lower, upper, self.damping)
            self.decrease = now.cost - now.predicted(step)
            if abs(self.decrease) < tolerance and closed:
                if self.damping == 0.0:
                    return "converged"
                # A damped step is short everywhere; only a full one proves the end.
                full = bounded_step(matrix, right, lower, upper, 0.0)
                if abs(now.cost - now.predicted(full)) < tolerance:
                    return "converged"
            if now.defect > 0 and self.decrease < 0.5 * self.penalty * now.defect:
                self.penalty = max(self.penalty, -2.0 * self.decrease / now.defect)
            if self._line_search(step):
                self.damping = self.damping / 10.0 if self.damping > 1e-7 else 0.0
                return ""
            self.damping = max(10.0 * self.damping, 1e-4)
        return "stalled"

    def _line_search(self, step: np.ndarray) -> bool:
        now = self.now
        expected = self.decrease + self.penalty * now.defect
        # Where only short steps were good, the next begins a little longer than the last.
        length = min(1.0, self.length / SHORTER)
        evaluate = self.evaluate
        for _ in range(self.lengths):
            trial = self.shooting.move(now.point, now.maps, now.offsets, step, length)
            new = evaluate(self.shooting, trial)
            if new is not None:
                merit = now.cost - new.cost + self.penalty * (now.defect - new.defect)
                # Near the optimum the gain drowns in rounding: any step that does no harm will do.
                tiny = expected < 1e-6 * abs(now.cost) and merit >= -1e-10 * abs(now.cost)
                if expected < 1.0:
                    tiny = tiny or merit > -self.slack
                good = merit > 1e-4 * length * expected or tiny
                if good and evaluate is not self.evaluate:
                    new = self.evaluate(self.shooting, trial)
                if good and new is not None:
                    self.at_floor = 0.1 * now.defect < new.defect < NEARLY_CLOSED
                    self.now, self.length = new, length
                    return True
            length *= SHORTER
            evaluate = self.cheap or evaluate
        self.length = 1.0
        return False
