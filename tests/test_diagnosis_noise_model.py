"""The filter of deviations against dense covariances, and noise levels against simulated ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oed_sysid.diagnosis.lanes import innovations_by_model
from scipy import optimize

from oed_sysid.noise import kalman as filters
from oed_sysid.noise.kalman import Deviations, NoiseModel, whiten
from oed_sysid.noise.levels import estimate_noise
from oed_sysid.noise.restricted_likelihood import Grounds, restricted

N_TIMES, N_STATES, N_FORCES, N_OUTPUTS = 9, 3, 2, 2
WHITE, COLOUR, FORCE = np.array([0.2, 0.1]), np.array([0.15, 0.05]), np.array([0.5, 0.8])


def small_record(seed: int = 0) -> Deviations:
    """Random time-varying dynamics with some samples missing."""
    rng = np.random.default_rng(seed)
    present = np.ones((N_TIMES, N_OUTPUTS))
    present[2, 0] = present[5] = 0.0
    return Deviations(
        transition=0.5 * rng.standard_normal((N_TIMES, N_STATES, N_STATES)),
        force_gain=rng.standard_normal((N_TIMES, N_STATES, N_FORCES)),
        output=rng.standard_normal((N_TIMES, N_OUTPUTS, N_STATES)),
        present=present,
        sample_time=0.3,
    )


def noise_model(kind: str) -> NoiseModel:
    """White, with forces, or with forces and coloured sensors."""
    colour = COLOUR if kind == "coloured" else 0 * COLOUR
    force = 0 * FORCE if kind == "white" else FORCE
    return NoiseModel(WHITE, colour, force, colour_time=0.4, force_time=1.0)


def dense_covariance(record: Deviations, noise: NoiseModel) -> np.ndarray:
    """Covariance of all samples, written down from the definition, without any recursion in it.

    Rows and columns run over times, then outputs.
    """
    age = record.sample_time * np.abs(np.subtract.outer(np.arange(N_TIMES), np.arange(N_TIMES)))
    force = np.kron(np.exp(-age / noise.force_time), np.diag(noise.force**2))
    colour = np.kron(np.exp(-age / noise.colour_time), np.diag(noise.colour**2))
    response = np.zeros((N_TIMES, N_OUTPUTS, N_TIMES, N_FORCES))
    for begin in range(N_TIMES):
        state = record.force_gain[begin]
        for k in range(begin + 1, N_TIMES):
            response[k, :, begin] = record.output[k] @ state
            state = record.transition[k] @ state
    full = response.reshape(N_TIMES * N_OUTPUTS, N_TIMES * N_FORCES)
    return full @ force @ full.T + colour + np.diag(np.tile(noise.white**2, N_TIMES))


@pytest.mark.parametrize("kind", ["white", "forces", "coloured"])
@pytest.mark.parametrize("compiled", [True, False])
def test_innovations_have_the_likelihood_of_the_dense_normal_distribution(
    kind: str, compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Inner products and log determinant equal those of the full covariance matrix."""
    if not compiled:
        monkeypatch.setattr(filters, "_library", lambda *sizes: None)
    record, noise = small_record(), noise_model(kind)
    columns = np.random.default_rng(1).standard_normal((N_TIMES, N_OUTPUTS, 4))
    columns[5] = np.nan
    whitened, log_determinant = whiten(noise, [record], [columns])
    seen = record.present.ravel() > 0
    covariance = dense_covariance(record, noise)[np.ix_(seen, seen)]
    flat = columns.reshape(-1, 4)[seen]
    expected = flat.T @ np.linalg.solve(covariance, flat)
    np.testing.assert_allclose(whitened[0].T @ whitened[0], expected, rtol=1e-9)
    np.testing.assert_allclose(log_determinant, np.linalg.slogdet(covariance)[1], rtol=1e-9)


def test_jobs_side_by_side_are_those_one_by_one() -> None:
    """Several records filtered together give what each gives alone, in order."""
    rng = np.random.default_rng(2)
    jobs = [
        (noise_model("coloured"), small_record(seed), rng.standard_normal((N_TIMES, N_OUTPUTS, 1)))
        for seed in range(4)
    ]
    together = filters.innovations(jobs)
    for job, found in zip(jobs, together, strict=True):
        np.testing.assert_array_equal(found.white, filters.innovations([job])[0].white)


