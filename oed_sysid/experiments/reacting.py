"""Manoeuvres that react to what is measured, and manoeuvres made of manoeuvres.

Both zigzags are one event detector: the order is reversed whenever the feedback's deviation has
reached the switch on the side of the order. Others act at the same time, in turn, or limited.
"""

from __future__ import annotations

import math
from collections import abc
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from itertools import accumulate
from typing import ClassVar

import numpy as np

from oed_sysid.errors import ModelError, listed
from oed_sysid.experiments import SAYS, base
from oed_sysid.experiments.base import Numbers, Rule
from oed_sysid.experiments.schedules import interval

_SWITCH = "It is the deviation at which the command reverses."
# Amplitudes and switches of the swings, lead [s] and gain of the signal that is kept.
Swings = tuple[tuple[float, ...], tuple[float, ...], float, float]


class SlopeLimit:
    """Follow an order that may jump, at a limited rate.

    Between two samples the command moves towards the order of the earlier one,
    as a steering gear does: an order is first seen in the command one sample
    after it was given.

    Parameters
    ----------
    rate : float or None
        Largest slope [unit/s]; None passes every order through.
    initial : float
        Command at the first sample, if there is a rate.
    """

    def __init__(self, rate: float | None, *, initial: float) -> None:
        self._rate = rate
        self._command = initial
        self._order = initial
        self._time: float | None = None

    def follow(self, order: float, time: float) -> float:
        """Return the command at ``time`` [s] and remember the order given there."""
        if self._time is not None and time < self._time:
            raise ModelError(SAYS["earlier_time"].format(self, time=time))
        if self._rate is None:
            self._command = order
        elif self._time is not None:
            reach = self._rate * (time - self._time)
            self._command += min(max(self._order - self._command, -reach), reach)
        self._order, self._time = order, time
        return self._command


class _Reversing(base.Stepwise, base.Timed):
    """What both zigzags share."""

    def controller(self) -> base.Controller:
        """Return a fresh controller."""
        return _Swings(self)  # type: ignore[arg-type]


@dataclass(frozen=True)
class ZigZag(_Reversing):
    r"""Zigzag test, for instance 10/10 of the IMO standards.

    After a straight approach the rudder is put over to ``amplitude``; when the
    heading has changed by ``switch`` from its value at that moment the rudder
    is reversed, and so on.

    Parameters
    ----------
    input : str
        Commanded channel.
    amplitude : float
        Command to either side [rad], above zero.
    switch : float
        Deviation of the feedback at which the command reverses [rad], above zero.
    feedback : str
        Measured signal, continuous: a heading must not jump at 180 degrees.
    rate : float or None
        Largest slope of the command [rad/s]; None lets it jump.
    first : int
        Side of the first execute, +1 or -1.
    start : float
        Time of the first execute [s]; the approach before holds ``trim``.
    sign : int
        +1 if a positive command lets the feedback grow, -1 if it falls.
    trim : float
        Command around which the swings are made [rad].
    reference : float or None
        Value from which the feedback's deviation is counted; None takes the
        first measured value at or after ``start``.
    lead : float
        Time by which the reversal looks ahead [s], with the rate of the feedback, which has to be
        the second of the signals. The swing then ends near ``switch`` on slow and on quick
        vehicles.
    keep_gain : float
        Shift of the reference for each unit by which a further signal, the last of those in
        ``feedback``, is off its first value, at most half a switch: swings about a depth keeper
        neither dive nor surface.

    Notes
    -----
    With the feedback :math:`\psi`, its rate :math:`r` and the kept signal :math:`z`, the command
    reverses where

    .. math:: \pm\left(\psi + T r - \psi_0 - k\,(z - z_0)\right) \ge \psi_s

    with ``lead`` :math:`T`, ``keep_gain`` :math:`k` and ``switch`` :math:`\psi_s`. The decision is
    taken on samples, so that the reversal comes up to one sample after the crossing. A measured
    NaN means no new measurement: the order is kept.

    References
    ----------
    IMO Resolution MSC.137(76), Annex, 4.2.5 and 4.2.6 (2002).

    Examples
    --------
    >>> from math import radians
    >>> test = ZigZag("rudder", radians(10), radians(10))
    >>> control = test.controller()
    >>> [round(control.command(t, {"psi": psi}), 3) for t, psi in [(0, 0.0), (1, 0.1), (2, 0.18)]]
    [0.175, 0.175, -0.175]
    """

    kind: ClassVar[str] = "zigzag"
    rules: ClassVar[Mapping[str, Rule]] = {
        "amplitude": base.above_zero(base.OTHER_SIDE),
        "switch": base.above_zero(_SWITCH),
    }
    amplitude: float
    switch: float
    _: KW_ONLY
    feedback: abc.Sequence[str] = ("psi",)
    rate: float | None = None
    first: int = 1
    sign: int = 1
    reference: float | None = None
    lead: float = 0.0
    keep_gain: float = 0.0

    def _validate(self) -> None:
        if self.lead < 0:
            raise ModelError(f"{self._owner} has lead {self.lead:g} s. Give zero or more.")
        more = ("its rate",) * (self.lead != 0) + ("the signal kept",) * (self.keep_gain != 0)
        self._set(feedback=base.feedback_of(self._owner, self.feedback, more))

    @property
    def swings(self) -> Swings:
        """Amplitudes, switches, lead and gain of the kept signal."""
        return (self.amplitude,), (self.switch,), self.lead, self.keep_gain

    def describe(self) -> str:
        """Return one line in words."""
        lead = f" {self.lead:.3g} s ahead" if self.lead else ""
        kept = f" about a keeper of {self.feedback[-1]}" if self.keep_gain else ""
        return (
            f"zigzag {math.degrees(self.amplitude):.3g}/{math.degrees(self.switch):.3g} deg of "
            f"{self.input}, reversed on {self.feedback[0]}{lead}{kept}, {_ending(self)}"
        )


