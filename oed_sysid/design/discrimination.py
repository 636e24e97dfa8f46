"""Experiments that make rival explanations fail: T-optimality, linearised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.special import ndtr

from oed_sysid.design.criteria import Measure
from oed_sysid.design.elimination import eliminate
from oed_sysid.effects import Effect
from oed_sysid.errors import DesignError
from oed_sysid.model import Model
from oed_sysid.sensitivity.shifts import Group, Shifts

_SMALLEST = 1e-9
# Width of the soft minimum over pairs, in units of log misfit.
_SOFTNESS = 0.1
# A rival whose refit is this close, in twice the log-likelihood, is not told apart by a search for
# missing physics.
GROUP_WIDTH = 6.0


@runtime_checkable
class ByShifts(Protocol):
    """Contract of criteria that ask what absent effects would do, beside the parameters."""

    @property
    def name(self) -> str:
        """Name for reports."""
        ...

    def shifts(self, nominal: Model) -> Shifts:
        """Return the effects or rivals, on the nominal model."""
        ...

    def bind_shifts(self, shifts: Shifts, n_parameters: int) -> Measure:
        """Return the function to maximise, of the information on ``[parameters, shifts]``."""
        ...


@dataclass(frozen=True)
class Discriminate:
    r"""Maximise the misfit that remains when the wrong rival has been refitted.

    Every rival shifts the outputs by :math:`D_i a_i` (whitened difference to the nominal model, at
    amplitudes :math:`a_i`). The part of it that the free parameters and start states could imitate
    is projected out, and, against another rival, the part that this rival could imitate at any
    amplitude: with the Gram matrix :math:`G` of what is left
    (:mod:`oed_sysid.sensitivity.shifts`)

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
    """

    rivals: Sequence[Effect | Model]
    against_believed: bool = True
    size: float = 0.1

    def __post_init__(self) -> None:
        object.__setattr__(self, "rivals", tuple(self.rivals))
        names = self.rival_names
        if not names or len(set(names)) < len(names):
            raise DesignError(
                f"The rivals are {', '.join(names) or 'none'}; give one or more, each once."
            )
        if not self.size > 0:
            raise DesignError(f"size is {self.size}. Give a share of the scale above zero.")
        if len(names) == 1 and not self.against_believed:
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

    def bind_shifts(self, shifts: Shifts, n_parameters: int) -> Measure:
        """Return the criterion of the information on ``[parameters, shifts]``."""

        def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
            gram, mapping = eliminate(matrix, n_parameters)
            pairs = pair_misfits(gram, shifts, against_believed=self.against_believed)
            logs = np.array([np.log(max(value, _SMALLEST)) for _, _, value, _ in pairs])
            smallest = logs.min()
            weights = np.exp(-(logs - smallest) / _SOFTNESS)
            value = smallest - _SOFTNESS * np.log(np.mean(weights))
            weights /= weights.sum()
            by_gram = np.zeros_like(gram)
            for weight, (_, _, misfit, slope) in zip(weights, pairs, strict=True):
                if misfit > _SMALLEST:
                    by_gram += weight / misfit * slope
            return float(value), mapping.T @ by_gram @ mapping

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
    if misfit <= _SMALLEST:
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
            mine, theirs = own.columns, other.columns
            block = gram[np.ix_(theirs, theirs)]
            floor = _SMALLEST + 1e-12 * float(np.trace(block))
            imitated = np.linalg.solve(
                block + floor * np.eye(len(theirs)), gram[np.ix_(theirs, mine)]
            )
            direction = np.zeros((len(gram), len(mine)))
            direction[mine, np.arange(len(mine))] = 1.0
            direction[theirs] = -imitated
            slope = direction @ own.weight @ direction.T
            left = gram[np.ix_(mine, mine)] - gram[np.ix_(mine, theirs)] @ imitated
            pairs.append((i, j, float(np.sum(own.weight * left)), slope))
    return pairs


@dataclass(frozen=True, eq=False)
class Completing:
    """A criterion by shifts with the joint information in hand, such as that of other runs.

    Parameters
    ----------
    criterion : ByShifts
    known : ndarray (n_parameters + n_columns, n_parameters + n_columns)
        Parameters in SI units, effects in units of their size; priors included.
    """

    criterion: ByShifts
    known: np.ndarray

    @property
    def name(self) -> str:
        """Name for reports."""
        return self.criterion.name

    def shifts(self, nominal: Model) -> Shifts:
        """Return those of the criterion."""
        return self.criterion.shifts(nominal)

    def bind_shifts(self, shifts: Shifts, n_parameters: int) -> Measure:
        """Return that of the criterion."""
        return self.criterion.bind_shifts(shifts, n_parameters)
