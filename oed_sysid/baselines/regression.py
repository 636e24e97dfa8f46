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
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import lsq_linear

from oed_sysid.baselines.equations import Rows, regression_form, rows_of
from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.covariance import asks, is_coloured, sandwich
from oed_sysid.likelihood.estimate import Posterior, Status
from oed_sysid.likelihood.estimator import check_choice
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import (
    Information,
    coloured_score_covariance,
)
from oed_sysid.likelihood.noise_levels import given_levels, root_mean_square, white_levels
from oed_sysid.likelihood.start_guess import first_state
from oed_sysid.physics.model import Model

CONVERGED = Status("converged", "")
DIVERGED = (
    "the values solve the regression, but the model with them diverges when it is "
    "simulated. Simulation needs stable values: remove terms that the data do not see, or use "
    "MultipleShooting."
)


@dataclass(frozen=True, eq=False)
class Regression:
    """What an estimator found, in the order of the model's free parameters.

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
    facts : mapping
        What else there is to tell.
    """

    estimates: np.ndarray
    covariance: np.ndarray
    information: Information | None = None
    coloured: bool = False
    status: Status = CONVERGED
    iterations: int = 1
    posterior: Posterior | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)


class Baseline(ABC):
    """An estimator whose kind says how values and their covariance are found.

    What the model then predicts is found by simulating each record from its first measurements,
    or from ``initial``, the known start of some states in all records, where a kind has it.
    """

    # Name and settings, for reports; settings by name in braces.
    words: ClassVar[str]

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return self.words.format_map(vars(self))

    @abstractmethod
    def _estimate(self, model: Model, dataset: Dataset) -> Regression:
        """Values of the free parameters, and their covariance."""

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate the free parameters from all records at once.

        Divergence in simulation overrides the status of what was found.

        Raises
        ------
        ModelError
            If the method cannot treat the model; the message says why and what to do.
        DataError
            If data and model do not belong together, or do not determine the parameters.
        """
        began = time.perf_counter()
        found = self._estimate(model, dataset)
        names, values = model.free_names, np.asarray(found.estimates, dtype=float)
        fitted = model.within_bounds(dict(zip(names, values, strict=True)))
        # What is not known of the start of a record is measured, or zero.
        initial = [first_state(model, one, getattr(self, "initial", None)) for one in dataset]
        runner, at = kernel(fitted), fitted.value_vector
        starts = zip(dataset, initial, strict=True)
        runs = [runner.simulate(one.times, one.inputs, at, own) for one, own in starts]
        residuals = [one.outputs - run.outputs for one, run in zip(dataset, runs, strict=True)]
        declared, stacked = given_levels(model.outputs), np.vstack(residuals)
        estimated = ~np.isfinite(declared)
        sizes = np.maximum(np.nan_to_num(root_mean_square(residuals)), 1e-12)
        sigma = np.where(estimated, sizes, declared)
        cost, status = np.inf, Status("diverged", DIVERGED)
        if all(run.ok for run in runs):
            cost, status = 0.5 * float(np.nansum((stacked / sigma) ** 2)), found.status
        return Fit(
            model=fitted,
            dataset=dataset,
            estimator=self.name,
            names=names,
            estimates=values,
            information=found.information or information_from_covariance(model, found.covariance),
            covariance=np.asarray(found.covariance, dtype=float),
            coloured=found.coloured,
            sigma=sigma,
            sigma_estimated=estimated,
            predictions=tuple(run.outputs for run in runs),
            residuals=tuple(residuals),
            states=tuple(run.states for run in runs),
            initial_states=tuple(initial),
            local_values=tuple({} for _ in dataset),
            cost=cost,
            status=status,
            iterations=found.iterations,
            seconds=time.perf_counter() - began,
            posterior=found.posterior,
            extras=dict(found.facts),
        )


def assumed_levels(model: Model, dataset: Dataset) -> np.ndarray:
    """Standard deviations ``(n_outputs,)``: as declared, else from differences of the samples."""
    levels = given_levels(model.outputs)
    return np.where(np.isfinite(levels), levels, white_levels(dataset)[0])


def information_from_covariance(model: Model, covariance: np.ndarray) -> Information:
    """Information whose covariance is the given one; nothing where that is infinite."""
    # In units of the parameters' magnitudes, so that one tolerance of rank serves all of them.
    scales = np.array([p.magnitude for p in model.free_parameters])
    scaled = np.asarray(covariance) / scales[:, None] / scales
    finite = np.isfinite(np.diag(scaled))
    matrix = np.zeros_like(scaled)
    block = np.ix_(finite, finite)
    matrix[block] = np.linalg.pinv(scaled[block], hermitian=True)
    return Information.from_matrix(model.free_names, matrix / scales[:, None] / scales, scales)


class RegressionEstimator(Baseline):
    """An estimator of linear equations of motion, by rows whose rates come from its ``rule``.

    A kind has the settings ``rule`` and, where it knows them, ``window`` (of a local cubic) and
    ``rates``; its ``apart`` says whether it solves each equation alone, so that none may share a
    parameter. Models that are not linear in their free parameters, and states that are not
    measured, are refused.
    """

    rule: str
    apart: ClassVar[bool] = True

    @abstractmethod
    def _solve(self, rows: Rows) -> Regression:
        """Solve the rows of all records."""

    def _estimate(self, model: Model, dataset: Dataset) -> Regression:
        known = {name: getattr(self, name) for name in ("window", "rates") if hasattr(self, name)}
        rows = rows_of(regression_form(model), dataset, rule=self.rule, **known)
        if self.apart:
            rows.check_separate()
        return self._solve(rows)


def each_equation(
    rows: Rows,
    solve: Callable[..., tuple[Sequence[str], Regression]],
    groups: Sequence[Sequence[int]] | None = None,
) -> Regression:
    """Solve equation by equation; ``extras`` holds the facts, by the state of the equation.

    ``groups`` are equations that are solved together, whose positions ``solve`` takes; it returns
    the names of their parameters and what was found of these.
    """
    names, equations = rows.form.names, rows.form.equations
    estimates, covariance = np.zeros(len(names)), np.zeros((len(names), len(names)))
    extras: dict[str, dict[str, Any]] = {}
    coloured = False
    for group in groups or [(index,) for index in range(len(equations))]:
        own, found = solve(*group)
        where = [names.index(name) for name in own]
        estimates[where] = found.estimates
        covariance[np.ix_(where, where)] = found.covariance
        coloured |= found.coloured
        for key, fact in found.facts.items():
            extras.setdefault(key, {})[", ".join(equations[i] for i in group)] = fact
    return Regression(estimates, covariance, coloured=coloured, facts=extras)


def solve_rows(rows: Rows, coloured: str = "auto") -> Regression:
    """Solve all equations together, each weighted by the spread of its own errors.

    Where no parameter is shared this is ordinary least squares of each equation.
    Priors enter as observations; bounds are kept.

    Parameters
    ----------
    rows : Rows
        NaN where a measurement is missing.
    coloured : str
        Whether errors that are correlated in time widen the covariance: ``"auto"``, ``"always"``
        or ``"never"``.
    """
    form, model = rows.form, rows.form.model
    n_free, n_equations = len(form.names), len(form.equations)
    targets, regressors = np.vstack(rows.targets), np.vstack(rows.regressors)
    valid = np.isfinite(targets) & np.isfinite(regressors).all(axis=2)
    # A row with a gap is one of zeros, which says nothing.
    targets = np.where(valid, targets, 0.0)
    regressors = np.where(valid[:, :, None], regressors, 0.0)
    # The first weights are sizes of the targets, as if the parameters were zero.
    spread = np.nan_to_num(root_mean_square([np.where(valid, targets, np.nan)]))
    levels = np.where(spread > 0, spread, 1.0)
    floor = 1e-10 * levels  # below it errors of an equation are rounding
    freedom = np.maximum(valid.sum(axis=0) - n_free / n_equations, 1.0)
    known, known_targets = prior_rows(model)

    def whitened(levels: np.ndarray) -> np.ndarray:
        return np.vstack([(regressors / levels[:, None]).reshape(-1, n_free), known])

    for _ in range(20):  # each equation weighed by its own errors, until these settle
        right = np.concatenate([(targets / levels).ravel(), known_targets])
        estimates = bounded_least_squares(whitened(levels), right, model)
        errors = targets - regressors @ estimates
        before, levels = levels, np.maximum(np.sqrt((errors**2).sum(axis=0) / freedom), floor)
        if np.abs(np.log(levels / before)).max() < 1e-6:
            break
    scales = np.array([p.magnitude for p in model.free_parameters])
    information = Information.from_jacobian(form.names, whitened(levels), scales)
    runs = zip(rows.targets, rows.regressors, strict=True)
    residuals = tuple(target - regressor @ estimates for target, regressor in runs)
    scaled = [residual / levels for residual in residuals]
    use = asks(coloured, is_coloured(scaled))
    covariance = information.covariance
    if use:
        ends = np.cumsum([len(target) for target in rows.targets])[:-1]
        jacobians = np.split(regressors / levels[:, None], ends)
        # A prior is one observation, and no series that could be correlated in time.
        middle = coloured_score_covariance(jacobians, scaled) + known.T @ known
        covariance = sandwich(covariance, middle)
    by_equation = dict(zip(form.equations, map(float, levels), strict=True))
    extras = {"equation_errors": by_equation, "equation_residuals": residuals}
    return Regression(estimates, covariance, information, use, facts=extras)


def column_norms(matrix: np.ndarray) -> np.ndarray:
    """Norms of the columns, one of empty ones: what brings columns to one size."""
    norms = np.linalg.norm(matrix, axis=0)
    return np.where(norms > 0, norms, 1.0)


def bounded_least_squares(matrix: np.ndarray, right: np.ndarray, model: Model) -> np.ndarray:
    """Least squares of smallest scaled norm, within the bounds of the free parameters."""
    scale = 1.0 / column_norms(matrix)
    solution = scale * np.linalg.lstsq(matrix * scale, right, rcond=1e-13)[0]
    lower, upper = np.array([(p.lower, p.upper) for p in model.free_parameters]).T
    if np.all(solution >= lower) and np.all(solution <= upper):
        return solution
    # SciPy wants a lower bound below the upper one, also where both hold a value.
    open_upper = np.where(upper > lower, upper, np.nextafter(lower, np.inf))
    result = lsq_linear(matrix * scale, right, (lower / scale, open_upper / scale))
    return np.clip(scale * result.x, lower, upper)


def residual_covariance(
    matrix: np.ndarray, errors: np.ndarray, freedom: int, penalty: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Covariance of least squares from its residuals, and whether these are correlated in time.

    Parameters
    ----------
    matrix : ndarray (n_rows, n)
        Regressors.
    errors : ndarray (n_rows,)
    freedom : int
        Rows beyond the parameters that were estimated.
    penalty : ndarray (n, n)
        What the curvature has beside that of the regressors.
    """
    variance = float(errors @ errors) / max(freedom, 1)
    if variance <= 0:
        return np.zeros_like(penalty), False
    scale = 1.0 / column_norms(matrix)
    rows, units = matrix * scale, np.outer(scale, scale)
    bread = np.linalg.pinv(rows.T @ rows + penalty * units, hermitian=True, rcond=1e-15)
    scaled = (errors / np.sqrt(variance))[:, None]
    coloured = is_coloured([scaled])
    middle = rows.T @ rows
    if coloured:
        middle = coloured_score_covariance([rows[:, None, :]], [scaled])
    return variance * sandwich(bread, middle) * units, coloured


