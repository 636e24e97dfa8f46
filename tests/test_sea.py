"""Seas and waves: found where they act and nowhere else, declared, reported, kept and drawn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from golden_files import restored
from marks import slow
from scipy.signal import lfilter
from simple_models import nomoto

from benchmarks.random_forces.scenarios import SCENARIOS
from benchmarks.random_forces.simulator import simulate, true_values
from benchmarks.random_forces.trial import believed, dataset, nominal_model
from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Fit, Force, Model, Record, Sea, Solver, improve, load_problem
from oed_sysid.compiled.filtering import narrow_band
from oed_sysid.errors import ModelError
from oed_sysid.evidence.chance import threshold as threshold_forces
from oed_sysid.evidence.rank import Ranking, rank
from oed_sysid.evidence.score import lines
from oed_sysid.evidence.study import Study
from oed_sysid.experiments.simulation import simulate as simulate_forces
from oed_sysid.likelihood import random_forces, sea_search
from oed_sysid.likelihood.covariance import clear_peaks, spectral_peak
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_model import SHAPES, Levels, NoiseModel
from oed_sysid.likelihood.projection import gain_within
from oed_sysid.likelihood.realisation import drawn_disturbances, forces_of_sea
from oed_sysid.likelihood.score_test import Scored, Setting, moved, posed
from oed_sysid.likelihood.sea_search import threshold
from oed_sysid.physics import Parameter, wave_force
from oed_sysid.physics.channels import Channels, Input, Output

TRUE = {"K": 0.1, "T": 8.0}
WHITE = np.array([5e-3, 2e-3])
SHIP = nomoto(0.12, 6.0, noise=(5e-3, 2e-3), step=0.5)
LEVEL, PERIOD = 3e-3, 7.0
SEA = Sea(period=PERIOD, bandwidth=0.2, levels={"r": LEVEL})


def waves(times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Sixty cosines about the period, 10 % wide, of a standard deviation of one: no resonator."""
    angular = 2 * np.pi / PERIOD * rng.normal(1.0, 0.1, 60)
    phase = rng.uniform(0, 2 * np.pi, 60)
    return np.cos(np.outer(times, angular) + phase).sum(axis=1) / np.sqrt(30)


