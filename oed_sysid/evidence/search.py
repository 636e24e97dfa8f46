"""The search: rank, ask, add, ask again, until nothing more is claimed.

Every decision is one :class:`~oed_sysid.evidence.claim.Claim`. After an addition what was added
earlier is asked again in both directions: left out where that costs less than its threshold,
exchanged where another is better in its place. No stage hands on a model whose whole validation
runs are worse than those of the model that it was given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import OedSysidError
from oed_sysid.evidence.chance import threshold
from oed_sysid.evidence.claim import Claim, claim, joined
from oed_sysid.evidence.propose import Proposals, propose
from oed_sysid.evidence.rank import Ranking, Refit, hopeful, pairs, rank
from oed_sysid.evidence.remainder import Remains, followed, remains
from oed_sysid.evidence.score import imitated_by
from oed_sysid.evidence.sentences import SAYS, say
from oed_sysid.evidence.study import Study, likelier, usual
from oed_sysid.evidence.usual import usual_effects
from oed_sysid.information.shifts import GROUP_WIDTH
from oed_sysid.likelihood.departures import TWOFOLD
from oed_sysid.likelihood.estimate import once_a_fit
from oed_sysid.likelihood.gauss_newton import NEAR, FilteredSolution
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.sea_search import periods, with_sea
from oed_sysid.physics import Effect
from oed_sysid.physics.table import POLYNOMIAL
from oed_sysid.physics.variants import BY_RECORD
from oed_sysid.runtime.constants import TOLD_APART
from oed_sysid.runtime.journal import Journal

Done = TypeVar("Done")


@dataclass(frozen=True, eq=False)
class Added:
    """One effect that was added, the decision, and what these data cannot tell from it."""

    effect: Effect
    claim: Claim
    group: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Standing:
    """Where a search stands.

    Attributes
    ----------
    study : Study
    added : tuple of Added
    fit : FilteredSolution
        With them.
    path : tuple of FilteredSolution
        Every fit that was reached, that of the nominal model first.
    decisions : tuple of Claim
        Everything that was asked, in this order.
    replaced, dropped : tuple of str
        Known effects whose place a term took; effects that do not come back.
    provisional : bool
        Whether it is only a place to begin, which may depend on the integration step and holds
        effects that others would do better in their place.
    """

    study: Study
    added: tuple[Added, ...]
    fit: FilteredSolution
    path: tuple[FilteredSolution, ...]
    decisions: tuple[Claim, ...] = ()
    replaced: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    provisional: bool = False

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects that were added, in their order."""
        return tuple(one.effect for one in self.added)

    @property
    def names(self) -> set[str]:
        """Identifiers of the effects that were added."""
        return {effect.name for effect in self.effects}

    @property
    def left(self) -> list[Effect]:
        """Candidates that may still be added."""
        gone = self.names | set(self.dropped)
        return [e for e in self.study.candidates if e.name not in gone]

    @property
    def earlier(self) -> tuple[Added, ...]:
        """What was added but the last; of a pair, claimed as one, both may not be needed."""
        pair = len(self.added) > 1 and self.added[-1].claim is self.added[-2].claim
        return self.added if pair else self.added[:-1]

    def needed(self, effect: Effect) -> float:
        """Threshold of an effect, were it among the candidates left."""
        return threshold(len(self.left) + 1, len(effect.parameters))

    def others(self, one: Added) -> tuple[Added, ...]:
        """What was added besides."""
        return tuple(other for other in self.added if other is not one)

    def at(self, fit: FilteredSolution) -> Standing:
        """The same at another fit."""
        return replace(self, fit=fit, path=(*self.path, fit))

    def dropping(self, one: Added, fit: FilteredSolution) -> Standing:
        """The same without one effect, which does not come back."""
        gone = (*self.dropped, one.effect.name)
        return replace(self.at(fit), added=self.others(one), dropped=gone)


@dataclass(frozen=True, eq=False)
class Ended:
    """Where a search ended and began, what is left of the records, and a term for that."""

    state: Standing
    first: Ranking
    last: Ranking | None
    left: Remains
    proposals: Proposals | None = None

    @property
    def base(self) -> FilteredSolution:
        """The fit of the nominal model."""
        return self.state.path[0]


