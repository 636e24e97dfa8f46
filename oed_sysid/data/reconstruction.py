r"""Filling in sparse measurements: Archimedes spiral, cubic spline, monotone cubic, lines.

Reconstructed samples are no measurements: they carry no information that the
sparse ones lack, and noise statistics of a fit to them mean nothing. Estimators
that simulate, such as multiple shooting, need no dense samples at all.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError

CURVES = {
    "cubic": lambda times, values, grid: CubicSpline(times, values)(grid),
    "pchip": lambda times, values, grid: PchipInterpolator(times, values)(grid),
    "linear": lambda times, values, grid: np.interp(grid, times, values),
}
METHODS = ("spiral", *CURVES)
TANGENTS = ("chord", "exact")
# Turns of the direction below this are straight lines.
STRAIGHT = 1e-9


def densify(times: np.ndarray, values: np.ndarray, factor: int, *, method: str) -> np.ndarray:
    """Values at ``factor`` equal steps within each interval of the samples.

    Parameters
    ----------
    times : ndarray (n,)
        Increasing times, s.
    values : ndarray (n,)
        Samples.
    factor : int
        Steps per interval.
    method : str
        One of :data:`METHODS`; the spiral with its published settings.

    Returns
    -------
    ndarray ((n - 1) * factor + 1,)

    Examples
    --------
    >>> times = np.array([0.0, 0.5, 1.0, 1.5])
    >>> dense = densify(times, np.sin(times), 5, method="cubic")
    >>> print(dense[:3].round(3))
    [0.    0.101 0.2  ]
    """
    times, values = _checked(times, values, factor)
    if method not in METHODS:
        raise DataError(f"method is {method!r}. Choose one of {', '.join(METHODS)}.")
    if method == "spiral":
        return archimedes_spiral(times, values, factor)
    return np.asarray(CURVES[method](times, values, dense_times(times, factor)))


def dense_times(times: np.ndarray, factor: int) -> np.ndarray:
    """Times of :func:`densify`, shape ``((n - 1) * factor + 1,)``."""
    index = np.arange((len(times) - 1) * factor + 1) / factor
    return np.interp(index, np.arange(len(times)), times)


def archimedes_spiral(
    times: np.ndarray,
    values: np.ndarray,
    factor: int,
    *,
    tangent: str = "chord",
    scale: float = 1.0,
) -> np.ndarray:
    r"""Join samples by pieces of Archimedes spirals in the plane of time and value.

    From the point :math:`A_i` a spiral
    :math:`A_i + k\vartheta\,(\cos(\rho\vartheta + \sigma), \sin(\rho\vartheta + \sigma))`
    leaves in the direction :math:`\sigma` of the curve before and turns until it
    meets :math:`A_{i+1}`: with :math:`\beta` the direction of the chord,
    :math:`\rho = \mathrm{sign}(\beta - \sigma)`, it ends at
    :math:`\vartheta^* = |\beta - \sigma|` and :math:`k = |A_{i+1} - A_i|/\vartheta^*`
    is the only scale that meets the point. The result depends on the units of
    time and value, as angles in a plane of unlike quantities do.

    Parameters
    ----------
    times, values : ndarray (n,)
        Samples; published in s and rad.
    factor : int
        Steps per interval.
    tangent : str
        Direction at which the next spiral leaves: ``"chord"``, from the last
        inserted point to the sample, as published (a disturbance of the
        direction decays by ``(factor - 1)/factor`` per interval), or
        ``"exact"``, that of the curve's end (it does not decay at all).
    scale : float
        Multiplies the values while curves are drawn.

    Returns
    -------
    ndarray ((n - 1) * factor + 1,)

    References
    ----------
    Han, Bai, Yu & Lian (2023), Ship Science and Technology 45(7), eq. 17-23; the
    scale ``k`` and the local sense of turning are completed here (README of the
    problem ``nomoto_sparse_heading``).

    Examples
    --------
    >>> corner = archimedes_spiral(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 1.0]), 2)
    >>> print(corner.round(3))
    [0.    0.    0.    0.149 1.   ]
    """
    times, values = _checked(times, values, factor)
    if tangent not in TANGENTS:
        raise DataError(f"tangent is {tangent!r}. Choose one of {', '.join(TANGENTS)}.")
    heights = values * scale
    grid = dense_times(times, factor)
    dense = np.empty(len(grid))
    dense[0] = heights[0]
    # The first piece is the chord itself (eq. 21).
    direction = np.arctan2(heights[1] - heights[0], times[1] - times[0])
    for i in range(len(times) - 1):
        inner = slice(i * factor + 1, (i + 1) * factor + 1)
        start = np.array([times[i], heights[i]])
        end = np.array([times[i + 1], heights[i + 1]])
        dense[inner], final = _piece(start, end, direction, grid[inner])
        if tangent == "exact":
            direction = final
        else:
            last = (i + 1) * factor
            direction = np.arctan2(dense[last] - dense[last - 1], grid[last] - grid[last - 1])
    return dense / scale


def _piece(
    start: np.ndarray, end: np.ndarray, direction: float, wanted: np.ndarray
) -> tuple[np.ndarray, float]:
    """One spiral at the wanted times, and the direction at its end."""
    chord = end - start
    beta = float(np.arctan2(chord[1], chord[0]))
    turn = float((beta - direction + np.pi) % (2 * np.pi) - np.pi)
    if abs(turn) < STRAIGHT:
        heights = start[1] + (wanted - start[0]) * chord[1] / chord[0]
        return heights, beta
    sense, last = np.sign(turn), abs(turn)
    k = float(np.hypot(*chord)) / last
    angle = last * (wanted - start[0]) / chord[0]
    low, high = np.zeros_like(angle), np.full_like(angle, last)
    for _ in range(60):
        phase = sense * angle + direction
        error = start[0] + k * angle * np.cos(phase) - wanted
        slope = k * (np.cos(phase) - sense * angle * np.sin(phase))
        low, high = np.where(error <= 0, angle, low), np.where(error > 0, angle, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = angle - error / slope
        inside = np.isfinite(step) & (step >= low) & (step <= high)
        new = np.where(inside, step, 0.5 * (low + high))
        if np.max(np.abs(new - angle)) < 1e-14:
            break
        angle = new
    heights = start[1] + k * angle * np.sin(sense * angle + direction)
    heights[-1] = end[1]
    return heights, beta + float(sense * np.arctan(last))


def reconstruct(record: Record, factor: int, *, method: str) -> Record:
    """Record with ``factor`` times as many samples, all outputs filled in.

    Inputs are connected by straight lines; outputs must not have gaps.

    Raises
    ------
    DataError
        If an output has missing samples.
    """
    if not np.isfinite(record.outputs).all():
        raise DataError(
            f"Record {record.name!r} has missing samples, which cannot be joined by a curve. Leave "
            "them out first."
        )
    grid = dense_times(record.times, factor)
    columns = [densify(record.times, column, factor, method=method) for column in record.outputs.T]
    inputs = [np.interp(grid, record.times, column) for column in record.inputs.T]
    return Record(
        f"{record.name}_{method}",
        grid,
        np.column_stack(inputs) if inputs else np.empty((len(grid), 0)),
        np.column_stack(columns),
        record.channels,
        source=f"{record.source}; {factor - 1} of {factor} samples reconstructed ({method})",
    )


def _checked(times: np.ndarray, values: np.ndarray, factor: int) -> tuple[np.ndarray, np.ndarray]:
    times, values = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    if times.ndim != 1 or times.shape != values.shape or len(times) < 3:
        raise DataError(
            f"Got times of shape {times.shape} and values of shape {values.shape}; expected the "
            "same, (n,), with three samples or more."
        )
    if not np.all(np.diff(times) > 0):
        raise DataError("Times have to increase strictly. Sort the samples.")
    if factor < 1:
        raise DataError(f"factor is {factor}. Give the number of steps per interval, 1 or more.")
    return times, values
