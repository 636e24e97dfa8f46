"""Forces measured at given motion, alone and beside free-running records."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import (
    Dataset,
    Experiment,
    Force,
    Input,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    State,
    ZigZag,
)
from oed_sysid.errors import DataError, ModelError
from oed_sysid.fitting.captive import CaptiveTests
from oed_sysid.simulation import simulate

TRUTH = {"Y_v": -40.0, "Y_r": 25.0, "N_v": -15.0, "N_r": -60.0, "Y_d": 12.0, "N_d": -30.0}
SPEED = 2.0


def ship() -> Model:
    """Sway and yaw of a ship at constant speed, with start values a third off."""
    parameters = tuple(Parameter(name, value / 1.5, "1") for name, value in TRUTH.items())
    return Model(
        "sway and yaw",
        states=(State("v", "m/s", scale=0.2), State("r", "rad/s", scale=0.1), State("psi", "rad")),
        inputs=(Input("delta", "rad"),),
        outputs=(
            Output("v", "m/s", noise_std=0.01),
            Output("r", "rad/s", noise_std=0.005),
            Output("psi", "rad", noise_std=0.01),
        ),
        axes={"Y": "v", "N": "r"},
        inertia={("Y", "v"): "150", ("N", "r"): "90"},
        kinematics={"psi": "r"},
        effects=(
            Force(
                "hull and rudder",
                {"Y": "Y_v*v + Y_r*r + Y_d*delta", "N": "N_v*v + N_r*r + N_d*delta"},
                parameters,
            ),
        ),
        step=0.2,
    )


def forces(v: np.ndarray, delta: np.ndarray) -> dict[str, np.ndarray]:
    """What a carriage would measure, by hand."""
    return {
        "Y": TRUTH["Y_v"] * v + TRUTH["Y_d"] * delta,
        "N": TRUTH["N_v"] * v + TRUTH["N_d"] * delta,
    }


def drift_tests(noise: float = 0.0) -> CaptiveTests:
    """Drift and rudder, without yaw."""
    v = np.array([-0.4, -0.2, 0.2, 0.4, 0.0, 0.0])
    delta = np.array([0.0, 0.0, 0.0, 0.0, 0.3, -0.3])
    rng = np.random.default_rng(3)
    measured = {
        axis: force + noise * rng.standard_normal(len(force))
        for axis, force in forces(v, delta).items()
    }
    return CaptiveTests("carriage", {"v": v}, {"delta": delta}, measured, {"Y": 0.1, "N": 0.1})


def zigzag() -> Dataset:
    """A weak zigzag, in which sway follows yaw."""
    order = ZigZag("delta", 0.2, 0.1, sign=-1)
    test = Experiment("zigzag", order, duration=60.0, sample_time=0.2)
    return Dataset((simulate(ship().with_values(TRUTH), test, rng=np.random.default_rng(1)),))


def test_forces_at_given_motion_are_the_models_own() -> None:
    """The towed model says the sum of forces by hand, whatever its free states do."""
    tests = drift_tests()
    found = tests.predict(ship().with_values(TRUTH))
    for axis, force in tests.forces.items():
        assert found[axis] == pytest.approx(force, abs=1e-9)
    assert max(tests.relative_errors(ship().with_values(TRUTH)).values()) < 1e-9
    assert tests.relative_errors(ship())["Y"] == pytest.approx(1 / 3, rel=1e-6)


def test_captive_tests_alone_determine_what_they_excite() -> None:
    """Without yaw in the tests its derivatives stay unknown and the others return."""
    fit = drift_tests().fit(MultipleShooting(disturbances="none"), ship())
    for name in ("Y_v", "N_v", "Y_d", "N_d"):
        assert fit.values[name] == pytest.approx(TRUTH[name], rel=1e-6)
    assert not np.isfinite(fit.std_errors["Y_r"]) or fit.std_errors["Y_r"] > 1e3


def test_captive_tests_and_a_zigzag_share_one_likelihood() -> None:
    """What the zigzag cannot separate comes from the carriage; intervals hold the truth."""
    data, tests = zigzag(), drift_tests(noise=0.1)
    estimator = MultipleShooting(disturbances="none", coloured="never")
    alone = estimator.fit(ship(), data)
    both = tests.fit(estimator, ship(), data)
    assert both.status.ok
    assert both.std_errors["Y_v"] < 0.2 * alone.std_errors["Y_v"]
    for name, true in TRUTH.items():
        assert abs(both.values[name] - true) < 4 * both.std_errors[name]
    assert both.model.state_names == ship().state_names
    assert both.dataset is data
    assert both.normalised_rms == pytest.approx(1.0, abs=0.1)
    assert both.predict(data).rms["r"] == pytest.approx(0.005, rel=0.2)
    assert set(both.extras["captive"]) == {"Y", "N"}


def test_one_bollard_pull_is_enough_for_a_record() -> None:
    """A single test is padded, not refused, and weighs as one."""
    tests = CaptiveTests("pull", {}, {"delta": [0.3]}, {"Y": [3.6]}, {"Y": 0.1})
    record = tests.record(ship())
    assert np.isfinite(record.outputs).sum() == 1
    assert tests.predict(ship().with_values(TRUTH))["Y"] == pytest.approx([3.6])


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"motions": {"w": [0.1]}}, ModelError, "no velocity of an axis"),
        ({"inputs": {}}, ModelError, "what the input 'delta' was"),
        ({"forces": {"K": [1.0]}}, ModelError, "no axis"),
        ({"inputs": {"delta": [0.1, 0.2]}}, DataError, "one value per test"),
        ({"motions": {"v": [np.nan]}}, DataError, "not finite"),
        ({"noise": {}}, DataError, "standard deviation"),
    ],
)
def test_what_does_not_fit_is_said(changes: dict, error: type, words: str) -> None:
    """Unknown states, inputs and axes, and columns of different lengths, are named."""
    given = {
        "motions": {"v": [0.1]},
        "inputs": {"delta": [0.0]},
        "forces": {"Y": [1.0]},
        "noise": {"Y": 0.1, "K": 0.1},
        **changes,
    }
    with pytest.raises(error, match=words):
        CaptiveTests("wrong", **given).record(ship())
