"""Whether trajectories hang on the integration step, which no estimation can mend.

A force that jumps with the state (a sign, an angle that leaps at 180 degrees)
makes a trajectory of fixed steps a staircase in the parameters: derivatives
miss the jumps, and iterations stall on a step of the stairs.

From the end of the iterations to a :class:`~oed_sysid.likelihood.fit.Fit`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from oed_sysid.compiled.filtering import FilterPass
from oed_sysid.compiled.kernels import kernel
from oed_sysid.likelihood.between_records import Sources, eliminate_own, scatter_of, sources_of
from oed_sysid.likelihood.covariance import (
    ReducedProblem,
    clear_peaks,
    shared_rows,
    tests_middle,
    tests_stray,
    widened,
)
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.fit import Fit, Status
from oed_sysid.likelihood.gauss_newton import FilteredSolution, Solution
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.shooting import Shooting, replace_values
from oed_sysid.likelihood.unknowns import KnownStarts
from oed_sysid.physics.model import Model

FINER = 4
# Root mean square change, in noise levels, from which the step is worth a word.
WORTH_SAYING = 0.5


def worst_step_error(shooting: Shooting, solution: Solution) -> tuple[float, str, str]:
    """Change that a finer step makes, in noise levels: the worst, its output and record.

    Parameters
    ----------
    shooting : Shooting
    solution : Solution
        Where its trajectories are simulated, without nodes.
    """
    model = shooting.model
    finer = kernel(replace(model, step=model.step / FINER))
    worst = (0.0, "", "")
    for index, record in enumerate(shooting.records):
        values = shooting.values(solution.point.unknowns, index)
        z0, _ = shooting.full_start(solution.point.unknowns, index)
        coarse, fine = (
            one.run(record.times, record.inputs, values, z0).outputs
            for one in (shooting.kernel, finer)
        )
        with np.errstate(invalid="ignore", over="ignore"):
            change = np.sqrt(np.mean(((coarse - fine) / shooting.sigma) ** 2, axis=0))
        for name, size in zip(model.output_names, change, strict=True):
            if np.isfinite(size) and size > worst[0]:
                worst = (float(size), name, record.name)
    return worst


def _or_stiff(model: Model) -> str:
    if model.integrator == "implicit":
        return ""
    return ", or take Model(integrator='implicit') if some of its motions die out within a step"


def with_step_advice(fit: Fit, shooting: Shooting, solution: Solution | None) -> Fit:
    """Add to the status of a failed fit that the step may be why."""
    if fit.status.ok or solution is None or solution.reason == "interrupted":
        return fit
    size, output, record = worst_step_error(shooting, solution)
    if size < WORTH_SAYING:
        return fit
    step = fit.model.step
    advice = (
        f"{fit.status.advice} The trajectories hang on the integration step: with "
        f"{step / FINER:g} s instead of {step:g} s, {output} of record {record!r} changes by "
        f"{size:.1f} noise levels. Reduce model.step{_or_stiff(fit.model)}; if that does not help, "
        "a force of the model jumps where the state passes some value: make it continuous."
    )
    return replace(fit, status=Status(fit.status.code, advice))


_ADVICE = {
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


def summarise(
    shooting: Shooting,
    solution: Solution | None,
    estimated: np.ndarray,
    estimator: str,
    iterations: int,
    began: float,
    *,
    coloured: str = "auto",
    weighed: bool = True,
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
    weighed : bool
        Whether the covariance holds the colour of the residuals; otherwise it is only said
        whether they have one.
    """
    model, layout = shooting.model, shooting.layout
    if solution is None:
        return _failed(shooting, estimated, estimator, iterations, began)
    unknowns = solution.point.unknowns
    reduced = ReducedProblem(shooting, solution.linearisation, unknowns)
    information = reduced.information
    covariance = information.covariance
    use = coloured == "always" or (coloured == "auto" and reduced.is_coloured)
    scattered = coloured == "always" or (coloured == "auto" and reduced.tests_stray(covariance))
    if ((use or scattered) and weighed) or shooting.loss is not None:
        covariance = reduced.sandwich(covariance, coloured=use, scattered=scattered)
    sources = reduced.sources
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
        free = layout.parameters(unknowns, index)
        local.append({layout.free_names[i]: float(free[i]) for i in layout.local})
    return Fit(
        model=replace_values(model, shooting, unknowns),
        dataset=shooting.dataset,
        estimator=estimator,
        names=layout.shared_names,
        estimates=layout.shared_values(unknowns)[0],
        information=information,
        covariance=covariance,
        record_scatter=None if sources is None else scatter_of(sources),
        sources=sources,
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
        start_states=_described(shooting.known_starts, model),
        tests_scatter=scattered and any(record.independent for record in shooting.records),
    )


