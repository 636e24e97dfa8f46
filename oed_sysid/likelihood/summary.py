"""From the end of the iterations to a :class:`~oed_sysid.likelihood.fit.Fit`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.likelihood.covariance import Errors, ReducedFilter, ReducedProblem, errors_of_windows
from oed_sysid.likelihood.estimate import Status
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.fit import SAYS, Fit
from oed_sysid.likelihood.gauss_newton import FilteredSolution, Solution
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.shooting import Shooting


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

    def fit(
        self,
        problem: Shooting | Filtered,
        unknowns: np.ndarray,
        end: tuple[str, float],
        errors: Errors,
        paths: Sequence[tuple[np.ndarray, np.ndarray]],
    ) -> Fit:
        """The result at some unknowns.

        Parameters
        ----------
        problem : Shooting or Filtered
        unknowns : ndarray (n_unknowns,)
        end : pair of str and float
            How the iterations ended, and the cost.
        errors : Errors
            Of the shared parameters.
        paths : sequence of pair of ndarray
            Outputs ``(n_times, n_outputs)`` and states ``(n_times, n_full)``, per record.
        """
        layout, starts, sources = problem.layout, problem.known_starts, errors.sources
        outputs = tuple(outputs for outputs, _ in paths)
        return Fit(
            model=problem.model.with_values(layout.means(problem.model, unknowns)),
            dataset=problem.dataset,
            estimator=self.name,
            names=layout.shared_names,
            estimates=layout.shared_values(unknowns)[0],
            information=errors.information,
            covariance=errors.covariance,
            record_scatter=None if sources is None else sources.scatter(),
            sources=sources,
            coloured=errors.coloured,
            tests_scatter=errors.scattered,
            sigma=problem.white(unknowns).copy(),
            sigma_estimated=np.asarray(self.estimated, dtype=bool),
            predictions=outputs,
            residuals=tuple(r.outputs - o for r, o in zip(problem.records, outputs, strict=True)),
            states=tuple(states for _, states in paths),
            initial_states=tuple(problem.initial_states(unknowns)),
            local_values=tuple(layout.local_values(unknowns)),
            cost=end[1],
            status=Status(end[0], SAYS["status"][end[0]]),
            iterations=self.iterations,
            seconds=time.perf_counter() - self.began,
            start_states=() if starts is None else starts.described(problem.model),
        )


def summarise(solution: Solution, how: Procedure, *, weighed: bool = True) -> Fit:
    """Build the result of an estimation from its last iterate.

    Parameters
    ----------
    solution : Solution
    how : Procedure
    weighed : bool
        Whether the covariance holds the colour of the residuals; otherwise it is only said
        whether they have one.
    """
    shooting, unknowns = solution.shooting, solution.point.unknowns
    if solution.reason == "diverged":
        return _failed(shooting, how)
    if solution.problem is not shooting:
        return _of_windows(solution, how)
    errors = ReducedProblem(shooting, solution.linearisation, unknowns).errors(
        how.coloured, weighed=weighed
    )
    runs = [shooting.run(unknowns, index) for index in range(len(shooting.records))]
    paths = [(run.outputs, run.states) for run in runs]
    return how.fit(shooting, unknowns, (solution.reason, solution.cost), errors, paths)


def _of_windows(solution: Solution, how: Procedure) -> Fit:
    """The result of windows of a horizon; predictions and residuals are those of these."""
    problem, point = solution.problem, solution.point
    paths, n_own = problem.paths(point), problem.shooting.layout.n_own
    errors = errors_of_windows(problem, point, how.coloured)
    end = solution.reason, solution.cost
    return replace(
        how.fit(problem.shooting, point.unknowns, end, errors, paths),
        initial_states=tuple(states[0, :n_own].copy() for _, states in paths),
        horizon=problem.horizon,
        n_windows=problem.n_windows,
    )


def _failed(shooting: Shooting, how: Procedure) -> Fit:
    """The result where no trajectory is finite: start values, of which nothing is known."""
    layout = shooting.layout
    n, begin = len(layout.shared), shooting.start_unknowns()
    nothing = Information(layout.shared_names, np.zeros((n, n)), np.ones(n))
    errors = Errors(nothing, nothing.covariance)
    fit = how.fit(shooting, begin, ("diverged", np.inf), errors, shooting.no_paths())
    unknown = tuple(np.full(layout.n_own, np.nan) for _ in shooting.records)
    return replace(fit, initial_states=unknown, local_values=({},) * len(unknown), start_states=())


def summarise_filtered(solution: FilteredSolution, how: Procedure) -> Fit:
    """Build the result of an estimation with disturbance forces from its last iterate.

    Where innovations oscillate with a period of their own, the covariance is that of
    :mod:`oed_sysid.likelihood.covariance`.

    Parameters
    ----------
    solution : FilteredSolution
    how : Procedure
    """
    problem, unknowns = solution.problem, solution.point.unknowns
    reduced = ReducedFilter(problem, unknowns, solution.matrix)
    alone = (problem.alone(unknowns, index) for index in range(len(problem.records)))
    paths = [(outputs, path[:, problem.own]) for outputs, path, _ in alone]
    cost = 0.5 * sum(part.square for part in reduced.passes) + problem.prior_cost(unknowns)
    return replace(
        how.fit(problem, unknowns, (solution.reason, cost), reduced.errors(how.coloured), paths),
        noise=problem.noise(unknowns),
        noise_std=reduced.level_errors,
        innovations=tuple(part.innovations for part in reduced.passes),
        innovation_std=tuple(
            np.where(np.isfinite(record.outputs), one, 1.0)
            for record, one in zip(problem.records, reduced.std, strict=True)
        ),
    )
