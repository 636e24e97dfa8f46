r"""Angles that wrap: a compass that goes from 359 to 0 degrees has not turned back.

A heading is known up to full turns, and a log usually holds it within one of them,

.. math:: \psi_m = \psi - 2\pi\,k, \qquad k \in \mathbb{Z},

so that the logged series jumps by one period where the vehicle passes the cut. Differential
equations need the continuous angle: of all series that agree with the log up to full turns, the
one that never moves by more than half a turn between two samples. In a gap it may: there it is
the one that comes nearest to the rate on both sides, :math:`\Delta\psi \approx
\tfrac12(\dot\psi_- + \dot\psi_+)\Delta t`, if these agree well enough to tell.
"""

from __future__ import annotations

import numpy as np

TURN = 2.0 * np.pi
# The period of a jump: 2 pi, or 360 where degrees passed as radians.
PERIODS = (TURN, 360.0)
# A wrapped signal stays within one turn, up to its noise and filtering.
RANGE_MARGIN = 0.04
# A jump is a clear wrap if what remains of it after adding the turn is this share of a turn.
CLEAR = 0.08
# ... and is not faster than this multiple of what the signal does around it.
FASTER = 8.0
# A gap is so many usual steps long; the rate beside it is from so many samples, at least LEAST.
GAP, BESIDE, LEAST = 4.0, 12, 5
# A signal that moves by more than this share of a turn between samples is too sparse to tell.
SPARSE = 0.08


def on_circle(difference: np.ndarray) -> np.ndarray:
    r"""Differences of angles on the circle, :math:`[-\pi, \pi)`; NaN stays.

    Parameters
    ----------
    difference : numpy.ndarray
        rad.

    Examples
    --------
    >>> print(np.degrees(on_circle(np.radians([358.0, -190.0, 30.0]))).round(6))
    [ -2. 170.  30.]
    """
    with np.errstate(invalid="ignore"):
        return np.remainder(difference + 0.5 * TURN, TURN) - 0.5 * TURN


def unwrapped(
    values: np.ndarray, period: float = TURN, times: np.ndarray | None = None
) -> np.ndarray:
    """Continuous series of an angle; missing samples stay missing.

    Parameters
    ----------
    values : numpy.ndarray
        Shape ``(n_samples,)``, NaN where not sampled.
    period : float
        One turn, in the unit of the values.
    times : numpy.ndarray, optional
        Shape ``(n_samples,)``, s. With them full turns within gaps are counted by the rates on
        both sides.

    Examples
    --------
    >>> print(np.degrees(unwrapped(np.radians([358.0, np.nan, 2.0, 6.0]))).round(6))
    [358.  nan 362. 366.]
    """
    result = np.array(values, dtype=float)
    present = np.isfinite(result)
    series = np.unwrap(result[present], period=period)
    if times is not None:
        series = _with_turns_in_gaps(np.asarray(times, dtype=float)[present], series, period)
    result[present] = series
    return result


def _with_turns_in_gaps(times: np.ndarray, series: np.ndarray, period: float) -> np.ndarray:
    """Add the full turns that a steady motion makes while nothing is logged."""
    steps = np.diff(times)
    if steps.size < 2 * LEAST:
        return series
    gaps = np.flatnonzero(steps > GAP * np.median(steps))
    edges = [0, *(gaps + 1), times.size]
    result = series.copy()
    for number, last in enumerate(gaps):
        rates = []
        for piece in (
            slice(max(edges[number], last + 1 - BESIDE), last + 1),
            slice(last + 1, min(edges[number + 2], last + 1 + BESIDE)),
        ):
            if piece.stop - piece.start >= LEAST:
                rates.append(float(np.polyfit(times[piece], series[piece], 1)[0]))
        if len(rates) < 2:
            continue
        duration = float(steps[last])
        expected = 0.5 * sum(rates) * duration
        if abs(rates[1] - rates[0]) * duration > 0.5 * period:
            continue  # which of two turns it was, nobody knows
        turns = round((expected - (series[last + 1] - series[last])) / period)
        result[last + 1 :] += turns * period
    return result


def clear_wraps(values: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Find jumps by a full turn that nothing but a wrapped angle explains.

    A jump counts only if the signal stays within one turn, if the jump is a turn up to 8 % of it,
    and if the motion that remains is no faster than the signal is around it. A heading that is
    sampled so sparsely that half a turn may lie between two samples shows no clear jump.

    Parameters
    ----------
    values : numpy.ndarray
        Shape ``(n_samples,)``, NaN where not sampled.

    Returns
    -------
    tuple of float and numpy.ndarray, or None
        The period (2 pi or 360) and the index of the sample after each jump; None without jumps.

    Examples
    --------
    >>> period, after = clear_wraps(np.radians([350.0, 354.0, 358.0, 2.0, 6.0]))
    >>> round(np.degrees(period)), after
    (360, array([3]))
    >>> clear_wraps(np.radians([10.0, 350.0, 20.0, 340.0])) is None
    True
    """
    present = np.flatnonzero(np.isfinite(values))
    series = values[present]
    if series.size < 4:
        return None
    reach = float(series.max() - series.min())
    steps = np.diff(series)
    for period in PERIODS:
        if not period * (1.0 - 2.0 * CLEAR) < reach < period * (1.0 + RANGE_MARGIN):
            continue
        jumps = np.flatnonzero(np.abs(np.abs(steps) - period) < CLEAR * period)
        if not jumps.size:
            continue
        rest = np.abs(steps - period * np.round(steps / period))
        usual = np.delete(rest, jumps)
        pace = float(np.quantile(usual, 0.9)) if usual.size else np.inf
        if pace > SPARSE * period or rest[jumps].max() > FASTER * max(pace, 0.002 * period):
            continue
        return period, present[jumps + 1]
    return None
