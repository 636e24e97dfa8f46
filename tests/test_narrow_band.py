"""Peaks in the spectrum of innovations: when they are one, and what they do to the errors."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.random_forces.scenarios import SCENARIOS
from benchmarks.random_forces.simulator import simulate, true_values
from benchmarks.random_forces.trial import _model, believed, dataset
from oed_sysid import MultipleShooting
from oed_sysid.data.record import Record
from oed_sysid.likelihood import random_forces
from oed_sysid.likelihood.covariance import clear_peaks, spectral_peak
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.channels import Channels, Input, Output


def narrow(rng: np.random.Generator, n: int, period: float) -> np.ndarray:
    """Unit white noise through a lightly damped resonance of a period in samples, unit variance."""
    pole = 0.985 * np.exp(2j * np.pi / period)
    wave = lfilter([1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(n + 800))
    return np.asarray(wave[800:] / wave[800:].std())


def fits(name: str, numbers: range) -> Iterator[tuple[Fit, np.ndarray]]:
    """Fits of data sets of the benchmark, and their true parameters."""
    scenario = SCENARIOS[name]
    model = _model(scenario.vehicle).with_values(believed(scenario))
    for drawn in simulate(scenario, 0, numbers):
        fit = MultipleShooting().fit(model, dataset(scenario, model, drawn.runs))
        truth = true_values(scenario, 0, drawn.number)
        yield fit, np.array([truth[name] for name in fit.names])


@pytest.mark.parametrize("lengths", [(200, 200, 200), (601,), (300, 900)])
def test_chance_of_a_peak_holds_in_white_noise(lengths: tuple[int, ...]) -> None:
    """In 600 trials chances below 5 % come in less than 5 %, and below half in some."""
    rng = np.random.default_rng(len(lengths))
    chances = np.array(
        [spectral_peak([rng.standard_normal(n) for n in lengths], 0.1).chance for _ in range(600)]
    )
    assert np.mean(chances < 0.05) < 0.05 + 2 * np.sqrt(0.05 * 0.95 / 600)
    assert np.mean(chances < 0.5) > 0.05


@pytest.mark.parametrize("period", [8.0, 30.0, 60.0])
def test_period_of_a_hidden_wave_is_found(period: float) -> None:
    """A wave of a third of the noise, with gaps: median period within a tenth."""
    rng = np.random.default_rng(3)
    found = []
    for _ in range(20):
        series = [rng.standard_normal(600) + 0.35 * narrow(rng, 600, period) for _ in range(3)]
        for one in series:
            one[rng.random(600) < 0.1] = np.nan
        found.append(spectral_peak(series, 0.5))
    assert np.mean([peak.chance < 1e-2 for peak in found]) > 0.8
    assert np.median([peak.period for peak in found]) == pytest.approx(0.5 * period, rel=0.1)


def test_a_slow_sensor_is_searched_in_its_own_samples() -> None:
    """Every fifth row is measured: the period is in seconds all the same."""
    rng = np.random.default_rng(5)
    times = 0.1 * np.arange(3000)
    wave = np.cos(2 * np.pi * times / 6.0)
    series = np.full((3000, 1), np.nan)
    series[::5, 0] = rng.standard_normal(600) + wave[::5]
    channels = Channels((Input("u", "1"),), (Output("y", "1"),))
    record = Record("a", times, np.zeros((3000, 1)), series, channels)
    (peak,) = clear_peaks([series], [record], ["y"])
    assert peak.output == "y"
    assert peak.period == pytest.approx(6.0, rel=0.03)


def test_a_swell_that_is_no_sea_is_named_and_its_errors_are_wider(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where first-order forces stand for a swell: named, period found, errors nearer the truth."""
    monkeypatch.setattr(random_forces, "with_sea", lambda found, *_, **__: found)
    ours, bound, named, periods = [], [], [], []
    for fit, truth in fits("swell_6", range(12)):
        away = fit.estimates - truth
        ours.append(away / np.array([fit.std_errors[name] for name in fit.names]))
        bound.append(away / fit.information.std_errors)
        swings = [concern.size for concern in fit.concerns if concern.kind == "swing"]
        named.append(bool(swings))
        periods += swings
        assert np.all(np.diag(fit.covariance) >= (1 - 1e-9) * np.diag(fit.information.covariance))
        assert fit.coloured == bool(swings)
    assert np.mean(named) >= 0.5
    assert np.median(periods) == pytest.approx(6.0, rel=0.2)
    assert np.sqrt(np.mean(np.square(ours))) < 0.95 * np.sqrt(np.mean(np.square(bound)))


def test_forces_without_a_period_are_not_named() -> None:
    """First-order Gauss-Markov forces: no swing, and errors are the bound's."""
    for fit, _ in fits("medium", range(4)):
        assert not [concern for concern in fit.concerns if concern.kind == "swing"]
        assert np.array_equal(fit.covariance, fit.information.covariance)
