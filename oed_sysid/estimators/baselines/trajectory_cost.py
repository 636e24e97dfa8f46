"""The misfit of simulated trajectories, for optimisers that ask for values only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError
from oed_sysid.estimators.baselines.regression_solution import are_coloured, sandwich
from oed_sysid.estimators.baselines.regression_summary import fit_from_values
from oed_sysid.fitting.fit import Fit, Status
from oed_sysid.fitting.noise_levels import given_levels, noise_floor
from oed_sysid.fitting.start_guess import check_channels, measured_states
from oed_sysid.information import Information, coloured_score_covariance
from oed_sysid.model import Model
from oed_sysid.simulation.batch import simulate_batch

# Members simulated at once: bounds the memory of long records.
CHUNK_BYTES = 64_000_000


class TrajectoryCost:
    r"""Mean square of scaled residuals over all records, for many candidates at once.

    .. math:: J(\theta) = \frac1N \sum_{k,i} \left(\frac{y_{ki} - \hat y_{ki}(\theta)}{s_i}\right)^2

    Trajectories start where ``initial`` says, else at the measured states
    (averaged over the first samples), else at zero. A start is never searched
    for: its noise ends up in the parameters, and in their stated errors.

    Parameters
    ----------
    model : Model
        All free parameters need finite bounds.
    dataset : Dataset
        Measured records.
    scale : str or mapping of str to float
        ``"noise"`` takes the noise level of each output, ``"peak"`` its largest
        magnitude; a mapping gives one number per output.
    initial : mapping of str to float
        Known start of some states, the same for all records.
    n_workers : int or None
        Threads; as many as cores by default.
    """

    def __init__(
        self,
        model: Model,
        dataset: Dataset,
        *,
        scale: str | Mapping[str, float] = "noise",
        initial: Mapping[str, float] | None = None,
        n_workers: int | None = None,
    ) -> None:
        check_channels(model, dataset)
        free = model.free_parameters
        if not free:
            raise ModelError(f"Model {model.name!r} has no free parameter to search for.")
        unbounded = [p.name for p in free if not np.isfinite([p.lower, p.upper]).all()]
        if unbounded:
            raise ModelError(
                f"{', '.join(unbounded)} have no finite bounds, and a search needs a region. Give "
                "lower and upper with model.with_parameter(replace(parameter, lower=..., "
                "upper=...)), or use MultipleShooting, which needs none."
            )
        if local := [p.name for p in free if p.per_record]:
            raise ModelError(
                f"{', '.join(local)} differ from record to record, which a search does not know. "
                "Use MultipleShooting."
            )
        self.model, self.dataset, self.n_workers = model, dataset, n_workers
        self.lower = np.array([p.lower for p in free])
        self.upper = np.array([p.upper for p in free])
        self._columns = [model.parameter_names.index(name) for name in model.free_names]
        self.scales = self._output_scales(scale)
        self.initial = dict(initial or {})
        if unknown := [name for name in self.initial if name not in model.state_names]:
            raise ModelError(
                f"initial names {unknown[0]!r}; model {model.name!r} has the states "
                f"{', '.join(model.state_names)}."
            )
        self._starts = [self._start(index) for index in range(len(dataset))]
        self.n_evaluations = 0

    def _output_scales(self, scale: str | Mapping[str, float]) -> np.ndarray:
        names = self.model.output_names
        if not isinstance(scale, str):
            missing = [name for name in names if not scale.get(name, 0.0) > 0]
            if missing:
                raise ModelError(
                    f"scale gives no positive number for the output(s) {', '.join(missing)}."
                )
            return np.array([scale[name] for name in names], dtype=float)
        if scale == "noise":
            levels = given_levels(self.model.outputs)
            return np.where(np.isfinite(levels), levels, noise_floor(self.dataset))
        if scale != "peak":
            raise ModelError(f"scale is {scale!r}. Choose noise, peak or a number per output.")
        stacked = np.vstack([record.outputs for record in self.dataset])
        peaks = np.nanmax(np.abs(stacked), axis=0)
        if not np.all(peaks > 0):
            flat = names[int(np.argmin(peaks))]
            raise DataError(f"Output {flat!r} is zero all the time and has no peak to scale with.")
        return peaks

    def _start(self, index: int) -> np.ndarray:
        own = np.zeros(len(self.model.states))
        for position, series in measured_states(self.model, self.dataset[index]).items():
            own[position] = series[0]
        for name, value in self.initial.items():
            own[self.model.state_names.index(name)] = value
        return own

    def __call__(self, population: np.ndarray) -> np.ndarray:
        """Costs ``(n,)`` of candidates ``(n, n_free)``; infinite where the model diverges."""
        population = np.atleast_2d(population)
        values = np.tile(self.model.value_vector, (len(population), 1))
        values[:, self._columns] = population
        total = np.zeros(len(population))
        count = 0
        for own, record in zip(self._starts, self.dataset, strict=True):
            present = np.isfinite(record.outputs)
            weights = present / self.scales
            measured = np.where(present, record.outputs, 0.0)
            count += int(present.sum())
            room = max(1, CHUNK_BYTES // (8 * record.outputs.size))
            for first in range(0, len(values), room):
                part = slice(first, first + room)
                found = simulate_batch(
                    self.model,
                    record.times,
                    inputs=record.inputs,
                    values=values[part],
                    initials=own,
                    n_workers=self.n_workers,
                )
                found -= measured
                found *= weights
                flat = found.reshape(len(found), -1)
                with np.errstate(over="ignore", invalid="ignore"):
                    total[part] += np.einsum("ij,ij->i", flat, flat)
        self.n_evaluations += len(population)
        return np.where(np.isfinite(total), total / count, np.inf)

    def fit(
        self,
        best: np.ndarray,
        *,
        estimator: str,
        began: float,
        iterations: int,
        status: Status,
        extras: Mapping[str, Any] | None = None,
    ) -> Fit:
        """Build the result from the best candidate ``(n_free,)``.

        The covariance is that of least squares at the optimum, widened by the
        noise of the measured start states.
        """
        if not np.isfinite(self(best)[0]):
            status = Status(
                "diverged",
                "every candidate left the numbers. Narrow the bounds, or reduce model.step.",
            )
        information, covariance, coloured = self._errors(best)
        return fit_from_values(
            self.model,
            self.dataset,
            estimator=estimator,
            estimates=best,
            covariance=covariance,
            information=information,
            coloured=coloured,
            began=began,
            status=status,
            iterations=iterations,
            initial_states=[self.initial] * len(self.dataset),
            extras={"evaluations": self.n_evaluations, **(extras or {})},
        )

    def _errors(self, best: np.ndarray) -> tuple[Information, np.ndarray, bool]:
        model, runner = self.model, kernel(self.model)
        values = model.value_vector
        values[self._columns] = best
        jacobians, residuals, starts = [], [], []
        for own, record in zip(self._starts, self.dataset, strict=True):
            z, dz = runner.start(own, record.inputs[0], values, record.times[0])
            run = runner.run(record.times, record.inputs, values, z, sensitivities=True)
            assert run.output_sensitivities is not None
            by_state = run.output_sensitivities[:, :, : runner.n_full] @ dz
            by_free = by_state[:, :, runner.n_own :]
            by_free += run.output_sensitivities[:, :, runner.n_full :]
            residual = record.outputs - run.outputs
            present = np.isfinite(residual)[:, :, None]
            jacobians.append(np.where(present & np.isfinite(by_free), by_free, 0.0))
            starts.append(np.where(present, np.nan_to_num(by_state[:, :, : runner.n_own]), 0.0))
            residuals.append(residual)
        stacked = np.vstack(residuals)
        levels = given_levels(model.outputs)
        with np.errstate(invalid="ignore"):
            rms = np.sqrt(np.nanmean(np.where(np.isfinite(stacked), stacked, np.nan) ** 2, axis=0))
        sigma = np.where(np.isfinite(levels), levels, np.maximum(rms, 1e-9 * self.scales))
        sigma = np.where(np.isfinite(sigma), sigma, self.scales)
        # The search weighed outputs by its own scales; errors follow from these weights.
        weights = 1.0 / self.scales
        magnitudes = np.array([p.magnitude for p in model.free_parameters])
        whitened = np.vstack(
            [(j / sigma[:, None]).reshape(-1, len(self._columns)) for j in jacobians]
        )
        information = Information.from_jacobian(model.free_names, whitened, magnitudes)
        weighted = [j * weights[:, None] for j in jacobians]
        rows = np.vstack([j.reshape(-1, len(self._columns)) for j in weighted])
        bread = Information.from_jacobian(model.free_names, rows, magnitudes).covariance
        scaled = [r * weights for r in residuals]
        coloured = are_coloured(scaled)
        shares = (sigma * weights)[:, None]
        noisy = np.vstack([(j * shares).reshape(-1, rows.shape[1]) for j in weighted])
        middle = coloured_score_covariance(weighted, scaled) if coloured else noisy.T @ noisy
        middle = middle + self._start_noise(weighted, starts, weights, sigma)
        return information, sandwich(bread, middle), coloured

    def _start_noise(
        self,
        weighted: list[np.ndarray],
        starts: list[np.ndarray],
        weights: np.ndarray,
        sigma: np.ndarray,
    ) -> np.ndarray:
        """Covariance of the score that comes from the noise of the start states."""
        n_free = len(self._columns)
        total = np.zeros((n_free, n_free))
        sources = {output.source: i for i, output in enumerate(self.model.outputs)}
        spread = np.array(
            [
                sigma[sources[name]] if name in sources and name not in self.initial else 0.0
                for name in self.model.state_names
            ]
        )
        for jacobian, start in zip(weighted, starts, strict=True):
            whitened = (start * weights[:, None]).reshape(-1, start.shape[2])
            mixed = jacobian.reshape(-1, n_free).T @ (whitened * spread)
            total += mixed @ mixed.T
        return total
