"""Events in a recorded manoeuvre: executes of the rudder, crossings, peaks, steady circles."""

from __future__ import annotations

import math

import numpy as np

from oed_sysid.errors import DataError
from oed_sysid.experiments.checks import FloatArray, Numbers

_SIDE_SHARE = 0.2  # of the largest rudder angle: below, the rudder is on neither side
_PLATEAU_SHARE = 0.05  # of a leg's angle: within, the rudder still holds it


def columns(times: Numbers, **signals: Numbers) -> tuple[FloatArray, ...]:
    """Return the times and each signal as arrays ``(n_times,)``, or raise DataError."""
    moments = np.asarray(times, dtype=float)
    if moments.ndim != 1 or len(moments) < 3 or not np.all(np.diff(moments) > 0):
        raise DataError(
            f"The manoeuvre has times of shape {moments.shape}; expected at least 3 increasing "
            "times in one dimension. Sort the record and remove repeated times."
        )
    arrays = [moments]
    for name, values in signals.items():
        array = np.asarray(values, dtype=float)
        if array.shape != moments.shape:
            raise DataError(
                f"The manoeuvre has {len(moments)} times but {name!r} of shape {array.shape}. "
                "Give one value per time."
            )
        if missing := np.count_nonzero(~np.isfinite(array)):
            raise DataError(
                f"The manoeuvre has {missing} missing value(s) in {name!r}. Its indices are "
                "points on a curve: leave out these samples, or fill them."
            )
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


def rudder_executes(times: FloatArray, rudder: FloatArray, first: float | None) -> list[float]:
    """Return the times [s] at which the rudder leaves each angle that it holds.

    The first is given, or that at which the rudder leaves the middle.
    """
    largest = float(np.max(np.abs(rudder)))
    side = np.where(np.abs(rudder) > _SIDE_SHARE * largest, np.sign(rudder), 0.0)
    used = np.flatnonzero(side)
    changes = np.flatnonzero(np.diff(side[used]) != 0)
    if len(changes) == 0:
        raise DataError(
            f"The rudder is never reversed (it stays between {np.min(rudder):.3g} and "
            f"{np.max(rudder):.3g}), so this is no zigzag. Check the column and its middle."
        )
    executes = [_leaves_middle(times, rudder, int(used[0])) if first is None else first]
    begins = used[np.concatenate([[0], changes + 1])]
    ends = used[changes]
    for begin, end in zip(begins, ends, strict=False):
        sign = side[begin]
        leg = sign * rudder[begin : end + 1]
        held = float(np.percentile(leg, 90))
        last = int(begin + np.flatnonzero(leg >= (1 - _PLATEAU_SHARE) * held)[-1])
        executes.append(_corner(times, 1 - sign * rudder / held, last))
    return executes


def _leaves_middle(times: FloatArray, rudder: FloatArray, on_side: int) -> float:
    """Return the time at which the rudder first leaves zero."""
    sign = math.copysign(1.0, rudder[on_side])
    largest = float(np.max(np.abs(rudder)))
    before = np.flatnonzero(np.abs(rudder[:on_side]) <= _PLATEAU_SHARE * largest)
    if len(before) == 0:
        return float(times[0])
    return _corner(times, sign * rudder / largest, int(before[-1]))


def _corner(times: FloatArray, moved: FloatArray, last: int) -> float:
    """Return the time at which ``moved``, still about 0 at ``last``, begins to grow to 1.

    A ramp is followed back along its slope up to one half; a jump happens at
    its first sample, because an order is held until the next one is given.
    """
    after = last + 1
    half = after + int(np.argmax(moved[after:] >= 0.5))
    if half == after:
        return float(times[after])
    slope = (moved[half] - moved[after]) / (times[half] - times[after])
    corner = times[after] - moved[after] / slope
    return float(max(corner, times[0]))


def peak(
    times: FloatArray, values: FloatArray, *, begin: float, end: float
) -> tuple[float, float] | None:
    """Return time and height of the largest value between two times.

    The height is that of the parabola through the three samples around the
    largest one. None if the values still rise where the record ends.
    """
    window = np.flatnonzero((times >= begin) & (times <= end))
    if len(window) == 0:
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
    reached = np.flatnonzero((values >= level) & (times > after))
    if len(reached) == 0:
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
