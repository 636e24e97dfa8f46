r"""What is random about a record: sensors, and forces that nobody measured.

For a record with states ``x``, outputs ``y`` and inputs ``u``

.. math::
    \dot x &= f(x, u, p) + G(x)\, w, \qquad
    w_j(t + \Delta) = \phi_j w_j(t) + \sqrt{1 - \phi_j^2}\, \sigma_j \epsilon,
    \quad \phi_j = e^{-\Delta/\tau_j} \\
    y_k &= h(x_k, p) + c_k + v_k

``w`` are first-order Gauss-Markov disturbances (level :math:`\sigma_j`, time :math:`\tau_j`),
``c`` coloured and ``v`` white errors of the sensors (Gelb 1974, *Applied optimal estimation*,
section 3.8). Waves are forces of second order instead: a :class:`Sea` of some period and width
acts on several equations, each with a level of its own
(:mod:`oed_sysid.compiled.filtering` has the equations). A :class:`NoiseModel` holds all levels
and times; white noise alone is its simplest case.

Levels and times of the noise as unknowns of an estimation.

A level enters as its variance in squared units, :math:`\eta = (\sigma/\sigma_0)^2 \ge 0`: the
likelihood has a slope there even at zero, so that an absent disturbance stays absent for a
reason. A correlation time enters as :math:`\ln \tau`, with a wide normal prior, because nothing
is known of the time of a disturbance that is absent.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
    SEA_PHASE,
    SEA_VARIANCE,
    SHAPES,
    WHITE_VARIANCE,
    Disturbed,
)
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.disturbances import DISTURBANCE
from oed_sysid.runtime.constants import NEGLIGIBLE, ROUNDING
from oed_sysid.runtime.display import plain

# Steps of a period over which the force of a sea is held at most: a wave held over an n-th of its
# period loses the share 1 - sinc(1/n) = pi^2/(6 n^2) of its amplitude. These are twelve; half as
# many lose 4 %, twice as many 0.3 % and cost twice.
STEPS_OF_PERIOD = int(np.pi / np.sqrt(6.0 * NEGLIGIBLE))


@dataclass(frozen=True)
class Sea:
    """Waves or swell: narrow-band forces with one period and width, and a level in each equation.

    In a :class:`NoiseModel` every number is given. Declared for an estimation, what is given is
    known, and what is left out is estimated.

    Attributes
    ----------
    period : float, optional
        Of an undamped wave, or of the peak, s.
    bandwidth : float, optional
        Width of the spectrum at half its power over its middle: twice the damping ratio.
    levels : mapping of str to float, optional
        Standard deviation of the force by place, ``{"force Z": 0.3}`` or short ``{"Z": 0.3}``, in
        the unit of the place.
    shape : str, optional
        ``"velocity"``, whose spectrum vanishes at frequency zero, ``"displacement"``, which has a
        tail there, or ``"jonswap"``, which is steep below its peak and has a tail above, as the
        spectrum of that name, which levels without a shape have. An estimation takes the likeliest.
    phases : mapping of str to float, optional
        Where one wave acts in all places, as a long-crested swell does: by how much the force in
        each is behind, rad. Without, each place has waves of its own.
    coherence : mapping of str to float, optional
        With phases: the share of each standard deviation that is of the common wave, from 0 to 1;
        the rest of the variance is of waves of its own. Without, all is common.
    height, direction : float, optional
        Where the levels are those of a swell: its significant height, m, and from where it comes,
        clockwise from the bow when a run begins, rad.
    records : sequence of str, optional
        Those that meet it, where records on other headings meet other seas, as an estimation may
        find. Without, all do.

    Examples
    --------
    >>> sea = Sea(period=8.0, bandwidth=0.2, levels={"Z": 0.3})
    >>> sea.places, sea.shape, sea.significant
    (('force Z',), 'jonswap', {'force Z': 0.6})
    """

    period: float | None = None
    bandwidth: float | None = None
    levels: Mapping[str, float] | None = None
    shape: str | None = None
    phases: Mapping[str, float] | None = None
    coherence: Mapping[str, float] | None = None
    height: float | None = None
    direction: float | None = None
    records: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("levels", "phases", "coherence"):
            if (given := getattr(self, name)) is not None:
                named = {k if " " in k else f"force {k}": float(v) for k, v in given.items()}
                object.__setattr__(self, name, named)
        if self.records is not None:
            object.__setattr__(self, "records", tuple(self.records))
        if self.levels is not None:
            object.__setattr__(self, "shape", "jonswap" if self.shape is None else self.shape)
        for right, words in self._faults():
            if not right:
                raise ModelError(f"A sea has {words}")

    def _faults(self) -> Iterator[tuple[bool, str]]:
        """What has to be right, and what is said where it is not."""
        right = bool(np.all((self.level >= 0) & np.isfinite(self.level)))
        yield right, f"levels {dict(self.levels or {})}. Give them as zero or above."
        right = self.period is None or 0 < self.period < np.inf
        yield right, f"a period of {self.period} s. Give one above zero."
        words = "It is a share of the frequency: give one above zero and below 2, such as 0.2."
        right = self.bandwidth is None or 0 < self.bandwidth < 2
        yield right, f"a bandwidth of {self.bandwidth}. {words}"
        right = self.shape in (None, *SHAPES)
        yield right, f"the shape {self.shape!r}. Choose {' or '.join(SHAPES)}."
        told = f"for each place with a level, of all {self.places}."
        yield self._told_for_each(self.phases), f"phases {self.phases}. Give one in rad {told}"
        shares = [*(self.coherence or {}).values()]
        right = not shares or (bool(self.phases) and 0 <= min(shares) <= max(shares) <= 1)
        right = right and self._told_for_each(self.coherence)
        yield right, f"a coherence {self.coherence}. Give one from 0 to 1, and a phase, {told}"

    @property
    def places(self) -> tuple[str, ...]:
        """Where it acts."""
        return tuple(self.levels or ())

    @property
    def level(self) -> np.ndarray:
        """Standard deviations of the forces, ``(n_places,)``."""
        return np.array(list((self.levels or {}).values()), dtype=float)

    def _told_for_each(self, given: Mapping[str, float] | None) -> bool:
        """Whether nothing is given, or a number for every place."""
        return given is None or (
            {*given} == {*self.places} and bool(np.all(np.isfinite([*given.values()])))
        )

    @property
    def processes(self) -> tuple[tuple[str, float, float], ...]:
        """Place, standard deviation, and phase, NaN without, of every process.

        Of one wave first its parts, then what each place has besides.
        """
        levels = self.levels or {}
        if self.phases is None:
            return tuple((place, level, np.nan) for place, level in levels.items())
        share = self.coherence or dict.fromkeys(levels, 1.0)
        parts = ((p, level * share[p], self.phases[p]) for p, level in levels.items())
        beside = ((p, level * np.sqrt(1.0 - share[p] ** 2), np.nan) for p, level in levels.items())
        return (*parts, *(beside if self.coherence else ()))

    def with_processes(self, level: np.ndarray, phase: np.ndarray) -> Sea:
        """Return the same sea with other numbers of all of its processes."""
        count = len(self.places)
        if self.phases is None:
            return self.with_levels(level)
        beside = level[count:] if self.coherence else np.zeros(count)
        total = np.hypot(level[:count], beside)
        share = np.minimum(level[:count] / np.maximum(total, np.finfo(float).tiny), 1.0)
        told = dict(zip(self.places, map(float, share), strict=True)) if self.coherence else None
        phases = dict(zip(self.places, map(float, phase[:count]), strict=True))
        return replace(self.with_levels(total), phases=phases, coherence=told)

    @property
    def significant(self) -> dict[str, float]:
        """Significant amplitude of the force by place, the mean of its highest third: twice rms."""
        return {place: 2.0 * level for place, level in (self.levels or {}).items()}

    @property
    def common(self) -> list[tuple[float, float]]:
        """Of one wave, by place: phase within half a turn, deg, and share of the variance, %."""
        phases, shares = np.array([*(self.phases or {}).values()]), self.coherence or {}
        turned = np.degrees((phases + np.pi) % (2.0 * np.pi) - np.pi)
        share = [100.0 * shares.get(place, 1.0) ** 2 for place in self.places]
        return list(zip(turned.tolist(), share, strict=True))

    @property
    def acts(self) -> bool:
        """Whether any level is above zero."""
        return bool(np.any(self.level > 0))

    @property
    def is_broad(self) -> bool:
        """Whether it is as wide as an estimation lets it be, and so no wave."""
        return (self.bandwidth or 0.0) >= 2.0 * DAMPING[1] * (1.0 - ROUNDING)

    def with_levels(self, level: np.ndarray) -> Sea:
        """Return the same sea with other levels in its places."""
        return replace(self, levels=dict(zip(self.places, map(float, level), strict=True)))

    def only(self, kept: np.ndarray) -> Sea:
        """Return the same sea in some of its places."""
        places = [place for place, one in zip(self.places, kept, strict=True) if one]
        levels, phases, coherence = (
            None if given is None else {place: given[place] for place in places}
            for given in (self.levels, self.phases, self.coherence)
        )
        return replace(self, levels=levels, phases=phases, coherence=coherence)

    def filled(self, other: Sea) -> Sea:
        """Return the same sea with the numbers of another where it leaves some out."""
        own = {name: value for name, value in vars(self).items() if value is not None}
        return replace(other, **own)

    def to_dict(self) -> dict[str, Any]:
        """Return the sea as plain data for JSON."""
        always = ("period", "bandwidth", "shape", "levels", "significant")
        known = ("phases", "coherence", "height", "direction", "records")
        told = (*always, *(name for name in known if getattr(self, name) is not None))
        return {name: plain(getattr(self, name)) for name in told}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Sea:
        """Return the sea of :meth:`to_dict`."""
        return cls(**{name: value for name, value in data.items() if name != "significant"})


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Standard deviations and correlation times of what disturbs a vehicle and its sensors.

    Attributes
    ----------
    white : ndarray (n_outputs,)
        White sensor noise, per sample, in the output's unit.
    colour : ndarray (n_outputs,)
        Coloured sensor noise (first-order Markov); zero where there is none.
    force : ndarray (n_forces,)
        Levels of the disturbances, in the unit of their place.
    colour_time, force_time : ndarray (n_outputs,), (n_forces,)
        Their correlation times, s; one number stands for all. Time zero is white from step
        to step; noise of a sensor that lasts for ever is its zero, which is off by a constant in
        each record.
    outputs, places : tuple of str
        Names, such as ``"q"`` and ``"force Z"`` or ``"actuator fin"``.
    seas : tuple of Sea
        Narrow-band disturbances besides.

    Examples
    --------
    >>> noise = NoiseModel(np.array([0.002]), np.zeros(1), np.array([0.01]), force_time=20.0,
    ...                    outputs=("psi",), places=("force r",))
    >>> dict(zip(noise.places, noise.force.tolist()))
    {'force r': 0.01}
    """

    white: np.ndarray
    colour: np.ndarray
    force: np.ndarray
    colour_time: Any = 0.4
    force_time: Any = 1.0
    outputs: tuple[str, ...] = field(default=())
    places: tuple[str, ...] = field(default=())
    seas: tuple[Sea, ...] = ()

    def __post_init__(self) -> None:
        for name, like in (("colour_time", self.white), ("force_time", self.force)):
            times = np.broadcast_to(np.asarray(getattr(self, name), dtype=float), like.shape)
            object.__setattr__(self, name, times.copy())
        seas = (self.seas,) if isinstance(self.seas, Sea) else tuple(self.seas)
        object.__setattr__(self, "seas", seas)
        for sea in seas:
            if None in (sea.period, sea.bandwidth, sea.levels, sea.shape):
                raise ModelError(f"{sea} leaves numbers out. A noise model needs all of them.")

    @classmethod
    def white_only(cls, white: np.ndarray, outputs: Sequence[str] = ()) -> NoiseModel:
        """Noise of sensors that is white, and nothing else.

        >>> NoiseModel.white_only(np.array([0.1])).is_white
        True
        """
        white = np.asarray(white, dtype=float)
        return cls(white, np.zeros_like(white), np.zeros(0), outputs=tuple(outputs))

    def on(self, *records: str) -> NoiseModel:
        """The noise on some records: of seas that each meets its own, those that these meet.

        A record that none of them knows meets one of its own: of the levels, periods and widths
        that they have in the mean, and of phases that nothing tells.
        """
        known = {name for sea in self.seas for name in sea.records or ()}
        if not known:
            return self
        if records and {*records} <= known:
            met = (sea for sea in self.seas if {*records} & {*(sea.records or records)})
            return replace(self, seas=tuple(met))
        each = (replace(self._usual_sea(), records=(name,)) for name in records)
        return replace(self, seas=tuple(each) or (self._usual_sea(),))

    def _usual_sea(self) -> Sea:
        """What the seas of single records are in the mean."""
        periods, damping = shapes_of(self.seas)
        levels = np.sqrt(np.mean([sea.level**2 for sea in self.seas], axis=0))
        return replace(
            self.seas[0].with_levels(levels),
            period=_middle(periods), bandwidth=2.0 * float(np.mean(damping)),
            phases=None, coherence=None, records=None,
        )  # fmt: skip

    @property
    def has_colour(self) -> bool:
        """Whether any sensor noise is coloured."""
        return bool(np.any(self.colour > 0))

    @property
    def has_forces(self) -> bool:
        """Whether any disturbance has a level above zero."""
        return bool(np.any(self.force > 0)) or any(sea.acts for sea in self.seas)

    @property
    def has_own_times(self) -> bool:
        """Whether disturbances that act and last do so for different times."""
        return len({*self.force_time[(self.force > 0) & (self.force_time > 0)]}) > 1

    @property
    def is_white(self) -> bool:
        """Whether nothing but white sensor noise is left."""
        return not (self.has_colour or self.has_forces)

    @property
    def sea_names(self) -> list[str]:
        """What its seas are called: ``sea``, or ``sea 1`` and so on."""
        count = len(self.seas)
        return [f"sea {i + 1}" if count > 1 else "sea" for i in range(count)]

    @property
    def zeros(self) -> np.ndarray:
        """Standard deviations of the constants by which sensors are off, ``(n_outputs,)``."""
        return np.where(np.isinf(self.colour_time), self.colour, 0.0)

    @property
    def sensors(self) -> np.ndarray:
        """Standard deviation of each output about its zero, white and coloured together."""
        return np.hypot(self.white, self.colour - self.zeros)

    def with_places(self, places: Sequence[str], time: Any, level: Any = 0.0) -> NoiseModel:
        """Return the same model with disturbances at more places.

        Parameters
        ----------
        places : sequence of str
        time, level : float or sequence of float
            One for all places, or one for each.
        """
        nothing = np.zeros(len(places))
        return replace(
            self,
            force=np.append(self.force, nothing + level),
            force_time=np.append(self.force_time, nothing + time),
            places=(*self.places, *places),
        )

    def only(self, kept: Sequence[bool] | np.ndarray) -> NoiseModel:
        """Return the same model with the disturbances of some of its places."""
        chosen = np.asarray(kept, dtype=bool)
        return replace(
            self,
            force=self.force[chosen],
            force_time=self.force_time[chosen],
            places=tuple(place for place, one in zip(self.places, chosen, strict=True) if one),
        )

    def at_most(self, sensors: np.ndarray) -> NoiseModel:
        """Return the same model with sensors whose standard deviation is no larger than given."""
        share = np.minimum(1.0, sensors / np.maximum(self.sensors, 1e-300))
        colour = share * (self.colour - self.zeros) + self.zeros
        return replace(self, white=share * self.white, colour=colour)

    def level(self, place: str) -> tuple[float, float]:
        """Level and time of the disturbance at one place; zero level where there is none."""
        if place not in self.places:
            return 0.0, np.nan
        index = self.places.index(place)
        return float(self.force[index]), float(self.force_time[index])

    def disturbed(self, coloured: np.ndarray | None = None) -> Disturbed:
        """What the filter takes.

        Parameters
        ----------
        coloured : ndarray of int, optional
            Outputs with coloured noise; by default those whose level is above zero.
        """
        coloured = np.flatnonzero(self.colour > 0) if coloured is None else coloured
        count, of_sea = len(self.force), [len(sea.processes) for sea in self.seas]
        at_sea, level, phase = _processes(self.seas)

        def each(of_force: Any, *of_seas: Any) -> np.ndarray:
            return np.concatenate([np.broadcast_to(of_force, count), np.repeat(of_seas, of_sea)])

        return Disturbed(
            disturbance_names((*self.places, *at_sea)),
            np.append(self.force, level) ** 2,
            each(self.force_time, *(sea.period for sea in self.seas)),
            self.white**2,
            coloured,
            self.colour[coloured] ** 2,
            self.colour_time[coloured],
            each(0.0, *(0.5 * (sea.bandwidth or 0.0) for sea in self.seas)),
            each(0, *(SHAPES[sea.shape or "jonswap"] for sea in self.seas)),
            each(-1, *range(len(self.seas))),
            np.append(np.full(count, np.nan), phase),
        )

    @property
    def disturbances(self) -> tuple[str, ...]:
        """Parameters of the filtered model that are random on a record, as a pass has them."""
        first = self.on(*(self.seas[0].records or ())[:1]) if self.seas else self
        return disturbance_names((*self.places, *_processes(first.seas)[0]))

    @property
    def longest_hold(self) -> float:
        """Longest time over which the waves that act may be held, s; infinite without a sea."""
        periods = [float(sea.period or np.inf) for sea in self.seas if sea.acts]
        return min(periods, default=np.inf) / STEPS_OF_PERIOD

    def longest_step(self, times: np.ndarray) -> float | None:
        """Longest time over which forces are held, s; None for the median sample time."""
        return step_within(times, self.longest_hold)

    def to_dict(self) -> dict[str, Any]:
        """Return the noise model as plain data for JSON."""
        sensors = zip(self.outputs, self.white, self.colour, self.colour_time, strict=True)
        forces = zip(self.places, self.force, self.force_time, strict=True)
        return {
            "sensors": {
                name: {"white": float(w), "zero": float(c)}
                if np.isinf(t)
                else {"white": float(w), "colour": float(c), "time": float(t) if c else None}
                for name, w, c, t in sensors
            },
            "disturbances": {
                name: {"level": float(level), "time": float(t) if level else None}
                for name, level, t in forces
            },
            **({"seas": [sea.to_dict() for sea in self.seas]} if self.seas else {}),
        }


