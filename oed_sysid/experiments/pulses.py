"""Short multi-step inputs: doublet and 3-2-1-1."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from oed_sysid.experiments import checks
from oed_sysid.experiments.base import OpenLoop, Waveform
from oed_sysid.experiments.waveforms import about, centre, staircase

_OTHER_SIDE = "Use first=-1 to begin to the other side."


@dataclass(frozen=True)
class Doublet(OpenLoop):
    """Two pulses of the same length and opposite sign.

    Its energy lies around the frequency ``0.37 / pulse_time`` [Hz], the peak of
    ``sin(x)**2 / x`` with ``x = pi * frequency * pulse_time``; it leaves the
    mean of the command at zero.

    Parameters
    ----------
    input : str
        Commanded channel.
    amplitude : float
        Height of the pulses, above zero.
    pulse_time : float
        Length of each pulse [s].
    start : float
        Time of the first pulse [s].
    first : int
        Side of the first pulse, +1 or -1.
    neutral : float
        Command about which it swings, held before and after: 0, or for instance the
        revolutions of cruise.

    Examples
    --------
    >>> print(Doublet("rudder", 0.2, pulse_time=2.0).commands([0, 1, 2, 3, 4]))
    [ 0.2  0.2 -0.2 -0.2  0. ]
    """

    kind: ClassVar[str] = "doublet"
    amplitude: float
    _: KW_ONLY
    pulse_time: float
    start: float = 0.0
    first: int = 1
    neutral: float = 0.0

    def _validate(self) -> None:
        self._set(
            amplitude=checks.positive(self._owner, "amplitude", self.amplitude, _OTHER_SIDE),
            pulse_time=checks.positive(self._owner, "pulse_time", self.pulse_time),
            start=checks.finite(self._owner, "start", self.start),
            neutral=checks.finite(self._owner, "neutral", self.neutral),
            first=checks.side(self._owner, "first", self.first),
        )

    @property
    def duration(self) -> float | None:
        """Until the end of the second pulse [s]."""
        return self.start + 2 * self.pulse_time

    def waveform(self) -> Waveform:
        """Return the function of time."""
        return about(
            self.neutral,
            _pulses(self.start, self.first * self.amplitude, self.pulse_time, (1, 1)),
        )

    def describe(self) -> str:
        """Return one line in words."""
        height = self.first * self.amplitude
        return (
            f"doublet of {self.input}: {height:+.4g} then {-height:+.4g}, "
            f"{self.pulse_time:g} s each, from {self.start:g} s{centre(self.neutral)}"
        )


@dataclass(frozen=True)
class ThreeTwoOneOne(OpenLoop):
    """Four alternating pulses of 3, 2, 1 and 1 units: a wide-band multi-step input.

    Parameters
    ----------
    input : str
        Commanded channel.
    amplitude : float
        Height of the pulses, above zero.
    unit_time : float
        Length of one unit [s].
    start : float
        Time of the first pulse [s].
    first : int
        Side of the first pulse, +1 or -1.
    neutral : float
        Command about which it swings, held before and after: 0, or for instance the
        revolutions of cruise.

    References
    ----------
    R. V. Jategaonkar, *Flight Vehicle System Identification*, 2nd ed., AIAA
    (2015), section 2.II.

    Examples
    --------
    >>> print(ThreeTwoOneOne("fin_command", 0.1, unit_time=1.0).commands(range(8)))
    [ 0.1  0.1  0.1 -0.1 -0.1  0.1 -0.1  0. ]
    """

    kind: ClassVar[str] = "3211"
    amplitude: float
    _: KW_ONLY
    unit_time: float
    start: float = 0.0
    first: int = 1
    neutral: float = 0.0

    def _validate(self) -> None:
        self._set(
            amplitude=checks.positive(self._owner, "amplitude", self.amplitude, _OTHER_SIDE),
            unit_time=checks.positive(self._owner, "unit_time", self.unit_time),
            start=checks.finite(self._owner, "start", self.start),
            neutral=checks.finite(self._owner, "neutral", self.neutral),
            first=checks.side(self._owner, "first", self.first),
        )

    @property
    def duration(self) -> float | None:
        """Until the end of the last pulse [s]."""
        return self.start + 7 * self.unit_time

    def waveform(self) -> Waveform:
        """Return the function of time."""
        return about(
            self.neutral,
            _pulses(self.start, self.first * self.amplitude, self.unit_time, (3, 2, 1, 1)),
        )

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"3-2-1-1 of {self.input}: {self.first * self.amplitude:+.4g} first, unit "
            f"{self.unit_time:g} s, from {self.start:g} s{centre(self.neutral)}"
        )


def _pulses(start: float, height: float, unit: float, lengths: tuple[int, ...]) -> Waveform:
    """Return alternating pulses, then zero."""
    edges = start + unit * np.concatenate([[0], np.cumsum(lengths)])
    levels = [height * (-1) ** index for index in range(len(lengths))]
    return staircase(edges.tolist(), [*levels, 0.0])
