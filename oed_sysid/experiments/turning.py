"""Constant commands and manoeuvres that hold one angle: turning circle and pull-out."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from oed_sysid.experiments import checks
from oed_sysid.experiments.base import OpenLoop, Waveform
from oed_sysid.experiments.waveforms import about, staircase


@dataclass(frozen=True)
class Constant(OpenLoop):
    """The same command at all times.

    Examples
    --------
    >>> Constant("thrust", 700.0).describe()
    'thrust constant at 700'
    """

    kind: ClassVar[str] = "constant"
    value: float

    def _validate(self) -> None:
        self._set(value=checks.finite(self._owner, "value", self.value))

    @property
    def duration(self) -> float | None:
        """None: it has no end."""
        return None

    def waveform(self) -> Waveform:
        """Return the function of time."""
        return lambda times: np.full(len(times), self.value)

    def describe(self) -> str:
        """Return one line in words."""
        return f"{self.input} constant at {self.value:g}"


@dataclass(frozen=True)
class TurningCircle(OpenLoop):
    """Turning circle: after a straight approach an angle is put on and held.

    Parameters
    ----------
    input : str
        Commanded channel.
    amplitude : float
        Held angle [rad]; its sign is the side.
    start : float
        Time of the execute [s].
    rate : float or None
        Largest slope of the command [rad/s]; None lets it jump.
    neutral : float
        Command about which it moves, held before: 0, or the trim of the command.

    References
    ----------
    IMO Resolution MSC.137(76), Annex, 4.2.2 (2002): 35 degrees or the maximum.
    """

    kind: ClassVar[str] = "turning_circle"
    amplitude: float
    _: KW_ONLY
    start: float = 0.0
    rate: float | None = None
    neutral: float = 0.0

    def _validate(self) -> None:
        self._set(
            amplitude=checks.not_zero(
                self._owner, "amplitude", self.amplitude, "Its sign is the side."
            ),
            start=checks.finite(self._owner, "start", self.start),
            neutral=checks.finite(self._owner, "neutral", self.neutral),
            rate=checks.slope(self._owner, self.rate),
        )

    @property
    def duration(self) -> float | None:
        """None: it depends on the vehicle; 540 degrees of turn are usual."""
        return None

    def waveform(self) -> Waveform:
        """Return the function of time."""
        swing = staircase([self.start], [self.amplitude], rate=self.rate)
        return about(self.neutral, swing)

    def describe(self) -> str:
        """Return one line in words."""
        angle = math.degrees(self.amplitude)
        return f"turning circle with {self.input} at {angle:.3g} deg from {self.start:g} s"


@dataclass(frozen=True)
class PullOut(OpenLoop):
    """Pull-out: turn with a held angle, then midships, and watch the yaw rate decay.

    A stable vehicle comes to a straight course, the same after turns to either
    side; an unstable one keeps on turning.

    Parameters
    ----------
    input : str
        Commanded channel.
    amplitude : float
        Held angle [rad]; its sign is the side.
    turn_duration : float
        How long it is held [s]: until the turn is steady.
    start : float
        Time of the execute [s].
    rate : float or None
        Largest slope of the command [rad/s]; None lets it jump.
    neutral : float
        Command about which it moves, held before: 0, or the trim of the command.
    """

    kind: ClassVar[str] = "pull_out"
    amplitude: float
    _: KW_ONLY
    turn_duration: float
    start: float = 0.0
    rate: float | None = None
    neutral: float = 0.0

    def _validate(self) -> None:
        self._set(
            amplitude=checks.not_zero(
                self._owner, "amplitude", self.amplitude, "Its sign is the side."
            ),
            turn_duration=checks.positive(self._owner, "turn_duration", self.turn_duration),
            start=checks.finite(self._owner, "start", self.start),
            neutral=checks.finite(self._owner, "neutral", self.neutral),
            rate=checks.slope(self._owner, self.rate),
        )

    @property
    def duration(self) -> float | None:
        """The turn, and as long again for the decay [s]."""
        return self.start + 2 * self.turn_duration

    def waveform(self) -> Waveform:
        """Return the function of time."""
        release = self.start + self.turn_duration
        swing = staircase([self.start, release], [self.amplitude, 0.0], rate=self.rate)
        return about(self.neutral, swing)

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"pull-out from a turn of {self.turn_duration:g} s with {self.input} at "
            f"{math.degrees(self.amplitude):.3g} deg"
        )
