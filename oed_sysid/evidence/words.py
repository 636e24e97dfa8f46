"""Findings in words: what was found, what it does to an estimate, and the line that mends it.

One table holds the sentences of every kind of finding; what fills them in are facts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
NO_FAULT = ("input lag", "input late", "input scale", "run")
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
        "{both} acts {left:.2g} times as strongly as logged.",
        "the coefficients of {both} are wrong by as much",
        "calibrate {both}, or correct the unit in the header",
    ),
    "input delay": (
        "the vehicle answers {both} {shown} before the log shows it.",
        "lags of actuators and damping are wrong by as much",
        "shift {both} back in time, or the outputs forward, before the columns are joined",
    ),
    "input lost": (
        "{both} acts {left:.2g} times as strongly {since} as before or in the other records: its "
        "actuator failed, or was not coupled.",
        "the coefficients of {both} are fitted too small, by a compromise",
        "cut the record there with window(), or leave it out",
    ),
    "input dead": (
        "{both} never changes in the log, but the vehicle moves as if it had: a free input of its "
        "kind explains {share} % of what the nominal model leaves.",
        "what {both} did is fitted to forces that were not",
        "log {both}; without it no coefficient of it can be estimated",
    ),
    "input lag": (
        "the vehicle answers {both} as through a lag of first order of {lag:.2g} s: its command "
        "was logged in place of its feedback.",
        "damping and added mass take the place of the lag",
        "log the feedback, or give the model a lag of the actuator as a candidate",
    ),
    "input late": (
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
    if signals:
        *most, last = signals
        both = f"{', '.join(most)} and {last}" if most else last
        words = {"commas": ", ".join(signals), "both": both} | words
        words = {"first": signals[0], "last": last} | words
    line = fix or line.format(**words)
    says, changes = says.format(**words), changes.format(**words)
    return Finding(kind, signals, records, says, changes, line, **facts)


# -- other readings --------------------------------------------------------------------------


def _say_reading(one: Reading) -> str:
    """Another reading in a few words, for lists of rivals."""
    names = " and ".join(one.correction.signals)
    words = {
        "sign": "with the other sign",
        "unit": one.meaning if "twice" in one.meaning else f"in {one.meaning}",
        "swap": "in each other's column",
        "frame": "along the axes of the positions",
        "offset": f"counted from elsewhere ({one.meaning})",
    }
    return f"{names} {words[one.correction.kind]}"


def _say_sized(one: Candidate, size: float) -> str:
    """A fault with a size in a few words, for lists of rivals."""
    names = " and ".join(one.signals)
    words = {
        "lever": f"lever arm of {names} against {''.join(one.other)}",
        "drift": f"current or drift along {names}",
        "rate": f"slow clock of {names}",
        "run": f"another {names}",
    }.get(one.kind, f"{one.kind} of {names}")
    where = f" in {one.record}" if one.record else ""
    return f"{words}{where} ({_size(size, one.unit, '.2g' if one.unit == '1' else '.3g')})"


def _size(size: float, unit: str, form: str) -> str:
    """Size of a fault in people's units."""
    value, shown = (100.0 * size, "%") if unit == "1" else angle_aware(size, unit)
    return f"{value:{form}} {shown}"


