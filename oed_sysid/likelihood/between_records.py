r"""Errors of estimates from what records say apart from one another.

Residuals of one record tell how noise moves an estimate, not what differs from record to record and
no parameter says: a term that is missing acts in a weak zigzag otherwise than in a strong one,
loading and water change from day to day. The scatter between records holds both. With information
:math:`H_i` and score :math:`g_i` of record *i* at the optimum, its start states and own parameters
eliminated, the estimate without this record is to first order

.. math::
    \hat p_{(i)} = \hat p - (H - H_i)^{-1} g_i, \qquad H = \sum_i H_i + \text{priors},

and the delete-one jackknife over *n* records is

.. math::
    C_r = \frac{n-1}{n} \sum_i (\hat p_{(i)} - \bar p)(\hat p_{(i)} - \bar p)'
        + H^{-1} \Lambda H^{-1}, \qquad \bar p = \frac1n \sum_i \hat p_{(i)},

priors of information :math:`\Lambda` being as uncertain as they say.

It is the covariance that is robust to correlation within clusters, CR3, with records as clusters.
It asks of records only that they are independent of one another: colour, forces and missing
structure may be what they are. Intervals are those of Student's distribution with :math:`n - 1`
degrees of freedom. What all records share, such as the scale of the one sensor, it cannot hold.

If noise alone acted, and as the information says, its expectation would be

.. math:: E_r = \frac{n-1}{n} \sum_i (H - H_i)^{-1} H_i H^{-1} + H^{-1} \Lambda H^{-1},

which is :math:`H^{-1}` for records that tell the same and more for unequal ones. Records differ by
more than the stated errors say where the diagonal of :math:`C_r` exceeds that of :math:`E_r`, this
multiplied by stated variance over :math:`H^{-1}`, by more than chance: a variable of
:math:`\chi^2_\nu / \nu` with :math:`\nu = (\sum_i w_i)^2 / \sum_i w_i^2 - 1` and :math:`w_i`
the terms of the sum.

References
----------
Bell & McCaffrey (2002), Bias reduction in standard errors for linear regression with multi-stage
samples, Survey Methodology 28(2).
MacKinnon, Nielsen & Webb (2023), Fast and reliable jackknife and bootstrap methods for
cluster-robust inference, J. Appl. Econometrics 38.

Whether records, and what was known before them, can all be right about one model.

Every record ``i`` and the priors (``i = 0``) tell the shared parameters, with information
:math:`H_i` and score :math:`g_i` at the joint estimate, start states and own parameters eliminated.
If one model holds for all, and errors are what they are said to be, the squared distances of their
own estimates from the joint one,

.. math::
    Q = \sum_i (\hat p_i - \hat p)' H_i (\hat p_i - \hat p) = \sum_i g_i' H_i^+ g_i
    \sim \chi^2_\nu, \qquad \nu = \sum_i \operatorname{rank} H_i - \operatorname{rank} \sum_i H_i,

are a chi-squared variable (Cochran 1954). A term that is missing acts in a weak manoeuvre otherwise
than in a strong one: estimates differ by more, also where the fit has taken what is left for random
forces and each record alone looks well. Differences that are small against what is asked need not
count: with an allowance :math:`T`, the covariance by which each source may differ,

.. math:: H_i \to (I + H_i T)^{-1} H_i, \qquad g_i \to (I + H_i T)^{-1} g_i.

Each source is compared with all others together, too, because many that agree would hide one,

.. math::
    Q_i = g_i' H_i^+ g_i + g_i' (H - H_i)^+ g_i \sim \chi^2_{\nu_i}, \qquad
    \nu_i = \operatorname{rank} H_i + \operatorname{rank} (H - H_i) - \operatorname{rank} H,

and the smallest chance counts times the number of comparisons (Bonferroni).

What all sources share, such as a wrong scale of the one sensor, they cannot show; neither can a
single record without priors contradict anything.

References
----------
Cochran (1954), The combination of estimates from different experiments, Biometrics 10, 101-129.
Box (1980), Sampling and Bayes' inference in scientific modelling and robustness, J. R. Stat. Soc.
A 143, 383-430 (priors that records contradict).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, stdtrit

from oed_sysid.data.record import Record
from oed_sysid.likelihood.projection import coordinates, inverse_of
from oed_sysid.runtime.constants import RANK_TOLERANCE

# Fewest of what shows by how much it scatters, three degrees of freedom: records, samples of a
# period and periods of a block, windows for each parameter.
FEWEST = 4
# Chance that a fit whose errors are right is told that its records differ.
CHANCE = 0.01
# Standard deviations that are wrong by a smaller factor are not worth a word.
WORTH_TELLING = 1.5


@dataclass(frozen=True, eq=False)
class RecordScatter:
    """How estimates scatter between records, to first order.

    Attributes
    ----------
    covariance : ndarray (n_shared, n_shared)
        Jackknife covariance :math:`C_r`; infinite on the diagonal where one record alone tells of
        a parameter.
    expected : ndarray (n_shared,)
        Diagonal of :math:`E_r`: what noise alone would give it.
    freedom : ndarray (n_shared,)
        Degrees of freedom of the comparison.
    n_records : int
    """

    covariance: np.ndarray
    expected: np.ndarray
    freedom: np.ndarray
    n_records: int

    def exceeds(self, stated: np.ndarray, white: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By what factor the scatter exceeds stated errors, and where chance seldom does that.

        Parameters
        ----------
        stated : ndarray (n_shared,)
            Stated variances.
        white : ndarray (n_shared,)
            Diagonal of the inverse information.

        Returns
        -------
        factor : ndarray (n_shared,)
            Of standard errors; one where nothing can be compared.
        clear : ndarray of bool (n_shared,)
        """
        found, ratio = np.diag(self.covariance), np.ones(len(stated))
        usable = np.isfinite(found) & np.isfinite(stated) & np.isfinite(white)
        usable &= (stated > 0) & (white > 0) & (self.expected > 0)
        # What noise alone would give, as much larger as the stated errors are larger than white
        # ones.
        due = self.expected[usable] * stated[usable] / white[usable]
        ratio[usable] = found[usable] / due
        factor = np.sqrt(ratio)
        chance = chdtrc(self.freedom, self.freedom * ratio) * max(int(usable.sum()), 1)
        return factor, usable & (chance < CHANCE) & (factor > WORTH_TELLING)

    def half_width(self, level: float = 0.95) -> np.ndarray:
        """Half width of intervals of the parameters, of Student's distribution."""
        errors = np.sqrt(np.diag(self.covariance))
        return float(stdtrit(self.n_records - 1, 0.5 + level / 2)) * errors


