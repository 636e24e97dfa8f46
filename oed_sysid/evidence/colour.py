r"""Noise of what is left of an equation, and its likelihood.

The residual of :math:`\dot y = f(s)` over blocks of samples is

.. math:: e_i = y_i - c - \int^{t_i} f(s)\,dt = a_i + b_i,

the noise :math:`a` of the signal itself, perhaps correlated from block to block, and the
integrated noise :math:`b` of the rates, a random walk whose steps may be correlated too. Whichever
of them is coloured, the first difference has the spectrum of an ARMA(1, 1) process to good
approximation (exactly if :math:`a` is white or first-order and the steps of :math:`b` are white, or
both share one correlation; Box, Jenkins & Reinsel 2008, section 4.3.3), and whitening is one
recursive filter: with the backward shift :math:`B`,

.. math:: (1 - \rho B)(1 - B)\,e = \sigma\,(1 - \vartheta B)\,\varepsilon .

:math:`\vartheta \to 1` is white noise of the signal alone, :math:`\vartheta = \rho` a random walk,
:math:`\vartheta < \rho` one with correlated steps. In the long run the walk gains the variance
:math:`\sigma^2 (1 - \vartheta)^2 / (1 - \rho)^2` a block, which is not taken below what the fast
noise of the rates makes: a smaller one would turn noise into biases.

Level and coefficients are those of largest restricted likelihood (Patterson & Thompson 1971),
with every fault that could be there among the regressors, so that no fault passes as noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded

CORRELATIONS = (0.0, 0.3, 0.6, 0.8, 0.92)
# One minus the moving-average coefficient.
AVERAGES = (0.001, 0.004, 0.015, 0.05, 0.12, 0.25, 0.45, 0.7, 1.0, 1.25)
LARGEST = 0.985
# Halvings of the grid's steps around its best point.
REFINEMENTS = 3


@dataclass(frozen=True)
class Colour:
    r"""Noise of one equation.

    Parameters
    ----------
    level : float
        Standard deviation of an innovation.
    correlation, average : float
        Coefficients of the filter, :math:`\rho` and :math:`\vartheta`.
    """

    level: float
    correlation: float
    average: float

    @property
    def walk_variance(self) -> float:
        """Variance that the residual gains per block in the long run."""
        return (self.level * (1.0 - self.average) / (1.0 - self.correlation)) ** 2

    @property
    def walk_share(self) -> float:
        """Share of the whitened residual's power that the noise of the rates makes."""
        theta, rho = self.average, self.correlation
        if theta < rho:
            return min((1.0 - theta) / (1.0 + theta), 1.0)
        power = 1.0 + (theta - rho) ** 2 / (1.0 - theta**2)
        return min(power * ((1.0 - theta) / (1.0 - rho)) ** 2, 1.0)

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Filter a stretch of residuals or regressors, shape ``(n_blocks, n_columns)``."""
        return _filtered(columns, self.correlation, self.average) / self.level


def _filtered(columns: np.ndarray, correlation: float, average: float) -> np.ndarray:
    steps = np.diff(columns, axis=0, prepend=np.zeros((1, columns.shape[1])))
    return _recursion(steps, correlation, average)


def _recursion(steps: np.ndarray, correlation: float, average: float) -> np.ndarray:
    """Filter first differences, shape ``(n_blocks, n_columns)``."""
    moved = steps.copy()
    moved[1:] -= correlation * steps[:-1]
    # y_k - average y_{k-1} = moved_k as a banded system: scipy.signal takes a second to import.
    bands = np.ones((2, len(steps)))
    bands[1] = -average
    return solve_banded((1, 0), bands, moved)


def estimate(
    stretches: list[np.ndarray],
    least_walk: float,
    least_level: float,
    start: Colour | None = None,
) -> Colour:
    r"""Noise of largest restricted likelihood.

    Parameters
    ----------
    stretches : list of ndarray (n_blocks, 1 + n_columns)
        For each uninterrupted stretch the residual, then its regressors. A free constant for
        each stretch is added.
    least_walk : float
        Variance per block that the known noise of the integrated signals alone produces; the
        walk is not taken below it.
    least_level : float
        Least ``level``.
    start : Colour, optional
        Where to look first, instead of everywhere.
    """
    scale = np.sqrt(sum(np.sum(np.diff(part, axis=0) ** 2, axis=0) for part in stretches)) + 1e-300
    scale[0] = 1.0
    parts = [
        np.diff(np.column_stack([part / scale, np.ones(len(part))]), axis=0, prepend=0.0)
        for part in stretches
    ]
    known: dict[tuple[float, float], tuple[float, float]] = {}

    def cost(correlation: float, rest: float) -> tuple[float, float]:
        key = (correlation, rest)
        if key not in known:
            known[key] = _cost(parts, correlation, 1.0 - rest, least_walk, least_level)
        return known[key]

    if start is None:
        grid = ((r, m) for r in CORRELATIONS for m in AVERAGES)
        best = min(grid, key=lambda point: cost(*point)[0])
    else:
        best = (start.correlation, 1.0 - start.average)
    for k in range(REFINEMENTS):
        width, factor = 0.1 / 2**k, 1.6 ** (0.5**k)
        around = [
            (min(max(best[0] + i * width, 0.0), LARGEST), min(best[1] * factor**j, 1.4))
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        best = min(around, key=lambda point: cost(*point)[0])
    return Colour(cost(*best)[1], best[0], 1.0 - best[1])


def _cost(
    parts: list[np.ndarray],
    correlation: float,
    average: float,
    least_walk: float,
    least_level: float,
) -> tuple[float, float]:
    """Minus twice the restricted log-likelihood, and the level that it is taken at.

    ``parts`` are first differences: residual, regressors, and the constant.
    """
    n_columns = parts[0].shape[1] - 1
    gram = np.zeros((n_columns, n_columns))
    n, n_constants, logarithms = 0, 0, 0.0
    for part in parts:
        white = _recursion(part, correlation, average)
        constant = white[:, -1]
        power = float(constant @ constant)
        rest = white[:, :-1] - np.outer(constant, constant @ white[:, :-1] / power)
        gram += rest.T @ rest
        n += len(part)
        n_constants += 1
        logarithms += np.log(power)
    inner = gram[1:, 1:] + 1e-9 * np.eye(n_columns - 1) * (np.trace(gram[1:, 1:]) + 1e-300)
    solved = np.linalg.solve(inner, gram[1:, 0]) if n_columns > 1 else np.zeros(0)
    rest_power = max(float(gram[0, 0] - gram[1:, 0] @ solved), 1e-300)
    freedom = max(n - n_constants - (n_columns - 1), 1)
    level = np.sqrt(rest_power / freedom)
    least = np.sqrt(least_walk) * (1.0 - correlation) / (1.0 - average)
    level = max(level, least, least_level)
    cost = freedom * 2.0 * np.log(level) + rest_power / level**2
    cost += logarithms + (np.linalg.slogdet(inner)[1] if n_columns > 1 else 0.0)
    return float(cost), float(level)
