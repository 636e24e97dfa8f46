"""Propose a term for what no known effect explains.

Every term of a dictionary is scored without refitting, in the metric of the
noise model and along the smoothed trajectory; the most promising are refitted
as real effects. What is proposed is a hypothesis that explains the records, in
the equation where it is needed, together with those they cannot tell from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from oed_sysid.diagnosis.dictionary import Signals, Term, signals_along
from oed_sysid.diagnosis.greybox import GreyBox, Task, estimate
from oed_sysid.diagnosis.linearise import SuperModel
from oed_sysid.diagnosis.rank import GROUP_WIDTH, threshold
from oed_sysid.diagnosis.term_scores import TermScore, TermScores, term_scores
from oed_sysid.effects import Effect
from oed_sysid.fitting.fit import align
from oed_sysid.model import Model
from oed_sysid.noise.linearisation import Along, along

# Terms refitted, at most this alike among each other.
N_REFITS, ALIKE = 8, 0.98
# How much likelier a more complicated term has to be, per factor.
SIMPLICITY = 1.0
# Seen from the best term, a rival is refitted if it explains this share of what that one
# does; so many of the first refits are then repeated beside it.
RIVAL, N_KEPT = 0.8, 3


@dataclass(frozen=True, eq=False)
class Proposal:
    """One term that would explain the records.

    Attributes
    ----------
    term : Term
    effect : Force
        At the fitted value, ready to be added to a model.
    fit : GreyBox
        The fit with it.
    gain : float
        Gain in twice the log-likelihood.
    score : TermScore
        What had been expected.
    alike : tuple of TermScore
        Terms that were not refitted because their signature is almost the same.
    """

    term: Term
    effect: Effect
    fit: GreyBox
    gain: float
    score: TermScore
    alike: tuple[TermScore, ...]

    @property
    def text(self) -> str:
        """The term for a reader, for instance ``M_qqq q^3``."""
        return self.term.text

    @property
    def value(self) -> float:
        """Fitted coefficient."""
        return self.effect.parameters[0].value

    @property
    def unit(self) -> str:
        """Unit of the coefficient."""
        return self.effect.parameters[0].unit

    @property
    def evidence(self) -> float:
        """Gain less what a more complicated term has to be worth."""
        return self.gain - SIMPLICITY * self.term.complexity


@dataclass(frozen=True, eq=False)
class Proposals:
    """Terms that would explain what no known effect explains, best first.

    Attributes
    ----------
    proposals : tuple of Proposal
    scores : tuple of TermScore
        Every term, largest statistic first.
    needed : float
        Gain that a claim needs, so many terms looked at.
    """

    proposals: tuple[Proposal, ...]
    scores: tuple[TermScore, ...]
    needed: float

    def __len__(self) -> int:
        return len(self.proposals)

    def __getitem__(self, index: int) -> Proposal:
        return self.proposals[index]

    @property
    def best(self) -> Proposal | None:
        """The best proposal; None where chance explains its gain."""
        if self.proposals and self.proposals[0].gain > self.needed:
            return self.proposals[0]
        return None

    @property
    def group(self) -> tuple[str, ...]:
        """The best term and all that these records cannot tell from it."""
        if self.best is None:
            return ()
        top = self.best.evidence
        found: list[str] = []
        for proposal in self.proposals:
            if top - proposal.evidence < GROUP_WIDTH:
                found += [proposal.text, *(other.term.text for other in proposal.alike)]
        return tuple(dict.fromkeys(found))

    @property
    def equations(self) -> dict[str, float]:
        """Largest score statistic of any term, by equation, largest first."""
        found: dict[str, float] = {}
        for score in self.scores:
            found.setdefault(score.term.equation, score.statistic)
        return found

    @property
    def verdict(self) -> str:
        """The finding in words."""
        best = self.best
        if best is None:
            return (
                f"None of {len(self.scores)} terms explains more than chance "
                f"(a gain of {self.needed:.0f} is needed)."
            )
        text = (
            f"A term {best.text} with {best.effect.parameters[0].name} = {best.value:.4g} "
            f"{best.unit} in the {best.term.equation} equation would explain the records "
            f"(gain {best.gain:.0f}, needed {self.needed:.0f})."
        )
        others = [name for name in self.group if name != best.text]
        if others:
            text += " These records cannot tell it from " + ", ".join(others[:8])
            text += f" and {len(others) - 8} more." if len(others) > 8 else "."
        return text

    def report(self) -> str:
        """Return the proposals as text."""
        rows = [("term", "equation", "gain", "score", "value", "unit", "distinct")]
        for proposal in self.proposals:
            rows.append(
                (
                    proposal.text,
                    proposal.term.equation,
                    f"{proposal.gain:.1f}",
                    f"{proposal.score.statistic:.1f}",
                    f"{proposal.value:.4g}",
                    proposal.unit,
                    f"{proposal.score.distinct:.2f}",
                )
            )
        lines = align(rows) if len(rows) > 1 else []
        return "\n".join([*lines, "", self.verdict] if lines else [self.verdict])

    def to_dict(self) -> dict[str, Any]:
        """Return the proposals as plain data for JSON."""
        return {
            "verdict": self.verdict,
            "needed": self.needed,
            "group": list(self.group),
            "equations": self.equations,
            "terms": [
                {
                    "term": proposal.text,
                    "name": proposal.effect.name,
                    "equation": proposal.term.equation,
                    "expression": proposal.term.expression,
                    "parameter": proposal.effect.parameters[0].name,
                    "value": proposal.value,
                    "unit": proposal.unit,
                    "gain": proposal.gain,
                    "score": proposal.score.statistic,
                    "alike": [other.term.text for other in proposal.alike],
                }
                for proposal in self.proposals
            ],
        }


def propose(task: Task, fit: GreyBox, *, n_refits: int = N_REFITS) -> Proposals:
    """Propose terms for what the present model lacks.

    Parameters
    ----------
    task : Task
    fit : GreyBox
        The present model, with estimated noise levels.
    n_refits : int
        How many terms to refit.
    """
    linear = along(task, fit)
    signals = signals_along(linear.system.model, task.dataset, [s.states for s in linear.stretches])
    first = term_scores(linear, signals)
    needed = threshold(len(first.scores), 1)
    bench = _Bench(task, fit, linear.system.model, signals)
    found = bench.refit(_representatives(first, n_refits), linear, task)
    if found and found[0].gain > needed:
        # Parameters bend to what is missing. With the best term they have straightened,
        # and its noise is small: seen from there, a rival may be better still.
        best = found[0]
        again = linear.system.at(best.fit.values).linearise(
            [s.states for s in linear.stretches], best.fit.noise
        )
        second = term_scores(again, signals)
        own = next((s.statistic for s in second.scores if s.term == best.term), 0.0)
        present = {proposal.term for proposal in found}
        rivals = [
            (score, alike)
            for score, alike in _representatives(second, n_refits)
            if score.statistic > RIVAL * own and score.term not in present
        ]
        if rivals:
            closer = replace(task, deviations=again.joint)
            kept = {proposal.term for proposal in found[:N_KEPT]}
            repeated: list[tuple[TermScore, list[TermScore]]] = [
                (score, []) for score in second.scores if score.term in kept
            ]
            found = [*bench.refit([*repeated, *rivals], again, closer), *found[N_KEPT:]]
            found.sort(key=lambda p: -p.evidence)
    return Proposals(tuple(found), first.scores, needed)


@dataclass(frozen=True, eq=False)
class _Bench:
    """Refits terms as real effects."""

    task: Task
    fit: GreyBox
    model: Model
    signals: Signals

    def refit(
        self,
        chosen: Sequence[tuple[TermScore, Sequence[TermScore]]],
        linear: Along,
        task: Task,
    ) -> list[Proposal]:
        """Refit each chosen term alone, best first, from where the linear model puts it."""
        if not chosen:
            return []
        effects = [
            score.term.effect(
                self.model, self.signals.units, max(abs(score.estimate), score.std_error)
            )
            for score, _ in chosen
        ]
        active = [e for e in task.super_model.candidates if e.name in self.model.effect_names]
        joined = SuperModel.build(task.super_model.base, [*active, *effects])
        wide = replace(task, super_model=joined)
        found = []
        for (score, alike), effect in zip(chosen, effects, strict=True):
            refitted = _refit(wide, linear, self.fit, effect, score)
            if refitted is not None:
                parameter = effect.parameters[0]
                fitted = effect.with_values({parameter.name: refitted.values[parameter.name]})
                gain = self.fit.objective - refitted.objective
                found.append(Proposal(score.term, fitted, refitted, gain, score, tuple(alike)))
        return sorted(found, key=lambda p: -p.evidence)


def _representatives(scored: TermScores, count: int) -> list[tuple[TermScore, list[TermScore]]]:
    """The best terms that differ; of those that are alike, the simplest stands for all."""
    result = []
    for family in scored.families(count, ALIKE):
        ordered = sorted(family, key=lambda s: SIMPLICITY * s.term.complexity - s.statistic)
        result.append((ordered[0], ordered[1:]))
    return result


def _refit(
    task: Task, linear: Along, fit: GreyBox, effect: Effect, score: TermScore
) -> GreyBox | None:
    """Estimate everything again with one term added."""
    name = effect.parameters[0].name
    names = (*fit.names, name)
    moved = linear.system.moved(score.unknowns[: len(fit.names)]).model.values
    n_own = linear.grounds.n_own
    initial = [
        stretch.states[0, :n_own] + score.unknowns[linear.grounds.unknowns(index)[len(fit.names) :]]
        for index, stretch in enumerate(linear.stretches)
    ]
    starts = (
        (dict(fit.values) | {n: moved[n] for n in fit.names} | {name: score.estimate}, initial),
        (dict(fit.values) | {name: 0.0}, fit.initial),
    )
    best: GreyBox | None = None
    for values, states in starts:
        found = estimate(
            task, names, values, states, fit.noise, update_noise=False, max_iterations=6
        )
        if found is not None and (best is None or found.objective < best.objective):
            best = found
        if best is not None and fit.objective - best.objective > 0.7 * score.statistic:
            break
    if best is None:
        return None
    again = estimate(task, names, best.values, best.initial, best.noise)
    return again if again is not None and again.objective < best.objective else best
