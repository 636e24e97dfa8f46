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

**A rudder that follows its order at a limited rate and angle** (:class:`_Machine`),

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
from operator import attrgetter

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded, expm
from scipy.optimize import least_squares, minimize

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError
from oed_sysid.likelihood.noise_levels import fast_level
from oed_sysid.likelihood.projection import inverse_of
from oed_sysid.runtime.display import TWO_SIDED_95

# Noise below this is none: rad, and rad per sample.
LEAST_NOISE = 1e-7
# Headings that can be smoothed, samples that a law needs and that a course is held at least.
LEAST_SAMPLES = 16
# Bounds of the logarithms of three levels of noise, and of alpha, kappa, gamma and lambda, per
# step: noise that is not nothing, and a ship that does not explode.
BOUNDS = np.array(
    [[np.log(LEAST_NOISE)] * 3 + [0.0, -np.inf, 0.0, -np.inf], [np.inf] * 3 + [2.0, np.inf] * 2]
)


@dataclass(frozen=True, eq=False)
class SmoothHeading:
    """Smoothed series.

    Attributes
    ----------
    times, heading, yaw_rate, acceleration : ndarray (n_times,)
        s, rad, rad/s, rad/s^2.
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
        for i, j in np.ndindex(3, 3):
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
        If fewer than 16 headings were measured.

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
    if np.isfinite(psi).sum() < LEAST_SAMPLES:
        raise DataError(
            f"Record {record.name!r} has {np.isfinite(psi).sum()} samples of {heading!r}; a law of "
            f"steering needs {LEAST_SAMPLES}. Give the law."
        )
    known = yaw_rate in record.channels.output_names
    step = float(np.median(np.diff(times)))
    turned = step * record.output(yaw_rate) if known else np.full(len(times), np.nan)
    middle = float(np.nanmedian(psi))
    turning = record.input(rudder)
    equations = _Equations(times, psi - middle, turned, turning)

    def fitted(first: np.ndarray, *sizes: float) -> np.ndarray:
        """Levels of the largest likelihood; those of size zero stay."""
        free = np.array(sizes) != 0
        moved = np.array(sizes)[free]
        simplex = first[free] + np.vstack([np.zeros(len(moved)), np.diag(moved)])
        start = first.copy()

        def value(some: np.ndarray) -> float:
            start[free] = some
            return equations.solve(np.clip(start, *BOUNDS))[0]

        options = {"xatol": 1e-2, "fatol": 1e-2, "maxfev": 600, "initial_simplex": simplex}
        start[free] = minimize(value, first[free], method="Nelder-Mead", options=options).x
        return np.clip(start, *BOUNDS)

    shown = [fast_level([psi], 3), fast_level([turned], 2), 0.1 * fast_level([np.diff(psi)], 1)]
    least = [10 * LEAST_NOISE] * 2 + [LEAST_NOISE]
    guess = np.log(np.maximum(np.nan_to_num(shown, nan=1.0), least))
    levels = fitted(np.array([*guess, 0, 0, 0, 0]), 1.5, 1.5, 1.5, 0, 0, 0, 0)
    if np.ptp(turning) > 0:
        _, states, _ = equations.solve(levels)
        gone = np.column_stack([-states[:-1, 1], turning[:-1], np.ones(len(times) - 1)])
        (alpha, kappa, _), *_ = np.linalg.lstsq(gone, np.diff(states[:, 1]), rcond=None)
        alpha = max(alpha, 0.01)
        levels[3:5] = alpha, kappa
        turns = np.array([0.3 * alpha, 0.3 * abs(kappa), alpha, 0.3 * alpha * abs(kappa)])
        levels = fitted(levels, 0.5, 0.5, 1.0, *turns[:2], 0, 0)
        levels = fitted(levels, 0.2, 0.2, -0.5, *turns)
    _, states, factor = equations.solve(levels)
    others = np.empty((len(times), 2))
    seen = equations.seen
    for half in (0, 1):
        equations.seen = seen.copy()
        equations.seen[half::2] = False
        others[half::2] = equations.solve(levels)[1][half::2, :2]
    acceleration = -levels[3] * states[:, 1] + levels[4] * turning + states[:, 2]
    return SmoothHeading(
        times, states[:, 0] + middle, states[:, 1] / step, acceleration / step**2,
        others * [1.0, 1 / step] + [middle, 0.0], float(levels[4] / step**2), factor,
    )  # fmt: skip


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
    changes : tuple of int
        Samples at which the level of the law changes.
    """

    law: np.ndarray
    first: float
    rate: float
    limit: float
    covariance: np.ndarray = field(repr=False)
    residuals: np.ndarray = field(repr=False)
    changes: tuple[int, ...] = ()

    @property
    def squares(self) -> float:
        """Sum of squares of the residuals, those of rounding included."""
        return float((self.residuals**2).sum()) + len(self.residuals) * LEAST_RESIDUAL**2

    @property
    def criterion(self) -> float:
        """Bayesian information criterion; each time of a change is one more number."""
        n = len(self.residuals)
        fitted = len(self.law) + 1 + math.isfinite(self.rate) + math.isfinite(self.limit)
        return n * math.log(self.squares / n) + (fitted + len(self.changes)) * math.log(n)


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
    path = [(first, -1, 0.0)]
    steps = np.diff(times).tolist()
    for k, (order, step) in enumerate(zip(wanted[1:].tolist(), steps, strict=True), start=1):
        last, since, total = path[-1]
        change = order - last
        ahead = math.copysign(step, change)
        free = abs(change) <= rate * step
        path.append((order, k, 0.0) if free else (last + rate * ahead, since, total + ahead))
    rudder, origin, moved = zip(*path, strict=True)
    return np.array(rudder), np.array(origin), np.array(moved)


