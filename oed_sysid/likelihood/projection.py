r"""Quadratic problems within bounds, unseen directions left alone.

.. math:: \min_x \tfrac12 x' A x - b' x, \qquad \ell \le x \le u

with ``A`` positive semidefinite. Directions without information get the smallest step.

Unknowns that are estimated along are eliminated by the Schur complement

.. math:: A_{kk} - A_{ko} A_{oo}^+ A_{ok} , \qquad b_k - A_{ko} A_{oo}^+ b_o ,

information and score of what is kept (Rao 1948): the score test of every absence.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from oed_sysid.runtime.constants import RANK_TOLERANCE, THREE_DIGITS

# What is left of a signature after projection, as a share of it, or of a statistic after its
# linearised cause, below which what is estimated does the same.
ABSORBED = THREE_DIGITS
# Below this share of the largest eigenvalue, a direction of an information is none.
NOTHING = RANK_TOLERANCE**2


def bounded_step(
    matrix: np.ndarray, right: np.ndarray, lower: np.ndarray, upper: np.ndarray, damping: float
) -> np.ndarray:
    """Minimise ``x' matrix x / 2 - right' x`` within bounds.

    Unknowns that the data do not see (a zero on the diagonal), or whose bounds
    coincide, stay where they are; along directions that are seen in no
    combination the step is the smallest one, in equilibrated unknowns.

    Parameters
    ----------
    matrix : ndarray (n, n)
        Positive semidefinite.
    right, lower, upper : ndarray (n,)
        Right-hand side and bounds of the step.
    damping : float
        Levenberg-Marquardt damping, in units of the diagonal.

    Returns
    -------
    ndarray (n,)
    """
    diagonal = np.diag(matrix)
    open_ = np.flatnonzero((diagonal > 0) & (upper > lower))
    step = np.zeros_like(right)
    if not len(open_):
        return np.clip(step, lower, upper)
    scale = 1.0 / np.sqrt(diagonal[open_])
    scaled = matrix[np.ix_(open_, open_)] * scale[:, None] * scale
    scaled[np.diag_indices_from(scaled)] += damping
    target = scale * right[open_]
    # LAPACK itself: SciPy's checks of its arguments take longer than a small factorization.
    triangle, failed = dpotrf(scaled)
    # Rounding errors, not the data, decide along directions with a smaller pivot.
    if not failed and np.min(np.diag(triangle)) ** 2 >= NOTHING:
        step[open_] = scale * dpotrs(triangle, target)[0]
    else:
        onto, _ = coordinates(scaled)
        step[open_] = scale * (onto @ (onto.T @ target))
        triangle = onto.T @ scaled
    if np.all(step >= lower) and np.all(step <= upper):
        return step
    from scipy.optimize import lsq_linear  # a fifth of a second, which few fits need

    # With A = T' T: minimise |T x - T'^-1 b| within the bounds, by active sets.
    projected = np.linalg.lstsq(triangle.T, target, rcond=None)[0]
    bounds = lower[open_] / scale, upper[open_] / scale
    result = lsq_linear(triangle, projected, bounds, method="bvls")
    step[open_] = scale * result.x
    return np.clip(step, lower, upper)


def gain_within(
    matrix: np.ndarray, right: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, float]:
    """The best step within bounds, and twice what it gains, ``2 right' x - x' matrix x``."""
    step = bounded_step(matrix, right, lower, upper, 0.0)
    return step, float(2.0 * right @ step - step @ matrix @ step)


def coordinates(
    information: np.ndarray, scale: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates in which an information is the identity, where it tells anything.

    Parameters
    ----------
    information : ndarray (n, n)
    scale : ndarray (n,), optional
        Units of its directions; by default the roots of its diagonal.

    Returns
    -------
    onto : ndarray (n, n_told)
        Its product with its transpose is the pseudo-inverse.
    blind : ndarray of bool (n,)
        Which unknowns have a part in directions of which nothing is told.
    """
    scale = np.sqrt(np.maximum(np.diag(information), 0.0)) if scale is None else scale
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(information / scale[:, None] / scale)
    clear = values > NOTHING * max(float(values.max(initial=0.0)), 0.0)
    blind = (vectors[:, ~clear] ** 2).sum(axis=1) > RANK_TOLERANCE
    return vectors[:, clear] / scale[:, None] / np.sqrt(values[clear]), blind


def inverse_of(matrix: np.ndarray) -> np.ndarray:
    """Inverse of an information in the directions that it sees, in units of its diagonal."""
    onto, _ = coordinates(matrix)
    return np.asarray(onto @ onto.T)


def share_of(matrix: np.ndarray, kept: np.ndarray, others: np.ndarray) -> np.ndarray:
    """:math:`A_{ko} A_{oo}^+`, shape ``(n_kept, n_others)``: what others explain of the kept.

    Zero in columns of unknowns that nothing tells.
    """
    return np.asarray(matrix[np.ix_(kept, others)] @ inverse_of(matrix[np.ix_(others, others)]))


def eliminate(matrix: np.ndarray, kept: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Information of some unknowns once all others are estimated too."""
    return score_beside(matrix, np.zeros(len(matrix)), kept, others)[0]


def score_beside(
    matrix: np.ndarray, right: np.ndarray, kept: np.ndarray, others: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Information ``(n_kept, n_kept)`` and score ``(n_kept,)`` of some, others estimated too."""
    share = share_of(matrix, kept, others)
    information = matrix[np.ix_(kept, kept)] - share @ matrix[np.ix_(others, kept)]
    return np.asarray(information), np.asarray(right[kept] - share @ right[others])


def root_of(covariance: np.ndarray) -> np.ndarray:
    """A matrix whose product with its transpose is a covariance, ``(n, n)``."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def project_out(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """Part of the columns of ``outer`` that those of ``inner`` cannot explain."""
    norms = np.linalg.norm(inner, axis=0)
    inner = inner[:, norms > 0] / norms[norms > 0]
    if not inner.shape[1]:
        return outer
    # By way of a factorization: singular vectors of a tall matrix take several times as long.
    basis, triangle = np.linalg.qr(inner)
    rotation, values, _ = np.linalg.svd(triangle)
    basis = basis @ rotation[:, values > RANK_TOLERANCE * values[0]]
    return outer - basis @ (basis.T @ outer)
