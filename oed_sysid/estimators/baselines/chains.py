"""Markov chains: whether they have mixed, and what their draws are worth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oed_sysid.information import autocorrelation


@dataclass(frozen=True, eq=False)
class Chains:
    """Draws of several chains.

    Attributes
    ----------
    coefficients : ndarray (n_chains, n_draws, n)
    variances : ndarray (n_chains, n_draws)
        Of the noise.
    """

    coefficients: np.ndarray
    variances: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        """Posterior mean, shape ``(n,)``."""
        return self.coefficients.mean(axis=(0, 1))

    @property
    def std(self) -> np.ndarray:
        """Posterior standard deviation, shape ``(n,)``."""
        return self.coefficients.reshape(-1, self.coefficients.shape[2]).std(axis=0)


def split_r_hat(draws: np.ndarray) -> np.ndarray:
    """Potential scale reduction of half chains, one where they agree.

    Parameters
    ----------
    draws : ndarray (n_chains, n_draws, n)

    Returns
    -------
    ndarray (n,)

    References
    ----------
    Gelman et al. (2013), Bayesian data analysis, 3rd ed., sec. 11.4.
    """
    half = draws.shape[1] // 2
    halves = np.concatenate([draws[:, :half], draws[:, half : 2 * half]])
    within = halves.var(axis=1, ddof=1).mean(axis=0)
    between = half * halves.mean(axis=1).var(axis=0, ddof=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = ((half - 1) / half * within + between / half) / within
    return np.sqrt(np.where(within > 0, ratio, 1.0))


def effective_draws(draws: np.ndarray) -> np.ndarray:
    """Number of independent draws that the chains are worth, shape ``(n,)``.

    Combines the autocorrelation within chains with the spread between them and
    cuts it where pairs turn negative (Gelman et al. 2013, sec. 11.5).

    Parameters
    ----------
    draws : ndarray (n_chains, n_draws, n)
    """
    n_chains, n_draws, n = draws.shape
    result = np.empty(n)
    for i in range(n):
        part = draws[:, :, i]
        within = part.var(axis=1, ddof=1).mean()
        if within == 0:
            result[i] = n_chains * n_draws
            continue
        total = (n_draws - 1) / n_draws * within + part.mean(axis=1).var(ddof=1)
        correlations = np.array([autocorrelation(chain, n_draws - 1) for chain in part])
        variances = part.var(axis=1)[:, None]
        rho = 1.0 - (within - (correlations * variances).mean(axis=0)) / total
        pairs = rho[1:-1:2] + rho[2::2]
        negative = np.flatnonzero(pairs < 0)
        tail = pairs[: negative[0]] if len(negative) else pairs
        result[i] = n_chains * n_draws / max(1.0 + 2.0 * float(tail.sum()), 1e-3)
    return np.minimum(result, n_chains * n_draws)
