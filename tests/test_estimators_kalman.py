"""Joint Kalman filters against least squares, against each other, and on real nonlinearity."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Model, Output, Parameter, State, load_problem
from oed_sysid.baselines import JointKalmanFilter, OutputError
from oed_sysid.baselines.benchmark import load_scenario
from oed_sysid.data.record import Record
from oed_sysid.errors import ModelError
from oed_sysid.experiments.simulation import simulate

# A ramp of unknown slope: linear in states and parameter together.
RAMP = Model(
    "ramp",
    (State("x", "m"),),
    (),
    (Output("x", "m", noise_std=0.3),),
    {"x": "slope"},
    parameters=(Parameter("slope", 0.0, "m/s", scale=1.0),),
)


def ramp_data(n: int = 60) -> Dataset:
    """Noisy samples of a ramp of slope 2."""
    t = 0.1 * np.arange(n)
    x = 2.0 * t + 0.3 * np.random.default_rng(0).standard_normal(n)
    return Dataset((Record("ramp", t, np.empty((n, 0)), x, RAMP.channels),))


@pytest.mark.parametrize("kind", ["extended", "unscented"])
def test_linear_model_gives_regularised_least_squares(kind: str) -> None:
    """For a linear model either filter equals least squares with the same priors."""
    data = ramp_data()
    record = data[0]
    fit = JointKalmanFilter(kind=kind, parameter_std={"slope": 5.0}).fit(RAMP, data)
    from oed_sysid.likelihood.start_guess import measured_states

    start = measured_states(RAMP, record)[0][0]
    design = np.column_stack([np.ones(60), record.times]) / 0.3
    rows = np.vstack([design, [[1 / 3.0, 0.0], [0.0, 1 / 5.0]]])
    right = np.concatenate([record.output("x") / 0.3, [start / 3.0, 0.0]])
    solution = np.linalg.lstsq(rows, right, rcond=None)[0]
    spread = np.linalg.inv(rows.T @ rows)
    assert fit.values["slope"] == pytest.approx(solution[1], rel=1e-8)
    assert fit.std_errors["slope"] == pytest.approx(np.sqrt(spread[1, 1]), rel=1e-8)


def test_filters_find_the_parameters_of_an_auv() -> None:
    """From values 20 per cent off, surge drag returns within its errors, near output error."""
    problem = load_problem("remus_diving_plane")
    model = problem.model.fix(*problem.model.free_names).free("X_uu", "Z_uuds", "M_uuds")
    rng = np.random.default_rng(3)
    data = Dataset((simulate(model, problem.experiment("zigzag_10_10"), rng=rng),))
    start = model.with_values({name: 0.8 * model.values[name] for name in model.free_names})
    reference = OutputError().fit(start, data)
    for kind in ("extended", "unscented"):
        fit = JointKalmanFilter(kind=kind).fit(start, data)
        assert 0.9 < fit.extras["innovation"] < 1.1
        for name in model.free_names:
            assert fit.values[name] == pytest.approx(model.values[name], rel=0.03)
            gap = abs(fit.values[name] - reference.values[name])
            assert gap < 4 * reference.std_errors[name]
        track = fit.extras["history"]["X_uu"]
        assert len(track) == data.n_samples
        spread = fit.extras["history_std"]["X_uu"]
        assert spread[-1] < 0.1 * spread[0]


def test_drift_is_followed() -> None:
    """With drift allowed the filter follows a slope that changes; without it, it averages."""
    t = 0.1 * np.arange(400)
    x = np.where(t < 20, t, 20 + 3 * (t - 20))
    x = x + 0.05 * np.random.default_rng(1).standard_normal(400)
    data = Dataset((Record("bend", t, np.empty((400, 0)), x, RAMP.channels),))
    follows = JointKalmanFilter(drift_std={"slope": 0.5}, process_std={"x": 0.1}).fit(RAMP, data)
    rigid = JointKalmanFilter().fit(RAMP, data)
    assert follows.values["slope"] == pytest.approx(3.0, abs=0.2)
    assert follows.extras["history"]["slope"][150] == pytest.approx(1.0, abs=0.3)
    assert abs(rigid.values["slope"] - 3.0) > 0.5


def test_missing_samples_widen_the_errors() -> None:
    """Samples that are missing are passed over, and the errors grow."""
    data = ramp_data()
    outputs = data[0].outputs.copy()
    outputs[1::2] = np.nan
    full = JointKalmanFilter().fit(RAMP, data)
    half = JointKalmanFilter().fit(RAMP, Dataset((data[0].with_outputs(outputs),)))
    assert half.std_errors["slope"] == pytest.approx(np.sqrt(2) * full.std_errors["slope"], rel=0.1)


def test_unknown_names_are_refused() -> None:
    """Settings that name a state or parameter that does not exist are errors."""
    with pytest.raises(ModelError, match="process_std names 'y'"):
        JointKalmanFilter(process_std={"y": 1.0}).fit(RAMP, ramp_data())
    with pytest.raises(ModelError, match="kind is"):
        JointKalmanFilter(kind="particle")


@pytest.mark.slow
def test_points_far_out_make_the_unscented_filter_too_sure() -> None:
    """On the torpedo 95 % intervals hold the truth nine times of ten, but not from far points."""
    scenario = load_scenario("torpedo")
    model = scenario.with_noise(scenario.noise(1.0))
    held: dict[float, list[bool]] = {3.0**0.5: [], 4.0: []}
    for seed in range(3):
        rng = np.random.default_rng(seed)
        data = Dataset(tuple(simulate(model, run, rng=rng) for run in scenario.train))
        away = {n: v * (1 + 0.3 * rng.uniform(-1, 1)) for n, v in scenario.truth.items()}
        for reach, found in held.items():
            filter_ = JointKalmanFilter("unscented", reach=reach)
            fit = filter_.fit(model.with_values(away), data)
            intervals = {name: fit.interval(name) for name in fit.names}
            found += [low <= scenario.truth[n] <= high for n, (low, high) in intervals.items()]
    near, far = (float(np.mean(found)) for found in held.values())
    assert near >= 0.85
    assert far < near - 0.1
