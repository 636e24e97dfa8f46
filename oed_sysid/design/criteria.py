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
    V:\ -\log \frac1m \sum_k c_k' C c_k, \quad G:\ -\log \max_k c_k' C c_k

Each comes with its derivative :math:`\partial\varphi / \partial F`: for D :math:`C`, for A
:math:`C^2 / \mathrm{tr}\, C`, for V with :math:`W = \tfrac1m \sum c c'` :math:`C W C /
\mathrm{tr}(C W)`.

All criteria see the information on the parameters in units of their values
(or scales), start states eliminated, so that a relative error counts the same
for every coefficient. A criterion of one's own is a frozen dataclass with
``name`` and ``bind``; :func:`oed_sysid.testing.check_criterion` checks what the search
relies on.

Experiments that make rival explanations fail: T-optimality, linearised.

Experiments that would show what is missing, if it is: the power of a search, before the trial.

A search for missing physics tests every effect of a vocabulary
(:mod:`oed_sysid.evidence.score`). Its statistic is a noncentral chi-squared variable; with the
Gram matrix :math:`G` of what the parameters cannot imitate
(:mod:`oed_sysid.information.shifts`), records in hand included, effect ``i`` of amplitudes
:math:`a_i`, its plausible size, shows with probability

.. math::
    \lambda_i = a_i' G_{ii}\, a_i, \qquad
    p_i = P\left[\chi^2_{\nu_i}(\lambda_i) > \chi^2_{\nu_i, 1 - \alpha/n}\right]

``n`` candidates, :math:`\alpha` false claims over all of them and :math:`\nu_i` amplitudes and
shapes. The criterion is the mean of :math:`\log p_i`, or the smallest: what shows already adds
nothing more, so that a run is designed for what the records could not show. The Schur complement
is concave in the information, and :math:`\log p` is concave and rising in :math:`\lambda` (Finner
& Roters 1997, *Log-concavity and inequalities for chi-square, F and beta distributions*, Statistica
Sinica 7), so that the bound of :mod:`oed_sysid.design.allocation` covers programmes too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from scipy.special import chdtri, chndtr, chndtrinc, ndtr

from oed_sysid.errors import DesignError, listed, located
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.information import commanded_runs, respond
from oed_sysid.information.shifts import GROUP_WIDTH, Group, Shifts
from oed_sysid.likelihood.projection import ABSORBED, share_of
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import IMMATERIAL, RANK_TOLERANCE
from oed_sysid.runtime.display import Section, Table, as_dict
from oed_sysid.runtime.tables import tables

# Sentences of designs.
SAYS: dict[str, Any] = tables(__file__, "sentences")
# Information that counts as none, in units of (relative error)**-2.
NOTHING = RANK_TOLERANCE**2


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
    first, last = np.split(np.arange(len(matrix)), [n_drop])
    # Derivative of the Schur complement: map dM map', the share being stationary.
    mapping = np.hstack([-share_of(matrix, last, first), np.eye(len(last))])
    reduced = mapping @ matrix[:, last]
    return 0.5 * (reduced + reduced.T), mapping


def inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of information matrices ``(..., n, n)`` in relative units, never infinite."""
    regular = matrix + NOTHING * np.eye(matrix.shape[-1])
    diagonal = np.sqrt(np.maximum(np.diagonal(regular, axis1=-2, axis2=-1), NOTHING))
    outer = diagonal[..., :, None] * diagonal[..., None, :]
    # Scaled to a unit diagonal, so that eigenvalues say how alike, not in which unit.
    values, vectors = np.linalg.eigh(regular / outer)
    inner = (vectors / np.maximum(values, 1e-15)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return inner / outer


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
    # Less the smallest, so that no exponent overflows.
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
    sigma : ndarray (n_outputs,)
        Standard deviations of the noise of the outputs.
    shifts : Shifts or None
        Absent effects that a criterion asks for: the last columns of that matrix.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading").model
    >>> Setting(ship, tuple(ship.free_names), np.ones(2), np.ones(1)).names
    ('T', 'K')
    """

    model: Model
    names: tuple[str, ...]
    scales: np.ndarray
    sigma: np.ndarray
    shifts: Shifts | None = None


