r"""One trial at sea, simulated: disturbance forces and coloured sensors drawn from a noise model.

.. math::
    w_{k+1} = \phi w_k + \sqrt{1 - \phi^2}\, \sigma \epsilon_k, \qquad \phi = e^{-\Delta/\tau}

beginning in the stationary distribution, held from sample to sample; the same for the coloured part
of a sensor's error, to which white noise is added. A manoeuvre that reacts sees the disturbed
vehicle, by its sensors' white noise alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oed_sysid.data.dataset import Record
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.manoeuvres import Piecewise
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.disturbances import chosen_places, with_disturbance_inputs
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model


def gauss_markov(
    level: float, time: float, times: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draw a stationary first-order Gauss-Markov process.

    Parameters
    ----------
    level : float
        Standard deviation.
    time : float
        Correlation time, s; zero is white.
    times : ndarray (n_times,)
        s, increasing.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray (n_times,)

    Examples
    --------
    >>> w = gauss_markov(0.3, 2.0, np.arange(20000) * 0.1, np.random.default_rng(0))
    >>> float(w.std().round(2)), float(np.corrcoef(w[:-20], w[20:])[0, 1].round(2))
    (0.31, 0.41)
    """
    draws = rng.standard_normal(len(times))
    steps = np.diff(times)
    memory = np.exp(-steps / time) if time > 0 else np.zeros(len(steps))
    fresh = np.sqrt(1 - memory**2) * draws[1:]
    # Plain floats: ten times faster than indexing arrays.
    value = float(draws[0])
    values = [value]
    for phi, push in zip(memory.tolist(), fresh.tolist(), strict=True):
        value = phi * value + push
        values.append(value)
    return level * np.array(values)


def at_sea(
    model: Model, experiment: Experiment, noise: NoiseModel, *, rng: np.random.Generator
) -> tuple[Model, Experiment]:
    """Return the vehicle with what disturbs it as inputs, and the run with one draw of them.

    Parameters
    ----------
    model : Model
    experiment : Experiment
    noise : NoiseModel
        Sensors in the order of the model's outputs; disturbance forces in equations (``force Z``)
        and other disturbances (``sensor q``).
    rng : numpy.random.Generator
    """
    acting = [i for i in range(len(noise.force)) if noise.force[i] > 0]
    places = chosen_places(model, [noise.places[i] for i in acting])
    vehicle = with_disturbance_inputs(model, places)
    vehicle = replace(
        vehicle,
        outputs=tuple(
            replace(output, noise_std=float(level))
            for output, level in zip(model.outputs, noise.white, strict=True)
        ),
    )
    names = vehicle.input_names[len(model.inputs) :]
    times = experiment.times
    waves = []
    for index, name in zip(acting, names, strict=True):
        force = gauss_markov(noise.force[index], noise.force_time[index], times, rng)
        waves.append(Piecewise(name, times.tolist(), force.tolist()))
    return vehicle, replace(experiment, manoeuvre=(*experiment.manoeuvres, *waves))


def simulate_at_sea(
    model: Model, experiment: Experiment, noise: NoiseModel, *, rng: np.random.Generator
) -> Record:
    """Simulate an experiment under disturbance forces and return what would be logged.

    Parameters
    ----------
    model : Model
        The vehicle as it is.
    experiment : Experiment
    noise : NoiseModel
        Sensors in the order of the model's outputs; disturbance forces in equations (``force Z``).
    rng : numpy.random.Generator

    Returns
    -------
    Record

    Raises
    ------
    SimulationError
        If the vehicle diverges.
    """
    vehicle, run = at_sea(model, experiment, noise, rng=rng)
    record = simulate(vehicle, run, rng=rng)
    outputs = record.outputs.copy()
    for i in np.flatnonzero(noise.colour > 0):
        outputs[:, i] += gauss_markov(noise.colour[i], noise.colour_time[i], record.times, rng)
    return Record(
        experiment.name, record.times, record.inputs[:, : len(model.inputs)], outputs,
        model.channels, source=f"simulation at sea of {model.name}: {experiment.describe()}",
    )  # fmt: skip
