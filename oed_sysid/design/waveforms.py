r"""Families of commands: numbers between 0 and 1 become commands within their limits.

Amplitude and rate limits of the actuators are kept by construction, so that
the search only has to mind what the vehicle does. The first sample is always
the trim command: nothing jumps before the experiment begins.

Sums of sines, with frequencies that must not be excited left out.

On a run of length :math:`T` with ``n`` lines at multiples of :math:`1/T`,

.. math::
    \delta(t) = \delta_0 + \rho\, \frac{\delta_{max} - \delta_{min}}2 \sum_{i=1}^n
    \left(a_i \cos 2\pi f_i t + b_i \sin 2\pi f_i t\right), \qquad
    f_i = \frac{k_i}{T} \notin \text{forbidden bands}

with free :math:`a_i, b_i \in [-1, 1]`; :math:`\rho = 1` and the sum clipped, or with forbidden
bands the largest :math:`\rho \le 1` that keeps range and rate unclipped.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np

from oed_sysid.errors import DesignError
from oed_sysid.experiments.experiment import Limits

# Sizes tried until limits hold, largest first: each 3 dB below the one before, down to 2 %.
SIZES = tuple(2.0 ** (-step / 2) for step in range(12))


@dataclass(frozen=True, eq=False)
class Grid:
    """What the designed commands have to fit in.

    Attributes
    ----------
    times : ndarray (n_times,)
        Samples, s, uniform.
    inputs : tuple of str
        Designed inputs.
    lower, upper, trim : ndarray (n_inputs,)
        Range of each, and its value before the experiment.
    rates : ndarray (n_inputs,)
        Largest slopes, per second; infinite for none.

    Examples
    --------
    >>> ends = np.array([0.35])
    >>> grid = Grid(np.arange(5.0), ("rudder",), -ends, ends, 0.0 * ends, np.array([np.inf]))
    >>> grid.inputs, grid.times.size
    (('rudder',), 5)
    """

    times: np.ndarray
    inputs: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    trim: np.ndarray
    rates: np.ndarray

    @classmethod
    def of(
        cls,
        limits: Limits,
        names: Sequence[str],
        duration: float,
        sample_time: float,
        trim: Mapping[str, float],
    ) -> Grid:
        """Return the room that limits leave some inputs, on a run's samples."""
        ranges = [limits.inputs[name] for name in names]
        lower, upper = np.array(ranges, dtype=float).T
        rest = [trim.get(n, trim_within(*r)) for n, r in zip(names, ranges, strict=True)]
        n_steps = int(np.floor(duration / sample_time + 1e-9))
        # The rate is checked on differences of floating-point sums.
        rates = (1 - 1e-9) * np.array([limits.rates.get(name, np.inf) for name in names])
        times = np.arange(n_steps + 1) * sample_time
        return cls(times, tuple(names), lower, upper, np.array(rest, dtype=float), rates)

    def only(self, name: str) -> Grid:
        """Return the grid of one input."""
        i = [self.inputs.index(name)]
        return Grid(self.times, (name,), self.lower[i], self.upper[i], self.trim[i], self.rates[i])

    @property
    def step(self) -> float:
        """Time between samples, s."""
        return float(self.times[1] - self.times[0])

    def limited(self, orders: np.ndarray) -> np.ndarray:
        """Commands that follow orders ``(n_batch, n_times, n_inputs)`` within the limits."""
        commands = np.clip(orders, self.lower, self.upper)
        commands[:, 0] = self.trim
        steps = self.rates * self.step
        if np.isfinite(steps).any():
            for k in range(1, commands.shape[1]):
                change = np.clip(commands[:, k] - commands[:, k - 1], -steps, steps)
                commands[:, k] = commands[:, k - 1] + change
        return commands


def trim_within(lower: float, upper: float) -> float:
    """Trim command of a range: zero, or the middle of a range without zero.

    At its limit an input could move to one side only.

    Examples
    --------
    >>> trim_within(-0.3, 0.3), trim_within(1.75, 3.25)
    (0.0, 2.5)
    """
    return 0.0 if lower <= 0.0 <= upper else 0.5 * (lower + upper)


@runtime_checkable
class Shape(Protocol):
    """A family on a grid; :class:`Levels` shows how to write another."""

    @property
    def size(self) -> int:
        """How many numbers describe one member."""

    @property
    def edges(self) -> np.ndarray:
        """Samples at which single numbers begin to act, the first is 0."""

    def commands(self, numbers: np.ndarray) -> np.ndarray:
        """Commands ``(n_batch, n_times, n_inputs)`` of numbers ``(n_batch, size)``."""

    def start(self, commands: np.ndarray) -> np.ndarray | None:
        """Numbers of the member nearest to given commands; None if the family is too narrow."""


