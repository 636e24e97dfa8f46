"""The smoother on the path of a filter, against dense least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from oed_sysid.compiled.filtering import FilterPass
from oed_sysid.likelihood.smoother import Path

N_TIMES, N_STATES, N_FORCES, N_OUTPUTS = 30, 3, 2, 2
SAMPLE = 0.2
FORCE, FORCE_TIME = np.array([0.7, 1.3]), np.array([0.9, 2.0])
WHITE, COLOUR_TIME = np.array([0.3, 0.5]), np.array([0.4, 0.9])


@dataclass(frozen=True)
class System:
    """A random time-varying linear system with gaps in the measurements."""

    transition: np.ndarray
    gain: np.ndarray
    output: np.ndarray
    present: np.ndarray
    colour: float

    @classmethod
    def drawn(cls, seed: int, colour: float) -> System:
        """Draw one."""
        rng = np.random.default_rng(seed)
        present = rng.random((N_TIMES, N_OUTPUTS)) > 0.2
        return cls(
            0.6 * rng.standard_normal((N_TIMES, N_STATES, N_STATES)),
            rng.standard_normal((N_TIMES, N_STATES, N_FORCES)),
            rng.standard_normal((N_TIMES, N_OUTPUTS, N_STATES)),
            present,
            colour,
        )

    def filtered(self, columns: np.ndarray) -> tuple[FilterPass, np.ndarray]:
        """The textbook filter, one output at a time: what it keeps, innovations of columns."""
        n_colours = N_OUTPUTS if self.colour else 0
        size = N_STATES + N_FORCES + n_colours
        times = np.concatenate([FORCE_TIME, COLOUR_TIME[:n_colours]])
        stationary = np.concatenate([FORCE, np.full(n_colours, self.colour)]) ** 2
        phi = np.exp(-SAMPLE / times)
        extra = np.arange(N_STATES, size)
        covariance = np.zeros((size, size))
        covariance[extra, extra] = stationary
        gains = np.zeros((N_TIMES, N_OUTPUTS, 2, size))
        moves = np.zeros((N_TIMES, size + N_FORCES, size))
        variances, innovations = np.ones((N_TIMES, N_OUTPUTS)), np.zeros_like(columns)
        state = np.zeros((size, columns.shape[2]))
        for k in range(N_TIMES):
            moves[k, size:] = covariance[N_STATES : N_STATES + N_FORCES]
            for i in np.flatnonzero(self.present[k]):
                h = np.concatenate([self.output[k, i], np.zeros(N_FORCES), np.zeros(n_colours)])
                if n_colours:
                    h[N_STATES + N_FORCES + i] = 1.0
                along = covariance @ h
                variances[k, i] = h @ along + WHITE[i] ** 2
                innovations[k, i] = columns[k, i] - h @ state
                gain = along / variances[k, i]
                gains[k, i] = h, gain
                state = state + np.outer(gain, innovations[k, i])
                covariance = covariance - np.outer(gain, along)
            f = np.zeros((size, size))
            f[:N_STATES, :N_STATES] = self.transition[k]
            f[:N_STATES, N_STATES : N_STATES + N_FORCES] = self.gain[k]
            f[extra, extra] = phi
            moves[k, :size] = f
            state, covariance = f @ state, f @ covariance @ f.T
            covariance[extra, extra] += stationary * (1.0 - phi**2)
        nothing = np.zeros((1, 1))
        part = FilterPass(
            nothing, nothing[0], nothing, 0.0, 0.0, innovations[:, :, 0], variances, None, nothing,
            gains, moves, -1,
        )  # fmt: skip
        return part, innovations

    def dense(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Conditional mean and deviation of the forces, from full covariances."""
        age = SAMPLE * np.abs(np.subtract.outer(np.arange(N_TIMES), np.arange(N_TIMES)))
        level = np.full(N_OUTPUTS, self.colour)
        force_cov, noise_cov = (
            sum(
                np.kron(np.exp(-age / times[i]), np.diag(size**2 * (np.arange(len(size)) == i)))
                for i in range(len(size))
            )
            for size, times in ((FORCE, FORCE_TIME), (level, COLOUR_TIME))
        )
        to_state = np.zeros((N_TIMES * N_STATES, N_TIMES * N_FORCES))
        for k in range(N_TIMES - 1):
            now, then = (slice(i * N_STATES, (i + 1) * N_STATES) for i in (k, k + 1))
            to_state[then] = self.transition[k] @ to_state[now]
            to_state[then, k * N_FORCES : (k + 1) * N_FORCES] += self.gain[k]
        output = np.zeros((N_TIMES * N_OUTPUTS, N_TIMES * N_STATES))
        for k in range(N_TIMES):
            rows, states = slice(k * N_OUTPUTS, (k + 1) * N_OUTPUTS), slice(k * N_STATES, None)
            output[rows, states][:, :N_STATES] = self.output[k]
        response = output @ to_state
        noise_cov += np.kron(np.eye(N_TIMES), np.diag(WHITE**2))
        seen = self.present.ravel()
        total = (response @ force_cov @ response.T + noise_cov)[np.ix_(seen, seen)]
        gain = np.linalg.solve(total, (response @ force_cov)[seen]).T
        forces = gain @ columns.reshape(-1, columns.shape[2])[seen]
        left = np.diag(force_cov) - np.sum(gain * (force_cov @ response.T)[:, seen], axis=1)
        return forces.reshape(N_TIMES, N_FORCES, -1), np.sqrt(left).reshape(N_TIMES, N_FORCES)


@pytest.mark.parametrize("colour", [0.0, 0.4])
def test_smoother_is_the_conditional_expectation(colour: float) -> None:
    """Mean and deviation of the disturbances are those of the joint normal distribution."""
    system = System.drawn(3, colour)
    columns = np.random.default_rng(4).standard_normal((N_TIMES, N_OUTPUTS, 3))
    forces, std = system.dense(columns)
    part, innovations = system.filtered(columns)
    path = Path.of(part, N_OUTPUTS if colour else 0)
    np.testing.assert_allclose(path.disturbances(innovations), forces, atol=1e-9)
    np.testing.assert_allclose(path.std, std, atol=1e-9)


def test_missing_samples_do_not_matter() -> None:
    """What stands in a column where nothing was measured has no influence, NaN included."""
    system = System.drawn(5, 0.0)
    part, innovations = system.filtered(np.ones((N_TIMES, N_OUTPUTS, 1)))
    path = Path.of(part)
    gaps = np.where(system.present[:, :, None], innovations, np.nan)
    np.testing.assert_array_equal(path.disturbances(gaps), path.disturbances(innovations))


def test_responses_are_those_of_the_filter() -> None:
    """What is added to the states changes the innovations as the filter of that change does."""
    system = System.drawn(7, 0.4)
    rng = np.random.default_rng(8)
    drive = np.zeros((N_TIMES, N_STATES + N_FORCES + N_OUTPUTS, 2))
    drive[:, :N_STATES] = rng.standard_normal((N_TIMES, N_STATES, 2))
    state, columns = np.zeros((N_STATES, 2)), np.zeros((N_TIMES, N_OUTPUTS, 2))
    for k in range(N_TIMES):
        columns[k] = -system.output[k] @ state  # measured minus model
        state = system.transition[k] @ state + drive[k, :N_STATES]
    part, innovations = system.filtered(columns)
    expected = innovations / np.sqrt(part.variances)[:, :, None]
    found = Path.of(part, N_OUTPUTS).responses(drive)
    np.testing.assert_allclose(
        found[system.present], expected[system.present], rtol=1e-9, atol=1e-12
    )
