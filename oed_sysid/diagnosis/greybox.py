"""Maximum likelihood of parameters and noise levels together.

A model that lacks an effect, fitted as if its residuals were sensor noise,
bends its parameters to absurd values. Fitted under a noise model with forces,
it admits what it cannot explain and stays near the truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.compiled.kernels import SelectedRun
from oed_sysid.data.dataset import Dataset
from oed_sysid.diagnosis.linearise import SuperModel
from oed_sysid.noise.kalman import Deviations, NoiseModel, whiten
from oed_sysid.noise.levels import estimate_noise
from oed_sysid.projection import bounded_step


@dataclass(frozen=True, eq=False)
class Task:
    """What stays the same while models and noise levels are compared.

    Attributes
    ----------
    super_model : SuperModel
    dataset : Dataset
    deviations : sequence of Deviations
        Linear dynamics of the base model, one per record.
    units : NoiseModel
        Natural size of every noise level.
    known_noise : bool
        Whether the white levels are given and sensors have no other noise.
    least_white : ndarray (n_outputs,) or None
        Smallest white levels, in their unit.
    """

    super_model: SuperModel
    dataset: Dataset
    deviations: Sequence[Deviations]
    units: NoiseModel
    known_noise: bool
    least_white: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class GreyBox:
    """A fit in the metric of a noise model.

    Attributes
    ----------
    names : tuple of str
        Estimated parameters.
    values : mapping
        Their estimates.
    initial : tuple of ndarray (n_own,)
        Initial states, per record.
    noise : NoiseModel
        Estimated noise model.
    objective : float
        Minus twice the log-likelihood, priors included, up to a constant.
    runs : list of SelectedRun
        Trajectories with derivatives by initial states and parameters.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    initial: tuple[np.ndarray, ...]
    noise: NoiseModel
    objective: float
    runs: list[SelectedRun]

    @property
    def outputs(self) -> list[np.ndarray]:
        """Model outputs, per record."""
        return [run.outputs for run in self.runs]


@dataclass(frozen=True, eq=False)
class Whitened:
    """Residual and Jacobian of all records in unit variance, priors appended as rows."""

    residual: np.ndarray
    jacobian: np.ndarray
    log_determinant: float


