"""Findings in words: what was found, what it does to an estimate, and the line that mends it.

Findings of single signals in words, gathered over records.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from oed_sysid.data.dataset import Dataset, overlap
from oed_sysid.evidence.blocks import Candidate
from oed_sysid.evidence.continuous import Continuous
from oed_sysid.evidence.discrete import SIZED, Discrete, Hypothesis
from oed_sysid.evidence.relations import Relation
from oed_sysid.evidence.result import Correction, Finding, amount, angle_aware, interval
from oed_sysid.evidence.screens import Fault
from oed_sysid.evidence.traces import Trace
from oed_sysid.physics.channels import Channels, Input, Output

COPY = "oed-sysid check ... --fix FOLDER writes corrected copies"


def _channel(channels: Channels, name: str) -> Input | Output | None:
    every: list[Input | Output] = [*channels.outputs, *channels.inputs]
    return next((channel for channel in every if channel.name == name), None)


def _line(channels: Channels, name: str, change: str) -> str:
    """Declaration of a channel with something changed; words for a column nobody declared."""
    channel = _channel(channels, name)
    if channel is None:
        return f'for the column "{name}", once a channel reads it: {change}'
    kind = "Input" if isinstance(channel, Input) else "Output"
    return f'{kind}("{name}", "{channel.unit}", {change})'


def _sign(channels: Channels, name: str) -> str:
    channel = _channel(channels, name)
    value = -channel.sign if channel is not None else -1.0
    return _line(channels, name, f"sign={value:g}")


def _column(channels: Channels, name: str) -> str:
    channel = _channel(channels, name)
    return (channel.column if channel is not None and channel.column else name) or name


def say_hypothesis(one: Hypothesis) -> str:
    """A discrete fault in a few words, for lists of rivals."""
    fix, names = one.correction, " and ".join(one.correction.signals)
    if fix.kind == "sign":
        return f"{names} with the other sign"
    if fix.kind == "unit":
        return (
            f"{names} in {one.meaning}"
            if "twice" not in one.meaning
            else (f"{names} {one.meaning}")
        )
    if fix.kind == "swap":
        return f"{names} in each other's column"
    if fix.kind == "frame":
        return f"{names} along the axes of the positions"
    if fix.kind == "offset":
        return f"{names} counted from elsewhere ({one.meaning})"
    return f"{names} late by {fix.value:g} s"


def discrete_finding(
    one: Discrete, channels: Channels, relations: tuple[Relation, ...], records: tuple[str, ...]
) -> Finding:
    """Words for a discrete fault."""
    fix, names = one.correction, one.correction.signals
    first = names[0]
    both = " and ".join(names)
    if fix.kind == "sign":
        says = f"{first} has the wrong sign: turned round, it agrees with the other signals."
        changes = f"every coefficient that {first} enters is fitted to its mirror image"
        line = _sign(channels, first)
    elif fix.kind == "unit":
        channel = _channel(channels, first)
        unit = channel.unit if channel is not None else ""
        if "twice" in one.meaning:
            says = f"{first} is too small: it seems {one.meaning}."
            line = f'write the header as "{_column(channels, first)} [{unit}]"'
        else:
            says = f"{first} is in {one.meaning}, not in {unit}."
            line = f'write the header as "{_column(channels, first)} [{one.meaning}]"'
            line += f', or read_csv(..., units={{"{first}": "{one.meaning}"}})'
        changes = f"{first} counts {1.0 / fix.value:.3g} times too much"
    elif fix.kind == "swap":
        a, b = names
        says = f"{a} and {b} are in each other's column."
        changes = "both signals are fitted to the other one's physics"
        line = f"{_line(channels, a, f'column={_quoted(_column(channels, b))}')} and "
        line += _line(channels, b, f"column={_quoted(_column(channels, a))}")
    elif fix.kind == "frame":
        says = f"{both} are along the axes of the positions (earth-fixed), not of the body."
        changes = "drift, drag and lift are fitted to a rotation of the frame"
        line = _frame_lines(names, channels, relations)
    elif fix.kind == "offset":
        says = f"{first} counts from another direction: {one.meaning} have to be added."
        changes = "forces that depend on the direction (wind, current, waves) are turned"
        line = f"add {one.meaning} to {first}: {COPY}"
    else:
        raise ValueError(fix.kind)
    rivals = tuple(say_hypothesis(r) for r in one.rivals if r.correction.kind not in SIZED)
    return Finding(
        fix.kind, names, records, says, changes, line, gain=one.gain, alternatives=rivals,
        correction=fix,
    )  # fmt: skip


def _quoted(text: str) -> str:
    return f'"{text}"'


def _frame_lines(
    names: tuple[str, ...], channels: Channels, relations: tuple[Relation, ...]
) -> str:
    """Declare the velocities as what they are, where the model has the equations for it."""
    lines = []
    for name in names:
        channel = _channel(channels, name)
        for relation in relations:
            level = dict.fromkeys(relation.signals, 0.0)
            if relation.target in names or not relation.is_rate or name not in relation.signals:
                continue
            at = {n: np.zeros(2) for n in level} | {name: np.ones(2)}
            if abs(float(relation(at, np.zeros(2))[0]) - 1.0) < 1e-6:
                text = f'Output("{name}", "m/s", expression="{relation.text}")'
                lines.append(text if channel is not None else f"{name} = {relation.text}")
                break
    written = " and ".join(lines)
    return f"{written}; or {COPY}" if written else COPY


SENSOR = {
    "bias": 'sensor_bias("bias_{0}", "{0}", "{unit}", scale={size:.2g})',
    "scale": 'sensor_scale("scale_{0}", "{0}")',
    "misalignment": 'sensor_misalignment("misalignment", "{0}", "{1}")',
    "lever": 'sensor_lever_arm("lever_{0}", "{0}", "{rate}")',
}


def say_candidate(one: Candidate, size: float) -> str:
    """A continuous fault in a few words, for lists of rivals."""
    value, unit = angle_aware(size, one.unit)
    number = f"{100.0 * size:.2g} %" if unit == "1" else f"{value:.3g} {unit}"
    names = " and ".join(one.signals)
    if one.kind == "lever":
        return f"lever arm of {names} against {one.other[0]} ({number})"
    if one.kind == "misalignment":
        return f"misalignment of {names} ({number})"
    if one.kind == "drift":
        return f"current or drift along {names} ({number})"
    return f"{one.kind} of {names}{f' in {one.record}' if one.record else ''} ({number})"


def _others(names: tuple[str, ...], relations: tuple[Relation, ...]) -> tuple[str, ...]:
    """Signals that are related to some, directly or through each other."""
    found: dict[str, None] = {}
    fresh = set(names)
    while fresh:
        here = {
            n
            for r in relations
            if fresh & {r.target, *r.signals}
            for n in (r.target, *r.signals)
            if n not in names and n not in found
        }
        found |= dict.fromkeys(sorted(here))
        fresh = here
    return tuple(found)


def _listed(names: tuple[str, ...]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]


def continuous_finding(
    one: Continuous,
    channels: Channels,
    relations: tuple[Relation, ...],
    records: tuple[str, ...],
    *,
    allowed: bool,
) -> Finding:
    """Words for a continuous fault; ``allowed`` where the model has an effect for it."""
    fault, names = one.candidate, one.candidate.signals
    size, kind, correction = one.size, fault.kind, one.correction
    bounds = interval(size, one.std)
    both = " and ".join(names)
    shown = amount(size, bounds, fault.unit)
    if kind == "delay" and size < 0.0:
        # Nothing is measured before it happens: the others lag.
        others = _others(names, relations)
        shown = amount(-size, (-bounds[1], -bounds[0]), fault.unit)
        says = f"{_listed(others)} come {shown} after {both}."
        changes = "lags of actuators and damping are wrong by as much"
        line = f"shift {', '.join(others)} back by {-size:.3g} s: {COPY}"
        names, size, bounds = others, -size, (-bounds[1], -bounds[0])
        correction = Correction("delay", names, size)
    elif kind == "delay":
        says = f"{both} {'comes' if len(names) == 1 else 'come'} {shown} late."
        changes = "lags of actuators and damping are wrong by as much"
        line = f'effect sensor_delay(...) of "{names[0]}", or shift it back: {COPY}'
    elif kind == "bias":
        where = f" in {fault.record}" if fault.record else ""
        says = f"{both} has a constant error of {shown}{where}."
        changes = "offsets of actuators and asymmetries of the hull take its place"
        line = "effect " + SENSOR[kind].format(names[0], unit=fault.unit, size=abs(size))
        if fault.record:
            line, records = line[:-1] + ", per_record=True)", (fault.record,)
    elif kind == "scale":
        says = f"{both} is wrong by {shown} of its value."
        changes = f"coefficients of terms with {both} are wrong by about as much"
        line = "effect " + SENSOR[kind].format(names[0])
    elif kind == "lever":
        says = (
            f"{both} is measured {shown} away from the reference point, against {fault.other[0]}."
        )
        changes = "damping and lift due to rotation take its place"
        line = "effect " + SENSOR[kind].format(names[0], rate=fault.other[0])
    elif kind == "misalignment":
        says = f"the axes of {both} are turned by {shown} against the angles."
        changes = "trim, drift angle and lift take its place"
        line = "effect " + SENSOR[kind].format(*names)
    else:
        says = f"{both} moves {shown} faster than the velocities say: a current, or a bias."
        changes = "velocities through the water and over ground are mixed up"
        line = "declare the velocities as relative to the water and add a current, or remove a bias"
    if kind in SENSOR and not isinstance(_channel(channels, names[0]), Output):
        line = f"{both} is no output of the model: {COPY}"
    if allowed:
        line = "the model has an effect for it already"
    rivals = tuple(say_candidate(c, s) for c, s in one.rivals)
    return Finding(
        kind, names, records, says, changes, line, suspect=not allowed, size=size,
        interval=bounds, unit=fault.unit, gain=one.gain, alternatives=rivals,
        correction=correction,
    )  # fmt: skip


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
        amount = here[0].amount
        if kind == "dead":
            amount = float(series[here[0].record].values[signal][here[0].rows[0]])
        result.append(_blanked(here, amount, units[signal]))
    return [*result, *_noise(dataset, traces), *_gaps(traces), *_copies(dataset)]


def _blanked(here: list[Fault], amount: float, unit: str) -> Finding:
    """Finding of samples of one signal that say nothing, or little."""
    kind, signal = here[0].kind, here[0].signal
    rows = {f.record: tuple(int(i) for i in f.rows) for f in here}
    n = sum(len(r) for r in rows.values())
    value, shown_unit = angle_aware(amount, unit)
    says, changes, fix, suspect = SENTENCES[kind]
    words = {
        "signal": signal,
        "n": n,
        "value": f"{amount:.3g} s" if kind == "held" else f"{value:.4g} {shown_unit}",
        "its": "its" if n == 1 else "their",
        "samples": "sample" if n == 1 else "samples",
    }
    counted = kind in ("spikes", "dropouts", "frozen", "saturated")
    return Finding(
        kind,
        (signal,),
        tuple(rows),
        says.format(**words),
        changes,
        fix.format(**words) if kind == "dead" else fix,
        suspect,
        size=float(n) if counted else amount,
        unit="samples" if counted else "",
        correction=None if kind == "quantised" else Correction("blank", (signal,), rows=rows),
    )


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
