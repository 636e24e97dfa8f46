"""Spectra and autocorrelations of the broadband inputs."""

import numpy as np
import pytest

from oed_sysid.experiments.manoeuvres import (
    PRBS,
    Chirp,
    Multisine,
    maximum_length_sequence,
    schroeder_phases,
)


@pytest.mark.parametrize("order", range(2, 17))
def test_prbs_has_the_autocorrelation_of_maximum_length(order):
    """Circular autocorrelation: n at lag zero and -1 elsewhere, for every register."""
    sequence = maximum_length_sequence(order, seed=1 + order // 3)
    length = 2**order - 1
    power = np.abs(np.fft.rfft(sequence)) ** 2
    correlation = np.fft.irfft(power, n=length)
    assert set(sequence) == {-1.0, 1.0}
    assert correlation[0] == pytest.approx(length)
    np.testing.assert_allclose(correlation[1:], -1.0, atol=1e-6 * length)


def test_prbs_seed_shifts_and_period_repeats():
    """Another seed gives the same period, shifted; the command repeats after it."""
    sequences = {
        tuple(np.roll(maximum_length_sequence(5, seed=seed), -shift))
        for seed in (1, 7, 31)
        for shift in range(31)
    }
    assert len(sequences) == 31
    prbs = PRBS("rudder", 0.2, bit_time=3.0, order=5, start=6.0)
    times = np.arange(0, 300, 1.0)
    commands = prbs.commands(times)
    assert not np.any(commands[:6])
    np.testing.assert_array_equal(commands[6:100], commands[6 + 93 : 100 + 93])
    assert prbs.duration == 6.0 + 93.0


def test_multisine_spectrum_lies_on_its_lines_only():
    """The FFT of one period shows the given amplitudes and nothing between them."""
    harmonics, sizes = [2, 3, 5, 11], [0.1, 0.2, 0.05, 0.15]
    signal = Multisine("rudder", np.array(harmonics) / 50.0, amplitudes=sizes)
    assert signal.period == pytest.approx(50.0)
    times = np.arange(500) * 0.1
    spectrum = 2 * np.abs(np.fft.rfft(signal.commands(times))) / len(times)
    np.testing.assert_allclose(spectrum[harmonics], sizes, atol=1e-12)
    spectrum[harmonics] = 0
    assert spectrum.max() < 1e-12


@pytest.mark.parametrize("n_lines", [8, 20, 50])
def test_schroeder_phases_lower_the_crest_factor(n_lines):
    """Equal lines: crest factor near 1.7, against sqrt(2 n) with equal phases."""
    lines = np.arange(1, n_lines + 1) / 100.0
    good = Multisine("rudder", lines, peak=0.3)
    naive = Multisine("rudder", lines, phases=np.zeros(n_lines), peak=0.3)
    assert naive.crest_factor == pytest.approx(np.sqrt(2 * n_lines), rel=2e-3)
    assert good.crest_factor < 2.0
    np.testing.assert_allclose(good.phases, schroeder_phases(np.ones(n_lines)))


@pytest.mark.parametrize("frequencies", [[0.01, 0.02, 0.05], [0.01, 0.01 * np.sqrt(2), 0.031]])
def test_multisine_peak_is_a_limit_and_is_used(frequencies):
    """The command stays below the peak; with a common period it comes within 0.2 %."""
    signal = Multisine("rudder", frequencies, amplitudes=[3.0, 2.0, 1.0], peak=0.35)
    largest = np.max(np.abs(signal.commands(np.linspace(0, 3000, 300_001))))
    assert largest <= 0.35
    if signal.period is not None:
        assert largest > 0.35 * 0.998
    ratio = np.array(signal.amplitudes) / signal.amplitudes[2]
    np.testing.assert_allclose(ratio, [3.0, 2.0, 1.0])


@pytest.mark.parametrize(
    ("law", "frequency"),
    [("linear", lambda share: 0.1 + 0.9 * share), ("log", lambda share: 0.1 * 10**share)],
)
def test_chirp_sweeps_by_its_law(law, frequency):
    """Each cycle, between two upward zeros, has the frequency that the law gives there."""
    chirp = Chirp(
        "fin", 0.2, first_frequency=0.1, last_frequency=1.0, sweep_time=400.0, law=law, start=3.0
    )
    times = np.linspace(3.0, 403.0, 400_001)
    commands = chirp.commands(times)
    below = np.flatnonzero((commands[1:] >= 0) & (commands[:-1] < 0))
    share = commands[below] / (commands[below] - commands[below + 1])
    upward = times[below] + share * (times[1] - times[0])
    middles = (upward[1:] + upward[:-1]) / 2
    np.testing.assert_allclose(1 / np.diff(upward), frequency((middles - 3) / 400), rtol=2e-3)
    assert upward[0] < 3.0 + 1 / 0.1
    assert upward[-1] > 403.0 - 2 / 1.0
    assert np.max(np.abs(commands)) == pytest.approx(0.2, rel=1e-5)
    assert not np.any(chirp.commands([2.9, 403.1]))
