"""From the end of the iterations to a :class:`~oed_sysid.likelihood.fit.Fit`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.compiled.filtering import FilterPass
from oed_sysid.likelihood.between_records import Sources, scatter_of, sources_of
from oed_sysid.likelihood.covariance import (
    ReducedProblem,
    clear_peaks,
    shared_rows,
    tests_middle,
    widened,
)
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.fit import Fit, Status
from oed_sysid.likelihood.gauss_newton import FilteredSolution, Solution
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.projection import eliminate, inverse_of, share_of
from oed_sysid.likelihood.shooting import Shooting

ADVICE = {
    "converged": "",
    "stalled": (
        "no step lowers the misfit, yet the gradient is not zero. Values are the best found; "
        "check bounds and not identifiable parameters, or shorten the shooting interval."
    ),
    "enough": "white noise does not explain the residuals, and iterations ended early.",
    "iterations": "the limit of iterations was reached. Raise max_iterations or start closer.",
    "interrupted": "stopped by the user. Values are the best so far; fit(..., warm=fit) goes on.",
    "infeasible": (
        "no trajectory satisfies the constraints. Loosen them, or start from values that do."
    ),
    "diverged": (
        "the model diverges from every start that was tried. Check signs and units of "
        "the start values, reduce model.step, or bound the parameters."
    ),
}


@dataclass(frozen=True, eq=False)
class Procedure:
    """How an estimation was made, whatever was minimised.

    Attributes
    ----------
    name : str
        Of the estimator, for reports.
    estimated : ndarray of bool (n_outputs,)
        White noise levels that nobody had declared.
    iterations : int
        In all.
    began : float
        ``time.perf_counter()`` at the start.
    coloured : str
        ``"auto"``, ``"never"`` or ``"always"``: whether errors hold the colour of residuals, and
        what independent tests scatter beyond their declared noise.
    """

    name: str
    estimated: np.ndarray
    iterations: int
    began: float
    coloured: str = "auto"

    def asks(self, found: bool) -> bool:
        """Whether errors hold what was or was not found in the residuals."""
        return self.coloured == "always" or (self.coloured == "auto" and found)

    def fit(
        self,
        problem: Shooting | Filtered,
        unknowns: np.ndarray,
        end: tuple[str, float],
        information: Information,
        paths: Sequence[tuple[np.ndarray, np.ndarray]],
        sources: Sources | None = None,
    ) -> Fit:
        """The result at some unknowns, errors as if residuals were white.

        Parameters
        ----------
        problem : Shooting or Filtered
        unknowns : ndarray (n_unknowns,)
        end : pair of str and float
            How the iterations ended, and the cost.
        information : Information
            Of the shared parameters.
        paths : sequence of pair of ndarray
            Outputs ``(n_times, n_outputs)`` and states ``(n_times, n_full)``, per record.
        sources : Sources, optional
        """
        layout, starts = problem.layout, problem.known_starts
        outputs = tuple(outputs for outputs, _ in paths)
        own = range(len(problem.records))
        return Fit(
            model=problem.model.with_values(layout.means(problem.model, unknowns)),
            dataset=problem.dataset,
            estimator=self.name,
            names=layout.shared_names,
            estimates=layout.shared_values(unknowns)[0],
            information=information,
            covariance=information.covariance,
            record_scatter=None if sources is None else scatter_of(sources),
            sources=sources,
            coloured=False,
            sigma=problem.white(unknowns).copy(),
            sigma_estimated=np.asarray(self.estimated, dtype=bool),
            predictions=outputs,
            residuals=tuple(r.outputs - o for r, o in zip(problem.records, outputs, strict=True)),
            states=tuple(states for _, states in paths),
            initial_states=tuple(problem.initial_state(unknowns, i).copy() for i in own),
            local_values=tuple(layout.local_values(unknowns)),
            cost=end[1],
            status=Status(end[0], ADVICE[end[0]]),
            iterations=self.iterations,
            seconds=time.perf_counter() - self.began,
            start_states=() if starts is None else starts.described(problem.model),
        )


def summarise(
    shooting: Shooting, solution: Solution | None, how: Procedure, *, weighed: bool = True
) -> Fit:
    """Build the result of an estimation from its last iterate.

    Parameters
    ----------
    shooting : Shooting
        The problem, at the final noise levels.
    solution : Solution or None
        Last iterate; None where no trajectory was finite.
    how : Procedure
    weighed : bool
        Whether the covariance holds the colour of the residuals; otherwise it is only said
        whether they have one.
    """
    if solution is None:
        return _failed(shooting, how)
    unknowns = solution.point.unknowns
    reduced = ReducedProblem(shooting, solution.linearisation, unknowns)
    runs = [shooting.run(unknowns, index) for index in range(len(shooting.records))]
    fit = how.fit(
        shooting, unknowns, (solution.reason, solution.cost), reduced.information,
        [(run.outputs, run.states) for run in runs], reduced.sources,
    )  # fmt: skip
    covariance, use = fit.covariance, how.asks(reduced.is_coloured)
    scattered = how.asks(reduced.told.stray(covariance))
    if ((use or scattered) and weighed) or shooting.loss is not None:
        covariance = reduced.sandwich(covariance, coloured=use, scattered=scattered)
    tests = any(record.independent for record in shooting.records)
    scattered = scattered and tests
    return replace(fit, covariance=covariance, coloured=use, tests_scatter=scattered)


def _failed(shooting: Shooting, how: Procedure) -> Fit:
    """The result where no trajectory is finite: start values, of which nothing is known."""
    layout = shooting.layout
    n, n_full = len(layout.shared), shooting.kernel.n_full
    paths = [
        (np.full(record.outputs.shape, np.nan), np.full((record.n_samples, n_full), np.nan))
        for record in shooting.records
    ]
    nothing = Information(layout.shared_names, np.zeros((n, n)), np.ones(n))
    fit = how.fit(shooting, shooting.start_unknowns(), ("diverged", np.inf), nothing, paths)
    unknown = tuple(np.full(layout.n_own, np.nan) for _ in shooting.records)
    return replace(fit, initial_states=unknown, local_values=({},) * len(unknown), start_states=())


def summarise_filtered(solution: FilteredSolution, how: Procedure) -> Fit:
    r"""Build the result of an estimation with disturbance forces from its last iterate.

    With the information ``H`` of all unknowns, start states, per-record parameters and
    levels ``o`` are eliminated from that of the shared parameters ``p``,
    :math:`H_{pp} - H_{po} H_{oo}^{-1} H_{op}`. Where innovations swing with a period of their own,
    the covariance is that of :mod:`oed_sysid.likelihood.covariance`.

    Parameters
    ----------
    solution : FilteredSolution
    how : Procedure
    """
    problem, unknowns = solution.problem, solution.point.unknowns
    layout, limits = problem.layout, problem.limits
    matrix = solution.matrix + np.diag(limits.prior_weight)
    shared = np.arange(len(layout.shared))
    slopes = layout.shared_values(unknowns)[1]
    reduced = eliminate(matrix, shared, problem.open_unknowns(len(shared)))
    information = Information.from_matrix(
        layout.shared_names, reduced / slopes[:, None] / slopes, limits.scale[shared] * slopes
    )
    # Derivatives serve the comparison of records alone.
    passes = problem.passes(unknowns, columns=len(shared) > 0)
    std = [np.sqrt(np.maximum(part.variances, 1e-300)) for part in passes]
    whitened = [
        np.full(part.innovations.shape, np.nan) if record.independent else part.innovations / one
        for record, part, one in zip(problem.records, passes, std, strict=True)
    ]
    peaks = clear_peaks(whitened, problem.records, problem.model.output_names)
    white = covariance = information.covariance
    if peaks:
        period = max(peak.period for peak in peaks)
        white = covariance = widened(problem, unknowns, matrix, covariance, period)
    if how.coloured != "never":
        covariance = _with_stray_tests(problem, unknowns, matrix, information, covariance)
    paths = []
    for index in range(len(problem.records)):
        outputs, path, _ = problem.alone(unknowns, index)
        paths.append((outputs, path if problem.own is None else path[:, problem.own]))
    cost = 0.5 * sum(part.square for part in passes) + problem.prior_cost(unknowns)
    sources = _sources(problem, unknowns, passes)
    fit = how.fit(problem, unknowns, (solution.reason, cost), information, paths, sources)
    return replace(
        fit,
        covariance=covariance,
        coloured=bool(peaks),
        noise=problem.noise(unknowns),
        noise_std=_level_errors(solution, matrix),
        innovations=tuple(part.innovations for part in passes),
        innovation_std=tuple(
            np.where(np.isfinite(record.outputs), one, 1.0)
            for record, one in zip(problem.records, std, strict=True)
        ),
        tests_scatter=covariance is not white,
    )


def _with_stray_tests(
    problem: Filtered,
    unknowns: np.ndarray,
    matrix: np.ndarray,
    information: Information,
    covariance: np.ndarray,
) -> np.ndarray:
    """Covariance with what independent tests scatter beyond their declared noise."""
    white = information.covariance
    if not any(record.independent for record in problem.records) or not len(white):
        return covariance
    told = shared_rows(problem, unknowns, matrix)
    if not told.stray(white):
        return covariance
    rows, residuals = told.tests
    more = tests_middle(rows, residuals, white, scattered=True)
    more -= tests_middle(rows, residuals, white, scattered=False)
    seen = np.where(np.isfinite(white), white, 0.0)
    return covariance + seen @ more @ seen


def _sources(
    problem: Filtered, unknowns: np.ndarray, passes: Sequence[FilterPass]
) -> Sources | None:
    """What priors and each record say of the shared parameters.

    Derivatives are those at frozen gain; levels of the noise are taken as they are, as mean and
    variance of an innovation are estimated independently of one another.
    """
    layout, limits = problem.layout, problem.limits
    n_shared = len(layout.shared)
    slopes = layout.shared_values(unknowns)[1]
    matrices, scores = [], []
    tests = np.zeros((n_shared, n_shared))
    slope = np.zeros(n_shared)
    for index, part in enumerate(passes):
        information, score = record_information(problem, unknowns, index, part)
        slope += score
        if problem.records[index].independent:
            tests += information
            continue
        matrices.append(information)
        scores.append(score)
    weight = limits.prior_weight[:n_shared]
    prior = np.diag(weight / slopes**2) + tests
    if problem.knowledge is not None:
        prior = prior + problem.knowledge.information / slopes[:, None] / slopes
    away = limits.prior_mean[:n_shared] - unknowns[:n_shared]
    gradient = slope + weight * away / slopes
    return sources_of(matrices, scores, prior, gradient=gradient)


def record_information(
    problem: Filtered, unknowns: np.ndarray, index: int, part: FilterPass
) -> tuple[np.ndarray, np.ndarray]:
    """Information and score of the shared parameters from one record.

    Its start states and own parameters are estimated along; levels of the noise are as they are.

    Parameters
    ----------
    problem : Filtered
    unknowns : ndarray (n_unknowns,)
    index : int
        Of the record.
    part : FilterPass
        Of this record at these unknowns, with derivatives.

    Returns
    -------
    information : ndarray (n_shared, n_shared)
    score : ndarray (n_shared,)
    """
    layout, limits = problem.layout, problem.limits
    n_own, columns = layout.n_own, layout.record_columns(index)
    size = np.concatenate([np.ones(n_own), layout.slopes(unknowns[columns[n_own:]])])
    width = len(columns)
    matrix = part.gram[:width, :width] * size[:, None] * size
    right = -part.gram[:width, -1] * size
    shared = n_own + layout.shared
    others = np.setdiff1d(np.arange(width), shared)
    others = others[~limits.held[columns[others]]]
    own = limits.prior_weight[columns[others]]
    matrix[others, others] += own
    right[others] += own * (limits.prior_mean - unknowns)[columns[others]]
    share = share_of(matrix, shared, others)
    information = matrix[np.ix_(shared, shared)] - share @ matrix[np.ix_(others, shared)]
    score = right[shared] - share @ right[others]
    slopes = layout.shared_values(unknowns)[1]
    return information / slopes[:, None] / slopes, score / slopes


def _level_errors(solution: FilteredSolution, matrix: np.ndarray) -> dict[str, float]:
    """Standard errors of levels, relative, and of the logarithms of times."""
    problem, unknowns = solution.problem, solution.point.unknowns
    levels, block = problem.levels, problem.layout.levels
    if not len(levels):
        return {}
    where = np.arange(block.start, block.stop)
    others = problem.open_unknowns(0)
    reduced = eliminate(matrix, where, others[others < block.start])
    variances = np.maximum(np.diag(inverse_of(reduced)), 0.0)
    errors = np.where(np.diag(reduced) > 0, np.sqrt(variances), np.inf)
    found = {}
    for name, value, error in zip(levels.names, unknowns[block], errors, strict=True):
        if name.endswith("level"):
            # Of a variance: twice the relative error of its root.
            error = 0.5 * error / value if value > 0 else np.inf
        found[name] = float(error)
    return found
