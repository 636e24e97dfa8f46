"""What no known effect explains: a proposed term joins the model like any other effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oed_sysid.diagnosis.greybox import GreyBox, estimate
from oed_sysid.diagnosis.linearise import SuperModel
from oed_sysid.diagnosis.propose import Proposals, propose
from oed_sysid.diagnosis.workbench import Workbench
from oed_sysid.effects import Effect

# A term in place of a known effect must not be less likely than both together by more.
PLACE_MARGIN = 6.0


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
    """

    effect: Effect
    proposals: Proposals
    replaces: tuple[str, ...]
    kept: tuple[Effect, ...]
    gain: float
    test_gain: float
    bench: Workbench
    fit: GreyBox

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
    bench: Workbench, added: Sequence[Effect], fit: GreyBox, earlier: GreyBox
) -> Unknown | None:
    """Propose a term beside the effects found, or in place of the last one.

    Parameters
    ----------
    bench : Workbench
        At the present fit.
    added : sequence of Effect
        Known effects in the model.
    fit : GreyBox
        The fit with them.
    earlier : GreyBox
        The fit without the last of them.

    Returns
    -------
    Unknown or None
        None where no term explains more than chance, or where the untouched
        records do not confirm it.
    """
    options = [(tuple(added), fit)]
    if added:
        options.append((tuple(added[:-1]), earlier))
    best: Unknown | None = None
    for kept, start in options:
        proposals = propose(bench.train, start)
        if proposals.best is None:
            continue
        effect = proposals.best.effect
        wide = _with_term(bench, effect)
        found = _fit(wide, kept, effect, start, proposals.best.fit.values)
        if found is None:
            continue
        gone = tuple(e.name for e in added if e not in kept)
        option = Unknown(
            effect, proposals, gone, kept, fit.objective - found.objective, np.nan, wide, found
        )
        if best is None or found.objective < best.fit.objective + PLACE_MARGIN * len(gone):
            best = option
    if best is None or best.gain < (0.0 if best.replaces else best.proposals.needed):
        return None
    if bench.test is None:
        return best
    gain = bench.test_objective(fit) - best.bench.test_objective(best.fit)
    return replace(best, test_gain=gain) if gain > 0 else None


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
