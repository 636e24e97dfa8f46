"""What every estimator is: an immutable set of choices with one verb, ``fit``."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.model import Model


@runtime_checkable
class Estimator(Protocol):
    """Contract of estimators; :func:`oed_sysid.testing.check_estimator` tests it."""

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        ...

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate the free parameters of a model from measured records."""
        ...
