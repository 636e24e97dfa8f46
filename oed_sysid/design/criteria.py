r"""Schur complements with their derivatives: unknowns that are estimated but not of interest.

Of a joint information in blocks, the first unknowns eliminated,

.. math:: S = F_{22} - F_{21} F_{11}^{-1} F_{12}, \qquad
    \mathrm{d}S = T\, \mathrm{d}F\, T', \quad T = \left[-F_{21} F_{11}^{-1},\ I\right]

so that a gradient :math:`\Gamma` by :math:`S` is :math:`T' \Gamma T` by :math:`F`. Blocks are
equilibrated, and a multiple of 1e-13 of the identity is added to :math:`F_{11}`: a direction that
nothing sees does not stop the elimination.

What a good experiment is: a number, larger is better, of the information matrix.

With information :math:`F` in units of the values, :math:`C = F^{-1}`, ``n`` parameters and rows
:math:`c_k` of a prediction's derivatives,

.. math::
    D:\ \log\det F, \quad A:\ -\log \frac{\mathrm{tr}\, C}{n}, \quad
    E:\ \log \lambda_{min}(F), \quad
    D_s:\ \log\det\left(F_{ss} - F_{sr} F_{rr}^{-1} F_{rs}\right)

.. math::
    V:\ -\log \frac1m \sum_k c_k' C c_k, \quad G:\ -\log \max_k c_k' C c_k, \quad
    \text{modified } E:\ \log \frac{\lambda_{min}(F)}{\lambda_{max}(F)}

Each comes with its derivative :math:`\partial\varphi / \partial F`: for D :math:`C`, for A
:math:`C^2 / \mathrm{tr}\, C`, for V with :math:`W = \tfrac1m \sum c c'` :math:`C W C /
\mathrm{tr}(C W)`.

All criteria see the information on the parameters in units of their values
(or scales), start states eliminated, so that a relative error counts the same
for every coefficient. A criterion of one's own is a frozen dataclass with
``name`` and ``bind``; :func:`oed_sysid.testing.check_criterion` checks what the search
relies on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from oed_sysid.errors import DesignError
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.information import plays, respond
from oed_sysid.information.noise import Noise
from oed_sysid.physics.model import Model

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


def soft_minimum(values: np.ndarray, width: float) -> tuple[float, np.ndarray]:
    """Soft minimum of some values, and its derivatives by them, which sum to one.

    Examples
    --------
    >>> value, weights = soft_minimum(np.array([1.0, 1.0, 9.0]), 0.1)
    >>> print(round(value, 2), weights.round(3))
    1.04 [0.5 0.5 0. ]
    """
    weights = np.exp(-(values - values.min()) / width)
    return float(values.min() - width * np.log(weights.mean())), weights / weights.sum()


# Value and derivative (symmetric) of a criterion at a scaled information matrix.
Measure = Callable[[np.ndarray], tuple[float, np.ndarray]]


@dataclass(frozen=True, eq=False)
class Setting:
    """What a criterion is bound to.

    Attributes
    ----------
    model : Model
        At the values in question.
    names : tuple of str
        Parameters that the information matrix is about, in order.
    scales : ndarray (n_names,)
        Their units in that matrix.
    noise : Noise
        Of the outputs.
    """

    model: Model
    names: tuple[str, ...]
    scales: np.ndarray
    noise: Noise


@runtime_checkable
class Criterion(Protocol):
    """Contract of criteria."""

    @property
    def name(self) -> str:
        """Name for reports."""
        ...

    def bind(self, setting: Setting) -> Measure:
        """Return the function to maximise."""
        ...


def _mean_variance(weight: np.ndarray | None = None) -> Measure:
    """Minus log of ``trace(C W)``, and its derivative; by default of the mean of the diagonal."""

    def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
        bound = inverse(matrix)
        target = np.eye(len(matrix)) / len(matrix) if weight is None else weight
        variance = float(np.sum(bound * target))
        return -np.log(variance), bound @ target @ bound / variance

    return measure


def _ends(matrix: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Logarithms of the smallest and the largest eigenvalue, and their derivatives."""
    values, vectors = np.linalg.eigh(matrix)
    sizes = np.maximum(values, NOTHING)
    return [
        (float(np.log(sizes[i])), np.outer(vectors[:, i], vectors[:, i]) / sizes[i])
        for i in (0, -1)
    ]


