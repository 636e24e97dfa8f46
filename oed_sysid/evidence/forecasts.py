"""Error of predictions a short time ahead, started again and again along a record.

Over a whole record a small error of a parameter grows into a large one of the
trajectory. A forecast of a few seconds from a state that is known shows what
the equations get wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.likelihood.start_guess import VAGUE, kinematic_states, measured_states
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import as_dict


@dataclass(frozen=True, eq=False)
class Forecasts:
    """Errors of forecasts of one model.

    Attributes
    ----------
    horizon : float
        How far ahead, s.
    starts : tuple of ndarray (n_starts,)
        Times at which forecasts begin, s, per record.
    errors : tuple of ndarray (n_starts, n_ahead, n_outputs)
        Measured minus forecast, per record; NaN where nothing was measured or
        the forecast diverged.
    expected : tuple of ndarray (n_starts, n_ahead, n_outputs)
        Standard deviation of these errors if the model were right: noise, and
        the error of the start state.
    failed : int
        Number of forecasts that diverged.
    """

    horizon: float
    starts: tuple[np.ndarray, ...]
    errors: tuple[np.ndarray, ...]
    expected: tuple[np.ndarray, ...]
    failed: int

    to_dict = as_dict("horizon", "n_forecasts", "failed", "rmse", "relative", "overall")

    @property
    def n_forecasts(self) -> int:
        """Number of forecasts over all records."""
        return sum(len(part) for part in self.starts)

    @property
    def rmse(self) -> np.ndarray:
        """Root mean square error of each output, shape ``(n_outputs,)``; infinite if one failed."""
        return self._rms(self.errors)

    @property
    def relative(self) -> np.ndarray:
        """The same in units of what a right model would leave; 1 is perfect."""
        pairs = zip(self.errors, self.expected, strict=True)
        return self._rms([error / size for error, size in pairs])

    @property
    def overall(self) -> float:
        """Relative error over all outputs."""
        finite = self.relative[np.isfinite(self.relative)]
        if self.failed:
            return np.inf
        return float(np.sqrt(np.mean(finite**2))) if len(finite) else np.nan

    def _rms(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        result = _rms(np.vstack([part.reshape(-1, part.shape[2]) for part in parts]))
        return np.where(np.isfinite(result), np.inf, result) if self.failed else result


def _rms(values: np.ndarray) -> np.ndarray:
    """Root mean square along the first axis of what is finite; NaN where nothing is."""
    count = np.isfinite(values).sum(axis=0)
    return np.sqrt(np.nansum(values**2, axis=0) / np.where(count > 0, count, np.nan))


def forecasts(
    model: Model,
    dataset: Dataset,
    sigma: np.ndarray,
    *,
    horizon: float = 10.0,
    local: Sequence[Mapping[str, float]] | None = None,
) -> Forecasts:
    """Forecast every stretch of ``horizon`` seconds from the one before it.

    The state at the start of a stretch of half the horizon is estimated from
    that stretch; the model then runs on over the horizon without measurements.

    Parameters
    ----------
    model : Model
        At the values to judge.
    dataset : Dataset
        Records; those shorter than one and a half horizons give no forecast, nor do independent
        tests.
    sigma : ndarray (n_outputs,)
        Noise levels.
    horizon : float
        How far ahead, s.
    local : sequence of mapping, optional
        Values of per-record parameters.
    """
    held = model.fix(*model.free_names)
    compiled, parts = kernel(held), []
    for index, record in enumerate(dataset):
        values = held.with_values(local[index] if local else {}).value_vector
        nothing = np.empty((0, 1, len(sigma)))
        parts.append(
            (np.empty(0), nothing, nothing)  # nothing follows from one test to the next
            if record.independent
            else _record(compiled, record, values, sigma, horizon)
        )
    starts, errors, expected = zip(*parts, strict=True)
    failed = sum(int(np.isnan(size).any(axis=(1, 2)).sum()) for size in expected)
    return Forecasts(horizon, starts, errors, expected, failed)


def _record(
    compiled: Kernel, record: Record, values: np.ndarray, sigma: np.ndarray, horizon: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starts, errors and their expected size along one record."""
    model = compiled.model
    ahead = max(2, round(horizon / record.sample_time))
    before = max(2, ahead // 2)
    first = np.arange(0, record.n_samples - before - ahead + 1, ahead)
    # States as far as measurements tell.
    guess = np.zeros((record.n_samples, len(model.states)))
    measured = measured_states(model, record)
    kinematic = kinematic_states(model, record, measured)
    for position, series in (measured | {k: v.series for k, v in kinematic.items()}).items():
        guess[:, position] = series
    # What effects remember along the model's own run.
    z0, _ = compiled.start(guess[0], record.inputs[0], values, record.times[0])
    own = compiled.run(record.times, record.inputs, values, z0)
    errors = np.full((len(first), ahead, len(sigma)), np.nan)
    expected = errors.copy()
    for row, begin in enumerate(first):
        memory = own.states[begin, compiled.n_own :] if own.ok else None
        part = slice(begin, begin + before + ahead)
        found = _forecast(compiled, record, part, values, guess[begin], memory, sigma, before)
        if found is not None:
            errors[row], expected[row] = found
    return record.times[first + before], errors, expected


def _forecast(
    compiled: Kernel,
    record: Record,
    part: slice,
    values: np.ndarray,
    own: np.ndarray,
    memory: np.ndarray | None,
    sigma: np.ndarray,
    before: int,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Errors and their expected size after the first ``before`` samples of a part."""
    times, inputs, outputs = record.times[part], record.inputs[part], record.outputs[part]
    weight = 1.0 / (VAGUE * np.array([state.scale for state in compiled.model.states]))
    start, best, kept = own.copy(), np.inf, None
    for _ in range(6):  # Gauss-Newton; linear models need one step
        z0, dz = compiled.start(start, inputs[0], values, times[0])
        if memory is not None:
            # A play or a lag is where its commands have left it, not in rest at the present one;
            # what follows from the states (a late sensor) is taken from these.
            alone = ~dz[compiled.n_own :, : compiled.n_own].any(axis=1)
            z0[compiled.n_own :][alone] = memory[alone]
        run = compiled.run(times, inputs, values, z0, sensitivities=True)
        if not run.ok or run.output_sensitivities is None:
            start = 0.5 * (start + own)
            continue
        jacobian = run.output_sensitivities[:, :, : compiled.n_full] @ dz[:, : compiled.n_own]
        residual = (outputs - run.outputs)[:before] / sigma
        seen = np.isfinite(residual)
        rows = np.where(seen[:, :, None], jacobian[:before] / sigma[:, None], 0.0)
        rows = np.vstack([rows.reshape(-1, len(own)), np.diag(weight)])
        right = np.concatenate([np.where(seen, residual, 0.0).ravel(), weight * (own - start)])
        cost = float(right @ right)
        if cost < best:
            inverse = np.linalg.pinv(rows, rcond=1e-10)
            gained, best = best - cost, cost
            kept = run.outputs, jacobian[before:], inverse @ inverse.T, start
            if gained < 1e-3:
                break
            start = start + inverse @ right
        elif kept is not None:
            start = 0.5 * (start + kept[3])
    if kept is None:
        return None
    prediction, later, covariance, _ = kept
    variance = np.einsum("tij,jk,tik->ti", later, covariance, later)
    return (outputs - prediction)[before:], np.sqrt(variance + sigma**2)
