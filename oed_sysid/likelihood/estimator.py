"""What every estimator is: an immutable set of choices with one verb, ``fit``.

Options of estimators: numbers that are numbers, before any work is done.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
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
    """Contract of estimators; :func:`oed_sysid.testing.check_estimator` tests it.

    Examples
    --------
    >>> from oed_sysid import MultipleShooting
    >>> isinstance(MultipleShooting(), Estimator), MultipleShooting().name
    (True, 'multiple shooting')
    """

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        ...

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate the free parameters of a model from measured records."""
        ...


@dataclass(frozen=True)
class Solver:
    """How the optimum of an estimation is sought.

    Parameters
    ----------
    method : str
        ``"gauss-newton"``; or ``"ipopt"``, which goes on from its end and takes constraints.
    max_iterations : int
        Most iterations.
    tolerance : float
        Gain of a full step below which the cost is least; see
        :func:`oed_sysid.likelihood.gauss_newton.solve`.
    constraints : sequence of str
        For IPOPT, in SI units: comparisons among parameters, ``"M_uq < 0"`` or
        ``"Y_v*N_r > N_v*Y_r"``; of predicted outputs along every record, ``"z < 25"``, and at its
        ends, ``"start(theta) == 0"``, ``"end(u) > 1.5"``. Those that bind are a concern of the fit,
        and standard errors know of them.

    Examples
    --------
    >>> Solver("ipopt", constraints=["K > 0"]).constraints
    ['K > 0']
    """

    method: str = "gauss-newton"
    _: KW_ONLY
    max_iterations: int = 100
    tolerance: float = 1e-6
    constraints: Sequence[str] = ()

    def __post_init__(self) -> None:
        check_choice("Solver", self.method, ("gauss-newton", "ipopt"))
        if self.constraints and self.method != "ipopt":
            raise ModelError(
                "Constraints among parameters need Solver('ipopt'); bounds of single parameters "
                "do not: give them as Parameter(lower=..., upper=...)."
            )
        check_count("max_iterations", self.max_iterations)
        check_positive("tolerance", self.tolerance, "Give a positive number.")


def check_choice(name: str, value: str, options: Iterable[str]) -> None:
    """Raise :class:`ModelError` for a setting that is none of the options."""
    if value not in options:
        raise ModelError(f"{name} is {value!r}. Choose one of {', '.join(options)}.")


def check_count(name: str, value: Any, least: int = 1) -> None:
    """Raise :class:`ModelError` where an option is no whole number from the least on."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < least:
        raise ModelError(f"{name} is {value!r}. Give a whole number, {least} or more.")


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
        listed = not isinstance(value, str | Mapping) and np.asarray(value, dtype=float).ndim == 1
    except (TypeError, ValueError):
        listed = False
    if not listed and not (isinstance(value, str) and value in words):
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
    if any(isinstance(one, Sea) and one.records for one in given):
        raise ModelError("An estimation tells which records meet a sea of their own. Name none.")
