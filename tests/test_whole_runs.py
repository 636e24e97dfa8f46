"""Whole runs: starts fitted to them, and what an estimator makes of disturbed ones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares

from oed_sysid import (
    Dataset,
    Input,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    Record,
    Solver,
    State,
    replayed,
)
from oed_sysid.design.knowledge import _information
from oed_sysid.export import export
from oed_sysid.likelihood.fit import Fit
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


def turning(seed: int, cubic: float, level: float) -> Dataset:
    """Two zigzags with cubic yaw damping and a slow force, five minutes each."""
    rng = np.random.default_rng(seed)
    found = []
    times = np.arange(0.0, 300.0, STEP)
    for name, period in (("one", 20.0), ("two", 30.0)):
        rudder = 0.35 * np.sign(np.sin(2 * np.pi * times / period + 0.1))
        psi = r = force = 0.0
        phi = np.exp(-STEP / TIME)
        rows = []
        for k in range(len(times)):
            rows.append((psi, r))
            force = phi * force + np.sqrt(1 - phi**2) * level * rng.standard_normal()
            for _ in range(10):
                psi += STEP / 10 * r
                slow = r + cubic * r**3
                r += STEP / 10 * ((0.1 * rudder[k] - slow) / 10.0 + force)
        seen = np.array(rows) + SIGMA * rng.standard_normal((len(times), 2))
        found.append(Record(f"{name} {seed}", times, rudder[:, None], seen, SHIP.channels))
    return Dataset(tuple(found))


NOMOTO = SHIP.with_values({}).fix("zero")


@pytest.fixture(scope="module")
def hidden() -> Fit:
    """Nomoto's equation under process noise, fitted to runs with strong cubic damping."""
    return MultipleShooting().fit(NOMOTO, turning(1, cubic=8e3, level=0.0))


def test_process_noise_that_holds_physics_is_said_first(hidden: Fit) -> None:
    """Whole runs are as no force of that strength would leave them; the report begins with it."""
    assert hidden.noise.has_forces
    assert hidden.whole_runs.took_the_work
    assert "taken the work of physics" in hidden.document().warnings[-1]
    report = hidden.report()
    assert "one step" in report
    assert "whole runs" in report
    assert hidden.to_dict()["whole_runs"]["outputs"]["psi"]["share"] > 0.01


def test_a_true_disturbance_is_none() -> None:
    """Of ten sets with a force that acts, at most one is taken for structure."""
    found = [MultipleShooting().fit(NOMOTO, turning(s, 0.0, LEVEL)) for s in range(10)]
    assert all(fit.noise.has_forces for fit in found)
    assert sum(fit.whole_runs.took_the_work for fit in found) <= 1
    assert replayed(found[0]) is found[0]


def test_values_for_runs_replay_better(hidden: Fit) -> None:
    """On other records within a tenth of the fit without process noise, and both uses warn."""
    runs = replayed(hidden)
    assert runs.purpose == "replay"
    white = MultipleShooting(disturbances="none").fit(NOMOTO, hidden.dataset)
    other = turning(2, cubic=8e3, level=0.0)
    errors = [fit.predict(other).rms["psi"] for fit in (runs, white, hidden)]
    assert errors[0] < 1.1 * min(errors[1:])
    assert "lacks physics" in runs.predict(other).caveat
    assert "replayed(fit)" in hidden.predict(other).caveat
    with pytest.warns(UserWarning, match="errors do not hold"):
        _information(runs)


def test_an_export_has_the_values_for_runs(hidden: Fit, tmp_path) -> None:
    """And says so."""
    with pytest.warns(UserWarning, match="those for runs"):
        (file,) = export(hidden, "latex", tmp_path / "ship.tex")
    assert file.exists()


def test_a_saved_fit_keeps_its_purpose(hidden: Fit, tmp_path) -> None:
    """What a fit was made for, and the same answer of its whole runs."""
    runs = replayed(hidden)
    runs.save(tmp_path / "fit.json")
    again = Fit.load(tmp_path / "fit.json")
    assert again.purpose == "replay"
    np.testing.assert_allclose(again.whole_runs.error, runs.whole_runs.error, rtol=1e-6)


@pytest.mark.parametrize("way", ["bound", "constraint"])
def test_what_binds_is_named_with_its_distance(way: str) -> None:
    """Held a tenth too low, a time constant is as many errors off as the free fit says."""
    data = turning(3, 0.0, 0.0)
    free = MultipleShooting(disturbances="none").fit(NOMOTO, data)
    limit = 0.995 * free.values["T"]
    if way == "bound":
        bounded = dataclasses.replace(NOMOTO.parameter("T"), upper=limit, value=0.9 * limit)
        model, solver = NOMOTO.with_parameter(bounded), Solver()
    else:
        model = NOMOTO
        solver = Solver(method="ipopt", constraints=(f"T < {limit}",))
    fit = MultipleShooting(disturbances="none", solver=solver).fit(model, data)
    (one,) = fit.binding
    expected = (free.values["T"] - limit) / free.std_errors["T"]
    assert one.distance == pytest.approx(expected, rel=0.1)
    assert one.beyond == pytest.approx(free.values["T"] - limit, rel=0.1)
    assert [c.kind for c in fit.concerns].count("constraint") == 1
    assert not free.binding
