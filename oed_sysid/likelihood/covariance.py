r"""How uncertain estimates are, from the Jacobian and the residuals at the optimum.

Residuals of a time series may be coloured, see
:func:`~oed_sysid.likelihood.information.coloured_score_covariance`. Those of independent tests,
such as
captive ones, cannot: with :math:`J_j` and :math:`e_j` the Jacobian and the residuals of test
:math:`j` in units of the noise, :math:`C` the covariance if the noise is as declared and
:math:`H_j = J_j C J_j'`, the middle of their sandwich is

.. math::
    B = \sum_j J_j' \left(e_j e_j' + S H_j S\right) J_j, \qquad
    S_{ii}^2 = \max\left(1, \frac{\sum_j e_{ji}^2}{\sum_j (1 - H_{jii})}\right),

in whatever order they stand (White 1980, Econometrica 48; :math:`H_j` is what the fit has taken out
of the residuals, so that :math:`B` is unbiased where the noise is as declared, :math:`S = 1`). It
is used where the squares of an output are larger than chance makes them, and is
:math:`\sum_j J_j' J_j` otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import gammaincc

from oed_sysid.data.record import sampled_alike
from oed_sysid.likelihood.agreement import Sources, sources_of
from oed_sysid.likelihood.fit import COLOUR_LIMIT
from oed_sysid.likelihood.information import (
    Information,
    coloured_score_covariance,
    effective_sample_size,
)
from oed_sysid.likelihood.shooting import Linearisation, Loss, Shooting

# A combination of initial states seen less than this share of the best is not projected out.
BLIND = 1e-10
# Residuals below this share of the noise say nothing about it.
SILENT = 0.01
# With so few independent samples that more is lost, no correction helps.
MOST_LOST = 2.0
# Chance of a sum of squares of independent tests below which their own residuals tell the errors.
STRAY_CHANCE = 1e-3


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
    def sources(self) -> Sources | None:
        """What priors and each record say of the shared parameters; None without any."""
        if not len(self.shooting.layout.shared):
            return None
        matrices, scores = [], []
        prior = np.zeros((self.rows[0].shape[2],) * 2)
        for record, rows, residual in zip(
            self.shooting.records, self.rows, self.scores, strict=True
        ):
            flat = rows.reshape(-1, rows.shape[2])
            if record.independent:  # known before the series, as it were
                prior += flat.T @ flat
                continue
            matrices.append(flat.T @ flat)
            # Residuals count once with the slope of a robust loss, not twice.
            own = (rows / np.sqrt(self.gain)[:, None]).reshape(-1, rows.shape[2])
            scores.append(own.T @ np.nan_to_num(residual).ravel())
        prior += sum((rows.T @ rows for rows in self.prior_rows), np.zeros_like(prior))
        return sources_of(matrices, scores, prior)

    @property
    def is_coloured(self) -> bool:
        """Whether residuals count clearly fewer independent samples than they have."""
        # Residuals far below the noise are rounding errors of a simulation, not noise.
        loud = any(np.nanmax(np.abs(s), initial=0.0) > SILENT for s in self._series)
        return loud and is_coloured(self._series)

    @property
    def _series(self) -> list[np.ndarray]:
        """Scores of the records that are series in time."""
        records = self.shooting.records
        return [s for r, s in zip(records, self.scores, strict=True) if not r.independent]

    @property
    def _tests(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and scores of all independent tests."""
        chosen = [i for i, record in enumerate(self.shooting.records) if record.independent]
        if not chosen:
            return self.rows[0][:0], self.scores[0][:0]
        return (
            np.concatenate([self.rows[i] for i in chosen]),
            np.concatenate([self.scores[i] for i in chosen]),
        )

    def tests_stray(self, white: np.ndarray) -> bool:
        """Whether independent tests scatter more than their noise allows."""
        return tests_stray(*self._tests, white)

    @property
    def _lost_freedom(self) -> float:
        """How much the fit has shrunk the residuals' variance, by independent samples."""
        count = sum(effective_sample_size(c) for s in self._series for c in s.T if _counts(c))
        return min(count / max(count - self.shooting.n_unknowns, 1.0), MOST_LOST)

    def sandwich(self, white: np.ndarray, *, coloured: bool, scattered: bool = False) -> np.ndarray:
        """Covariance ``H^-1 B H^-1`` of the shared parameters.

        Parameters
        ----------
        white : ndarray (n_shared, n_shared)
            ``H^-1``, infinite on the diagonal where nothing is seen.
        coloured : bool
            Take ``B`` from the residuals' own colour; otherwise from their
            variance alone, which differs from ``H`` for robust losses.
        scattered : bool
            Take the part of independent tests from their own residuals.

        Returns
        -------
        ndarray (n_shared, n_shared)
        """
        jacobians = [rows / np.sqrt(self.gain)[:, None] for rows in self.rows]
        if white.size == 0:  # every parameter is known; initial states alone were estimated
            return white
        middle = np.zeros_like(white)
        records = self.shooting.records
        series = [i for i, record in enumerate(records) if not record.independent]
        robust = self.shooting.loss is not None
        if coloured:
            for group in sampled_alike([records[i] for i in series]):
                middle += coloured_score_covariance(
                    [jacobians[series[i]] for i in group], [self.scores[series[i]] for i in group]
                )
        else:
            variance = np.ones(self.scores[0].shape[1])
            if robust:
                variance = np.nanmean(np.vstack(self.scores) ** 2, axis=0)
            for index in range(len(records)) if robust else series:
                flat = (jacobians[index] * np.sqrt(variance)[:, None]).reshape(-1, len(white))
                middle += flat.T @ flat
        if coloured or robust:
            middle *= self._lost_freedom
        if coloured or not robust:
            rows, scores = self._tests
            middle += tests_middle(rows, scores, white, scattered=scattered)
        middle += sum(rows.T @ rows for rows in self.prior_rows)
        finite = np.flatnonzero(np.isfinite(np.diag(white)))
        block = np.ix_(finite, finite)
        result = white.copy()
        result[block] = white[block] @ middle[block] @ white[block]
        return result


