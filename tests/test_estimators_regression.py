"""Regressions on the equations of motion: batch, online, in the frequency domain."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from altered import part
from motion import small
from published import PUBLISHED
from scipy.spatial.distance import cdist
from simple_models import NOMOTO
from test_estimators import TEST as MULTISINE
from test_estimators import YAW as DAMPED_YAW

from benchmarks.documents.published import paper
from benchmarks.documents.published.auv import exact_errors
from oed_sysid import Dataset, Doublet, Experiment, Model, Piecewise, Record, load_problem, simulate
from oed_sysid.baselines import (
    EquationError,
    EquationStream,
    IncrementalLSSVM,
    LeastSquaresSVM,
    OnlineRegression,
    RecursiveLeastSquares,
    RecursiveLSSVM,
    SupportVectorRegression,
)
from oed_sysid.baselines.equations import exact_rates, local_cubic, regression_form, rows_of
from oed_sysid.baselines.fourier import FourierRegression, FourierStream
from oed_sysid.baselines.least_squares import TotalLeastSquares, generalised_tls
from oed_sysid.baselines.support_vectors import train
from oed_sysid.errors import DataError, ModelError, PrecisionWarning, library
from oed_sysid.physics import Actuator, Force, Memory, Sensor
from oed_sysid.physics.parameters import Parameter
from oed_sysid.testing import check_estimator

AUV = load_problem("auv_diving_plane")
RECORD = simulate(AUV.model, AUV.experiment("zigzag_5_5"), noise=False)
DATA = Dataset((RECORD,))
SCRIPT = paper("auv_diving_plane")

TURN = Force("turn", {"N": "K*delta - r"}, (Parameter("K", 0.1, "1/s"),))
YAW = small(
    "yaw", "r [rad/s] <- delta [rad]", {}, {"T [s]": 10.0}, 1e-3,
    axes={"N": "r"}, inertia={("N", "r"): "T"}, effects=(TURN,),
)  # fmt: skip


def errors(fit) -> dict[str, float]:
    """Relative errors in per cent, by parameter."""
    return {
        name.removesuffix("_prime"): 100 * (value / AUV.truth[name] - 1)
        for name, value in fit.values.items()
    }


def test_exact_accelerations_give_every_coefficient_back() -> None:
    """With exact rates the regression is exact: all 19 numbers to nine digits."""
    assert max(map(abs, exact_errors().values())) < 1e-7


# Printed by an independent program for the same trajectory, per cent (trapezoid, Simpson, Euler).
INDEPENDENT = PUBLISHED["diving_plane"]


@pytest.mark.parametrize("rule", INDEPENDENT)
def test_error_table_of_the_diving_plane(rule: str) -> None:
    """Errors made by each way to take derivatives equal those of an independent program."""
    fit = LeastSquaresSVM(rule=rule).fit(AUV.model, DATA)
    found = errors(fit)
    for name, expected in INDEPENDENT[rule].items():
        assert found[name] == pytest.approx(expected, abs=0.006), name
    assert fit.extras["bias"]["u"] == pytest.approx(fit.values["X_T"])


def test_dual_and_primal_agree_where_the_dual_is_well_conditioned() -> None:
    """The dual equals the primal in dimensionless equations and loses digits in newton."""
    gaps = {}
    for label, scale in (("dimensionless", SCRIPT.DIMENSIONLESS), ("newton", "raw")):
        primal, dual = SCRIPT.forms(RECORD, scale)
        gaps[label] = SCRIPT.apart(primal, dual)
        assert dual.extras["condition"]["w"] > primal.extras["condition"]["w"]
    assert gaps["dimensionless"] < 1e-8  # rounding times a condition number of some 1e7
    assert gaps["newton"] > 1e-2


def test_train_solves_the_optimality_conditions() -> None:
    """Primal and dual fulfil the stationarity conditions of the LS-SVM's Lagrangian."""
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((40, 3)), rng.standard_normal(40)
    for form in ("primal", "dual"):
        machine = train(x, y, C=10.0, form=form)
        residual = y - machine.predict(x)
        assert machine.multipliers == pytest.approx(10.0 * residual)
        assert machine.coefficients == pytest.approx(x.T @ machine.multipliers)
        assert machine.multipliers.sum() == pytest.approx(0.0, abs=1e-10)


