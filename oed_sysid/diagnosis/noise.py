"""Noise levels by maximum likelihood: Fisher scoring on variances.

In a variance the likelihood has a slope even at zero, so that an absent
disturbance stays absent for a reason, and one scoring step from anywhere
solves the case of plain white noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed_sysid.diagnosis.innovations import Deviations, Innovations, NoiseModel, innovations
from oed_sysid.gauss_newton import bounded_step
from oed_sysid.information import autocorrelation

# Smallest white variance, as a share of its unit: the filter must stay regular.
WHITE_FLOOR = 1e-8
# Finite-difference step, as a share of the variance and of its unit.
RELATIVE_STEP, ABSOLUTE_STEP = 1e-4, 1e-5


def estimate_noise(
    start: NoiseModel,
    units: NoiseModel,
    deviations: Sequence[Deviations],
    residuals: Sequence[np.ndarray],
    *,
    known: bool,
) -> NoiseModel:
    """Noise levels that make residuals most likely.

    Coloured sensor noise is admitted only where the innovations without it are
    correlated from sample to sample.

    Parameters
    ----------
    start : NoiseModel
        Start levels.
    units : NoiseModel
        Natural size of every level; also the white levels, where known.
    deviations : sequence of Deviations
    residuals : sequence of ndarray (n_times, n_outputs)
        NaN where nothing was measured.
    known : bool
        Whether white levels are given and sensors have no other noise.
    """
    series = [residual[:, :, None] for residual in residuals]
    search = _Search(units, deviations, series, known=known, coloured=start.has_colour)
    noise = search.run(start)
    if known or noise.has_colour or not search.is_coloured(noise):
        return noise
    colour = np.where(noise.colour > 0, noise.colour, 0.3 * units.colour)
    search = _Search(units, deviations, series, known=known, coloured=True)
    return search.run(noise.with_levels(noise.white, colour, noise.force))


class _Search:
    """Fisher scoring on the variances that are free, in squared units."""

    def __init__(
        self,
        units: NoiseModel,
        deviations: Sequence[Deviations],
        series: Sequence[np.ndarray],
        *,
        known: bool,
        coloured: bool,
    ) -> None:
        self.units, self.deviations, self.series = units, deviations, series
        self.known, self.coloured = known, coloured
        self.n_forces, self.n_outputs = len(units.force), len(units.white)
        lower = [np.zeros(self.n_forces)]
        if not known:
            lower.append(np.full(self.n_outputs, WHITE_FLOOR))
        if coloured:
            lower.append(np.zeros(self.n_outputs))
        self.lower = np.concatenate(lower)

    def variances(self, noise: NoiseModel) -> np.ndarray:
        """Free variances of a noise model, in squared units."""
        parts = [(noise.force / self.units.force) ** 2]
        if not self.known:
            parts.append((noise.white / self.units.white) ** 2)
        if self.coloured:
            parts.append((noise.colour / self.units.colour) ** 2)
        return np.maximum(np.concatenate(parts), self.lower)

    def model(self, variances: np.ndarray) -> NoiseModel:
        """Noise model of given variances."""
        size = np.sqrt(variances)
        rest = size[self.n_forces :]
        white = self.units.white * (1.0 if self.known else rest[: self.n_outputs])
        colour = (
            self.units.colour * rest[-self.n_outputs :]
            if self.coloured
            else np.zeros(self.n_outputs)
        )
        return self.units.with_levels(white, colour, self.units.force * size[: self.n_forces])

    def filter(self, variances: Sequence[np.ndarray]) -> list[list[Innovations]]:
        """Innovations of every record under several noise models, side by side."""
        models = [self.model(v) for v in variances]
        jobs = [
            (noise, record, column)
            for noise in models
            for record, column in zip(self.deviations, self.series, strict=True)
        ]
        found = innovations(jobs)
        n = len(self.series)
        return [found[i * n : (i + 1) * n] for i in range(len(models))]

    def run(self, start: NoiseModel, max_iterations: int = 25) -> NoiseModel:
        """Iterate until minus twice the log-likelihood falls by less than 0.01."""
        variances = self.variances(start)
        # At exactly zero a disturbance looks useless next to others that are too small.
        variances[: self.n_forces] = np.maximum(variances[: self.n_forces], 1e-3)
        value, damping = np.inf, 1e-3
        for _ in range(max_iterations):
            step_sizes = RELATIVE_STEP * variances + ABSOLUTE_STEP
            moved = [
                variances + size * unit
                for size, unit in zip(step_sizes, np.eye(len(variances)), strict=True)
            ]
            base, *others = self.filter([variances, *moved])
            value = _objective(base)
            gradient, fisher = _scores(base, others, step_sizes)
            accepted = None
            for _ in range(8):
                step = bounded_step(
                    fisher,
                    -0.5 * gradient,
                    self.lower - variances,
                    np.full_like(variances, np.inf),
                    damping,
                )
                trial = variances + step
                new = _objective(self.filter([trial])[0])
                if new < value:
                    accepted = (trial, new)
                    break
                damping = max(10 * damping, 1e-2)
            if accepted is None:
                break
            gained = value - accepted[1]
            variances, value = accepted
            damping /= 10
            if gained < 0.01:
                break
        return self.model(variances)

    def is_coloured(self, noise: NoiseModel) -> bool:
        """Whether any output's innovations are clearly correlated from sample to sample."""
        found = self.filter([self.variances(noise)])[0]
        for column in range(self.n_outputs):
            lag_one, count = 0.0, 0
            for part, record in zip(found, self.deviations, strict=True):
                seen = record.present[:, column] > 0
                values = np.where(seen, part.white[:, column, 0], np.nan)
                n = int(seen.sum())
                if n > 20:
                    lag_one += n * float(autocorrelation(values, 1)[1])
                    count += n
            if count and abs(lag_one / count) > 4.0 / np.sqrt(count):
                return True
        return False


def _objective(parts: Sequence[Innovations]) -> float:
    """Minus twice the log-likelihood."""
    value = sum(part.log_determinant + float(np.sum(part.white**2)) for part in parts)
    return value if np.isfinite(value) else np.inf


def _scores(
    base: Sequence[Innovations], others: Sequence[Sequence[Innovations]], steps: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient of the objective and expected information, from scalar innovations.

    With innovations ``e`` of variance ``s``, the objective is the sum of
    ``e^2/s + log s`` and the information of two parameters is the sum of
    ``ds ds / (2 s^2) + de de / s`` (e.g. Harvey 1989, section 3.4).
    """
    root = np.concatenate([part.roots.ravel() for part in base])
    white = np.concatenate([part.white.ravel() for part in base])
    log_variance, innovation = [], []
    for parts, step in zip(others, steps, strict=True):
        moved_root = np.concatenate([part.roots.ravel() for part in parts])
        moved_white = np.concatenate([part.white.ravel() for part in parts])
        log_variance.append(2.0 * np.log(moved_root / root) / step)
        innovation.append((moved_white * moved_root / root - white) / step)
    dlog, de = np.array(log_variance), np.array(innovation)
    gradient = dlog @ (1.0 - white**2) + 2.0 * de @ white
    return gradient, 0.5 * dlog @ dlog.T + de @ de.T
