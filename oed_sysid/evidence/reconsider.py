"""Second thoughts of a search: a likelier valley, an effect needed no more, thinned records.

A term that is in no vocabulary is tried beside the effects that a search has found, or in their
place.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.constancy import doubt, imitates
from oed_sysid.evidence.propose import Proposals, propose
from oed_sysid.evidence.rank import Ranking, Refit, rank
from oed_sysid.evidence.search import (
    BOUGHT,
    Added,
    Standing,
    absent,
    difference,
    dismissal,
    own_error,
    persists,
    rises,
    smoothed_fit,
)
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.projection import eliminate
from oed_sysid.physics import Effect
from oed_sysid.text.expressions import names

# An effect stays unasked where its information says that it is worth so many times what it needs.
SURE = 4.0
# Share of the largest gain below which an effect seen in thinned records is asked again.
BESIDE = 0.1
# Twice the log-likelihood within which two fits are the same.
NEARBY = 1.0
# A rival must be this much more likely to take an earlier effect's place.
SWAP_MARGIN = 6.0


def with_effect(
    state: Standing, chosen: Refit, ranking: Ranking, validation_gain: float
) -> Standing:
    """Add an effect, and estimate once more."""
    study = state.study
    fit = not_astray(study, study.settle(chosen.fit))
    if study.validation is not None and rises(study, state.fit, fit, validation_gain):
        fit = chosen.fit  # a better likelihood elsewhere, which the validation records refuse
    effect = chosen.score.effect
    group = ranking.claimed_with(effect.name)
    one = Added(effect, ranking, chosen.gain, ranking.needed(chosen), validation_gain, group)
    return replace(state, added=(*state.added, one), fit=fit, path=(*state.path, fit))


def not_astray(study: Study, fit: FilteredSolution) -> FilteredSolution:
    """The fit, or a likelier one from the nominal values, or from a fit without disturbance forces.

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
    start = (
        study.without_forces(effects, best.values)
        if own_error(study, best, study.train) > BOUGHT
        else None
    )
    if start is not None:
        again = study.estimate(effects, start.values, start, noise=quiet, max_iterations=25)
        if again is not None and again.objective < best.objective - NEARBY:
            best = again
    return fit if best is fit else study.settle(best)


def _preferred(ranking: Ranking, present: str) -> Refit | None:
    """The best of a ranking, or the effect that is present where that one is not clearly worse."""
    if not ranking.refits:
        return None
    best = ranking.refits[0]
    old = next((refit for refit in ranking.refits if refit.name == present), best)
    return old if best.evidence < old.evidence + SWAP_MARGIN else best


def reviewed(state: Standing) -> Standing:
    """Drop or replace effects that others, or a better fit, have made doubtful."""
    study = state.study
    # By identity: a swap puts what came instead at the end.
    for old in state.added:
        needed = state.needed(old.effect)
        is_last = old is state.added[-1]
        if is_last and _cost(state.fit, old.effect) > SURE * needed:
            continue
        others = state.others(old)
        without = _without(state, old)
        if without is None:
            continue
        if without.objective - state.fit.objective < needed:
            return rebuilt(state.dropping(old, study.settle(without)))
        if is_last:  # it was the best of a ranking just now
            continue
        left = replace(state, added=others, fit=without).left
        also = (old.effect.name,)
        ranking = rank(study, without, left, also=also, n_refits=5, share=state.share)
        chosen = _preferred(ranking, old.effect.name)
        if chosen is None:
            continue
        group = ranking.claimed_with(chosen.name)
        if chosen.name == old.effect.name:
            same = replace(old, ranking=ranking, group=group)
            kept = tuple(same if one is old else one for one in state.added)
            state = replace(state, added=kept)
            continue
        if study.validation is not None and study.validate(chosen.fit) > study.validate(state.fit):
            continue
        new = Added(
            chosen.score.effect,
            ranking,
            chosen.gain,
            ranking.needed(chosen),
            old.validation_gain,
            group,
        )
        state = rebuilt(replace(state, added=(*others, new), fit=study.settle(chosen.fit)))
    return state