@runtime_checkable
class Criterion(Protocol):
    """Contract of criteria.

    Examples
    --------
    >>> DOptimal().name
    'D'
    """

    @property
    def name(self) -> str:
        """Name for reports."""

    def bind(self, setting: Setting) -> Measure:
        """Return the function to maximise."""


def _mean_variance(weight: np.ndarray | None = None) -> Measure:
    """Minus log of ``trace(C W)``, and its derivative; by default of the mean of the diagonal."""

    def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
        bound = inverse(matrix)
        target = np.eye(len(matrix)) / len(matrix) if weight is None else weight
        variance = float(np.sum(bound * target))
        return -np.log(variance), bound @ target @ bound / variance

    return measure


def _smallest(matrix: np.ndarray) -> tuple[float, np.ndarray]:
    """Logarithm of the smallest eigenvalue, and its derivative."""
    values, vectors = np.linalg.eigh(matrix)
    size = max(float(values[0]), NOTHING)
    return float(np.log(size)), np.outer(vectors[:, 0], vectors[:, 0]) / size


@dataclass(frozen=True)
class DOptimal:
    """Smallest volume of the confidence ellipsoid: log det of the information.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading").model
    >>> setting = Setting(ship, ("K", "T"), np.ones(2), np.ones(1))
    >>> value, _ = DOptimal().bind(setting)(np.diag([1.0, 4.0]))
    >>> round(float(value), 3)  # log(1 * 4)
    1.386
    """

    name: str = "D"

    def bind(self, setting: Setting) -> Measure:
        """Return ``log det F`` and its derivative ``F**-1``."""
        return lambda matrix: (log_determinant(matrix), inverse(matrix))


@dataclass(frozen=True)
class AOptimal:
    """Smallest mean squared relative error: minus log of the mean of the bound's diagonal.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading").model
    >>> setting = Setting(ship, ("K", "T"), np.ones(2), np.ones(1))
    >>> value, _ = AOptimal().bind(setting)(np.diag([1.0, 4.0]))
    >>> round(float(value), 3)  # minus the logarithm of (1 + 1/4)/2
    0.47
    """

    name: str = "A"

    def bind(self, setting: Setting) -> Measure:
        """Return ``-log(trace(C)/n)`` and its derivative."""
        return _mean_variance()


@dataclass(frozen=True)
class EOptimal:
    """Shortest longest axis of the ellipsoid: log of the smallest eigenvalue.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading").model
    >>> setting = Setting(ship, ("K", "T"), np.ones(2), np.ones(1))
    >>> value, _ = EOptimal().bind(setting)(np.diag([1.0, 4.0]))
    >>> round(float(value), 3)  # log(1)
    0.0
    """

    name: str = "E"

    def bind(self, setting: Setting) -> Measure:
        """Return ``log(lambda_min)`` and its derivative."""
        return _smallest


@dataclass(frozen=True)
class DsOptimal:
    """D-criterion of some parameters, the others estimated but not of interest.

    Parameters
    ----------
    interest : sequence of str
        Parameters of interest.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading").model
    >>> setting = Setting(ship, ("K", "T"), np.ones(2), np.ones(1))
    >>> value, _ = DsOptimal(["T"]).bind(setting)(np.diag([1.0, 4.0]))
    >>> round(float(value), 3)  # log(4): K is of no interest
    1.386
    """

    interest: Sequence[str]

    @property
    def name(self) -> str:
        """Name for reports."""
        return f"Ds ({', '.join(self.interest)})"

    def bind(self, setting: Setting) -> Measure:
        """Return ``log det`` of the Schur complement and its derivative."""
        lacking = f"Model {setting.model.name!r} has no parameter that is estimated"
        last = located(DesignError, lacking, self.interest, setting.names)
        # Those of no interest in front, where they are eliminated.
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
        runs = commanded_runs(setting.model, self.manoeuvres)
        rows = np.concatenate([respond(setting.model, given).jacobian for given in runs])
        rows = rows[:, :, columns] / setting.sigma[:, None]
        return np.asarray(rows.reshape(-1, len(columns)) * setting.scales)


