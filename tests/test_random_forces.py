"""Disturbance forces: whether they act, how strongly, and what they leave of the parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from turning_ship import GAIN, NOISE, SAMPLE, SHIP, TIME, dataset, record

from oed_sysid import Dataset, Fit, MultipleShooting, Parameter, Record, Sensor
from oed_sysid.likelihood.disturbances import chosen_places
from oed_sysid.likelihood.score_test import CLEAR, ScoreTest, Setting, score_test
from oed_sysid.physics.channels import Output, State
from oed_sysid.physics.model import Model

FORCE, FORCE_TIME = 0.02, 1.0
WHITE = MultipleShooting(disturbances="none", coloured="never")


def score_of(data: Dataset, model: Model = SHIP, *, colour: bool = True) -> ScoreTest:
    """Score test at the white fit."""
    fit = WHITE.fit(model, data)
    places = chosen_places(model, "all")
    declared = np.zeros(len(fit.sigma), dtype=bool)
    setting = Setting(data, places, fit.sigma, declared, colour=colour)
    return score_test(fit.model, data, setting, fit.initial_states, fit.local_values)


def test_white_records_rarely_ask_for_forces() -> None:
    """Over 40 seeds of white data the gain stays small: a median below 1, never far above 6."""
    gains = np.array([score_of(dataset(seed, n_records=1)).gain for seed in range(40)])
    assert np.all(gains > -1e-9)
    assert np.median(gains) < 1.0
    # The bound of a mixture of chi-squared variables, three times and three levels looked at.
    assert np.sum(gains > CLEAR) <= 2
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
    assert auto.noise is not None
    assert auto.noise.is_white
    assert auto.innovations is None
    assert auto.process_noise.statistic < CLEAR
    np.testing.assert_array_equal(auto.estimates, plain.estimates)


@pytest.fixture(scope="module")
def disturbed() -> Fit:
    """Two records of a ship under a random yaw acceleration."""
    return MultipleShooting().fit(SHIP, dataset(3, force=FORCE))


def test_disturbed_data_are_found_out(disturbed: Fit) -> None:
    """Level and time lie within three of their errors, and innovations are white."""
    assert disturbed.status.ok
    noise, errors = disturbed.noise, disturbed.noise_std
    assert noise is not None
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
    assert fit.noise is not None
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
    assert rudder.noise is not None
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
    assert warm.noise is not None
    assert warm.noise.is_white
    np.testing.assert_allclose(warm.estimates, cold.estimates, rtol=1e-4)


def test_a_disturbed_fit_survives_its_file(disturbed: Fit, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Saved and loaded, it has the same noise, likelihood and predictions."""
    path = tmp_path / "fit.json"
    disturbed.save(path)
    again = Fit.load(path)
    assert again.noise is not None
    assert disturbed.noise is not None
    assert again.noise.to_dict() == disturbed.noise.to_dict()
    assert again.log_likelihood == pytest.approx(disturbed.log_likelihood, rel=1e-9)
    other = dataset(9)
    assert again.predict(other).rms == pytest.approx(disturbed.predict(other).rms, rel=1e-9)


def test_an_unmeasured_velocity_is_started_anywhere() -> None:
    """Heading alone is measured: start rate, force and parameters are found from it."""
    model = replace(SHIP, outputs=SHIP.outputs[:1])
    data = Dataset(
        [replace(r, outputs=r.outputs[:, :1], channels=model.channels) for r in dataset(
            3, n_records=3, force=FORCE
        )]
    )  # fmt: skip
    fit = MultipleShooting(disturbances="all").fit(model, data)
    assert fit.status.ok
    for name, truth in (("K", GAIN), ("T", TIME)):
        assert abs(fit.values[name] - truth) < 4 * fit.std_errors[name]
    for own in fit.initial_states:
        assert abs(own[1]) < 0.05
    assert fit.noise is not None
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


UNSTABLE = Model(
    "unstable ship",
    states=SHIP.states,
    inputs=SHIP.inputs,
    outputs=SHIP.outputs,
    kinematics={"psi": "r", "r": "K*delta + a*r"},
    actuators={"delta": "rudder"},
    parameters=(Parameter("K", 0.1, "1/s^2"), Parameter("a", 0.2, "1/s")),
    step=SAMPLE,
)


def test_an_unstable_ship_in_closed_loop_is_identified() -> None:
    """Where the model on its own runs away, the filter follows: both parameters are covered."""
    rng = np.random.default_rng(8)
    data = Dataset([unstable_record(f"course_{i}", rng) for i in range(2)])
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
    bias = Sensor(
        "bias", {"r": "r + b_r"}, (Parameter("b_r", 0.0, "rad/s", per_record=True, scale=0.01),)
    )
    records = []
    for index, size in enumerate(biases):
        clean = record(f"zigzag_{index}", rng, force=FORCE)
        records.append(clean.with_outputs(clean.outputs + np.array([0.0, size])))
    fit = MultipleShooting(disturbances="all").fit(SHIP + bias, Dataset(records))
    assert "b_r" not in fit.names
    for found, truth in zip(fit.local_values, biases, strict=True):
        assert found["b_r"] == pytest.approx(truth, abs=0.002)
    assert fit.noise is not None
    assert FORCE / 2 < fit.noise.force[0] < 2 * FORCE


@pytest.mark.slow
def test_standard_errors_cover_under_random_forces() -> None:
    """Over 60 seeds estimates scatter as their errors say, and 95 % intervals cover in 95."""
    truth = {"K": GAIN, "T": TIME}
    scaled, levels, times = [], [], []
    for seed in range(60):
        fit = MultipleShooting(disturbances="all").fit(SHIP, dataset(100 + seed, force=FORCE))
        assert fit.noise is not None
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
@pytest.mark.parametrize("colour", [0.0, 0.85])
def test_levels_are_found_on_average(colour: float) -> None:
    """Undeclared white levels come out within a tenth; a coloured sensor is seen as such."""
    model = replace(
        SHIP,
        outputs=(Output("psi", "rad", "heading"), Output("r", "rad/s", "yaw rate")),
        states=(State("psi", "rad"), State("r", "rad/s", scale=0.1)),
    )
    sensors, force = [], []
    for seed in range(8):
        data = Dataset(
            [replace(r, channels=model.channels) for r in dataset(
                300 + seed, n_records=3, force=FORCE, colour=colour
            )]
        )  # fmt: skip
        fit = MultipleShooting(disturbances="all").fit(model, data)
        assert fit.noise is not None
        sensors.append(fit.noise.sensors)
        force.append(fit.noise.force[0])
    mean = np.sqrt(np.mean(np.square(sensors), axis=0))
    np.testing.assert_allclose(mean, NOISE, rtol=0.1 if colour == 0 else 0.25)
    assert np.sqrt(np.mean(np.square(force))) == pytest.approx(
        FORCE, rel=0.1 if colour == 0 else 0.3
    )
