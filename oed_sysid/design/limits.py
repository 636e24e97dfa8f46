r"""Limits on what the vehicle does, as numbers for a search and as words for people.

Of a limited signal :math:`x_j` with bounds :math:`l_j, u_j` the excess is a share of its width
:math:`b_j = u_j - l_j` (of a bound alone: its absolute value),

.. math:: h_j(t) = \max\left(\frac{l_j - x_j(t)}{b_j}, \frac{x_j(t) - u_j}{b_j}\right)

and a run is inside where :math:`\max_{j,t} h_j \le 0`; limits on the end count at the last sample
only. In words angles are in degrees.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import degrees

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.errors import DesignError
from oed_sysid.experiments.experiment import Limits
from oed_sysid.experiments.simulation import Trajectory
from oed_sysid.experiments.trajectory import state_names
from oed_sysid.physics.model import Model


def units_of(model: Model) -> dict[str, str]:
    """Units of all states, inputs and outputs by name."""
    units = {output.name: output.unit for output in model.outputs}
    units |= {state.name: state.unit for effect in model.effects for state in effect.states}
    units |= {state.name: state.unit for state in model.states}
    return units | {channel.name: channel.unit for channel in model.inputs}


def quantity(value: float, unit: str) -> str:
    """Return a number with its unit, angles in degrees.

    Examples
    --------
    >>> quantity(0.0872665, "rad"), quantity(12.0, "m")
    ('5 deg', '12 m')
    """
    if unit in ("rad", "rad/s"):
        # Commands are floating-point sums: 5e-9 deg is zero.
        return f"{round(degrees(value), 6) + 0.0:.4g} {unit.replace('rad', 'deg')}"
    return f"{value:.4g} {unit}".rstrip()


def span(lower: float, upper: float, unit: str) -> str:
    """Return a range with one unit."""
    if lower == -float("inf"):
        return f"up to {quantity(upper, unit)}"
    if upper == float("inf"):
        return f"from {quantity(lower, unit)}"
    if lower == -upper:
        return f"+-{quantity(upper, unit)}"
    return between(lower, upper, unit)


def between(lower: float, upper: float, unit: str) -> str:
    """Return two numbers with one unit.

    >>> between(0.1, 0.2, "rad")
    '5.73 to 11.46 deg'
    """
    return f"{quantity(lower, unit).split(' ')[0]} to {quantity(upper, unit)}"


def outside(lower: float, upper: float, unit: str) -> str:
    """Return where a value is outside a range, whose ends may be none.

    >>> outside(-float("inf"), 12.0, "m")
    'above 12 m'
    """
    ends = (("below", lower), ("above", upper))
    return " or ".join(f"{word} {quantity(end, unit)}" for word, end in ends if abs(end) < 1e30)


def percent(share: float) -> str:
    """Return a relative error, a dash where nothing is known; beyond ten its size is no matter."""
    if not share < 1e4:
        return "-"
    if share > 10:
        return ">1000%"
    return f"{100 * share:.3g}%"


# A limit counts as reached within this share of its width.
REACHED = 0.01
_SIDES = ("lower", "upper")


@dataclass(frozen=True, eq=False)
class LimitBounds:
    """Bounds on states and outputs during the experiment and at its end.

    Attributes
    ----------
    names : tuple of str
        Limited signals; those of the end come last.
    columns : ndarray of int (n_limits,)
        Columns of a vehicle's signals.
    lower, upper, width : ndarray (n_limits,)
    at_end : ndarray of bool (n_limits,)
        Whether only the last sample counts.
    n_full : int
        Columns of full states before the outputs.
    units : tuple of str
        Of the limited signals, for words.
    """

    names: tuple[str, ...]
    columns: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    width: np.ndarray
    at_end: np.ndarray
    n_full: int = 0
    units: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, model: Model, limits: Limits, end: Mapping[str, tuple[float, float]] | None = None
    ) -> LimitBounds:
        """Return the bounds of a model's states (before outputs of the same name)."""
        states, n_full = state_names(model), kernel(model).n_full
        names, columns, ranges, at_end = [], [], [], []
        for group, last in ((limits.signals, False), (end or {}, True)):
            for name, pair in group.items():
                if name in states:
                    column = states.index(name)
                elif name in model.output_names:
                    column = n_full + model.output_names.index(name)
                else:
                    raise DesignError(
                        f"The limit of {name!r} is on nothing: model {model.name!r} has the states "
                        f"and outputs {', '.join(dict.fromkeys((*states, *model.output_names)))}."
                    )
                if not float(pair[0]) < float(pair[1]):
                    raise DesignError(
                        f"The limit of {name!r} is {pair}; lower has to be below upper."
                    )
                names.append(name)
                columns.append(column)
                ranges.append((float(pair[0]), float(pair[1])))
                at_end.append(last)
        lower, upper = np.array(ranges, dtype=float).reshape(-1, 2).T
        width = np.where(np.isfinite(upper - lower), upper - lower, 1.0)
        one_sided = ~np.isfinite(upper - lower)
        bound = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, 1.0))
        width = np.where(one_sided, np.maximum(np.abs(bound), 1e-3), width)
        return cls(
            tuple(names), np.array(columns, dtype=int), lower, upper, width,
            np.array(at_end, dtype=bool), n_full, tuple(units_of(model)[n] for n in names),
        )  # fmt: skip

    def excess(self, signals: np.ndarray, *, first: int = 0, n_times: int) -> np.ndarray:
        """How far signals are beyond their limits, as shares of the width.

        Parameters
        ----------
        signals : ndarray (n_part, n_columns)
            From sample ``first`` on.
        first, n_times : int
            Where the part begins, and the length of the whole.

        Returns
        -------
        ndarray (n_part, n_limits, 2)
            Below and above; negative inside, minus infinity where not limited.
        """
        values = signals[:, self.columns]
        both = np.stack([self.lower - values, values - self.upper], axis=2)
        both = both / self.width[:, None]
        if self.at_end.any():
            rows = np.arange(first, first + len(signals))[:, None] != n_times - 1
            both[np.broadcast_to((rows & self.at_end)[:, :, None], both.shape)] = -np.inf
        return both

    def worst(self, signals: np.ndarray) -> float:
        """Largest excess of a whole run; negative if all limits are kept."""
        if not self.names:
            return -np.inf
        return float(self.excess(signals, n_times=len(signals)).max())

    def during(self) -> LimitBounds:
        """The limits that hold during the run, of signals that are picked already."""
        kept = np.flatnonzero(~self.at_end)
        return LimitBounds(
            tuple(self.names[i] for i in kept), np.arange(len(kept)), self.lower[kept],
            self.upper[kept], self.width[kept], np.zeros(len(kept), dtype=bool), 0,
            tuple(self.units[i] for i in kept),
        )  # fmt: skip

    def first_left(self, run: Trajectory) -> str | None:
        """Limit that a motion leaves first; None if it keeps all, those on its end waived."""
        bounds = self.during()
        if not bounds.names:
            return None
        signals = np.column_stack([run.signal(name) for name in bounds.names])
        excess = bounds.excess(signals, n_times=len(signals))
        outside = excess.max(axis=(1, 2)) > 0
        if not outside.any():
            return None
        first = excess[int(np.argmax(outside))]
        limit, side = np.unravel_index(int(np.argmax(first)), first.shape)
        return f"{bounds.names[limit]} {_SIDES[side]} limit"

    def reached(self, times: np.ndarray, signals: np.ndarray) -> tuple[str, ...]:
        """Limits that are reached within 1 %, in words."""
        return tuple(
            f"{self.names[i]} {_SIDES[side]} limit {quantity(bound, self.units[i])} {when}"
            for i, side, bound, _, when in self._extremes(times, signals, -REACHED)
        )

    def broken(self, times: np.ndarray, signals: np.ndarray) -> tuple[str, ...]:
        """Limits that are not kept, in words."""
        return tuple(
            f"{self.names[i]} is {quantity(value, self.units[i])} {when}, "
            f"{('below', 'above')[side]} its limit of {quantity(bound, self.units[i])}"
            for i, side, bound, value, when in self._extremes(times, signals, 1e-9)
        )

    def _extremes(
        self, times: np.ndarray, signals: np.ndarray, beyond: float
    ) -> Iterator[tuple[int, int, float, float, str]]:
        """Limit, side, bound, value and time of largest excesses above a share of the width."""
        excess = self.excess(signals, n_times=len(signals))
        for index, bounds in enumerate(zip(self.lower, self.upper, strict=True)):
            for side, bound in enumerate(bounds):
                sample = int(np.argmax(excess[:, index, side]))
                if excess[sample, index, side] > beyond:
                    when = "at the end" if self.at_end[index] else f"at t = {times[sample]:g} s"
                    value = float(signals[sample, self.columns[index]])
                    yield index, side, float(bound), value, when
