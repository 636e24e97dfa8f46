"""How uncertain estimates are, from the Jacobian and the residuals at the optimum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed_sysid.data.sampling import sampled_alike
from oed_sysid.fitting.between_records import FEWEST_RECORDS, RecordScatter, record_scatter
from oed_sysid.fitting.fit import COLOUR_LIMIT
from oed_sysid.fitting.shooting import Linearisation, Loss, Shooting
from oed_sysid.information import (
    Information,
    coloured_score_covariance,
    effective_sample_size,
)

# A combination of initial states seen less than this share of the best is not projected out.
BLIND = 1e-10
# Residuals below this share of the noise say nothing about it.
SILENT = 0.01
# With so few independent samples that more is lost, no correction helps.
MOST_LOST = 2.0


class ReducedProblem:
    """Jacobian of the shared parameters, with everything else projected out.

    Initial states and per-record parameters are unknown too; what the data
    say about the shared parameters is what these cannot explain away.

    Parameters
    ----------
    shooting : Shooting
        The problem.
    lin : Linearisation
        At the optimum.
    unknowns : ndarray (n_unknowns,)
        The optimum.

    Attributes
    ----------
    rows : list of ndarray (n_times, n_outputs, n_shared)
        Whitened and reduced Jacobian, per record; zero where nothing was measured.
    scores : list of ndarray (n_times, n_outputs)
        Whitened residuals, as the loss lets them count; NaN where missing.
    prior_rows : list of ndarray (n_rows, n_shared)
        What priors add.
    gain : ndarray (n_outputs,)
        Slope of the scores: 1 for least squares, less for robust losses.
    """

    def __init__(self, shooting: Shooting, lin: Linearisation, unknowns: np.ndarray) -> None:
        self.shooting = shooting
        layout = shooting.layout
        n_shared = len(layout.shared)
        residuals = [residual / shooting.sigma for residual in lin.residuals]
        self.scores, self.gain = _scores(residuals, shooting.loss)
        keep = layout.n_own + layout.shared
        others = np.concatenate([np.arange(layout.n_own), layout.n_own + layout.local])
        # Derivatives by values, of parameters whose logarithm is unknown too.
        self._slopes = layout.shared_values(unknowns)[1]
        self.rows, self.prior_rows = [], []
        for index, residual in enumerate(residuals):
            present = np.isfinite(residual)
            weight = present * np.sqrt(self.gain) / shooting.sigma
            jacobian = lin.jacobians[index] * weight[:, :, None]
            flat = jacobian.reshape(-1, jacobian.shape[2])
            columns = layout.record_columns(index)
            # What is held explains nothing away.
            drop = others[~shooting.limits.held[columns[others]]]
            prior = np.sqrt(shooting.limits.prior_weight[columns[drop]])
            inner = np.vstack([flat[:, drop], np.diag(prior)])
            outer = np.vstack([flat[:, keep] / self._slopes, np.zeros((len(drop), n_shared))])
            reduced = _project_out(inner, outer)
            self.rows.append(reduced[: len(flat)].reshape(*residual.shape, n_shared))
            self.prior_rows.append(reduced[len(flat) :])
        own = np.sqrt(shooting.limits.prior_weight[:n_shared])
        self.prior_rows.append(np.diag(own / self._slopes))

    @property
    def information(self) -> Information:
        """Information of the shared parameters, as if residuals were white."""
        n_shared = len(self.shooting.layout.shared)
        scales = self.shooting.limits.scale[:n_shared] * self._slopes
        stacked = [rows.reshape(rows.shape[0] * rows.shape[1], n_shared) for rows in self.rows]
        jacobian = np.vstack([*stacked, *self.prior_rows])
        return Information.from_jacobian(self.shooting.layout.shared_names, jacobian, scales)

    @property
    def between_records(self) -> RecordScatter | None:
        """Scatter of the shared parameters between records; None for fewer than four."""
        if len(self.rows) < FEWEST_RECORDS or not len(self.shooting.layout.shared):
            return None
        matrices, scores = [], []
        for rows, residual in zip(self.rows, self.scores, strict=True):
            flat = rows.reshape(-1, rows.shape[2])
            matrices.append(flat.T @ flat)
            # Residuals count once with the slope of a robust loss, not twice.
            own = (rows / np.sqrt(self.gain)[:, None]).reshape(-1, rows.shape[2])
            scores.append(own.T @ np.nan_to_num(residual).ravel())
        prior = sum((rows.T @ rows for rows in self.prior_rows), np.zeros_like(matrices[0]))
        return record_scatter(matrices, scores, prior)

    @property
    def is_coloured(self) -> bool:
        """Whether residuals count clearly fewer independent samples than they have."""
        # Residuals far below the noise are rounding errors of a simulation, not noise.
        loud = any(np.nanmax(np.abs(s), initial=0.0) > SILENT for s in self.scores)
        return loud and is_coloured(self.scores)

    @property
    def _lost_freedom(self) -> float:
        """How much the fit has shrunk the residuals' variance, by independent samples."""
        count = sum(effective_sample_size(c) for s in self.scores for c in s.T if _counts(c))
        return min(count / max(count - self.shooting.layout.n_unknowns, 1.0), MOST_LOST)

    def sandwich(self, white: np.ndarray, *, coloured: bool) -> np.ndarray:
        """Covariance ``H^-1 B H^-1`` of the shared parameters.

        Parameters
        ----------
        white : ndarray (n_shared, n_shared)
            ``H^-1``, infinite on the diagonal where nothing is seen.
        coloured : bool
            Take ``B`` from the residuals' own colour; otherwise from their
            variance alone, which differs from ``H`` for robust losses.

        Returns
        -------
        ndarray (n_shared, n_shared)
        """
        jacobians = [rows / np.sqrt(self.gain)[:, None] for rows in self.rows]
        if white.size == 0:  # every parameter is known; initial states alone were estimated
            return white
        middle = np.zeros_like(white)
        if coloured:
            for group in sampled_alike(self.shooting.records):
                middle += coloured_score_covariance(
                    [jacobians[i] for i in group], [self.scores[i] for i in group]
                )
        else:
            variance = np.nanmean(np.vstack(self.scores) ** 2, axis=0)
            for jacobian in jacobians:
                flat = (jacobian * np.sqrt(variance)[:, None]).reshape(-1, len(white))
                middle += flat.T @ flat
        middle *= self._lost_freedom
        middle += sum(rows.T @ rows for rows in self.prior_rows)
        finite = np.flatnonzero(np.isfinite(np.diag(white)))
        block = np.ix_(finite, finite)
        result = white.copy()
        result[block] = white[block] @ middle[block] @ white[block]
        return result