@runtime_checkable
class Parametrisation(Protocol):
    """Contract of families of commands.

    Examples
    --------
    :class:`Levels`, :class:`Multisines` and :class:`Pulses` are such families.
    """

    @property
    def name(self) -> str:
        """Name for reports."""

    def on(self, grid: Grid) -> Shape:
        """Return the family on a grid."""


@dataclass(frozen=True)
class Levels:
    """Free levels, each held until the next.

    Parameters
    ----------
    n_levels : int or None
        Number of levels of each input; None takes one for every four samples,
        at most 60.

    Examples
    --------
    >>> Levels(12).n_levels
    12
    """

    n_levels: int | None = None

    def __post_init__(self) -> None:
        if self.n_levels is not None and self.n_levels < 2:
            raise DesignError(f"{self.n_levels} levels make no manoeuvre. Give 2 or more.")

    @property
    def name(self) -> str:
        """Name for reports."""
        return f"{self.n_levels or 'free'} held levels"

    def on(self, grid: Grid) -> Shape:
        """Return the family on a grid."""
        n_times = len(grid.times)
        n_levels = self.n_levels or int(np.clip((n_times - 1) // 4, 2, 60))
        if n_levels > n_times - 1:
            raise DesignError(
                f"{n_levels} levels do not fit in {n_times - 1} samples. Ask for fewer levels, a "
                "shorter sample_time or a longer duration."
            )
        # The sample at 0 is at trim; level i begins at sample edges[i].
        edges = 1 + np.floor(np.arange(n_levels) * (n_times - 1) / n_levels).astype(int)
        owner = np.searchsorted(edges, np.arange(n_times), side="right") - 1
        waves = (owner == np.arange(n_levels)[:, None]).astype(float)
        # What no level takes is trim.
        taken = waves.sum(axis=0)[:, None]
        middle = 0.5 * (grid.lower + grid.upper)
        offset = taken * middle + (1.0 - taken) * grid.trim
        return _LinearShape(grid, waves, offset, np.unique(np.concatenate([[0], edges])))


@dataclass(frozen=True, eq=False)
class _LinearShape:
    """Waves ``(n_waves, n_times)`` of free heights in half ranges about an offset.

    The offset is ``(n_times, n_inputs)``, or ``(n_inputs,)``; ``clean`` makes commands smaller
    as a whole in the place of clipping them.
    """

    grid: Grid
    waves: np.ndarray
    offset: np.ndarray
    edges: np.ndarray
    clean: bool = False

    @property
    def size(self) -> int:
        return len(self.waves) * len(self.grid.inputs)

    @property
    def half(self) -> np.ndarray:
        """Half of the range of each input, ``(n_inputs,)``."""
        return 0.5 * (self.grid.upper - self.grid.lower)

    def commands(self, numbers: np.ndarray) -> np.ndarray:
        shape = (-1, len(self.waves), len(self.grid.inputs))
        heights = 2 * np.atleast_2d(numbers).reshape(shape) - 1
        wave = np.einsum("bli,lt->bti", heights, self.waves) * self.half
        if self.clean:
            wave *= self._room(wave)
        return self.grid.limited(self.offset + wave)

    def _room(self, wave: np.ndarray) -> np.ndarray:
        """Factors ``(n_batch, 1, n_inputs)`` up to 1 that keep range and rate without clipping."""
        grid = self.grid
        # The first sample is trim, so the second is a step from there.
        steps = np.abs(np.diff(np.concatenate([0 * wave[:, :1], wave[:, 1:]], axis=1), axis=1))
        shares = (
            wave[:, 1:].max(axis=1) / (grid.upper - grid.trim),
            -wave[:, 1:].min(axis=1) / (grid.trim - grid.lower),
            steps.max(axis=1) / (grid.rates * grid.step),
        )
        return 1.0 / np.maximum(1.0, np.max(shares, axis=0))[:, None]

    def start(self, commands: np.ndarray) -> np.ndarray | None:
        # The first sample is at trim whatever the numbers are.
        wanted = ((commands - self.offset) / self.half)[1:]
        heights, *_ = np.linalg.lstsq(self.waves.T[1:], wanted, rcond=None)
        return np.clip(0.5 * (heights + 1), 0.0, 1.0).ravel()


@dataclass(frozen=True)
class Pulses:
    """Blocks of 3-2-1-1 pulses with free height, side and unit time.

    Parameters
    ----------
    n_blocks : int
        Blocks one after another in the duration.

    Examples
    --------
    >>> Pulses(2).n_blocks
    2
    """

    n_blocks: int = 3

    @property
    def name(self) -> str:
        """Name for reports."""
        return f"{self.n_blocks} blocks of 3-2-1-1"

    def on(self, grid: Grid) -> Shape:
        """Return the family on a grid."""
        if (grid.times[-1] - grid.times[0]) / self.n_blocks < 14 * grid.step:
            raise DesignError(
                f"{self.n_blocks} blocks of 3-2-1-1 do not fit in the duration. Ask for fewer."
            )
        return _PulseShape(grid, self.n_blocks)


class _PulseShape:
    def __init__(self, grid: Grid, n_blocks: int) -> None:
        self._grid, self._n_blocks = grid, n_blocks
        self.edges = np.floor(np.arange(n_blocks) * (len(grid.times) - 1) / n_blocks).astype(int)
        self._starts = grid.times[self.edges]
        self._block = (grid.times[-1] - grid.times[0]) / n_blocks

    @property
    def size(self) -> int:
        return 2 * self._n_blocks * len(self._grid.inputs)

    def commands(self, numbers: np.ndarray) -> np.ndarray:
        grid = self._grid
        share = np.atleast_2d(numbers).reshape(-1, 2, self._n_blocks, len(grid.inputs))
        height = 2 * share[:, 0] - 1
        shortest, longest = 2 * grid.step, self._block / 7
        unit = shortest + share[:, 1] * (longest - shortest)
        orders = np.zeros((len(share), len(grid.times), len(grid.inputs)))
        ends = grid.times[None, :, None] + grid.step
        for block, begin in enumerate(self._starts):
            edges = [begin + n * unit[:, None, block] for n in (0.0, 3.0, 5.0, 6.0, 7.0)]
            # Share of each sample's interval inside a pulse: smooth in the unit time.
            passed = [np.clip((ends - edge) / grid.step, 0, 1) for edge in edges]
            for pulse, (first, last) in enumerate(pairwise(passed)):
                orders += (-1) ** pulse * height[:, None, block] * (first - last)
        span = np.where(orders > 0, grid.upper - grid.trim, grid.trim - grid.lower)
        return grid.limited(grid.trim + orders * span)

    def start(self, commands: np.ndarray) -> np.ndarray | None:
        return None


@dataclass(frozen=True)
class Multisines:
    """Sums of sines with free amplitudes and phases, clipped at the limits.

    With forbidden frequencies the commands are made smaller as a whole instead
    of being clipped, since clipping puts power at all frequencies: what the
    actuator is told from the second sample on then has no power at all at the
    multiples of ``1/duration`` inside the bands.

    Parameters
    ----------
    n_lines : int
        Number of lines, multiples of ``1/duration``.
    highest : float or None
        Highest frequency, Hz; None takes an eighth of the sampling frequency,
        or the ``n_lines``-th multiple if that is lower.
    forbidden : sequence of (low, high)
        Bands, Hz, in which there must be no line: a structural mode, a slosh
        period, the waves of the day.

    Examples
    --------
    >>> Multisines(8, forbidden=[(0.1, 0.2)]).n_lines
    8
    """

    n_lines: int = 12
    highest: float | None = None
    forbidden: Sequence[tuple[float, float]] = ()

    def __post_init__(self) -> None:
        for band in self.forbidden:
            if len(band) != 2 or not 0 <= band[0] < band[1]:
                raise DesignError(f"The forbidden band {band} is none. Give (low, high) in Hz.")

    @property
    def name(self) -> str:
        """Name for reports."""
        bands = ", ".join(f"{low:g} to {high:g}" for low, high in self.forbidden)
        return f"multisine of {self.n_lines} lines" + (f" outside {bands} Hz" if bands else "")

    def on(self, grid: Grid) -> Shape:
        """Return the family on a grid."""
        duration = grid.times[-1] - grid.times[0]
        highest = self.highest or 1.0 / (8 * grid.step)
        if self.n_lines < 1 or self.n_lines / duration > 0.5 / grid.step:
            raise DesignError(
                f"{self.n_lines} lines do not fit below half the sampling frequency. Ask for fewer."
            )
        top = max(highest * duration, self.n_lines)
        allowed = np.arange(1, int(top) + 1)
        for low, high in self.forbidden:
            allowed = allowed[(allowed / duration < low) | (allowed / duration > high)]
        if len(allowed) < self.n_lines:
            raise DesignError(
                f"Only {len(allowed)} multiples of {1 / duration:.3g} Hz up to "
                f"{top / duration:.3g} Hz lie outside the forbidden bands, fewer than "
                f"{self.n_lines} lines. Ask for fewer lines, a longer run or higher frequencies."
            )
        wanted = np.unique(np.round(np.geomspace(1.0, top, self.n_lines)))
        kept = [k for k in wanted if k in allowed]
        missing = [k for k in allowed if k not in kept]
        multiples = np.sort([*kept, *missing[: self.n_lines - len(kept)]])
        angles = 2 * np.pi * np.outer(multiples / duration, grid.times - grid.times[0])
        # Cosine and sine amplitudes: smooth where amplitude and phase are not.
        waves = np.vstack([np.cos(angles), np.sin(angles)])
        return _LinearShape(grid, waves, grid.trim, np.array([0]), clean=bool(self.forbidden))
