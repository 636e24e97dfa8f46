"""Whole runs: starts fitted to them, and what an estimator makes of disturbed ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from oed_sysid import Dataset, Input, Model, Output, Parameter, Record, State
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.prediction import predict
from oed_sysid.likelihood.whole_runs import WholeRun

STEP = 0.5
TIMES = np.arange(0.0, 100.0, STEP)
SIGMA = np.array([0.002, 0.0005])
LEVEL, TIME = 4e-4, 4.0

SHIP = Model(
    "ship with a helm zero",
    (State("psi", "rad"), State("r", "rad/s", scale=0.02)),
    (Input("delta", "rad"),),
    (Output("psi", "rad", noise_std=SIGMA[0]), Output("r", "rad/s", noise_std=SIGMA[1])),
    {"psi": "r", "r": "(K*(delta - zero) - r)/T"},
    parameters=(
        Parameter("K", 0.1, "1/s"),
        Parameter("T", 10.0, "s", lower=1.0),
        Parameter("zero", 0.0, "rad", per_record=True, prior_mean=0.0, prior_std=0.05),
    ),
    step=STEP,
)
RUDDER = 0.2 * np.sign(np.sin(TIMES / 8.0))


def run(start: np.ndarray, zero: float, force: np.ndarray | None = None) -> np.ndarray:
    """Heading and rate of the ship by fine Euler steps, ``(n_times, 2)``."""
    psi, r = start
    fine, found = 50, []
    for k in range(len(TIMES)):
        found.append((psi, r))
        push = 0.0 if force is None else force[k]
        for _ in range(fine):
            psi += STEP / fine * r
            r += STEP / fine * ((0.1 * (RUDDER[k] - zero) - r) / 10.0 + push)
    return np.array(found)


def disturbed(seed: int) -> Record:
    """A run under a slow force, its helm half a degree off."""
    rng = np.random.default_rng(seed)
    phi, force = np.exp(-STEP / TIME), np.zeros(len(TIMES))
    for k in range(1, len(TIMES)):
        force[k] = phi * force[k - 1] + np.sqrt(1 - phi**2) * LEVEL * rng.standard_normal()
    seen = run(np.array([0.05, 0.004]), 0.01, force) + SIGMA * rng.standard_normal((len(TIMES), 2))
    return Record("sea", TIMES, RUDDER[:, None], seen, SHIP.channels)


NOISE = NoiseModel(
    SIGMA, np.zeros(2), np.array([LEVEL]), force_time=np.array([TIME]),
    outputs=SHIP.output_names, places=("force r",),
)  # fmt: skip


def test_starts_under_process_noise_are_fitted_to_the_whole_run() -> None:
    """Start states and helm zero are those of SciPy's least squares on the run without forces."""
    record = disturbed(1)

    def left(unknowns: np.ndarray) -> np.ndarray:
        model = run(unknowns[:2], unknowns[2])
        return np.append(((record.outputs - model) / SIGMA).ravel(), unknowns[2] / 0.05)

    found = least_squares(left, np.zeros(3), x_scale=[0.1, 0.01, 0.01])
    prediction = predict(SHIP, Dataset((record,)), np.zeros((2, 2)), NOISE)
    (own,), (local,) = prediction.initial_states, prediction.local_values
    assert own["psi"] == pytest.approx(found.x[0], abs=2e-4)
    assert own["r"] == pytest.approx(found.x[1], abs=2e-5)
    assert local["zero"] == pytest.approx(found.x[2], abs=1e-4)


def test_the_linear_answer_is_that_of_a_refit() -> None:
    """What a departure does to the estimated start, to first order and by another fit."""
    record = disturbed(2)
    here = WholeRun.fitted(SHIP, record, SIGMA)
    moved = record.with_outputs(record.outputs + run(np.array([0.02, 0.001]), -0.004))
    there = WholeRun.fitted(SHIP, moved, SIGMA)
    whitened = ((moved.outputs - record.outputs) * here.weights()).ravel()
    change = here.answer()[0] @ whitened
    np.testing.assert_allclose(there.unknowns[here.others] - here.unknowns[here.others], change,
                               rtol=1e-3)  # fmt: skip


def test_bands_of_a_fitted_start_hold_disturbed_runs() -> None:
    """The share of 95 % bands over twenty records under the stated process noise."""
    inside = []
    for seed in range(20):
        found = predict(SHIP, Dataset((disturbed(seed),)), np.zeros((2, 2)), NOISE)
        inside.append(list(found.coverage().values()))
    assert np.mean(inside, axis=0) == pytest.approx([0.95, 0.95], abs=0.04)


def test_noise_of_sensors_has_its_level_and_memory() -> None:
    """White and autocorrelated parts of the drawn noise have the variance of their sum."""
    here = WholeRun.fitted(SHIP, disturbed(3), SIGMA)
    noise = NoiseModel(SIGMA, 2.0 * SIGMA, np.zeros(0), 3.0, outputs=SHIP.output_names)
    rng = np.random.default_rng(0)
    drawn = here.sensors(noise, 300, rng) / SIGMA
    assert np.var(drawn, axis=(0, 1)) == pytest.approx([5.0, 5.0], rel=0.1)
    lagged = np.mean(drawn[:, 6:] * drawn[:, :-6], axis=(0, 1))  # 3 s later
    assert lagged == pytest.approx([4.0 / np.e] * 2, rel=0.15)
    assert np.var(here.sensors(noise, 300, rng, white=False) / SIGMA) == pytest.approx(4.0, rel=0.1)