def gaussian(first: np.ndarray, second: np.ndarray, *, width: float) -> np.ndarray:
    """Radial basis functions, exp(-|x - x'|^2/(2 width^2))."""
    return np.exp(-cdist(first, second, "sqeuclidean") / (2 * width**2))


def test_gaussian_kernel_learns_a_curve() -> None:
    """The RBF machine predicts a sine between its samples and has no coefficients."""
    x = np.linspace(0, 6, 40)[:, None]
    machine = train(x, np.sin(x[:, 0]), C=1e6, kernel=partial(gaussian, width=1.0), form="dual")
    between = x[:-1] + 0.05
    assert machine.predict(between) == pytest.approx(np.sin(between[:, 0]), abs=1e-3)
    assert machine.coefficients is None
    with pytest.raises(ModelError, match="linear kernel"):
        train(x, x[:, 0], C=1.0, kernel=partial(gaussian, width=1.0))


def test_support_vectors_ignore_outliers() -> None:
    """A few wild samples move least squares by far more than support vector regression."""
    rng = np.random.default_rng(1)
    truth = {name: AUV.truth[name] for name in ("Z_uq_prime", "Z_uuds_prime", "Z_uw_prime")}
    rates = exact_rates(AUV.model, DATA)["zigzag_5_5"].copy()
    rates[rng.choice(len(rates), 8, replace=False), 1] += 0.02
    settings = {"rule": "exact", "rates": {"zigzag_5_5": rates}}
    robust = SupportVectorRegression(**settings).fit(AUV.model, DATA)
    plain = EquationError(**settings).fit(AUV.model, DATA)
    for name, value in truth.items():
        assert abs(robust.values[name] - value) < 0.5 * abs(plain.values[name] - value)


def test_nonlinear_parameters_are_named() -> None:
    """K/T in the kinematics is refused, with the way to write it, and accepted as an inertia."""
    with pytest.raises(ModelError, match=r"not linear in K, T.*equation of r.*inertia"):
        regression_form(NOMOTO)
    assert regression_form(NOMOTO.fix("T")).names == ("K",)
    assert regression_form(YAW).names == ("T", "K")


def test_parameters_outside_the_motion_are_named() -> None:
    """Free parameters of actuators and sensors are refused by name."""
    offset = Parameter("E_offset", 0.0, "rad")
    actuator = Actuator("offset", {"delta": "delta + E_offset"}, (offset,))
    with pytest.raises(ModelError, match=r"E_offset.*actuator signal"):
        regression_form(YAW + actuator)
    assert regression_form(YAW + replace(actuator, parameters=(replace(offset, fixed=True),)))
    bias = Parameter("E_bias", 0.0, "rad/s")
    with pytest.raises(ModelError, match=r"E_bias.*sensor"):
        regression_form(YAW + Sensor("bias", {"r": "r + E_bias"}, (bias,)))
    known = Parameter("E_bias", 0.1, "rad/s", fixed=True)
    with pytest.raises(ModelError, match=r"sensor effect 'bias'"):
        regression_form(YAW + Sensor("bias", {"r": "r + E_bias"}, (known,)))


def test_unmeasured_states_are_named() -> None:
    """A state in the equations that no output measures is an error that names it."""
    outputs = tuple(o for o in AUV.model.outputs if o.name != "w")
    with pytest.raises(ModelError, match="contain w, which no output measures"):
        EquationError().fit(replace(AUV.model, outputs=outputs), DATA)


def test_actuator_with_memory_feeds_the_regression() -> None:
    """A known lag of the actuator is simulated, so that the forces belong to the right time."""
    lag = Actuator(
        "lag",
        {"delta": "delta + (before - delta)*lag/h*(1 - exp(-h/lag))"},
        (Parameter("lag", 2.0, "s", fixed=True),),
        memory=(Memory("before", "delta + (before - delta)*exp(-h/lag)", "delta"),),
    )
    model = YAW + lag
    test = Experiment("test", Doublet("delta", 0.2, pulse_time=15.0), duration=60.0)
    data = Dataset((simulate(model, test, noise=False),))
    lagged = EquationError(rule="trapezoid").fit(model, data)
    ideal = EquationError(rule="trapezoid").fit(YAW, data)
    assert lagged.values["T"] == pytest.approx(10.0, rel=1e-3)
    assert abs(ideal.values["T"] - 10.0) > 0.3


