"""Commands that are functions of time: steps and holds, pulses, sequences, tables, sines.

Most are a schedule, times at which the order changes and the order from then on, played as a
staircase about a trim command: at once, or at the limited rate of a steering gear.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from fractions import Fraction
from itertools import accumulate
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from oed_sysid.errors import ModelError
from oed_sysid.experiments import base
from oed_sysid.experiments.base import FloatArray, Numbers, Rule, Waveform
from oed_sysid.physics.channels import INTERPOLATIONS
from oed_sysid.runtime.constants import ROUNDING


def interval(times: FloatArray, edges: NDArray[np.floating]) -> NDArray[np.intp]:
    """Return for each time how many of the increasing ``edges`` have passed."""
    # A switch at 0.1 * 3 s has happened on the sample at 0.3 s.
    return np.searchsorted(edges, times + ROUNDING * (1 + np.abs(times)), side="right")


def staircase(
    times: Numbers,
    levels: Numbers,
    *,
    before: float = 0.0,
    rate: float | None = None,
) -> Waveform:
    """Return a command that steps, or moves at a limited rate, to each level.

    Parameters
    ----------
    times : sequence of float, shape (n,)
        Increasing times of the steps [s].
    levels : sequence of float, shape (n,)
        Command ordered at each step.
    before : float
        Command before the first step.
    rate : float or None
        Largest slope [unit/s]; None lets the command jump.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = staircase([1.0], [0.3], rate=0.1)
    >>> print(ramp(np.array([0.0, 2.0, 9.0])))
    [0.  0.1 0.3]
    """
    if rate is None:
        held, edges = np.array([before, *levels]), np.array(times)
        return lambda moments: held[interval(moments, edges)]
    # A ramp may be cut off by the next order before it has arrived.
    corners, value = [(times[0], before)], before
    for begin, end, level in zip(times, [*times[1:], math.inf], levels, strict=True):
        arrival = begin + abs(level - value) / rate
        corners.append((begin, value))
        if arrival <= end:
            value = level
            corners.append((arrival, value))
        else:
            value += math.copysign(rate * (end - begin), level - value)
    corner_times, corner_values = np.array(corners).T
    return lambda moments: np.interp(moments, corner_times, corner_values)


def about(trim: float, wave: Waveform) -> Waveform:
    """Return a waveform about a trim command instead of about zero."""
    return wave if trim == 0.0 else lambda moments: trim + wave(moments)


def within(start: float, end: float, inside: Waveform) -> Waveform:
    """Return ``inside`` of the time since ``start``, and zero outside start to end [s]."""

    def windowed(moments: FloatArray) -> FloatArray:
        running = interval(moments, np.array([start, end])) == 1
        return np.where(running, inside(moments - start), 0.0)

    return windowed


@dataclass(frozen=True)
class Constant(base.OpenLoop):
    """The same command at all times.

    Examples
    --------
    >>> Constant("thrust", 700.0).describe()
    'thrust constant at 700'
    """

    kind: ClassVar[str] = "constant"
    rules: ClassVar[Mapping[str, Rule]] = {"value": base.finite}
    value: float

    def waveform(self) -> Waveform:
        """Return the function of time."""
        return lambda times: np.full(len(times), self.value)

    def describe(self) -> str:
        """Return one line in words."""
        return f"{self.input} constant at {self.value:g}"


class Scheduled(base.OpenLoop, base.Timed):
    """A manoeuvre that is a schedule of orders about a trim command."""

    @abstractmethod
    def schedule(self) -> tuple[Numbers, Numbers]:
        """Return times since ``start`` ``(n,)`` [s] and the order from each on ``(n,)``."""

    def waveform(self) -> Waveform:
        """Return the function of time; the last order is kept."""
        times, orders = self.schedule()
        moments = [self.start + time for time in times]
        return about(self.trim, staircase(moments, orders, rate=getattr(self, "rate", None)))


@dataclass(frozen=True)
class TurningCircle(Scheduled):
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
    trim : float
        Command about which it moves, held before: 0, or the trim of the command.

    References
    ----------
    IMO Resolution MSC.137(76), Annex, 4.2.2 (2002): 35 degrees or the maximum.

    Examples
    --------
    >>> run = TurningCircle("rudder", 0.6, start=10.0)
    >>> run.commands([0.0, 20.0])
    array([0. , 0.6])
    """

    kind: ClassVar[str] = "turning_circle"
    rules: ClassVar[Mapping[str, Rule]] = {"amplitude": base.not_zero("Its sign is the side.")}
    amplitude: float
    _: KW_ONLY
    rate: float | None = None

    def schedule(self) -> tuple[Numbers, Numbers]:
        """Return times since ``start`` and orders."""
        return [0.0], [self.amplitude]

    def describe(self) -> str:
        """Return one line in words."""
        angle = math.degrees(self.amplitude)
        return f"turning circle with {self.input} at {angle:.3g} deg from {self.start:g} s"


