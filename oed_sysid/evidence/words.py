"""Findings in words: what was found, what it does to an estimate, and the line that mends it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset, overlap
from oed_sysid.evidence.contrasts import Candidate, Found, Misfit, Reading
from oed_sysid.evidence.relations import Relation
from oed_sysid.evidence.result import Correction, Finding, amount, angle_aware, interval
from oed_sysid.evidence.screens import Fault
from oed_sysid.evidence.traces import Trace
from oed_sysid.physics.channels import Channels, Input, Output

COPY = "oed-sysid check ... --fix FOLDER writes corrected copies"
CUT = f"cut the record there with window(), or {COPY}"
# Fast noise against the declared level before it is mentioned, and a gap in usual steps.
NOISIER, GAP = 2.5, 4.5


# -- channels --------------------------------------------------------------------------------


def _channel(channels: Channels, name: str) -> Input | Output | None:
    every: list[Input | Output] = [*channels.outputs, *channels.inputs]
    return next((channel for channel in every if channel.name == name), None)


def declared(channels: Channels, name: str, change: str) -> str:
    """Declaration of a channel with something changed; words for a column nobody declared."""
    channel = _channel(channels, name)
    if channel is None:
        return f'for the column "{name}", once a channel reads it: {change}'
    kind = "Input" if isinstance(channel, Input) else "Output"
    return f'{kind}("{name}", "{channel.unit}", {change})'


def _sign(channels: Channels, name: str) -> str:
    channel = _channel(channels, name)
    return declared(channels, name, f"sign={-channel.sign if channel is not None else -1.0:g}")


def _column(channels: Channels, name: str) -> str:
    channel = _channel(channels, name)
    return (channel.column if channel is not None and channel.column else name) or name


def header_line(channels: Channels, name: str, unit: str) -> str:
    """What to write above a column that is in another unit."""
    return f'write the header as "{_column(channels, name)} [{unit}]"'


def _frame_lines(
    names: tuple[str, ...], channels: Channels, relations: tuple[Relation, ...]
) -> str:
    """Declare the velocities as what they are, where the model has the equations for it."""
    lines = []
    for name in names:
        for relation in relations:
            if relation.target in names or not relation.is_rate or name not in relation.signals:
                continue
            at = {n: np.full(2, float(n == name)) for n in relation.signals}
            if abs(float(relation(at, np.zeros(2))[0]) - 1.0) < 1e-6:
                known = _channel(channels, name) is not None
                line = f'Output("{name}", "m/s", expression="{relation.text}")'
                lines.append(line if known else f"{name} = {relation.text}")
                break
    return f"{' and '.join(lines)}; or {COPY}" if lines else COPY


# -- other readings --------------------------------------------------------------------------


def say_reading(one: Reading) -> str:
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
    fix, names, both = one.correction, one.correction.signals, " and ".join(one.correction.signals)
    first, last = names[0], names[-1]
    channel = _channel(channels, first)
    is_are, have = ("is", "has") if len(names) == 1 else ("are", "have")
    twice = "twice" in one.meaning
    units = ", ".join(f'"{n}": "{one.meaning}"' for n in names)
    says, changes, line = {
        "sign": (
            f"{both} {have} the wrong sign: turned round, it agrees with the other signals.",
            f"every coefficient that {both} enters is fitted to its mirror image",
            " and ".join(_sign(channels, n) for n in names),
        ),
        "unit": (
            f"{both} {is_are} too small: it seems {one.meaning}."
            if twice
            else f"{both} {is_are} in {one.meaning}, not in {channel.unit if channel else ''}.",
            f"{both} counts {1.0 / fix.value:.3g} times too much",
            " and ".join(
                header_line(channels, n, channel.unit if twice and channel else one.meaning)
                for n in names
            )
            + f", or read_csv(..., units={{{units}}})" * (not twice),
        ),
        "swap": (
            f"{first} and {last} are in each other's column.",
            "both signals are fitted to the other one's physics",
            " and ".join(
                declared(channels, name, f'column="{_column(channels, other)}"')
                for name, other in ((first, last), (last, first))
            ),
        ),
        "frame": (
            f"{both} are along the axes of the positions (earth-fixed), not of the body.",
            "drift, drag and lift are fitted to a rotation of the frame",
            _frame_lines(names, channels, relations),
        ),
        "offset": (
            f"{first} counts from another direction: {one.meaning} have to be added.",
            "forces that depend on the direction (wind, current, waves) are turned",
            f"add {one.meaning} to {first}: {COPY}",
        ),
    }[fix.kind]
    rivals = tuple(say_reading(r) for r in one.rivals)
    return Finding(
        fix.kind, names, records, says, changes, line, gain=one.gain, alternatives=rivals,
        correction=fix,
    )  # fmt: skip


# -- faults with a size ----------------------------------------------------------------------

# What a fault says, what it does to an estimate, and what mends it.
SIZED = {
    "bias": (
        "{both} has a constant error of {shown}{where}.",
        "offsets of actuators and asymmetries of the hull take its place",
        'effect sensor_bias("bias_{0}", "{0}", "{unit}", scale={size:.2g}{own})',
    ),
    "scale": (
        "{both} is wrong by {shown} of its value{where}.",
        "coefficients of terms with {both} are wrong by about as much",
        'effect sensor_scale("scale_{0}", "{0}"{own})',
    ),
    "lever": (
        "{both} is measured {shown} away from the reference point, against {rate}.",
        "damping and lift due to rotation take its place",
        'effect sensor_lever_arm("lever_{0}", "{0}", "{rate}")',
    ),
    "misalignment": (
        "the axes of {both} are turned by {shown} against the angles.",
        "trim, drift angle and lift take its place",
        'effect sensor_misalignment("misalignment", "{0}", "{1}")',
    ),
    "delay": (
        "{both} {come} {shown} late.",
        "lags of actuators and damping are wrong by as much",
        'effect sensor_delay(...) of "{0}", or shift it back: {COPY}',
    ),
    "ahead": (
        "{both} {come} {shown} after {first}.",
        "lags of actuators and damping are wrong by as much",
        "shift {commas} back by {size:.3g} s: {COPY}",
    ),
    "rate": (
        "the clock of {both} runs {shown} slow against the others.",
        "what the others answer seems to drift away in time",
        "set the times of {both} right before the columns are joined: {COPY}",
    ),
    "current": (
        "{both} moves {shown} faster than the velocities say: a current, or a bias.",
        "velocities through the water and over ground are mixed up",
        "declare the velocities as relative to the water and add a current, or remove a bias",
    ),
    "drift": (
        "{both} drifts by {shown}{where}, which no motion explains.",
        "slow forces and moments take its place",
        "{COPY}",
    ),
    "burst": (
        "{both} is off by {shown} for a moment at t = {at:.6g} s of {record}.",
        "the model is asked to explain a motion that was not",
        "{CUT}",
    ),
    "step": (
        "{both} jumps by {shown} at t = {at:.6g} s of {record} and stays there: the sensor was set "
        "or reset.",
        "a model cannot move at once, and explains the new level by offsets and forces",
        "{CUT}",
    ),
}


def say_sized(one: Candidate, size: float) -> str:
    """A fault with a size in a few words, for lists of rivals."""
    value, unit = angle_aware(size, one.unit)
    number = f"{100.0 * size:.2g} %" if unit == "1" else f"{value:.3g} {unit}"
    names = " and ".join(one.signals)
    words = {
        "lever": f"lever arm of {names} against {''.join(one.other)}",
        "drift": f"current or drift along {names}",
        "rate": f"slow clock of {names}",
    }.get(one.kind, f"{one.kind} of {names}")
    return f"{words}{f' in {one.record}' if one.record else ''} ({number})"


def seen_from(kind: str, size: float, unit: str) -> str:
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
    allowed: bool,
    begins: dict[str, tuple[float, float]] | None = None,
) -> Finding:
    """Words for a fault with a size; ``allowed`` where the model has an effect for it."""
    fault, names, size = one.candidate, one.candidate.signals, one.size
    kind, bounds, correction, first = fault.kind, interval(size, one.std), one.correction, ""
    which = kind
    if kind == "delay" and size < 0.0:
        # Nothing is measured before it happens: the others lag.
        which, first = "ahead", " and ".join(names)
        names, size, bounds = _others(names, relations), -size, (-bounds[1], -bounds[0])
        correction = Correction("delay", names, size)
    elif kind == "drift" and fault.unit == "m/s":
        which = "current"
    start, end = (begins or {}).get(fault.record, (0.0, 1.0))
    words: dict[str, Any] = {
        "both": f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0],
        "commas": ", ".join(names), "first": first, "come": "come" if len(names) > 1 else "comes",
        "shown": amount(size, bounds, fault.unit), "unit": fault.unit, "size": abs(size),
        "rate": "".join(fault.other), "record": fault.record,
        "at": start + fault.at * (end - start),
        "where": f" in {fault.record}" if fault.record else "",
        "own": ", per_record=True" if fault.record else "", "COPY": COPY, "CUT": CUT,
    }  # fmt: skip
    says, changes, line = (text.format(*names, **words) for text in SIZED[which])
    if "effect" in line and not all(isinstance(_channel(channels, n), Output) for n in names[:1]):
        line = f"{words['both']} is no output of the model: {COPY}"
    if allowed:
        line = "the model has an effect for it already"
    rivals = tuple(say_sized(c, s) for c, s in one.rivals)
    return Finding(
        {"rate": "clock"}.get(kind, kind), names, (fault.record,) if fault.record else records,
        says, changes, line, suspect=not allowed, size=size, interval=bounds, unit=fault.unit,
        gain=one.gain, alternatives=rivals, correction=correction,
    )  # fmt: skip


def misfit_finding(misfits: Sequence[Misfit], relations: tuple[Relation, ...]) -> list[Finding]:
    """One finding for each equation that fails somewhere, with the record where it fails most."""
    result = []
    for index in dict.fromkeys(one.relation for one in misfits):
        relation = relations[index]
        here = [one for one in misfits if one.relation == index]
        worst = max(here, key=lambda one: one.share)
        names = tuple(dict.fromkeys((relation.target, *relation.signals)))
        more = f" (and in {len(here) - 1} more)" if len(here) > 1 else ""
        result.append(
            Finding(
                "unexplained",
                names,
                tuple(one.record for one in here),
                f"{relation} leaves {100.0 * worst.share:.0f} % of the changes of "
                f"{relation.target} unexplained in {worst.record}{more}, most at about "
                f"t = {worst.time:.4g} s: one of {', '.join(names)} is wrong in a way that has no "
                "name here.",
                "whatever is fitted to these signals explains a motion that was not",
                f"look at {', '.join(names)} of {worst.record} around t = {worst.time:.4g} s, and "
                "cut the record there or leave the wrong signal out",
                size=worst.share,
                unit="1",
            )
        )
    return result


# -- single signals --------------------------------------------------------------------------

BLANK = f"leave these cells empty: {COPY}"
# What a screen says, what it does to an estimate, what mends it, and whether the log is suspect.
SCREENS = {
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
    "interpolated": (
        "{signal} is joined by straight lines: one measurement every {value}, the rest was made.",
        "made samples count as measured ones; errors are stated too small",
        f"keep the measured samples and leave the other cells empty: {COPY}",
        True,
    ),
    "quantised": (
        "{signal} comes in steps of {value}.",
        "its noise is that of rounding, which the errors have to allow for",
        "nothing, if the step is below what matters; else log more digits",
        False,
    ),
    "copied": (
        "{signal} at every sample: one column was written twice.",
        "one of the two says nothing, and which one nobody knows",
        "leave the column that is no measurement out of the file",
        True,
    ),
    "step": (
        "{signal} jumps by {jump} from one sample to the next at t = {time:.6g} s of {record} and "
        "stays there{more}: the sensor was set or reset.",
        "a model cannot move at once, and explains the new level by offsets and forces",
        f"cut the record there with window(), or subtract the jump from all later samples: {COPY}",
        True,
    ),
}


def screen_findings(
    dataset: Dataset, traces: Sequence[Trace], faults: list[Fault]
) -> list[Finding]:
    """Findings of all screens, one for each kind and signal."""
    series = {trace.name: trace for trace in traces}
    result = []
    for kind, signal in dict.fromkeys((f.kind, f.signal) for f in faults):
        here = [f for f in faults if (f.kind, f.signal) == (kind, signal)]
        result.append(_screened(kind, signal, here, series))
    return [*result, *_noise(dataset, traces), *_gaps(traces), *_copies(dataset)]


def _screened(kind: str, signal: str, here: list[Fault], series: dict[str, Trace]) -> Finding:
    """Finding of samples of one signal that say nothing, or little, or lie on another level."""
    largest = max(here, key=lambda one: abs(one.amount))
    trace = series[largest.record]
    names = tuple(signal.split(" = "))
    unit, size = trace.units[names[0]], largest.amount
    if kind == "dead":
        size = float(trace.values[signal][largest.rows[0]])
    row = int(largest.rows[largest.sizes.index(largest.amount)]) if largest.sizes else 0
    rows = {f.record: tuple(int(i) for i in f.rows) for f in here}
    n = sum(len(r) for r in rows.values())
    value, shown = angle_aware(size, unit)
    words = {
        "signal": signal, "n": n, "record": largest.record, "time": float(trace.times[row]),
        "value": f"{size:.3g} s" if kind in ("held", "interpolated") else f"{value:.4g} {shown}",
        "jump": f"{value:+.3g} {shown}", "its": "its" if n == 1 else "their",
        "samples": "sample" if n == 1 else "samples",
        "more": f" (and {n - 1} more {'jump' if n == 2 else 'jumps'})" * (n > 1),
    }  # fmt: skip
    says, changes, fix, suspect = SCREENS[kind]
    counted = kind in ("spikes", "dropouts", "frozen", "saturated")
    correction = Correction("blank", names, rows=rows)
    if kind == "step":
        sizes = {f.record: f.sizes for f in here}
        correction = Correction("step", (signal,), rows=rows, sizes=sizes)
    return Finding(
        kind, names, tuple(rows), says.format(**words), changes,
        fix.format(**words) if kind == "dead" else fix, suspect,
        size=float(n) if counted else size,
        unit="samples" if counted else unit * (kind == "step"),
        correction=None if kind in ("quantised", "copied") else correction,
    )  # fmt: skip


def _noise(dataset: Dataset, traces: Sequence[Trace]) -> list[Finding]:
    """Declared noise levels that the fast noise of the log contradicts."""
    result = []
    for output in dataset.channels.outputs:
        levels = [t.noise[output.name] for t in traces if output.name in t.noise]
        level = float(np.median(levels)) if levels else 0.0
        if not output.noise_std or level <= NOISIER * output.noise_std:
            continue
        (value, unit), (said, _) = (angle_aware(v, output.unit) for v in (level, output.noise_std))
        ratio = level / output.noise_std
        result.append(
            Finding(
                "noise",
                (output.name,),
                tuple(t.name for t in traces if output.name in t.noise),
                f"{output.name} is {ratio:.2g} times noisier than declared "
                f"({value:.3g} for {said:.3g} {unit}).",
                "with declared noise, errors are stated too small by as much",
                f'Output("{output.name}", "{output.unit}", noise_std={level:.2g}), or let the '
                "noise be estimated",
                False,
                size=ratio,
                unit="1",
            )
        )
    return result


def _gaps(traces: Sequence[Trace]) -> list[Finding]:
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
