"""Parameters that are estimated as their logarithms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

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
)
from oed_sysid.compiled.kernels import kernel
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multistart import Multistart, profile
from oed_sysid.likelihood.shooting import Shooting

TIMES = np.arange(0.0, 20.0, 0.1)
NOISE = 0.02
ESTIMATOR = MultipleShooting(noise="given", disturbances="none", coloured="never")


def relaxation(*, log: bool, value: float = 0.3, prior_std: float | None = None) -> Model:
    """A first-order lag; its rate may be known to a factor only."""
    return Model(
        "relaxation",
        (State("x", "m"),),
        (Input("drive", "m/s"),),
        (Output("x", "m", noise_std=NOISE),),
        {"x": "K*drive - k*x"},
        parameters=(
            Parameter("k", value, "1/s", lower=1e-9, prior_std=prior_std, log=log),
            Parameter("K", 1.0),
        ),
    )


def record(rng: np.random.Generator, *, level: float = NOISE, times: np.ndarray = TIMES) -> Record:
    """A square wave with noise."""
    model = relaxation(log=False)
    inputs = np.where(np.sin(1.2 * times) > 0, 0.2, -0.2)[:, None]
    code = kernel(model)
    z, _ = code.start(np.array([0.1]), inputs[0], model.value_vector, 0.0)
    clean = code.run(times, inputs, model.value_vector, z).outputs
    return Record(
        "run", times, inputs, clean + level * rng.normal(size=clean.shape), model.channels
    )


@pytest.mark.parametrize("disturbances", ["none", ("x",)])
def test_the_same_optimum_and_the_delta_method(disturbances: str | tuple[str]) -> None:
    """Without priors the optimum and the information do not depend on the scale."""
    data = Dataset((record(np.random.default_rng(1)),))
    estimator = MultipleShooting(
        noise="given", disturbances=disturbances, coloured="never", solver=Solver(tolerance=1e-9)
    )
    plain = estimator.fit(relaxation(log=False), data)
    logged = estimator.fit(relaxation(log=True), data)
    near = 1e-4 if disturbances == "none" else 2e-2
    errors = np.sqrt(np.diag(plain.covariance))
    assert np.all(np.abs(logged.estimates - plain.estimates) < near * errors)
    assert logged.covariance == pytest.approx(plain.covariance, rel=10 * near)
    low, high = logged.interval("k")
    value, error = logged.values["k"], logged.std_errors["k"]
    assert low * high == pytest.approx(value**2)
    assert np.log(high / low) == pytest.approx(2 * 1.959964 * error / value)


def test_a_start_two_decades_off_arrives() -> None:
    """From a hundredth and from ten times the truth the logarithm finds the same value."""
    data = Dataset((record(np.random.default_rng(2)),))
    best = ESTIMATOR.fit(relaxation(log=True), data)
    for start in (0.003, 3.0):
        fit = ESTIMATOR.fit(relaxation(log=True, value=start), data)
        assert fit.status.ok
        assert fit.values["k"] == pytest.approx(best.values["k"], rel=1e-4)


def test_derivatives_are_those_by_the_logarithm() -> None:
    """Columns of the condensed Jacobian equal differences of outputs by log k."""
    data = Dataset((record(np.random.default_rng(3)),))
    shooting = Shooting(relaxation(log=True), data, np.array([NOISE]))
    unknowns = shooting.start_unknowns()
    assert unknowns[0] == pytest.approx(np.log(0.3))
    lin = shooting.linearise(shooting.continuous(unknowns))
    assert lin is not None
    ends = []
    for sign in (1, -1):
        moved = unknowns.copy()
        moved[0] += sign * 1e-5
        there = shooting.linearise(shooting.continuous(moved))
        assert there is not None
        ends.append(data[0].outputs - there.residuals[0])
    found = lin.jacobians[0][:, :, 1]
    assert found == pytest.approx((ends[0] - ends[1]) / 2e-5, abs=1e-8)


def test_the_prior_is_relative() -> None:
    """Where data say nothing, value and error are those of the prior, log-normal."""
    times = np.arange(0.0, 1.0, 0.1)
    quiet = record(np.random.default_rng(4), times=times)
    silent = replace(quiet, inputs=0 * quiet.inputs, outputs=0 * quiet.outputs)
    model = relaxation(log=True, prior_std=0.2).fix("K")
    fit = ESTIMATOR.fit(model, Dataset((silent,)))
    assert fit.values["k"] == pytest.approx(0.3, rel=1e-6)
    assert fit.std_errors["k"] == pytest.approx(0.06, rel=1e-6)
    low, high = fit.interval("k")
    assert (low, high) == pytest.approx((0.3 * np.exp(-0.391993), 0.3 * np.exp(0.391993)), rel=1e-4)
    assert model.parameter("k").prior_spread == pytest.approx(0.06)


@pytest.mark.slow
def test_log_normal_intervals_hold_the_truth() -> None:
    """Weak data, 200 sets: 95 % intervals hold it in 92 to 98 %, and never below zero."""
    rng, held = np.random.default_rng(5), []
    times = np.arange(0.0, 4.0, 0.2)
    for _ in range(200):
        data = Dataset((record(rng, times=times),))
        fit = ESTIMATOR.fit(relaxation(log=True), data)
        low, high = fit.interval("k")
        assert low > 0
        held.append(low <= 0.3 <= high)
    assert 0.92 <= np.mean(held) <= 0.98


def test_saved_predicted_profiled_and_started_elsewhere(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Everything that takes a fit works on values, not on logarithms."""
    data = Dataset((record(np.random.default_rng(6)),))
    fit = ESTIMATOR.fit(relaxation(log=True), data)
    plain = ESTIMATOR.fit(relaxation(log=False), data)
    fit.save(tmp_path / "fit.json")
    assert Fit.load(tmp_path / "fit.json").interval("k") == fit.interval("k")
    band, other = fit.predict(data).model_std[0], plain.predict(data).model_std[0]
    assert band == pytest.approx(other, rel=1e-2, abs=1e-6)
    found = profile(fit, "k")
    assert found.estimate == pytest.approx(fit.values["k"], rel=1e-5)
    assert (found.lower, found.upper) == pytest.approx(fit.interval("k"), rel=5e-3)
    bounded = fit.model.with_parameter(replace(fit.model.parameter("k"), lower=1e-4, upper=100.0))
    starts = [s["k"] for s in Multistart(n_starts=40).starts(bounded)]
    assert 1e-4 <= min(starts) < 1e-3
    assert 10.0 < max(starts) <= 100.0


def test_per_record_parameters_may_be_logarithms() -> None:
    """Each record's own rate is found, and reported as a value."""
    rng = np.random.default_rng(7)
    runs = tuple(replace(record(rng), name=name) for name in ("a", "b"))
    model = relaxation(log=True)
    local = model.with_parameter(replace(model.parameter("k"), per_record=True))
    fit = ESTIMATOR.fit(local, Dataset(runs))
    alone = [ESTIMATOR.fit(model.fix("K").with_values(fit.values), Dataset((r,))) for r in runs]
    for own, one in zip(fit.local_values, alone, strict=True):
        assert own["k"] == pytest.approx(one.values["k"], rel=1e-3)


@pytest.mark.parametrize("wrong", [{"value": -1.0}, {"value": 0.0}, {"value": 1.0, "lower": -1.0}])
def test_what_cannot_be_a_logarithm_is_refused(wrong: dict[str, float]) -> None:
    """Values and bounds of log-scaled parameters are positive; no lower bound means zero."""
    with pytest.raises(ModelError, match="log=True"):
        Parameter("k", **wrong, log=True)  # type: ignore[arg-type]
    assert Parameter("k", 1.0, log=True).lower == 0.0
