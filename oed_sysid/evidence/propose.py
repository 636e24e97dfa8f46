r"""Propose a term for what no known effect explains.

Every term of a dictionary is a force along the filtered trajectory. At frozen gain the filter
carries it to the innovations (:mod:`oed_sysid.likelihood.smoother`), the unknowns that the model
has already are projected out, and the statistic

.. math:: T = (s' M r)^2 / s' M s

is computed as in :mod:`oed_sysid.evidence.score`. The most promising terms are refitted as real
effects. What is proposed is a hypothesis that explains the records, in the equation where it is
needed, together with those they cannot tell from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.errors import SimulationError
from oed_sysid.evidence.claim import GROUP_WIDTH, threshold
from oed_sysid.evidence.dictionary import Signals, Term, signals_along, terms
from oed_sysid.evidence.rank import ALIKE, N_REFITS
from oed_sysid.evidence.residual_forces import derivatives, let_in
from oed_sysid.evidence.score import ABSORBED
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.smoother import Path
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import align, as_dict
from oed_sysid.text import expressions

# Share of what the best term explains from which a rival, seen from it, is refitted.
RIVAL = 0.8
# Terms, of those with the largest statistics, whose likeness is looked at.
COMPARED = 60


@dataclass(frozen=True, eq=False)
class Proposal:
    """One term that would explain the records.

    Attributes
    ----------
    term : Term
    effect : Force
        At the fitted value, ready to be added to a model.
    fit : FilteredSolution
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
    fit: FilteredSolution
    gain: float
    score: TermScore
    alike: tuple[TermScore, ...]

    to_dict = as_dict(
        "value", "unit", "gain",
        term="text", name="effect.name", equation="term.equation", expression="term.expression",
        parameter=lambda self: self.effect.parameters[0].name, score="score.statistic",
        alike=lambda self: [other.term.text for other in self.alike],
    )  # fmt: skip

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
        """Gain less what a more complicated term has to be worth: one for every factor."""
        return self.gain - self.term.complexity


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

    to_dict = as_dict("verdict", "needed", "group", "equations", terms="proposals")


def propose(study: Study, fit: FilteredSolution, *, n_refits: int = N_REFITS) -> Proposals:
    """Propose terms for what the present model lacks.

    Parameters
    ----------
    study : Study
    fit : FilteredSolution
        The present model, with estimated noise levels.
    n_refits : int
        How many terms to refit.
    """
    problem, unknowns = let_in(fit, study.unit)
    first, signals = term_scores(problem, unknowns)
    needed = threshold(len(first.scores), 1)
    bench = _Bench(study, fit, problem.model, signals)
    found = bench.refit(_representatives(first, n_refits))
    if found and found[0].gain > needed:
        # Parameters bend to what is missing. With the best term they have straightened,
        # and its noise is small: seen from there, a rival may be better still.
        best = found[0]
        again = let_in(fit, study.unit, best.fit.values, best.fit.noise)
        second, _ = term_scores(*again, signals)
        own = next((s.statistic for s in second.scores if s.term == best.term), 0.0)
        present = {proposal.term for proposal in found}
        rivals = [
            (score, alike)
            for score, alike in _representatives(second, n_refits)
            if score.statistic > RIVAL * own and score.term not in present
        ]
        if rivals:
            found = sorted([*found, *bench.refit(rivals, best.fit)], key=lambda p: -p.evidence)
    return Proposals(tuple(found), first.scores, needed)


@dataclass(frozen=True, eq=False)
class _Bench:
    """Refits terms as real effects."""

    study: Study
    fit: FilteredSolution
    model: Model
    signals: Signals

    def refit(
        self,
        chosen: Sequence[tuple[TermScore, Sequence[TermScore]]],
        near: FilteredSolution | None = None,
    ) -> list[Proposal]:
        """Refit each chosen term alone, best first; from parameters of a nearby fit too."""
        if not chosen:
            return []
        effects = [
            score.term.effect(
                self.model, self.signals.units, max(abs(score.estimate), score.std_error)
            )
            for score, _ in chosen
        ]
        wide = self.study.with_candidates(effects)
        present = self.study.effects_of(self.fit)
        found = []
        for (score, alike), effect in zip(chosen, effects, strict=True):
            refitted = _refit(wide, present, self.fit, effect, score, near)
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
        ordered = sorted(family, key=lambda s: s.term.complexity - s.statistic)
        result.append((ordered[0], ordered[1:]))
    return result


def _refit(
    study: Study,
    present: Sequence[Effect],
    fit: FilteredSolution,
    effect: Effect,
    score: TermScore,
    near: FilteredSolution | None,
) -> FilteredSolution | None:
    """Estimate everything again with one term added."""
    name = effect.parameters[0].name
    effects = (*present, effect)
    starts = [dict(fit.values) | {name: 0.0}, dict(fit.values) | {name: score.estimate}]
    if near is not None:
        starts.insert(0, dict(near.values) | {name: score.estimate})
    best: FilteredSolution | None = None
    for values in starts:
        found = study.estimate(effects, values, fit, update_noise=False, max_iterations=6)
        if found is not None and (best is None or found.objective < best.objective):
            best = found
        if best is not None and fit.objective - best.objective > 0.7 * score.statistic:
            break
    if best is None:
        return None
    again = study.estimate(effects, best.values, best)
    return again if again is not None and again.objective < best.objective else best


@dataclass(frozen=True, eq=False)
class TermScore:
    """Evidence for one term before refitting.

    Attributes
    ----------
    term : Term
    statistic : float
        Chi-squared statistic of its coefficient.
    estimate, std_error : float
        One-step estimate of the coefficient, and its standard error.
    distinct : float
        Share of its signature that free parameters cannot imitate.
    """

    term: Term
    statistic: float
    estimate: float
    std_error: float
    distinct: float


