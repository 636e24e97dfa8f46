"""Regression in the frequency domain: exact without noise, good in waves, the same on board."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from oed_sysid import (
    Dataset,
    Experiment,
    Force,
    Input,
    Model,
    Output,
    Parameter,
    Piecewise,
    Record,
    State,
)
from oed_sysid.baselines import EquationError
from oed_sysid.baselines.fourier import FourierRegression, FourierStream
from oed_sysid.errors import DataError, ModelError
from oed_sysid.testing import check_estimator

# Sway and yaw of a ship of 60 m at 6 m/s, per unit of mass and of inertia.
TRUTH = {
    "Y_v": -0.09, "Y_r": -2.2, "Y_d": 0.12,
    "N_v": -0.0012, "N_r": -0.16, "N_d": -0.011,
}  # fmt: skip
SAMPLING = 0.5


def ship(values: dict[str, float] | None = None) -> Model:
    """Linear sway and yaw; start values are far off."""
    values = values or {name: 0.5 * value for name, value in TRUTH.items()}
    units = {
        "Y_v": "1/s",
        "Y_r": "m/s",
        "Y_d": "m/s^2",
        "N_v": "1/(m s)",
        "N_r": "1/s",
        "N_d": "1/s^2",
    }
    free = {name: Parameter(name, value, units[name]) for name, value in values.items()}
    sway, yaw = ("Y_v", "Y_r", "Y_d"), ("N_v", "N_r", "N_d")
    return Model(
        "ship",
        (State("v", "m/s"), State("r", "rad/s")),
        (Input("d", "rad"),),
        (Output("v", "m/s", noise_std=0.02), Output("r", "rad/s", noise_std=0.0005)),
        axes={"Y": "v", "N": "r"},
        inertia={("Y", "v"): "1", ("N", "r"): "1"},
        effects=(
            Force("sway", {"Y": "Y_v*v + Y_r*r + Y_d*d"}, tuple(free[n] for n in sway)),
            Force("yaw", {"N": "N_v*v + N_r*r + N_d*d"}, tuple(free[n] for n in yaw)),
        ),
        step=0.5,
    )


@cache
def sailed(seed: int, waves: float = 1.0, noise: float = 1.0, length: float = 600.0) -> Record:
    """Levels of the rudder in 8 s swell, by Euler's method in steps of a hundredth of a second."""
    rng = np.random.default_rng(seed)
    n, fine = int(length / SAMPLING) + 1, 50
    d = np.repeat(rng.choice([-0.25, -0.1, 0.1, 0.25], n // 40 + 1), 40)[:n]
    omega = 2 * np.pi / 8.0 * (1 + 0.1 * rng.standard_normal(60))
    phase = rng.uniform(0, 2 * np.pi, (2, 60))
    h = SAMPLING / fine
    t = np.arange(n * fine) * h
    lift = np.array([0.06, 0.0025]) * waves
    force = [
        lift[i] * np.sqrt(2 / 60) * np.cos(np.outer(t, omega) + phase[i]).sum(axis=1)
        for i in (0, 1)
    ]
    v = r = 0.0
    found = np.empty((n, 2))
    k = TRUTH
    for i in range(n):
        found[i] = v, r
        for j in range(i * fine, (i + 1) * fine):
            dv = k["Y_v"] * v + k["Y_r"] * r + k["Y_d"] * d[i] + force[0][j]
            dr = k["N_v"] * v + k["N_r"] * r + k["N_d"] * d[i] + force[1][j]
            v, r = v + h * dv, r + h * dr
    found += noise * np.array([0.02, 0.0005]) * rng.standard_normal(found.shape)
    model = ship()
    return Record(f"run {seed}", np.arange(n) * SAMPLING, d[:, None], found, model.channels)


def errors(values: dict[str, float]) -> np.ndarray:
    """Relative errors of all coefficients."""
    return np.array([abs(values[name] / value - 1) for name, value in TRUTH.items()])


def test_without_noise_the_coefficients_come_out() -> None:
    """Differences in a band far below the sampling are rates."""
    fit = FourierRegression().fit(ship(), Dataset((sailed(0, 0.0, 0.0),)))
    assert errors(dict(fit.values)).max() < 0.02


def test_swell_outside_the_band_does_not_count() -> None:
    """Half as wrong as regression on differences, and within 8 % in the geometric mean."""
    runs = [Dataset((sailed(seed),)) for seed in range(4)]
    means = [
        float(np.exp(np.mean([np.log(errors(dict(one.fit(ship(), run).values))) for run in runs])))
        for one in (FourierRegression(without=((0.09, 0.16),)), EquationError())
    ]
    assert means[0] < 0.08
    assert means[0] < 0.5 * means[1]


def test_errors_are_those_that_are_stated() -> None:
    """Scores are standard normal in white noise and swell, over seeds and coefficients."""
    scores = []
    for seed in range(4):
        fit = FourierRegression(without=((0.09, 0.16),)).fit(ship(), Dataset((sailed(seed),)))
        scores += [(fit.values[n] - value) / fit.std_errors[n] for n, value in TRUTH.items()]
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 2.0


def test_the_stream_ends_at_the_estimate_of_the_log() -> None:
    """Sample by sample the same sums, and the same estimates and errors."""
    record = sailed(1)
    band = (0.002, 0.08)
    fit = FourierRegression(band).fit(ship(), Dataset((record,)))
    stream = FourierStream(ship(), duration=600.0, period=SAMPLING, band=band)
    for t, d, y in zip(record.times, record.inputs[:, 0], record.outputs, strict=True):
        stream.push(t, {"d": d, "v": y[0], "r": y[1]})
    for name, value in stream.values.items():
        assert value == pytest.approx(fit.values[name], rel=1e-9)
        share = stream.relative_errors[name] * abs(value)
        assert share == pytest.approx(fit.std_errors[name], rel=1e-6)
    assert stream.n_samples == len(record.times)


def test_four_runs_tell_more_than_one() -> None:
    """Runs add up; four have half the errors of one."""
    stream = FourierStream(ship(), duration=600.0, period=SAMPLING, band=(0.002, 0.08))
    told = []
    for seed in (1, 2, 4, 5):
        record = sailed(seed)
        for t, d, y in zip(record.times, record.inputs[:, 0], record.outputs, strict=True):
            stream.push(t, {"d": d, "v": y[0], "r": y[1]})
        told.append(np.mean(np.log(list(stream.relative_errors.values()))))
        stream.start()
    assert told[3] < told[0] + np.log(0.7)


def test_half_a_run_claims_no_more_than_it_knows() -> None:
    """Frequencies of a run that goes on count by how much of it is over."""
    record = sailed(3)
    stream = FourierStream(ship(), duration=600.0, period=SAMPLING, band=(0.002, 0.08))
    for k in range(300):
        d, y = record.inputs[k, 0], record.outputs[k]
        stream.push(record.times[k], {"d": d, "v": y[0], "r": y[1]})
    errors_now, values = stream.relative_errors, stream.values
    score = [(values[n] / v - 1) / errors_now[n] * abs(v / values[n]) for n, v in TRUTH.items()]
    assert np.sqrt(np.mean(np.square(score))) < 2.5
    assert stream.advice(1e-3).startswith("go on")
    assert stream.advice(100.0).startswith("enough")


def test_coherence_says_what_answers() -> None:
    """A response that the rudder moves is coherent with it, one of noise alone is not."""
    rng = np.random.default_rng(0)
    record = sailed(2)
    stream = FourierStream(ship(), duration=600.0, period=SAMPLING, band=(0.0, 0.05))
    for t, d, y in zip(record.times, record.inputs[:, 0], record.outputs, strict=True):
        stream.push(t, {"d": d, "v": 0.02 * rng.standard_normal(), "r": y[1]})
    found = stream.coherence()
    assert found["d", "r"] > 0.6
    assert found["d", "v"] < 0.45


def test_it_is_an_estimator() -> None:
    """The contract of all estimators holds."""
    record = sailed(0, 0.0, 0.0)
    orders = Piecewise("d", record.times.tolist(), record.inputs[:, 0].tolist())
    run = Experiment("levels", orders, duration=600.0, sample_time=SAMPLING)
    found = check_estimator(
        FourierRegression(), ship(TRUTH), (run,), rng=np.random.default_rng(0), tolerance=0.01,
        n_repeats=10,
    )  # fmt: skip
    assert found.coverage > 0.85


def test_too_narrow_a_band_is_refused() -> None:
    """More parameters than frequencies are named with what to do."""
    with pytest.raises(DataError, match=r"frequencies from .* are left"):
        FourierRegression((0.01, 0.012)).fit(ship(), Dataset((sailed(0),)))
    with pytest.raises(ModelError, match="length of many samples"):
        FourierStream(ship(), duration=0.1, period=0.5)