@dataclass(frozen=True, eq=False)
class Search:
    """How a search is made: once with disturbance forces, perhaps again without.

    Attributes
    ----------
    max_effects : int
        Most effects to add.
    tell : callable
        Told in words what is being done.
    keep : Journal
        Of finished steps.
    notes : list of str
        What the result has to say beside its numbers.
    all_samples : Dataset or None
        Training records with all samples, where some were left out.
    terms : bool
        Whether what no candidate is may be sought: usual effects that were not named, then a term.
    """

    max_effects: int
    tell: Callable[[str], None]
    keep: Journal
    notes: list[str]
    all_samples: Dataset | None
    terms: bool

    def known(self, study: Study, base: FilteredSolution) -> Ended:
        """Search among the candidates from a nominal fit, and ask all samples."""
        state, first, last = self.ended(Standing(study, (), base, (base,)))
        if self.all_samples is not None and state.added:
            self.tell("asking all samples")
            full = replace(study, train=self.all_samples, validation=None)
            asking = partial(eliminated, state, full, state.fit.noise)
            thinned, state = state, self.keep.once("all samples", asking)
            gone = [one.effect.name for one in thinned.added if one not in state.added]
            self.notes.extend(say("search", "thinned", name=name) for name in gone)
        return Ended(state, first, last, self._left(state))

    def beyond(self, end: Ended) -> Ended:
        """Look for what no candidate is, where more than noise is left: usual physics, a term.

        Physics with a name leads a term. Where no usual effect explains as much as the best term
        does, the term is asked first: a search among all of them would end with it, too.
        """
        usual = self._usual(end)
        if usual is None:
            return self._term(end)
        leads = self.stage("what leads", partial(usual_leads, usual, end.state.study))
        with_it = None if leads else self._term(end)
        if with_it is not None and with_it.proposals is not None and not with_it.left.structured:
            return with_it
        after = self._among(usual, end)
        return self._term(after) if with_it is None or after is not end else with_it

    def _usual(self, end: Ended) -> Standing | None:
        """The same state among the usual effects that nobody named, too; None without any."""
        study = end.state.study
        if not (self._unexplained(end) and end.left.structured) or study.train.only_tests:
            return None
        known = {effect.name for effect in (*study.candidates, *study.base.effects)}
        named = usual_effects(study.base, study.train)
        more = [e for e in named if e.source != POLYNOMIAL and e.name not in known]
        if not more:
            return None
        self.tell("looking among usual effects that were not named")
        joined = self.stage("usual effects", partial(study.with_candidates, more))
        return None if joined is None else replace(end.state, study=joined)

    def _among(self, begun: Standing, end: Ended) -> Ended:
        """Go on among more candidates."""
        named = {effect.name for effect in end.state.study.candidates}
        state, _, last = self.ended(begun)
        found = sorted(state.names - named)
        if not found:
            return end
        more = len(begun.study.candidates) - len(named)
        self.notes.append(say("search", "usual", count=more, names=", ".join(found)))
        return replace(end, state=state, last=last or end.last, left=self._left(state))

    def _term(self, end: Ended) -> Ended:
        """Look for a term, where more than noise is left."""
        if not self._unexplained(end):
            return end
        self.tell("looking for a term that no known effect holds")
        found = self.stage("unknown term", partial(with_term, end.state, self.max_effects))
        if found is None:
            return end
        wider, proposals, tied = found
        if proposals is not None:
            # Its forces may have followed motion, as no sea does, for want of the term.
            wider = self.stage("a sea beside the term", partial(with_waves, wider, None)) or wider
        left = end.left if proposals is None else self._left(wider)
        return replace(end, state=wider, left=replace(left, tied=tied), proposals=proposals)

    def _unexplained(self, end: Ended) -> bool:
        """Whether what is left is more than noise, and may be asked for."""
        return self.terms and not end.left.is_noise and bool(np.isfinite(end.left.forces))

    def _left(self, state: Standing) -> Remains:
        work = partial(remains, state.study, state.fit)
        return self.stage("what remains", work) or Remains(np.inf, None)

    def calmer(self, end: Ended, study: Study, base: FilteredSolution) -> Ended:
        """Of a search with disturbance forces and one without, the one that is worth more.

        A large missing effect makes forces grow until the records are likely and whole runs are
        not: the right effect does not lead out of that valley. What the other search finds is
        estimated with forces from where it ended, and claimed against what this one has. Where that
        is not likelier, whole runs decide: a constant force, say, does not show beside forces that
        wander, and process noise could not have left runs that are so much better. Where forces
        follow motion or commands, which no disturbance does, any better runs of no more effects do.
        Nothing found is no reason to leave out forces that the records ask for.
        """
        calm, first, last = self.ended(Standing(study, (), base, (base,), provisional=True))
        calm = replace(calm, provisional=False)  # what is taken of it is resolved and exchanged
        found, present = end.state.study, end.state.fit
        noise = found.loosened(calm.fit.noise)
        fit = calm.added and found.estimate(calm.effects, calm.fit.values, calm.fit, noise=noise)
        if not fit:
            return end
        # More than nothing, where both found the same.
        needed = 2.0 * NEAR + sum(calm.needed(effect) for effect in calm.effects)
        spared = sum(end.state.needed(effect) for effect in end.state.effects)
        decided = claim(found, present, fit, calm.effects, needed, spared)
        state = replace(calm, decisions=(*end.state.decisions, decided))
        if decided.stands:
            self.notes.append(SAYS["search"]["likelier"])
            fit = found.kept(fit, found.resolved(fit))
            state = asked_again(replace(state.at(fit), study=found))
            return self.beyond(Ended(state, first, last, self._left(state)))
        refused = replace(end, state=replace(end.state, decisions=state.decisions))
        records = study.train if study.validation is None else study.validation
        here = found.own_error(present, records)

        def better(one: Standing, by: float) -> bool:
            return by * study.own_error(one.fit, records) < here

        # No effect was added that made whole runs worse, so that none is left out to better them.
        if not better(state, 1.0 if end.left.follows else TWOFOLD):
            return refused
        state = eliminated(asked_again(state), found, noise, TWOFOLD)
        # Process noise that follows motion or commands is none: any better runs of no more effects.
        fewer = end.left.follows and len(state.added) <= len(end.state.added)
        if not (state.added and better(state, 1.0 if fewer else TWOFOLD)):
            return refused
        fit = study.kept(state.fit, study.resolved(state.fit))
        state = state.at(fit)
        there = study.own_error(fit, records)
        self.notes.append(say("search", "better", times=here / there))
        return self.beyond(Ended(state, first, last, self._left(state)))

    def stage(self, label: str, work: Callable[[], Done]) -> Done | None:
        """What a stage returns; None, and a note, where it fails: earlier results are kept."""
        try:
            return self.keep.once(label, work)
        except (OedSysidError, np.linalg.LinAlgError) as error:
            self.notes.append(say("search", "failed", error=error))
            return None

    def ended(self, state: Standing) -> tuple[Standing, Ranking, Ranking | None]:
        """Search to the end: the state, the first and the last ranking; what was found stays."""
        seen: list[tuple[Standing, Ranking]] = []
        try:
            seen.extend(self.rounds(state))
        except OedSysidError as error:
            self.notes.append(say("search", "early", error=error))
        if not seen:
            return state, rank(state.study, state.fit, state.left, n_refits=0), None
        first, (end, last) = seen[0][1], seen[-1]
        return end, first, None if last is first else last

    def rounds(self, state: Standing) -> Iterator[tuple[Standing, Ranking]]:
        """The state and the ranking after every stage that ended well."""
        once, tell = self.keep.once, self.tell
        while len(state.added) < self.max_effects:
            tell(f"ranking candidates, round {len(state.added) + 1}")
            ranking = once("ranking", partial(_ranked, state))
            state = once("alike", partial(with_alike, state, ranking))
            yield state, ranking
            chosen, decisions = once("choice", partial(choice, state, ranking))
            state = replace(state, decisions=(*state.decisions, *decisions))
            rival = None if chosen is None else chosen[1]
            calm = not state.fit.noise.seas
            state = once("a sea", partial(with_waves, state, rival))
            yield state, ranking
            if calm and state.fit.noise.seas:
                tell("confirmed a sea in the place of disturbance forces of first order")
                continue
            if chosen is None:
                break
            refit, decided = chosen
            tell(
                f"confirmed {decided.name}: T = {decided.statistic:.1f}, threshold "
                f"{decided.needed:.1f}"
            )
            work = partial(with_refit, state, refit, decisions, ranking)
            state = once(f"with {refit.name}", work)
            yield state, ranking
            tell("asking again what was added")
            asking = eliminated if state.provisional else asked_again
            state = once("asked again", partial(asking, state))
            yield state, ranking


