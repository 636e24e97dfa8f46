r"""Schur complements with their derivatives: unknowns that are estimated but not of interest.

Of a joint information in blocks, the first unknowns eliminated,

.. math:: S = F_{22} - F_{21} F_{11}^{-1} F_{12}, \qquad
    \mathrm{d}S = T\, \mathrm{d}F\, T', \quad T = \left[-F_{21} F_{11}^{-1},\ I\right]

so that a gradient :math:`\Gamma` by :math:`S` is :math:`T' \Gamma T` by :math:`F`. Blocks are
equilibrated, and a multiple of 1e-13 of the identity is added to :math:`F_{11}`: a direction that
nothing sees does not stop the elimination.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

# Information that counts as none, in units of (relative error)**-2: a prior of 1e5 times the value.
NOTHING = 1e-10
# Smallest pivot of an equilibrated information at which its inverse has ten digits.
REGULAR = 1e-3


def eliminate(matrix: np.ndarray, n_drop: int) -> tuple[np.ndarray, np.ndarray]:
    """Information on the last unknowns when the first ``n_drop`` are unknown too.

    Parameters
    ----------
    matrix : ndarray (n, n)
        Positive semidefinite.
    n_drop : int
        How many to eliminate.

    Returns
    -------
    reduced : ndarray (n - n_drop, n - n_drop)
    map : ndarray (n - n_drop, n)
        ``d reduced = map d(matrix) map'``.

    Examples
    --------
    >>> reduced, _ = eliminate(np.array([[2.0, 1.0], [1.0, 3.0]]), 1)
    >>> print(reduced)
    [[2.5]]
    """
    n = len(matrix)
    if n_drop == 0:
        return matrix, np.eye(n)
    first, last = slice(0, n_drop), slice(n_drop, None)
    block = matrix[first, first]
    diagonal = np.diag(block)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    # A direction that nothing sees is not worth estimating; it must not stop the elimination.
    regular = block * scale[:, None] * scale + 1e-13 * np.eye(n_drop)
    solved = scale[:, None] * cho_solve(cho_factor(regular), scale[:, None] * matrix[first, last])
    mapping = np.hstack([-solved.T, np.eye(n - n_drop)])
    reduced = matrix[last, last] - matrix[last, first] @ solved
    return 0.5 * (reduced + reduced.T), mapping


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of information matrices ``(..., n, n)`` in relative units, never infinite."""
    regular = matrix + NOTHING * np.eye(matrix.shape[-1])
    diagonal = np.sqrt(np.maximum(np.diagonal(regular, axis1=-2, axis2=-1), NOTHING))
    outer = diagonal[..., :, None] * diagonal[..., None, :]
    values, vectors = np.linalg.eigh(regular / outer)
    inner = (vectors / np.maximum(values, 1e-15)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return inner / outer


def quick_inverse(matrix: np.ndarray) -> np.ndarray:
    """As :func:`inverse`, several times faster where nothing is near singular."""
    sizes = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    if sizes.min() > 0:
        outer = sizes[..., :, None] * sizes[..., None, :]
        try:
            roots = np.linalg.cholesky(matrix / outer)
        except np.linalg.LinAlgError:
            return inverse(matrix)
        if np.diagonal(roots, axis1=-2, axis2=-1).min() > REGULAR:
            return np.asarray(np.linalg.inv(matrix / outer) / outer)
    return inverse(matrix)


def log_determinant(matrix: np.ndarray) -> float:
    """Logarithm of the determinant of an information matrix in relative units."""
    regular = matrix + NOTHING * np.eye(len(matrix))
    diagonal = np.sqrt(np.maximum(np.diag(regular), NOTHING))
    values = np.linalg.eigvalsh(regular / diagonal[:, None] / diagonal)
    return float(np.sum(np.log(np.maximum(values, 1e-15))) + 2 * np.sum(np.log(diagonal)))
