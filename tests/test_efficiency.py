"""Statistics over many noisy repetitions: efficiency and coverage of the stated intervals.

The full-size version, on a vehicle, is benchmarks/efficiency.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from test_information import ar1
from yaw_vehicle import NOISE, TRUE, yaw_data, yaw_model

from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood.multiple_shooting import MultipleShooting

TRUTH = np.array(list(TRUE.values()))


def repeat(memory: float, n_runs: int, **options: object) -> tuple[np.ndarray, ...]:
    """Deviations from the truth, white errors and stated errors, each ``(n_runs, 3)``."""
    clean = yaw_data(0, noise=np.zeros(2))
    estimator = MultipleShooting(**{"noise": NOISE, **options})
    rows = []
    for seed in range(n_runs):
        rng = np.random.default_rng(seed)
        data = Dataset(
            tuple(
                r.with_outputs(r.outputs + NOISE * ar1(r.n_samples, memory, rng, 2)) for r in clean
            )
        )
        fit = estimator.fit(yaw_model(), data)
        assert fit.status.ok
        errors = np.sqrt(np.diag(fit.covariance))
        rows.append((fit.estimates - TRUTH, fit.information.std_errors, errors))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def coverage(deviation: np.ndarray, errors: np.ndarray) -> float:
    """Share of 95 % intervals that hold the truth."""
    return float(np.mean(np.abs(deviation) < 1.959964 * errors))


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["given", "estimate"])
def test_estimates_are_efficient_and_intervals_hold(noise: str) -> None:
    """White noise: variance over the bound near one, 95 % intervals cover about 95 %."""
    deviation, white, stated = repeat(
        0.0, 600, noise=NOISE if noise == "given" else "estimate", coloured="auto"
    )
    ratio = np.var(deviation, axis=0) / np.mean(white**2, axis=0)
    # The variance of 600 normal numbers is known to 5.8 %: three of these.
    assert np.all(np.abs(ratio - 1) < 0.175)
    assert np.all(np.abs(deviation.mean(axis=0)) < 0.15 * white.mean(axis=0))
    assert 0.93 < coverage(deviation, stated) < 0.97


@pytest.mark.slow
@pytest.mark.parametrize(("memory", "least"), [(0.5, 0.92), (0.9, 0.87)])
def test_sandwich_intervals_hold_in_coloured_noise(memory: float, least: float) -> None:
    """Slow noise: white intervals fail, the stated ones hold, with some loss if it is very slow."""
    deviation, white, stated = repeat(memory, 300, disturbances="none")
    assert coverage(deviation, white) < 0.8
    assert least < coverage(deviation, stated) < 0.985


@pytest.mark.slow
def test_robust_intervals_hold() -> None:
    """With Huber's loss on Gaussian noise the intervals cover as well."""
    deviation, _, stated = repeat(0.0, 300, loss="huber", coloured="never")
    assert 0.92 < coverage(deviation, stated) < 0.975


@pytest.mark.slow
def test_default_intervals_hold_in_coloured_noise() -> None:
    """On its own the estimator finds the colour of the sensors, and states what it is worth."""
    deviation, _, stated = repeat(0.5, 100)
    assert 0.92 < coverage(deviation, stated) < 0.985
