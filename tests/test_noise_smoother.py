"""The disturbance smoother against dense least squares."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid.likelihood.kalman import Deviations
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.smoother import smooth, smooth_numpy

N_TIMES, N_STATES, N_FORCES, N_OUTPUTS = 30, 3, 2, 2


def system(seed: int) -> Deviations:
    """A random time-varying system with gaps in the measurements."""
    rng = np.random.default_rng(seed)
    present = (rng.random((N_TIMES, N_OUTPUTS)) > 0.2).astype(float)
    return Deviations(
        0.6 * rng.standard_normal((N_TIMES, N_STATES, N_STATES)),
        rng.standard_normal((N_TIMES, N_STATES, N_FORCES)),
        rng.standard_normal((N_TIMES, N_OUTPUTS, N_STATES)),
        present,
        0.2,
    )


def dense(
    noise: NoiseModel, record: Deviations, column: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Conditional mean of forces and states, and deviation of forces, from full covariances."""
    age = record.sample_time * np.abs(np.subtract.outer(np.arange(N_TIMES), np.arange(N_TIMES)))
    force_cov, noise_cov = (
        sum(
            np.kron(np.exp(-age / times[i]), np.diag(size**2 * (np.arange(len(size)) == i)))
            for i in range(len(size))
        )
        for size, times in ((noise.force, noise.force_time), (noise.colour, noise.colour_time))
    )
    to_state = np.zeros((N_TIMES * N_STATES, N_TIMES * N_FORCES))
    for k in range(N_TIMES - 1):
        now, then = (slice(i * N_STATES, (i + 1) * N_STATES) for i in (k, k + 1))
        to_state[then] = record.transition[k] @ to_state[now]
        to_state[then, k * N_FORCES : (k + 1) * N_FORCES] += record.force_gain[k]
    output = np.zeros((N_TIMES * N_OUTPUTS, N_TIMES * N_STATES))
    for k in range(N_TIMES):
        output[k * N_OUTPUTS : (k + 1) * N_OUTPUTS, k * N_STATES : (k + 1) * N_STATES] = (
            record.output[k]
        )
    response = output @ to_state
    noise_cov += np.kron(np.eye(N_TIMES), np.diag(noise.white**2))
    seen = record.present.ravel() > 0
    total = (response @ force_cov @ response.T + noise_cov)[np.ix_(seen, seen)]
    gain = np.linalg.solve(total, (response @ force_cov)[seen]).T
    forces = gain @ column.reshape(-1, column.shape[2])[seen]
    left = np.diag(force_cov) - np.sum(gain * (force_cov @ response.T)[:, seen], axis=1)
    states = to_state @ forces
    return (
        forces.reshape(N_TIMES, N_FORCES, -1),
        states.reshape(N_TIMES, N_STATES, -1),
        np.sqrt(left).reshape(N_TIMES, N_FORCES),
    )


@pytest.mark.parametrize("method", [smooth, smooth_numpy])
@pytest.mark.parametrize("colour", [0.0, 0.4])
def test_smoother_is_the_conditional_expectation(method, colour) -> None:  # type: ignore[no-untyped-def]
    """Compiled and NumPy smoothers return mean and deviation of the joint normal distribution."""
    record = system(3)
    noise = NoiseModel(
        np.array([0.3, 0.5]),
        np.full(2, colour),
        np.array([0.7, 1.3]),
        np.array([0.4, 0.9]),
        np.array([0.9, 2.0]),
    )
    column = np.random.default_rng(4).standard_normal((N_TIMES, N_OUTPUTS, 3))
    forces, states, std = dense(noise, record, column)
    found = method(noise, record, column)
    np.testing.assert_allclose(found.forces, forces, atol=1e-9)
    np.testing.assert_allclose(found.states, states, atol=1e-9)
    np.testing.assert_allclose(found.std, std, atol=1e-9)


def test_missing_samples_do_not_matter() -> None:
    """What stands in a column where nothing was measured has no influence, NaN included."""
    record = system(5)
    noise = NoiseModel(np.array([0.3, 0.5]), np.zeros(2), np.array([0.7, 1.3]))
    column = np.random.default_rng(6).standard_normal((N_TIMES, N_OUTPUTS, 1))
    gaps = np.where(record.present[:, :, None] > 0, column, np.nan)
    np.testing.assert_array_equal(
        smooth(noise, record, gaps).forces, smooth(noise, record, column).forces
    )
