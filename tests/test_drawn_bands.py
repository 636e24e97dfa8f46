"""Bands of predictions where first order misleads, against simulations of another kind."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Model, Output, Parameter, Record, State
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.prediction import Spread, misleads, predict

# What stands upright falls to one side or the other, and is caught at one.
FORCE, TIME, STEP = 0.05, 1.0, 0.1
TIMES = np.arange(150) * STEP


def falling(growth: float) -> Model:
    """A state that grows, or decays, until its cube stops it."""
    return Model(
        name="pitchfork",
        states=(State("x", "rad"),),
        inputs=(),
        outputs=(Output("x", "rad", noise_std=0.01),),
        kinematics={"x": "a*x - x**3"},
        parameters=(Parameter("a", growth, "1/s"),),
        step=0.02,
    )


def predicted(
    growth: float, start: float, spread: float = 0.0, *, force: float = FORCE, colour: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Prediction of the package and its standard deviation, without the sensor's."""
    model = falling(growth)
    noise = NoiseModel(
        np.array([0.01]), np.array([colour]), np.array([force]), TIME, outputs=("x",),
        places=("force x",), force_time=np.array([TIME]),
    )  # fmt: skip
    record = Record("run", TIMES, np.zeros((len(TIMES), 0)), np.zeros((len(TIMES), 1)),
                    model.channels)  # fmt: skip
    initial = {"x": (start, spread)} if spread else {"x": start}
    found = predict(model, Dataset((record,)), np.zeros((1, 1)), noise, initial=initial)
    return found.outputs[0][:, 0], found.model_std[0][:, 0]


def simulated(
    growth: float, start: float, spread: float = 0.0, *, force: float = FORCE
) -> np.ndarray:
    """Many runs by Euler and Maruyama with a fine step, ``(n_runs, n_times)``."""
    rng, fine, n_runs = np.random.default_rng(5), 0.005, 4000
    x = start + spread * rng.standard_normal(n_runs)
    w = force * rng.standard_normal(n_runs)
    found = []
    for k in range(len(TIMES) * round(STEP / fine)):
        if k % round(STEP / fine) == 0:
            found.append(x)
        x = x + fine * (growth * x - x**3 + w)
        fresh = force * np.sqrt(2 * fine / TIME) * rng.standard_normal(n_runs)
        w = w - fine * w / TIME + fresh
    return np.array(found).T


@pytest.mark.parametrize(("start", "spread"), [(0.01, 0.0), (0.02, 0.02)])
def test_what_falls_to_either_side_has_a_band_of_both(start: float, spread: float) -> None:
    """Mean squares about the prediction are those of the simulated runs; bands hold them."""
    path, std = predicted(1.0, start, spread)
    runs = simulated(1.0, start, spread)
    expected = np.sqrt(np.mean((runs - path) ** 2, axis=0))
    np.testing.assert_allclose(std[20:], expected[20:], rtol=0.12)
    assert np.mean(np.abs(runs - path) <= 1.96 * std) > 0.94
    assert std[-1] > 1.0  # to first order, what has been caught is known to 0.03


def test_an_unknown_start_alone_has_a_band_of_both_sides() -> None:
    """Without disturbance forces, and with known parameters, the start decides the side."""
    path, std = predicted(1.0, 0.01, 0.02, force=0.0)
    runs = simulated(1.0, 0.01, 0.02, force=0.0)
    expected = np.sqrt(np.mean((runs - path) ** 2, axis=0))
    np.testing.assert_allclose(std[20:], expected[20:], rtol=0.12)
    assert std[-1] > 0.9


def test_what_is_damped_has_the_band_of_the_closed_form() -> None:
    """Two hundred draws tell a standard deviation to five per cent."""
    path, std = predicted(-1.0, 0.1)
    expected = np.sqrt(np.mean((simulated(-1.0, 0.1) - path) ** 2, axis=0))
    np.testing.assert_allclose(std[5:], expected[5:], rtol=0.12)
    # dx/dt = -x + w with w of time one: the variance tends to FORCE^2/2, nearly.
    assert std[-1] == pytest.approx(FORCE / np.sqrt(2.0), rel=0.1)


@pytest.mark.parametrize("force", [0.0, FORCE])
def test_the_colour_of_a_sensor_is_part_of_the_band(force: float) -> None:
    """With or without disturbance forces: its variance is added to that of the runs."""
    growth, start, level = 1.0, 0.01, 0.2
    quiet = predicted(growth, start, force=force)[1]
    coloured = predicted(growth, start, force=force, colour=level)[1]
    np.testing.assert_allclose(coloured[1:], np.hypot(quiet, level)[1:], rtol=1e-3, atol=1e-4)


def test_draws_have_the_covariance_that_is_stated() -> None:
    """Start states follow the parameters; what nothing is known of stays; bounds are kept."""
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, np.inf]])
    gain = np.array([[0.5, -1.0, 0.0]])
    spread = Spread(
        np.arange(4.0), np.arange(3), np.array([3]), gain, covariance, np.array([[0.25]]),
        (np.full(4, -np.inf), np.array([np.inf, np.inf, np.inf, np.inf])),
    )  # fmt: skip
    drawn = spread.draw(40000, np.random.default_rng(0))
    assert np.all(drawn[:, 2] == 2.0)
    expected = np.zeros((4, 4))
    expected[:2, :2] = covariance[:2, :2]
    expected[3, :2] = expected[:2, 3] = -gain[0, :2] @ covariance[:2, :2]
    expected[3, 3] = gain[0, :2] @ covariance[:2, :2] @ gain[0, :2] + 0.25
    np.testing.assert_allclose(np.cov(drawn.T), expected, atol=0.12)


def test_what_misleads_is_a_clear_difference() -> None:
    """First-order variances within a fifth of those of the same draws stand."""
    variance = np.full((50, 2), 0.3)
    assert not misleads(variance, 1.1 * variance)
    assert misleads(variance, 4.0 * variance)
    assert misleads(variance, 0.1 * variance)
