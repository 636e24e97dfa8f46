r"""Inputs made of sines: multisine, frequency sweep, several multisines that share no line.

Several inputs at once:

.. math:: u_j(t) = \sum_{k \in K_j} a_{jk} \cos(2\pi k t/T + \varphi_{jk}), \qquad
    K_i \cap K_j = \emptyset

Over one period ``T`` signals with disjoint lines are orthogonal, also delayed against each other,
so that the answers to rudder and propeller can be told apart although both move at the same time
(Morelli 2012, *Flight test maneuvers for efficient aerodynamic modeling*, J. Aircraft 49). Phases
begin as Schroeder's; the signal is clipped, and the phases of what is left are taken, over and
over (van der Ouderaa, Schoukens & Renneboog 1988, IEEE Trans. Instrum. Meas. 37): the peak factor

.. math:: \mathrm{PF} = \frac{\max u - \min u}{2 \sqrt 2\, \mathrm{rms}(u)}

of one sine is one, that of Schroeder's phases for the lines of several inputs often 1.3 to 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from fractions import Fraction
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from oed_sysid.errors import ModelError, located
from oed_sysid.experiments import base
from oed_sysid.experiments.base import FloatArray, Numbers, Rule, Waveform
from oed_sysid.experiments.schedules import about, within

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
    neutral : float
        Command about which it swings, held before and after: 0, or for instance the
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
    >>> signal.period, round(signal.crest_factor, 2)
    (100.0, 1.89)
    """

    kind: ClassVar[str] = "multisine"
    frequencies: Numbers
    _: KW_ONLY
    amplitudes: Numbers | None = None
    phases: Numbers | None = None
    peak: float | None = None

    def _validate(self) -> None:
        owner = self._owner
        lines = base.increasing(
            owner, "frequencies", base.numbers(owner, "frequencies", self.frequencies)
        )
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
        self._set(frequencies=lines, amplitudes=sizes, phases=angles)
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
        if self.period is None:
            return total
        grid = np.max(np.abs(self._cycle(self.period)))
        return min(total, float(grid) / math.cos(math.pi / _OVERSAMPLING))

    def _cycle(self, period: float) -> FloatArray:
        """One period about neutral, on a grid of the shortest cycle's parts."""
        n_points = _OVERSAMPLING * round(period * self.frequencies[-1])
        return self._sum(np.arange(n_points) * period / n_points)

    @property
    def crest_factor(self) -> float:
        """Largest absolute command divided by its root mean square."""
        return self.largest / math.sqrt(float(np.sum(np.square(self.amplitudes or ()))) / 2)

    @property
    def duration(self) -> float | None:
        """Until the end of one period [s]; None without a period."""
        return None if self.period is None else self.start + self.period

    def waveform(self) -> Waveform:
        """Return the function of time."""
        return about(self.neutral, within(self.start, math.inf, self._sum))

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"multisine of {self.input}: {len(self.frequencies)} lines from "
            f"{self.frequencies[0]:.4g} to {self.frequencies[-1]:.4g} Hz, at most "
            f"{self.largest:.4g}{self._when}"
        )

    def _sum(self, elapsed: FloatArray) -> FloatArray:
        angles = 2 * math.pi * np.multiply.outer(elapsed, np.asarray(self.frequencies))
        total: FloatArray = np.cos(angles + np.asarray(self.phases)) @ np.asarray(self.amplitudes)
        return total


def schroeder_phases(amplitudes: Numbers) -> FloatArray:
    r"""Return phases ``(n,)`` [rad] that give equally spaced lines a low peak.

    .. math:: \varphi_k = -2 \pi \sum_{j<k} (k - j) \, a_j^2 / \sum_j a_j^2

    Examples
    --------
    >>> import numpy as np
    >>> print(np.round(schroeder_phases([1.0, 1.0, 1.0]) / np.pi, 3))
    [-0.    -0.667 -2.   ]
    """
    power = np.square(np.asarray(amplitudes, dtype=float))
    share = np.concatenate([[0.0], np.cumsum(power / power.sum())[:-1]])
    phases: FloatArray = -2 * math.pi * np.cumsum(share)
    return phases


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
    neutral : float
        Command about which it swings, held before and after: 0, or for instance the
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
        swing = within(self.start, self.start + self.sweep_time, self._sweep)
        return about(self.neutral, swing)

    def describe(self) -> str:
        """Return one line in words."""
        return (
            f"{self.law} chirp of {self.input}: +-{self.amplitude:.4g}, "
            f"{self.first_frequency:g} to {self.last_frequency:g} Hz in {self.sweep_time:g} s"
            f"{self._when}"
        )

    def _sweep(self, elapsed: FloatArray) -> FloatArray:
        share = np.clip(elapsed / self.sweep_time, 0.0, 1.0)
        growth = math.log(self.last_frequency / self.first_frequency)
        if self.law == "linear" or growth == 0:
            mean = self.first_frequency + (self.last_frequency - self.first_frequency) * share / 2
            cycles = mean * share * self.sweep_time
        else:
            cycles = self.first_frequency * self.sweep_time / growth * np.expm1(growth * share)
        wave: FloatArray = self.amplitude * np.sin(2 * math.pi * cycles)
        return wave


