"""What no known effect explains: a proposed term joins the model like any other effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oed_sysid.diagnosis.conclusion import Remains, remains
from oed_sysid.diagnosis.greybox import GreyBox, estimate
from oed_sysid.diagnosis.linearise import SuperModel
from oed_sysid.diagnosis.propose import Proposals, propose
from oed_sysid.diagnosis.workbench import Workbench
from oed_sysid.effects import Effect

# A known effect stays beside a term only if both together are likelier by more than this,
# about what any claim needs: what a model lacks is imitated by effects that it does not lack.
PLACE_MARGIN = 10.0


@dataclass(frozen=True, eq=False)
class Unknown:
    """A term that was proposed, tried and confirmed.

    Attributes
    ----------
    effect : Force
        The term as an effect.
    proposals : Proposals
        All terms that were considered.
    replaces : tuple of str
        Known effects that had only imitated it and were taken out.
    kept : tuple of Effect
        Known effects that stay beside it.
    gain, test_gain : float
        Gain in twice the log-likelihood on training and untouched records; NaN
        without any.
    bench : Workbench
        Its super-model holds the term.
    fit : GreyBox
        The fit with it.
    remains : Remains
        What that fit leaves.
    """

    effect: Effect
    proposals: Proposals
    replaces: tuple[str, ...]
    kept: tuple[Effect, ...]
    gain: float
    test_gain: float
    bench: Workbench
    fit: GreyBox
    remains: Remains

    def to_dict(self) -> dict[str, Any]:
        """Return the term as plain data for JSON."""
        best = self.proposals[0]
        parameter = self.effect.parameters[0]
        return {
            "term": best.text,
            "name": self.effect.name,
            "equation": best.term.equation,
            "expression": best.term.expression,
            "parameter": parameter.name,
            "value": self.fit.values[parameter.name],
            "unit": parameter.unit,
            "evidence": self.gain,
            "test_gain": None if np.isnan(self.test_gain) else self.test_gain,
            "group": list(self.proposals.group),
            "replaces": list(self.replaces),
        }


def find_unknown(
    bench: Workbench, added: Sequence[Effect], path: Sequence[GreyBox]
) -> Unknown | None:
    """Propose a term beside the effects found, or in place of some or all of them.

    Parameters
    ----------
    bench : Workbench
        At the present fit.
    added : sequence of Effect
        Known effects in the model, in the order in which they were added.
    path : sequence of GreyBox
        The fits without any of them, with the first, with the first two, ...

    Returns
    -------
    Unknown or None
        None where no term explains more than chance, or where the untouched
        records do not confirm it.
    """
    present = path[-1]
    best: Unknown | None = None
    for count in sorted({0, max(len(added) - 1, 0), len(added)}):
        kept, start = tuple(added[:count]), path[count]
        proposals = propose(bench.train, start)
        if proposals.best is None:
            continue
        effect = proposals.best.effect
        wide = _with_term(bench, effect)
        found = _fit(wide, kept, effect, start, proposals.best.fit.values)
        if found is None:
            continue
        kept, found = _without_imitations(wide, kept, effect, found)
        gone = tuple(e.name for e in added if e not in kept)
        gain = present.objective - found.objective
        left = remains(wide.train, found)
        option = Unknown(effect, proposals, gone, kept, gain, np.nan, wide, found, left)
        if best is None or _cost(option) < _cost(best):
            best = option
        if _worthwhile(option, len(added)) and left.is_noise:
            break  # fewer effects explain everything
    if best is None or not _worthwhile(best, len(added)):
        return None
    if bench.test is None:
        return best
    gain = bench.test_objective(present) - best.bench.test_objective(best.fit)
    return replace(best, test_gain=gain) if gain > 0 else None


def _worthwhile(option: Unknown, n_known: int) -> bool:
    """Whether a term is worth more than the known effects that it joins or replaces.

    One of many terms must gain what chance does not; one in place of a known
    effect must beat it clearly, since it may say the same in other words.
    """
    if not option.replaces:
        return option.gain > option.proposals.needed
    fewer = n_known - len(option.kept) - 1
    return option.gain + PLACE_MARGIN * fewer > PLACE_MARGIN


def _cost(option: Unknown) -> float:
    """Minus twice the log-likelihood, and what every known effect has to be worth."""
    return option.fit.objective + PLACE_MARGIN * len(option.kept)


def _without_imitations(
    bench: Workbench, kept: tuple[Effect, ...], term: Effect, fit: GreyBox
) -> tuple[tuple[Effect, ...], GreyBox]:
    """Drop known effects, the least likely first, that are not needed beside the term."""
    while kept:
        options = []
        for effect in kept:
            others = tuple(e for e in kept if e is not effect)
            values = dict(fit.values) | dict.fromkeys(effect.amplitude_names, 0.0)
            without = _fit(bench, others, term, fit, values)
            if without is not None:
                options.append((others, without))
        if not options:
            break
        others, without = min(options, key=lambda pair: pair[1].objective)
        if without.objective - fit.objective > PLACE_MARGIN:
            break
        kept, fit = others, without
    return kept, fit


def _with_term(bench: Workbench, effect: Effect) -> Workbench:
    """The bench with one more candidate in its super-model."""
    old = bench.train.super_model
    joined = SuperModel.build(old.base, (*old.candidates, effect))
    test = None if bench.test is None else replace(bench.test, super_model=joined)
    return Workbench(replace(bench.train, super_model=joined), test)


def _fit(
    bench: Workbench,
    kept: Sequence[Effect],
    effect: Effect,
    start: GreyBox,
    values: Mapping[str, float],
) -> GreyBox | None:
    """Estimate a model of kept effects and the term, all else absent."""
    base = bench.train.super_model.base
    names = [*base.free_names]
    for present in (*kept, effect):
        names += [p.name for p in present.parameters if not p.fixed]
    chosen = {name: values[name] for name in names if name in values}
    return estimate(bench.train, names, chosen, start.initial, start.noise)
