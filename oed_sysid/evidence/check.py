r"""Compatibility of logs: what signals say about each other, before any model of forces.

In flight test this is called data compatibility or flight-path reconstruction (Klein & Morelli
2006, Aircraft System Identification, chapter 10; Jategaonkar 2015, Flight Vehicle System
Identification, chapter 10). Kinematics relate measured signals whatever the forces are,

.. math:: \dot y = f(s_1, s_2, \dots):

heading and yaw rate; positions, heading and velocities; depth, pitch and speeds; attitudes and
rates. If they do not hold, a sensor, a unit, a sign or a clock is wrong, and no model can be
right. The check goes from what is obvious to what is subtle, and each step undoes what it found
before the next one looks:

1. single signals: exact coincidences (dead, held, frozen, cut off, lost, interpolated, coarse
   samples, copies) and samples that stand out (:mod:`~oed_sysid.evidence.screens`); and times that
   scatter (:mod:`~oed_sysid.evidence.screens`);
2. what no motion can explain: other readings of the numbers (sign, unit, columns, axes;
   :mod:`~oed_sysid.evidence.readings`), faults with a size (bias, scale, delay, rate of a clock,
   lever arm, misalignment, drift, step), in all records or in one, and equations that fail although
   all of this is undone (:mod:`~oed_sysid.evidence.contrasts`);
3. inputs, against the nominal model with its priors and limits
   (:mod:`~oed_sysid.evidence.inputs`).

What was asked of every signal, and what could not be, is part of the result.

The equations come from the model's own text, or follow from standard names of signals
(:mod:`~oed_sysid.evidence.relations`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from time import perf_counter

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence import contrasts, words
from oed_sysid.evidence.contrasts import (
    UNEXPLAINED,
    Candidate,
    Found,
    Piece,
    Question,
    Result,
)
from oed_sysid.evidence.corrections import corrected_copies, why_not_more
from oed_sysid.evidence.inputs import (
    between_runs,
    has_priors,
    input_findings,
    scaled_inputs,
)
from oed_sysid.evidence.readings import Evidence, as_readings, diagnosed
from oed_sysid.evidence.relations import Relation, names_of, relations, spare_signals, standard
from oed_sysid.evidence.result import (
    Balance,
    Correction,
    Finding,
    Judged,
    LogCheck,
    interval,
    kinds_that_are,
)
from oed_sysid.evidence.screens import Fault, jitter, marked, screened
from oed_sysid.evidence.traces import Trace, units_of
from oed_sysid.experiments.problem import Problem
from oed_sysid.likelihood.between_records import WORTH_TELLING
from oed_sysid.likelihood.departures import ACTING, MOMENTS
from oed_sysid.likelihood.estimate import Departure
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.input_factors import input_factors
from oed_sysid.likelihood.judgement import Concern, concerns_of, departure_of
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.likelihood.whole_runs import whole_runs
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import BEYOND, MATERIAL, NEGLIGIBLE
from oed_sysid.text.expressions import names as names_in
from oed_sysid.text.expressions import to_numpy

__all__ = [
    "Balance",
    "Correction",
    "Finding",
    "Judged",
    "LogCheck",
    "check",
    "corrected_copies",
    "why_not_more",
]


def check(
    dataset: Dataset, problem: Problem | Model | None = None, *, inputs: bool = True
) -> LogCheck:
    """Check records for faults of the log, before any model of forces.

    Parameters
    ----------
    dataset : Dataset
        The records; several with different speeds and turns tell more.
    problem : Problem or Model, optional
        What the signals are: kinematics and outputs without unknown parameters are used. Signals
        with standard names (SNAME) are also held against the kinematics of a rigid body, without a
        problem against these alone.
    inputs : bool
        Whether the inputs are judged against the nominal model, its priors and limits.

    Returns
    -------
    LogCheck
        What was found, with sizes, 95 % intervals and fixes, and what was asked of each signal.

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
    if model is not None or not isinstance(dataset, Dataset):
        check_channels(model, dataset)
    traces = [Trace.of(r, spare_signals(r)) for r in dataset]
    faults, traces = screened(traces)
    told, clean = _equations(dataset, model, traces, faults), _clean(traces, faults)
    equations = tuple(filter(partial(_is_resolved, clean), told))
    faults, related, balances, ended = _related(dataset, model, clean, equations, faults)
    late = jitter(clean)
    findings = [
        *words.screen_findings(dataset, traces, faults),
        *related,
        *words.jitter_finding(late, dataset),
    ]
    names = dataset.channels.output_names
    asked, unchecked = _asked(names, traces, equations, ended), _shared(told, clean, equations)
    asked += words.jitter_rows(late, names)
    if inputs and model is not None:
        known = [f.correction for f in findings if f.correction is not None]
        ranges = problem.limits.inputs if isinstance(problem, Problem) else None
        judged, of_inputs, reason = input_findings(dataset, model, known, ranges)
        findings, asked = [*findings, *judged], [*asked, *of_inputs]
        unchecked = (*unchecked, reason) if reason else unchecked
    return LogCheck(
        tuple(_ordered(findings)),
        dataset.names,
        tuple(map(str, equations)),
        balances,
        unchecked,
        _answered(asked, findings),
        perf_counter() - began,
    )