@dataclass(frozen=True)
class VOptimal(_Prediction):
    """Smallest mean variance of predictions of given manoeuvres.

    Parameters
    ----------
    manoeuvres : sequence of Experiment
        What is to be predicted well, such as a turning circle.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> VOptimal([*load_problem("nomoto_sparse_heading").experiments.values()]).name
    'V (mean prediction)'
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

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> GOptimal([*load_problem("nomoto_sparse_heading").experiments.values()]).name
    'G (worst prediction)'
    """

    name: str = "G (worst prediction)"

    def bind(self, setting: Setting) -> Measure:
        """Return minus log of the largest variance in noise units, and its derivative."""
        rows = self._rows(setting)

        def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
            bound = inverse(matrix)
            variances = np.einsum("ij,ij->i", rows @ bound, rows)
            # The largest of smooth functions: the derivative is that of the one that is largest.
            worst = int(np.argmax(variances))
            row = bound @ rows[worst]
            return -np.log(variances[worst]), np.outer(row, row) / variances[worst]

        return measure


@runtime_checkable
class ByShifts(Criterion, Protocol):
    """Contract of criteria that ask what absent effects would do, beside the parameters.

    They are bound to a setting with these shifts, and see the information on
    ``[parameters, shifts]``.

    Examples
    --------
    :class:`Discriminate` and :class:`Detect` are such criteria.
    """

    def shifts(self, nominal: Model) -> Shifts:
        """Return the effects or rivals, on the nominal model."""


def _asked(setting: Setting) -> tuple[Shifts, int]:
    """The absent effects of a setting, and how many parameters stand before them."""
    if setting.shifts is None:
        raise DesignError("This criterion needs its effects. Bind it to Setting(..., shifts=...).")
    return setting.shifts, len(setting.names)


def _check(what: str, names: Sequence[str], size: float) -> None:
    """Refuse effects that are named twice, and amplitudes that are none."""
    if not names or len(set(names)) < len(names):
        raise DesignError(f"The {what} are {listed(names)}; give one or more, each once.")
    if not size > 0:
        raise DesignError(f"size is {size}. Give a share of the scale above zero.")


