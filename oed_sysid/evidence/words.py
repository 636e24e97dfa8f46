"""Findings in words: what was found, what it does to an estimate, and the line that mends it.

One table holds the sentences of every kind of finding; what fills them in are facts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset, overlap
from oed_sysid.data.record import GAP
from oed_sysid.evidence.contrasts import LARGEST, LOUDER, Candidate, Found, Misfit, Reading, Result
from oed_sysid.evidence.relations import Relation
from oed_sysid.evidence.result import Correction, Finding, Judged, amount, angle_aware, interval
from oed_sysid.evidence.screens import Fault
from oed_sysid.evidence.traces import Trace
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.runtime.display import counted

COPY = "oed-sysid check ... --fix FOLDER writes corrected copies"
CUT = f"cut the record there with window(), or {COPY}"
BLANK = f"leave these cells empty: {COPY}"
# Faults that are other readings of the same numbers: seen where a scale of one would be.
READ = ("sign", "unit", "swap")
# Rows that tell of the vehicle or of what its model lacks as well as of its log.
NO_FAULT = ("input lag", "input scale", "run")
# What may be wrong in place of an input.
NOMINAL = "a nominal model or priors that are wrong by as much"
# Fast noise over the declared level, and a jump of the times in usual steps, that are mentioned.
NOISIER = 2.5

# What a finding says, what it does to an estimate, and what mends it.
SAYS = {
    # other readings of the same numbers
    "sign": (
        "{both} {have} the wrong sign: turned round, it agrees with the other signals.",
        "every coefficient that {both} enters is fitted to its mirror image",
        "{signs}",
    ),
    "unit": (
        "{both} {are} in {meaning}, not in {declared}.",
        "{both} counts {times} times too much",
        "{headers}, or read_csv(..., units={{{units}}})",
    ),
    "twice": (
        "{both} {are} too small: it seems {meaning}.",
        "{both} counts {times} times too much",
        "{headers}",
    ),
    "swap": (
        "{first} and {last} are in each other's column.",
        "both signals are fitted to the other one's physics",
        "{columns}",
    ),
    "frame": (
        "{both} are along the axes of the positions (earth-fixed), not of the body.",
        "drift, drag and lift are fitted to a rotation of the frame",
        "{frames}",
    ),
    "offset": (
        "{first} counts from another direction: {meaning} have to be added.",
        "forces that depend on the direction (wind, current, waves) are turned",
        f"add {{meaning}} to {{first}}: {COPY}",
    ),
    # faults with a size
    "bias": (
        "{both} has a constant error of {shown}{where}.",
        "offsets of actuators and asymmetries of the hull take its place",
        'effect sensor_bias("bias_{first}", "{first}", "{unit}", scale={size:.2g}{own})',
    ),
    "scale": (
        "{both} is wrong by {shown} of its value{where}.",
        "coefficients of terms with {both} are wrong by about as much",
        'effect sensor_scale("scale_{first}", "{first}"{own})',
    ),
    "lever": (
        "{both} is measured {shown} away from the reference point, against {rate}.",
        "damping and lift due to rotation take its place",
        'effect sensor_lever_arm("lever_{first}", "{first}", "{rate}")',
    ),
    "misalignment": (
        "the axes of {both} are turned by {shown} against the angles.",
        "trim, drift angle and lift take its place",
        'effect sensor_misalignment("misalignment", "{first}", "{last}")',
    ),
    "delay": (
        "{both} {come} {shown} late.",
        "lags of actuators and damping are wrong by as much",
        f'effect sensor_delay(...) of "{{first}}", or shift it back: {COPY}',
    ),
    "ahead": (
        "{both} {come} {shown} after {early}.",
        "lags of actuators and damping are wrong by as much",
        f"shift {{commas}} back by {{size:.3g}} s: {COPY}",
    ),
    "rate": (
        "the clock of {both} runs {shown} slow against the others.",
        "what the others answer seems to drift away in time",
        f"set the times of {{both}} right before the columns are joined: {COPY}",
    ),
    "current": (
        "{both} moves {shown} faster than the velocities say: a current, or a bias.",
        "velocities through the water and over ground are mixed up",
        "declare the velocities as relative to the water and add a current, or remove a bias",
    ),
    "drift": (
        "{both} drifts by {shown}{where}, which no motion explains.",
        "slow forces and moments take its place",
        COPY,
    ),
    "burst": (
        "{both} is off by {shown} for a moment at t = {at:.6g} s of {record}.",
        "the model is asked to explain a motion that was not",
        CUT,
    ),
    "step": (
        "{both} jumps by {shown} at t = {at:.6g} s of {record} and stays there: the sensor was set "
        "or reset.",
        "a model cannot move at once, and explains the new level by offsets and forces",
        CUT,
    ),
    # equations
    "unexplained": (
        "{relation} leaves {share} % of the changes of {first} unexplained in {record}{more}, most "
        "at about t = {at:.4g} s: one of {commas} is wrong in a way that has no name here.",
        "whatever is fitted to these signals explains a motion that was not",
        "look at {commas} of {record} around t = {at:.4g} s, and cut the record there or leave the "
        "wrong signal out",
    ),
    # single signals
    "dead": (
        "{commas} never changes ({value}): the sensor was off or its column is a constant.",
        "its equation is fitted to nothing",
        'leave the column out of the file ("{commas}" then counts as not measured)',
    ),
    "spikes": (
        "{commas} has {samples}, alone or in short groups, that {its} neighbours contradict.",
        "least squares follows the worst samples; errors are stated too small",
        BLANK,
    ),
    "dropouts": (
        "{commas} shows {value} in {samples} between ordinary ones: a drop-out or a sentinel.",
        "least squares follows them",
        BLANK,
    ),
    "frozen": (
        "{commas} stands still for {samples} although it moves before and after.",
        "the model is asked to explain a motion that was not",
        BLANK,
    ),
    "saturated": (
        "{commas} is cut off at {value} in {samples}.",
        "the motion beyond the limit is fitted as if it had stopped there",
        BLANK,
    ),
    "held": (
        "{commas} holds each value for {size:.3g} s: a slow sensor written at the log's rate.",
        "the same measurement counts several times, and late by half of that",
        f"keep the first sample of each and leave the other cells empty: {COPY}",
    ),
    "interpolated": (
        "{commas} is joined by straight lines: one measurement every {size:.3g} s, the rest was "
        "made.",
        "made samples count as measured ones; errors are stated too small",
        f"keep the measured samples and leave the other cells empty: {COPY}",
    ),
    "quantised": (
        "{commas} comes in steps of {value}.",
        "its noise is that of rounding, which the errors have to allow for",
        "nothing, if the step is below what matters; else log more digits",
    ),
    "copied": (
        "{commas} at every sample: one column was written twice.",
        "one of the two says nothing, and which one nobody knows",
        "leave the column that is no measurement out of the file",
    ),
    "jump": (
        "{commas} jumps by {jump} from one sample to the next at t = {at:.6g} s of {record} and "
        "stays there{more}: the sensor was set or reset.",
        "a model cannot move at once, and explains the new level by offsets and forces",
        f"cut the record there with window(), or subtract the jump from all later samples: {COPY}",
    ),
    "caught up": (
        "{commas} jumps by {jump} from one sample to the next at t = {at:.6g} s of {record}{more}: "
        "the other signals say that the vehicle moved there, so that it was lost before and caught "
        "up.",
        "a model cannot move at once, and explains the new level by offsets and forces",
        "cut the record there with window(); nothing is subtracted in a corrected copy",
    ),
    "noise": (
        "{commas} is {ratio:.2g} times noisier than declared ({level:.3g} for {said:.3g} {unit}).",
        "with declared noise, errors are stated too small by as much",
        'Output("{commas}", "{si}", noise_std={found:.2g}), or let the noise be estimated',
    ),
    # inputs and parameters, against the nominal model
    "input sign": (
        "{both} acts with the other sign than the nominal model and its priors say.",
        "the coefficients of {both} are fitted to their mirror image",
        "{signs}",
    ),
    "input unit": (
        "{both} acts as if it were in {meaning}, not in {declared}.",
        "the coefficients of {both} are fitted {times} times too small",
        "{headers}",
    ),
    "input twice": (
        "{both} acts {factor:.3g} times as strongly as logged: converted twice?",
        "the coefficients of {both} are fitted {factor:.3g} times too large",
        "correct the unit in the header",
    ),
    "input swap": (
        "{first} and {last} are in each other's column.",
        "both commands are fitted to the other one's forces",
        "{columns}",
    ),
    "input scale": (
        "{both} acts as if its values were wrong by {shown}.",
        "the coefficients of {both} are wrong by as much",
        "calibrate {both}, or correct the unit in the header",
    ),
    "input delay": (
        "the vehicle answers {both} {shown} before the log shows it.",
        "lags of actuators and damping are wrong by as much",
        "shift {both} back in time, or the outputs forward, before the columns are joined",
    ),
    "input lag": (
        "the vehicle answers {both} {shown} late: an actuator lags, or its command was logged in "
        "place of its feedback.",
        "damping and added mass take the place of the lag",
        "log the feedback, or give the model a lag of the actuator as a candidate",
    ),
    "run": (
        "{both} differs by {shown} in {record} from the other runs.",
        "what differs between runs is fitted by a compromise",
        "fit {record} apart, or give the model what differs (loading, water, a current)",
    ),
    "other_way": ("{says}", "values are those of {name} as it was logged", "correct {name}"),
    "far": (
        "values many prior deviations from what was declared: {away}. An input or a sensor is in "
        "another unit, or the priors are wrong.",
        "predictions hold for this log alone",
        "look at units and signs of inputs and outputs, or widen the priors",
    ),
    "limit": (
        "{commas} reaches {largest:.3g} {unit}, far beyond its limit of {allowed}{as_if}.",
        "the coefficients of {commas} are wrong by as much",
        "correct the unit in the header, or the limit in the problem",
    ),
    # times and records
    "gap": (
        "{gaps} in time, the longest of {size:.3g} s after t = {at:.6g} s.",
        "the inputs in between are not known; a model bridges the gap with the last",
        "cut the record there with window(), or fill in the commands",
    ),
    "clock": (
        "the clock jumps by {size:.3g} s at t = {at:.6g} s, but the signals go on as if {step:.3g} "
        "s had passed.",
        "the model runs on through time that did not pass",
        "take {more:.6g} s off all later times",
    ),
    "duplicate": (
        "{first} and {last} share {n} samples: one is a copy of the other, or a part.",
        "the same noise counts twice, and a test on one of them is no test",
        "leave {last} out",
    ),
}


def said(
    kind: str,
    signals: tuple[str, ...],
    records: tuple[str, ...],
    words: dict[str, Any],
    *,
    row: str = "",
    fix: str = "",
    **facts: Any,
) -> Finding:
    """The finding of a kind, its sentences those of a row of the table, or another ``fix``."""
    says, changes, line = SAYS[row or kind]
    words = {"commas": ", ".join(signals)} | words
    line = fix or line.format(**words)
    says, changes = says.format(**words), changes.format(**words)
    return Finding(kind, signals, records, says, changes, line, **facts)


# -- channels --------------------------------------------------------------------------------


def _channel(channels: Channels, name: str) -> Input | Output | None:
    every: list[Input | Output] = [*channels.outputs, *channels.inputs]
    return next((channel for channel in every if channel.name == name), None)


def _declared(channels: Channels, name: str, change: str) -> str:
    """Declaration of a channel with something changed; words for a column nobody declared."""
    channel = _channel(channels, name)
    if channel is None:
        return f'for the column "{name}", once a channel reads it: {change}'
    kind = "Input" if isinstance(channel, Input) else "Output"
    return f'{kind}("{name}", "{channel.unit}", {change})'


def _frame_lines(
    names: tuple[str, ...], channels: Channels, relations: tuple[Relation, ...]
) -> str:
    """Declare the velocities as what they are, where the model has the equations for it."""
    lines = []
    for name in names:
        at = {n: np.full(2, float(n == name)) for r in relations for n in r.signals}
        own = (
            r.text
            for r in relations
            if r.target not in names and r.is_rate and name in r.signals
            if abs(float(r({n: at[n] for n in r.signals}, np.zeros(2))[0]) - 1.0) < 1e-6
        )
        for text in list(own)[:1]:
            known = _channel(channels, name) is not None
            lines.append(
                f'Output("{name}", "m/s", expression="{text}")' if known else f"{name} = {text}"
            )
    return f"{' and '.join(lines)}; or {COPY}" if lines else COPY


# -- other readings --------------------------------------------------------------------------


def _say_reading(one: Reading) -> str:
    """Another reading in a few words, for lists of rivals."""
    fix, names = one.correction, " and ".join(one.correction.signals)
    return {
        "sign": f"{names} with the other sign",
        "unit": f"{names} {one.meaning if 'twice' in one.meaning else f'in {one.meaning}'}",
        "swap": f"{names} in each other's column",
        "frame": f"{names} along the axes of the positions",
        "offset": f"{names} counted from elsewhere ({one.meaning})",
    }[fix.kind]


def reading_finding(
    one: Reading, channels: Channels, relations: tuple[Relation, ...], records: tuple[str, ...]
) -> Finding:
    """Words for another reading of the same numbers."""
    fix, names = one.correction, one.correction.signals
    known = {name: _channel(channels, name) for name in names}
    columns = {name: getattr(channel, "column", "") or name for name, channel in known.items()}
    unit = getattr(known[names[0]], "unit", "")
    twice = "twice" in one.meaning
    header = unit if twice and unit else one.meaning
    signs = (f"sign={-getattr(channel, 'sign', 1.0):g}" for channel in known.values())
    swapped = zip(names, reversed(names), strict=True)
    have, are = ("has", "is") if len(names) == 1 else ("have", "are")
    words = {
        "both": " and ".join(names), "first": names[0], "last": names[-1], "meaning": one.meaning,
        "have": have, "are": are,
        "declared": unit, "times": f"{1.0 / fix.value:.3g}",
        "factor": fix.value,
        "headers": " and ".join(f'write the header as "{c} [{header}]"' for c in columns.values()),
        "units": ", ".join(f'"{name}": "{one.meaning}"' for name in names),
        "signs": " and ".join(_declared(channels, *p) for p in zip(names, signs, strict=True)),
        "columns": " and ".join(
            _declared(channels, name, f'column="{columns[other]}"') for name, other in swapped
        ),
        "frames": _frame_lines(names, channels, relations),
    }  # fmt: skip
    row = "twice" if twice else fix.kind
    others = tuple(map(_say_reading, one.rivals))
    if isinstance(known[names[0]], Input):
        row, others = f"input {row}", (*others, NOMINAL)
    return said(
        fix.kind, names, records, words, row=row, gain=one.gain, alternatives=others,
        correction=None if row == "input swap" else fix,
    )  # fmt: skip


# -- faults with a size ----------------------------------------------------------------------


def _say_sized(one: Candidate, size: float) -> str:
    """A fault with a size in a few words, for lists of rivals."""
    value, unit = angle_aware(size, one.unit)
    number = f"{100.0 * size:.2g} %" if unit == "1" else f"{value:.3g} {unit}"
    names = " and ".join(one.signals)
    words = {
        "lever": f"lever arm of {names} against {''.join(one.other)}",
        "drift": f"current or drift along {names}",
        "rate": f"slow clock of {names}",
        "run": f"another {names}",
    }.get(one.kind, f"{one.kind} of {names}")
    return f"{words}{f' in {one.record}' if one.record else ''} ({number})"


def _seen_from(kind: str, size: float, unit: str) -> str:
    """Least size of a fault that would be seen, in people's units."""
    unit = {"scale": "1", "delay": "s", "rate": "1", "drift": f"{unit}/s"}.get(kind, unit)
    value, shown = angle_aware(size, unit)
    if not np.isfinite(size):
        return ""
    return f"{100.0 * size:.1g} %" if unit == "1" else f"{value:.1g} {shown}"


