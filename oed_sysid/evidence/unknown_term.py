"""A term that is in no vocabulary, beside the effects that a search has found or in their place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oed_sysid.evidence.propose import Proposals, propose
from oed_sysid.evidence.reconsider import rebuilt
from oed_sysid.evidence.smoothers import dismissal, persists, smoothed_fit
from oed_sysid.evidence.standing import Added, Standing, absent, difference, rises
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.physics import Effect
from oed_sysid.text.expressions import names

# A known effect stays beside a proposed term only if both together are likelier by more than
# this, about what any claim needs: what a model lacks is imitated by effects it does not lack.
PLACE_MARGIN = 10.0


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
    best: tuple[float, Standing, Proposals, FilteredSolution] | None = None
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
            one = Added(effect, None, gain, proposals.needed, np.nan, (effect.name,))
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
        or not persists(option.study, smoothed_fit(study, state.fit), found, PLACE_MARGIN)
    ):
        told = dismissal(study, term.name)
        return state.doubting(term.name, told), None, ()
    validation_gain = np.nan
    if study.validation is not None:
        validation_gain = difference(study.validate(state.fit), option.study.validate(found))
        if validation_gain <= 0 or rises(option.study, state.fit, found):
            return state, None, tied
    last = replace(option.added[-1], validation_gain=validation_gain)
    option = replace(option, added=(*option.added[:-1], last), fit=option.study.settle(found))
    if len(option.added) > max_effects + 1:
        return state, None, tied
    present = {one.effect.name for one in option.added}
    gone = tuple(one.effect.name for one in state.added if one.effect.name not in present)
    return rebuilt(replace(option, replaced=gone)), proposals, ()


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
