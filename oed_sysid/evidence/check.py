r"""Compatibility of logs: what signals say about each other, before any model of forces.

In flight test this is called data compatibility or flight-path reconstruction (Klein & Morelli
2006, Aircraft System Identification, chapter 10; Jategaonkar 2015, Flight Vehicle System
Identification, chapter 10). Kinematics relate measured signals whatever the forces are,

.. math:: \dot y = f(s_1, s_2, \dots):

heading and yaw rate; positions, heading and velocities; depth, pitch and speeds; attitudes and
rates. If they do not hold, a sensor, a unit, a sign or a clock is wrong, and no model can be
right. The check goes from what is obvious to what is subtle, and each step undoes what it found
before the next one looks:

0. single signals: spikes, steps, drop-outs, frozen, cut-off, dead, held or coarse signals, gaps,
   copies (:mod:`~oed_sysid.evidence.screens`);
1. faults that are there or not: sign, unit, swapped columns, axes of the velocities
   (:mod:`~oed_sysid.evidence.discrete`);
2. faults with a size: bias, scale, delay, lever arm, misalignment, drift
   (:mod:`~oed_sysid.evidence.continuous`, on the residuals of
   :mod:`~oed_sysid.evidence.blocks` and with their noise);
3. equations that fail although all of this is undone (this module);
4. signs and units of inputs, against the nominal model and its priors
   (:mod:`~oed_sysid.evidence.inputs`).

The equations come from the model's own text, or follow from standard names of signals
(:mod:`~oed_sysid.evidence.relations`).

The check of logs before any model: :func:`check` and :func:`quick_check`.

Equations between signals that fail although all findings are undone.

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
from time import perf_counter

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence import continuous, discrete
from oed_sysid.evidence.blocks import partial
from oed_sysid.evidence.corrections import clock_findings, corrected_copies, undo, why_not_more
from oed_sysid.evidence.discrete import Changes, changes, unchecked
from oed_sysid.evidence.inputs import input_findings
from oed_sysid.evidence.relations import Relation, relations, spare_signals
from oed_sysid.evidence.result import Balance, Correction, Finding, LogCheck
from oed_sysid.evidence.screens import Fault, screened
from oed_sysid.evidence.traces import QUARTILE, Trace
from oed_sysid.evidence.words import continuous_finding, discrete_finding, screen_findings
from oed_sysid.experiments.problem import Problem
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.physics.model import Model

__all__ = [
    "Balance",
    "Correction",
    "Finding",
    "LogCheck",
    "check",
    "corrected_copies",
    "quick_check",
    "signal_check",
    "why_not_more",
]


# Samples that must not enter any equation.
BLANKED = ("spikes", "dropouts", "frozen", "saturated", "held")
MOST_DRAWN = 400


def check(dataset: Dataset, problem: Problem | Model, *, inputs: bool = True) -> LogCheck:
    """Check records for faults of the log, before any model of forces.

    Parameters
    ----------
    dataset : Dataset
        The records; several with different speeds and turns tell more.
    problem : Problem or Model
        What the signals are: kinematics and outputs without unknown parameters are used. Signals
        with standard names (SNAME) are also held against the kinematics of a rigid body.
    inputs : bool
        Whether signs and units of the inputs are judged against the nominal model and its priors.

    Returns
    -------
    LogCheck
        What was found, with sizes, 95 % intervals and fixes.

    Examples
    --------
    >>> from oed_sysid import Dataset, Input, Model, Output, Parameter, Record, State
    >>> model = Model(
    ...     "yaw", (State("psi", "rad"), State("r", "rad/s")), (Input("rudder", "rad"),),
    ...     (Output("psi", "rad"), Output("r", "rad/s")),
    ...     {"psi": "r", "r": "(K*rudder - r)/T"},
    ...     parameters=(Parameter("K", 0.1, "1/s"), Parameter("T", 5.0, "s")),
    ... )
    >>> rng = np.random.default_rng(0)
    >>> t = np.arange(600) * 0.2
    >>> psi = 0.5 * np.sin(0.1 * t) + 0.002 * rng.standard_normal(600)
    >>> r = -0.05 * np.cos(0.1 * t) + 0.001 * rng.standard_normal(600)
    >>> record = Record("run", t, np.zeros((600, 1)), np.column_stack([psi, r]), model.channels)
    >>> found = check(Dataset((record,)), model)
    >>> print(found.serious[0].says)
    psi has the wrong sign: turned round, it agrees with the other signals.
    >>> print(found.serious[0].fix, "|", *found.serious[0].alternatives)
    Output("psi", "rad", sign=-1) | r with the other sign
    """
    began = perf_counter()
    model = problem.model if isinstance(problem, Problem) else problem
    check_channels(model, dataset)
    traces, equations, findings = _screened(dataset, model, spare=True)
    balances: tuple[Balance, ...] = ()
    if equations:
        contradictions, balances = _contradictions(dataset, model, traces, equations)
        findings += contradictions
    open_points = unchecked(model, equations, traces)
    if inputs:
        fixes = [f.correction for f in findings if f.correction is not None]
        judged, reason = input_findings(dataset, model, fixes)
        findings += judged
        open_points += (reason,) * bool(reason)
    ordered = _ordered(findings)
    return LogCheck(
        tuple(ordered),
        dataset.names,
        tuple(str(one) for one in equations),
        balances,
        open_points,
        perf_counter() - began,
    )


def quick_check(dataset: Dataset, model: Model) -> LogCheck:
    """Screens of single signals, discrete faults and inputs: quick enough before every fit.

    Parameters
    ----------
    dataset : Dataset
        The records.
    model : Model
        What the signals are.

    Returns
    -------
    LogCheck
        As :func:`check`, without faults that have a size.
    """
    began = perf_counter()
    traces, equations, findings = _screened(dataset, model, spare=False)
    if equations:
        now = discrete.ratios([t.thinned(600) for t in traces], equations)
        # Only equations that leave much unexplained can hide a discrete fault.
        if np.any(now.raw[now.counts > 0] > discrete.DOUBTFUL):
            found, _ = discrete.search([t.thinned(600) for t in traces], equations)
            findings += [
                discrete_finding(one, dataset.channels, equations, dataset.names)
                for one in found
                if one.correction.kind not in discrete.SIZED
            ]
    fixes = [f.correction for f in findings if f.correction is not None]
    findings += input_findings(dataset, model, fixes)[0]
    ordered = _ordered(findings)
    return LogCheck(
        tuple(ordered),
        dataset.names,
        tuple(str(one) for one in equations),
        duration=perf_counter() - began,
    )


def signal_check(dataset: Dataset) -> LogCheck:
    """Screens of single signals only, for records of which no problem says what they are.

    Parameters
    ----------
    dataset : Dataset
        The records.

    Returns
    -------
    LogCheck
        As :func:`quick_check`, without any equation between signals.
    """
    began = perf_counter()
    traces = [Trace.of(record, {}) for record in dataset]
    faults, traces = screened(traces)
    findings = _ordered(screen_findings(dataset, traces, faults))
    open_points = ("signals against each other: name the problem whose channels these are",)
    return LogCheck(tuple(findings), dataset.names, (), (), open_points, perf_counter() - began)


def _blank(trace: Trace, faults: list[Fault]) -> Trace:
    """A trace without the samples of some faults."""
    rows: dict[str, np.ndarray] = {}
    for fault in faults:
        if fault.record != trace.name or fault.kind not in BLANKED:
            continue
        known = rows.get(fault.signal, np.empty(0, dtype=int))
        rows[fault.signal] = np.union1d(known, fault.rows).astype(int)
    return trace.blank(rows)


def _screened(
    dataset: Dataset, model: Model, *, spare: bool
) -> tuple[list[Trace], tuple[Relation, ...], list[Finding]]:
    """Traces with bad samples left out, what was found, and the equations that remain."""
    traces = [Trace.of(r, spare_signals(r) if spare else {}) for r in dataset]
    faults, traces = screened(traces)
    findings = screen_findings(dataset, traces, faults)
    clean = [_blank(trace, faults) for trace in traces]
    dead = {fault.signal for fault in faults if fault.kind == "dead"}
    everywhere = set.intersection(*(set(trace.values) for trace in traces))
    standard = everywhere - set(model.output_names)
    missing = set.intersection(*(set(record.missing_outputs) for record in dataset)) | dead
    equations = relations(model, standard, missing)
    findings = [f if f.kind != "step" else judged_step(f, clean, equations) for f in findings]
    jumps = [f.correction for f in findings if f.kind == "step" and f.correction]
    return [undo(trace, jumps) for trace in clean], equations, findings


def _ordered(findings: list[Finding]) -> list[Finding]:
    """Suspect ones first, the largest gain first; a wrong unit explains a wrong noise level."""
    rescaled = {n for f in findings if f.kind in ("unit", "swap", "scale") for n in f.signals}
    kept = [f for f in findings if f.kind != "noise" or not rescaled & set(f.signals)]
    return sorted(kept, key=lambda one: (not one.suspect, -(one.gain or 0.0)))


def _allowed(model: Model, fault: continuous.Candidate) -> bool:
    """Whether the model has a sensor effect on a signal of this fault."""
    touched = {key for e in model.effects if e.stage == "sensor" for key in e.terms}
    return bool(touched & set(fault.signals))


def _balances(
    before: list[Trace], after: list[Trace], equations: tuple[Relation, ...]
) -> tuple[Balance, ...]:
    """How well each equation holds, as it is and with the findings undone."""
    from oed_sysid.evidence.blocks import stretches

    shares = [discrete.ratios(traces, equations).raw for traces in (before, after)]
    series: dict[int, list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]] = {}
    for old, new in zip(before, after, strict=True):
        parts = {(p.relation, i): p for i, p in enumerate(stretches(old, equations, ()))}
        mended = stretches(new, equations, ())
        for (index, _), part in parts.items():
            at = [p for p in mended if p.relation == index]
            if not at:
                continue
            times = np.concatenate([p.times for p in at])
            rest = np.concatenate([p.residual - p.residual.mean() for p in at])
            series.setdefault(index, []).append(
                (
                    old.name,
                    part.times,
                    part.residual - part.residual.mean(),
                    np.interp(part.times, times, rest),
                )
            )
    return tuple(
        Balance(
            str(one),
            float(np.sqrt(shares[0][i])),
            float(np.sqrt(shares[1][i])),
            one.target,
            before[0].units.get(one.target, ""),
            tuple(series.get(i, ())),
        )
        for i, one in enumerate(equations)
    )


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


def _contradictions(
    dataset: Dataset, model: Model, traces: list[Trace], equations: tuple[Relation, ...]
) -> tuple[list[Finding], tuple[Balance, ...]]:
    """Faults that equations show, each undone before the next kind is looked for."""
    channels, names = dataset.channels, dataset.names
    found, mended = discrete.search(traces, equations)
    starts = [one.correction for one in found if one.correction.kind in discrete.SIZED]
    fixed = [one for one in found if one.correction.kind not in discrete.SIZED]
    if starts:
        # Sizes are estimated, not guessed: only what is there or not stays undone.
        mended = [undo(t, [one.correction for one in fixed], equations) for t in traces]
    findings = [discrete_finding(one, channels, equations, names) for one in fixed]
    sizes, _ = continuous.search(mended, equations, start=starts)
    findings += [
        continuous_finding(one, channels, equations, names, allowed=_allowed(model, one.candidate))
        for one in sizes
    ]
    after = [undo(t, [one.correction for one in sizes], equations) for t in mended]
    findings += clock_findings(after, equations)
    findings += unexplained_findings(after, equations)
    return findings, _balances(traces, after, equations)


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
    mended = [undo(trace, (fix,)) for trace in touched]
    if sum(_gained(touched, mended, relation) for relation in concerned) >= 0.0:
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


def _gained(before: list[Trace], after: list[Trace], relation: Relation) -> float:
    """Gain in twice the log-likelihood of an equation by a correction."""
    rests = [[part.rest for t in some for part in changes(t, relation)] for some in (before, after)]
    if not all(rests):
        return 0.0
    powers = [float(np.mean(np.concatenate(rest) ** 2)) for rest in rests]
    return sum(r.size for r in rests[0]) * np.log(powers[0] / powers[1]) if min(powers) > 0 else 0.0
