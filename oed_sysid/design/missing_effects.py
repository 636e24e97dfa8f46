r"""Experiments that make rival explanations fail: T-optimality, linearised.

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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.optimize import brentq
from scipy.special import chdtri, chndtr, ndtr

from oed_sysid.design.criteria import Measure, eliminate, soft_minimum
from oed_sysid.errors import DesignError
from oed_sysid.information.shifts import Group, Shifts
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import as_dict

_SMALLEST = 1e-9
# Width of the soft minimum over pairs or effects, in units of log misfit or log power.
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
            value, weights = soft_minimum(logs, _SOFTNESS)
            by_gram = np.zeros_like(gram)
            for weight, (_, _, misfit, slope) in zip(weights, pairs, strict=True):
                if misfit > _SMALLEST:
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


FALSE_CLAIMS = 0.01
# Beyond this expected gain everything shows; the distribution is not evaluated.
_CERTAIN = 300.0
# Share of an effect that parameters cannot imitate, below which no run of this kind shows it.
_ABSORBED = 1e-6
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
    """

    candidates: Sequence[Effect]
    worst: bool = False
    size: float = 1.0
    false_claims: float = FALSE_CLAIMS

    def __post_init__(self) -> None:
        object.__setattr__(self, "candidates", tuple(self.candidates))
        names = [effect.name for effect in self.candidates]
        if not names or len(set(names)) < len(names):
            raise DesignError(
                f"The candidates are {', '.join(names) or 'none'}; give one or more, each once."
            )
        if not self.size > 0 or not 0 < self.false_claims < 1:
            raise DesignError(
                f"size is {self.size}, false_claims {self.false_claims}. Give a share of the scale "
                "above zero, and a probability."
            )

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

    def bind_shifts(self, shifts: Shifts, n_parameters: int) -> Measure:
        """Return the criterion of the information on ``[parameters, shifts]``."""
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
                usable.append(value > _ABSORBED * noncentrality(raw, group)[0])
            if not self.worst:
                return float(logs.mean()), mapping.T @ np.mean(slopes, axis=0) @ mapping
            kept = np.flatnonzero(usable) if any(usable) else np.arange(len(logs))
            smallest, weights = soft_minimum(logs[kept], _SOFTNESS)
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
            least = float(np.sqrt(_for_power(group.freedom, gain) / max(last, 1e-300)))
            rare, sure = (
                float(np.exp(log_power(v, group.freedom, gain)[0])) for v in (first, last)
            )
            sizes = dict(group.sizes)
            found.append(Detection(group.name, sizes, first, last, rare, sure, least))
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
    """

    name: str
    sizes: dict[str, float]
    gain_before: float
    gain_after: float
    before: float
    after: float
    least: float

    to_dict = as_dict("name", "sizes", "gain_before", "gain_after", "before", "after", "least")


def missing_physics(
    misfits: Mapping[tuple[str, str], float], chances: Sequence[Detection]
) -> list[str]:
    """Lines on rivals told apart and on effects detected, records in hand included."""
    lines = [
        f"  If {first} is true, {second} is expected to fit worse by "
        f"2 dlogL = {misfit:.3g}{'' if misfit > 16 else ' (not enough to decide)'}; "
        f"told apart with {told_apart(misfit):.0%}."
        for (first, second), misfit in misfits.items()
    ]
    return lines + (chance_table(chances) if chances else [])


def chance_table(chances: Sequence[Detection], *, most: int = 12) -> list[str]:
    """Lines with the effects that a run makes visible, and those that stay hidden."""
    lines = [f"  {'effect':<32} {'chance before':>13} {'after':>7} {'shows from':>14}"]
    gained = sorted(chances, key=lambda one: one.before - one.after)
    for one in gained[:most]:
        least = f"{one.least:.2g} of usual" if one.least < 1e3 else "-"
        lines.append(f"  {one.name:<32} {one.before:>13.0%} {one.after:>7.0%} {least:>14}")
    hidden = [one.name for one in chances if one.after < 0.5]
    shown = sum(one.after >= SURE for one in chances)
    lines.append(
        f"  {shown} of {len(chances)} effects would show at their usual size with 90 % or more, "
        f"{sum(one.before >= SURE for one in chances)} before."
    )
    if hidden:
        lines.append(f"  Would stay hidden: {', '.join(hidden)}.")
    return lines


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
    if gain > _CERTAIN + needed:
        return 0.0, 0.0
    power = 1.0 - float(chndtr(needed, freedom, gain))
    more = 1.0 - float(chndtr(needed, freedom + 2, gain))
    # d/dlambda of the survival function is half of what two degrees of freedom more add.
    return float(np.log(max(power, 1e-300))), 0.5 * max(more - power, 0.0) / max(power, 1e-300)


def _for_power(freedom: int, needed: float) -> float:
    """Non-centrality at which a test is sure."""
    return float(brentq(lambda one: log_power(one, freedom, needed)[0] - np.log(SURE), 0, _CERTAIN))
