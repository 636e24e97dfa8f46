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
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from oed_sysid.evidence.chance import FALSE_CLAIMS, threshold
from oed_sysid.evidence.contrasts import (
    CLOSE,
    MOST_BLOCKS,
    Candidate,
    Found,
    Noise,
    Question,
    Result,
    contrasts,
    mended,
    search,
    unexplained,
)
from oed_sysid.evidence.corrections import undo
from oed_sysid.evidence.relations import READINGS, Relation
from oed_sysid.evidence.result import Correction
from oed_sysid.evidence.traces import Trace, units_of
from oed_sysid.runtime.constants import NEGLIGIBLE


def diagnosed(traces: Sequence[Trace], question: Question) -> tuple[list[Found], Result]:
    """Faults that the equations show: readings first where nothing else is near, then sizes."""
    plain = search(traces, question, only_linear=True)
    if not plain.strained and not _nearer(plain, traces, question):
        return [], _unopposed(plain, traces, question)
    found, start = misread(traces, question)
    right = mended(traces, found, question.relations)
    ends = [search(right, question) if found or plain.strained else plain]
    ends += [search(right, question, start=start)] if start else []
    best = max(ends, key=lambda end: _worth(end, right, question))
    if named := [reading for one in best.found for reading in as_readings(one, units_of(traces))]:
        found = [*found, *named]
        right = mended(traces, found, question.relations)
        best = search(right, question)
    return found, _unopposed(best, right, question)


def _unopposed(end: Result, traces: Sequence[Trace], question: Question) -> Result:
    """The end of a search, or of one without faults of a kind that stand against one another.

    Of two signals that are late the equations tell the difference, and where motion repeats itself
    that but for whole periods: linearised step by step both may grow until the signals, with both
    undone, agree less than as logged.
    """
    # What begins at a place of a record is another at every place.
    whole = {one.candidate for one in end.found} & {*question.common, *question.single}
    # That of a signal in one record only adds to that in all.
    kinds = list({(one.kind, one.signals): one.kind for one in whole}.values())
    opposed = {one for one in whole if kinds.count(one.kind) > 1}
    if not opposed:
        return end
    common = tuple(one for one in question.common if one not in opposed)
    single = tuple(one for one in question.single if one not in opposed)
    fewer = replace(question, common=common, single=single)
    other = replace(_unopposed(search(traces, fewer), traces, fewer), seen=end.seen)
    return max((end, other), key=lambda one: _worth(one, traces, question))


def _worth(end: Result, traces: Sequence[Trace], question: Question) -> float:
    """Information of the equations with the faults of a search undone, less the price of these."""
    left = mended(traces, end.found, question.relations)
    return float(Evidence(question, left).told.sum()) - CLOSE * len(end.found)


def as_readings(one: Found, units: Mapping[str, str]) -> list[Found]:
    """A scale that is that of a sign or a unit within its error, as another reading.

    Parameters
    ----------
    one : Found
        A ``scale``: its size is the relative error, 1; or ``lost``: the share that is left.
    units : mapping of str to str
        Units of the signals.

    Returns
    -------
    list of Found
        One ``sign`` or ``unit``, or nothing.
    """
    fault, names = one.candidate, one.candidate.signals
    if fault.kind not in ("scale", "lost") or fault.record or fault.placed:
        return []
    lost = fault.kind == "lost"
    by = 1.0 - one.size if lost else 1.0 / (1.0 + one.size)
    error = one.std if lost else one.std * by**2
    factors = [*READINGS.get(units[names[0]], ()), (-1.0, "")]
    near = [
        Found(Candidate("unit" if factor > 0.0 else "sign", names, meaning=meaning), factor)
        for factor, meaning in factors
        # What may be no effect at all is no other unit.
        if abs(by - factor) < max(NEGLIGIBLE * abs(by), 3.0 * error) and 3.0 * error < abs(by)
    ]
    # What the records cannot tell it from is read as well.
    rivals = tuple((*as_readings(other, units), other)[0] for other in one.rivals)
    return [replace(reading, gain=one.gain, rivals=rivals) for reading in near[:1]]


