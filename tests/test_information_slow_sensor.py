"""Residuals of a sensor that samples more slowly than its record."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from oed_sysid.likelihood.information import effective_sample_size, whiteness


@pytest.mark.parametrize("stride", [2, 4, 7])
def test_colour_shows_between_missing_rows(stride: int) -> None:
    """A series with empty rows in between is as coloured as without them."""
    rng = np.random.default_rng(3)
    series = lfilter([1.0], [1.0, -0.9], rng.standard_normal(2000))
    sparse = np.full(2000 * stride, np.nan)
    sparse[1::stride] = series
    assert effective_sample_size(sparse) == pytest.approx(effective_sample_size(series))
    assert whiteness(sparse).lag_one == pytest.approx(0.9, abs=0.05)
    assert not whiteness(sparse).is_white


def test_white_series_with_gaps_stays_white() -> None:
    """Samples lost at random leave a white series white."""
    rng = np.random.default_rng(4)
    series = rng.standard_normal(3000)
    series[rng.random(3000) < 0.3] = np.nan
    assert whiteness(series).is_white
