"""From the end of the iterations to a :class:`~oed_sysid.fit.Fit`."""

from __future__ import annotations

import time

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from oed_sysid.fit import COLOUR_LIMIT, Fit, Status
from oed_sysid.gauss_newton import Solution
from oed_sysid.information import (
    Information,
    coloured_score_covariance,
    effective_sample_size,
)
from oed_sysid.shooting import Linearisation, Shooting, replace_values

_ADVICE = {
    "converged": "",
    "stalled": (
        "no step lowers the misfit, yet the gradient is not zero. Values are the best found; "
        "check bounds and not identifiable parameters, or shorten the shooting interval."
    ),
    "iterations": "the limit of iterations was reached. Raise max_iterations or start closer.",
    "diverged": (
        "the model leaves the numbers from every start that was tried. Check signs and units of "
        "the start values, reduce model.step, or bound the parameters."
    ),
}


def summarise(
    shooting: Shooting,
    solution: Solution | None,
    estimated: np.ndarray,
    estimator: str,
    iterations: int,
    began: float,
    *,
    coloured: str = "auto",
) -> Fit:
    """Build the result of an estimation from its last iterate.

    Parameters
    ----------
    shooting : Shooting
        The problem, at the final noise levels.
    solution : Solution or None
        Last iterate; None where no trajectory was finite.
    estimated : ndarray of bool (n_outputs,)
        Which noise levels were estimated.
    estimator : str
        Name for reports.
    iterations : int
        Iterations in all.
    began : float
        ``time.perf_counter()`` at the start.
    coloured : str
        ``"auto"``, ``"never"`` or ``"always"``.
    """
    model, layout = shooting.model, shooting.layout
    if solution is None:
        return _failed(shooting, estimated, estimator, iterations, began)
    unknowns = solution.point.unknowns
    n_shared = len(layout.shared)
    matrix, _ = shooting.normal_equations(solution.linearisation)
    matrix = matrix + np.diag(shooting.limits.prior_weight)
    reduced = eliminate(matrix, n_shared)
    names = tuple(layout.free_names[i] for i in layout.shared)
    scales = shooting.limits.scale[:n_shared]
    information = Information.from_matrix(names, reduced, scales)
    covariance = information.covariance
    use = coloured == "always" or (coloured == "auto" and is_coloured(solution.linearisation))
    if use:
        covariance = sandwich(shooting, solution.linearisation, matrix, information)
    points = shooting.continuous(unknowns)
    predictions, states, residuals, initial, local = [], [], [], [], []
    for index, record in enumerate(shooting.records):
        values = shooting.values(unknowns, index)
        own = shooting.initial_state(unknowns, index)
        z0, _ = shooting.kernel.start(own, record.inputs[0], values, record.times[0])
        run = shooting.kernel.run(record.times, record.inputs, values, z0)
        predictions.append(run.outputs)
        states.append(run.states)
        residuals.append(record.outputs - run.outputs)
        initial.append(own.copy())
        free = unknowns[layout.record_columns(index)[layout.n_own :]]
        local.append({layout.free_names[i]: float(free[i]) for i in layout.local})
    return Fit(
        model=replace_values(model, shooting, points.unknowns),
        dataset=shooting.dataset,
        estimator=estimator,
        names=names,
        estimates=unknowns[:n_shared].copy(),
        information=information,
        covariance=covariance,
        coloured=use,
        sigma=shooting.sigma.copy(),
        sigma_estimated=np.asarray(estimated, dtype=bool),
        predictions=tuple(predictions),
        residuals=tuple(residuals),
        states=tuple(states),
        initial_states=tuple(initial),
        local_values=tuple(local),
        cost=solution.cost,
        status=Status(solution.reason, _ADVICE[solution.reason]),
        iterations=iterations,
        seconds=time.perf_counter() - began,
    )