def test_missing_samples_drop_rows_only() -> None:
    """Rows with a missing measurement are left out and the others still give the exact values."""
    holes = RECORD.outputs.copy()
    holes[40:45, 2] = np.nan
    data = Dataset((RECORD.with_outputs(holes),))
    rates = exact_rates(AUV.model, DATA)
    fit = EquationError(rule="exact", rates=rates).fit(AUV.model, data)
    assert max(map(abs, errors(fit).values())) < 1e-7
    rows = rows_of(regression_form(AUV.model), data, rule="simpson")
    assert np.isnan(rows.targets[0][38:45]).any(axis=1).all()
    assert np.isfinite(rows.targets[0][46:]).all()


def test_wrong_rates_are_refused() -> None:
    """Exact rates of another shape are an error that gives the expected one."""
    with pytest.raises(DataError, match=r"\(241, 6\)"):
        EquationError(rule="exact", rates={"zigzag_5_5": np.zeros((3, 3))}).fit(AUV.model, DATA)
    with pytest.raises(ModelError, match="belong together"):
        EquationError(rule="exact")


def test_local_cubic_is_exact_for_cubics() -> None:
    """Value and slope of a cubic are exact on uneven times, at the ends too."""
    t = np.sort(np.random.default_rng(0).uniform(0, 5, 30))
    x = np.column_stack([t**3 - t, 2 * t**2])
    values, slopes = local_cubic(t, x, 7)
    assert values == pytest.approx(x, abs=1e-9)
    assert slopes == pytest.approx(np.column_stack([3 * t**2 - 1, 4 * t]), abs=1e-7)


def test_priors_and_bounds_are_kept() -> None:
    """A tight prior wins over the data, and an estimate stays within its bounds."""
    believed = replace(
        AUV.model.parameter("Z_uuds_prime"), prior_mean=-0.05, prior_std=1e-9, scale=None
    )
    bounded = replace(AUV.model.parameter("Z_uq_prime"), upper=-0.1399, value=-0.2, lower=-1.0)
    model = AUV.model.with_parameter(believed).with_parameter(replace(bounded, upper=-0.15))
    fit = EquationError(rule="exact", rates=exact_rates(AUV.model, DATA)).fit(model, DATA)
    assert fit.values["Z_uuds_prime"] == pytest.approx(-0.05, rel=1e-4)
    assert fit.values["Z_uq_prime"] == pytest.approx(-0.15)


def test_total_least_squares_removes_the_bias_of_noisy_regressors() -> None:
    """With noise in all columns least squares is biased towards zero and total LS is not."""
    rng = np.random.default_rng(2)
    plain, total = [], []
    for _ in range(100):
        x = rng.standard_normal((400, 2))
        noisy = x + np.array([0.5, 0.0]) * rng.standard_normal(x.shape)
        y = x @ [1.0, 2.0] + 0.5 * rng.standard_normal(400)
        plain.append(np.linalg.lstsq(noisy, y, rcond=None)[0])
        total.append(generalised_tls(noisy, y, np.diag([0.25, 0.0, 0.25]))[0])
    assert np.mean(plain, axis=0)[0] < 0.85
    assert np.mean(total, axis=0) == pytest.approx([1.0, 2.0], abs=0.02)


def test_total_least_squares_equals_the_classical_solution() -> None:
    """With errors of one size in every column it is the last right singular vector."""
    rng = np.random.default_rng(3)
    x = rng.standard_normal((50, 3))
    y = x @ [1.0, -2.0, 0.5] + 0.1 * rng.standard_normal(50)
    x = x + 0.1 * rng.standard_normal(x.shape)
    v = np.linalg.svd(np.column_stack([x, y]))[2][-1]
    values, ratio = generalised_tls(x, y, 0.01 * np.eye(4))
    assert values == pytest.approx(-v[:3] / v[3])
    assert 0.3 < ratio < 3