@dataclass(frozen=True)
class Discriminate:
    r"""Maximise the misfit that remains when the wrong rival has been refitted.

    Every rival shifts the outputs by :math:`D_i a_i` (whitened difference to the nominal model, at
    amplitudes :math:`a_i`). The part of it that the free parameters and start states could imitate
    is projected out, and, against another rival, the part that this rival could imitate at any
    amplitude: with the Gram matrix :math:`G` of what is left
    (:mod:`oed_sysid.information.shifts`)

    .. math:: T_{i|j} = a_i' \left(G_{ii} - G_{ij} G_{jj}^{-1} G_{ji}\right) a_i

    The criterion is the logarithm of the smallest :math:`T` over all pairs,
    the nominal model included. :math:`T` is the expected gain of
    :math:`2 \Delta \log L` of the truth over its best rival, which scatters with a variance of
    :math:`4T`; a rival is told apart where that gain exceeds 6, with probability

    .. math:: p_{i|j} = \Phi\left(\frac{T_{i|j} - 6}{2 \sqrt{T_{i|j}}}\right)

    so that the choice is safe above 16 to 25. Records in hand count: their own :math:`G` is added.

    Parameters
    ----------
    rivals : sequence of Effect or Model
        Effects are added to the model, at their value or else a share of their scale;
        models replace it and must have the same inputs and outputs.
    against_believed : bool
        Whether each rival has also to be told from the model without it.
    size : float
        Amplitude of effects without a value, as a share of their scale. Choose
        it small: what separates weak effects separates strong ones, while the
        shift by a strong effect says little about how a refit would go.

    References
    ----------
    W. G. Hunter, A. M. Reiner, Designs for discriminating between two rival
    models, *Technometrics* 7 (1965) 307-323.
    A. C. Atkinson, V. V. Fedorov, The design of experiments for discriminating
    between two rival models, *Biometrika* 62 (1975) 57-70.

    Examples
    --------
    >>> from oed_sysid.physics import cubic_damping, quadratic_drag
    >>> Discriminate([quadratic_drag("two", "N", "r"), cubic_damping("three", "N", "r")]).name
    'discrimination of two, three'
    """

    rivals: Sequence[Effect | Model]
    against_believed: bool = True
    size: float = 0.1

    def __post_init__(self) -> None:
        object.__setattr__(self, "rivals", tuple(self.rivals))
        _check("rivals", self.rival_names, self.size)
        if len(self.rivals) == 1 and not self.against_believed:
            raise DesignError("One rival alone can only be told from the nominal model.")

    @property
    def rival_names(self) -> tuple[str, ...]:
        """Names of the rivals."""
        return tuple(rival.name for rival in self.rivals)

    @property
    def name(self) -> str:
        """Name for reports."""
        return f"discrimination of {', '.join(self.rival_names)}"

    def shifts(self, nominal: Model) -> Shifts:
        """Return what each rival does, built on the nominal model."""
        return Shifts.of(nominal, self.rivals, size=self.size)

    def bind(self, setting: Setting) -> Measure:
        """Return the criterion of the information on ``[parameters, shifts]``."""
        shifts, n_parameters = _asked(setting)

        def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
            gram, mapping = eliminate(matrix, n_parameters)
            pairs = pair_misfits(gram, shifts, against_believed=self.against_believed)
            logs = np.array([np.log(max(value, NOTHING)) for _, _, value, _ in pairs])
            value, weights = soft_minimum(logs, IMMATERIAL)
            by_gram = np.zeros_like(gram)
            for weight, (_, _, misfit, slope) in zip(weights, pairs, strict=True):
                if misfit > NOTHING:
                    # d log T = dT / T, weighted by the soft minimum.
                    by_gram += weight / misfit * slope
            return value, mapping.T @ by_gram @ mapping

        return measure

    def misfits(
        self, nominal: Model, shifts: Shifts, total: np.ndarray, n_parameters: int
    ) -> dict[tuple[str, str], float]:
        """Expected ``2 dlogL`` of every rival over every other and over the nominal model.

        Parameters
        ----------
        nominal : Model
        shifts : Shifts
        total : ndarray
            Information on ``[parameters, shifts]``.
        n_parameters : int
        """
        gram, _ = eliminate(total, n_parameters)
        names = shifts.names
        return {
            (names[i], nominal.name if j < 0 else names[j]): value
            for i, j, value, _ in pair_misfits(gram, shifts, against_believed=True)
        }


def told_apart(misfit: float) -> float:
    """Probability that a rival is told apart, of its expected misfit.

    >>> round(told_apart(6.0), 2), round(told_apart(25.0), 2)
    (0.5, 0.97)
    """
    if misfit <= NOTHING:
        return 0.0
    return float(ndtr((misfit - GROUP_WIDTH) / (2.0 * np.sqrt(misfit))))


def noncentrality(gram: np.ndarray, group: Group) -> tuple[float, np.ndarray]:
    """Expected gain of an effect over the model without it, and its derivative by ``gram``."""
    slope = np.zeros_like(gram)
    slope[np.ix_(group.columns, group.columns)] = group.weight
    return float(np.sum(slope * gram)), slope


def pair_misfits(
    gram: np.ndarray, shifts: Shifts, *, against_believed: bool
) -> list[tuple[int, int, float, np.ndarray]]:
    """Misfit of each rival ``i`` after the best refit of rival ``j`` (-1: none).

    Parameters
    ----------
    gram : ndarray (n_columns, n_columns)
        Inner products of the projected shifts.
    shifts : Shifts
    against_believed : bool
        Whether the pairs with ``j = -1`` count.

    Returns
    -------
    list of (i, j, misfit, derivative by ``gram``)
    """
    groups = shifts.groups
    pairs = []
    for i, own in enumerate(groups):
        if against_believed or len(groups) == 1:
            pairs.append((i, -1, *noncentrality(gram, own)))
        for j, other in enumerate(groups):
            if j == i:
                continue
            # G_ii - G_ij G_jj^-1 G_ji of the class: what the other at its best amplitude leaves.
            both = np.ix_(*[np.concatenate([other.columns, own.columns])] * 2)
            left, mapping = eliminate(gram[both], len(other.columns))
            slope = np.zeros_like(gram)
            slope[both] = mapping.T @ own.weight @ mapping
            pairs.append((i, j, float(np.sum(own.weight * left)), slope))
    return pairs


