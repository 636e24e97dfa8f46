"""Disturbance forces, unknown inputs, noisier sensors, fits a short time ahead."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from altered import with_outputs
from marks import slow
from motion import small
from scipy.optimize import minimize
from turning_ship import CUBIC, GAIN, GYRO_BIAS, NOISE, SAMPLE, SHIP, TIME, dataset, record

from benchmarks.truth import gauss_markov, runge_kutta
from oed_sysid import Dataset, Fit, Parameter, Record, UnknownForce, UnknownInput, load_problem
from oed_sysid.errors import DataError, ModelError
from oed_sysid.evidence.study import Study
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.disturbances import chosen_places
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.gauss_newton import differentiated, restricted
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_levels import believed_levels
from oed_sysid.likelihood.noise_model import Levels, NoiseModel
from oed_sysid.likelihood.prediction import unknown_series
from oed_sysid.likelihood.score_test import ScoreTest, Setting, Start, score_test
from oed_sysid.likelihood.shooting import Point, Shooting
from oed_sysid.likelihood.windows import Windows
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import TOLD_APART

FORCE, FORCE_TIME = 0.02, 1.0
WHITE = MultipleShooting(disturbances="none", coloured="never")


def score_of(data: Dataset, model: Model = SHIP, *, colour: bool = True) -> ScoreTest:
    """Score test at the white fit."""
    fit = WHITE.fit(model, data)
    places = chosen_places(model, "all")
    declared = np.zeros(len(fit.sigma), dtype=bool)
    setting = Setting(fit.model, data, places, fit.sigma, declared, colour=colour)
    start = Start({}, fit.initial_states, fit.local_values)
    return score_test(setting, start)


@pytest.mark.parametrize("count", [10, *slow(40)])
def test_white_records_rarely_ask_for_forces(count: int) -> None:
    """Over seeds of white data the gain stays small: a median below 1, never far above 6."""
    gains = np.array([score_of(dataset(seed, n_records=1)).gain for seed in range(count)])
    assert np.all(gains > -1e-9)
    assert np.median(gains) < 1.0
    # The bound of a mixture of chi-squared variables, three times and three levels looked at.
    assert np.sum(gains > TOLD_APART) <= 2
    assert gains.max() < 12.0


def test_forces_show_in_the_score_test() -> None:
    """A random yaw acceleration gives a gain far above chance, its level among the reasons."""
    data = dataset(3, force=FORCE)
    assert score_of(data).gain > 50.0
    found = score_of(data, colour=False)
    assert found.gain > 50.0
    # One step from zero, where the likelihood is far from quadratic: an order at best.
    assert found.unit.force[0] < found.noise.force[0] < 3 * FORCE
    assert found.noise.places == ("force r",)


def test_white_data_stay_a_white_fit() -> None:
    """On its own the estimator lets nothing in, and the estimates are those without the test."""
    data = dataset(5)
    auto, plain = MultipleShooting().fit(SHIP, data), WHITE.fit(SHIP, data)
    assert auto.noise.is_white
    assert auto.innovations is None
    assert auto.process_noise.statistic < TOLD_APART
    np.testing.assert_array_equal(auto.estimates, plain.estimates)


@pytest.fixture(scope="module")
def disturbed() -> Fit:
    """Two records of a ship under a random yaw acceleration."""
    return MultipleShooting().fit(SHIP, dataset(3, force=FORCE))


def test_disturbed_data_are_found_out(disturbed: Fit) -> None:
    """Level and time lie within three of their errors, and innovations are white."""
    assert disturbed.status.ok
    noise, errors = disturbed.noise, disturbed.noise_std
    level, time = noise.level("force r")
    times = [value for name, value in errors.items() if name.endswith("time")]
    levels = [value for name, value in errors.items() if name == "force r level"]
    assert len(times) == len(levels) == 1
    assert abs(np.log(level / FORCE)) < 3 * levels[0] < 1.0
    assert abs(np.log(time / FORCE_TIME)) < 3 * times[0] < 2.0
    for part in disturbed.whitened:
        assert np.mean(part**2) == pytest.approx(1.0, abs=0.12)
        for column in part.T:
            assert abs(np.mean(column[1:] * column[:-1])) < 4.0 / np.sqrt(len(column))
    # The simulated sensors are white, as declared.
    np.testing.assert_array_equal(noise.white, NOISE)


def test_noise_declared_too_small_bends_nothing(disturbed: Fit) -> None:
    """A third of the noise declared: what the records show is estimated, and the fit is the same.

    Forces had grown to follow every wiggle, and a sea of 0.2 s was found. What is declared holds
    where it is insisted on.
    """
    small = SHIP.with_noise(NOISE / 3.0)
    data = dataset(3, force=FORCE)
    fit = MultipleShooting().fit(small, data)
    assert not fit.noise.seas
    assert fit.sigma_estimated.all()
    np.testing.assert_allclose(fit.noise.white, NOISE, rtol=0.1)
    errors = np.array(list(disturbed.std_errors.values()))
    np.testing.assert_allclose(fit.estimates, disturbed.estimates, atol=0.3 * errors.min())
    np.testing.assert_allclose(list(fit.std_errors.values()), errors, rtol=0.1)
    found = {c.signal: c.size for c in fit.concerns if c.kind == "noise_level"}
    assert found == {name: pytest.approx(3.0, rel=0.1) for name in SHIP.output_names}
    insisted = MultipleShooting(noise="given", disturbances="none").fit(small, data)
    np.testing.assert_array_equal(insisted.sigma, NOISE / 3.0)


def test_quick_motion_is_no_noise_of_a_sensor() -> None:
    """A declared level holds where forces explain better what shows from sample to sample."""
    data = dataset(3, force=15.0 * FORCE)
    assert np.isnan(believed_levels(SHIP.outputs, data)).any()
    fit = MultipleShooting().fit(SHIP, data)
    np.testing.assert_array_equal(fit.noise.white, NOISE)


def test_correlated_noise_of_the_sensors_is_no_force() -> None:
    """White and coloured noise of 0.9 s in equal parts: forces had grown to explain the colour."""
    rng = np.random.default_rng(7)

    def coloured(one: Record) -> np.ndarray:
        white = rng.standard_normal(one.outputs.shape)
        white[0] = rng.standard_normal(2)
        return one.outputs + NOISE * gauss_markov(white, 0.8)

    fit = MultipleShooting(disturbances="all").fit(SHIP, with_outputs(dataset(7), coloured))
    assert not fit.noise.has_forces
    assert fit.noise.colour == pytest.approx(NOISE, rel=0.3)
    assert fit.log_likelihood > 4110.0  # 4077 with a force in yaw


def test_forces_are_likelier_than_a_white_fit(disturbed: Fit) -> None:
    """The likelihood gains what the test promised, and errors of parameters grow."""
    plain = WHITE.fit(SHIP, disturbed.dataset)
    gain = 2.0 * (disturbed.log_likelihood - plain.log_likelihood)
    assert gain > 50.0
    for name, error in plain.std_errors.items():
        assert disturbed.std_errors[name] > error


def test_named_disturbances_are_let_in_whatever_the_test_says() -> None:
    """Asked for, the force is estimated on white data too, and its level comes out as nothing."""
    fit = MultipleShooting(disturbances=("r",)).fit(SHIP, dataset(6))
    plain = WHITE.fit(SHIP, fit.dataset)
    assert fit.noise.places == ("force r",)
    assert fit.noise.force[0] < 0.2 * FORCE
    assert 2 * (fit.log_likelihood - plain.log_likelihood) == pytest.approx(0.0, abs=6.0)
    for name, value in plain.values.items():
        assert fit.values[name] == pytest.approx(value, abs=plain.std_errors[name])


def test_noise_on_a_logged_input_is_another_place() -> None:
    """Noise of the rudder's log is white from sample to sample, less likely than a slow force."""
    data = dataset(3, force=FORCE)
    forces = MultipleShooting(disturbances=("r",)).fit(SHIP, data)
    rudder = MultipleShooting(disturbances=("actuator delta",)).fit(SHIP, data)
    level, time = rudder.noise.level("actuator delta")
    assert level > 0
    assert time == 0.0
    assert forces.log_likelihood > rudder.log_likelihood + 5.0


