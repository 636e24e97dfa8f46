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
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

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
    if one.kind == "scale":
        # On the left by what the other signals predict: the noise of y is no part of it.
        fixed = {n: pivot(trace.values[n], trace.units[n]) for n in here}
        inner = sum(partials[n] * (series[n] - fixed[n]) for n in here)
        return 0.0, inner - (rate if left else 0.0)
    if one.kind == "delay":
        own_rate = -rate if relation.is_rate else -slopes.of(relation.target)
        return (own_rate if left else 0.0), -sum(partials[n] * slopes.of(n) for n in here)
    if one.kind == "lever":
        if one.other[0] not in series:
            return 0.0, 0.0
        return 0.0, sum(partials[n] * series[one.other[0]] for n in here)
    if one.kind == "misalignment":
        first, second = one.signals
        if first not in series or second not in series:
            return 0.0, 0.0
        change = partials.get(second, 0.0) * series[first]
        return 0.0, change - partials.get(first, 0.0) * series[second]
    # A drift: the position moves although no velocity says so.
    return (trace.times - trace.times[0] if left else 0.0), 0.0


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
