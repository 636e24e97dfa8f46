"""The online estimators behind the interface of the others: a log is played back."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.estimators.baselines.ls_svm import check_weight
from oed_sysid.estimators.baselines.regression_form import regression_form
from oed_sysid.estimators.baselines.regression_rows import Rates, check_rule, rows_of
from oed_sysid.estimators.baselines.regression_summary import fit_from_values
from oed_sysid.estimators.baselines.separate_equations import SeparateSolution, separate
from oed_sysid.estimators.online.incremental import IncrementalLSSVM
from oed_sysid.estimators.online.recursive import RecursiveLeastSquares, RecursiveLSSVM
from oed_sysid.fitting.fit import Fit
from oed_sysid.model import Model

METHODS = ("recursive", "incremental", "forgetting")


@dataclass(frozen=True)
class OnlineRegression:
    """Play records back through an online regression, one equation at a time.

    The result is the last state of the recursion; ``extras["history"]`` holds,
    by parameter, its value after every sample.

    Parameters
    ----------
    method : str
        ``"recursive"`` (:class:`RecursiveLSSVM`), ``"incremental"``
        (:class:`IncrementalLSSVM`) or ``"forgetting"``
        (:class:`RecursiveLeastSquares`).
    C : float
        Weight of the errors of the LS-SVM.
    start : int
        Samples of the first batch; values before are NaN in the history.
    window : int or None
        Latest samples to learn from, all by default.
    forgetting : float
        Of ``"forgetting"``.
    bias : bool
        Whether equations without a constant term get one; always so with
        ``"recursive"``.
    scale : str or mapping
        See :class:`~oed_sysid.estimators.baselines.ls_svm.LeastSquaresSVM`.
    rule, rates
        Where derivatives come from, see
        :class:`~oed_sysid.estimators.baselines.equation_error.EquationError`.

    References
    ----------
    Xu, Zou & Yin (2012), On-line identification by incremental LS-SVM, J. Ship
    Mechanics 16(3).
    """

    method: str = "recursive"
    C: float = 3e4
    start: int = 2
    window: int | None = None
    forgetting: float = 0.99
    bias: bool = True
    scale: str | Mapping[str, float] = "raw"
    rule: str = "trapezoid"
    rates: Rates | None = None

    def __post_init__(self) -> None:
        check_weight(self.C)
        check_rule(self.rule, 9)
        if self.method not in METHODS:
            raise ModelError(f"method is {self.method!r}. Choose one of {', '.join(METHODS)}.")
        if self.start < 1:
            raise ModelError(f"start is {self.start}. Begin with at least one sample.")
        if self.rule == "local":
            raise ModelError("A local cubic needs later samples. Choose another rule.")

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        memory = "" if self.window is None else f", last {self.window} samples"
        setting = (
            f"forgetting {self.forgetting:g}" if self.method == "forgetting" else f"C {self.C:g}"
        )
        return f"online regression ({self.method}, {setting}{memory})"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate the free parameters, samples in the order of the records.

        Raises
        ------
        ModelError
            As :meth:`EquationError.fit`, and where equations share a parameter.
        """
        began = time.perf_counter()
        form = regression_form(model)
        rows = rows_of(form, dataset, rule=self.rule, rates=self.rates)
        found = separate(rows, model, self._solve, scale=self.scale, bias=self.bias)
        return fit_from_values(
            model,
            dataset,
            estimator=self.name,
            estimates=found.estimates,
            covariance=found.covariance,
            coloured=found.coloured,
            began=began,
            iterations=sum(map(len, rows.targets)),
            extras={"bias": found.facts["bias"], "history": found.history},
        )

    def _solve(self, features: np.ndarray, targets: np.ndarray, bias: bool) -> SeparateSolution:
        columns = features
        machine: RecursiveLSSVM | IncrementalLSSVM | RecursiveLeastSquares
        if self.method == "recursive":
            machine = RecursiveLSSVM(C=self.C, window=self.window)
        elif self.method == "incremental":
            machine = IncrementalLSSVM(C=self.C, window=self.window, bias=bias)
        else:
            columns = np.hstack([features, np.ones((len(features), 1))]) if bias else features
            machine = RecursiveLeastSquares(np.zeros(columns.shape[1]), forgetting=self.forgetting)
        n = features.shape[1]
        track = np.full((len(targets), n + 1), np.nan)
        first = min(self.start, len(targets))
        machine.start(columns[:first], targets[:first])
        for k in range(first - 1, len(targets)):
            if k >= first:
                machine.update(columns[k], targets[k])
            if isinstance(machine, IncrementalLSSVM):
                multipliers, track[k, n] = machine.solution()
                kept = columns[k + 1 - len(multipliers) : k + 1]
                track[k, :n] = kept.T @ multipliers
                continue
            if isinstance(machine, RecursiveLSSVM):
                track[k, :n], track[k, n] = machine.solution()
                continue
            values = machine.coefficients
            track[k, :n], track[k, n] = values[:n], values[n] if bias else 0.0
        ridge = 0.0 if self.method == "forgetting" else 1.0 / self.C
        age = np.arange(len(targets))[::-1]
        weights = self.forgetting**age if self.method == "forgetting" else np.ones(len(targets))
        if self.window is not None and self.method != "forgetting":
            weights = (age < self.window).astype(float)
        return SeparateSolution(
            track[-1, :n], float(track[-1, n]), ridge, weights=weights, track=track
        )
