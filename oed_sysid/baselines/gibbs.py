"""Bayesian linear regression by Gibbs sampling, with its closed form and its diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from oed_sysid.baselines.equations import WINDOW, Rates, Rows, check_rule
from oed_sysid.baselines.regression import (
    CONVERGED,
    Regression,
    RegressionEstimator,
    each_equation,
    prior_rows,
)
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.estimate import Posterior, Status
from oed_sysid.likelihood.estimator import check_choice
from oed_sysid.likelihood.information import autocorrelation
from oed_sysid.runtime.constants import NEGLIGIBLE, RANK_TOLERANCE


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
    # Halves show a chain that drifts, which has the same mean as another that does.
    half = draws.shape[1] // 2
    halves = np.concatenate([draws[:, :half], draws[:, half : 2 * half]])
    within = halves.var(axis=1, ddof=1).mean(axis=0)
    # Of means, times the draws in each: what the variance within would be if halves agreed.
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
        # Sums of neighbours are positive for a reversible chain: the first negative one is noise.
        pairs = rho[1:-1:2] + rho[2::2]
        negative = np.flatnonzero(pairs < 0)
        tail = pairs[: negative[0]] if len(negative) else pairs
        result[i] = n_chains * n_draws / max(1.0 + 2.0 * float(tail.sum()), 1e-3)
    return np.minimum(result, n_chains * n_draws)


DRAWS = ("joint", "coordinate")


def sample_posterior(
    features: np.ndarray,
    targets: np.ndarray,
    *,
    precision: np.ndarray,
    rng: np.random.Generator,
    mean: np.ndarray | None = None,
    shape: float = 1e-3,
    rate: float = 1e-3,
    draw: str = "joint",
    n_draws: int = 2000,
    burn_in: int = 500,
    n_chains: int = 4,
) -> Chains:
    r"""Gibbs sampler of :math:`y = \Phi c + e`, :math:`e \sim N(0, s^2)`.

    Alternates between the coefficients given the variance and the variance
    given the coefficients. ``"coordinate"`` draws one coefficient at a time,

    .. math:: c_j|\cdot \sim N(\mu, 1/\pi),\quad \pi = G_{jj}/s^2 + \lambda_j,\quad
              \mu = \frac{h_j - \sum_{l\ne j}G_{jl}c_l}{s^2\pi}

    with :math:`G=\Phi^T\Phi`, :math:`h=\Phi^Ty`; it mixes slowly where columns
    are alike. ``"joint"`` draws all at once.

    Parameters
    ----------
    features : ndarray (n_samples, n)
        Columns of like size.
    targets : ndarray (n_samples,)
    precision : ndarray (n,)
        Prior precision of each coefficient.
    rng : numpy.random.Generator
    mean : ndarray (n,), optional
        Prior mean, zero by default.
    shape, rate : float
        Of the prior of the variance.
    draw : str
        ``"joint"`` or ``"coordinate"``.
    n_draws, burn_in, n_chains : int
        Draws kept and dropped per chain, and number of chains; these begin at
        overdispersed points.

    References
    ----------
    Geman & Geman (1984), IEEE Trans. PAMI 6; Chen, Deng & Xu (2023), Ship
    Engineering 45(2), for the use on manoeuvring derivatives.
    """
    check_choice("draw", draw, DRAWS)
    n = features.shape[1]
    mean0 = np.zeros(n) if mean is None else np.asarray(mean, dtype=float)
    gram, moment = features.T @ features, features.T @ targets
    energy = float(targets @ targets)
    # Conjugate priors: normal for coefficients, inverse gamma (shape a) for the variance.
    a = shape + 0.5 * len(targets)
    centre = np.linalg.lstsq(features, targets, rcond=None)[0]
    start = float(np.mean((targets - features @ centre) ** 2)) + 1e-12 * energy / len(targets)
    spread = np.sqrt(start / np.maximum(np.diag(gram), 1e-300))
    # Overdispersed starts: chains that agree after these have forgotten them.
    c = centre + 10.0 * spread * rng.standard_normal((n_chains, n))
    variance = start * np.exp(rng.uniform(-1, 1, n_chains))
    kept = np.empty((n_chains, n_draws, n))
    variances = np.empty((n_chains, n_draws))
    for index in range(burn_in + n_draws):
        if draw == "coordinate":
            for j in range(n):
                pi = gram[j, j] / variance + precision[j]
                # What the other coefficients explain of this column.
                others = c @ gram[j] - c[:, j] * gram[j, j]
                mu = ((moment[j] - others) / variance + precision[j] * mean0[j]) / pi
                c[:, j] = mu + rng.standard_normal(n_chains) / np.sqrt(pi)
        else:
            # All chains at once: mean of the normal distribution, and a draw about it.
            inner = gram / variance[:, None, None] + np.diag(precision)
            right = moment / variance[:, None] + precision * mean0
            # inner = U'U: a solution of U x = z has the covariance inner^-1.
            upper = np.linalg.cholesky(inner).transpose(0, 2, 1)
            unit = rng.standard_normal((n_chains, n))
            c = np.linalg.solve(inner, right[:, :, None])[:, :, 0]
            c = c + np.linalg.solve(upper, unit[:, :, None])[:, :, 0]
        # |y - Phi c|^2 from the normal equations: a draw costs nothing per sample.
        sse = energy - 2 * c @ moment + np.einsum("ci,ij,cj->c", c, gram, c)
        sse = np.maximum(sse, 1e-14 * energy)
        variance = (rate + 0.5 * sse) / rng.gamma(a, size=n_chains)
        if index >= burn_in:
            kept[:, index - burn_in] = c
            variances[:, index - burn_in] = variance
    return Chains(kept, variances)


@dataclass(frozen=True)
class GibbsRegression(RegressionEstimator):
    """Bayesian regression of each equation of motion by Gibbs sampling.

    Estimates are posterior means and the covariance is that of the draws. The
    errors of the rows are taken as white; where derivatives come from noisy
    measurements they are not, and the posterior is too narrow.

    Parameters
    ----------
    n_draws, burn_in, n_chains : int
        See :func:`sample_posterior`.
    draw : str
        ``"joint"`` or ``"coordinate"``, as published.
    rule, window, rates
        Where derivatives come from, see
        :class:`~oed_sysid.baselines.least_squares.EquationError`.
    seed : int
        Of the random numbers.

    References
    ----------
    Chen, Deng & Xu (2023), Ship Engineering 45(2), doi
    10.13788/j.cnki.cbgc.2023.02.11; Gelman et al. (2013), Bayesian data
    analysis, 3rd ed., ch. 11.

    Examples
    --------
    >>> GibbsRegression(n_draws=500, burn_in=100).name
    'Gibbs sampling (joint draws, 4 x 500)'
    """

    words: ClassVar[str] = "Gibbs sampling ({draw} draws, {n_chains} x {n_draws})"
    n_draws: int = 2000
    burn_in: int = 500
    n_chains: int = 4
    draw: str = "joint"
    rule: str = "local"
    window: int = WINDOW
    rates: Rates | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        check_rule(self.rule, self.window)
        check_choice("draw", self.draw, DRAWS)
        if self.n_draws < 100 or self.n_chains < 2 or self.burn_in < 0:
            raise ModelError(
                f"{self.n_chains} chains of {self.n_draws} draws cannot be judged. Give at least 2 "
                "chains of 100."
            )

    def _solve(self, rows: Rows) -> Regression:
        """Draw from each equation; the posterior holds the draws, and how far to trust them."""
        rng = np.random.default_rng(self.seed)
        drawn: dict[str, np.ndarray] = {}
        r_hat: dict[str, float] = {}
        effective: dict[str, float] = {}

        def solve(index: int) -> tuple[Sequence[str], Regression]:
            names, draws = self._draws(rows, index, rng)
            flat = draws.reshape(-1, len(names))
            drawn.update(zip(names, np.moveaxis(draws, 2, 0), strict=True))
            r_hat.update(zip(names, map(float, split_r_hat(draws)), strict=True))
            effective.update(zip(names, map(float, effective_draws(draws)), strict=True))
            return names, Regression(flat.mean(axis=0), np.atleast_2d(np.cov(flat.T)))

        found = each_equation(rows, solve)
        worst = max(r_hat, key=lambda name: r_hat[name])
        status = CONVERGED
        # Chains count as mixed whose spread is that within each to a hundredth (Vehtari et al.
        # 2021).
        if r_hat[worst] > 1.0 + NEGLIGIBLE:
            status = Status(
                "iterations",
                f"the chains disagree in {worst} (R-hat {r_hat[worst]:.3f}). Raise "
                "n_draws, or use draw='joint'.",
            )
        return replace(
            found,
            status=status,
            iterations=self.n_draws + self.burn_in,
            posterior=Posterior(drawn, r_hat, effective),
        )

    def _draws(
        self, rows: Rows, index: int, rng: np.random.Generator
    ) -> tuple[tuple[str, ...], np.ndarray]:
        """Names of the parameters of an equation, and draws ``(n_chains, n_draws, n_names)``."""
        features, targets, names = rows.equation(index)
        size = float(np.sqrt(np.mean(targets**2))) or 1.0
        # Columns of unit size: chains of like pace, and one width of prior for all.
        units = size / np.sqrt(np.mean(features**2, axis=0))
        # Known parameters as whitened rows; the others have a prior so wide, in units of what
        # explains the whole target, that it tells less than rounding.
        known, means = prior_rows(rows.form.model)
        columns = [rows.form.names.index(name) for name in names]
        weights, aims = known.sum(axis=0)[columns], (known.T @ means)[columns]
        precision = np.where(weights > 0, (weights * units) ** 2, RANK_TOLERANCE**2)
        mean = np.divide(aims, weights**2, out=np.zeros(len(names)), where=weights > 0)
        chains = sample_posterior(
            features * units / size,
            targets / size,
            precision=precision,
            mean=mean / units,
            rate=1e-18,  # a variance below rounding cannot be told from none
            draw=self.draw,
            n_draws=self.n_draws,
            burn_in=self.burn_in,
            n_chains=self.n_chains,
            rng=rng,
        )
        return names, chains.coefficients * units
