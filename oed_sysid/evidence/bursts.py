r"""Groups of bad samples: a signal leaves its surroundings at once and comes back.

For a group of :math:`L` samples from :math:`i` on, :math:`c_k` is the cubic through the two samples
before it and the two after it, and

.. math:: D_i = \min(|y_i - c_i|,\, |y_{i+L-1} - c_{i+L-1}|)

is how far both of its ends stand out. The scatter of the same deviations over the whole record, for
the same :math:`L`, allows for the motion that a cubic does not follow; that near by for a manoeuvre
in an otherwise quiet record. With :math:`a, b` the changes from sample to sample after and before
the group, it is left alone unless the steps into it and out of it exceed :math:`1.5\,|a - b|`
beside :math:`b` and :math:`a`, and unless its ends stand out by half of what its middle does: a
turning point and a short hump are no faults.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed_sysid.evidence.traces import QUARTILE

LENGTHS = (2, 3, 4, 5, 6)
# Half width, in samples, of what is near by, beside the group.
NEARBY = 20
# Largest deviation of a time step in the group from the usual one.
UNEVEN = 0.2
LEAST_WINDOWS = 20


def bursts(
    times: np.ndarray, series: np.ndarray, taken: np.ndarray, limit: float, least: float
) -> list[np.ndarray]:
    """Find groups of two to six consecutive samples that their surroundings contradict.

    Parameters
    ----------
    times, series : numpy.ndarray
        Shape ``(n_times,)``; the series has no gaps.
    taken : numpy.ndarray of bool
        Samples that are known to be bad, already replaced by what lies between the others.
    limit : float
        Robust deviations that both ends of a group have to stand out by.
    least : float
        The least deviation that matters, in the unit of the series.

    Returns
    -------
    list of numpy.ndarray
        Indices of the samples of each group.

    Examples
    --------
    >>> t = np.arange(300) * 0.1
    >>> y = np.sin(t) + 0.01 * np.random.default_rng(0).standard_normal(300)
    >>> y[100:103] += [0.5, -0.5, 0.5]
    >>> [rows.tolist() for rows in bursts(t, y, np.zeros(300, dtype=bool), 8.5, 0.02)]
    [[100, 101, 102]]
    """
    used = taken.copy()
    steps = np.diff(times)
    uneven = np.abs(steps - np.median(steps)) > UNEVEN * np.median(steps)
    found: list[tuple[float, int, int]] = []
    for length in LENGTHS:
        if series.size - length - 3 >= LEAST_WINDOWS:
            found += _candidates(series, length, limit, least)
    groups = []
    # The clearest first: a window that holds a part of a group sees the rest beside it.
    for _, first, length in sorted(found, reverse=True):
        window = slice(first - 2, first + length + 2)
        if used[window].any() or uneven[first - 2 : first + length + 1].any():
            continue
        groups.append(np.arange(first, first + length))
        used[first : first + length] = True
    return groups


def weights(length: int) -> np.ndarray:
    """Share of each of the four surrounding samples in the cubic, shape ``(length, 4)``.

    >>> print(weights(1) * 6.0)
    [[-1.  4.  4. -1.]]
    """
    at = np.array([-2.0, -1.0, length, length + 1.0])
    powers = np.arange(4)
    inside = np.arange(length)[:, None] ** powers
    return np.round(inside @ np.linalg.inv(at[:, None] ** powers), 12)


def deviations(y: np.ndarray, length: int) -> np.ndarray:
    """Distance from the cubic of every group of a length, shape ``(n - length - 3, length)``."""
    n = y.size - length - 3
    around = np.column_stack([y[k : k + n] for k in (0, 1, length + 2, length + 3)])
    inside = np.column_stack([y[k + 2 : k + 2 + n] for k in range(length)])
    return inside - around @ weights(length).T


def _candidates(
    y: np.ndarray, length: int, limit: float, least: float
) -> Sequence[tuple[float, int, int]]:
    """Excess, first sample and length of each group that stands out."""
    d = np.abs(deviations(y, length))
    ends = np.minimum(d[:, 0], d[:, -1])
    usual = float(np.median(d[:, [0, -1]])) / QUARTILE
    result = []
    # What rises from sample to sample stands out most in its middle.
    sharp = ends >= 0.5 * d.max(axis=1)
    for k in np.flatnonzero(sharp & (ends > max(limit * usual, least))):
        first = int(k) + 2
        last = first + length - 1
        before, after = y[first - 1] - y[first - 2], y[last + 2] - y[last + 1]
        bend = 1.5 * abs(after - before)
        into, out = y[first] - y[first - 1] - before, y[last + 1] - y[last] - after
        back = y[last + 1] - y[first - 1] - 0.5 * (length + 1) * (before + after)
        if min(abs(into), abs(out)) <= bend or abs(back) > 0.5 * ends[k]:
            continue
        # Windows that overlap the group see it as well.
        beside = np.abs(np.arange(d.shape[0]) - k)
        near = d[(beside > length + 3) & (beside <= length + 3 + NEARBY)]
        nearby = limit * float(np.median(near[:, [0, -1]])) / QUARTILE if near.size else 0.0
        # Calm surroundings: their own changes are no size that would make a group stand out.
        calm = 3.0 * max(abs(before), abs(after))
        if ends[k] > max(nearby, calm):
            result.append((float(ends[k] / max(limit * usual, nearby, least)), first, length))
    return result
