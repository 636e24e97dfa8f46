r"""Screens of single signals: what a log shows without any equation.

Exact coincidences. In continuous noise no two samples are equal, so no likelihood can hold them:
held, frozen, cut-off, lost, interpolated and coarse samples are told by counting. With a share
:math:`p` of samples that repeat their neighbour by rounding alone, a run of :math:`L` is none if

.. math:: N p^{L-1} < \alpha .

Spikes are looked for in what a cubic through four neighbours does not explain,

.. math:: d_i = y_i - (-y_{i-2} + 4 y_{i-1} + 4 y_{i+1} - y_{i+2})/6,

at 8.5 times the robust deviation of :math:`d`, globally and nearby: with normal noise one in
:math:`10^{16}` samples. Noise may have heavier tails, as Student's law with five degrees of freedom
has: of :math:`n` samples beyond 3.5 deviations :math:`n\,(3.5/x)^5` are then beyond :math:`x`, and
the limit is where chance, with probability :math:`\alpha`, leaves as many there as are (Poisson).
One alone has to be large; of several, which such tails do not make, each need only be beyond what
normal noise leaves. A kink, where a rudder starts to move say, changes the
slope and is left alone: the deviation from both neighbours has to exceed 1.5 times the change of
slope around it. Where chance would hardly put so many of these samples right after steps of the
inputs, those there are no faults but answers that are faster than the sampling.

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

Steps: a signal jumps once between two samples and stays there. A compass that was set, a gyro that
was reset, a depth whose zero was changed: of the differences of neighbours that is a single sample
that five on either side contradict, and it is found as a spike of theirs. Its size is fitted as a
cubic with a step, over the widest surroundings in which noise is all that this leaves.

Times at which samples were taken that scatter about those that were written.

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

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from math import comb

import numpy as np
from scipy.special import bdtrc, ndtri, pdtrc, pdtri

from oed_sysid.data.record import MINIMUM_SAMPLES
from oed_sysid.evidence.chance import FALSE_CLAIMS
from oed_sysid.evidence.traces import LEAST, Trace, fast_noise
from oed_sysid.likelihood.noise_levels import (
    SPIKE,
    Runs,
    longest_run,
    off_cubic,
    robust_deviation,
    surely_beyond,
)
from oed_sysid.runtime.constants import MATERIAL, NEGLIGIBLE

# Robust deviations from which on tails are counted.
TAIL = 3.5
# Samples on either side of a step that tell level and slope.
SIDE = MINIMUM_SAMPLES
# Samples around a group or a step that say what is usual.
AROUND = 5 * SIDE
# Samples of the longest group: half of what says what is usual. What stays longer is a step.
LONGEST = AROUND // 2
# Share of samples or values from which on a signal is coarse, held or interpolated.
HELD = 0.5


@dataclass(frozen=True, eq=False)
class Fault:
    """Samples of one signal in one record that a screen stopped; for steps, the size of each."""

    kind: str
    signal: str
    record: str
    rows: np.ndarray
    amount: float = 0.0
    sizes: tuple[float, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Signals: of copies both."""
        return tuple(self.signal.split(" = "))

    def groups(self) -> list[np.ndarray]:
        """Positions in ``rows`` of what happened at once."""
        together = self.kind == "spikes"
        apart = np.diff(self.rows) > 1 if together else np.ones(self.rows.size - 1, dtype=bool)
        return np.split(np.arange(self.rows.size), np.flatnonzero(apart) + 1)

    def without(self, pushed: np.ndarray) -> list[Fault]:
        """The fault without what begins at marked samples; none where nothing is left."""
        left = [group for group in self.groups() if not pushed[self.rows[group[0]]]]
        if not left:
            return []
        chosen = np.concatenate(left)
        sizes = tuple(self.sizes[k] for k in chosen) if self.sizes else ()
        amount = max(sizes, key=abs, default=0.0) if self.sizes else float(chosen.size)
        return [replace(self, rows=self.rows[chosen], amount=amount, sizes=sizes)]


