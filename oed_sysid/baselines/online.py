"""Estimation on board: one sample at a time, at a known cost per sample.

============================  ========================================================
:class:`IncrementalLSSVM`     LS-SVM grown by one sample by the bordering recursion
:class:`RecursiveLSSVM`       the same solution in the size of the features, flat cost
:class:`RecursiveLeastSquares`  with exponential forgetting
:class:`EquationStream`       from a model and samples to features and targets
:class:`KalmanStream`         states and parameters together, by Kalman filter
:class:`OnlineRegression`     all of this behind the interface of the estimators
============================  ========================================================
"""

from oed_sysid.baselines.machines import (
    IncrementalLSSVM,
    OnlineRegression,
    RecursiveLeastSquares,
    RecursiveLSSVM,
)
from oed_sysid.baselines.streams import EquationStream, KalmanStream

__all__ = [
    "EquationStream",
    "IncrementalLSSVM",
    "KalmanStream",
    "OnlineRegression",
    "RecursiveLSSVM",
    "RecursiveLeastSquares",
]