def orthogonal_multisines(
    peaks: Mapping[str, float],
    *,
    period: float,
    lowest: float,
    highest: float,
    spectra: Mapping[str, Callable[[FloatArray], FloatArray]] | None = None,
    start: float = 0.0,
    neutral: Mapping[str, float] | None = None,
) -> tuple[Multisine, ...]:
    """Return one multisine for each input, on lines that no other has.

    Parameters
    ----------
    peaks : mapping of str to float
        Largest departure from neutral by input, in its unit.
    period : float
        Common period [s]; lines are multiples of its inverse.
    lowest, highest : float
        Band [Hz].
    spectra : mapping of str to callable, optional
        Relative amplitude over frequency [Hz] by input; flat by default.
    start : float
        Time at which all begin [s].
    neutral : mapping of str to float, optional
        Command about which each swings.

    Returns
    -------
    tuple of Multisine
        In the order of ``peaks``; give them to one experiment together.

    Raises
    ------
    ModelError
        If the band holds fewer than two lines for each input.

    Examples
    --------
    >>> rudder, propeller = orthogonal_multisines(
    ...     {"rudder": 0.2, "propeller": 1.0}, period=100.0, lowest=0.01, highest=0.2
    ... )
    >>> set(rudder.frequencies) & set(propeller.frequencies)
    set()
    >>> round(rudder.crest_factor, 2), round(propeller.crest_factor, 2)
    (1.44, 1.52)
    """
    for given in (spectra, neutral):
        if peaks:
            located(ModelError, "The set of peaks has no input", given or {}, peaks)
    lines = _common_lines(tuple(peaks), period, lowest, highest)
    found = []
    for position, (name, peak) in enumerate(peaks.items()):
        own = lines[position :: len(peaks)]
        shape = (spectra or {}).get(name, np.ones_like)
        amplitudes = np.asarray(shape(own / period), dtype=float)
        found.append(
            Multisine(
                name, (own / period).tolist(), amplitudes=amplitudes.tolist(),
                phases=low_peak_phases(own, amplitudes).tolist(), peak=peak, start=start,
                neutral=(neutral or {}).get(name, 0.0),
            )
        )  # fmt: skip
    return tuple(found)


def _common_lines(
    inputs: tuple[str, ...], period: float, lowest: float, highest: float
) -> NDArray[np.int64]:
    """Multiples of the base frequency within the band, enough for all inputs."""
    if not inputs or not (np.isfinite(period) and period > 0) or not 0 < lowest < highest:
        raise ModelError(
            f"Orthogonal multisines of {', '.join(inputs) or 'no input'} with period {period} s "
            f"and band {lowest} to {highest} Hz. Give inputs with peaks, a period and a rising "
            "band."
        )
    first = int(np.ceil(lowest * period - 1e-9))
    last = int(np.floor(highest * period + 1e-9))
    lines = np.arange(max(first, 1), last + 1)
    if len(lines) < 2 * len(inputs):
        raise ModelError(
            f"The band {lowest:g} to {highest:g} Hz holds {len(lines)} lines of period "
            f"{period:g} s for {len(inputs)} inputs. Give a longer period or a wider band: two "
            "lines each."
        )
    return lines


def low_peak_phases(lines: np.ndarray, amplitudes: np.ndarray) -> FloatArray:
    """Return phases [rad] that give a sum of cosines a low peak.

    Parameters
    ----------
    lines : ndarray of int (n,)
        Multiples of the base frequency.
    amplitudes : ndarray (n,)

    Returns
    -------
    ndarray (n,)
    """
    n = 16 * int(lines.max())
    phases = schroeder_phases(amplitudes.tolist())
    best, best_peak = phases, np.inf
    for sweep in range(400):
        spectrum = np.zeros(n // 2 + 1, dtype=complex)
        spectrum[lines] = 0.5 * n * amplitudes * np.exp(1j * phases)
        signal = np.fft.irfft(spectrum, n)
        peak = float(np.abs(signal).max())
        if peak < best_peak:
            best, best_peak = phases, peak
        # Clipped at a share of the peak that rises to the peak itself.
        share = 0.75 + 0.25 * sweep / 400
        clipped = np.clip(signal, -share * peak, share * peak)
        phases = np.angle(np.fft.rfft(clipped)[lines])
    found: FloatArray = best
    return found
