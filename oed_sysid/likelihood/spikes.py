r"""Spikes: samples that stand out alone from residuals.

With :math:`\epsilon_k` the one-step errors of an output,

:math:`d_k = \epsilon_k - \operatorname{median}(\epsilon_{k-2}, \epsilon_{k-1},
\epsilon_{k+1}, \epsilon_{k+2})` over its median absolute deviation; a spike exceeds what the
largest of as many normal numbers does, and stands alone (Hampel 1974, *J. Am. Stat. Assoc.* 69).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtri

from oed_sysid.data.dataset import Dataset

# Spikes that normal noise shows in one data set of so many.
SPIKE_CHANCE = 1e-3
# Where residuals are structured, only what is this many deviations off stands out as a spike.
STRUCTURED_SPIKE = 6.0
# Single spikes from which on pairs of them are spikes, too.
SEVERAL = 3
# Spread of the departure of white noise from the median of its four neighbours.
BESIDE = 1.137


def spike_masks(whitened: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Samples that stand out alone, per record.

    Parameters
    ----------
    whitened : sequence of ndarray (n_times, n_outputs)
        Residuals in any unit, NaN where missing.

    Returns
    -------
    tuple of ndarray of bool (n_times, n_outputs)
    """
    masks = [np.zeros(part.shape, dtype=bool) for part in whitened]
    for column in range(whitened[0].shape[1]):
        rows, series, pieces, size = _departures(whitened, column)
        n = sum(len(piece) for piece in pieces)
        if n < 30 or size <= 0.0:
            continue
        own = np.concatenate(series)
        middle = float(np.median(own))
        slow = 1.4826 * float(np.median(np.abs(own - middle)))
        surely = float(-ndtri(0.5 * SPIKE_CHANCE / n / whitened[0].shape[1]))
        structured = slow > 1.1 * size / BESIDE
        if structured:
            surely = max(surely, STRUCTURED_SPIKE)
        limit = surely if structured else max(4.0, float(-ndtri(0.5 / n)))
        sizes = []
        for values, piece in zip(series, pieces, strict=True):
            scaled = np.abs(piece) / size
            if not structured:
                # Neighbours that happen to lie on the other side do not make a spike.
                scaled = np.minimum(scaled, np.abs(values - middle) / slow)
            sizes.append(scaled)
        if not np.any(np.concatenate(sizes) > surely):
            continue
        for mask, index, scaled in zip(masks, rows, sizes, strict=True):
            # Where spikes are clear, what chance does in one sample of n is one of them too.
            mask[index, column] = scaled > limit
        if structured or sum(int(mask[:, column].sum()) for mask in masks) < SEVERAL:
            continue
        # Where there are several spikes among white residuals, two meet now and then.
        for mask, index, values in zip(masks, rows, series, strict=True):
            big = np.abs(values - middle) > surely * slow
            before, after = np.r_[False, big[:-1]], np.r_[big[1:], False]
            before2, after2 = np.r_[False, before[:-1]], np.r_[after[1:], False]
            pair = big & (after & ~before & ~after2 | before & ~after & ~before2)
            mask[index[pair], column] = True
    return tuple(masks)


def spike_sizes(whitened: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """How far samples are from their neighbours, in the usual distance (its standard deviation).

    Parameters
    ----------
    whitened : sequence of ndarray (n_times, n_outputs)
        Residuals in any unit, NaN where missing.

    Returns
    -------
    tuple of ndarray (n_times, n_outputs)
        With the sign of the departure; NaN where missing.
    """
    found = [np.full(part.shape, np.nan) for part in whitened]
    for column in range(whitened[0].shape[1]):
        rows, _, pieces, usual = _departures(whitened, column)
        for one, index, piece in zip(found, rows, pieces, strict=True):
            one[index, column] = piece / usual if usual > 0 else 0.0
    return tuple(found)


def _departures(
    whitened: Sequence[np.ndarray], column: int
) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray], float]:
    """Rows, values and departures of the samples of one output, per record; the usual departure."""
    rows = [np.flatnonzero(np.isfinite(part[:, column])) for part in whitened]
    series = [part[index, column] for part, index in zip(whitened, rows, strict=True)]
    pieces = [_beside(values) for values in series]
    away = np.concatenate(pieces)
    usual = 1.4826 * float(np.median(np.abs(away - np.median(away)))) if len(away) else 0.0
    return rows, series, pieces, usual


def _beside(values: np.ndarray) -> np.ndarray:
    """Departure of every sample from the median of its two neighbours on each side.

    Zero where the sample does not stand out from the next on either side by half as much: the
    edge of a step and one of a group are no spikes.
    """
    n = len(values)
    if n < 5:
        return np.zeros(n)
    padded = np.concatenate([values[2:0:-1], values, values[-2:-4:-1]])
    neighbours = np.stack([padded[shift : shift + n] for shift in (0, 1, 3, 4)])
    away = values - np.median(neighbours, axis=0)
    least = np.min((values - neighbours[1:3]) * np.sign(away), axis=0)
    grouped = (least < 0.5 * np.abs(away)) & (np.abs(away) > 3.0 * np.median(np.abs(away)))
    return np.where(grouped, 0.0, away)


def without_spikes(dataset: Dataset, masks: Sequence[np.ndarray]) -> Dataset:
    """Copy of a data set in which the marked samples are missing."""
    return Dataset(
        tuple(
            record.with_outputs(np.where(mask, np.nan, record.outputs))
            for record, mask in zip(dataset, masks, strict=True)
        )
    )
