"""Total least squares: noise in the regressors as well as in the target."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.estimators.baselines.regression_form import RegressionForm, regression_form
from oed_sysid.estimators.baselines.regression_rows import Rows, check_rule, rows_of
from oed_sysid.estimators.baselines.regression_solution import are_coloured, sandwich
from oed_sysid.estimators.baselines.regression_summary import fit_from_values
from oed_sysid.fitting.fit import Fit, Status
from oed_sysid.fitting.noise_levels import given_levels, noise_floor
from oed_sysid.information import coloured_score_covariance
from oed_sysid.model import Model

# Perturbed copies of the data that measure how noise enters the columns.
COPIES = 12


@dataclass(frozen=True)
class TotalLeastSquares:
    r"""Generalised total least squares, one equation at a time.

    With ``D = [regressors, target]`` and ``W`` the covariance of the errors of
    its columns, the solution is the direction that minimises

    .. math:: \frac{v^T D^T D v}{v^T W v}, \qquad v \propto (\theta, -1).

    Columns without noise, such as commanded angles, are exact. ``W`` follows
    from the noise levels of the outputs, carried through smoothing, derivatives
    and products by perturbing the data. Where the least ratio is far from one
    the stated noise does not explain the misfit.

    Parameters
    ----------
    rule, window
        Where derivatives come from, see :class:`EquationError`.
    seed : int
        Of the perturbations.

    References
    ----------
    Van Huffel & Vandewalle (1991), The total least squares problem, SIAM,
    ch. 10 (generalised TLS).
    """

    rule: str = "local"
    window: int = 9
    seed: int = 0

    def __post_init__(self) -> None:
        check_rule(self.rule, self.window)
        if self.rule == "exact":
            raise ModelError("Exact rates have no noise to share out. Use EquationError.")

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return f"total least squares ({self.rule} derivatives)"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate the free parameters of each equation.

        Raises
        ------
        ModelError
            As :meth:`EquationError.fit`, and where equations share a parameter.
        """
        began = time.perf_counter()
        form = regression_form(model)
        rows = rows_of(form, dataset, rule=self.rule, window=self.window)
        rows.check_separate()
        sigma = given_levels(model.outputs)
        sigma = np.where(np.isfinite(sigma), sigma, noise_floor(dataset))
        errors = self._column_errors(form, dataset, rows, sigma)
        estimates = np.zeros(len(form.names))
        covariance = np.zeros((len(form.names), len(form.names)))
        ratios: dict[str, float] = {}
        coloured = False
        for index, equation in enumerate(form.equations):
            regressors, target, names = rows.equation(index)
            if len(target) <= len(names):
                raise ModelError(
                    f"The equation of {equation} has {len(target)} complete rows for "
                    f"{len(names)} parameters. Give a longer record."
                )
            values, ratio = generalised_tls(regressors, target, errors[index])
            block, use = _covariance(regressors, target, values, ratio * errors[index])
            where = [form.names.index(name) for name in names]
            estimates[where] = values
            covariance[np.ix_(where, where)] = block
            ratios[equation] = float(np.sqrt(ratio))
            coloured |= use
        return fit_from_values(
            model,
            dataset,
            estimator=self.name,
            estimates=estimates,
            covariance=covariance,
            coloured=coloured,
            began=began,
            status=Status("converged", ""),
            extras={"noise_ratio": ratios},
        )

    def _column_errors(
        self, form: RegressionForm, dataset: Dataset, rows: Rows, sigma: np.ndarray
    ) -> list[np.ndarray]:
        """Covariance of the errors of ``[regressors, target]`` per row, by equation."""
        rng = np.random.default_rng(self.seed)
        sums = [np.zeros(()) for _ in form.equations]
        used = [rows.equation(i)[2] for i in range(len(form.equations))]
        for _ in range(COPIES):
            copy = Dataset(
                tuple(
                    record.with_outputs(
                        record.outputs + sigma * rng.standard_normal(record.outputs.shape)
                    )
                    for record in dataset
                )
            )
            moved = rows_of(form, copy, rule=self.rule, window=self.window)
            for index, names in enumerate(used):
                columns = [form.names.index(name) for name in names]
                change = [
                    np.column_stack([new[:, index][:, columns] - old[:, index][:, columns], t - s])
                    for new, old, t, s in zip(
                        moved.regressors,
                        rows.regressors,
                        (target[:, index] for target in moved.targets),
                        (target[:, index] for target in rows.targets),
                        strict=True,
                    )
                ]
                stacked = np.vstack(change)
                stacked = stacked[np.isfinite(stacked).all(axis=1)]
                sums[index] = sums[index] + stacked.T @ stacked / max(len(stacked), 1)
        return [total / COPIES for total in sums]


def generalised_tls(
    regressors: np.ndarray, target: np.ndarray, errors: np.ndarray
) -> tuple[np.ndarray, float]:
    """Solve ``target = regressors @ values`` where all columns have errors.

    Parameters
    ----------
    regressors : ndarray (n_rows, n_parameters)
    target : ndarray (n_rows,)
    errors : ndarray (n_parameters + 1, n_parameters + 1)
        Covariance of the errors of one row of ``[regressors, target]``; may be
        singular.

    Returns
    -------
    values : ndarray (n_parameters,)
    ratio : float
        Mean square of the misfit over that of the stated errors.

    Examples
    --------
    >>> x = np.array([[1.0], [2.0], [3.0]])
    >>> values, ratio = generalised_tls(x, 2 * x[:, 0], np.eye(2))
    >>> print(values.round(6))
    [2.]
    """
    matrix = np.column_stack([regressors, target])
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms == 0] = 1.0
    _, values, vectors = np.linalg.svd(matrix / norms, full_matrices=False)
    # Rounding is the smallest misfit that can be told from none.
    values = np.maximum(values, 1e-14 * values[0])
    whitener = vectors.T / values
    scaled = errors / norms[:, None] / norms
    inner = whitener.T @ scaled @ whitener
    found, directions = np.linalg.eigh(0.5 * (inner + inner.T))
    direction = whitener @ directions[:, -1] / norms
    if abs(direction[-1]) < 1e-12 * np.abs(direction * norms).max() / norms[-1]:
        raise ModelError(
            "Total least squares has no solution here: the least misfit lies in the regressors "
            "alone, which are not independent. Remove a parameter, or use EquationError."
        )
    ratio = 1.0 / (found[-1] * len(target)) if found[-1] > 0 else 0.0
    return -direction[:-1] / direction[-1], float(ratio)


def _covariance(
    regressors: np.ndarray, target: np.ndarray, values: np.ndarray, errors: np.ndarray
) -> tuple[np.ndarray, bool]:
    """First-order covariance of the estimates, and whether errors are coloured."""
    n, n_parameters = regressors.shape
    residual = target - regressors @ values
    variance = float(residual @ residual) / max(n - n_parameters, 1)
    norms = np.linalg.norm(regressors, axis=0)
    norms[norms == 0] = 1.0
    curvature = regressors.T @ regressors - n * errors[:-1, :-1]
    bread = np.linalg.pinv(curvature / norms[:, None] / norms, hermitian=True)
    bread = bread / norms[:, None] / norms
    if variance <= 0:
        return np.zeros_like(bread), False
    scaled = (residual / np.sqrt(variance))[:, None]
    middle = regressors.T @ regressors
    coloured = are_coloured([scaled])
    if coloured:
        middle = coloured_score_covariance([regressors[:, None, :]], [scaled])
    return variance * sandwich(bread, middle), coloured
