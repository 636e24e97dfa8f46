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

from oed_sysid.evidence.chance import threshold
from oed_sysid.evidence.dictionary import Signals, Term, signals_along, terms
from oed_sysid.evidence.rank import N_REFITS, Refit, refitted
from oed_sysid.evidence.residual_forces import let_in, rows_of, smoothable
from oed_sysid.evidence.score import ABSORBED, Score
from oed_sysid.evidence.study import Study
from oed_sysid.information.shifts import GROUP_WIDTH
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.fit import ALIKE
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.smoother import Path
from oed_sysid.physics import Effect
from oed_sysid.text import expressions

# Share of what the best term explains from which a rival, seen from it, is refitted.
RIVAL = 0.8


@dataclass(frozen=True, eq=False)
class Proposal:
    """One term that would explain the records.

    Attributes
    ----------
    term : Term
    refit : Refit
        With the term as a real effect.
    alike : tuple of str
        Terms that were not refitted because their signature is almost the same.
    """

    term: Term
    refit: Refit
    alike: tuple[str, ...]

    @property
    def effect(self) -> Effect:
        """The term at its fitted value, ready to be added to a model."""
        return self.refit.score.effect.with_values(self.refit.fit.values)

    @property
    def evidence(self) -> float:
        """Gain less what a more complicated term has to be worth: one for every factor."""
        return self.refit.gain - self.term.complexity


@dataclass(frozen=True, eq=False)
class Proposals:
    """Terms that would explain what no known effect explains, best first.

    Attributes
    ----------
    proposals : tuple of Proposal
    needed : float
        Gain that a claim needs, so many terms looked at.
    """

    proposals: tuple[Proposal, ...]
    needed: float

    @property
    def best(self) -> Proposal | None:
        """The best proposal; None where chance explains its gain."""
        return next((one for one in self.proposals[:1] if one.refit.gain > self.needed), None)

    @property
    def group(self) -> tuple[str, ...]:
        """The best term and all that these records cannot tell from it."""
        if self.best is None:
            return ()
        top = self.best.evidence
        near = [one for one in self.proposals if top - one.evidence < GROUP_WIDTH]
        return tuple(dict.fromkeys(text for one in near for text in (one.term.text, *one.alike)))


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
    first = term_scores(*let_in(fit, study.unit))
    needed = threshold(len(first.scores), 1)
    chosen = first.representatives(n_refits)
    found = _refitted(study, fit, first.signals, chosen, needed)
    if found and found[0].refit.gain > needed:
        # Parameters bend to what is missing. With the best term they have straightened,
        # and its noise is small: seen from there, a rival may be better still.
        best = found[0].refit.fit
        again = let_in(fit, study.unit, best.values, best.noise)
        second = term_scores(*again, first.signals)
        own = next((s.statistic for s in second.scores if s.term == found[0].term), 0.0)
        present = {proposal.term for proposal in found}
        rivals = [
            (score, alike)
            for score, alike in second.representatives(n_refits)
            if score.statistic > RIVAL * own and score.term not in present
        ]
        found += _refitted(study, fit, first.signals, rivals, needed, best)
    return Proposals(tuple(sorted(found, key=lambda p: -p.evidence)), needed)


