r"""Measured signals of one record, with their noise and with what cannot be used left out.

The noise of a signal is read from its fourth differences, in which every motion that is slow
against the sampling disappears,

.. math:: \hat\sigma = \operatorname{median} |\Delta^4 y| \,/\, (0.6745 \sqrt{70}),

where 70 is the sum of the squared binomial coefficients and 0.6745 the quartile of a normal
variable.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from oed_sysid.data.record import GAP, Record
from oed_sysid.evidence.relations import STANDARD_UNITS
from oed_sysid.likelihood.noise_levels import fast_level
from oed_sysid.runtime.constants import IMMATERIAL

# Fewer samples have no usual behaviour to differ from.
LEAST = 20
# How many samples after a step of an input the answer may peak.
ANSWERED = 3


@dataclass(frozen=True)
class Trace:
    """Signals of one record.

    Parameters
    ----------
    name : str
        Of the record.
    times : numpy.ndarray
        Shape ``(n_times,)``, s.
    values : mapping
        Signal to series ``(n_times,)``; NaN where there is no usable sample.
    units : mapping
        Signal to SI unit.
    noise : mapping
        Signal to the standard deviation of its fast noise.
    step : float
        Median time step, s; found from the times if not given.
    inputs : numpy.ndarray
        Shape ``(n_times, n_inputs)``: commands, as logged; none if not given.
    fast : frozenset of str
        Signals that answer a step of an input faster than they are sampled.
    """

    name: str
    times: np.ndarray
    values: dict[str, np.ndarray]
    units: dict[str, str]
    noise: dict[str, float] = field(default_factory=dict)
    step: float = 0.0
    inputs: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    fast: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if not self.step:
            object.__setattr__(self, "step", float(np.median(np.diff(self.times))))
        if not self.inputs.size:
            object.__setattr__(self, "inputs", np.zeros((self.times.size, 0)))

    @classmethod
    def of(cls, record: Record, spare: Mapping[str, np.ndarray]) -> Trace:
        """Outputs of a record, and spare signals of its file."""
        outputs = [o for o in record.channels.outputs if o.name not in record.missing_outputs]
        values = {o.name: np.array(record.output(o.name)) for o in outputs}
        units = {o.name: o.unit for o in outputs}
        values |= {name: np.array(series) for name, series in spare.items()}
        units |= {name: STANDARD_UNITS[name] for name in spare}
        noise = {name: fast_noise(series) for name, series in values.items()}
        return cls(record.name, record.times, values, units, noise, inputs=record.inputs)

    @cached_property
    def pushed(self) -> np.ndarray:
        """Samples right after a step of an input, ``(n_times,)`` of bool."""
        pushed = np.zeros(self.times.size, dtype=bool)
        for column in self.inputs.T:
            pushed |= after_steps(column)
        return pushed

    @property
    def ends(self) -> tuple[float, float]:
        """First and last time, s."""
        return float(self.times[0]), float(self.times[-1])

    def answers(self, name: str) -> np.ndarray:
        """Where a signal may answer steps of inputs, ``(n_times,)`` of bool: its next samples."""
        answers, present = self.pushed.copy(), np.flatnonzero(np.isfinite(self.values[name]))
        for begin in np.flatnonzero(self.pushed & np.diff(self.pushed, prepend=False)):
            after = present[np.searchsorted(present, begin) :][:ANSWERED]
            answers[begin : after.max(initial=begin) + 1] = True
        return answers

    def blank(self, rows: Mapping[str, np.ndarray]) -> Trace:
        """Return the trace and its noise without some samples; ``rows`` by signal.

        What has no noise, as inputs of a model, has none then; rows may be beyond the end.
        """
        values, noise = dict(self.values), dict(self.noise)
        for name, chosen in rows.items():
            if len(chosen):
                values[name] = values[name].copy()
                values[name][chosen[chosen < self.times.size]] = np.nan
                noise[name] = noise[name] and fast_noise(values[name])
        return replace(self, values=values, noise=noise)

    def during(self, rows: slice) -> Trace:
        """Return some consecutive samples of the trace."""
        values = {name: series[rows] for name, series in self.values.items()}
        return replace(self, times=self.times[rows], values=values, inputs=self.inputs[rows])

    def thinned(self, most: int) -> Trace:
        """Return means over groups of samples so that at most ``most`` are left."""
        group = -(-self.times.size // most)
        if group < 2:
            return self
        n = self.times.size // group * group
        present = {name: np.ma.masked_invalid(series) for name, series in self.values.items()}
        values = {
            name: series[:n].reshape(-1, group).mean(axis=1).filled(np.nan)
            for name, series in present.items()
        }
        times = self.times[:n].reshape(-1, group).mean(axis=1)
        noise = {name: std / np.sqrt(group) for name, std in self.noise.items()}
        inputs = self.inputs[group - 1 : n : group]
        return replace(self, times=times, values=values, noise=noise, step=0.0, inputs=inputs)

    def filled(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Series joined by cubic splines, ``(n_times,)``; those with two samples or more."""
        series: dict[str, np.ndarray] = {}
        for name in names:
            values = self.values[name]
            present = np.flatnonzero(np.isfinite(values))
            if present.size == self.times.size:
                series[name] = values
            elif present.size > 1:
                series[name] = np.interp(self.times, self.times[present], values[present])
            if 3 < present.size < self.times.size:  # a curve between samples, straight on outside
                inside = slice(present[0], present[-1] + 1)
                from scipy.interpolate import CubicSpline  # takes a third of a second

                curve = CubicSpline(self.times[present], values[present])
                series[name][inside] = curve(self.times[inside])
        return series

    def usable(self, names: Iterable[str]) -> np.ndarray:
        """Where signals can be relied on, ``(n_times,)`` of bool.

        Not inside long gaps, before the first or after the last sample, nor where a signal is
        faster than its samples.
        """
        usable = np.ones(self.times.size, dtype=bool)
        for name in names:
            present = np.flatnonzero(np.isfinite(self.values[name]))
            if name in self.fast:
                usable[self.answers(name)] = False
            if present.size < 2:
                return np.zeros_like(usable)
            steps = np.diff(self.times[present])
            limit = GAP * max(float(np.median(steps)), self.step)
            usable[: present[0]] = usable[present[-1] + 1 :] = False
            for k in np.flatnonzero(steps > limit):
                usable[present[k] + 1 : present[k + 1]] = False
        return usable

    def pieces(self, usable: np.ndarray, least: int) -> list[slice]:
        """Stretches of usable samples between gaps in time, of at least ``least`` samples."""
        apart = np.diff(self.times) > GAP * self.step
        broken = np.flatnonzero(apart | ~usable[1:] | ~usable[:-1]) + 1
        edges = [0, *broken.tolist(), self.times.size]
        whole = (slice(a, b) for a, b in pairwise(edges) if b - a >= least)
        return [piece for piece in whole if usable[piece].all()]


