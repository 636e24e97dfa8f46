r"""Heading and yaw rate of a record without the noise of their sensors.

The two are smoothed together, since one is the derivative of the other:

.. math::
    \dot\psi = r, \qquad \dot r = -\alpha r + \kappa \delta + b, \qquad \dot b = w, \qquad
    \psi^m_k = \psi(t_k) + e_k, \qquad r^m_k = r(t_k) + f_k ,

white :math:`w` of density :math:`q` for all that the rudder :math:`\delta` does not do. The
levels of :math:`e, f, w` and :math:`\alpha, \kappa` are those of the largest likelihood; the smoothed series is the mean of :math:`\psi, r` given all measurements
(Rauch, Tung & Striebel, AIAA Journal 3(8), 1965), here from the banded normal equations. What is
regressed on such a mean is not attenuated by the sensors' noise (Carroll et al., *Measurement
Error in Nonlinear Models*, 2006, chapter 4).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError

# Median absolute deviation of a normal distribution of unit standard deviation.
MAD = 0.6745
# Noise below this is none: rad, and rad per sample.
LEAST_NOISE = 1e-7
LEAST_HEADINGS = 10


@dataclass(frozen=True, eq=False)
class SmoothHeading:
    """Smoothed series.

    Attributes
    ----------
    times, heading, yaw_rate, acceleration : ndarray (n_times,)
        s, rad, rad/s, rad/s^2.
    heading_noise, yaw_rate_noise : float
        Standard deviation of the sensors, rad and rad/s.
    effect : float
        Yaw acceleration by the rudder, 1/s^2.
    """

    times: np.ndarray
    heading: np.ndarray
    yaw_rate: np.ndarray
    acceleration: np.ndarray
    heading_noise: float
    yaw_rate_noise: float
    effect: float
    factor: np.ndarray = field(repr=False)

    def at(self, time: float) -> tuple[float, float, float]:
        """Heading, its standard deviation and yaw rate at a time between samples."""
        k = int(np.abs(self.times - time).argmin())
        ahead = time - self.times[k]
        unit = np.zeros(self.factor.shape[1])
        unit[3 * k] = 1.0
        variance = cho_solve_banded((self.factor, True), unit)[3 * k]
        rate = self.yaw_rate[k] + self.acceleration[k] * ahead
        heading = self.heading[k] + 0.5 * (self.yaw_rate[k] + rate) * ahead
        return float(heading), float(np.sqrt(variance)), float(rate)


class _Equations:
    """Normal equations of the smoother in the units rad, rad/step, rad/step^2."""

    def __init__(
        self, times: np.ndarray, heading: np.ndarray, turned: np.ndarray, rudder: np.ndarray
    ) -> None:
        self.measured = np.column_stack([heading, turned])
        self.seen = np.isfinite(self.measured)
        self.measured = np.where(self.seen, self.measured, 0.0)
        self.n = len(times)
        self.rudder = rudder[:-1]
        self.steps = h = np.diff(times) / np.median(np.diff(times))
        spread = [
            [h**5 / 20, h**4 / 8, h**3 / 6],
            [h**4 / 8, h**3 / 3, h**2 / 2],
            [h**3 / 6, h**2 / 2, h],
        ]
        self.weight = np.linalg.inv(np.moveaxis(np.array(spread), -1, 0))

    def forward(self, alpha: float) -> np.ndarray:
        """Transition from sample to sample ``(n_times - 1, 3, 3)``."""
        h = self.steps
        # Below that the damping is lost in rounding.
        alpha = max(alpha, 1e-4)
        kept = np.exp(-alpha * h)
        table = np.tile(np.eye(3), (len(h), 1, 1))
        table[:, 1, 1] = kept
        table[:, 0, 1] = table[:, 1, 2] = (1 - kept) / alpha
        table[:, 0, 2] = (h - table[:, 0, 1]) / alpha
        return table

    def solve(self, levels: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Minus twice the log-likelihood, states ``(n_times, 3)`` and the factor.

        ``levels`` are the logarithms of both noise levels and of the square root of q, then
        alpha and kappa per step.
        """
        noise, jerk = np.exp(levels[:2]), np.exp(2 * levels[2])
        forward = self.forward(levels[3])
        push = levels[4] * self.rudder[:, None] * forward[:, :, 2]
        push[:, 2] = 0.0
        before = self.weight @ forward / jerk
        diagonal = np.zeros((self.n, 3, 3))
        diagonal[:-1] += np.swapaxes(forward, 1, 2) @ before
        diagonal[1:] += self.weight / jerk
        right = np.zeros((self.n, 3))
        right[1:] += np.einsum("kij,kj->ki", self.weight, push) / jerk
        right[:-1] -= np.einsum("kji,kj->ki", before, push)
        for column in (0, 1):
            inverse = self.seen[:, column] / noise[column] ** 2
            diagonal[:, column, column] += inverse
            right[:, column] += inverse * self.measured[:, column]
        # Lower band: element (i, j) of the matrix stands at [i - j, j].
        band = np.zeros((6, 3 * self.n))
        for i in range(3):
            for j in range(3):
                if i >= j:
                    band[i - j, j::3] = diagonal[:, i, j]
                band[3 + i - j, j : 3 * (self.n - 1) : 3] -= before[:, i, j]
        factor = cholesky_banded(band, lower=True)
        states = cho_solve_banded((factor, True), right.ravel()).reshape(self.n, 3)
        misfit = np.where(self.seen, self.measured - states[:, :2], 0.0) / noise
        moved = states[1:] - np.einsum("kij,kj->ki", forward, states[:-1]) - push
        value = (
            (misfit**2).sum()
            + np.einsum("ki,kij,kj", moved, self.weight, moved) / jerk
            + 2 * (self.seen.sum(axis=0) @ levels[:2])
            + 6 * (self.n - 1) * levels[2]
            + 2 * np.log(factor[0]).sum()
        )
        return float(value), states, factor