@dataclass(frozen=True)
class Log:
    """What findings are about: channels, equations between signals, and records.

    Parameters
    ----------
    channels : Channels
    relations : tuple of Relation
    records : tuple of str
    ends : mapping of str to (float, float)
        First and last time of each record, s.
    modelled : frozenset of str
        Signals on which the model has an effect of a sensor.
    """

    channels: Channels
    relations: tuple[Relation, ...]
    records: tuple[str, ...]
    ends: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    modelled: frozenset[str] = frozenset()

    def at(self, fault: Candidate) -> float:
        """When a fault begins in its record, s."""
        start, end = self.ends.get(fault.record, (0.0, 1.0))
        return start + fault.span[0] * (end - start)

    def _channel(self, name: str) -> Input | Output | None:
        return next((channel for channel in self.channels.all if channel.name == name), None)

    def _column(self, name: str) -> str:
        return getattr(self._channel(name), "column", "") or name

    def _is_input(self, name: str) -> bool:
        return name in self.channels.input_names

    def _declared(self, name: str, change: str) -> str:
        """Declaration of a channel with something changed; words for a column nobody declared."""
        channel = self._channel(name)
        if channel is None:
            return f'for the column "{name}", once a channel reads it: {change}'
        return f'{type(channel).__name__}("{name}", "{channel.unit}", {change})'

    def _frame(self, names: tuple[str, ...]) -> str:
        """Declare the velocities as what they are, where the model has the equations for it."""
        lines = []
        for name in names:
            rates = (r for r in self.relations if r.is_rate and name in r.signals)
            own = [r for r in rates if r.target not in names and abs(r.level(name) - 1.0) < 1e-6]
            for text in (r.text for r in own[:1]):
                known = self._channel(name) is not None
                output = f'Output("{name}", "m/s", expression="{text}")'
                lines.append(output if known else f"{name} = {text}")
        return f"{' and '.join(lines)}; or {COPY}" if lines else COPY

    def _others(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Signals that are related to some, directly or through each other."""
        found: dict[str, None] = {}
        fresh = set(names)
        while fresh:
            touched = (r.names for r in self.relations if fresh & {*r.names})
            fresh = set().union(*touched) - {*names, *found}
            found |= dict.fromkeys(sorted(fresh))
        return tuple(found)

    def reading(self, one: Reading) -> Finding:
        """Words for another reading of the same numbers."""
        fix, names = one.correction, one.correction.signals
        unit, twice = getattr(self._channel(names[0]), "unit", ""), "twice" in one.meaning
        header = unit if twice and unit else one.meaning
        lists: dict[str, list[str]] = {"headers": [], "signs": [], "columns": []}
        for name, other in zip(names, reversed(names), strict=True):
            channel, column = self._channel(name), self._column(other)
            sign = -getattr(channel, "sign", 1.0)
            lists["headers"].append(f'write the header as "{self._column(name)} [{header}]"')
            lists["signs"].append(self._declared(name, f"sign={sign:g}"))
            lists["columns"].append(self._declared(name, f'column="{column}"'))
        have, are = ("has", "is") if len(names) == 1 else ("have", "are")
        words = {key: " and ".join(each) for key, each in lists.items()} | {
            "have": have, "are": are, "meaning": one.meaning, "declared": unit,
            "times": f"{1.0 / fix.value:.3g}", "factor": fix.value, "lag": fix.value,
            "frames": self._frame(names),
            "units": ", ".join(f'"{name}": "{one.meaning}"' for name in names),
        }  # fmt: skip
        row, others = "twice" if twice else fix.kind, tuple(map(_say_reading, one.rivals))
        if self._is_input(names[0]):
            row, others = f"input {row}", (*others, NOMINAL)
        return said(
            fix.kind, names, self.records, words, row=row, gain=one.gain, alternatives=others,
            correction=None if row in ("input swap", "input lag") else fix,
            suspect=row not in NO_FAULT,
        )  # fmt: skip

    def sized(self, one: Found) -> Finding:
        """Words for a fault with a size."""
        fault, early = one.candidate, " and ".join(one.candidate.signals)
        of_input = self._is_input(fault.signals[0])
        row, names, size = self._row_of(fault, one.size, of_input=of_input)
        bounds = interval(size, one.std)
        undone = replace(one.correction, signals=names, value=size)
        at = self.at(fault)
        words = {
            "early": early, "come": "come" if len(names) > 1 else "comes",
            "shown": amount(size, bounds, fault.unit), "unit": fault.unit, "size": abs(size),
            "rate": "".join(fault.other), "record": fault.record,
            "at": at, "left": 1.0 - size,
            "since": f"from t = {at:.6g} s of {fault.record} on" if fault.placed
            else f"in {fault.record}",
            "where": f" in {fault.record}" * bool(fault.record),
            "own": ", per_record=True" * bool(fault.record),
        }  # fmt: skip
        allowed = bool(self.modelled & {*fault.signals})
        fix = "the model has an effect for it already" if allowed else ""
        if not fix and "effect" in SAYS[row][2] and self._channel(names[0]) is None:
            fix = f"{' and '.join(names)} is no output of the model: {COPY}"
        others = tuple(_say_sized(*rival) for rival in one.rivals)
        kinds = {"rate": "clock", "input scale": "scale"}
        return said(
            kinds.get(row, fault.kind), names,
            (fault.record,) if fault.record else self.records, words, row=row, fix=fix,
            suspect=not allowed and row not in NO_FAULT, size=size, interval=bounds,
            unit=fault.unit, gain=one.gain, alternatives=(*others, *[NOMINAL] * of_input),
            correction=None if of_input or row == "run" else undone,
        )  # fmt: skip

    def _row_of(
        self, fault: Candidate, size: float, *, of_input: bool
    ) -> tuple[str, tuple[str, ...], float]:
        """Row of the table that tells of a fault, the signals it is told of, and its size there."""
        if of_input:
            if fault.kind == "lost" and not fault.record:
                return "input scale", fault.signals, size
            late = fault.kind == "delay" and size < 0.0
            return f"input {'late' if late else fault.kind}", fault.signals, -size if late else size
        if fault.kind == "delay" and size < 0.0:
            # Nothing is measured before it happens: the others lag.
            return "ahead", self._others(fault.signals), -size
        current = fault.kind == "drift" and fault.unit == "m/s"
        return "current" if current else fault.kind, fault.signals, size


def _kinds_of(fault: Candidate) -> tuple[str, ...]:
    """Rows of the table of what was tested that a fault with a size stands for."""
    if fault.kind == "scale" or (fault.kind == "lost" and not fault.record):
        return ("scale", *READ)
    return (fault.kind,)


def judged_row(
    kind: str, name: str, unit: str, ended: Result | None, *, related: bool = True
) -> Judged:
    """Whether a fault was tested, from which size on, or why it was not."""
    sizes = [] if ended is None else [
        (float(v), LARGEST * f.plausible)
        for f, v in zip(ended.faults, ended.visible, strict=True)
        if f.signals == (name,) and kind in _kinds_of(f)
    ]  # fmt: skip
    size, plausible = min(sizes, default=(np.inf, 0.0))
    units = {"scale": "1", "delay": "s", "lost": "1", "rate": "1"}
    unit = (units | {"drift": f"{unit}/s"}).get(kind, unit)
    shown = _size(size, unit, ".1g") if kind not in READ and np.isfinite(size) else ""
    why = "nothing that was measured depends on it"
    if kind in READ:
        why = "nothing in which it moves enough"
    elif not related:
        why = "no equation without unknown parameters relates it"
    elif shown:
        why = f"the motion shows it from {shown} on only"
    tested = size <= plausible
    return Judged(kind, name, "tested" if tested else "not tested", shown if tested else why)


def misfit_finding(misfits: Sequence[Misfit], relations: tuple[Relation, ...]) -> list[Finding]:
    """One finding for each equation that fails somewhere, with the record where it fails most."""
    result = []
    for index in dict.fromkeys(one.relation for one in misfits):
        relation = relations[index]
        here = [one for one in misfits if one.relation == index]
        worst = max(here, key=lambda one: one.share)
        words = {
            "relation": relation, "share": f"{100.0 * worst.share:.0f}", "record": worst.record,
            "at": worst.time, "more": f" (and in {len(here) - 1} more)" * (len(here) > 1),
        }  # fmt: skip
        names, records = tuple(dict.fromkeys(relation.names)), tuple(one.record for one in here)
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
    trace, names, size = series[largest.record], largest.names, largest.amount
    unit = trace.units[names[0]]
    if kind == "dead":
        size = float(trace.values[signal][largest.rows[0]])
    row = int(largest.rows[largest.sizes.index(largest.amount)]) if largest.sizes else 0
    rows = {fault.record: tuple(fault.rows.tolist()) for fault in here}
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
    sizes = {fault.record: fault.sizes for fault in here} if steps else {}
    correction = Correction("step" if steps else "blank", names, rows=rows, sizes=sizes)
    return said(
        "step" if steps else kind, names, tuple(rows), words,
        row="jump" if kind == "step" else kind,
        suspect=kind not in ("held", "quantised"), size=float(n) if many else size,
        unit="samples" if many else unit * steps,
        correction=None if kind in ("quantised", "copied", "caught up") else correction,
    )  # fmt: skip


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
            names = first.name, second.name
            words = {"first": first.name, "last": second.name, "n": found.n_equal}
            size = float(found.n_equal)
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
        if not relation.is_rate or not {*relation.names} <= trace.values.keys():
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
