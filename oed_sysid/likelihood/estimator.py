"""What every estimator is: an immutable set of choices with one verb, ``fit``.

Options of estimators: numbers that are numbers, before any work is done.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from typing import Any, Protocol, runtime_checkable

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.noise_model import Sea
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


def check_count(name: str, value: Any) -> None:
    """Raise :class:`ModelError` where an option is no whole number from one on."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < 1:
        raise ModelError(f"{name} is {value!r}. Give a whole number, 1 or more.")


def check_positive(name: str, value: Any, advice: str, *, infinite: bool = False) -> None:
    """Raise :class:`ModelError` where an option is no number above zero.

    Parameters
    ----------
    name : str
    value : object
    advice : str
        What to give.
    infinite : bool
        Whether infinity is allowed.

    Examples
    --------
    >>> check_positive("tolerance", 1e-6, "Give a positive number.")
    """
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not (number and value > 0 and (infinite or np.isfinite(value))):
        raise ModelError(f"{name} is {value!r}. {advice}")


def check_levels(value: Any) -> None:
    """Raise :class:`ModelError` where noise is no word and no sequence of numbers."""
    words = ("auto", "given", "estimate")
    try:
        known = value in words if isinstance(value, str) else not isinstance(value, Mapping)
        if known and not isinstance(value, str):
            known = np.asarray(value, dtype=float).ndim == 1
    except (TypeError, ValueError):
        known = False
    if not known:
        raise ModelError(
            f"noise is {value!r}. Choose auto, given, estimate or a list of levels, one per output."
        )


def check_disturbances(value: Any) -> None:
    """Raise :class:`ModelError` where disturbances are no word, no sea and no sequence of these."""
    given = [value] if isinstance(value, Sea) else value
    listed = isinstance(given, Sequence) and all(isinstance(one, str | Sea) for one in given)
    if not listed:
        raise ModelError(
            f"disturbances is {value!r}. Choose auto, none, all or the equations that are "
            "disturbed, such as ('Z', 'M') or Sea(period=8.0)."
        )
    if sum(isinstance(one, Sea) for one in given) > 1:
        raise ModelError("One sea can be declared for an estimation. Name the one that dominates.")
