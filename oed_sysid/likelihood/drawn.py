"""What is predicted where all that is uncertain is drawn, not carried to first order.

Mean squares about the prediction, of runs with parameters, start states and random forces drawn
together: beyond first order an unstable vehicle falls to one side or the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.record import Record
from oed_sysid.experiments.simulation import simulate_batch
from oed_sysid.likelihood.disturbances import chosen_places, with_disturbance_inputs
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.realisation import gauss_markov
from oed_sysid.physics.model import Model

# Draws that show whether a first-order band would mislead, draws of a band, and at once.
N_PROBE, N_DRAWS, CHUNK = 20, 200, 20
RUNAWAY = 1e100  # a draw beyond is no run of a vehicle
# Mean over a run of drawn over first-order variances from which (or below whose inverse) it does;
# three times the scatter of so few draws.
MISLEADS = 2.0
# The same where both are of the same draws, so that no chance is in it.
MISLEADS_SURELY = 1.2

SimulateAll = Callable[[np.ndarray, np.random.Generator], np.ndarray]


@dataclass(frozen=True, eq=False)
class Spread:
    """Distribution of the unknowns of one record.

    Attributes
    ----------
    unknowns : ndarray (n_unknowns,)
        Its centre.
    shared, others : ndarray of int
        Columns of shared parameters, and of start states and parameters of the record.
    gain : ndarray (n_others, n_shared)
        How the others follow the shared, as they would if they were estimated anew.
    covariance : ndarray (n_shared, n_shared)
        Infinite variances stay at the centre.
    other_covariance : ndarray (n_others, n_others)
        At given shared parameters.
    bounds : tuple of ndarray (n_unknowns,)
        Lower and upper; draws beyond are set to them.
    """

    unknowns: np.ndarray
    shared: np.ndarray
    others: np.ndarray
    gain: np.ndarray
    covariance: np.ndarray
    other_covariance: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]

    def draw(self, n_draws: int, rng: np.random.Generator) -> np.ndarray:
        """Unknowns, ``(n_draws, n_unknowns)``."""
        known = np.isfinite(np.diag(self.covariance))
        root, own = _root(self.covariance[np.ix_(known, known)]), _root(self.other_covariance)
        steps = np.zeros((n_draws, len(self.shared)))
        steps[:, known] = rng.normal(size=(n_draws, len(root))) @ root.T
        found = np.tile(self.unknowns, (n_draws, 1))
        found[:, self.shared] += steps
        alone = rng.normal(size=(n_draws, len(own))) @ own.T
        found[:, self.others] += alone - steps @ self.gain.T
        return np.clip(found, *self.bounds)

    def mean_square(
        self, simulate: SimulateAll, outputs: np.ndarray, n_draws: int = N_DRAWS
    ) -> np.ndarray:
        """Mean square about ``outputs`` of runs that do not run away, ``(n_times, n_outputs)``."""
        rng = np.random.default_rng(0)  # the same draws for the same fit
        total, count = np.zeros_like(outputs), 0
        for done in range(0, n_draws, CHUNK):
            runs = simulate(self.draw(min(CHUNK, n_draws - done), rng), rng)
            runs = runs[(np.abs(runs) < RUNAWAY).all(axis=(1, 2))]
            total += ((runs - outputs) ** 2).sum(axis=0)
            count += len(runs)
        return total / count if count else np.full_like(outputs, np.inf)


def misleads(variance: np.ndarray, drawn: np.ndarray, limit: float = MISLEADS) -> bool:
    """Whether first-order variances differ clearly from those of some draws, on the whole."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(np.isfinite(variance) & (variance > 0), drawn / variance, np.nan)
    seen = ~np.isnan(ratio).all(axis=0)
    means = np.nanmean(ratio[:, seen], axis=0)
    return bool(np.any((means > limit) | (means < 1.0 / limit)))


def runs_at_sea(
    model: Model,
    record: Record,
    noise: NoiseModel,
    split: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> SimulateAll:
    """Runs of a record under drawn random forces.

    Parameters
    ----------
    model : Model
    record : Record
        Gives times and inputs.
    noise : NoiseModel
        Its forces are drawn; sensors are without noise.
    split : callable
        From unknowns to all values of the model's parameters and its own start states.
    """
    acting = [i for i in range(len(noise.force)) if noise.force[i] > 0]
    places = chosen_places(model, [noise.places[i] for i in acting])
    vehicle = with_disturbance_inputs(model, places)

    def simulate(unknowns: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        values, starts = (np.array(part) for part in zip(*map(split, unknowns), strict=True))
        waves = [
            [gauss_markov(noise.force[i], noise.force_time[i], record.times, rng) for i in acting]
            for _ in unknowns
        ]
        calm = np.broadcast_to(record.inputs, (len(unknowns), *record.inputs.shape))
        shape = (len(unknowns), len(acting), len(record.times))
        inputs = np.concatenate([calm, np.reshape(waves, shape).swapaxes(1, 2)], axis=2)
        return simulate_batch(vehicle, record.times, inputs=inputs, values=values, initials=starts)

    return simulate


def _root(covariance: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))
