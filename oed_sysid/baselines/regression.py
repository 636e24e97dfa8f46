r"""Solving regressions, all equations together or each alone, and the ``Fit`` that results.

Regressions, filters and samplers end with values and a covariance. What the model then predicts,
and how well, is found by simulating each record from its first measurements.

Errors of rows that are correlated in time are stated by the sandwich

.. math:: \mathrm{cov}\,\hat\theta = B\,(\Phi^T S\,\Phi)\,B, \qquad
          B = (\Phi^T W\,\Phi)^{-1},

with :math:`S` from the residuals' own autocorrelation
(:func:`oed_sysid.likelihood.information.coloured_score_covariance`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from scipy.optimize import lsq_linear

from oed_sysid.baselines.equations import Rows, regression_form, rows_of
from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.covariance import sandwich
from oed_sysid.likelihood.estimate import Posterior, Status
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import (
    COLOUR_LIMIT,
    Information,
    coloured_score_covariance,
    effective_sample_size,
)
from oed_sysid.likelihood.noise_levels import given_levels
from oed_sysid.likelihood.start_guess import check_channels, first_state
from oed_sysid.physics.model import Model

CONVERGED = Status("converged", "")
DIVERGED = (
    "the values solve the regression, but the model with them diverges when it is "
    "simulated. Simulation needs stable values: remove terms that the data do not see, or use "
    "MultipleShooting."
)


def fit_from_values(
    model: Model,
    dataset: Dataset,
    *,
    estimator: str,
    estimates: np.ndarray,
    covariance: np.ndarray,
    began: float,
    information: Information | None = None,
    coloured: bool = False,
    status: Status = CONVERGED,
    iterations: int = 1,
    known: Mapping[str, float] | None = None,
    posterior: Posterior | None = None,
    extras: Mapping[str, Any] | None = None,
) -> Fit:
    """Simulate every record with the estimated values and build the result.

    Parameters
    ----------
    model : Model
        The model that was fitted, at its start values.
    dataset : Dataset
        The records.
    estimator : str
        Name for reports.
    estimates : ndarray (n_free,)
        Values in the order of ``model.free_names``.
    covariance : ndarray (n_free, n_free)
        Of the estimates.
    began : float
        ``time.perf_counter()`` at the start.
    information : Information, optional
        By default the inverse of the covariance.
    coloured : bool
        Whether the covariance accounts for coloured errors.
    status : Status, optional
        Divergence in simulation overrides it.
    iterations : int
        Iterations or samples.
    known : mapping of str to float, optional
        Known start of some states in all records; others are measured, or zero.
    posterior : Posterior, optional
        Draws, of a sampler.
    extras : mapping, optional
        What else the estimator has to tell.
    """
    check_channels(model, dataset)
    names = model.free_names
    values = np.array([float(value) for value in estimates])
    fitted = model.with_values(_within_bounds(model, dict(zip(names, values, strict=True))))
    runner = kernel(fitted)
    predictions, residuals, states, initial = [], [], [], []
    diverged = False
    for record in dataset:
        own = first_state(model, record, known)
        z, _ = runner.start(own, record.inputs[0], fitted.value_vector, record.times[0])
        run = runner.run(record.times, record.inputs, fitted.value_vector, z)
        diverged |= not run.ok
        predictions.append(run.outputs)
        residuals.append(record.outputs - run.outputs)
        states.append(run.states)
        initial.append(own)
    declared = given_levels(model.outputs)
    stacked = np.vstack(residuals)
    present = np.isfinite(stacked)
    squares = np.where(present, stacked, 0.0) ** 2
    found = np.sqrt(squares.sum(axis=0) / np.maximum(present.sum(axis=0), 1))
    found = np.where(found > 0, found, 1e-12)
    estimated = ~np.isfinite(declared)
    sigma = np.where(estimated, found, declared)
    if information is None:
        information = information_from_covariance(model, covariance)
    if diverged:
        status = Status("diverged", DIVERGED)
    return Fit(
        model=fitted,
        dataset=dataset,
        estimator=estimator,
        names=names,
        estimates=values,
        information=information,
        covariance=np.asarray(covariance, dtype=float),
        coloured=coloured,
        sigma=sigma,
        sigma_estimated=estimated,
        predictions=tuple(predictions),
        residuals=tuple(residuals),
        states=tuple(states),
        initial_states=tuple(initial),
        local_values=tuple({} for _ in dataset),
        cost=0.5 * float(np.sum(squares / sigma**2)) if not diverged else np.inf,
        status=status,
        iterations=iterations,
        seconds=time.perf_counter() - began,
        posterior=posterior,
        extras=dict(extras or {}),
    )


def information_from_covariance(model: Model, covariance: np.ndarray) -> Information:
    """Information whose covariance is the given one; nothing where that is infinite."""
    scales = np.array([p.magnitude for p in model.free_parameters])
    scaled = np.asarray(covariance) / scales[:, None] / scales
    finite = np.isfinite(np.diag(scaled))
    matrix = np.zeros_like(scaled)
    block = np.ix_(finite, finite)
    matrix[block] = np.linalg.pinv(scaled[block], hermitian=True)
    inner = matrix / scales[:, None] / scales
    return Information.from_matrix(model.free_names, inner, scales)


def _within_bounds(model: Model, values: Mapping[str, float]) -> dict[str, float]:
    """Values that a parameter can carry: a bound where an unbounded method left it."""
    inside = {}
    for name, value in values.items():
        parameter = model.parameter(name)
        finite = value if np.isfinite(value) else parameter.value
        inside[name] = float(np.clip(finite, parameter.lower, parameter.upper))
    return inside


# Errors of an equation below this share of its target are rounding.
ROUNDING = 1e-10


ROUNDS = 20


@dataclass(frozen=True, eq=False)
class Regression:
    """What a regression found, in the order of the model's free parameters.

    Attributes
    ----------
    estimates : ndarray (n_free,)
    covariance : ndarray (n_free, n_free)
    information : Information or None
        As if the errors of the rows were white; by default the inverse covariance.
    coloured : bool
        Whether the covariance accounts for errors correlated in time.
    status : Status
    iterations : int
        Iterations or samples.
    posterior : Posterior or None
        Draws, of a sampler.
    extras : mapping
        What else there is to tell.
    """

    estimates: np.ndarray
    covariance: np.ndarray
    information: Information | None = None
    coloured: bool = False
    status: Status = CONVERGED
    iterations: int = 1
    posterior: Posterior | None = None
    extras: Mapping[str, Any] = field(default_factory=dict)


class RegressionMethod(Protocol):
    """An estimator that takes rates by a rule; see :class:`.EquationError`."""

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        ...

    @property
    def rule(self) -> str:
        """Where derivatives come from."""
        ...


def regress(
    method: RegressionMethod,
    model: Model,
    dataset: Dataset,
    solve: Callable[[Rows], Regression],
    *,
    window: int = 9,
    apart: bool = True,
) -> Fit:
    """Derive the rows of all records, solve them, and simulate what was found.

    Parameters
    ----------
    method : estimator
        With its ``rule``, and ``rates`` where it can be given them.
    solve : callable
        From the rows to the result.
    window : int
        Samples of a local cubic.
    apart : bool
        Whether each equation is solved alone, so that none may share a parameter.

    Raises
    ------
    ModelError
        If the model is not linear in its free parameters, a state is not measured, or equations
        that are solved apart share a parameter.
    DataError
        If data and model do not belong together.
    """
    began = time.perf_counter()
    rates = getattr(method, "rates", None)
    rows = rows_of(regression_form(model), dataset, rule=method.rule, window=window, rates=rates)
    if apart:
        rows.check_separate()
    found = vars(solve(rows))
    return fit_from_values(model, dataset, estimator=method.name, began=began, **found)


def solve_rows(rows: Rows, model: Model, *, coloured: str = "auto") -> Regression:
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
        pairs = zip(rows.regressors, residuals, strict=True)
        jacobians = [
            np.where(np.isfinite(r) & np.isfinite(error)[:, :, None], r, 0.0) / levels[:, None]
            for r, error in pairs
        ]
        middle = coloured_score_covariance(jacobians, scaled) + prior_rows.T @ prior_rows
        covariance = sandwich(covariance, middle)
    extras = {
        "equation_errors": dict(zip(rows.form.equations, map(float, levels), strict=True)),
        "equation_residuals": residuals,
    }
    return Regression(estimates, covariance, information, use, extras=extras)


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


def residual_covariance(
    bread: np.ndarray, rows: np.ndarray, errors: np.ndarray, variance: float
) -> tuple[np.ndarray, bool]:
    """Covariance of least squares from its residuals, and whether these are correlated in time.

    Parameters
    ----------
    bread : ndarray (n, n)
        Inverse curvature.
    rows : ndarray (n_rows, n)
        Weighted regressors.
    errors : ndarray (n_rows,)
    variance : float
        Of the errors.
    """
    if variance <= 0:
        return np.zeros_like(bread), False
    scaled = (errors / np.sqrt(variance))[:, None]
    coloured = are_coloured([scaled])
    middle = rows.T @ rows
    if coloured:
        middle = coloured_score_covariance([rows[:, None, :]], [scaled])
    return variance * sandwich(bread, middle), coloured


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


@dataclass(frozen=True, eq=False)
class SeparateSolution:
    """What a solver found for one equation, in scaled units.

    Attributes
    ----------
    coefficients : ndarray (n_features,)
    bias : float
    ridge : float
        Weight of ``|coefficients|^2`` against a squared error; enters the errors.
    weights : ndarray (n_rows,) or None
        Weight that each row had in the end; all one by default.
    track : ndarray (n_rows, n_features + 1) or None
        Coefficients and bias after every row, of recursive solvers.
    facts : mapping
        What the solver has to tell about this equation.
    """

    coefficients: np.ndarray
    bias: float
    ridge: float = 0.0
    weights: np.ndarray | None = None
    track: np.ndarray | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)


Solver = Callable[[np.ndarray, np.ndarray, bool], SeparateSolution]


@dataclass(frozen=True, eq=False)
class ScaledEquation:
    """One equation in scaled units, its constant regressor set apart as the bias.

    Attributes
    ----------
    features : ndarray (n_rows, n_features)
    targets : ndarray (n_rows,)
    names : tuple of str
        Parameters of the features.
    constant : str or None
        Parameter that the bias stands for.
    units : ndarray (n_features,)
        Parameter = coefficient * unit.
    constant_unit, target_unit : float
        Constant parameter = bias * constant_unit; target = scaled target * target_unit.
    """

    features: np.ndarray
    targets: np.ndarray
    names: tuple[str, ...]
    constant: str | None
    units: np.ndarray
    constant_unit: float
    target_unit: float


def check_scale(scale: str | Mapping[str, float], equations: tuple[str, ...]) -> None:
    """Raise :class:`ModelError` for an unknown scaling."""
    if isinstance(scale, str):
        if scale not in ("raw", "unit"):
            raise ModelError(f"scale is {scale!r}. Choose raw, unit or a divisor per equation.")
        return
    missing = [name for name in equations if not scale.get(name, 0.0) > 0]
    if missing:
        raise ModelError(
            f"scale gives no positive divisor for the equation of {', '.join(missing)}. The "
            f"equations are those of {', '.join(equations)}."
        )


def scaled_equation(rows: Rows, index: int, scale: str | Mapping[str, float]) -> ScaledEquation:
    """Scale one equation and set its constant regressor apart."""
    check_scale(scale, rows.form.equations)
    features, targets, names = rows.equation(index)
    equation = rows.form.equations[index]
    if not len(targets):
        raise ModelError(f"No complete row is left for the equation of {equation}: all are NaN.")
    span, size = np.ptp(features, axis=0), np.abs(features).max(axis=0)
    is_constant = (span <= 1e-12 * size) & (size > 0)
    if is_constant.sum() > 1:
        several = [name for name, flag in zip(names, is_constant, strict=True) if flag]
        raise ModelError(
            f"{', '.join(several)} are all constant terms of the equation of {equation}. Fix all "
            "but one."
        )
    constant = names[int(np.argmax(is_constant))] if is_constant.any() else None
    level = float(features[0, is_constant][0]) if constant else 1.0
    kept = features[:, ~is_constant]
    if scale == "unit":
        target_unit = float(np.sqrt(np.mean(targets**2))) or 1.0
        column_units = np.sqrt(np.mean(kept**2, axis=0))
        column_units[column_units == 0] = 1.0
    else:
        target_unit = 1.0 if isinstance(scale, str) else float(scale[equation])
        column_units = np.full(kept.shape[1], target_unit)
    return ScaledEquation(
        features=kept / column_units,
        targets=targets / target_unit,
        names=tuple(name for name, flag in zip(names, is_constant, strict=True) if not flag),
        constant=constant,
        units=target_unit / column_units,
        constant_unit=target_unit / level,
        target_unit=target_unit,
    )


def separate(
    rows: Rows,
    solver: Solver,
    *,
    scale: str | Mapping[str, float] = "raw",
    bias: bool = True,
) -> Regression:
    """Solve every equation with ``solver(features, targets, bias)``.

    Returns
    -------
    Regression
        ``extras``: ``bias`` and whatever the solver tells, by the state of the equation, and
        ``history``, the value of each parameter after every row, of recursive solvers.
    """
    names = rows.form.names
    estimates = np.zeros(len(names))
    covariance = np.zeros((len(names), len(names)))
    extras: dict[str, dict[str, Any]] = {"bias": {}}
    coloured = False
    for index, equation in enumerate(rows.form.equations):
        part = scaled_equation(rows, index, scale)
        with_bias = bias or part.constant is not None
        solution = solver(part.features, part.targets, with_bias)
        extras["bias"][equation] = solution.bias * part.target_unit
        for key, fact in solution.facts.items():
            extras.setdefault(key, {})[equation] = fact
        block, use = equation_covariance(part, solution, with_bias)
        coloured |= use
        # Coefficients and the bias, which stands for the constant parameter where there is one.
        involved = [*part.names, part.constant] if part.constant else list(part.names)
        where, n = [names.index(name) for name in involved], len(involved)
        units = np.append(part.units, part.constant_unit)
        estimates[where] = (np.append(solution.coefficients, solution.bias) * units)[:n]
        covariance[np.ix_(where, where)] = (block * units[:, None] * units)[:n, :n]
        if solution.track is not None:
            tracks = dict(zip(involved, (solution.track * units).T, strict=False))
            extras.setdefault("history", {}).update(tracks)
    return Regression(estimates, covariance, coloured=coloured, extras=extras)


def equation_covariance(
    part: ScaledEquation, solution: SeparateSolution, with_bias: bool
) -> tuple[np.ndarray, bool]:
    """Covariance of ``[coefficients, bias]`` in scaled units, and whether errors are coloured."""
    n, n_features = part.features.shape
    matrix = np.hstack([part.features, np.full((n, 1), float(with_bias))])
    weights = np.ones(n) if solution.weights is None else solution.weights
    errors = part.targets - part.features @ solution.coefficients - solution.bias
    freedom = max(float(weights.sum()) - n_features - with_bias, 1.0)
    variance = float(weights @ errors**2) / freedom
    norms = np.linalg.norm(matrix, axis=0)
    scale = 1.0 / np.where(norms > 0, norms, 1.0)
    matrix = matrix * scale
    penalty = np.diag([*np.full(n_features, solution.ridge), 0.0]) * scale**2
    bread = np.linalg.pinv((matrix.T * weights) @ matrix + penalty, hermitian=True, rcond=1e-15)
    covariance, coloured = residual_covariance(bread, matrix * weights[:, None], errors, variance)
    return covariance * scale[:, None] * scale, coloured
