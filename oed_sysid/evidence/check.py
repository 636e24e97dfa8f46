"""The check of logs before any model: :func:`check` and :func:`quick_check`."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence import continuous, discrete
from oed_sysid.evidence.clocks import clock_findings
from oed_sysid.evidence.corrections import undo
from oed_sysid.evidence.inputs import input_findings
from oed_sysid.evidence.limits import unchecked
from oed_sysid.evidence.relations import Relation, relations
from oed_sysid.evidence.result import Balance, Finding, LogCheck
from oed_sysid.evidence.screen_words import screen_findings
from oed_sysid.evidence.screens import screened
from oed_sysid.evidence.spare import spare_signals
from oed_sysid.evidence.traces import Trace
from oed_sysid.evidence.unexplained import judged_step, unexplained_findings
from oed_sysid.evidence.words import continuous_finding, discrete_finding
from oed_sysid.experiments.problem import Problem
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.physics.model import Model

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
        names = dataset.names
        found, mended = discrete.search(traces, equations)
        starts = [one.correction for one in found if one.correction.kind in discrete.SIZED]
        fixed = [one for one in found if one.correction.kind not in discrete.SIZED]
        if starts:
            # Sizes are estimated, not guessed: only what is there or not stays undone.
            mended = [undo(t, [one.correction for one in fixed], equations) for t in traces]
        findings += [discrete_finding(one, dataset.channels, equations, names) for one in fixed]
        sizes, _ = continuous.search(mended, equations, start=starts)
        findings += [
            continuous_finding(
                one, dataset.channels, equations, names, allowed=_allowed(model, one.candidate)
            )
            for one in sizes
        ]
        after = [undo(t, [one.correction for one in sizes], equations) for t in mended]
        balances = _balances(traces, after, equations)
        findings += clock_findings(after, equations)
        findings += unexplained_findings(after, equations)
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


def _screened(
    dataset: Dataset, model: Model, *, spare: bool
) -> tuple[list[Trace], tuple[Relation, ...], list[Finding]]:
    """Traces with bad samples left out, what was found, and the equations that remain."""
    traces = [Trace.of(r, spare_signals(r) if spare else {}) for r in dataset]
    faults, traces = screened(traces)
    findings = screen_findings(dataset, traces, faults)
    clean = []
    for trace in traces:
        rows: dict[str, np.ndarray] = {}
        for fault in faults:
            if fault.record == trace.name and fault.kind in BLANKED:
                known = rows.get(fault.signal, np.empty(0, dtype=int))
                rows[fault.signal] = np.union1d(known, fault.rows).astype(int)
        clean.append(trace.blank(rows))
    dead = {fault.signal for fault in faults if fault.kind == "dead"}
    everywhere = set.intersection(*(set(trace.values) for trace in traces))
    standard = everywhere - set(model.output_names)
    missing = set.intersection(*(set(record.missing_outputs) for record in dataset)) | dead
    equations = relations(model, standard, missing)
    findings = [f if f.kind != "step" else judged_step(f, clean, equations) for f in findings]
    jumps = [f.correction for f in findings if f.kind == "step" and f.correction is not None]
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