def test_total_least_squares_on_a_noisy_record() -> None:
    """Over ten noisy records, the mean error of quadratic damping falls by more than half."""
    noise = 1e-2
    outputs = tuple(replace(o, noise_std=noise) if o.name == "r" else o for o in DAMPED_YAW.outputs)
    model = replace(DAMPED_YAW, outputs=outputs)
    test = replace(MULTISINE, sample_time=0.5, duration=300.0)
    found: dict[str, list[float]] = {"least squares": [], "total": []}
    ratios = []
    for seed in range(10):
        data = Dataset((simulate(model, test, rng=np.random.default_rng(seed)),))
        plain = EquationError(window=5).fit(model, data)
        total = TotalLeastSquares(window=5).fit(model, data)
        found["least squares"].append(plain.values["N_absrr"] / model.values["N_absrr"] - 1)
        found["total"].append(total.values["N_absrr"] / model.values["N_absrr"] - 1)
        ratios.append(total.extras["noise_ratio"]["r"])
    assert abs(np.mean(found["total"])) < 0.5 * abs(np.mean(found["least squares"]))
    # The stated noise, carried through derivatives and products, explains the misfit.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def test_shared_parameters_need_a_joint_solution() -> None:
    """Separate regressions refuse a parameter of two equations; equation error solves it."""
    both = Force("both", {"Z": "E_both*u**2", "M": "E_both*u**2"}, (Parameter("E_both", 0.0, "1"),))
    model = AUV.model + both
    with pytest.raises(ModelError, match=r"E_both appears in the equations of w and of q"):
        OnlineRegression().fit(model, DATA)
    fixed = model.fix("Z_uu_prime", "M_uu_prime")
    fit = EquationError(rule="exact", rates=exact_rates(AUV.model, DATA)).fit(fixed, DATA)
    assert fit.values["E_both"] == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(ModelError, match="appears in"):
        TotalLeastSquares().fit(model, DATA)


def test_missing_library_says_which_extra_to_install() -> None:
    """An optional library that is absent is reported with the command that installs it."""
    with pytest.raises(ModelError, match=r'pip install "oed_sysid\[baselines\]"'):
        library("no_such_library_anywhere", "A test", extra="baselines", error=ModelError)


TANKER = load_problem("online_ship")
ZIGZAG = simulate(TANKER.model, TANKER.experiment("zigzag_5_5"), noise=False)
SCRIPT_ONLINE = paper("online_ship")
FEATURES, TARGETS = SCRIPT_ONLINE.yaw_rows()


def gap(first: np.ndarray, second: np.ndarray) -> float:
    """Relative difference of two vectors."""
    return float(np.linalg.norm(first - second) / np.linalg.norm(second))


def taught(machine, features: np.ndarray = FEATURES, targets: np.ndarray = TARGETS):
    """A machine that begins with two samples and learns the others one by one."""
    machine.start(features[:2], targets[:2])
    for row, target in zip(features[2:], targets[2:], strict=True):
        machine.update(row, target)
    return machine


@pytest.mark.parametrize(
    ("method", "noise", "weight", "limit"),
    [
        ("cholesky", 0.0, 3e5, 1e-11),
        ("cholesky", 0.01, 3e5, 1e-11),
        ("inverse", 0.0, 3e5, 1e-8),
        ("inverse", 0.01, 3e5, 1e-8),
        ("inverse", 0.01, 1e3, 1e-11),
    ],
)
def test_incremental_equals_batch_at_every_step(
    method: str, noise: float, weight: float, limit: float
) -> None:
    """From two samples to two hundred the recursion equals the batch dual solution."""
    machine = IncrementalLSSVM(C=weight, method=method)
    assert SCRIPT_ONLINE.recursion_gap(machine, *SCRIPT_ONLINE.yaw_rows(noise)) < limit


@pytest.mark.parametrize("weight", [1e3, 3e5])
def test_primal_recursion_equals_batch_at_every_step(weight: float) -> None:
    """The recursion in the size of the features is the LS-SVM, from the second sample on."""
    machine = RecursiveLSSVM(C=weight)
    machine.start(FEATURES[:1], TARGETS[:1])
    assert machine.bias == pytest.approx(TARGETS[0])
    assert SCRIPT_ONLINE.recursion_gap(RecursiveLSSVM(C=weight), FEATURES, TARGETS) < 1e-11


