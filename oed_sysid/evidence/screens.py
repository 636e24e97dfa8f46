r"""Screens of single signals: what a log shows without any equation.

Spikes are looked for in what a cubic through four neighbours does not explain,

.. math:: d_i = y_i - (-y_{i-2} + 4 y_{i-1} + 4 y_{i+1} - y_{i+2})/6,

at 8.5 times the robust deviation of :math:`d`, globally and nearby: with normal noise one in
:math:`10^{16}` samples. A kink, where a rudder starts to move say, changes the slope and is left
alone: the deviation from both neighbours has to exceed 1.5 times the change of slope around it.
Groups of bad samples and lasting jumps are found as below. Where chance would hardly put so many of
them right after steps of the inputs, those there are no faults but answers that are faster than the
sampling.

Groups of bad samples: a signal leaves its surroundings at once and comes back.

For a group of :math:`L` samples from :math:`i` on, :math:`c_k` is the cubic through the two samples
before it and the two after it, and

.. math:: D_i = \min(|y_i - c_i|,\, |y_{i+L-1} - c_{i+L-1}|)

is how far both of its ends stand out. The scatter of the same deviations over the whole record, for
the same :math:`L`, allows for the motion that a cubic does not follow; that near by for a manoeuvre
in an otherwise quiet record. With :math:`a, b` the changes from sample to sample after and before
the group, it is left alone unless the steps into it and out of it exceed :math:`1.5\,|a - b|`
beside :math:`b` and :math:`a`, and unless its ends stand out by half of what its middle does: a
turning point and a short hump are no faults.

Steps: a signal jumps once between two samples and stays there.

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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import bdtrc

from oed_sysid.evidence.traces import QUARTILE, Trace, fast_noise

SPIKE = 8.5
# Faults below this share of a signal's range are immaterial.
SMALL = 0.01
# Largest deviation of a time step in a burst or about a step from the usual one, and fewest
# windows that tell what is usual.
UNEVEN, LEAST_WINDOWS = 0.2, 20
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
        yield from _standing_still(trace, name, present, runs, taken)
    if not held:
        yield from _jumping(trace, name, present, runs, taken, coarse)


def _standing_still(
    trace: Trace, name: str, present: np.ndarray, runs: Runs, taken: np.ndarray
) -> Iterator[Fault]:
    """A smooth signal that is cut off, or stops dead; its samples are ``taken``."""
    series = trace.values[name][present]
    # Runs far longer than its usual ones.
    least = max(FROZEN, 4.0 * float(np.quantile(runs.length, 0.9)))
    long = np.flatnonzero(runs.length >= least)
    at_end = np.isin(runs.value, (series.max(), series.min()))
    flat = np.flatnonzero((runs.length >= 3) & at_end & ~taken[runs.first])
    clipped = flat if _is_clipped(series, runs, flat) else np.empty(0, dtype=int)
    left = [k for k in long if k not in clipped and not taken[runs.first[k]]]
    frozen = np.array([int(k) for k in left if _is_sudden(series, runs, int(k))], dtype=int)
    if clipped.size:
        rows = runs.rows(clipped)
        taken[rows] = True
        yield Fault("saturated", name, trace.name, present[rows], float(runs.value[clipped[0]]))
    if frozen.size:
        rows = runs.rows(frozen, after=1)
        taken[rows] = True
        duration = float(runs.length[frozen].sum()) * trace.step
        yield Fault("frozen", name, trace.name, present[rows], duration)


def _jumping(
    trace: Trace, name: str, present: np.ndarray, runs: Runs, taken: np.ndarray, coarse: bool
) -> Iterator[Fault]:
    """Spikes, and steps beside what is ``taken``."""
    series = trace.values[name][present]
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


def _fast(faults: Sequence[Fault], after: Mapping[str, np.ndarray]) -> set[str]:
    """Signals whose samples that stand out follow steps of the inputs beyond chance."""
    share = float(np.concatenate(list(after.values())).mean())
    begins: dict[str, list[bool]] = {}
    for f in faults:
        if f.kind in ANSWERS:
            known = begins.setdefault(f.signal, [])
            known += [bool(after[f.record][f.rows[group[0]]]) for group in f.groups()]
    return {
        name
        for name, said in begins.items()
        if any(said) and bdtrc(sum(said) - 1, len(said), share) < CHANCE
    }


def screened(traces: Sequence[Trace]) -> tuple[list[Fault], list[Trace]]:
    """Faults of all records, and the records with what is faster than its samples marked.

    Samples of one signal that stand out and follow steps of the inputs more often than chance would
    have it are its answers. Smaller steps are answered as fast, only less clearly: all are marked.
    """
    faults = [fault for trace in traces for fault in screen(trace)]
    after = {trace.name: trace.pushed for trace in traces}
    fast = _fast(faults, after)
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


LENGTHS = (2, 3, 4, 5, 6)
# Half width, in samples, of what is near by, beside the group.
AROUND_BURST = 20


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
        near = d[(beside > length + 3) & (beside <= length + 3 + AROUND_BURST)]
        nearby = limit * float(np.median(near[:, [0, -1]])) / QUARTILE if near.size else 0.0
        # Calm surroundings: their own changes are no size that would make a group stand out.
        calm = 3.0 * max(abs(before), abs(after))
        if ends[k] > max(nearby, calm):
            result.append((float(ends[k] / max(limit * usual, nearby, least)), first, length))
    return result


LIMIT = 8.5
# Samples on either side that tell level and slope.
SIDE = 5
AROUND_STEP = 25
# A step below this share of the range of a signal is left to the equations.
SMALL_STEP = 0.05
# Against the motion along either line over its samples, and the part between the two samples.
STEEP, AT_ONCE = 3.0, 0.7
# Half widths, in samples, of the surroundings that its size is fitted in.
WIDTHS = (10, 20, 40, 80)
# What a fit may leave against the noise.
NOISY = 1.15


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
        near = size[(beside >= SIDE) & (beside < SIDE + AROUND_STEP)]
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
