"""Population searches on the trajectory misfit."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from test_estimators import TEST, YAW

from oed_sysid import Dataset, Model, load_problem
from oed_sysid.baselines import DifferentialSwarm, OutputError
from oed_sysid.baselines.population import TrajectoryCost, redrawn
from oed_sysid.errors import ModelError
from oed_sysid.experiments.simulation import simulate, simulate_inputs


def yaw_data(seed: int) -> Dataset:
    """One noisy record."""
    return Dataset((simulate(YAW, TEST, rng=np.random.default_rng(seed)),))


def bounded(model: Model, low: float, high: float) -> Model:
    """Bounds on every free parameter at multiples of its value."""
    for parameter in model.free_parameters:
        lower, upper = sorted((low * parameter.value, high * parameter.value))
        model = model.with_parameter(replace(parameter, lower=lower, upper=upper))
    return model


def test_cost_is_the_mean_square_of_scaled_residuals() -> None:
    """The vectorised cost of each candidate equals that of a single simulation."""
    data = yaw_data(0)
    cost = TrajectoryCost(YAW, data)
    candidates = np.array([[-1.0, -4.0, 0.8], [-0.5, -2.0, 1.0]])
    own = cost._starts[0]
    expected = []
    for candidate in candidates:
        model = YAW.with_values(dict(zip(YAW.free_names, candidate, strict=True)))
        run = simulate_inputs(model, data[0].times, inputs=data[0].inputs, initial=own)
        scaled = (run.outputs - data[0].outputs) / [2e-3, 1e-3]
        expected.append(np.mean(scaled**2))
    assert cost(candidates) == pytest.approx(expected)
    assert cost.n_evaluations == 2


def test_cost_leaves_missing_samples_out_and_survives_divergence() -> None:
    """NaN samples do not count, and a candidate that diverges costs infinity."""
    data = yaw_data(0)
    outputs = data[0].outputs.copy()
    outputs[10:20, 0] = np.nan
    cost = TrajectoryCost(YAW, Dataset((data[0].with_outputs(outputs),)))
    assert np.isfinite(cost(np.array([[-1.0, -4.0, 0.8]])))[0]
    wild = replace(YAW.parameter("N_r"), lower=-1e5, upper=0.0, value=-1.0)
    assert TrajectoryCost(YAW.with_parameter(wild), data)(np.array([[-9e4, -4.0, 0.8]]))[0] > 1e20


def test_swarm_ends_at_the_optimum_and_states_its_errors() -> None:
    """With noise the swarm ends at the least cost, with the errors of least squares there."""
    data, start = yaw_data(1), {"psi": 0.0, "r": 0.0}
    swarm = DifferentialSwarm(n_particles=40, n_generations=150, initial=start).fit(YAW, data)
    cost = TrajectoryCost(YAW, data, initial=start)
    least = minimize(
        lambda x: cost(x)[0],
        [YAW.values[name] for name in YAW.free_names],
        method="Nelder-Mead",
        options={"xatol": 1e-7, "fatol": 1e-9},
    )
    reference = OutputError().fit(YAW, data)
    for name, value in zip(YAW.free_names, least.x, strict=True):
        assert abs(swarm.values[name] - value) < 0.05 * swarm.std_errors[name]
        assert abs(swarm.values[name] - YAW.values[name]) < 3.5 * swarm.std_errors[name]
        # The start is known here and estimated there.
        assert 0.3 < swarm.std_errors[name] / reference.std_errors[name] < 1.05
    assert np.all(np.diff(swarm.extras["history"]) <= 0)
    assert swarm.extras["evaluations"] == pytest.approx(40 * (swarm.iterations + 1), abs=5)


def test_one_random_number_per_particle_converges_faster() -> None:
    """Over six seeds the draw per particle reaches a far lower cost than one per dimension."""
    data = Dataset((simulate(YAW, TEST, noise=False),))
    lowest = {
        draw: np.median(
            [
                DifferentialSwarm(n_particles=20, n_generations=80, draw=draw, seed=seed)
                .fit(YAW, data)
                .extras["history"][-1]
                for seed in range(6)
            ]
        )
        for draw in ("particle", "dimension")
    }
    assert lowest["particle"] < 0.3 * lowest["dimension"]


def test_noise_of_a_measured_start_is_in_the_errors() -> None:
    """A start taken from noisy measurements widens the stated errors."""
    known = DifferentialSwarm(n_generations=60, initial={"psi": 0.0, "r": 0.0})
    measured = DifferentialSwarm(n_generations=60)
    first, second = (estimator.fit(YAW, yaw_data(2)) for estimator in (known, measured))
    assert second.std_errors["N_r"] > 1.5 * first.std_errors["N_r"]
    with pytest.raises(ModelError, match="initial names 'u'"):
        DifferentialSwarm(initial={"u": 1.0}).fit(YAW, yaw_data(2))


def test_members_of_a_difference_may_be_the_same() -> None:
    """Over six seeds the search converges faster where the two random members may coincide."""
    data = Dataset((simulate(YAW, TEST, noise=False),))
    lowest = {
        distinct: np.median(
            [
                DifferentialSwarm(n_particles=20, n_generations=60, distinct=distinct, seed=seed)
                .fit(YAW, data)
                .extras["history"][-1]
                for seed in range(6)
            ]
        )
        for distinct in (False, True)
    }
    assert lowest[False] < 0.5 * lowest[True]


def test_redrawn_coordinates_lie_between_best_and_bound() -> None:
    """Coordinates outside the bounds come back inside, others stay."""
    rng = np.random.default_rng(0)
    lower, upper = np.zeros(3), np.ones(3)
    best = rng.uniform(size=(200, 3))
    moved = rng.uniform(-1, 2, size=(200, 3))
    result = redrawn(moved, best, lower, upper, rng)
    inside = (moved >= 0) & (moved <= 1)
    assert np.array_equal(result[inside], moved[inside])
    assert np.all(result[moved < 0] <= best[moved < 0])
    assert np.all(result[moved > 1] >= best[moved > 1])
    assert result.min() >= 0
    assert result.max() <= 1


def test_search_needs_bounds() -> None:
    """A free parameter without bounds is named, with what to do."""
    parameter = replace(YAW.parameter("N_r"), lower=-np.inf)
    with pytest.raises(ModelError, match="N_r have no finite bounds"):
        DifferentialSwarm().fit(YAW.with_parameter(parameter), yaw_data(0))


@pytest.mark.slow
def test_large_swarm_is_quick() -> None:
    """100 particles, 300 generations, 1,000 samples: 15 s on two cores, 30 s of processor time."""
    problem = load_problem("auv_diving_plane")
    experiment = replace(problem.experiment("zigzag_5_5"), duration=499.5)
    data = Dataset((simulate(problem.model, experiment, noise=False),))
    assert data.n_samples == 1000
    model = bounded(problem.model, 0.2, 3.0)
    swarm = DifferentialSwarm(n_particles=100, n_generations=300)
    began = time.process_time()  # other work on the machine does not count
    fit = swarm.fit(model, data)
    assert time.process_time() - began < 30.0
    assert fit.extras["history"][-1] < 1e-3 * fit.extras["history"][0]
