"""Gibbs sampling and population searches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from altered import overwritten
from scipy import stats
from scipy.optimize import minimize
from test_estimators import TEST, YAW

from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Model, load_problem, simulate, simulate_inputs
from oed_sysid.baselines import DifferentialSwarm, EquationError, GibbsRegression, OutputError
from oed_sysid.baselines.equations import exact_rates
from oed_sysid.baselines.gibbs import effective_draws, sample_posterior, split_r_hat
from oed_sysid.baselines.population import TrajectoryCost, redrawn
from oed_sysid.errors import ModelError


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
    chains = sample_posterior(
        x,
        y,
        precision=np.full(6, 1e-9),  # nothing was known: a Student distribution about least squares
        draw=draw,
        n_draws=n_draws,
        rng=np.random.default_rng(1),
    )
    mean, squares, *_ = np.linalg.lstsq(x, y, rcond=None)
    variance = (1e-3 + 0.5 * squares[0]) / (1e-3 + 0.5 * (len(y) - 6) - 1)
    std = np.sqrt(np.diag(np.linalg.inv(x.T @ x)) * variance)
    assert np.max(np.abs(chains.coefficients.mean(axis=(0, 1)) - mean) / std) < 0.05
    assert chains.coefficients.std(axis=(0, 1)) == pytest.approx(std, rel=0.05)
    assert chains.variances.mean() == pytest.approx(variance, rel=0.02)
    assert split_r_hat(chains.coefficients).max() < 1.01


def test_independent_prior_against_quadrature() -> None:
    """With a prior that does not depend on the noise, the mean equals a numerical integral."""
    rng = np.random.default_rng(2)
    x = rng.standard_normal((12, 1))
    y = 0.7 * x[:, 0] + 0.5 * rng.standard_normal(12)

    c, variance = np.meshgrid(np.linspace(-1.5, 2.0, 151), np.linspace(0.02, 6.0, 601))
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
        drawn = chains.coefficients[:, :, 0]
        assert abs(drawn.mean() - mean) < 0.03 * drawn.std()


def test_effective_draws_of_an_autoregression() -> None:
    """For an AR(1) chain the number is the known share (1 - a)/(1 + a)."""
    rng = np.random.default_rng(6)
    series = gauss_markov(rng.standard_normal((4, 20000)), 0.8, axis=1)
    share = effective_draws(series[:, :, None])[0] / series.size
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


def yaw_data(seed: int) -> Dataset:
    """One noisy record."""
    return Dataset((simulate(YAW, TEST, rng=np.random.default_rng(seed)),))


def bounded(model: Model, low: float, high: float) -> Model:
    """Bounds on every free parameter at multiples of its value."""
    for parameter in model.free_parameters:
        lower, upper = sorted((low * parameter.value, high * parameter.value))
        model = model.with_parameter(replace(parameter, lower=lower, upper=upper))
    return model


def test_cost_is_the_mean_square_of_scaled_residuals() -> None:
    """The vectorised cost of each candidate equals that of a single simulation."""
    data = yaw_data(0)
    cost = TrajectoryCost(YAW, data)
    candidates = np.array([[-1.0, -4.0, 0.8], [-0.5, -2.0, 1.0]])
    own = cost._starts[0]
    expected = []
    for candidate in candidates:
        model = YAW.with_values(dict(zip(YAW.free_names, candidate, strict=True)))
        run = simulate_inputs(model, data[0].times, inputs=data[0].inputs, initial=own)
        scaled = (run.outputs - data[0].outputs) / [2e-3, 1e-3]
        expected.append(np.mean(scaled**2))
    assert cost(candidates) == pytest.approx(expected)
    assert cost.n_evaluations == 2


def test_cost_leaves_missing_samples_out_and_survives_divergence() -> None:
    """NaN samples do not count, and a candidate that diverges costs infinity."""
    data = yaw_data(0)
    cost = TrajectoryCost(YAW, overwritten(data, 0, np.s_[10:20, 0], np.nan))
    assert np.isfinite(cost(np.array([[-1.0, -4.0, 0.8]])))[0]
    wild = replace(YAW.parameter("N_r"), lower=-1e5, upper=0.0, value=-1.0)
    assert TrajectoryCost(YAW.with_parameter(wild), data)(np.array([[-9e4, -4.0, 0.8]]))[0] > 1e20


def test_swarm_ends_at_the_optimum_and_states_its_errors() -> None:
    """With noise the swarm ends at the least cost, with the errors of least squares there."""
    data, start = yaw_data(1), {"psi": 0.0, "r": 0.0}
    swarm = DifferentialSwarm(n_particles=40, n_generations=150, initial=start).fit(YAW, data)
    cost = TrajectoryCost(YAW, data, initial=start)
    least = minimize(
        lambda x: cost(x)[0],
        [YAW.values[name] for name in YAW.free_names],
        method="Nelder-Mead",
        options={"xatol": 1e-7, "fatol": 1e-9},
    )
    reference = OutputError().fit(YAW, data)
    for name, value in zip(YAW.free_names, least.x, strict=True):
        assert abs(swarm.values[name] - value) < 0.05 * swarm.std_errors[name]
        assert abs(swarm.values[name] - YAW.values[name]) < 3.5 * swarm.std_errors[name]
        # The start is known here and estimated there.
        assert 0.3 < swarm.std_errors[name] / reference.std_errors[name] < 1.05
    assert np.all(np.diff(swarm.extras["history"]) <= 0)
    assert swarm.extras["evaluations"] == pytest.approx(40 * (swarm.iterations + 1), abs=5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "better", "worse", "n_generations", "share"),
    [("draw", "particle", "dimension", 80, 0.3), ("distinct", False, True, 60, 0.5)],
    ids=["one random number per particle", "two members may be the same"],
)
def test_a_swarm_converges_faster(
    option: str, better: object, worse: object, n_generations: int, share: float
) -> None:
    """Over six seeds the search reaches a far lower cost than with the other choice."""
    data = Dataset((simulate(YAW, TEST, noise=False),))

    def lowest(choice: object) -> float:
        settings = {"n_particles": 20, "n_generations": n_generations, option: choice}
        swarms = (DifferentialSwarm(**settings, seed=seed) for seed in range(6))
        return float(np.median([one.fit(YAW, data).extras["history"][-1] for one in swarms]))

    assert lowest(better) < share * lowest(worse)


@pytest.mark.slow
def test_noise_of_a_measured_start_is_in_the_errors() -> None:
    """A start taken from noisy measurements widens the stated errors."""
    known = DifferentialSwarm(n_generations=60, initial={"psi": 0.0, "r": 0.0})
    measured = DifferentialSwarm(n_generations=60)
    first, second = (estimator.fit(YAW, yaw_data(2)) for estimator in (known, measured))
    assert second.std_errors["N_r"] > 1.5 * first.std_errors["N_r"]
    with pytest.raises(ModelError, match="initial names 'u'"):
        DifferentialSwarm(initial={"u": 1.0}).fit(YAW, yaw_data(2))


def test_redrawn_coordinates_lie_between_best_and_bound() -> None:
    """Coordinates outside the bounds come back inside, others stay."""
    rng = np.random.default_rng(0)
    lower, upper = np.zeros(3), np.ones(3)
    best = rng.uniform(size=(200, 3))
    moved = rng.uniform(-1, 2, size=(200, 3))
    result = redrawn(moved, best, lower, upper, rng)
    inside = (moved >= 0) & (moved <= 1)
    assert np.array_equal(result[inside], moved[inside])
    assert np.all(result[moved < 0] <= best[moved < 0])
    assert np.all(result[moved > 1] >= best[moved > 1])
    assert result.min() >= 0
    assert result.max() <= 1


def test_search_needs_bounds() -> None:
    """A free parameter without bounds is named, with what to do."""
    parameter = replace(YAW.parameter("N_r"), lower=-np.inf)
    with pytest.raises(ModelError, match="N_r have no finite bounds"):
        DifferentialSwarm().fit(YAW.with_parameter(parameter), yaw_data(0))