def judged_anew(state: Standing) -> Standing:
    """Every effect beside the others in the present likelihood: what gains too little is dropped.

    For a set that was found under another noise: its gains are those of that noise.
    """
    while True:
        judged = [(one, _without(state, one)) for one in state.added]
        anew = [
            one if without is None else replace(one, gain=without.objective - state.fit.objective)
            for one, without in judged
        ]
        spare = [
            (one, without)
            for (one, without), seen in zip(judged, anew, strict=True)
            if without is not None and seen.gain < state.needed(one.effect)
        ]
        if not spare:
            return rebuilt(replace(state, added=tuple(anew)))
        least, without = min(spare, key=lambda pair: pair[1].objective)
        state = state.dropping(least, state.study.settle(without))


def _without(state: Standing, one: Added) -> FilteredSolution | None:
    """The fit with all effects but one."""
    return state.study.estimate(
        [other.effect for other in state.others(one)],
        absent(state.fit, one.effect),
        state.fit,
        noise=state.study.loosened(state.fit.noise),
        max_iterations=25,
    )


def on_all_samples(state: Standing, whole: Dataset) -> tuple[Standing, list[str]]:
    """Drop what only the thinned records show: means of a command between samples are not it.

    Asked are effects that remember a command or a signal, and those beside a much larger one.
    """
    study, largest = state.study, max((one.gain for one in state.added), default=0.0)
    full = replace(study, train=whole)
    notes: list[str] = []
    for one in reversed(state.added):
        if not one.effect.memory and one.gain > BESIDE * largest:
            continue
        effects, fit = [other.effect for other in state.others(one)], state.fit
        less = full.estimate(effects, absent(fit, one.effect), fit, max_iterations=12)
        more = full.estimate([*effects, one.effect], fit.values, fit, max_iterations=12)
        if less is None or more is None:
            continue
        if less.objective - more.objective >= state.needed(one.effect):
            continue
        without = study.estimate(effects, less.values, fit, max_iterations=25)
        if without is None:
            continue
        state = rebuilt(state.dropping(one, study.settle(without)))
        notes.append(
            f"{one.effect.name} was seen in the thinned records and is not in all samples: it is "
            "no claim."
        )
    return state, notes


def without_imitations(state: Standing) -> Standing:
    """Drop effects, the last first, that cannot be told from what else is missing."""
    for one in reversed(state.added):
        study = state.study
        sizes = imitates(study, state.fit, one.effect, partial(_without, state, one))
        if not sizes:
            continue
        without = _without(state, one)
        if without is None:
            continue
        told = doubt(one.effect, sizes)
        state = rebuilt(state.dropping(one, study.settle(without)).doubting(one.effect.name, told))
    return state


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


def rebuilt(state: Standing) -> Standing:
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
            fits = [fit for fit in fits if not rises(study, last, fit)] or fits
        path.append(min(fits, key=lambda fit: fit.objective, default=last))
    if state.added:
        path.append(state.fit)
    return replace(state, path=tuple(path))


# A known effect stays beside a proposed term only if both together are likelier by more than
# this, about what any claim needs: what a model lacks is imitated by effects it does not lack.
PLACE_MARGIN = 10.0


def _beside(
    state: Standing, kept: tuple[Added, ...], start: FilteredSolution, proposals: Proposals
) -> Standing | None:
    """The best term beside some effects, less those that only imitated it."""
    assert proposals.best is not None
    effect = proposals.best.effect
    wide = state.study.with_candidates([effect])
    found = wide.estimate(
        [*(one.effect for one in kept), effect], proposals.best.fit.values, start,
        noise=state.study.loosened(start.noise), max_iterations=25,
    )  # fmt: skip
    if found is None:
        return None
    kept, found = _without_imitations(wide, kept, effect, found)
    gain = state.path[len(kept)].objective - found.objective
    one = Added(effect, None, gain, proposals.needed, np.nan, (effect.name,))
    return replace(state, study=wide, added=(*kept, one), fit=found)


