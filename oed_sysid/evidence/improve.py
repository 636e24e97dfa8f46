r"""The loop: fit, locate, rank, add, refit, until nothing more is claimed.

What is claimed, and why, is one rule (:mod:`oed_sysid.evidence.claim`); how candidates are gone
through is :mod:`oed_sysid.evidence.search`. What shapes an improvement is hashed, so that a later
call finds the steps of one that did not end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset, check_disjoint, together
from oed_sysid.evidence.check import LogCheck, check, with_departure, with_estimates
from oed_sysid.evidence.corrections import as_measured
from oed_sysid.evidence.improvement import Improvement, Step, Yardstick, proposed_terms
from oed_sysid.evidence.locate import Located, likeliest, locate
from oed_sysid.evidence.preparation import Prepared, prepared
from oed_sysid.evidence.remainder import Remains
from oed_sysid.evidence.search import Ended, Search, every_step
from oed_sysid.evidence.sentences import say
from oed_sysid.evidence.study import RISE, Study, worse
from oed_sysid.evidence.usual import settled
from oed_sysid.likelihood.archive import encode
from oed_sysid.likelihood.between_records import WORTH_TELLING
from oed_sysid.likelihood.departures import MOMENTS
from oed_sysid.likelihood.estimate import ProcessNoiseTest
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.input_factors import input_factors
from oed_sysid.likelihood.judgement import concerns_of
from oed_sysid.likelihood.noise_levels import believed_levels
from oed_sysid.likelihood.noise_model import Disturbances
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.runtime.journal import Journal, opened
from oed_sysid.runtime.threads import single_threaded


@single_threaded
def improve(
    model: Model,
    train: Dataset,
    test: Dataset | None = None,
    *,
    candidates: Sequence[Effect] | None = None,
    known_noise: bool = False,
    disturbances: Disturbances = "auto",
    max_effects: int = 4,
    terms: bool = True,
    progress: Callable[[str], None] | None = None,
    journal: Journal | None = None,
) -> Improvement:
    """Find the effects that a model lacks.

    An effect is claimed where training and validation records together are likelier with it than
    chance makes them, and whole validation runs are not predicted worse.

    Parameters
    ----------
    model : Model
        The nominal model.
    train, test : Dataset
        Training records, and validation records that nothing is chosen on. Of a single record
        without any the last part is kept for validation; very long logs are read more coarsely.
        Notes of the result say so (:mod:`oed_sysid.evidence.preparation`).
    candidates : sequence of Effect, optional
        What may be missing; without any, what usually is
        (:func:`~oed_sysid.evidence.usual.usual_effects`).
    known_noise : bool
        Whether the declared noise levels are right and sensors have no other
        noise; otherwise levels and colour are estimated.
    disturbances : str or sequence of str
        Where disturbance forces may act beside what is missing: in all equations (``"auto"``,
        ``"all"``), in none (``"none"``) or in those named, as ``("Y", "N")``. Forces that need not
        repeat explain part of any misfit: where none act (calm water, long slow motion), an effect
        shows more clearly without them.
    max_effects : int
        Most effects to add; a proposed term may come beside them.
    terms : bool
        Whether, where the candidates leave structure, usual effects that were not named are asked,
        and where more than noise is left a term that no candidate holds.
    progress : callable, optional
        Told in words what is being done, and of every effect when it is confirmed.
    journal : Journal, optional
        Keeps every finished step; a later call with the same content goes on from them.

    Returns
    -------
    Improvement
        Its ``model`` and ``fit`` are what to design, predict and export with.

    Raises
    ------
    DataError
        If validation records repeat training records, the records have other channels than the
        model, or they have too few samples for its unknowns.

    Examples
    --------
    >>> from oed_sysid import Dataset, load_problem
    >>> problem = load_problem("remus_diving_plane")
    >>> train = Dataset((problem.data()["train_steps"].window(0.0, 30.0),))
    >>> found = improve(problem.model, train, candidates=problem.effects[:3], terms=False)
    >>> [step.added for step in found.steps]
    ['heave_crossflow_drag']
    """
    tell = progress or (lambda text: None)
    for records in (train,) if test is None else (train, test):
        check_channels(model, records)
    if test is not None:
        check_disjoint(train, test)
    # Overlaps of training and validation records were refused above.
    logs = train if test is None else together(train, test)
    # Tests at given motion are no log.
    log = None if logs.only_tests else check(logs, model).without("duplicate")
    ready, left_out = _measured(prepared(train, test), train, test, log)
    train, test = ready.train, ready.validation
    candidates, told = settled(model, train, candidates, log)
    said = [disturbances] if isinstance(disturbances, str) else disturbances

    def shape() -> dict[str, Any]:
        """What shapes the result, so that a later call finds the steps of one that did not end."""
        return {
            "model": encode(model),
            "candidates": [encode(effect) for effect in candidates],
            "train": [[record.name, record.content_hash] for record in train],
            "validation": [[record.name, record.content_hash] for record in test or ()],
            "known_noise": known_noise,
            "disturbances": [str(one) for one in np.atleast_1d(np.array(said, dtype=object))],
            "max_effects": max_effects,
            "terms": terms,
        }

    keep = opened(journal, "improve", shape, shared={"train": train, "validation": test})
    begin = partial(Study.begin, model, train, test, candidates, known_noise=known_noise)
    tell("fitting the nominal model")
    study, base = keep.once("nominal model", partial(begin, disturbances=disturbances))
    notes = [*ready.notes, *left_out, *told, *_left_aside(study, candidates)]
    read_wrong = _read_wrong(study, base)
    notes += read_wrong
    # What is found in records whose input is read wrong replaces that input.
    searched = (0, False) if read_wrong else (max_effects, terms)
    run = Search(searched[0], tell, keep, notes, ready.whole, searched[1])
    end = run.beyond(run.known(study, base))
    # Without disturbance forces no residual force is left to be seen.
    moved = end.base
    if disturbances == "auto" and not read_wrong and _hiding(end):
        tell("searching without disturbance forces")
        calm = keep.once("without disturbance forces", partial(begin, disturbances="none"))
        end = run.calmer(end, *calm)
    tell("locating where the nominal model fails")
    work = partial(locate, end.base, end.state.study.unit, likeliest(end.first), moved)
    location = run.stage("location", work) or Located.nothing(end.base)
    tell("fits and errors of every step")
    result = keep.once("every step", lambda: _result(end, location, notes, log, logs))
    return replace(result, notes=(*_other_noise(result.fit), *result.notes))


def _measured(
    ready: Prepared, train: Dataset, test: Dataset | None, log: LogCheck | None
) -> tuple[Prepared, tuple[str, ...]]:
    """Records of a search without samples that repeat others; what is thinned keeps its own."""
    if log is None or ready.whole is not None:
        return ready, ()
    (train, words), given = as_measured(train, log), test and as_measured(test, log)
    if given:
        test, words = given[0], tuple(dict.fromkeys((*words, *given[1])))
    return (prepared(train, test), words) if words else (ready, ())


def _left_aside(study: Study, candidates: Sequence[Effect]) -> Iterator[str]:
    """Notes on training samples that stand out alone, and candidates that it cannot take."""
    spikes = [f"{count} of {n} samples of {name}" for name, (count, n) in study.excluded.items()]
    if spikes:
        yield say("records", "spikes", names=", ".join(spikes))
    known = {one.name for one in (*study.candidates, *study.base.effects)}
    if left := [one.name for one in candidates if one.name not in known]:
        yield say("candidates", "unknown", names=", ".join(left))


def _read_wrong(study: Study, base: FilteredSolution) -> list[str]:
    """A note where inputs act otherwise than the start values of the nominal model say."""
    fit = study.result(study.polished(base), "improve, disturbance forces")
    strange = input_factors(fit, study.base.values)
    names = " and ".join(name for one in strange for name in one.reading.names)
    return [say("search", "inputs", names=names)] if names else []


def _hiding(end: Ended) -> bool:
    """Whether disturbance forces may have grown over what is missing.

    They have structure, or an effect made whole runs worse, which only forces allow.
    """
    worsened = any(worse(one.claim.before, one.claim.after, RISE) for one in end.state.added)
    return not end.left.is_noise and (bool(end.left.structured) or worsened)


def _other_noise(fit: Fit) -> list[str]:
    """Words where sensors are not as loud as declared."""
    told = ", ".join(
        f"{one.signal} {one.size:.2g} times"
        for one in concerns_of(fit, "noise_level")
        if not 1.0 / WORTH_TELLING < one.size < WORTH_TELLING
    )
    return [say("records", "noise", names=told)] if told else []


def _result(
    end: Ended, location: Located, notes: Sequence[str], log: LogCheck | None, logs: Dataset
) -> Improvement:
    state, study = end.state, end.state.study
    # Fits and the table of errors are of the same estimates, as anybody finds them from the fits.
    path = [study.polished(fit) for fit in every_step(state)]
    fits = [study.result(fit, "improve, disturbance forces") for fit in path]
    records = {"train": study.train, "test": study.validation}
    base_rms, *rms = [{name: study.rms(fit, of) for name, of in records.items()} for fit in path]
    yardstick = Yardstick({k: of for k, of in records.items() if of}, _sigma(study, fits))
    relative = yardstick.relative
    steps = tuple(
        Step(at.effect.with_values(fit.model.values), at.group, at.claim, fit, own, relative(own))
        for at, fit, own in zip(state.added, fits[1:], rms, strict=True)
    )
    if log is not None:
        told = with_estimates(log, fits[-1], state.effects, study.base.values, logs)
        log = told if log.suspect else _with_times(told, study, fits)
    remains = _whole(end, fits[-1], log)
    return Improvement(
        fits[0], base_rms, steps, end.first, location, remains, yardstick,
        proposed=proposed_terms(end.proposals, steps, state.replaced), notes=tuple(notes), log=log,
        last=end.last if steps else None, decisions=state.decisions,
    )  # fmt: skip


def _with_times(log: LogCheck, study: Study, fits: Sequence[Fit]) -> LogCheck:
    """The check of a log with a signal that is late or early, where that explains more than claims.

    No effect moves what was logged in time.
    """
    one, told = study.departing()
    if one is None or one.kind not in MOMENTS or told <= fits[-1].log_likelihood:
        return log
    asked = ProcessNoiseTest(0.0, departure=one, departure_likelier=True)
    return with_departure(log, replace(fits[0], process_noise=asked))


def _whole(end: Ended, fit: Fit, log: LogCheck | None) -> Remains:
    """What is left, with what whole runs of the last fit and the check of the log say."""
    study, validation = end.state.study, end.state.study.validation
    if end.left.fit is not None:
        fit = study.result(study.polished(end.left.fit), "improve, what remains")
    return replace(
        end.left,
        training=fit.whole_runs,
        validation=None if validation is None else fit.runs_on(validation),
        suspect=log.verdict if log is not None and log.suspect else "",
        unjudged=(*(() if log is None else log.unjudged), *_unmoved(end)),
    )


def _unmoved(end: Ended) -> Iterator[str]:
    """That forces may follow commands of which none moves, in words: a log shows dead ones so."""
    study = end.state.study
    records = [*study.train, *(study.validation or ())]
    moves = any(np.ptp(one.inputs, axis=0).any() for one in records)
    if end.left.random and study.base.inputs and not moves:
        yield say("log", "still", names=", ".join(study.base.input_names))


def _sigma(study: Study, fits: Sequence[Fit]) -> np.ndarray:
    """Noise level of every output: declared, else the smallest that a fit's sensors have."""
    declared = believed_levels(study.base.outputs, study.train)
    found = np.min([fit.noise.sensors for fit in fits], axis=0)
    return np.where(np.isnan(declared), np.maximum(found, study.setting.least_white), declared)
