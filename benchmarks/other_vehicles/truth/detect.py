r"""What a hidden effect would gain, computed without the package.

Along the true trajectory, one sample of the nominal vehicle misses the true one by
:math:`b_k`; deviations follow :math:`\delta_{k+1} = A_k\delta_k + b_k` and show in the
outputs as :math:`H_k\delta_k + d_k`. Parameters and initial states do the same with
their own :math:`B_k`. A Kalman filter of the disturbance forces and the sensor noise, at their
true levels, turns these columns into whitened innovations, and

.. math:: G = \|(I - P_J)\,W y\|^2

is the expected gain in twice the log-likelihood by the true structure over the nominal
one, parameters and initial states estimated (Rao's score test in its noncentral form,
to first order in the size of what is hidden).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.other_vehicles.truth.simulator import Plant, Runs, Sizes, Vehicle

STEP = 1e-5  # relative change for differences


@dataclass(frozen=True)
class Gains:
    """Expected gains in twice the log-likelihood.

    Attributes
    ----------
    train : float
        On the training records, parameters and initial states estimated.
    validation : float
        On the validation records, parameters as the nominal fit to the
        training records has them, initial states estimated.
    """

    train: float
    validation: float


def gains(
    vehicle: Vehicle,
    runs: Runs,
    parameters: Sizes,
    hidden: Sizes,
    nominal: tuple[Sizes, Sizes],
    estimated: Sequence[str],
    *,
    waves: float,
    input_noise: float = 0.0,
) -> Gains:
    """Expected gains of the truth over a nominal structure.

    Parameters
    ----------
    vehicle, runs
        What was simulated, training records first.
    parameters, hidden : mapping
        The truth.
    nominal : tuple
        Parameters and hidden sizes of the structure to compare with.
    estimated : sequence of str
        Parameters that are estimated.
    waves : float
        Size of the disturbance forces.
    input_noise : float
        Size of the noise of the logged input, which the filter takes for a white force.
    """
    n_train, parts = len(vehicle.train), []
    for record in range(len(runs.names)):
        truth, other = (
            Plant(vehicle, values, {k: _of_record(v, record) for k, v in sizes.items()})
            for values, sizes in ((parameters, hidden), nominal)
        )
        parts.append(_whitened(truth, other, runs, record, estimated, (waves, input_noise)))
    return _project(parts, n_train, len(vehicle.states))


def _of_record(size: float | np.ndarray, record: int) -> float:
    return float(size if np.ndim(size) == 0 else np.asarray(size)[record])


def _whitened(
    truth: Plant,
    other: Plant,
    runs: Runs,
    record: int,
    estimated: Sequence[str],
    disturbed: tuple[float, float],
) -> np.ndarray:
    """Innovations of the effect, parameters and initial states, ``(n_times * n_outputs, ...)``."""
    vehicle = truth.vehicle
    n = len(vehicle.states)
    full = runs.states[record].T
    sent = runs.commands[record].T
    forces = runs.forces[record].T
    state = full[:n]
    fed, play = np.empty_like(sent), sent[:, 0]
    for k in range(sent.shape[1]):
        fed[:, k], play = other.effective(sent[:, k], play)

    def later(
        plant: Plant, own: np.ndarray, push: np.ndarray, sent: np.ndarray = fed
    ) -> np.ndarray:
        # What lags in both structures goes on from where it truly is.
        return plant.advance(np.concatenate([own, full[n:]]), sent, push)[:n]

    base = later(other, state, forces)
    true = truth.advance(full, runs.effective[record].T, forces)[:n]
    jump = true - base
    gap = truth.measure(full) - other.measure(full)
    seen = other.measure(other.start(state, fed))
    scale = np.maximum(np.max(np.abs(state), axis=1), 1e-3)
    # Columns of the transition and of the outputs by differences.
    transition, shown = np.empty((full.shape[1], n, n)), np.empty((full.shape[1], len(seen), n))
    for i in range(n):
        moved = state.copy()
        moved[i] += STEP * scale[i]
        transition[:, :, i] = ((later(other, moved, forces) - base) / (STEP * scale[i])).T
        there = other.measure(other.start(moved, fed))
        shown[:, :, i] = ((there - seen) / (STEP * scale[i])).T
    driven = []
    for name in estimated:
        size = abs(float(other.parameters[name])) or 1.0
        changed = {**other.parameters, name: other.parameters[name] + STEP * size}
        driven.append((later(replace(other, parameters=changed), state, forces) - base) / STEP)
    pushed = np.empty((full.shape[1], n, len(forces)))
    levels = disturbed[0] * np.array(list(vehicle.forces.values()))
    for i, level in enumerate(vehicle.forces.values()):
        shift = forces.copy()
        shift[i] += level
        pushed[:, :, i] = ((later(other, state, shift) - base) / level).T
    channel, size = vehicle.logged
    wrong = fed.copy()
    wrong[vehicle.inputs.index(channel)] += size
    shaken = disturbed[1] * (later(other, state, forces, wrong) - base).T
    inputs = np.stack([jump, *driven], axis=2).transpose(1, 0, 2)  # time, state, column
    return _innovations(vehicle, transition, shown, inputs, gap.T, pushed, levels, shaken)


def _innovations(
    vehicle: Vehicle,
    transition: np.ndarray,
    shown: np.ndarray,
    inputs: np.ndarray,
    gap: np.ndarray,
    pushed: np.ndarray,
    levels: np.ndarray,
    shaken: np.ndarray,
) -> np.ndarray:
    """Deviations of every column, through the filter of forces and noise."""
    n_times, n_outputs, n = shown.shape
    n_forces, n_columns = len(levels), inputs.shape[2] + n
    memory = float(np.exp(-vehicle.sample / vehicle.force_time))
    noise = np.array([vehicle.noise[name] for name in vehicle.outputs])
    deviation = np.zeros((n, n_columns))
    deviation[:, -n:] = np.eye(n)
    believed = np.zeros((n + n_forces, n_columns))
    covariance = np.zeros((n + n_forces, n + n_forces))
    covariance[n:, n:] = np.diag(levels**2)
    drive = np.zeros_like(covariance)
    drive[n:, n:] = np.diag(levels**2 * (1 - memory**2))
    seen = np.zeros((n_outputs, n + n_forces))
    step = np.zeros_like(covariance)
    step[n:, n:] = memory * np.eye(n_forces)
    rows = np.empty((n_times, n_outputs, n_columns))
    for k in range(n_times):
        seen[:, :n] = shown[k]
        value = shown[k] @ deviation
        value[:, 0] += gap[k]
        innovation = value - seen @ believed
        spread = seen @ covariance @ seen.T + np.diag(noise**2)
        root = np.linalg.cholesky(spread)
        rows[k] = np.linalg.solve(root, innovation)
        if np.any(levels) or np.any(shaken):
            gain = np.linalg.solve(spread, seen @ covariance).T
            believed = believed + gain @ innovation
            covariance = covariance - gain @ seen @ covariance
            step[:n, :n], step[:n, n:] = transition[k], pushed[k]
            believed = step @ believed
            covariance = step @ covariance @ step.T + drive
            covariance[:n, :n] += np.outer(shaken[k], shaken[k])
        deviation = transition[k] @ deviation
        deviation[:, : n_columns - n] += inputs[k]
    return rows.reshape(n_times * n_outputs, n_columns)


def _project(parts: Sequence[np.ndarray], n_train: int, n: int) -> Gains:
    """Remove what parameters and initial states absorb."""
    train = [_without_start(part, n) for part in parts[:n_train]]
    stacked = np.concatenate(train)
    effect, columns = stacked[:, 0], stacked[:, 1:]
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    absorbed = np.linalg.lstsq(columns / scale, effect, rcond=1e-10)[0] / scale
    left = effect - columns @ absorbed
    judged = 0.0
    for part in parts[n_train:]:
        clean = _without_start(part, n)
        judged += float(np.sum((clean[:, 0] - clean[:, 1:] @ absorbed) ** 2))
    return Gains(float(left @ left), judged)


def _without_start(part: np.ndarray, n: int) -> np.ndarray:
    """The columns of effect and parameters, initial states projected out."""
    start, own = part[:, -n:], part[:, :-n]
    u, s, _ = np.linalg.svd(start, full_matrices=False)
    basis = u[:, s > 1e-10 * s[0]]
    return own - basis @ (basis.T @ own)
