"""What a fit says about itself, whether sources agree, parameters on a logarithmic scale."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from altered import overwritten, with_outputs
from golden_files import restored
from marks import slow
from motion import small
from scipy.stats import norm
from test_design import ship, straight, weak_and_strong
from test_information import ar1
from yaw_vehicle import NOISE, yaw_data, yaw_model

from oed_sysid import Dataset, Fit, Model, Parameter, Record, Solver, simulate_inputs
from oed_sysid.baselines import MultipleShooting, Multistart, profile
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.between_records import CHANCE, Sources, sources_of
from oed_sysid.likelihood.shooting import Shooting

KNOWN = MultipleShooting(noise=NOISE, disturbances="none")


@pytest.fixture(scope="module")
def fit() -> Fit:
    """A fit with a gap in its data and one local parameter."""
    data = overwritten(yaw_data(1), 1, np.s_[10:30, 0], np.nan)
    model = yaw_model(K=Parameter("K", 0.1, "1/s", per_record=True))
    return KNOWN.fit(model, data)


def test_frame_holds_what_the_table_says(fit: Fit) -> None:
    """Values, errors and intervals of the frame are those of the fit."""
    frame = fit.to_dataframe()
    assert list(frame.index) == list(fit.names)
    for name in fit.names:
        assert frame.loc[name, "value"] == fit.values[name]
        assert (frame.loc[name, "low"], frame.loc[name, "high"]) == fit.interval(name)
        assert frame.loc[name, "unit"] == fit.model.parameter(name).unit


def test_likelihood_and_criteria(fit: Fit) -> None:
    """Log-likelihood, AIC and BIC agree with densities added up one by one."""
    total = 0.0
    for residual in fit.residuals:
        densities = norm.logpdf(residual, scale=NOISE)
        total += float(np.nansum(densities))
    assert fit.log_likelihood == pytest.approx(total)
    n_unknowns = 2 + 3 * (2 + 1)
    assert fit.n_unknowns == n_unknowns
    assert fit.n_observations == 2 * (200 + 120 + 61) - 20
    assert fit.aic == pytest.approx(2 * n_unknowns - 2 * total)
    assert fit.bic == pytest.approx(n_unknowns * np.log(fit.n_observations) - 2 * total)


def test_residuals_are_measured_minus_model(fit: Fit) -> None:
    """Residuals, predictions and root mean squares belong together."""
    for record, prediction, residual in zip(
        fit.dataset, fit.predictions, fit.residuals, strict=True
    ):
        assert np.allclose(record.outputs - prediction, residual, equal_nan=True)
    stacked = np.vstack(fit.residuals)
    assert fit.rms["psi"] == pytest.approx(np.sqrt(np.nanmean(stacked[:, 0] ** 2)))
    assert fit.normalised_rms == pytest.approx(np.sqrt(np.nanmean((stacked / NOISE) ** 2)))


def test_interval_and_correlation(fit: Fit) -> None:
    """Intervals are normal quantiles; the correlation has ones on its diagonal."""
    low, high = fit.interval("T", 0.9)
    assert high - low == pytest.approx(2 * 1.6448536 * fit.std_errors["T"])
    assert 0.5 * (high + low) == pytest.approx(fit.values["T"])
    assert np.allclose(np.diag(fit.correlation), 1.0)


def test_saved_fit_comes_back(fit: Fit, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A fit read from its file continues as the original, and the file is plain JSON."""
    again = restored(fit, tmp_path)
    text = (tmp_path / "fit.json").read_text()
    json.loads(text, parse_constant=lambda text: pytest.fail(f"{text} is not JSON"))
    resumed = KNOWN.fit(again.model, again.dataset, warm=again)
    assert resumed.iterations <= 2