def screened(traces: Sequence[Trace]) -> tuple[list[Fault], list[Trace]]:
    """Faults of all records, and the records with what is faster than its samples marked.

    Samples of one signal that stand out and follow steps of the inputs more often than chance would
    have it are its answers. Smaller steps are answered as fast, only less clearly: all are marked.
    What jumps after a step of an input and stays is no fault that the signal alone could show.
    """
    shared = sum(len(trace.values) for trace in traces)
    names = dict.fromkeys(name for trace in traces for name in trace.values)
    fast = frozenset(name for name in names if _answers(traces, name))
    kept = list[Fault]()
    for trace in traces:
        for fault in screen(trace, shared):
            answers = fault.kind == "step" or (fault.kind == "spikes" and fault.signal in fast)
            kept += fault.without(trace.answers(fault.signal)) if answers else [fault]
    return kept, [replace(trace, fast=fast) for trace in traces]


def _answers(traces: Sequence[Trace], name: str) -> bool:
    """Whether a signal stands out after steps of the inputs more often than chance would have it.

    Spikes elsewhere say nothing about that.
    """
    hits, others, share = 0, 0, list[np.ndarray]()
    for trace in (one for one in traces if name in one.values):
        present = np.flatnonzero(np.isfinite(trace.values[name]))
        if present.size <= LEAST:
            continue
        size, pushed = _sizes(trace.values[name][present]), trace.answers(name)[present][2:-2]
        spiky = np.convolve(size > SPIKE, np.ones(9), mode="same") > 0.5
        hits += _events((size > TAIL) & pushed)
        others += _events((size > TAIL) & ~pushed & ~spiky)
        share.append(pushed)
    chance = np.mean(np.concatenate(share)) if share else 0.0
    return hits > 0 and bool(bdtrc(hits - 1, hits + others, chance) < FALSE_CLAIMS)


def _events(here: np.ndarray) -> int:
    """How many stretches of samples are marked; gaps of less than a group do not part them."""
    rows = np.flatnonzero(here)
    return rows.size and 1 + int(np.sum(np.diff(rows) > SIDE))


def screen(trace: Trace, shared: int = 1) -> list[Fault]:
    """All faults of the single signals of one record; ``shared`` of them share the false alarms.

    A signal without any noise (a simulation, a hand-made file) is not judged as frozen or dead,
    because nothing tells that it should have moved.
    """
    noisy = max(trace.noise.values(), default=0.0) > 0.0
    found = list[Fault]()
    for (first, series), (second, other) in combinations(trace.values.items(), 2):
        same = np.array_equal(series, other, equal_nan=True)
        if same and np.unique(series[np.isfinite(series)]).size > 1:
            rows = np.arange(trace.times.size)
            found.append(Fault("copied", f"{second} = {first}", trace.name, rows))
    for name, values in trace.values.items():
        present = np.flatnonzero(np.isfinite(values))
        if present.size >= LEAST and (noisy or np.ptp(values[present]) > 0.0):
            signal = Signal(trace, name, present, noisy=noisy, shared=shared)
            for kind, (rows, *more) in signal.stopped():
                found.append(Fault(kind, name, trace.name, present[rows], *more))
    return found


# Rows in which a screen stops a signal, a number about them, and the sizes of steps.
Stopped = tuple[np.ndarray] | tuple[np.ndarray, float] | tuple[np.ndarray, float, tuple[float, ...]]


