r"""A course law read from a record: its heading smoothed, its rudder followed, its changes found.

**Heading and yaw rate without the noise of their sensors** (:func:`smooth_heading`). The two are
smoothed together, since one is the derivative of the other:

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

**A rudder that follows its order at a limited rate and angle** (:func:`fit_machine`),

.. math::
    w_k = \Phi_k \beta, \qquad
    \delta_k = \mathrm{clip}\big(\mathrm{clip}(w_k, \pm\delta_\mathrm{max}),\;
        \delta_{k-1} \pm \dot\delta_\mathrm{max} (t_k - t_{k-1})\big) ,

with the regressors :math:`\Phi` of the law. :math:`\beta`, the first rudder, the rate and the
limit make the sum of squares of logged minus followed rudder least. Standard errors are raised by
:math:`\sqrt{(1 + \rho) / (1 - \rho)}` for residuals with the correlation :math:`\rho` from sample
to sample.

**The law** (:func:`fit_course_law`),

.. math::
    w_k = \delta_0 + K_p (\psi_\mathrm{ref}(t_k) - \psi_k) - K_d r_k ,

is driven by the logged heading and yaw rate: as they were logged, where the law saw the sensors'
noise, or smoothed, where it did not; whichever leaves less of the rudder. An ordered course that
is not given is piecewise constant: changes are found one by one by regression of the samples off
the rate limit, then taken away again while the information criterion does not mind.

What the same changes alone explain is no merit of heading and yaw rate. A law is accepted if
they explain half of the rest, with a gain that turns the ship back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, expm
from scipy.optimize import least_squares, minimize

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
    >>> from oed_sysid.physics.channels import Channels, Input, Output
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


# Residuals below this are rounding, rad.
LEAST_RESIDUAL = 1e-6


@dataclass(frozen=True, eq=False)
class Followed:
    """Logged rudder, explained.

    Attributes
    ----------
    law : ndarray (n_regressors,)
        Coefficients of the order.
    first, rate, limit : float
        First rudder, rad; largest rate, rad/s, and angle, rad, or inf.
    covariance : ndarray (n_regressors + 2, n_regressors + 2)
        Of the law, the rate and the limit; zero for those that are not fitted.
    residuals : ndarray (n_times,)
        Logged minus followed rudder, rad.
    """

    law: np.ndarray
    first: float
    rate: float
    limit: float
    covariance: np.ndarray = field(repr=False)
    residuals: np.ndarray = field(repr=False)

    @property
    def squares(self) -> float:
        """Sum of squares of the residuals, those of rounding included."""
        return float((self.residuals**2).sum()) + len(self.residuals) * LEAST_RESIDUAL**2

    @property
    def n_parameters(self) -> int:
        """How many numbers were fitted."""
        return len(self.law) + 1 + math.isfinite(self.rate) + math.isfinite(self.limit)

    @property
    def memory(self) -> float:
        """Correlation of the residuals from sample to sample."""
        return correlation(self.residuals)

    def criterion(self, n_changes: int = 0) -> float:
        """Bayesian information criterion; each time of a change is one more number."""
        n = len(self.residuals)
        return n * math.log(self.squares / n) + (self.n_parameters + n_changes) * math.log(n)


def follow(
    orders: np.ndarray, times: np.ndarray, first: float, rate: float, limit: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rudder that follows orders.

    Returns
    -------
    rudder : ndarray (n_times,)
        rad.
    origin : ndarray of int (n_times,)
        Sample at which the rudder last was where it was ordered; -1 where not yet.
    moved : ndarray (n_times,)
        Time at the largest rate since then, with its sign, s.
    """
    wanted = np.clip(orders, -limit, limit)
    if math.isinf(rate):
        rudder = wanted.copy()
        rudder[0] = first
        origin = np.arange(len(times))
        origin[0] = -1
        return rudder, origin, np.zeros(len(times))
    reached, origins, moved = [first], [-1], [0.0]
    last, since, total = first, -1, 0.0
    steps = np.diff(times).tolist()
    for k, (order, step) in enumerate(zip(wanted[1:].tolist(), steps, strict=True), start=1):
        change = order - last
        if abs(change) <= rate * step:
            last, since, total = order, k, 0.0
        else:
            ahead = math.copysign(step, change)
            last, total = last + rate * ahead, total + ahead
        reached.append(last)
        origins.append(since)
        moved.append(total)
    return np.array(reached), np.array(origins), np.array(moved)


