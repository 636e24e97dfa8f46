r"""Noise of what is left of an equation, and its likelihood.

The residual of :math:`\dot y = f(s)` over blocks of samples is

.. math::

    e_i = y_i - c - \int^{t_i} f(s)\,dt = a_i + b_i, \qquad
    a_i = \rho\, a_{i-1} + \text{white}, \quad b_i = b_{i-1} + \text{white},

the noise of the signal itself (level :math:`\sigma_e`, correlation :math:`\rho` from block to
block) and the integrated noise of the rates, a random walk of variance
:math:`\lambda\sigma_e^2` a block. Its first difference has the spectrum of an ARMA(1, 1) process,
so that whitening is one recursive filter (Box, Jenkins & Reinsel 2008, section 4.3.3): with
backward shift :math:`B` and :math:`s = 1 - \rho^2`,

.. math::

    (1 - \rho B)(1 - B)\,e = g\,(1 - \vartheta B)\,\varepsilon, \qquad
    g^2 (1 + \vartheta^2) = \lambda (1 + \rho^2) + 2 s, \quad
    g^2 \vartheta = \lambda \rho + s .

Levels and correlation are those of largest restricted likelihood (Patterson & Thompson 1971),
with every fault that could be there among the regressors, so that no fault passes as noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

CORRELATIONS = (0.0, 0.3, 0.6, 0.8, 0.92)
WALKS = tuple(10.0**k for k in (-6.0, -4.0, -3.0, -2.0, -1.3, -0.6, 0.0, 0.7, 1.5, 3.0))
# Halvings of the grid's steps around its best point.
REFINEMENTS = 3


@dataclass(frozen=True)
class Colour:
    """Levels of one equation's noise.

    Parameters
    ----------
    level : float
        Standard deviation of a block's own noise.
    correlation : float
        From one block to the next.
    walk : float
        Variance of the random walk per block, in units of ``level**2``.
    """

    level: float
    correlation: float
    walk: float

    @property
    def walk_variance(self) -> float:
        """Variance that the random walk gains per block."""
        return self.walk * self.level**2

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Filter a stretch of residuals or regressors, shape ``(n_blocks, n_columns)``."""
        return _filtered(columns, self.correlation, self.walk) / self.level


def _gain(correlation: float, walk: float) -> tuple[float, float]:
    """Gain and moving-average coefficient of the differenced noise of unit level."""
    s = 1.0 - correlation**2
    a = walk * (1.0 + correlation**2) + 2.0 * s
    c = walk * correlation + s
    theta = (a - np.sqrt(max(a * a - 4.0 * c * c, 0.0))) / (2.0 * c)
    return float(np.sqrt(c / theta)), float(theta)


def _filtered(columns: np.ndarray, correlation: float, walk: float) -> np.ndarray:
    gain, theta = _gain(correlation, walk)
    steps = np.diff(columns, axis=0, prepend=np.zeros((1, columns.shape[1])))
    return lfilter([1.0 / gain, -correlation / gain], [1.0, -theta], steps, axis=0)


def estimate(stretches: list[np.ndarray], least_walk: float, least_level: float) -> Colour:
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
    """
    scale = np.sqrt(sum(np.sum(np.diff(part, axis=0) ** 2, axis=0) for part in stretches)) + 1e-300
    parts = [part / np.where(np.arange(part.shape[1]) == 0, 1.0, scale) for part in stretches]
    known: dict[tuple[float, float], tuple[float, float]] = {}

    def cost(correlation: float, log_walk: float) -> tuple[float, float]:
        key = (correlation, log_walk)
        if key not in known:
            known[key] = _cost(parts, correlation, 10.0**log_walk, least_walk, least_level)
        return known[key]

    grid = [(r, float(np.log10(w))) for r in CORRELATIONS for w in WALKS]
    best = min(grid, key=lambda point: cost(*point)[0])
    for k in range(REFINEMENTS):
        width, height = 0.12 / 2**k, 0.5 / 2**k
        around = [
            (min(max(best[0] + i * width, 0.0), 0.97), best[1] + j * height)
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        best = min(around, key=lambda point: cost(*point)[0])
    return Colour(cost(*best)[1], best[0], 10.0 ** best[1])


def _cost(
    parts: list[np.ndarray],
    correlation: float,
    walk: float,
    least_walk: float,
    least_level: float,
) -> tuple[float, float]:
    """Minus twice the restricted log-likelihood, and the level that it is taken at."""
    n_columns = parts[0].shape[1]
    gram = np.zeros((n_columns, n_columns))
    n, n_constants, logarithms = 0, 0, 0.0
    gain, _ = _gain(correlation, walk)
    for part in parts:
        white = _filtered(
            np.column_stack([part, np.ones(len(part))]), correlation, walk
        )
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
    level = max(level, np.sqrt(least_walk / walk), least_level)
    cost = freedom * 2.0 * np.log(level) + rest_power / level**2 + 2.0 * n * np.log(gain)
    cost += logarithms + (np.linalg.slogdet(inner)[1] if n_columns > 1 else 0.0)
    return float(cost), float(level)
