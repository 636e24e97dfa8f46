r"""The loop: fit, locate, rank, add, refit, until what remains is noise.

An effect is claimed where three things hold:

1. the gain :math:`2\Delta\log L` on the training records is one that chance rarely gives,
   however many candidates were tried;
2. the validation records become more likely, judged with noise levels and start states
   estimated on them and with the uncertainty of the parameters taken along;
3. the error of the model on its own on the validation records is finite and does not rise.

What shapes an improvement, so that a later call finds the steps of one that did not end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from oed_sysid.data.dataset import Dataset, check_disjoint, together
from oed_sysid.errors import OedSysidError
from oed_sysid.evidence.check import LogCheck, check, quick_check
from oed_sysid.evidence.constancy import doubt, imitates
from oed_sysid.evidence.improvement import Improvement, Step, Term, Yardstick, parameter_table
from oed_sysid.evidence.locate import Located, likeliest, locate
from oed_sysid.evidence.preparation import prepared
from oed_sysid.evidence.propose import Proposals
from oed_sysid.evidence.rank import Ranking, Refit, rank, threshold
from oed_sysid.evidence.reconsider import (
    judged_anew,
    on_all_samples,
    reviewed,
    with_effect,
    with_term,
    without_imitations,
)
from oed_sysid.evidence.remainder import Remains, remains
from oed_sysid.evidence.search import (
    ASKED,
    BOUGHT,
    CONFIRMED,
    Standing,
    confirmed,
    difference,
    own_error,
    rises,
    without_smoothers,
)
from oed_sysid.evidence.study import Study
from oed_sysid.evidence.usual import settled
from oed_sysid.likelihood.archive import encode
from oed_sysid.likelihood.departures import other_way
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.judgement import level_concerns
from oed_sysid.likelihood.noise_levels import signal_spread
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.runtime.journal import Journal, opened
from oed_sysid.runtime.threads import single_threaded

# Factor of a declared noise level from which it is worth a word.
OTHER_NOISE = 1.3
# Share of a signal that whole runs must miss before a search is worth making again.
MUCH = 0.1


@dataclass(frozen=True, eq=False)
class _Reached:
    """Where a search ended, where it began, and what it saw on the way."""

    state: Standing
    base: FilteredSolution
    first: Ranking
    rejected: tuple[str, ...]
    last: Ranking | None = None


@dataclass(frozen=True, eq=False)
class _Ended:
    """A search with all samples asked, what is left of the records, and a term for that."""

    state: Standing
    left: Remains
    proposals: Proposals | None
    notes: list[str]


@single_threaded
def improve(
    model: Model,
    train: Dataset,
    test: Dataset | None = None,
    *,
    candidates: Sequence[Effect] | None = None,
    known_noise: bool = False,
    disturbances: str | Sequence[str] = "auto",
    max_effects: int = 4,
    progress: Callable[[str], None] | None = None,
    journal: Journal | None = None,
) -> Improvement:
    """Find the effects that a model lacks.

    Choices are made on the training records; an effect is claimed only where
    it also makes the validation records more likely and predicts them no worse.

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
    progress : callable, optional
        Told in words what is being done.
    journal : Journal, optional
        Keeps every finished step; a later call with the same content goes on from them.
    """
    tell = progress or (lambda text: None)
    for records in (train,) if test is None else (train, test):
        check_channels(model, records)
    if test is not None:
        check_disjoint(train, test)
    # Overlaps of training and validation records were refused above.
    logs = train if test is None else together(train, test)
    # Where nobody named what may be wrong, the log itself is asked at length; tests are no log.
    series = not logs.only_tests
    log = quick_check(logs, model).without("duplicate") if series else None
    asked = None if candidates or not series else check(logs, model, inputs=False)
    ready = prepared(train, test)
    train, test = ready.train, ready.validation
    candidates, told = settled(model, train, candidates, asked)
    keep = opened(
        journal,
        "improve",
        lambda: {
            "model": encode(model),
            "candidates": [encode(effect) for effect in candidates],
            "train": [[record.name, record.content_hash] for record in train],
            "validation": [[record.name, record.content_hash] for record in test or ()],
            "known_noise": known_noise,
            "disturbances": [disturbances] if isinstance(disturbances, str) else [*disturbances],
            "max_effects": max_effects,
        },
        shared={"train": train, "validation": test},
    )
    begin = partial(Study.begin, model, train, test, candidates, known_noise=known_noise)
    tell("fitting the nominal model")
    study, base = keep.once("nominal model", partial(begin, disturbances=disturbances))
    notes = [*ready.notes, *told]
    found = _searched(study, base, max_effects, tell, keep, notes)
    finish = partial(_ended, whole=ready.whole, max_effects=max_effects, tell=tell, keep=keep)

    def calmer(than: _Reached) -> _Reached:
        tell("searching without random forces")
        calm = keep.once("without random forces", partial(begin, disturbances="none"))
        return _calmer(than, _searched(*calm, max_effects, tell, keep, notes), notes)

    may_be_calm = disturbances == "auto"
    if may_be_calm and _astray(found.state.study, found.state.fit):
        found, may_be_calm = calmer(found), False
    end = finish(found)
    if may_be_calm and _unexplained(end):
        reached = replace(found, state=end.state)
        if (other := calmer(reached)) is not reached:
            found, end = other, finish(other)
    notes += end.notes
    tell("locating where the nominal model fails")
    location = _located(study, found.base, found.first, notes, keep)
    notes += _bought(end.state.study, end.state.fit)
    tell("fits and errors of every step")
    result = keep.once("every step", lambda: _result(found, end, location, notes, log))
    acting = other_way(result.fit, {p.name: p.value for p in model.free_parameters})
    said = (*(one.text for one in acting), *_other_noise(result.fit))
    return replace(result, notes=(*said, *result.notes))


def _other_noise(fit: Fit) -> list[str]:
    """Words where sensors are not as loud as declared."""
    slow = {n for n, level in zip(fit.noise.outputs, fit.noise.colour, strict=True) if level > 0}
    found = [
        concern
        for concern in level_concerns(fit)
        # Where some of it is slow, its white part is no level of the sensor.
        if concern.signal not in slow and not 1.0 / OTHER_NOISE < concern.size < OTHER_NOISE
    ]
    if not found:
        return []
    told = ", ".join(f"{concern.signal} {concern.size:.2g} times" for concern in found)
    return [
        f"The noise is not as declared: {told}. Errors in units of the noise count the declared "
        "levels; gains and standard errors are of those found. Correct noise_std, or leave it out."
    ]


def _searched(
    study: Study,
    base: FilteredSolution,
    max_effects: int,
    tell: Callable[[str], None],
    keep: Journal,
    notes: list[str],
) -> _Reached:
    """Search from the nominal model to the end."""
    state, first, rejected = Standing(study, (), base, (base,)), None, []
    last: Ranking | None = None
    for reached, ranking, refused in _search(state, max_effects, tell, keep, notes):
        state, first, last = reached, first or ranking, ranking
        rejected += refused
    first = first or rank(study, base, study.candidates, n_refits=0, share=state.share)
    return _Reached(state, base, first, tuple(rejected), None if last is first else last)


def _ended(
    found: _Reached,
    *,
    whole: Dataset | None,
    max_effects: int,
    tell: Callable[[str], None],
    keep: Journal,
) -> _Ended:
    """Ask all samples, judge what is left, and look for a term where that is no noise."""
    state, notes = found.state, list[str]()
    if whole is not None:
        tell("asking all samples")
        state, notes = keep.once("all samples", partial(on_all_samples, state, whole))
    state = keep.once("sizes", partial(without_imitations, state))
    left = _kept(keep, "what remains", lambda: remains(state.study, state.fit), notes)
    if left is None or left.is_noise:
        return _Ended(state, left or Remains(np.inf, None), None, notes)
    tell("looking for a term that no known effect holds")
    beyond = _kept(keep, "unknown term", lambda: with_term(state, max_effects), notes)
    if beyond is None:
        return _Ended(state, left, None, notes)
    wider, proposals, tied = beyond
    wider = keep.once("sizes with a term", partial(without_imitations, wider))
    again = _kept(keep, "what remains", lambda: remains(wider.study, wider.fit), notes)
    return _Ended(wider, replace(again or left, tied=tied), proposals, notes)


def _unexplained(end: _Ended) -> bool:
    """Whether structure is missing under disturbance forces, and whole runs miss much."""
    if not end.left.structured:
        return False
    study = end.state.study
    missed = study.rms(end.state.fit, study.train) / signal_spread(study.train)
    return bool(np.nanmax(missed) > MUCH)


def _calmer(found: _Reached, calm: _Reached, notes: list[str]) -> _Reached:
    """Of a search with disturbance forces and one without, the one whose end is likelier with them.

    A large missing effect makes forces grow until the records are likely and whole runs are not:
    gains are then judged in a valley from which the right effect does not lead out.
    """
    study, present = found.state.study, found.state.fit
    more = len(calm.state.added) - len(found.state.added)
    if not calm.state.added:
        return found
    end = calm.state.fit
    noise = study.quiet(study.loosened(present.noise))
    fit = study.estimate(calm.state.effects, end.values, end, noise=noise, max_iterations=25)
    needed = max(more, 1) * threshold(len(study.candidates), 1, found.state.share)
    if fit is None or present.objective - fit.objective < needed:
        return found
    if study.validation is not None:
        gain = difference(study.validate(present), study.validate(fit))
        if not gain > CONFIRMED or rises(study, present, fit, gain):
            return found
    notes.append(
        "Random forces had grown over what is missing: it was searched for without them, and is "
        "likelier with them, too."
    )
    fit = study.settle(fit)
    state = replace(calm.state, study=study, fit=fit, path=(*calm.state.path[:-1], fit))
    return replace(calm, state=judged_anew(state))


def _astray(study: Study, found: FilteredSolution) -> bool:
    """Whether disturbance forces explain the records at the price of whole runs."""
    acting = [
        place
        for place, level in zip(found.noise.places, found.noise.force, strict=True)
        if level > 0 and not place.startswith("actuator")
    ]
    return bool(acting) and own_error(study, found, study.train) > BOUGHT * study.plain_error


def _bought(study: Study, found: FilteredSolution) -> list[str]:
    """Words where disturbance forces still explain the records at the price of whole runs."""
    if not _astray(study, found):
        return []
    alone = own_error(study, found, study.train)
    return [
        f"Random forces make the records likely, but a whole run is then {alone:.3g} x noise off, "
        f"{study.plain_error:.3g} for the nominal model without them. Where the sea was calm, look "
        "again with disturbances='none' (--disturbances none): what is missing shows more clearly."
    ]


def _search(
    state: Standing,
    max_effects: int,
    tell: Callable[[str], None],
    keep: Journal,
    notes: list[str],
) -> Iterator[tuple[Standing, Ranking, list[str]]]:
    """Rank, choose, add, reconsider, until nothing more is worth it.

    Yields the state, the ranking and what the validation records refused after every round, and
    after every stage of it that ended well: what was found stays where a later stage fails.
    """
    try:
        yield from _rounds(state, max_effects, tell, keep)
    except OedSysidError as error:
        notes.append(f"The search ended early: {error}")


def _rounds(
    state: Standing, max_effects: int, tell: Callable[[str], None], keep: Journal
) -> Iterator[tuple[Standing, Ranking, list[str]]]:
    while len(state.added) < max_effects:
        tell(f"ranking candidates, round {len(state.added) + 1}")
        ranking = keep.once(
            "ranking", partial(rank, state.study, state.fit, state.left, share=state.share)
        )
        yield state, ranking, []
        ranking, told = keep.once("smoothers", partial(without_smoothers, state, ranking))
        for name, why in told.items():
            state = state.doubting(name, why)
        chosen, validation_gain, refused, told = keep.once(
            "choice", partial(_choose, state, ranking)
        )
        for name, why in told.items():
            state = state.doubting(name, why)
        ranking = ranking.without(told)
        yield state, ranking, refused
        if chosen is None:
            break
        tell(f"adding {chosen.name}")
        adding = partial(with_effect, state, chosen, ranking, validation_gain)
        state = keep.once(f"with {chosen.name}", adding)
        yield state, ranking, []
        tell("reconsidering the effects added")
        state = keep.once("review", partial(reviewed, state))
        yield state, ranking, []


def _choose(
    state: Standing, ranking: Ranking
) -> tuple[Refit | None, float, list[str], dict[str, str]]:
    """Best candidate that chance does not explain, the validation records confirm, and repeats.

    Returns it with its validation gain, what the validation records refused, and words, by name,
    about what cannot be told from what else is missing.
    """
    refused: list[str] = []
    told: dict[str, str] = {}
    study = state.study
    hopeful = [r for r in ranking.refits[:ASKED] if r.gain >= ranking.needed(r)]
    before = np.nan if study.validation is None or not hopeful else study.validate(state.fit)
    for refit in hopeful:
        gain = np.nan
        if study.validation is not None:
            gain = difference(before, study.validate(refit.fit))
            excess = refit.gain / ranking.needed(refit)
            agreed = confirmed(study, state.fit, refit.fit, gain, excess)
            if not agreed or rises(study, state.fit, refit.fit, gain):
                refused.append(refit.name)
                continue
        if sizes := imitates(study, refit.fit, refit.score.effect, lambda: state.fit):
            told[refit.name] = doubt(refit.score.effect, sizes)
            continue
        return refit, gain, refused, told
    return None, np.nan, refused, told


def _located(
    study: Study, base: FilteredSolution, first: Ranking, notes: list[str], keep: Journal
) -> Located:
    rivals = likeliest(first)
    found = _kept(keep, "location", lambda: locate(base, study.unit, rivals), notes)
    return found if found is not None else Located.nothing(base)


def _kept(keep: Journal, label: str, work: Callable, notes: list[str]):  # type: ignore[no-untyped-def,type-arg]
    """What a stage returns; None, and a note, where it fails: earlier results are kept."""
    try:
        return keep.once(label, work)
    except (OedSysidError, np.linalg.LinAlgError) as error:
        notes.append(f"One stage could not be done: {error}")
        return None


def _at_estimates(effect: Effect, values: Mapping[str, float]) -> Effect:
    own = {p.name for p in effect.parameters}
    return effect.with_values({k: v for k, v in values.items() if k in own})


def _result(
    found: _Reached, end: _Ended, location: Located, notes: list[str], log: LogCheck | None
) -> Improvement:
    state, proposals = end.state, end.proposals
    study = state.study
    label = "improve, random forces"
    # Fits and the table of errors are of the same estimates, as anybody finds them from the fits.
    path = [study.polished(fit) for fit in (found.base, *state.path[1:])]
    fits = [study.result(fit, label) for fit in path]
    base_fit = fits[0]
    sigma = _sigma(study, fits)
    rms = [
        {
            "train": study.rms(fit, study.train),
            "test": np.full(len(sigma), np.nan)
            if study.validation is None
            else study.rms(fit, study.validation),
        }
        for fit in path
    ]
    errors = [relative(one, sigma, study) for one in rms]
    steps = [
        Step(
            effect=_at_estimates(one.effect, fits[number].model.values),
            group=one.group,
            gain=one.gain,
            needed=one.needed,
            test_gain=one.validation_gain,
            train_error=errors[number]["train"],
            test_error=errors[number]["test"],
            fit=fits[number],
            rms=rms[number],
        )
        for number, one in enumerate(state.added, start=1)
    ]
    yardstick = Yardstick.of(study.train, sigma)
    term = None
    if proposals is not None and proposals.best is not None:
        term = Term.of(proposals, steps[-1], state.replaced)
    claimed = {step.added for step in steps}
    return Improvement(
        model=fits[-1].model,
        base=base_fit.model,
        steps=tuple(steps),
        ranking=found.first,
        base_fit=base_fit,
        base_error=errors[0],
        final_error=errors[-1],
        location=location,
        remains=replace(
            end.left,
            training=fits[-1].whole_runs,
            validation=None if study.validation is None else fits[-1].runs_on(study.validation),
            suspect=_suspect(log, steps),
        ),
        parameters=parameter_table(fits[-1]),
        base_rms=rms[0],
        yardstick=yardstick,
        rejected=tuple(dict.fromkeys(n for n in found.rejected if n not in claimed)),
        proposed=() if term is None else (term.to_dict(),),
        notes=(*notes, *state.doubts),
        log=log,
        skipped=study.skipped,
        last=found.last if steps else None,
    )


def _suspect(log: LogCheck | None, steps: Sequence[Step]) -> str:
    """Why the log is not to be trusted; empty where it is, or where a sensor was put right."""
    if log is None or not log.suspect or any(step.effect.stage == "sensor" for step in steps):
        return ""
    return log.verdict


def _sigma(study: Study, fits: Sequence[Fit]) -> np.ndarray:
    """Noise level of every output: declared, else the smallest that a fit's sensors have."""
    declared = np.array(
        [np.nan if o.noise_std is None else o.noise_std for o in study.base.outputs]
    )
    found = np.min([fit.noise.sensors for fit in fits if fit.noise is not None], axis=0)
    return np.where(np.isnan(declared), np.maximum(found, study.setting.least_white), declared)


def relative(rms: Mapping[str, np.ndarray], sigma: np.ndarray, study: Study) -> dict[str, float]:
    """Errors of all outputs together, in units of the noise, from those of each."""
    found = {}
    for key, dataset in (("train", study.train), ("test", study.validation)):
        if dataset is None:
            found[key] = np.nan
            continue
        count = np.sum([np.isfinite(r.outputs).sum(axis=0) for r in dataset], axis=0)
        seen = count > 0
        total = float(np.sum(count[seen] * (rms[key][seen] / sigma[seen]) ** 2))
        found[key] = float(np.sqrt(total / count.sum())) if seen.any() else np.nan
    return found
