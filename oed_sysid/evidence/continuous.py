r"""Faults of a log that have a size: bias, scale, delay, lever arm, misalignment, drift.

With the residuals of all equations whitened (:mod:`~oed_sysid.evidence.blocks`) and free
constants projected out, the faults :math:`\varphi` enter linearly,

.. math:: e = Z \varphi + \varepsilon, \qquad \varepsilon \sim N(0, I),

and are selected one after the other by what they gain, :math:`2 \ln \Lambda = b^T G^{-1} b` with
:math:`G = Z^T Z` and :math:`b = Z^T e`; each that was taken may be exchanged or dropped. They are
then undone in the log and everything is linearised again, until nothing changes.

The noise of a signal stands in the residual and in its own regressor, which biases a scale error
by the ratio of noise to signal (the attenuation of regressions with errors in variables, Fuller
1987). Its expected value in :math:`b` lies between zero and what it would be if all of the
residual's walk came from that signal: half of it is subtracted, and what remains uncertain counts
against the fault and widens its interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.evidence.blocks import (
    LARGEST,
    Candidate,
    Colour,
    Stretch,
    estimate,
    gain_of,
    ridge,
    select,
    solve,
    stretches,
)
from oed_sysid.evidence.corrections import undo
from oed_sysid.evidence.discrete import levers, positions_of, velocities_of
from oed_sysid.evidence.relations import Relation
from oed_sysid.evidence.result import Correction
from oed_sysid.evidence.traces import Trace

ACCEPTED = 16.0
ACCEPTED_COLOURED = 26.0
# Noise is coloured where blocks correlate, or where rates wander more than their fast noise.
COLOURED = 0.35
WANDERING = 4.0
ROUNDS = 6
CLOSE = 9.0
# Intervals are wider than the linear theory says: noise levels are estimated, faults selected.
WIDER = 1.15
NUMERICAL = 3e-5
# Biases of single records have to bring this much more, and are looked for in no more records.
SINGLE, MOST_RECORDS = 26.0, 24
# The noise of the equations is estimated anew in so many rounds, and kept from then on.
SETTLING = 3


@dataclass(frozen=True)
class Continuous:
    """A continuous fault that was accepted."""

    candidate: Candidate
    size: float
    std: float
    gain: float
    rivals: tuple[tuple[Candidate, float], ...]

    @property
    def correction(self) -> Correction:
        """How to undo it."""
        one = self.candidate
        return Correction(one.kind, one.signals, self.size, one.other, record=one.record)


@dataclass(frozen=True)
class System:
    """Normal equations of all faults, whitened.

    ``gram`` is ``(n, n)``, ``right`` ``(n,)``, ``limits`` the gain that each needs, ``doubt`` the
    half-width of what noise in a regressor may have added to ``right``.
    """

    gram: np.ndarray
    right: np.ndarray
    limits: np.ndarray
    doubt: np.ndarray
    parts: tuple[Stretch, ...]
    colours: dict[int, Colour]


def candidates(traces: list[Trace], relations: tuple[Relation, ...]) -> tuple[Candidate, ...]:
    """Continuous faults that these signals may have, with usual sizes."""
    units = {n: u for trace in traces for n, u in trace.units.items()}
    inner = list(dict.fromkeys(n for r in relations for n in r.signals))
    values = [r.target for r in relations if not r.is_rate]
    names = list(dict.fromkeys([r.target for r in relations] + inner))
    size = {n: _rms(traces, n) for n in names}
    noise = {n: float(np.median([t.noise[n] for t in traces if n in t.noise])) for n in names}
    step = float(np.median([trace.step for trace in traces]))
    result = []
    for name in dict.fromkeys([*inner, *values]):
        material = max(0.15 * noise[name], 1e-3 * size[name])
        result.append(Candidate("bias", (name,), units[name], 0.3 * size[name], material))
    result += [Candidate("scale", (n,), "1", 0.2, 0.01) for n in names]
    result += _late(names, relations, units, step)
    return (*result, *_in_space(relations, units, size))


def _late(
    names: list[str], relations: tuple[Relation, ...], units: dict[str, str], step: float
) -> list[Candidate]:
    """Delays of single signals, of all positions and of all velocities."""
    together = [positions_of(relations, units), velocities_of(relations, units)]
    groups = [*((name,) for name in names), *(group for group in together if len(group) > 1)]
    return [Candidate("delay", g, "s", max(0.7, 3.0 * step), 0.3 * step) for g in groups]


def _in_space(
    relations: tuple[Relation, ...], units: dict[str, str], size: dict[str, float]
) -> list[Candidate]:
    """Lever arms and misalignments of velocities, and drifts of positions."""
    positions, velocities = positions_of(relations, units), velocities_of(relations, units)
    result = []
    for velocity, rate in levers(relations, units):
        arm = 0.5 * max(size[v] for v in velocities) / max(size[rate], 1e-12)
        least = min(0.05, 0.02 * arm)
        result.append(Candidate("lever", (velocity,), "m", arm, least, (rate,)))
    for i, first in enumerate(velocities):
        for second in velocities[i + 1 :]:
            result.append(Candidate("misalignment", (first, second), "rad", 0.1, 0.004))
    if len(positions) > 1:
        speed = max((size[v] for v in velocities), default=1.0)
        level = [p for p in positions if p != "z"]
        result += [Candidate("drift", (p,), "m/s", 0.3 * speed, 2e-3 * speed) for p in level]
    return result


def _rms(traces: list[Trace], name: str) -> float:
    parts = [t.values[name] for t in traces if name in t.values]
    whole = np.concatenate(parts) if parts else np.zeros(1)
    whole = whole[np.isfinite(whole)]
    return float(np.sqrt(np.mean(whole**2))) + 1e-12 if whole.size else 1e-12


def search(
    traces: list[Trace],
    relations: tuple[Relation, ...],
    *,
    start: Sequence[Correction] = (),
) -> tuple[list[Continuous], System | None]:
    """Find continuous faults.

    Parameters
    ----------
    traces : list of Trace
        Records, discrete faults undone.
    relations : tuple of Relation
        Equations between their signals.
    start : sequence of Correction
        Delays and lever arms to start from, where they are large. The search also begins without
        them, and the more likely end is returned.

    Returns
    -------
    found : list of Continuous
        The faults, the largest gain first.
    system : System or None
        The last normal equations; None where nothing could be worked out.
    """
    faults = candidates(traces, relations)
    begins = (start, ()) if start else ((),)
    ends = [_search(traces, relations, faults, begin) for begin in begins]
    found, system, cost = min(ends, key=lambda end: end[2])
    names = [trace.name for trace in traces]
    if 1 < len(names) <= MOST_RECORDS:
        # A gyro that was switched on anew has another bias.
        single = [replace(f, record=n) for f in faults if f.kind == "bias" for n in names]
        begin = [one.correction for one in found]
        more, other, less = _search(traces, relations, (*faults, *single), begin)
        if cost - less > SINGLE and any(one.candidate.record for one in more):
            return more, other
    return found, system


def _begun(
    faults: tuple[Candidate, ...], start: Sequence[Correction]
) -> tuple[list[int], np.ndarray]:
    """Faults of a start, and their sizes among those of all."""
    active, sizes = list[int](), np.zeros(len(faults))
    shared = {(f.kind, f.signals, f.other): k for k, f in enumerate(faults) if not f.record}
    for one in start:
        k = shared.get((one.kind, one.signals, one.other))
        if k is not None:
            active.append(k)
            sizes[k] = one.value
    return active, sizes


def _search(
    traces: list[Trace],
    relations: tuple[Relation, ...],
    faults: tuple[Candidate, ...],
    start: Sequence[Correction],
) -> tuple[list[Continuous], System | None, float]:
    """Search from one start; also minus twice the log-likelihood, with a price for each fault."""
    active, sizes = _begun(faults, start)
    system, right = None, np.zeros(len(faults))
    colours: dict[int, Colour] | None = None
    for turn in range(ROUNDS):
        undone = _undone(traces, faults, sizes, active, relations)
        factors = {
            faults[k].signals[0]: 1.0 + float(sizes[k]) for k in active if faults[k].kind == "scale"
        }
        parts = [p for trace in undone for p in stretches(trace, relations, faults, factors)]
        if not parts:
            return [], None, np.inf
        system = assemble(parts, relations, faults, colours, settled=turn > SETTLING)
        colours = system.colours
        right = system.right + system.gram[:, active] @ sizes[active]
        chosen = select(system.gram, right, faults, system.limits, system.doubt, active)
        new = np.zeros(len(faults))
        if chosen:
            new[chosen], std = solve(system.gram, right, faults, chosen)
        still = not chosen or bool(np.all(np.abs(new - sizes)[chosen] < 0.1 * std + 1e-9))
        settled = still and set(chosen) == set(active)
        active, sizes = chosen, new
        if settled:
            break
    assert system is not None
    counts = {part.relation: 0 for part in system.parts}
    for part in system.parts:
        counts[part.relation] += part.residual.size
    cost = sum(2.0 * n * np.log(system.colours[i].level) for i, n in counts.items())
    cost += ACCEPTED * len(active)
    if not active:
        return [], system, float(cost)
    return _described(system, right, faults, active, sizes), system, float(cost)


def _undone(
    traces: list[Trace],
    faults: tuple[Candidate, ...],
    sizes: np.ndarray,
    active: list[int],
    relations: tuple[Relation, ...],
) -> list[Trace]:
    fixes = [
        Correction(
            faults[k].kind,
            faults[k].signals,
            float(sizes[k]),
            faults[k].other,
            record=faults[k].record,
        )
        for k in active
    ]
    return [undo(trace, fixes, relations) for trace in traces] if fixes else traces


def _limit(colour: Colour, walk: float) -> float:
    """Gain that a fault needs in an equation with this noise."""
    wanders = walk > 0.0 and colour.walk_variance > WANDERING * walk
    return ACCEPTED_COLOURED if colour.correlation > COLOURED or wanders else ACCEPTED


def assemble(
    parts: list[Stretch],
    relations: tuple[Relation, ...],
    faults: tuple[Candidate, ...],
    colours: dict[int, Colour] | None,
    *,
    settled: bool = False,
) -> System:
    """Whiten all equations and sum their normal equations."""
    n = len(faults)
    gram, right, doubt = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    limits, weights = np.zeros(n), np.zeros(n) + 1e-300
    known: dict[int, Colour] = {}
    for index in sorted({part.relation for part in parts}):
        mine = [part for part in parts if part.relation == index]
        used = np.flatnonzero(np.any([np.any(p.columns != 0.0, axis=0) for p in mine], axis=0))
        blocks = [np.column_stack([p.residual, p.columns[:, used]]) for p in mine]
        walk = float(np.mean([p.walk for p in mine]))
        spread = float(np.mean([np.std(p.residual) for p in mine]))
        level = max(0.7 * float(np.mean([p.level for p in mine])), NUMERICAL * spread)
        before = colours.get(index) if colours is not None else None
        kept = before if settled else None
        colour = kept or estimate(blocks, walk, level, before)
        known[index] = colour
        limit = _limit(colour, walk)
        for part, block in zip(mine, blocks, strict=True):
            white = colour.whiten(np.column_stack([block, np.ones(len(block))]))
            constant = white[:, -1]
            along = constant @ white[:, :-1] / (constant @ constant)
            white = white[:, :-1] - np.outer(constant, along)
            own = white[:, 1:].T @ white[:, 1:]
            gram[np.ix_(used, used)] += own
            right[used] += white[:, 1:].T @ white[:, 0]
            most = _attenuation(part, relations[index].target, colour, faults, used, own)
            right[used] -= 0.5 * most
            doubt[used] += 0.5 * np.abs(most)
            limits[used] += limit * own.diagonal()
            weights[used] += own.diagonal()
    return System(gram, right, limits / weights, doubt, tuple(parts), known)


def _attenuation(
    part: Stretch,
    target: str,
    colour: Colour,
    faults: tuple[Candidate, ...],
    used: np.ndarray,
    own: np.ndarray,
) -> np.ndarray:
    """Expected product of a regressor's noise with the residual's, for scales; ``(n_used,)``."""
    n = part.residual.size
    walk = colour.walk_share
    result = np.zeros(used.size)
    for i, k in enumerate(used):
        one = faults[k]
        if one.kind == "scale":
            share = -1.0 if one.signals[0] == target else part.shares.get(one.signals[0], 0.0)
            # Noise cannot be more than the regressor's own power.
            most = 0.5 * float(own[i, i])
            result[i] = min(max(n * walk * share, -most), most)
    return result


def _described(
    system: System,
    right: np.ndarray,
    faults: tuple[Candidate, ...],
    active: list[int],
    sizes: np.ndarray,
) -> list[Continuous]:
    """Accepted faults with errors, gains and rivals."""
    gram = system.gram
    inverse = np.linalg.inv(gram[np.ix_(active, active)] + ridge(faults, active))
    # A doubt is uniform, with the variance of a third of its half-width squared.
    unsure = (inverse * system.doubt[active]) ** 2 / 3.0
    std = np.sqrt(inverse.diagonal() + unsure.sum(axis=1))
    gain = gain_of(gram, right, faults, active)
    result = []
    for position, k in enumerate(active):
        rest = [j for j in active if j != k]
        own = gain - gain_of(gram, right, faults, rest)
        rivals = []
        for j in range(len(faults)):
            if j in active or gram[j, j] <= 0.0:
                continue
            trial = [*rest, j]
            if gain_of(gram, right, faults, trial) < gain - CLOSE:
                continue
            size = float(solve(gram, right, faults, trial)[0][-1])
            if abs(size) <= LARGEST * faults[j].plausible:
                rivals.append((faults[j], size))
        result.append(
            Continuous(faults[k], float(sizes[k]), WIDER * float(std[position]), own, tuple(rivals))
        )
    return sorted(result, key=lambda one: -one.gain)