@once_a_fit
def _ranked(state: Standing) -> Ranking:
    """The candidates left; asked whether one leads a term, and in the first round after that."""
    return rank(state.study, state.fit, state.left)


_proposed = once_a_fit(propose, place=1)


def usual_leads(state: Standing, nominal: Study) -> bool:
    """Whether a candidate explains as much as the best term, by odds that tell them apart.

    Terms are asked beside the study without those candidates, as they are after that.
    """
    refits, term = _ranked(state).refits, _proposed(nominal, state.fit).best
    named = refits[0].evidence if refits else -np.inf
    return term is None or bool(named > term.refit.evidence - TOLD_APART)


def with_alike(state: Standing, ranking: Ranking) -> Standing:
    """The last effect's group with all that does as well in its place, beside the model it made.

    That is what free parameters imitate there, and what passed behind it: beside another noise
    model the two may have been told apart.
    """
    if not state.added:
        return state
    *others, last = state.added
    known = {*last.group, f"{last.effect.name}{BY_RECORD}"}
    names = {*_imitating(state, last, ranking), *_just_behind(state, last)} - known
    asked = [one for one in state.left if one.name in names]
    rivals = [one.name for one in asked if _replaces(state, last, one)]
    return replace(state, added=(*others, replace(last, group=(*last.group, *rivals))))