def _clean(traces: Sequence[Trace], faults: Sequence[Fault]) -> list[Trace]:
    """Traces without the samples that screens found to be bad."""
    bad = kinds_that_are("bad samples")
    return [trace.blank(marked(faults, trace.name, bad)) for trace in traces]


def _answered(asked: Sequence[Judged], findings: Sequence[Finding]) -> tuple[Judged, ...]:
    """What was asked, with what was found."""
    found = {(f.kind, n) for f in findings for n in f.signals}
    return tuple(
        replace(one, state="found", says="") if (one.fault, one.signal) in found else one
        for one in asked
    )


def _is_resolved(traces: Sequence[Trace], relation: Relation) -> bool:
    """Whether a right side is measured often enough to tell of its left side.

    Where the left side is measured in between, curves through the other samples must return it: of
    motion that is faster a right log tells another motion, and that another unit or scale.
    """
    left = moved = 0.0
    for trace in traces:
        if not trace.values.keys() >= {*relation.names}:
            continue
        target = trace.values[relation.target]
        apart = np.any([np.isnan(trace.values[name]) for name in relation.signals], axis=0)
        between = apart & np.isfinite(target) & trace.usable(relation.signals)
        seldom = trace.blank({relation.target: np.flatnonzero(apart)}).filled([relation.target])
        if seldom and between.any():
            missed = (target - seldom[relation.target])[between]
            # Noise of a sample, and at most as much of those beside it.
            noise = np.sqrt(2.0) * trace.noise[relation.target]
            left += float(np.sum(missed**2 - noise**2))
            moved += float(between.sum() * np.var(target[between]))
    return left <= UNEXPLAINED**2 * moved


def _related(
    dataset: Dataset, model: Model | None, clean: Sequence[Trace],
    equations: tuple[Relation, ...], faults: Sequence[Fault],
) -> tuple[list[Fault], list[Finding], tuple[Balance, ...], Result]:  # fmt: skip
    """Steps with the sizes that equations give, what these find, how well they hold, the search."""
    steps = {one: _steps(one, clean, equations) for one in faults if one.kind == "step"}
    known = {fix.key: fix for fixes in steps.values() for fix in fixes or ()}
    found, ended = diagnosed(clean, Question.of(clean, equations, known.values()))
    mended = contrasts.mended(clean, (*found, *ended.found), equations)
    ends = {trace.name: trace.ends for trace in clean}
    log = words.Log(dataset.channels, equations, dataset.names, ends, _sensed(model))
    findings = [*map(log.reading, found)]
    findings += (log.sized(one) for one in ended.found if one.correction.key not in known)
    findings += words.clock_findings(mended, equations)
    findings += words.misfit_finding(contrasts.unexplained(mended, equations), equations)
    faults = [_resized(one, steps[one], ended) if one in steps else one for one in faults]
    return faults, findings, tuple(_balances(clean, mended, equations)), ended