# "auto", "all", "none", places, or a sea that is declared, or several of these.
Disturbances = str | Sea | Sequence[str | Sea]


def seas_in(disturbances: Disturbances) -> tuple[Sea, ...]:
    """Seas that are declared among disturbances."""
    return tuple(one for one in _given(disturbances) if isinstance(one, Sea))


def forces_in(disturbances: Disturbances) -> str | tuple[str, ...]:
    """Places that disturbances are asked for; all where nothing but a sea is."""
    if isinstance(disturbances, str) and not seas_in(disturbances):
        return "all" if disturbances == "auto" else disturbances
    return tuple(one for one in _given(disturbances) if isinstance(one, str)) or "all"


def _given(disturbances: Disturbances) -> tuple[str | Sea, ...]:
    """What is asked for, one by one; the word alone is a sea of which nothing is known."""
    given = (disturbances,) if isinstance(disturbances, str | Sea) else disturbances
    return tuple(Sea() if one == "sea" else one for one in given)


def step_within(times: np.ndarray, most: float) -> float | None:
    """Longest step between some samples of at most a time, s; None for their median."""
    if not np.isfinite(most) or len(times) < 2:
        return None
    return min(float(np.median(np.diff(times))), most)


def disturbance_names(at_places: Sequence[str]) -> tuple[str, ...]:
    """Parameters of the filtered model through which disturbances act at places."""
    return tuple(f"{DISTURBANCE}{place.replace(' ', '_', 1)}" for place in at_places)


