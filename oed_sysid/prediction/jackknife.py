r"""Estimates, and whatever follows from them, without each record in turn.

With the estimates (or predictions) :math:`q_{(i)}` from all records but the *i*-th,

.. math::
    \operatorname{var} q = \frac{n-1}{n} \sum_i (q_{(i)} - \bar q)^2, \qquad
    \bar q = \frac1n \sum_i q_{(i)},

and an interval is :math:`q \pm t_{n-1} \sqrt{\operatorname{var} q}` with Student's quantile. What
differs from record to record and no parameter says, missing structure among it, is in it; an error
that all records share, or that of a prior, is not. Every fit of four records or more has the same
to first order at no cost (:mod:`oed_sysid.likelihood.between_records`); refits hold what is
nonlinear as well.

References
----------
Efron & Stein (1981), The jackknife estimate of variance, Ann. Statist. 9: on average it does not
understate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError, OedSysidError
from oed_sysid.likelihood.estimator import Estimator
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import Report, Section, Table, as_text, digits, rounded

Purpose = Callable[[Fit], Mapping[str, float]]
# With two, one difference would have to tell how much differences scatter.
FEWEST = 3


@dataclass(frozen=True, eq=False)
class Jackknife:
    """Quantities with the errors that records show apart from one another.

    Attributes
    ----------
    names : tuple of str
        Of the quantities.
    values : ndarray (n_quantities,)
        From all records.
    without : mapping of str to ndarray (n_quantities,)
        From all records but one, by its name; where that fit failed, the record is not there.
    n_records : int
    """

    names: tuple[str, ...]
    values: np.ndarray
    without: Mapping[str, np.ndarray]
    n_records: int

    @property
    def freedom(self) -> int:
        """Degrees of freedom: one less than fits that succeeded."""
        return len(self.without) - 1

    @property
    def std_errors(self) -> dict[str, float]:
        """Standard error by name; infinite where fewer than two fits succeeded."""
        if self.freedom < 1:
            return dict.fromkeys(self.names, math.inf)
        table = np.array(list(self.without.values()))
        n = len(table)
        squares = np.sum((table - table.mean(axis=0)) ** 2, axis=0)
        return dict(zip(self.names, map(float, np.sqrt((n - 1) / n * squares)), strict=True))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of one quantity, of Student's distribution."""
        value = float(self.values[self.names.index(name)])
        if self.freedom < 1:
            return -math.inf, math.inf
        half = float(stdtrit(self.freedom, 0.5 + level / 2)) * self.std_errors[name]
        return value - half, value + half

    def document(self) -> Report:
        """Return quantities, intervals and what moved them most, as a table."""
        lost = self.n_records - len(self.without)
        title = f"jackknife over {self.n_records} records"
        if lost:
            title += f"; {lost} of the fits without one record failed and are not counted"
        rows = []
        for column, name in enumerate(self.names):
            low, high = self.interval(name)
            half = 0.5 * (high - low)
            moved = {record: row[column] for record, row in self.without.items()}
            worst = max(moved, key=lambda record: abs(moved[record] - self.values[column]))
            shown = (rounded(one, half) for one in (self.values[column], low, high, moved[worst]))
            value, lower, upper, to = shown
            error = digits(self.std_errors[name], 2)
            rows.append((name, value, error, f"{lower} to {upper}", worst, to))
        headers = (
            "quantity", "value", "std. error", "95 % interval", "moves most without", "to",
        )  # fmt: skip
        table = Table(headers, rows, words=(4,))
        return Report(title, sections=(Section("Quantities", tables=(table,), indent=2),))

    report = as_text


def jackknife(
    estimator: Estimator,
    model: Model,
    dataset: Dataset,
    *,
    purpose: Purpose | None = None,
) -> Jackknife:
    """Fit all records, then all but each, and tell how much that moves what is wanted.

    Parameters
    ----------
    estimator : Estimator
        Such as :class:`~oed_sysid.likelihood.multiple_shooting.MultipleShooting`.
    model : Model
        Its values are the start values of every fit.
    dataset : Dataset
        Three records or more, independent of one another.
    purpose : callable, optional
        ``fit -> {name: number}``, such as
        ``lambda fit: turning_circle(fit, ...).quantities()``; by default the parameters.

    Returns
    -------
    Jackknife

    Raises
    ------
    DataError
        If there are fewer than three records.
    ModelError
        If the fit of all records does not give the quantities.

    Examples
    --------
    Runs of a body whose drag differs by a tenth from run to run, each measured well:

    >>> from oed_sysid import Force, MultipleShooting, Output, Parameter, Record, State
    >>> drag = Force("drag", {"X": "-k*u"}, (Parameter("k", 2.0, "kg/s"),))
    >>> body = Model("body", (State("u", "m/s"),), (), (Output("u", "m/s", noise_std=0.001),),
    ...     axes={"X": "u"}, inertia={("X", "u"): "10"}, effects=(drag,))
    >>> rng, times = np.random.default_rng(0), np.arange(0.0, 10.0, 0.2)
    >>> runs = [
    ...     Record(f"run {i}", times, np.empty((50, 0)),
    ...         np.exp(-k * times / 10)[:, None] + 0.001 * rng.standard_normal((50, 1)),
    ...         body.channels)
    ...     for i, k in enumerate((1.8, 1.9, 2.0, 2.1, 2.2))
    ... ]
    >>> shooting = MultipleShooting(disturbances="none")
    >>> found = jackknife(shooting, body, Dataset(tuple(runs)))
    >>> stated = shooting.fit(body, Dataset(tuple(runs))).information.std_errors[0]
    >>> print(f"{found.std_errors['k']:.3f} and, of residuals as white noise, {stated:.4f}")
    0.071 and, of residuals as white noise, 0.0006
    """
    return leave_out(lambda data: estimator.fit(model, data), dataset, purpose)


def leave_out(
    fitted: Callable[[Dataset], Fit], dataset: Dataset, purpose: Purpose | None = None
) -> Jackknife:
    """As :func:`jackknife`, for anything that fits a data set."""
    if len(dataset) < FEWEST:
        raise DataError(
            f"{len(dataset)} records do not show how records differ. Give {FEWEST} or more; long "
            "ones can be cut where the vehicle has forgotten what was before."
        )

    def wanted(data: Dataset) -> Mapping[str, float]:
        fit = fitted(data)
        return fit.values if purpose is None else purpose(fit)

    if not (whole := {name: float(value) for name, value in wanted(dataset).items()}):
        raise ModelError("Nothing is wanted: no parameter is free, or purpose returns nothing.")
    without: dict[str, np.ndarray] = {}
    for left in dataset.names:
        try:
            found = wanted(Dataset(tuple(record for record in dataset if record.name != left)))
        except OedSysidError:
            continue  # one fit fewer, which the factor of the variance counts
        row = np.array([found[name] for name in whole], dtype=float)
        if np.isfinite(row).all():
            without[left] = row
    return Jackknife(tuple(whole), np.array(list(whole.values())), without, len(dataset))
