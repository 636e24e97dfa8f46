"""Findings in words: what was found, what it does to an estimate, and the line that mends it.

One table (``findings.toml``) holds the sentences of every kind of finding; what fills them in are
facts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset, overlap
from oed_sysid.data.record import GAP
from oed_sysid.evidence.contrasts import LARGEST, LOUDER, Candidate, Found, Misfit, Result
from oed_sysid.evidence.relations import Relation
from oed_sysid.evidence.result import (
    KINDS,
    Correction,
    Finding,
    Judged,
    amount,
    interval,
    is_a,
    size_unit,
)
from oed_sysid.evidence.screens import Fault, Jitter
from oed_sysid.evidence.traces import Trace
from oed_sysid.likelihood.between_records import WORTH_TELLING
from oed_sysid.likelihood.noise_levels import credible_levels
from oed_sysid.physics.channels import Channels, Input, Output
from oed_sysid.runtime.display import counted
from oed_sysid.text.units import shown_unit

COPY = "oed-sysid check ... --fix FOLDER writes corrected copies"
# Faults that are other readings of the same numbers: seen where a scale of one would be.
READ = ("sign", "unit", "swap")
# What may be wrong in place of an input.
NOMINAL = "a nominal model or priors that are wrong by as much"


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
    row = row or kind
    words = _of(signals) | {"copy": COPY} | words
    says, changes, line = (KINDS[row][text].format(**words) for text in ("says", "changes", "fix"))
    facts = {"suspect": not is_a(row, "note")} | facts
    return Finding(kind, signals, records, says, changes, fix or line, **facts)


def _of(signals: Sequence[str]) -> dict[str, str]:
    """Names of signals as sentences need them."""
    if not signals:
        return {}
    *most, last = signals
    both = f"{', '.join(most)} and {last}" if most else last
    names = {"commas": ", ".join(signals), "both": both, "first": signals[0], "last": last}
    of_one = {"have": "has", "are": "is", "come": "comes"}
    return names | {verb: verb if most else one for verb, one in of_one.items()}


def rival(one: Found) -> str:
    """Another explanation in a few words."""
    fault, row = one.candidate, _row_of_reading(one.candidate)
    text = KINDS.get(row, {}).get("rival", f"{row} of {{both}}")
    words = {"meaning": fault.meaning, "rate": "".join(fault.other)}
    where = f" in {fault.record}" if fault.record else ""
    shown = _size(one.size, fault.unit, ".2g" if fault.unit == "1" else ".3g")
    return f"{text.format(**_of(fault.signals), **words)}{where}" + f" ({shown})" * bool(one.std)


def _row_of_reading(fault: Candidate) -> str:
    """Row of the table that tells of another reading of the same numbers; else of the kind."""
    if "twice" in fault.meaning:
        return "twice"
    return "turned" if fault.kind == "misalignment" and fault.meaning else fault.kind


def _size(size: float, unit: str, form: str) -> str:
    """Size of a fault in people's units."""
    factor, shown = size_unit(unit)
    return f"{factor * size:{form}} {shown}"


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
            if text := next(self._levels(name, names), ""):
                output = f'Output("{name}", "m/s", expression="{text}")'
                lines.append(output if self._channel(name) is not None else f"{name} = {text}")
        return f"{' and '.join(lines)}; or {COPY}" if lines else COPY

    def _levels(self, name: str, names: tuple[str, ...]) -> Iterator[str]:
        """Right sides that a signal alone is at level attitude."""
        rates = (r for r in self.relations if r.is_rate and name in r.signals)
        for r in rates:
            if r.target not in names and abs(r.level(name) - 1.0) < 1e-6:
                yield r.text

    def _others(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Signals that are related to some, directly or through each other."""
        found: dict[str, None] = {}
        fresh = set(names)
        while fresh:
            touched = (r.names for r in self.relations if fresh & {*r.names})
            fresh = set().union(*touched) - {*names, *found}
            found |= dict.fromkeys(sorted(fresh))
        return tuple(found)

    def reading(self, one: Found) -> Finding:
        """Words for another reading of the same numbers."""
        fix, names, meaning = one.correction, one.candidate.signals, one.candidate.meaning
        unit, twice = getattr(self._channel(names[0]), "unit", ""), "twice" in meaning
        header = unit if twice and unit else meaning
        columns = [*map(self._column, names)]
        signs = (-getattr(self._channel(name), "sign", 1.0) for name in names)
        lines = {
            "headers": [f'write the header as "{column} [{header}]"' for column in columns],
            "signs": map(self._declared, names, (f"sign={sign:g}" for sign in signs)),
            "columns": map(self._declared, names, (f'column="{c}"' for c in reversed(columns))),
        }
        words = {key: " and ".join(each) for key, each in lines.items()} | {
            "meaning": meaning, "declared": unit,
            "times": f"{1.0 / fix.value:.3g}", "factor": fix.value,
            "frames": self._frame(names),
            "units": ", ".join(f'"{name}": "{meaning}"' for name in names),
        }  # fmt: skip
        row, others = _row_of_reading(one.candidate), tuple(map(rival, one.rivals))
        if names[0] in self.channels.input_names:
            row, others = f"input {row}", (*others, NOMINAL)
        return said(
            fix.kind, names, self.records, words, row=row, gain=one.gain, alternatives=others,
            correction=None if row == "input swap" else fix,
        )  # fmt: skip

    def sized(self, one: Found) -> Finding:
        """Words for a fault with a size."""
        fault, here = one.candidate, one.candidate.record
        of_input = fault.signals[0] in self.channels.input_names
        row, names, size = self._row_of(fault, one.size, of_input=of_input)
        bounds, at = interval(size, one.std), self.at(fault)
        words = {
            "early": " and ".join(fault.signals), "shown": amount(size, bounds, fault.unit),
            "unit": fault.unit, "size": abs(size), "left": 1.0 - size,
            "rate": "".join(fault.other), "record": here, "at": at,
            "since": f"from t = {at:.6g} s of {here} on" if fault.placed else f"in {here}",
            "where": f" in {here}" * bool(here), "own": ", per_record=True" * bool(here),
        }  # fmt: skip
        delayed = (*names, here) if fault.kind == "delay" and not of_input else ()
        told = (each for each in one.rivals if self._delayed(each) != delayed)
        others = (*map(rival, told), *[NOMINAL] * of_input)
        kinds = {"rate": "clock", "input scale": "scale"}
        undone = replace(one.correction, signals=names, value=size)
        allowed = bool(self.modelled & {*fault.signals})
        return said(
            kinds.get(row, fault.kind), names, (here,) if here else self.records, words, row=row,
            fix=self._fix(row, names, allowed=allowed), size=size, interval=bounds,
            unit=fault.unit, gain=one.gain, alternatives=others,
            correction=None if of_input or row == "run" else undone,
            suspect=not (allowed or is_a(row, "note")),
        )  # fmt: skip

    def _fix(self, row: str, names: tuple[str, ...], *, allowed: bool) -> str:
        """What to do in place of the line of the table, if that cannot be done."""
        if allowed:
            return "the model has an effect for it already"
        if "effect" in KINDS[row]["fix"] and self._channel(names[0]) is None:
            return f"{' and '.join(names)} is no output of the model: {COPY}"
        return ""

    def _delayed(self, one: Found) -> tuple[str, ...]:
        """Signals that a delay makes late, and its record: where one is ahead, the others are."""
        fault = one.candidate
        if fault.kind != "delay":
            return (fault.kind,)
        names = self._others(fault.signals) if one.size < 0.0 else fault.signals
        return (*names, fault.record)

    def _row_of(
        self, fault: Candidate, size: float, *, of_input: bool
    ) -> tuple[str, tuple[str, ...], float]:
        """Row of the table that tells of a fault, the signals it is told of, and its size there."""
        late = fault.kind == "delay" and size < 0.0
        if of_input and late:
            return "input late", fault.signals, -size
        if of_input:
            scaled = fault.kind == "lost" and not fault.record
            return "input scale" if scaled else f"input {fault.kind}", fault.signals, size
        if late:  # nothing is measured before it happens: the others lag
            return "ahead", self._others(fault.signals), -size
        current = fault.kind == "drift" and fault.unit == "m/s"
        return "current" if current else fault.kind, fault.signals, size


def _kinds_of(fault: Candidate) -> tuple[str, ...]:
    """Rows of the table of what was tested that a fault with a size stands for."""
    if fault.kind == "scale" or (fault.kind == "lost" and not fault.record):
        return ("scale", *READ)
    return (fault.kind,)


def _least_seen(kind: str, name: str, ended: Result) -> tuple[float, float]:
    """From which size on a fault of a signal would have been seen, and how large it can be."""
    sizes = (
        (float(of), LARGEST * fault.plausible)
        for fault, of in ended.seen
        if fault.signals == (name,) and kind in _kinds_of(fault)
    )
    return min(sizes, default=(np.inf, 0.0))


def judged_row(kind: str, name: str, unit: str, ended: Result, *, related: bool = True) -> Judged:
    """Whether a fault was tested, from which size on, or why it was not."""
    size, plausible = _least_seen(kind, name, ended)
    alike = (each.candidate for one in ended.found for each in (one, *one.rivals))
    units = {"scale": "1", "delay": "s", "lost": "1", "rate": "1", "drift": f"{unit}/s"}
    of_size = kind not in READ and np.isfinite(size)
    shown = _size(size, units.get(kind, unit), ".1g") if of_size else ""
    if size <= plausible:
        return Judged(kind, name, "tested", shown)
    whys = {
        "no faults explain what the nominal model leaves": not ended.settled,
        "nothing in which it moves enough": kind in READ,
        "no equation without unknown parameters relates it": not related,
        f"the motion shows it from {shown} on only": bool(shown),
        "these records cannot tell it from what was found": any(
            fault.signals == (name,) and kind in _kinds_of(fault) for fault in alike
        ),
        "nothing that was measured depends on it": True,
    }
    return Judged(kind, name, "not tested", next(why for why, true in whys.items() if true))


def misfit_finding(misfits: Sequence[Misfit], relations: tuple[Relation, ...]) -> Iterator[Finding]:
    """One finding for each equation that fails somewhere, with the record where it fails most."""
    for index in dict.fromkeys(one.relation for one in misfits):
        relation = relations[index]
        here = [one for one in misfits if one.relation == index]
        worst = max(here, key=lambda one: one.share)
        words = {
            "relation": relation, "share": f"{100.0 * worst.share:.0f}", "record": worst.record,
            "at": worst.time, "more": f" (and in {len(here) - 1} more)" * (len(here) > 1),
        }  # fmt: skip
        names, records = tuple(dict.fromkeys(relation.names)), tuple(one.record for one in here)
        yield said("unexplained", names, records, words, size=worst.share, unit="1")


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
    made = {fault.signal for fault in faults if is_a(fault.kind, "made")}
    return [*result, *_noise(dataset, traces, made), *_gaps(traces), *_copies(dataset)]


def screened_inputs(faults: Iterable[Fault], traces: Sequence[Trace]) -> Iterator[Finding]:
    """Findings of samples of inputs that say nothing; suspect, as no input can be left empty."""
    series = {trace.name: trace for trace in traces}
    for fault in faults:
        found = _screened(fault.kind, fault.signal, [fault], series)
        row = KINDS["input held" if fault.kind == "held" else "input frozen"]
        changes = row["changes"].format(both=fault.signal)
        yield replace(found, changes=changes, fix=row["fix"], correction=None, suspect=True)


def _screened(kind: str, signal: str, here: list[Fault], series: dict[str, Trace]) -> Finding:
    """Finding of samples of one signal that say nothing, or little, or lie on another level."""
    largest = max(here, key=lambda one: abs(one.amount))
    trace, names, size = series[largest.record], largest.names, largest.amount
    if kind == "dead":
        size = float(trace.values[signal][largest.rows[0]])
    jumps = bool(largest.sizes)
    first = int(largest.rows[largest.sizes.index(largest.amount)]) if jumps else 0
    rows = {fault.record: tuple(fault.rows.tolist()) for fault in here}
    n = sum(map(len, rows.values()))
    factor, shown = shown_unit(trace.units[names[0]])
    words = {
        "commas": signal, "samples": counted(n, "sample"), "record": largest.record,
        "at": float(trace.times[first]), "value": f"{factor * size:.4g} {shown}", "size": size,
        "jump": f"{factor * size:+.3g} {shown}", "its": "its" if n == 1 else "their",
        "more": f" (and {n - 1} more {'jump' if n == 2 else 'jumps'})" * (n > 1),
    }  # fmt: skip
    facts: dict[str, Any] = {"size": size, "unit": trace.units[names[0]] if jumps else ""}
    if is_a(kind, "counted"):
        facts = {"size": float(n), "unit": "samples"}
    sizes = {fault.record: fault.sizes for fault in here} if jumps else {}
    correction = Correction("step" if jumps else "blank", names, rows=rows, sizes=sizes)
    return said(
        "step" if jumps else kind, names, tuple(rows), words,
        row="jump" if kind == "step" else kind,
        correction=None if is_a(kind, "as logged") else correction, **facts,
    )  # fmt: skip


def _noise(dataset: Dataset, traces: Sequence[Trace], made: set[str]) -> Iterable[Finding]:
    """Declared noise levels that the fast noise of measured samples contradicts."""
    levels, seen = credible_levels(dataset)
    for output, level, told in zip(dataset.channels.outputs, levels, seen, strict=True):
        declared = output.noise_std
        if output.name in made or not (told and declared and level > WORTH_TELLING * declared):
            continue
        records = tuple(t.name for t in traces if output.name in t.noise)
        factor, unit = shown_unit(output.unit)
        words = {
            "ratio": level / declared, "level": factor * level, "said": factor * declared,
            "unit": unit, "found": level, "si": output.unit,
        }  # fmt: skip
        size = float(level / declared)
        yield said("noise", (output.name,), records, words, size=size, unit="1")


def _gaps(traces: Sequence[Trace]) -> Iterable[Finding]:
    """Jumps in time."""
    for trace in traces:
        steps = np.diff(trace.times)
        wide = np.flatnonzero(steps > GAP * trace.step)
        if wide.size and trace.step > 0.0:
            longest = wide[np.argmax(steps[wide])]
            size = float(steps[longest])
            words = {"gaps": counted(wide.size, "gap"), "size": size, "at": trace.times[longest]}
            yield said("gap", (), (trace.name,), words, size=size, unit="s")


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


def jitter_finding(found: Jitter, dataset: Dataset) -> Iterator[Finding]:
    """Times that scatter; suspect where they disorder samples, else noise that errors allow for."""
    if found.signals:
        bounds = interval(found.size, found.std)
        words = {"shown": amount(found.size, bounds, "s"), "share": f"{100.0 * found.share:.0f}"}
        yield said("jitter", found.signals, dataset.names, words, suspect=found.disorders,
                   size=found.size, interval=bounds, unit="s")  # fmt: skip


def jitter_rows(found: Jitter, names: Sequence[str]) -> list[Judged]:
    """From which size on scattering times would show in each signal, or why they would not."""
    why = "no other signal changes fast enough beside it"
    seen = {n: _size(v, "s", ".1g") for n, v in found.visible.items()}
    return [Judged("jitter", n, "tested" if n in seen else "not tested", seen.get(n, why))
            for n in names]  # fmt: skip


def clock_findings(traces: list[Trace], relations: tuple[Relation, ...]) -> Iterator[Finding]:
    """Gaps in time over which the signals contradict the clock."""
    for trace in traces:
        steps = np.diff(trace.times)
        for k in np.flatnonzero(steps > WORTH_TELLING * trace.step):
            if _contradicts(trace, relations, int(k)):
                more = float(steps[k] - trace.step)
                words = {"size": steps[k], "at": trace.times[k], "step": trace.step, "more": more}
                yield said("clock", (), (trace.name,), words, size=more, unit="s")


def _contradicts(trace: Trace, relations: tuple[Relation, ...], k: int) -> bool:
    """Whether the changes over a gap agree with a usual step, and not with the clock's."""
    off, rows = np.zeros((1, 2)), slice(max(k - 4, 0), k + 6)
    before = k + 1 - rows.start
    spans = np.array([trace.times[k + 1] - trace.times[k], trace.step])
    for relation in relations:
        here = {n: trace.values[n][rows] for n in relation.names if n in trace.values}
        whole = len(here) == len({*relation.names}) and np.isfinite([*here.values()]).all()
        if not relation.is_rate or not whole or here[relation.target].size < before + 5:
            continue
        rate = float(np.mean(relation(here, trace.times[rows])))
        # Means of five samples on either side, five usual steps apart beside the gap.
        ends = np.split(here[relation.target], [before])
        change = float(np.mean(ends[1]) - np.mean(ends[0]))
        noise = trace.noise[relation.target] * np.sqrt(2.0 / 5.0) + 0.02 * abs(rate) * spans[0]
        noise += 1e-9 + 1e-3 * abs(change)
        off = np.vstack([off, np.abs(change - rate * (spans + 4.0 * trace.step)) / noise])
    by_clock, by_step = off.max(axis=0)
    return bool(by_clock > LOUDER and by_step < 0.5 * LOUDER)
