r"""Noise levels: what the data themselves say about their measurement noise.

Spikes: samples that stand out alone from residuals.

With :math:`\epsilon_k` the one-step errors of an output,

:math:`d_k = \epsilon_k - \operatorname{median}(\epsilon_{k-2}, \epsilon_{k-1},
\epsilon_{k+1}, \epsilon_{k+2})` over its median absolute deviation; a spike exceeds what the
largest of as many normal numbers does, and stands alone (Hampel 1974, *J. Am. Stat. Assoc.* 69).
Groups of samples are a sensor's fault, not motion, where they jump away and jump back, or repeat
one value to the last digit longer than noise lets them.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from scipy.linalg import solve_banded
from scipy.special import chdtri, ndtr, ndtri

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.errors import DataError, ModelError
from oed_sysid.physics.channels import Output
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import BEYOND, IMMATERIAL, MATERIAL, ROUNDING, THREE_DIGITS

# Lowest order of the differences in which white noise is looked for, and the share of one order's
# level below which the next one's means that motion was seen, not noise.
LOWEST_ORDER, STILL_FALLING = 3, 0.85
# Standard error of the logarithm of such a level, times the root of the number of samples.
DIFFERENCE_ERROR = 1.5
# White noise below this share of the signal is the last digit of a file, not a sensor. Where no
# sensor's noise is seen, as in a filtered log, it is not taken to be finer than three digits.
LAST_DIGIT = 1e-5


def white_levels(dataset: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Level of the white part of each output, and whether it is the noise that one sees.

    From differences of third order, which a smooth motion hardly enters: the
    variance of a difference of order k of white noise is ``binomial(2k, k)`` times
    that of the noise. While the next order shows clearly less, it is still the
    motion that is seen. Differences are taken between samples that follow one
    another, missing ones left out.

    Parameters
    ----------
    dataset : Dataset

    Returns
    -------
    levels : ndarray (n_outputs,)
        The signal's spread where there are too few samples.
    seen : ndarray of bool (n_outputs,)
        False where the level still falls at the highest order: it is then no
        more than an upper limit of the noise.
    """
    n_outputs = len(dataset[0].channels.outputs)
    levels, seen = np.full(n_outputs, np.nan), np.zeros(n_outputs, dtype=bool)
    for column in range(n_outputs):
        measured = [r.outputs[:, column] for r in dataset if not r.independent]
        levels[column], seen[column] = white_level(measured, coarse=True)
    spread = signal_spread(dataset)
    known = np.isfinite(levels)
    return np.where(known, np.maximum(levels, ROUNDING * spread), spread), seen & known


def white_level(parts: Sequence[np.ndarray], *, coarse: bool = False) -> tuple[float, bool]:
    """Level of the white part of one signal, and whether noise is what one sees.

    Parameters
    ----------
    parts : sequence of ndarray
        Its series in each record.
    coarse : bool
        As of :func:`fast_level`.
    """
    level = fast_level(parts, coarse=coarse)
    for order in range(LOWEST_ORDER + 1, 13):
        finer = fast_level(parts, order, coarse=coarse)
        if not finer < STILL_FALLING * level:
            return level, bool(np.isfinite(finer))
        level = finer
    return level, False