def test_an_earlier_fit_with_forces_is_where_the_next_begins(disturbed: Fit) -> None:
    """From its end, the likeliest point is found again; on other records, that of a cold start."""
    again = MultipleShooting().fit(SHIP, disturbed.dataset, warm=disturbed)
    assert again.iterations < disturbed.iterations
    assert again.log_likelihood == pytest.approx(disturbed.log_likelihood, abs=0.02)
    other = dataset(4, force=3 * FORCE)
    cold, warm = (MultipleShooting().fit(SHIP, other, warm=fit) for fit in (None, disturbed))
    assert warm.log_likelihood == pytest.approx(cold.log_likelihood, abs=0.02)
    for name, error in cold.std_errors.items():
        assert warm.values[name] == pytest.approx(cold.values[name], abs=0.05 * error)
        assert warm.std_errors[name] == pytest.approx(error, rel=0.05)


def test_forces_of_an_earlier_fit_are_not_taken_along_where_none_act(disturbed: Fit) -> None:
    """Calm water after a seaway: the fit is white again, and equal to that from a cold start."""
    calm = dataset(5)
    warm, cold = (MultipleShooting().fit(SHIP, calm, warm=fit) for fit in (disturbed, None))
    assert warm.noise.is_white
    np.testing.assert_allclose(warm.estimates, cold.estimates, rtol=1e-4)