@dataclass(frozen=True)
class ZigZagLike(_Reversing):
    """Zigzag with an amplitude and a switch of its own for each swing.

    The diving-plane version: the fin is put to +amplitude, which lowers the
    bow; when the pitch angle is at or below -switch the fin goes to -amplitude
    until the pitch angle is at or above +switch, and so on. Swings of several
    sizes excite linear and quadratic terms in one run.

    Parameters
    ----------
    input : str
        Commanded channel.
    amplitudes : float or sequence of float, shape (n,)
        Command of each swing [rad], above zero; the last is kept afterwards.
    switches : float or sequence of float, shape (m,)
        Feedback at which each swing ends [rad], above zero; the last is kept
        afterwards. It may have another length than ``amplitudes``.
    feedback : str
        Measured signal.
    rate : float or None
        Largest slope of the command [rad/s]; None lets it jump.
    first : int
        Side of the first command, +1 or -1.
    start : float
        Time of the first command [s]; before, ``trim`` is held.
    sign : int
        +1 if a positive command lets the feedback grow, -1 if it falls (a
        positive stern plane lowers the bow).
    trim : float
        Command around which the swings are made [rad].
    reference : float or None
        Value from which the feedback's deviation is counted; None takes the
        first measured value at or after ``start``.

    Examples
    --------
    >>> dive = ZigZagLike("fin_command", (0.35, 0.2), (0.1, 0.05))
    >>> control = dive.controller()
    >>> [control.command(t, {"theta": angle}) for t, angle in [(0, 0.0), (1, -0.11), (2, 0.06)]]
    [0.35, -0.2, 0.2]
    """

    kind: ClassVar[str] = "zigzag_like"
    rules: ClassVar[Mapping[str, Rule]] = {
        "amplitudes": base.each_positive(base.OTHER_SIDE),
        "switches": base.each_positive(_SWITCH),
        "feedback": lambda owner, _, signals: base.feedback_of(owner, signals),
    }
    amplitudes: float | Numbers
    switches: float | Numbers
    _: KW_ONLY
    feedback: abc.Sequence[str] = ("theta",)
    rate: float | None = None
    first: int = 1
    sign: int = -1
    reference: float | None = 0.0

    @property
    def swings(self) -> Swings:
        """Amplitudes and switches as tuples; neither lead nor a signal that is kept."""
        return tuple(self.amplitudes), tuple(self.switches), 0.0, 0.0  # type: ignore[arg-type]

    def describe(self) -> str:
        """Return one line in words."""
        amplitudes, switches, *_ = self.swings
        return (
            f"zigzag of {self.input} with {_degrees(amplitudes)} deg, reversed when "
            f"{self.feedback[0]} reaches {_degrees(switches)} deg, {_ending(self)}"
        )