class Signal:
    """Samples of one signal in one record, and those that a screen has stopped."""

    def __init__(
        self, trace: Trace, name: str, present: np.ndarray, *, noisy: bool, shared: int
    ) -> None:
        self.times, self.series = trace.times[present], trace.values[name][present]
        self.dt, self.noisy = trace.step, noisy
        self.taken = np.zeros(present.size, dtype=bool)
        self.runs = Runs.of(self.series)
        distinct = np.unique(self.series)
        self.step = float(np.min(np.diff(distinct), initial=np.inf))
        self.equal = 1.0 - self.runs.length.size / present.size
        few = distinct.size < HELD * self.runs.length.size
        self.coarse = few and self.step > MATERIAL * trace.noise[name]
        # What rounding repeats is counted, not assumed.
        self.alpha = FALSE_CLAIMS / shared
        self.reach = float(np.subtract(*np.quantile(self.series, [0.98, 0.02])))
        # The least size that is material.
        self.least = max(NEGLIGIBLE * self.reach, 4.0 * self.step if self.coarse else 0.0)

    def stopped(self) -> Iterator[tuple[str, Stopped]]:
        """Kinds of fault and what stopped the signal, until nothing more can be said of it."""
        for kind, look, ends in SCREENS:
            if (found := look(self)) is not None:
                self.taken[found[0]] = True
                yield kind, found
                if ends:
                    return

    def dead(self) -> Stopped | None:
        """All samples are equal."""
        return None if self.step < np.inf else (np.arange(self.series.size),)

    def held(self) -> Stopped | None:
        """Most samples repeat the one before, in stretches of like length."""
        length = self.runs.length
        if self.coarse or self.equal < HELD or np.quantile(length, 0.25) < 2:
            return None
        later = self.runs.rows(np.arange(length.size), after=1)
        return later, float(np.median(length)) * self.dt

    def interpolated(self) -> Stopped | None:
        """Most samples lie on straight lines between others."""
        between = np.empty(0) if self.coarse else interpolated(self.series)
        if between.size <= HELD * self.series.size:
            return None
        knots = max(self.series.size - between.size, 1)
        return between, float(self.series.size / knots) * self.dt

    def quantised(self) -> Stopped | None:
        """The samples stand on the steps of a converter."""
        return (np.empty(0, dtype=int), self.step) if self.coarse else None

    def lost(self) -> Stopped | None:
        """Runs to which the signal falls at once, and from which it comes back."""
        return self._stopped(self._repeated[0])

    def saturated(self) -> Stopped | None:
        """Runs at its largest or smallest value."""
        return self._stopped(self._repeated[1])

    def frozen(self) -> Stopped | None:
        """Runs in which it stands still and that are neither."""
        chosen = np.flatnonzero(self._repeated[2])
        length = float(self.runs.length[chosen].sum()) * self.dt
        return (self.runs.rows(chosen, after=1), length) if chosen.size else None

    def _stopped(self, chosen: np.ndarray) -> Stopped | None:
        """All samples of some runs, and the value of the first of these."""
        rows = self.runs.rows(np.flatnonzero(chosen))
        return (rows, float(self.runs.value[chosen][0])) if rows.size else None

    @cached_property
    def _repeated(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Runs of equal samples that rounding does not make: lost, cut off or frozen."""
        series, runs, coarse, n = self.series, self.runs, self.coarse, self.series.size
        # Of the repetitions those in the longest run of all are what is asked.
        usual = np.sort(runs.length)[: max(1, int(0.99 * runs.length.size))]
        p = float(np.clip((usual - 1).sum() / n, 1.0 / n, 0.98))
        least = 1.0 + longest_run(p, n, self.alpha)
        if coarse:  # a slow signal stays on a step of the converter
            least = max(least, 4.0 * float(np.quantile(runs.length, 0.9)))
        into, out = runs.edges()
        changes = np.abs(np.diff(series))
        jump = 3.0 * float(np.quantile(changes[changes > 0.0], 0.95))
        with np.errstate(invalid="ignore"):
            falls, leaps = np.abs(into) > jump, np.abs(out) > jump
            fallen = falls & leaps & (np.sign(into) * np.sign(out) < 0.0)
        far = np.abs(runs.value - np.median(series)) > 10.0 * (self.reach or np.ptp(series))
        values, place = np.unique(runs.value, return_inverse=True)
        recurs = np.bincount(place, weights=fallen)[place] * (not coarse)
        extreme = (runs.value == values[0]) | (runs.value == values[-1])
        lost = far | (fallen & (recurs >= 4) & (recurs > 0.8 * np.bincount(place)[place]))
        lost |= fallen & (runs.length >= (least if coarse else 3)) & ((recurs > 1) | extreme)
        # It stops at once, and does not come to rest at a turning point.
        pace = float(np.median(changes))
        first, last = np.fmin(np.abs(into), np.abs(out)), np.fmax(np.abs(into), np.abs(out))
        sudden = (first > 0.02 * pace) & (last > 0.3 * pace)
        # Runs of three at one value, where rounding would hardly make two of them at any.
        three = (runs.length >= 3) & ((n * p**2) ** 2 < self.alpha)
        again = np.bincount(place, weights=three)[place] > 1
        lost |= three & again & sudden & ~extreme & (not coarse)
        long = (runs.length >= least) & ~lost
        # What is cut off leaves its limit and returns to it as it moves.
        level = (runs.length >= min(3.0, least)) & extreme & ~(lost | falls | leaps)
        cut = level & ((np.bincount(place, weights=level)[place] >= 2) | long) & (not coarse)
        # A slow signal stays on a step of its converter.
        masks = lost, cut, long & ~cut & (runs.length >= 8) & sudden & (not coarse)
        return masks if self.noisy else (lost & False,) * 3

    def spikes(self) -> Stopped | None:
        """Samples, alone or in short groups, that their neighbours contradict."""
        y, taken = self.series.copy(), self.taken
        y[taken] = np.interp(np.flatnonzero(taken), np.flatnonzero(~taken), y[~taken])
        if y.size < LEAST + 4:
            return None
        rows = np.sort(np.concatenate([
            np.zeros(0, dtype=int), *bursts(self.times, y, taken, _limit(y, self.alpha), self.least)
        ]))  # fmt: skip
        return (rows, float(rows.size)) if rows.size else None

    def jumps(self) -> Stopped | None:
        """Steps after which it keeps its new level."""
        taken = self.taken.copy()
        if not self.coarse:  # the end of samples that stand still is no new level
            taken[self.runs.rows(np.flatnonzero(self.runs.length >= 3))] = True
        jumped = steps(self.times, self.series, taken, 5.0 * self.least)
        sizes = tuple(jumped.values())
        return (np.array([*jumped]), max(sizes, key=abs), sizes) if jumped else None


# Screens in their order, and whether nothing more can be said of a signal that one stops. What a
# fault means and what mends it stands in the table of words.
SCREENS: tuple[tuple[str, Callable[[Signal], Stopped | None], bool], ...] = (
    ("dead", Signal.dead, True),
    ("held", Signal.held, True),
    ("interpolated", Signal.interpolated, True),
    ("quantised", Signal.quantised, False),
    ("dropouts", Signal.lost, False),
    ("saturated", Signal.saturated, False),
    ("frozen", Signal.frozen, False),
    ("spikes", Signal.spikes, False),
    ("step", Signal.jumps, False),
)


def interpolated(series: np.ndarray) -> np.ndarray:
    """Samples on the straight line through both neighbours, to the digits that are written.

    Examples
    --------
    >>> slow = np.random.default_rng(0).standard_normal(11)
    >>> interpolated(np.interp(np.arange(41) / 4.0, np.arange(11), slow)).size
    30
    """
    values = np.unique(series)
    digits = float(np.min(np.diff(values)))
    usual = float(np.median(np.abs(np.diff(series))))
    fine = max(1e-9 * float(np.ptp(series)), 2.1 * digits if digits < 0.01 * usual else 0.0)
    flat = np.abs(np.diff(series, 2)) <= fine
    return np.flatnonzero(flat & (np.abs(np.diff(series))[1:] > 0.0)) + 1


def _sizes(series: np.ndarray) -> np.ndarray:
    """Deviations from a cubic through four neighbours, in robust deviations; none without noise."""
    d = np.abs(off_cubic(series)[:, 0])
    usual = robust_deviation(d)
    return d / usual if usual > 0.0 else 0.0 * d


def _limit(series: np.ndarray, alpha: float) -> float:
    """Robust deviations beyond which lie more samples than noise with such tails leaves."""
    size = _sizes(series)
    n_tail, surely = int(np.sum(size > TAIL)), surely_beyond(alpha, size.size)
    # Samples beside one that stands out do as well: only the largest around counts.
    around = np.lib.stride_tricks.sliding_window_view(np.pad(size, SIDE), 2 * SIDE + 1)
    peaks = -np.sort(-size[(size == around.max(axis=1)) & (size > surely)])
    rank, share = np.arange(peaks.size), (TAIL / peaks) ** 5
    made = np.maximum(n_tail - 1 - rank, 1) * share / (1.0 - share)
    last = int(np.max(np.flatnonzero(pdtrc(rank, made) < alpha), initial=0))
    left = max(n_tail - 1 - last, 0)
    limit = TAIL * (1.0 + left / float(pdtri(last, 1.0 - alpha))) ** 0.2
    return max(limit, surely if last else SPIKE)


def bursts(
    times: np.ndarray, series: np.ndarray, taken: np.ndarray, limit: float, least: float
) -> list[np.ndarray]:
    """Find groups of one to twelve consecutive samples that their surroundings contradict.

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
    lengths = [n for n in range(1, LONGEST + 1) if series.size - n - 3 >= LEAST]
    return _groups(times, series, taken, lengths, (limit, least))


def _groups(
    times: np.ndarray,
    series: np.ndarray,
    taken: np.ndarray,
    lengths: Sequence[int],
    limits: tuple[float, float],
    side: int = 2,
) -> list[np.ndarray]:
    """Groups of some lengths that so many samples on either side contradict."""
    y, used, uneven = series.copy(), taken.copy(), _uneven(times)
    groups: list[np.ndarray] = []
    while True:
        found = [one for length in lengths for one in _candidates(y, length, *limits, side)]
        before = len(groups)
        # The clearest first: a window that holds a part of a group sees the rest beside it.
        for _, first, length in sorted(found, reverse=True):
            window = slice(first - side, first + length + side)
            if used[window].any() or uneven[window.start : window.stop - 1].any():
                continue
            groups.append(np.arange(first, first + length))
            used[first : first + length] = True
        if len(groups) == before:
            return groups
        # Beside a group that is taken out there may be another one.
        bad = np.concatenate(groups)
        good = np.setdiff1d(np.arange(y.size), bad)
        y[bad] = np.interp(bad, good, y[good])
        used = taken.copy()
        used[bad] = True


def _uneven(times: np.ndarray) -> np.ndarray:
    """Time steps that differ from the usual one, ``(n_times - 1,)``."""
    intervals = np.diff(times)
    usual = np.median(intervals)
    return np.asarray(np.abs(intervals - usual) > MATERIAL * usual)


def _candidates(
    y: np.ndarray, length: int, limit: float, least: float, side: int
) -> Iterator[tuple[float, int, int]]:
    """Excess, first sample and length of each group that stands out."""
    d = np.abs(off_cubic(y, length, side))
    ends = np.minimum(d[:, 0], d[:, -1])
    usual = robust_deviation(d[:, [0, -1]])
    # What rises from sample to sample stands out most in its middle.
    sharp = ends >= 0.5 * d.max(axis=1)
    for k in np.flatnonzero(sharp & (ends > max(limit * usual, least))):
        first = int(k) + side
        last = first + length - 1
        before, after = y[first - 1] - y[first - 2], y[last + 2] - y[last + 1]
        bend = 1.5 * abs(after - before)
        into, out = y[first] - y[first - 1] - before, y[last + 1] - y[last] - after
        back = y[last + 1] - y[first - 1] - 0.5 * (length + 1) * (before + after)
        if min(abs(into), abs(out)) <= bend or abs(back) > 0.5 * ends[k]:
            continue
        # Windows that overlap the group see it as well.
        beside = np.abs(np.arange(d.shape[0]) - k)
        apart = length + 2 * side - 1
        near = d[(beside > apart) & (beside <= apart + AROUND)]
        nearby = limit * robust_deviation(near[:, [0, -1]]) if near.size else 0.0
        # Calm surroundings: their own changes are no size that would make a group stand out.
        calm = 3.0 * max(abs(before), abs(after))
        if ends[k] > max(nearby, calm):
            yield float(ends[k] / max(limit * usual, nearby, least)), first, length


def steps(
    times: np.ndarray, series: np.ndarray, taken: np.ndarray, least: float
) -> dict[int, float]:
    """Find jumps after which a signal keeps its new level.

    Parameters
    ----------
    times, series : numpy.ndarray
        Shape ``(n_times,)``; the series has no gaps.
    taken : numpy.ndarray of bool
        Samples that are known to be bad; no step is looked for beside them.
    least : float
        The least size that matters, in the unit of the series.

    Returns
    -------
    dict of int to float
        Index of the first sample after each jump, and its size in the unit of the series.

    Examples
    --------
    >>> t = np.arange(400) * 0.1
    >>> y = np.sin(t) + 0.01 * np.random.default_rng(0).standard_normal(400)
    >>> y[250:] += 1.5
    >>> found = steps(t, y, np.zeros(400, dtype=bool), 0.1)
    >>> {row: round(size, 1) for row, size in found.items()}
    {250: 1.5}
    """
    if series.size <= LEAST + 2 * SIDE:
        return {}
    beside = taken[1:] | taken[:-1]
    jumps = _groups(times[1:], np.diff(series), beside, [1], (SPIKE, least), SIDE)
    # What passes jumps back before long.
    change = np.where(beside, 0.0, np.abs(np.diff(series)))
    around = np.lib.stride_tricks.sliding_window_view(np.pad(change, LONGEST), 2 * LONGEST + 1)
    alone = np.sort(around, axis=1)[:, -2] < 0.5 * change
    rows = sorted(int(group[0]) + 1 for group in jumps if alone[group[0]])
    edges = [0, *rows, series.size]
    bounds = zip(rows, edges, edges[2:], strict=False)
    return {row: _size(series, taken, row, free) for row, *free in bounds}


def _size(series: np.ndarray, taken: np.ndarray, row: int, free: Sequence[int]) -> float:
    """Size of a jump from the widest surroundings that a cubic with a step follows."""
    noise, size = fast_noise(series), float(series[row] - series[row - 1])
    for width in (10, 20, 40, 80):
        if row - width < free[0] or row + width > free[1]:
            break
        rows = np.arange(row - width, row + width)
        x = (rows - row + 0.5) / width
        matrix = np.column_stack([x**0, x, x**2, x**3, x > 0.0])[~taken[rows]]
        here = series[rows[~taken[rows]]]
        fitted = np.linalg.lstsq(matrix, here, rcond=None)[0]
        left = here - matrix @ fitted
        if width > 10 and np.sqrt(np.sum(left**2) / (here.size - 5)) > 1.15 * noise:
            break
        size = float(fitted[-1])
    return size


def marked(faults: Sequence[Fault], record: str, kinds: Sequence[str]) -> Mapping[str, np.ndarray]:
    """Rows of some kinds of faults in a record, by signal."""
    rows: dict[str, np.ndarray] = {}
    for fault in faults:
        if fault.record == record and fault.kind in kinds:
            rows[fault.signal] = np.union1d(rows.get(fault.signal, []), fault.rows).astype(int)
    return rows


# -- times that scatter ---------------------------------------------------------------------------

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
    values = trace.values.get(name)
    if values is None or name in trace.fast:
        return left, rate
    rows = np.flatnonzero(np.isfinite(values))
    if rows.size < LEAST:
        return left, rate
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
        return left, rate
    follow = float(np.sum(deviation[1:] * deviation[:-1]) / np.sum(deviation**2))
    if follow > 0.5 * CORRELATED[1]:
        return left, rate
    smooth = np.convolve(np.gradient(series, times), np.hanning(9)[1:-1] / 4.0, mode="same")
    left[rows[2:-2]] = deviation / noise
    rate[rows[2:-2]] = np.where(even, smooth[2:-2], 0.0) / noise
    return left, rate