def resonator(times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The velocity of a damped oscillator under white noise, by small steps from rest."""
    step, w, z = times[1] - times[0], 2 * np.pi / PERIOD, 0.1
    before = 5000
    push = np.sqrt(4 * z * w * step) * rng.standard_normal(len(times) + before)
    a, b, values = 0.0, 0.0, []
    for draw in push:
        a += step * w * b
        b += draw - step * (w * a + 2 * z * w * b)
        values.append(b)
    return np.array(values[before:])


def gusts(times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A first-order process of 5 s and a standard deviation of one."""
    return gauss_markov(rng.standard_normal(len(times)), np.exp(-(times[1] - times[0]) / 5.0))


def swells(times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Waves, and others of 2.5 times their period."""
    return (waves(times, rng) + waves(times / 2.5, rng)) / np.sqrt(2)


ACTING = {"waves": waves, "resonator": resonator, "gusts": gusts, "swells": swells}


@cache
def records(force: str, seed: int, level: float = LEVEL) -> Dataset:
    """Two zigzags by the clock, integrated here with small Euler steps, sampled at 0.5 s."""
    rng = np.random.default_rng(seed)
    fine = np.arange(0.0, 150.0, 0.02)
    found = []
    for name, half in (("slow", 20.0), ("quick", 12.0)):
        rudder = 0.2 * np.where((fine // half) % 2 == 0, 1.0, -1.0)
        push = ACTING[force](fine, rng) if force else np.zeros_like(fine)
        psi, r = 0.0, 0.0
        states = []
        for delta, w in zip(rudder.tolist(), (level * push).tolist(), strict=True):
            states.append((psi, r))
            psi += 0.02 * r
            r += 0.02 * ((TRUE["K"] * delta - r) / TRUE["T"] + w)
        at = slice(None, None, 25)
        outputs = np.array(states)[at] + WHITE * rng.standard_normal((len(fine[at]), 2))
        found.append(Record(name, fine[at], rudder[at, None], outputs, SHIP.channels))
    return Dataset(found)


@pytest.fixture(scope="module")
def at_sea() -> Fit:
    """The default fit to records in waves."""
    return MultipleShooting().fit(SHIP, records("waves", 0))


def test_waves_are_named_with_their_period_and_level(at_sea: Fit) -> None:
    """Period within 10 %, level within 30 %, both with errors; values within their intervals."""
    (sea,) = at_sea.noise.seas
    assert sea.period == pytest.approx(PERIOD, rel=0.1)
    assert sea.levels["force r"] == pytest.approx(LEVEL, rel=0.3)
    assert 0.0 < at_sea.noise_std["sea period"] < 0.1
    for name, true in TRUE.items():
        assert abs(at_sea.values[name] - true) < 3 * at_sea.std_errors[name]


def test_a_sea_is_reported_and_survives_a_file(at_sea: Fit, tmp_path: Path) -> None:
    """Report and plain data tell period, width and significant amplitude; a saved fit is whole."""
    told = at_sea.report()
    assert "Disturbance forces have a period, as waves give them" in told
    assert "significant amplitude" in told
    (plain,) = at_sea.to_dict()["noise_model"]["seas"]
    (sea,) = at_sea.noise.seas
    assert plain["period"] == sea.period
    assert plain["significant"]["force r"] == pytest.approx(2 * float(sea.level[0]))
    assert restored(at_sea, tmp_path).noise.seas == at_sea.noise.seas
    assert Sea.from_dict(plain) == sea


def test_whole_runs_of_another_day_are_judged_in_its_own_sea(at_sea: Fit) -> None:
    """Waves twice as high, which those of the records of the fit would not have left."""
    other = at_sea.runs_on(records("waves", 7, 2.0 * LEVEL))
    assert np.abs(other.each("z")).max() < 3.0
    assert not other.objections


def test_a_later_fit_goes_on_with_the_sea(at_sea: Fit) -> None:
    """From an earlier fit the same values, and its sea, in fewer iterations."""
    again = MultipleShooting().fit(SHIP, at_sea.dataset, warm=at_sea)
    assert again.noise.seas[0].period == pytest.approx(at_sea.noise.seas[0].period, rel=0.02)
    assert again.iterations < at_sea.iterations
    for name in TRUE:
        assert abs(again.values[name] - at_sea.values[name]) < 0.1 * at_sea.std_errors[name]


@pytest.mark.parametrize("seed", [0, 1, *slow(2)])
@pytest.mark.parametrize("force", ["", "gusts"])
def test_no_sea_is_claimed_without_waves(force: str, seed: int) -> None:
    """White noise and a first-order process are no sea."""
    assert not MultipleShooting().fit(SHIP, records(force, seed)).noise.seas


UNDECLARED = nomoto(0.12, 6.0, noise=(None, None), step=0.5)


@cache
def sparsely(force: str, seed: int) -> Dataset:
    """Every second sample, seven in a wave."""
    taken = slice(None, None, 2)
    return Dataset(
        Record(one.name, one.times[taken], one.inputs[taken], one.outputs[taken], SHIP.channels)
        for one in records(force, seed)
    )


@pytest.mark.parametrize("disturbances", ["auto", *slow(Sea())])
@pytest.mark.parametrize("seed", [0, *slow(1, 2, 3)])
def test_waves_are_told_from_sensors_of_unknown_noise(seed: int, disturbances: str | Sea) -> None:
    """A white fit takes them for noise of the gyro, twice as large; slow forces cannot act there.

    A score at variance zero is of these: heading adds up what is slow in a force.
    """
    fit = MultipleShooting(disturbances=disturbances).fit(UNDECLARED, sparsely("waves", seed))
    assert fit.noise.seas[0].period == pytest.approx(PERIOD, rel=0.1)
    assert fit.sigma == pytest.approx(WHITE, rel=0.15)
    declared = MultipleShooting().fit(SHIP, sparsely("waves", seed))
    for name, error in declared.std_errors.items():
        assert abs(fit.values[name] - declared.values[name]) < 0.3 * error


@pytest.mark.parametrize("seed", [0, 1, *slow(2, 3)])
def test_white_sensors_of_unknown_noise_are_no_sea(seed: int) -> None:
    """Nothing is estimated but their noise."""
    fit = MultipleShooting().fit(UNDECLARED, sparsely("", seed))
    assert fit.noise.is_white
    assert fit.sigma == pytest.approx(WHITE, rel=0.15)


@pytest.mark.parametrize("number", [2, *slow(0, 3, 4, 5)])
def test_autocorrelated_noise_of_a_sensor_is_no_sea(number: int) -> None:
    """A pitch angle whose errors remember: a sea is asked for first, and is worth nothing beside.

    Its colour is found with its size.
    """
    scenario = SCENARIOS["colour_0.8"]
    model = nominal_model(scenario.vehicle)
    data = dataset(scenario, model, simulate(scenario, 0, [number])[0].runs)
    fit = MultipleShooting().fit(model, data)
    assert not fit.noise.seas
    assert fit.noise.is_white or not fit.noise.has_forces
    column = model.output_names.index("theta")
    total = np.hypot(fit.noise.white, fit.noise.colour)[column]
    assert fit.noise.colour[column] > 0.8 * total
    assert total == pytest.approx(model.outputs[column].noise_std, rel=0.25)


def test_the_constrained_program_ends_where_the_other_does(at_sea: Fit) -> None:
    """IPOPT finds the same sea, an equation in which no waves act included."""
    (sea,) = at_sea.noise.seas
    still = replace(at_sea.noise, seas=(replace(sea, levels={**sea.levels, "force u": 0.0}),))
    levels = Levels.of(still, still)
    assert np.isfinite(levels.vector()).all()
    assert len(levels) == len(Levels.of(at_sea.noise, at_sea.noise))
    program = MultipleShooting(solver=Solver("ipopt")).fit(SHIP, at_sea.dataset)
    assert program.status.ok
    assert program.noise.seas[0].period == pytest.approx(sea.period, rel=0.02)
    for name, error in at_sea.std_errors.items():
        assert abs(program.values[name] - at_sea.values[name]) < 0.2 * error


def test_a_declared_period_is_held_and_the_rest_estimated() -> None:
    """What is declared is known: the period stays, levels and width have errors."""
    declared = Sea(period=PERIOD, shape="velocity")
    fit = MultipleShooting(disturbances=declared).fit(SHIP, records("waves", 1))
    (sea,) = fit.noise.seas
    assert sea.period == PERIOD
    assert "sea period" not in fit.noise_std
    assert {"sea bandwidth", "sea force r level"} <= set(fit.noise_std)
    whole = MultipleShooting(disturbances=SEA).fit(SHIP, records("waves", 1))
    assert whole.noise.seas == (SEA,)


@pytest.mark.parametrize(
    "wrong", [{"period": -1.0}, {"bandwidth": 3.0}, {"levels": {"Z": -1.0}}, {"shape": "square"}]
)
def test_impossible_seas_are_refused(wrong: dict) -> None:
    """Errors name what is wrong."""
    with pytest.raises(ModelError, match=str(next(iter(wrong)))):
        Sea(**wrong)


def test_a_noise_model_needs_every_number_of_a_sea() -> None:
    """A sea to be estimated is no noise model."""
    with pytest.raises(ModelError, match="leaves numbers out"):
        NoiseModel(WHITE, 0 * WHITE, np.zeros(0), seas=(Sea(period=8.0),))


@pytest.mark.parametrize("shape", ["velocity", "displacement"])
def test_a_drawn_sea_has_the_spectrum_of_its_resonator(shape: str) -> None:
    """Mean of periodograms against the textbook's spectrum, within their scatter."""
    sea = Sea(period=8.0, bandwidth=0.3, levels={"r": 2.0}, shape=shape)
    rng = np.random.default_rng(3)
    times = 0.25 * np.arange(1024)
    window = np.hanning(len(times))
    drawn = [window * forces_of_sea(sea, times, rng)[:, 0] for _ in range(60)]
    power = np.mean(np.abs(np.fft.rfft(drawn)) ** 2, axis=0) / np.sum(window**2)
    w, w0, z = 2 * np.pi * np.fft.rfftfreq(len(times), 0.25), 2 * np.pi / 8.0, 0.15
    shaped = w**2 if shape == "velocity" else w0**2
    density = 4 * 4 * z * w0 * shaped / ((w0**2 - w**2) ** 2 + (2 * z * w0 * w) ** 2)
    near = (w > 0.7 * w0) & (w < 1.4 * w0)
    np.testing.assert_allclose(power[near], density[near] / 0.25, rtol=0.5)
    assert power[near].sum() == pytest.approx(density[near].sum() / 0.25, rel=0.1)
    low = (w > 0) & (w < 0.2 * w0)
    assert (power[low].mean() < 0.01 * power[near].max()) == (shape == "velocity")


def test_a_sea_of_fourth_order_is_nearest_to_the_spectrum_of_a_sea() -> None:
    """Of the three shapes its covariance is nearest to that of JONSWAP, level and peak as given."""
    f = np.linspace(0.02, 1.0, 4000)
    x = 8.0 * f
    peak = 3.3 ** np.exp(-((x - 1) ** 2) / 2 / np.where(x < 1, 0.07, 0.09) ** 2)
    density = x**-5.0 * np.exp(-1.25 * x**-4.0) * peak
    lags = np.linspace(0.0, 24.0, 97)
    true = np.cos(2 * np.pi * np.outer(lags, f)) @ density / density.sum()
    off = {}
    for shape, turn in SHAPES.items():
        own = [
            np.abs(narrow_band(lags, 8.0, z, turn)[:, 0, 0] - true).max()
            for z in np.linspace(0.05, 0.2, 16)
        ]
        off[shape] = min(own)
    assert off["jonswap"] < 0.07
    assert off["jonswap"] < 0.6 * min(off["velocity"], off["displacement"])


@pytest.mark.slow
@pytest.mark.parametrize("force", ["waves", "gusts"])
def test_improve_finds_a_sea_itself(force: str) -> None:
    """Waves are claimed as any effect is, and no term in their place; gusts are none."""
    kick = Force("kick", {"r": "k_kick*abs(r)*r"}, (Parameter("k_kick", 0.0, "1", scale=1.0),))
    train, test = records(force, 5), records(force, 6)
    test = Dataset(one.rename(f"{one.name} again") for one in test)
    found = improve(SHIP, train, test, candidates=[kick], terms=False)
    assert bool(found.base_fit.noise.seas) == (force == "waves")
    assert not found.steps
    asked = {one.name: one.stands for one in found.decisions}
    assert asked.get("a sea", False) == (force == "waves")
    rows = [row for row in found.report().splitlines() if row.startswith("a sea")]
    assert [row.endswith("stands") for row in rows] == [True] * (force == "waves")


def test_processes_in_one_place_add_up() -> None:
    """A force and a sea in one place act together, each with its own variance."""
    noise = NoiseModel(
        WHITE, 0 * WHITE, np.array([3.0]), force_time=2.0, outputs=("psi", "r"),
        places=("force r",), seas=(Sea(8.0, 0.2, {"r": 4.0}),),
    )  # fmt: skip
    rng = np.random.default_rng(0)
    (drawn,) = [drawn_disturbances(noise, 0.5 * np.arange(20000), rng)["force r"]]
    assert np.std(drawn) == pytest.approx(5.0, rel=0.05)


@pytest.mark.slow
def test_levels_far_above_their_unit_end_where_they_are_likeliest() -> None:
    """Variances twelve decades above where they began: from believed and true values, one end."""
    scenario = SCENARIOS["drone_swell"]
    one = simulate(scenario, 7000, [19])[0]
    model = nominal_model("drone").with_values(believed(scenario))
    data = dataset(scenario, model, one.runs)
    fit = MultipleShooting().fit(model, data)
    other = MultipleShooting().fit(model.with_values(one.truth), data)
    for name, error in fit.std_errors.items():
        assert abs(fit.values[name] - other.values[name]) < 0.02 * error


def test_every_peak_of_the_test_is_a_period_to_begin_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two swells at once: both periods are tried, and the likelier end is the fit's."""
    tried: list[list[float]] = []
    ends: list[FilteredSolution] = []
    periods, at_sea = sea_search._likely_periods, sea_search._at_sea

    def kept(*given: object) -> list[float]:
        tried.append(periods(*given))
        return tried[-1]

    def ended(*given: object) -> FilteredSolution:
        ends.append(at_sea(*given))
        return ends[-1]

    monkeypatch.setattr(sea_search, "_likely_periods", kept)
    monkeypatch.setattr(sea_search, "_at_sea", ended)
    fit = MultipleShooting().fit(SHIP, records("swells", 0, 2 * LEVEL))
    (found,) = tried
    assert len(found) == 2
    for period, peak in zip((PERIOD, 2.5 * PERIOD), found, strict=True):
        assert abs(np.log(peak / period)) < 0.5 * np.log(sea_search.NEXT_PERIOD) + 0.1
    best = min(ends, key=lambda one: one.restricted)
    assert fit.noise.seas[0].period == pytest.approx(best.noise.seas[0].period, rel=0.05)


def test_a_test_of_one_more_level_is_that_of_all_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    """What resonators at variance zero gain by one pass of their own tangents, and by all."""
    ends: list[tuple[FilteredSolution, Setting]] = []

    def kept(found: FilteredSolution, setting: Setting, *_: object) -> FilteredSolution:
        ends.append((found, setting))
        return found

    monkeypatch.setattr(random_forces, "with_sea", kept)
    MultipleShooting().fit(SHIP, records("waves", 1))
    ((found, setting),) = ends
    for period in (4.0, PERIOD, 20.0):
        nothing = Sea(period, 0.3, {"r": 0.0}, "velocity")
        noise, known = replace(found.noise, seas=(nothing,)), [replace(nothing, levels=None)]
        wide = posed(found, setting, noise, seas=known, longest_hold=0.5)
        gain, _ = Scored.at(found, 0.5).gain(wide, ["sea force r level"])
        still = moved(found, wide, 0)
        unknowns, limits = still.point.unknowns, wide.limits
        equations = limits.with_priors(still.matrix, still.right, unknowns)
        lower, upper = limits.lower - unknowns, limits.upper - unknowns
        _, both = gain_within(*equations, lower, upper)
        new = wide.layout.levels.start + wide.levels.names.index("sea force r level")
        lower[new] = upper[new] = 0.0
        _, without = gain_within(*equations, lower, upper)
        # But for the wide prior of the time of forces, whose middle is where levels begin.
        assert gain == pytest.approx(both - without, rel=5e-3, abs=0.05)
        assert (gain > 20.0) == (period == PERIOD)


def looked_at(series: list[np.ndarray], periods: list[float], step: float) -> np.ndarray:
    """Periods ``(n_periods,)`` at which innovations of one output may show a sea."""
    records = [SimpleNamespace(independent=False, duration=step * (len(one) - 1)) for one in series]
    parts = [
        SimpleNamespace(innovations=one[:, None], variances=np.full((len(one), 1), 4.0))
        for one in series
    ]
    problem = SimpleNamespace(records=records, passes=lambda *_, **__: parts)
    found = SimpleNamespace(problem=problem, point=SimpleNamespace(unknowns=None))
    calm = [Sea(one, bandwidth=0.3, levels={"r": 0.0}, shape="velocity") for one in periods]
    return sea_search._in_spectrum(found, calm)


def test_a_look_at_white_innovations_leads_on_as_seldom_as_it_says() -> None:
    """Two records, a fifth of the second missing: 5 % of the looks at each of four periods."""
    rng, shown = np.random.default_rng(5), []
    for _ in range(1000):
        series = [2.0 * rng.standard_normal(n) for n in (400, 300)]
        series[1][rng.random(300) < 0.2] = np.nan
        shown.append(looked_at(series, [4.0, 8.0, 16.0, 32.0], 0.5))
    assert np.mean(shown, axis=0) == pytest.approx(0.05, abs=0.025)


@pytest.mark.parametrize("period", [5.0, 12.0])
def test_a_look_at_innovations_in_waves_shows_their_period(period: float) -> None:
    """A band of a third of the power of the white noise, of which half of the samples are left."""
    rng, times = np.random.default_rng(6), 0.5 * np.arange(600)
    for _ in range(20):
        phase = 2 * np.pi * np.outer(times, rng.uniform(0.93, 1.07, 30)) / period
        swell = np.cos(phase + rng.uniform(0, 2 * np.pi, 30)).sum(axis=1) / np.sqrt(15.0)
        series = 2.0 * (rng.standard_normal(600) + swell / np.sqrt(3.0))
        series[rng.random(600) < 0.5] = np.nan
        shown = looked_at([series], [period, 0.2 * period, 4.0 * period], 0.5)
        assert shown[0]


def test_threshold_is_the_tail_of_signed_normals() -> None:
    """Of sums of squares of positive parts, drawn here, the stated share is beyond it."""
    draws = np.maximum(np.random.default_rng(0).standard_normal((400_000, 3)), 0.0)
    share = np.mean(np.sum(draws**2, axis=1) > threshold(3, 1))
    assert share == pytest.approx(0.01, rel=0.15)


def narrow(rng: np.random.Generator, n: int, period: float) -> np.ndarray:
    """Unit white noise through a lightly damped resonance of a period in samples, unit variance."""
    pole = 0.985 * np.exp(2j * np.pi / period)
    wave = lfilter([1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(n + 800))
    return np.asarray(wave[800:] / wave[800:].std())


def fits(name: str, numbers: range) -> Iterator[tuple[Fit, np.ndarray]]:
    """Fits of data sets of the benchmark, and their true parameters."""
    scenario = SCENARIOS[name]
    model = nominal_model(scenario.vehicle).with_values(believed(scenario))
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


@pytest.mark.slow
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
        swings = [concern.size for concern in fit.concerns if concern.kind == "narrow_band"]
        named.append(bool(swings))
        periods += swings
        assert np.all(np.diag(fit.covariance) >= (1 - 1e-9) * np.diag(fit.information.covariance))
        assert fit.coloured == bool(swings)
    assert np.mean(named) >= 0.5
    assert np.median(periods) == pytest.approx(6.0, rel=0.2)
    assert np.sqrt(np.mean(np.square(ours))) < 0.95 * np.sqrt(np.mean(np.square(bound)))


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_forces_without_a_period_are_not_named(number: int) -> None:
    """First-order Gauss-Markov forces: no swing, and errors are the bound's."""
    for fit, _ in fits("medium", range(number, number + 1)):
        assert not [concern for concern in fit.concerns if concern.kind == "narrow_band"]
        assert np.array_equal(fit.covariance, fit.information.covariance)


AUV = load_problem("remus_diving_plane")
SHIP_FORCES = load_problem("kvlcc2", variant="mmg")
# Sizes of a wave in each equation, N and N m, that move the vehicle by some noise levels.
SIZES = {"X": 0.4, "Z": 1.0, "M": 0.3}, {"X": 6.0, "Y": 12.0, "N": 20.0}


def ranked(problem: object, sizes: dict[str, float], axis: str, omega: float) -> Ranking:
    """Waves as candidates in every equation of a vehicle that one acts on, 400 s long."""
    model: Model = problem.model  # type: ignore[attr-defined]
    runs = [replace(e, duration=400.0) for e in list(problem.experiments.values())[:2]]  # type: ignore[attr-defined]
    waves = {a: wave_force(f"wave_{a}", a, frequency=0.6, scale=s) for a, s in sizes.items()}
    truth = model
    if axis:
        present = {f"E_wave_{axis}_cos": sizes[axis], f"omega_wave_{axis}": omega}
        truth = model + waves[axis].with_values(present)
    records = []
    for index, run in enumerate(runs):
        seen = simulate_forces(truth, run, noise=True, rng=np.random.default_rng([3, index]))
        records.append(
            Record(f"run_{index}", seen.times, seen.inputs, seen.outputs, model.channels)
        )
    study, fit = Study.begin(
        model, Dataset(records), None, tuple(waves.values()), known_noise=True, disturbances="none"
    )
    return rank(study, fit, study.candidates)


OMEGAS = 0.713, 0.476  # between the grid's frequencies
QUICK = ("N", 0)
CASES = [
    (vehicle, own, axis)
    for vehicle, own in zip((AUV, SHIP_FORCES), SIZES, strict=True)
    for axis in own
]


@pytest.mark.parametrize(
    ("problem", "sizes", "axis", "omega"),
    [
        pytest.param(*case, omega, marks=() if (case[2], j) == QUICK else pytest.mark.slow)
        for case in CASES
        for j, omega in enumerate(OMEGAS)
    ],
)
def test_wave_is_named_where_it_acts(
    problem: object, sizes: dict[str, float], axis: str, omega: float
) -> None:
    """The right equation is first, alone in its group, and the frequency right."""
    found = ranked(problem, sizes, axis, omega)
    best = found.refits[0]
    assert best.name == f"wave_{axis}"
    assert best.gain > best.needed
    assert [one.name for one in found.group()] == [f"wave_{axis}"]
    assert best.fit.values[f"omega_wave_{axis}"] == pytest.approx(omega, abs=0.004)
    # The score alone is most of the refit's gain: its frequency was not missed.
    assert best.score.statistic > 0.5 * best.gain


@pytest.mark.parametrize(("problem", "sizes"), [*slow((AUV, SIZES[0])), (SHIP_FORCES, SIZES[1])])
def test_no_wave_is_found_where_there_is_none(problem: object, sizes: dict[str, float]) -> None:
    """The best of many frequencies gains by chance; what a claim needs counts them."""
    found = ranked(problem, sizes, "", 0.0)
    assert all(one.gain < one.needed for one in found.refits)
    for score in found.scores:
        assert score.trials == pytest.approx(0.48 * 400.0 / (2 * np.pi), rel=0.01)
        assert found.needed_by(score) > threshold_forces(len(sizes), score.freedom)


@pytest.mark.parametrize("count", [100, *slow(200)])
def test_chance_of_the_best_frequency(count: int) -> None:
    """In white noise the best line passes what a claim needs no oftener than it should."""
    t = np.arange(0.0, 600.0, 1.0)
    trials = 0.5 * 600.0 / (2 * np.pi)
    strict, loose = 0, 0
    for seed in range(count):
        noise = np.random.default_rng([9, seed]).standard_normal((len(t), 1))
        (omega, *_) = lines([t], [noise], 0.4, 0.9)
        power = 2.0 * abs(np.exp(-1j * omega * t) @ noise[:, 0]) ** 2 / len(t)
        strict += power > threshold_forces(1, 3, 0.05, trials=trials)
        loose += power > threshold_forces(1, 3, 0.05)
    assert strict <= 0.05 * count
    assert loose > 0.3 * count


def test_lines_are_none_where_a_record_is_short() -> None:
    """A record shorter than a swing tells no frequency."""
    t = np.arange(0.0, 4.0, 0.5)
    assert len(lines([t], [np.ones((len(t), 1))], 0.4, 0.6)) == 0
