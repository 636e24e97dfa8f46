"""Noise levels: what the data themselves say about their measurement noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed_sysid.channels import Output
from oed_sysid.dataset import Dataset

# A residual this much smaller than the signal's own spread is numerically exact.
SMALLEST_SHARE = 1e-9


def noise_floor(dataset: Dataset) -> np.ndarray:
    """Standard deviation of the white part of each output, shape ``(n_outputs,)``.

    From third differences, which a smooth motion hardly enters: the variance of
    a third difference of white noise is twenty times that of the noise.
    """
    n_outputs = len(dataset[0].channels.outputs)
    levels = np.full(n_outputs, np.nan)
    for column in range(n_outputs):
        squares = [np.diff(record.outputs[:, column], 3) ** 2 for record in dataset]
        pooled = np.concatenate(squares)
        pooled = pooled[np.isfinite(pooled)]
        if len(pooled):
            # The median of a chi-squared variable with one degree of freedom is 0.4549.
            robust = np.median(pooled) / 0.4549
            levels[column] = np.sqrt((robust or np.mean(pooled)) / 20.0)
    spread = signal_spread(dataset)
    return np.where(np.isfinite(levels), np.maximum(levels, SMALLEST_SHARE * spread), spread)


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


def residual_levels(residuals: Sequence[np.ndarray], n_unknowns: int) -> np.ndarray:
    """Root mean square of residuals, corrected for the unknowns fitted, by output."""
    stacked = np.vstack(residuals)
    present = np.isfinite(stacked)
    count = present.sum(axis=0)
    total = max(int(count.sum()), 1)
    share = count * (1.0 - min(n_unknowns / total, 0.9))
    squares = (np.where(present, stacked, 0.0) ** 2).sum(axis=0)
    return np.sqrt(squares / np.maximum(share, 1e-9))