# Probability from which on something counts as sure: limits kept if no probability was asked for,
# and the smallest size of an effect that shows.
SURE = 0.9


@dataclass(frozen=True)
class Detect:
    """Maximise the chance that a search over a vocabulary finds what is missing.

    Parameters
    ----------
    candidates : sequence of Effect
        Each at its values, or, where these are zero, at its plausible size: ``size`` times the
        scale of its amplitudes.
    worst : bool
        Judge by the smallest chance instead of the mean of the logarithms; effects that the
        parameters imitate completely are left out.
    size : float
        Amplitude of effects without a value, as a share of their scale.
    false_claims : float
        Share of false claims over all candidates.

    Examples
    --------
    >>> from oed_sysid.physics import quadratic_drag
    >>> Detect([quadratic_drag("drag", "N", "r", scale=0.1)], worst=True).name
    'smallest chance to show 1 effects'
    """

    candidates: Sequence[Effect]
    worst: bool = False
    size: float = 1.0
    false_claims: float = 0.01

    def __post_init__(self) -> None:
        object.__setattr__(self, "candidates", tuple(self.candidates))
        _check("candidates", [effect.name for effect in self.candidates], self.size)
        if not 0 < self.false_claims < 1:
            raise DesignError(f"false_claims is {self.false_claims}. Give a probability.")

    @property
    def name(self) -> str:
        """Name for reports."""
        kind = "smallest" if self.worst else "mean log"
        return f"{kind} chance to show {len(self.candidates)} effects"

    def shifts(self, nominal: Model) -> Shifts:
        """Return what each candidate does, built on the nominal model."""
        return Shifts.of(nominal, self.candidates, size=self.size)

    def needed(self, freedom: int) -> float:
        """Gain in twice the log-likelihood that a claim needs.

        >>> from oed_sysid import load_problem
        >>> round(Detect(load_problem("remus_diving_plane").effects).needed(1), 1)
        13.4
        """
        return float(chdtri(freedom, self.false_claims / len(self.candidates)))

    def bind(self, setting: Setting) -> Measure:
        """Return the criterion of the information on ``[parameters, shifts]``."""
        shifts, n_parameters = _asked(setting)
        needed = [self.needed(group.freedom) for group in shifts.groups]

        def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
            gram, mapping = eliminate(matrix, n_parameters)
            raw = matrix[n_parameters:, n_parameters:]
            logs = np.zeros(len(shifts.groups))
            slopes, usable = [], []
            for i, (group, gain) in enumerate(zip(shifts.groups, needed, strict=True)):
                value, by_gram = noncentrality(gram, group)
                logs[i], slope = log_power(value, group.freedom, gain)
                slopes.append(slope * by_gram)
                # Where parameters imitate an effect, no run of this kind shows it.
                usable.append(value > ABSORBED**2 * noncentrality(raw, group)[0])
            if not self.worst:
                return float(logs.mean()), mapping.T @ np.mean(slopes, axis=0) @ mapping
            kept = np.flatnonzero(usable) if any(usable) else np.arange(len(logs))
            smallest, weights = soft_minimum(logs[kept], IMMATERIAL)
            total = np.tensordot(weights, np.stack(slopes)[kept], axes=1)
            return smallest, mapping.T @ total @ mapping

        return measure

    def detections(
        self, shifts: Shifts, before: np.ndarray, after: np.ndarray, n_parameters: int
    ) -> tuple[Detection, ...]:
        """How surely every effect shows, before a run and after it.

        Parameters
        ----------
        shifts : Shifts
        before, after : ndarray
            Information on ``[parameters, shifts]``.
        n_parameters : int
        """
        grams = [eliminate(matrix, n_parameters)[0] for matrix in (before, after)]
        found = []
        for group in shifts.groups:
            gain = self.needed(group.freedom)
            first, last = (noncentrality(gram, group)[0] for gram in grams)
            # The gain grows with the square of the size.
            # Non-centrality at which the test exceeds its threshold with this probability.
            surely = chndtrinc(gain, group.freedom, 1.0 - SURE)
            least = float(np.sqrt(surely / max(last, 1e-300)))
            rare, sure = (
                float(np.exp(log_power(v, group.freedom, gain)[0])) for v in (first, last)
            )
            found.append(Detection(group.name, dict(group.sizes), first, last, rare, sure, least))
        return tuple(found)