def credible_levels(dataset: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Noise levels that sensors may have, and whether the records show them.

    As :func:`white_levels`, but a level that is not seen, or is that of the last
    digit of a file, is at least a thousandth of the signal's spread: filtered
    records would otherwise seem to be measured without any error.

    Returns
    -------
    levels : ndarray (n_outputs,)
    seen : ndarray of bool (n_outputs,)
    """
    levels, seen = white_levels(dataset)
    spread = signal_spread(dataset)
    seen = seen & (levels > LAST_DIGIT * spread)
    return np.where(seen, levels, np.maximum(levels, THREE_DIGITS * spread)), seen


def fast_level(
    parts: Sequence[np.ndarray], order: int = LOWEST_ORDER, *, coarse: bool = False
) -> float:
    r"""Level of white noise with differences whose median is as large as these; NaN without any.

    .. math:: \sigma^2 = \operatorname{median}(\Delta^k u)^2 \,/\, \Big(0.4549 \binom{2 k}{k}\Big)

    Of ``coarse`` digits more than half the differences may be zero; their squares still tell.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> held = np.repeat([0.0, 0.3, -0.3], 200)
    >>> round(fast_level([held + 0.01 * rng.standard_normal(600)]), 3)
    0.01
    """
    differences = [np.diff(part[np.isfinite(part)], order) ** 2 for part in parts]
    pooled = np.concatenate([np.zeros(0), *differences])
    if not len(pooled):
        return np.nan
    # The median of a chi-squared variable with one degree of freedom is 0.4549.
    square = np.median(pooled) / 0.4549 or coarse * np.mean(pooled)
    return float(np.sqrt(square / comb(2 * order, order)))


def shown_in_log(dataset: Dataset, name: str) -> float:
    """Level of white noise that would wiggle as fast as the log of an input does, in its unit.

    An upper limit: a command that changes from sample to sample has it, too. Infinite where no
    input has that name, or where records are too short to tell.

    Parameters
    ----------
    dataset : Dataset
    name : str
    """
    names = dataset[0].channels.input_names
    if name not in names:
        return np.inf
    level = fast_level([record.inputs[:, names.index(name)] for record in dataset])
    return level if np.isfinite(level) else np.inf


def parabolas(series: np.ndarray) -> np.ndarray:
    """Parabolas through nine samples each, at their middle (Savitzky & Golay 1964).

    Of white noise a quarter of the variance is left; fewer than nine samples stay as they are.
    """
    from scipy.signal import savgol_filter  # takes half a second

    smooth: np.ndarray = savgol_filter(series, 9, 2) if series.size >= 9 else series
    return smooth


def signal_spread(dataset: Dataset) -> np.ndarray:
    """Standard deviation of each measured signal, at least a tiny positive number."""
    stacked = np.vstack([record.outputs - _first(record.outputs) for record in dataset])
    with np.errstate(invalid="ignore"):
        mean = np.nansum(stacked, axis=0) / np.maximum(np.isfinite(stacked).sum(axis=0), 1)
    return np.maximum(np.nan_to_num(root_mean_square([stacked - mean])), 1e-12)


def _first(outputs: np.ndarray) -> np.ndarray:
    rows = np.argmax(np.isfinite(outputs), axis=0)
    return np.nan_to_num(outputs[rows, np.arange(outputs.shape[1])])


def given_levels(outputs: Sequence[Output]) -> np.ndarray:
    """Declared noise levels, NaN where unknown."""
    return np.array([np.nan if o.noise_std is None else o.noise_std for o in outputs], dtype=float)


def believed_levels(outputs: Sequence[Output], dataset: Dataset) -> np.ndarray:
    """Declared noise levels, NaN where unknown and where records show clearly more noise.

    Their high-frequency content tells, whatever the model: below it forces would follow every
    wiggle, and parameters the forces.

    Examples
    --------
    >>> from oed_sysid.data.record import Record
    >>> from oed_sysid.physics.channels import Channels
    >>> noise = 0.02 * np.random.default_rng(0).standard_normal((2000, 2))
    >>> outputs = Output("a", "m", noise_std=0.02), Output("b", "m", noise_std=0.01)
    >>> times, inputs = np.arange(2000.0), np.zeros((2000, 0))
    >>> record = Record("run", times, inputs, noise, channels=Channels((), outputs))
    >>> believed_levels(outputs, Dataset((record,))).tolist()
    [0.02, nan]
    """
    declared = given_levels(outputs)
    if np.isnan(declared).all():
        return declared
    levels, seen = credible_levels(dataset)
    counts = sum(np.isfinite(record.outputs).sum(axis=0) for record in dataset)
    error = DIFFERENCE_ERROR / np.sqrt(np.maximum(counts, 1))
    more = levels * np.exp(-BEYOND * error) > (1.0 + MATERIAL) * declared
    return np.where(seen & more, np.nan, declared)


def start_levels(
    model: Model, dataset: Dataset, noise: str | Sequence[float], earlier: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Noise levels to begin with, and which of them to estimate.

    Parameters
    ----------
    model : Model
        Its outputs may declare levels.
    dataset : Dataset
        Measured records.
    noise : str or sequence of float
        As :class:`~oed_sysid.likelihood.multiple_shooting.MultipleShooting` takes it.
    earlier : ndarray (n_outputs,) or None
        Levels of an earlier fit.

    Returns
    -------
    levels : ndarray (n_outputs,)
        An output without any sample counts as one unit; it weighs nothing.
    estimated : ndarray of bool (n_outputs,)
    """
    names = model.output_names
    measured = np.isfinite(np.vstack([record.outputs for record in dataset])).any(axis=0)
    if not isinstance(noise, str):
        return _stated(names, np.asarray(noise, dtype=float)), np.zeros(len(names), dtype=bool)
    declared = given_levels(model.outputs)
    if noise == "auto":
        declared = believed_levels(model.outputs, dataset)
    unknown = np.isnan(declared)
    if noise == "given" and np.any(unknown & measured):
        missing = itertools.compress(names, unknown)
        raise DataError(
            f"The noise level of {', '.join(missing)} is not declared. Set noise_std on these "
            "outputs, or use noise='auto' to estimate it."
        )
    estimated = measured & (unknown if noise != "estimate" else True)
    if noise != "estimate":
        _stated(names, np.where(unknown, 1.0, declared))
    if not estimated.any():
        return np.where(measured, declared, 1.0), estimated
    if earlier is not None and earlier.shape == declared.shape:
        floor = earlier
    else:
        # Model errors dominate at first; a floor far below them would stiffen the start.
        floor = np.maximum(white_levels(dataset)[0], 0.02 * signal_spread(dataset))
    levels = np.where(estimated, floor, declared)
    return np.where(measured, levels, 1.0), estimated


def _stated(names: Sequence[str], levels: np.ndarray) -> np.ndarray:
    """Levels that somebody states, each above zero."""
    if levels.shape != (len(names),):
        raise ModelError(
            f"noise gives {levels.size} levels, expected {len(names)}, for {', '.join(names)}."
        )
    for name, level in zip(names, levels, strict=True):
        if not 0 < level < np.inf:
            raise DataError(
                f"The noise level of output {name!r} is {level}; residuals are divided by it. "
                "Give a positive standard deviation, or noise='estimate'."
            )
    return levels


def first_order(series: np.ndarray, share: float) -> np.ndarray:
    """Answer of first order to a series, from rest at its first value.

    Each sample takes a share of what is left: ``a[k] = a[k-1] + share * (s[k] - a[k-1])``.

    >>> print(first_order(np.array([0.0, 1.0, 1.0, 1.0]), 0.5))
    [0.    0.5   0.75  0.875]
    """
    bands = np.stack([np.ones(series.size), np.full(series.size, share - 1.0)])
    asked = share * series
    asked[0] = series[0]
    return np.asarray(solve_banded((1, 0), bands, asked, check_finite=False))


def root_mean_square(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Root mean square of residuals, by output; NaN where nothing was measured."""
    stacked = np.vstack(parts)
    finite = np.isfinite(stacked)
    count, total = finite.sum(axis=0), (np.where(finite, stacked, 0.0) ** 2).sum(axis=0)
    return np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def residual_levels(residuals: Sequence[np.ndarray], n_unknowns: int = 0) -> np.ndarray:
    """Root mean square of residuals, corrected for the unknowns fitted, by output."""
    stacked = np.vstack(residuals)
    count = np.isfinite(stacked).sum(axis=0)
    # Unknowns take degrees of freedom from all outputs in proportion to their samples.
    share = count * (1.0 - min(n_unknowns / max(int(count.sum()), 1), 0.9))
    return np.sqrt(np.nansum(stacked**2, axis=0) / np.maximum(share, 1e-9))


# Chance that noise as declared is taken for spikes in a data set, for a scatter of tests, or a
# disturbance for a law.
RARE = 1e-3
# Robust deviations of a spike or step that is alone, or among structured residuals.
SPIKE = 8.5
# Spread of the departure of white noise from the median of its four neighbours, and of normal
# numbers over the median of their sizes.
BESIDE, NORMAL = 1.137, float(1.0 / ndtri(0.75))


@dataclass(frozen=True, eq=False)
class _Output:
    """Samples of one output that were measured, per record.

    Attributes
    ----------
    rows : list of ndarray of int (n,)
        Where they are.
    values : list of ndarray (n,)
    """

    rows: list[np.ndarray]
    values: list[np.ndarray]

    @cached_property
    def away(self) -> list[np.ndarray]:
        """Departures ``(n,)`` from the median of the neighbours."""
        return [_beside(one) for one in self.values]

    @cached_property
    def every(self) -> np.ndarray:
        """Values of all records."""
        return np.concatenate(self.values)

    @cached_property
    def middle(self) -> float:
        """Median of all values."""
        return float(np.median(self.every))

    @cached_property
    def spread(self) -> float:
        """Standard deviation of the values about it, were they normal."""
        return robust_deviation(self.every - self.middle)

    @cached_property
    def usual(self) -> float:
        """Standard deviation of the departures, were they normal."""
        away = np.concatenate(self.away)
        return robust_deviation(away - np.median(away)) if len(away) else 0.0

    def surely(self, chance: float) -> float:
        """Deviations beyond which normal noise shows any sample with a chance."""
        return surely_beyond(chance, len(self.every))

    def sizes(self, off: Sequence[np.ndarray], usual: float, spread: float) -> list[np.ndarray]:
        """How far samples stand out: of both departures, in their spreads, the smaller."""
        return [
            np.minimum(np.abs(piece) / usual, np.abs(other) / (spread or usual))
            for piece, other in zip(self.away, off, strict=True)
        ]


def surely_beyond(chance: float, count: int) -> float:
    """Deviations beyond which any of so many normal numbers lies with a chance."""
    return float(-ndtri(0.5 * chance / count))


def _measured(whitened: Sequence[np.ndarray]) -> Iterator[_Output]:
    """Measured samples of every output."""
    for column in range(whitened[0].shape[1]):
        rows = [np.flatnonzero(np.isfinite(part[:, column])) for part in whitened]
        pairs = zip(whitened, rows, strict=True)
        yield _Output(rows, [part[index, column] for part, index in pairs])


def _by_output(
    whitened: Sequence[np.ndarray],
    find: Callable[[int, _Output], Sequence[np.ndarray] | None],
    nothing: float | bool = False,
) -> tuple[np.ndarray, ...]:
    """What is found of the measured samples of every output, ``(n_times, n_outputs)`` per record.

    Elsewhere, and where nothing is found, stands ``nothing``.
    """
    found = tuple(np.full(part.shape, nothing) for part in whitened)
    for column, measured in enumerate(_measured(whitened)):
        parts = find(column, measured)
        triples = () if parts is None else zip(found, measured.rows, parts, strict=True)
        for one, index, part in triples:
            one[index, column] = part
    return found


def spike_masks(
    whitened: Sequence[np.ndarray],
    *,
    declared: np.ndarray | None = None,
    taken: np.ndarray | None = None,
    stepped: Callable[[], Sequence[np.ndarray]] | None = None,
) -> tuple[np.ndarray, ...]:
    """Samples that stand out alone, per record; with inputs, also groups that jump there and back.

    Parameters
    ----------
    whitened : sequence of ndarray (n_times, n_outputs)
        Residuals in any unit, NaN where missing.
    declared : ndarray of bool (n_outputs,), optional
        Outputs whose residuals are in units of a declared noise level: within what this makes
        no sample is a spike, however smooth the others are.
    taken : ndarray of int (n_outputs,), optional
        Samples of each output that were taken out as spikes before.
    stepped : callable, optional
        Says per record where an input has just stepped, ``(n_times,)`` (:func:`input_steps`): a
        motion may jump there.

    Returns
    -------
    tuple of ndarray of bool (n_times, n_outputs)
    """
    n_outputs = whitened[0].shape[1]
    taken = np.zeros(n_outputs) if taken is None else taken
    least = np.zeros(n_outputs) if declared is None else declared.astype(float)

    def find(column: int, one: _Output) -> list[np.ndarray] | None:
        if len(one.every) < 30 or one.usual <= 0.0:
            return None
        found = _outliers(one, least[column], taken[column], RARE / n_outputs)
        if stepped is None:
            return found
        groups = _jumping(one, stepped, least[column], RARE / n_outputs)
        return [alone | group for alone, group in zip(found, groups, strict=True)]

    return _by_output(whitened, find)


def _off_bends(one: _Output, least: float, usual: float, surely: float) -> list[np.ndarray]:
    """Spikes of slow residuals, whose bends the cubic through the neighbours follows."""
    off = [_off_cubic(values) for values in one.values]
    spread = max(robust_deviation(np.concatenate(off)), least)
    # A transient here and there makes large departures usual.
    usual = max(usual, np.quantile(np.abs(np.concatenate(one.away)), 0.9) / ndtri(0.95))
    limit = max(surely, SPIKE)
    return [size > limit for size in one.sizes(off, usual, spread)]


def _outliers(one: _Output, least: float, count: int, chance: float) -> list[np.ndarray]:
    """Spikes among the samples of one output, per record; see :func:`spike_masks`.

    Parameters
    ----------
    one : _Output
    least : float
        Least deviation of the values.
    count : int
        Spikes that were taken out before.
    chance : float
        Probability that normal noise shows one.
    """
    usual, surely = max(one.usual, BESIDE * least), one.surely(chance)
    off = [values - one.middle for values in one.values]
    slow = max(one.spread, least)
    if slow > 1.1 * usual / BESIDE:
        return _off_bends(one, least, usual, surely)
    if not np.any(np.abs(one.every - one.middle) > surely * slow):
        return [np.zeros(len(values), dtype=bool) for values in off]
    # Neighbours that happen to lie on the other side do not make a spike.
    sizes = one.sizes(off, usual, slow)
    every = np.concatenate(sizes)
    limit = size_of_few(every, surely, count)
    masks = [size > limit for size in sizes]
    count += int(np.sum(every > limit))
    # Where there are several spikes some meet: as many in a row as chance makes of so many.
    for mask, away in zip(masks, off, strict=True) if count >= 3 else ():
        for first, stop in runs_of(np.abs(away) > surely * slow):
            mask[first:stop] |= stop - first <= _longest(count, len(every))
    return masks


def size_of_few(sizes: np.ndarray, surely: float, taken: int = 0) -> float:
    r"""Size beyond which samples are spikes: hardly any of normal noise is, or few of many.

    Where any of the sizes ``(n,)`` is beyond ``surely``, spikes are clear, and small ones hide
    among the noise: with ``k`` of ``n`` beyond a size ``t``, ``taken`` before included,
    :math:`2 n \Phi(-t) \le q k`, an immaterial share :math:`q` of them are good samples
    (Benjamini & Hochberg 1995).
    """
    if not np.any(sizes > surely):
        return surely
    ordered = np.sort(sizes)[::-1]
    found = taken + np.arange(1, len(ordered) + 1)
    chance = 2.0 * (len(ordered) + taken) * ndtr(-ordered)
    beyond = np.flatnonzero(chance <= IMMATERIAL * found)
    return float(np.nextafter(ordered[beyond[-1]], 0.0)) if len(beyond) else surely


def longest_run(share: float, n: int, chance: float = RARE) -> float:
    r"""Events in a row that chance hardly makes of a share of them among ``n`` samples.

    .. math:: n\, p^L = \alpha

    Examples
    --------
    >>> round(longest_run(0.1, 1000), 1)
    6.0
    """
    return float(np.log(chance / n) / np.log(share))


def _longest(count: int, n: int) -> int:
    """Most events in a row that chance makes of so many among ``n`` samples."""
    return max(int(longest_run(min(count / n, 0.5), n)), 2)


def _jumping(
    one: _Output, stepped: Callable[[], Sequence[np.ndarray]], least: float, chance: float
) -> list[np.ndarray]:
    """Groups of samples that are off and jump as nothing does that moves.

    There and back, or from one side to the other. Where most groups begin as an input steps, it
    is the vehicle that answers, at once. Over a gap in the rows a motion may go far. Other
    parameters as of :func:`_outliers`; ``stepped`` as of :func:`spike_masks`.
    """
    far = one.surely(chance) * max(one.spread, least)
    found = [np.zeros(len(values), dtype=bool) for values in one.values]
    if not np.any(np.abs(one.every - one.middle) > far):
        return found
    calm = [~part[index] for part, index in zip(stepped(), one.rows, strict=True)]
    steps = [np.diff(values, prepend=values[:1], append=values[-1:]) for values in one.values]
    jump = one.surely(chance) * max(robust_deviation(np.concatenate(steps)), np.sqrt(2.0) * least)
    answers, elsewhere = [], 0
    for mask, values, away, row, still in zip(
        found, one.values, steps, one.rows, calm, strict=True
    ):
        jumps = (np.abs(away) > jump) & _close(row)
        for first, stop in runs_of(np.abs(values - one.middle) > far):
            above = values[first:stop] > one.middle
            across = np.any((above[1:] != above[:-1]) & jumps[first + 1 : stop])
            back = jumps[first] and jumps[stop]
            if across or (back and still[first]):
                mask[first:stop] = True
                elsewhere += 1
            elif back:
                answers.append(mask[first:stop])
    for group in answers if len(answers) < elsewhere else ():
        group[:] = True
    return found


def _close(row: np.ndarray) -> np.ndarray:
    """Steps between neighbouring rows, ends included, that leave no gap, ``(n + 1,)``."""
    apart = np.diff(row, prepend=row[:1], append=row[-1:])
    return np.asarray(apart <= 2.0 * np.median(apart) if len(row) else apart > 0)


def input_steps(record: Record) -> np.ndarray:
    """Samples ``(n_times,)`` at or after which an input steps, by more than it usually moves."""
    moves = np.abs(np.diff(record.inputs, axis=0))
    if not len(moves):
        return np.ones(record.n_samples, dtype=bool)
    usual = NORMAL * np.nanmedian(moves, axis=0)
    stepped = np.r_[False, np.any(moves > BEYOND * usual, axis=1)]
    # A sample early and late: clocks of command and sensor need not agree to one.
    return stepped | np.r_[False, stepped[:-1]] | np.r_[stepped[1:], False]


@dataclass(frozen=True)
class Runs:
    """Stretches of equal consecutive samples: first index, length and value of each."""

    first: np.ndarray
    length: np.ndarray
    value: np.ndarray

    @classmethod
    def of(cls, series: np.ndarray) -> Runs:
        """Find the runs of a series without gaps.

        Examples
        --------
        >>> Runs.of(np.array([2.0, 2.0, 5.0, 2.0])).length.tolist()
        [2, 1, 1]
        """
        # Nothing is equal to NaN: the first sample, if there is one, begins a run.
        first = np.flatnonzero(np.diff(series, prepend=np.nan) != 0.0)
        return cls(first, np.diff(first, append=series.size), series[first])

    def rows(self, chosen: np.ndarray, *, after: int = 0) -> np.ndarray:
        """Indices of all samples of the chosen runs, without the first ``after`` of each."""
        parts = [np.arange(self.first[k] + after, self.first[k] + self.length[k]) for k in chosen]
        return np.concatenate(parts) if parts else np.empty(0, dtype=int)

    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Changes from the run before into each run, and from it to the next; NaN at the ends."""
        between = np.diff(self.value)
        return np.concatenate([[np.nan], between]), np.concatenate([between, [np.nan]])


def held_masks(
    outputs: Sequence[np.ndarray], whitened: Sequence[np.ndarray], sigma: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Samples that repeat one value longer than noise lets them, and that are off, per record.

    Noise breaks a repetition where it exceeds the resolution of a signal, the least difference
    of neighbours. A sensor that repeats itself (a drop-out that reads zero, a value that is
    held) says nothing new. A group whose squares are those of noise does no harm and stays, and
    so does the largest or the least value of a signal where it is not jumped to: a limit may be
    the vehicle's.

    Parameters
    ----------
    outputs : sequence of ndarray (n_times, n_outputs)
        Measurements, NaN where missing.
    whitened : sequence of ndarray (n_times, n_outputs)
        Their residuals in units of ``sigma``.
    sigma : ndarray (n_outputs,)
        Standard deviation of each.
    """

    def find(column: int, one: _Output) -> list[np.ndarray] | None:
        values = [part[index, column] for part, index in zip(outputs, one.rows, strict=True)]
        steps = np.abs(np.concatenate([np.diff(part) for part in values]))
        n, equal = len(steps) + 1, int(np.sum(steps == 0.0))
        usual = robust_deviation(one.every) if equal else 0.0
        if equal < 2 or equal == len(steps) or usual * sigma[column] < np.min(steps[steps > 0.0]):
            return None  # too coarse: repetitions are the resolution's
        longest, every = _longest(equal, n), np.concatenate(values)
        ends, jump = (every.min(), every.max()), -np.sqrt(2.0) * usual * ndtri(0.5 * RARE / n)
        masks = [np.zeros(len(part), dtype=bool) for part in values]
        for mask, part, off in zip(masks, values, one.values, strict=True):
            runs = Runs.of(part)
            for k in np.flatnonzero(runs.length > longest):
                first, stop = runs.first[k], runs.first[k] + runs.length[k]
                around = np.diff(off[max(first - 1, 0) : stop + 1])[[0, -1]]
                limit = part[first] in ends and np.abs(around).max() < jump
                square = float(np.sum(off[first:stop] ** 2)) / usual**2
                mask[first:stop] = not limit and square > chdtri(stop - first, RARE / n)
        return masks

    return _by_output(whitened, find)


def stand_out(outputs: Sequence[np.ndarray]) -> bool:
    """Whether samples of the records themselves may be spikes, before any fit.

    Alone among their neighbours, jumping or repeated as normal noise of the records' own roughness
    hardly lets any be. What bends a whole fit is larger.

    Parameters
    ----------
    outputs : sequence of ndarray (n_times, n_outputs)
        Measurements, NaN where missing.
    """
    return any(_stands_out(one, RARE / outputs[0].shape[1]) for one in _measured(outputs))


def _stands_out(one: _Output, chance: float) -> bool:
    """Whether a sample, a step or a repetition of one output does."""
    off = [_off_cubic(values) for values in one.values]
    every = np.concatenate([np.diff(values) for values in one.values])
    if not len(every):
        return False
    spreads = one.usual, robust_deviation(np.concatenate(off)), robust_deviation(every)
    if min(spreads) <= 0.0:  # of noise nothing is seen
        return True
    surely = one.surely(chance)
    longest = _longest(max(int(np.sum(every == 0.0)), 1), len(every))
    return bool(
        np.concatenate(one.sizes(off, *spreads[:2])).max() > surely
        or np.abs(every).max() > surely * spreads[2]
        or any(np.any(Runs.of(values).length > longest) for values in one.values)
    )


def repeating(masks: Sequence[np.ndarray], outputs: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Those runs of marked samples in which a value is repeated, per record.

    Parameters
    ----------
    masks : sequence of ndarray of bool (n_times, n_outputs)
    outputs : sequence of ndarray (n_times, n_outputs)
    """
    found = tuple(np.zeros_like(mask) for mask in masks)
    for one, mask, values in zip(found, masks, outputs, strict=True):
        for column in range(mask.shape[1]):
            for first, stop in runs_of(mask[:, column]):
                one[first:stop, column] = np.any(np.diff(values[first:stop, column]) == 0.0)
    return found


def settled(before: Sequence[np.ndarray], after: Sequence[np.ndarray]) -> bool:
    """Whether no more samples change sides than chance marks among those marked, anyway."""
    changed = sum(int(np.sum(a != b)) for a, b in zip(before, after, strict=True))
    return changed <= IMMATERIAL * sum(int(part.sum()) for part in after)


def robust_deviation(values: np.ndarray) -> float:
    """Standard deviation of normal numbers of mean zero, from the median of their sizes."""
    return NORMAL * float(np.median(np.abs(values)))


def spike_sizes(whitened: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """How far samples are from their neighbours, in the usual distance (its standard deviation).

    Parameters
    ----------
    whitened : sequence of ndarray (n_times, n_outputs)
        Residuals in any unit, NaN where missing.

    Returns
    -------
    tuple of ndarray (n_times, n_outputs)
        With the sign of the departure; NaN where missing.
    """

    def find(_: int, one: _Output) -> list[np.ndarray]:
        return [piece / one.usual if one.usual > 0 else 0.0 * piece for piece in one.away]

    return _by_output(whitened, find, np.nan)


def runs_of(marked: np.ndarray) -> Iterable[tuple[int, int]]:
    """First sample, and the one after the last, of every run of marked samples."""
    edges = np.flatnonzero(np.diff(np.r_[False, marked, False].astype(int)))
    return zip(edges[::2], edges[1::2], strict=True)


def _beside(values: np.ndarray) -> np.ndarray:
    """Departure of every sample from the median of its two neighbours on each side.

    Zero where the sample does not stand out from the next on either side by half as much: the
    edge of a step and one of a group are no spikes.
    """
    n = len(values)
    if n < 5:
        return np.zeros(n)
    # Reflected at the ends, so that every sample has four neighbours.
    padded = np.concatenate([values[2:0:-1], values, values[-2:-4:-1]])
    neighbours = np.stack([padded[shift : shift + n] for shift in (0, 1, 3, 4)])
    # The median of four is the mean of the middle two: the sum less both extremes.
    middle = neighbours.sum(axis=0) - neighbours.max(axis=0) - neighbours.min(axis=0)
    away = values - 0.5 * middle
    least = np.min((values - neighbours[1:3]) * np.sign(away), axis=0)
    grouped = (least < 0.5 * np.abs(away)) & (np.abs(away) > 3.0 * np.median(np.abs(away)))
    return np.where(grouped, 0.0, away)


def _off_cubic(values: np.ndarray) -> np.ndarray:
    """Departure of every sample from the cubic through its two neighbours on each side."""
    off = np.zeros(len(values))
    if len(values) >= 5:
        off[2:-2] = off_cubic(values)[:, 0]
    return off


def cubic_weights(length: int, side: int = 2) -> np.ndarray:
    """Share of each of the surrounding samples in the cubic, shape ``(length, 2 side)``.

    >>> print(cubic_weights(1) * 6.0)
    [[-1.  4.  4. -1.]]
    """
    at = np.append(np.arange(-side, 0), np.arange(length, length + side)).astype(float)
    powers = np.arange(4)
    inside = np.arange(length)[:, None] ** powers
    return np.round(inside @ np.linalg.pinv(at[:, None] ** powers), 12)


def off_cubic(values: np.ndarray, length: int = 1, side: int = 2) -> np.ndarray:
    """Departure of every group of samples from the cubic through some on each side of it.

    Returns
    -------
    ndarray (n - length - 2 side + 1, length)
        The first row is that of the group that begins after ``side`` samples.
    """
    windows = np.lib.stride_tricks.sliding_window_view(values, length + 2 * side)
    around = np.delete(windows, np.arange(side, side + length), axis=1)
    return np.asarray(windows[:, side : side + length] - around @ cubic_weights(length, side).T)


def without_spikes(dataset: Dataset, masks: Sequence[np.ndarray]) -> Dataset:
    """Copy of a data set in which the marked samples are missing."""
    pairs = zip(dataset, masks, strict=True)
    left = (one.with_outputs(np.where(mask, np.nan, one.outputs)) for one, mask in pairs)
    return Dataset(tuple(left))