@pytest.mark.parametrize("n_models", [3, 11])
def test_models_in_lanes_are_those_one_by_one(n_models: int) -> None:
    """Residuals filtered under many noise models at once give what each model gives alone."""
    rng = np.random.default_rng(3)
    models = [
        noise_model("coloured").with_levels(
            WHITE * rng.uniform(0.5, 2), COLOUR * (i % 3), FORCE * (i % 4)
        )
        for i in range(n_models)
    ]
    records = [small_record(seed) for seed in range(2)]
    series = [rng.standard_normal((N_TIMES, N_OUTPUTS, 1)) for _ in records]
    series[1][5] = np.nan
    together = innovations_by_model(models, records, series)
    for model, row in zip(models, together, strict=True):
        for record, column, found in zip(records, series, row, strict=True):
            alone = filters.innovations([(model, record, column)])[0]
            np.testing.assert_allclose(found.white, alone.white, rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(found.roots, alone.roots, rtol=1e-12)


def test_a_lane_that_breaks_down_leaves_the_others_alone() -> None:
    """A covariance that is not positive definite is infinite for its own model only."""
    good = noise_model("coloured")
    bad = good.with_levels(0 * WHITE, 0 * COLOUR, 0 * FORCE + [0.0, 1e-9])
    column = np.random.default_rng(4).standard_normal((N_TIMES, N_OUTPUTS, 1))
    found = innovations_by_model([good, bad, good], [small_record()], [column])
    assert np.isfinite(found[0][0].log_determinant)
    assert found[2][0].log_determinant == pytest.approx(found[0][0].log_determinant)
    assert not np.isfinite(found[1][0].log_determinant)


def test_unknown_scale_is_the_most_likely_one() -> None:
    """Where levels are not known, the best common factor on all of them is found in one go."""
    rng = np.random.default_rng(5)
    records = [small_record(seed) for seed in range(2)]
    columns = tuple(3.0 * rng.standard_normal((N_TIMES, N_OUTPUTS, 4)) for _ in records)
    grounds = Grounds(columns, np.zeros((1, 2)), WHITE)
    noise = noise_model("forces")

    def objective(log_scale: float) -> float:
        size = np.exp(log_scale)
        scaled = noise.with_levels(size * WHITE, 0 * COLOUR, size * FORCE)
        return restricted(grounds, [scaled], [records])[0].objective

    best = optimize.minimize_scalar(objective, bounds=(-5.0, 5.0), method="bounded")
    free = replace(grounds, scale_known=False)
    found = restricted(free, [noise.with_levels(WHITE, 0 * COLOUR, FORCE)], [records])[0]
    assert found.objective == pytest.approx(best.fun, rel=1e-9)
    assert found.scale == pytest.approx(np.exp(best.x), rel=1e-3)


def long_record(n_times: int) -> Deviations:
    """A stable first-order system seen by two sensors."""
    return Deviations(
        np.full((n_times, 1, 1), 0.9),
        np.full((n_times, 1, 1), 0.3),
        np.tile([[1.0], [0.5]], (n_times, 1, 1)),
        np.ones((n_times, 2)),
        0.1,
    )


def markov(std: float, memory: float, n_times: int, rng: np.random.Generator) -> np.ndarray:
    """Stationary first-order sequence."""
    found = std * rng.standard_normal(n_times)
    for k in range(1, n_times):
        found[k] = memory * found[k - 1] + np.sqrt(1 - memory**2) * found[k]
    return found


def simulated(noise: NoiseModel, n_times: int, seed: int) -> np.ndarray:
    """Deviations of the outputs of :func:`long_record`."""
    rng = np.random.default_rng(seed)
    force = markov(noise.force[0], np.exp(-0.1 / noise.force_time), n_times, rng)
    state = np.zeros(n_times)
    for k in range(n_times - 1):
        state[k + 1] = 0.9 * state[k] + 0.3 * force[k]
    outputs = np.outer(state, [1.0, 0.5]) + noise.white * rng.standard_normal((n_times, 2))
    for column in range(2):
        outputs[:, column] += markov(
            noise.colour[column], np.exp(-0.1 / noise.colour_time), n_times, rng
        )
    return outputs


@pytest.mark.parametrize(
    ("force", "colour"),
    [(0.0, (0.0, 0.0)), (0.2, (0.0, 0.0)), (0.2, (0.08, 0.0))],
    ids=["white", "force", "force and colour"],
)
def test_noise_levels_of_simulated_records_are_found(
    force: float, colour: tuple[float, float]
) -> None:
    """Averaged over seeds, every level is found within a tenth, and absent ones stay near zero."""
    truth = NoiseModel(np.array([0.1, 0.05]), np.array(colour), np.array([force]))
    units = NoiseModel(np.array([0.2, 0.1]), np.array([0.2, 0.1]), np.array([1.0]))
    start = units.with_levels(units.white, 0 * units.colour, units.force)
    n_times = 1500
    found = [
        estimate_noise(
            start, units, [long_record(n_times)], [simulated(truth, n_times, seed)], known=False
        )
        for seed in range(6)
    ]
    for name in ("white", "force", "colour"):
        mean = np.sqrt(np.mean([getattr(noise, name) ** 2 for noise in found], axis=0))
        wanted = getattr(truth, name)
        np.testing.assert_allclose(mean[wanted > 0], wanted[wanted > 0], rtol=0.1)
        size = getattr(units, name)
        assert np.all(mean[wanted == 0] < 0.15 * size[wanted == 0])


def test_declared_levels_are_kept() -> None:
    """With known noise the white levels are the declared ones and sensors get no colour."""
    truth = NoiseModel(np.array([0.1, 0.05]), np.zeros(2), np.array([0.2]))
    units = NoiseModel(truth.white, truth.white, np.array([1.0]))
    start = units.with_levels(units.white, np.zeros(2), units.force)
    found = estimate_noise(
        start, units, [long_record(1000)], [simulated(truth, 1000, 3)], known=True
    )
    np.testing.assert_array_equal(found.white, truth.white)
    assert not found.has_colour
    assert found.force[0] == pytest.approx(0.2, rel=0.2)
