r"""Steps: a signal jumps once between two samples and stays there.

A compass that was set, a gyro that was reset, a depth whose zero was changed. Straight lines
through the five samples before and the five after meet the middle between samples :math:`i` and
:math:`i + 1` at different levels,

.. math:: J_i = r_i(t_{i+1/2}) - l_i(t_{i+1/2}).

A step stands out by 8.5 robust deviations of :math:`J`, over the record and near by, is three times
what the signal moves by itself over these samples, happens between two samples (the raw change is
most of it), and is the largest of its neighbours. Curvature moves both lines alike and falls out.

:math:`J` is uncertain by 1.28 times the noise. Its size is therefore fitted once more as a cubic
with a step, over the widest surroundings in which noise is all that this leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oed_sysid.evidence.traces import QUARTILE, fast_noise

LIMIT = 8.5
# Samples on either side that tell level and slope.
SIDE = 5
NEARBY = 25
# A step below this share of the range of a signal is left to the equations.
SMALL = 0.05
# Against the motion along either line over its samples, and the part between the two samples.
STEEP, AT_ONCE = 3.0, 0.7
# Half widths, in samples, of the surroundings that its size is fitted in.
WIDTHS = (10, 20, 40, 80)
# What a fit may leave against the noise.
NOISY = 1.15
UNEVEN = 0.2
LEAST_WINDOWS = 20


@dataclass(frozen=True)
class Step:
    """A jump: index of the first sample after it, and its size in the unit of the signal."""

    row: int
    size: float


def steps(times: np.ndarray, series: np.ndarray, taken: np.ndarray, least: float) -> list[Step]:
    """Find jumps after which a signal keeps its new level.

    Parameters
    ----------
    times, series : numpy.ndarray
        Shape ``(n_times,)``; the series has no gaps.
    taken : numpy.ndarray of bool
        Samples that are known to be bad; no step is looked for beside them.
    least : float
        The least size that matters, in the unit of the series.

    Examples
    --------
    >>> t = np.arange(400) * 0.1
    >>> y = np.sin(t) + 0.01 * np.random.default_rng(0).standard_normal(400)
    >>> y[250:] += 1.5
    >>> [(one.row, round(one.size, 1)) for one in steps(t, y, np.zeros(400, dtype=bool), 0.1)]
    [(250, 1.5)]
    """
    n = series.size - 2 * SIDE + 1
    if n < LEAST_WINDOWS:
        return []
    # Level half a sample beyond the end of a line through SIDE samples, and its slope.
    at = np.arange(SIDE) - 0.5 * (SIDE - 1)
    slope = at / np.sum(at**2)
    level = 1.0 / SIDE + 0.5 * SIDE * slope
    windows = np.lib.stride_tricks.sliding_window_view(series, SIDE)
    before, after = windows[:n], windows[SIDE : SIDE + n]
    jumps = after @ level[::-1] - before @ level
    motion = SIDE * np.maximum(np.abs(before @ slope), np.abs(after @ slope))
    raw = series[SIDE : SIDE + n] - series[SIDE - 1 : SIDE - 1 + n]
    usual = float(np.median(np.abs(jumps))) / QUARTILE
    intervals = np.diff(times)
    uneven = np.abs(intervals - np.median(intervals)) > UNEVEN * np.median(intervals)
    size = np.abs(jumps)
    result = []
    for k in np.flatnonzero(size > np.maximum(max(LIMIT * usual, least), STEEP * motion)):
        around = slice(k, k + 2 * SIDE)
        if taken[around].any() or uneven[k : k + 2 * SIDE - 1].any():
            continue
        if size[k] < size[max(k - SIDE, 0) : k + SIDE + 1].max():
            continue
        beside = np.abs(np.arange(n) - k)
        near = size[(beside >= SIDE) & (beside < SIDE + NEARBY)]
        nearby = LIMIT * float(np.median(near)) / QUARTILE
        if size[k] > nearby and raw[k] / jumps[k] > AT_ONCE:
            result.append(Step(int(k) + SIDE, float(jumps[k])))
    edges = [0, *(one.row for one in result), series.size]
    return [
        Step(one.row, _size(series, taken, one, (edges[j], edges[j + 2])))
        for j, one in enumerate(result)
    ]


def _size(series: np.ndarray, taken: np.ndarray, one: Step, free: tuple[int, int]) -> float:
    """Size of a jump from the widest surroundings that a cubic with a step follows."""
    noise, size = fast_noise(series), one.size
    for width in WIDTHS:
        if one.row - width < free[0] or one.row + width > free[1]:
            break
        rows = np.arange(one.row - width, one.row + width)
        x = (rows - one.row + 0.5) / width
        matrix = np.column_stack([x**0, x, x**2, x**3, x > 0.0])[~taken[rows]]
        here = series[rows[~taken[rows]]]
        fitted = np.linalg.lstsq(matrix, here, rcond=None)[0]
        left = here - matrix @ fitted
        if np.sqrt(np.sum(left**2) / (here.size - 5)) > NOISY * noise:
            break
        size = float(fitted[-1])
    return size