@dataclass(frozen=True, eq=False)
class TermScores:
    """Scores of all terms, largest statistic first.

    Attributes
    ----------
    scores : tuple of TermScore
    likeness : ndarray (n_compared, n_compared)
        Correlation of the projected signatures of the first ones.
    """

    scores: tuple[TermScore, ...]
    likeness: np.ndarray

    def families(self, count: int, alike: float) -> list[list[TermScore]]:
        """The best terms that differ, each followed by those that are like it.

        Parameters
        ----------
        count : int
            How many families.
        alike : float
            Correlation above which two terms are of one family.
        """
        found: list[list[int]] = []
        for index in range(len(self.likeness)):
            near = [family for family in found if abs(self.likeness[family[0], index]) > alike]
            if near:
                near[0].append(index)
            elif len(found) < count:
                found.append([index])
        return [[self.scores[index] for index in family] for family in found]


def term_scores(
    problem: Filtered, unknowns: np.ndarray, signals: Signals | None = None
) -> tuple[TermScores, Signals]:
    """Score every term of the dictionary; those that free parameters imitate are left out.

    Parameters
    ----------
    problem : Filtered
        With a disturbance in every equation, and no level unknown.
    unknowns : ndarray (n_unknowns,)
        Where.
    signals : Signals, optional
        What terms are made of; by default along the filtered path.

    Returns
    -------
    TermScores, Signals
    """
    passes = problem.passes(unknowns, rows=True, gains=True, moves=True)
    if not all(part.ok for part in passes):
        raise SimulationError(
            f"Model {problem.model.name!r} diverges although a force may act in every equation. "
            "Cut the record, or bound the parameters."
        )
    if signals is None:
        size = problem.kernel.n_full
        kept = np.arange(size) if problem.own is None else problem.own
        states = [part.path[:, :size][:, kept] for part in passes]
        signals = signals_along(problem.model, problem.dataset, states)
    dictionary = terms(problem.model, signals.signals)
    matrix, right = problem.gathered(unknowns, passes)
    limits = problem.limits
    matrix = matrix + np.diag(limits.prior_weight)
    right = right + limits.prior_weight * (limits.prior_mean - unknowns)
    n_terms = len(dictionary)
    cross, along_residual = np.zeros((len(right), n_terms)), np.zeros(n_terms)
    full, kept_rows = np.zeros(n_terms), []
    for index, (part, scope) in enumerate(zip(passes, signals.values, strict=True)):
        path = Path.of(part, problem.levels.n_coloured, problem.levels.n_second)
        white = np.nan_to_num(part.innovations / np.sqrt(part.variances)).ravel()
        own = derivatives(problem, unknowns, index, part.rows).reshape(len(white), -1)
        drive = _driven(problem, path, dictionary, scope)
        rows = path.responses(drive).reshape(len(white), -1)
        cross[problem.layout.record_columns(index)] += own.T @ rows
        along_residual -= rows.T @ white
        full += np.sum(rows**2, axis=0)
        kept_rows.append(rows.astype(np.float32))
    return _scored(dictionary, matrix, right, cross, along_residual, full, kept_rows), signals


def _scored(
    dictionary: Sequence[Term],
    matrix: np.ndarray,
    right: np.ndarray,
    cross: np.ndarray,
    along_residual: np.ndarray,
    full: np.ndarray,
    kept: Sequence[np.ndarray],
) -> TermScores:
    """Statistics of terms from products of whitened columns, unknowns projected out."""
    size = np.sqrt(np.diag(matrix))
    size = np.where(size > 0, size, np.inf)
    values, vectors = np.linalg.eigh(matrix / size[:, None] / size)
    seen = values > 1e-11 * values.max()
    basis = vectors[:, seen] / np.sqrt(values[seen]) / size[:, None]
    step, shadow = basis.T @ right, basis.T @ cross
    left = np.sqrt(np.maximum(full - np.sum(shadow**2, axis=0), 0.0))
    usable = np.flatnonzero((left > ABSORBED * np.sqrt(full)) & (full > 0))
    scores = (along_residual - shadow.T @ step)[usable] / left[usable]
    order = usable[np.argsort(-(scores**2))]
    root = dict(zip(usable, scores, strict=True))
    first = order[:COMPARED]
    likeness = (
        sum((rows[:, first].T @ rows[:, first]).astype(float) for rows in kept)
        - shadow[:, first].T @ shadow[:, first]
    )
    return TermScores(
        tuple(
            TermScore(
                dictionary[i],
                float(root[i] ** 2),
                float(root[i] / left[i]),
                float(1.0 / left[i]),
                float(left[i] / np.sqrt(full[i])),
            )
            for i in order
        ),
        likeness / left[first][:, None] / left[first],
    )


def _driven(
    problem: Filtered, path: Path, dictionary: Sequence[Term], scope: dict[str, np.ndarray]
) -> np.ndarray:
    """What a unit of every coefficient adds between samples, ``(n_times, n, n_terms)``."""
    n = len(path.drive)
    texts = dict.fromkeys(term.expression for term in dictionary)
    values = {text: np.broadcast_to(expressions.to_numpy(text, scope), (n,)) for text in texts}
    place = {name: index for index, name in enumerate(problem.levels.noise.places)}
    drive = np.empty((*path.drive.shape[:2], len(dictionary)))
    for index, term in enumerate(dictionary):
        force = path.drive[:, :, place[f"force {term.equation}"]]
        drive[:, :, index] = force * values[term.expression][:, None]
    return drive
