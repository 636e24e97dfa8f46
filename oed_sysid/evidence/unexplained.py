r"""Equations between signals that fail although all findings are undone.

Over blocks of about a second the left side of an equation changes by :math:`\Delta\bar y`, and
:math:`\epsilon = \Delta\bar y - \Delta\overline{\int f}` of it is left
(:mod:`~oed_sysid.evidence.discrete`). What noise alone would leave is, with :math:`m` samples
of spacing :math:`\tau` in a block of length :math:`T = m\tau`,

.. math:: e^2 = 2 \sigma_y^2 / m + \tfrac{2}{3} T \tau \sum_s f_s^2 \sigma_s^2 + \delta^2,

where :math:`2/3\,T` is the variance of the difference of two neighbouring block means of a random
walk of unit density, and :math:`\delta` what changes when every second sample is left out of the
integral: a rate that is sampled too slowly is no fault. An equation fails in a record where

.. math:: \sum \epsilon^2 > \tfrac{1}{9} \sum (\Delta\bar y)^2 \quad\text{and}\quad
    \Big(\overline{\epsilon^2} > 8\,e^2 \text{ or } \max|\epsilon| > 10\,\hat\sigma_\epsilon\Big).

Noise may leave all of a left side that hardly changes (96 % of a quiet tanker's heading), hence the
second condition; noise that is correlated from sample to sample is larger than its fast part tells
(up to 240 times in the mean square), but leaves 21 % at most, hence the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.evidence.blocks import partial
from oed_sysid.evidence.corrections import undo
from oed_sysid.evidence.discrete import Changes, changes
from oed_sysid.evidence.relations import Relation
from oed_sysid.evidence.result import Finding
from oed_sysid.evidence.traces import QUARTILE, Trace

# Of a left side's changes (root mean square) that may stay unexplained.
SHARE = 1.0 / 3.0
# Mean square of what is left against that of noise.
LOUDER = 8.0
# A single block against the robust deviation of all.
ALONE = 10.0


@dataclass(frozen=True)
class Misfit:
    """What one equation leaves in one record: its share, and the time of the largest part, s."""

    record: str
    share: float
    time: float


def unexplained_findings(traces: Sequence[Trace], relations: tuple[Relation, ...]) -> list[Finding]:
    """Equations that the records contradict.

    Parameters
    ----------
    traces : sequence of Trace
        The records with all findings undone.
    relations : tuple of Relation
        Equations between their signals.

    Returns
    -------
    list of Finding
        One for each equation that fails somewhere, with the record where it fails most.
    """
    result = []
    for relation in relations:
        found = [one for one in (misfit(trace, relation) for trace in traces) if one is not None]
        if not found:
            continue
        worst = max(found, key=lambda one: one.share)
        names = tuple(dict.fromkeys((relation.target, *relation.signals)))
        more = f" (and in {len(found) - 1} more)" if len(found) > 1 else ""
        result.append(
            Finding(
                "unexplained",
                names,
                tuple(one.record for one in found),
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


def misfit(trace: Trace, relation: Relation) -> Misfit | None:
    """What an equation leaves in a record, if noise and slow sampling do not explain it."""
    parts = list(changes(trace, relation))
    if not parts:
        return None
    left, rest, times = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("left", "rest", "times")
    )
    power = float(np.sum(left**2))
    share = float(np.sqrt(np.sum(rest**2) / power)) if power > 0.0 else 0.0
    if share <= SHARE:
        return None
    expected = _expected(trace, relation, parts)
    largest = int(np.argmax(np.abs(rest)))
    usual = float(np.median(np.abs(rest))) / QUARTILE
    louder = float(np.mean(rest**2)) > LOUDER * expected
    alone = abs(rest[largest]) > max(ALONE * usual, np.sqrt(LOUDER * expected))
    return Misfit(trace.name, share, float(times[largest])) if louder or alone else None


def judged_step(
    found: Finding, traces: Sequence[Trace], relations: tuple[Relation, ...]
) -> Finding:
    """Return a finding of a step, without its correction where the equations contradict that.

    A signal that catches up with the motion after it was lost jumps as well, and is right
    afterwards: with the jump subtracted the equations leave more, not less.
    """
    (signal,), fix = found.signals, found.correction
    concerned = [one for one in relations if signal in (one.target, *one.signals)]
    if fix is None or not concerned:
        return found
    touched = [trace for trace in traces if trace.name in fix.rows]
    gain = 0.0
    for relation in concerned:
        before, after = (
            [part.rest for trace in some for part in changes(trace, relation)]
            for some in (touched, [undo(trace, (fix,)) for trace in touched])
        )
        if before and after:
            powers = [float(np.mean(np.concatenate(rest) ** 2)) for rest in (before, after)]
            if min(powers) > 0.0:
                gain += sum(rest.size for rest in before) * np.log(powers[0] / powers[1])
    if gain >= 0.0:
        return found
    return replace(
        found,
        says=f"{found.says.rsplit(':', 1)[0]}: the other signals say that the vehicle moved "
        "there, so that it was lost before and caught up.",
        fix="cut the record there with window(); nothing is subtracted in a corrected copy",
        correction=None,
    )


def _expected(trace: Trace, relation: Relation, parts: list[Changes]) -> float:
    """Mean square that noise and sampling leave of a change from block to block."""
    series, usable = trace.filled(relation.signals)
    length, group = parts[0].length, parts[0].group
    expected = 2.0 * trace.noise[relation.target] ** 2 / group
    for name in relation.signals:
        slope = partial(relation, series, trace.times, name)[usable]
        present = trace.times[np.isfinite(trace.values[name])]
        spacing = float(np.median(np.diff(present)))
        power = float(np.mean(slope**2)) * trace.noise[name] ** 2 * spacing
        expected += power * (2.0 / 3.0 * length if relation.is_rate else 2.0 / length)
    if relation.is_rate:
        coarse = np.concatenate([part.rest for part in changes(trace, relation, every=2)])
        fine = np.concatenate([part.rest for part in parts])
        expected += float(np.mean((coarse - fine) ** 2))
    return expected
