r"""What is left of every equation, in blocks, and how each possible fault would show in it.

For :math:`\dot y = f(s)` the residual of a record is :math:`e(t) = y(t) - c - \int f(s)\,dt`. A
fault :math:`\varphi` of a measured signal changes it by, to first order,

===================  =====================================  ==========================
fault of ``s``       ``s`` measured                         change of the residual
===================  =====================================  ==========================
bias                 :math:`s + \varphi`                    :math:`-\int f_s`
scale                :math:`(1 + \varphi) s`                :math:`-\int f_s s`
delay                :math:`s(t - \varphi)`                 :math:`+\int f_s \dot s`
lever arm            :math:`s + \varphi\,\omega`            :math:`-\int f_s \omega`
misalignment         :math:`s_1 - \varphi s_2`,             :math:`-\int (f_2 s_1 - f_1 s_2)`
                     :math:`s_2 + \varphi s_1`
===================  =====================================  ==========================

and by :math:`\int f` (scale), :math:`-\dot y` (delay) or :math:`t` (drift) where the signal
stands on the left. Integrals are those of cubic Hermite splines.

Noise of what is left of an equation, and its likelihood.

The residual of :math:`\dot y = f(s)` over blocks of samples is

.. math:: e_i = y_i - c - \int^{t_i} f(s)\,dt = a_i + b_i,

the noise :math:`a` of the signal itself, perhaps correlated from block to block, and the
integrated noise :math:`b` of the rates, a random walk whose steps may be correlated too. Whichever
of them is coloured, the first difference has the spectrum of an ARMA(1, 1) process to good
approximation (exactly if :math:`a` is white or first-order and the steps of :math:`b` are white, or
both share one correlation; Box, Jenkins & Reinsel 2008, section 4.3.3), and whitening is one
recursive filter: with the backward shift :math:`B`,

.. math:: (1 - \rho B)(1 - B)\,e = \sigma\,(1 - \vartheta B)\,\varepsilon .

:math:`\vartheta \to 1` is white noise of the signal alone, :math:`\vartheta = \rho` a random walk,
:math:`\vartheta < \rho` one with correlated steps. In the long run the walk gains the variance
:math:`\sigma^2 (1 - \vartheta)^2 / (1 - \rho)^2` a block, which is not taken below what the fast
noise of the rates makes: a smaller one would turn noise into biases.

Level and coefficients are those of largest restricted likelihood (Patterson & Thompson 1971),
with every fault that could be there among the regressors, so that no fault passes as noise.

Which continuous faults a log has: forward selection with exchange and drop.

A set :math:`S` of faults gains :math:`b_S^T (G_{SS} + P_S^{-1})^{-1} b_S`, with normal equations
:math:`G, b` and the squares of plausible sizes on the diagonal of :math:`P`. A fault enters if it
gains more than its limit and is of a size that matters.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_banded

from oed_sysid.evidence.corrections import pivot
from oed_sysid.evidence.relations import Relation
from oed_sysid.evidence.traces import Trace

MOST_BLOCKS = 240
LEAST_BLOCKS = 12
# Window, in samples, of the smoothing before a signal without an equation is differentiated.
SMOOTHING = 9


@dataclass(frozen=True)
class Candidate:
    """A continuous fault that a log may have.

    Parameters
    ----------
    kind : str
        ``bias``, ``scale``, ``delay``, ``lever``, ``misalignment`` or ``drift``.
    signals : tuple of str
        Signals that it acts on.
    other : tuple of str
        The rate, for a lever arm.
    unit : str
        Of the size.
    plausible, material : float
        Usual size, and the least that matters.
    record : str
        The only record that it acts in; empty for all of them.
    """

    kind: str
    signals: tuple[str, ...]
    unit: str
    plausible: float
    material: float
    other: tuple[str, ...] = ()
    record: str = ""


@dataclass(frozen=True)
class Stretch:
    """Residual and regressors of one equation over one uninterrupted piece of a record.

    ``residual`` is ``(n_blocks,)``, ``columns`` ``(n_blocks, n_candidates)``, ``walk`` the
    variance per block that the known noise of the integrated signals produces, ``level`` that of
    the left side, ``shares`` the part of each signal in ``walk``.
    """

    relation: int
    record: str
    times: np.ndarray
    residual: np.ndarray
    columns: np.ndarray
    walk: float
    level: float
    shares: dict[str, float]

    def times_factor(self, factor: float) -> Stretch:
        """Return the stretch in a unit that is ``1/factor`` as large."""
        return replace(
            self,
            residual=factor * self.residual,
            columns=factor * self.columns,
            walk=factor**2 * self.walk,
        )


def integral(times: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Cumulative integral of cubic Hermite splines through ``(n, k)`` samples; first row zero.

    Examples
    --------
    >>> t = np.linspace(0.0, 3.0, 31)
    >>> print(round(float(integral(t, np.cos(t)[:, None])[-1, 0] / np.sin(3.0)), 6))
    0.999996
    """
    steps = np.diff(times)[:, None]
    slopes = np.gradient(columns, times, axis=0)
    parts = 0.5 * steps * (columns[1:] + columns[:-1]) - steps**2 / 12.0 * np.diff(slopes, axis=0)
    return np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(parts, axis=0)])