def smooth_heading(
    record: Record, rudder: str, *, heading: str = "psi", yaw_rate: str = "r"
) -> SmoothHeading:
    """Smooth heading and yaw rate of a record; gaps are bridged.

    Parameters
    ----------
    record : Record
        Its output ``heading``, and ``yaw_rate`` if it has that.
    rudder : str
        Input that turns the ship.
    heading, yaw_rate : str
        Outputs, rad and rad/s.

    Raises
    ------
    DataError
        If fewer than ten headings were measured.

    Examples
    --------
    >>> from oed_sysid.channels import Channels, Input, Output
    >>> channels = Channels((Input("d", "rad"),), (Output("psi", "rad"), Output("r", "rad/s")))
    >>> t = np.arange(0.0, 60.0, 0.5)
    >>> rng = np.random.default_rng(0)
    >>> true = np.column_stack([np.sin(0.2 * t), 0.2 * np.cos(0.2 * t)])
    >>> noisy = true + [0.01, 0.005] * rng.standard_normal(true.shape)
    >>> smooth = smooth_heading(Record("turns", t, 0 * t, noisy, channels), "d")
    >>> print(round(1000 * np.std(smooth.yaw_rate - true[:, 1]), 1), "mrad/s instead of 5")
    2.0 mrad/s instead of 5
    """
    times, psi = record.times, record.output(heading)
    if np.isfinite(psi).sum() < LEAST_HEADINGS:
        raise DataError(
            f"Record {record.name!r} has {np.isfinite(psi).sum()} samples of {heading!r}; a law of "
            f"steering needs {LEAST_HEADINGS}. Give the law."
        )
    known = yaw_rate in record.channels.output_names
    step = float(np.median(np.diff(times)))
    turned = step * record.output(yaw_rate) if known else np.full(len(times), np.nan)
    middle = float(np.nanmedian(psi))
    turning = record.input(rudder)
    equations = _Equations(times, psi - middle, turned, turning)
    least = np.log(LEAST_NOISE)

    def within(levels: np.ndarray) -> np.ndarray:
        """Levels of noise that are not nothing, and a ship that does not explode."""
        return np.array([*np.maximum(levels[:3], least), np.clip(levels[3], 0, 2), levels[4]])

    def fitted(first: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Levels of the largest likelihood; those of size zero stay."""
        free = sizes > 0
        simplex = first[free] + np.vstack([np.zeros(free.sum()), np.diag(sizes[free])])
        start = first.copy()

        def value(some: np.ndarray) -> float:
            start[free] = some
            return equations.solve(within(start))[0]

        options = {"xatol": 1e-2, "fatol": 1e-2, "initial_simplex": simplex}
        start[free] = minimize(value, first[free], method="Nelder-Mead", options=options).x
        return within(start)

    first = np.log(
        [
            _noise(psi, 3),
            _noise(turned, 2) if np.isfinite(turned).any() else 1.0,
            0.1 * _noise(np.diff(psi), 1),
        ]
    )
    levels = fitted(np.array([*first, 0.0, 0.0]), np.array([1.5, 1.5, 1.5, 0.0, 0.0]))
    if np.ptp(turning) > 0:
        _, states, _ = equations.solve(levels)
        gone = np.column_stack([-states[:-1, 1], turning[:-1], np.ones(len(times) - 1)])
        (alpha, kappa, _), *_ = np.linalg.lstsq(gone, np.diff(states[:, 1]), rcond=None)
        levels[3:] = max(alpha, 0.01), kappa
        levels = fitted(levels, np.array([0.5, 0.5, 1.0, 0.3 * levels[3], 0.3 * abs(kappa)]))
    _, states, factor = equations.solve(levels)
    noise = np.exp(levels[:2])
    acceleration = -levels[3] * states[:, 1] + levels[4] * turning + states[:, 2]
    return SmoothHeading(
        times,
        states[:, 0] + middle,
        states[:, 1] / step,
        acceleration / step**2,
        float(noise[0]),
        float(noise[1] / step) if known else np.nan,
        float(levels[4] / step**2),
        factor,
    )


def _noise(series: np.ndarray, order: int) -> float:
    """Standard deviation of white noise on a smooth series, from its differences."""
    change = np.diff(series[np.isfinite(series)], order)
    squares = {1: 2, 2: 6, 3: 20}[order]
    spread = float(np.median(np.abs(change))) / MAD / np.sqrt(squares) if change.size else 0.0
    return max(spread, 10 * LEAST_NOISE)


def rudder_noise(rudder: np.ndarray) -> float:
    """Noise of a logged rudder, rad; nothing where it is held and moved evenly."""
    change = np.diff(rudder, 2)
    return float(np.median(np.abs(change))) / MAD / np.sqrt(6)
