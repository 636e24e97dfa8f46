"""The estimator against a general least-squares solver on a hand-written simulator."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from altered import overwritten, with_outputs
from marks import slow
from motion import small
from plain_pages import plain_pages  # noqa: F401
from scipy.optimize import least_squares
from test_shooting import diving_data
from vehicles import remus
from yaw_vehicle import NOISE, TRUE, simulate_yaw, yaw_data, yaw_model, yaw_record

from oed_sysid import Dataset, Fit, Model, MultipleShooting, Parameter, Record, Solver, replayed
from oed_sysid.errors import ModelError, OedSysidError
from oed_sysid.likelihood.multistart import profile
from oed_sysid.physics import hull_derivatives

START = {"K": 0.08, "T": 12.0, "alpha": 6.0}
ESTIMATOR = MultipleShooting(noise=NOISE, coloured="never", disturbances="none")


def reference(
    data: Dataset,
    prior: dict[str, tuple[float, float]] | None = None,
    held: dict[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Optimum, covariance of what is not held and half the sum of squares, by SciPy."""
    held = held or {}
    names = [name for name in TRUE if name not in held]
    n = len(names)

    def residuals(x: np.ndarray) -> np.ndarray:
        values, parts = held | dict(zip(names, x[:n], strict=True)), []
        for start, record in zip(x[n:].reshape(-1, 2), data, strict=True):
            model = simulate_yaw(record.times, record.inputs[:, 0], start, values)
            scaled = (record.outputs - model) / NOISE
            parts.append(scaled[np.isfinite(scaled)])
        for name, (mean, std) in (prior or {}).items():
            parts.append(np.array([(values[name] - mean) / std]))
        return np.concatenate(parts)

    starts = [np.nan_to_num(record.outputs[0]) for record in data]
    guess = np.concatenate([[TRUE[name] for name in names], *starts])
    scale = np.concatenate([np.abs(guess[:n]), np.full(len(guess) - n, 0.05)])
    found = least_squares(residuals, guess, x_scale=scale, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    return found.x, covariance[:n, :n], found.cost


def errors_apart(estimates: np.ndarray, others: np.ndarray, covariance: np.ndarray) -> float:
    """Largest difference in standard errors."""
    return float(np.max(np.abs(estimates - others) / np.sqrt(np.diag(covariance))))


def with_gaps(data: Dataset) -> Dataset:
    """Rate missing over a stretch of one record, heading at every third sample."""
    return overwritten(overwritten(data, 0, np.s_[20:90, 1], np.nan), 0, np.s_[::3, 0], np.nan)


@pytest.mark.parametrize("kind", ["plain", "gaps", "irregular"])
def test_optimum_and_covariance_are_those_of_scipy(kind: str) -> None:
    """Three records of different length: same estimates, errors and cost, gaps or not."""
    data = yaw_data(1, irregular=kind == "irregular")
    data = with_gaps(data) if kind == "gaps" else data
    expected, covariance, cost = reference(data)
    fit = ESTIMATOR.fit(yaw_model().with_values(START), data)
    assert fit.status.ok
    assert errors_apart(fit.estimates, expected[:3], covariance) < 2e-3
    assert np.allclose(fit.covariance, covariance, rtol=2e-3)
    assert fit.cost == pytest.approx(cost, abs=1e-4)
    for index, own in enumerate(fit.initial_states):
        assert np.allclose(own, expected[3 + 2 * index : 5 + 2 * index], atol=1e-5)


@pytest.mark.parametrize("interval", [2.0, 20.0, np.inf])
def test_the_interval_does_not_change_the_optimum(interval: float) -> None:
    """Single shooting and multiple shooting with any interval end at the same place."""
    data = yaw_data(2)
    expected = ESTIMATOR.fit(yaw_model(), data)
    other = replace(ESTIMATOR, interval=interval).fit(yaw_model(), data)
    assert errors_apart(other.estimates, expected.estimates, expected.covariance) < 2e-3
    assert np.allclose(other.covariance, expected.covariance, rtol=1e-3)


def test_priors_are_observations() -> None:
    """A prior adds one row; estimates and covariance are those of the augmented problem."""
    data = yaw_data(3)
    prior = {"alpha": (20.0, 0.5)}
    expected, covariance, cost = reference(data, prior)
    parameter = Parameter("alpha", 12.0, prior_mean=20.0, prior_std=0.5)
    fit = ESTIMATOR.fit(yaw_model(alpha=parameter), data)
    assert errors_apart(fit.estimates, expected[:3], covariance) < 2e-3
    assert np.allclose(fit.covariance, covariance, rtol=2e-3)
    assert fit.cost == pytest.approx(cost, abs=1e-4)


def test_active_bounds_give_the_constrained_optimum() -> None:
    """With a bound in the way, the others settle where SciPy has them with that value held."""
    data = yaw_data(4)
    expected, _, cost = reference(data, held={"T": 7.5})
    parameter = Parameter("T", 6.0, "s", lower=0.5, upper=7.5)
    fit = ESTIMATOR.fit(yaw_model(T=parameter), data)
    assert fit.status.ok
    assert fit.values["T"] == 7.5
    assert "at bound" in fit.report()
    assert fit.cost == pytest.approx(cost, abs=1e-3)
    assert fit.values["K"] == pytest.approx(expected[0], rel=1e-4)


def test_fixed_parameters_stay_and_others_follow() -> None:
    """A fixed parameter keeps its value and is not listed."""
    fit = ESTIMATOR.fit(yaw_model().with_values({"T": 9.0}).fix("T"), yaw_data(5))
    assert fit.names == ("K", "alpha")
    assert fit.model.values["T"] == 9.0


def test_parameters_per_record() -> None:
    """A rudder effectiveness that differs by record is found for each; the rest is shared."""
    rng = np.random.default_rng(6)
    gains = {"a": 0.08, "b": 0.12, "c": 0.16}
    data = Dataset(yaw_record(name, rng, n=300, values={"K": gain}) for name, gain in gains.items())
    fit = ESTIMATOR.fit(yaw_model(K=Parameter("K", 0.1, "1/s", per_record=True)), data)
    assert fit.names == ("T", "alpha")
    assert [v["K"] for v in fit.local_values] == pytest.approx(list(gains.values()), rel=0.05)
    assert fit.model.values["K"] == pytest.approx(np.mean(list(gains.values())), rel=0.05)
    assert fit.normalised_rms == pytest.approx(1.0, abs=0.05)
    alone = ESTIMATOR.fit(yaw_model(K=Parameter("K", 0.1, "1/s")), data)
    assert alone.cost > fit.cost + 100


def test_one_record_makes_local_and_shared_the_same() -> None:
    """With a single record it does not matter whether a parameter is per record."""
    data = Dataset((yaw_data(7)[0],))
    shared = ESTIMATOR.fit(yaw_model(), data)
    local = ESTIMATOR.fit(yaw_model(K=Parameter("K", 0.1, per_record=True)), data)
    assert local.local_values[0]["K"] == pytest.approx(shared.values["K"], rel=1e-5)
    keep = [1, 2]
    assert np.allclose(local.covariance, shared.covariance[np.ix_(keep, keep)], rtol=1e-4)


def test_noise_levels_are_found() -> None:
    """Estimated noise is within its own uncertainty of the truth, and errors scale with it."""
    data = yaw_data(8)
    fit = MultipleShooting(noise="estimate").fit(yaw_model().with_values(START), data)
    n = sum(record.n_samples for record in data)
    assert np.all(np.abs(fit.sigma / NOISE - 1) < 4 / np.sqrt(2 * n))
    assert fit.sigma_estimated.all()
    again = MultipleShooting(noise=fit.sigma).fit(yaw_model(), data)
    assert errors_apart(again.estimates, fit.estimates, fit.covariance) < 0.02


@pytest.mark.parametrize("loss", ["huber", "student"])
def test_robust_losses_ignore_outliers(loss: str) -> None:
    """With 5 % gross outliers the square is far off, robust losses are not."""
    data = yaw_data(9)
    rng = np.random.default_rng(9)

    def spoilt(record: Record) -> np.ndarray:
        outputs = record.outputs.copy()
        hit = rng.random(outputs.shape) < 0.05
        outputs[hit] += (rng.uniform(5, 40, hit.sum())) * np.broadcast_to(NOISE, hit.shape)[hit]
        return outputs

    bad = with_outputs(data, spoilt)
    clean = ESTIMATOR.fit(yaw_model(), data)
    robust = MultipleShooting(noise=NOISE, loss=loss, coloured="never").fit(yaw_model(), bad)
    square = replace(ESTIMATOR, loss="square").fit(yaw_model(), bad)
    truth = np.array(list(TRUE.values()))
    assert errors_apart(robust.estimates, truth, robust.covariance) < 4
    off = errors_apart(robust.estimates, clean.estimates, clean.covariance)
    assert off < 1.5
    assert errors_apart(square.estimates, clean.estimates, clean.covariance) > 2 * off
    without = ESTIMATOR.fit(yaw_model(), bad)  # by default they are taken out
    assert errors_apart(without.estimates, clean.estimates, clean.covariance) < 1.5


def test_robust_loss_costs_little_on_clean_data() -> None:
    """On Gaussian noise Huber's standard errors are a few per cent above least squares'."""
    data = yaw_data(10)
    square = ESTIMATOR.fit(yaw_model(), data)
    huber = MultipleShooting(noise=NOISE, loss="huber", coloured="never").fit(yaw_model(), data)
    ratio = np.sqrt(np.diag(huber.covariance) / np.diag(square.covariance))
    assert np.all(ratio > 0.93)
    assert np.all(ratio < 1.12)


def test_warm_start_takes_fewer_iterations() -> None:
    """An earlier fit to the same records is worth iterations, and the optimum is the same."""
    data = yaw_data(11)
    cold = ESTIMATOR.fit(yaw_model().with_values(START), data)
    warm = ESTIMATOR.fit(yaw_model().with_values(START), data, warm=cold)
    assert warm.iterations <= 2 < cold.iterations
    assert errors_apart(warm.estimates, cold.estimates, cold.covariance) < 1e-3


def test_warm_start_respects_fixed_values_and_bounds() -> None:
    """What the new model fixes or bounds is not overruled by the earlier fit."""
    data = yaw_data(12)
    first = ESTIMATOR.fit(yaw_model(), data)
    fixed = ESTIMATOR.fit(yaw_model().with_values({"T": 11.0}).fix("T"), data, warm=first)
    assert fixed.model.values["T"] == 11.0
    bounded = ESTIMATOR.fit(yaw_model(T=Parameter("T", 5.0, upper=6.0)), data, warm=first)
    assert bounded.values["T"] <= 6.0


def test_warm_start_knows_records_by_name() -> None:
    """Initial states and local values go to the record of the same name, in any order."""
    data = yaw_data(13)
    model = yaw_model(K=Parameter("K", 0.1, per_record=True))
    first = ESTIMATOR.fit(model, data)
    turned = Dataset((data[2], data[0]))
    again = ESTIMATOR.fit(model.with_values(dict(first.values)), turned, warm=first)
    # Fewer records move the optimum a little: a start near it needs few iterations.
    assert again.iterations <= 4
    assert np.allclose(again.initial_states[1], first.initial_states[0], atol=0.01)


def test_wild_start_finds_its_own_way() -> None:
    """From parameters with wrong signs and sizes the fit ends at the same optimum."""
    model, data = remus(), diving_data(remus(), 200)
    estimator = MultipleShooting(noise=[0.02, 0.02, 0.004, 0.004, 0.03], disturbances="none")
    right = estimator.fit(model, data)
    # Data without noise: the stated noise, not the residuals' rounding errors, gives the errors.
    assert 1e-4 < right.std_errors["Z_uw"] < 10
    for seed in range(6):
        rng = np.random.default_rng(seed)
        wild = {n: rng.uniform(-4, 4) * abs(model.values[n]) for n in model.free_names}
        fit = estimator.fit(model.with_values(wild), data)
        assert fit.status.ok
        assert errors_apart(fit.estimates, right.estimates, right.covariance) < 0.05


def test_unmeasured_states_do_not_stop_the_way_in() -> None:
    """Without heave velocity and pitch rate measured, wild starts still arrive."""
    model = remus()
    model = replace(model, outputs=tuple(o for o in model.outputs if o.name not in ("w", "q")))
    full = diving_data(remus(), 300)[0]
    columns = [remus().output_names.index(name) for name in model.output_names]
    noise = np.array([0.01, 0.002, 0.02])
    outputs = full.outputs[:, columns] + noise * np.random.default_rng(0).standard_normal(
        (full.n_samples, 3)
    )
    record = replace(full, outputs=outputs, channels=model.channels, missing_outputs=())
    estimator = MultipleShooting(noise=noise, disturbances="none")
    data = Dataset((record,))
    right = estimator.fit(model, data)
    arrived = 0
    for seed in range(5):
        rng = np.random.default_rng(seed)
        wild = {n: rng.uniform(-3, 3) * abs(model.values[n]) for n in model.free_names}
        fit = estimator.fit(model.with_values(wild), data)
        arrived += fit.status.ok and fit.cost < right.cost + 0.1
    assert arrived >= 4


def test_unobservable_states_do_not_disturb_the_covariance() -> None:
    """A depth that nothing measures has no bearing on the parameters' errors."""
    model = remus().fix("zgW")
    data = diving_data(model, 150)[0]
    outputs = data.outputs.copy()
    outputs[:, -1] = np.nan
    silent = Dataset((data.with_outputs(outputs),))
    without = replace(
        model, states=model.states[:4], outputs=model.outputs[:4], kinematics={"theta": "q"}
    )
    smaller = Dataset(
        (replace(data, outputs=outputs[:, :4], channels=without.channels, missing_outputs=()),)
    )
    noise = [0.02, 0.02, 0.004, 0.004]
    full = replace(ESTIMATOR, noise=[*noise, 0.03]).fit(model, silent)
    small = replace(ESTIMATOR, noise=noise).fit(without, smaller)
    assert np.allclose(full.covariance, small.covariance, rtol=1e-5)
    assert np.isnan(full.rms["z"])
    assert replace(ESTIMATOR, noise="estimate").fit(model, silent).sigma[-1] == 1.0


def test_free_scale_is_named() -> None:
    """With a free added mass every heave coefficient scales with it, and the fit says so."""
    model = _heave_model()
    data = diving_data(model, 150)
    fit = replace(ESTIMATOR, noise=[0.02, 0.02, 0.004, 0.004, 0.03]).fit(model, data)
    (text,) = fit.information.null_directions()
    ratios = dict(re.findall(r"(\w+): ([-+.\de]+)", text))
    assert set(ratios) == {"A_w", "Z_uw", "Z_uq", "Z_uuds"}
    for name, ratio in ratios.items():
        # All are free to grow by the same factor.
        assert float(ratio) / float(ratios["A_w"]) == pytest.approx(
            fit.values[name] / fit.values["A_w"], rel=0.02
        )
        assert np.isinf(fit.std_errors[name])
    assert np.isfinite(fit.std_errors["M_uw"])
    assert "Not identifiable" in fit.report()
    assert "not identifiable" in fit.report()


def _heave_model() -> Model:
    """Heave without any force of known size: ``A_w w' = Z_uw u w + Z_uq u q + Z_uuds u^2 ds``."""
    model = remus().with_values({"Z_uq": -20.0})
    hull, righting = model.effects
    return replace(
        model,
        inertia={("X", "u"): "m", ("Z", "w"): "A_w", ("M", "q"): "I_yy"},
        effects=(hull_derivatives("hull", hull.parameters, extra={"X": "T"}), righting),
        parameters=(*model.parameters, Parameter("A_w", 66.0)),
    )


def test_interrupted_fit_can_be_resumed() -> None:
    """Ctrl-C leaves a usable fit that says so; continuing from it reaches the optimum."""
    data = yaw_data(14)
    seen = []

    def stop(progress: object) -> None:
        seen.append(progress)
        if len(seen) == 1:
            raise KeyboardInterrupt

    stopped = replace(ESTIMATOR, progress=stop).fit(yaw_model().with_values(START), data)
    assert stopped.status.code == "interrupted"
    assert "warm=fit" in stopped.status.advice
    resumed = ESTIMATOR.fit(yaw_model().with_values(START), data, warm=stopped)
    direct = ESTIMATOR.fit(yaw_model(), data)
    assert errors_apart(resumed.estimates, direct.estimates, direct.covariance) < 2e-3


def test_diverging_model_is_a_status_that_advises() -> None:
    """A model that diverges from every start is reported, not raised."""
    parameter = Parameter("alpha", -1e9, fixed=True)
    fit = ESTIMATOR.fit(yaw_model(alpha=parameter), yaw_data(15))
    assert fit.status.code == "diverged"
    assert "signs and units" in fit.status.advice
    assert not fit.status.ok
    assert "diverged" in fit.report()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("steep", [1e152, *slow(1e160, 1e300)])
@pytest.mark.parametrize("disturbances", ["auto", *slow("none")])
def test_a_fit_with_derivatives_beyond_numbers_still_answers(
    steep: float, disturbances: str, tmp_path: Path
) -> None:
    """What a run is by its parameters may overflow although the run does not: all say so."""
    law = {"w": f"T - w + {steep:g}*(b - 1)"}
    model = small("steep", "w [m/s] <- T [N]", law, {"b": 1.0}, 1e-3)
    rng, times = np.random.default_rng(5), np.arange(0.0, 20.0, 0.1)
    inputs, noise = np.sign(np.sin(times))[:, None], rng.normal(size=(2, len(times), 1))
    data = Dataset(Record(f"r{i}", times, inputs, y, model.channels) for i, y in enumerate(noise))
    few = MultipleShooting(disturbances=disturbances, solver=Solver(max_iterations=3))
    fit = few.fit(model, data)
    assert fit.status.code == "diverged"
    path = tmp_path / "fit.json"
    fit.save(path)
    for said in (fit, Fit.load(path), fit.predict(data), replayed(fit)):
        assert said.report()
    assert fit.document().html()
    assert fit.to_dict()["status"]
    assert fit.runs_on(data).to_dict()
    with suppress(OedSysidError):
        profile(fit, "b")


OF_ANOTHER_KIND = {
    MultipleShooting: [
        ({"horizon": float("inf")}, "horizon is inf. Give seconds above zero, or None"),
        ({"horizon": "10"}, "horizon is '10'"),
        ({"disturbances": None}, "disturbances is None. Choose auto, none, all"),
        ({"disturbances": (1,)}, r"disturbances is \(1,\)"),
        ({"noise": {"r": 0.1}}, "noise is {'r': 0.1}. Choose auto, given, estimate or a list"),
        ({"noise": None}, "noise is None"),
        ({"solver": "ipopt"}, r"Write solver=Solver\('ipopt'\)"),
        ({"max_iterations": 40}, r"no argument 'max_iterations'. Write solver=Solver\(max_iter"),
        ({"constraints": ("K > 0",)}, "MultipleShooting has no argument 'constraints'"),
        ({"interval": "5"}, "Shooting interval is '5'. Give a positive length in s"),
    ],
    Solver: [
        ({"max_iterations": 2.5}, "max_iterations is 2.5. Give a whole number, 1 or more"),
        ({"tolerance": "small"}, "tolerance is 'small'. Give a positive number"),
    ],
}


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [(kind, *row) for kind, rows in OF_ANOTHER_KIND.items() for row in rows],
)
def test_options_of_another_kind_are_refused_at_once(kind: type, options: dict, words: str) -> None:
    """What is expected, what was given and what to do, before any record is read."""
    with pytest.raises(ModelError, match=words):
        kind(**options)
