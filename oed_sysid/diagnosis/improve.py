r"""The loop: fit, locate, rank, add, refit, until what remains is noise.

An effect is claimed where three things hold:

1. the gain :math:`2\Delta\log L` on the training records is one that chance rarely gives,
   however many candidates were tried;
2. the validation records become more likely, judged with noise levels and start states
   estimated on them and with the uncertainty of the parameters taken along;
3. the error of the model on its own on the validation records is finite and does not rise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from oed_sysid.batch.journal import Journal
from oed_sysid.batch.threads import single_threaded
from oed_sysid.compatibility import LogCheck, quick_check
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.overlap import check_disjoint, together
from oed_sysid.diagnosis.improvement import (
    RISE,
    Improvement,
    Step,
    Term,
    Yardstick,
    parameter_table,
)
from oed_sysid.diagnosis.journal import opened
from oed_sysid.diagnosis.locate import Located, likeliest, locate
from oed_sysid.diagnosis.preparation import prepared
from oed_sysid.diagnosis.propose import Proposals, propose
from oed_sysid.diagnosis.rank import (
    FALSE_CLAIMS,
    FALSE_CLAIMS_BEFORE_TEST,
    Ranking,
    Refit,
    rank,
    threshold,
)
from oed_sysid.diagnosis.remainder import Remains, remains
from oed_sysid.diagnosis.study import Study, total_error
from oed_sysid.diagnosis.usual import settled
from oed_sysid.effects import Effect
from oed_sysid.errors import OedSysidError
from oed_sysid.fitting.fit import Fit
from oed_sysid.fitting.gauss_newton import FilteredSolution
from oed_sysid.fitting.noise_levels import credible_levels
from oed_sysid.fitting.summary import eliminate
from oed_sysid.language.expressions import names
from oed_sysid.model import Model

# An effect stays unasked where its information says that it is worth so many times what it needs.
SURE = 4.0
# Share of the largest gain below which an effect seen in thinned records is asked again.
BESIDE = 0.1
# Twice the log-likelihood within which two fits are the same.
NEARBY = 1.0
# A rival must be this much more likely to take an earlier effect's place.
SWAP_MARGIN = 6.0
# Gain in twice the log-likelihood on validation records that confirms a claim.
CONFIRMED = 2.0
# Error of whole runs, over that of a fit without random forces, that they should not cost.
BOUGHT = 2.0
# Candidates per round that the validation records are asked about.
ASKED = 3
# A known effect stays beside a proposed term only if both together are likelier by more than
# this, about what any claim needs: what a model lacks is imitated by effects it does not lack.
PLACE_MARGIN = 10.0


@dataclass(frozen=True, eq=False)
class _Added:
    """One effect that was added, why, and the fit with it."""

    effect: Effect
    ranking: Ranking | None
    gain: float
    needed: float
    validation_gain: float
    group: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _State:
    """Where the loop stands: what was added, the fit with it, and all fits on the way."""

    study: Study
    added: tuple[_Added, ...]
    fit: FilteredSolution
    path: tuple[FilteredSolution, ...]
    replaced: tuple[str, ...] = ()
    dismissed: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[Effect, ...]:
        return tuple(one.effect for one in self.added)

    @property
    def left(self) -> list[Effect]:
        gone = {effect.name for effect in self.effects} | set(self.dropped)
        return [e for e in self.study.candidates if e.name not in gone]

    @property
    def share(self) -> float:
        """Share of false claims allowed before validation records, if any, are asked."""
        return FALSE_CLAIMS if self.study.validation is None else FALSE_CLAIMS_BEFORE_TEST


@dataclass(frozen=True, eq=False)
class _Reached:
    """Where a search ended, where it began, and what it saw on the way."""

    state: _State
    base: FilteredSolution
    first: Ranking
    rejected: tuple[str, ...]


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
        Notes of the result say so (:mod:`oed_sysid.diagnosis.preparation`).
    candidates : sequence of Effect, optional
        What may be missing; without any, what usually is
        (:func:`~oed_sysid.diagnosis.usual.usual_effects`).
    known_noise : bool
        Whether the declared noise levels are right and sensors have no other
        noise; otherwise levels and colour are estimated.
    disturbances : str or sequence of str
        Where random forces may act beside what is missing: in all equations (``"auto"``,
        ``"all"``), in none (``"none"``) or in those named, as ``("Y", "N")``. Forces that need not
        repeat explain part of any misfit: where none act (calm water, long slow motion), an effect
        shows more clearly without them.
    max_effects : int
        Most effects to add.
    progress : callable, optional
        Told in words what is being done.
    journal : Journal, optional
        Keeps every finished step; a later call with the same content goes on from them.
    """
    tell = progress or (lambda text: None)
    if test is not None:
        check_disjoint(train, test)
    # Overlaps of training and validation records were refused above.
    log = quick_check(train if test is None else together(train, test), model).without("duplicate")
    ready = prepared(train, test)
    train, test = ready.train, ready.validation
    candidates, told = settled(model, train, candidates)
    settings = {
        "known_noise": known_noise,
        "disturbances": [disturbances] if isinstance(disturbances, str) else [*disturbances],
        "max_effects": max_effects,
    }
    keep = opened(journal, model, train, test, candidates, settings)
    begin = partial(Study.begin, model, train, test, candidates, known_noise=known_noise)
    tell("fitting the nominal model")
    study, base = keep.once("nominal model", partial(begin, disturbances=disturbances))
    notes = [*ready.notes, *told]
    found = _searched(study, base, max_effects, tell, keep, notes)
    if disturbances == "auto" and _astray(found.state.study, found.state.fit):
        tell("searching without random forces")
        calm = keep.once("without random forces", partial(begin, disturbances="none"))
        found = _calmer(found, _searched(*calm, max_effects, tell, keep, notes), notes)
    state, base, first = found.state, found.base, found.first
    rejected = [*found.rejected]
    if ready.whole is not None:
        tell("asking all samples")
        state, told = keep.once("all samples", partial(_on_all_samples, state, ready.whole))
        notes += told
    tell("locating where the nominal model fails")
    location = _located(study, base, first, notes, keep)
    left = _kept(keep, "what remains", lambda: remains(state.study, state.fit), notes)
    proposals: Proposals | None = None
    if left is not None and not left.is_noise:
        tell("looking for a term that no known effect holds")
        beyond = _kept(keep, "unknown term", lambda: _with_term(state, max_effects), notes)
        if beyond is not None:
            state, proposals, tied = beyond
            again = _kept(keep, "what remains", lambda: remains(state.study, state.fit), notes)
            left = replace(again or left, tied=tied)
    if left is None:
        left = Remains(np.inf, None)
    notes += _bought(state.study, state.fit)
    tell("fits and errors of every step")
    return keep.once(
        "every step",
        lambda: _result(state, base, first, location, rejected, proposals, left, notes, log),
    )


