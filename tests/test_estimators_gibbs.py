"""Gibbs sampling against the closed form, and the diagnostics of its chains."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from oed_sysid import Dataset, load_problem
from oed_sysid.baselines import EquationError, GibbsRegression
from oed_sysid.baselines.equations import exact_rates
from oed_sysid.baselines.gibbs import (
    conjugate_posterior,
    effective_draws,
    sample_posterior,
    split_r_hat,
)
from oed_sysid.experiments.simulation import simulate


def correlated_problem() -> tuple[np.ndarray, np.ndarray]:
    """Regression of six features, two of them alike."""
    rng = np.random.default_rng(5)
    x = rng.standard_normal((300, 6))
    x[:, 1] += 2 * x[:, 0]
    return x, x @ np.arange(1.0, 7.0) + 0.5 * rng.standard_normal(300)


@pytest.mark.parametrize(("draw", "n_draws"), [("joint", 2000), ("coordinate", 6000)])
def test_means_equal_the_closed_form(draw: str, n_draws: int) -> None:
    """Posterior means lie within 0.05 sd of the closed form, and R-hat is below 1.01."""
    x, y = correlated_problem()
    precision = np.full(6, 0.01)
    exact = conjugate_posterior(x, y, precision=precision)
    chains = sample_posterior(
        x,
        y,
        precision=precision,
        conjugate=True,
        draw=draw,
        n_draws=n_draws,
        rng=np.random.default_rng(1),
    )
    std = np.sqrt(np.diag(exact.covariance))
    assert np.max(np.abs(chains.mean - exact.mean) / std) < 0.05
    assert chains.std == pytest.approx(std, rel=0.05)
    assert chains.variances.mean() == pytest.approx(exact.variance, rel=0.02)
    assert split_r_hat(chains.coefficients).max() < 1.01


def test_independent_prior_against_quadrature() -> None:
    """With a prior that does not depend on the noise, the mean equals a numerical integral."""
    rng = np.random.default_rng(2)
    x = rng.standard_normal((12, 1))
    y = 0.7 * x[:, 0] + 0.5 * rng.standard_normal(12)

    c, variance = np.meshgrid(np.linspace(-1.5, 2.0, 401), np.linspace(0.02, 6.0, 1201))
    errors = y - c[:, :, None] * x[:, 0]
    logarithm = stats.norm.logpdf(errors, scale=np.sqrt(variance)[:, :, None]).sum(axis=2)
    logarithm += stats.norm.logpdf(c, scale=0.3) + stats.invgamma.logpdf(variance, 2.0, scale=1.0)
    weight = np.exp(logarithm - logarithm.max())
    mean = float(np.sum(c * weight) / np.sum(weight))
    for draw in ("joint", "coordinate"):
        chains = sample_posterior(
            x,
            y,
            precision=np.array([1 / 0.09]),
            shape=2.0,
            rate=1.0,
            draw=draw,
            n_draws=6000,
            rng=np.random.default_rng(3),
        )
        assert abs(chains.mean[0] - mean) < 0.03 * chains.std[0]


def test_conjugate_posterior_without_prior_is_least_squares() -> None:
    """As the prior vanishes, mean and covariance are those of least squares."""
    x, y = correlated_problem()
    posterior = conjugate_posterior(x, y, precision=np.full(6, 1e-12), shape=1e-9, rate=1e-9)
    solution, squares, *_ = np.linalg.lstsq(x, y, rcond=None)
    assert posterior.mean == pytest.approx(solution, rel=1e-6)
    expected = np.linalg.inv(x.T @ x) * squares[0] / (len(y) - 2)
    assert posterior.covariance == pytest.approx(expected, rel=1e-6)


def test_joint_draws_mix_better() -> None:
    """Features that are alike slow coordinate-wise draws down and not joint ones."""
    x, y = correlated_problem()
    found = {}
    for draw in ("joint", "coordinate"):
        chains = sample_posterior(
            x, y, precision=np.full(6, 0.01), draw=draw, rng=np.random.default_rng(4)
        )
        found[draw] = effective_draws(chains.coefficients)
    assert found["coordinate"][0] < 0.3 * found["joint"][0]
    assert found["joint"].min() > 6000


def test_effective_draws_of_an_autoregression() -> None:
    """For an AR(1) chain the number is the known share (1 - a)/(1 + a)."""
    rng = np.random.default_rng(6)
    noise = rng.standard_normal((4, 20000))
    series = np.zeros_like(noise)
    for k in range(1, noise.shape[1]):
        series[:, k] = 0.8 * series[:, k - 1] + noise[:, k]
    share = effective_draws(series[:, :, None])[0] / noise.size
    assert share == pytest.approx(0.2 / 1.8, rel=0.1)


def test_r_hat_sees_chains_that_disagree() -> None:
    """Chains around different values, or that drift, have a large R-hat."""
    rng = np.random.default_rng(7)
    together = rng.standard_normal((4, 500, 1))
    apart = together + np.array([0.0, 0.0, 0.0, 2.0])[:, None, None]
    drifting = together + np.linspace(0, 3, 500)[None, :, None]
    assert split_r_hat(together)[0] < 1.01
    assert split_r_hat(apart)[0] > 1.2
    assert split_r_hat(drifting)[0] > 1.2


def test_estimator_agrees_with_least_squares_and_states_its_chains() -> None:
    """On a real regression, posterior means and errors are those of least squares."""
    problem = load_problem("auv_diving_plane")
    record = simulate(problem.model, problem.experiment("zigzag_5_5"), noise=False)
    data = Dataset((record,))
    rng = np.random.default_rng(8)
    rates = {
        name: rate * (1 + 0.02 * rng.standard_normal(rate.shape))
        for name, rate in exact_rates(problem.model, data).items()
    }
    least = EquationError(rule="exact", rates=rates, coloured="never").fit(problem.model, data)
    gibbs = GibbsRegression(rule="exact", rates=rates).fit(problem.model, data)
    assert max(gibbs.posterior.r_hat.values()) < 1.01
    assert min(gibbs.posterior.effective_draws.values()) > 4000
    for name in least.names:
        assert abs(gibbs.values[name] - least.values[name]) < 0.1 * least.std_errors[name]
        assert gibbs.std_errors[name] == pytest.approx(least.std_errors[name], rel=0.1)
    assert gibbs.posterior.draws["Z_uq_prime"].shape == (4, 2000)
