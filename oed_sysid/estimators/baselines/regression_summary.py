"""A :class:`~oed_sysid.fitting.fit.Fit` from parameter values that no trajectory was fitted for.

Regressions, filters and samplers end with values and a covariance. What the
model then predicts, and how well, is found by simulating each record from its
first measurements.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.fitting.fit import Fit, Status
from oed_sysid.fitting.noise_levels import given_levels
from oed_sysid.fitting.start_guess import check_channels, measured_states
from oed_sysid.information import Information
from oed_sysid.model import Model

DIVERGED = (
    "the values solve the regression, but the model with them leaves the numbers when it is "
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
    status: Status | None = None,
    iterations: int = 1,
    initial_states: Sequence[Mapping[str, float]] | None = None,
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
        Converged by default; divergence in simulation overrides it.
    iterations : int
        Iterations or samples.
    initial_states : sequence of mapping, optional
        Known start values per record; others are measured, or zero.
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
    for index, record in enumerate(dataset):
        own = np.zeros(runner.n_own)
        for position, series in measured_states(model, record).items():
            own[position] = series[0]
        for name, value in (initial_states[index] if initial_states else {}).items():
            own[model.state_names.index(name)] = value
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
    if status is None:
        status = Status("converged", "")
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
