"""Linear deviations against finite differences of an independent integrator."""

from __future__ import annotations

import numpy as np
from oed_sysid.diagnosis.linearise import SuperModel, deviations, disturbed_equations
from scipy.integrate import solve_ivp
from turning_ship import CANDIDATES, CUBIC, NOISE, SAMPLE, SHIP, dataset, rates

from oed_sysid.diagnosis.score import two_sided

N3 = -15.0


def flow(state: np.ndarray, rudder: float, push: float) -> np.ndarray:
    """Heading and yaw rate one sample later."""

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return rates(x, rudder, N3) + np.array([0.0, push])

    return solve_ivp(rate, (0.0, SAMPLE), state, rtol=1e-11, atol=1e-13).y[:, -1]


def test_deviations_are_derivatives_of_the_step() -> None:
    """Transition and force gain equal central differences of a tight adaptive integrator."""
    data = dataset(0, N3, 1)
    model = (SHIP + CUBIC).with_values({"K": 0.5, "T": 4.0, "n3": N3})
    states = data[0].outputs * 1.0
    found = deviations(model, data, [states])[0]
    size = 1e-4
    for k in (10, 77, 150, 280):
        rudder = float(data[0].inputs[k, 0])
        for column in range(2):
            move = size * np.eye(2)[column]
            slope = (flow(states[k] + move, rudder, 0) - flow(states[k] - move, rudder, 0)) / (
                2 * size
            )
            np.testing.assert_allclose(found.transition[k, :, column], slope, atol=1e-5)
        slope = (flow(states[k], rudder, size) - flow(states[k], rudder, -size)) / (2 * size)
        np.testing.assert_allclose(found.force_gain[k, :, 0], slope, atol=1e-5)
    np.testing.assert_allclose(found.output[3], np.eye(2), atol=1e-12)


def test_only_equations_with_parameters_are_disturbed() -> None:
    """Heading is the integral of yaw rate by definition; yaw acceleration may lack physics."""
    assert disturbed_equations(SHIP) == ("r",)


def test_sub_models_of_a_super_model_are_the_models_themselves() -> None:
    """With all candidates absent it runs as the base, and its sensitivities are differences."""
    data = dataset(1, N3, 1)
    joined = SuperModel.build(SHIP, CANDIDATES)
    assert not joined.skipped
    start = [np.zeros(2)]
    base = joined.run(data, start, {"K": 0.5, "T": 4.0}, ("K", "n3"))
    assert base is not None
    assert base[0].jacobian is not None
    for position, (name, value) in enumerate({"K": 0.5, "n3": 0.0}.items()):
        size = 1e-4
        moved = [
            joined.run(data, start, {"K": 0.5, "T": 4.0} | {name: value + sign * size})
            for sign in (1, -1)
        ]
        slope = (moved[0][0].outputs - moved[1][0].outputs) / (2 * size)
        scale = np.abs(slope).max()
        np.testing.assert_allclose(base[0].jacobian[:, :, 2 + position], slope, atol=1e-5 * scale)
    clean = dataset(1, 0.0, 1)
    alone = joined.run(clean, start, {"K": 0.5, "T": 4.0})
    assert alone is not None
    residual = (clean[0].outputs - alone[0].outputs) / NOISE
    np.testing.assert_allclose(np.mean(residual**2), 1.0, atol=0.2)


def test_a_candidate_that_does_not_fit_is_left_out() -> None:
    """A candidate on signals that the model lacks is skipped and named."""
    from oed_sysid.effects.sensors import sensor_bias

    joined = SuperModel.build(SHIP, (*CANDIDATES, sensor_bias("bias_depth", "z", "m", scale=0.1)))
    assert joined.skipped == ("bias_depth",)
    assert [effect.name for effect in joined.candidates] == [e.name for e in CANDIDATES]
    assert [two_sided(effect) for effect in joined.candidates] == [True, True, False, True]