def _steps(
    fault: Fault, traces: Sequence[Trace], equations: tuple[Relation, ...]
) -> list[Correction] | None:
    """Steps that a screen found, as faults of the equations; empty where these contradict them.

    None where no equation relates the signal.

    A signal that catches up with the motion after it was lost jumps as well, and is right
    afterwards: with the jump subtracted the equations tell less, not more.
    """
    some = Question(tuple(r for r in equations if fault.signal in r.names), ())
    if not some.relations:
        return None
    here = next(trace for trace in traces if trace.name == fault.record)
    since = here.times - here.times[0]
    shares = 0.5 * (since[fault.rows] + since[fault.rows - 1]) / since[-1]
    fixes = [
        Correction("step", (fault.signal,), size, record=fault.record, span=(float(share), 1.0))
        for share, size in zip(shares, fault.sizes, strict=True)
    ]
    return fixes if Evidence(some, [here]).gained(fixes) > 0.0 else []


def _resized(fault: Fault, fixes: Sequence[Correction] | None, ended: Result) -> Fault:
    """Steps of a signal with the sizes that the equations give them; it caught up without any.

    Where no equation relates it, nothing contradicts that it moved so.
    """
    if fixes is None:
        return replace(fault, kind="moved")
    sized = {one.correction.key: one.size for one in ended.found}
    own = tuple(sized.get(fix.key, fix.value) for fix in fixes)
    if not own:
        return replace(fault, kind="caught up")
    return replace(fault, sizes=own, amount=max(own, key=abs))


def advised(fit: Fit, log: LogCheck) -> Fit:
    """The fit; where it failed, its advice says first what the check of its log found.

    What a log shows that no model could follow stalls iterations too, and then looks like a model
    that jumps: the cause that was seen stands before those that may be.
    """
    if fit.status.ok or log.ok:
        return fit
    found = " ".join(f"{one.says} Fix: {one.fix.rstrip('.')}." for one in log.serious)
    advice = f"The check of the log says why it may fail: {found} Then fit again."
    if fit.status.advice:
        advice += f" Where the log is right: {fit.status.advice}"
    return replace(fit, status=replace(fit.status, advice=advice))


def with_estimates(
    log: LogCheck,
    fit: Fit,
    claimed: Sequence[Effect] = (),
    nominal: Mapping[str, float] | None = None,
    records: Dataset | None = None,
) -> LogCheck:
    """The check of a log together with what a fit says about it: the gate of every certificate.

    Parameters
    ----------
    log : LogCheck
        Of the records of the fit.
    fit : Fit
        Its values are held against their declared priors and against what the model began with.
    claimed : sequence of Effect
        Effects that were claimed. What those of the sensors bring into the records is undone, and
        what the equations between signals then no longer ask for is answered.
    nominal : mapping of str to float, optional
        Values that the model began with; those of the fit's own beginning if not given.
    records : Dataset, optional
        The records of the log, to undo what was claimed; those of the fit if not given.

    Returns
    -------
    LogCheck
        Suspect as well where values are many prior deviations away (``far``) or an input acts
        otherwise than the start values say (``input_factor``), where an effect of a sensor in the
        model has the value of another sign or unit (``sign``, ``unit``), and where a sensor that is
        late, off, of another scale, clock or place explains what the fit leaves; with parameters
        that are others in single records (``run``), and without noise that the fit finds to be
        motion.
    """
    begun, noisy = nominal or fit.nominal, _noisier(fit)
    findings = [
        one
        for one in _left(log, fit, records or fit.dataset, claimed, begun)
        if one.kind != "noise" or noisy.issuperset(one.signals)
    ]
    found = {one.name for one in findings}
    findings += [one for one in _read_as(log, fit) if one.name not in found]
    for one in input_factors(fit, begun):
        row = {"says": one.text, "name": " and ".join(one.reading.names)}
        findings.append(words.said("input_factor", one.reading.names, log.records, row))
    findings += [*_departed(log, fit), *_zeros(log, fit), *_far(fit, log.records)]
    findings += [*scaled_inputs(fit), *between_runs(fit)]
    return replace(log, findings=tuple(_ordered(findings)))


def with_departure(log: LogCheck, fit: Fit) -> LogCheck:
    """A check with the departure that a fit names, in place of what was left of it."""
    new = [*_departed(replace(log, findings=()), fit)]
    left = [one for one in log.findings if one.name not in {other.name for other in new}]
    return replace(log, findings=tuple(_ordered([*left, *new])))


