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
STRUCTURED_SPIKE = 8.0
# Share of the departures within which tails are looked at, and where it ends in normal numbers.
TAIL = 0.9
TAIL_AT = float(-ndtri(0.5 * (1.0 - TAIL)))
# Single spikes from which on groups of them are spikes, too.
SEVERAL = 3
# Spread of the departure of white noise from the median of its four neighbours.
BESIDE = 1.137


def spike_masks(
    whitened: Sequence[np.ndarray],
    *,
    declared: np.ndarray | None = None,
    taken: np.ndarray | None = None,
) -> tuple[np.ndarray, ...]:
    """Samples that stand out alone, per record.

    Parameters
    ----------
    whitened : sequence of ndarray (n_times, n_outputs)
        Residuals in any unit, NaN where missing.
    declared : ndarray of bool (n_outputs,), optional
        Outputs whose residuals are in units of a declared noise level: within what this makes
        no sample is a spike, however smooth the others are.
    taken : ndarray of int (n_outputs,), optional
        Samples of each output that were taken out as spikes before.

    Returns
    -------
    tuple of ndarray of bool (n_times, n_outputs)
    """
    masks = tuple(np.zeros(part.shape, dtype=bool) for part in whitened)
    n_outputs = whitened[0].shape[1]
    for column in range(n_outputs):
        rows, series, pieces, usual = _departures(whitened, column)
        n = sum(len(piece) for piece in pieces)
        if n < 30 or usual <= 0.0:
            continue
        least = 1.0 if declared is not None and declared[column] else 0.0
        count = 0 if taken is None else taken[column]
        chance = SPIKE_CHANCE / n_outputs
        found = _outliers(series, pieces, max(usual, BESIDE * least), least, count, chance)
        for mask, index, one in zip(masks, rows, found, strict=True):
            mask[index, column] = one
    return masks


def _outliers(
    series: list[np.ndarray],
    pieces: list[np.ndarray],
    usual: float,
    least: float,
    count: int,
    chance: float,
) -> list[np.ndarray]:
    """Spikes among the samples of one output, per record; see :func:`spike_masks`.

    Parameters
    ----------
    series, pieces : list of ndarray (n,)
        Values, and their departures from the median of their neighbours.
    usual, least : float
        Usual departure, and least deviation of the values.
    count : int
        Spikes that were taken out before.
    chance : float
        Probability that normal noise shows one.
    """
    own = np.concatenate(series)
    n, middle = len(own), float(np.median(own))
    slow = max(_deviation(own - middle), least)
    surely = float(-ndtri(0.5 * chance / n))
    structured = slow > 1.1 * usual / BESIDE
    if structured:
        # A bend of slow residuals is followed by the cubic through the neighbours; a transient
        # here and there makes large departures usual.
        surely = limit = max(surely, STRUCTURED_SPIKE)
        off = [_off_cubic(values) for values in series]
        spread = max(_deviation(np.concatenate(off)), least)
        usual = max(usual, float(np.quantile(np.abs(np.concatenate(pieces)), TAIL)) / TAIL_AT)
    else:
        # Neighbours that happen to lie on the other side do not make a spike.
        limit = max(4.0, float(-ndtri(0.5 / n)))
        off, spread = [values - middle for values in series], slow
    sizes = [
        np.minimum(np.abs(piece) / usual, np.abs(away) / (spread or usual))
        for piece, away in zip(pieces, off, strict=True)
    ]
    masks = [np.zeros(len(values), dtype=bool) for values in series]
    if np.any(np.concatenate(sizes) > surely):
        # Where spikes are clear, what chance does in one sample of n is one of them too.
        masks = [size > limit for size in sizes]
        count += sum(int(mask.sum()) for mask in masks)
    if structured or count < SEVERAL:
        return masks
    # Where there are several spikes some meet: as many in a row as chance makes of so many.
    longest = max(int(np.log(SPIKE_CHANCE / n) / np.log(min(count / n, 0.5))), 2)
    for mask, away in zip(masks, off, strict=True):
        big = np.abs(away) > surely * slow
        mask |= big & (_run_lengths(big) <= longest)
    return masks


def _deviation(values: np.ndarray) -> float:
    """Standard deviation of normal numbers of mean zero, from the median of their sizes."""
    return 1.4826 * float(np.median(np.abs(values)))


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


def _run_lengths(marked: np.ndarray) -> np.ndarray:
    """Length of the run of marked samples that each belongs to, zero where it is not marked."""
    edges = np.flatnonzero(np.diff(np.r_[False, marked, False].astype(int)))
    lengths = np.zeros(len(marked), dtype=int)
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        lengths[first:stop] = stop - first
    return lengths


def _departures(
    whitened: Sequence[np.ndarray], column: int
) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray], float]:
    """Rows, values and departures of the samples of one output, per record; the usual departure."""
    rows = [np.flatnonzero(np.isfinite(part[:, column])) for part in whitened]
    series = [part[index, column] for part, index in zip(whitened, rows, strict=True)]
    pieces = [_beside(values) for values in series]
    away = np.concatenate(pieces)
    usual = _deviation(away - np.median(away)) if len(away) else 0.0
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
    middle = neighbours.sum(axis=0) - neighbours.max(axis=0) - neighbours.min(axis=0)
    away = values - 0.5 * middle
    least = np.min((values - neighbours[1:3]) * np.sign(away), axis=0)
    grouped = (least < 0.5 * np.abs(away)) & (np.abs(away) > 3.0 * np.median(np.abs(away)))
    return np.where(grouped, 0.0, away)


def _off_cubic(values: np.ndarray) -> np.ndarray:
    """Departure of every sample from the cubic through its two neighbours on each side."""
    off = np.zeros(len(values))
    if len(values) >= 5:
        near, far = values[1:-3] + values[3:-1], values[:-4] + values[4:]
        off[2:-2] = values[2:-2] - (4.0 * near - far) / 6.0
    return off


def without_spikes(dataset: Dataset, masks: Sequence[np.ndarray]) -> Dataset:
    """Copy of a data set in which the marked samples are missing."""
    return Dataset(
        tuple(
            record.with_outputs(np.where(mask, np.nan, record.outputs))
            for record, mask in zip(dataset, masks, strict=True)
        )
    )