class _Swings(base.Controller):
    """Reverse the order whenever the feedback's deviation reaches the switch."""

    def __init__(self, settings: ZigZag | ZigZagLike) -> None:
        self._settings = settings
        self._amplitudes, self._switches, self._lead, self._keep_gain = settings.swings
        self._limit = SlopeLimit(settings.rate, initial=settings.trim)
        # Not a number until they are measured.
        self._reference = math.nan if settings.reference is None else settings.reference
        self._kept = math.nan
        self._reversals = -1
        self._reverse()

    def command(self, time: float, signals: Mapping[str, float]) -> float:
        if time < self._settings.start:
            return self._limit.follow(self._settings.trim, time)
        names = self._settings.feedback
        seen = [measured_signal(self._settings.input, name, signals) for name in names]
        # Headings count from the first measured value, whatever the course of the approach.
        if not math.isfinite(self._reference):
            self._reference = seen[0]
        if not math.isfinite(self._kept):
            self._kept = seen[-1]
        if self._swing(seen) >= self._switch:
            self._reverse()
        return self._limit.follow(self._order, time)

    def _swing(self, seen: abc.Sequence[float]) -> float:
        """How far the feedback has gone to the side of the order, rad; NaN while not known."""
        deviation = seen[0] - self._reference
        if self._lead:
            deviation += self._lead * seen[1]
        if self._keep_gain and math.isfinite(self._kept):
            # The keeper may shift the reference by half a switch, so that every swing still ends.
            most = 0.5 * self._switch
            shift = self._keep_gain * (seen[-1] - self._kept)
            deviation -= min(max(shift, -most), most)
        return self._settings.sign * self._side * deviation

    def _reverse(self) -> None:
        """Begin the next swing; the last amplitude and the last switch go on."""
        self._reversals += 1
        self._side = self._settings.first * (-1) ** self._reversals
        self._switch = self._switches[min(self._reversals, len(self._switches) - 1)]
        size = self._amplitudes[min(self._reversals, len(self._amplitudes) - 1)]
        self._order = self._settings.trim + self._side * size


def measured_signal(owner: str, name: str, signals: Mapping[str, float]) -> float:
    """Return the feedback signal, or raise with the names that there are."""
    if name not in signals:
        raise ModelError(
            f"The manoeuvre of {owner!r} reacts to {name!r}, which is not among the signals "
            f"({listed(signals)}). Measure it, or set feedback to one of them."
        )
    return float(signals[name])


def _degrees(values: abc.Iterable[float]) -> str:
    return ", ".join(f"{math.degrees(value):.3g}" for value in values)


def _ending(manoeuvre: ZigZag | ZigZagLike) -> str:
    side = "positive" if manoeuvre.first > 0 else "negative"
    rate = manoeuvre.rate
    limit = "" if rate is None else f", at most {math.degrees(rate):.3g} deg/s"
    return f"{side} side first, from {manoeuvre.start:g} s{limit}"


@dataclass(frozen=True)
class ReverseSpiral(base.Stepwise, base.Timed):
    """Reverse (Bech) spiral: steer a sequence of constant yaw rates.

    The mean command at each rate gives the steady curve also where the vehicle
    is unstable, which a direct spiral jumps over. The command is
    proportional-integral in the error of the yaw rate.

    Parameters
    ----------
    input : str
        Commanded channel.
    rates : sequence of float, shape (n,)
        Yaw rates to steer [rad/s].
    hold : float
        Time on each rate [s].
    gain : float
        Command per error of the yaw rate [s], above zero.
    reset_time : float
        Integral time [s].
    limit : float
        Largest command to either side [rad].
    feedback : str
        Measured yaw rate.
    sign : int
        +1 if a positive command lets the feedback grow, -1 if it falls.
    start : float
        Time of the first rate [s].
    trim : float
        Command about which it moves, held before: 0, or the trim of the command.

    Examples
    --------
    >>> run = ReverseSpiral("rudder", [0.01, 0.0, -0.01], hold=120.0, gain=20.0, reset_time=30.0,
    ...                     limit=0.35)
    >>> run.feedback
    ('r',)
    """

    kind: ClassVar[str] = "reverse_spiral"
    rules: ClassVar[Mapping[str, Rule]] = {
        "gain": base.above_zero("Use sign=-1 for a reversed command."),
        "feedback": lambda owner, _, signals: base.feedback_of(owner, signals),
    }
    rates: Numbers
    _: KW_ONLY
    hold: float
    gain: float
    reset_time: float
    limit: float
    feedback: abc.Sequence[str] = ("r",)
    sign: int = 1

    @property
    def duration(self) -> float | None:
        """Until the last rate has been held [s]."""
        return self.start + self.hold * len(self.rates)

    def controller(self) -> base.Controller:
        """Return a fresh controller: proportional-integral steering."""
        edges = self.start + self.hold * np.arange(len(self.rates))
        # No time has elapsed at the first sample.
        integral, before, order = 0.0, math.inf, self.trim

        def command(time: float, signals: Mapping[str, float]) -> float:
            nonlocal integral, before, order
            leg = int(interval(np.array([time]), edges)[0]) - 1
            if leg < 0:
                return self.trim
            measured = measured_signal(self.input, self.feedback[0], signals)
            elapsed, before = max(time - before, 0.0), time
            if math.isnan(measured):  # no new measurement: keep the command
                return order
            error = self.sign * self.gain * (self.rates[leg] - measured)
            # An integral beyond the limit could not be undone in time (windup).
            summed = integral + error * elapsed / self.reset_time
            integral = float(np.clip(summed, -self.limit, self.limit))
            order = self.trim + float(np.clip(error + integral, -self.limit, self.limit))
            return order

        return base.Law(command)

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"reverse spiral of {self.input}: {len(self.rates)} values of {self.feedback[0]}, "
            f"{self.hold:g} s each"
        )