def test_an_unmeasured_velocity_is_started_anywhere() -> None:
    """Heading alone is measured: start rate, force and parameters are found from it."""
    model = replace(SHIP, outputs=SHIP.outputs[:1])
    data = Dataset(
        replace(r, outputs=r.outputs[:, :1], channels=model.channels) for r in dataset(
            3, n_records=3, force=FORCE
        )
    )  # fmt: skip
    fit = MultipleShooting(disturbances="all").fit(model, data)
    assert fit.status.ok
    for name, truth in (("K", GAIN), ("T", TIME)):
        assert abs(fit.values[name] - truth) < 4 * fit.std_errors[name]
    for own in fit.initial_states:
        assert abs(own[1]) < 0.05
    assert FORCE / 2 < fit.noise.force[0] < 2 * FORCE


def unstable_record(name: str, rng: np.random.Generator) -> Record:
    """A directionally unstable ship on a steady course, held by its autopilot, in waves."""
    times = np.arange(0.0, 60.0, SAMPLE)
    state, force, outputs, inputs = np.zeros(2), 0.0, [], []
    target = 0.1 * np.sign(np.sin(2 * np.pi * times / 25.0))
    for k in range(len(times)):
        # The autopilot knows what is measured, noise included, and nothing else.
        seen = state + NOISE * rng.standard_normal(2)
        outputs.append(seen)
        rudder = np.clip(-1.5 * (seen[0] - target[k]) - 5.0 * seen[1], -0.6, 0.6)
        inputs.append([rudder])
        for _ in range(10):
            h = SAMPLE / 10
            first = np.array([state[1], (GAIN * rudder + state[1]) / TIME + force])
            middle = state + h / 2 * first
            state = state + h * np.array([middle[1], (GAIN * rudder + middle[1]) / TIME + force])
        force = (
            np.exp(-SAMPLE) * force
            + 0.02 * np.sqrt(1 - np.exp(-2 * SAMPLE)) * rng.standard_normal()
        )
    return Record(name, times, np.array(inputs), np.array(outputs), UNSTABLE.channels)


UNSTABLE = replace(
    SHIP,
    name="unstable ship",
    kinematics={"psi": "r", "r": "K*delta + a*r"},
    parameters=(Parameter("K", 0.1, "1/s^2"), Parameter("a", 0.2, "1/s")),
)


# An AUV under the surface, which draws it up and trims it: what its fins do, per second.
UNDER = dict(Zw=0.7, Zq=0.55, Zd=0.22, Z2=0.06, Mw=0.25, Mq=1.1, Mt=0.45, Md=0.55, M2=0.05)


def under_the_surface(values: Iterable[float]) -> Model:
    """The model of it; the velocity of heave is not measured."""
    law = {
        "w": "-Zw*w + Zq*q + Zd*fin - Z2*exp(-z/1.5)",
        "q": "Mw*w - Mq*q - Mt*sin(theta) - Md*fin + M2*exp(-z/1.5)",
        "theta": "q",
        "z": "w*cos(theta) - 1.8*sin(theta)",
    }
    units = ("1/s", "m/s", "m/s^2", "m/s^2", "1/(m s)", "1/s", "1/s^2", "1/s^2", "1/s^2")
    named = {f"{n} [{u}]": v for n, u, v in zip(UNDER, units, values, strict=True)}
    signals = "w [m/s], q [rad/s], theta [rad], z [m] <- fin [rad]"
    noise = dict.fromkeys(("q", "theta", "z"))
    scales = {"w": 0.1, "q": 0.1, "theta": 0.1}
    return small("under the surface", signals, law, named, noise, scales=scales, step=0.4)


def depth_held(name: str, rng: np.random.Generator, model: Model) -> Record:
    """A run in gusts at depths that an autopilot holds, which sees noise; plain arithmetic."""
    times = 0.4 * np.arange(240)
    more = np.repeat(rng.uniform(-0.1, 0.1, 20), 12)
    wanted = 3.0 + np.repeat(np.append(0.0, rng.uniform(-0.8, 0.8, 4)), 48)
    seen, drawn = 0.02 * rng.standard_normal(240), rng.standard_normal((240, 2))
    kept = np.exp(-0.4 / np.array([1.5, 0.8]))
    blown = [gauss_markov(*one) for one in zip(drawn.T, kept, strict=True)]
    gusts = np.column_stack(blown) * [0.003, 0.00855]

    def rate(x: np.ndarray, _: int, fin: float, gust: np.ndarray) -> np.ndarray:
        w, q, theta, z = x
        pull, p = np.exp(-z / 1.5), UNDER
        heave = -p["Zw"] * w + p["Zq"] * q + p["Zd"] * fin - p["Z2"] * pull
        pitch = p["Mw"] * w - p["Mq"] * q - p["Mt"] * np.sin(theta) - p["Md"] * fin
        rise = w * np.cos(theta) - 1.8 * np.sin(theta)
        return np.array([heave + gust[0], pitch + p["M2"] * pull + gust[1], q, rise])

    state, states, fins = np.array([0.0, 0.0, 0.0, 3.0]), [], []
    for k in range(240):
        trim = np.clip(-0.25 * (wanted[k] - state[3] - seen[k]), -0.3, 0.3)
        fins.append(np.clip(0.5 * (state[2] - trim), -0.25, 0.25) + more[k])
        states.append(state[1:])
        state = runge_kutta(rate, state, 0.4, fins[-1], gusts[k])
    outputs = states + np.array([0.004, 0.004, 0.02]) * rng.standard_normal((240, 3))
    outputs[1::2, 2] = np.nan
    return Record(name, times, np.array(fins)[:, None], outputs, model.channels)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [101, 104, 125])