def _others(names: tuple[str, ...], relations: tuple[Relation, ...]) -> tuple[str, ...]:
    """Signals that are related to some, directly or through each other."""
    found: dict[str, None] = {}
    fresh = set(names)
    while fresh:
        touched = (r for r in relations if fresh & {r.target, *r.signals})
        here = {n for r in touched for n in (r.target, *r.signals)} - {*names, *found}
        found |= dict.fromkeys(sorted(here))
        fresh = here
    return tuple(found)


def sized_finding(
    one: Found,
    channels: Channels,
    relations: tuple[Relation, ...],
    records: tuple[str, ...],
    *,
    allowed: bool = False,
    begins: dict[str, tuple[float, float]] | None = None,
) -> Finding:
    """Words for a fault with a size; ``allowed`` where the model has an effect for it."""
    fault, early = one.candidate, " and ".join(one.candidate.signals)
    of_input = isinstance(_channel(channels, fault.signals[0]), Input)
    row, names, size = _row_of(fault, one.size, relations, of_input=of_input)
    bounds = interval(size, one.std)
    undone = replace(one.correction, signals=names, value=size)
    correction = None if of_input or row == "run" else undone
    start, end = (begins or {}).get(fault.record, (0.0, 1.0))
    both = f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
    words = {
        "both": both, "first": names[0], "last": names[-1], "early": early,
        "come": "come" if len(names) > 1 else "comes", "shown": amount(size, bounds, fault.unit),
        "unit": fault.unit, "size": abs(size), "rate": "".join(fault.other),
        "record": fault.record, "at": start + fault.span[0] * (end - start),
        "where": f" in {fault.record}" * bool(fault.record),
        "own": ", per_record=True" * bool(fault.record),
    }  # fmt: skip
    fix = "the model has an effect for it already" if allowed else ""
    if not fix and "effect" in SAYS[row][2] and _channel(channels, names[0]) is None:
        fix = f"{both} is no output of the model: {COPY}"
    others = tuple(_say_sized(*rival) for rival in one.rivals)
    return said(
        {"rate": "clock"}.get(fault.kind, fault.kind), names,
        (fault.record,) if fault.record else records, words, row=row, fix=fix,
        suspect=not allowed and row not in NO_FAULT, size=size, interval=bounds, unit=fault.unit,
        gain=one.gain, alternatives=(*others, NOMINAL) if of_input else others,
        correction=correction,
    )  # fmt: skip


