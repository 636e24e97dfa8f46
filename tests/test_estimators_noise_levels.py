"""The noise that records themselves show, against noise that was put in."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Output, Record
from oed_sysid.likelihood.noise_levels import credible_levels, noise_floor, white_levels
from oed_sysid.physics.channels import Channels

CHANNELS = Channels((), (Output("y", "m", "level"),))


def record(motion: np.ndarray, noise: float, seed: int = 0) -> Record:
    """A motion at 10 Hz with white noise added."""
    rng = np.random.default_rng(seed)
    values = motion + noise * rng.standard_normal(len(motion))
    times = 0.1 * np.arange(len(motion))
    return Record("r", times, np.zeros((len(times), 0)), values[:, np.newaxis], CHANNELS)


@pytest.mark.parametrize("frequency", [0.02, 0.5, 1.5], ids=["slow", "faster", "seven samples"])
def test_white_noise_is_seen_below_a_motion_a_hundred_times_larger(frequency: float) -> None:
    """However fast the motion, up to seven samples a period, the level is found within a fifth."""
    motion = np.sin(2 * np.pi * frequency * 0.1 * np.arange(3000))
    levels, seen = white_levels(Dataset((record(motion, 0.01),)))
    assert seen[0]
    assert levels[0] == pytest.approx(0.01, rel=0.2)


def test_missing_samples_between_the_measured_ones_do_not_matter() -> None:
    """A sensor with every fourth sample shows the noise that it has."""
    full = record(np.zeros(4000), 0.3)
    sparse = np.where(np.arange(4000) % 4 == 0, full.outputs[:, 0], np.nan)
    assert noise_floor(Dataset((full.with_outputs(sparse[:, np.newaxis]),)))[0] == pytest.approx(
        0.3, rel=0.1
    )


def test_motion_without_noise_is_not_called_noise() -> None:
    """Where every order of differences shows less, the level is only an upper limit, and small."""
    motion = np.sin(0.1 * 0.1 * np.arange(500))
    levels, _ = white_levels(Dataset((record(motion, 0.0),)))
    assert levels[0] < 1e-6


def test_a_filtered_log_is_not_measured_without_error() -> None:
    """The last digit of a file is no sensor's noise; noise that one sees is left as it is."""
    motion = np.sin(0.2 * 0.1 * np.arange(3000))
    rounded = Dataset((record(np.round(motion, 8), 0.0),))
    levels, seen = credible_levels(rounded)
    assert not seen[0]
    assert levels[0] == pytest.approx(1e-3 * np.std(motion), rel=0.1)
    fine = Dataset((record(motion, 1e-4),))
    levels, seen = credible_levels(fine)
    assert seen[0]
    assert levels[0] == pytest.approx(1e-4, rel=0.2)