def _imitating(state: Standing, last: Added, ranking: Ranking) -> Iterable[str]:
    """Names of effects that free parameters imitate, as the one that was added last."""
    imitated = set(ranking.imitated())
    absorbed = [effect for effect in state.left if effect.name in imitated]
    return imitated_by(state.study, state.fit, last.effect, absorbed) if absorbed else ()


def _just_behind(state: Standing, last: Added) -> Iterable[str]:
    """Names of effects that were passed over behind it, but not far."""
    near = (one for one in state.decisions if TWOFOLD * one.excess > last.claim.excess)
    return (one.name for one in near if one.behind == f"behind {last.claim.name}")


def _replaces(state: Standing, last: Added, rival: Effect) -> bool:
    """Whether all records are as likely with a rival in the place of what was added last.

    Near the fit a small change of one is like that of the other and of what is free; that of the
    whole effect need not be.
    """
    study, fit = state.study, state.fit
    effects = (*(one.effect for one in state.others(last)), rival.widened())
    begins = (fit.values, dict(fit.values) | usual([rival]))
    found = likelier(*(study.estimate(effects, values, fit) for values in begins))
    if found is None:
        return False
    worse = found.objective - fit.objective
    if study.validation is not None:
        worse += study.predict(found, study.validation).value
        worse -= study.predict(fit, study.validation).value
    return bool(worse < GROUP_WIDTH)