def prior_rows(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Priors as whitened rows ``(n_priors, n_free)`` and targets ``(n_priors,)``."""
    free = model.free_parameters
    weights = np.array([1.0 / p.prior_spread if p.prior_spread else 0.0 for p in free])
    means = np.array([p.prior_mean or 0.0 for p in free])
    known = np.flatnonzero(weights)
    return np.diag(weights)[known], (weights * means)[known]


@dataclass(frozen=True, eq=False)
class SeparateSolution:
    """What a solver found for one equation, in scaled units.

    Attributes
    ----------
    coefficients : ndarray (n_features,)
    bias : float
    ridge : float
        Weight of ``|coefficients|^2`` against a squared error; enters the errors.
    track : ndarray (n_rows, n_features + 1) or None
        Coefficients and bias after every row, of recursive solvers.
    facts : mapping
        What the solver has to tell about this equation.
    """

    coefficients: np.ndarray
    bias: float
    ridge: float = 0.0
    track: np.ndarray | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)


Solver = Callable[[np.ndarray, np.ndarray, bool], SeparateSolution]


def positive(scale: Mapping[str, float], names: Sequence[str], what: str) -> np.ndarray:
    """Numbers by name in the order of the names; none may be missing, zero or negative."""
    if missing := [name for name in names if not scale.get(name, 0.0) > 0]:
        raise ModelError(
            f"scale gives no positive number for the {what} {', '.join(missing)}. Give one for "
            f"each of {', '.join(names)}."
        )
    return np.array([scale[name] for name in names], dtype=float)


def _constant(features: np.ndarray, names: Sequence[str], equation: str) -> int | None:
    """Which regressor of an equation is a constant, whose parameter its bias stands for."""
    if not len(features):
        raise ModelError(f"No complete row is left for the equation of {equation}: all are NaN.")
    span, size = np.ptp(features, axis=0), np.abs(features).max(axis=0)
    found = np.flatnonzero((span <= 1e-12 * size) & (size > 0)).tolist()
    if len(found) > 1:
        raise ModelError(
            f"{', '.join(names[i] for i in found)} are all constant terms of the equation of "
            f"{equation}. Fix all but one."
        )
    return found[0] if found else None


def _units(
    features: np.ndarray, targets: np.ndarray, scale: str | float
) -> tuple[np.ndarray, float]:
    """What features ``(n_features,)`` and targets of an equation are divided by."""
    if scale != "unit":
        divisor = 1.0 if isinstance(scale, str) else float(scale)
        return np.full(features.shape[1], divisor), divisor
    sizes = np.sqrt(np.mean(features**2, axis=0))
    return np.where(sizes == 0, 1.0, sizes), float(np.sqrt(np.mean(targets**2))) or 1.0


def separate(
    rows: Rows,
    solver: Solver,
    *,
    scale: str | Mapping[str, float] = "raw",
) -> Regression:
    """Solve every equation with ``solver(features, targets, bias)``.

    Equations that share parameters are solved as one, each divided by its scale and without a
    bias.

    Returns
    -------
    Regression
        ``extras``: ``bias`` and whatever the solver tells, by the state of the equation, and
        ``history``, the value of each parameter after every row, of recursive solvers.
    """
    equations, history = rows.form.equations, dict[str, np.ndarray]()
    if isinstance(scale, str):
        check_choice("scale", scale, ("raw", "unit"))
        scales: Any = [scale] * len(equations)
    else:
        scales = positive(scale, equations, "equation of")

    def solve(*group: int) -> tuple[Sequence[str], Regression]:
        if alone := len(group) == 1:
            features, targets, names = rows.equation(*group)
            constant, own = _constant(features, names, equations[group[0]]), scales[group[0]]
        else:
            features, targets, names = _coupled(rows, group, scales)
            constant, own = None, scale if isinstance(scale, str) else "raw"
        order = [i for i in range(len(names)) if i != constant]
        sizes, divisor = _units(features[:, order], targets, own)
        scaled, aims = features[:, order] / sizes, targets / divisor
        solution = solver(scaled, aims, alone)
        block, coloured = solution_covariance(scaled, aims, solution, alone)
        # Coefficients and the bias, which stands for the constant parameter where there is one.
        level = 1.0 if constant is None else float(features[0, constant])
        order += [] if constant is None else [constant]
        n, units = len(order), np.append(divisor / sizes, divisor / level)
        owners = [names[i] for i in order]
        values = (np.append(solution.coefficients, solution.bias) * units)[:n]
        if solution.track is not None:
            history.update(zip(owners, (solution.track * units).T, strict=False))
        facts = {"bias": solution.bias * divisor, **solution.facts}
        covariance = (block * units[:, None] * units)[:n, :n]
        return owners, Regression(values, covariance, coloured=coloured, facts=facts)

    found = each_equation(rows, solve, rows.groups())
    return replace(found, facts={**found.facts, "history": history}) if history else found


def _coupled(
    rows: Rows, group: Sequence[int], scales: Sequence[str | float]
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Rows of several equations below each other, divided by their scales: as of one equation."""
    parts = [rows.equation(index) for index in group]
    names = tuple(dict.fromkeys(name for *_, own in parts for name in own))
    features, targets = [], []
    for (own, aims, known), index in zip(parts, group, strict=True):
        _, divisor = _units(own, aims, scales[index])
        wide = np.zeros((len(aims), len(names)))
        wide[:, [names.index(name) for name in known]] = own / divisor
        features.append(wide)
        targets.append(aims / divisor)
    return np.vstack(features), np.concatenate(targets), names


def solution_covariance(
    features: np.ndarray, targets: np.ndarray, solution: SeparateSolution, with_bias: bool
) -> tuple[np.ndarray, bool]:
    """Covariance of ``[coefficients, bias]`` in scaled units, and whether errors are coloured."""
    n, n_features = features.shape
    matrix = np.hstack([features, np.full((n, 1), float(with_bias))])
    errors = targets - features @ solution.coefficients - solution.bias
    # The ridge pulls the coefficients, not the bias.
    penalty = np.diag([*np.full(n_features, solution.ridge), 0.0])
    return residual_covariance(matrix, errors, n - n_features - with_bias, penalty)