@dataclass(frozen=True)
class DOptimal:
    """Smallest volume of the confidence ellipsoid: log det of the information."""

    name: str = "D"

    def bind(self, setting: Setting) -> Measure:
        """Return ``log det F`` and its derivative ``F**-1``."""
        return lambda matrix: (log_determinant(matrix), inverse(matrix))


@dataclass(frozen=True)
class AOptimal:
    """Smallest mean squared relative error: minus log of the mean of the bound's diagonal."""

    name: str = "A"

    def bind(self, setting: Setting) -> Measure:
        """Return ``-log(trace(C)/n)`` and its derivative."""
        return _mean_variance()


@dataclass(frozen=True)
class EOptimal:
    """Shortest longest axis of the ellipsoid: log of the smallest eigenvalue."""

    name: str = "E"

    def bind(self, setting: Setting) -> Measure:
        """Return ``log(lambda_min)`` and its derivative."""
        return lambda matrix: _ends(matrix)[0]


@dataclass(frozen=True)
class ModifiedE:
    """Roundest ellipsoid: minus log of the condition number.

    Says nothing about size; combine the result with a look at the errors.
    """

    name: str = "modified E"

    def bind(self, setting: Setting) -> Measure:
        """Return ``-log(lambda_max / lambda_min)`` and its derivative."""

        def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
            (small, by_small), (large, by_large) = _ends(matrix)
            return small - large, by_small - by_large

        return measure


@dataclass(frozen=True)
class DsOptimal:
    """D-criterion of some parameters, the others estimated but not of interest.

    Parameters
    ----------
    interest : sequence of str
        Parameters of interest.
    """

    interest: Sequence[str]

    @property
    def name(self) -> str:
        """Name for reports."""
        return f"Ds ({', '.join(self.interest)})"

    def bind(self, setting: Setting) -> Measure:
        """Return ``log det`` of the Schur complement and its derivative."""
        for wanted in self.interest:
            if wanted not in setting.names:
                raise DesignError(
                    f"The parameter of interest {wanted!r} is not estimated. Estimated are "
                    f"{', '.join(setting.names)}."
                )
        last = [setting.names.index(name) for name in self.interest]
        order = np.array([i for i in range(len(setting.names)) if i not in last] + last)
        n_drop = len(order) - len(last)

        def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
            reduced, mapping = eliminate(matrix[np.ix_(order, order)], n_drop)
            gradient = np.empty_like(matrix)
            gradient[np.ix_(order, order)] = mapping.T @ inverse(reduced) @ mapping
            return log_determinant(reduced), gradient

        return measure


@dataclass(frozen=True)
class _Prediction:
    """Accuracy of predictions of given manoeuvres, start states known."""

    manoeuvres: Sequence[Experiment]

    def _rows(self, setting: Setting) -> np.ndarray:
        """Whitened derivatives of the predictions, ``(n_samples, n_names)``."""
        if not self.manoeuvres:
            raise DesignError("Name the manoeuvres to be predicted: manoeuvres=[Experiment(...)].")
        columns = [len(setting.model.states) + setting.model.free_names.index(n)
                   for n in setting.names]  # fmt: skip
        rows = [
            (respond(setting.model, play).jacobian[:, :, columns] / setting.noise.sigma[:, None])
            for play in plays(setting.model, self.manoeuvres)
        ]
        return np.vstack([r.reshape(-1, len(columns)) for r in rows]) * setting.scales


@dataclass(frozen=True)
class VOptimal(_Prediction):
    """Smallest mean variance of predictions of given manoeuvres.

    Parameters
    ----------
    manoeuvres : sequence of Experiment
        What is to be predicted well, such as a turning circle.
    """

    name: str = "V (mean prediction)"

    def bind(self, setting: Setting) -> Measure:
        """Return minus log of the mean variance in noise units, and its derivative."""
        rows = self._rows(setting)
        return _mean_variance(rows.T @ rows / len(rows))


@dataclass(frozen=True)
class GOptimal(_Prediction):
    """Smallest largest variance of predictions of given manoeuvres.

    Parameters
    ----------
    manoeuvres : sequence of Experiment
        What is to be predicted well.
    """

    name: str = "G (worst prediction)"

    def bind(self, setting: Setting) -> Measure:
        """Return minus log of the largest variance in noise units, and its derivative."""
        rows = self._rows(setting)

        def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
            bound = inverse(matrix)
            variances = np.einsum("ij,ij->i", rows @ bound, rows)
            worst = int(np.argmax(variances))
            row = bound @ rows[worst]
            return -np.log(variances[worst]), np.outer(row, row) / variances[worst]

        return measure
