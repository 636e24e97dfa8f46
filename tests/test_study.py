"""One filter for every model on the way, and linear deviations against another integrator."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from turning_ship import CANDIDATES, CUBIC, NOISE, SAMPLE, SHIP, dataset, rates

from oed_sysid.errors import DataError
from oed_sysid.evidence.score import two_sided
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.disturbances import disturbed_equations
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.levels import Levels
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.smoother import Path
from oed_sysid.physics import sensor_bias

N3 = -15.0


def flow(state: np.ndarray, rudder: float, push: float) -> np.ndarray:
    """Heading and yaw rate one sample later."""

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return rates(x, rudder, N3) + np.array([0.0, push])

    return solve_ivp(rate, (0.0, SAMPLE), state, rtol=1e-11, atol=1e-13).y[:, -1]


def test_moves_of_the_filter_are_derivatives_of_the_step() -> None:
    """Transition and force gain equal central differences of a tight adaptive integrator."""
    data = dataset(0, N3, 1)
    model = (SHIP + CUBIC).with_values({"K": 0.5, "T": 4.0, "n3": N3})
    nothing = np.zeros(2, dtype=bool)
    noise = NoiseModel(NOISE, np.zeros(2), np.array([1e-3]), 1.0, 2.0, ("psi", "r"), ("force r",))
    levels = Levels.of(
        noise, noise, ["disturbance_force_r"], white=nothing, colour=nothing, force=nothing[:1]
    )
    problem = Filtered(model, data, levels)
    unknowns = problem.point([data[0].outputs[0]]).unknowns
    part = problem.passes(unknowns, columns=False, gains=True, moves=True)[0]
    path = Path.of(part)
    assert part.moves is not None
    size = 1e-4
    for k in (10, 77, 150, 280):
        state, push = part.path[k, :2], part.path[k, 2]
        rudder = float(data[0].inputs[k, 0])
        for column in range(2):
            move = size * np.eye(2)[column]
            ends = [flow(state + sign * move, rudder, push) for sign in (1, -1)]
            slope = (ends[0] - ends[1]) / (2 * size)
            np.testing.assert_allclose(part.moves[k, :2, column], slope, atol=1e-5)
        ends = [flow(state, rudder, push + sign * size) for sign in (1, -1)]
        np.testing.assert_allclose(
            path.drive[k, :2, 0], (ends[0] - ends[1]) / (2 * size), atol=1e-5
        )
    np.testing.assert_allclose(part.gains[3, :, 0, :2], np.eye(2), atol=1e-12)  # type: ignore[index]


def test_only_equations_with_parameters_are_disturbed() -> None:
    """Heading is the integral of yaw rate by definition; yaw acceleration may lack physics."""
    assert disturbed_equations(SHIP) == ("r",)


def test_sub_models_of_a_study_are_the_models_themselves() -> None:
    """On the filter of all candidates each model has the likelihood it has on its own."""
    data = dataset(1, N3, 1)
    study, fit = Study.begin(SHIP, data, None, CANDIDATES, known_noise=False)
    assert study.skipped == ()
    levels = study.levels(fit.noise, data)
    for effects in ((), study.candidates[:1], study.candidates[::-1]):
        through = study.problem(effects, fit.values, levels, data)
        alone = Filtered(through.model, data, levels)
        point = through.point(fit.initial)
        assert through.layout.free_names == alone.layout.free_names
        value = alone.objective(point.unknowns)
        assert through.objective(point.unknowns) == pytest.approx(value, rel=1e-9)
        matrix, right = through.gathered(point.unknowns, through.passes(point.unknowns))
        own_matrix, own_right = alone.gathered(point.unknowns, alone.passes(point.unknowns))
        np.testing.assert_allclose(matrix, own_matrix, rtol=1e-7, atol=1e-9 * own_matrix.max())
        size = np.sqrt(np.diag(own_matrix))
        np.testing.assert_allclose(right / size, own_right / size, atol=1e-6)


def test_a_candidate_that_does_not_fit_is_left_out() -> None:
    """A candidate on signals that the model lacks is skipped and named."""
    candidates = (*CANDIDATES, sensor_bias("bias_depth", "z", "m", scale=0.1))
    study, _ = Study.begin(SHIP, dataset(1, N3, 1), None, candidates, known_noise=True)
    assert study.skipped == ("bias_depth",)
    assert [effect.name for effect in study.candidates] == [e.name for e in CANDIDATES]
    assert [two_sided(effect) for effect in study.candidates] == [True, True, False, True]


def test_known_noise_has_to_be_declared() -> None:
    """Levels that nobody declared cannot be taken as known, and the outputs are named."""
    from yaw_vehicle import yaw_data, yaw_model

    with pytest.raises(DataError, match="psi, r"):
        Study.begin(yaw_model(), yaw_data(), None, [CUBIC], known_noise=True)


def test_validation_prefers_the_true_structure() -> None:
    """Records that were not fitted are likelier under the model with the hidden damping."""
    train, other = dataset(11, N3), dataset(12, N3)
    study, fit = Study.begin(SHIP, train, other, CANDIDATES, known_noise=False)
    right = study.estimate(study.candidates[:1], fit.values, fit, max_iterations=25)
    wrong = study.estimate(study.candidates[1:2], fit.values, fit, max_iterations=25)
    assert right is not None
    assert wrong is not None
    assert study.validate(fit) - study.validate(right) > 50.0
    assert study.validate(wrong) - study.validate(right) > 50.0
    np.testing.assert_allclose(study.rms(right, other), NOISE, rtol=0.12)
    assert np.all(study.rms(fit, other) > 1.3 * study.rms(right, other))