@pytest.mark.parametrize(
    ("machine", "limit"),
    [
        (IncrementalLSSVM(C=3e5, window=60), 1e-9),
        (IncrementalLSSVM(C=3e5, window=60, method="inverse", refresh=10), 1e-5),
    ],
    ids=["cholesky", "inverse"],
)
def test_window_forgets_exactly(machine: IncrementalLSSVM, limit: float) -> None:
    """After any number of slides the machine equals a batch over the last sixty samples."""
    machine.start(FEATURES[:2], TARGETS[:2])
    worst = 0.0
    for k in range(2, len(TARGETS)):
        machine.update(FEATURES[k], TARGETS[k])
        if k >= 60:
            window = slice(k - 59, k + 1)
            batch = train(FEATURES[window], TARGETS[window], C=3e5)
            worst = max(worst, gap(machine.coefficients, batch.coefficients))
    assert machine.n_samples == 60
    assert worst < limit


def test_incremental_learns_any_kernel() -> None:
    """With an RBF kernel the recursion predicts as the batch does."""
    x = np.linspace(0, 6, 50)[:, None]
    kernel = partial(gaussian, width=0.8)
    machine = taught(IncrementalLSSVM(C=100.0, kernel=kernel), x, np.sin(x[:, 0]))
    batch = train(x, np.sin(x[:, 0]), C=100.0, kernel=kernel, form="dual")
    assert machine.predict(x + 0.05) == pytest.approx(batch.predict(x + 0.05), abs=1e-9)
    with pytest.raises(ModelError, match="linear kernel"):
        _ = machine.coefficients


def test_primal_state_does_not_grow() -> None:
    """What the recursion keeps has the size of the features, however many samples came."""
    rng = np.random.default_rng(1)
    x, y = rng.standard_normal((3000, 6)), rng.standard_normal(3000)
    machine = taught(RecursiveLSSVM(C=1e3), x, y)
    assert machine.n_samples == 3000
    assert machine.inverse.shape == (7, 7)


# Printed by an independent program, per cent, after 60 and after 200 samples.
INDEPENDENT_ONLINE = PUBLISHED["tanker"]


@pytest.mark.parametrize("rule", INDEPENDENT_ONLINE)
def test_error_table_of_the_tanker(rule: str) -> None:
    """Errors of the six coefficients equal those of an independent program at both lengths."""
    fit = OnlineRegression(C=3e5, rule=rule).fit(TANKER.model, Dataset((ZIGZAG,)))
    names = ("Y_v", "Y_r", "N_v", "N_r", "Y_delta", "N_delta")
    early, late = INDEPENDENT_ONLINE[rule]
    for name, at_60, at_200 in zip(names, early, late, strict=True):
        truth, track = TANKER.truth[name], fit.extras["history"][name]
        assert 100 * (track[59] / truth - 1) == pytest.approx(at_60, abs=2e-3)
        assert 100 * (fit.values[name] / truth - 1) == pytest.approx(at_200, abs=2e-3)


def test_stream_gives_the_rows_of_the_batch() -> None:
    """Samples pushed one by one give the rows that the whole record gives."""
    stream = EquationStream(TANKER.model, rule="trapezoid")
    rows = []
    for k, moment in enumerate(ZIGZAG.times):
        sample = {"delta": ZIGZAG.input("delta")[k]}
        sample |= {name: ZIGZAG.output(name)[k] for name in ("v", "r", "psi")}
        rows += [row for row in stream.push(float(moment), sample) if row.equation == "r"]
    assert stream.names("r") == ("N_v", "N_r", "N_delta")
    assert np.array([row.features for row in rows]) == pytest.approx(FEATURES)
    assert np.array([row.target for row in rows]) == pytest.approx(TARGETS)


def test_stream_skips_missing_and_refuses_impossible_samples() -> None:
    """A missing output gives no row; a missing command or a clock set back is an error."""
    stream = EquationStream(TANKER.model, rule="euler")
    whole = {"delta": 0.1, "v": 0.0, "r": 0.0}
    assert stream.push(0.0, whole) == []
    assert stream.push(3.0, {"delta": 0.1, "v": np.nan, "r": 0.0}) == []
    with pytest.raises(ModelError, match="has no delta"):
        stream.push(6.0, {"v": 0.0, "r": 0.0})
    with pytest.raises(ModelError, match="not later"):
        stream.push(3.0, whole)


