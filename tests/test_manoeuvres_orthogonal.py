"""Multisines for several inputs at once."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid.errors import ModelError
from oed_sysid.experiments.manoeuvres import (
    Multisine,
    orthogonal_multisines,
    peak_factor,
    schroeder_phases,
)

BAND = {"period": 100.0, "lowest": 0.02, "highest": 0.3}


def test_signals_are_orthogonal_at_every_delay() -> None:
    """Over a period no input is seen in another, however late it answers."""
    signals = orthogonal_multisines({"rudder": 0.2, "propeller": 1.0, "fin": 0.1}, **BAND)
    times = np.arange(2000) * 0.05
    waves = [s.commands(times) for s in signals]
    for i, first in enumerate(waves):
        for second in waves[:i]:
            both = np.fft.irfft(np.fft.rfft(first) * np.fft.rfft(second).conj())
            assert np.abs(both).max() < 1e-9 * len(times)


def test_peaks_are_those_asked_for_and_lower_than_schroeder() -> None:
    """Commands stay within their peaks, and for the same peak more power is put in."""
    times = np.arange(20000) * 0.005
    for signal in orthogonal_multisines({"rudder": 0.2, "propeller": 1.0}, **BAND):
        assert np.abs(signal.commands(times)).max() == pytest.approx(signal.peak, rel=3e-3)
        plain = Multisine(
            signal.input, signal.frequencies, peak=signal.peak,
            phases=schroeder_phases([1.0] * len(signal.frequencies)).tolist(),
        )  # fmt: skip
        assert signal.crest_factor < 0.95 * plain.crest_factor
        assert peak_factor(signal) < 1.25


def test_spectra_are_those_designed() -> None:
    """Amplitudes follow the spectrum that is asked for, line by line."""
    (signal,) = orthogonal_multisines({"rudder": 0.2}, **BAND, spectra={"rudder": lambda f: 1 / f})
    power = np.abs(np.fft.rfft(signal.commands(np.arange(2000) * 0.05)))
    lines = np.round(np.array(signal.frequencies) * 100).astype(int)
    np.testing.assert_allclose(power[lines] * lines, power[lines[0]] * lines[0], rtol=1e-6)
    assert np.delete(power, lines).max() < 1e-9 * power.max()


def test_bands_without_room_are_refused() -> None:
    """Too few lines and unknown inputs are named."""
    with pytest.raises(ModelError, match="two lines each"):
        orthogonal_multisines({"a": 1.0, "b": 1.0}, period=10.0, lowest=0.1, highest=0.3)
    with pytest.raises(ModelError, match="'c' has no peak"):
        orthogonal_multisines({"a": 1.0}, **BAND, neutral={"c": 1.0})
