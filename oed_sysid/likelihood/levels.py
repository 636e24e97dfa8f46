r"""Levels and times of the noise as unknowns of an estimation.

A level enters as its variance in squared units, :math:`\eta = (\sigma/\sigma_0)^2 \ge 0`: the
likelihood has a slope there even at zero, so that an absent disturbance stays absent for a
reason. A correlation time enters as :math:`\ln \tau`, with a wide normal prior, because nothing
is known of the time of a disturbance that is absent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
# Least share that a variance keeps in one step along its curve, and the steepest such curve.
LEAST_KEPT, MOST_POWER = 0.1, 2.0
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
        disturbances: Sequence[str],
        *,
        white: np.ndarray,
        colour: np.ndarray,
        force: np.ndarray,
        own_times: bool = False,
        least_white: np.ndarray | None = None,
        most_colour: np.ndarray | None = None,
        times: tuple[float, float] = (1e-3, np.inf),
        seas: Sequence[Sea] | None = None,
    ) -> Levels:
        """Name the unknowns.

        Parameters
        ----------
        noise, unit : NoiseModel
        disturbances : sequence of str
            Parameters that are the disturbances, as many as ``noise`` has forces.
        white, colour, force : ndarray of bool
            Which levels are unknown; ``colour`` also says which outputs may have it.
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
        coloured = np.flatnonzero(colour | (noise.colour > 0))
        # White from step to step is no matter of time.
        lasting = force & (noise.force_time > 0)
        floor = np.full(len(noise.white), WHITE_FLOOR)
        if least_white is not None:
            floor = np.maximum(floor, (least_white / unit.white) ** 2)
        low, high = np.log(times[0]), np.log(times[1])
        rows: list[tuple[int, int, float, float, float, float]] = []

        def variance(
            kind: int, index: int, size: float, least: float = 0.0, most: float = np.inf
        ) -> None:
            rows.append((kind, index, least, most, size**2, 0.0))

        def logarithm(
            kind: int, index: int, value: float, bounds: tuple[float, float] = (low, high)
        ) -> None:
            rows.append((kind, index, *bounds, 1.0, float(np.clip(np.log(value), *bounds))))

        for i in np.flatnonzero(force):
            variance(FORCE_VARIANCE, int(i), unit.force[i])
        if own_times:
            for i in np.flatnonzero(lasting):
                logarithm(FORCE_TIME, int(i), noise.force_time[i])
        elif lasting.any():
            logarithm(FORCE_TIME, -1, _middle(noise.force_time[lasting]))
        for i in np.flatnonzero(white):
            variance(WHITE_VARIANCE, int(i), unit.white[i], floor[i])
        for position, i in enumerate(coloured):
            if colour[i]:
                highest = np.inf if most_colour is None else (most_colour[i] / unit.colour[i]) ** 2
                variance(COLOUR_VARIANCE, position, unit.colour[i], most=highest)
                if own_times:
                    logarithm(COLOUR_TIME, position, noise.colour_time[i])
        if colour.any() and not own_times:
            logarithm(COLOUR_TIME, -1, _middle(noise.colour_time[colour]))
        place = 0
        for number, sea in enumerate(noise.seas):
            known = Sea() if seas is None else seas[number]
            for own in unit.seas[number].level if known.levels is None else ():
                variance(SEA_VARIANCE, place, own)
                place += 1
            place += len(sea.places) if known.levels is not None else 0
            if known.period is None:  # a wave takes two samples, and a record a few waves
                between = np.log(4.0 * times[0]), high
                logarithm(SEA_PERIOD, number, float(sea.period or 1.0), between)
            if known.bandwidth is None:
                between = np.log(DAMPING[0]), np.log(DAMPING[1])
                logarithm(SEA_DAMPING, number, 0.5 * float(sea.bandwidth or 1.0), between)
        kinds = np.array([row[0] for row in rows], dtype=int)
        table = np.array([row[2:] for row in rows], dtype=float).reshape(len(rows), 4)
        is_time = np.isin(kinds, LOGARITHMS)
        return cls(
            noise,
            unit,
            tuple((row[0], row[1]) for row in rows),
            coloured,
            (
                *disturbances[: len(noise.force)],
                *disturbance_names([place for sea in noise.seas for place in sea.places]),
            ),
            table[:, 0],
            table[:, 1],
            table[:, 2],
            table[:, 3],
            np.where(is_time, VAGUE_TIME**-2.0, 0.0),
        )

    def __len__(self) -> int:
        return len(self.entries)

    def vector(self, noise: NoiseModel | None = None) -> np.ndarray:
        """Unknowns of a noise model, within the bounds, ``(n_levels,)``."""
        noise = self.noise if noise is None else noise
        values = []
        for (kind, index), scale in zip(self.entries, self.scale, strict=True):
            if kind == FORCE_VARIANCE:
                values.append(noise.force[index] ** 2 / scale)
            elif kind == WHITE_VARIANCE:
                values.append(noise.white[index] ** 2 / scale)
            elif kind == COLOUR_VARIANCE:
                values.append(noise.colour[self.coloured[index]] ** 2 / scale)
            elif kind == SEA_VARIANCE:
                level = np.concatenate([sea.level for sea in noise.seas])[index]
                values.append(level**2 / scale)
            elif kind == SEA_PERIOD:
                values.append(np.log(float(noise.seas[index].period or 1.0)))
            elif kind == SEA_DAMPING:
                values.append(np.log(0.5 * float(noise.seas[index].bandwidth or 1.0)))
            else:
                times = noise.force_time if kind == FORCE_TIME else noise.colour_time[self.coloured]
                values.append(np.log(_middle(times[times > 0]) if index < 0 else times[index]))
        return np.clip(np.array(values, dtype=float), self.lower, self.upper)

    def at(self, vector: np.ndarray) -> NoiseModel:
        """Noise model of given unknowns."""
        noise = self.noise
        white, colour, force = noise.white.copy(), noise.colour.copy(), noise.force.copy()
        colour_time, force_time = noise.colour_time.copy(), noise.force_time.copy()
        seas, sea_level = list(noise.seas), [level for sea in noise.seas for level in sea.level]
        for (kind, index), scale, value in zip(self.entries, self.scale, vector, strict=True):
            if kind == FORCE_VARIANCE:
                force[index] = np.sqrt(max(value, 0.0) * scale)
            elif kind == WHITE_VARIANCE:
                white[index] = np.sqrt(max(value, 0.0) * scale)
            elif kind == COLOUR_VARIANCE:
                colour[self.coloured[index]] = np.sqrt(max(value, 0.0) * scale)
            elif kind == FORCE_TIME:
                force_time[noise.force_time > 0 if index < 0 else index] = np.exp(value)
            elif kind == SEA_VARIANCE:
                sea_level[index] = np.sqrt(max(value, 0.0) * scale)
            elif kind == SEA_PERIOD:
                seas[index] = replace(seas[index], period=float(np.exp(value)))
            elif kind == SEA_DAMPING:
                seas[index] = replace(seas[index], bandwidth=2.0 * float(np.exp(value)))
            else:
                colour_time[self.coloured if index < 0 else self.coloured[index]] = np.exp(value)
        starts = np.cumsum([0, *(len(sea.places) for sea in seas)])
        return replace(
            noise,
            white=white,
            colour=colour,
            force=force,
            colour_time=colour_time,
            force_time=force_time,
            seas=tuple(
                sea.with_levels(np.array(sea_level[begin : begin + len(sea.places)]))
                for sea, begin in zip(seas, starts, strict=False)
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
        power = np.zeros(len(self))
        for j, (kind, index) in enumerate(self.entries):
            if kind not in (FORCE_TIME, COLOUR_TIME):
                continue
            level = FORCE_VARIANCE if kind == FORCE_TIME else COLOUR_VARIANCE
            of = [
                i
                for i, (other, its) in enumerate(self.entries)
                if other == level and index in (-1, its) and vector[i] > 0 and self._lasts(i)
            ]
            among, beside = information[np.ix_(of, of)], information[of, j]
            if of and np.all(np.diag(among) > 0):
                size = 1.0 / np.sqrt(np.diag(among))
                change = -size * np.linalg.lstsq(size[:, None] * among * size, size * beside)[0]
                power[of] = np.clip(change / vector[of], -MOST_POWER, MOST_POWER)
        return power

    def _lasts(self, position: int) -> bool:
        kind, index = self.entries[position]
        return kind != FORCE_VARIANCE or bool(self.noise.force_time[index] > 0)

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
        for i, (kind, index) in enumerate(self.entries):
            force = kind == FORCE_VARIANCE
            if not (force or kind == COLOUR_VARIANCE) or vector[i] <= 0 or not self._lasts(i):
                continue
            time = FORCE_TIME if force else COLOUR_TIME
            of = [j for j, entry in enumerate(self.entries) if entry in ((time, index), (time, -1))]
            if of and after[i] > self.lower[i]:  # at its bound it has vanished
                longer = float(np.clip(after[of[0]], self.lower[of[0]], self.upper[of[0]]))
                longer = power[i] * (longer - vector[of[0]])
                kept = max(after[i] - vector[i] * longer, LEAST_KEPT * vector[i])
                after[i] = kept * np.exp(longer)
        return after

    def disturbed(self, noise: NoiseModel) -> Disturbed:
        """What the filter takes."""
        return replace(noise.disturbed(self.coloured), disturbances=self.disturbances)

    def name_of(self, kind: int, index: int) -> str:
        """Name of one unknown, such as ``"force Z level"`` or ``"colour of q time"``."""
        if kind in (SEA_PERIOD, SEA_DAMPING):
            number = f" {index + 1}" if len(self.noise.seas) > 1 else ""
            return f"sea{number} {'period' if kind == SEA_PERIOD else 'bandwidth'}"
        if kind == SEA_VARIANCE:
            places = [place for sea in self.noise.seas for place in sea.places]
            place = f"sea {places[index]}"
        elif kind in (FORCE_VARIANCE, FORCE_TIME):
            place = "disturbances" if index < 0 else self.noise.places[index]
        elif kind == WHITE_VARIANCE:
            place = f"white of {self.noise.outputs[index]}"
        elif index < 0:
            place = "colours"
        else:
            place = f"colour of {self.noise.outputs[self.coloured[index]]}"
        return f"{place} {'time' if kind in (FORCE_TIME, COLOUR_TIME) else 'level'}"

    def held(self) -> Levels:
        """Return the same noise with nothing unknown."""
        nothing = np.zeros(0)
        return replace(
            self,
            entries=(),
            lower=nothing,
            upper=nothing,
            scale=nothing,
            prior_mean=nothing,
            prior_weight=nothing,
        )

    @property
    def are_variances(self) -> np.ndarray:
        """Which unknowns are variances, not times, of shape ``(n_levels,)``."""
        kinds = [kind for kind, _ in self.entries]
        return ~np.isin(kinds, LOGARITHMS).reshape(len(kinds))

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

    def _only(self, keep: Sequence[bool]) -> Levels:
        """Some of the unknowns; the others stay at the noise model's values."""
        return replace(
            self,
            entries=tuple(e for e, kept in zip(self.entries, keep, strict=True) if kept),
            **{
                name: getattr(self, name)[np.array(keep, dtype=bool)]
                for name in ("lower", "upper", "scale", "prior_mean", "prior_weight")
            },
        )

    def starting(self, noise: NoiseModel) -> Levels:
        """Return the same unknowns, begun elsewhere."""
        return replace(self, noise=noise)


def _middle(times: np.ndarray) -> float:
    """Geometric mean of some times."""
    return float(np.exp(np.mean(np.log(np.maximum(times, 1e-9)))))