@dataclass(frozen=True)
class PullOut(Scheduled):
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
    trim : float
        Command about which it moves, held before: 0, or the trim of the command.

    Examples
    --------
    >>> run = PullOut("rudder", 0.35, start=5.0, turn_duration=60.0)
    >>> run.commands([0.0, 10.0, 70.0])
    array([0.  , 0.35, 0.  ])
    """

    kind: ClassVar[str] = "pull_out"
    rules: ClassVar[Mapping[str, Rule]] = {"amplitude": base.not_zero("Its sign is the side.")}
    amplitude: float
    _: KW_ONLY
    turn_duration: float
    rate: float | None = None

    @property
    def duration(self) -> float | None:
        """The turn, and as long again for the decay [s]."""
        return self.start + 2 * self.turn_duration

    def schedule(self) -> tuple[Numbers, Numbers]:
        """Return times since ``start`` and orders."""
        return [0.0, self.turn_duration], [self.amplitude, 0.0]

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"pull-out from a turn of {self.turn_duration:g} s with {self.input} at "
            f"{math.degrees(self.amplitude):.3g} deg"
        )


class Pulses(Scheduled):
    """Alternating pulses of ``lengths`` in units of time, then the trim command again."""

    lengths: ClassVar[tuple[int, ...]]
    rules: ClassVar[Mapping[str, Rule]] = {"amplitude": base.above_zero(base.OTHER_SIDE)}
    amplitude: float
    first: int

    @property
    @abstractmethod
    def unit(self) -> float:
        """Length of the shortest pulse [s]."""

    @property
    def duration(self) -> float | None:
        """Until the end of the last pulse [s]."""
        return self.start + sum(self.lengths) * self.unit

    def schedule(self) -> tuple[Numbers, Numbers]:
        """Return times since ``start`` and orders."""
        heights = [self.height * (-1) ** index for index in range(len(self.lengths))]
        return [self.unit * n for n in accumulate(self.lengths, initial=0)], [*heights, 0.0]

    @property
    def height(self) -> float:
        """First order about the trim command."""
        return self.first * self.amplitude


@dataclass(frozen=True)
class Doublet(Pulses):
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
    trim : float
        Command about which it moves, held before and after: 0, or for instance the
        revolutions of cruise.

    Examples
    --------
    >>> print(Doublet("rudder", 0.2, pulse_time=2.0).commands([0, 1, 2, 3, 4]))
    [ 0.2  0.2 -0.2 -0.2  0. ]
    """

    kind: ClassVar[str] = "doublet"
    lengths: ClassVar[tuple[int, ...]] = (1, 1)
    amplitude: float
    _: KW_ONLY
    pulse_time: float
    first: int = 1

    @property
    def unit(self) -> float:
        """Length of each pulse [s]."""
        return self.pulse_time

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"doublet of {self.input}: {self.height:+.4g} then {-self.height:+.4g}, "
            f"{self.pulse_time:g} s each{self._when}"
        )


