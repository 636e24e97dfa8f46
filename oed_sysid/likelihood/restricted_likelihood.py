"""Likelihood of a noise model, parameters and initial states projected out.

Restricted maximum likelihood (Patterson & Thompson 1971): noise levels are
judged by what is left of the residuals once everything that the unknowns could
explain has been removed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.likelihood.kalman import Deviations, innovations
from oed_sysid.likelihood.noise_model import NoiseModel


@dataclass(frozen=True, eq=False)
class Grounds:
    """Columns that every place is judged by: sensitivities and residuals, per record.

    Attributes
    ----------
    columns : tuple of ndarray (n_times, n_outputs, n_names + n_own + 1)
        Derivatives by parameters and initial states, then the residual.
    prior : ndarray (n_names, 2)
        Inverse standard deviation of each parameter's prior, and the distance
        of its value from the prior mean in these; zero without a prior.
    white : ndarray (n_outputs,)
        White sensor noise.
    scale_known : bool
        Whether noise levels are what they say; otherwise a common factor on all of
        them is estimated, so that only their ratios and the shape of the noise count.
    """

    columns: tuple[np.ndarray, ...]
    prior: np.ndarray
    white: np.ndarray
    scale_known: bool = True

    @property
    def n_own(self) -> int:
        """Initial states per record."""
        return self.columns[0].shape[2] - 1 - len(self.prior)

    def unknowns(self, index: int) -> np.ndarray:
        """Positions, among all unknowns, of those that matter for one record."""
        n_names, n_own = len(self.prior), self.n_own
        first = n_names + index * n_own
        return np.r_[:n_names, first : first + n_own]


@dataclass(frozen=True, eq=False)
class Restricted:
    """Restricted likelihood under one noise model.

    Attributes
    ----------
    objective : float
        Minus twice the log-likelihood, up to a constant.
    correction : ndarray (n_unknowns,)
        What parameters, then initial states of each record, should change by.
    covariance : ndarray (n_unknowns, n_unknowns)
        Of that correction.
    scale : float
        Most likely factor on all noise levels; 1 where they are known.
    """

    objective: float
    correction: np.ndarray
    covariance: np.ndarray
    scale: float = 1.0


def restricted(
    grounds: Grounds, models: Sequence[NoiseModel], records: Sequence[Sequence[Deviations]]
) -> list[Restricted]:
    """Restricted likelihood under several noise models, each with its own deviations.

    Parameters
    ----------
    grounds : Grounds
    models : sequence of NoiseModel
    records : sequence of sequence of Deviations
        For every noise model, the deviations of all records.
    """
    jobs = [
        (noise, line, column)
        for noise, lines in zip(models, records, strict=True)
        for line, column in zip(lines, grounds.columns, strict=True)
    ]
    found = innovations(jobs)
    n = len(grounds.columns)
    result = []
    for index in range(len(models)):
        parts = found[index * n : (index + 1) * n]
        grams = [_gram(part.white) for part in parts]
        log_determinant = sum(part.log_determinant for part in parts)
        n_samples = int(sum(line.present.sum() for line in records[index]))
        result.append(_restricted(grounds, grams, log_determinant, n_samples))
    return result


def _gram(white: np.ndarray) -> np.ndarray:
    rows = white.reshape(-1, white.shape[2])
    # What overflows is not likely: its objective becomes infinite.
    with np.errstate(over="ignore", invalid="ignore"):
        return rows.T @ rows


def _restricted(
    grounds: Grounds, grams: Sequence[np.ndarray], log_determinant: float, n_samples: int
) -> Restricted:
    n_names = len(grounds.prior)
    n_unknowns = n_names + grounds.n_own * len(grams)
    matrix, right = np.zeros((n_unknowns, n_unknowns)), np.zeros(n_unknowns)
    matrix[np.arange(n_names), np.arange(n_names)] = grounds.prior[:, 0] ** 2
    right[:n_names] = grounds.prior[:, 0] * grounds.prior[:, 1]
    square = float(np.sum(grounds.prior[:, 1] ** 2))
    for index, gram in enumerate(grams):
        where = grounds.unknowns(index)
        matrix[np.ix_(where, where)] += gram[:-1, :-1]
        right[where] += gram[:-1, -1]
        square += float(gram[-1, -1])
    if not (np.isfinite(matrix).all() and np.isfinite(right).all() and np.isfinite(square)):
        # Without a disturbance that holds it, an unstable linear model leaves the numbers.
        nothing = np.zeros(n_unknowns)
        return Restricted(np.inf, nothing, np.diag(nothing))
    size = np.sqrt(np.diag(matrix))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(matrix / size[:, None] / size)
    seen = values > 1e-11 * values.max()
    basis = vectors[:, seen] / np.sqrt(values[seen]) / size[:, None]
    projected = basis.T @ right
    # Unseen directions drop out of every model alike.
    determinant = 2.0 * float(np.log(size).sum()) + float(np.log(values[seen]).sum())
    left = square - float(projected @ projected)
    scale, misfit = 1.0, left
    if not grounds.scale_known:
        # With all variances multiplied by s, the objective is n log s + left / s, least at
        # s = left / n for n samples less the unknowns that were seen.
        freedom = max(n_samples - int(seen.sum()), 1)
        scale = float(np.sqrt(max(left, np.finfo(float).tiny) / freedom))
        misfit = freedom * (1.0 + 2.0 * np.log(scale))
    objective = log_determinant + misfit + determinant
    return Restricted(
        objective if np.isfinite(objective) else np.inf,
        basis @ projected,
        scale**2 * (basis @ basis.T),
        scale,
    )