def test_a_fit_without_process_noise_does_not_lead_astray(seed: int) -> None:
    """Bent by gusts that were taken for noise its values lie in another valley, 60 errors off."""
    rng = np.random.default_rng(seed)
    true = np.array([*UNDER.values()])
    model = under_the_surface(true * (1 + rng.choice([-1, 1], 9) * rng.uniform(0.1, 0.5, 9)))
    data = Dataset(depth_held(name, rng, model) for name in ("one", "other"))
    fit, best = (MultipleShooting().fit(m, data) for m in (model, under_the_surface(true)))
    assert fit.log_likelihood > best.log_likelihood - 1.0
    assert fit.status.ok
    off = [(fit.values[name] - value) / fit.std_errors[name] for name, value in UNDER.items()]
    assert np.sqrt(np.mean(np.square(off))) < 1.7


def test_an_unstable_ship_in_closed_loop_is_identified() -> None:
    """Where the model on its own runs away, the filter follows: both parameters are covered."""
    rng = np.random.default_rng(8)
    data = Dataset(unstable_record(f"course_{i}", rng) for i in range(2))
    assert max(np.abs(r.outputs[:, 0]).max() for r in data) < 0.5
    fit = MultipleShooting(disturbances="all").fit(UNSTABLE, data)
    assert fit.status.ok
    # The same optimum is reached from the truth.
    true = UNSTABLE.with_values({"K": GAIN / TIME, "a": 1.0 / TIME})
    near = MultipleShooting(disturbances="all").fit(true, data)
    assert fit.log_likelihood == pytest.approx(near.log_likelihood, abs=0.1)
    for name, truth in (("K", GAIN / TIME), ("a", 1.0 / TIME)):
        assert abs(fit.values[name] - truth) < 4 * fit.std_errors[name]
        assert fit.std_errors[name] < 0.5 * abs(truth)
    for part in fit.whitened:
        assert np.mean(part**2) == pytest.approx(1.0, abs=0.15)


def test_parameters_of_each_record_go_with_random_forces() -> None:
    """A gyro bias of its own for every record is found beside the force."""
    rng = np.random.default_rng(4)
    biases = (0.02, -0.01)
    records = []
    for index, size in enumerate(biases):
        clean = record(f"zigzag_{index}", rng, force=FORCE)
        records.append(clean.with_outputs(clean.outputs + np.array([0.0, size])))
    fit = MultipleShooting(disturbances="all").fit(SHIP + GYRO_BIAS, Dataset(records))
    assert "b_r" not in fit.names
    for found, truth in zip(fit.local_values, biases, strict=True):
        assert found["b_r"] == pytest.approx(truth, abs=0.002)
    assert FORCE / 2 < fit.noise.force[0] < 2 * FORCE


@pytest.mark.parametrize("force", [0.0, 2e-3])
def test_information_holds_whatever_the_length_of_differences(force: float) -> None:
    """What the gain adds is differenced alone: nothing without process noise, little beside it."""
    model, data = (SHIP + CUBIC).with_values({"K": 0.5, "T": 4.0}), dataset(3, 5.0, 2)
    noise = NoiseModel(NOISE, np.zeros(2), np.array([force]), 1.0, 2.0, ("psi", "r"), ("force r",))
    problem = Filtered(model, data, Levels.of(noise, noise).held())
    unknowns = problem.point([run.outputs[0] for run in data]).unknowns
    base = problem.passes(unknowns, rows=True, gains=True)
    frozen, _ = problem.gathered(unknowns, base)
    std = 1.0 / np.sqrt(np.maximum(np.diag(frozen), 1e-12))
    short, one, long = (problem.differentiated(unknowns, base, x * std)[0] for x in (0.01, 1, 30))
    scale = np.outer(std, std)
    np.testing.assert_allclose(one * scale, short * scale, atol=1e-6 if force == 0.0 else 0.02)
    if force == 0.0:
        np.testing.assert_allclose(long * scale, frozen * scale, atol=1e-6)
    else:
        assert np.max(np.abs(one - frozen) * scale) > 1e-3


