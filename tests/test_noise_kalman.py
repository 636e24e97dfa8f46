"""The filter of deviations, and restricted likelihood, against dense covariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize

from oed_sysid.likelihood import kalman as filters
from oed_sysid.likelihood.kalman import Deviations, whiten
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.restricted_likelihood import Grounds, restricted

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
    times = np.array([1.0, 2.5])
    return NoiseModel(WHITE, colour, force, colour_time=np.array([0.4, 1.1]), force_time=times)


def dense_covariance(record: Deviations, noise: NoiseModel) -> np.ndarray:
    """Covariance of all samples, written down from the definition, without any recursion in it.

    Rows and columns run over times, then outputs.
    """
    age = record.sample_time * np.abs(np.subtract.outer(np.arange(N_TIMES), np.arange(N_TIMES)))
    force, colour = (
        sum(
            np.kron(np.exp(-age / times[i]), np.diag(size**2 * (np.arange(len(size)) == i)))
            for i in range(len(size))
        )
        for size, times in ((noise.force, noise.force_time), (noise.colour, noise.colour_time))
    )
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
