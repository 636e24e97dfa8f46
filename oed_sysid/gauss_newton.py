"""Damped Gauss-Newton steps for multiple shooting, with an exact-penalty line search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import lsq_linear

from oed_sysid.shooting import Linearisation, Point, Shooting


@dataclass(frozen=True)
class Progress:
    """What a solver reports after each iteration."""

    iteration: int
    cost: float
    defect: float
    decrement: float


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the Gauss-Newton iterations ended.

    ``reason`` is ``"converged"``, ``"stalled"``, ``"iterations"`` or ``"diverged"``.
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
        None where even the start trajectory is not finite.
    """
    lin = shooting.linearise(point)
    if lin is None:
        return None
    cost, defect = shooting.cost(lin, point.unknowns), shooting.defect(lin)
    damping, penalty, reason = 0.0, 1.0, "iterations"
    iteration = 0
    for iteration in range(1, max_iterations + 1):
        matrix, right = shooting.normal_equations(lin)
        right = right + shooting.prior_weight * (shooting.prior_mean - point.unknowns)
        matrix = matrix + np.diag(shooting.prior_weight)
        accepted = None
        while accepted is None and damping < 1e8:
            step = bounded_step(
                matrix,
                right,
                shooting.lower - point.unknowns,
                shooting.upper - point.unknowns,
                damping,
            )
            decrease = cost - shooting.predicted_cost(lin, point.unknowns, step)
            if defect > 0 and decrease < 0.5 * penalty * defect:
                penalty = max(penalty, -2.0 * decrease / defect)
            expected = decrease + penalty * defect
            if abs(decrease) < tolerance and defect < 1e-8:
                reason = "converged"
                break
            length = 1.0
            for _ in range(5):
                trial = shooting.move(point, lin, step, length)
                new = shooting.linearise(trial)
                if new is not None:
                    new_cost, new_defect = (
                        shooting.cost(new, trial.unknowns),
                        shooting.defect(new),
                    )
                    merit = cost - new_cost + penalty * (defect - new_defect)
                    if merit > 1e-4 * length * expected or (
                        merit >= -1e-10 * abs(cost) and expected < 1e-6 * abs(cost)
                    ):
                        accepted = (trial, new, new_cost, new_defect)
                        break
                length *= 0.4
            if accepted is None:
                damping = max(10.0 * damping, 1e-4)
        if accepted is None:
            reason = reason if reason == "converged" else "stalled"
            break
        point, lin, cost, defect = accepted
        damping = damping / 10.0 if damping > 1e-7 else 0.0
        if callback is not None:
            callback(Progress(iteration, cost, defect, decrease))
    return Solution(point, lin, cost, iteration, reason)


def bounded_step(
    matrix: np.ndarray, right: np.ndarray, lower: np.ndarray, upper: np.ndarray, damping: float
) -> np.ndarray:
    """Minimise ``x' matrix x / 2 - right' x`` within bounds.

    Unknowns that the data do not see (a zero on the diagonal) stay where they
    are; others that they see only in combination take the smallest step.
    """
    diagonal = np.diag(matrix)
    seen = diagonal > 0
    step = np.zeros_like(right)
    scale = 1.0 / np.sqrt(diagonal[seen])
    scaled = matrix[np.ix_(seen, seen)] * scale[:, None] * scale
    n = len(scale)
    for attempt in (damping, 1e-12, 1e-9, 1e-6):
        try:
            damped = scaled + max(damping, attempt) * np.eye(n)
            factor = cho_factor(damped, lower=False)
            break
        except LinAlgError:
            continue
    else:
        damped = scaled + np.eye(n)
        factor = cho_factor(damped, lower=False)
    step[seen] = scale * cho_solve(factor, scale * right[seen])
    if np.all(step >= lower) and np.all(step <= upper):
        return step
    triangle = np.triu(factor[0])
    target = np.linalg.solve(triangle.T, scale * right[seen])
    low, high = lower[seen] / scale, upper[seen] / scale
    # lsq_linear wants an open interval.
    closed = high - low < 1e-14
    result = lsq_linear(
        triangle, target, (np.where(closed, low - 1e-14, low), np.where(closed, high + 1e-14, high))
    )
    step[seen] = scale * result.x
    return np.clip(step, lower, upper)