@pytest.mark.slow
def test_standard_errors_cover_under_random_forces() -> None:
    """Over 60 seeds estimates scatter as their errors say, and 95 % intervals cover in 95."""
    truth = {"K": GAIN, "T": TIME}
    scaled, levels, times = [], [], []
    for seed in range(60):
        fit = MultipleShooting(disturbances="all").fit(SHIP, dataset(100 + seed, force=FORCE))
        scaled.append([(fit.values[n] - v) / fit.std_errors[n] for n, v in truth.items()])
        levels.append(fit.noise.force[0])
        times.append(fit.noise.force_time[0])
    found = np.array(scaled)
    # Of 60, a standard deviation is known within 9 %, a mean within 0.13, a coverage within 3 %.
    np.testing.assert_allclose(found.std(axis=0), 1.0, atol=0.3)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=0.45)
    assert np.mean(np.abs(found) < 1.96) > 0.88
    assert np.sqrt(np.mean(np.square(levels))) == pytest.approx(FORCE, rel=0.1)
    assert np.exp(np.mean(np.log(times))) == pytest.approx(FORCE_TIME, rel=0.2)


@pytest.mark.slow
def test_inputs_whose_log_shows_no_noise_leave_the_numbers_finite() -> None:
    """Exact commands have no level to begin at in the place of forces: they are not asked alone."""
    problem = load_problem("catamaran")
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        fit = MultipleShooting().fit(problem.model, problem.data())
    assert fit.status.ok
    assert fit.noise.has_forces
    assert np.isfinite(fit.noise.force).all()


TRUE = {"K": 0.3, "T": 4.0, "a": 1.5}
NOISE_INPUTS = np.array([0.002, 0.003])
BOAT = small(
    "boat",
    "r [rad/s], psi [rad] <- rudder [rad], trim [rad]",
    {"r": "(K*(rudder + trim) - r - a*r*abs(r))/T", "psi": "r"},
    [Parameter("K", 0.2, "1/s"), Parameter("T", 3.0, "s", lower=0.3), Parameter("a", 0.5, "s")],
    scales={"r": 0.1},
    step=0.1,
)
SERIES = {"duration": 80.0, "spacing": 8.0, "scale": 0.1}


def hidden(times: np.ndarray, phase: float) -> np.ndarray:
    """A trim that nobody logged, rad."""
    return 0.08 * np.sin(2 * np.pi * times / 50 + phase) + 0.05


@pytest.fixture(scope="module")
def data() -> Dataset:
    """Two records with different origins of time, the trim logged as zero."""
    rng = np.random.default_rng(0)
    records = []
    for phase, origin in ((0.0, 0.0), (1.0, 500.0)):
        times = origin + np.arange(0.0, 80.0, 0.2)
        rudder = np.repeat(rng.choice([-0.2, 0.0, 0.2], 40), 10)
        inputs = {"rudder": rudder, "trim": hidden(times - origin, phase)}
        run = simulate_inputs(BOAT.with_values(TRUE), times, inputs=inputs)
        measured = run.outputs + NOISE_INPUTS * rng.standard_normal(run.outputs.shape)
        logged = np.column_stack([rudder, np.zeros(times.size)])
        records.append(Record(f"run_{phase:.0f}", times, logged, measured, BOAT.channels))
    return Dataset(records)


def fitted(model: Model, data: Dataset) -> Fit:
    """A fit with known noise and no disturbance forces."""
    return MultipleShooting(noise=NOISE_INPUTS, disturbances="none").fit(model, data)


def test_series_of_as_many_nodes_as_an_expression_may_hold() -> None:
    """The longest series becomes a model; a longer one is refused with its number of nodes."""
    longest = UnknownInput("trim", "rad", duration=140.0, spacing=1.0, scale=1.0)
    assert len((BOAT + longest).effects[-1].parameters) == 141
    with pytest.raises(ModelError, match="142 nodes, more than 140"):
        UnknownInput("trim", "rad", duration=141.0, spacing=1.0, scale=1.0)


def test_series_and_parameters_are_recovered(data: Dataset) -> None:
    """The unlogged trim comes back within a tenth of its swing, and the parameters are right."""
    fit = fitted(BOAT + UnknownInput("trim", "rad", **SERIES), data)
    assert fit.status.ok
    for name, true in TRUE.items():
        assert abs(fit.values[name] - true) < 3.5 * fit.std_errors[name]
    assert fit.std_errors["K"] < 0.015
    series = unknown_series(fit, "unknown_input_trim")
    for run, phase, (times, values) in zip(data, (0.0, 1.0), series, strict=True):
        truth = hidden(run.times - run.times[0], phase)
        away = np.interp(run.times, times, values) - truth
        assert np.sqrt(np.mean(away**2)) < 0.1 * np.std(truth)