@dataclass(frozen=True)
class ThreeTwoOneOne(Pulses):
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
    trim : float
        Command about which it moves, held before and after: 0, or for instance the
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
    lengths: ClassVar[tuple[int, ...]] = (3, 2, 1, 1)
    amplitude: float
    _: KW_ONLY
    unit_time: float
    first: int = 1

    @property
    def unit(self) -> float:
        """Length of one unit [s]."""
        return self.unit_time

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"3-2-1-1 of {self.input}: {self.height:+.4g} first, unit "
            f"{self.unit_time:g} s{self._when}"
        )


@dataclass(frozen=True)
class Spiral(Scheduled):
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
    trim : float
        Command about which it moves, held before: 0, or the trim of the command.

    Examples
    --------
    >>> run = Spiral("rudder", [0.2, 0.0, -0.2], hold=60.0)
    >>> run.commands([10.0, 70.0, 130.0])
    array([ 0.2,  0. , -0.2])
    """

    kind: ClassVar[str] = "spiral"
    angles: Numbers
    _: KW_ONLY
    hold: float
    rate: float | None = None

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
        farthest = base.not_zero("Its sign is the side to begin with.")(owner, "largest", largest)
        count = max(1, round(abs(farthest) / base.positive(owner, "step", step)))
        across = [largest * index / count for index in range(count, -count - 1, -1)]
        return cls(input, (*across, *across[-2::-1]), hold=hold, rate=rate)

    @property
    def duration(self) -> float | None:
        """Until the last angle has been held [s]."""
        return self.start + self.hold * len(self.angles)

    def schedule(self) -> tuple[Numbers, Numbers]:
        """Return times since ``start`` and orders."""
        return [index * self.hold for index in range(len(self.angles))], self.angles

    def describe(self) -> str:
        """Return one line in words."""
        first, last = math.degrees(self.angles[0]), math.degrees(self.angles[-1])
        return (
            f"direct spiral of {self.input}: {len(self.angles)} angles from {first:.3g} to "
            f"{last:.3g} deg, {self.hold:g} s each"
        )


class Tabulated(base.OpenLoop):
    """A command through the points of a table."""

    rules: ClassVar[Mapping[str, Rule]] = {"interpolation": base.one_of(*INTERPOLATIONS)}
    times: Numbers
    values: Numbers
    interpolation: str

    def _validate(self) -> None:
        if len(self.times) != len(self.values):
            raise ModelError(
                f"{self._owner} has {len(self.times)} times but {len(self.values)} values. Give "
                "one value per time."
            )

    @property
    def _delay(self) -> float:
        """How much later than its times it is played [s]."""
        return 0.0

    @property
    def duration(self) -> float | None:
        """Until the last value [s]."""
        return self.times[-1] + self._delay

    def waveform(self) -> Waveform:
        """Return the function of time through the values."""
        points, levels = np.asarray(self.times) + self._delay, np.asarray(self.values)
        if self.interpolation == "hold":
            return staircase(points.tolist(), levels.tolist(), before=float(levels[0]))
        return lambda moments: np.interp(moments, points, levels)


@dataclass(frozen=True)
class Piecewise(Tabulated):
    """Command through given points; designed inputs have this form.

    Before the first time the first value holds, after the last time the last.

    Parameters
    ----------
    input : str
        Commanded channel.
    times : sequence of float, shape (n,)
        Increasing times [s].
    values : sequence of float, shape (n,)
        Command at each time.
    interpolation : {"hold", "linear"}
        What happens between: keep the last value, or connect the points.

    Examples
    --------
    >>> print(Piecewise("rudder", [0, 2], [0.0, 0.2], interpolation="linear").commands([1, 5]))
    [0.1 0.2]
    """

    kind: ClassVar[str] = "piecewise"
    times: Numbers
    values: Numbers
    _: KW_ONLY
    interpolation: str = "hold"

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"piecewise {self.interpolation} command of {self.input}: {len(self.times)} points "
            f"from {self.times[0]:g} to {self.times[-1]:g} s"
        )


@dataclass(frozen=True)
class FromRecord(Tabulated):
    """Replay of a recorded command; the first recorded time becomes ``start``.

    Parameters
    ----------
    input : str
        Commanded channel.
    times : sequence of float, shape (n,)
        Times of the record [s], increasing, on any clock.
    values : sequence of float, shape (n,)
        Recorded command, without gaps.
    record : str
        Name of the record, for the description.
    interpolation : {"hold", "linear"}
        What happens between the samples.
    start : float
        Time at which the replay begins [s].

    Examples
    --------
    >>> replay = FromRecord("rudder", [600.0, 601.0], [0.0, 0.2], record="trial_3")
    >>> print(replay.commands([0.0, 1.0]), replay.duration)
    [0.  0.2] 1.0
    """

    kind: ClassVar[str] = "from_record"
    times: Numbers
    values: Numbers
    _: KW_ONLY
    record: str = ""
    interpolation: str = "hold"
    start: float = 0.0

    def describe(self) -> str:
        """Return one line in words."""
        source = f" of record {self.record!r}" if self.record else ""
        return f"replay of {self.input}{source}: {len(self.times)} samples from {self.start:g} s"

    @property
    def _delay(self) -> float:
        """From the first time to the start [s]."""
        return self.start - self.times[0]


# Feedback taps of maximum-length shift registers, one set of each order:
# P. Alfke, Efficient Shift Registers, LFSR Counters, and Long Pseudo-Random
# Sequence Generators, Xilinx XAPP 052 (1996), table 3.
# fmt: off
_TAPS = {
    2: (2, 1), 3: (3, 2), 4: (4, 3), 5: (5, 3), 6: (6, 5), 7: (7, 6), 8: (8, 6, 5, 4), 9: (9, 5),
    10: (10, 7), 11: (11, 9), 12: (12, 6, 4, 1), 13: (13, 4, 3, 1), 14: (14, 5, 3, 1),
    15: (15, 14), 16: (16, 15, 13, 4),
}
# fmt: on


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
    from scipy.signal import max_len_seq  # slow to import, and needed here only

    register = [seed >> place & 1 for place in range(order)]
    taps = [order - tap for tap in _TAPS[order][1:]]
    return 2.0 * max_len_seq(order, state=register, taps=taps)[0] - 1.0


@dataclass(frozen=True)
class PRBS(base.OpenLoop, base.Timed):
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
    trim : float
        Command about which it moves, held before and after: 0, or for instance the
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

    def _validate(self) -> None:
        owner = self._owner
        if self.order not in _TAPS:
            raise ModelError(f"{owner} has order {self.order!r}. Choose one from 2 to 16.")
        if int(self.seed) != self.seed or not 1 <= self.seed < 2**self.order:
            raise ModelError(
                f"{owner} has seed {self.seed!r}; it is the first content of the shift register: "
                f"choose 1 to {2**self.order - 1}."
            )
        self._set(order=int(self.order), seed=int(self.seed))

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

        def bits_at(times: FloatArray) -> FloatArray:
            # Bits are counted, not multiplied out, so that no edge is lost to rounding.
            bits = np.floor((times - self.start) / self.bit_time + ROUNDING).astype(int)
            return np.where(bits < 0, 0.0, levels[bits % len(levels)])

        return about(self.trim, bits_at)

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"PRBS of {self.input}: +-{self.amplitude:.4g}, {2**self.order - 1} bits of "
            f"{self.bit_time:g} s{self._when}"
        )


_OVERSAMPLING = 64  # grid points in the shortest cycle of a multisine
_MOST_HARMONICS = 20_000  # beyond, a multisine counts as not periodic


@dataclass(frozen=True)
class Multisine(base.OpenLoop, base.Timed):
    r"""Sum of cosines at chosen frequencies.

    .. math:: u(t) = \sum_k a_k \cos(2 \pi f_k (t - t_0) + \varphi_k)

    Parameters
    ----------
    input : str
        Commanded channel.
    frequencies : sequence of float, shape (n,)
        Frequencies [Hz], increasing, above zero.
    amplitudes : sequence of float, shape (n,), optional
        Amplitude of each line; all 1 by default, which needs a ``peak``.
    phases : sequence of float, shape (n,), optional
        Phases [rad]; by default those of Schroeder, which keep the peak low
        when the frequencies are multiples of their spacing.
    peak : float, optional
        Scale all amplitudes by one factor, so that the largest absolute command
        comes within 0.2 % of this limit and never above it. Frequencies without
        a common period are scaled by the sum of their amplitudes.
    start : float
        Time at which it begins [s]; zero before.
    trim : float
        Command about which it moves, held before and after: 0, or for instance the
        revolutions of cruise.

    References
    ----------
    M. R. Schroeder, Synthesis of low-peak-factor signals and binary sequences
    with low autocorrelation, *IEEE Trans. Information Theory* 16 (1970) 85-89,
    equation 11. H. Ehlich and K. Zeller, *Math. Z.* 86 (1964) 41-44: bound of a
    trigonometric polynomial by its values on a grid.

    Examples
    --------
    >>> signal = Multisine("rudder", [0.01, 0.02, 0.03, 0.04], peak=0.2)
    >>> signal.period, round(signal.largest, 2)
    (100.0, 0.2)
    """

    kind: ClassVar[str] = "multisine"
    rules: ClassVar[Mapping[str, Rule]] = {"frequencies": base.RULES["times"]}
    frequencies: Numbers
    _: KW_ONLY
    amplitudes: Numbers | None = None
    phases: Numbers | None = None
    peak: float | None = None

    def _validate(self) -> None:
        owner = self._owner
        lines = self.frequencies
        base.positive(owner, "first frequency", lines[0], "Use Constant for a mean value.")
        if self.amplitudes is None and self.peak is None:
            raise ModelError(f"{owner} has neither amplitudes nor a peak. Give one of them.")
        given = [1.0] * len(lines) if self.amplitudes is None else self.amplitudes
        sizes = base.each_positive("Use a phase of pi to invert it.")(owner, "amplitudes", given)
        angles = schroeder_phases(sizes) if self.phases is None else self.phases
        angles = base.numbers(owner, "phases", angles)
        for name, values in (("amplitudes", sizes), ("phases", angles)):
            if len(values) != len(lines):
                raise ModelError(
                    f"{owner} has {len(lines)} frequencies but {len(values)} {name}. "
                    "Give one of each for every line."
                )
        self._set(amplitudes=sizes, phases=angles)
        if self.peak is not None:
            factor = base.positive(owner, "peak", self.peak) / self.largest
            # Stored numbers that are already at the limit are kept as they are.
            if abs(factor - 1) > 1e-9:
                self._set(amplitudes=tuple(factor * size for size in sizes))
            self._set(peak=float(self.peak))

    @property
    def period(self) -> float | None:
        """Common period of all lines [s]; None if they have none of usable length."""
        base = self.frequencies[0]
        ratios = [Fraction(line / base).limit_denominator(1000) for line in self.frequencies]
        if not np.allclose([ratio * base for ratio in ratios], self.frequencies, rtol=1e-9, atol=0):
            return None
        count = math.lcm(*(ratio.denominator for ratio in ratios))
        return count / base if ratios[-1] * count <= _MOST_HARMONICS else None

    @property
    def largest(self) -> float:
        """Upper bound of the absolute command, within 0.2 % of it for a periodic signal."""
        total = float(np.sum(np.asarray(self.amplitudes)))
        if (period := self.period) is None:
            return total
        # One period about trim, on a grid of the shortest cycle's parts.
        n_points = _OVERSAMPLING * round(period * self.frequencies[-1])
        grid = np.max(np.abs(self._sum(np.arange(n_points) * period / n_points)))
        return min(total, float(grid) / math.cos(math.pi / _OVERSAMPLING))

    @property
    def duration(self) -> float | None:
        """Until the end of one period [s]; None without a period."""
        return None if self.period is None else self.start + self.period

    def waveform(self) -> Waveform:
        """Return the function of time."""
        return about(self.trim, within(self.start, math.inf, self._sum))

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"multisine of {self.input}: {len(self.frequencies)} lines from "
            f"{self.frequencies[0]:.4g} to {self.frequencies[-1]:.4g} Hz, at most "
            f"{self.largest:.4g}{self._when}"
        )

    def _sum(self, elapsed: FloatArray) -> FloatArray:
        angles = 2 * math.pi * np.multiply.outer(elapsed, np.asarray(self.frequencies))
        return np.cos(angles + np.asarray(self.phases)) @ np.asarray(self.amplitudes)


def schroeder_phases(amplitudes: Numbers) -> FloatArray:
    r"""Return phases ``(n,)`` [rad] that give equally spaced lines a low peak.

    .. math:: \varphi_k = -2 \pi \sum_{j<k} (k - j) \, a_j^2 / \sum_j a_j^2

    Returns
    -------
    ndarray (n_lines,)
        Phases, rad.

    Examples
    --------
    >>> import numpy as np
    >>> print(np.round(schroeder_phases([1.0, 1.0, 1.0]) / np.pi, 3))
    [-0.    -0.667 -2.   ]
    """
    power = np.square(np.asarray(amplitudes, dtype=float))
    share = np.concatenate([[0.0], np.cumsum(power / power.sum())[:-1]])
    return -2 * math.pi * np.cumsum(share)


@dataclass(frozen=True)
class Chirp(base.OpenLoop, base.Timed):
    """Sine of a frequency that sweeps from one value to another, then zero.

    Parameters
    ----------
    input : str
        Commanded channel.
    amplitude : float
        Amplitude, above zero.
    first_frequency, last_frequency : float
        Frequency at the beginning and at the end [Hz].
    sweep_time : float
        Length of the sweep [s].
    law : {"linear", "log"}
        Equal time for equal differences, or for equal ratios of frequency.
    start : float
        Time at which it begins [s].
    trim : float
        Command about which it moves, held before and after: 0, or for instance the
        revolutions of cruise.

    Examples
    --------
    >>> sweep = Chirp("rudder", 0.1, first_frequency=0.01, last_frequency=0.1, sweep_time=200.0)
    >>> sweep.describe()
    'linear chirp of rudder: +-0.1, 0.01 to 0.1 Hz in 200 s, from 0 s'
    """

    kind: ClassVar[str] = "chirp"
    rules: ClassVar[Mapping[str, Rule]] = {"law": base.one_of("linear", "log")}
    amplitude: float
    _: KW_ONLY
    first_frequency: float
    last_frequency: float
    sweep_time: float
    law: str = "linear"

    @property
    def duration(self) -> float | None:
        """Until the end of the sweep [s]."""
        return self.start + self.sweep_time

    def waveform(self) -> Waveform:
        """Return the function of time."""
        return about(self.trim, within(self.start, self.start + self.sweep_time, self._sweep))

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"{self.law} chirp of {self.input}: +-{self.amplitude:.4g}, "
            f"{self.first_frequency:g} to {self.last_frequency:g} Hz in {self.sweep_time:g} s"
            f"{self._when}"
        )

    def _sweep(self, elapsed: FloatArray) -> FloatArray:
        from scipy.signal import chirp  # slow to import, and needed here only

        # A cosine, a quarter of a cycle late.
        ends = self.first_frequency, self.sweep_time, self.last_frequency
        way = {"linear": "linear", "log": "logarithmic"}[self.law]
        return self.amplitude * chirp(elapsed, *ends, method=way, phi=-90)