def variance(residuals: np.ndarray, n_parameters: int) -> float:
    """Variance of residuals, raised as if fewer of them were independent: AR(1)."""
    whole = float((residuals**2).sum()) / max(len(residuals) - n_parameters, 1)
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
# Share of the largest rate from which on a start value counts a sample as limited.
AT_RATE = 0.75
# A change of course has to lower the sum of squares by this share, and by this of the rudder's.
LEAST_GAIN = 0.25
# The second share, of the whole sum of squares of the rudder.
LEAST_OF_RUDDER = 1e-3
# A rudder that moves less than this is constant, rad.
CONSTANT = 1e-4


def fit_course_law(
    record: Record,
    input: str,
    *,
    heading: str,
    yaw_rate: str,
    courses: np.ndarray | None,
    most_changes: int,
) -> tuple[Followed, bool, float]:
    """Fit the law; see :meth:`problems.kvlcc2.closed_loop.CourseControl.of`.

    Returns
    -------
    followed : Followed
        Its law is ``gain, damping, level`` and the level's changes, or with given courses
        ``gain, damping, neutral``.
    sees_noise : bool
        Whether the law saw the logged noise of the sensors.
    explained : float
        Share of the rudder's variance that the law explains.
    """
    rudder, times = record.input(input), record.times
    measured = np.column_stack([record.output(heading), record.output(yaw_rate)])
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
    clean = np.column_stack([smooth.heading, smooth.yaw_rate])
    ordered = np.zeros((len(times), 2))
    if courses is not None:
        ordered[:, 0], most_changes = courses, 0
    fits = []
    for seen in (np.where(np.isfinite(measured), measured, clean), clean):
        machine = _Machine(ordered - seen, times, rudder)
        fits.append((machine, machine.fitted(most_changes)))
    machine, followed = min(fits, key=lambda one: one[1].criterion)
    sees_noise = machine is fits[0][0]
    if not sees_noise:
        others = replace(machine, columns=ordered - smooth.others)
        followed = others.instrumented(followed, ordered - measured)
    changes = followed.changes
    # Changes alone: the same number of them and a rate, without heading and yaw rate.
    without = replace(machine, columns=ordered[:, : int(courses is not None)])
    alone = without.fitted(len(changes), all_of_them=True).squares
    whole = machine.whole
    if alone < LEAST_LEFT * whole:
        raise DataError(
            f"{len(changes)} steps of the rudder alone explain {100 * (1 - alone / whole):.0f} % "
            f"of {input!r} in record {record.name!r}: it was stepped, as in a zigzag or an "
            "open-loop manoeuvre, and no helmsman held a course there. Use ZigzagControl, or "
            "replay the logged input."
        )
    explained = 1 - followed.squares / max(whole, 1e-300)
    where = f"of {input!r} in record {record.name!r}"
    share = min(1 - followed.squares / alone, explained)
    if not share >= LEAST_EXPLAINED:
        raise DataError(
            f"Heading and yaw rate explain {100 * max(share, 0):.0f} % {where} beyond "
            f"{len(changes)} changes of course, {100 * LEAST_EXPLAINED:.0f} % are needed: no "
            f"helmsman held a course there. {ADVICE}"
        )
    _check(followed, math.copysign(1.0, smooth.effect), where)
    return followed, sees_noise, explained


