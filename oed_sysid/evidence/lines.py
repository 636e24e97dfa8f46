r"""Frequencies at which a residual swings, to begin the search for a periodic force.

Over a record of length :math:`T` two frequencies are told apart from about :math:`2\pi / T` on, so
that a coarse grid of frequencies misses a wave in a long record: at all frequencies of the grid it
averages out, in every equation, and an equation that it does not act in may come first by chance. A
force that swings moves outputs with its frequency, so that the periodogram of the innovations
:math:`e` in units of their standard deviation (Schuster 1898), summed over records and outputs,

.. math::
    P(\omega) = \sum_i \frac{1}{n_i} \Bigl| \sum_k e_{ik}\, e^{-\mathrm{i}\omega t_{ik}} \Bigr|^2,

has its largest maxima where it is worth to begin.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Frequencies per 2 pi over the longest record; and maxima that are tried.
PER_CYCLE, N_LINES = 4, 3
# Most frequencies that are looked at, products with times at once.
MOST, AT_ONCE = 20_000, 200


def lines(
    times: Sequence[np.ndarray], innovations: Sequence[np.ndarray], low: float, high: float
) -> np.ndarray:
    """Frequencies of the largest maxima of the periodogram.

    Parameters
    ----------
    times : sequence of ndarray (n_times,)
        Of each record, s.
    innovations : sequence of ndarray (n_times, n_outputs)
        In units of their standard deviation; NaN where not measured.
    low, high : float
        Range, rad/s.

    Returns
    -------
    ndarray (n_lines,)
        Largest first, three at most, rad/s.

    Examples
    --------
    >>> t = np.arange(0.0, 600.0, 0.5)
    >>> found = lines([t], [np.cos(0.713 * t + 1.0)[:, None]], 0.4, 0.9)
    >>> print(f"{found[0]:.3f}")
    0.714
    """
    longest = max((float(t[-1] - t[0]) for t in times if len(t) > 1), default=0.0)
    count = int(np.ceil((high - low) * longest * PER_CYCLE / (2.0 * np.pi))) + 1
    if not (high > low and 3 <= count <= MOST):
        return np.zeros(0)
    frequencies = np.linspace(low, high, count)
    power = np.zeros(count)
    for t, part in zip(times, innovations, strict=True):
        seen = np.isfinite(part)
        rows = np.where(seen, part, 0.0) / np.sqrt(np.maximum(seen.sum(axis=0), 1))
        for begin in range(0, count, AT_ONCE):
            block = slice(begin, begin + AT_ONCE)
            waves = np.exp(-1j * np.outer(frequencies[block], t))
            power[block] += (np.abs(waves @ rows) ** 2).sum(axis=1)
    padded = np.pad(power, 1, constant_values=-np.inf)
    peaks = np.flatnonzero((power >= padded[:-2]) & (power > padded[2:]))
    return frequencies[peaks[np.argsort(-power[peaks], kind="stable")][:N_LINES]]