def eliminate(matrix: np.ndarray, n_keep: int) -> np.ndarray:
    """Information of the first unknowns when the others are unknown too (Schur)."""
    if n_keep == len(matrix):
        return matrix
    keep, drop = slice(0, n_keep), slice(n_keep, None)
    inner = matrix[drop, drop]
    diagonal = np.diag(inner)
    seen = diagonal > 0
    scale = 1.0 / np.sqrt(diagonal[seen])
    scaled = inner[np.ix_(seen, seen)] * scale[:, None] * scale
    cross = matrix[drop, keep][seen] * scale[:, None]
    try:
        solved = cho_solve(cho_factor(scaled), cross)
    except LinAlgError:
        solved = np.linalg.lstsq(scaled, cross, rcond=1e-12)[0]
    return matrix[keep, keep] - cross.T @ solved


def is_coloured(lin: Linearisation) -> bool:
    """Whether residuals count clearly fewer independent samples than they have."""
    effective = total = 0.0
    for residual in lin.residuals:
        for column in residual.T:
            n = int(np.isfinite(column).sum())
            if n > 20:
                effective += effective_sample_size(column)
                total += n
    return total > 0 and effective < COLOUR_LIMIT * total


def sandwich(
    shooting: Shooting, lin: Linearisation, matrix: np.ndarray, information: Information
) -> np.ndarray:
    """Covariance of the shared parameters when residuals are coloured.

    ``H^-1 B H^-1`` with ``B`` the covariance of the score under the residuals'
    own colour, reduced to the parameters by eliminating the initial states.
    """
    layout = shooting.layout
    n_shared = len(layout.shared)
    drop = slice(n_shared, None)
    # Each parameter column with the initial states projected out.
    inner, cross = matrix[drop, drop], matrix[drop, :n_shared]
    projection = np.linalg.lstsq(inner, cross, rcond=1e-12)[0] if len(inner) else cross
    jacobians, residuals = [], []
    for index in range(layout.n_records):
        columns = layout.record_columns(index)
        residual = lin.residuals[index] / shooting.sigma
        present = np.isfinite(residual)
        full = np.zeros((*residual.shape, layout.n_unknowns))
        full[:, :, columns] = lin.jacobians[index] * (present / shooting.sigma)[:, :, None]
        reduced = full[:, :, :n_shared] - full[:, :, drop] @ projection
        jacobians.append(reduced)
        residuals.append(residual)
    middle = coloured_score_covariance(jacobians, residuals)
    prior = np.diag(shooting.limits.prior_weight[:n_shared])
    white = information.covariance
    finite = np.isfinite(np.diag(white))
    result = white.copy()
    block = np.ix_(finite, finite)
    result[block] = white[block] @ (middle + prior)[block] @ white[block]
    return result


def _failed(
    shooting: Shooting, estimated: np.ndarray, estimator: str, iterations: int, began: float
) -> Fit:
    names = tuple(shooting.layout.free_names[i] for i in shooting.layout.shared)
    n = len(names)
    shapes = [record.outputs.shape for record in shooting.records]
    unknown = tuple(np.full(shape, np.nan) for shape in shapes)
    return Fit(
        model=shooting.model,
        dataset=shooting.dataset,
        estimator=estimator,
        names=names,
        estimates=np.array([shooting.model.values[name] for name in names]),
        information=Information(names, np.zeros((n, n)), np.ones(n)),
        covariance=np.diag(np.full(n, np.inf)) if n else np.zeros((0, 0)),
        coloured=False,
        sigma=shooting.sigma.copy(),
        sigma_estimated=np.asarray(estimated, dtype=bool),
        predictions=unknown,
        residuals=unknown,
        states=tuple(np.full((shape[0], shooting.kernel.n_full), np.nan) for shape in shapes),
        initial_states=tuple(np.full(shooting.layout.n_own, np.nan) for _ in shapes),
        local_values=tuple({} for _ in shapes),
        cost=np.inf,
        status=Status("diverged", _ADVICE["diverged"]),
        iterations=iterations,
        seconds=time.perf_counter() - began,
    )