def residuals(dataset: Dataset, outputs: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Measured minus model, per record."""
    return [record.outputs - y for record, y in zip(dataset, outputs, strict=True)]


def whitened(task: Task, fit: GreyBox, extra: Sequence[np.ndarray] | None = None) -> Whitened:
    """Whiten residual, Jacobian and optional further columns of a fit.

    Columns of the Jacobian: parameters, then initial states of each record,
    then ``extra`` ones, which carry no prior.
    """
    n_own = len(fit.initial[0])
    n_names, n_records = len(fit.names), len(fit.initial)
    n_extra = extra[0].shape[2] if extra is not None else 0
    blocks = []
    for index, (residual, jacobian) in enumerate(
        zip(residuals(task.dataset, fit.outputs), _jacobians(fit), strict=True)
    ):
        parts = [jacobian[:, :, n_own:], jacobian[:, :, :n_own], residual[:, :, None]]
        if extra is not None:
            parts.append(extra[index])
        blocks.append(np.concatenate(parts, axis=2))
    white, log_det = whiten(fit.noise, task.deviations, blocks)
    n_columns = n_names + n_records * n_own + n_extra
    rows = sum(len(w) for w in white)
    jacobian = np.zeros((rows + n_names, n_columns))
    residual = np.zeros(rows + n_names)
    begin = 0
    for index, part in enumerate(white):
        block = slice(begin, begin + len(part))
        first = n_names + index * n_own
        jacobian[block, :n_names] = part[:, :n_names]
        jacobian[block, first : first + n_own] = part[:, n_names : n_names + n_own]
        jacobian[block, n_columns - n_extra :] = part[:, n_names + n_own + 1 :]
        residual[block] = part[:, n_names + n_own]
        begin += len(part)
    for position, name in enumerate(fit.names):
        parameter = task.super_model.model.parameter(name)
        if parameter.prior_std is not None and parameter.prior_mean is not None:
            jacobian[rows + position, position] = 1.0 / parameter.prior_std
            residual[rows + position] = (
                parameter.prior_mean - fit.values[name]
            ) / parameter.prior_std
    return Whitened(residual, jacobian, log_det)


def estimate(
    task: Task,
    names: Sequence[str],
    values: Mapping[str, float],
    initial: Sequence[np.ndarray],
    noise: NoiseModel,
    *,
    max_iterations: int = 12,
    update_noise: bool = True,
    tolerance: float = 0.02,
) -> GreyBox | None:
    """Estimate parameters, initial states and noise levels of one sub-model.

    Parameters
    ----------
    task : Task
    names : sequence of str
        Parameters to estimate; all others stay at ``values`` or at the model's.
    values : mapping
        Start values.
    initial : sequence of ndarray (n_own,)
        Start values of the initial states.
    noise : NoiseModel
        Start levels.
    max_iterations : int
        Most Gauss-Newton iterations.
    update_noise : bool
        Whether to estimate the levels that the task does not declare known.
    tolerance : float
        Stop when minus twice the log-likelihood falls by less.

    Returns
    -------
    GreyBox or None
        None where the start trajectory diverges.
    """
    fit = _evaluate(task, tuple(names), dict(values), tuple(initial), noise)
    if fit is None:
        return None
    if update_noise:
        fit = with_noise(task, fit, _noise(task, fit, settled=False))
    lower, upper = _bounds(task, fit)
    updates, damping = 0, 0.0
    for iteration in range(max_iterations):
        system = whitened(task, fit)
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = system.jacobian.T @ system.jacobian
        right = system.jacobian.T @ system.residual
        if not np.isfinite(matrix).all():
            # An unstable model whose sensitivities have left the numbers shows no way on.
            break
        position = _vector(fit)
        better = None
        for _ in range(6):
            step = bounded_step(matrix, right, lower - position, upper - position, damping)
            trial = _evaluate(task, *_unpack(fit, position + step), fit.noise)
            if trial is not None and trial.objective < fit.objective:
                better = trial
                break
            damping = max(10 * damping, 1e-3)
        gained = fit.objective - better.objective if better is not None else 0.0
        fit = better or fit
        damping = damping / 10 if damping > 1e-5 else 0.0
        settled = gained < tolerance
        if update_noise and (settled or iteration in (1, 4)) and updates < 5:
            updates += 1
            again = with_noise(task, fit, _noise(task, fit, settled=settled))
            settled = settled and fit.objective - again.objective < 5 * tolerance
            fit = again if again.objective < fit.objective else fit
        if settled:
            break
    return fit


def _jacobians(fit: GreyBox) -> list[np.ndarray]:
    return [run.jacobian for run in fit.runs if run.jacobian is not None]


def _noise(task: Task, fit: GreyBox, *, settled: bool) -> NoiseModel:
    """Levels at a fit; while its parameters still move, they need not be exact."""
    return estimate_noise(
        fit.noise,
        task.units,
        task.deviations,
        residuals(task.dataset, fit.outputs),
        known=task.known_noise,
        least_white=task.least_white,
        tolerance=0.02 if settled else 1.0,
        max_iterations=25 if settled else 6,
    )


def _evaluate(
    task: Task,
    names: tuple[str, ...],
    values: Mapping[str, float],
    initial: tuple[np.ndarray, ...],
    noise: NoiseModel,
) -> GreyBox | None:
    runs = task.super_model.run(task.dataset, initial, values, names)
    if runs is None:
        return None
    fit = GreyBox(names, values, initial, noise, np.inf, runs)
    return with_noise(task, fit, noise)


def with_noise(task: Task, fit: GreyBox, noise: NoiseModel) -> GreyBox:
    """Return the same fit judged under another noise model."""
    series = [r[:, :, None] for r in residuals(task.dataset, fit.outputs)]
    white, log_det = whiten(noise, task.deviations, series)
    with np.errstate(over="ignore"):  # what overflows is not likely
        objective = log_det + sum(float(np.sum(w**2)) for w in white)
    for name in fit.names:
        parameter = task.super_model.model.parameter(name)
        if parameter.prior_std is not None and parameter.prior_mean is not None:
            objective += ((fit.values[name] - parameter.prior_mean) / parameter.prior_std) ** 2
    return replace(fit, noise=noise, objective=objective if np.isfinite(objective) else np.inf)


def _vector(fit: GreyBox) -> np.ndarray:
    return np.concatenate([[fit.values[name] for name in fit.names], *fit.initial])


def _unpack(
    fit: GreyBox, vector: np.ndarray
) -> tuple[tuple[str, ...], dict[str, float], tuple[np.ndarray, ...]]:
    n_names, n_own = len(fit.names), len(fit.initial[0])
    values = dict(fit.values) | dict(zip(fit.names, map(float, vector[:n_names]), strict=True))
    states = vector[n_names:].reshape(-1, n_own)
    return fit.names, values, tuple(row.copy() for row in states)


def _bounds(task: Task, fit: GreyBox) -> tuple[np.ndarray, np.ndarray]:
    parameters = [task.super_model.model.parameter(name) for name in fit.names]
    free = np.full(sum(len(own) for own in fit.initial), np.inf)
    lower = np.concatenate([[p.lower for p in parameters], -free])
    upper = np.concatenate([[p.upper for p in parameters], free])
    return lower, upper
