"""Solving each equation of motion as a regression of its own, as published baselines do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.estimators.baselines.regression_rows import Rows
from oed_sysid.estimators.baselines.regression_solution import are_coloured
from oed_sysid.information import coloured_score_covariance
from oed_sysid.model import Model


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
class SeparateEstimates:
    """All equations together.

    Attributes
    ----------
    estimates : ndarray (n_free,)
    covariance : ndarray (n_free, n_free)
    coloured : bool
        Whether the covariance accounts for errors correlated in time.
    facts : mapping
        ``bias`` and whatever the solver tells, by the state of the equation.
    history : mapping of str to ndarray (n_rows,)
        Value of each parameter after every row, of recursive solvers.
    """

    estimates: np.ndarray
    covariance: np.ndarray
    coloured: bool
    facts: Mapping[str, Mapping[str, Any]]
    history: Mapping[str, np.ndarray]


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
    if isinstance(scale, str):
        target_unit = 1.0 if scale == "raw" else float(np.sqrt(np.mean(targets**2))) or 1.0
        column_units = np.full(kept.shape[1], target_unit)
        if scale == "unit":
            column_units = np.sqrt(np.mean(kept**2, axis=0))
            column_units[column_units == 0] = 1.0
    else:
        target_unit = float(scale[equation])
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
    model: Model,
    solver: Solver,
    *,
    scale: str | Mapping[str, float] = "raw",
    bias: bool = True,
) -> SeparateEstimates:
    """Solve every equation with ``solver(features, targets, bias)``.

    Returns
    -------
    SeparateEstimates
        In the order of the model's free parameters.
    """
    rows.check_separate()
    names = rows.form.names
    estimates = np.zeros(len(names))
    covariance = np.zeros((len(names), len(names)))
    facts: dict[str, dict[str, Any]] = {"bias": {}}
    history: dict[str, np.ndarray] = {}
    coloured = False
    for index, equation in enumerate(rows.form.equations):
        part = scaled_equation(rows, index, scale)
        with_bias = bias or part.constant is not None
        solution = solver(part.features, part.targets, with_bias)
        for name, value in zip(part.names, solution.coefficients * part.units, strict=True):
            estimates[names.index(name)] = value
        if part.constant is not None:
            estimates[names.index(part.constant)] = solution.bias * part.constant_unit
        facts["bias"][equation] = solution.bias * part.target_unit
        for key, fact in solution.facts.items():
            facts.setdefault(key, {})[equation] = fact
        block, use = equation_covariance(part, solution, with_bias)
        coloured |= use
        units = np.concatenate([part.units, [part.constant_unit]])
        block = block * units[:, None] * units
        involved = [*part.names, part.constant] if part.constant else list(part.names)
        if solution.track is not None:
            history |= dict(zip(involved, (solution.track * units).T, strict=False))
        where = [names.index(name) for name in involved]
        covariance[np.ix_(where, where)] = block[: len(involved), : len(involved)]
    return SeparateEstimates(estimates, covariance, coloured, facts, history)


def equation_covariance(
    part: ScaledEquation, solution: SeparateSolution, with_bias: bool
) -> tuple[np.ndarray, bool]:
    """Covariance of ``[coefficients, bias]`` in scaled units, and whether errors are coloured."""
    n, n_features = part.features.shape
    ones = np.full((n, 1), 1.0 if with_bias else 0.0)
    matrix = np.hstack([part.features, ones])
    weights = np.ones(n) if solution.weights is None else solution.weights
    errors = part.targets - part.features @ solution.coefficients - solution.bias
    freedom = max(float(weights.sum()) - n_features - with_bias, 1.0)
    variance = float(weights @ errors**2) / freedom
    norms = np.linalg.norm(matrix, axis=0)
    scale = 1.0 / np.where(norms > 0, norms, 1.0)
    matrix = matrix * scale
    penalty = np.diag([*np.full(n_features, solution.ridge), 0.0]) * scale**2
    bread = np.linalg.pinv((matrix.T * weights) @ matrix + penalty, hermitian=True, rcond=1e-15)
    if variance <= 0:
        return np.zeros_like(bread), False
    weighted = matrix * weights[:, None]
    scaled = (errors / np.sqrt(variance))[:, None]
    coloured = are_coloured([scaled])
    middle = weighted.T @ weighted
    if coloured:
        middle = coloured_score_covariance([weighted[:, None, :]], [scaled])
    return variance * (bread @ middle @ bread) * scale[:, None] * scale, coloured