def test_without_the_series_the_parameters_are_wrong(data: Dataset) -> None:
    """The same fit without it misses by far more than it states, or does not end well."""
    fit = fitted(BOAT, data)
    misses = [abs(fit.values[n] - true) / fit.std_errors[n] for n, true in TRUE.items()]
    assert not fit.status.ok or max(misses) > 10


def test_force_and_input_say_the_same(data: Dataset) -> None:
    """A series in the equation of r is the series of the trim times K/T."""
    by_input = fitted(BOAT + UnknownInput("trim", "rad", **SERIES), data)
    series = SERIES | {"scale": 0.1 * 0.3 / 4.0}
    by_force = fitted(BOAT + UnknownForce("r", "rad/s^2", **series), data)
    assert by_force.values["K"] == pytest.approx(by_input.values["K"], rel=0.01)
    (_, one), _ = unknown_series(by_force, "unknown_force_r")
    (_, other), _ = unknown_series(by_input, "unknown_input_trim")
    gain = by_input.values["K"] / by_input.values["T"]
    np.testing.assert_allclose(one, gain * other, atol=0.05 * gain * 0.1)


def test_prior_holds_what_the_record_does_not_say(data: Dataset) -> None:
    """Nodes behind the end of a record stay where the last one was."""
    longer = SERIES | {"duration": 160.0}
    fit = fitted(BOAT + UnknownInput("trim", "rad", **longer), data)
    (_, values), _ = unknown_series(fit, "unknown_input_trim")
    np.testing.assert_allclose(values[12:], values[11], atol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [({"spacing": 0.0}, "spacing 0.0"), ({"scale": -1.0}, "scale"), ({"spacing": 0.1}, "nodes")],
)
def test_impossible_series_are_refused(change: dict, words: str) -> None:
    """Times and levels are positive, and nodes few."""
    with pytest.raises(ModelError, match=words):
        UnknownInput("trim", "rad", **(SERIES | change))


def test_unknown_names_are_refused(data: Dataset) -> None:
    """A fit without such an effect says which it has."""
    fit = fitted(BOAT + UnknownInput("trim", "rad", **SERIES), data)
    with pytest.raises(DataError, match="unknown_input_trim"):
        unknown_series(fit, "unknown_input_rudder")


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_noise_declared_three_times_too_small_is_found(seed: int) -> None:
    """No force that follows every wiggle, no parameter that follows the force."""
    outputs = tuple(replace(one, noise_std=one.noise_std / 3.0) for one in SHIP.outputs)
    model = replace(SHIP + CUBIC, outputs=outputs)
    runs = []
    for run in dataset(seed, -3.0, n_records=3):
        seen, sample = run.outputs.copy(), np.arange(run.n_samples)
        seen[sample % 5 > 0, 0] = np.nan
        seen[sample % 2 > 0, 1] = np.nan  # rates come half as often
        runs.append(run.with_outputs(seen))
    _, best = Study.begin(model, Dataset(runs), None, (), known_noise=False)
    for name, value in {"K": GAIN, "T": TIME, "n3": -3.0}.items():
        assert best.values[name] == pytest.approx(value, rel=0.25)
    np.testing.assert_allclose(best.noise.white, NOISE, rtol=0.1)


@pytest.fixture(scope="module")
def zigzags() -> Dataset:
    """Four records of a linear ship with declared noise."""
    rng = np.random.default_rng(4)
    return Dataset(record(f"run_{i}", rng) for i in range(4))


@pytest.mark.parametrize("horizon", [0.2, 1.0, 7.3, 20.0, 1e4])
def test_every_transition_is_counted_once(zigzags: Dataset, horizon: float) -> None:
    """Windows overlap by one sample, so that their steps add up to those of the records."""
    problem = Windows.overlapping(Shooting(SHIP, zigzags, np.array([0.01, 0.004])), horizon)
    seen = {index: np.zeros(run.n_samples - 1, dtype=int) for index, run in enumerate(zigzags)}
    for part in problem.windows:
        stops = [*part.starts[1:], zigzags[part.record].n_samples]
        for start, stop, counted in zip(part.starts, stops, part.counted, strict=True):
            if counted:
                seen[part.record][start : stop - 1] += 1
    for counts in seen.values():
        assert (counts == 1).all()


def test_the_longest_horizon_is_the_whole_record(zigzags: Dataset) -> None:
    """With one window a record, values are those of the estimator without a horizon."""
    whole = MultipleShooting(disturbances="none").fit(SHIP, zigzags)
    long = MultipleShooting(disturbances="none", horizon=1e4).fit(SHIP, zigzags)
    for name, value in whole.values.items():
        assert long.values[name] == pytest.approx(value, rel=1e-5)
    assert (long.horizon, long.n_windows) == (1e4, 4)
    assert long.normalised_rms == pytest.approx(whole.normalised_rms, rel=1e-4)