def _searched(
    study: Study,
    base: FilteredSolution,
    max_effects: int,
    tell: Callable[[str], None],
    keep: Journal,
    notes: list[str],
) -> _Reached:
    """Search from the nominal model to the end."""
    state, first, rejected = _State(study, (), base, (base,)), None, []
    for reached, ranking, refused in _search(state, max_effects, tell, keep, notes):
        state, first = reached, first or ranking
        rejected += refused
    first = first or rank(study, base, study.candidates, n_refits=0, share=state.share)
    return _Reached(state, base, first, tuple(rejected))


def _calmer(found: _Reached, calm: _Reached, notes: list[str]) -> _Reached:
    """Of a search with random forces and one without, the one whose end is likelier with them.

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
    if study.validation is not None and (
        not _difference(study.validate(present), study.validate(fit)) > CONFIRMED
        or _rises(study, present, fit)
    ):
        return found
    notes.append(
        "Random forces had grown over what is missing: it was searched for without them, and is "
        "likelier with them, too."
    )
    fit = study.settle(fit)
    state = replace(calm.state, study=study, fit=fit, path=(*calm.state.path[:-1], fit))
    return replace(calm, state=state)


def _astray(study: Study, found: FilteredSolution) -> bool:
    """Whether random forces explain the records at the price of whole runs."""
    acting = [
        place
        for place, level in zip(found.noise.places, found.noise.force, strict=True)
        if level > 0 and not place.startswith("actuator")
    ]
    return bool(acting) and _alone(study, found) > BOUGHT * study.plain_error


def _alone(study: Study, found: FilteredSolution) -> float:
    """Error of the model on its own on the training records, in units of the noise."""
    return total_error(study.rms(found, study.train) / study.setting.white)


def _bought(study: Study, found: FilteredSolution) -> list[str]:
    """Words where random forces still explain the records at the price of whole runs."""
    if not _astray(study, found):
        return []
    return [
        f"Random forces make the records likely, but a whole run is then "
        f"{_alone(study, found):.3g} x noise off, {study.plain_error:.3g} for the nominal model "
        "without them. Where the sea was calm, look again with disturbances='none' "
        "(--disturbances none): what is missing shows more clearly."
    ]


def _search(
    state: _State,
    max_effects: int,
    tell: Callable[[str], None],
    keep: Journal,
    notes: list[str],
) -> Iterator[tuple[_State, Ranking, list[str]]]:
    """Rank, choose, add, reconsider, until nothing more is worth it.

    Yields the state, the ranking and what the validation records refused after every round, and
    after every stage of it that ended well: what was found stays where a later stage fails.
    """
    try:
        yield from _rounds(state, max_effects, tell, keep)
    except OedSysidError as error:
        notes.append(f"The search ended early: {error}")


def _rounds(
    state: _State, max_effects: int, tell: Callable[[str], None], keep: Journal
) -> Iterator[tuple[_State, Ranking, list[str]]]:
    while len(state.added) < max_effects:
        tell(f"ranking candidates, round {len(state.added) + 1}")
        ranking = keep.once(
            "ranking", partial(rank, state.study, state.fit, state.left, share=state.share)
        )
        yield state, ranking, []
        ranking, told = keep.once("smoothers", partial(_without_smoothers, state, ranking))
        state = replace(state, dismissed=tuple(dict.fromkeys((*state.dismissed, *told))))
        chosen, validation_gain, refused = keep.once("choice", partial(_choose, state, ranking))
        yield state, ranking, refused
        if chosen is None:
            break
        tell(f"adding {chosen.name}")
        adding = partial(_with, state, chosen, ranking, validation_gain)
        state = keep.once(f"with {chosen.name}", adding)
        yield state, ranking, []
        tell("reconsidering the effects added")
        state = keep.once("review", partial(_review, state))
        yield state, ranking, []


def _choose(state: _State, ranking: Ranking) -> tuple[Refit | None, float, list[str]]:
    """Best candidate whose gain chance does not explain and the validation records confirm."""
    refused: list[str] = []
    study = state.study
    hopeful = [r for r in ranking.refits[:ASKED] if r.gain >= ranking.needed(r)]
    if study.validation is None or not hopeful:
        return (hopeful[0] if hopeful else None), np.nan, refused
    before = study.validate(state.fit)
    for refit in hopeful:
        gain = _difference(before, study.validate(refit.fit))
        if gain > CONFIRMED and not _rises(study, state.fit, refit.fit):
            return refit, gain, refused
        refused.append(refit.name)
    return None, np.nan, refused


def _without_smoothers(state: _State, ranking: Ranking) -> tuple[Ranking, tuple[str, ...]]:
    """The ranking without refits that only smooth the noise of a logged input, and why."""
    study, kept, told = state.study, [], []
    asked = [r for r in ranking.refits[:ASKED] if r.gain >= ranking.needed(r)]
    if study.smoothed is None or not asked:
        return ranking, ()
    before = _smoothed(study, state.fit)
    for refit in ranking.refits:
        if refit in asked and not _persists(study, before, refit.fit, ranking.needed(refit)):
            told.append(_dismissal(study, refit.name))
        else:
            kept.append(refit)
    return replace(ranking, refits=tuple(kept)), tuple(told)


def _smoothed(study: Study, fit: FilteredSolution) -> FilteredSolution | None:
    """The same model on the training records with the noise of logged inputs smoothed."""
    assert study.smoothed is not None
    other = replace(study, train=study.smoothed)
    return other.estimate(other.effects_of(fit), fit.values, fit, max_iterations=12)


def _persists(
    study: Study, before: FilteredSolution | None, after: FilteredSolution, needed: float
) -> bool:
    """Whether a gain over a fit to smoothed records is left there.

    The vehicle answers to the true input. What flattens the answer to a noisy log (a play, a lag)
    is likelier, whether or not it is there.
    """
    found = _smoothed(study, after)
    if before is None or found is None:
        return True
    return before.objective - found.objective >= needed


def _in_noisy_input(study: Study, term: Effect) -> bool:
    """Whether a proposed term holds an input whose log is noisy.

    Where commands are held at few levels, a power of one does nothing that the other coefficients
    cannot do, except to the noise.
    """
    noisy = set(study.noisy_inputs)
    noisy |= {signal for signal, text in study.base.actuator_signals.items() if names(text) & noisy}
    return any(names(text) & noisy for text in term.terms.values())


def _dismissal(study: Study, name: str) -> str:
    return (
        f"{name} may explain no more than the noise of the logged {', '.join(study.noisy_inputs)}: "
        "no claim is made."
    )


def _difference(before: float, after: float) -> float:
    """Gain of a model over another, either of which may not run at all."""
    if not np.isfinite(after):
        return -np.inf
    return before - after if np.isfinite(before) else np.inf


def _rises(study: Study, before: FilteredSolution, after: FilteredSolution) -> bool:
    """Whether the error of the model on its own on validation records rises or is infinite."""
    assert study.validation is not None
    old, new = (_total(study, fit) for fit in (before, after))
    return not np.isfinite(new) or new > RISE * old


def _total(study: Study, fit: FilteredSolution) -> float:
    """Error over all outputs on validation records, in units of the noise."""
    assert study.validation is not None
    return total_error(study.rms(fit, study.validation) / study.setting.white)


def _with(state: _State, chosen: Refit, ranking: Ranking, validation_gain: float) -> _State:
    """Add an effect, and estimate once more."""
    study = state.study
    fit = _not_astray(study, study.settle(chosen.fit))
    if study.validation is not None and _rises(study, state.fit, fit):
        fit = chosen.fit  # a better likelihood elsewhere, which the validation records refuse
    effect = chosen.score.effect
    names = [refit.name for refit in ranking.group()]
    group = tuple(dict.fromkeys((effect.name, *names, *ranking.alike(effect.name))))
    one = _Added(effect, ranking, chosen.gain, ranking.needed(chosen), validation_gain, group)
    return replace(state, added=(*state.added, one), fit=fit, path=(*state.path, fit))


def _not_astray(study: Study, fit: FilteredSolution) -> FilteredSolution:
    """The fit, or a likelier one from the nominal values, or from a fit without random forces.

    Where a large effect was missing, forces have grown to explain it and parameters have followed
    them. Once it is there, that may be a valley of its own.
    """
    if not (fit.noise.force > 0).any():
        return fit
    effects, quiet = study.effects_of(fit), study.quiet(fit.noise)
    own = {p.name for effect in effects for p in effect.parameters}
    values = study.base.values | {k: v for k, v in fit.values.items() if k in own}
    best = study.estimate(effects, values, fit, noise=quiet, max_iterations=25)
    if best is None or best.objective > fit.objective - NEARBY:
        best = fit
    start = study.without_forces(effects, best.values) if _alone(study, best) > BOUGHT else None
    if start is not None:
        again = study.estimate(effects, start.values, start, noise=quiet, max_iterations=25)
        if again is not None and again.objective < best.objective - NEARBY:
            best = again
    return fit if best is fit else study.settle(best)


def _review(state: _State) -> _State:
    """Drop or replace effects that others, or a better fit, have made doubtful."""
    study = state.study
    for position, old in enumerate(state.added):
        needed = threshold(len(state.left) + 1, len(old.effect.parameters), state.share)
        is_last = position == len(state.added) - 1
        if is_last and _cost(state.fit, old.effect) > SURE * needed:
            continue
        others = tuple(one for i, one in enumerate(state.added) if i != position)
        values = dict(state.fit.values) | dict.fromkeys(old.effect.amplitude_names, 0.0)
        without = study.estimate(
            [one.effect for one in others],
            values,
            state.fit,
            noise=study.loosened(state.fit.noise),
            max_iterations=25,
        )
        if without is None:
            continue
        if without.objective - state.fit.objective < needed:
            gone = (*state.dropped, old.effect.name)
            fewer = replace(state, added=others, fit=study.settle(without), dropped=gone)
            return _rebuilt(fewer)
        if is_last:  # it was the best of a ranking just now
            continue
        reduced = replace(state, added=others, fit=without)
        ranking = rank(
            study,
            without,
            reduced.left,
            also=(old.effect.name,),
            n_refits=5,
            share=state.share,
        )
        present = next((r for r in ranking.refits if r.name == old.effect.name), None)
        best = ranking.refits[0] if ranking.refits else None
        if best is None:
            continue
        chosen = best
        if present is not None and best.evidence < present.evidence + SWAP_MARGIN:
            chosen = present
        names = [refit.name for refit in ranking.group()]
        group = tuple(dict.fromkeys((chosen.name, *names, *ranking.alike(chosen.name))))
        if chosen.name == old.effect.name:
            same = replace(old, ranking=ranking, group=group)
            kept = tuple(same if i == position else one for i, one in enumerate(state.added))
            state = replace(state, added=kept)
            continue
        if study.validation is not None and study.validate(chosen.fit) > study.validate(state.fit):
            continue
        new = _Added(
            chosen.score.effect,
            ranking,
            chosen.gain,
            ranking.needed(chosen),
            old.validation_gain,
            group,
        )
        state = _rebuilt(replace(state, added=(*others, new), fit=study.settle(chosen.fit)))
    return state


def _on_all_samples(state: _State, whole: Dataset) -> tuple[_State, list[str]]:
    """Drop what only the thinned records show: means of a command between samples are not it.

    Asked are effects that remember a command or a signal, and those beside a much larger one.
    """
    study, largest = state.study, max((one.gain for one in state.added), default=0.0)
    full = replace(study, train=whole)
    notes: list[str] = []
    for one in reversed(state.added):
        if not one.effect.memory and one.gain > BESIDE * largest:
            continue
        others = tuple(o for o in state.added if o is not one)
        values = dict(state.fit.values)
        absent = values | dict.fromkeys(one.effect.amplitude_names, 0.0)
        effects = [o.effect for o in others]
        less = full.estimate(effects, absent, state.fit, max_iterations=12)
        more = full.estimate([*effects, one.effect], values, state.fit, max_iterations=12)
        needed = threshold(len(state.left) + 1, len(one.effect.parameters), state.share)
        if less is None or more is None or less.objective - more.objective >= needed:
            continue
        without = study.estimate(effects, less.values, state.fit, max_iterations=25)
        if without is None:
            continue
        gone = (*state.dropped, one.effect.name)
        state = _rebuilt(replace(state, added=others, fit=study.settle(without), dropped=gone))
        notes.append(
            f"{one.effect.name} was seen in the thinned records and is not in all samples: it is "
            "no claim."
        )
    return state, notes


def _cost(fit: FilteredSolution, effect: Effect) -> float:
    """What leaving an effect out would cost in twice the log-likelihood, by its information."""
    known = {name: i for i, name in enumerate(fit.problem.layout.shared)}
    own = np.array([known[name] for name in effect.amplitude_names if name in known], dtype=int)
    if len(own) < len(effect.amplitude_names):  # one for each record: not told so quickly
        return 0.0
    matrix = fit.matrix + np.diag(fit.problem.limits.prior_weight)
    size = fit.point.unknowns[own]
    rest = np.setdiff1d(np.arange(len(matrix)), own)
    return float(size @ eliminate(matrix, own, rest) @ size)


def _rebuilt(state: _State) -> _State:
    """The same with the fits of all steps made again, each with its own and earlier effects."""
    study, path = state.study, [state.path[0]]
    for count in range(1, len(state.added)):
        last = path[-1]
        effects = state.effects[:count]
        names = [effect.name for effect in effects]
        fits = [fit for fit in state.path if [e.name for e in study.effects_of(fit)] == names]
        for values in (state.fit.values, last.values):
            fit = study.estimate(
                effects, values, last, max_iterations=25, noise=study.loosened(last.noise)
            )
            fits += [] if fit is None else [fit]
        if study.validation is not None:
            # Two optima of nearly the same likelihood: the one that predicts is meant.
            fits = [fit for fit in fits if not _rises(study, last, fit)] or fits
        path.append(min(fits, key=lambda fit: fit.objective, default=last))
    if state.added:
        path.append(state.fit)
    return replace(state, path=tuple(path))


def _with_term(
    state: _State, max_effects: int
) -> tuple[_State, Proposals | None, tuple[str, ...]] | None:
    """Propose a term beside the effects found, or in place of some or all of them.

    Returns
    -------
    state : _State
        With the term, where it is worth it and confirmed.
    proposals : Proposals or None
        Those of the term that was added.
    tied : tuple of str
        Terms that would explain what is left and were not confirmed.
    """
    study, n_known = state.study, len(state.added)
    best: tuple[float, _State, Proposals, FilteredSolution] | None = None
    tied: tuple[str, ...] = ()
    for count in sorted({0, max(n_known - 1, 0), n_known}, reverse=True):
        start = state.path[count]
        proposals = propose(study, start)
        if proposals.best is None:
            continue
        if count == n_known:
            tied = proposals.group[:3]
        effect = proposals.best.effect
        wide = study.with_candidates([effect])
        kept = state.added[:count]
        found = wide.estimate(
            [*(one.effect for one in kept), effect], proposals.best.fit.values, start,
            noise=study.loosened(start.noise), max_iterations=25,
        )  # fmt: skip
        if found is None:
            continue
        kept, found = _without_imitations(wide, kept, effect, found)
        cost = found.objective + PLACE_MARGIN * len(kept)
        if best is None or cost < best[0]:
            gain = state.path[len(kept)].objective - found.objective
            one = _Added(effect, None, gain, proposals.needed, np.nan, (effect.name,))
            option = replace(state, study=wide, added=(*kept, one), fit=found)
            best = cost, option, proposals, found
    if best is None:
        return state, None, ()
    _, option, proposals, found = best
    fewer = n_known - len(option.added)
    gained = state.fit.objective - found.objective
    replaced = fewer + 1 > 0
    worth = gained + PLACE_MARGIN * fewer > PLACE_MARGIN if replaced else gained > proposals.needed
    if not worth:
        return state, None, tied
    term = option.added[-1].effect
    if study.smoothed is not None and (
        _in_noisy_input(study, term)
        or not _persists(option.study, _smoothed(study, state.fit), found, PLACE_MARGIN)
    ):
        told = _dismissal(study, term.name)
        return replace(state, dismissed=(*state.dismissed, told)), None, ()
    validation_gain = np.nan
    if study.validation is not None:
        validation_gain = _difference(study.validate(state.fit), option.study.validate(found))
        if validation_gain <= 0 or _rises(option.study, state.fit, found):
            return state, None, tied
    last = replace(option.added[-1], validation_gain=validation_gain)
    option = replace(option, added=(*option.added[:-1], last), fit=option.study.settle(found))
    if len(option.added) > max_effects + 1:
        return state, None, tied
    present = {one.effect.name for one in option.added}
    gone = tuple(one.effect.name for one in state.added if one.effect.name not in present)
    return _rebuilt(replace(option, replaced=gone)), proposals, ()


def _without_imitations(
    study: Study, kept: tuple[_Added, ...], term: Effect, fit: FilteredSolution
) -> tuple[tuple[_Added, ...], FilteredSolution]:
    """Drop known effects, the least likely first, that are not needed beside the term."""
    while kept:
        options = []
        for one in kept:
            others = tuple(other for other in kept if other is not one)
            values = dict(fit.values) | dict.fromkeys(one.effect.amplitude_names, 0.0)
            without = study.estimate(
                [*(o.effect for o in others), term], values, fit, max_iterations=25
            )
            if without is not None:
                options.append((others, without))
        if not options:
            break
        others, without = min(options, key=lambda pair: pair[1].objective)
        if without.objective - fit.objective > PLACE_MARGIN:
            break
        kept, fit = others, without
    return kept, fit


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
    state: _State,
    base: FilteredSolution,
    first: Ranking,
    location: Located,
    rejected: list[str],
    proposals: Proposals | None,
    left: Remains,
    notes: list[str],
    log: LogCheck,
) -> Improvement:
    study = state.study
    label = "improve, random forces"
    # Fits and the table of errors are of the same estimates, as anybody finds them from the fits.
    path = [study.polished(fit) for fit in (base, *state.path[1:])]
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
    steps = []
    for number, one in enumerate(state.added, start=1):
        steps.append(
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
        )
    yardstick = Yardstick.of(study.train, sigma)
    worst = rms[-1]["test"] if study.validation is not None else rms[-1]["train"]
    names = study.base.output_names
    # Noise that nobody declared is what the fastest wiggles show, whatever a fit took for noise.
    fast = np.where(study.estimated, np.minimum(sigma, credible_levels(study.train)[0]), sigma)
    excess = np.sqrt(np.maximum(worst**2 - fast**2, 0.0)) / yardstick.spread
    shares = {
        name: float(share) for name, share in zip(names, excess, strict=True) if np.isfinite(share)
    }
    term = None
    if proposals is not None and proposals.best is not None:
        term = Term.of(proposals, steps[-1], state.replaced)
    return Improvement(
        model=fits[-1].model,
        base=base_fit.model,
        steps=tuple(steps),
        ranking=first,
        base_fit=base_fit,
        base_error=errors[0],
        final_error=errors[-1],
        location=location,
        remains=replace(left, shares=shares, suspect=_suspect(log, steps)),
        parameters=parameter_table(fits[-1]),
        base_rms=rms[0],
        yardstick=yardstick,
        rejected=tuple(
            name for name in dict.fromkeys(rejected) if name not in {step.added for step in steps}
        ),
        proposed=() if term is None else (term.to_dict(),),
        notes=(*notes, *state.dismissed),
        log=log,
        skipped=study.skipped,
    )


def _suspect(log: LogCheck, steps: Sequence[Step]) -> str:
    """Why the log is not to be trusted; empty where it is, or where a sensor was put right."""
    if not log.suspect or any(step.effect.stage == "sensor" for step in steps):
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
