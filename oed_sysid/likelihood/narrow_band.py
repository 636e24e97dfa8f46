r"""Innovations that swing with a period of their own, as waves and swell leave them.

A filter takes random forces for first-order Gauss-Markov processes. Those of a sea with a narrow
spectrum leave innovations that are nearly white from sample to sample, and yet power about one
frequency, where a vehicle that is moved there tells most of its parameters. Over ``R`` blocks of
``n`` innovations ``e`` in units of their standard deviation, and ``2 w + 1`` neighbouring
frequencies, white ones have

.. math::
    \hat S(f_i) = \frac{1}{R\,(2 w + 1)} \sum_{r, |j| \le w}
    \frac1n \Big| \sum_k e^r_k\, e^{-2 \pi \mathrm{i}\, (i + j) k / n} \Big|^2, \qquad
    2 R\,(2 w + 1)\, \hat S \sim \chi^2_{2 R (2 w + 1)}.

Where a peak is clear, errors are those of the sandwich :math:`H^{-1} B H^{-1}`, with ``B`` from
the autocovariances of the innovations over several periods
(:func:`~oed_sysid.likelihood.information.coloured_score_covariance`), and never below
:math:`H^{-1}`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from oed_sysid.data.dataset import Record
from oed_sysid.data.record import sampled_alike
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.information import coloured_score_covariance

# Chance in white innovations, all frequencies and outputs together, below which a peak is one.
PEAK_CHANCE = 1e-2
# Periods that are searched: at least so many samples, and so many of them in a block.
FEWEST_SAMPLES, FEWEST_PERIODS = 4, 4
# Longest block, in samples, and neighbouring frequencies that are taken together on either side.
BLOCK, NEIGHBOURS = 4096, (1, 3, 9)
# Shares of a record that must be measured, and by which intervals may differ.
PRESENT, REGULAR = 0.5, 0.1
# Periods over which the autocovariance is kept.
MEMORY = 25.0


@dataclass(frozen=True)
class Peak:
    """Power of innovations about one frequency.

    Attributes
    ----------
    output : str
    period : float
        At the centre of the power beyond that of white innovations, s.
    ratio : float
        Power there over that of white innovations.
    chance : float
        Of such a peak in white innovations, at any frequency.
    """

    output: str
    period: float
    ratio: float
    chance: float


def spectral_peak(series: Sequence[np.ndarray], sample_time: float, output: str = "") -> Peak:
    """Clearest peak in the spectrum of one output.

    Parameters
    ----------
    series : sequence of ndarray (n_times,)
        Innovations over their standard deviations, a series a record, NaN where nothing was
        measured.
    sample_time : float
        Time between samples, s.
    output : str

    Returns
    -------
    Peak
        With chance one where there is nothing to search.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> swell = np.cos(2 * np.pi * np.arange(600) / 50)
    >>> found = spectral_peak([rng.standard_normal(600) + 0.4 * swell], 0.1)
    >>> round(found.period), found.chance < 1e-3
    (5, True)
    >>> spectral_peak([rng.standard_normal(600)], 0.1).chance < 0.05
    False
    """
    best = Peak(output, np.inf, 1.0, 1.0)
    usable = [one for one in series if np.mean(np.isfinite(one)) > PRESENT]
    length = min([BLOCK, *(len(one) for one in usable)])
    if not usable or length < 2 * FEWEST_SAMPLES * FEWEST_PERIODS:
        return best
    power, count = np.zeros(length // 2 + 1), 0
    for one in usable:
        for begin in range(0, len(one) - length + 1, length):
            block = np.nan_to_num(one[begin : begin + length])
            size = float(block @ block)
            if size > 0.0:
                power += np.abs(np.fft.rfft(block)) ** 2 / size
                count += 1
    first, last = FEWEST_PERIODS, length // FEWEST_SAMPLES
    widths = [width for width in NEIGHBOURS if 2 * width + 1 <= (last - first) // 2]
    tries = max((last - first) * len(widths), 1)
    for width in widths:
        sums = np.convolve(power[first : last + 1], np.ones(2 * width + 1), "valid")
        freedom = count * (2 * width + 1)
        chances = chi2.sf(2.0 * sums, 2 * freedom)
        at = int(np.argmin(chances))
        chance = min(1.0, float(chances[at]) * tries)
        if chance < best.chance:
            bins = np.arange(first + at, first + at + 2 * width + 1)
            centre = np.average(bins, weights=np.maximum(power[bins] - count, 1e-9))
            period = float(length * sample_time / centre)
            best = Peak(output, period, float(sums[at] / freedom), chance)
    return best


def clear_peaks(
    whitened: Sequence[np.ndarray], records: Sequence[Record], outputs: Sequence[str]
) -> list[Peak]:
    """Outputs whose innovations have a clear peak, the clearest first.

    Parameters
    ----------
    whitened : sequence of ndarray (n_times, n_outputs)
        Innovations over their standard deviations, a part a record.
    records : sequence of Record
    outputs : sequence of str
        Their names.
    """
    found: dict[str, Peak] = {}
    for group in sampled_alike(records):
        regular = [i for i in group if _is_regular(records[i])]
        for column, name in enumerate(outputs):
            series, time = _own_samples([whitened[i][:, column] for i in regular])
            if not series:
                continue
            peak = spectral_peak(series, time * records[regular[0]].sample_time, name)
            if peak.chance * len(outputs) < PEAK_CHANCE and (
                name not in found or peak.chance < found[name].chance
            ):
                found[name] = peak
    return sorted(found.values(), key=lambda peak: peak.chance)


def _is_regular(record: Record) -> bool:
    steps = np.diff(record.times)
    return len(steps) > 1 and float(np.ptp(steps)) < REGULAR * float(np.median(steps))


def _own_samples(series: Sequence[np.ndarray]) -> tuple[list[np.ndarray], int]:
    """Rows at which a sensor slower than the records can have sampled, and their stride."""
    rows = [np.flatnonzero(np.isfinite(one)) for one in series]
    steps = [np.diff(one) for one in rows if len(one) > 1]
    if not steps:
        return [], 1
    stride = int(np.gcd.reduce(np.concatenate(steps)))
    parts = [one[own[0] :: stride] for one, own in zip(series, rows, strict=True) if len(own) > 1]
    return parts, stride


def widened(
    problem: Filtered,
    unknowns: np.ndarray,
    matrix: np.ndarray,
    covariance: np.ndarray,
    period: float,
) -> np.ndarray:
    """Covariance of the shared parameters where innovations swing with a period.

    Parameters
    ----------
    problem : Filtered
    unknowns : ndarray (n_unknowns,)
    matrix : ndarray (n_unknowns, n_unknowns)
        Information of all unknowns, priors included.
    covariance : ndarray (n_shared, n_shared)
        That of white innovations, infinite where nothing is seen.
    period : float
        Longest clear period, s.
    """
    layout, limits = problem.layout, problem.limits
    n_shared = len(layout.shared)
    finite = np.flatnonzero(np.isfinite(np.diag(covariance)))
    if not len(finite):
        return covariance
    share = _shares(matrix, n_shared, _others(problem))
    slopes = layout.shared_values(unknowns)[1]
    jacobians, scores = shared_rows(problem, unknowns, matrix)
    weight = limits.prior_weight
    middle = np.diag(weight[:n_shared]) + (share * weight) @ share.T
    if problem.knowledge is not None:
        middle = middle + problem.knowledge.information
    middle = middle / slopes[:, None] / slopes
    series = [i for i, record in enumerate(problem.records) if not record.independent]
    for group in sampled_alike([problem.records[i] for i in series]):
        own = [series[i] for i in group]
        lags = int(np.ceil(MEMORY * period / problem.records[own[0]].sample_time))
        middle = middle + coloured_score_covariance(
            [jacobians[i] for i in own], [scores[i] for i in own], lags=lags
        )
    for index in set(range(len(problem.records))) - set(series):
        flat = jacobians[index].reshape(-1, n_shared)
        middle = middle + flat.T @ flat
    block = np.ix_(finite, finite)
    robust = covariance[block] @ middle[block] @ covariance[block]
    white, found = np.diag(covariance[block]), np.diag(robust)
    grow = np.sqrt(np.maximum(1.0, white / np.where(found > 0, found, np.inf)))
    result = covariance.copy()
    result[block] = robust * grow[:, None] * grow
    return result


def shared_rows(
    problem: Filtered, unknowns: np.ndarray, matrix: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Derivatives of innovations by the shared parameters, all else estimated along.

    Parameters
    ----------
    problem : Filtered
    unknowns : ndarray (n_unknowns,)
    matrix : ndarray (n_unknowns, n_unknowns)
        Information of all unknowns, priors included.

    Returns
    -------
    jacobians : list of ndarray (n_times, n_outputs, n_shared)
        In units of the innovations' standard deviation, zero where nothing was measured.
    scores : list of ndarray (n_times, n_outputs)
        Innovations in that unit, NaN where nothing was measured.
    """
    layout = problem.layout
    n_shared = len(layout.shared)
    share = _shares(matrix, n_shared, _others(problem))
    slopes = layout.shared_values(unknowns)[1]
    jacobians, scores = [], []
    for index, part in enumerate(problem.passes(unknowns, rows=True)):
        columns = layout.record_columns(index)
        size = np.concatenate(
            [np.ones(layout.n_own), layout.slopes(unknowns[columns[layout.n_own :]])]
        )
        assert part.rows is not None
        onto = (np.eye(n_shared, len(share.T)) - share)[:, columns].T
        jacobian = part.rows[..., : len(columns)] @ (size[:, None] * onto / slopes)
        jacobian[~np.isfinite(part.innovations)] = 0.0
        jacobians.append(jacobian)
        scores.append(part.innovations / np.sqrt(part.variances))
    return jacobians, scores


def _others(problem: Filtered) -> np.ndarray:
    """Unknowns that are estimated beside the shared parameters, levels among them."""
    n_shared = len(problem.layout.shared)
    held = problem.limits.held.copy()
    held[problem.layout.levels] = False
    return n_shared + np.flatnonzero(~held[n_shared:])


def _shares(matrix: np.ndarray, n_shared: int, others: np.ndarray) -> np.ndarray:
    """``H_po H_oo^-1`` in the columns of all unknowns, zero where one is not estimated."""
    share = np.zeros((n_shared, len(matrix)))
    size = np.sqrt(np.maximum(np.diag(matrix)[others], 0.0))
    seen, size = others[size > 0], size[size > 0]
    if len(seen):
        inner = matrix[np.ix_(seen, seen)] / size[:, None] / size
        cross = matrix[:n_shared, seen] / size
        share[:, seen] = cross @ np.linalg.pinv(inner, rcond=1e-12, hermitian=True) / size
    return share
