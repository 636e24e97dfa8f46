"""Zigzag manoeuvres: reverse the command when a measured signal has swung far enough."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.experiments import checks
from oed_sysid.experiments.base import Controller, Stepwise
from oed_sysid.experiments.checks import FloatArray, Numbers
from oed_sysid.experiments.waveforms import SlopeLimit


@dataclass(frozen=True)
class ZigZag(Stepwise):
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
        Time of the first execute [s]; the approach before holds ``neutral``.
    sign : int
        +1 if a positive command lets the feedback grow, -1 if it falls.
    neutral : float
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
    amplitude: float
    switch: float
    _: KW_ONLY
    feedback: Sequence[str] = ("psi",)
    rate: float | None = None
    first: int = 1
    start: float = 0.0
    sign: int = 1
    neutral: float = 0.0
    reference: float | None = None
    lead: float = 0.0
    keep_gain: float = 0.0

    def _validate(self) -> None:
        owner = self._owner
        self._set(
            lead=checks.finite(owner, "lead", self.lead),
            keep_gain=checks.finite(owner, "keep_gain", self.keep_gain),
        )
        if self.lead < 0:
            raise ModelError(f"{owner} has lead {self.lead:g} s. Give zero or more.")
        more = ("its rate", *("the signal kept",) * (self.keep_gain != 0))
        _validate_swings(self, more if self.lead else more[1:])
        self._set(
            amplitude=checks.positive(owner, "amplitude", self.amplitude, _OTHER_SIDE),
            switch=checks.positive(owner, "switch", self.switch, _SWITCH),
        )

    @property
    def duration(self) -> float | None:
        """None: it depends on the vehicle; 5 reversals are usual."""
        return None

    def controller(self) -> Controller:
        """Return a fresh controller."""
        return _Swings(
            self, (self.amplitude,), (self.switch,), lead=self.lead, keep_gain=self.keep_gain
        )

    def describe(self) -> str:
        """Return one line in words."""
        lead = f" {self.lead:.3g} s ahead" if self.lead else ""
        kept = f" about a keeper of {self.feedback[-1]}" if self.keep_gain else ""
        return (
            f"zigzag {math.degrees(self.amplitude):.3g}/{math.degrees(self.switch):.3g} deg of "
            f"{self.input}, reversed on {self.feedback[0]}{lead}{kept}, {_ending(self)}"
        )


@dataclass(frozen=True)
class ZigZagLike(Stepwise):
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
        Time of the first command [s]; before, ``neutral`` is held.
    sign : int
        +1 if a positive command lets the feedback grow, -1 if it falls (a
        positive stern plane lowers the bow).
    neutral : float
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
    amplitudes: float | Numbers
    switches: float | Numbers
    _: KW_ONLY
    feedback: Sequence[str] = ("theta",)
    rate: float | None = None
    first: int = 1
    start: float = 0.0
    sign: int = -1
    neutral: float = 0.0
    reference: float | None = 0.0

    def _validate(self) -> None:
        _validate_swings(self)
        self._set(
            amplitudes=_each_positive(self._owner, "amplitudes", self.amplitudes, _OTHER_SIDE),
            switches=_each_positive(self._owner, "switches", self.switches, _SWITCH),
        )

    @property
    def duration(self) -> float | None:
        """None: it depends on the vehicle."""
        return None

    def controller(self) -> Controller:
        """Return a fresh controller."""
        owner = self._owner
        amplitudes = _each_positive(owner, "amplitudes", self.amplitudes, "")
        return _Swings(self, amplitudes, _each_positive(owner, "switches", self.switches, ""))

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"zigzag of {self.input} with {_degrees(self.amplitudes)} deg, reversed when "
            f"{self.feedback[0]} reaches {_degrees(self.switches)} deg, {_ending(self)}"
        )


_OTHER_SIDE = "Use first=-1 to begin to the other side."
_SWITCH = "It is the deviation at which the command reverses."


class _Swings(Controller):
    """Reverse the order whenever the feedback's deviation reaches the switch."""

    def __init__(
        self,
        settings: ZigZag | ZigZagLike,
        amplitudes: tuple[float, ...],
        switches: tuple[float, ...],
        *,
        lead: float = 0.0,
        keep_gain: float = 0.0,
    ) -> None:
        self._settings = settings
        self._signal = settings.feedback[0]
        self._amplitudes = amplitudes
        self._switches = switches
        self._limit = SlopeLimit(settings.rate, initial=settings.neutral)
        self._reference = settings.reference
        self._reversals = 0
        self._lead, self._keep_gain = lead, keep_gain
        self._kept: float | None = None

    def command(self, time: float, signals: Mapping[str, float]) -> float:
        if time < self._settings.start:
            return self._limit.follow(self._settings.neutral, time)
        seen = {
            name: measured_signal(self._settings.input, name, signals)
            for name in self._settings.feedback
        }
        measured = seen[self._signal]
        if self._reference is None and math.isfinite(measured):
            self._reference = measured
        if self._keep_gain and self._kept is None:
            kept = seen[self._settings.feedback[-1]]
            self._kept = kept if math.isfinite(kept) else None
        if self._reference is not None and self._swing(seen) >= self._switch:
            self._reversals += 1
        return self._limit.follow(self._order, time)

    def foreseen(self, times: FloatArray) -> FloatArray | None:
        before = len(times) and times[0] < self._settings.start
        return self._limit.foreseen(self._settings.neutral if before else self._order, times)

    def undisturbed(self, times: FloatArray, signals: Mapping[str, FloatArray]) -> int:
        early = int(np.searchsorted(times, self._settings.start))
        if early:
            return early
        if self._reference is None or (self._keep_gain and self._kept is None):
            return 0
        reached = self._swing(signals) >= self._switch
        return int(np.argmax(reached)) if reached.any() else len(times)

    def skip(self, times: FloatArray) -> None:
        before = len(times) and times[0] < self._settings.start
        self._limit.skip(self._settings.neutral if before else self._order, times)

    def _swing(self, seen: Mapping[str, Any]) -> Any:
        """How far the feedback has gone to the side of the order, rad; a number or an array."""
        deviation = seen[self._signal] - self._reference
        names = self._settings.feedback
        if self._lead:
            deviation = deviation + self._lead * seen[names[1]]
        if self._keep_gain and self._kept is not None:
            most = 0.5 * self._switch
            shift = self._keep_gain * (seen[names[-1]] - self._kept)
            deviation = deviation - np.clip(shift, -most, most)
        return self._settings.sign * self._side * deviation

    @property
    def _switch(self) -> float:
        return _item(self._switches, self._reversals)

    @property
    def _order(self) -> float:
        return self._settings.neutral + self._side * _item(self._amplitudes, self._reversals)

    @property
    def _side(self) -> int:
        return self._settings.first if self._reversals % 2 == 0 else -self._settings.first


