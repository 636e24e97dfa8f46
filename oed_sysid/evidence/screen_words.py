"""Findings of single signals in words, gathered over records."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from oed_sysid.data.dataset import Dataset, overlap
from oed_sysid.evidence.result import Correction, Finding
from oed_sysid.evidence.screens import Fault
from oed_sysid.evidence.traces import Trace
from oed_sysid.evidence.words import COPY, angle_aware

# Fast noise against the declared level before it is mentioned.
NOISIER = 2.5
# A step of the clock between samples, in usual steps, that counts as a gap.
GAP = 4.5
BLANK = f"leave these cells empty: {COPY}"
SENTENCES = {
    "dead": (
        "{signal} never changes ({value}): the sensor was off or its column is a constant.",
        "its equation is fitted to nothing",
        'leave the column out of the file ("{signal}" then counts as not measured)',
        True,
    ),
    "spikes": (
        "{signal} has {n} {samples}, alone or in short groups, that {its} neighbours contradict.",
        "least squares follows the worst samples; errors are stated too small",
        BLANK,
        True,
    ),
    "dropouts": (
        "{signal} shows {value} in {n} {samples} between ordinary ones: a drop-out or a sentinel.",
        "least squares follows them",
        BLANK,
        True,
    ),
    "frozen": (
        "{signal} stands still for {n} {samples} although it moves before and after.",
        "the model is asked to explain a motion that was not",
        BLANK,
        True,
    ),
    "saturated": (
        "{signal} is cut off at {value} in {n} {samples}.",
        "the motion beyond the limit is fitted as if it had stopped there",
        BLANK,
        True,
    ),
    "held": (
        "{signal} holds each value for {value}: a slow sensor written at the log's rate.",
        "the same measurement counts several times, and late by half of that",
        f"keep the first sample of each and leave the other cells empty: {COPY}",
        False,
    ),
    "quantised": (
        "{signal} comes in steps of {value}.",
        "its noise is that of rounding, which the errors have to allow for",
        "nothing, if the step is below what matters; else log more digits",
        False,
    ),
}


def screen_findings(dataset: Dataset, traces: list[Trace], faults: list[Fault]) -> list[Finding]:
    """Findings of all screens, one for each kind and signal."""
    units = {n: u for trace in traces for n, u in trace.units.items()}
    series = {trace.name: trace for trace in traces}
    result = []
    for kind, signal in dict.fromkeys((f.kind, f.signal) for f in faults):
        here = [f for f in faults if (f.kind, f.signal) == (kind, signal)]
        if kind == "step":
            result.append(_step(here, series, units[signal]))
            continue
        rows = {f.record: tuple(int(i) for i in f.rows) for f in here}
        n = sum(len(r) for r in rows.values())
        amount = here[0].amount
        if kind == "dead":
            amount = float(series[here[0].record].values[signal][here[0].rows[0]])
        value, unit = angle_aware(amount, units[signal])
        shown = f"{amount:.3g} s" if kind == "held" else f"{value:.4g} {unit}"
        says, changes, fix, suspect = SENTENCES[kind]
        words = {
            "signal": signal, "n": n, "value": shown, "its": "its" if n == 1 else "their",
            "samples": "sample" if n == 1 else "samples",
        }  # fmt: skip
        result.append(
            Finding(
                kind,
                (signal,),
                tuple(rows),
                says.format(**words),
                changes,
                fix.format(**words) if kind == "dead" else fix,
                suspect,
                size=float(n) if kind in ("spikes", "dropouts", "frozen", "saturated") else amount,
                unit="samples" if kind in ("spikes", "dropouts", "frozen", "saturated") else "",
                correction=Correction("blank", (signal,), rows=rows)
                if kind not in ("quantised",)
                else None,
            )
        )
    return [*result, *_noise(dataset, traces), *_gaps(traces), *_copies(dataset)]


def _step(faults: list[Fault], series: dict[str, Trace], unit: str) -> Finding:
    """Words for the lasting jumps of one signal; the largest one stands for all."""
    largest = max(faults, key=lambda one: abs(one.amount))
    row = int(largest.rows[largest.sizes.index(largest.amount)])
    time = float(series[largest.record].times[row])
    value, shown = angle_aware(largest.amount, unit)
    more = sum(fault.rows.size for fault in faults) - 1
    others = f" (and {more} more {'jump' if more == 1 else 'jumps'})" * bool(more)
    signal = largest.signal
    return Finding(
        "step",
        (signal,),
        tuple(fault.record for fault in faults),
        f"{signal} jumps by {value:+.3g} {shown} from one sample to the next at t = {time:.6g} s "
        f"of {largest.record} and stays there{others}: the sensor was set or reset.",
        "a model cannot move at once, and explains the new level by offsets and forces",
        f"cut the record there with window(), or subtract the jump from all later samples: {COPY}",
        True,
        size=largest.amount,
        unit=unit,
        correction=Correction(
            "step",
            (signal,),
            rows={fault.record: tuple(int(k) for k in fault.rows) for fault in faults},
            sizes={fault.record: fault.sizes for fault in faults},
        ),
    )


def _noise(dataset: Dataset, traces: list[Trace]) -> list[Finding]:
    """Declared noise levels that the fast noise of the log contradicts."""
    result = []
    for output in dataset.channels.outputs:
        levels = [t.noise[output.name] for t in traces if output.name in t.noise]
        if not output.noise_std or not levels:
            continue
        ratio = float(np.median(levels)) / output.noise_std
        if ratio > NOISIER:
            value, unit = angle_aware(float(np.median(levels)), output.unit)
            declared, _ = angle_aware(output.noise_std, output.unit)
            result.append(
                Finding(
                    "noise",
                    (output.name,),
                    tuple(t.name for t in traces if output.name in t.noise),
                    f"{output.name} is {ratio:.2g} times noisier than declared "
                    f"({value:.3g} for {declared:.3g} {unit}).",
                    "with declared noise, errors are stated too small by as much",
                    f'Output("{output.name}", "{output.unit}", '
                    f"noise_std={float(np.median(levels)):.2g}), or let the noise be estimated",
                    False,
                    size=ratio,
                    unit="1",
                )
            )
    return result


def _gaps(traces: list[Trace]) -> list[Finding]:
    """Jumps in time."""
    result = []
    for trace in traces:
        steps = np.diff(trace.times)
        wide = np.flatnonzero(steps > GAP * trace.step)
        if wide.size and trace.step > 0.0:
            longest = float(steps[wide].max())
            result.append(
                Finding(
                    "gap",
                    (),
                    (trace.name,),
                    f"{wide.size} {'gap' if wide.size == 1 else 'gaps'} in time, the longest of "
                    f"{longest:.3g} s after t = {trace.times[wide[np.argmax(steps[wide])]]:.6g} s.",
                    "the inputs in between are not known; a model bridges the gap with the last",
                    "cut the record there with window(), or fill in the commands",
                    False,
                    size=longest,
                    unit="s",
                )
            )
    return result


def _copies(dataset: Dataset) -> list[Finding]:
    """Records that hold the same measurement."""
    result = []
    for first, second in combinations(dataset, 2):
        found = overlap(first, second)
        if found is None:
            continue
        names = (first.name, second.name)
        result.append(
            Finding(
                "duplicate",
                (),
                names,
                f"{names[0]} and {names[1]} share {found.n_equal} samples: one is a copy of the "
                "other, or a part.",
                "the same noise counts twice, and a test on one of them is no test",
                f"leave {names[1]} out",
                True,
                size=float(found.n_equal),
                unit="samples",
            )
        )
    return result