def _counts(column: np.ndarray) -> bool:
    """Whether a series is long enough for its correlation to be estimated."""
    return int(np.isfinite(column).sum()) > 20


def is_coloured(residuals: Sequence[np.ndarray], limit: float = COLOUR_LIMIT) -> bool:
    """Whether residuals count fewer independent samples than a share of their number."""
    effective = total = 0.0
    for residual in residuals:
        for column in residual.T:
            if _counts(column):
                effective += effective_sample_size(column)
                total += int(np.isfinite(column).sum())
    return total > 0 and effective < limit * total


def _scores(
    residuals: Sequence[np.ndarray], loss: Loss | None
) -> tuple[list[np.ndarray], np.ndarray]:
    """Residuals as the loss lets them count, and the mean slope of that by output."""
    if loss is None:
        return list(residuals), np.ones(residuals[0].shape[1])

    def score(residual: np.ndarray) -> np.ndarray:
        return residual * loss(residual)[1]

    stacked, h = np.vstack(residuals), 1e-4
    slopes = (score(stacked + h) - score(stacked - h)) / (2 * h)
    seen = np.isfinite(stacked)
    count = np.maximum(seen.sum(axis=0), 1)
    gain = np.where(seen, slopes, 0.0).sum(axis=0) / count
    return [score(residual) for residual in residuals], np.maximum(gain, 0.05)


def _project_out(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """Part of the columns of ``outer`` that those of ``inner`` cannot explain."""
    norms = np.linalg.norm(inner, axis=0)
    inner = inner[:, norms > 0] / norms[norms > 0]
    if not inner.shape[1]:
        return outer
    # By way of a factorization: singular vectors of a tall matrix take several times as long.
    basis, triangle = np.linalg.qr(inner)
    rotation, values, _ = np.linalg.svd(triangle)
    basis = basis @ rotation[:, values > BLIND * values[0]]
    return outer - basis @ (basis.T @ outer)
