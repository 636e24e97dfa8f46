r"""Sums of sines, with frequencies that must not be excited left out.

On a run of length :math:`T` with ``n`` lines at multiples of :math:`1/T`,

.. math::
    \delta(t) = \delta_0 + \rho\, \frac{\delta_{max} - \delta_{min}}2 \sum_{i=1}^n
    \left(a_i \cos 2\pi f_i t + b_i \sin 2\pi f_i t\right), \qquad
    f_i = \frac{k_i}{T} \notin \text{forbidden bands}

with free :math:`a_i, b_i \in [-1, 1]`; :math:`\rho = 1` and the sum clipped, or with forbidden
bands the largest :math:`\rho \le 1` that keeps range and rate unclipped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.design.parametrisation import Grid, Shape
from oed_sysid.errors import DesignError


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
        allowed = np.array([k for k in range(1, int(top) + 1) if self._allows(k / duration)])
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
        return _SineShape(grid, multiples / duration, clean=bool(self.forbidden))

    def _allows(self, frequency: float) -> bool:
        return not any(low <= frequency <= high for low, high in self.forbidden)


class _SineShape:
    def __init__(self, grid: Grid, frequencies: np.ndarray, *, clean: bool = False) -> None:
        self._grid = grid
        self._clean = clean
        self._frequencies = frequencies
        self.edges = np.array([0])
        angles = 2 * np.pi * np.outer(frequencies, grid.times - grid.times[0])
        self._waves = np.cos(angles), np.sin(angles)

    @property
    def size(self) -> int:
        return 2 * len(self._frequencies) * len(self._grid.inputs)

    def commands(self, numbers: np.ndarray) -> np.ndarray:
        grid = self._grid
        n_lines = len(self._frequencies)
        # Cosine and sine amplitudes: smooth where amplitude and phase are not.
        parts = 2 * np.atleast_2d(numbers).reshape(-1, 2, n_lines, len(grid.inputs)) - 1
        span = 0.5 * (grid.upper - grid.lower)
        cosine, sine = self._waves
        wave = np.einsum("bli,lt->bti", parts[:, 0], cosine)
        wave += np.einsum("bli,lt->bti", parts[:, 1], sine)
        wave *= span
        if self._clean:
            wave *= self._room(wave)
        return grid.limited(grid.neutral + wave)

    def _room(self, wave: np.ndarray) -> np.ndarray:
        """Factors ``(n_batch, 1, n_inputs)`` up to 1 that keep range and rate without clipping."""
        grid = self._grid
        # The first sample is neutral, so the second is a step from there.
        steps = np.abs(np.diff(np.concatenate([0 * wave[:, :1], wave[:, 1:]], axis=1), axis=1))
        shares = (
            wave[:, 1:].max(axis=1) / (grid.upper - grid.neutral),
            -wave[:, 1:].min(axis=1) / (grid.neutral - grid.lower),
            steps.max(axis=1) / (grid.rates * grid.step),
        )
        return 1.0 / np.maximum(1.0, np.max(shares, axis=0))[:, None]

    def start(self, commands: np.ndarray) -> np.ndarray | None:
        grid = self._grid
        span = 0.5 * (grid.upper - grid.lower)
        # The first sample is neutral whatever the sines are.
        basis = np.vstack(self._waves).T[1:]
        parts, *_ = np.linalg.lstsq(basis, (commands[1:] - grid.neutral) / span, rcond=None)
        return np.clip(0.5 * (parts + 1), 0.0, 1.0).ravel()
