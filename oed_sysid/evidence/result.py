"""What a check of a log found: findings with sizes, fixes and words."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.sentences import SAYS
from oed_sysid.likelihood.fit import MOST_DRAWN
from oed_sysid.runtime import display
from oed_sysid.runtime.display import Figure, Section, Table, as_dict, counted, share
from oed_sysid.runtime.tables import tables
from oed_sysid.text.units import shown_unit

# Kinds of finding: sentences, and what follows from each.
KINDS: dict[str, dict[str, Any]] = tables(__file__, "findings")
# Faults that change a model's coefficients, whatever the motion.
MATTER = ("sign", "unit", "scale", "delay")


def is_a(kind: str, what: str) -> bool:
    """Whether something follows from a kind of finding, such as ``"contradiction"``."""
    # Faults that inputs alone can have, such as a lag, are no kinds of the table.
    return what in KINDS.get(kind, {}).get("is", ())


def kinds_that_are(what: str) -> tuple[str, ...]:
    """All kinds of finding from which something follows."""
    return tuple(kind for kind in KINDS if is_a(kind, what))


@dataclass(frozen=True)
class Correction:
    """How to undo a finding in a copy of a record.

    Parameters
    ----------
    kind : str
        ``sign``, ``unit``, ``swap``, ``frame``, ``offset``, ``bias``, ``scale``, ``delay``,
        ``lever``, ``misalignment``, ``step`` or ``blank``.
    signals : tuple of str
        Signals that change.
    value : float
        Factor, offset, relative error, delay in s, lever in m or angle in rad.
    other : tuple of str
        Signals that the change needs: the rate of a lever arm.
    rows : mapping
        For ``blank``: record name to the indices of samples to leave out; for ``step``: to the
        indices of the first samples after each jump.
    sizes : mapping
        For ``step``: record name to the jump at each of these indices, in the signal's SI unit.
    record : str
        The only record that changes; empty for all of them.
    span : tuple of float
        For ``step`` and ``burst``: share of the record where it begins and ends.

    Examples
    --------
    >>> Correction("sign", ("r",), -1.0).key
    ('sign', ('r',), (), '', 0.0)
    """

    kind: str
    signals: tuple[str, ...]
    value: float = 1.0
    other: tuple[str, ...] = ()
    rows: dict[str, tuple[int, ...]] = field(default_factory=dict, repr=False)
    sizes: dict[str, tuple[float, ...]] = field(default_factory=dict, repr=False)
    record: str = ""
    span: tuple[float, float] = (0.0, 1.0)

    @property
    def key(self) -> Hashable:
        """What is wrong where and from when on, whatever its size."""
        return self.kind, self.signals, self.other, self.record, self.span[0]


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a log, or worth knowing.

    Parameters
    ----------
    kind : str
        What: ``sign``, ``unit``, ``swap``, ``frame``, ``bias``, ``scale``, ``delay``, ``lever``,
        ``misalignment``, ``drift``, ``spikes``, ``dropouts``, ``frozen``, ``saturated``, ``held``,
        ``dead``, ``gap``, ``clock``, ``duplicate``, ``quantised``, ``noise``, ``step``,
        ``unexplained`` …
    signals : tuple of str
        Signals concerned.
    records : tuple of str
        Records concerned.
    says : str
        The finding in a sentence.
    changes : str
        What it would do to an estimate.
    fix : str
        A line for the problem file, or words for a corrected copy.
    suspect : bool
        Whether the log should not be used as it is; otherwise it is good to know.
    size : float or None
        Estimated size, in ``unit``.
    interval : tuple of float or None
        Its 95 % interval.
    unit : str
        Unit of the size.
    gain : float or None
        Likelihood-ratio statistic (twice the logarithm of the likelihood ratio).
    alternatives : tuple of str
        Other explanations that these records cannot tell from this one.
    correction : Correction or None
        How a corrected copy undoes it.

    Examples
    --------
    One of ``check(...).findings``; see :func:`~oed_sysid.evidence.check.check`.
    """

    kind: str
    signals: tuple[str, ...]
    records: tuple[str, ...]
    says: str
    changes: str
    fix: str
    suspect: bool = True
    size: float | None = None
    interval: tuple[float, float] | None = None
    unit: str = ""
    gain: float | None = None
    alternatives: tuple[str, ...] = ()
    correction: Correction | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Kind and signals in one word, such as ``"bias q"``."""
        return f"{self.kind} {', '.join(self.signals)}".strip()

    def lines(self) -> list[str]:
        """Return the finding as sentences, the most important first."""
        gain = "" if self.gain is None else f" Likelihood-ratio statistic {self.gain:.0f}."
        others = "; ".join(self.alternatives)
        rows = {
            "These records cannot tell it from: ": f"{others}." * bool(others),
            "Left as it is: ": self.changes,
            "Fix: ": self.fix,
        }
        return [self.says + gain, *(begin + text for begin, text in rows.items() if text)]

    to_dict = as_dict(
        "name", "kind", "signals", "records", "says", "changes", "fix", "suspect", "size",
        "interval", "unit", "gain", "alternatives", "correction",
    )  # fmt: skip


@dataclass(frozen=True)
class Balance:
    """How well one equation between signals holds.

    Parameters
    ----------
    relation : str
        The equation.
    before, after : float
        Root mean square of what is left of the left side's changes, as a share of them, in the
        log as it is and with the findings undone.
    target, unit : str
        Signal on the left side and the unit of the series.
    series : tuple of (str, ndarray, ndarray, ndarray)
        Record, times ``(n_blocks,)``, residual before and after ``(n_blocks,)``: the signal
        minus the integral of the other signals.

    Examples
    --------
    >>> Balance("psi' = r", before=0.62, after=0.05, target="psi", unit="rad").after
    0.05
    """

    relation: str
    before: float
    after: float
    target: str
    unit: str
    series: tuple[tuple[str, np.ndarray, np.ndarray, np.ndarray], ...] = field(
        default=(), repr=False, compare=False
    )

    to_dict = as_dict("relation", "before", "after")


@dataclass(frozen=True)
class Judged:
    """What was asked of one signal.

    Parameters
    ----------
    fault : str
        Kind of fault.
    signal : str
        Output or input.
    state : str
        ``tested``, ``found`` or ``not tested``.
    says : str
        From which size on the fault would have been seen, or why it could not be tested.

    Examples
    --------
    >>> Judged("bias", "r", "tested", "from 0.02 deg/s on").state
    'tested'
    """

    fault: str
    signal: str
    state: str
    says: str = ""

    @property
    def cell(self) -> str:
        """The answer in a table: a size that would have been seen, or whether it was asked."""
        return {"tested": self.says or "yes", "found": "FOUND"}.get(self.state, "-")

    to_dict = as_dict("fault", "signal", "state", "says")


@dataclass(frozen=True)
class LogCheck:
    """Result of :func:`~oed_sysid.evidence.check`.

    Parameters
    ----------
    findings : tuple of Finding
        What was found, suspect ones first.
    records : tuple of str
        Records that were looked at.
    relations : tuple of str
        Equations between signals that were used.
    balances : tuple of Balance
        How well each of them holds.
    unchecked : tuple of str
        What these equations cannot tell, in sentences.
    judged : tuple of Judged
        What was asked of every signal, and what could not be.
    duration : float
        Time that the check took, s.

    Examples
    --------
    >>> LogCheck((), ("run_1",), relations=("psi' = r",)).verdict
    'The signals agree with each other.'
    """

    findings: tuple[Finding, ...]
    records: tuple[str, ...]
    relations: tuple[str, ...] = ()
    balances: tuple[Balance, ...] = field(default=(), repr=False)
    unchecked: tuple[str, ...] = ()
    judged: tuple[Judged, ...] = field(default=(), repr=False)
    duration: float = math.nan

    _repr_html_ = display.as_html

    def __repr__(self) -> str:
        return f"<LogCheck of {len(self.records)} records: {self.verdict}>"

    @property
    def suspect(self) -> bool:
        """Whether the log contradicts itself and should not be used as it is."""
        return any(finding.suspect for finding in self.findings)

    @property
    def ok(self) -> bool:
        """Whether nothing suspect was found."""
        return not self.suspect

    @property
    def serious(self) -> tuple[Finding, ...]:
        """Return the findings that make the log suspect."""
        return tuple(finding for finding in self.findings if finding.suspect)

    @property
    def unjudged(self) -> tuple[str, ...]:
        """What nothing in the log tells from a fault of a sensor, in words."""
        jumps = [f for f in self.findings if f.kind == "step" and not f.suspect]
        return tuple(f"whether {f.signals[0]} jumped or its sensor was set" for f in jumps)

    @property
    def verdict(self) -> str:
        """One sentence."""
        if self.suspect:
            names = "; ".join(finding.name for finding in self.serious)
            return f"Log suspect: {counted(len(self.serious), 'finding')} ({names})."
        if not self.relations:
            return SAYS["log"]["unrelated"]
        names = "; ".join(f"{kind} of {', '.join(of)}" for kind, of in self.not_tested.items())
        if names:
            return f"The signals agree as far as they could be tested. Not tested: {names}."
        return "The signals agree with each other."

    @property
    def not_tested(self) -> dict[str, tuple[str, ...]]:
        """Signals by kind of the faults that change a model and could not be tested."""
        rows = [one for one in self.judged if one.state == "not tested" and one.fault in MATTER]
        return {kind: tuple(r.signal for r in rows if r.fault == kind)
                for kind in dict.fromkeys(r.fault for r in rows)}  # fmt: skip

    def named(self, kind: str, signal: str | None = None) -> Finding | None:
        """Return the first finding of a kind, of a signal if given; None if there is none."""
        alike = (one for one in self.findings if one.kind == kind)
        return next((one for one in alike if signal in (None, *one.signals)), None)

    def without(self, kind: str) -> LogCheck:
        """Return the result without the findings of one kind."""
        return replace(self, findings=tuple(one for one in self.findings if one.kind != kind))

    def warning(self) -> str:
        """Return a paragraph to put above a result made from this log; empty if it is ok."""
        if self.ok:
            return ""
        lines = (f"  - {one.says} Fix: {one.fix}" for one in self.serious)
        return "\n".join((self.verdict, *lines))

    def document(self, dataset: Dataset | None = None, *, title: str = "") -> display.Report:
        """Return the result; with the records, these drawn."""
        undone = "with the findings undone"
        records = () if dataset is None else dataset.records[:MOST_DRAWN]
        drawn = [Figure("figure_record", one, f"{one.name} as it was read.") for one in records]
        equations = [
            f"{row.relation}: {share(row.before)}" + f", {share(row.after)} {undone}" * self.suspect
            for row in self.balances
        ]
        return display.Report(
            title=title or "Log check",
            subtitle=f"Log check of {', '.join(self.records)}",
            headline=f"Log check of {counted(len(self.records), 'record')}: "
            f"{', '.join(self.records)}\n\n{self.verdict}",
            answer=self.verdict,
            numbers=(
                ("suspect", str(len(self.serious))),
                ("good to know", str(len(self.findings) - len(self.serious))),
                ("equations used", str(len(self.relations))),
            ),
            sections=(
                *self._listed("Suspect", suspect=True),
                *self._listed("Good to know", suspect=False),
                Section(
                    "Equations between signals, and what is left of the left side's changes",
                    equations, figures=self._figures(), heading=True, indent=5,
                ),
                *self._judged(),
                Section("What this check cannot tell", self.unchecked, heading=True, indent=5),
                Section("Records", figures=drawn, only="page"),
            ),
        )  # fmt: skip

    report = display.as_text

    def _listed(self, title: str, *, suspect: bool) -> list[Section]:
        """Findings of one weight as a numbered list."""
        lines = []
        chosen = [one for one in self.findings if one.suspect is suspect]
        for number, one in enumerate(chosen, start=1):
            first, *rest = one.lines()
            some = one.records and set(one.records) != set(self.records)
            where = f" ({', '.join(one.records)})" if some else ""
            lines += [f"{number:3d}. {first}{where}", *(f"     {text}" for text in rest)]
        return [Section(title, lines, heading=True)]

    def _judged(self) -> list[Section]:
        """Faults times signals: what was tested, from which size on, and what was found."""
        if not self.judged:
            return []
        kinds = list(dict.fromkeys(one.fault for one in self.judged))
        cells = {(one.signal, one.fault): one.cell for one in self.judged}
        rows = [
            (signal, *(cells.get((signal, kind), "") for kind in kinds))
            for signal in dict.fromkeys(one.signal for one in self.judged)
        ]
        untold = dict[tuple[str, str], list[str]]()
        for one in self.judged:
            if one.state == "not tested" and one.says:
                untold.setdefault((one.signal, one.says), []).append(one.fault)
        alike = dict[tuple[str, str], list[str]]()
        for (signal, why), faults in untold.items():
            alike.setdefault((", ".join(faults), why), []).append(signal)
        reasons = [f"{what} of {', '.join(of)}: {why}" for (what, why), of in alike.items()]
        table = Table(("signal", *kinds), rows, caption=SAYS["captions"]["judged"])
        return [Section("What was tested", reasons, tables=(table,), heading=True, indent=5)]

    def _figures(self) -> list[Figure]:
        if not self.balances:
            return []
        captions, size = SAYS["captions"], (7.0, 1.5 + 0.5 * len(self.balances))
        balances = Figure("plot_balances", self, captions["plot_balances"], size=size)
        return [balances, Figure("figure_check", self, captions["figure_check"])]

    to_dict = as_dict(
        "verdict", "suspect", "records", "findings", "judged", "unchecked",
        relations="balances", duration_s="duration",
    )  # fmt: skip


def size_unit(unit: str) -> tuple[float, str]:
    """Factor and unit in which people read the size of a fault: shares are per cent.

    >>> size_unit("1"), size_unit("m")
    ((100.0, '%'), (1.0, 'm'))
    """
    return (100.0, "%") if unit == "1" else shown_unit(unit)


def amount(size: float, bounds: tuple[float, float], unit: str) -> str:
    """Estimate with half the width of its 95 % interval, in people's units."""
    factor, shown = size_unit(unit)
    return f"{display.interval(factor * size, factor * (0.5 * (bounds[1] - bounds[0])))} {shown}"


def interval(size: float, std: float) -> tuple[float, float]:
    """95 % interval of an estimate with a normal error.

    >>> interval(1.0, 0.1)
    (0.804, 1.196)
    """
    return size - display.TWO_SIDED_95 * std, size + display.TWO_SIDED_95 * std
