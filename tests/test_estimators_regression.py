"""Regressions on the equations of motion: form, derivatives, published error tables."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simple_models import NOMOTO
from test_estimators import TEST as MULTISINE
from test_estimators import YAW as DAMPED_YAW

from benchmarks.documents.published import paper
from benchmarks.documents.published.auv import exact_errors
from oed_sysid import (
    Dataset,
    Experiment,
    Force,
    Input,
    Model,
    Output,
    Parameter,
    State,
    load_problem,
)
from oed_sysid.baselines import EquationError, LeastSquaresSVM, SupportVectorRegression
from oed_sysid.baselines.equations import (
    exact_rates,
    local_cubic,
    regression_form,
    rows_of,
)
from oed_sysid.baselines.least_squares import (
    TotalLeastSquares,
    generalised_tls,
    is_linear,
)
from oed_sysid.baselines.population import optional
from oed_sysid.baselines.support_vectors import GaussianKernel, train
from oed_sysid.errors import DataError, ModelError
from oed_sysid.experiments.manoeuvres import Doublet
from oed_sysid.experiments.simulation import simulate
from oed_sysid.physics import Actuator, Memory, Sensor

AUV = load_problem("auv_diving_plane")
RECORD = simulate(AUV.model, AUV.experiment("zigzag_5_5"), noise=False)
DATA = Dataset((RECORD,))
SCRIPT = paper("auv_diving_plane")

YAW = Model(
    "yaw",
    (State("r", "rad/s"),),
    (Input("delta", "rad"),),
    (Output("r", "rad/s", noise_std=1e-3),),
    axes={"N": "r"},
    inertia={("N", "r"): "T"},
    effects=(Force("turn", {"N": "K*delta - r"}, (Parameter("K", 0.1, "1/s"),)),),
    parameters=(Parameter("T", 10.0, "s"),),
)


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
INDEPENDENT = {
    "simpson": {
        "X_qq": 0.0,
        "X_wq": -0.01,
        "Z_uu": -1.85,
        "Z_uw": 0.24,
        "Z_uabsw": 36.55,
        "Z_absww": -0.18,
        "Z_uq": -0.44,
        "Z_wabsq": -185.68,
        "Z_uuds": -0.72,
        "M_uu": 0.24,
        "M_uw": -1.79,
        "M_uabsw": 43.92,
        "M_absww": 752.54,
        "M_uq": -0.63,
        "M_uuds": -0.61,
        "z_BB": -0.72,
    },
    "trapezoid": {"X_qq": 0.99, "X_wq": 0.43, "X_ww": -0.72, "Z_absww": 97.94, "z_BB": -0.39},
    "euler": {"X_qq": 13.61, "X_ww": -17.52, "Z_uw": 14.11, "Z_wabsq": -3953.51, "z_BB": -10.06},
}


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
    assert gaps["dimensionless"] < 1e-9
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


def test_gaussian_kernel_learns_a_curve() -> None:
    """The RBF machine predicts a sine between its samples and has no coefficients."""
    x = np.linspace(0, 6, 40)[:, None]
    machine = train(x, np.sin(x[:, 0]), C=1e6, kernel=GaussianKernel(1.0), form="dual")
    between = x[:-1] + 0.05
    assert machine.predict(between) == pytest.approx(np.sin(between[:, 0]), abs=1e-3)
    assert machine.coefficients is None
    with pytest.raises(ModelError, match="linear kernel"):
        train(x, x[:, 0], C=1.0, kernel=GaussianKernel(1.0))


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
    assert not is_linear(NOMOTO)
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
        LeastSquaresSVM().fit(model, DATA)
    fixed = model.fix("Z_uu_prime", "M_uu_prime")
    fit = EquationError(rule="exact", rates=exact_rates(AUV.model, DATA)).fit(fixed, DATA)
    assert fit.values["E_both"] == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(ModelError, match="appears in"):
        TotalLeastSquares().fit(model, DATA)


def test_missing_library_says_which_extra_to_install() -> None:
    """An optional library that is absent is reported with the command that installs it."""
    with pytest.raises(ModelError, match=r"pip install 'oed-sysid\[baselines\]'"):
        optional("no_such_library_anywhere", "nothing", wanted_by="A test")
