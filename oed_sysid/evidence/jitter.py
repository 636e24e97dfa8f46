r"""Times at which samples were taken that scatter about those that were written.

A sample that is :math:`\delta_k` early or late is off by :math:`\dot y_i \delta_k` in every signal
:math:`i` that shares the clock, while noise of sensors is their own. With :math:`d_{ik}` what the
cubic through four neighbours leaves, in its own standard deviation, and :math:`g_{ik}` the rate
over the noise that this stands for, signals :math:`i \ne j` have

.. math:: T_{ij} = \sum_k g_i g_j\, d_i d_j, \qquad
    \mathrm{E}\,T_{ij} = \delta^2 \sum_k g_i^2 g_j^2, \qquad
    \mathrm{var}\,T_{ij} = \kappa \sum_k g_i^2 g_j^2 ,

the variance without jitter (or that of the summands, where tails are heavy);
:math:`\kappa = 1 + 2 \sum_l \rho_l^2` of the correlations of fourth differences of white noise.
Louder noise in faster motion makes no false alarm, because the sign of a product is that of the
rates only where the clock is shared. Jitter of one signal alone is not told from such noise, and is
not asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.special import ndtri

from oed_sysid.evidence.chance import FALSE_CLAIMS
from oed_sysid.evidence.traces import LEAST, Trace

# Correlations of fourth differences of white noise, and what they do to the variance of a sum.
CORRELATED = np.array([(-1) ** k * comb(8, 4 + k) / comb(8, 4) for k in range(5)])
SUMMED = float(2.0 * np.sum(CORRELATED**2) - 1.0)


@dataclass(frozen=True)
class Jitter:
    """What pairs of signals say of a shared scatter of the times of samples.

    Parameters
    ----------
    signals : tuple of str
        Signals that share it; empty where none shows.
    size, std : float
        Standard deviation of the times, and its error, s.
    share : float
        Largest share of the fast noise of one of these signals that it makes, 1 at most.
    disorders : bool
        Whether it is more than half a sample: which of two neighbours came first is not known.
    visible : mapping of str to float
        Least standard deviation that would show in each signal, s.
    """

    signals: tuple[str, ...]
    size: float
    std: float
    share: float
    disorders: bool
    visible: Mapping[str, float]


def jitter(traces: Sequence[Trace]) -> Jitter:
    """Judge the times of samples of some records, their bad samples left out."""
    names = tuple(dict.fromkeys(name for trace in traces for name in trace.values))
    if not names:
        return Jitter((), 0.0, 0.0, 0.0, False, {})
    product, power, variance = np.zeros((3, len(names), len(names)))
    own = np.zeros((2, len(names)))
    for trace in traces:
        left, rate = np.stack([_left(trace, name) for name in names], axis=1)
        both, following = left * rate, rate**2 @ rate.T**2
        product += both @ both.T
        power += following
        # Tails of the noise are counted as they are.
        variance += SUMMED * np.maximum(following, both**2 @ both.T**2)
        own += [np.sum(rate**2, axis=1), np.sum(left != 0.0, axis=1)]
    pairs = ~np.eye(len(names), dtype=bool) & (power > 0.0)
    limit = -ndtri(FALSE_CLAIMS / max(int(pairs.sum()) // 2, 1))
    deviation = np.sqrt(variance)
    least = np.sqrt(limit * deviation / np.where(pairs, power, np.nan))
    seen = {n: float(np.nanmin(row)) for n, row in zip(names, least, strict=True)
            if np.isfinite(row).any()}  # fmt: skip
    shares = np.any(pairs & (product > limit * deviation), axis=1)
    among = pairs & shares & shares[:, None]
    total, weight = product[among].sum(), power[among].sum()
    if not total > 0.0:
        return Jitter((), 0.0, 0.0, 0.0, False, seen)
    size = float(np.sqrt(total / weight))
    error = float(np.sqrt(2.0 * variance[among].sum()) / weight / (2.0 * size))
    loudest = float(np.max(size**2 * own[0, shares] / own[1, shares]))
    disorders = size > 0.5 * min(trace.step for trace in traces)
    signals = tuple(np.array(names)[shares].tolist())
    return Jitter(signals, size, error, min(loudest, 1.0), disorders, seen)


def _left(trace: Trace, name: str) -> tuple[np.ndarray, np.ndarray]:
    """What cubics leave of a signal, and its rate over its noise, ``(n_times,)`` each.

    Both are zero where neighbours are missing, and where motion is no slower than the samples.
    """
    left, rate = np.zeros((2, trace.times.size))
    nothing = left, rate
    values = trace.values.get(name)
    if values is None or name in trace.fast:
        return nothing
    rows = np.flatnonzero(np.isfinite(values))
    if rows.size < LEAST:
        return nothing
    times, series = trace.times[rows], values[rows]
    apart = np.stack([times[k : times.size - 4 + k] - times[2:-2] for k in (0, 1, 3, 4)])
    around = np.stack([series[k : series.size - 4 + k] for k in (0, 1, 3, 4)])
    # Lagrange's weights of the cubic through the neighbours, at the sample itself.
    own = np.eye(4, dtype=bool)[:, :, None]
    weights = np.prod(np.where(own, 1.0, apart[:, None] / (apart[:, None] - apart + own)), axis=0)
    spread = np.sqrt(1.0 + np.sum(weights**2, axis=0))
    deviation = (series[2:-2] - np.sum(weights * around, axis=0)) / spread
    even = np.ptp(apart, axis=0) < 6.0 * np.median(np.diff(times))
    deviation = np.where(even, deviation, 0.0)
    noise = float(np.sqrt(np.mean(deviation**2)))
    if noise == 0.0:
        return nothing
    follow = float(np.sum(deviation[1:] * deviation[:-1]) / np.sum(deviation**2))
    if follow > 0.5 * CORRELATED[1]:
        return nothing
    smooth = np.convolve(np.gradient(series, times), np.hanning(9)[1:-1] / 4.0, mode="same")
    left[rows[2:-2]] = deviation / noise
    rate[rows[2:-2]] = np.where(even, smooth[2:-2], 0.0) / noise
    return left, rate