def with_waves(state: Standing, rival: Claim | None) -> Standing:
    """Ask a sea in the place of forces of first order, as any effect.

    It is where it is claimed and its forces follow neither motion nor commands; and where what
    would be added else, ``rival``, has neither a larger statistic nor whole runs that are much
    better: noise leaves those as they are.
    """
    study, fit = state.study, state.fit
    found, places = _at_sea(state, last=rival is None)
    if found is fit or not found.noise.seas:
        return state
    # A level in each place, a period that is the best of many, and a width.
    needed = threshold(len(state.left) + 1, len(places) + 2, trials=len(periods(fit)))
    decided = replace(claim(study, fit, found, (), needed), name="a sea")
    if decided.stands and rival is not None and _explained(decided, rival):
        return state  # asked again beside what explains more
    # A force that follows motion or commands is physics, whatever its period.
    if taken := decided.stands and not followed(found):
        state = replace(state, fit=found, path=(*(p for p in state.path if p is not fit), found))
    else:
        decided = decided.passed_over("but its forces follow motion or commands")
    earlier = (
        one.passed_over("behind a sea") if taken and one is rival else one
        for one in state.decisions
    )
    return replace(state, decisions=(*earlier, decided))


def _at_sea(state: Standing, *, last: bool) -> tuple[FilteredSolution, list[str]]:
    """The fit with a sea where one may still act, and the places of its forces.

    In the ``last`` round what declared sensors were granted may be waves: with the noise that was
    declared the model is estimated anew.
    """
    fit, setting = state.fit, state.study.setting
    places = [place for place in setting.at_sea if place in fit.noise.places]
    if setting.seas or fit.noise.seas or not places:
        return fit, []
    found = with_sea(fit, replace(setting, any_sea=True))
    if last and found is fit and np.any((fit.noise.colour > 0) & ~state.study.estimated):
        found = state.study.anew(fit, at_sea=True) or fit
    return found, places


def _explained(sea: Claim, rival: Claim) -> bool:
    """Whether an effect is worth more than a sea, or leaves whole runs that are much better."""
    return sea.statistic <= rival.statistic or TWOFOLD * rival.after < sea.after


def choice(
    state: Standing, ranking: Ranking
) -> tuple[tuple[Refit, Claim] | None, tuple[Claim, ...]]:
    """What is claimed next, if anything, and every decision: single effects, then pairs."""
    claims: list[Claim] = []
    for tried in (lambda: ranking.refits, partial(pairs, state.study, state.fit, ranking)):
        refits = tried()
        asked = [one for one in refits if hopeful(one, refits[0].gain)]
        more = asked_of(state, asked)
        claims += more
        if (lead := leader(ranking, asked, more)) is not None:
            why = f"behind {lead[1].name}"
            return lead, tuple(one if one is lead[1] else one.passed_over(why) for one in claims)
    return None, tuple(claims)


def leader(
    ranking: Ranking, refits: Sequence[Refit], claims: Sequence[Claim]
) -> tuple[Refit, Claim] | None:
    """The refit that stands with the largest excess; of its group, physics that has a name.

    Parameters
    ----------
    ranking : Ranking
        Says what two statistics may differ by and be the same.
    refits, claims : sequence
        What was asked, and the answers.
    """
    standing = [pair for pair in zip(refits, claims, strict=True) if pair[1].stands]
    standing.sort(key=lambda pair: -pair[1].excess)
    if not standing:
        return None
    best, first = standing[0]
    close = (
        (refit, one)
        for refit, one in standing
        if first.excess - one.excess < ranking.error(best, refit, first.independent)
    )
    return next((pair for pair in close if not polynomial(pair[0])), standing[0])


def polynomial(refit: Refit) -> bool:
    """Whether a term of a series is in a refit."""
    return any(effect.source == POLYNOMIAL for effect in refit.effects)


def asked_of(state: Standing, refits: Sequence[Refit]) -> list[Claim]:
    """The claim of every refit."""
    return [claim(state.study, state.fit, r.fit, r.effects, r.needed) for r in refits]