@dataclass(frozen=True)
class Agreement:
    """How well sources agree.

    Attributes
    ----------
    statistic : float
        :math:`Q` of all together.
    freedom : int
        Its degrees of freedom; zero where nothing can be compared.
    each : tuple of float
        :math:`Q_i` of each source against all others.
    each_freedom : tuple of int
    """

    statistic: float
    freedom: int
    each: tuple[float, ...]
    each_freedom: tuple[int, ...]

    @property
    def chances(self) -> tuple[float, ...]:
        """Chance of as large a statistic where all are right: of all together, then of each."""
        pairs = zip((self.freedom, *self.each_freedom), (self.statistic, *self.each), strict=True)
        return tuple(float(chdtrc(n, value)) if n > 0 else 1.0 for n, value in pairs)

    @property
    def chance(self) -> float:
        """Chance that any comparison is as unlikely as the least likely one."""
        compared = sum(freedom > 0 for freedom in self.each_freedom)
        # Of two sources there is one difference.
        return min(1.0, (1 if compared <= 2 else compared + 1) * min(self.chances))

    @property
    def worst(self) -> int:
        """The source that differs most from the others."""
        return int(np.argmin(self.chances[1:])) if self.each else 0


@dataclass(frozen=True, eq=False)
class Sources:
    """What priors and each record say of the shared parameters, at the joint estimate.

    Attributes
    ----------
    matrices : ndarray (1 + n_records, n_shared, n_shared)
        Information of what was known before (priors, independent tests), then of each record.
    scores : ndarray (1 + n_records, n_shared)
        Slopes of their log-likelihoods; their sum is zero at the joint estimate.
    """

    matrices: np.ndarray
    scores: np.ndarray

    @property
    def n_records(self) -> int:
        """Records, independent tests not among them."""
        return len(self.matrices) - 1

    def scatter(self) -> RecordScatter | None:
        """Scatter of estimates by leaving out one record after the other, to first order.

        It is taken about where the slope of the whole, zero but for approximate scores, would be.

        Returns
        -------
        RecordScatter or None
            None for fewer than four records, or where nothing is to be estimated.

        Examples
        --------
        The mean of four numbers has the standard error of the textbook:

        >>> numbers = np.array([1.0, -2.0, 3.0, -2.0])
        >>> matrices = np.array([0.0, 1.0, 1.0, 1.0, 1.0])[:, None, None]  # no prior
        >>> found = Sources(matrices, np.array([0.0, *numbers])[:, None]).scatter()
        >>> round(float(found.covariance[0, 0]), 9), float(np.var(numbers, ddof=1) / 4)
        (1.5, 1.5)
        >>> round(float(found.expected[0]), 9), float(found.freedom[0])  # variance one
        (0.25, 3.0)
        """
        n, prior, records = self.n_records, self.matrices[0], self.matrices[1:]
        if n < FEWEST or not len(prior):
            return None
        whole = self.matrices.sum(axis=0)
        scale = np.sqrt(np.maximum(np.diag(whole), 0.0))
        inverse = inverse_of(whole)
        # One Newton step to the joint optimum of the approximate scores.
        step = inverse @ self.scores.sum(axis=0)
        told = [coordinates(whole - matrix, scale) for matrix in records]
        alone = np.any([scale == 0, *(blind for _, blind in told)], axis=0)
        without = np.array([onto @ onto.T for onto, _ in told])
        moved = (without @ (self.scores[1:] - records @ step)[..., None])[..., 0]
        # Jackknife: scatter about the mean of the estimates that each leave one record out.
        moved -= moved.mean(axis=0)
        assumed = inverse @ prior @ inverse
        covariance = (n - 1) / n * moved.T @ moved + assumed
        covariance[alone, :] = covariance[:, alone] = 0.0
        covariance[alone, alone] = np.inf
        shares = np.maximum(np.diagonal(without @ records @ inverse, axis1=1, axis2=2), 0.0)
        total = shares.sum(axis=0)
        squares = np.where(total > 0, (shares**2).sum(axis=0), 1.0)
        # Satterthwaite (1946): degrees of freedom of a sum of unequal parts.
        freedom = np.clip(total**2 / squares - 1.0, 1.0, n - 1.0)
        return RecordScatter(covariance, (n - 1) / n * total + np.diag(assumed), freedom, n)

    def agreement(
        self, *, allowance: np.ndarray | None = None, stated: np.ndarray | None = None
    ) -> Agreement:
        """Compare what the sources say.

        Parameters
        ----------
        allowance : ndarray (n_shared,), optional
            Standard deviations by which sources may differ besides their errors.
        stated : ndarray (n_shared, n_shared), optional
            Covariance of the joint estimate where it is larger than the information says: in the
            directions in which it is, every record tells as much less.

        Returns
        -------
        Agreement

        Examples
        --------
        Two records of equal weight, three standard errors of their difference apart:

        >>> one = np.eye(1)
        >>> score = np.array([[0.0], [3.0 / 2**0.5], [-3.0 / 2**0.5]])
        >>> found = Sources(np.array([0 * one, one, one]), score).agreement()
        >>> round(found.statistic, 9), found.freedom, round(found.chances[0], 4)
        (9.0, 1, 0.0027)
        """
        size = self.matrices.shape[-1]
        matrices, scores = self.matrices.copy(), self.scores.copy()
        if stated is not None and size:
            # Priors and tests do not share what oscillates in the records.
            matrices[1:], scores[1:] = self._grown(stated)
        if allowance is not None and size:
            # (I + H T)^-1 of the head of this module, T being diagonal.
            shrink = np.linalg.inv(np.eye(size) + matrices * np.square(allowance))
            matrices = shrink @ matrices
            matrices = 0.5 * (matrices + matrices.transpose(0, 2, 1))
            scores = (shrink @ scores[..., None])[..., 0]
        onto, _ = coordinates(matrices.sum(axis=0))
        # In coordinates in which all sources together are the identity, shares lie between 0 and
        # 1.
        shares = onto.T @ matrices @ onto
        slopes = scores @ onto
        slopes = slopes - (shares @ slopes.sum(axis=0)[:, None])[..., 0]
        told, axes = np.linalg.eigh(shares)
        squares = (slopes[:, None] @ axes)[:, 0] ** 2
        seen = told > RANK_TOLERANCE
        # Where one source tells everything, there is nobody to differ from.
        both = seen & (told < 1.0 - RANK_TOLERANCE)
        total = float(np.sum(squares / np.where(seen, told, np.inf)))
        each = np.sum(squares / np.where(both, told * (1.0 - told), np.inf), axis=1)
        freedom = max(int(seen.sum()) - onto.shape[1], 0)
        return Agreement(total, freedom, tuple(each.tolist()), tuple(both.sum(axis=1).tolist()))

    def _grown(self, stated: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Information and scores of the records where errors are as a covariance states."""
        whole = self.matrices.sum(axis=0)
        onto, _ = coordinates(whole)
        back = whole @ onto  # the transposed inverse, where anything is told
        grown, axes = np.linalg.eigh(back.T @ np.where(np.isfinite(stated), stated, 0.0) @ back)
        less = (axes / np.sqrt(np.maximum(grown, 1.0))) @ axes.T
        own = onto.T @ self.matrices[1:] @ onto
        inverses = np.linalg.pinv(own, rcond=RANK_TOLERANCE, hermitian=True)
        apart = inverses @ (self.scores[1:] @ onto)[..., None]
        told = less @ own @ less
        return back @ told @ back.T, (back @ told @ apart)[..., 0]

    def apart(self, index: int) -> np.ndarray:
        """Differences of one source from all others, in standard errors of them, ``(n_shared,)``.

        Zero where the others, or it alone, do not tell a parameter.
        """
        whole = self.matrices.sum(axis=0)
        left, joint = inverse_of(whole - self.matrices[index]), inverse_of(whole)
        moved = left @ self.scores[index]
        # Of the difference of an estimate and one that contains it: their variances subtract.
        variance = np.diag(left) - np.diag(joint)
        usable = variance > RANK_TOLERANCE * np.diag(joint)
        return np.where(usable, moved / np.sqrt(np.where(usable, variance, 1.0)), 0.0)


def sources_of(
    matrices: Sequence[np.ndarray],
    scores: Sequence[np.ndarray],
    prior: np.ndarray,
    records: Sequence[Record] = (),
    *,
    gradient: np.ndarray | None = None,
) -> Sources | None:
    """Gather what priors and records say; None where there is nothing to compare.

    Parameters
    ----------
    matrices, scores : sequence of ndarray
        Information and score of each record.
    prior : ndarray (n_shared, n_shared)
        Information that is there without records.
    records : sequence of Record
        Independent tests among them are known before the series, as it were.
    gradient : ndarray (n_shared,), optional
        Slope of the whole where it is not zero, because scores are approximate.
    """
    tests = np.zeros(len(matrices), dtype=bool)
    tests[: len(records)] = [record.independent for record in records]
    if tests.all() or not len(prior):
        return None
    told, scored = np.array(matrices), np.array(scores)
    slope = np.zeros(len(prior)) if gradient is None else gradient
    known = prior + told[tests].sum(axis=0)
    before = slope - scored[~tests].sum(axis=0)
    return Sources(np.array([known, *told[~tests]]), np.array([before, *scored[~tests]]))