def _cheapest(state: Standing) -> tuple[tuple[Standing, Proposals] | None, tuple[str, ...]]:
    """The likeliest term beside all, most or none of the effects; terms tied beside all of them.

    An effect that stays has its price.
    """
    n_known = len(state.added)
    found: list[tuple[float, Standing, Proposals]] = []
    tied: tuple[str, ...] = ()
    for count in sorted({0, max(n_known - 1, 0), n_known}, reverse=True):
        start = state.path[count]
        proposals = propose(state.study, start)
        if proposals.best is None:
            continue
        if count == n_known:
            tied = proposals.group[:3]
        option = _beside(state, state.added[:count], start, proposals)
        if option is not None:
            cost = option.fit.objective + PLACE_MARGIN * (len(option.added) - 1)
            found.append((cost, option, proposals))
    return (min(found, key=lambda one: one[0])[1:] if found else None), tied


def _agreed(state: Standing, option: Standing) -> Standing | None:
    """The search with a term, settled; None where validation records do not agree."""
    study, validation_gain = state.study, np.nan
    if study.validation is not None:
        validation_gain = difference(study.validate(state.fit), option.study.validate(option.fit))
        if validation_gain <= 0 or rises(option.study, state.fit, option.fit):
            return None
    last = replace(option.added[-1], validation_gain=validation_gain)
    settled = option.study.settle(option.fit)
    return replace(option, added=(*option.added[:-1], last), fit=settled)


def with_term(
    state: Standing, max_effects: int
) -> tuple[Standing, Proposals | None, tuple[str, ...]] | None:
    """Propose a term beside the effects found, or in place of some or all of them.

    Returns
    -------
    state : Standing
        With the term, where it is worth it and confirmed.
    proposals : Proposals or None
        Those of the term that was added.
    tied : tuple of str
        Terms that would explain what is left and were not confirmed.
    """
    study, n_known = state.study, len(state.added)
    best, tied = _cheapest(state)
    if best is None:
        return state, None, ()
    option, proposals = best
    found = option.fit
    fewer = n_known - len(option.added)
    gained = state.fit.objective - found.objective
    replaced = fewer + 1 > 0
    worth = gained + PLACE_MARGIN * fewer > PLACE_MARGIN if replaced else gained > proposals.needed
    if not worth:
        return state, None, tied
    term = option.added[-1].effect
    if study.smoothed is not None and (
        _in_noisy_input(study, term)
        or not persists(option.study, smoothed_fit(study, state.fit), found, PLACE_MARGIN)
    ):
        told = dismissal(study, term.name)
        return state.doubting(term.name, told), None, ()
    agreed = _agreed(state, option)
    if agreed is None or len(agreed.added) > max_effects + 1:
        return state, None, tied
    present = {one.effect.name for one in agreed.added}
    gone = tuple(one.effect.name for one in state.added if one.effect.name not in present)
    return rebuilt(replace(agreed, replaced=gone)), proposals, ()


def _without_imitations(
    study: Study, kept: tuple[Added, ...], term: Effect, fit: FilteredSolution
) -> tuple[tuple[Added, ...], FilteredSolution]:
    """Drop known effects, the least likely first, that are not needed beside the term."""
    while kept:
        options = []
        for one in kept:
            others = tuple(other for other in kept if other is not one)
            without = study.estimate(
                [*(o.effect for o in others), term], absent(fit, one.effect), fit, max_iterations=25
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


def _in_noisy_input(study: Study, term: Effect) -> bool:
    """Whether a proposed term holds an input whose log is noisy.

    Where commands are held at few levels, a power of one does nothing that the other coefficients
    cannot do, except to the noise.
    """
    noisy = set(study.noisy_inputs)
    noisy |= {signal for signal, text in study.base.actuator_signals.items() if names(text) & noisy}
    return any(names(text) & noisy for text in term.terms.values())