def with_refit(
    state: Standing, refit: Refit, claims: Sequence[Claim], ranking: Ranking
) -> Standing:
    """Add what was claimed, and estimate once more."""
    study = state.study
    decided = next(one for one in claims if one.name == refit.name)
    # A better likelihood elsewhere may be one that the validation records refuse.
    fit = not_astray(study, study.settle(refit.fit))
    fit = study.kept(refit.fit, fit if state.provisional else study.resolved(fit))
    single = len(refit.effects) == 1
    added = [
        Added(effect, decided, ranking.claimed_with(refit, claims) if single else (effect.name,))
        for effect in refit.effects
    ]
    # What is in the model is no other word for what is beside it.
    gone = {effect.name for effect in refit.effects}
    before = [
        replace(one, group=tuple(n for n in one.group if n not in gone)) for one in state.added
    ]
    return replace(state.at(fit), added=(*before, *added))


def not_astray(study: Study, fit: FilteredSolution) -> FilteredSolution:
    """The fit, or a likelier one by more than arithmetic that begins anew, as the nominal one did.

    Where a large effect was missing, parameters and forces have followed it. Once it is there, that
    may be a valley of its own.
    """
    anew = study.anew(fit)
    likelier = anew is not None and anew.objective < fit.objective - 2.0 * NEAR
    return study.settle(anew) if anew is not None and likelier else fit


def asked_again(state: Standing) -> Standing:
    """Drop what costs less than its threshold to leave out; exchange what another does better."""
    state = eliminated(state)
    for old in state.added[:-1]:
        if old in state.added:
            state = _exchanged(state, old)
    return state


def eliminated(
    state: Standing,
    judge: Study | None = None,
    noise: NoiseModel | None = None,
    rise: float | None = None,
) -> Standing:
    """Backward elimination: what costs less than its threshold goes, the least likely first.

    Parameters
    ----------
    state : Standing
        Its last effect stays, where it was claimed on its own just now.
    judge : Study, optional
        Where the cost is asked, in place of the state's own study: all samples of records that were
        thinned, process noise beside effects that were found without. There every effect may go.
    noise : NoiseModel, optional
        To begin with there.
    rise : float, optional
        Ratio of whole-run errors, of the state's own study, by which an effect is needed.
    """
    if not state.added:
        return state
    there = state
    if judge is not None:
        fit = judge.estimate(state.effects, state.fit.values, state.fit, noise=noise)
        if fit is None:
            return state
        there = replace(state, study=judge, fit=fit)
    while asked := state.earlier if judge is None else state.added:
        spare = [(one, *fits) for one in asked if (fits := _spared(state, there, one, rise))]
        if not spare:
            break
        one, fit, judged = min(spare, key=lambda found: found[1].objective)
        state, there = state.dropping(one, fit), there.dropping(one, judged)
    return state


def _spared(
    state: Standing, there: Standing, one: Added, rise: float | None
) -> tuple[FilteredSolution, FilteredSolution] | None:
    """The fits without an effect, here and where the cost is asked; None where it is needed."""
    needed = state.needed(one.effect)
    judged = _without(there, one)
    if judged is None:
        return None
    judged = there.study.settle(judged)
    if claim(there.study, judged, there.fit, [one.effect], needed).excess >= 0.0:
        return None
    fit: FilteredSolution | None = judged
    if there is not state:
        fit = _without(state, one)
        fit = fit and state.study.settle(fit)
    return None if fit is None or state.study.rises(state.fit, fit, rise) else (fit, judged)


def _exchanged(state: Standing, old: Added) -> Standing:
    """The state with another effect in place of one, where that is clearly likelier."""
    study, without = state.study, _without(state, old)
    if without is None:
        return state
    before = replace(state, added=state.others(old), fit=without)
    ranking = rank(study, without, before.left, also=(old.effect.name,))
    present = next((r for r in ranking.refits if r.name == old.effect.name), None)
    best = next(iter(ranking.refits), None)
    if best is None or present is None or best.evidence < present.evidence + GROUP_WIDTH:
        return state
    decided, kept = claims = asked_of(before, [best, present])
    if not decided.stands or decided.excess < kept.excess + GROUP_WIDTH:
        return state
    after = with_refit(before, best, claims, ranking)
    if study.rises(state.fit, after.fit):
        return state
    return replace(after, decisions=(*state.decisions, decided))