def stretches(
    trace: Trace,
    relations: tuple[Relation, ...],
    candidates: tuple[Candidate, ...],
    factors: Mapping[str, float] | None = None,
) -> list[Stretch]:
    """Residuals and regressors of all equations in one record.

    ``factors`` are the scales that were undone, by signal: the residual of an equation is taken
    in the unit that its left side was logged in, or shrinking a signal would shrink its noise.
    """
    slopes = _Slopes(trace, relations)
    result: list[Stretch] = []
    for index, relation in enumerate(relations):
        if any(name not in trace.values for name in (relation.target, *relation.signals)):
            continue
        needed = {*relation.signals, *(n for c in candidates for n in (*c.signals, *c.other))}
        series, usable = trace.filled(relation.signals)
        if not series:
            continue
        more, _ = trace.filled(n for n in needed if n in trace.values and n not in series)
        found = _of_relation(trace, index, relation, {**more, **series}, usable, candidates, slopes)
        factor = (factors or {}).get(relation.target, 1.0)
        result += [part.times_factor(factor) if factor != 1.0 else part for part in found]
    return result


def _of_relation(
    trace: Trace,
    index: int,
    relation: Relation,
    series: dict[str, np.ndarray],
    usable: np.ndarray,
    candidates: tuple[Candidate, ...],
    slopes: _Slopes,
) -> Iterable[Stretch]:
    times, target = trace.times, trace.values[relation.target]
    inner = {name: series[name] for name in relation.signals}
    rate = relation(inner, times)
    partials = {name: partial(relation, inner, times, name) for name in relation.signals}
    direct = np.zeros((times.size, len(candidates)))
    under = np.zeros((times.size, len(candidates)))
    for k, one in enumerate(candidates):
        direct[:, k], under[:, k] = _columns(one, relation, trace, series, partials, rate, slopes)
    for piece in trace.pieces(usable, LEAST_BLOCKS):
        rows = np.flatnonzero(np.isfinite(target[piece])) + piece.start
        group = -(-rows.size // MOST_BLOCKS)
        n = rows.size // group if group else 0
        if n < LEAST_BLOCKS:
            continue
        if relation.is_rate:
            inside = integral(times[piece], np.column_stack([rate[piece], under[piece]]))
        else:
            inside = np.column_stack([rate[piece], under[piece]])
        used = rows[: n * group]
        inside = inside[used - piece.start]
        whole = np.column_stack([times[used], target[used] - inside[:, 0]])
        whole = np.column_stack([whole, direct[used] - inside[:, 1:]])
        means = whole.reshape(n, group, -1).mean(axis=1)
        span = float(np.median(np.diff(means[:, 0])))
        power = {
            name: float(np.mean(partials[name][piece] ** 2))
            * trace.noise[name] ** 2
            * _spacing(trace, name)
            for name in relation.signals
        }
        total = sum(power.values())
        yield Stretch(
            index,
            trace.name,
            means[:, 0],
            means[:, 1],
            means[:, 2:],
            walk=total * span if relation.is_rate else 0.0,
            level=trace.noise[relation.target] / np.sqrt(group),
            shares={name: p / total if total else 0.0 for name, p in power.items()},
        )


def _spacing(trace: Trace, name: str) -> float:
    """Median time between samples of a signal, s."""
    present = trace.times[np.isfinite(trace.values[name])]
    return float(np.median(np.diff(present)))


def partial(
    relation: Relation, series: dict[str, np.ndarray], times: np.ndarray, name: str
) -> np.ndarray:
    """Derivative of a right side by one signal, by central differences, ``(n_times,)``."""
    h = 1e-4 * (float(np.std(series[name])) + 1e-3)
    up = relation({**series, name: series[name] + h}, times)
    return (up - relation({**series, name: series[name] - h}, times)) / (2.0 * h)


def _columns(
    one: Candidate,
    relation: Relation,
    trace: Trace,
    series: dict[str, np.ndarray],
    partials: dict[str, np.ndarray],
    rate: np.ndarray,
    slopes: _Slopes,
) -> tuple[np.ndarray | float, np.ndarray | float]:
    """What a unit of a fault adds to the left side, and to the integrand."""
    if one.record not in ("", trace.name):
        return 0.0, 0.0
    here = [name for name in one.signals if name in partials]
    left = relation.target in one.signals
    if one.kind == "bias":
        is_value = left and not relation.is_rate
        return (1.0 if is_value else 0.0), sum(partials[n] for n in here)
    if one.kind in ("lever", "misalignment"):
        return 0.0, _geometric(one, series, partials)
    if one.kind == "scale":
        # On the left by what the other signals predict: the noise of y is no part of it.
        fixed = {n: pivot(trace.values[n], trace.units[n]) for n in here}
        inner = sum(partials[n] * (series[n] - fixed[n]) for n in here)
        return 0.0, inner - (rate if left else 0.0)
    if one.kind == "delay":
        own_rate = -rate if relation.is_rate else -slopes.of(relation.target)
        return (own_rate if left else 0.0), -sum(partials[n] * slopes.of(n) for n in here)
    # A drift: the position moves although no velocity says so.
    return (trace.times - trace.times[0] if left else 0.0), 0.0


def _geometric(
    one: Candidate, series: dict[str, np.ndarray], partials: dict[str, np.ndarray]
) -> np.ndarray | float:
    """What a metre of a lever arm, or a radian of misalignment, adds to the integrand."""
    if any(name not in series for name in one.other or one.signals):
        return 0.0
    if one.kind == "lever":
        return sum(partials[n] * series[one.other[0]] for n in one.signals if n in partials)
    first, second = one.signals
    change = partials.get(second, 0.0) * series[first]
    return change - partials.get(first, 0.0) * series[second]


class _Slopes:
    """Rates of signals in one record: from their equation, or else by smoothed differences."""

    def __init__(self, trace: Trace, relations: tuple[Relation, ...]) -> None:
        self._trace = trace
        self._relations = {r.target: r for r in relations if r.is_rate}
        self._known: dict[str, np.ndarray] = {}

    def of(self, name: str) -> np.ndarray:
        """Rate of a signal, shape ``(n_times,)``."""
        if name not in self._known:
            self._known[name] = self._find(name)
        return self._known[name]

    def _find(self, name: str) -> np.ndarray:
        trace, relation = self._trace, self._relations.get(name)
        if relation is not None and all(n in trace.values for n in relation.signals):
            series, _ = trace.filled(relation.signals)
            if series:
                return relation(series, trace.times)
        series, _ = trace.filled((name,))
        if not series:
            return np.zeros(trace.times.size)
        window = np.hanning(SMOOTHING + 2)[1:-1]
        half = SMOOTHING // 2
        padded = np.pad(series[name], half, mode="reflect", reflect_type="odd")
        smooth = np.convolve(padded, window / window.sum(), mode="valid")
        return np.gradient(smooth, trace.times)


CORRELATIONS = (0.0, 0.3, 0.6, 0.8, 0.92)
# One minus the moving-average coefficient.
AVERAGES = (0.001, 0.004, 0.015, 0.05, 0.12, 0.25, 0.45, 0.7, 1.0, 1.25)
MOST_LASTING = 0.985
# Halvings of the grid's steps around its best point.
REFINEMENTS = 3


@dataclass(frozen=True)
class Colour:
    r"""Noise of one equation.

    Parameters
    ----------
    level : float
        Standard deviation of an innovation.
    correlation, average : float
        Coefficients of the filter, :math:`\rho` and :math:`\vartheta`.
    """

    level: float
    correlation: float
    average: float

    @property
    def walk_variance(self) -> float:
        """Variance that the residual gains per block in the long run."""
        return (self.level * (1.0 - self.average) / (1.0 - self.correlation)) ** 2

    @property
    def walk_share(self) -> float:
        """Share of the whitened residual's power that the noise of the rates makes."""
        theta, rho = self.average, self.correlation
        if theta < rho:
            return min((1.0 - theta) / (1.0 + theta), 1.0)
        power = 1.0 + (theta - rho) ** 2 / (1.0 - theta**2)
        return min(power * ((1.0 - theta) / (1.0 - rho)) ** 2, 1.0)

    def whiten(self, columns: np.ndarray) -> np.ndarray:
        """Filter a stretch of residuals or regressors, shape ``(n_blocks, n_columns)``."""
        return _filtered(columns, self.correlation, self.average) / self.level


def _filtered(columns: np.ndarray, correlation: float, average: float) -> np.ndarray:
    steps = np.diff(columns, axis=0, prepend=np.zeros((1, columns.shape[1])))
    return _recursion(steps, correlation, average)


def _recursion(steps: np.ndarray, correlation: float, average: float) -> np.ndarray:
    """Filter first differences, shape ``(n_blocks, n_columns)``."""
    moved = steps.copy()
    moved[1:] -= correlation * steps[:-1]
    # y_k - average y_{k-1} = moved_k as a banded system: scipy.signal takes a second to import.
    bands = np.ones((2, len(steps)))
    bands[1] = -average
    return solve_banded((1, 0), bands, moved)


def estimate(
    stretches: list[np.ndarray],
    least_walk: float,
    least_level: float,
    start: Colour | None = None,
) -> Colour:
    r"""Noise of largest restricted likelihood.

    Parameters
    ----------
    stretches : list of ndarray (n_blocks, 1 + n_columns)
        For each uninterrupted stretch the residual, then its regressors. A free constant for
        each stretch is added.
    least_walk : float
        Variance per block that the known noise of the integrated signals alone produces; the
        walk is not taken below it.
    least_level : float
        Least ``level``.
    start : Colour, optional
        Where to look first, instead of everywhere.
    """
    scale = np.sqrt(sum(np.sum(np.diff(part, axis=0) ** 2, axis=0) for part in stretches)) + 1e-300
    scale[0] = 1.0
    parts = [
        np.diff(np.column_stack([part / scale, np.ones(len(part))]), axis=0, prepend=0.0)
        for part in stretches
    ]
    known: dict[tuple[float, float], tuple[float, float]] = {}

    def cost(correlation: float, rest: float) -> tuple[float, float]:
        key = (correlation, rest)
        if key not in known:
            known[key] = _cost(parts, correlation, 1.0 - rest, least_walk, least_level)
        return known[key]

    if start is None:
        grid = ((r, m) for r in CORRELATIONS for m in AVERAGES)
        best = min(grid, key=lambda point: cost(*point)[0])
    else:
        best = (start.correlation, 1.0 - start.average)
    for k in range(REFINEMENTS):
        width, factor = 0.1 / 2**k, 1.6 ** (0.5**k)
        around = [
            (min(max(best[0] + i * width, 0.0), MOST_LASTING), min(best[1] * factor**j, 1.4))
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        best = min(around, key=lambda point: cost(*point)[0])
    return Colour(cost(*best)[1], best[0], 1.0 - best[1])


def _cost(
    parts: list[np.ndarray],
    correlation: float,
    average: float,
    least_walk: float,
    least_level: float,
) -> tuple[float, float]:
    """Minus twice the restricted log-likelihood, and the level that it is taken at.

    ``parts`` are first differences: residual, regressors, and the constant.
    """
    n_columns = parts[0].shape[1] - 1
    gram = np.zeros((n_columns, n_columns))
    n, n_constants, logarithms = 0, 0, 0.0
    for part in parts:
        white = _recursion(part, correlation, average)
        constant = white[:, -1]
        power = float(constant @ constant)
        rest = white[:, :-1] - np.outer(constant, constant @ white[:, :-1] / power)
        gram += rest.T @ rest
        n += len(part)
        n_constants += 1
        logarithms += np.log(power)
    inner = gram[1:, 1:] + 1e-9 * np.eye(n_columns - 1) * (np.trace(gram[1:, 1:]) + 1e-300)
    solved = np.linalg.solve(inner, gram[1:, 0]) if n_columns > 1 else np.zeros(0)
    rest_power = max(float(gram[0, 0] - gram[1:, 0] @ solved), 1e-300)
    freedom = max(n - n_constants - (n_columns - 1), 1)
    level = np.sqrt(rest_power / freedom)
    least = np.sqrt(least_walk) * (1.0 - correlation) / (1.0 - average)
    level = max(level, least, least_level)
    cost = freedom * 2.0 * np.log(level) + rest_power / level**2
    cost += logarithms + (np.linalg.slogdet(inner)[1] if n_columns > 1 else 0.0)
    return float(cost), float(level)


MOST_FAULTS = 5
# A rival has to be of a size that such faults have.
LARGEST = 4.0
# A size has to exceed this multiple of what noise in its regressor may have made.
DOUBT = 1.5
# What linearisation leaves of a large fault: a further one has to gain this share of it.
SHARE = 1e-3


def ridge(faults: tuple[Candidate, ...], chosen: Sequence[int]) -> np.ndarray:
    """What plausible sizes add to the normal equations, ``(n_chosen, n_chosen)``."""
    return np.diag([faults[k].plausible ** -2.0 for k in chosen])


def solve(
    gram: np.ndarray, right: np.ndarray, faults: tuple[Candidate, ...], chosen: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of chosen faults and their standard deviations."""
    inner = gram[np.ix_(chosen, chosen)] + ridge(faults, chosen)
    inverse = np.linalg.inv(inner)
    return inverse @ right[list(chosen)], np.sqrt(inverse.diagonal())


def gain_of(
    gram: np.ndarray, right: np.ndarray, faults: tuple[Candidate, ...], chosen: Sequence[int]
) -> float:
    """Likelihood-ratio statistic of a set of faults."""
    if not chosen:
        return 0.0
    inner = gram[np.ix_(chosen, chosen)] + ridge(faults, chosen)
    return float(right[list(chosen)] @ np.linalg.solve(inner, right[list(chosen)]))


@dataclass(frozen=True)
class _Selection:
    """Faults that may be chosen, and what each has to gain and to be worth."""

    gram: np.ndarray
    right: np.ndarray
    faults: tuple[Candidate, ...]
    limits: np.ndarray
    doubt: np.ndarray

    def gain(self, chosen: list[int]) -> float:
        """Gain of a set."""
        return gain_of(self.gram, self.right, self.faults, chosen)

    def price(self, fault: int, gain: float) -> float:
        """What one has to gain in a set of this gain."""
        return max(self.limits[fault], SHARE * gain)

    def with_each(self, chosen: list[int], rest: list[int]) -> list[tuple[float, int]]:
        """Gain of ``rest`` and one more that is material there and not chosen, and which."""
        able = (k for k in range(len(self.faults)) if self.gram[k, k] > 0.0 and k not in chosen)
        return [
            (self.gain([*rest, k]), k)
            for k in able
            if is_material(self.gram, self.right, self.doubt, self.faults, [*rest, k])
        ]

    def added(self, chosen: list[int]) -> list[int]:
        """The set with the one that gains most beyond its price, if any."""
        if len(chosen) >= MOST_FAULTS:
            return chosen
        gain = self.gain(chosen)
        trials = [
            (new - gain - self.price(k, gain), k) for new, k in self.with_each(chosen, chosen)
        ]
        return [*chosen, max(trials)[1]] if trials and max(trials)[0] > 0.0 else chosen

    def exchanged(self, chosen: list[int]) -> list[int]:
        """The set with each replaced in turn by what gains clearly more in its place."""
        for position in range(len(chosen)):
            gain = self.gain(chosen)
            rest = chosen[:position] + chosen[position + 1 :]
            swaps = self.with_each(chosen, rest)
            if swaps and max(swaps)[0] > gain + 1.0:
                chosen = [*rest, max(swaps)[1]]
        return chosen

    def pruned(self, chosen: list[int]) -> list[int]:
        """The set without those, the worst first, that do not pay or are immaterial."""
        chosen = list(chosen)
        while chosen:
            gain = self.gain(chosen)
            without = {k: [j for j in chosen if j != k] for k in chosen}
            losses = [(gain - self.gain(without[k]) - self.price(k, gain), k) for k in chosen]
            small = [
                k
                for k in chosen
                if not is_material(self.gram, self.right, self.doubt, self.faults, [*without[k], k])
            ]
            worst = min(losses)
            if worst[0] < 0.0:
                chosen.remove(worst[1])
            elif small:
                chosen.remove(small[0])
            else:
                break
        return chosen


def select(
    gram: np.ndarray,
    right: np.ndarray,
    faults: tuple[Candidate, ...],
    limits: np.ndarray,
    doubt: np.ndarray,
    start: list[int],
) -> list[int]:
    """Forward selection with exchange and drop."""
    bench = _Selection(gram, right, faults, limits, doubt)
    chosen = [k for k in start if gram[k, k] > 0.0]
    seen: set[frozenset[int]] = set()
    while frozenset(chosen) not in seen:
        # A set that comes back means that adding and dropping take turns.
        seen.add(frozenset(chosen))
        chosen = bench.pruned(bench.exchanged(bench.added(chosen)))
    return chosen


def is_material(
    gram: np.ndarray,
    right: np.ndarray,
    doubt: np.ndarray,
    faults: tuple[Candidate, ...],
    chosen: list[int],
) -> bool:
    """Whether the last of the chosen faults is large enough to matter, and not absurd."""
    sizes, std = solve(gram, right, faults, chosen)
    last = faults[chosen[-1]]
    least = last.material + DOUBT * float(std[-1]) ** 2 * doubt[chosen[-1]]
    return least <= abs(float(sizes[-1])) <= LARGEST * last.plausible
