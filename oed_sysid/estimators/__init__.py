"""Estimators: from a model and measured records to a :class:`~oed_sysid.fit.Fit`."""

from oed_sysid.estimators.base import Estimator
from oed_sysid.estimators.multiple_shooting import MultipleShooting

__all__ = ["Estimator", "MultipleShooting"]
