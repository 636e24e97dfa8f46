"""Pseudo-random binary sequences from a shift register."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.experiments import checks
from oed_sysid.experiments.base import OpenLoop, Waveform
from oed_sysid.experiments.checks import FloatArray
from oed_sysid.experiments.waveforms import about, centre

# Feedback taps of maximum-length shift registers, one set of each order:
# P. Alfke, Efficient Shift Registers, LFSR Counters, and Long Pseudo-Random
# Sequence Generators, Xilinx XAPP 052 (1996), table 3.
_TAPS = {
    2: (2, 1),
    3: (3, 2),
    4: (4, 3),
    5: (5, 3),
    6: (6, 5),
    7: (7, 6),
    8: (8, 6, 5, 4),
    9: (9, 5),
    10: (10, 7),
    11: (11, 9),
    12: (12, 6, 4, 1),
    13: (13, 4, 3, 1),
    14: (14, 5, 3, 1),
    15: (15, 14),
    16: (16, 15, 13, 4),
}


def maximum_length_sequence(order: int, *, seed: int = 1) -> FloatArray:
    """Return one period of a maximum-length binary sequence of +1 and -1.

    Parameters
    ----------
    order : int
        Length of the shift register, 2 to 16.
    seed : int
        Its first content, 1 to ``2**order - 1``; another seed shifts the
        sequence in time.

    Returns
    -------
    ndarray, shape (2**order - 1,)
        The sequence; its circular autocorrelation is ``n`` at lag 0 and -1 at
        all other lags.

    Examples
    --------
    >>> print(maximum_length_sequence(3))
    [ 1. -1. -1.  1. -1.  1.  1.]
    """
    register, length = seed, 2**order - 1
    bits = np.empty(length)
    for index in range(length):
        bits[index] = register & 1
        fed_back = 0
        for tap in _TAPS[order]:
            fed_back ^= register >> (order - tap)
        register = (register >> 1) | ((fed_back & 1) << (order - 1))
    return 2 * bits - 1


@dataclass(frozen=True)
class PRBS(OpenLoop):
    """Pseudo-random binary sequence of maximum length, repeated.

    Its spectrum is flat up to about ``0.44 / bit_time`` [Hz] (half power); the
    longest time on one side is ``order * bit_time``.

    Parameters
    ----------
    input : str
        Commanded channel.
    amplitude : float
        Command to either side, above zero.
    bit_time : float
        Shortest time on one side [s].
    order : int
        Length of the shift register, 2 to 16; the period has ``2**order - 1`` bits.
    seed : int
        First content of the register, 1 to ``2**order - 1``: where in its
        period the sequence begins. Draw it from a generator for a random one.
    start : float
        Time of the first bit [s]; zero before.
    neutral : float
        Command about which it swings, held before and after: 0, or for instance the
        revolutions of cruise.

    References
    ----------
    L. Ljung, *System Identification: Theory for the User*, 2nd ed. (1999),
    section 13.3.

    Examples
    --------
    >>> sequence = PRBS("rudder", 0.1, bit_time=2.0, order=5)
    >>> sequence.period
    62.0
    """

    kind: ClassVar[str] = "prbs"
    amplitude: float
    _: KW_ONLY
    bit_time: float
    order: int = 7
    seed: int = 1
    start: float = 0.0
    neutral: float = 0.0

    def _validate(self) -> None:
        owner = self._owner
        if self.order not in _TAPS:
            raise ModelError(f"{owner} has order {self.order!r}. Choose one from 2 to 16.")
        if int(self.seed) != self.seed or not 1 <= self.seed < 2**self.order:
            raise ModelError(
                f"{owner} has seed {self.seed!r}; it is the first content of the shift register: "
                f"choose 1 to {2**self.order - 1}."
            )
        self._set(
            amplitude=checks.positive(owner, "amplitude", self.amplitude),
            bit_time=checks.positive(owner, "bit_time", self.bit_time),
            order=int(self.order),
            seed=int(self.seed),
            start=checks.finite(owner, "start", self.start),
            neutral=checks.finite(owner, "neutral", self.neutral),
        )

    @property
    def period(self) -> float:
        """Time after which the sequence repeats [s]."""
        return float((2**self.order - 1) * self.bit_time)

    @property
    def duration(self) -> float | None:
        """Until the end of one period [s]."""
        return self.start + self.period

    def waveform(self) -> Waveform:
        """Return the function of time."""
        levels = self.amplitude * maximum_length_sequence(self.order, seed=self.seed)

        def play(times: FloatArray) -> FloatArray:
            # Bits are counted, not multiplied out, so that no edge is lost to rounding.
            bits = np.floor((times - self.start) / self.bit_time + 1e-9).astype(int)
            return np.where(bits < 0, 0.0, levels[bits % len(levels)])

        return about(self.neutral, play)

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"PRBS of {self.input}: +-{self.amplitude:.4g}, {2**self.order - 1} bits of "
            f"{self.bit_time:g} s, from {self.start:g} s{centre(self.neutral)}"
        )