def _refitted(
    study: Study,
    fit: FilteredSolution,
    signals: Signals,
    chosen: Sequence[tuple[TermScore, tuple[str, ...]]],
    needed: float,
    near: FilteredSolution | None = None,
) -> list[Proposal]:
    """Refits of terms, each alone, best first; begun at parameters of a nearby fit where given."""
    scores, model = [], fit.problem.model
    for one, _ in chosen:
        effect = one.term.effect(model, signals.units, max(abs(one.estimate), one.std_error))
        name, nothing = effect.parameters[0].name, np.zeros((0, 1))
        size, error = {name: one.estimate}, {name: one.std_error}
        scores.append(Score(effect, one.statistic, 1, size, error, one.distinct, nothing))
    if not scores:
        return []
    # One structure with all of them: compiled once.
    wide = study.with_candidates([score.effect for score in scores])
    given = {score.effect.name: pair for score, pair in zip(scores, chosen, strict=True)}
    found = []
    for again in refitted(wide, fit, [((score,), needed) for score in scores], near):
        own, alike = given[again.name]
        found.append(Proposal(own.term, again, alike))
    return sorted(found, key=lambda p: -p.evidence)


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
    signals : Signals
        What they are made of.
    """

    scores: tuple[TermScore, ...]
    likeness: np.ndarray
    signals: Signals

    def representatives(self, count: int) -> list[tuple[TermScore, tuple[str, ...]]]:
        """The best terms that differ; of those that are alike, the simplest stands for all."""
        families: list[list[int]] = []
        for index in range(len(self.likeness)):
            near = [own for own in families if abs(self.likeness[own[0], index]) > ALIKE]
            if near:
                near[0].append(index)
            elif len(families) < count:
                families.append([index])
        found = []
        for own in families:
            scores = (self.scores[index] for index in own)
            first, *others = sorted(scores, key=lambda s: s.term.complexity - s.statistic)
            found.append((first, tuple(one.term.text for one in others)))
        return found


def term_scores(
    problem: Filtered, unknowns: np.ndarray, signals: Signals | None = None
) -> TermScores:
    """Score every term of the dictionary; those that free parameters imitate are left out.

    Parameters
    ----------
    problem : Filtered
        With a disturbance in every equation, and no level unknown.
    unknowns : ndarray (n_unknowns,)
        Where.
    signals : Signals, optional
        What terms are made of; by default along the filtered path.
    """
    passes, paths = smoothable(problem, unknowns)
    if signals is None:
        states = [part.path[:, problem.own] for part in passes]
        signals = signals_along(problem.model, problem.dataset, states)
    dictionary = terms(problem.model, signals.signals)
    matrix, right = problem.gathered(unknowns, passes)
    limits = problem.limits
    matrix = matrix + np.diag(limits.prior_weight)
    right = right + limits.prior_weight * (limits.prior_mean - unknowns)
    n_terms = len(dictionary)
    cross, along = np.zeros((len(right), n_terms)), np.zeros(n_terms)
    full, kept_rows = np.zeros(n_terms), []
    for index, (part, path, scope) in enumerate(zip(passes, paths, signals.values, strict=True)):
        white = np.nan_to_num(part.innovations / np.sqrt(part.variances)).ravel()
        own = rows_of(problem, unknowns, index, part.rows).reshape(len(white), -1)
        rows = path.responses(_driven(problem, path, dictionary, scope)).reshape(len(white), -1)
        cross[problem.layout.record_columns(index)] += own.T @ rows
        along -= rows.T @ white
        full += np.sum(rows**2, axis=0)
        # Thousands of terms: single precision serves to tell which of them are alike.
        kept_rows.append(rows.astype(np.float32))
    # Known unknowns are projected out in an orthonormal basis of what the records see of them.
    size = np.sqrt(np.where(np.diag(matrix) > 0, np.diag(matrix), np.inf))
    values, vectors = np.linalg.eigh(matrix / size[:, None] / size)
    seen = values > 1e-11 * values.max()
    basis = vectors[:, seen] / np.sqrt(values[seen]) / size[:, None]
    step, shadow = basis.T @ right, basis.T @ cross
    left = np.sqrt(np.maximum(full - np.sum(shadow**2, axis=0), 0.0))
    usable = np.flatnonzero((left > ABSORBED * np.sqrt(full)) & (full > 0))
    root = np.zeros(n_terms)
    # Signed root of the score statistic: its square is chi-squared of one degree of freedom.
    root[usable] = (along - shadow.T @ step)[usable] / left[usable]
    order = usable[np.argsort(-(root[usable] ** 2))]
    first = order[:60]  # likeness of the strongest is looked at
    likeness = (
        sum((rows[:, first].T @ rows[:, first]).astype(float) for rows in kept_rows)
        - shadow[:, first].T @ shadow[:, first]
    )
    columns = (root**2, root / np.maximum(left, 1e-300), 1.0 / np.maximum(left, 1e-300))
    facts = np.array([*columns, left / np.sqrt(np.maximum(full, 1e-300))]).T
    return TermScores(
        tuple(TermScore(dictionary[i], *map(float, facts[i])) for i in order),
        likeness / left[first][:, None] / left[first],
        signals,
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
        # A term is a force on its equation: it acts as the disturbance there does, times its
        # value.
        force = path.drive[:, :, place[f"force {term.equation}"]]
        drive[:, :, index] = force * values[term.expression][:, None]
    return drive
