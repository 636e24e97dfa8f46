"""Noise levels by maximum likelihood: Fisher scoring on variances.

In a variance the likelihood has a slope even at zero, so that an absent
disturbance stays absent for a reason, and one scoring step from anywhere
solves the case of plain white noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.diagnosis.lanes import innovations_by_model
from oed_sysid.information import autocorrelation
from oed_sysid.noise.kalman import Deviations, Innovations, NoiseModel
from oed_sysid.projection import bounded_step

# Smallest white variance, as a share of its unit: the filter must stay regular.
WHITE_FLOOR = 1e-4
# Finite-difference step, as a share of the variance and of its unit.
RELATIVE_STEP, ABSOLUTE_STEP = 1e-4, 1e-5


def estimate_noise(
    start: NoiseModel,
    units: NoiseModel,
    deviations: Sequence[Deviations],
    residuals: Sequence[np.ndarray],
    *,
    known: bool,
    least_white: np.ndarray | None = None,
    tolerance: float = 0.01,
    max_iterations: int = 25,
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
    least_white : ndarray (n_outputs,), optional
        Smallest white levels, in their unit: what disturbances may not explain away.
    tolerance : float
        Stop when minus twice the log-likelihood would fall by less.
    max_iterations : int
        Most scoring steps, without and with colour.
    """
    series = [residual[:, :, None] for residual in residuals]
    floor = np.full(len(units.white), WHITE_FLOOR)
    if least_white is not None:
        floor = np.maximum(floor, (least_white / units.white) ** 2)
    search = _Search(units, deviations, series, floor, known=known, coloured=start.has_colour)
    noise = search.run(start, tolerance, max_iterations)
    if known or noise.has_colour or not search.is_coloured(noise):
        return noise
    colour = np.where(noise.colour > 0, noise.colour, 0.3 * units.colour)
    search = _Search(units, deviations, series, floor, known=known, coloured=True)
    admitted = noise.with_levels(noise.white, colour, noise.force)
    return search.run(admitted, tolerance, max_iterations)


class _Search:
    """Fisher scoring on the variances that are free, in squared units."""

    def __init__(
        self,
        units: NoiseModel,
        deviations: Sequence[Deviations],
        series: Sequence[np.ndarray],
        white_floor: np.ndarray,
        *,
        known: bool,
        coloured: bool,
    ) -> None:
        self.units, self.deviations, self.series = units, deviations, series
        self.known, self.coloured = known, coloured
        self.n_forces, self.n_outputs = len(units.force), len(units.white)
        lower = [np.zeros(self.n_forces)]
        if not known:
            lower.append(white_floor)
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
        return innovations_by_model(
            [self.model(v) for v in variances], self.deviations, self.series
        )

    def run(self, start: NoiseModel, tolerance: float, max_iterations: int) -> NoiseModel:
        """Iterate until minus twice the log-likelihood would fall by less than the tolerance.

        Variances at their bound rest until the others have settled.
        """
        point = self.at(self.variances(start))
        slopes = _Slopes.empty(len(point.variances), point)
        awake, damping = np.ones(len(point.variances), dtype=bool), 1e-3
        for _ in range(max_iterations):
            self.differentiate(point, slopes, awake)
            step, promised = self.step(point, slopes, awake, damping)
            if promised < tolerance and not awake.all():
                self.differentiate(point, slopes, ~awake)
                awake[:] = True
                step, promised = self.step(point, slopes, awake, damping)
            if promised < tolerance:
                break
            for _ in range(8):
                trial = self.at(point.variances + step)
                if trial.value < point.value:
                    break
                damping = max(10 * damping, 1e-2)
                step, _ = self.step(point, slopes, awake, damping)
            else:
                break
            point = trial
            damping /= 10
            awake = point.variances > self.lower
        return self.model(point.variances)

    def at(self, variances: np.ndarray) -> _Point:
        """Innovations and likelihood at given variances."""
        return _Point.of(variances, self.filter([variances])[0])

    def differentiate(self, point: _Point, slopes: _Slopes, which: np.ndarray) -> None:
        """Fill the slopes by the variances that are named, by differences."""
        index = np.flatnonzero(which)
        sizes = RELATIVE_STEP * point.variances[index] + ABSOLUTE_STEP
        unit = np.eye(len(which))[index]
        moved = self.filter([point.variances + d * e for d, e in zip(sizes, unit, strict=True)])
        for position, size, parts in zip(index, sizes, moved, strict=True):
            slopes.fill(int(position), point, parts, float(size))

    def step(
        self, point: _Point, slopes: _Slopes, awake: np.ndarray, damping: float
    ) -> tuple[np.ndarray, float]:
        """Damped scoring step within the bounds, and the decrease that it promises."""
        gradient, fisher = slopes.of(point, awake)
        part = bounded_step(
            fisher,
            -0.5 * gradient,
            (self.lower - point.variances)[awake],
            np.full(len(gradient), np.inf),
            damping,
        )
        step = np.zeros_like(point.variances)
        step[awake] = part
        return step, float(-(gradient @ part + part @ fisher @ part))

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


@dataclass(frozen=True, eq=False)
class _Point:
    """Variances, with the innovations and minus twice the log-likelihood that they give."""

    variances: np.ndarray
    white: np.ndarray
    roots: np.ndarray
    value: float

    @classmethod
    def of(cls, variances: np.ndarray, parts: Sequence[Innovations]) -> _Point:
        white, roots = _joined(parts)
        value = float(white @ white + 2.0 * np.log(roots).sum())
        return cls(variances, white, roots, value if np.isfinite(value) else np.inf)


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Derivatives of every innovation, and of the logarithm of its variance.

    Rows belong to variances, columns to scalar innovations.
    """

    innovation: np.ndarray
    log_variance: np.ndarray

    @classmethod
    def empty(cls, n_variances: int, point: _Point) -> _Slopes:
        shape = n_variances, len(point.white)
        return cls(np.zeros(shape), np.zeros(shape))

    def fill(self, position: int, point: _Point, moved: Sequence[Innovations], size: float) -> None:
        white, roots = _joined(moved)
        self.log_variance[position] = 2.0 * np.log(roots / point.roots) / size
        self.innovation[position] = (white * roots / point.roots - point.white) / size

    def of(self, point: _Point, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradient of the objective and expected information, from scalar innovations.

        With innovations ``e`` of variance ``s``, the objective is the sum of
        ``e^2/s + log s`` and the information of two parameters is the sum of
        ``ds ds / (2 s^2) + de de / s`` (e.g. Harvey 1989, section 3.4).
        """
        dlog, de = self.log_variance[which], self.innovation[which]
        gradient = dlog @ (1.0 - point.white**2) + 2.0 * de @ point.white
        return gradient, 0.5 * dlog @ dlog.T + de @ de.T


def _joined(parts: Sequence[Innovations]) -> tuple[np.ndarray, np.ndarray]:
    return (
        np.concatenate([part.white.ravel() for part in parts]),
        np.concatenate([part.roots.ravel() for part in parts]),
    )