def measured_signal(owner: str, name: str, signals: Mapping[str, float]) -> float:
    """Return the feedback signal, or raise with the names that there are."""
    if name not in signals:
        raise ModelError(
            f"The manoeuvre of {owner!r} reacts to {name!r}, which is not among the signals "
            f"({', '.join(signals) or 'none'}). Measure it, or set feedback to one of them."
        )
    return float(signals[name])


def _validate_swings(manoeuvre: ZigZag | ZigZagLike, more: Sequence[str] = ()) -> None:
    """Check and normalise the settings that both zigzags have; ``more`` are further signals."""
    owner, reference = manoeuvre._owner, manoeuvre.reference
    manoeuvre._set(
        feedback=checks.feedback(owner, manoeuvre.feedback, more),
        rate=checks.slope(owner, manoeuvre.rate),
        first=checks.side(owner, "first", manoeuvre.first),
        start=checks.finite(owner, "start", manoeuvre.start),
        sign=checks.side(owner, "sign", manoeuvre.sign),
        neutral=checks.finite(owner, "neutral", manoeuvre.neutral),
        reference=None if reference is None else checks.finite(owner, "reference", reference),
    )


def _each_positive(
    owner: str, name: str, values: float | Numbers, advice: str
) -> tuple[float, ...]:
    sequence = (values,) if isinstance(values, int | float) else values
    return tuple(
        checks.positive(owner, f"{name}[{index}]", value, advice)
        for index, value in enumerate(checks.numbers(owner, name, sequence))
    )


def _item(values: tuple[float, ...], index: int) -> float:
    return values[min(index, len(values) - 1)]


def _degrees(values: float | Numbers) -> str:
    sequence = (values,) if isinstance(values, int | float) else values
    return ", ".join(f"{math.degrees(value):.3g}" for value in sequence)


def _ending(manoeuvre: ZigZag | ZigZagLike) -> str:
    side = "positive" if manoeuvre.first > 0 else "negative"
    rate = manoeuvre.rate
    limit = "" if rate is None else f", at most {math.degrees(rate):.3g} deg/s"
    return f"{side} side first, from {manoeuvre.start:g} s{limit}"
