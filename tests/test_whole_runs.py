"""Whole runs: starts fitted to them, disturbed ones, bands where first order misleads."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from golden_files import restored
from marks import slow
from motion import small
from scipy.optimize import least_squares

from benchmarks.random_forces.scenarios import SCENARIOS
from benchmarks.random_forces.simulator import believed
from benchmarks.random_forces.simulator import simulate as drawn_sets
from benchmarks.random_forces.trial import dataset, nominal_model
from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Fit, Model, MultipleShooting, NoiseModel, Record, Solver, replayed
from oed_sysid.design.knowledge import _information
from oed_sysid.export import export
from oed_sysid.likelihood.prediction import Spread, misleads, predict
from oed_sysid.likelihood.replay import _parts
from oed_sysid.likelihood.whole_runs import WholeRun
from oed_sysid.physics.parameters import Parameter

STEP = 0.5
TIMES = np.arange(0.0, 100.0, STEP)
SIGMA = np.array([0.002, 0.0005])
LEVEL, TIME = 4e-4, 4.0

SHIP = small(
    "ship with a helm zero",
    "psi [rad], r [rad/s] <- delta [rad]",
    {"psi": "r", "r": "(K*(delta - zero) - r)/T"},
    [
        Parameter("K", 0.1, "1/s"),
        Parameter("T", 10.0, "s", lower=1.0),
        Parameter("zero", 0.0, "rad", per_record=True, prior_mean=0.0, prior_std=0.05),
    ],
    dict(zip(("psi", "r"), SIGMA, strict=True)),
    scales={"r": 0.02},
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
    force = LEVEL * gauss_markov(rng.standard_normal(len(TIMES)), np.exp(-STEP / TIME))
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
    """The share of 95 % bands over twelve records under the stated process noise."""
    inside = []
    for seed in range(12):
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
    return Dataset(found)


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


@pytest.mark.parametrize("count", [2, *slow(10)])
def test_a_true_disturbance_is_none(count: int) -> None:
    """Of ten sets with a force that acts, at most one is taken for structure; of two, none."""
    found = [MultipleShooting().fit(NOMOTO, turning(s, 0.0, LEVEL)) for s in range(count)]
    assert all(fit.noise.has_forces for fit in found)
    assert sum(fit.whole_runs.took_the_work for fit in found) <= count // 10
    assert replayed(found[0]) is found[0]


@pytest.fixture(scope="module")
def runs(hidden: Fit) -> Fit:
    """Its values for runs."""
    return replayed(hidden)


def test_values_for_runs_replay_better(hidden: Fit, runs: Fit) -> None:
    """On other records within a tenth of the fit without process noise, and both uses warn."""
    assert runs.purpose == "replay"
    white = MultipleShooting(disturbances="none").fit(NOMOTO, hidden.dataset)
    other = turning(2, cubic=8e3, level=0.0)
    predictions = [fit.predict(other) for fit in (runs, white, hidden)]
    errors = [one.rms["psi"] for one in predictions]
    assert errors[0] < 1.1 * min(errors[1:])
    assert "lacks physics" in predictions[0].caveat
    assert "replayed(fit)" in predictions[2].caveat
    with pytest.warns(UserWarning, match="errors do not hold"):
        _information(runs)


def test_halves_of_a_single_record_are_left_out(hidden: Fit) -> None:
    """Every sample is in one of the two, and each begins where the model is then."""
    one = Dataset((hidden.dataset[0],))
    white = MultipleShooting(disturbances="none").fit(NOMOTO, one)
    parts, states = _parts(white)
    times = np.concatenate([part.times for part in parts])
    np.testing.assert_array_equal(times, one[0].times)
    assert len(parts) == len(states) == 2
    run = one[0].output("psi")[len(parts[0].times)]
    assert states[1][0] == pytest.approx(run, abs=0.2 * np.ptp(one[0].output("psi")))
    kept, _ = _parts(hidden)
    assert kept is hidden.dataset


def test_an_export_has_the_values_for_runs(hidden: Fit, tmp_path) -> None:
    """And says so."""
    with pytest.warns(UserWarning, match="those for runs"):
        (file,) = export(hidden, "latex", tmp_path / "ship.tex")
    assert file.exists()


def test_a_saved_fit_keeps_its_purpose(runs: Fit, tmp_path) -> None:
    """What a fit was made for, and the same answer of its whole runs."""
    assert restored(runs, tmp_path).purpose == "replay"


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


# What stands upright falls to one side or the other, and is caught at one.
FORCE, TIME_BANDS, STEP_BANDS = 0.05, 1.0, 0.1
TIMES_BANDS = np.arange(150) * STEP_BANDS


def falling(growth: float) -> Model:
    """A state that grows, or decays, until its cube stops it."""
    law, values = {"x": "a*x - x**3"}, {"a [1/s]": growth}
    return small("pitchfork", "x [rad]", law, values, 0.01, step=0.02)


def predicted(
    growth: float, start: float, spread: float = 0.0, *, force: float = FORCE, colour: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Prediction of the package and its standard deviation, without the sensor's."""
    model = falling(growth)
    noise = NoiseModel(
        np.array([0.01]), np.array([colour]), np.array([force]), TIME_BANDS, outputs=("x",),
        places=("force x",), force_time=np.array([TIME_BANDS]),
    )  # fmt: skip
    still = np.zeros((len(TIMES_BANDS), 1))
    record = Record("run", TIMES_BANDS, still[:, :0], still, model.channels)
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
    for k in range(len(TIMES_BANDS) * round(STEP_BANDS / fine)):
        if k % round(STEP_BANDS / fine) == 0:
            found.append(x)
        x = x + fine * (growth * x - x**3 + w)
        fresh = force * np.sqrt(2 * fine / TIME_BANDS) * rng.standard_normal(n_runs)
        w = w - fine * w / TIME_BANDS + fresh
    return np.array(found).T


@pytest.mark.parametrize(
    ("start", "spread", "force"),
    [(0.02, 0.02, FORCE), *slow((0.01, 0.0, FORCE), (0.01, 0.02, 0.0))],
)
def test_what_falls_to_either_side_has_a_band_of_both(
    start: float, spread: float, force: float
) -> None:
    """Mean squares about the prediction are those of the simulated runs; bands hold them.

    Without disturbance forces, and with known parameters, the start decides the side.
    """
    path, std = predicted(1.0, start, spread, force=force)
    runs = simulated(1.0, start, spread, force=force)
    expected = np.sqrt(np.mean((runs - path) ** 2, axis=0))
    np.testing.assert_allclose(std[20:], expected[20:], rtol=0.12)
    assert not force or np.mean(np.abs(runs - path) <= 1.96 * std) > 0.94
    # To first order, what has been caught is known to 0.03.
    assert std[-1] > (1.0 if force else 0.9)


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


@pytest.mark.slow
@pytest.mark.parametrize("number", [2, 0])
def test_strong_forces_that_are_true_are_not_taken_for_physics(number: int) -> None:
    """A fit without process noise ends far beyond first order there; its own runs decide."""
    scenario = SCENARIOS["medium_5s"]
    (drawn,) = drawn_sets(scenario, 8123, [number])
    model = nominal_model(scenario.vehicle).with_values(believed(scenario))
    fit = MultipleShooting().fit(model, dataset(scenario, model, drawn.runs))
    assert fit.whole_runs.process_noise
    assert not fit.whole_runs.objections
    assert np.max(np.abs(fit.whole_runs.each("z"))) < 4.0
