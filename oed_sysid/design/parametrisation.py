"""Families of commands: numbers between 0 and 1 become commands within their limits.

Amplitude and rate limits of the actuators are kept by construction, so that
the search only has to mind what the vehicle does. The first sample is always
the neutral command: nothing jumps before the experiment begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from oed_sysid.errors import DesignError


@dataclass(frozen=True, eq=False)
class Grid:
    """What the designed commands have to fit in.

    Attributes
    ----------
    times : ndarray (n_times,)
        Samples, s, uniform.
    inputs : tuple of str
        Designed inputs.
    lower, upper, neutral : ndarray (n_inputs,)
        Range of each, and its value before the experiment.
    rates : ndarray (n_inputs,)
        Largest slopes, per second; infinite for none.
    """

    times: np.ndarray
    inputs: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    neutral: np.ndarray
    rates: np.ndarray

    @property
    def step(self) -> float:
        """Time between samples, s."""
        return float(self.times[1] - self.times[0])

    def limited(self, orders: np.ndarray) -> np.ndarray:
        """Commands that follow orders ``(n_batch, n_times, n_inputs)`` within the limits."""
        commands = np.clip(orders, self.lower, self.upper)
        commands[:, 0] = self.neutral
        steps = self.rates * self.step
        if np.isfinite(steps).any():
            for k in range(1, commands.shape[1]):
                change = np.clip(commands[:, k] - commands[:, k - 1], -steps, steps)
                commands[:, k] = commands[:, k - 1] + change
        return commands


def neutral_within(lower: float, upper: float) -> float:
    """Neutral command of a range: zero, or the middle of a range without zero.

    At its limit an input could move to one side only.

    Examples
    --------
    >>> neutral_within(-0.3, 0.3), neutral_within(1.75, 3.25)
    (0.0, 2.5)
    """
    return 0.0 if lower <= 0.0 <= upper else 0.5 * (lower + upper)


@runtime_checkable
class Shape(Protocol):
    """A family on a grid; :class:`Levels` shows how to write another."""

    @property
    def size(self) -> int:
        """How many numbers describe one member."""
        ...

    @property
    def edges(self) -> np.ndarray:
        """Samples at which single numbers begin to act, the first is 0."""
        ...

    def commands(self, numbers: np.ndarray) -> np.ndarray:
        """Commands ``(n_batch, n_times, n_inputs)`` of numbers ``(n_batch, size)``."""
        ...

    def start(self, commands: np.ndarray) -> np.ndarray | None:
        """Numbers of the member nearest to given commands; None if the family is too narrow."""
        ...


@runtime_checkable
class Parametrisation(Protocol):
    """Contract of families of commands."""

    @property
    def name(self) -> str:
        """Name for reports."""
        ...

    def on(self, grid: Grid) -> Shape:
        """Return the family on a grid."""
        ...


@dataclass(frozen=True)
class Levels:
    """Free levels, each held or connected by straight lines.

    Parameters
    ----------
    n_levels : int or None
        Number of levels of each input; None takes one for every four samples,
        at most 60.
    interpolation : {"hold", "linear"}
        Steps, or a broken line through the levels.
    """

    n_levels: int | None = None
    interpolation: str = "hold"

    def __post_init__(self) -> None:
        if self.interpolation not in ("hold", "linear"):
            raise DesignError(f"interpolation is {self.interpolation!r}. Choose hold or linear.")
        if self.n_levels is not None and self.n_levels < 2:
            raise DesignError(f"{self.n_levels} levels make no manoeuvre. Give 2 or more.")

    @property
    def name(self) -> str:
        """Name for reports."""
        kind = "held" if self.interpolation == "hold" else "linear"
        return f"{self.n_levels or 'free'} {kind} levels"

    def on(self, grid: Grid) -> Shape:
        """Return the family on a grid."""
        n_samples = len(grid.times) - 1
        n_levels = self.n_levels or int(np.clip(n_samples // 4, 2, 60))
        if n_levels > n_samples:
            raise DesignError(
                f"{n_levels} levels do not fit in {n_samples} samples. Ask for fewer levels, a "
                "shorter sample_time or a longer duration."
            )
        return _LevelShape(grid, n_levels, self.interpolation == "linear")


class _LevelShape:
    def __init__(self, grid: Grid, n_levels: int, linear: bool) -> None:
        self._grid = grid
        self._n_levels = n_levels
        n_times = len(grid.times)
        if linear:
            knots = np.linspace(0, n_times - 1, n_levels + 1)
            position = np.arange(n_times)
            weights = np.stack([np.interp(position, knots, row) for row in np.eye(n_levels + 1)])
            self._neutral_weight, self._weights = weights[0], weights[1:]
            edges = np.floor(knots[:-1]).astype(int)
        else:
            # The sample at 0 is neutral; level i begins at sample edges[i].
            edges = 1 + np.floor(np.arange(n_levels) * (n_times - 1) / n_levels).astype(int)
            owner = np.searchsorted(edges, np.arange(n_times), side="right") - 1
            self._weights = (owner == np.arange(n_levels)[:, None]).astype(float)
            self._neutral_weight = (owner < 0).astype(float)
        self.edges = np.unique(np.concatenate([[0], edges]))

    @property
    def size(self) -> int:
        return self._n_levels * len(self._grid.inputs)

    def commands(self, numbers: np.ndarray) -> np.ndarray:
        grid = self._grid
        share = np.atleast_2d(numbers).reshape(-1, self._n_levels, len(grid.inputs))
        levels = grid.lower + share * (grid.upper - grid.lower)
        orders = np.einsum("bli,lt->bti", levels, self._weights)
        orders += self._neutral_weight[:, None] * grid.neutral
        return grid.limited(orders)

    def start(self, commands: np.ndarray) -> np.ndarray | None:
        grid = self._grid
        wanted = commands - self._neutral_weight[:, None] * grid.neutral
        levels, *_ = np.linalg.lstsq(self._weights.T, wanted, rcond=None)
        share = (levels - grid.lower) / (grid.upper - grid.lower)
        return np.clip(share, 0.0, 1.0).ravel()


@dataclass(frozen=True)
class Pulses:
    """Blocks of 3-2-1-1 pulses with free height, side and unit time.

    Parameters
    ----------
    n_blocks : int
        Blocks one after another in the duration.
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
        starts = np.floor(np.arange(n_blocks) * (len(grid.times) - 1) / n_blocks).astype(int)
        self.edges = starts
        self._starts = grid.times[starts]
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
        edges = np.array([0.0, 3.0, 5.0, 6.0, 7.0])
        for block, begin in enumerate(self._starts):
            for pulse in range(4):
                first = begin + edges[pulse] * unit[:, block]
                last = begin + edges[pulse + 1] * unit[:, block]
                # Share of each sample's interval inside the pulse: smooth in the unit time.
                inside = np.clip(
                    (grid.times[None, :, None] + grid.step - first[:, None]) / grid.step, 0, 1
                ) - np.clip(
                    (grid.times[None, :, None] + grid.step - last[:, None]) / grid.step, 0, 1
                )
                orders += (-1) ** pulse * height[:, None, block] * inside
        span = np.where(orders > 0, grid.upper - grid.neutral, grid.neutral - grid.lower)
        return grid.limited(grid.neutral + orders * span)

    def start(self, commands: np.ndarray) -> np.ndarray | None:
        return None
