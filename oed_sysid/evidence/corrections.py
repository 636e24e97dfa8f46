r"""Undoing what was found, in a trace or in a copy of a record.

Corrected copies of records: what was found is undone, and said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.evidence.relations import Relation, relations
from oed_sysid.evidence.result import Correction, LogCheck
from oed_sysid.evidence.traces import Trace
from oed_sysid.experiments.problem import Problem
from oed_sysid.physics.model import Model

# What happened last on the way from the vehicle to the log is undone first.
ORDER = (
    "blank", "step", "burst", "swap", "sign", "unit", "offset", "frame", "delay", "rate", "bias",
    "scale",
    "misalignment", "lever", "drift",
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
    first, last = one.signals[0], one.signals[-1]
    if one.kind == "unit":
        return {name: abs(one.value) * noise[name] for name in one.signals}
    if one.kind == "swap":
        return {first: noise[last], last: noise[first]}
    if one.kind == "frame":
        return dict.fromkeys(one.signals, float(np.mean([noise[name] for name in one.signals])))
    return {}


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
        records.append(record.with_outputs(np.column_stack(columns)))
    return Dataset(tuple(_with_inputs(record, chosen) for record in records))


def _with_inputs(record: Record, corrections: tuple[Correction, ...]) -> Record:
    names = record.channels.input_names
    inputs = np.array(record.inputs)
    for one in corrections:
        for name in one.signals:
            if name in names and one.kind in ("sign", "unit"):
                inputs[:, names.index(name)] *= one.value
    return replace(record, inputs=inputs)


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


def _undone(
    trace: Trace, one: Correction, relations: tuple[Relation, ...]
) -> dict[str, np.ndarray]:
    """Signals that a correction changes."""
    if one.kind == "frame":
        return body_axes(trace, one.signals, relations)
    if one.kind not in ("swap", "misalignment"):
        return {name: _mended(trace, name, one) for name in one.signals}
    first, second = one.signals
    x, y = trace.values[first], trace.values[second]
    if one.kind == "swap":
        return {first: y, second: x}
    cos, sin = np.cos(one.value), np.sin(one.value)
    return {first: cos * x + sin * y, second: cos * y - sin * x}


def _mended(trace: Trace, name: str, one: Correction) -> np.ndarray:
    """One signal without a fault that concerns it alone."""
    series, times, size = trace.values[name], trace.times, one.value
    since, index = times - times[0], np.arange(times.size)
    rows, sizes = one.rows.get(trace.name, ()), one.sizes.get(trace.name, ())
    share, (begin, end) = since / max(since[-1], 1e-300), one.span
    jumps = sum((s * (index >= row) for row, s in zip(rows, sizes, strict=False)), 0.0 * since)
    ways: dict[str, Callable[[], np.ndarray]] = {
        "scale": lambda: (series + size * pivot(series, trace.units[name])) / (1.0 + size),
        "blank": lambda: np.where(np.isin(index, rows), np.nan, series),
        "step": lambda: series - (jumps if one.rows else size * (share >= begin)),
        "burst": lambda: series - size * ((share >= begin) & (share < end)),
        "delay": lambda: shifted(times, series, size),
        "rate": lambda: shifted(times, series, size * since),
        "lever": lambda: series - size * trace.values[one.other[0]],
        "sign": lambda: size * series,
        "unit": lambda: size * series,
        "offset": lambda: series + size,
        "bias": lambda: series - size,
        "drift": lambda: series - size * since,
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
    n = len(velocities)
    matrix, known = np.zeros((times.size, n, n)), set[str]()
    for relation in relations:
        place = level_axis(relation, values, trace.units, times, velocities)
        if place is not None:
            known.add(place)
            rows = [_partial(relation, values, times, v) for v in velocities]
            matrix[:, velocities.index(place)] = np.column_stack(rows)
    if not known:
        return {}
    absent = [i for i, name in enumerate(velocities) if name not in known]
    if n == 2 and len(absent) == 1:
        other = matrix[:, 1 - absent[0]]
        matrix[:, absent[0], absent[0]] = other[:, 1 - absent[0]]
        matrix[:, absent[0], 1 - absent[0]] = -other[:, absent[0]]
    elif absent:
        return {}
    logged = np.column_stack([values[name] for name in velocities])
    ok = np.isfinite(matrix).all(axis=(1, 2)) & (np.abs(np.linalg.det(np.nan_to_num(matrix))) > 0.1)
    body = np.full_like(logged, np.nan)
    body[ok] = np.linalg.solve(matrix[ok], logged[ok][:, :, None])[:, :, 0]
    return {name: body[:, i] for i, name in enumerate(velocities)}


def level_axis(
    relation: Relation,
    values: dict[str, np.ndarray],
    units: dict[str, str],
    times: np.ndarray,
    velocities: tuple[str, ...],
) -> str | None:
    """Velocity that the rate of a position equals at level attitude; None if there is none."""
    if not relation.is_rate or units.get(relation.target) != "m":
        return None
    level = {n: np.zeros(2) for n in relation.signals}
    found = []
    for name in relation.signals:
        if name in velocities:
            slope = float(relation({**level, name: np.ones(2)}, times[:2])[0])
            if abs(slope) > 1e-9:
                found.append((name, slope))
    return found[0][0] if len(found) == 1 and abs(found[0][1] - 1.0) < 1e-6 else None


def _partial(
    relation: Relation, values: dict[str, np.ndarray], times: np.ndarray, name: str
) -> np.ndarray:
    """Derivative of a right side by a signal that it is linear in, shape ``(n_times,)``."""
    if name not in relation.signals:
        return np.zeros(times.size)
    here = {n: values[n] for n in relation.signals}
    zero = {n: np.zeros(times.size) for n in relation.signals if n not in here}
    up, down = here[name] + 0.5, here[name] - 0.5
    return relation({**zero, **here, name: up}, times) - relation(
        {**zero, **here, name: down}, times
    )


# A current is no fault of the log, and what stands for a dead sensor nobody knows.
LEFT_ALONE = ("drift", "duplicate", "gap", "clock")


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
    """
    model = problem.model if isinstance(problem, Problem) else problem
    mine = {*dataset.channels.output_names, *dataset.channels.input_names}
    doubtful = found.named("unexplained") is not None
    fixes = [
        (one.correction, one.says)
        for one in found.findings
        if one.correction is not None and not (doubtful and one.correction.kind != "blank")
        if one.kind not in LEFT_ALONE and set(one.correction.signals) <= mine
    ]
    if not fixes:
        return dataset, ()
    undone, done = zip(*fixes, strict=True)
    return corrected(dataset, undone, relations(model)), done


def why_not_more(found: LogCheck) -> str:
    """Return why faults that were found are not undone in the copies; empty if they are.

    Parameters
    ----------
    found : LogCheck
        Result of :func:`~oed_sysid.evidence.check`.
    """
    still = found.named("unexplained")
    if still is None:
        return ""
    left = [
        one.name
        for one in found.findings
        if one.correction is not None and one.correction.kind != "blank"
        if one.kind not in LEFT_ALONE
    ]
    what = f"{', '.join(left)} is left as logged" if left else "nothing but bad samples is changed"
    return (
        f"{what}: with all findings undone an equation of {still.signals[0]} still leaves "
        f"{100.0 * (still.size or 0.0):.0f} % unexplained, so that no correction can be relied on; "
        "mend that first"
    )
