r"""What a pass of the filter is given and what it returns, compiled or interpreted.

A disturbance is one state of first order, or two of second: with :math:`\omega = 2\pi/T`

.. math::
    \dot a = \omega b, \qquad
    \dot b = -\omega a - 2 \zeta \omega b + \sqrt{4 \zeta \omega}\, n(t)

whose stationary covariance is the unit matrix, times the variance of the disturbance. What acts is
the velocity :math:`b` (no power at frequency zero) or the displacement :math:`a`. Exactly, over a
time :math:`h`, with :math:`\omega_d = \omega \sqrt{1 - \zeta^2}`, :math:`c = \cos \omega_d h` and
:math:`s = \sin(\omega_d h) / \sqrt{1 - \zeta^2}`,

.. math::
    \Phi = e^{-\zeta \omega h}
    \begin{pmatrix} c + \zeta s & s \\ -s & c - \zeta s \end{pmatrix}, \qquad
    Q = \sigma^2 (I - \Phi \Phi')

so that the variance enters force noise alone, period and damping :math:`\Phi` alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

# Levels of the noise by kind, as ``filter.c`` numbers them.
FORCE_VARIANCE, FORCE_TIME, WHITE_VARIANCE, COLOUR_VARIANCE, COLOUR_TIME = range(5)
# Those of narrow-band disturbances: a variance counts among all of these, the others are of a sea.
SEA_VARIANCE, SEA_PERIOD, SEA_DAMPING = range(5, 8)
# Most disturbances that act through one parameter, as in ``filter.c``.
MOST_PROCESSES = 4


@dataclass(frozen=True, eq=False)
class Disturbed:
    """Variances and times of everything random in one pass.

    Attributes
    ----------
    disturbances : tuple of str
        Parameters of the model that are random; one stands there as often as processes act on it.
        Those of first order come first.
    variance, time : ndarray (n_disturbances,)
        Stationary variance, and correlation time or period in s; time zero is white from step to
        step.
    white : ndarray (n_outputs,)
        Variances of white sensor noise.
    coloured : ndarray of int (n_coloured,)
        Outputs with coloured errors.
    colour_variance, colour_time : ndarray (n_coloured,)
        Their variances, and correlation times in s.
    damping : ndarray (n_disturbances,), optional
        Of those of second order.
    turn : ndarray of int (n_disturbances,), optional
        0 for first order, 1 where the displacement acts, -1 where the velocity does.
    sea : ndarray of int (n_disturbances,), optional
        Which of those of second order share period and damping; -1 for first order.
    """

    disturbances: tuple[str, ...]
    variance: np.ndarray
    time: np.ndarray
    white: np.ndarray
    coloured: np.ndarray
    colour_variance: np.ndarray
    colour_time: np.ndarray
    damping: Any = 0.0
    turn: Any = 0
    sea: Any = -1

    def __post_init__(self) -> None:
        for name, kind in (("damping", float), ("turn", np.intc), ("sea", np.intc)):
            given = np.asarray(getattr(self, name), dtype=kind)
            object.__setattr__(self, name, np.broadcast_to(given, self.variance.shape).copy())

    @property
    def acting(self) -> tuple[str, ...]:
        """Parameters of the model that are random, each once."""
        return tuple(dict.fromkeys(self.disturbances))

    @property
    def n_second(self) -> int:
        """Number of second states, which come last of all."""
        return int(np.sum(self.turn != 0))

    def memory(self, length: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Transition of disturbances, colours and second states over a time.

        Parameters
        ----------
        length : float
            s.

        Returns
        -------
        transition, by_time, by_damping : ndarray (n, n)
            And its derivatives by the logarithms of all times and periods, and of all dampings.
        """
        n_first = len(self.variance) + len(self.coloured)
        size = n_first + self.n_second
        found = np.zeros((3, size, size))
        times = np.maximum(np.concatenate([self.time, self.colour_time]), 1e-9)
        second = n_first
        for j, time in enumerate(times):
            turn = self.turn[j] if j < len(self.turn) else 0
            if turn == 0:
                left = np.exp(-length / time)
                found[:2, j, j] = left, left * length / time
                continue
            block = np.ix_((j, second), (j, second))
            for kind, part in enumerate(narrow_band(length, time, float(self.damping[j]), turn)):
                found[kind][block] = part
            second += 1
        return found[0], found[1], found[2]

    @property
    def stationary(self) -> np.ndarray:
        """Variances of disturbances, colours and second states, ``(n,)``."""
        return np.concatenate([self.variance, self.colour_variance, self.variance[self.turn != 0]])


def narrow_band(
    length: float, period: float, damping: float, turn: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Transition of what acts and of the second state, and its derivatives.

    Parameters
    ----------
    length, period : float
        s.
    damping : float
        Below one.
    turn : int
        1 where the displacement acts, -1 where the velocity does.

    Returns
    -------
    transition, by_period, by_damping : ndarray (2, 2)
        The latter by the logarithms.

    Examples
    --------
    >>> phi, _, _ = narrow_band(8.0, 8.0, 0.1, -1)
    >>> float(np.linalg.det(phi).round(4)), float(np.exp(-4 * np.pi * 0.1).round(4))
    (0.2846, 0.2846)
    """
    z, angle, root = damping, 2 * np.pi * length / period, np.sqrt(1 - damping**2)
    c, s, e = np.cos(angle * root), np.sin(angle * root) / root, np.exp(-damping * angle)
    by_c, by_s = angle * z * s, z / root**2 * (s - angle * c)
    mirror = np.array([[1.0, 0.0], [0.0, -1.0]])
    cross = np.array([[0.0, 1.0], [-1.0, 0.0]])
    unit = np.eye(2)
    phi = e * (c * unit + turn * s * (z * mirror + cross))
    rates = -z * unit + turn * (z * mirror + cross)
    by_damping = e * (by_c * unit + turn * (by_s * (z * mirror + cross) + s * mirror))
    return phi, -angle * rates @ phi, z * (by_damping - angle * phi)


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
    gains : ndarray (n_times, n_outputs, 2, n) or None
        Derivatives of each output, and the gain of its innovation; zero where missing. The ``n``
        are active components, disturbances, colours and second states of disturbances.
    moves : ndarray (n_times, n + n_disturbances, n) or None
        Their transition towards the next sample (zero at the last one), above the predicted
        covariance of the disturbances with them.
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
