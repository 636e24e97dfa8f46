"""Every baseline keeps the contract of estimators, to the accuracy that it promises."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from oed_sysid import Experiment, Force, Input, Model, Output, Parameter, State
from oed_sysid.baselines import (
    CovarianceMatrixAdaptation,
    DifferentialEvolution,
    DifferentialSwarm,
    EquationError,
    GibbsRegression,
    JointKalmanFilter,
    LeastSquaresSVM,
    OnlineRegression,
    OutputError,
    ParticleSwarm,
    SupportVectorRegression,
    TotalLeastSquares,
)
from oed_sysid.experiments.manoeuvres import Multisine
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.multistart import Multistart
from oed_sysid.testing import check_estimator

YAW = Model(
    "yaw",
    (State("psi", "rad"), State("r", "rad/s", scale=0.1)),
    (Input("delta", "rad", interpolation="linear"),),
    (Output("psi", "rad", noise_std=2e-3), Output("r", "rad/s", noise_std=1e-3)),
    kinematics={"psi": "r"},
    axes={"N": "r"},
    inertia={("N", "r"): "I"},
    effects=(
        Force(
            "hull",
            {"N": "N_r*r + N_absrr*r*abs(r) + N_delta*delta"},
            (
                Parameter("N_r", -1.0, "N m s", lower=-3.0, upper=0.0),
                Parameter("N_absrr", -4.0, "kg m^2", lower=-10.0, upper=0.0),
                Parameter("N_delta", 0.8, "N m", lower=0.0, upper=3.0),
            ),
        ),
    ),
    parameters=(Parameter("I", 5.0, "kg m^2", fixed=True),),
)
TEST = Experiment(
    "multisine", Multisine("delta", (0.02, 0.05, 0.1, 0.16), amplitudes=(0.2,) * 4), duration=80.0
)

# Estimator, accuracy without noise, coverage promised (None: intervals exclude a stated bias).
# Differences of a rudder that has corners at the samples are good to a thousandth, local
# cubics smear more; the others simulate.
CASES = [
    (MultipleShooting(), 1e-6, 0.85, 10),
    (OutputError(), 1e-6, 0.85, 10),
    (Multistart(n_starts=3, n_jobs=1), 1e-6, None, 0),
    (JointKalmanFilter(), 1e-4, 0.85, 10),
    (JointKalmanFilter(kind="unscented"), 1e-3, 0.8, 4),
    (EquationError(rule="simpson"), 5e-3, 0.85, 10),
    (EquationError(window=9), 5e-3, None, 0),
    (TotalLeastSquares(window=9), 5e-3, None, 0),
    (LeastSquaresSVM(C=1e8), 5e-3, 0.85, 10),
    (SupportVectorRegression(), 1e-2, None, 0),
    (OnlineRegression(C=1e8), 5e-3, 0.85, 5),
    (OnlineRegression(C=1e8, method="incremental"), 5e-3, None, 0),
    (OnlineRegression(C=1e8, method="incremental", window=200), 5e-3, None, 0),
    (OnlineRegression(C=1e8, window=400), 5e-3, None, 0),
    (OnlineRegression(method="forgetting", forgetting=0.998), 5e-3, None, 0),
    (GibbsRegression(rule="simpson", n_draws=300), 5e-3, None, 0),
    (GibbsRegression(rule="simpson", n_draws=2000, draw="coordinate"), 1e-2, None, 0),
    (DifferentialSwarm(n_particles=40, n_generations=120), 1e-3, None, 0),
    (DifferentialEvolution(n_particles=30, n_generations=80), 1e-3, None, 0),
    (CovarianceMatrixAdaptation(n_generations=120), 1e-3, None, 0),
    (ParticleSwarm(n_particles=30, n_generations=80), 1e-2, None, 0),
]


@pytest.mark.parametrize(
    ("estimator", "tolerance", "coverage", "n_repeats"),
    CASES,
    ids=[f"{type(case[0]).__name__}-{i}" for i, case in enumerate(CASES)],
)
def test_contract(
    estimator: object, tolerance: float, coverage: float | None, n_repeats: int
) -> None:
    """It finds the truth without noise, covers it with noise, and changes nothing."""
    check_estimator(
        estimator,  # type: ignore[arg-type]
        YAW,
        (TEST,),
        rng=np.random.default_rng(7),
        tolerance=tolerance,
        coverage=coverage,
        n_repeats=n_repeats,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "estimator",
    [
        DifferentialSwarm(n_particles=40, n_generations=120),
        DifferentialEvolution(n_particles=30, n_generations=80),
        CovarianceMatrixAdaptation(n_generations=120),
    ],
    ids=lambda estimator: type(estimator).__name__,
)
def test_searches_cover_the_truth(estimator: object) -> None:
    """Intervals of the population searches hold the truth over noise realisations."""
    check_estimator(
        estimator,  # type: ignore[arg-type]
        YAW,
        (TEST,),
        rng=np.random.default_rng(8),
        coverage=0.85,
        n_repeats=12,
    )


@dataclass(frozen=True)
class Shifted:
    """An estimator that breaks one promise on purpose."""

    fault: str
    name: str = "shifted"

    def fit(self, model: Model, dataset: object) -> Fit:
        """Fit well, then spoil it."""
        fit = MultipleShooting().fit(model, dataset)  # type: ignore[arg-type]
        if self.fault == "value":
            return replace(fit, estimates=1.01 * fit.estimates)
        if self.fault == "errors":
            return replace(fit, covariance=1e-4 * fit.covariance)
        if self.fault == "random":
            noise = 1e-9 * np.random.default_rng().standard_normal(len(fit.estimates))
            return replace(fit, estimates=fit.estimates + noise)
        return replace(fit, names=fit.names[::-1])


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("value", "is off by"),
        ("errors", "intervals hold the truth"),
        ("random", "two results"),
        ("names", "returns"),
    ],
)
def test_contract_finds_broken_promises(fault: str, message: str) -> None:
    """The check fails, with the right words, for an estimator that breaks a promise."""
    with pytest.raises(AssertionError, match=message):
        check_estimator(Shifted(fault), YAW, (TEST,), rng=np.random.default_rng(1), n_repeats=5)
