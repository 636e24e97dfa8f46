"""Two iterates of the likelihood with random forces: frozen gain, and the filter as it is.

:class:`Whitened` has derivatives along the filtered path at frozen gain, from one pass.
:class:`Differentiated` has those of the filter as it is, by differences of whole filters, and its
cost alone takes a pass without any derivative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.shooting import Point

# Information by differences of whole filters over that at frozen gain beyond which it is rounding
# that an unstable model amplifies. Rounding falls with the square of the step, information does
# not: where a standard deviation is smaller than at frozen gain by the second factor, and as much
# smaller than with steps so many times longer, it is rounding as well.
AMPLIFIED, SMALLER, FARTHER = 1.2, 0.8, 3.0
# Share of the largest eigenvalue below which nothing is known.
NOTHING = 1e-12


@dataclass(frozen=True, eq=False)
class Whitened:
    """A point with gradients along the filtered path at frozen gain; an iterate.

    A rise of the cost within ``slack`` near the end is the frozen gain's, not a wrong step.
    """

    problem: Filtered
    point: Point
    cost: float
    matrix: np.ndarray
    right: np.ndarray
    defect: float = 0.0
    offsets: tuple[np.ndarray, ...] = ()

    @classmethod
    def at(cls, problem: Filtered, point: Point) -> Whitened | None:
        """Evaluate a point; None where the filter leaves the numbers."""
        found = problem.passes(point.unknowns)
        objective = sum(part.objective for part in found)
        if not np.isfinite(objective):
            return None
        matrix, right = problem.gathered(point.unknowns, found)
        if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
            return None
        cost = 0.5 * objective + problem.prior_cost(point.unknowns)
        return cls(problem, point, cost, matrix, right)

    @property
    def maps(self) -> tuple[np.ndarray, ...]:
        """How levels follow times."""
        return self.problem.maps(self.point, self.matrix)

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and right-hand side, priors excluded."""
        return self.matrix, self.right

    def predicted(self, step: np.ndarray) -> float:
        """Cost of the quadratic model after a step."""
        return _predicted(self.problem, self.point, self.cost, self.matrix, self.right, step)


class Differentiated:
    """A point with the gradient of the filter as it is; derivatives only when asked for."""

    defect = 0.0
    offsets: tuple[np.ndarray, ...] = ()

    def __init__(self, problem: Filtered, point: Point, cost: float) -> None:
        self.problem, self.point, self.cost = problem, point, cost
        self._equations: tuple[np.ndarray, np.ndarray] | None = None

    @classmethod
    def at(cls, problem: Filtered, point: Point) -> Differentiated | None:
        """Evaluate a point; None where the filter leaves the numbers."""
        objective = problem.objective(point.unknowns)
        return cls(problem, point, 0.5 * objective) if np.isfinite(objective) else None

    @property
    def maps(self) -> tuple[np.ndarray, ...]:
        """How levels follow times."""
        return self.problem.maps(self.point, self.equations()[0])

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and right-hand side, priors excluded."""
        if self._equations is None:
            problem, unknowns = self.problem, self.point.unknowns
            base = problem.passes(unknowns, rows=True)
            frozen, right = problem.gathered(unknowns, base)
            size = np.diag(frozen) + problem.limits.prior_weight
            scale = problem.limits.scale
            std = np.where(size > 0, 1.0 / np.sqrt(np.where(size > 0, size, 1.0)), scale)
            step = np.minimum(std, scale)
            whole = problem.differentiated(unknowns, base, step)
            known = np.arange(problem.layout.levels.start)
            # A vehicle so unstable that moved filters overflow is one whose rounding is amplified.
            more = not all(np.isfinite(part).all() for part in whole)
            more = more or bool(
                (np.diag(whole[0])[known] > AMPLIFIED * np.diag(frozen)[known]).any()
            )
            found = None if more else self._std(whole[0])
            if found is not None and (found < SMALLER * self._std(frozen)).any():
                farther, _ = problem.differentiated(unknowns, base, FARTHER * step)
                more = not np.isfinite(farther).all()
                more = more or bool((found < SMALLER * self._std(farther)).any())
            self._equations = (frozen, right) if more else whole
        return self._equations

    def _std(self, matrix: np.ndarray) -> np.ndarray:
        """Standard deviations of the shared parameters, everything else unknown."""
        matrix = matrix + np.diag(self.problem.limits.prior_weight)
        size = np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), 1.0))
        inverse = np.linalg.pinv(matrix / size / size[:, None], rcond=NOTHING, hermitian=True)
        shared = len(self.problem.layout.shared)
        return np.asarray(np.sqrt(np.maximum(np.diag(inverse)[:shared], 0.0)) / size[:shared])

    def predicted(self, step: np.ndarray) -> float:
        """Cost of the quadratic model after a step."""
        matrix, right = self.equations()
        return _predicted(self.problem, self.point, self.cost, matrix, right, step)


def _predicted(
    problem: Filtered,
    point: Point,
    cost: float,
    matrix: np.ndarray,
    right: np.ndarray,
    step: np.ndarray,
) -> float:
    # Joint knowledge is in matrix and right-hand side already, priors of single unknowns are not.
    change = float(step @ (0.5 * (matrix @ step) - right))
    limits = problem.limits
    away = point.unknowns - limits.prior_mean
    prior = 0.5 * float(limits.prior_weight @ ((away + step) ** 2 - away**2))
    return cost + change + prior
