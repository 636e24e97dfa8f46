r"""Levels and times of the noise as unknowns of an estimation.

A level enters as its variance in squared units, :math:`\eta = (\sigma/\sigma_0)^2 \ge 0`: the
likelihood has a slope there even at zero, so that an absent disturbance stays absent for a
reason. A correlation time enters as :math:`\ln \tau`, with a wide normal prior, because nothing
is known of the time of a disturbance that is absent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np

from oed_sysid.compiled.filtering import (
    COLOUR_TIME,
    COLOUR_VARIANCE,
    FORCE_TIME,
    FORCE_VARIANCE,
    SEA_DAMPING,
    SEA_PERIOD,
    SEA_VARIANCE,
    WHITE_VARIANCE,
    Disturbed,
)
from oed_sysid.likelihood.noise_model import NoiseModel, Sea, disturbance_names

# Smallest white variance, as a share of its unit: the filter must stay regular.
WHITE_FLOOR = 1e-4
# Standard deviation of the prior of the logarithm of a correlation time.
VAGUE_TIME = 2.0
# Shortest time in samples, longest as a share of the shortest record.
SHORTEST, LONGEST = 0.5, 0.2
# Levels that are no variances but logarithms.
LOGARITHMS = (FORCE_TIME, COLOUR_TIME, SEA_PERIOD, SEA_DAMPING)
# Least and largest damping of a sea: below, a wave that never changes; above, no wave.
DAMPING = (0.005, 0.7)


@dataclass(frozen=True, eq=False)
class Levels:
    """Which levels and times are unknown, between which bounds.

    Attributes
    ----------
    noise : NoiseModel
        Values to begin with; what is not unknown stays there.
    unit : NoiseModel
        Natural size of every level.
    entries : tuple of (kind, index)
        Unknowns, as :mod:`oed_sysid.compiled.filtering` numbers them; colours count
        among the outputs that have one.
    coloured : ndarray of int
        Outputs with coloured noise.
    disturbances : tuple of str
        Parameters of the filtered model that are the disturbances.
    lower, upper, scale : ndarray (n_levels,)
        Bounds and squared units (1 for times).
    prior_mean, prior_weight : ndarray (n_levels,)
        Of the logarithms of times.
    """

    noise: NoiseModel
    unit: NoiseModel
    entries: tuple[tuple[int, int], ...]
    coloured: np.ndarray
    disturbances: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    scale: np.ndarray
    prior_mean: np.ndarray
    prior_weight: np.ndarray

    @classmethod
    def of(
        cls,
        noise: NoiseModel,
        unit: NoiseModel,
        *,
        white: np.ndarray | bool = False,
        colour: np.ndarray | bool = False,
        force: np.ndarray | bool = False,
        own_times: bool = False,
        least_white: float | np.ndarray = 0.0,
        most_colour: float | np.ndarray = np.inf,
        times: tuple[float, float] = (1e-3, np.inf),
        seas: Sequence[Sea] | None = None,
    ) -> Levels:
        """Name the unknowns.

        Parameters
        ----------
        noise, unit : NoiseModel
        white, colour, force : ndarray of bool, optional
            Which levels are unknown, by default none; ``colour`` also says which outputs may have
            it.
        own_times : bool
            Whether every unknown disturbance and colour has a time of its own; else all share one.
        least_white : ndarray (n_outputs,), optional
            Smallest white levels, in the outputs' units.
        most_colour : ndarray (n_outputs,), optional
            Largest coloured levels, in the outputs' units.
        times : tuple of float
            Shortest and longest correlation time, s.
        seas : sequence of Sea, optional
            What is known of each sea of ``noise``; what they leave out is unknown. By default
            nothing is.
        """
        white, colour = (np.broadcast_to(one, noise.white.shape) for one in (white, colour))
        force = np.broadcast_to(force, noise.force.shape)
        coloured = np.flatnonzero(colour | (noise.colour > 0))
        of_colour = colour[coloured]
        floor = np.maximum(WHITE_FLOOR, (least_white / unit.white) ** 2)
        most = np.broadcast_to(most_colour, len(unit.colour))[coloured] / unit.colour[coloured]
        between = np.log(times)
        known = ([Sea()] * len(noise.seas) if seas is None else seas)[: len(noise.seas)]
        rows: list[tuple[float, ...]] = []

        def add(kind: int, which: Any, size: Any, low: Any = 0.0, high: Any = np.inf) -> None:
            """Unknowns of a kind at some positions, with natural sizes or values, and bounds."""
            low, high = (np.broadcast_to(end, len(size)) for end in (low, high))
            for i in map(int, which):
                own = (size[i] ** 2, 0.0, 0.0)
                if kind in LOGARITHMS:
                    own = (1.0, float(np.clip(np.log(size[i]), low[i], high[i])), VAGUE_TIME**-2.0)
                rows.append((kind, i, low[i], high[i], *own))

        def add_times(kind: int, which: np.ndarray, time: np.ndarray) -> None:
            if own_times:
                add(kind, np.flatnonzero(which), time, *between)
            elif which.any():
                add(kind, [-1], [_middle(time[which])], *between)

        add(FORCE_VARIANCE, np.flatnonzero(force), unit.force)
        # White from step to step is no matter of time.
        add_times(FORCE_TIME, force & (noise.force_time > 0), noise.force_time)
        add(WHITE_VARIANCE, np.flatnonzero(white), unit.white, floor)
        add(COLOUR_VARIANCE, np.flatnonzero(of_colour), unit.colour[coloured], high=most**2)
        add_times(COLOUR_TIME, of_colour, noise.colour_time[coloured])
        free = [
            one.levels is None
            for one, sea in zip(known, noise.seas, strict=True)
            for _ in sea.places
        ]
        add(SEA_VARIANCE, np.flatnonzero(free), _levels_of(unit.seas))
        # A wave takes two samples, and a record a few waves.
        periods, damping = _shapes_of(noise.seas)
        free = [sea.period is None for sea in known]
        add(SEA_PERIOD, np.flatnonzero(free), periods, np.log(4.0 * times[0]), between[1])
        free = [sea.bandwidth is None for sea in known]
        add(SEA_DAMPING, np.flatnonzero(free), damping, *np.log(DAMPING))
        table = np.array(rows, dtype=float).reshape(-1, 7).T
        entries = tuple(zip(*table[:2].astype(int).tolist(), strict=True))
        at_sea = [place for sea in noise.seas for place in sea.places]
        names = disturbance_names((*noise.places, *at_sea))
        return cls(noise, unit, entries, coloured, names, *table[2:])

    def __len__(self) -> int:
        return len(self.entries)

    def _sizes(self, noise: NoiseModel) -> dict[int, np.ndarray]:
        """Numbers of a noise model by kind, counted as :attr:`entries` count them."""
        periods, damping = _shapes_of(noise.seas)
        return {
            FORCE_VARIANCE: noise.force.copy(),
            FORCE_TIME: noise.force_time.copy(),
            WHITE_VARIANCE: noise.white.copy(),
            COLOUR_VARIANCE: noise.colour[self.coloured],
            COLOUR_TIME: noise.colour_time[self.coloured],
            SEA_VARIANCE: _levels_of(noise.seas),
            SEA_PERIOD: periods,
            SEA_DAMPING: damping,
        }

    def vector(self, noise: NoiseModel | None = None) -> np.ndarray:
        """Unknowns of a noise model, within the bounds, ``(n_levels,)``."""
        sizes, values = self._sizes(self.noise if noise is None else noise), []
        for (kind, index), scale in zip(self.entries, self.scale, strict=True):
            own = sizes[kind]
            # A time that all share begins at the geometric mean of theirs.
            size = own[index] if index >= 0 else _middle(own[own > 0])
            values.append(np.log(size) if kind in LOGARITHMS else size**2 / scale)
        return np.clip(np.array(values, dtype=float), self.lower, self.upper)

    def at(self, vector: np.ndarray) -> NoiseModel:
        """Noise model of given unknowns."""
        noise, sizes = self.noise, self._sizes(self.noise)
        for (kind, index), scale, value in zip(self.entries, self.scale, vector, strict=True):
            size = np.exp(value) if kind in LOGARITHMS else np.sqrt(max(value, 0.0) * scale)
            sizes[kind][sizes[kind] > 0 if index < 0 else index] = size
        colour, colour_time = noise.colour.copy(), noise.colour_time.copy()
        colour[self.coloured] = sizes[COLOUR_VARIANCE]
        colour_time[self.coloured] = sizes[COLOUR_TIME]
        stops = np.cumsum([len(sea.places) for sea in noise.seas])[:-1]
        levels = np.split(sizes[SEA_VARIANCE], stops)
        each = zip(noise.seas, levels, sizes[SEA_PERIOD], sizes[SEA_DAMPING], strict=False)
        return replace(
            noise,
            white=sizes[WHITE_VARIANCE],
            colour=colour,
            force=sizes[FORCE_VARIANCE],
            colour_time=colour_time,
            force_time=sizes[FORCE_TIME],
            seas=tuple(
                replace(
                    sea.with_levels(level), period=float(period), bandwidth=2.0 * float(damping)
                )
                for sea, level, period, damping in each
            ),
        )

    def following(self, information: np.ndarray, vector: np.ndarray) -> np.ndarray:
        r"""How the logarithm of each variance follows that of its time, ``(n_levels,)``.

        Along :math:`\sigma^2 \propto \tau^a` the records cannot tell the two apart: :math:`a = 1`
        where a disturbance lasts longer than the vehicle answers, so that its intensity counts,
        and :math:`-1` where it is over before.

        Parameters
        ----------
        information : ndarray (n_levels, n_levels)
            Of all levels and times.
        vector : ndarray (n_levels,)
            Where.
        """
        power, times = np.zeros(len(self)), self._times()
        for j in set(times.values()):
            of = [i for i, its in times.items() if its == j and vector[i] > 0]
            among, beside = information[np.ix_(of, of)], information[of, j]
            if of and np.all(np.diag(among) > 0):
                # Levels of forces and moments differ by powers of ten.
                size = 1.0 / np.sqrt(np.diag(among))
                change = -size * np.linalg.lstsq(size[:, None] * among * size, size * beside)[0]
                # No curve is steeper: a variance that goes with the square of its time.
                power[of] = np.clip(change / vector[of], -2.0, 2.0)
        return power

    def _times(self) -> dict[int, int]:
        """Position of the unknown time of each variance that has one, by its own position."""
        position = {entry: j for j, entry in enumerate(self.entries)}
        found = {}
        for i, (kind, index) in enumerate(self.entries):
            time = {FORCE_VARIANCE: FORCE_TIME, COLOUR_VARIANCE: COLOUR_TIME}.get(kind, -1)
            j = position.get((time, index), position.get((time, -1)))
            # White from step to step is no matter of time.
            if j is not None and (kind == COLOUR_VARIANCE or self.noise.force_time[index] > 0):
                found[i] = j
        return found

    def moved(self, vector: np.ndarray, step: np.ndarray, power: np.ndarray) -> np.ndarray:
        r"""Unknowns after a step, taken along the curves on which levels follow their times.

        Records tell :math:`\sigma^2 \tau^{-a}` of a disturbance far better than either of the
        two, so that a straight step in both would leave it.

        Parameters
        ----------
        vector, step : ndarray (n_levels,)
        power : ndarray (n_levels,)
            As :meth:`following` tells.
        """
        after = vector + step
        for i, j in self._times().items():
            if vector[i] > 0 and after[i] > self.lower[i]:  # at its bound it has vanished
                time = float(np.clip(after[j], self.lower[j], self.upper[j]))
                longer = power[i] * (time - vector[j])
                # A step takes no more than nine tenths of a variance.
                after[i] = np.exp(longer) * max(after[i] - vector[i] * longer, 0.1 * vector[i])
        return after

    def disturbed(self, noise: NoiseModel) -> Disturbed:
        """What the filter takes."""
        return replace(noise.disturbed(self.coloured), disturbances=self.disturbances)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns, such as ``"force Z level"`` or ``"colour of q time"``."""
        noise = self.noise
        colours = tuple(f"colour of {noise.outputs[column]}" for column in self.coloured)
        seas = [f"sea {i + 1}" if len(noise.seas) > 1 else "sea" for i in range(len(noise.seas))]
        of = {
            FORCE_VARIANCE: ("level", noise.places),
            FORCE_TIME: ("time", (*noise.places, "disturbances")),
            WHITE_VARIANCE: ("level", [f"white of {name}" for name in noise.outputs]),
            COLOUR_VARIANCE: ("level", colours),
            COLOUR_TIME: ("time", (*colours, "colours")),
            SEA_VARIANCE: ("level", [f"sea {place}" for sea in noise.seas for place in sea.places]),
            SEA_PERIOD: ("period", seas),
            SEA_DAMPING: ("bandwidth", seas),
        }
        # A time that all share has the index -1.
        return tuple(f"{of[kind][1][index]} {of[kind][0]}" for kind, index in self.entries)

    def held(self) -> Levels:
        """Return the same noise with nothing unknown."""
        return self._only([False] * len(self))

    @property
    def are_variances(self) -> np.ndarray:
        """Which unknowns are variances, not times, of shape ``(n_levels,)``."""
        kinds = [kind for kind, _ in self.entries]
        return ~np.isin(kinds, LOGARITHMS).reshape(len(kinds))

    def only_variances(self) -> Levels:
        """The same where all times and dampings are known."""
        return self._only(self.are_variances)

    def only(self, names: Sequence[str]) -> Levels:
        """Return the same noise with some of its unknowns, by :attr:`names`."""
        return self._only(np.isin(self.names, names))

    @property
    def shares_a_time(self) -> bool:
        """Whether several levels have one time together."""
        return any(index < 0 for _, index in self.entries)

    @property
    def n_coloured(self) -> int:
        """Number of outputs with coloured noise."""
        return len(self.coloured)

    @property
    def n_second(self) -> int:
        """Number of second states of narrow-band disturbances."""
        return sum(len(sea.places) for sea in self.noise.seas)

    def without_forces(self, dropped: np.ndarray) -> Levels:
        """Return the same unknowns with some disturbances absent.

        Parameters
        ----------
        dropped : ndarray of bool (n_forces,)
        """
        none_left = bool(np.all(dropped | (self.noise.force == 0)))
        keep = [
            not (
                (kind == FORCE_VARIANCE and dropped[index])
                or (kind == FORCE_TIME and (none_left if index < 0 else dropped[index]))
            )
            for kind, index in self.entries
        ]
        noise = replace(self.noise, force=np.where(dropped, 0.0, self.noise.force))
        return replace(self._only(keep), noise=noise)

    def holding_forces(self) -> Levels:
        """Return the same unknowns, levels and times of disturbances known."""
        of_sensors = (WHITE_VARIANCE, COLOUR_VARIANCE, COLOUR_TIME)
        return self._only([kind in of_sensors for kind, _ in self.entries])

    def _only(self, keep: Sequence[bool] | np.ndarray) -> Levels:
        """Some of the unknowns; the others stay at the noise model's values."""
        chosen = np.array(keep, dtype=bool)
        numbers = ("lower", "upper", "scale", "prior_mean", "prior_weight")
        kept: dict[str, Any] = {name: getattr(self, name)[chosen] for name in numbers}
        return replace(self, entries=tuple(compress(self.entries, chosen)), **kept)

    def starting(self, noise: NoiseModel) -> Levels:
        """Return the same unknowns, begun elsewhere."""
        return replace(self, noise=noise)


def _levels_of(seas: Sequence[Sea]) -> np.ndarray:
    """Levels of some seas in all their places."""
    return np.concatenate([np.zeros(0), *(sea.level for sea in seas)])


def _shapes_of(seas: Sequence[Sea]) -> tuple[np.ndarray, np.ndarray]:
    """Periods and damping ratios of some seas."""
    periods = np.array([sea.period or 1.0 for sea in seas], dtype=float)
    return periods, np.array([0.5 * (sea.bandwidth or 1.0) for sea in seas], dtype=float)


def _middle(times: np.ndarray) -> float:
    """Geometric mean of some times."""
    return float(np.exp(np.mean(np.log(np.maximum(times, 1e-9)))))