def _read_as(log: LogCheck, fit: Fit) -> Iterator[Finding]:
    """Signs and units that sensors of the model stand for: no sensor errs by such a factor."""
    channels = fit.dataset.channels
    told = words.Log(channels, (), log.records)
    units = {one.name: one.unit for one in channels.outputs}
    for name, size, error in _scales(fit):
        scale = Found(Candidate("scale", (name,), "1"), size, error)
        yield from map(told.reading, as_readings(scale, units))


def _scales(fit: Fit) -> Iterator[tuple[str, float, float]]:
    """Outputs that the model takes in proportion, with the relative error and its deviation."""
    for effect in fit.model.effects:
        own = {p.name for p in effect.parameters} & {*fit.std_errors}
        terms = {str(key): term for key, term in effect.terms.items()}
        for name, term in terms.items() if effect.stage == "sensor" and len(own) == 1 else ():
            (size,) = own
            if {*names_in(term)} == {name, size}:
                # A share of the output, at any size of either: E y is twice as large for 2 y.
                scope = {name: np.array([0.0, 1.0, 2.0]), size: fit.values[size]}
                added = to_numpy(term, scope) - scope[name]
                if np.allclose(added, added[1] * scope[name]) and added[1]:
                    slope = float(added[1] / fit.values[size])
                    yield name, float(added[1]), abs(slope) * fit.std_errors[size]


def _left(
    log: LogCheck,
    fit: Fit,
    records: Dataset,
    claimed: Sequence[Effect],
    nominal: Mapping[str, float],
) -> list[Finding]:
    """Findings that the records still show beside the effects that were claimed.

    Those of the sensors are undone. What was found of inputs was asked of the nominal model: it is
    asked again with the other effects, all else at the values that it had, unless one of them acts
    with a command and may be what is wrong with it. Without priors, values that were begun with say
    nothing, and those of the fit take their place.
    """
    # Exact coincidences of what was logged stay what they are.
    asked = [f for f in log.serious if f.gain or f.kind == "unexplained"]
    if not (asked and claimed):
        return [*log.findings]
    known = has_priors(fit.model)
    shown = _shown_beside(fit, records, claimed, nominal if known else fit.values)
    commands = {*fit.model.input_names, *fit.model.actuator_signals}
    if known and any(commands & _acting(one) for one in claimed):
        shown |= {one.name for one in asked if {*one.signals} <= commands}
    return [f for f in log.findings if f not in asked or f.name in shown]


def _shown_beside(
    fit: Fit, records: Dataset, claimed: Sequence[Effect], nominal: Mapping[str, float]
) -> set[str]:
    """Names of what a check finds where effects of sensors are undone, and others are as found."""
    sensors = [one for one in claimed if one.stage == "sensor"]
    bare = fit.model.without(*(one.name for one in sensors))
    own = {p.name for one in claimed for p in one.parameters}
    kept = ({*bare.free_names} & {*nominal}) - own
    begun = bare.with_values({name: nominal[name] for name in kept})
    return {one.name for one in check(_without(fit, records, sensors), begun).serious}


def _acting(effect: Effect) -> set[str]:
    """Signals that an effect of an actuator acts on, and names in the terms of any."""
    own = {*map(str, effect.terms)} if effect.stage == "actuator" else set()
    return own.union(*map(names_in, effect.terms.values()))


def _without(fit: Fit, records: Dataset, effects: Sequence[Effect]) -> Dataset:
    r"""Records as they would be without some effects, ``y - h(x, p) + h(x, p_0)``.

    :math:`x, p` are those of whole runs, :math:`p_0` the same with the effects at nothing.
    """
    nothing = {p.name: 0.0 for effect in effects for p in effect.parameters}
    undone = []
    for run in whole_runs(fit.model, records, fit.sigma):
        at = run.unknowns.copy()
        run.shooting.fill(at, 0, np.full(len(run.states), np.nan), nothing)
        changed = run.simulated(at) - run.outputs
        undone.append(run.record.with_outputs(run.record.outputs + np.nan_to_num(changed)))
    return Dataset(tuple(undone))


def _sensed(model: Model | None) -> frozenset[str]:
    """Signals on which sensors have an effect."""
    effects = () if model is None else model.effects
    return frozenset(str(key) for e in effects if e.stage == "sensor" for key in e.terms)