# -- what of it is unknown ----------------------------------------------------------


# Smallest white variance, as a share of its unit: the filter must stay regular.
WHITE_FLOOR = NEGLIGIBLE**2
# Standard deviation of the prior of the logarithm of a correlation time.
VAGUE_TIME = 2.0
# Shortest time in samples, longest as a share of the shortest record.
SHORTEST, LONGEST = 0.5, 0.2
# Levels that are no variances but logarithms.
LOGARITHMS = (FORCE_TIME, COLOUR_TIME, SEA_PERIOD, SEA_DAMPING)
# Least and largest damping of a sea: below, a wave that never changes; above, no wave.
DAMPING = (0.005, 0.7)


def correlation_times(dataset: Dataset) -> tuple[float, float]:
    """Shortest and longest correlation time that records tell from white noise and a zero, s."""
    shortest = SHORTEST * min(record.sample_time for record in dataset)
    return shortest, max(LONGEST * min(record.duration for record in dataset), 4.0 * shortest)


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
        lasting = noise.colour_time[coloured]
        # What lasts for ever is the zero of a sensor. Where one is off none is trusted to less than
        # its noise, and it may be as far off as the records tell.
        is_zero = np.isinf(lasting)
        most = np.broadcast_to(most_colour, len(unit.colour))[coloured] / unit.colour[coloured]
        most = np.where(is_zero, np.inf, most)
        least = np.where(is_zero, unit.white[coloured] / unit.colour[coloured], 0.0)
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
        add(COLOUR_VARIANCE, np.flatnonzero(of_colour), unit.colour[coloured], least**2, most**2)
        add_times(COLOUR_TIME, of_colour & ~is_zero, lasting)
        _, _, phases = _processes(noise.seas)
        _, sizes, _ = _processes(unit.seas)
        counts, parts = [len(sea.processes) for sea in noise.seas], np.isfinite(phases)
        unknown = np.repeat([sea.levels is None for sea in known], counts).astype(bool)
        # What a fit has put at zero stays there, as forces do; a part of a wave keeps a phase.
        least = np.where(parts, WHITE_FLOOR, 0.0)
        add(SEA_VARIANCE, np.flatnonzero(unknown & (sizes > 0)), sizes, least)
        unknown = np.repeat([sea.phases is None for sea in known], counts).astype(bool)
        # Relative to that of the first part.
        unknown[np.cumsum([0, *counts])[:-1][np.array(counts, dtype=int) > 0]] = False
        add(SEA_PHASE, np.flatnonzero(unknown & parts), np.ones(len(parts)), -np.inf)
        # A wave takes two samples, and a record a few waves.
        periods, damping = shapes_of(noise.seas)
        free = [sea.period is None for sea in known]
        add(SEA_PERIOD, np.flatnonzero(free), periods, np.log(4.0 * times[0]), between[1])
        free = [sea.bandwidth is None for sea in known]
        add(SEA_DAMPING, np.flatnonzero(free), damping, *np.log(DAMPING))
        table = np.array(rows, dtype=float).reshape(-1, 7).T
        entries = tuple(zip(*table[:2].astype(int).tolist(), strict=True))
        return cls(noise, unit, entries, coloured, noise.disturbances, *table[2:])

    def __len__(self) -> int:
        return len(self.entries)

    def _sizes(self, noise: NoiseModel) -> dict[int, np.ndarray]:
        """Numbers of a noise model by kind, counted as :attr:`entries` count them."""
        periods, damping = shapes_of(noise.seas)
        _, level, phase = _processes(noise.seas)
        return {
            FORCE_VARIANCE: noise.force.copy(),
            FORCE_TIME: noise.force_time.copy(),
            WHITE_VARIANCE: noise.white.copy(),
            COLOUR_VARIANCE: noise.colour[self.coloured],
            COLOUR_TIME: noise.colour_time[self.coloured],
            SEA_VARIANCE: level,
            SEA_PERIOD: periods,
            SEA_DAMPING: damping,
            SEA_PHASE: phase,
        }

    def vector(self, noise: NoiseModel | None = None) -> np.ndarray:
        """Unknowns of a noise model, within the bounds, ``(n_levels,)``."""
        sizes, values = self._sizes(self.noise if noise is None else noise), []
        for (kind, index), scale in zip(self.entries, self.scale, strict=True):
            own = sizes[kind]
            # A time that all share begins at the geometric mean of theirs.
            size = own[index] if index >= 0 else _middle(own[(own > 0) & np.isfinite(own)])
            own_value = size if kind == SEA_PHASE else size**2 / scale
            values.append(np.log(size) if kind in LOGARITHMS else own_value)
        return np.clip(np.array(values, dtype=float), self.lower, self.upper)

    def at(self, vector: np.ndarray) -> NoiseModel:
        """Noise model of given unknowns."""
        noise, sizes = self.noise, self._sizes(self.noise)
        for (kind, index), scale, value in zip(self.entries, self.scale, vector, strict=True):
            own = value if kind == SEA_PHASE else np.sqrt(max(value, 0.0) * scale)
            size = np.exp(value) if kind in LOGARITHMS else own
            those = (sizes[kind] > 0) & np.isfinite(sizes[kind])
            sizes[kind][those if index < 0 else index] = size
        colour, colour_time = noise.colour.copy(), noise.colour_time.copy()
        colour[self.coloured] = sizes[COLOUR_VARIANCE]
        colour_time[self.coloured] = sizes[COLOUR_TIME]
        stops = np.cumsum([len(sea.processes) for sea in noise.seas])[:-1]
        levels, phases = (np.split(sizes[kind], stops) for kind in (SEA_VARIANCE, SEA_PHASE))
        each = zip(noise.seas, levels, phases, sizes[SEA_PERIOD], sizes[SEA_DAMPING], strict=False)
        return replace(
            noise,
            white=sizes[WHITE_VARIANCE],
            colour=colour,
            force=sizes[FORCE_VARIANCE],
            colour_time=colour_time,
            force_time=sizes[FORCE_TIME],
            seas=tuple(
                replace(
                    sea.with_processes(level, phase),
                    period=float(period),
                    bandwidth=2.0 * float(damping),
                )
                for sea, level, phase, period, damping in each
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
        found, lasting = {}, self._sizes(self.noise)
        for i, (kind, index) in enumerate(self.entries):
            time = {FORCE_VARIANCE: FORCE_TIME, COLOUR_VARIANCE: COLOUR_TIME}.get(kind, -1)
            j = position.get((time, index), position.get((time, -1)))
            # White from step to step, and what is constant, is no matter of time.
            if j is not None and 0.0 < lasting[time][index] < np.inf:
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

    def on(self, record: Record) -> tuple[Levels, np.ndarray]:
        """Levels that act on one record, and their positions among all."""
        seas, noise = self.noise.seas, self.noise.on(record.name)
        met = np.array([sea in noise.seas for sea in seas], dtype=bool)
        process = np.repeat(met, [len(sea.processes) for sea in seas])
        among = {SEA_PERIOD: met, SEA_DAMPING: met, SEA_VARIANCE: process, SEA_PHASE: process}
        keep = np.array([k not in among or among[k][i] for k, i in self.entries], dtype=bool)
        if record.independent:  # nothing links its samples
            keep &= np.array([kind == WHITE_VARIANCE for kind, _ in self.entries], dtype=bool)
        here = self.only(keep)
        # Counted among those that act there.
        entries = ((k, int(among[k][:i].sum()) if k in among else i) for k, i in here.entries)
        return replace(here, noise=noise, entries=tuple(entries)), np.flatnonzero(keep)

    def disturbed(self, noise: NoiseModel) -> Disturbed:
        """What the filter takes, of a noise model on one record."""
        return replace(noise.disturbed(self.coloured), disturbances=self.disturbances)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns, such as ``"force Z level"`` or ``"colour of q time"``."""
        noise = self.noise
        colours = tuple(f"colour of {noise.outputs[column]}" for column in self.coloured)
        at_sea = [
            f"{label} {place}{' besides' if sea.phases and np.isnan(phase) else ''}"
            for label, sea in zip(noise.sea_names, noise.seas, strict=True)
            for place, _, phase in sea.processes
        ]
        of = {
            FORCE_VARIANCE: ("level", noise.places),
            FORCE_TIME: ("time", (*noise.places, "disturbances")),
            WHITE_VARIANCE: ("level", [f"white of {name}" for name in noise.outputs]),
            COLOUR_VARIANCE: ("level", colours),
            COLOUR_TIME: ("time", (*colours, "colours")),
            SEA_VARIANCE: ("level", at_sea),
            SEA_PHASE: ("phase", at_sea),
            SEA_PERIOD: ("period", noise.sea_names),
            SEA_DAMPING: ("bandwidth", noise.sea_names),
        }
        # A time that all share has the index -1.
        return tuple(f"{of[kind][1][index]} {of[kind][0]}" for kind, index in self.entries)

    def held(self) -> Levels:
        """Return the same noise with nothing unknown."""
        return self.only([False] * len(self))

    @property
    def are_variances(self) -> np.ndarray:
        """Which unknowns are variances, not times, of shape ``(n_levels,)``."""
        kinds = [kind for kind, _ in self.entries]
        return ~np.isin(kinds, (*LOGARITHMS, SEA_PHASE)).reshape(len(kinds))

    @property
    def shares_a_time(self) -> bool:
        """Whether several levels have one time together."""
        return any(index < 0 for _, index in self.entries)

    def without_forces(self, dropped: np.ndarray) -> Levels:
        """Return the same unknowns with some disturbances absent.

        Parameters
        ----------
        dropped : ndarray of bool (n_forces,)
        """
        # A time that all share, of index -1, goes with the last of them.
        gone = np.append(dropped, np.all(dropped | (self.noise.force == 0)))
        of_forces = (FORCE_VARIANCE, FORCE_TIME)
        keep = [not (kind in of_forces and gone[index]) for kind, index in self.entries]
        noise = replace(self.noise, force=np.where(dropped, 0.0, self.noise.force))
        return replace(self.only(keep), noise=noise)

    def holding_forces(self) -> Levels:
        """Return the same unknowns, levels and times of disturbances known."""
        of_sensors = (WHITE_VARIANCE, COLOUR_VARIANCE, COLOUR_TIME)
        return self.only([kind in of_sensors for kind, _ in self.entries])

    def only(self, keep: Sequence[bool] | np.ndarray) -> Levels:
        """Return the same noise with some of its unknowns; the others stay at its values."""
        chosen = np.array(keep, dtype=bool)
        numbers = ("lower", "upper", "scale", "prior_mean", "prior_weight")
        kept: dict[str, Any] = {name: getattr(self, name)[chosen] for name in numbers}
        return replace(self, entries=tuple(compress(self.entries, chosen)), **kept)

    def starting(self, noise: NoiseModel) -> Levels:
        """Return the same unknowns, begun elsewhere."""
        return replace(self, noise=noise)


def _processes(seas: Sequence[Sea]) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Places, levels and phases of all processes of some seas."""
    every = [process for sea in seas for process in sea.processes]
    numbers = np.array([process[1:] for process in every], dtype=float).reshape(-1, 2)
    return tuple(place for place, _, _ in every), numbers[:, 0].copy(), numbers[:, 1].copy()


def shapes_of(seas: Sequence[Sea]) -> tuple[np.ndarray, np.ndarray]:
    """Periods and damping ratios of some seas."""
    periods = np.array([sea.period or 1.0 for sea in seas], dtype=float)
    return periods, np.array([0.5 * (sea.bandwidth or 1.0) for sea in seas], dtype=float)


def _middle(times: np.ndarray) -> float:
    """Geometric mean of some times."""
    return float(np.exp(np.mean(np.log(np.maximum(times, 1e-9)))))
