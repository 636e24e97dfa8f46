r"""Heading and yaw rate of a record without the noise of their sensors.

The two are smoothed together, since one is the derivative of the other:

.. math::
    \dot\psi = r, \qquad \dot r = -\alpha r + \kappa \delta + b, \qquad
    \dot b = -\gamma b + \lambda \delta + w, \qquad
    \psi^m_k = \psi(t_k) + e_k, \qquad r^m_k = r(t_k) + f_k ,

white :math:`w` of density :math:`q` for all that the rudder :math:`\delta` does not do; without
:math:`w` it is Nomoto's equation of second order. The levels of :math:`e, f, w` and
:math:`\alpha, \kappa, \gamma, \lambda` are those of the largest likelihood; the smoothed series
is the mean of :math:`\psi, r` given all measurements (Rauch, Tung & Striebel, AIAA Journal 3(8),
1965), here from the banded normal equations. What is regressed on such a mean is not attenuated
by the sensors' noise (Carroll et al., *Measurement Error in Nonlinear Models*, 2006, chapter 4).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, expm
from scipy.optimize import minimize

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError

# Median absolute deviation of a normal distribution of unit standard deviation.
MAD = 0.6745
# Noise below this is none: rad, and rad per sample.
LEAST_NOISE = 1e-7
LEAST_HEADINGS = 10
# Bounds of alpha, kappa, gamma and lambda, per step.
RATES = np.array([[0.0, -np.inf, 0.0, -np.inf], [2.0, np.inf, 2.0, np.inf]])


@dataclass(frozen=True, eq=False)
class SmoothHeading:
    """Smoothed series.

    Attributes
    ----------
    times, heading, yaw_rate, acceleration : ndarray (n_times,)
        s, rad, rad/s, rad/s^2.
    heading_noise, yaw_rate_noise : float
        Standard deviation of the sensors, rad and rad/s.
    others : ndarray (n_times, 2)
        Heading and yaw rate smoothed without the sample itself and every second other one: free
        of its noise.
    effect : float
        Yaw acceleration by the rudder, 1/s^2.
    """

    times: np.ndarray
    heading: np.ndarray
    yaw_rate: np.ndarray
    acceleration: np.ndarray
    heading_noise: float
    yaw_rate_noise: float
    others: np.ndarray = field(repr=False)
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
        h = np.diff(times) / np.median(np.diff(times))
        self.kinds = np.unique(h.round(6), return_inverse=True)
        spread = [
            [h**5 / 20, h**4 / 8, h**3 / 6],
            [h**4 / 8, h**3 / 3, h**2 / 2],
            [h**3 / 6, h**2 / 2, h],
        ]
        self.weight = np.linalg.inv(np.moveaxis(np.array(spread), -1, 0))

    def transition(
        self, alpha: float, kappa: float, gamma: float, lambda_: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Transition ``(n_times - 1, 3, 3)`` and the rudder's share ``(n_times - 1, 3)``."""
        system = np.zeros((4, 4))
        system[0, 1] = system[1, 2] = 1.0
        system[1, 1], system[1, 3], system[2, 2], system[2, 3] = -alpha, kappa, -gamma, lambda_
        kinds, which = self.kinds
        table = np.array([expm(system * h) for h in kinds])[which]
        return table[:, :3, :3], table[:, :3, 3] * self.rudder[:, None]

    def solve(self, levels: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Minus twice the log-likelihood, states ``(n_times, 3)`` and the factor.

        ``levels`` are the logarithms of both noise levels and of the square root of q, then
        alpha, kappa, gamma and lambda, time in steps.
        """
        noise, jerk = np.exp(levels[:2]), np.exp(2 * levels[2])
        forward, push = self.transition(*levels[3:])
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
        return np.array([*np.maximum(levels[:3], least), *np.clip(levels[3:], *RATES)])

    def fitted(first: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Levels of the largest likelihood; those of size zero stay."""
        free = sizes != 0
        simplex = first[free] + np.vstack([np.zeros(free.sum()), np.diag(sizes[free])])
        start = first.copy()

        def value(some: np.ndarray) -> float:
            start[free] = some
            return equations.solve(within(start))[0]

        options = {"xatol": 1e-2, "fatol": 1e-2, "maxfev": 600, "initial_simplex": simplex}
        start[free] = minimize(value, first[free], method="Nelder-Mead", options=options).x
        return within(start)

    first = np.log(
        [
            _noise(psi, 3),
            _noise(turned, 2) if np.isfinite(turned).any() else 1.0,
            0.1 * _noise(np.diff(psi), 1),
        ]
    )
    levels = fitted(np.array([*first, 0, 0, 0, 0]), np.array([1.5, 1.5, 1.5, 0, 0, 0, 0]))
    if np.ptp(turning) > 0:
        _, states, _ = equations.solve(levels)
        gone = np.column_stack([-states[:-1, 1], turning[:-1], np.ones(len(times) - 1)])
        (alpha, kappa, _), *_ = np.linalg.lstsq(gone, np.diff(states[:, 1]), rcond=None)
        alpha = max(alpha, 0.01)
        levels[3:5] = alpha, kappa
        turns = np.array([0.3 * alpha, 0.3 * abs(kappa), alpha, 0.3 * alpha * abs(kappa)])
        levels = fitted(levels, np.array([0.5, 0.5, 1.0, *turns[:2], 0, 0]))
        levels = fitted(levels, np.array([0.2, 0.2, -0.5, *turns]))
    _, states, factor = equations.solve(levels)
    others = np.empty((len(times), 2))
    seen = equations.seen
    for half in (0, 1):
        equations.seen = seen.copy()
        equations.seen[half::2] = False
        others[half::2] = equations.solve(levels)[1][half::2, :2]
    noise = np.exp(levels[:2])
    acceleration = -levels[3] * states[:, 1] + levels[4] * turning + states[:, 2]
    return SmoothHeading(
        times,
        states[:, 0] + middle,
        states[:, 1] / step,
        acceleration / step**2,
        float(noise[0]),
        float(noise[1] / step) if known else np.nan,
        others * [1.0, 1 / step] + [middle, 0.0],
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
