"""Numbers that describe standard manoeuvres: overshoot angles, advance, tactical diameter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from oed_sysid.errors import DataError
from oed_sysid.experiments import events
from oed_sysid.experiments.checks import FloatArray, Numbers
from oed_sysid.runtime.display import as_dict

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
    """

    executes: tuple[float, ...]
    overshoots: tuple[float, ...]
    check_times: tuple[float, ...]
    initial_turning_time: float
    initial_turning_heading: float
    initial_turning_track: float | None
    reach: float | None
    period: float | None

    @property
    def first_overshoot(self) -> float:
        """Overshoot after the second execute [rad]."""
        return self.overshoots[0]

    @property
    def second_overshoot(self) -> float | None:
        """Overshoot after the third execute [rad]; None if the record ends before."""
        return self.overshoots[1] if len(self.overshoots) > 1 else None

    to_dict = as_dict()

    def report(self) -> str:
        """Return the numbers in lines of text, angles in degrees."""
        overshoots = ", ".join(f"{math.degrees(angle):.2f}" for angle in self.overshoots)
        return "\n".join(
            [
                f"overshoot angles       {overshoots} deg",
                f"initial turning time   {self.initial_turning_time:.2f} s to "
                f"{math.degrees(self.initial_turning_heading):.2f} deg",
                f"initial turning track  {_text(self.initial_turning_track, 'm')}",
                f"reach                  {_text(self.reach, 's')}",
                f"period                 {_text(self.period, 's')}",
            ]
        )


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

    def report(self) -> str:
        """Return the numbers in lines of text, angles in degrees."""
        drift = None if self.drift is None else math.degrees(self.drift)
        return "\n".join(
            [
                f"turn to {'starboard' if self.side > 0 else 'port'}, "
                f"{math.degrees(self.turned):.0f} deg",
                f"advance             {self.advance:.2f} m at 90 deg, {self.time_90:.2f} s",
                f"transfer            {self.transfer:.2f} m at 90 deg",
                f"tactical diameter   {self.tactical_diameter:.2f} m at 180 deg, "
                f"{self.time_180:.2f} s",
                f"steady diameter     {_text(self.steady_diameter, 'm')}",
                f"steady speed ratio  {_text(self.steady_speed_ratio, '')}".rstrip(),
                f"drift               {_text(drift, 'deg')}",
            ]
        )


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
    >>> print(round(result.first_overshoot, 3), round(result.check_times[0], 3))
    0.1 10.0
    """
    moments, angle, helm = events.columns(times, heading=heading, rudder=rudder)
    angle = np.unwrap(angle)
    executes = events.rudder_executes(moments, helm, execute)
    at_execute = np.interp(executes, moments, angle)
    original = float(at_execute[0])
    side = math.copysign(1.0, at_execute[1] - original)

    overshoots: list[float] = []
    check_times: list[float] = []
    for index in range(1, len(executes)):
        sign = side * (-1) ** (index - 1)
        end = executes[index + 1] if index + 1 < len(executes) else math.inf
        peak = events.peak(moments, sign * angle, begin=executes[index], end=end)
        if peak is None:
            break
        overshoots.append(peak[1] - sign * float(at_execute[index]))
        check_times.append(peak[0] - executes[index])
    if not overshoots:
        raise DataError(
            f"The record ends at {moments[-1]:g} s, before the heading turns back after the rudder "
            f"reversal at {executes[1]:.4g} s. Record the zigzag for longer."
        )
    track = None
    if speed is not None:
        _, speeds = events.columns(times, speed=speed)
        track = events.travelled(moments, speeds, executes[0], executes[1])
    turned_back = executes[1] + check_times[0]
    back = events.first_reach(moments, -side * (angle - original), 0.0, after=turned_back)
    return ZigZagIndices(
        executes=tuple(executes),
        overshoots=tuple(overshoots),
        check_times=tuple(check_times),
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
    moments, north, east, angle = events.columns(times, x=x, y=y, heading=heading)
    begin = events.within_record(moments, execute)
    angle = np.unwrap(angle)
    course = float(np.interp(begin, moments, angle))
    change = angle - course
    during = moments >= begin
    side = 1 if np.max(change[during]) >= -np.min(change[during]) else -1
    turned = float(np.max(side * change[during]))
    if turned < math.pi:
        raise DataError(
            f"The turn reaches {math.degrees(turned):.1f} degrees of heading change, but the "
            "tactical diameter is defined at 180. Record a longer turn (540 degrees are usual), "
            "or check that heading is in radians."
        )
    origin = np.interp(begin, moments, north), np.interp(begin, moments, east)
    along = (north - origin[0]) * math.cos(course) + (east - origin[1]) * math.sin(course)
    across = (east - origin[1]) * math.cos(course) - (north - origin[0]) * math.sin(course)
    quarter, half = (
        _time_of_turn(moments, side * change, angle, begin) for angle in (math.pi / 2, math.pi)
    )
    track_north, track_east = np.gradient(north, moments), np.gradient(east, moments)
    if speed is None:
        speeds = np.hypot(track_north, track_east)
    else:
        _, speeds = events.columns(times, speed=speed)

    radius = ratio = drift = None
    steady = during & (side * change >= steady_from)
    if turned >= steady_from + _STEADY_ARC and np.count_nonzero(steady) >= 3:
        radius = events.circle_radius(north[steady], east[steady])
        ratio = float(np.mean(speeds[steady]) / np.interp(begin, moments, speeds))
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


def _time_of_turn(times: FloatArray, change: FloatArray, angle: float, execute: float) -> float:
    """Return the time [s] at which the heading has changed by an angle."""
    time = events.first_reach(times, change, angle, after=execute)
    if time is None:  # pragma: no cover - the caller has checked the largest change
        raise DataError(f"The turn never reaches {math.degrees(angle):.0f} degrees.")
    return time


def _text(value: float | None, unit: str) -> str:
    """Return a number with its unit, or words where the record is too short for it."""
    return "record too short or signal not given" if value is None else f"{value:.3f} {unit}"
