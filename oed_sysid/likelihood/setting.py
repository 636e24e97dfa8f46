"""What stays the same while the noise of some records is looked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood.disturbances import DISTURBANCE, Place, disturbance
from oed_sysid.likelihood.input_noise import shown_in_log
from oed_sysid.likelihood.levels import LONGEST, SHORTEST, Levels
from oed_sysid.likelihood.noise_levels import credible_levels
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.unknowns import KnownStarts
from oed_sysid.physics.model import Model

# Share of the white level seen in the fastest wiggles that an estimate must leave standing.
LEAST_SEEN = 0.7
# ... and the share of that where a sensor is coloured.
COLOUR_SEEN = 0.1
# Slow noise of a sensor, over what was declared or its fastest wiggles show, beyond which it is
# none: noise with correlation 0.9 from sample to sample is at 4 times its wiggles, with 0.98 at 10.
DRIFTS = 10.0
# Noise of a logged input, over what the fastest wiggles of the log show, that is believed.
INPUT_SEEN = 2.0


@dataclass(frozen=True, eq=False)
class Setting:
    """What stays the same while noise is looked for.

    Attributes
    ----------
    places : tuple of Place
        Where disturbances may act.
    white : ndarray (n_outputs,)
        White levels to begin with.
    estimated : ndarray of bool (n_outputs,)
        Which of these are unknown.
    least_white : ndarray (n_outputs,)
        What the fastest wiggles show is there, whatever disturbances could explain of it.
    colour : bool
        Whether sensors may have coloured noise.
    inputs : tuple of Place
        Logged inputs, which may be noisy: white from sample to sample, let in where it pays. Left
        out are those whose log is held or smooth to the last digit.
    most_input : mapping of str to float
        Place of each to the level above which that noise would show in the log itself.
    most_colour : ndarray (n_outputs,), optional
        Level above which slow noise of a sensor is none.
    known : tuple of str
        Places whose level and time are known.
    known_starts : KnownStarts or None
        Start states that are held or known with a stated error.
    """

    places: tuple[Place, ...]
    white: np.ndarray
    estimated: np.ndarray
    least_white: np.ndarray
    colour: bool = True
    inputs: tuple[Place, ...] = ()
    most_input: Mapping[str, float] = field(default_factory=dict)
    most_colour: np.ndarray | None = None
    known: tuple[str, ...] = ()
    known_starts: KnownStarts | None = None

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        places: Sequence[Place],
        white: np.ndarray,
        estimated: np.ndarray,
        *,
        colour: bool = True,
        inputs: Sequence[Place] = (),
        known: Sequence[str] = (),
        known_starts: KnownStarts | None = None,
        drifting: bool = True,
    ) -> Setting:
        """Setting of some records.

        Where sensors are not ``drifting``, slow noise far above their wiggles is none of theirs.
        """
        floor, seen = credible_levels(dataset)
        least = np.where(seen, LEAST_SEEN * np.minimum(floor, white), 0.0)
        most = {p.name: INPUT_SEEN * shown_in_log(dataset, p.channel) for p in inputs}
        return cls(
            tuple(places),
            white,
            estimated,
            least,
            colour,
            tuple(place for place in inputs if most[place.name] > 0),
            most,
            None if drifting else np.where(seen, DRIFTS * np.maximum(floor, white), np.inf),
            tuple(known),
            known_starts,
        )

    @property
    def disturbances(self) -> tuple[str, ...]:
        """Parameters of the filtered model that may be disturbances."""
        own = (place for place in self.inputs if place not in self.places)
        return tuple(disturbance(place).name for place in (*self.places, *own))

    def times(self, dataset: Dataset) -> tuple[float, float]:
        """Shortest and longest correlation time, s."""
        shortest = SHORTEST * min(record.sample_time for record in dataset)
        return shortest, max(LONGEST * min(record.duration for record in dataset), 4.0 * shortest)

    def noise(self, model: Model, time: float) -> NoiseModel:
        """White noise, and disturbances of zero level."""
        nothing = np.zeros_like(self.white)
        return NoiseModel(
            self.white,
            nothing,
            np.zeros(len(self.places)),
            time,
            np.array([0.0 if place.stage == "actuator" else time for place in self.places]),
            model.output_names,
            tuple(place.name for place in self.places),
        )

    def levels(
        self,
        dataset: Dataset,
        noise: NoiseModel,
        unit: NoiseModel,
        colour: np.ndarray,
        *,
        own_times: bool = False,
    ) -> Levels:
        """Unknown levels, begun at a noise model, some outputs coloured."""
        known = dict(zip(unit.places, unit.force, strict=True))
        sizes = [
            known.get(place, max(level, 1e-9))
            for place, level in zip(noise.places, noise.force, strict=True)
        ]
        return Levels.of(
            noise,
            # What a white fit leaves may be far above any sensor's noise, and so no unit of it.
            replace(
                unit,
                white=np.minimum(unit.white, self.white),
                force=np.array(sizes),
                force_time=1.0,
                places=noise.places,
            ),
            [f"{DISTURBANCE}{place.replace(' ', '_', 1)}" for place in noise.places],
            # Where colour is let in, the white level has to make room for it.
            white=self.estimated | colour,
            colour=colour,
            force=np.array([place not in self.known for place in noise.places], dtype=bool),
            own_times=own_times,
            # ... and most of the fastest wiggles may be its own.
            least_white=np.where(colour, COLOUR_SEEN, 1.0) * self.least_white,
            most_colour=self.most_colour,
            times=self.times(dataset),
        )

    def as_in(self, dataset: Dataset, noise: NoiseModel, unit: NoiseModel) -> Levels:
        """Unknown levels as a noise model has them: its colours, its own times if they differ."""
        times = noise.force_time[(noise.force > 0) & (noise.force_time > 0)]
        own = bool(np.any(times != times[:1]))
        return self.levels(dataset, noise, unit, noise.colour > 0, own_times=own)
