"""Noise levels: what the data themselves say about their measurement noise."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError
from oed_sysid.physics.channels import Output
from oed_sysid.physics.model import Model

# A residual this much smaller than the signal's own spread is numerically exact.
SMALLEST_SHARE = 1e-9
# Orders of differences in which white noise is looked for, and the share of one order's level
# below which the next one's means that motion was seen, not noise.
LOWEST_ORDER, HIGHEST_ORDER, STILL_FALLING = 3, 12, 0.85
# White noise below this share of the signal is the last digit of a file, not a sensor; and where
# no sensor's noise is seen, as in a filtered log, it is not taken to be finer than FINEST_NOISE.
LAST_DIGIT, FINEST_NOISE = 1e-5, 1e-3


def noise_floor(dataset: Dataset) -> np.ndarray:
    """Standard deviation of the white part of each output, shape ``(n_outputs,)``.

    See :func:`white_levels`.
    """
    return white_levels(dataset)[0]


def white_levels(dataset: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Level of the white part of each output, and whether it is the noise that one sees.

    From differences of third order, which a smooth motion hardly enters: the
    variance of a difference of order k of white noise is ``binomial(2k, k)`` times
    that of the noise. While the next order shows clearly less, it is still the
    motion that is seen. Differences are taken between samples that follow one
    another, missing ones left out.

    Parameters
    ----------
    dataset : Dataset

    Returns
    -------
    levels : ndarray (n_outputs,)
        The signal's spread where there are too few samples.
    seen : ndarray of bool (n_outputs,)
        False where the level still falls at the highest order: it is then no
        more than an upper limit of the noise.
    """
    n_outputs = len(dataset[0].channels.outputs)
    levels, seen = np.full(n_outputs, np.nan), np.zeros(n_outputs, dtype=bool)
    for column in range(n_outputs):
        measured = [r.outputs[:, column] for r in dataset if not r.independent]
        measured = [values[np.isfinite(values)] for values in measured]
        levels[column] = _difference_level(measured, LOWEST_ORDER)
        for order in range(LOWEST_ORDER + 1, HIGHEST_ORDER + 1):
            finer = _difference_level(measured, order)
            if not finer < STILL_FALLING * levels[column]:
                seen[column] = np.isfinite(finer)
                break
            levels[column] = finer
    spread = signal_spread(dataset)
    known = np.isfinite(levels)
    return np.where(known, np.maximum(levels, SMALLEST_SHARE * spread), spread), seen & known


def credible_levels(dataset: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Noise levels that sensors may have, and whether the records show them.

    As :func:`white_levels`, but a level that is not seen, or is that of the last
    digit of a file, is at least a thousandth of the signal's spread: filtered
    records would otherwise seem to be measured without any error.

    Returns
    -------
    levels : ndarray (n_outputs,)
    seen : ndarray of bool (n_outputs,)
    """
    levels, seen = white_levels(dataset)
    spread = signal_spread(dataset)
    seen = seen & (levels > LAST_DIGIT * spread)
    return np.where(seen, levels, np.maximum(levels, FINEST_NOISE * spread)), seen


def _difference_level(measured: Sequence[np.ndarray], order: int) -> float:
    """Standard deviation of white noise with differences as large as these; NaN without any."""
    pooled = np.concatenate([np.zeros(0), *(np.diff(values, order) ** 2 for values in measured)])
    if not len(pooled):
        return np.nan
    # The median of a chi-squared variable with one degree of freedom is 0.4549.
    robust = np.median(pooled) / 0.4549
    return float(np.sqrt((robust or np.mean(pooled)) / comb(2 * order, order)))


def signal_spread(dataset: Dataset) -> np.ndarray:
    """Standard deviation of each measured signal, at least a tiny positive number."""
    stacked = np.vstack([record.outputs - _first(record.outputs) for record in dataset])
    present = np.isfinite(stacked)
    count = np.maximum(present.sum(axis=0), 1)
    mean = np.where(present, stacked, 0.0).sum(axis=0) / count
    variance = (np.where(present, stacked - mean, 0.0) ** 2).sum(axis=0) / count
    return np.maximum(np.sqrt(variance), 1e-12)


def _first(outputs: np.ndarray) -> np.ndarray:
    present = np.isfinite(outputs)
    rows = np.argmax(present, axis=0)
    values = outputs[rows, np.arange(outputs.shape[1])]
    return np.where(np.isfinite(values), values, 0.0)


def given_levels(outputs: Sequence[Output]) -> np.ndarray:
    """Declared noise levels, NaN where unknown."""
    return np.array([np.nan if o.noise_std is None else o.noise_std for o in outputs], dtype=float)


def start_levels(
    model: Model, dataset: Dataset, noise: str | Sequence[float], earlier: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Noise levels to begin with, and which of them to estimate.

    Parameters
    ----------
    model : Model
        Its outputs may declare levels.
    dataset : Dataset
        Measured records.
    noise : str or sequence of float
        As :class:`~oed_sysid.likelihood.multiple_shooting.MultipleShooting` takes it.
    earlier : ndarray (n_outputs,) or None
        Levels of an earlier fit.

    Returns
    -------
    levels : ndarray (n_outputs,)
        An output without any sample counts as one unit; it weighs nothing.
    estimated : ndarray of bool (n_outputs,)
    """
    names = model.output_names
    measured = np.isfinite(np.vstack([record.outputs for record in dataset])).any(axis=0)
    if not isinstance(noise, str):
        levels = np.asarray(noise, dtype=float)
        if levels.shape != (len(names),):
            raise ModelError(
                f"noise gives {levels.size} levels, expected {len(names)}, for {', '.join(names)}."
            )
        _check_positive(names, levels)
        return levels, np.zeros(len(levels), dtype=bool)
    declared = given_levels(model.outputs)
    unknown = np.isnan(declared)
    if noise == "given" and np.any(unknown & measured):
        missing = [name for name, is_unknown in zip(names, unknown, strict=True) if is_unknown]
        raise DataError(
            f"The noise level of {', '.join(missing)} is not declared. Set noise_std on these "
            "outputs, or use noise='auto' to estimate it."
        )
    estimated = measured & (unknown if noise != "estimate" else True)
    if noise != "estimate":
        _check_positive(names, np.where(unknown, 1.0, declared))
    if not estimated.any():
        return np.where(measured, declared, 1.0), estimated
    if earlier is not None and earlier.shape == declared.shape:
        floor = earlier
    else:
        # Model errors dominate at first; a floor far below them would stiffen the start.
        floor = np.maximum(noise_floor(dataset), 0.02 * signal_spread(dataset))
    levels = np.where(estimated, floor, declared)
    return np.where(measured, levels, 1.0), estimated


def _check_positive(names: Sequence[str], levels: np.ndarray) -> None:
    for name, level in zip(names, levels, strict=True):
        if not (level > 0 and np.isfinite(level)):
            raise DataError(
                f"The noise level of output {name!r} is {level}; residuals are divided by it. "
                "Give a positive standard deviation, or noise='estimate'."
            )


def residual_levels(residuals: Sequence[np.ndarray], n_unknowns: int) -> np.ndarray:
    """Root mean square of residuals, corrected for the unknowns fitted, by output."""
    stacked = np.vstack(residuals)
    present = np.isfinite(stacked)
    count = present.sum(axis=0)
    total = max(int(count.sum()), 1)
    share = count * (1.0 - min(n_unknowns / total, 0.9))
    squares = (np.where(present, stacked, 0.0) ** 2).sum(axis=0)
    return np.sqrt(squares / np.maximum(share, 1e-9))