def test_forgetting_equals_weighted_least_squares() -> None:
    """With forgetting the recursion is least squares with weights that decay."""
    rng = np.random.default_rng(4)
    x, y = rng.standard_normal((300, 3)), rng.standard_normal(300)
    filter_ = RecursiveLeastSquares(np.zeros(3), std=1e4, forgetting=0.97)
    filter_.start(x, y)
    root = 0.97 ** (np.arange(300)[::-1] / 2)
    batch = np.linalg.lstsq(x * root[:, None], y * root, rcond=None)[0]
    assert filter_.coefficients == pytest.approx(batch, abs=1e-6)


def test_forgetting_without_excitation_stays_bounded() -> None:
    """Zero features for a long time do not blow the covariance up without limit."""
    filter_ = RecursiveLeastSquares(np.zeros(2), std=1.0, forgetting=0.9, largest_std=100.0)
    for _ in range(2000):
        filter_.update(np.zeros(2), 0.0)
    assert np.trace(filter_.inverse) <= 2 * 100.0**2 * (1 + 1e-9)


def test_machines_must_learn_before_they_tell() -> None:
    """A machine that has seen nothing says what to call."""
    for machine in (IncrementalLSSVM(), RecursiveLSSVM()):
        with pytest.raises(ModelError, match="learnt nothing"):
            _ = machine.bias


def test_published_recursion_warns_when_its_digits_are_lost() -> None:
    """With a weight beyond its digits the inverse warns and errs; Cholesky is silent and right."""
    first, second = (
        taught(IncrementalLSSVM(C=1e14, method=way)) for way in ("inverse", "cholesky")
    )
    batch = train(FEATURES, TARGETS, C=1e14)
    with pytest.warns(PrecisionWarning, match="lost its digits"):
        lost = gap(first.coefficients, batch.coefficients)
    assert first.residual > 1e-3
    assert lost > 1e-3
    assert second.residual < 1e-3
    assert gap(second.coefficients, batch.coefficients) < 1e-3


