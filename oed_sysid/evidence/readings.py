r"""Other readings of the numbers of a log, and the order in which its faults are searched.

Sign, unit, columns and axes have no size: they are other readings of the same numbers.
Each is judged by the information that the equations give about their left sides,

.. math:: I = \sum_k \ln \frac{S_{y,k}}{S_{e,k}},

where :math:`S_y` is the same law fitted to :math:`y` itself. It does not depend on units, which is
the Jacobian without which the smallest unit would win.

A reading has to tell more than every fault with a size does together (:func:`misread`); the faults
with a size are those of :mod:`~oed_sysid.evidence.contrasts`.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from oed_sysid.evidence.chance import FALSE_CLAIMS
from oed_sysid.evidence.contrasts import (
    CLOSE,
    MOST_BLOCKS,
    Found,
    Noise,
    Question,
    Reading,
    Result,
    contrasts,
    search,
)
from oed_sysid.evidence.corrections import undo
from oed_sysid.evidence.relations import READINGS
from oed_sysid.evidence.result import Correction
from oed_sysid.evidence.traces import RELATIVE, Trace


def diagnosed(
    traces: Sequence[Trace],
    question: Question,
    known: Sequence[Correction] = (),
) -> tuple[list[Reading], Result]:
    """Faults that the equations show: readings first where nothing else is near, then sizes."""
    plain = search(traces, question, known=known, only_linear=True)
    if not plain.strained and not _nearer(traces, question):
        return [], plain

    def mended(found: Sequence[Reading]) -> list[Trace]:
        return [undo(t, [r.correction for r in found], question.relations) for t in traces]

    found, start = misread([undo(t, known, question.relations) for t in traces], question)
    right = mended(found)
    ends = [search(right, question, known=known) if found or plain.strained else plain]
    ends += [search(right, question, start=start, known=known)] if start else []
    best = max(ends, key=lambda end: _worth(end, right, question))
    if named := [reading for one in best.found for reading in _as_units(one)]:
        found = [*found, *named]
        best = search(mended(found), question, known=known)
    return found, best


def _worth(end: Result, traces: Sequence[Trace], question: Question) -> float:
    """Information of the equations with the faults of a search undone, less the price of these."""
    left = [undo(t, [one.correction for one in end.found], question.relations) for t in traces]
    return float(Evidence(question)(left).sum()) - CLOSE * len(end.found)


def _as_units(one: Found) -> list[Reading]:
    """A scale that is that of a sign or a unit within its error, as another reading."""
    fault, names = one.candidate, one.candidate.signals
    if fault.kind not in ("scale", "lost") or fault.record or fault.placed:
        return []
    lost = fault.kind == "lost"
    by = 1.0 - one.size if lost else 1.0 / (1.0 + one.size)
    error = one.std if lost else one.std * by**2
    factors = [*READINGS.get(fault.unit_of, ()), *[(-1.0, "")] * lost]
    near = [
        Reading(Correction("unit" if factor > 0.0 else "sign", names, factor), meaning, one.gain)
        for factor, meaning in factors
        if abs(by - factor) < max(RELATIVE * abs(by), 3.0 * error)
    ]
    return near[:1]


@dataclass(frozen=True)
class Evidence:
    """Information that each equation gives about its left side.

    A reading changes some signals only: an equation whose signals are as they were before tells
    what it told then, and is not asked again.
    """

    question: Question
    told: dict[tuple[int, Hashable], float] = field(default_factory=dict)

    def __call__(self, traces: Sequence[Trace]) -> np.ndarray:
        """Information in some records, ``(n_relations,)``."""
        relations = enumerate(self.question.relations)
        keys = [(i, tuple(_numbers(trace, r.names) for trace in traces)) for i, r in relations]
        self._ask(traces, [key for key in keys if key not in self.told])
        return np.array([self.told[key] for key in keys])

    def gained(self, traces: Sequence[Trace], corrections: Sequence[Correction]) -> float:
        """What all equations tell more with some faults undone."""
        undone = [undo(trace, corrections, self.question.relations) for trace in traces]
        return float(np.sum(self(undone) - self(traces)))

    def ranked(self, traces: Sequence[Trace], readings: Iterable[Reading]) -> list[Reading]:
        """Readings with what each gains, the most first."""
        told = (replace(one, gain=self.gained(traces, [one.correction])) for one in readings)
        return sorted(told, key=lambda one: -one.gain)

    def _ask(self, traces: Sequence[Trace], fresh: Sequence[tuple[int, Hashable]]) -> None:
        asked, given = tuple(self.question.relations[key[0]] for key in fresh), self.question.given
        pieces = [p for t in traces for p in contrasts(t, asked, given)] if asked else []
        for k, key in enumerate(fresh):
            mine = [piece for piece in pieces if piece.relation == k]
            self.told[key] = Noise(mine, given, np.arange(len(given))).told if mine else 0.0


def _numbers(trace: Trace, names: Iterable[str]) -> tuple[Hashable, ...]:
    """What an equation reads of some signals, as a key."""
    here = [n for n in names if n in trace.values]
    return (
        *here,
        *(hash(trace.values[n].tobytes()) for n in here),
        *(trace.noise[n] for n in here),
    )


def misread(traces: Sequence[Trace], question: Question) -> tuple[list[Reading], list[Correction]]:
    """Other readings that the equations ask for, and delays to begin from.

    A reading is accepted if it tells more than every fault with a size does together.

    Returns
    -------
    found : list of Reading
        At most three, in the order of their statistics.
    start : list of Correction
        Large delays that compete with readings: their sizes are for :func:`search` to find.
    """
    relations, late = question.relations, [*_late(question)]
    coarse, evidence = _coarse(traces, question), Evidence(question)
    found: list[Reading] = []
    for _ in range(3 if question.readings else 0):
        best, *others = evidence.ranked(coarse, (*question.readings, *late))
        # What chance exceeds rarely, however many readings are tried.
        limit = 2.0 * math.log((1 + len(others)) / FALSE_CLAIMS)
        if best.gain <= limit:
            break
        if best.delays:
            return found, [best.correction]
        sized = [one.correction for one in search(coarse, question, single=False).found]
        if best.gain < limit + max(0.0, evidence.gained(coarse, sized)):
            break
        found.append(replace(best, rivals=tuple(one for one in others if one.near(best))))
        coarse = [undo(t, (best.correction,), relations) for t in coarse]
    return found, []


def _coarse(traces: Sequence[Trace], question: Question) -> list[Trace]:
    """Traces with fewer samples, unless motion is too fast for these."""
    coarse = [trace.thinned(2 * MOST_BLOCKS) for trace in traces]
    evidence = Evidence(question)
    lost, told = evidence(coarse) == 0.0, evidence(traces) != 0.0
    return list(traces) if np.any(lost & told) else coarse


def _nearer(traces: Sequence[Trace], question: Question) -> bool:
    """Whether a reading tells more, the equations taken as they are; asked of nominal ones only.

    Forces that are wrong in all can be so large that no fault with a size stands out of them.
    """
    if not question.given:
        return False
    evidence = Evidence(replace(question, given=()))
    coarse = [trace.thinned(2 * MOST_BLOCKS) for trace in traces]
    return any(evidence.gained(coarse, [one.correction]) > 0.0 for one in question.readings)


def _late(question: Question) -> Iterator[Reading]:
    """Large delays, as rivals of readings: the linearised score does not reach so far."""
    late = (f for f in question.common if f.kind in ("delay", "lag"))
    for fault, k in product(late, range(-1, 3)):
        delay = fault.plausible * 2.0**k
        if delay > 2.0 * fault.material:
            for size in (delay, -delay)[: 1 if fault.positive else 2]:
                yield Reading(Correction(fault.kind, fault.signals, size))