def _row_of(
    fault: Candidate, size: float, relations: tuple[Relation, ...], *, of_input: bool
) -> tuple[str, tuple[str, ...], float]:
    """Row of the table that tells of a fault, the signals it is told of, and its size there."""
    if of_input:
        lag = fault.kind == "delay" and size < 0.0
        return f"input {'lag' if lag else fault.kind}", fault.signals, -size if lag else size
    if fault.kind == "delay" and size < 0.0:
        # Nothing is measured before it happens: the others lag.
        return "ahead", _others(fault.signals, relations), -size
    current = fault.kind == "drift" and fault.unit == "m/s"
    return "current" if current else fault.kind, fault.signals, size


def judged_row(
    kind: str, name: str, unit: str, ended: Result | None, *, related: bool = True
) -> Judged:
    """Whether a fault was tested, from which size on, or why it was not."""
    size, plausible = _visible(ended, "scale" if kind in READ else kind, name)
    shown = _seen_from(kind, size, unit)
    if kind in READ:
        shown, why = "", "nothing in which it moves enough"
    elif not related:
        why = "no equation without unknown parameters relates it"
    elif np.isfinite(size):
        why = f"the motion shows it from {shown} on only"
    else:
        why = "nothing that was measured depends on it"
    tested = size <= plausible
    return Judged(kind, name, "tested" if tested else "not tested", shown if tested else why)


