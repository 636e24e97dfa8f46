"""Numbers that describe standard manoeuvres: overshoot angles, advance, tactical diameter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from oed_sysid.errors import DataError
from oed_sysid.experiments import SAYS
from oed_sysid.experiments.base import FloatArray, Numbers
from oed_sysid.runtime.constants import BEYOND, IMMATERIAL, MATERIAL
from oed_sysid.runtime.display import Report, as_dict, as_text

_FEWEST_HELD = 3  # samples that tell a level or a slope
_STEADY_ARC = math.pi / 2  # least heading change from which a steady turn is measured [rad]


@dataclass(frozen=True)
class ZigZagIndices:
    """Indices of a zigzag test; times from the record's clock [s], angles [rad].

    Parameters
    ----------
    executes : tuple of float
        Times at which the rudder began to move: first execute, second, ...
    overshoots : tuple of float
        Heading beyond that at the execute, after the second, third, ... execute.
    check_times : tuple of float
        Time from each of these executes to the largest heading.
    initial_turning_time : float
        Time from the first to the second execute.
    initial_turning_heading : float
        Heading change in that time.
    initial_turning_track : float or None
        Distance travelled in that time [m]; None without speed.
    reach : float or None
        Time from the first execute until the heading is back at its original
        value; None if the record ends before.
    period : float or None
        Time from the second to the fourth execute; None with fewer executes.

    Examples
    --------
    What :func:`~oed_sysid.experiments.indices.zigzag_indices` returns; see there.
    """

    executes: tuple[float, ...]
    overshoots: tuple[float, ...]
    check_times: tuple[float, ...]
    initial_turning_time: float
    initial_turning_heading: float
    initial_turning_track: float | None
    reach: float | None
    period: float | None

    to_dict = as_dict()

    def document(self) -> Report:
        """Return the numbers, angles in degrees."""
        overshoots = ", ".join(f"{math.degrees(angle):.2f}" for angle in self.overshoots)
        heading = math.degrees(self.initial_turning_heading)
        turning = f"{self.initial_turning_time:.2f} s to {heading:.2f} deg"
        return Report(
            "zigzag",
            head=(
                ("overshoot angles", f"{overshoots} deg"),
                ("initial turning time", turning),
                ("initial turning track", _text(self.initial_turning_track, "m")),
                ("reach", _text(self.reach, "s")),
                ("period", _text(self.period, "s")),
            ),
        )

    report = as_text


@dataclass(frozen=True)
class TurningIndices:
    """Indices of a turning circle; lengths [m], times since the execute [s], angles [rad].

    Lengths to the side of the turn are positive for port and starboard turns.

    Parameters
    ----------
    side : int
        +1 for a turn to starboard (heading grows), -1 to port.
    advance : float
        Distance along the original course when the heading has changed by 90 degrees.
    transfer : float
        Distance across the original course at that moment.
    tactical_diameter : float
        Distance across the original course at 180 degrees.
    time_90, time_180 : float
        Time to these heading changes.
    turned : float
        Largest heading change in the record.
    steady_radius : float or None
        Radius of the circle through the steady part; None if it is too short.
    steady_speed_ratio : float or None
        Speed in the steady part over that at the execute.
    drift : float or None
        Heading minus course in the steady part, positive with the bow inside
        the track.

    Examples
    --------
    What :func:`~oed_sysid.experiments.indices.turning_indices` returns; see there.
    """

    side: int
    advance: float
    transfer: float
    tactical_diameter: float
    time_90: float
    time_180: float
    turned: float
    steady_radius: float | None
    steady_speed_ratio: float | None
    drift: float | None

    @property
    def steady_diameter(self) -> float | None:
        """Twice the steady radius [m]."""
        return None if self.steady_radius is None else 2 * self.steady_radius

    to_dict = as_dict()

    def document(self) -> Report:
        """Return the numbers, angles in degrees."""
        drift = None if self.drift is None else math.degrees(self.drift)
        side, turned = "starboard" if self.side > 0 else "port", math.degrees(self.turned)
        return Report(
            f"turn to {side}, {turned:.0f} deg",
            head=(
                ("advance", f"{self.advance:.2f} m at 90 deg, {self.time_90:.2f} s"),
                ("transfer", f"{self.transfer:.2f} m at 90 deg"),
                (
                    "tactical diameter",
                    f"{self.tactical_diameter:.2f} m at 180 deg, {self.time_180:.2f} s",
                ),
                ("steady diameter", _text(self.steady_diameter, "m")),
                ("steady speed ratio", _text(self.steady_speed_ratio, "").rstrip()),
                ("drift", _text(drift, "deg")),
            ),
        )

    report = as_text


def zigzag_indices(
    times: Numbers,
    heading: Numbers,
    rudder: Numbers,
    *,
    speed: Numbers | None = None,
    execute: float | None = None,
) -> ZigZagIndices:
    """Return overshoot angles and times of a zigzag test.

    Executes are found from the rudder: the moment at which it leaves the angle
    that it held, back along its slope where it moves over several samples.
    Overshoots count from the heading at that moment, so a rudder *order* and a
    measured rudder *angle* with a slow gear agree. The largest heading is that
    of a parabola through the three samples around it.

    Parameters
    ----------
    times : array_like, shape (n_times,)
        Increasing times [s].
    heading : array_like, shape (n_times,)
        Heading [rad]; jumps by a full turn are removed.
    rudder : array_like, shape (n_times,)
        Rudder order or angle [rad], with zero as its middle.
    speed : array_like, shape (n_times,), optional
        Speed [m/s], for the distance travelled in the initial turn.
    execute : float, optional
        Time of the first execute [s]; by default found from the rudder.

    Returns
    -------
    ZigZagIndices
        The indices.

    Raises
    ------
    DataError
        If the rudder is never reversed, or the record ends before the heading
        turns back.

    References
    ----------
    IMO Resolution MSC.137(76), Annex, 4.2.5 to 4.2.8 and 5.3 (2002). ITTC
    Recommended Procedure 7.5-04-02-01, Full Scale Manoeuvring Trials.

    Examples
    --------
    A heading of constant acceleration between the executes at 0 s and 10 s:

    >>> import numpy as np
    >>> times = np.arange(0.0, 31.0)
    >>> rudder = np.where(times < 10, 0.2, -0.2)
    >>> after = times - 10
    >>> heading = np.where(after < 0, times**2, 100 + 20 * after - after**2) / 1000
    >>> result = zigzag_indices(times, heading, rudder)
    >>> print(round(result.overshoots[0], 3), round(result.check_times[0], 3))
    0.1 10.0
    """
    moments, angle, helm = columns(times, heading=heading, rudder=rudder)
    angle = np.unwrap(angle)
    executes = rudder_legs(moments, helm, first=execute).begins.tolist()
    at_execute = np.interp(executes, moments, angle)
    original = float(at_execute[0])
    # Which way the first swing went: indices are the same for port and starboard.
    side = math.copysign(1.0, at_execute[1] - original)

    peaks = list[tuple[float, float]]()
    for index, (begin, end) in enumerate(pairwise([*executes[1:], math.inf])):
        sign = side * (-1) ** index
        if (peak := summit(moments, sign * angle, begin=begin, end=end)) is None:
            break
        peaks.append((peak[1] - sign * float(at_execute[index + 1]), peak[0] - begin))
    if not peaks:
        raise DataError(SAYS["zigzag_ends"].format(end=moments[-1], reversal=executes[1]))
    overshoots, check_times = zip(*peaks, strict=True)
    track = None
    if speed is not None:
        track = travelled(moments, columns(times, speed=speed)[1], *executes[:2])
    turned_back = executes[1] + check_times[0]
    back = first_reach(moments, -side * (angle - original), 0.0, after=turned_back)
    return ZigZagIndices(
        executes=tuple(executes),
        overshoots=overshoots,
        check_times=check_times,
        initial_turning_time=executes[1] - executes[0],
        initial_turning_heading=abs(float(at_execute[1]) - original),
        initial_turning_track=track,
        reach=None if back is None else back - executes[0],
        period=executes[3] - executes[1] if len(executes) > 3 else None,
    )


def turning_indices(
    times: Numbers,
    x: Numbers,
    y: Numbers,
    heading: Numbers,
    *,
    speed: Numbers | None = None,
    execute: float | None = None,
    steady_from: float = 2 * math.pi,
) -> TurningIndices:
    """Return advance, transfer, tactical diameter and the steady turn of a turning circle.

    Parameters
    ----------
    times : array_like, shape (n_times,)
        Increasing times [s].
    x, y : array_like, shape (n_times,)
        Position north and east [m] of the midship point.
    heading : array_like, shape (n_times,)
        Heading [rad] from north to east; jumps by a full turn are removed.
    speed : array_like, shape (n_times,), optional
        Speed [m/s]; by default that of the track.
    execute : float, optional
        Time of the rudder execute [s]; by default the first time. The heading
        then is the original course.
    steady_from : float
        Heading change from which the turn counts as steady [rad]. At least 90
        degrees more are needed for the steady values.

    Returns
    -------
    TurningIndices
        The indices.

    Raises
    ------
    DataError
        If the heading changes by less than 180 degrees.

    Notes
    -----
    Wind and current are not corrected for. A course made good that differs
    from the heading at the execute rotates advance and transfer.

    References
    ----------
    IMO Resolution MSC.137(76), Annex, 4.2.2 to 4.2.4 (2002). ITTC Recommended
    Procedure 7.5-04-02-01, Full Scale Manoeuvring Trials.

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.linspace(0.0, 3 * np.pi, 1000)
    >>> result = turning_indices(angle, 100 * np.sin(angle), 100 - 100 * np.cos(angle), angle)
    >>> print(round(result.advance, 1), round(result.transfer, 1), round(result.tactical_diameter))
    100.0 100.0 200
    """
    moments, north, east, angle = columns(times, x=x, y=y, heading=heading)
    begin = within_record(moments, execute)
    angle = np.unwrap(angle)
    course = float(np.interp(begin, moments, angle))
    change = angle - course
    during = moments >= begin
    side = 1 if np.max(change[during]) >= -np.min(change[during]) else -1
    if (turned := float(np.max(side * change[during]))) < math.pi:
        raise DataError(SAYS["short_turn"].format(turned=math.degrees(turned)))
    origin = np.interp(begin, moments, north), np.interp(begin, moments, east)
    # Axes of the approach: along the original course, and to starboard of it.
    along = (north - origin[0]) * math.cos(course) + (east - origin[1]) * math.sin(course)
    across = (east - origin[1]) * math.cos(course) - (north - origin[0]) * math.sin(course)
    quarter, half = (
        first_reach(moments, side * change, angle, after=begin) for angle in (math.pi / 2, math.pi)
    )
    assert quarter is not None  # the turn is longer
    assert half is not None
    track_north, track_east = np.gradient(north, moments), np.gradient(east, moments)
    speeds = np.hypot(track_north, track_east) if speed is None else columns(times, speed=speed)[1]

    radius = ratio = drift = None
    steady = during & (side * change >= steady_from)
    if turned >= steady_from + _STEADY_ARC and np.count_nonzero(steady) >= 3:
        radius = circle_radius(north[steady], east[steady])
        ratio = float(np.mean(speeds[steady]) / np.interp(begin, moments, speeds))
        # Drift angle as a mean on the circle, so that a course across north does no harm.
        slip = angle[steady] - np.arctan2(track_east[steady], track_north[steady])
        drift = side * float(np.angle(np.mean(np.exp(1j * slip))))
    return TurningIndices(
        side=side,
        advance=float(np.interp(quarter, moments, along)),
        transfer=side * float(np.interp(quarter, moments, across)),
        tactical_diameter=side * float(np.interp(half, moments, across)),
        time_90=quarter - begin,
        time_180=half - begin,
        turned=turned,
        steady_radius=radius,
        steady_speed_ratio=ratio,
        drift=drift,
    )


def _text(value: float | None, unit: str) -> str:
    """Return a number with its unit, or words where the record is too short for it."""
    return "record too short or signal not given" if value is None else f"{value:.3f} {unit}"


# -- events in a record: executes of the rudder, crossings, peaks, steady circles ----------


def columns(times: Numbers, **signals: Numbers) -> tuple[FloatArray, ...]:
    """Return the times and each signal as arrays ``(n_times,)``, or raise DataError."""
    moments = np.asarray(times, dtype=float)
    if moments.ndim != 1 or len(moments) < 3 or not np.all(np.diff(moments) > 0):
        raise DataError(SAYS["times_of_manoeuvre"].format(shape=moments.shape))
    arrays = [moments]
    for name, values in signals.items():
        array = np.asarray(values, dtype=float)
        if array.shape != moments.shape:
            raise DataError(
                f"The manoeuvre has {len(moments)} times but {name!r} of shape {array.shape}. "
                "Give one value per time."
            )
        if missing := np.count_nonzero(~np.isfinite(array)):
            raise DataError(SAYS["missing_values"].format(missing=missing, name=name))
        arrays.append(array)
    return tuple(arrays)


def within_record(times: FloatArray, execute: float | None) -> float:
    """Return the time of the execute, the first time by default, or raise DataError."""
    if execute is None:
        return float(times[0])
    if not times[0] <= execute < times[-1]:
        raise DataError(
            f"The execute at {execute:g} s is outside the record from {times[0]:g} to "
            f"{times[-1]:g} s. Give it on the record's clock."
        )
    return float(execute)


@dataclass(frozen=True, eq=False)
class Legs:
    """A rudder that is held, moves to the other side and is held again, as in a zigzag.

    Attributes
    ----------
    orders, errors : ndarray (n_legs,)
        Rudder of each leg and its standard error, NaN where it was not held: the order is then
        that of the other legs.
    begins : ndarray (n_legs,)
        When the rudder leaves the order before, s.
    rate, rate_error : float
        Largest rate of the rudder, and its standard error, per second.
    before : float
        Rudder before the first leg.
    """

    orders: np.ndarray
    errors: np.ndarray
    begins: np.ndarray
    rate: float
    rate_error: float
    before: float


def rudder_legs(
    times: FloatArray, rudder: FloatArray, *, first: float | None = None, noise: float | None = None
) -> Legs:
    r"""Read the legs of a zigzag from its rudder, order or measured angle.

    A rudder that moves over several samples has left the order before where its ramp meets it,

    .. math:: t_b = \bar t - |\bar\delta - \delta_\mathrm{before}| / \dot\delta

    with the means over the ramp; one that jumps, at its first sample, because an order is held
    until the next one is given.

    Parameters
    ----------
    times, rudder : ndarray (n_times,)
        s, and the angle with zero as its middle.
    first : float, optional
        When the first leg begins, s; by default found.
    noise : float, optional
        Standard deviation of the rudder's sensor; by default from second differences, which are
        zero on a ramp and where it is held: their median is :math:`0.67 \sqrt 6` of it.

    Raises
    ------
    DataError
        If the rudder is never reversed.
    """
    starts = _reversals(rudder)
    if noise is None:
        noise = float(np.median(np.abs(np.diff(rudder, 2)))) / (ndtri(0.75) * math.sqrt(6))
    before = float(np.median(rudder[: max(starts[0], 1)]))
    found = list[tuple[float, float, NDArray[np.intp]]]()
    for begin, end in pairwise([*starts.tolist(), len(times)]):
        found.append(_leg(rudder, begin, end, found[-1][0] if found else before, noise))
    levels, deviations, ramps = zip(*found, strict=True)
    orders, errors = np.array(levels), np.array(deviations)
    for loose in np.flatnonzero(np.isnan(errors)):
        others = orders[np.isfinite(errors) & (orders * orders[loose] > 0)]
        orders[loose] = np.median(others) if len(others) else orders[loose]
    left = np.array([before, *orders[:-1]])
    rate, error = _rate(times, rudder, ramps, np.abs(orders - left))
    begins = times[starts].astype(float)
    for i, ramp in enumerate(ramps):
        if len(ramp):
            begins[i] = np.mean(times[ramp]) - abs(np.mean(rudder[ramp]) - left[i]) / rate
    begins[0] = max(begins[0], times[0]) if first is None else first
    return Legs(orders, errors, begins, rate, error, before)


def _reversals(rudder: FloatArray) -> NDArray[np.intp]:
    """First samples of the rudder on each side."""
    largest = float(np.max(np.abs(rudder)))
    # Less than a material share of the largest angle is on neither side.
    side = np.where(np.abs(rudder) > MATERIAL * largest, np.sign(rudder), 0.0)
    used = np.flatnonzero(side)
    starts = used[np.flatnonzero(np.diff(side[used], prepend=0.0))]
    if len(starts) < 2:
        raise DataError(
            f"The rudder is never reversed (it stays between {np.min(rudder):.3g} and "
            f"{np.max(rudder):.3g}), so this is no zigzag. Check the column and its middle."
        )
    return starts


def _leg(
    rudder: FloatArray, begin: int, end: int, before: float, noise: float
) -> tuple[float, float, NDArray[np.intp]]:
    """Order of one leg, its standard error, and the samples of the ramp from the one before."""
    leg = rudder[begin:end]
    side = math.copysign(1.0, leg[0])
    near = max(BEYOND * noise, IMMATERIAL * float(np.max(np.abs(leg))))
    held = np.abs(leg - side * np.quantile(side * leg, 0.75, method="higher")) <= near
    few = held.sum() < _FEWEST_HELD
    error = math.nan if few else 1.25 * float(np.std(leg[held])) / math.sqrt(held.sum())
    last = max(begin - 1, 0)  # the rudder as it was before
    while last and abs(rudder[last] - before) > near:
        last -= 1
    return float(np.median(leg[held])), error, np.arange(last + 1, begin + int(held.argmax()))


def _rate(
    times: FloatArray, rudder: FloatArray, ramps: Sequence[NDArray[np.intp]], moves: FloatArray
) -> tuple[float, float]:
    """Rate of the rudder on its ramps and its standard error; without ramps it jumps a sample."""
    telling = [ramp for ramp in ramps if len(ramp) >= _FEWEST_HELD]
    slopes = [abs(float(np.polyfit(times[ramp], rudder[ramp], 1)[0])) for ramp in telling]
    if not slopes:
        return float(np.max(moves / np.median(np.diff(times)))), 0.0
    return float(np.median(slopes)), 1.25 * float(np.std(slopes)) / math.sqrt(len(slopes))


def summit(
    times: FloatArray, values: FloatArray, *, begin: float, end: float
) -> tuple[float, float] | None:
    """Return time and height of the largest value between two times.

    The height is that of the parabola through the three samples around the
    largest one. None if the values still rise where the record ends.
    """
    if not len(window := np.flatnonzero((times >= begin) & (times <= end))):
        return None
    top = int(window[np.argmax(values[window])])
    if top == len(times) - 1:
        return None
    if top == 0:
        return float(times[0]), float(values[0])
    near = slice(top - 1, top + 2)
    quadratic, linear, _ = np.polyfit(times[near] - times[top], values[near] - values[top], 2)
    if quadratic >= 0:
        return float(times[top]), float(values[top])
    shift = float(np.clip(-linear / (2 * quadratic), *(times[near][[0, 2]] - times[top])))
    return float(times[top]) + shift, float(values[top]) + (quadratic * shift + linear) * shift


def first_reach(
    times: FloatArray, values: FloatArray, level: float, *, after: float
) -> float | None:
    """Return the time, after a given one, at which values first reach a level from below."""
    if not len(reached := np.flatnonzero((values >= level) & (times > after))):
        return None
    above = int(reached[0])
    if above == 0 or values[above - 1] >= level:
        return float(times[above])
    share = (level - values[above - 1]) / (values[above] - values[above - 1])
    return float(times[above - 1] + share * (times[above] - times[above - 1]))


def travelled(times: FloatArray, speeds: FloatArray, begin: float, end: float) -> float:
    """Return the distance [m] between two times, by the trapezoidal rule."""
    inner = times[(times > begin) & (times < end)]
    nodes = np.concatenate([[begin], inner, [end]])
    at_nodes = np.interp(nodes, times, speeds)
    return float(np.sum((at_nodes[1:] + at_nodes[:-1]) / 2 * np.diff(nodes)))


def circle_radius(x: FloatArray, y: FloatArray) -> float:
    """Return the radius of the circle through points, by linear least squares.

    References
    ----------
    I. Kasa, A circle fitting procedure and its error analysis, *IEEE Trans.
    Instrumentation and Measurement* 25 (1976) 8-14.
    """
    east, north = x - np.mean(x), y - np.mean(y)
    matrix = np.column_stack([2 * east, 2 * north, np.ones_like(east)])
    a, b, c = np.linalg.lstsq(matrix, east**2 + north**2)[0]
    return float(np.sqrt(c + a**2 + b**2))
