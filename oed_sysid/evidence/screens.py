r"""Screens of single signals: what a log shows without any equation.

Spikes are looked for in what a cubic through four neighbours does not explain,

.. math:: d_i = y_i - (-y_{i-2} + 4 y_{i-1} + 4 y_{i+1} - y_{i+2})/6,

at 8.5 times the robust deviation of :math:`d`, globally and nearby: with normal noise one in
:math:`10^{16}` samples. A kink, where a rudder starts to move say, changes the slope and is left
alone: the deviation from both neighbours has to exceed 1.5 times the change of slope around it.
Groups of bad samples are found by :mod:`~oed_sysid.evidence.bursts`, lasting jumps by
:mod:`~oed_sysid.evidence.steps`. Where chance would hardly put so many of them right after
steps of the inputs, those there are no faults but answers that are faster than the sampling.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import bdtrc

from oed_sysid.evidence.bursts import bursts
from oed_sysid.evidence.steps import SMALL as SMALL_STEP
from oed_sysid.evidence.steps import steps
from oed_sysid.evidence.traces import QUARTILE, Trace

SPIKE = 8.5
# Faults below this share of a signal's range are immaterial.
SMALL = 0.01
LEAST_RUNS = 4
FROZEN = 8
# Shortest run of one value that may be a drop-out of its own, and the steps into it and out of it
# in usual ones.
LEAST_LOST, SUDDEN = 3, 3.0
LEAST_SAMPLES = 20
UNIQUE = 0.6
# Probability below which spikes after steps of the inputs are none.
CHANCE = 0.05
# Faults that may be answers to the inputs.
ANSWERS = ("spikes", "step")


@dataclass(frozen=True)
class Fault:
    """Samples of one signal in one record that a screen stopped; for steps, the size of each."""

    kind: str
    signal: str
    record: str
    rows: np.ndarray
    amount: float = 0.0
    sizes: tuple[float, ...] = ()

    def groups(self) -> list[np.ndarray]:
        """Positions in ``rows`` of what happened at once."""
        together = self.kind == "spikes"
        apart = np.diff(self.rows) > 1 if together else np.ones(self.rows.size - 1, dtype=bool)
        return np.split(np.arange(self.rows.size), np.flatnonzero(apart) + 1)

    def only(self, chosen: np.ndarray) -> Fault:
        """Return the fault with some of its rows only."""
        sizes = tuple(self.sizes[k] for k in chosen) if self.sizes else ()
        amount = max(sizes, key=abs, default=0.0) if self.sizes else float(chosen.size)
        return replace(self, rows=self.rows[chosen], amount=amount, sizes=sizes)


@dataclass(frozen=True)
class Runs:
    """Stretches of equal consecutive samples: first index, length and value of each."""

    first: np.ndarray
    length: np.ndarray
    value: np.ndarray

    @classmethod
    def of(cls, series: np.ndarray) -> Runs:
        """Find the runs of a series without gaps."""
        first = np.concatenate([[0], np.flatnonzero(np.diff(series) != 0.0) + 1])
        length = np.diff(np.concatenate([first, [series.size]]))
        return cls(first, length, series[first])

    def rows(self, chosen: np.ndarray, *, after: int = 0) -> np.ndarray:
        """Indices of all samples of the chosen runs, without the first ``after`` of each."""
        parts = [np.arange(self.first[k] + after, self.first[k] + self.length[k]) for k in chosen]
        return np.concatenate(parts) if parts else np.empty(0, dtype=int)


def screen(trace: Trace) -> list[Fault]:
    """All faults of the single signals of one record.

    A signal without any noise (a simulation, a hand-made file) is not judged as frozen or dead,
    because nothing tells that it should have moved.
    """
    noisy = any(std > 0.0 for std in trace.noise.values())
    return [fault for name in trace.values for fault in _faults(trace, name, noisy)]


def _faults(trace: Trace, name: str, noisy: bool) -> Iterator[Fault]:
    values = trace.values[name]
    present = np.flatnonzero(np.isfinite(values))
    series = values[present]
    if series.size < LEAST_SAMPLES:
        return
    if series.max() == series.min():
        if noisy:
            yield Fault("dead", name, trace.name, present)
        return
    runs = Runs.of(series)
    equal = 1.0 - runs.length.size / series.size
    distinct = np.unique(series).size
    coarse = equal > 0.2 and distinct < UNIQUE * runs.length.size
    held = not coarse and equal >= 0.5 and float(np.quantile(runs.length, 0.25)) >= 2
    taken = np.zeros(series.size, dtype=bool)
    sentinel = _dropouts(series, runs, coarse or held)
    if sentinel.size:
        taken[sentinel] = True
        yield Fault("dropouts", name, trace.name, present[sentinel], float(series[sentinel[0]]))
    if held:
        interval = float(np.median(runs.length)) * trace.step
        later = runs.rows(np.arange(runs.length.size), after=1)
        yield Fault("held", name, trace.name, present[later], interval)
    elif coarse:
        jumps = np.abs(np.diff(np.unique(series)))
        yield Fault("quantised", name, trace.name, np.empty(0, dtype=int), float(np.min(jumps)))
    elif equal < 0.5 and trace.noise[name] > 0.0:
        # A smooth signal that stops dead: runs far longer than its usual ones.
        least = max(FROZEN, 4.0 * float(np.quantile(runs.length, 0.9)))
        long = np.flatnonzero(runs.length >= least)
        at_end = np.isin(runs.value, (series.max(), series.min()))
        flat = np.flatnonzero((runs.length >= 3) & at_end & ~taken[runs.first])
        clipped = flat if _is_clipped(series, runs, flat) else np.empty(0, dtype=int)
        left = [k for k in long if k not in clipped and not taken[runs.first[k]]]
        sudden = [int(k) for k in left if _is_sudden(series, runs, int(k))]
        frozen = np.array(sudden, dtype=int)
        if clipped.size:
            rows = runs.rows(clipped)
            taken[rows] = True
            yield Fault("saturated", name, trace.name, present[rows], float(runs.value[clipped[0]]))
        if frozen.size:
            rows = runs.rows(frozen, after=1)
            taken[rows] = True
            duration = float(runs.length[frozen].sum()) * trace.step
            yield Fault("frozen", name, trace.name, present[rows], duration)
    if not held:
        rows = _spikes(trace.times[present], series, taken, coarse)
        if rows.size:
            taken[rows] = True
            yield Fault("spikes", name, trace.name, present[rows], float(rows.size))
        least = max(SMALL_STEP * _reach(series[~taken]), 4.0 * _quantum(series) * coarse)
        # Beside samples that stand still a jump is the end of that, not a new level.
        stuck = runs.rows(np.flatnonzero((runs.length >= LEAST_LOST) & (not coarse)))
        taken[stuck] = True
        jumped = steps(trace.times[present], series, taken, least)
        if jumped:
            sizes = tuple(one.size for one in jumped)
            rows = present[[one.row for one in jumped]]
            yield Fault("step", name, trace.name, rows, max(sizes, key=abs), sizes)


def _reach(series: np.ndarray) -> float:
    """Range of a signal without its outermost samples."""
    return float(np.subtract(*np.quantile(series, [0.98, 0.02])))


def _quantum(series: np.ndarray) -> float:
    """Smallest difference between two values of a signal."""
    return float(np.min(np.diff(np.unique(series))))


def screened(traces: Sequence[Trace]) -> tuple[list[Fault], list[Trace]]:
    """Faults of all records, and the records with what is faster than its samples marked.

    Samples of one signal that stand out and follow steps of the inputs more often than chance would
    have it are its answers. Smaller steps are answered as fast, only less clearly: all are marked.
    """
    faults = [fault for trace in traces for fault in screen(trace)]
    after = {trace.name: trace.pushed for trace in traces}
    share = float(np.concatenate([trace.pushed for trace in traces]).mean())
    fast = set()
    for name in {fault.signal for fault in faults if fault.kind in ANSWERS}:
        found = [f for f in faults if f.kind in ANSWERS and f.signal == name]
        begins = [bool(after[f.record][f.rows[group[0]]]) for f in found for group in f.groups()]
        if any(begins) and bdtrc(sum(begins) - 1, len(begins), share) < CHANCE:
            fast.add(name)
    kept = []
    for fault in faults:
        if fault.kind in ANSWERS and fault.signal in fast:
            left = [g for g in fault.groups() if not after[fault.record][fault.rows[g[0]]]]
            fault = fault.only(np.concatenate([np.empty(0, dtype=int), *left]))
        if fault.kind not in ANSWERS or fault.rows.size:
            kept.append(fault)
    return kept, [replace(trace, fast=frozenset(fast)) for trace in traces]


def _is_clipped(series: np.ndarray, runs: Runs, flat: np.ndarray) -> bool:
    """Whether flat stretches at the extremes are a limit.

    Two or more have the same value, and the signal comes to it by steps of its usual size: what
    falls there at once was not measured.
    """
    if flat.size < 2:
        return False
    _, counts = np.unique(runs.value[flat], return_counts=True)
    into, out = _edges(runs)
    nearer = np.fmin(into, out)[flat]
    return bool(counts.max() >= 2 and np.nanmedian(nearer) <= SUDDEN * _usual_step(series))


def _edges(runs: Runs) -> tuple[np.ndarray, np.ndarray]:
    """Steps from the run before into each run, and from it to the next one; NaN at the ends."""
    between = np.abs(np.diff(runs.value))
    return np.concatenate([[np.nan], between]), np.concatenate([between, [np.nan]])


def _usual_step(series: np.ndarray) -> float:
    """What 95 in 100 changes from sample to sample stay below, where the signal changes."""
    changes = np.abs(np.diff(series))
    return float(np.quantile(changes[changes > 0.0], 0.95))


def _is_sudden(series: np.ndarray, runs: Runs, k: int) -> bool:
    """Whether a signal stops and starts at once, not by coming to rest at a turning point."""
    usual = float(np.median(np.abs(np.diff(series))))
    first, last = int(runs.first[k]), int(runs.first[k] + runs.length[k])
    entry = abs(series[first] - series[first - 1]) if first else None
    leave = abs(series[last] - series[last - 1]) if last < series.size else None
    edges = [edge for edge in (entry, leave) if edge is not None]
    if len(edges) < 2:
        return bool(edges) and edges[0] > 4.0 * usual
    return min(edges) > 0.02 * usual and max(edges) > 0.3 * usual


def _dropouts(series: np.ndarray, runs: Runs, coarse: bool) -> np.ndarray:
    """Samples that hold a value which stands for "nothing was measured"."""
    low, high = np.quantile(series, [0.02, 0.98])
    reach = float(high - low) or float(series.max() - series.min())
    d = _deviation(series)
    noise = float(np.median(np.abs(d)) / QUARTILE) if d.size else 0.0
    least = max(SPIKE * noise, 0.05 * reach)
    before = np.concatenate([[np.nan], runs.value[:-1]])
    after = np.concatenate([runs.value[1:], [np.nan]])
    with np.errstate(invalid="ignore"):
        jump = np.fmin(np.abs(runs.value - before), np.abs(runs.value - after))
        returns = ~(np.abs(before - after) > 0.5 * jump)
    apart = (jump > least) & returns
    rows = []
    for value in np.unique(runs.value[apart]):
        here = apart & (runs.value == value)
        extreme = abs(value - np.median(series)) > 10.0 * reach
        share = here.sum() / max(int((runs.value == value).sum()), 1)
        if extreme or (here.sum() >= LEAST_RUNS and share > 0.8 and not coarse):
            rows.append(runs.rows(np.flatnonzero(runs.value == value)))
    if not coarse:
        rows.append(_lost(series, runs, least))
    return np.unique(np.concatenate(rows)) if rows else np.empty(0, dtype=int)


def _lost(series: np.ndarray, runs: Runs, least: float) -> np.ndarray:
    """Samples of runs of one value that a signal falls to at once and leaves at once.

    The value is that of two such runs or more, or beyond all others; a single run of an ordinary
    value is a sensor that froze.
    """
    into, out = _edges(runs)
    before = np.concatenate([[np.nan], runs.value[:-1]])
    after = np.concatenate([runs.value[1:], [np.nan]])
    jump = max(least, SUDDEN * _usual_step(series))
    with np.errstate(invalid="ignore"):
        same_side = (runs.value - before) * (runs.value - after) > 0.0
        fallen = (runs.length >= LEAST_LOST) & (np.minimum(into, out) > jump) & same_side
    chosen = [
        k
        for k in np.flatnonzero(fallen)
        if (runs.value[fallen] == runs.value[k]).sum() > 1
        or runs.value[k] in (series.min(), series.max())
    ]
    return runs.rows(np.array(chosen, dtype=int))


def _deviation(series: np.ndarray) -> np.ndarray:
    """What a cubic through four neighbours does not explain, shape ``(n - 4,)``."""
    y = series
    return y[2:-2] - (-y[:-4] + 4.0 * y[1:-3] + 4.0 * y[3:-1] - y[4:]) / 6.0


def _spikes(times: np.ndarray, series: np.ndarray, taken: np.ndarray, coarse: bool) -> np.ndarray:
    """Indices of samples, alone or in short groups, that their neighbours contradict."""
    y = series.copy()
    y[taken] = np.interp(np.flatnonzero(taken), np.flatnonzero(~taken), series[~taken])
    d = _deviation(y)
    if d.size < LEAST_SAMPLES:
        return np.empty(0, dtype=int)
    floor = max(SMALL * _reach(y), 4.0 * _quantum(series) * coarse)
    limit = max(SPIKE * float(np.median(np.abs(d))) / QUARTILE, floor)
    steps = np.diff(times)
    usual = float(np.median(steps))
    found: list[int] = []
    for i in np.argsort(-np.abs(d)) + 2:
        if abs(d[i - 2]) <= limit:
            break
        if taken[i] or np.any(np.abs(steps[i - 2 : i + 2] - usual) > 0.2 * usual):
            continue
        now = y[i] - (-y[i - 2] + 4.0 * y[i - 1] + 4.0 * y[i + 1] - y[i + 2]) / 6.0
        near = d[max(i - 12, 0) : i + 8]
        nearby = SPIKE * float(np.median(np.abs(near))) / QUARTILE
        middle = 0.5 * (y[i - 1] + y[i + 1])
        bend = abs((y[i + 2] - y[i + 1]) - (y[i - 1] - y[i - 2]))
        apart = abs(y[i] - middle)
        if abs(now) <= max(limit, nearby) or apart <= 1.5 * bend:
            continue
        if abs(y[i + 1] - y[i - 1]) > 0.5 * apart:
            continue
        found.append(int(i))
        y[i] = middle
    known = taken.copy()
    known[found] = True
    groups = bursts(times, y, known, SPIKE, floor)
    return np.sort(np.concatenate([np.array(found, dtype=int), *groups]))
