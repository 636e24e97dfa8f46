"""Weighted least squares over the rows of several equations, with honest errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from oed_sysid.estimators.baselines.regression_rows import Rows
from oed_sysid.fitting.fit import COLOUR_LIMIT
from oed_sysid.information import (
    Information,
    coloured_score_covariance,
    effective_sample_size,
)
from oed_sysid.model import Model

# Errors of an equation below this share of its target are rounding.
ROUNDING = 1e-10
ROUNDS = 20


@dataclass(frozen=True, eq=False)
class Solved:
    """Solution of a regression.

    Attributes
    ----------
    estimates : ndarray (n_free,)
        Values in the order of the model's free parameters.
    information : Information
        As if the errors of the rows were white.
    covariance : ndarray (n_free, n_free)
        The inverse information, or the sandwich where errors are coloured.
    coloured : bool
        Whether the sandwich is in use.
    levels : ndarray (n_equations,)
        Standard deviation of the rows' errors, in the unit of each equation.
    residuals : tuple of ndarray (n_rows, n_equations)
        Target minus regressors times estimates, per record.
    """

    estimates: np.ndarray
    information: Information
    covariance: np.ndarray
    coloured: bool
    levels: np.ndarray
    residuals: tuple[np.ndarray, ...]


def solve_rows(rows: Rows, model: Model, *, coloured: str = "auto") -> Solved:
    """Solve all equations together, each weighted by the spread of its own errors.

    Where no parameter is shared this is ordinary least squares of each equation.
    Priors enter as observations; bounds are kept.
    """
    n_free, n_equations = len(rows.form.names), len(rows.form.equations)
    targets = np.vstack(rows.targets)
    regressors = np.vstack(rows.regressors)
    valid = np.isfinite(targets) & np.isfinite(regressors).all(axis=2)
    spread = np.array([_rms(targets[valid[:, i], i]) for i in range(n_equations)])
    levels = np.where(spread > 0, spread, 1.0)
    floor = ROUNDING * levels
    prior_rows, prior_targets = _priors(model)
    estimates = np.zeros(n_free)
    for _ in range(ROUNDS):
        flat = np.where(valid[:, :, None], regressors / levels[:, None], 0.0)
        right = np.where(valid, targets / levels, 0.0).ravel()
        matrix = np.vstack([flat.reshape(-1, n_free), prior_rows])
        estimates = bounded_least_squares(matrix, np.concatenate([right, prior_targets]), model)
        errors = np.where(valid, targets - regressors @ estimates, 0.0)
        freedom = np.maximum(valid.sum(axis=0) - n_free / n_equations, 1.0)
        new = np.maximum(np.sqrt((errors**2).sum(axis=0) / freedom), floor)
        change = np.max(np.abs(np.log(new / levels)))
        levels = new
        if change < 1e-6:
            break
    residuals = tuple(t - r @ estimates for t, r in zip(rows.targets, rows.regressors, strict=True))
    scales = np.array([p.magnitude for p in model.free_parameters])
    whitened = np.where(valid[:, :, None], regressors / levels[:, None], 0.0)
    stacked = np.vstack([whitened.reshape(-1, n_free), prior_rows])
    information = Information.from_jacobian(rows.form.names, stacked, scales)
    scaled = [residual / levels for residual in residuals]
    use = coloured == "always" or (coloured == "auto" and are_coloured(scaled))
    covariance = information.covariance
    if use:
        jacobians = [
            np.where(np.isfinite(r), r, 0.0) / levels[:, None]
            for r in _blanked(rows.regressors, residuals)
        ]
        middle = coloured_score_covariance(jacobians, scaled) + prior_rows.T @ prior_rows
        covariance = sandwich(covariance, middle)
    return Solved(estimates, information, covariance, use, levels, residuals)


def bounded_least_squares(matrix: np.ndarray, right: np.ndarray, model: Model) -> np.ndarray:
    """Least squares of smallest scaled norm, within the bounds of the free parameters."""
    norms = np.linalg.norm(matrix, axis=0)
    scale = 1.0 / np.where(norms > 0, norms, 1.0)
    solution = scale * np.linalg.lstsq(matrix * scale, right, rcond=1e-13)[0]
    lower = np.array([p.lower for p in model.free_parameters])
    upper = np.array([p.upper for p in model.free_parameters])
    if np.all(solution >= lower) and np.all(solution <= upper):
        return solution
    open_upper = np.where(upper > lower, upper, np.nextafter(lower, np.inf))
    result = lsq_linear(matrix * scale, right, (lower / scale, open_upper / scale))
    return np.clip(scale * result.x, lower, upper)


def sandwich(bread: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """``bread middle bread`` over the parameters that are seen at all."""
    finite = np.isfinite(np.diag(bread))
    result = bread.copy()
    block = np.ix_(finite, finite)
    result[block] = bread[block] @ middle[block] @ bread[block]
    return result


def are_coloured(residuals: Sequence[np.ndarray]) -> bool:
    """Whether residual columns count clearly fewer independent samples than they have."""
    effective = total = 0.0
    for residual in residuals:
        for column in residual.T:
            n = int(np.isfinite(column).sum())
            if n > 20:
                effective += effective_sample_size(column)
                total += n
    return total > 0 and effective < COLOUR_LIMIT * total


def _blanked(regressors: Sequence[np.ndarray], residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Regressors, zero in the rows whose target is missing."""
    pairs = zip(regressors, residuals, strict=True)
    return [np.where(np.isfinite(error)[:, :, None], rows, 0.0) for rows, error in pairs]


def _priors(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Priors as whitened rows ``(n_priors, n_free)`` and targets."""
    known = [(i, p) for i, p in enumerate(model.free_parameters) if p.prior_spread is not None]
    rows = np.zeros((len(known), len(model.free_parameters)))
    targets = np.zeros(len(known))
    for row, (index, parameter) in enumerate(known):
        rows[row, index] = 1.0 / float(parameter.prior_spread or 1.0)
        targets[row] = float(parameter.prior_mean or 0.0) * rows[row, index]
    return rows, targets


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
