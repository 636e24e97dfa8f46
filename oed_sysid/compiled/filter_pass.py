"""What a pass of the filter is given and what it returns, compiled or interpreted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Levels of the noise by kind, as ``filter.c`` numbers them.
FORCE_VARIANCE, FORCE_TIME, WHITE_VARIANCE, COLOUR_VARIANCE, COLOUR_TIME = range(5)


@dataclass(frozen=True, eq=False)
class Disturbed:
    """Variances and times of everything random in one pass.

    Attributes
    ----------
    disturbances : tuple of str
        Parameters of the model that are random.
    variance, time : ndarray (n_disturbances,)
        Stationary variance, and correlation time in s; time zero is white from step to step.
    white : ndarray (n_outputs,)
        Variances of white sensor noise.
    coloured : ndarray of int (n_coloured,)
        Outputs with coloured errors.
    colour_variance, colour_time : ndarray (n_coloured,)
        Their variances, and correlation times in s.
    """

    disturbances: tuple[str, ...]
    variance: np.ndarray
    time: np.ndarray
    white: np.ndarray
    coloured: np.ndarray
    colour_variance: np.ndarray
    colour_time: np.ndarray


@dataclass(frozen=True, eq=False)
class FilterPass:
    """What one pass over one record returns.

    Attributes
    ----------
    gram : ndarray (n_columns + n_levels + 1, same)
        Sum of ``[de e]'[de e] / S``: derivatives of the innovations by columns and levels, then
        the innovation itself.
    level_slope : ndarray (n_levels,)
        Half the sum of ``q (1 - e^2/S)`` with ``q = d log S``.
    level_information : ndarray (n_levels, n_levels)
        Half the sum of ``q q'``.
    log_variance, square : float
        Sums of ``log S`` and ``e^2/S``.
    innovations, variances : ndarray (n_times, n_outputs)
        ``e``, NaN where nothing was measured, and ``S``, also where nothing was.
    rows : ndarray (n_times, n_outputs, n_columns + 2 n_levels) or None
        ``de / sqrt(S)``, also where nothing was measured, then ``q`` of the levels.
    path : ndarray (n_times, n_full + n_disturbances + n_coloured)
        Filtered means.
    gains : ndarray (n_times, n_outputs, 2, n_active + n_disturbances + n_coloured) or None
        Derivatives of each output, and the gain of its innovation; zero where missing.
    moves : ndarray (n_times, n + n_disturbances, n) or None
        Transition of ``n`` active components, disturbances and colours towards the next sample
        (zero at the last one), above the predicted covariance of the disturbances with them.
    failed_at : int
        First sample that is not finite, or -1.
    """

    gram: np.ndarray
    level_slope: np.ndarray
    level_information: np.ndarray
    log_variance: float
    square: float
    innovations: np.ndarray
    variances: np.ndarray
    rows: np.ndarray | None
    path: np.ndarray
    gains: np.ndarray | None
    moves: np.ndarray | None
    failed_at: int

    @property
    def ok(self) -> bool:
        """Whether everything stayed finite."""
        return self.failed_at < 0

    @property
    def objective(self) -> float:
        """Minus twice the log-likelihood, up to a constant."""
        value = self.log_variance + self.square
        return value if self.ok and np.isfinite(value) else np.inf


@dataclass(eq=False)
class Results:
    """Arrays that a pass fills."""

    gram: np.ndarray
    level: np.ndarray
    e: np.ndarray
    s: np.ndarray
    rows: np.ndarray | None
    path: np.ndarray
    total: np.ndarray
    gains: np.ndarray | None = None
    moves: np.ndarray | None = None

    @classmethod
    def empty(
        cls, n: int, n_outputs: int, width: int, n_levels: int, size: int, rows: bool
    ) -> Results:
        """Return arrays of the right shapes; what no pass fills stays NaN."""
        return cls(
            np.full((width + 1, width + 1), np.nan),
            np.zeros(n_levels * (n_levels + 1)),
            np.full((n, n_outputs), np.nan),
            np.full((n, n_outputs), np.nan),
            np.zeros((n, n_outputs, width + n_levels)) if rows else None,
            np.full((n, size), np.nan),
            np.full(2, np.inf),
        )

    def done(self, failed: int) -> FilterPass:
        """Return the pass; ``failed`` is the sample at which it broke off, or below zero."""
        n_levels = int((np.sqrt(1 + 4 * len(self.level)) - 1) / 2)
        return FilterPass(
            self.gram,
            self.level[:n_levels],
            self.level[n_levels:].reshape(n_levels, n_levels),
            float(self.total[0]),
            float(self.total[1]),
            self.e,
            self.s,
            self.rows,
            self.path,
            self.gains,
            self.moves,
            failed,
        )