def test_intervals_hold_at_ten_seconds() -> None:
    """White noise: values of fifteen data sets stay within what their errors say."""
    z = []
    for seed in range(15):
        rng = np.random.default_rng([7, seed])
        data = Dataset(record(f"run_{i}", rng) for i in range(3))
        fit = MultipleShooting(disturbances="none", horizon=10.0).fit(SHIP, data)
        assert fit.status.ok
        z += [(fit.values[n] - t) / fit.std_errors[n] for n, t in (("K", GAIN), ("T", TIME))]
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.6


def test_a_short_horizon_costs_precision_where_the_structure_is_right(zigzags: Dataset) -> None:
    """Noise in the states is all that a one-step fit sees."""
    errors = [
        MultipleShooting(disturbances="none", horizon=h).fit(SHIP, zigzags).std_errors["T"]
        for h in (0.2, 5.0, 60.0)
    ]
    assert errors[0] > 2 * errors[1] > 2 * errors[2]


def test_missing_structure_shows_at_long_horizons() -> None:
    """Without the cubic damping of the data the misfit grows with the horizon, with it it stays."""
    rng = np.random.default_rng(2)
    data = Dataset(record(f"run_{i}", rng, cubic=-3.0) for i in range(4))
    for model, low, high in ((SHIP, 1.1, 30.0), (SHIP + CUBIC, 0.95, 1.05)):
        short, long = (
            MultipleShooting(disturbances="none", noise="given", horizon=h).fit(model, data)
            for h in (2.0, 60.0)
        )
        growth = long.normalised_rms / short.normalised_rms
        assert low < growth < high


def test_parameters_of_each_record_are_found() -> None:
    """A rudder zero per record is one number for all windows of that record."""
    rng = np.random.default_rng(3)
    runs = []
    for i, zero in enumerate((-0.05, 0.0, 0.05)):
        run = record(f"run_{i}", rng)
        runs.append(replace(run, inputs=run.inputs - zero))
    zero = Parameter("E_zero", 0.0, "rad", prior_mean=0.0, prior_std=0.1, per_record=True)
    model = replace(
        SHIP,
        kinematics={"psi": "r", "r": "(K*(delta + E_zero) - r)/T"},
        parameters=(*SHIP.parameters, zero),
    )
    fit = MultipleShooting(disturbances="none", horizon=10.0).fit(model, Dataset(runs))
    found = [local["E_zero"] for local in fit.local_values]
    assert found == pytest.approx([-0.05, 0.0, 0.05], abs=0.01)
    assert fit.values["K"] == pytest.approx(GAIN, rel=0.03)


def test_noise_levels_are_estimated_where_asked(zigzags: Dataset) -> None:
    """Levels from the windows' residuals, start states counted."""
    fit = MultipleShooting(disturbances="none", noise="estimate", horizon=10.0).fit(SHIP, zigzags)
    assert fit.sigma == pytest.approx([0.01, 0.004], rel=0.1)


def test_settings_that_have_no_place_are_refused(zigzags: Dataset) -> None:
    """Disturbance forces, robust losses, known starts and too short horizons are named."""
    with pytest.raises(ModelError, match="whole records"):
        MultipleShooting(horizon=10.0, disturbances="all")
    with pytest.raises(ModelError, match="intervals"):
        MultipleShooting(horizon=10.0, loss="huber")
    with pytest.raises(ModelError, match="above zero"):
        MultipleShooting(horizon=0.0)
    with pytest.raises(DataError, match="a step of the records"):
        MultipleShooting(horizon=0.05).fit(SHIP, zigzags)
    with pytest.raises(ModelError, match="start_states"):
        MultipleShooting(horizon=5.0).fit(SHIP, zigzags, start_states={"r": 0.0})


def test_a_fit_ahead_is_judged_by_its_windows(zigzags: Dataset) -> None:
    """Its trajectories do not depend on the step, though whole runs of a wrong model drift away."""
    wrong = SHIP.with_values({"K": 0.9 * GAIN}).fix("K")
    fit = MultipleShooting(disturbances="none", horizon=1.0).fit(wrong, zigzags)
    assert fit.status.ok
    assert "integration" not in {concern.kind for concern in fit.concerns}
    assert fit.nominal == {"T": wrong.values["T"]}
    errors = [
        run.outputs - simulate_inputs(fit.model, run.times, inputs=run.inputs, initial=own).outputs
        for run, own in zip(zigzags, fit.initial_states, strict=True)
    ]
    assert np.sqrt(np.mean((np.vstack(errors) / fit.sigma) ** 2)) > 3 * fit.normalised_rms


# -- restricted likelihood -----------------------------------------------------------

N_PUSHES, PUSH_STEP, SENSOR, N_PUSHED = 6, 0.5, 0.05, 60