@dataclass(frozen=True)
class Detection:
    """How surely one effect would show.

    Attributes
    ----------
    name : str
    sizes : mapping of str to float
        Amplitudes that count as its plausible size.
    gain_before, gain_after : float
        Expected gain in twice the log-likelihood, besides what chance adds.
    before, after : float
        Probability that a search claims it.
    least : float
        Share of the size that shows with a probability of 0.9 after the run.

    Examples
    --------
    >>> told = Detection("drag", {"E_drag": 0.1}, 2.0, 14.0, before=0.1, after=0.86, least=1.1)
    >>> told.after
    0.86
    """

    name: str
    sizes: dict[str, float]
    gain_before: float
    gain_after: float
    before: float
    after: float
    least: float

    to_dict = as_dict("name", "sizes", "gain_before", "gain_after", "before", "after", "least")


def shown(chances: Sequence[Detection]) -> tuple[int, int]:
    """How many effects would show surely, before and after."""
    each = np.array([(one.before, one.after) for one in chances]) >= SURE
    before, after = each.sum(axis=0).tolist()
    return before, after


def missing_physics(
    misfits: Mapping[tuple[str, str], float], chances: Sequence[Detection]
) -> Section:
    """What is said of rivals told apart and of effects detected, records in hand included."""
    lines = [
        f"If {first} is true, {second} is expected to fit worse by "
        f"2 dlogL = {misfit:.3g}{'' if misfit > 16 else ' (not enough to decide)'}; "
        f"told apart with {told_apart(misfit):.0%}."
        for (first, second), misfit in misfits.items()
    ]
    if not chances:
        return Section("MISSING PHYSICS", lines, heading=True, indent=2)
    # The effects that a run makes visible, and those that stay hidden.
    rows = [
        (one.name, f"{one.before:.0%}", f"{one.after:.0%}",
         f"{one.least:.2g} of usual" if one.least < 1e3 else "-")
        for one in sorted(chances, key=lambda one: one.before - one.after)
    ]  # fmt: skip
    before, after = shown(chances)
    lines.append(SAYS["effects_show"].format(after=after, n=len(chances), before=before))
    if hidden := [one.name for one in chances if one.after < 0.5]:
        lines.append(f"Would stay hidden: {', '.join(hidden)}.")
    table = Table(("effect", "chance before", "after", "shows from"), rows)
    return Section("MISSING PHYSICS", lines, (table,), heading=True, indent=2)


def log_power(gain: float, freedom: int, needed: float) -> tuple[float, float]:
    """Logarithm of the chance that a test exceeds its threshold, and its derivative.

    Parameters
    ----------
    gain : float
        Non-centrality.
    freedom : int
    needed : float
        Threshold.

    Examples
    --------
    >>> value, slope = log_power(13.4, 1, 13.4)
    >>> print(f"{np.exp(value):.3f} {slope:.3f}")
    0.500 0.109
    """
    gain = max(gain, 0.0)
    power = 1.0 - float(chndtr(needed, freedom, gain))
    more = 1.0 - float(chndtr(needed, freedom + 2, gain))
    # d/dlambda of the survival function is half of what two degrees of freedom more add.
    return float(np.log(max(power, 1e-300))), 0.5 * max(more - power, 0.0) / max(power, 1e-300)