ADVICE = "Give the law, or replay the logged input."


def _check(followed: Followed, side: float, where: str) -> None:
    """Refuse gains that hold no course with a rudder that turns the ship to a side."""
    gain, damping = side * followed.law[:2]
    errors = np.sqrt(np.diag(followed.covariance)[:2])
    said = f"The gain {where} is {followed.law[0]:.3g} with a standard error of {errors[0]:.2g}:"
    if abs(gain) < TWO_SIDED_95 * errors[0]:
        raise DataError(
            f"{said} the record does not determine it. Take one in which the course is changed, or "
            "give the law."
        )
    if gain <= 0:
        raise DataError(f"{said} this rudder does not turn the ship back to a course. {ADVICE}")
    if damping < -TWO_SIDED_95 * errors[1]:
        raise DataError(
            f"The damping {where} is {followed.law[1]:.3g} s with a standard error of "
            f"{errors[1]:.2g} s, of the sign that drives the turn: no helmsman held a course "
            f"there. {ADVICE}"
        )


@dataclass(frozen=True, eq=False)
class _Machine:
    """A logged rudder, and the columns that are to explain it beside a level that changes."""

    columns: np.ndarray
    times: np.ndarray
    rudder: np.ndarray

    @property
    def whole(self) -> float:
        """Sum of squares of the rudder about its mean."""
        return float(((self.rudder - self.rudder.mean()) ** 2).sum())

    def table(self, changes: tuple[int, ...]) -> np.ndarray:
        """Regressors of the law: columns, a level, and a step at each change."""
        index = np.arange(len(self.columns))[:, None]
        return np.hstack([self.columns, (index >= np.array([0, *changes])).astype(float)])

    def fit(
        self,
        changes: tuple[int, ...],
        law: np.ndarray,
        rate: float,
        *,
        limit: float = math.inf,
        first: float | None = None,
        n_steps: int = 60,
    ) -> Followed:
        """Fit law, first rudder and, where they are finite, rate and limit from start values."""
        table, n = self.table(changes), len(law)
        start = np.array([*law, self.rudder[0] if first is None else first, rate, limit])
        free = np.isfinite(start)

        def parts(some: np.ndarray) -> np.ndarray:
            """Law, first rudder, rate and limit."""
            values = start.copy()
            values[free] = some
            return np.append(values[: n + 1], np.abs(values[n + 1 :]))

        def errors(some: np.ndarray) -> np.ndarray:
            values = parts(some)
            return follow(table @ values[:n], self.times, *values[n:])[0] - self.rudder

        def slopes(some: np.ndarray) -> np.ndarray:
            values = parts(some)
            orders = table @ values[:n]
            _, origin, moved = follow(orders, self.times, *values[n:])
            begun = origin >= 0
            inside = begun & (np.abs(orders[origin]) < values[-1])
            at_limit = np.sign(orders[origin]) * (begun & ~inside)
            law_by = table[origin] * inside[:, None]
            return np.column_stack([law_by, ~begun, moved, at_limit])[:, free]

        found = least_squares(errors, start[free], jac=slopes, x_scale="jac", max_nfev=n_steps)
        # Standard errors for correlated residuals.
        spread = variance(found.fun, len(found.x))
        covariance = np.zeros((len(start), len(start)))
        covariance[np.ix_(free, free)] = spread * inverse_of(found.jac.T @ found.jac)
        kept = [*range(n), n + 1, n + 2]
        values = parts(found.x)
        own, (begin, rate, limit) = values[:n], map(float, values[n:])
        covariance = covariance[np.ix_(kept, kept)]
        return Followed(own, begin, rate, limit, covariance, -found.fun, changes)

    def fitted(self, most_changes: int, *, all_of_them: bool = False) -> Followed:
        """Fit with the rate limit that explains the rudder best, or none, and with changes."""
        starts, squares = self.rates(), attrgetter("squares")
        sought = {self.seek_changes(off, most_changes) for _, off in starts}
        tried = [self.refined(self.best_rate(changes, starts)) for changes in sought]
        best = followed = min(tried, key=squares)
        while (changes := followed.changes) and not all_of_them:
            # Without the change that matters least.
            fewer = [(*changes[:i], *changes[i + 1 :]) for i in range(len(changes))]
            followed = min((self.without(some, followed) for some in fewer), key=squares)
            again = self.best_rate(followed.changes, starts)
            followed = self.refined(min(followed, again, key=squares))
            lost = followed.squares - best.squares
            least = max(LEAST_GAIN * followed.squares, LEAST_OF_RUDDER * self.whole)
            if followed.criterion <= best.criterion or lost < least:
                best = followed
        limit = float(np.abs(self.rudder).max()) - fast_level([self.rudder])
        if (np.abs(self.rudder) > 0.97 * limit).sum() > 3:
            more = self.fit(best.changes, best.law, best.rate, limit=limit)
            best = min(best, more, key=attrgetter("criterion"))
        return best

    def best_rate(
        self, changes: tuple[int, ...], starts: list[tuple[float, np.ndarray]]
    ) -> Followed:
        """Fit from each start value of the rate, the law by regression off it."""
        table = self.table(changes)
        found = []
        for rate, off in starts:
            law, *_ = np.linalg.lstsq(table[off], self.rudder[off], rcond=None)
            found.append(self.fit(changes, law, rate, n_steps=12))
        return min(found, key=attrgetter("squares"))

    def without(self, changes: tuple[int, ...], followed: Followed) -> Followed:
        """Fit with fewer changes, quickly."""
        n = self.columns.shape[1]
        orders = self.rudder - followed.residuals
        law, *_ = np.linalg.lstsq(self.table(changes), orders, rcond=None)
        return self.fit(changes, np.append(followed.law[:n], law[n:]), followed.rate, n_steps=6)

    def rates(self) -> list[tuple[float, np.ndarray]]:
        """Start values of the rate, and the samples off that limit; no limit first."""
        times, rudder = self.times, self.rudder
        noise = fast_level([rudder])
        free = np.arange(len(times)) > 0
        found = [(math.inf, free)]
        # Over so many samples a slope stands out of the noise.
        largest = float(np.quantile(np.abs(np.diff(rudder)), 0.98))
        width = int(np.clip(math.ceil((10 * noise / max(largest, 1e-12)) ** (2 / 3)), 1, 20))
        slope = np.abs(rudder[width:] - rudder[:-width]) / (times[width:] - times[:-width])
        for rate in dict.fromkeys(np.quantile(slope, [1.0, 0.98, 0.9]).tolist()):
            off = free.copy()
            for k in np.flatnonzero(slope > AT_RATE * rate):
                off[k + 1 : k + width + 1] = False
            stands_out = rate * float(np.median(np.diff(times))) > max(noise / 3, 0.0)
            if stands_out and off.sum() > LEAST_SAMPLES:
                found.append((rate, off))
        return found

    def seek_changes(self, off: np.ndarray, most: int) -> tuple[int, ...]:
        """Find changes of the level one by one, each where it lowers the sum of squares most."""
        n, rudder = len(self.rudder), self.rudder[off]
        # At most some 400 places; what is found is moved sample by sample afterwards.
        times = np.arange(LEAST_SAMPLES // 2, n - LEAST_SAMPLES // 2, max(n // 400, 1))
        steps = (np.arange(n)[off][:, None] >= times).astype(float)
        changes: tuple[int, ...] = ()
        while len(changes) < most:
            allowed = np.all([np.abs(times - c) >= LEAST_SAMPLES for c in changes], axis=0)
            base, _ = np.linalg.qr(self.table(changes)[off])
            left = rudder - base @ (base.T @ rudder)
            across = steps - base @ (base.T @ steps)
            size = (across**2).sum(axis=0)
            value = np.where((size > 1e-6) & allowed, (left @ across) ** 2 / (size + 1e-12), 0.0)
            if value.max() <= 0:
                break
            changes = tuple(sorted([*changes, int(times[value.argmax()])]))
        return changes

    def refined(self, best: Followed) -> Followed:
        """Fit with changes that are moved sample by sample to where they fit best."""
        reach = [1, 2, 3, 5, 8, 13, 20]
        for _ in range(4):
            moved = list(best.changes)
            for i, now in enumerate(best.changes):
                squares = []
                for shift in (0, *reach, *(-s for s in reach)):
                    moved[i] = now + shift
                    if shift and min(np.diff([0, *moved, len(self.times)])) < LEAST_SAMPLES // 2:
                        continue
                    orders = self.table(tuple(moved)) @ best.law
                    rudder, *_ = follow(orders, self.times, best.first, best.rate, math.inf)
                    misfit = float(((rudder - self.rudder) ** 2).sum())
                    squares.append((misfit, abs(shift), now + shift))
                moved[i] = min(squares)[2]
            if tuple(moved) == best.changes:
                break
            again = self.fit(tuple(moved), best.law, best.rate, first=best.first, n_steps=30)
            if again.squares >= best.squares:
                break
            best = again
        return best

    def instrumented(self, followed: Followed, measured: np.ndarray) -> Followed:
        """Law by instrumental variables where the rudder is off its limits.

        The measured columns hold noise that the law did not see; the instruments, smoothed from
        other samples, do not, and so do not attenuate, however good the smoother's model is
        (Soderstrom & Stoica, *System Identification*, 1989, chapter 8).
        """
        changes = followed.changes
        table, instruments = replace(self, columns=measured).table(changes), self.table(changes)
        _, origin, _ = follow(
            instruments @ followed.law, self.times, followed.first, followed.rate, followed.limit
        )
        off = (origin == np.arange(len(self.times))) & np.isfinite(measured).all(axis=1)
        off &= np.abs(self.rudder - followed.residuals) < 0.99 * followed.limit
        table, instruments, rudder = table[off], instruments[off], self.rudder[off]
        if off.sum() < LEAST_SAMPLES or np.linalg.matrix_rank(instruments) < table.shape[1]:
            return followed
        inverse = np.linalg.pinv(instruments.T @ table)
        law = inverse @ (instruments.T @ rudder)
        n = len(law)
        covariance = followed.covariance.copy()
        covariance[:n] = covariance[:, :n] = 0.0
        spread = variance(rudder - table @ law, n)
        covariance[:n, :n] = spread * inverse @ (instruments.T @ instruments) @ inverse.T
        return replace(followed, law=law, covariance=covariance)