def _visible(ended: Result | None, kind: str, name: str) -> tuple[float, float]:
    """Least size of a fault of a signal alone that would be seen, and the largest plausible."""
    if ended is None:
        return np.inf, 0.0
    sizes = [
        (float(v), LARGEST * f.plausible)
        for f, v in zip(ended.faults, ended.visible, strict=True)
        if f.kind == kind and f.signals == (name,)
    ]
    return min(sizes, default=(np.inf, 0.0))


def misfit_finding(misfits: Sequence[Misfit], relations: tuple[Relation, ...]) -> list[Finding]:
    """One finding for each equation that fails somewhere, with the record where it fails most."""
    result = []
    for index in dict.fromkeys(one.relation for one in misfits):
        relation = relations[index]
        here = [one for one in misfits if one.relation == index]
        worst = max(here, key=lambda one: one.share)
        words = {
            "relation": relation, "share": f"{100.0 * worst.share:.0f}", "first": relation.target,
            "record": worst.record, "at": worst.time,
            "more": f" (and in {len(here) - 1} more)" * (len(here) > 1),
        }  # fmt: skip
        names = tuple(dict.fromkeys((relation.target, *relation.signals)))
        records = tuple(one.record for one in here)
        result.append(said("unexplained", names, records, words, size=worst.share, unit="1"))
    return result