def fit_machine(
    regressors: np.ndarray,
    times: np.ndarray,
    rudder: np.ndarray,
    *,
    law: np.ndarray,
    rate: float = math.inf,
    limit: float = math.inf,
    first: float | None = None,
    n_steps: int = 60,
) -> Followed:
    """Fit law, first rudder and, where they are finite, rate and limit to a logged rudder.

    Parameters
    ----------
    regressors : ndarray (n_times, n_regressors)
        The order is their product with the law.
    times, rudder : ndarray (n_times,)
        s and rad.
    law : ndarray (n_regressors,)
        Start values.
    rate, limit : float
        Start values, rad/s and rad; inf where there is none.
    first : float, optional
        Start value, rad; the first sample by default.
    n_steps : int
        Most evaluations.
    """
    n = regressors.shape[1]
    rated, limited = math.isfinite(rate), math.isfinite(limit)

    def parts(values: np.ndarray) -> tuple[np.ndarray, float, float, float]:
        """Law, first rudder, rate and limit."""
        more = list(values[n + 1 :])
        allowed = abs(more.pop(0)) if rated else math.inf
        return values[:n], float(values[n]), allowed, abs(more.pop(0)) if limited else math.inf

    def errors(values: np.ndarray) -> np.ndarray:
        beta, begin, allowed, most = parts(values)
        return follow(regressors @ beta, times, begin, allowed, most)[0] - rudder

    def slopes(values: np.ndarray) -> np.ndarray:
        beta, begin, allowed, most = parts(values)
        orders = regressors @ beta
        _, origin, moved = follow(orders, times, begin, allowed, most)
        free = (origin >= 0) & (np.abs(orders[origin]) < most)
        table = np.zeros((len(times), len(values)))
        table[:, :n] = regressors[origin] * free[:, None]
        table[:, n] = origin < 0
        if rated:
            table[:, n + 1] = moved
        if limited:
            table[:, -1] = np.sign(orders[origin]) * ((origin >= 0) & ~free)
        return table

    start = [*law, rudder[0] if first is None else first]
    start += [rate] * rated + [limit] * limited
    found = least_squares(errors, start, jac=slopes, x_scale="jac", max_nfev=n_steps)
    beta, begin, allowed, most = parts(found.x)
    whole = _covariance(found.jac, found.fun)
    position = [*range(n)]
    covariance = np.zeros((n + 2, n + 2))
    into = [*range(n)]
    if rated:
        position.append(n + 1)
        into.append(n)
    if limited:
        position.append(len(found.x) - 1)
        into.append(n + 1)
    covariance[np.ix_(into, into)] = whole[np.ix_(position, position)]
    return Followed(beta, begin, allowed, most, covariance, -found.fun)


