"""Support vector regression with an insensitive zone, through scikit-learn."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.estimators.baselines.ls_svm import check_weight
from oed_sysid.estimators.baselines.optional_libraries import optional
from oed_sysid.estimators.baselines.regression_form import regression_form
from oed_sysid.estimators.baselines.regression_rows import Rates, check_rule, rows_of
from oed_sysid.estimators.baselines.regression_summary import fit_from_values
from oed_sysid.estimators.baselines.separate_equations import SeparateSolution, separate
from oed_sysid.fitting.fit import Fit, Status
from oed_sysid.model import Model


@dataclass(frozen=True)
class SupportVectorRegression:
    r"""Linear :math:`\varepsilon`-support vector regression, one equation at a time.

    .. math:: \min \tfrac12|w|^2 + C\sum_i \max(0, |y_i - w^Tx_i - b| - \varepsilon)

    Errors within the zone cost nothing and others linearly, so that outliers
    count little. Stated intervals treat the solution as least squares and are
    a rough guide only.

    Parameters
    ----------
    C : float
        Weight of the errors, in scaled units.
    epsilon : float
        Half-width of the zone, in scaled units.
    scale : str or mapping
        See :class:`LeastSquaresSVM`; ``"unit"`` makes both settings
        independent of units.
    rule, window, rates
        Where derivatives come from, see :class:`EquationError`.
    max_iterations : int
        Most iterations of the solver per equation.

    References
    ----------
    Smola & Schölkopf (2004), A tutorial on support vector regression,
    Statistics and Computing 14; solver: Fan et al. (2008), LIBLINEAR.
    """

    C: float = 100.0
    epsilon: float = 1e-3
    scale: str | Mapping[str, float] = "unit"
    rule: str = "simpson"
    window: int = 9
    rates: Rates | None = None
    max_iterations: int = 200_000

    def __post_init__(self) -> None:
        check_weight(self.C)
        check_rule(self.rule, self.window)
        if not self.epsilon >= 0:
            raise ModelError(f"epsilon is {self.epsilon}. Give the half-width of the zone, >= 0.")

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return f"support vector regression (C {self.C:g}, epsilon {self.epsilon:g})"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate the free parameters of each equation.

        Raises
        ------
        ModelError
            As :meth:`EquationError.fit`, where equations share a parameter, or
            if scikit-learn is not installed.
        """
        began = time.perf_counter()
        svm = optional("sklearn.svm", "scikit-learn", wanted_by="SupportVectorRegression")
        form = regression_form(model)
        rows = rows_of(form, dataset, rule=self.rule, window=self.window, rates=self.rates)
        unfinished: list[int] = []

        def solve(features: np.ndarray, targets: np.ndarray, bias: bool) -> SeparateSolution:
            machine = svm.SVR(
                kernel="linear",
                C=self.C,
                epsilon=self.epsilon,
                tol=1e-6,
                max_iter=self.max_iterations,
            )
            centre = targets.mean() if bias else 0.0
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # reported in the status
                machine.fit(features, targets - centre)
            if machine.fit_status_ or machine.n_iter_ >= self.max_iterations:
                unfinished.append(int(machine.n_iter_))
            return SeparateSolution(
                machine.coef_.ravel(),
                float(machine.intercept_[0]) + float(centre),
                facts={"support_vectors": len(machine.support_)},
            )

        found = separate(rows, model, solve, scale=self.scale)
        status = Status("converged", "")
        if unfinished:
            status = Status(
                "iterations",
                "the limit of iterations was reached. Raise max_iterations, or lower C.",
            )
        return fit_from_values(
            model,
            dataset,
            estimator=self.name,
            estimates=found.estimates,
            covariance=found.covariance,
            coloured=found.coloured,
            began=began,
            status=status,
            extras=found.facts,
        )