# -- single signals --------------------------------------------------------------------------


def screen_findings(
    dataset: Dataset, traces: Sequence[Trace], faults: list[Fault]
) -> list[Finding]:
    """Findings of all screens, one for each kind and signal."""
    series = {trace.name: trace for trace in traces}
    kinds: dict[tuple[str, str], list[Fault]] = {}
    for fault in faults:
        kinds.setdefault((fault.kind, fault.signal), []).append(fault)
    result = [_screened(*key, here, series) for key, here in kinds.items()]
    return [*result, *_noise(dataset, traces), *_gaps(traces), *_copies(dataset)]


def _screened(kind: str, signal: str, here: list[Fault], series: dict[str, Trace]) -> Finding:
    """Finding of samples of one signal that say nothing, or little, or lie on another level."""
    largest = max(here, key=lambda one: abs(one.amount))
    trace = series[largest.record]
    names = largest.names
    unit, size = trace.units[names[0]], largest.amount
    if kind == "dead":
        size = float(trace.values[signal][largest.rows[0]])
    row = int(largest.rows[largest.sizes.index(largest.amount)]) if largest.sizes else 0
    rows = {f.record: tuple(int(i) for i in f.rows) for f in here}
    n = sum(map(len, rows.values()))
    value, shown = angle_aware(size, unit)
    words = {
        "commas": signal, "samples": counted(n, "sample"), "record": largest.record,
        "at": float(trace.times[row]), "value": f"{value:.4g} {shown}", "size": size,
        "jump": f"{value:+.3g} {shown}", "its": "its" if n == 1 else "their",
        "more": f" (and {n - 1} more {'jump' if n == 2 else 'jumps'})" * (n > 1),
    }  # fmt: skip
    steps = kind in ("step", "caught up")
    many = kind in ("spikes", "dropouts", "frozen", "saturated")
    correction = Correction("blank", names, rows=rows)
    if steps:
        correction = Correction("step", names, rows=rows, sizes={f.record: f.sizes for f in here})
    found = said(
        kind, names, tuple(rows), words, row="jump" if kind == "step" else "",
        suspect=kind not in ("held", "quantised"), size=float(n) if many else size,
        unit="samples" if many else unit * steps,
        correction=None if kind in ("quantised", "copied", "caught up") else correction,
    )  # fmt: skip
    return replace(found, kind="step") if steps else found