def _covariance(jacobian: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """Covariance of least squares with correlated residuals."""
    count = jacobian.shape[1]
    size = np.sqrt((jacobian**2).sum(axis=0))
    size = np.where(size > 0, size, 1.0)
    scaled = jacobian / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    return variance(residuals, count) * inverse / np.outer(size, size)


def variance(residuals: np.ndarray, n_parameters: int) -> float:
    """Variance of residuals, raised as if fewer of them were independent: AR(1)."""
    n = len(residuals)
    whole = float((residuals**2).sum()) / max(n - n_parameters, 1)
    memory = np.clip(correlation(residuals), 0.0, 0.95)
    return whole * float((1 + memory) / (1 - memory))


def correlation(residuals: np.ndarray) -> float:
    """Correlation of residuals from sample to sample."""
    size = float((residuals**2).sum())
    return float(residuals[1:] @ residuals[:-1]) / size if size > 0 else 0.0


# Share of what changes of course leave that heading and yaw rate have to explain.
LEAST_EXPLAINED = 0.5


# Share of the variance that changes alone have to leave; a zigzag's rudder is all changes.
LEAST_LEFT = 0.1


# Standard errors from which on a sign is one.
SIGNIFICANT = 2.0


# Share of the largest rate from which on a start value counts a sample as limited.
AT_RATE = 0.75


# Samples that a course is held at least, and that a law needs.
LEAST_HELD = 16


LEAST_SAMPLES = 20


# A change of course has to lower the sum of squares by this share, and by this of the rudder's.
LEAST_GAIN = 0.25


LEAST_OF_RUDDER = 1e-3


# A rudder that moves less than this is constant, rad.
CONSTANT = 1e-4


# Times at which a change is sought, at most.
MOST_TIMES = 400


@dataclass(frozen=True, eq=False)
class CourseFit:
    """A law read from a record.

    Attributes
    ----------
    followed : Followed
        Law ``gain, damping, level`` and the level's changes, or with given courses
        ``gain, damping, neutral``.
    changes : tuple of int
        Samples at which the level changes.
    sees_noise : bool
        Whether the law saw the logged noise of the sensors.
    explained, beyond_changes : float
        Share of the rudder's variance that the law explains, and of what changes alone leave.
    """

    followed: Followed
    changes: tuple[int, ...]
    sees_noise: bool
    explained: float
    beyond_changes: float
    smooth: SmoothHeading = field(repr=False)


def fit_course_law(
    record: Record,
    input: str,
    *,
    heading: str,
    yaw_rate: str,
    courses: np.ndarray | None,
    most_changes: int,
) -> CourseFit:
    """Fit the law; see :meth:`oed_sysid.prediction.laws.CourseControl.of`."""
    rudder, times = record.input(input), record.times
    record.output(yaw_rate)
    if len(times) < LEAST_SAMPLES:
        raise DataError(
            f"Record {record.name!r} has {len(times)} samples; a law needs {LEAST_SAMPLES}. Give "
            "the law, or take a longer record."
        )
    if np.ptp(rudder) < CONSTANT:
        raise DataError(
            f"Input {input!r} of record {record.name!r} is constant: no helmsman held a course "
            "with it. Replay the logged input, or give the law."
        )
    smooth = smooth_heading(record, input, heading=heading, yaw_rate=yaw_rate)
    clean = (smooth.heading, smooth.yaw_rate)
    logged = tuple(
        np.where(np.isfinite(record.output(name)), record.output(name), series)
        for name, series in zip((heading, yaw_rate), clean, strict=True)
    )
    found = []
    for sees_noise, (psi, r) in ((True, logged), (False, clean)):
        columns = np.column_stack([-psi, -r] if courses is None else [courses - psi, -r])
        followed, changes = _fit(columns, times, rudder, 0 if courses is not None else most_changes)
        found.append((followed.criterion(len(changes)), sees_noise, followed, changes))
    _, sees_noise, followed, changes = min(found, key=lambda one: one[0])
    if not sees_noise:
        measured = np.column_stack([record.output(heading), record.output(yaw_rate)])
        ordered = np.zeros((len(times), 2))
        if courses is not None:
            ordered[:, 0] = courses
        followed = _instrumented(
            followed, changes, ordered - measured, ordered - smooth.others, times, rudder
        )
    # Changes alone: the same number of them and a rate, without heading and yaw rate.
    nothing = np.empty((len(times), 0)) if courses is None else courses[:, None]
    alone, _ = _fit(nothing, times, rudder, len(changes), all_of_them=True)
    whole = float(((rudder - rudder.mean()) ** 2).sum())
    fit = CourseFit(
        followed,
        changes,
        sees_noise,
        1 - followed.squares / max(whole, 1e-300),
        1 - followed.squares / alone.squares,
        smooth,
    )
    if alone.squares < LEAST_LEFT * whole:
        raise DataError(
            f"{len(changes)} steps of the rudder alone explain "
            f"{100 * (1 - alone.squares / whole):.0f} % of {input!r} in record {record.name!r}: it "
            "was stepped, as in a zigzag or an open-loop manoeuvre, and no helmsman held a course "
            "there. Use ZigzagControl, or replay the logged input."
        )
    _check(fit, record, input, rudder)
    return fit


def _check(fit: CourseFit, record: Record, input: str, rudder: np.ndarray) -> None:
    """Refuse what is no course law."""
    advice = "Give the law, or replay the logged input."
    where = f"of {input!r} in record {record.name!r}"
    share = min(fit.beyond_changes, fit.explained)
    if not share >= LEAST_EXPLAINED:
        raise DataError(
            f"Heading and yaw rate explain {100 * max(share, 0):.0f} % {where} beyond "
            f"{len(fit.changes)} changes of course, {100 * LEAST_EXPLAINED:.0f} % are needed: no "
            f"helmsman held a course there. {advice}"
        )
    side = math.copysign(1.0, fit.smooth.effect)
    errors = np.sqrt(np.diag(fit.followed.covariance)[:2])
    (gain, damping), (gain_error, damping_error) = side * fit.followed.law[:2], errors
    if abs(gain) < SIGNIFICANT * gain_error:
        raise DataError(
            f"The gain {where} is {fit.followed.law[0]:.3g} with a standard error of "
            f"{gain_error:.2g}: the record does not determine it. Take one in which the course is "
            "changed, or give the law."
        )
    if gain <= 0:
        raise DataError(
            f"The gain {where} is {fit.followed.law[0]:.3g} with a standard error of "
            f"{gain_error:.2g}: this rudder does not turn the ship back to a course. {advice}"
        )
    if damping < -SIGNIFICANT * damping_error:
        raise DataError(
            f"The damping {where} is {fit.followed.law[1]:.3g} s with a standard error of "
            f"{damping_error:.2g} s, of the sign that drives the turn: no helmsman held a course "
            f"there. {advice}"
        )


def _instrumented(
    followed: Followed,
    changes: tuple[int, ...],
    measured: np.ndarray,
    others: np.ndarray,
    times: np.ndarray,
    rudder: np.ndarray,
) -> Followed:
    """Law by instrumental variables where the rudder is off its limits.

    The measured columns hold noise that the law did not see; the instruments, smoothed from
    other samples, do not, and so do not attenuate, however good the smoother's model is
    (Soderstrom & Stoica, *System Identification*, 1989, chapter 8).
    """
    table, instruments = _levels(measured, changes), _levels(others, changes)
    orders = rudder - followed.residuals
    _, origin, _ = follow(
        _levels(others, changes) @ followed.law,
        times,
        followed.first,
        followed.rate,
        followed.limit,
    )
    off = (origin == np.arange(len(times))) & np.isfinite(measured).all(axis=1)
    off &= np.abs(orders) < 0.99 * followed.limit
    if off.sum() < LEAST_SAMPLES or np.linalg.matrix_rank(instruments[off]) < table.shape[1]:
        return followed
    table, instruments = table[off], instruments[off]
    inverse = np.linalg.pinv(instruments.T @ table)
    law = inverse @ (instruments.T @ rudder[off])
    covariance = followed.covariance.copy()
    n = len(law)
    covariance[:n] = covariance[:, :n] = 0.0
    spread = variance(rudder[off] - table @ law, n)
    covariance[:n, :n] = spread * inverse @ (instruments.T @ instruments) @ inverse.T
    return replace(followed, law=law, covariance=covariance)


def _fit(
    columns: np.ndarray,
    times: np.ndarray,
    rudder: np.ndarray,
    most_changes: int,
    *,
    all_of_them: bool = False,
) -> tuple[Followed, tuple[int, ...]]:
    """Fit with the rate limit that explains the rudder best, or none."""
    starts = _rates(times, rudder)
    sought = []
    for changes in {_seek_changes(columns, rudder, off, most_changes) for _, off in starts}:
        followed = _best_rate(columns, times, rudder, changes, starts)
        sought.append(_refine(columns, times, rudder, changes, followed))
    followed, changes = min(sought, key=lambda one: one[0].squares)
    whole = float(((rudder - rudder.mean()) ** 2).sum())
    best = (followed.criterion(len(changes)), followed, changes)
    while changes and not all_of_them:
        # Without the change that matters least.
        fewer = [(*changes[:i], *changes[i + 1 :]) for i in range(len(changes))]
        tried = [(_without(columns, times, rudder, some, followed), some) for some in fewer]
        followed, changes = min(tried, key=lambda one: one[0].squares)
        again = _best_rate(columns, times, rudder, changes, starts)
        followed = min(followed, again, key=lambda one: one.squares)
        followed, changes = _refine(columns, times, rudder, changes, followed)
        value = followed.criterion(len(changes))
        lost = followed.squares - best[1].squares
        negligible = lost < LEAST_GAIN * followed.squares or lost < LEAST_OF_RUDDER * whole
        if value <= best[0] or negligible:
            best = (value, followed, changes)
    followed, changes = best[1:]
    limit = float(np.abs(rudder).max()) - rudder_noise(rudder)
    if (np.abs(rudder) > 0.97 * limit).sum() > 3:
        table = _levels(columns, changes)
        more = fit_machine(table, times, rudder, law=followed.law, rate=followed.rate, limit=limit)
        followed = min(followed, more, key=lambda one: one.criterion())
    return followed, changes


def _best_rate(
    columns: np.ndarray,
    times: np.ndarray,
    rudder: np.ndarray,
    changes: tuple[int, ...],
    starts: list[tuple[float, np.ndarray]],
) -> Followed:
    """Fit from each start value of the rate, the law by regression off it."""
    table = _levels(columns, changes)
    found = []
    for rate, off in starts:
        law, *_ = np.linalg.lstsq(table[off], rudder[off], rcond=None)
        found.append(fit_machine(table, times, rudder, law=law, rate=rate, n_steps=12))
    return min(found, key=lambda one: one.squares)


def _without(
    columns: np.ndarray,
    times: np.ndarray,
    rudder: np.ndarray,
    changes: tuple[int, ...],
    followed: Followed,
) -> Followed:
    """Fit with fewer changes, quickly."""
    table = _levels(columns, changes)
    orders = rudder - followed.residuals
    law, *_ = np.linalg.lstsq(table, orders, rcond=None)
    law[: columns.shape[1]] = followed.law[: columns.shape[1]]
    return fit_machine(table, times, rudder, law=law, rate=followed.rate, n_steps=6)


def _rates(times: np.ndarray, rudder: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Start values of the rate, and the samples off that limit; no limit first."""
    noise = rudder_noise(rudder)
    step = float(np.median(np.diff(times)))
    free = np.ones(len(times), dtype=bool)
    free[0] = False
    rates: list[tuple[float, np.ndarray]] = [(math.inf, free)]
    # Over so many samples a slope stands out of the noise.
    largest = float(np.quantile(np.abs(np.diff(rudder)), 0.98))
    width = int(np.clip(math.ceil((10 * noise / max(largest, 1e-12)) ** (2 / 3)), 1, 20))
    slope = np.abs(rudder[width:] - rudder[:-width]) / (times[width:] - times[:-width])
    for share in (1.0, 0.98, 0.9):
        rate = float(np.quantile(slope, share))
        at = np.flatnonzero(slope > AT_RATE * rate)
        off = free.copy()
        for k in at:
            off[k + 1 : k + width + 1] = False
        if (
            (rate, width) not in [(r, width) for r, _ in rates]
            and rate * step > noise / 3
            and off.sum() > LEAST_SAMPLES
            and rate > 0
        ):
            rates.append((rate, off))
    return rates


def _levels(columns: np.ndarray, changes: tuple[int, ...]) -> np.ndarray:
    """Regressors of the law: columns, a level, and a step at each change."""
    index = np.arange(len(columns))[:, None]
    steps = (index >= np.array([0, *changes])[None, :]).astype(float)
    return np.hstack([columns, steps])


def _seek_changes(
    columns: np.ndarray, rudder: np.ndarray, off: np.ndarray, most: int
) -> tuple[int, ...]:
    """Find changes of the level one by one, each where it lowers the sum of squares most."""
    n = len(rudder)
    stride = max(n // MOST_TIMES, 1)
    times = np.arange(LEAST_HELD // 2, n - LEAST_HELD // 2, stride)
    steps = (np.arange(n)[off][:, None] >= times[None, :]).astype(float)
    changes: list[int] = []
    while len(changes) < most:
        allowed = np.all([np.abs(times - c) >= LEAST_HELD for c in changes], axis=0)
        base, _ = np.linalg.qr(_levels(columns, tuple(changes))[off])
        left = rudder[off] - base @ (base.T @ rudder[off])
        across = steps - base @ (base.T @ steps)
        size = (across**2).sum(axis=0)
        value = np.where((size > 1e-6) & allowed, (left @ across) ** 2 / (size + 1e-12), 0.0)
        if value.max() <= 0:
            break
        changes = sorted([*changes, int(times[value.argmax()])])
    return tuple(changes)


def _refine(
    columns: np.ndarray,
    times: np.ndarray,
    rudder: np.ndarray,
    changes: tuple[int, ...],
    best: Followed,
) -> tuple[Followed, tuple[int, ...]]:
    """Fit the rudder machine, its changes moved sample by sample to where they fit best."""
    reach = [1, 2, 3, 5, 8, 13, 20]
    for _ in range(4):
        moved = list(changes)
        for i, now in enumerate(changes):
            squares = []
            for shift in (0, *reach, *(-s for s in reach)):
                moved[i] = now + shift
                bounds = [0, *moved, len(times)]
                if shift and min(np.diff(bounds)) < LEAST_HELD // 2:
                    continue
                orders = _levels(columns, tuple(moved)) @ best.law
                followed, *_ = follow(orders, times, best.first, best.rate, math.inf)
                squares.append((float(((followed - rudder) ** 2).sum()), abs(shift), now + shift))
            moved[i] = min(squares)[2]
        if tuple(moved) == changes:
            break
        table = _levels(columns, tuple(moved))
        again = fit_machine(
            table, times, rudder, law=best.law, rate=best.rate, first=best.first, n_steps=30
        )
        if again.squares >= best.squares:
            break
        best, changes = again, tuple(moved)
    return best, changes