def _without(state: Standing, one: Added) -> FilteredSolution | None:
    """The fit with all effects but one."""
    values = dict(state.fit.values) | dict.fromkeys(one.effect.amplitude_names, 0.0)
    effects = [other.effect for other in state.others(one)]
    return state.study.estimate(effects, values, state.fit)


def every_step(state: Standing) -> tuple[FilteredSolution, ...]:
    """Fits of the nominal model and of every step, those that were left out made again."""
    fits = [state.path[0]]
    for count in range(1, len(state.added)):
        seen = [*_reached(state, state.effects[:count], fits[-1])]
        # Two optima of nearly the same likelihood: the one that predicts is meant.
        seen = [fit for fit in seen if not state.study.rises(fits[-1], fit)] or seen
        fits.append(likelier(*seen) or fits[-1])
    return (*fits, *[state.fit][: len(state.added)])


def _reached(
    state: Standing, effects: Sequence[Effect], last: FilteredSolution
) -> Iterator[FilteredSolution]:
    """Fits with just these effects: those that the search came by, else made again."""
    study, names = state.study, {effect.name for effect in effects}
    seen = [fit for fit in state.path if {e.name for e in study.effects_of(fit)} == names]
    yield from seen
    for values in () if seen else (state.fit.values, last.values):
        noise = study.loosened(last.noise)
        fit = study.estimate(effects, values, last, noise=noise)
        if fit is not None:
            yield fit


def with_term(
    state: Standing, max_effects: int
) -> tuple[Standing, Proposals | None, tuple[str, ...]]:
    """Ask for a term that no candidate holds, beside the effects found or in place of some.

    Missing physics that is in no vocabulary is imitated by effects that it is not: terms are sought
    from the nominal model, too, and effects that are not needed beside the term go.

    Returns
    -------
    state : Standing
        With the term, where it is claimed.
    proposals : Proposals or None
        Those of the term that was added.
    tied : tuple of str
        Terms that would explain what is left and were not claimed.
    """
    nominal = replace(state, added=(), fit=state.path[0])
    begun = (state, nominal) if state.added else (state,)
    proposed = [(one, _proposed(one.study, one.fit)) for one in begun]
    tied = proposed[0][1].group[:3]
    beside = ((_beside(one, proposals, max_effects), proposals) for one, proposals in proposed)
    options = [(option, proposals) for option, proposals in beside if option is not None]
    if not options:
        return state, None, tied

    def cost(pair: tuple[Standing, Proposals]) -> float:
        return pair[0].fit.objective + sum(map(state.needed, pair[0].effects))

    option, proposals = min(options, key=cost)
    gone = [effect for effect in state.effects if effect.name not in option.names]
    spared = sum(map(state.needed, gone))
    # Of what explains alike, physics that has a name leads a term.
    needed = proposals.needed + (TOLD_APART if gone else 0.0)
    *others, term = option.added
    decided = claim(option.study, state.fit, option.fit, [term.effect], needed, spared)
    if gone:
        decided = replace(decided, name=f"{decided.name} in the place of {joined(gone)}")
    decisions = (*state.decisions, decided)
    if not decided.stands:
        return replace(state, decisions=decisions), None, tied
    found = replace(
        option,
        added=(*others, replace(term, claim=decided)),
        fit=option.study.kept(option.fit, option.study.settle(option.fit)),
        decisions=decisions,
        replaced=tuple(effect.name for effect in gone),
    )
    return found, proposals, ()


def _beside(state: Standing, proposals: Proposals, max_effects: int) -> Standing | None:
    """The best term beside the effects of a state, less those not needed any more."""
    if proposals.best is None:
        return None
    effect, study, start = proposals.best.effect, state.study, state.fit
    wide = study.with_candidates([effect])
    found = wide.estimate(
        [*state.effects, effect],
        proposals.best.refit.fit.values,
        start,
        noise=study.loosened(start.noise),
    )
    if found is None:
        return None
    decided = Claim(effect.name, start.objective - found.objective, np.nan, proposals.needed)
    term = Added(effect, decided, (effect.name,))
    option = eliminated(replace(state, study=wide, added=(*state.added, term), fit=found))
    return option if len(option.added) <= max_effects + 1 else None
