"""Estimators: from a model and measured records to a :class:`~oed_sysid.fitting.fit.Fit`."""

from oed_sysid.estimators.base import Estimator
from oed_sysid.estimators.baselines.gibbs import GibbsRegression
from oed_sysid.estimators.baselines.least_squares import (
    EquationError,
    HeadingDifferences,
    TotalLeastSquares,
)
from oed_sysid.estimators.baselines.population import (
    CovarianceMatrixAdaptation,
    DifferentialEvolution,
    DifferentialSwarm,
    ParticleSwarm,
)
from oed_sysid.estimators.baselines.support_vectors import LeastSquaresSVM, SupportVectorRegression
from oed_sysid.estimators.kalman import JointKalmanFilter
from oed_sysid.estimators.multiple_shooting import MultipleShooting
from oed_sysid.estimators.multistart import Multistart
from oed_sysid.estimators.online import (
    EquationStream,
    IncrementalLSSVM,
    OnlineRegression,
    RecursiveLeastSquares,
    RecursiveLSSVM,
)
from oed_sysid.estimators.output_error import OutputError
from oed_sysid.estimators.profile import Profile, profile

__all__ = [
    "Estimator",
    "MultipleShooting",
    "Multistart",
    "Profile",
    "profile",
    "OutputError",
    "EquationError",
    "TotalLeastSquares",
    "LeastSquaresSVM",
    "SupportVectorRegression",
    "HeadingDifferences",
    "GibbsRegression",
    "OnlineRegression",
    "EquationStream",
    "IncrementalLSSVM",
    "RecursiveLSSVM",
    "RecursiveLeastSquares",
    "JointKalmanFilter",
    "DifferentialSwarm",
    "DifferentialEvolution",
    "CovarianceMatrixAdaptation",
    "ParticleSwarm",
]
