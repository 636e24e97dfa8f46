r"""One trial at sea, simulated: disturbance forces and coloured sensors drawn from a noise model.

.. math::
    w_{k+1} = \phi w_k + \sqrt{1 - \phi^2}\, \sigma \epsilon_k, \qquad \phi = e^{-\Delta/\tau}

beginning in the stationary distribution, held from sample to sample; the same for the coloured part
of a sensor's error, to which white noise is added. A sea is drawn with the exact transition of its
two states (:mod:`oed_sysid.compiled.filtering`), as often as a wave needs, linear in between. A
manoeuvre that reacts sees the disturbed vehicle, by its sensors' white noise alone.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oed_sysid.compiled.filtering import SHAPES, narrow_band, rates
from oed_sysid.data.dataset import Record
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.manoeuvres import Piecewise
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.disturbances import chosen_places, with_disturbance_inputs
from oed_sysid.likelihood.noise_model import NoiseModel, Sea, shapes_of
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


def forces_of_sea(sea: Sea, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Draw the forces of a sea: parts of one wave, or of one of its own in each place.

    Parameters
    ----------
    sea : Sea
        With all of its numbers.
    times : ndarray (n_times,)
        s, increasing.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray (n_times, n_places)

    Examples
    --------
    >>> sea = Sea(period=8.0, bandwidth=0.2, levels={"Z": 0.3})
    >>> w = forces_of_sea(sea, np.arange(40000) * 0.2, np.random.default_rng(0))[:, 0]
    >>> float(w.std().round(2)), float(np.corrcoef(w[:-20], w[20:])[0, 1].round(2))
    (0.3, -0.64)
    """
    (period,), (damping,) = shapes_of([sea])
    turn = SHAPES[sea.shape or "jonswap"]
    # Transitions by length of step: regular sampling has one.
    lengths, which = np.unique(np.diff(times).round(12), return_inverse=True)
    moves = narrow_band(lengths, period, damping, turn)
    unit = np.eye(moves.shape[1])
    # In units of the stationary covariance, which is one: Q = I - Phi Phi'.
    roots = [np.linalg.cholesky(unit - phi @ phi.T) for phi in moves]
    acting = rates(turn, damping)[1].T

    def wave() -> np.ndarray:
        draws = rng.standard_normal((len(times), len(unit)))
        state = draws[0]
        values = [state]
        for kind, fresh in zip(which, draws[1:], strict=True):
            state = moves[kind] @ state + roots[kind] @ fresh
            values.append(state)
        return np.array(values)

    together = np.zeros((len(times), 2)) if sea.phases is None else wave() @ acting
    forces = dict.fromkeys(sea.places, np.zeros(len(times)))
    for place, level, phase in sea.processes:
        own = np.isnan(phase)
        push = wave()[:, 0] if own else together @ [np.cos(phase), np.sin(phase)]
        forces[place] = forces[place] + level * push
    return np.array([*forces.values()]).T


def drawn_disturbances(
    noise: NoiseModel, times: np.ndarray, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Draw what acts in each place, ``(n_times,)``; several processes in one place add up."""
    found: dict[str, np.ndarray] = {}
    for i in np.flatnonzero(noise.force > 0):
        force = gauss_markov(noise.force[i], noise.force_time[i], times, rng)
        found[noise.places[i]] = found.get(noise.places[i], 0.0) + force
    for sea in noise.seas:
        acting = sea.only(sea.level > 0)
        for place, force in zip(acting.places, forces_of_sea(acting, times, rng).T, strict=True):
            found[place] = found.get(place, 0.0) + force
    return found


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
    times, noise = experiment.times, noise.on(experiment.name)
    held = noise.longest_step(times)
    if held is not None:
        count = int(np.ceil(float(np.max(np.diff(times))) / held - 1e-6))
        # Between two samples as many further points as a wave needs.
        times = np.interp(np.arange((len(times) - 1) * count + 1) / count, range(len(times)), times)
    drawn = drawn_disturbances(noise, times, rng)
    places = chosen_places(model, list(drawn))
    vehicle = with_disturbance_inputs(model, places).with_noise(noise.white)
    names = vehicle.input_names[len(model.inputs) :]
    way = "linear" if noise.seas else "hold"
    waves = [
        Piecewise(name, times.tolist(), force.tolist(), interpolation=way)
        for name, force in zip(names, drawn.values(), strict=True)
    ]
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