def tests_stray(rows: np.ndarray, scores: np.ndarray, white: np.ndarray) -> bool:
    """Whether residuals of independent tests are larger than chance makes them.

    Parameters
    ----------
    rows : ndarray (n_tests, n_outputs, n_shared)
        Jacobian in units of the noise, zero where nothing was measured.
    scores : ndarray (n_tests, n_outputs)
        Residuals in units of the noise, NaN where nothing was measured.
    white : ndarray (n_shared, n_shared)
        Covariance if the noise is as declared.
    """
    freedom, squares, _ = _leverage(rows, scores, white)
    told = freedom > 0.5
    chances = gammaincc(0.5 * freedom[told], 0.5 * squares[told])
    return bool((chances * np.sum(told) < STRAY_CHANCE).any())


def tests_middle(
    rows: np.ndarray, scores: np.ndarray, white: np.ndarray, *, scattered: bool
) -> np.ndarray:
    """Covariance of the summed scores of independent tests, from noise or from residuals.

    Parameters
    ----------
    rows, scores, white
        See :func:`tests_stray`.
    scattered : bool
        Whether from residuals; otherwise from the noise as declared.

    Returns
    -------
    ndarray (n_shared, n_shared)
    """
    if not scattered:
        flat = rows.reshape(-1, rows.shape[2])
        return np.asarray(flat.T @ flat)
    freedom, squares, taken = _leverage(rows, scores, white)
    each = np.einsum("tip,ti->tp", rows, np.nan_to_num(scores))
    lost = np.sqrt(np.maximum(1.0, squares / np.maximum(freedom, 1.0)))
    rows = rows * lost[:, None]
    return np.asarray(each.T @ each + np.einsum("tip,tij,tjq->pq", rows, taken, rows))


def _leverage(
    rows: np.ndarray, scores: np.ndarray, white: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Degrees of freedom and sums of squares of independent tests by output, their ``J C J'``."""
    finite = np.isfinite(np.diag(white))
    known = np.where(np.outer(finite, finite), white, 0.0)
    taken = rows @ known @ rows.transpose(0, 2, 1)
    freedom = np.isfinite(scores).sum(axis=0) - np.einsum("tii->i", taken)
    return freedom, np.nansum(scores**2, axis=0), taken


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