def _noise(dataset: Dataset, traces: Sequence[Trace]) -> Iterable[Finding]:
    """Declared noise levels that the fast noise of the log contradicts."""
    for output in dataset.channels.outputs:
        levels = {t.name: t.noise[output.name] for t in traces if output.name in t.noise}
        level = float(np.median([*levels.values()])) if levels else 0.0
        if not output.noise_std or level <= NOISIER * output.noise_std:
            continue
        value, unit = angle_aware(level, output.unit)
        ratio, declared = level / output.noise_std, angle_aware(output.noise_std, output.unit)[0]
        words = {"ratio": ratio, "level": value, "said": declared, "unit": unit, "found": level}
        yield said(
            "noise", (output.name,), tuple(levels), words | {"si": output.unit}, suspect=False,
            size=ratio, unit="1",
        )  # fmt: skip


def _gaps(traces: Sequence[Trace]) -> Iterable[Finding]:
    """Jumps in time."""
    for trace in traces:
        steps = np.diff(trace.times)
        wide = np.flatnonzero(steps > GAP * trace.step)
        if wide.size and trace.step > 0.0:
            longest = wide[np.argmax(steps[wide])]
            size = float(steps[longest])
            words = {"gaps": counted(wide.size, "gap"), "size": size, "at": trace.times[longest]}
            yield said("gap", (), (trace.name,), words, suspect=False, size=size, unit="s")