def summarise_filtered(
    solution: FilteredSolution,
    estimated: np.ndarray,
    estimator: str,
    iterations: int,
    began: float,
    *,
    coloured: str = "auto",
) -> Fit:
    r"""Build the result of an estimation with disturbance forces from its last iterate.

    With the information ``H`` of all unknowns, start states, per-record parameters and
    levels ``o`` are eliminated from that of the shared parameters ``p``,
    :math:`H_{pp} - H_{po} H_{oo}^{-1} H_{op}`. Where innovations swing with a period of their own,
    the covariance is that of :mod:`oed_sysid.likelihood.covariance`.

    Parameters
    ----------
    solution : FilteredSolution
    estimated : ndarray of bool (n_outputs,)
        Which white levels nobody had declared.
    estimator : str
        Name for reports.
    iterations : int
        Iterations in all.
    began : float
        ``time.perf_counter()`` at the start.
    coloured : str
        Unless ``"never"``, residuals of independent tests tell their part of the errors where
        they are larger than declared; see :mod:`oed_sysid.likelihood.covariance`.
    """
    problem, unknowns = solution.problem, solution.point.unknowns
    model, layout = problem.model, problem.layout
    matrix = solution.matrix + np.diag(problem.limits.prior_weight)
    shared = np.arange(len(layout.shared))
    rest = _free_positions(problem, len(shared), layout.n_unknowns)
    estimates, slopes = layout.shared_values(unknowns)
    reduced = eliminate(matrix, shared, rest) / slopes[:, None] / slopes
    information = Information.from_matrix(
        layout.shared_names, reduced, problem.limits.scale[shared] * slopes
    )
    noise = problem.noise(unknowns)
    measured = [np.isfinite(record.outputs) for record in problem.records]
    covariance = information.covariance
    # Derivatives serve the comparison of records alone.
    passes = problem.passes(unknowns, columns=len(layout.shared) > 0)
    whitened = [
        np.full(part.innovations.shape, np.nan)
        if record.independent
        else part.innovations / np.sqrt(np.maximum(part.variances, 1e-300))
        for record, part in zip(problem.records, passes, strict=True)
    ]
    peaks = clear_peaks(whitened, problem.records, model.output_names)
    if peaks:
        period = max(peak.period for peak in peaks)
        covariance = widened(problem, unknowns, matrix, covariance, period)
    white = covariance
    if coloured != "never":
        covariance = _with_stray_tests(problem, unknowns, matrix, information, covariance)
    sources = _sources(problem, unknowns, passes)
    predictions, states, residuals, initial, local = [], [], [], [], []
    free = np.array([layout.parameters(unknowns, i) for i in range(len(problem.records))])
    at = model.with_values(_means(model, layout.free_names, free))
    for index, record in enumerate(problem.records):
        own = problem.initial_state(unknowns, index)
        outputs, path, _ = problem.alone(unknowns, index)
        predictions.append(outputs)
        states.append(path if problem.own is None else path[:, problem.own])
        residuals.append(record.outputs - outputs)
        initial.append(own.copy())
        local.append({layout.free_names[i]: float(free[index][i]) for i in layout.local})
    return Fit(
        model=at,
        dataset=problem.dataset,
        estimator=estimator,
        names=layout.shared_names,
        estimates=estimates,
        information=information,
        covariance=covariance,
        record_scatter=None if sources is None else scatter_of(sources),
        sources=sources,
        coloured=bool(peaks),
        sigma=noise.white.copy(),
        sigma_estimated=np.asarray(estimated, dtype=bool),
        predictions=tuple(predictions),
        residuals=tuple(residuals),
        states=tuple(states),
        initial_states=tuple(initial),
        local_values=tuple(local),
        cost=0.5 * sum(part.square for part in passes) + problem.prior_cost(unknowns),
        status=Status(solution.reason, _ADVICE[solution.reason]),
        iterations=iterations,
        seconds=time.perf_counter() - began,
        noise=noise,
        noise_std=_level_errors(solution, matrix),
        innovations=tuple(part.innovations for part in passes),
        innovation_std=tuple(
            np.where(seen, np.sqrt(np.maximum(part.variances, 1e-300)), 1.0)
            for part, seen in zip(passes, measured, strict=True)
        ),
        start_states=_described(problem.known_starts, model),
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
    chosen = [i for i, record in enumerate(problem.records) if record.independent]
    white = information.covariance
    if not chosen or not len(white):
        return covariance
    jacobians, scores = shared_rows(problem, unknowns, matrix)
    rows = np.concatenate([jacobians[i] for i in chosen])
    residuals = np.concatenate([scores[i] for i in chosen])
    if not tests_stray(rows, residuals, white):
        return covariance
    more = tests_middle(rows, residuals, white, scattered=True)
    more -= tests_middle(rows, residuals, white, scattered=False)
    finite = np.flatnonzero(np.isfinite(np.diag(white)))
    block = np.ix_(finite, finite)
    result = covariance.copy()
    result[block] += white[block] @ more[block] @ white[block]
    return result


def _described(
    starts: KnownStarts | None, model: Model
) -> tuple[dict[str, tuple[float, float]], ...]:
    return () if starts is None else starts.described(model)


def _free_positions(problem: Filtered, first: int, stop: int) -> np.ndarray:
    """Unknowns from ``first`` to ``stop`` that are estimated; levels count as such."""
    held = problem.limits.held.copy()
    held[problem.layout.levels] = False
    return first + np.flatnonzero(~held[first:stop])


def eliminate(matrix: np.ndarray, kept: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Information of some unknowns once all others are estimated too."""
    if not len(others):
        return matrix[np.ix_(kept, kept)]
    inner = matrix[np.ix_(others, others)]
    size = np.sqrt(np.maximum(np.diag(inner), 0.0))
    seen = size > 0
    scaled = inner[np.ix_(seen, seen)] / size[seen][:, None] / size[seen]
    values, vectors = np.linalg.eigh(scaled)
    clear = values > 1e-12 * values.max(initial=0.0)
    cross = matrix[np.ix_(kept, others[seen])] / size[seen]
    root = cross @ (vectors[:, clear] / np.sqrt(values[clear]))
    return matrix[np.ix_(kept, kept)] - root @ root.T


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
    information, score = eliminate_own(matrix, right, shared, others)
    slopes = layout.shared_values(unknowns)[1]
    return information / slopes[:, None] / slopes, score / slopes


def _means(model: Model, names: tuple[str, ...], free: np.ndarray) -> dict[str, float]:
    """Values of the free parameters; those of each record take their mean, within bounds."""
    lower = [p.lower for p in model.free_parameters]
    upper = [p.upper for p in model.free_parameters]
    means = np.clip(free.mean(axis=0), lower, upper) if len(names) else []
    return dict(zip(names, map(float, means), strict=True))


def _level_errors(solution: FilteredSolution, matrix: np.ndarray) -> dict[str, float]:
    """Standard errors of levels, relative, and of the logarithms of times."""
    problem, unknowns = solution.problem, solution.point.unknowns
    levels, block = problem.levels, problem.layout.levels
    if not len(levels):
        return {}
    where = np.arange(block.start, block.stop)
    others = _free_positions(problem, 0, block.start)
    reduced = eliminate(matrix, where, others)
    open_ = np.diag(reduced) > 0
    errors = np.full(len(where), np.inf)
    # In units of their own information: variances and logarithms differ by many decades.
    size = np.sqrt(np.diag(reduced)[open_])
    inner = np.linalg.pinv(reduced[np.ix_(open_, open_)] / size[:, None] / size, hermitian=True)
    errors[open_] = np.sqrt(np.maximum(np.diag(inner), 0.0)) / size
    found = {}
    for (kind, index), value, error in zip(levels.entries, unknowns[block], errors, strict=True):
        name = levels.name_of(kind, index)
        if name.endswith("level"):
            # Of a variance: twice the relative error of its root.
            found[name] = float(0.5 * error / value) if value > 0 else np.inf
        else:
            found[name] = float(error)
    return found


def _failed(
    shooting: Shooting, estimated: np.ndarray, estimator: str, iterations: int, began: float
) -> Fit:
    names = shooting.layout.shared_names
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
