"""From the end of the iterations to a :class:`~oed_sysid.fitting.fit.Fit`."""

from __future__ import annotations

import time

import numpy as np

from oed_sysid.fitting.covariance import ReducedProblem
from oed_sysid.fitting.fit import Fit, Status
from oed_sysid.fitting.gauss_newton import Solution
from oed_sysid.fitting.shooting import Shooting, replace_values
from oed_sysid.information import Information

_ADVICE = {
    "converged": "",
    "stalled": (
        "no step lowers the misfit, yet the gradient is not zero. Values are the best found; "
        "check bounds and not identifiable parameters, or shorten the shooting interval."
    ),
    "iterations": "the limit of iterations was reached. Raise max_iterations or start closer.",
    "interrupted": "stopped by the user. Values are the best so far; fit(..., warm=fit) goes on.",
    "infeasible": (
        "no trajectory satisfies the constraints. Loosen them, or start from values that do."
    ),
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
    reduced = ReducedProblem(shooting, solution.linearisation)
    information = reduced.information
    covariance = information.covariance
    use = coloured == "always" or (coloured == "auto" and reduced.is_coloured)
    if use or shooting.loss is not None:
        covariance = reduced.sandwich(covariance, coloured=use)
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
        model=replace_values(model, shooting, unknowns),
        dataset=shooting.dataset,
        estimator=estimator,
        names=layout.shared_names,
        estimates=unknowns[: len(layout.shared)].copy(),
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
