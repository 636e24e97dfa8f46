"""Estimators: from a model and measured records to a :class:`~oed_sysid.likelihood.fit.Fit`."""

from oed_sysid.baselines.fourier import FourierRegression, FourierStream
from oed_sysid.baselines.gibbs import GibbsRegression
from oed_sysid.baselines.kalman import JointKalmanFilter
from oed_sysid.baselines.least_squares import (
    EquationError,
    HeadingDifferences,
    TotalLeastSquares,
)
from oed_sysid.baselines.online import (
    EquationStream,
    IncrementalLSSVM,
    OnlineRegression,
    RecursiveLeastSquares,
    RecursiveLSSVM,
)
from oed_sysid.baselines.output_error import OutputError
from oed_sysid.baselines.population import (
    CovarianceMatrixAdaptation,
    DifferentialEvolution,
    DifferentialSwarm,
    ParticleSwarm,
)
from oed_sysid.baselines.support_vectors import LeastSquaresSVM, SupportVectorRegression
from oed_sysid.likelihood.estimator import Estimator, Solver
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.multistart import Multistart, Profile, profile
from oed_sysid.runtime.version import exported

__all__ = exported(globals())
