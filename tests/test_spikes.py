"""Samples that stand out alone."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid.likelihood.noise_levels import spike_sizes


def test_sizes_of_spikes_are_distances_from_neighbours() -> None:
    """A jump of ten standard deviations is as far from its neighbours, whatever drifts below."""
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(4000, 1))
    drift = 50.0 * np.sin(np.arange(4000) / 300.0)[:, None]
    noise[1234] = 10.0
    (sizes,) = spike_sizes([noise + drift])
    assert np.argmax(np.abs(sizes)) == 1234
    # White noise is 1.137 standard deviations from the median of its neighbours.
    assert sizes[1234, 0] == pytest.approx(10.0 / 1.137, rel=0.15)
    assert np.nanstd(np.delete(sizes, 1234)) == pytest.approx(1.0, abs=0.1)
