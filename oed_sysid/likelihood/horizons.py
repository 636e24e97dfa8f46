r"""Least squares over short predictions: how far ahead a fit has to be right.

A record is cut into windows of a horizon :math:`H` that overlap by one sample, so that every
transition from a sample to the next belongs to exactly one. Each window begins from a state of its
own, and with the outputs :math:`h` of the trajectory that starts there,

.. math::
    \min_{p} \sum_w \min_{x_w} \sum_{k \in w} \frac{|y_k - h(\varphi(t_k; x_w, p))|^2}{\sigma^2}
        + \text{priors}.

Over one step this is a regression of the motion on the state before; over the whole record it is
maximum likelihood with white noise. Where the structure is wrong a long horizon lets its misfit
into the derivatives, a short one weighs noise in the states more.

How it is minimised says :mod:`oed_sysid.likelihood.windows`. Scores of windows are not independent
where residuals are coloured: the covariance is :math:`H^{-1} B H^{-1}` with :math:`B` their
covariance, neighbours within a tenth of the record included (Newey & West 1987, Econometrica 55).
Where windows are too few for that, it is :math:`H^{-1}` times the residuals' mean square in units
of the noise and the samples per independent one. Independent tests, such as captive ones, add to
:math:`B` as :mod:`oed_sysid.likelihood.covariance` says, priors as much as they say.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from oed_sysid.errors import DataError
from oed_sysid.likelihood.between_records import Sources, sources_of
from oed_sysid.likelihood.covariance import (
    ReducedProblem,
    Scores,
    onto_shared,
    sandwich,
)
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import Convergence, Descent, Progress, Solution
from oed_sysid.likelihood.information import Information, effective_sample_size
from oed_sysid.likelihood.shooting import Point, Shooting
from oed_sysid.likelihood.summary import Procedure
from oed_sysid.likelihood.windows import CONTROL, Windows

# Share of a record's windows over which scores are taken to be related.
RELATED = 0.1
# Windows per parameter that a covariance from their scores needs.
ENOUGH = 4


def check_horizon(shooting: Shooting, horizon: float) -> None:
    """Raise :class:`DataError` where a horizon is shorter than one step of the records."""
    series = [record for record in shooting.records if not record.independent]
    longest = max((record.sample_time for record in series), default=0.0)
    if not horizon >= 0.99 * longest:
        raise DataError(
            f"horizon is {horizon:g} s, and a step of the records {longest:g} s. Give at least one "
            "step; horizon=None predicts whole records."
        )


def solve_windows(
    shooting: Shooting,
    point: Point,
    *,
    horizon: float,
    max_iterations: int,
    tolerance: float,
    callback: Callable[[Progress], None] | None = None,
) -> Solution | None:
    """Minimise over windows of a horizon; None where the model diverges within the first.

    Parameters
    ----------
    shooting : Shooting
        The problem.
    point : Point
        Where to begin; only its unknowns are used.
    horizon : float
        Length of a window, s.
    max_iterations, tolerance, callback
        See :func:`oed_sysid.likelihood.gauss_newton.solve`.
    """
    problem = Windows.overlapping(shooting, horizon, point.unknowns)
    begin = problem.at(problem.start)
    if begin is None:
        return None
    descent = Descent(begin, Windows.at, Convergence(tolerance), CONTROL)
    reason = descent.run(max_iterations, callback=callback)
    return Solution(descent.now, descent.steps + 1, reason)


def summarise_windows(solution: Solution, how: Procedure) -> Fit:
    """Build the result; its predictions and residuals are those of the windows.

    Unless errors are ``"never"`` to hold the colour of residuals, they are those at the head of
    this module.
    """
    problem, unknowns = solution.problem, solution.point.unknowns
    shooting = problem.shooting
    paths, own = problem.paths(solution.point), how.coloured
    information, covariance, sources, scattered = _uncertainty(problem, solution.point, own)
    end = solution.reason, solution.cost
    fit = how.fit(shooting, unknowns, end, information, paths, sources)
    n_own = shooting.layout.n_own
    return replace(
        fit,
        covariance=covariance,
        coloured=how.coloured != "never" and problem.n_windows > 0,
        initial_states=tuple(states[0, :n_own].copy() for _, states in paths),
        horizon=problem.horizon,
        n_windows=problem.n_windows,
        tests_scatter=scattered,
    )


def _uncertainty(
    problem: Windows, point: Point, coloured: str
) -> tuple[Information, np.ndarray, Sources | None, bool]:
    """Information and covariance of the shared parameters, their sources, whether tests scatter."""
    shooting, unknowns = problem.shooting, point.unknowns
    layout, limits = shooting.layout, shooting.limits
    n_shared = len(layout.shared)
    slopes = layout.shared_values(unknowns)[1]
    prior = np.diag(limits.prior_weight[:n_shared] / slopes**2)
    told = _told_by_records(problem, point)
    tests = np.array([record.independent for record in shooting.records])
    matrices = np.array([matrix for matrix, _ in told])
    whole = prior + matrices.sum(axis=0)
    information = Information.from_matrix(
        layout.shared_names, whole, limits.scale[:n_shared] * slopes
    )
    sums = [rows.sum(axis=0) for _, rows in told]
    sources = sources_of(list(matrices), sums, prior, shooting.records)
    covariance = information.covariance
    if coloured == "never" or not n_shared:
        return information, covariance, sources, False
    alone = _tests(shooting, np.flatnonzero(tests).tolist(), unknowns)
    scattered = alone is not None and (coloured == "always" or alone.stray(covariance))
    scores = [told[i][1] for i in np.flatnonzero(~tests)]
    middle = prior + _middle(problem, point, scores, matrices[~tests].sum(axis=0))
    if alone is not None:
        middle += alone.of_tests(covariance, scattered=scattered)
    return information, sandwich(covariance, middle), sources, scattered


def _told_by_records(problem: Windows, point: Point) -> list[tuple[np.ndarray, np.ndarray]]:
    """What every record says of the shared parameters, its own ones estimated along.

    Information ``(n_shared, n_shared)``, and scores of the windows in their order,
    ``(n_windows, n_shared)``.
    """
    shooting, n_free = problem.shooting, len(problem.shooting.layout.free_names)
    matrices = np.zeros((len(shooting.records), n_free, n_free))
    scores: list[list[np.ndarray]] = [[] for _ in shooting.records]
    for part, matrix, own in problem.told(point):
        matrices[part.record] += matrix
        scores[part.record].append(np.column_stack([part.starts[part.counted], own]))
    told = []
    for index, matrix in enumerate(matrices):
        onto, _ = onto_shared(shooting, point.unknowns, index, matrix)
        rows = np.vstack(scores[index])
        rows = rows[np.argsort(rows[:, 0]), 1:]
        told.append((onto @ matrix @ onto.T, rows @ onto.T))
    return told


def _middle(
    problem: Windows, point: Point, scores: Sequence[np.ndarray], told: np.ndarray
) -> np.ndarray:
    """Covariance of the summed scores of the windows; from the residuals where they are few."""
    if problem.n_windows < ENOUGH * len(told):
        return _inflation(problem, point) * told
    return sum(map(_summed, scores), np.zeros_like(told))


def _tests(shooting: Shooting, tests: list[int], unknowns: np.ndarray) -> Scores | None:
    """Jacobian and residuals of independent tests; None without any."""
    if not tests:
        return None
    alone, own = shooting.part(tests, unknowns)
    found = alone.linearise(alone.continuous(own))
    assert found is not None
    return ReducedProblem(alone, found, own).told


def _summed(rows: np.ndarray) -> np.ndarray:
    """Covariance of the sum of a record's scores ``(n_windows, n_shared)``, neighbours related."""
    middle = rows.T @ rows
    reach = int(RELATED * len(rows)) + 1
    for lag in range(1, min(reach, len(rows) - 1) + 1):
        # Weights of Bartlett: the sum stays positive semidefinite.
        related = rows[lag:].T @ rows[:-lag]
        middle += (1 - lag / (reach + 1)) * (related + related.T)
    return np.asarray(middle)


def _inflation(problem: Windows, point: Point) -> float:
    """Mean square of the residuals in units of the noise, times samples per independent one."""
    shooting = problem.shooting
    ratios = []
    for record, residual in zip(shooting.records, problem.residuals(point), strict=True):
        for column in (residual / shooting.sigma).T:
            seen = column[np.isfinite(column)]
            if len(seen) > 10 and not record.independent:
                mean_square = float(np.mean(seen**2))
                ratios.append(mean_square * len(seen) / effective_sample_size(column))
    return max(float(np.mean(ratios)) if ratios else 0.0, 1.0)