def test_infinite_errors_survive_the_file(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """What is not identifiable is still so after loading."""
    model = yaw_model().with_values({"K": 0.0, "alpha": 1.0}).fix("K")
    quiet = with_outputs(yaw_data(3), lambda record: 0.0 * record.outputs + NOISE)
    restored(KNOWN.fit(model, quiet), tmp_path)


def test_coloured_residuals_widen_the_errors() -> None:
    """Slow noise of the same size gives larger, honest errors, and the report says why."""
    rng = np.random.default_rng(4)
    white = yaw_data(4, noise=np.zeros(2))
    remembering = with_outputs(white, lambda r: r.outputs + NOISE * ar1(r.n_samples, 0.9, rng, 2))
    fit = KNOWN.fit(yaw_model(), remembering)
    plain = replace(KNOWN, coloured="never").fit(yaw_model(), remembering)
    assert fit.coloured
    assert "correlated in time" in fit.report()
    ratio = np.sqrt(np.diag(fit.covariance) / np.diag(plain.covariance))
    # Independent samples are (1 - 0.9) / (1 + 0.9) of all: errors are up to 4.4 times larger.
    assert np.all(ratio > 1.5)
    assert np.all(ratio < 6.0)
    assert not KNOWN.fit(yaw_model(), yaw_data(4)).coloured


WHITE = MultipleShooting(disturbances="none", noise="given")


def linear(rng: np.random.Generator, n_records: int, shift: float = 0.0) -> Sources:
    """Priors and records of a linear model of three parameters; one record may be of another."""
    truth = np.zeros(3)
    prior = np.diag([1.0, 4.0, 0.0])
    mean = truth + np.array([1.0, 0.5, 0.0]) * rng.standard_normal(3)
    matrices, own = [], []
    for index in range(n_records):
        # The second record does not see the last parameter.
        rows = rng.standard_normal((20, 3)) * [1.0, 2.0, 0.0 if index == 1 else 0.5]
        at = truth + shift * (index == 0) * np.array([1.0, 0.0, 0.0])
        measured = rows @ at + rng.standard_normal(20)
        matrices.append(rows.T @ rows)
        own.append(rows.T @ measured)
    whole = prior + np.sum(matrices, axis=0)
    joint = np.linalg.solve(whole, prior @ mean + np.sum(own, axis=0))
    scores = [right - matrix @ joint for matrix, right in zip(matrices, own, strict=True)]
    found = sources_of(matrices, scores, prior)
    np.testing.assert_allclose(found.scores[0], prior @ (mean - joint), atol=1e-9)
    return found


def test_right_sources_agree_as_often_as_chance_says() -> None:
    """Statistics are chi-squared with the stated freedom, also where a source sees not all."""
    rng = np.random.default_rng(0)
    found = [linear(rng, 3).agreement() for _ in range(400)]
    one = found[0]
    # Ranks 2, 3, 2, 3 of priors and records, less three parameters.
    assert one.freedom == 7
    assert one.each_freedom == (2, 3, 2, 3)
    chances = np.array([agreement.chances for agreement in found])
    # The mean of 400 uniform variables has a standard error of 0.014.
    np.testing.assert_allclose(chances.mean(axis=0), 0.5, atol=0.06)
    for share in (0.05, 0.2):
        np.testing.assert_allclose((chances < share).mean(axis=0), share, atol=0.06)
    assert np.mean([agreement.chance < 0.05 for agreement in found]) < 0.08


def test_a_record_of_another_vehicle_is_named_and_a_small_difference_allowed() -> None:
    """The source that differs is the worst; within the allowance it is not."""
    rng = np.random.default_rng(1)
    found = [linear(rng, 4, shift=2.0) for _ in range(20)]
    told = [sources.agreement() for sources in found]
    assert sum(agreement.chance < 1e-3 for agreement in told) >= 18
    assert sum(agreement.worst == 1 for agreement in told) >= 18
    apart = np.array([sources.apart(1) for sources in found])
    assert np.all(np.abs(apart[:, 0]) > 3.0)
    assert np.median(np.abs(apart[:, 1:])) < 2.0
    allowed = [sources.agreement(allowance=np.array([2.0, 0.0, 0.0])).chance for sources in found]
    assert sum(chance < 1e-3 for chance in allowed) == 0


def test_allowance_and_stated_errors_are_added() -> None:
    """Two records of one parameter: the difference over the root of all variances."""
    sources = Sources(np.array([0.0, 1.0, 1.0])[:, None, None], np.array([[0.0], [2.0], [-2.0]]))
    assert sources.agreement().statistic == pytest.approx(16 / 2)
    assert sources.agreement(allowance=np.ones(1)).statistic == pytest.approx(16 / 4)
    assert sources.agreement(stated=np.eye(1)).statistic == pytest.approx(16 / 4)
    assert sources.agreement().each == pytest.approx((0.0, 8.0, 8.0))


def test_errors_count_in_their_direction_alone() -> None:
    """What is four times as uncertain in one parameter does not excuse another."""
    matrices = np.array([np.zeros((2, 2)), np.eye(2), np.eye(2)])
    sources = Sources(matrices, np.array([[0.0, 0.0], [2.0, 2.0], [-2.0, -2.0]]))
    found = sources.agreement(stated=np.diag([0.5, 2.0]))
    assert found.statistic == pytest.approx(8.0 + 2.0)
    assert found.freedom == 2


@pytest.mark.parametrize("estimator", [WHITE, *slow(MultipleShooting())], ids=["white", "forces"])
def test_a_missing_term_shows_where_runs_differ_in_strength(estimator: MultipleShooting) -> None:
    """Quadratic damping that the model lacks: each run looks well, weak and strong ones differ."""
    contradicted, plain = [], []
    for seed in range(8):
        data = weak_and_strong(np.random.default_rng((7, seed)))
        lacking, right = estimator.fit(straight(), data), estimator.fit(ship(), data)
        for fit, chances in ((lacking, contradicted), (right, plain)):
            chances.append(fit.sources.agreement(stated=fit.covariance).chance)
    assert sum(chance < CHANCE for chance in contradicted) >= 7
    assert sum(chance < CHANCE for chance in plain) == 0


TIMES = np.arange(0.0, 20.0, 0.1)
NOISE_PARAMETERS = 0.02
ESTIMATOR = MultipleShooting(noise="given", disturbances="none", coloured="never")


def relaxation(*, log: bool, value: float = 0.3, prior_std: float | None = None) -> Model:
    """A first-order lag; its rate may be known to a factor only."""
    rate = Parameter("k", value, "1/s", lower=1e-9, prior_std=prior_std, log=log)
    signals, law = "x [m] <- drive [m/s]", {"x": "K*drive - k*x"}
    return small("relaxation", signals, law, [rate, Parameter("K", 1.0)], NOISE_PARAMETERS)


def record(
    rng: np.random.Generator, *, level: float = NOISE_PARAMETERS, times: np.ndarray = TIMES
) -> Record:
    """A square wave with noise."""
    model = relaxation(log=False)
    inputs = np.where(np.sin(1.2 * times) > 0, 0.2, -0.2)[:, None]
    clean = simulate_inputs(model, times, inputs=inputs, initial=[0.1]).outputs
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
    shooting = Shooting(relaxation(log=True), data, np.array([NOISE_PARAMETERS]))
    unknowns = shooting.start_unknowns()
    assert unknowns[0] == pytest.approx(np.log(0.3))
    lin = shooting.linearise(shooting.continuous(unknowns))
    ends = []
    for sign in (1, -1):
        moved = unknowns.copy()
        moved[0] += sign * 1e-5
        there = shooting.linearise(shooting.continuous(moved))
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


def test_saved_predicted_profiled_and_started_elsewhere(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """Everything that takes a fit works on values, not on logarithms."""
    data = Dataset((record(np.random.default_rng(6)),))
    fit = ESTIMATOR.fit(relaxation(log=True), data)
    plain = ESTIMATOR.fit(relaxation(log=False), data)
    assert restored(fit, tmp_path).interval("k") == fit.interval("k")
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