@dataclass(frozen=True)
class Evidence:
    """Information that equations give about their left sides in some records."""

    question: Question
    traces: Sequence[Trace]

    @property
    def told(self) -> np.ndarray:
        """Information of each equation, ``(n_relations,)``."""
        return self._now[0]

    @cached_property
    def _now(self) -> np.ndarray:
        return self._told(self.traces, self.question.relations)

    def gained(self, corrections: Sequence[Correction]) -> float:
        """What all equations tell more with some faults undone; only those with the signals do.

        An equation that tells less than nothing tells nothing once a signal is out of it, by
        whatever unit makes that small: only what it then tells counts.

        Nothing, where an error of a parameter that is given would have to be larger for it than
        chance allows: a coefficient of almost nothing undoes any other unit of its input, and may
        then be anything.
        """
        relations, changed = self.question.relations, {n for c in corrections for n in c.signals}
        asked = [k for k, r in enumerate(relations) if changed & {*r.names}]
        undone = [undo(trace, corrections, relations) for trace in self.traces]
        after, away = self._told(undone, tuple(relations[k] for k in asked))
        told, before = self._now[:, asked]
        chance = math.sqrt(threshold(len(self.question.given), 1))
        if np.any(away > np.maximum(before, chance)):
            return -np.inf
        return float(np.sum(after - np.maximum(told, 0.0)))

    def ranked(self, readings: Iterable[Found]) -> list[Found]:
        """Readings with what each gains, the likeliest first."""
        told = (replace(one, gain=self.gained([one.correction])) for one in readings)
        return sorted(told, key=lambda one: one.candidate.rare - one.gain)

    def _told(self, traces: Sequence[Trace], asked: tuple[Relation, ...]) -> np.ndarray:
        given, result = self.question.given, np.zeros((2, len(asked)))
        pieces = [p for t in traces for p in contrasts(t, asked, given)] if asked else []
        for k in {piece.side.index for piece in pieces}:
            mine = [piece for piece in pieces if piece.side.index == k]
            noise = Noise(mine, given, np.arange(len(given)))
            result[:, k] = noise.told, noise.away
        return result


def misread(traces: Sequence[Trace], question: Question) -> tuple[list[Found], list[Found]]:
    """Other readings that the equations ask for, and delays to begin from.

    A reading is accepted if it tells more than every fault with a size does together, or as much as
    a single scale.

    Returns
    -------
    found : list of Found
        At most three, in the order of their statistics.
    start : list of Found
        A large delay, which competes with readings: its size is for :func:`search` to find.
    """
    # What a nominal model says of the motion between samples changes with the units of its states,
    # and with the signs of its inputs.
    plain = tuple(replace(one, model=None) for one in question.relations)
    question = replace(question, relations=plain)
    late, level = [*_late(question)], [undo(trace, question.known) for trace in traces]
    shared, coarse = replace(question, single=(), local=(), known=()), _coarse(level, question)
    found = list[Found]()
    for _ in range(3 if question.readings else 0):
        evidence = Evidence(question, coarse)
        best, *others = evidence.ranked((*question.readings, *late))
        # What chance exceeds rarely, however many readings are tried.
        limit = 2.0 * math.log((1 + len(others)) / FALSE_CLAIMS)
        if best.gain <= limit:
            break
        if best.candidate in question.common:
            return found, [best]
        sized = search(coarse, shared).found
        told = max(0.0, evidence.gained([one.correction for one in sized]))
        # One scale that does as much has a size of its own to choose, and another unit none.
        as_much = [one for one in sized if one.candidate.kind == "scale" and len(sized) == 1]
        if best.gain < (max(limit, told - CLOSE) if as_much else limit + told):
            break
        rivals = (*_near(best, others, question), *as_much)
        found.append(replace(best, rivals=rivals))
        coarse = mended(coarse, [best], question.relations)
    return found, []


def _near(best: Found, others: Iterable[Found], question: Question) -> Iterator[Found]:
    """Other readings that the equations cannot tell from the best."""
    for one in others:
        if one.gain > best.gain - CLOSE and one.candidate not in question.common:
            yield one


def _coarse(traces: Sequence[Trace], question: Question) -> list[Trace]:
    """Traces with fewer samples, unless motion is too fast for these."""
    coarse = thinned(traces)
    lost, told = (Evidence(question, some).told == 0.0 for some in (coarse, traces))
    return list(traces) if np.any(lost & ~told) else coarse


def thinned(traces: Sequence[Trace]) -> list[Trace]:
    """Traces with samples enough for the blocks of contrasts."""
    return [trace.thinned(2 * MOST_BLOCKS) for trace in traces]


def _nearer(plain: Result, traces: Sequence[Trace], question: Question) -> bool:
    """Whether another reading may be near although no fault with a size stands out.

    Where a scale was found, which may be that of a unit, or an equation fails with what was found
    undone: a signal in other units may be its own noise, or hide the others. Of nominal ones, in
    which forces are noise, it is asked whether a reading tells more, these taken as they are:
    forces that are wrong in all can be as large.
    """
    if not question.given:
        left = mended(traces, plain.found, question.relations)
        scaled = any(one.candidate.kind == "scale" for one in plain.found)
        return scaled or bool(unexplained(left, question.relations))
    evidence = Evidence(replace(question, given=()), thinned(traces))
    return any(evidence.gained([one.correction]) > 0.0 for one in question.readings)


def _late(question: Question) -> Iterator[Found]:
    """Large delays, as rivals of readings: the linearised score does not reach so far."""
    late = (f for f in question.common if f.kind in ("delay", "lag"))
    for fault, k in product(late, range(-1, 3)):
        delay = fault.plausible * 2.0**k
        if delay > 2.0 * fault.material:
            for size in (delay, -delay)[: 1 if fault.positive else 2]:
                yield Found(fault, size)
