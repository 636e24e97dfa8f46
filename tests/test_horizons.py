"""Fits that look a short time ahead."""

from __future__ import annotations

import numpy as np
import pytest
from turning_ship import CUBIC, GAIN, SHIP, TIME, record

from oed_sysid import Dataset, Model, MultipleShooting, Parameter
from oed_sysid.compiled.kernels import kernel
from oed_sysid.errors import DataError, ModelError
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.likelihood.windows import Windows


@pytest.fixture(scope="module")
def zigzags() -> Dataset:
    """Four records of a linear ship with declared noise."""
    rng = np.random.default_rng(4)
    return Dataset(tuple(record(f"run_{i}", rng) for i in range(4)))


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
        data = Dataset(tuple(record(f"run_{i}", rng) for i in range(3)))
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
    data = Dataset(tuple(record(f"run_{i}", rng, cubic=-3.0) for i in range(4)))
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
        shifted = run.inputs - zero
        runs.append(type(run)(run.name, run.times, shifted, run.outputs, run.channels))
    zero = Parameter("E_zero", 0.0, "rad", prior_mean=0.0, prior_std=0.1, per_record=True)
    model = Model(
        "with zero",
        states=SHIP.states,
        inputs=SHIP.inputs,
        outputs=SHIP.outputs,
        kinematics={"psi": "r", "r": "(K*(delta + E_zero) - r)/T"},
        actuators={"delta": "rudder"},
        parameters=(*SHIP.parameters, zero),
        step=SHIP.step,
    )
    fit = MultipleShooting(disturbances="none", horizon=10.0).fit(model, Dataset(tuple(runs)))
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
    """Its trajectories do not hang on the step, though whole runs of a wrong model drift away."""
    wrong = SHIP.with_values({"K": 0.9 * GAIN}).fix("K")
    fit = MultipleShooting(disturbances="none", horizon=1.0).fit(wrong, zigzags)
    assert fit.status.ok
    assert "integration" not in {concern.kind for concern in fit.concerns}
    assert fit.nominal == {"T": wrong.values["T"]}
    whole = kernel(fit.model)
    errors = []
    for run, own in zip(zigzags, fit.initial_states, strict=True):
        values = fit.model.value_vector
        z0, _ = whole.start(own, run.inputs[0], values, run.times[0])
        errors.append(run.outputs - whole.run(run.times, run.inputs, values, z0).outputs)
    assert np.sqrt(np.mean((np.vstack(errors) / fit.sigma) ** 2)) > 3 * fit.normalised_rms
