r"""Undoing what was found, in a trace or in a copy of a record.

Corrected copies of records: what was found is undone, and said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.relations import Relation, names_of, relations
from oed_sysid.evidence.result import Correction, Finding, LogCheck, is_a
from oed_sysid.evidence.sentences import say
from oed_sysid.evidence.traces import Trace
from oed_sysid.experiments.problem import Problem
from oed_sysid.likelihood.noise_levels import first_order
from oed_sysid.physics.model import Model

# What happened last on the way from the vehicle to the log is undone first.
ORDER = (
    "blank", "step", "burst", "swap", "sign", "unit", "offset", "frame", "delay", "lag", "rate",
    "bias", "scale", "lost", "misalignment", "lever", "drift",
)  # fmt: skip


def undo(
    trace: Trace, corrections: Iterable[Correction], relations: tuple[Relation, ...] = ()
) -> Trace:
    """Return a trace without the faults; ``relations`` are needed to turn frames only."""
    for one in sorted(corrections, key=lambda c: ORDER.index(c.kind)):
        here = one.record in ("", trace.name)
        if here and all(name in trace.values for name in (*one.signals, *one.other)):
            values = trace.values | _undone(trace, one, relations)
            trace = replace(trace, values=values, noise=trace.noise | _noise(trace.noise, one))
    return trace


def _noise(noise: dict[str, float], one: Correction) -> dict[str, float]:
    """Noise levels that a correction changes."""
    levels = [noise[name] for name in one.signals] if one.kind in ("unit", "swap", "frame") else []
    if one.kind == "unit":
        levels = [abs(one.value) * level for level in levels]
    elif one.kind == "swap":
        levels.reverse()
    elif levels:
        levels = [float(np.mean(levels))] * len(levels)
    return dict(zip(one.signals, levels, strict=False))


def corrected(
    dataset: Dataset, corrections: Iterable[Correction], relations: tuple[Relation, ...] = ()
) -> Dataset:
    """Return copies of records without the faults; signals outside the outputs are left alone."""
    chosen = tuple(corrections)
    records = []
    for record in dataset:
        trace = undo(Trace.of(record, {}), chosen, relations)
        columns = [
            trace.values.get(name, np.full(record.n_samples, np.nan))
            for name in record.channels.output_names
        ]
        names, inputs = record.channels.input_names, np.array(record.inputs)
        for one in chosen:
            if one.kind in ("sign", "unit"):
                inputs[:, [names.index(name) for name in one.signals if name in names]] *= one.value
        records.append(replace(record.with_outputs(np.column_stack(columns)), inputs=inputs))
    return Dataset(tuple(records))


def pivot(series: np.ndarray, unit: str) -> float:
    """Value that a relative error leaves alone: zero, or the mean of a heading."""
    # An angle that stays within a quarter turn is scaled about zero, a heading about its mean.
    if unit != "rad" or np.nanmax(np.abs(series)) < np.pi / 2:
        return 0.0
    return float(np.nanmean(series))


def shifted(times: np.ndarray, series: np.ndarray, delay: float | np.ndarray) -> np.ndarray:
    """Series that was logged ``delay`` seconds late, at the times of the others; NaN outside."""
    present = np.isfinite(series)
    moved = np.interp(times + delay, times[present], series[present], left=np.nan, right=np.nan)
    return np.where(present, moved, np.nan)


def lagged(times: np.ndarray, series: np.ndarray, lag: float) -> np.ndarray:
    r"""Answer of first order to a signal, :math:`T \dot a = s - a`; ahead of it where ``lag < 0``.

    Examples
    --------
    >>> t = np.arange(0.0, 10.0, 0.01)
    >>> print(lagged(t, 1.0 * (t > 0.0), 2.0)[200].round(2))
    0.63
    """
    present = np.isfinite(series)
    whole = np.interp(times, times[present], series[present])  # a filter remembers what is missing
    # The mean delay is the lag, whatever the step.
    step = float(np.median(np.diff(times)))
    answer = (
        first_order(whole, step / (lag + step))
        if lag > 0.0
        else whole - lag * np.gradient(whole, times)
    )
    return np.where(present, answer, np.nan)


def _undone(
    trace: Trace, one: Correction, relations: tuple[Relation, ...]
) -> dict[str, np.ndarray]:
    """Signals that a correction changes."""
    if one.kind == "frame":
        return body_axes(trace, one.signals, relations)
    if one.kind not in ("swap", "misalignment"):
        kept = {logged(n): trace.values[n] for n in one.signals} if one.kind == "lost" else {}
        return kept | trace.values | {name: _mended(trace, name, one) for name in one.signals}
    first, second = one.signals
    if one.kind == "swap":
        return {first: trace.values[second], second: trace.values[first]}
    # Where only one of them has a sample the other is what lies between its own.
    x, y = trace.filled(one.signals).values()
    cos, sin = np.cos(one.value), np.sin(one.value)
    turned = {first: cos * x + sin * y, second: cos * y - sin * x}
    return {n: np.where(np.isfinite(trace.values[n]), turned[n], np.nan) for n in one.signals}


def share_of(since: np.ndarray) -> np.ndarray:
    """Times since the beginning of a record as shares of its length, ``(n_times,)``."""
    return since / max(since[-1], 1e-300)


def logged(name: str) -> str:
    """Name of an input as it was before its loss was undone: what is lost is a share of that."""
    return f"{name} as logged"


# What a unit of a fault adds to a signal ``(n_times,)``: from the fault (its other signals and its
# span), the signals and the time since the beginning of the record in s.
ADDED: dict[str, Callable[[Any, Mapping[str, np.ndarray], np.ndarray], np.ndarray]] = {
    "bias": lambda one, values, since: np.ones_like(since),
    "drift": lambda one, values, since: np.maximum(since - one.span[0] * since[-1], 0.0),
    "lost": lambda one, values, since: (
        values.get(logged(one.signals[0]), values[one.signals[0]])
        * (share_of(since) >= one.span[0])
    ),
    "lever": lambda one, values, since: values[one.other[0]],
    "step": lambda one, values, since: 1.0 * (share_of(since) >= one.span[0]),
    "burst": lambda one, values, since: (
        1.0 * (share_of(since) >= one.span[0]) * (share_of(since) < one.span[1])
    ),
}


def _mended(trace: Trace, name: str, one: Correction) -> np.ndarray:
    """One signal without a fault that concerns it alone."""
    series, times, size = trace.values[name], trace.times, one.value
    since, index = times - times[0], np.arange(times.size)
    rows = one.rows.get(trace.name, ())
    if one.rows and one.kind == "step":
        jumps = zip(rows, one.sizes.get(trace.name, ()), strict=False)
        return series - sum((s * (index >= row) for row, s in jumps), 0.0 * since)
    if one.kind in ADDED:
        whole = trace.values | trace.filled(one.other)
        return series - size * ADDED[one.kind](one, whole, since)
    ways: dict[str, Callable[[], np.ndarray]] = {
        "scale": lambda: (series + size * pivot(series, trace.units[name])) / (1.0 + size),
        "blank": lambda: np.where(np.isin(index, rows), np.nan, series),
        "delay": lambda: shifted(times, series, size),
        "lag": lambda: lagged(times, series, size),
        "rate": lambda: shifted(times, series, size * since),
        "sign": lambda: size * series,
        "unit": lambda: size * series,
        "offset": lambda: series + size,
    }
    return ways.get(one.kind, lambda: series)()


def body_axes(
    trace: Trace, velocities: tuple[str, ...], relations: tuple[Relation, ...]
) -> dict[str, np.ndarray]:
    r"""Velocities along the axes of the positions, turned into body axes.

    With :math:`\dot P_i = \sum_j J_{ij}(\text{angles})\, v_j` and :math:`J = I` at level
    attitude, the logged signals are :math:`m_j = \dot P_j`, and :math:`v = J^{-1} m`; a
    direction without a position of its own is completed by orthogonality.
    """
    values, times = trace.values, trace.times
    whole = trace.filled(name for name in names_of(relations) if name in values)
    n = len(velocities)
    matrix, absent = np.zeros((times.size, n, n)), set(range(n))
    for relation in relations:
        place = level_axis(relation, trace.units, velocities)
        if place is not None:
            row = velocities.index(place)
            absent.discard(row)
            here = {name: whole.get(name, np.zeros(times.size)) for name in relation.signals}
            for column, name in enumerate(velocities):
                if name in here:
                    matrix[:, row, column] = relation.slope(here, times, name)
    if absent and (n, len(absent)) != (2, 1):
        return {}
    for row in absent:
        other = matrix[:, 1 - row]
        matrix[:, row, row], matrix[:, row, 1 - row] = other[:, 1 - row], -other[:, row]
    logged = np.column_stack([values[name] for name in velocities])
    ok = np.isfinite(matrix).all(axis=(1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(matrix))) > 0.1)
    body = np.full_like(logged, np.nan)
    body[ok] = np.linalg.solve(matrix[ok], logged[ok][:, :, None])[:, :, 0]
    return {name: body[:, i] for i, name in enumerate(velocities)}


def level_axis(
    relation: Relation, units: Mapping[str, str], velocities: tuple[str, ...]
) -> str | None:
    """Velocity that the rate of a position equals at level attitude; None if there is none."""
    if not relation.is_rate or units.get(relation.target) != "m":
        return None
    shares = {name: relation.level(name) for name in relation.signals if name in velocities}
    found = [name for name, share in shares.items() if abs(share) > 1e-9]
    return found[0] if len(found) == 1 and abs(shares[found[0]] - 1.0) < 1e-6 else None


def corrected_copies(
    dataset: Dataset, problem: Problem | Model, found: LogCheck
) -> tuple[Dataset, tuple[str, ...]]:
    """Return copies of records with the findings undone, and what was done in sentences.

    Bad samples become missing ones; faults with several explanations are undone by the first of
    them. Records that a finding calls a copy, clocks and currents are left as they are, and a
    sensor that is dead in a record counts as not measured there. Where an equation stays
    unexplained with the findings undone, only the bad samples are left out: signs, units and sizes
    that make the rest agree a little better may answer the wrong question
    (:func:`why_not_more`).

    Parameters
    ----------
    dataset : Dataset
        The records that were checked.
    problem : Problem or Model
        As given to :func:`~oed_sysid.evidence.check`.
    found : LogCheck
        Its result.

    Returns
    -------
    copies : Dataset
    done : tuple of str

    Examples
    --------
    Of a log, the problem that says what its signals are, and what its check found::

        copies, done = corrected_copies(dataset, problem, check(dataset, problem))
    """
    model = problem.model if isinstance(problem, Problem) else problem
    mine = {*dataset.channels.output_names, *dataset.channels.input_names}
    doubtful = found.named("unexplained") is not None
    undone, done = list[Correction](), list[str]()
    for fix, one in _undoable(found):
        if set(fix.signals) <= mine and (fix.kind == "blank" or not doubtful):
            undone.append(fix)
            done.append(one.says)
    if not undone:
        return dataset, ()
    return corrected(dataset, undone, relations(model)), tuple(done)


def as_measured(dataset: Dataset, found: LogCheck) -> tuple[Dataset, tuple[str, ...]]:
    """Return records with only the samples that were measured, and what was left out in sentences.

    A value that is held for ten samples is one measurement, and a straight line between two is two:
    counted as what the log shows, they make errors too small by the root of their number. Held
    values are also late by half of the time that they are held. The first sample of each, and the
    ends of each line, are kept; the others become empty.

    Parameters
    ----------
    dataset : Dataset
        The records that were checked, or some of them.
    found : LogCheck
        Result of :func:`~oed_sysid.evidence.check`.

    Returns
    -------
    records : Dataset
    left_out : tuple of str
    """
    here = {*dataset.names}
    told = ((fix, one) for fix, one in _undoable(found) if is_a(one.kind, "made"))
    made = [(fix, one) for fix, one in told if here & {*one.records}]
    if not made:
        return dataset, ()
    facts = ({"names": ", ".join(one.signals), "size": one.size} for _, one in made)
    words = tuple(say("log", "measured", **each) for each in facts)
    return corrected(dataset, [fix for fix, _ in made]), words


def _undoable(found: LogCheck) -> Iterable[tuple[Correction, Finding]]:
    """Corrections that a copy may get, and the findings that they undo."""
    for one in found.findings:
        if one.correction is not None and not is_a(one.kind, "left alone"):
            yield one.correction, one


def why_not_more(found: LogCheck) -> str:
    """Return why faults that were found are not undone in the copies; empty if they are.

    Parameters
    ----------
    found : LogCheck
        Result of :func:`~oed_sysid.evidence.check`.

    Returns
    -------
    str
        Empty where they are undone.

    Examples
    --------
    >>> why_not_more(LogCheck((), ("run_1",)))
    ''
    """
    still = found.named("unexplained")
    if still is None:
        return ""
    left = [one.name for fix, one in _undoable(found) if fix.kind != "blank"]
    what = f"{', '.join(left)} is left as logged" if left else "nothing but bad samples is changed"
    size = 100.0 * (still.size or 0.0)
    return say("log", "doubtful", what=what, target=still.signals[0], left=size)
