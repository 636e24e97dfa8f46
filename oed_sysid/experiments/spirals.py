"""Spirals: the steady relation of yaw rate and rudder angle."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar, Self

import numpy as np

from oed_sysid.experiments import checks
from oed_sysid.experiments.base import Controller, OpenLoop, Stepwise, Waveform
from oed_sysid.experiments.checks import Numbers
from oed_sysid.experiments.waveforms import about, interval, staircase
from oed_sysid.experiments.zigzag import measured_signal


@dataclass(frozen=True)
class Spiral(OpenLoop):
    """Direct (Dieudonne) spiral: a sequence of angles, each held until the turn is steady.

    Yaw rate against angle shows course instability as a hysteresis loop, so the
    sequence goes there and back: see :meth:`direct`.

    Parameters
    ----------
    input : str
        Commanded channel.
    angles : sequence of float, shape (n,)
        Held angles [rad], in the order in which they are put on.
    hold : float
        Time on each angle [s].
    start : float
        Time of the first angle [s].
    rate : float or None
        Largest slope of the command [rad/s]; None lets it jump.
    neutral : float
        Command about which it moves, held before: 0, or the trim of the command.
    """

    kind: ClassVar[str] = "spiral"
    angles: Numbers
    _: KW_ONLY
    hold: float
    start: float = 0.0
    rate: float | None = None
    neutral: float = 0.0

    @classmethod
    def direct(
        cls, input: str, largest: float, *, step: float, hold: float, rate: float | None = None
    ) -> Self:
        """Return the spiral from ``largest`` to the other side and back.

        Parameters
        ----------
        input : str
            Commanded channel.
        largest : float
            First and last angle [rad]; its sign is the side to begin with.
        step : float
            Wanted difference of neighbouring angles [rad]; rounded so that
            zero is one of the angles.
        hold : float
            Time on each angle [s].
        rate : float or None
            Largest slope of the command [rad/s].

        Examples
        --------
        >>> Spiral.direct("rudder", 0.2, step=0.1, hold=60.0).angles
        (0.2, 0.1, 0.0, -0.1, -0.2, -0.1, 0.0, 0.1, 0.2)
        """
        owner = f"Spiral of {input!r}"
        count = max(
            1,
            round(
                abs(
                    checks.not_zero(
                        owner, "largest", largest, "Its sign is the side to begin with."
                    )
                )
                / checks.positive(owner, "step", step)
            ),
        )
        across = [largest * index / count for index in range(count, -count - 1, -1)]
        return cls(input, (*across, *across[-2::-1]), hold=hold, rate=rate)

    def _validate(self) -> None:
        self._set(
            angles=checks.numbers(self._owner, "angles", self.angles),
            hold=checks.positive(self._owner, "hold", self.hold),
            start=checks.finite(self._owner, "start", self.start),
            neutral=checks.finite(self._owner, "neutral", self.neutral),
            rate=checks.slope(self._owner, self.rate),
        )

    @property
    def duration(self) -> float | None:
        """Until the last angle has been held [s]."""
        return self.start + self.hold * len(self.angles)

    def waveform(self) -> Waveform:
        """Return the function of time; the last angle is kept."""
        legs = _legs(self.start, self.hold, self.angles)
        return about(self.neutral, staircase(legs, self.angles, rate=self.rate))

    def describe(self) -> str:
        """Return one line in words."""
        first, last = math.degrees(self.angles[0]), math.degrees(self.angles[-1])
        return (
            f"direct spiral of {self.input}: {len(self.angles)} angles from {first:.3g} to "
            f"{last:.3g} deg, {self.hold:g} s each"
        )


@dataclass(frozen=True)
class ReverseSpiral(Stepwise):
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
    neutral : float
        Command about which it moves, held before: 0, or the trim of the command.
    """

    kind: ClassVar[str] = "reverse_spiral"
    rates: Numbers
    _: KW_ONLY
    hold: float
    gain: float
    reset_time: float
    limit: float
    feedback: Sequence[str] = ("r",)
    sign: int = 1
    start: float = 0.0
    neutral: float = 0.0

    def _validate(self) -> None:
        owner = self._owner
        self._set(
            rates=checks.numbers(owner, "rates", self.rates),
            hold=checks.positive(owner, "hold", self.hold),
            gain=checks.positive(owner, "gain", self.gain, "Use sign=-1 for a reversed command."),
            reset_time=checks.positive(owner, "reset_time", self.reset_time),
            limit=checks.positive(owner, "limit", self.limit),
            feedback=checks.feedback(owner, self.feedback),
            sign=checks.side(owner, "sign", self.sign),
            start=checks.finite(owner, "start", self.start),
            neutral=checks.finite(owner, "neutral", self.neutral),
        )

    @property
    def duration(self) -> float | None:
        """Until the last rate has been held [s]."""
        return self.start + self.hold * len(self.rates)

    def controller(self) -> Controller:
        """Return a fresh controller."""
        return _RateSteering(self)

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"reverse spiral of {self.input}: {len(self.rates)} values of {self.feedback[0]}, "
            f"{self.hold:g} s each"
        )


class _RateSteering(Controller):
    """Proportional-integral steering of a sequence of yaw rates."""

    def __init__(self, settings: ReverseSpiral) -> None:
        self._settings = settings
        self._edges = np.array(_legs(settings.start, settings.hold, settings.rates))
        self._integral = 0.0
        self._time: float | None = None
        self._command = settings.neutral

    def command(self, time: float, signals: Mapping[str, float]) -> float:
        settings = self._settings
        leg = int(interval(np.array([time]), self._edges)[0]) - 1
        if leg < 0:
            return settings.neutral
        measured = measured_signal(settings.input, settings.feedback[0], signals)
        elapsed = 0.0 if self._time is None else time - self._time
        self._time = time
        if math.isnan(measured):  # no new measurement: keep the command
            return self._command
        error = settings.sign * settings.gain * (settings.rates[leg] - measured)
        integral = self._integral + error * elapsed / settings.reset_time
        # An integral beyond the limit could not be undone in time (windup).
        self._integral = _bounded(integral, settings.limit)
        swing = _bounded(error + self._integral, settings.limit)
        self._command = settings.neutral + swing
        return self._command


def _bounded(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def _legs(start: float, hold: float, levels: Numbers) -> list[float]:
    """Return the time at which each level begins [s]."""
    return [start + index * hold for index in range(len(levels))]
