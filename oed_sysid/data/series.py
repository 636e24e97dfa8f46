"""One field of a log, with times of its own."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True, eq=False)
class Series:
    """One field of one topic.

    Parameters
    ----------
    name : str
        ``topic.field``, as mapping files name it.
    times : numpy.ndarray
        Shape ``(n_samples,)``, in s since the log's origin, in the order of the log.
    values : numpy.ndarray
        Shape ``(n_samples,)``, in ``unit``.
    unit : str or None
        Unit, where the log or its format says so; else None.
    derived : str
        What it was calculated from, empty where it stands in the log.

    Examples
    --------
    >>> series = Series("gyro.z", np.arange(11) * 0.1, np.zeros(11), "rad/s")
    >>> print(round(series.rate, 6), series.span)
    10.0 (0.0, 1.0)
    """

    name: str
    times: np.ndarray = field(repr=False)
    values: np.ndarray = field(repr=False)
    unit: str | None = None
    derived: str = ""

    @property
    def rate(self) -> float:
        """Samples per second: the inverse of the median step; NaN with a single sample."""
        steps = np.diff(self.times)
        steps = steps[steps > 0.0]
        return float(1.0 / np.median(steps)) if steps.size else np.nan

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, in s."""
        return float(np.min(self.times)), float(np.max(self.times))
