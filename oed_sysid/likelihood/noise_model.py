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
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from oed_sysid.compiled.filtering import FOURTH, Disturbed
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.disturbances import DISTURBANCE

SHAPES = {"jonswap": FOURTH, "velocity": -1, "displacement": 1}
# Steps of a period over which the force of a sea is held at most: a wave held that long loses 1 %
# of its amplitude (sinc(1/12)); half as many steps lose 4 %, twice as many 0.3 % and cost twice.
STEPS_OF_PERIOD = 12


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
    height, direction : float, optional
        Where the levels are those of a swell: its significant height, m, and from where it comes,
        clockwise from the bow when a run begins, rad.

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
    height: float | None = None
    direction: float | None = None

    def __post_init__(self) -> None:
        if self.levels is not None:
            named = {k if " " in k else f"force {k}": float(v) for k, v in self.levels.items()}
            object.__setattr__(self, "levels", named)
            object.__setattr__(self, "shape", "jonswap" if self.shape is None else self.shape)
        faults = (
            (bool(np.all((self.level >= 0) & np.isfinite(self.level))),
             f"levels {dict(self.levels or {})}. Give them as zero or above."),
            (self.period is None or 0 < self.period < np.inf,
             f"a period of {self.period} s. Give one above zero."),
            (self.bandwidth is None or 0 < self.bandwidth < 2,
             f"a bandwidth of {self.bandwidth}. It is a share of the frequency: give one above "
             "zero and below 2, such as 0.2."),
            (self.shape in (None, *SHAPES),
             f"the shape {self.shape!r}. Choose {' or '.join(SHAPES)}."),
        )  # fmt: skip
        for right, words in faults:
            if not right:
                raise ModelError(f"A sea has {words}")

    @property
    def places(self) -> tuple[str, ...]:
        """Where it acts."""
        return tuple(self.levels or ())

    @property
    def level(self) -> np.ndarray:
        """Standard deviations of the forces, ``(n_places,)``."""
        return np.array(list((self.levels or {}).values()), dtype=float)

    @property
    def significant(self) -> dict[str, float]:
        """Significant amplitude of the force by place, the mean of its highest third: twice rms."""
        return {place: 2.0 * level for place, level in (self.levels or {}).items()}

    @property
    def is_complete(self) -> bool:
        """Whether nothing is left to estimate."""
        return None not in (self.period, self.bandwidth, self.levels, self.shape)

    @property
    def acts(self) -> bool:
        """Whether any level is above zero."""
        return bool(np.any(self.level > 0))

    def with_levels(self, level: np.ndarray) -> Sea:
        """Return the same sea with other levels in its places."""
        return replace(self, levels=dict(zip(self.places, map(float, level), strict=True)))

    def filled(self, other: Sea) -> Sea:
        """Return the same sea with the numbers of another where it leaves some out."""
        own = {name: value for name, value in vars(self).items() if value is not None}
        return replace(other, **own)

    def to_dict(self) -> dict[str, Any]:
        """Return the sea as plain data for JSON."""
        return {
            "period": self.period,
            "bandwidth": self.bandwidth,
            "shape": self.shape,
            "levels": None if self.levels is None else dict(self.levels),
            "significant": self.significant,
            **{n: v for n in ("height", "direction") if (v := getattr(self, n)) is not None},
        }

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
        to step.
    outputs, places : tuple of str
        Names, such as ``"q"`` and ``"force Z"`` or ``"actuator fin"``.
    seas : tuple of Sea
        Narrow-band disturbances besides.
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
            if not sea.is_complete:
                raise ModelError(f"{sea} leaves numbers out. A noise model needs all of them.")

    @classmethod
    def white_only(cls, white: np.ndarray, outputs: Sequence[str] = ()) -> NoiseModel:
        """Noise of sensors that is white, and nothing else.

        >>> NoiseModel.white_only(np.array([0.1])).is_white
        True
        """
        white = np.asarray(white, dtype=float)
        return cls(white, np.zeros_like(white), np.zeros(0), outputs=tuple(outputs))

    @property
    def has_colour(self) -> bool:
        """Whether any sensor noise is coloured."""
        return bool(np.any(self.colour > 0))

    @property
    def has_forces(self) -> bool:
        """Whether any disturbance has a level above zero."""
        return bool(np.any(self.force > 0)) or any(sea.acts for sea in self.seas)

    @property
    def is_white(self) -> bool:
        """Whether nothing but white sensor noise is left."""
        return not (self.has_colour or self.has_forces)

    @property
    def sensors(self) -> np.ndarray:
        """Standard deviation of one measurement of each output, white and coloured together."""
        return np.hypot(self.white, self.colour)

    def with_places(self, places: Sequence[str], time: float) -> NoiseModel:
        """Return the same model with disturbances of level zero at more places."""
        nothing = np.zeros(len(places))
        return replace(
            self,
            force=np.append(self.force, nothing),
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
        return replace(self, white=share * self.white, colour=share * self.colour)

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
        count, of_sea = len(self.force), [len(sea.places) for sea in self.seas]
        at_places = (*self.places, *(place for sea in self.seas for place in sea.places))

        def each(of_force: Any, *of_seas: Any) -> np.ndarray:
            return np.concatenate([np.broadcast_to(of_force, count), np.repeat(of_seas, of_sea)])

        return Disturbed(
            disturbance_names(at_places),
            np.concatenate([self.force, *(sea.level for sea in self.seas)]) ** 2,
            each(self.force_time, *(sea.period for sea in self.seas)),
            self.white**2,
            coloured,
            self.colour[coloured] ** 2,
            self.colour_time[coloured],
            each(0.0, *(0.5 * (sea.bandwidth or 0.0) for sea in self.seas)),
            each(0, *(SHAPES[sea.shape or "jonswap"] for sea in self.seas)),
            each(-1, *range(len(self.seas))),
        )

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
                name: {"white": float(w), "colour": float(c), "time": float(t) if c else None}
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
    given = (disturbances,) if isinstance(disturbances, str | Sea) else disturbances
    return tuple(one for one in given if isinstance(one, Sea))


def step_within(times: np.ndarray, most: float) -> float | None:
    """Longest step between some samples of at most a time, s; None for their median."""
    if not np.isfinite(most) or len(times) < 2:
        return None
    return min(float(np.median(np.diff(times))), most)


def disturbance_names(at_places: Sequence[str]) -> tuple[str, ...]:
    """Parameters of the filtered model through which disturbances act at places."""
    return tuple(f"{DISTURBANCE}{place.replace(' ', '_', 1)}" for place in at_places)