def units_of(traces: Iterable[Trace]) -> dict[str, str]:
    """Units of the signals of some records."""
    return {name: unit for trace in traces for name, unit in trace.units.items()}


def after_steps(series: np.ndarray) -> np.ndarray:
    """Samples right after the steps of an input that is mostly held, ``(n_times,)``.

    Examples
    --------
    >>> print(after_steps(np.repeat([0.0, 1.0, 1.0, 1.0], 6)).nonzero()[0])
    [6 7 8]
    """
    pushed = np.zeros(series.size, dtype=bool)
    whole = np.nan_to_num(series)
    change = np.abs(np.diff(whole))
    # Every change of a command that is held; of one with noise the large ones.
    for least in (0.0, IMMATERIAL * np.ptp(whole)):
        steps = np.flatnonzero(change > least)
        if 0 < steps.size < IMMATERIAL * series.size:
            for after in range(1, ANSWERED + 1):
                pushed[np.minimum(steps + after, series.size - 1)] = True
            break
    return pushed


def fast_noise(values: np.ndarray) -> float:
    """Standard deviation of the noise that changes from sample to sample.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> t = np.arange(2000) * 0.1
    >>> print(round(fast_noise(np.sin(t) + 0.02 * rng.standard_normal(2000)), 3))
    0.02
    """
    series = values[np.isfinite(values)]
    if series.size < LEAST:
        return 0.0
    return fast_level([series], order=4)