def _copies(dataset: Dataset) -> Iterable[Finding]:
    """Records that hold the same measurement."""
    for first, second in combinations(dataset, 2):
        found = overlap(first, second)
        if found is not None:
            words = {"first": first.name, "last": second.name, "n": found.n_equal}
            size = float(found.n_equal)
            names = (first.name, second.name)
            yield said("duplicate", (), names, words, size=size, unit="samples")


# -- clocks ----------------------------------------------------------------------------------

# Over a gap of the times each equation predicts a change. If the signals change as if only one
# usual step had passed, the clock was set and no time is missing.


def clock_findings(traces: list[Trace], relations: tuple[Relation, ...]) -> list[Finding]:
    """Gaps in time over which the signals contradict the clock."""
    result = []
    for trace in traces:
        steps = np.diff(trace.times)
        for k in np.flatnonzero(steps > NOISIER * trace.step):
            if _contradicts(trace, relations, int(k)):
                more = float(steps[k] - trace.step)
                words = {"size": steps[k], "at": trace.times[k], "step": trace.step, "more": more}
                result.append(said("clock", (), (trace.name,), words, size=more, unit="s"))
    return result


def _contradicts(trace: Trace, relations: tuple[Relation, ...], k: int) -> bool:
    """Whether the changes over a gap agree with a usual step, and not with the clock's."""
    by_clock, by_step = 0.0, 0.0
    span = trace.times[k + 1] - trace.times[k]
    for relation in relations:
        names = (relation.target, *relation.signals)
        if not relation.is_rate or any(name not in trace.values for name in names):
            continue
        rows = slice(max(k - 4, 0), k + 6)
        here = {name: trace.values[name][rows] for name in relation.signals}
        target = trace.values[relation.target]
        ends = (target[max(k - 4, 0) : k + 1], target[k + 1 : k + 6])
        if any(not np.isfinite(v).all() for v in (*here.values(), *ends)) or len(ends[1]) < 5:
            continue
        rate = float(np.mean(relation(here, trace.times[rows])))
        # Means of five samples on either side, five usual steps apart beside the gap.
        change = float(np.mean(ends[1]) - np.mean(ends[0]))
        noise = trace.noise[relation.target] * np.sqrt(2.0 / 5.0) + 0.02 * abs(rate) * span
        noise += 1e-9 + 1e-3 * abs(change)
        sides = 4.0 * trace.step
        by_clock = max(by_clock, abs(change - rate * (span + sides)) / noise)
        by_step = max(by_step, abs(change - rate * (trace.step + sides)) / noise)
    return by_clock > LOUDER and by_step < 0.5 * LOUDER