def _noisier(fit: Fit) -> set[str]:
    """Outputs of which a fit finds more noise than declared; all where it failed."""
    if not fit.status.ok:
        return {*fit.model.output_names}
    told = {one.signal for one in concerns_of(fit, "noise_level") if one.size > 1.0}
    level = zip(fit.model.outputs, fit.noise.sensors, strict=True)
    return told | {o.name for o, std in level if std > WORTH_TELLING * (o.noise_std or np.inf)}


def _far(fit: Fit, records: tuple[str, ...]) -> Iterator[Finding]:
    """Values many prior deviations from their prior means."""
    away = {
        p.name: abs(p.value - p.prior_mean) / p.prior_std
        for p in fit.model.free_parameters
        if p.prior_std and p.prior_mean is not None
    }
    far = {name: size for name, size in away.items() if size > BEYOND}
    row = {"away": ", ".join(f"{name} ({size:.1f})" for name, size in far.items())}
    if far:
        yield words.said("far", tuple(far), records, row)


def _departing(fit: Fit) -> Departure | None:
    """The departure of a log that a fit names; an actuator that lags, or is off, is none.

    One that acts before its command is one: the command was logged late.
    """
    asked = fit.process_noise
    likelier = asked is not None and asked.departure_likelier
    ended = likelier or fit.status.ok or fit.status.code == "degenerate"
    if not ended or (best := departure_of(fit)) is None:
        return None
    alike = (best.kind, *best.rivals) if best.kind in MOMENTS else (best.kind,)
    acts = any(one.strip("()").endswith(ACTING) for one in alike)
    early = best.size < 0.0 and best.kind != "acts off"
    return None if acts and not early else best


def _departed(log: LogCheck, fit: Fit) -> Iterator[Finding]:
    """What departs by a fit, unless the equations between signals have said so."""
    if (best := _departing(fit)) is None:
        return
    outputs = dict(zip(fit.model.output_names, fit.noise.sensors, strict=True))
    units = {one.name: one.unit for one in fit.model.outputs}
    late = MATERIAL * min(record.sample_time for record in fit.dataset)
    # Units, and least sizes that matter: those of the equations between signals.
    kinds = {
        "delay": ("s", late),
        "bias": (units.get(best.signal, ""), MATERIAL * float(outputs.get(best.signal, 0.0))),
        "scale": ("1", NEGLIGIBLE),
        "clock": ("1", late / max(record.duration for record in fit.dataset)),
        "lever": ("m", 0.0),
    }
    (one,) = (c for c in concerns_of(fit, "offset", *kinds) if c.size == best.size)
    kind = "bias" if one.kind == "offset" else one.kind
    if not any(log.named(kind, name) for name in best.signals):
        unit, least = kinds[kind]
        yield words.said(
            kind, best.signals, log.records, _text(one), row="departs",
            size=best.size, interval=interval(best.size, best.std), unit=unit, gain=best.gain,
            alternatives=best.rivals, suspect=abs(best.size) > least,
        )  # fmt: skip


def _zeros(log: LogCheck, fit: Fit) -> Iterator[Finding]:
    """Sensors that a fit estimates to be off, unless the equations between signals have said so."""
    unit = {output.name: output.unit for output in fit.model.outputs}
    for one in concerns_of(fit, "zero"):
        if not log.named("bias", one.signal):
            yield words.said(
                "bias", (one.signal,), log.records, _text(one), row="zero",
                size=one.size, unit=unit[one.signal],
            )  # fmt: skip


def _text(one: Concern) -> dict[str, str]:
    """What a concern says, and what to do: the sentences behind the first."""
    says, _, todo = one.text.partition(". ")
    return {"says": f"{says}.", "todo": todo}


def _equations(
    dataset: Dataset, model: Model | None, traces: Sequence[Trace], faults: Sequence[Fault]
) -> list[Relation]:
    """Equations between signals that were measured and say something."""
    everywhere = set.intersection(*(set(trace.values) for trace in traces))
    spare = everywhere - set(dataset.channels.output_names)
    missing = set.intersection(*(set(record.missing_outputs) for record in dataset))
    mute = set().union(*(one.names for one in faults if one.kind in ("dead", "copied")))
    found = (
        standard([o for o in dataset.channels.outputs if o.name not in missing], spare)
        if model is None
        else relations(model, spare, missing)
    )
    return [one for one in found if mute.isdisjoint(one.names)]


