r"""The course law that a logged rudder follows, and how much of the rudder it explains.

.. math::
    w_k = \delta_0 + K_p (\psi_\mathrm{ref}(t_k) - \psi_k) - K_d r_k ,

followed by a rudder of limited rate and angle (:mod:`oed_sysid.predictions.rudder_machine`) that
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

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError
from oed_sysid.predictions.rudder_machine import Followed, fit_machine, follow, variance
from oed_sysid.predictions.smooth_heading import SmoothHeading, rudder_noise, smooth_heading

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
    """Fit the law; see :meth:`oed_sysid.predictions.course_control.CourseControl.of`."""
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