@dataclass(frozen=True)
class Combined(base.Excitation):
    """Several manoeuvres at the same time, each on an input of its own.

    Parameters
    ----------
    manoeuvres : sequence of Manoeuvre
        One for each input.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import Constant, TurningCircle
    >>> trial = Combined((Constant("thrust", 700.0), TurningCircle("rudder", 0.6)))
    >>> trial.inputs
    ('thrust', 'rudder')
    """

    kind: ClassVar[str] = "combined"
    manoeuvres: abc.Sequence[base.Manoeuvre]

    def __post_init__(self) -> None:
        self._set(manoeuvres=_parts("Combined", self.manoeuvres))
        if len(set(self.inputs)) < len(self.inputs):
            raise ModelError(SAYS["commanded_twice"].format(inputs=", ".join(self.inputs)))

    @property
    def parts(self) -> tuple[base.Manoeuvre, ...]:
        """The manoeuvres."""
        return tuple(self.manoeuvres)

    @property
    def feedback(self) -> abc.Sequence[str]:
        """Names of the measured signals that any of them reacts to."""
        return _signals(self.manoeuvres)

    @property
    def duration(self) -> float | None:
        """The longest suggestion [s]; None if no manoeuvre has one."""
        known = (part.duration for part in self.manoeuvres)
        return max((one for one in known if one is not None), default=None)

    def describe(self) -> str:
        """Return one line in words."""
        return "; ".join(part.describe() for part in self.manoeuvres)


@dataclass(frozen=True)
class Sequence(base.Stepwise):
    """Manoeuvres on one input, one after another; each counts time from its own beginning.

    Parameters
    ----------
    manoeuvres : sequence of Manoeuvre
        All on the same input.
    durations : sequence of float, optional
        Time of each [s]; by default their own. The last manoeuvre goes on
        after its time, and may be left without one.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import Constant, Doublet
    >>> wait = Constant("rudder", 0.0)
    >>> parts = Sequence((wait, Doublet("rudder", 0.2, pulse_time=1.0)), durations=(5.0, 3.0))
    >>> print(parts.commands([4.0, 5.0, 6.0, 7.0]))
    [ 0.   0.2 -0.2  0. ]
    """

    kind: ClassVar[str] = "sequence"
    input: str = field(init=False)
    manoeuvres: abc.Sequence[base.Manoeuvre]
    _: KW_ONLY
    durations: Numbers | None = None

    def __post_init__(self) -> None:
        parts = _parts("Sequence", self.manoeuvres)
        self._set(manoeuvres=parts, input=parts[0].input)
        super().__post_init__()

    def _validate(self) -> None:
        parts = self.manoeuvres
        if len({part.input for part in parts}) > 1:
            raise ModelError(
                f"Sequence has inputs {', '.join(part.input for part in parts)}; all must be the "
                "same. Use Combined for manoeuvres on several inputs."
            )
        if self.durations is None:
            for part in parts[:-1]:
                if part.duration is None:
                    raise ModelError(SAYS["endless_part"].format(self, part=type(part).__name__))
            return
        times = base.each_positive("")(self._owner, "durations", self.durations)
        if len(times) not in (len(parts), len(parts) - 1):
            raise ModelError(
                f"{self._owner} has {len(parts)} manoeuvres but {len(times)} durations. Give one "
                "for each; that of the last may be left out."
            )
        self._set(durations=times)

    @property
    def feedback(self) -> abc.Sequence[str]:
        """Names of the measured signals that any of them reacts to."""
        return _signals(self.manoeuvres)

    @property
    def duration(self) -> float | None:
        """Sum of the durations [s]; None if the last has none."""
        times = self._times()
        return None if len(times) < len(self.manoeuvres) else sum(times)

    def controller(self) -> base.Controller:
        """Return a fresh controller."""
        begins = np.array([0.0, *accumulate(self._times()[: len(self.manoeuvres) - 1])])
        controllers = [part.controller() for part in self.manoeuvres]

        def command(time: float, signals: Mapping[str, float]) -> float:
            # Each on its own clock.
            index = max(int(interval(np.array([time]), begins)[0]) - 1, 0)
            return controllers[index].command(time - begins[index], signals)

        return base.Law(command)

    def describe(self) -> str:
        """Return one line in words."""
        return ", then ".join(part.describe() for part in self.manoeuvres)

    def _times(self) -> list[float]:
        """Return the time of each part, without the last if it has none [s]."""
        if self.durations is not None:
            return [float(time) for time in self.durations]
        return [time for part in self.manoeuvres if (time := part.duration) is not None]


