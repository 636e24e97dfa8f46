r"""Whether records, and what was known before them, can all be right about one model.

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

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

# Share of the joint information in a direction below which a source tells nothing of it.
TOLD = 1e-6
# Scaled information below this share of the largest is none.
NOTHING = 1e-12


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

    def agreement(
        self, *, allowance: np.ndarray | None = None, inflation: float = 1.0
    ) -> Agreement:
        """Compare what the sources say.

        Parameters
        ----------
        allowance : ndarray (n_shared,), optional
            Standard deviations by which sources may differ besides their errors.
        inflation : float
            Variances of what records say over those of white noise, where errors are known to be
            larger than the information says.

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
        # Priors and tests do not share what swings in the records.
        weight = np.array([1.0, *[1.0 / inflation] * self.n_records])
        matrices, scores = self.matrices * weight[:, None, None], self.scores * weight[:, None]
        if allowance is not None and size:
            shrink = np.linalg.inv(np.eye(size) + matrices * np.square(allowance))
            matrices = shrink @ matrices
            matrices = 0.5 * (matrices + matrices.transpose(0, 2, 1))
            scores = (shrink @ scores[..., None])[..., 0]
        whole = matrices.sum(axis=0)
        scale = np.sqrt(np.maximum(np.diag(whole), 0.0))
        scale = np.where(scale > 0, scale, 1.0)
        values, vectors = np.linalg.eigh(whole / scale[:, None] / scale)
        clear = values > NOTHING * max(float(values.max(initial=0.0)), 0.0)
        # In these coordinates the joint information is the identity.
        onto = vectors[:, clear] / scale[:, None] / np.sqrt(values[clear])
        shares = onto.T @ matrices @ onto
        slopes = scores @ onto
        slopes = slopes - (shares @ slopes.sum(axis=0)[:, None])[..., 0]
        total, freedom = 0.0, -int(clear.sum())
        each, each_freedom = [], []
        for share, slope in zip(shares, slopes, strict=True):
            told, axes = np.linalg.eigh(share)
            squares = (axes.T @ slope) ** 2
            seen = told > TOLD
            total, freedom = total + float(np.sum(squares[seen] / told[seen])), freedom + seen.sum()
            both = seen & (told < 1.0 - TOLD)
            each.append(float(np.sum(squares[both] / (told[both] * (1.0 - told[both])))))
            each_freedom.append(int(both.sum()))
        return Agreement(total, max(int(freedom), 0), tuple(each), tuple(each_freedom))

    def apart(self, index: int) -> np.ndarray:
        """Differences of one source from all others, in standard errors of them, ``(n_shared,)``.

        Zero where the others, or it alone, do not tell a parameter.
        """
        others = self.matrices.sum(axis=0) - self.matrices[index]
        own = self.matrices[index]
        both = others + own
        size = np.sqrt(np.maximum(np.diag(both), 0.0))
        size = np.where(size > 0, size, 1.0)
        left, joint = (
            np.linalg.pinv(m / size[:, None] / size, rcond=NOTHING, hermitian=True)
            for m in (others, both)
        )
        moved = left @ (self.scores[index] / size)
        variance = np.diag(left) - np.diag(joint)
        usable = variance > TOLD * np.diag(joint)
        return np.where(usable, moved / np.sqrt(np.where(usable, variance, 1.0)), 0.0)


def sources_of(
    matrices: list[np.ndarray],
    scores: list[np.ndarray],
    prior: np.ndarray,
    *,
    gradient: np.ndarray | None = None,
) -> Sources | None:
    """Gather what priors and records say; None where there is nothing to compare.

    Parameters
    ----------
    matrices, scores : list of ndarray
        Information and score of each record.
    prior : ndarray (n_shared, n_shared)
        Information that is there without records.
    gradient : ndarray (n_shared,), optional
        Slope of the whole where it is not zero, because scores are approximate.
    """
    if not matrices or not len(prior):
        return None
    slope = np.zeros(len(prior)) if gradient is None else gradient
    before = slope - np.sum(scores, axis=0)
    return Sources(np.array([prior, *matrices]), np.array([before, *scores]))