def _ordered(findings: list[Finding]) -> list[Finding]:
    """Suspect ones first, and in the order of the steps: what is found later may follow from it.

    A wrong unit explains a wrong noise level.
    """
    rescaled = {n for f in findings if f.kind in ("unit", "swap", "scale") for n in f.signals}
    kept = [f for f in findings if f.kind != "noise" or not rescaled & set(f.signals)]
    return sorted(kept, key=lambda one: not one.suspect)


def _asked(
    names: Sequence[str], traces: Sequence[Trace], equations: tuple[Relation, ...], ended: Result
) -> list[Judged]:
    """What was asked of every signal, from which size on it shows, or why it was not."""
    related, units = names_of(equations), units_of(traces)
    kinds = ("bias", "scale", "delay", "rate", "drift", "step", *words.READ)
    return [
        words.judged_row(kind, name, units[name], ended, related=name in related)
        for name, kind in product(names, kinds)
        if name in units
    ]


def _shared(
    equations: Sequence[Relation], traces: Sequence[Trace], resolved: Sequence[Relation]
) -> tuple[str, ...]:
    """What no kinematics can tell, in sentences; others than the ``resolved`` tell nothing."""
    units, related = units_of(traces), names_of(equations)
    alone = ", ".join(n for n in units if n not in related)
    targets = ", ".join(r.target for r in equations if r.is_rate)
    positions = contrasts.positions_of(equations, units)
    velocities = ", ".join(contrasts.velocities_of(equations, units))
    told = [
        (alone, f"No equation without unknown parameters relates {alone}."),
        (equations, f"Constant offsets of {targets}, and a delay common to all signals."),
        *((True, text) for text in _either(equations, units)),
        (positions, f"The sign of {', '.join(positions)} against those of {velocities} together."),
        (positions, "A bias of an attitude angle against a misalignment of the velocities."),
        (positions, "At a single speed: a bias of a velocity against its scale."),
        (len(positions) > 1, "On straight runs: a current against a bias of the velocities."),
    ]
    return (
        *(text for holds, text in told if holds),
        *(
            f"Whether {one}: too few samples, {one.target} moves between them."
            for one in equations
            if one not in resolved
        ),
    )


def _either(equations: Sequence[Relation], units: Mapping[str, str]) -> Iterator[str]:
    """What an angle and its rate alone cannot tell, unless others depend on the angle."""
    inner = {n for r in equations for n in r.signals}
    for relation in equations:
        angle, *rates = relation.names
        if units.get(angle) == "rad" and len(rates) == 1:
            rate = rates[0]
            if angle in inner:
                yield f"A wrong sign or unit that {angle} and {rate} share in full."
            else:
                yield f"Which of {angle} and {rate} has a wrong sign, unit, scale or delay."


def _balances(
    before: Sequence[Trace], after: Sequence[Trace], equations: tuple[Relation, ...]
) -> Iterator[Balance]:
    """How well each equation holds, as it is and with the findings undone."""
    for relation in equations:
        old, new = (
            [piece for t in traces for piece in contrasts.contrasts(t, (relation,))]
            for traces in (before, after)
        )
        series = tuple((p.side.record, p.times, p.series, _same(p, new)) for p in old)
        unit = before[0].units.get(relation.target, "")
        shares = _share(old), _share(new)
        yield Balance(str(relation), *shares, relation.target, unit, series)


def _same(piece: Piece, others: Sequence[Piece]) -> np.ndarray:
    """The contrast of the piece of the same time, ``(n_blocks,)``."""
    middle = float(np.mean(piece.times))
    here = (one for one in others if one.side.record == piece.side.record)
    twin = next((one for one in here if one.times[0] < middle < one.times[-1]), piece)
    return np.interp(piece.times, twin.times, twin.series)


def _share(pieces: Sequence[Piece]) -> float:
    """Root mean square of what is left of a left side's changes over about a second."""
    left, moved = np.sum([piece.changes for piece in pieces], axis=0) if pieces else (0.0, 0.0)
    return float(np.sqrt(left / moved)) if moved > 0.0 else 1.0
