"""Score every term of a dictionary without refitting, and find those that are alike.

Each term is a force along the smoothed trajectory. The linear deviations carry
it to the outputs, the filter of the noise model whitens it, the unknowns that
the model has already are projected out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.diagnosis.dictionary import Signals, Term, terms
from oed_sysid.language import expressions
from oed_sysid.noise.kalman import whiten
from oed_sysid.noise.linearisation import Along, Stretch

# What is left of a term after projection, below which free parameters imitate it.
ABSORBED = 0.01
# Terms, of those with the largest statistics, whose likeness is looked at.
COMPARED = 60


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
    unknowns : ndarray (n_unknowns,)
        Change of parameters and initial states that goes with the term.
    """

    term: Term
    statistic: float
    estimate: float
    std_error: float
    distinct: float
    unknowns: np.ndarray


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


def term_scores(linear: Along, signals: Signals) -> TermScores:
    """Score every term of the dictionary; those that free parameters imitate are left out.

    Parameters
    ----------
    linear : Along
        The model along its smoothed trajectories.
    signals : Signals
        Along the same trajectories.
    """
    dictionary = terms(linear.system.model, signals.signals)
    grounds, n_terms = linear.grounds, len(dictionary)
    n_names = len(grounds.prior)
    n_unknowns = n_names + grounds.n_own * len(grounds.columns)
    matrix, right = np.zeros((n_unknowns, n_unknowns)), np.zeros(n_unknowns)
    matrix[np.arange(n_names), np.arange(n_names)] = grounds.prior[:, 0] ** 2
    right[:n_names] = grounds.prior[:, 0] * grounds.prior[:, 1]
    cross, along_residual = np.zeros((n_unknowns, n_terms)), np.zeros(n_terms)
    full, kept = np.zeros(n_terms), []
    for index, (stretch, scope, line, known) in enumerate(
        zip(linear.stretches, signals.values, linear.joint, grounds.columns, strict=True)
    ):
        responses = _respond(linear, stretch, dictionary, scope)
        whitened, _ = whiten(linear.noise, [line], [np.concatenate([known, responses], axis=2)])
        n_known = known.shape[2]
        own, residual = whitened[0][:, : n_known - 1], whitened[0][:, n_known - 1]
        rows = whitened[0][:, n_known:]
        where = grounds.unknowns(index)
        matrix[np.ix_(where, where)] += own.T @ own
        right[where] += own.T @ residual
        cross[where] += own.T @ rows
        along_residual += rows.T @ residual
        full += np.sum(rows**2, axis=0)
        kept.append(rows.astype(np.float32))
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
                basis @ (step - root[i] / left[i] * shadow[:, i]),
            )
            for i in order
        ),
        likeness / left[first][:, None] / left[first],
    )


def _respond(
    linear: Along, stretch: Stretch, dictionary: Sequence[Term], scope: dict[str, np.ndarray]
) -> np.ndarray:
    """Change of the outputs per unit of every coefficient, ``(n_times, n_outputs, n_terms)``."""
    n, size = stretch.states.shape
    texts = list(dict.fromkeys(term.expression for term in dictionary))
    values = {text: np.broadcast_to(expressions.to_numpy(text, scope), (n,)) for text in texts}
    forces = {linear.where[i].signal: stretch.gains[:, :, i] for i in linear.forces}
    drive = np.empty((n, size, len(dictionary)))
    for index, term in enumerate(dictionary):
        drive[:, :, index] = forces[term.equation] * values[term.expression][:, None]
    result = np.empty((n, stretch.output.shape[1], len(dictionary)))
    moved = np.zeros((size, len(dictionary)))
    for k in range(n):
        result[k] = stretch.output[k] @ moved
        moved = stretch.transition[k] @ moved + drive[k]
    return result
