r"""What chance exceeds rarely: the one budget of false alarms that every question shares.

A log without a fault, and a search over records without missing physics, may say something with
probability :math:`\alpha` altogether. Of :math:`m` questions, each a chi-squared variable of
:math:`k` freedoms where there is nothing, one is answered where it exceeds

.. math:: \chi^{2,-1}_k(1 - \alpha / m)

(Bonferroni).
"""

from __future__ import annotations

from scipy.special import chdtri

from oed_sysid.likelihood.between_records import CHANCE

# Probability that something is said where there is nothing: that of warnings of a fit, too.
FALSE_CLAIMS = CHANCE


def threshold(
    n_candidates: int, freedom: int, share: float = FALSE_CLAIMS, *, trials: float = 1.0
) -> float:
    """Likelihood-ratio statistic that chance exceeds rarely, however many candidates.

    ``trials`` counts the frequencies of which a candidate takes the best.

    Examples
    --------
    >>> round(threshold(40, 1), 1)
    13.4
    """
    return float(chdtri(freedom, share / (max(n_candidates, 1) * max(trials, 1.0))))