def pushed(rng: np.random.Generator) -> tuple[Model, Dataset]:
    """A body that is pushed by six known waves of unknown effect, and by a random force."""
    effects = [f"b{i}" for i in range(N_PUSHES)]
    model = small(
        "pushed body",
        "v [m/s] <- " + ", ".join(f"s{i} [1]" for i in range(N_PUSHES)),
        {"v": "-c*v + " + " + ".join(f"b{i}*s{i}" for i in range(N_PUSHES))},
        {"c [1/s]": 1.0} | {f"{name} [m/s^2]": 1.0 for name in effects},
        SENSOR,
        step=PUSH_STEP,
    ).fix("c")
    times = PUSH_STEP * np.arange(N_PUSHED)
    waves = np.stack([np.sin(0.15 * (i + 1) * times + i) for i in range(N_PUSHES)], axis=1)
    kept, last = np.exp(-PUSH_STEP / 3.0), np.exp(-PUSH_STEP)
    force, speed, speeds = 0.5 * rng.standard_normal(), 0.0, np.empty(N_PUSHED)
    for k, own in enumerate(waves):
        speeds[k] = speed + SENSOR * rng.standard_normal()
        speed = last * speed + (1.0 - last) * (own.sum() + force)
        force = kept * force + np.sqrt(1.0 - kept**2) * 0.5 * rng.standard_normal()
    return model, Dataset((Record("run", times, waves, speeds[:, None], model.channels),))


def pushed_cost(data: Dataset, level: float, time: float, *, restricted: bool) -> float:
    """Half of minus twice the (restricted) log-likelihood of a force, from dense covariances."""
    last, after = np.exp(-PUSH_STEP), np.subtract.outer(np.arange(N_PUSHED), np.arange(N_PUSHED))
    answer = np.tril(last ** np.maximum(after - 1, 0), -1) * (1.0 - last)
    own = level**2 * np.exp(-PUSH_STEP * np.abs(after) / time)
    covariance = SENSOR**2 * np.eye(N_PUSHED) + answer @ own @ answer.T
    known = np.column_stack([last ** np.arange(N_PUSHED), answer @ data[0].inputs])
    inverse, speeds = np.linalg.inv(covariance), data[0].outputs[:, 0]
    told = known.T @ inverse @ known
    left = speeds - known @ np.linalg.solve(told, known.T @ inverse @ speeds)
    lost = np.linalg.slogdet(told)[1] if restricted else 0.0
    return 0.5 * float(np.linalg.slogdet(covariance)[1] + left @ inverse @ left + lost)


def test_noise_is_estimated_by_the_restricted_likelihood() -> None:
    """On a linear model the fit ends near its optimum, which the maximum of the likelihood misses.

    A wide prior of the force's time and the end of the iterations leave a tenth of a nat or two.
    """
    missed, of_the_likelihood = [], []
    for seed in range(4):
        model, data = pushed(np.random.default_rng(seed))

        def least(restricted: bool, data: Dataset = data) -> tuple[float, np.ndarray]:
            found = minimize(
                lambda x: pushed_cost(data, *np.exp(x), restricted=restricted),
                [-0.7, 1.0], method="Nelder-Mead",
            )  # fmt: skip
            return float(found.fun), np.exp(found.x)

        noise = MultipleShooting(disturbances=("v",)).fit(model, data).noise
        optimum = least(restricted=True)[0]
        at = float(noise.force[0]), float(noise.force_time[0])
        missed.append(pushed_cost(data, *at, restricted=True) - optimum)
        likeliest = least(restricted=False)[1]
        of_the_likelihood.append(pushed_cost(data, *likeliest, restricted=True) - optimum)
    assert max(missed) < 0.3
    assert sum(of_the_likelihood) > 4.0 * sum(missed)


@pytest.mark.parametrize("unit", [1e-3, 1e-12])
def test_the_slope_at_a_variance_of_zero_is_that_of_any_unit(unit: float) -> None:
    """What the restricted likelihood adds, of a force that does not act, in SI units.

    In units of its size and of a billionth of it: where records begin to tell of a variance far
    above its unit, a difference of one unit is rounding.
    """
    model, data = pushed(np.random.default_rng(0))
    noise = NoiseModel.white_only(np.array([SENSOR]), ("v",)).with_places(["force v"], 3.0)
    levels = Levels.of(noise, replace(noise, force=np.array([unit])), force=True)
    problem = Filtered(model, data, levels.only(levels.are_variances))
    at = problem.point([np.zeros(1)])
    (level,) = range(*problem.layout.levels.indices(problem.layout.n_unknowns))
    far = at.unknowns.copy()
    far[level] = (1e-3 / unit) ** 2
    slopes = [kind(problem, at).equations.right[level] for kind in (differentiated, restricted)]
    added = [
        restricted(problem, one).cost - differentiated(problem, one).cost
        for one in (at, Point(far, ()))
    ]
    assert (slopes[0] - slopes[1]) / unit**2 == pytest.approx((added[1] - added[0]) / 1e-6, rel=0.1)
