"""Damped Gauss-Newton steps for multiple shooting, with an exact-penalty line search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oed_sysid.fitting.iterates import Evaluate, Exact, Gathered, Iterate
from oed_sysid.fitting.shooting import Linearisation, Point, Shooting
from oed_sysid.projection import bounded_step

LINE_SEARCH_STEPS = 5
# A trajectory whose scaled jumps sum to less is continuous.
CLOSED = 1e-8
# Rounding errors grow along an unstable trajectory. Jumps below the first number that no longer
# shrink are theirs, and then so are gains below a share of the cost, or a cost, of the others:
# estimates are within 0.04 standard errors of where they would end.
NEARLY_CLOSED, ROUNDING_SHARE, ROUNDING_COST = 1e-6, 1e-8, 1e-3


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

    ``reason`` is ``"converged"``, ``"stalled"``, ``"iterations"``,
    ``"interrupted"`` or, from constrained solvers, ``"infeasible"``.
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
    search = _Search(shooting, begin, evaluate)
    reason, iteration = "iterations", 0
    try:
        for iteration in range(1, max_iterations + 1):
            outcome = search.advance(tolerance)
            if outcome and search.confirm():
                outcome = search.advance(tolerance)
            if outcome:
                reason = outcome
                break
            if callback is not None:
                callback(Progress(iteration, search.now.cost, search.now.defect, search.decrease))
    except KeyboardInterrupt:
        reason = "interrupted"
    search.confirm()
    now = search.now
    if not isinstance(now, Exact):
        return None
    return Solution(now.point, now.linearisation, now.cost, iteration, reason)


class _Search:
    """State of the iterations: where they are, how they evaluate, damping and penalty."""

    def __init__(self, shooting: Shooting, begin: Iterate, evaluate: Evaluate) -> None:
        self.shooting, self.now, self.evaluate = shooting, begin, evaluate
        self.damping, self.penalty, self.decrease = 0.0, 1.0, np.inf
        self.at_floor = False

    def confirm(self) -> bool:
        """Go on with exact sensitivities at the same point; return whether that is news."""
        if isinstance(self.now, Exact):
            return False
        exact = Exact.at(self.shooting, self.now.point)
        if exact is None:
            return False
        self.now, self.evaluate, self.damping = exact, Exact.at, 0.0
        return True

    def advance(self, tolerance: float) -> str:
        """Take one step; return why there is none, or an empty string."""
        now, limits = self.now, self.shooting.limits
        unknowns = now.point.unknowns
        matrix, right = now.equations()
        right = right + limits.prior_weight * (limits.prior_mean - unknowns)
        matrix = matrix + np.diag(limits.prior_weight)
        lower, upper = limits.lower - unknowns, limits.upper - unknowns
        closed = now.defect < CLOSED or self.at_floor
        if self.at_floor:
            tolerance = max(tolerance, min(ROUNDING_SHARE * abs(now.cost), ROUNDING_COST))
        while self.damping < 1e8:
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
        length = 1.0
        for _ in range(LINE_SEARCH_STEPS):
            trial = self.shooting.move(now.point, now.maps, now.offsets, step, length)
            new = self.evaluate(self.shooting, trial)
            if new is not None:
                merit = now.cost - new.cost + self.penalty * (now.defect - new.defect)
                # Near the optimum the gain drowns in rounding: any step that does no harm will do.
                tiny = expected < 1e-6 * abs(now.cost) and merit >= -1e-10 * abs(now.cost)
                if merit > 1e-4 * length * expected or tiny:
                    self.at_floor = 0.1 * now.defect < new.defect < NEARLY_CLOSED
                    self.now = new
                    return True
            length *= 0.4
        return False