@dataclass(frozen=True)
class _Shaped(base.Stepwise):
    """A manoeuvre that shapes what another one orders."""

    input: str = field(init=False)
    manoeuvre: base.Manoeuvre

    def __post_init__(self) -> None:
        self._set(input=_parts(type(self).__name__, (self.manoeuvre,))[0].input)
        super().__post_init__()

    @property
    def feedback(self) -> abc.Sequence[str]:
        """Names of the measured signals that the manoeuvre reacts to."""
        return self.manoeuvre.feedback

    @property
    def duration(self) -> float | None:
        """That of the manoeuvre [s]."""
        return self.manoeuvre.duration


@dataclass(frozen=True)
class RateLimited(_Shaped):
    """A manoeuvre whose command changes at a limited rate, as a steering gear's does.

    Between two samples the command moves towards the order of the earlier one.
    An actuator's own rate limit belongs in the model; this one shapes what is
    commanded.

    Parameters
    ----------
    manoeuvre : Manoeuvre
        What is ordered.
    rate : float
        Largest slope [unit/s], above zero.
    initial : float
        Command at the first sample.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import TurningCircle
    >>> slow = RateLimited(TurningCircle("rudder", 0.3), 0.1)
    >>> print(slow.commands([0.0, 1.0, 2.0, 3.0, 4.0]).round(3))
    [0.  0.1 0.2 0.3 0.3]
    """

    kind: ClassVar[str] = "rate_limited"
    rules: ClassVar[Mapping[str, Rule]] = {"rate": base.positive}
    rate: float
    _: KW_ONLY
    initial: float = 0.0

    def controller(self) -> base.Controller:
        """Return a fresh controller."""
        order, limit = self.manoeuvre.controller(), SlopeLimit(self.rate, initial=self.initial)
        return base.Law(lambda time, signals: limit.follow(order.command(time, signals), time))

    def describe(self) -> str:
        """Return one line in words."""
        return f"{self.manoeuvre.describe()}, at most {self.rate:.4g} per second"


@dataclass(frozen=True)
class Saturated(_Shaped):
    """A manoeuvre whose command is cut off at a limit to either side.

    Parameters
    ----------
    manoeuvre : Manoeuvre
        What is ordered.
    limit : float
        Largest absolute command, above zero.

    Examples
    --------
    >>> from oed_sysid.experiments.manoeuvres import Piecewise
    >>> print(Saturated(Piecewise("rudder", [0, 1], [0.5, -0.1]), 0.3).commands([0, 1]))
    [ 0.3 -0.1]
    """

    kind: ClassVar[str] = "saturated"
    limit: float

    def controller(self) -> base.Controller:
        """Return a fresh controller."""
        order, most = self.manoeuvre.controller(), self.limit
        return base.Law(lambda time, signals: min(max(order.command(time, signals), -most), most))

    def describe(self) -> str:
        """Return one line in words."""
        return f"{self.manoeuvre.describe()}, cut off at {self.limit:.4g}"


def _parts(owner: str, manoeuvres: abc.Iterable[base.Manoeuvre]) -> tuple[base.Manoeuvre, ...]:
    """Return the manoeuvres as a tuple that is not empty."""
    if not (parts := tuple(manoeuvres)):
        raise ModelError(f"{owner} has no manoeuvres. Give at least one.")
    for part in parts:
        if not isinstance(part, base.Manoeuvre):
            raise ModelError(SAYS["no_manoeuvre"].format(owner=owner, kind=type(part).__name__))
    return parts


def _signals(manoeuvres: abc.Iterable[base.Manoeuvre]) -> tuple[str, ...]:
    """Return the names of all measured signals, each once."""
    return tuple(dict.fromkeys(name for part in manoeuvres for name in part.feedback))