def test_published_recursion_is_silent_where_it_is_sound() -> None:
    """At the published weight the residual is rounding, and nothing is said."""
    machine = taught(IncrementalLSSVM(C=3e5, method="inverse"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        coefficients = machine.coefficients
    assert machine.residual < 1e-6
    assert gap(coefficients, train(FEATURES, TARGETS, C=3e5).coefficients) < 1e-7


# Sway and yaw of a ship of 60 m at 6 m/s, per unit of mass and of inertia.
TRUTH = {
    "Y_v": -0.09, "Y_r": -2.2, "Y_d": 0.12,
    "N_v": -0.0012, "N_r": -0.16, "N_d": -0.011,
}  # fmt: skip
SAMPLING = 0.5


def ship(values: dict[str, float] | None = None) -> Model:
    """Linear sway and yaw; start values are far off."""
    values = values or {name: 0.5 * value for name, value in TRUTH.items()}
    units = ("1/s", "m/s", "m/s^2", "1/(m s)", "1/s", "1/s^2")
    free = [Parameter(*one, unit) for one, unit in zip(values.items(), units, strict=True)]
    return small(
        "ship",
        "v [m/s], r [rad/s] <- d [rad]",
        noise={"v": 0.02, "r": 0.0005},
        axes={"Y": "v", "N": "r"},
        inertia={("Y", "v"): "1", ("N", "r"): "1"},
        effects=(
            Force("sway", {"Y": "Y_v*v + Y_r*r + Y_d*d"}, free[:3]),
            Force("yaw", {"N": "N_v*v + N_r*r + N_d*d"}, free[3:]),
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
    lift = np.array([0.06, 0.0025]) * waves * np.sqrt(2 / 60)
    # Waves at samples times how far they turn from there on: sums of sines at every step.
    within = np.exp(1j * np.outer(omega, np.arange(fine) * h))
    begun = np.exp(1j * (np.outer(np.arange(n) * SAMPLING, omega) + phase[:, None]))
    force = lift[:, None] * (begun @ within).real.reshape(2, -1)
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


def errors_fourier(values: dict[str, float]) -> np.ndarray:
    """Relative errors of all coefficients."""
    return np.array([abs(values[name] / value - 1) for name, value in TRUTH.items()])


def pushed(stream: FourierStream, record: Record, sway: np.ndarray | None = None) -> None:
    """Give a record to a stream sample by sample, maybe with another speed of sway."""
    v = record.output("v") if sway is None else sway
    for t, d, own, r in zip(record.times, record.inputs[:, 0], v, record.output("r"), strict=True):
        stream.push(t, {"d": d, "v": own, "r": r})


def test_without_noise_the_coefficients_come_out() -> None:
    """Differences in a band far below the sampling are rates."""
    fit = FourierRegression().fit(ship(), Dataset((sailed(0, 0.0, 0.0),)))
    assert errors_fourier(dict(fit.values)).max() < 0.02


@pytest.mark.parametrize(
    ("waves", "noise", "share", "limit"),
    [(1.0, 1.0, 0.5, 0.08), (0.0, 8.0, 1 / 3, np.inf)],
    ids=["swell that is not named", "noisy regressors"],
)
def test_neither_swell_nor_noise_of_the_regressors_counts(
    waves: float, noise: float, share: float, limit: float
) -> None:
    """In the geometric mean half, or a third, of the error of regression on differences."""
    runs = [Dataset((sailed(seed, waves, noise),)) for seed in range(4)]
    found, differences = (
        np.mean([np.log(errors_fourier(dict(one.fit(ship(), run).values))) for run in runs])
        for one in (FourierRegression(), EquationError())
    )
    assert found < np.log(limit)
    assert found < differences + np.log(share)


def test_errors_are_those_that_are_stated() -> None:
    """Scores are standard normal in white noise and swell, over seeds and coefficients."""
    scores = []
    for seed in range(4):
        fit = FourierRegression().fit(ship(), Dataset((sailed(seed),)))
        scores += [(fit.values[n] - value) / fit.std_errors[n] for n, value in TRUTH.items()]
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 2.0


def test_the_stream_ends_at_the_estimate_of_the_log() -> None:
    """Sample by sample the same sums, and the same estimates and errors."""
    record = sailed(1)
    band = (0.002, 0.08)
    fit = FourierRegression(band).fit(ship(), Dataset((record,)))
    stream = FourierStream(ship(), duration=600.0, period=SAMPLING, band=band)
    pushed(stream, record)
    for name, value in stream.values.items():
        assert value == pytest.approx(fit.values[name], rel=1e-9)
        share = stream.relative_errors[name] * abs(value)
        assert share == pytest.approx(fit.std_errors[name], rel=1e-6)
    assert stream.n_samples == len(record.times)


@pytest.mark.slow
def test_four_runs_tell_more_than_one() -> None:
    """Runs add up; four have half the errors of one."""
    stream = FourierStream(ship(), duration=600.0, period=SAMPLING, band=(0.002, 0.08))
    told = []
    for seed in range(4):
        pushed(stream, sailed(seed))
        told.append(np.mean(np.log(list(stream.relative_errors.values()))))
        stream.start()
    assert told[3] < told[0] + np.log(0.7)


def test_half_a_run_claims_no_more_than_it_knows() -> None:
    """Frequencies of a run that goes on count by how much of it is over."""
    stream = FourierStream(ship(), duration=600.0, period=SAMPLING, band=(0.002, 0.08))
    pushed(stream, part(sailed(3), np.s_[:300]))
    errors_now, values = stream.relative_errors, stream.values
    score = [(values[n] / v - 1) / errors_now[n] * abs(v / values[n]) for n, v in TRUTH.items()]
    assert np.sqrt(np.mean(np.square(score))) < 2.5
    assert stream.advice(1e-3).startswith("go on")
    assert stream.advice(100.0).startswith("enough")


def test_coherence_says_what_answers() -> None:
    """A response that the rudder moves is coherent with it, one of noise alone is not."""
    record = sailed(2)
    stream = FourierStream(ship(), duration=600.0, period=SAMPLING, band=(0.0, 0.05))
    pushed(stream, record, 0.02 * np.random.default_rng(0).standard_normal(len(record.times)))
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
