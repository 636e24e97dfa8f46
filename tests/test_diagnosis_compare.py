"""Comparison of models with records: numbers, words and where a misfit sits."""

from __future__ import annotations

import json

import numpy as np
import pytest

from oed_sysid import Force, Input, Model, MultipleShooting, Output, Parameter, Sensor, State
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import DataError
from oed_sysid.evidence.compare import Comparison, compare
from oed_sysid.evidence.forecasts import forecasts
from oed_sysid.evidence.improve import improve
from oed_sysid.evidence.misfit import Signal, concentrations, correlate, regimes

NOISE = np.array([0.01, 0.004])
CUBIC = Force(
    "cubic", {"r": "n3*r**3"}, (Parameter("n3", 0.0, "s/rad^2"),), description="cubic damping"
)
NOMINAL = Model(
    "turning ship",
    states=(State("psi", "rad", "heading"), State("r", "rad/s", "yaw rate", scale=0.1)),
    inputs=(Input("rudder", "rad", "rudder"),),
    outputs=(
        Output("psi", "rad", "heading", noise_std=NOISE[0]),
        Output("r", "rad/s", "yaw rate", noise_std=NOISE[1]),
    ),
    kinematics={"psi": "r", "r": "(K*rudder - r)/T"},
    parameters=(Parameter("K", 0.5, "1/s"), Parameter("T", 4.0, "s", lower=0.1)),
)


def record(
    name: str, seed: int, cubic: float, *, gap: bool = False, amplitude: float = 0.5
) -> Record:
    """A record by explicit Euler in small steps, independent of the package."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, 0.2)
    rudder = amplitude * np.sign(np.sin(2 * np.pi * t / (17.0 + seed))) * (t > 3)
    outputs = np.empty((len(t), 2))
    psi = r = 0.0
    for k, angle in enumerate(rudder):
        outputs[k] = psi, r
        for _ in range(200):
            psi += 0.001 * r
            r += 0.001 * ((0.5 * angle - r) / 4.0 + cubic * r**3)
    outputs += NOISE * rng.standard_normal(outputs.shape)
    if gap:
        outputs[50:80, 1] = np.nan
    return Record(name, t, rudder[:, None], outputs, NOMINAL.channels)


@pytest.fixture(scope="module")
def both() -> Comparison:
    """The believed and the true structure, fitted to two records, judged on two others."""
    train = Dataset((record("a", 1, -20.0), record("b", 2, -20.0, amplitude=0.25)))
    test = Dataset((record("c", 3, -20.0, gap=True), record("d", 5, -20.0)))
    fits = [
        MultipleShooting(disturbances="none").fit(model, train)
        for model in (NOMINAL, NOMINAL + CUBIC)
    ]
    return compare(fits, test)


def test_the_true_structure_leaves_noise_and_the_believed_one_does_not(both: Comparison) -> None:
    """Misfit, band, whiteness and verdict tell a right model from a wrong one."""
    wrong, right = both.models
    assert right.is_noise
    assert right.verdict.startswith("base + cubic: the misfit is noise")
    assert right.relative == pytest.approx(1.0, abs=0.06)
    assert not wrong.is_noise
    assert wrong.relative > 1.5
    assert both.best is right
    for good, bad in zip(right.outputs, wrong.outputs, strict=True):
        assert good.coverage == pytest.approx(0.95, abs=0.03)
        assert bad.coverage < 0.85
        assert bad.effective_samples < 0.6 * bad.n_samples


def test_numbers_are_those_of_the_residuals(both: Comparison) -> None:
    """RMSE, sample counts and windows agree with a direct calculation that skips gaps."""
    part = both[0]
    stacked = np.vstack(part.prediction.residuals)
    rate = part.output("r")
    assert rate.n_samples == 600 - 30
    assert rate.rmse == pytest.approx(float(np.sqrt(np.nanmean(stacked[:, 1] ** 2))))
    assert rate.relative == pytest.approx(rate.rmse / NOISE[1])
    first = part.prediction.residuals[0][:50, 1] / NOISE[1]
    assert len(rate.windows[0]) == 6
    assert rate.windows[0][0] == pytest.approx(np.sqrt(np.mean(first**2)))
    scaled = stacked / NOISE
    assert part.relative == pytest.approx(float(np.sqrt(np.nanmean(scaled**2))))


def test_words_name_where_the_misfit_sits(both: Comparison) -> None:
    """The verdict of a wrong model names outputs, a regime and is repeated in the report."""
    assert "yaw rate deviates by" in both[0].verdict or "heading deviates by" in both[0].verdict
    assert "Closest: base + cubic" in both.verdict
    report = both.report()
    assert both[0].verdict in report
    assert "10 s ahead" in report
    assert json.loads(json.dumps(both.to_dict()))["best"] == "base + cubic"


def test_forecasts_of_a_right_model_leave_what_is_expected(both: Comparison) -> None:
    """A right model's forecast error is one in its own standard deviations, a wrong one's more."""
    assert both[1].forecasts.overall == pytest.approx(1.0, abs=0.08)
    assert both[0].forecasts.overall > 1.3
    assert both[1].forecasts.n_forecasts == 10
    growth = both[0].forecasts.growth()
    assert growth.shape == (50, 2)
    assert np.mean(growth[-10:, 0]) > np.mean(growth[:10, 0])


def test_short_records_give_no_forecast() -> None:
    """A record shorter than one and a half horizons yields none, and nothing breaks."""
    short = Dataset((record("a", 1, 0.0).window(0.0, 10.0),))
    assert forecasts(NOMINAL, short, NOISE, horizon=10.0).n_forecasts == 0
    assert compare(NOMINAL, short, horizon=10.0).report()


def test_a_model_that_diverges_is_a_verdict_not_a_crash() -> None:
    """An unstable model is reported as diverging."""
    wild = NOMINAL + CUBIC.with_values({"n3": 500.0})
    found = compare(wild, Dataset((record("a", 1, 0.0),)))
    assert found[0].relative == np.inf
    assert "diverges" in found.verdict
    assert found.report()


def test_correlation_finds_signal_and_lag() -> None:
    """A residual that repeats a signal 1.4 s later is correlated with it at that lag."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 80.0, 0.2)
    series = np.convolve(rng.standard_normal(len(t) + 9), np.ones(10) / 10, "valid")
    residual = 0.5 * np.roll(series, 7) + 0.1 * rng.standard_normal(len(t))
    found = correlate([residual], Signal("u", "m/s", "", (series,), False), [t])
    assert found is not None
    assert found.lag == pytest.approx(1.4)
    assert found.is_clear
    assert found.value > 0.7


def test_chance_correlations_are_not_clear() -> None:
    """Coloured series that have nothing to do with each other rarely look related."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 60.0, 0.2)
    smooth = np.ones(20) / 20
    false = 0
    for _ in range(60):
        a, b = (np.convolve(rng.standard_normal(len(t) + 19), smooth, "valid") for _ in range(2))
        found = correlate([a], Signal("u", "", "", (b,), False), [t])
        assert found is not None
        false += found.is_clear
    assert false <= 1


def test_regimes_point_at_the_part_that_is_wrong() -> None:
    """Noise that grows while a rate is large is located there; even noise nowhere."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 200.0, 0.1)
    rate = np.sin(2 * np.pi * t / 23.0)
    signal = Signal("q", "rad/s", "pitch rate", (rate,), False)
    parts = regimes([signal], [t])
    uneven = rng.standard_normal(len(t)) * np.where(np.abs(rate) > 0.8, 3.0, 1.0)
    first = concentrations([uneven], parts)[0]
    assert first.is_clear
    assert first.words == "while pitch rate q is large (above 0.86 rad/s)"
    assert first.share_of_misfit > 2 * first.share_of_time
    assert not concentrations([rng.standard_normal(len(t))], parts)[0].is_clear


def test_seconds_after_a_command_are_a_regime() -> None:
    """Misfit after steps of an input is attributed to these seconds."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 200.0, 0.1)
    step = np.sign(np.sin(2 * np.pi * t / 40.0))
    since = t % 20.0
    signal = Signal("rudder", "rad", "rudder", (step,), True)
    residual = rng.standard_normal(len(t)) + 4.0 * np.exp(-since)
    first = concentrations([residual], regimes([signal], [t]))[0]
    assert first.words == "in the 2 s after rudder changes"


def test_empty_comparisons_are_refused() -> None:
    """Nothing to compare, and impossible horizons, are explained."""
    data = Dataset((record("a", 1, 0.0),))
    with pytest.raises(DataError, match="at least one fit"):
        compare([], data)
    with pytest.raises(DataError, match="above zero"):
        compare(NOMINAL, data, horizon=0.0)


def test_what_differs_from_record_to_record_is_estimated_on_each() -> None:
    """A gyro bias that is declared per record is neither misfit nor forecast error."""
    bias = Sensor(
        "bias", {"r": "r + b_r"}, (Parameter("b_r", 0.0, "rad/s", per_record=True, scale=0.01),)
    )
    first = record("a", 1, 0.0)
    second = record("b", 2, 0.0)
    shifted = second.with_outputs(second.outputs + np.array([0.0, 0.02]))
    found = compare({"biased": NOMINAL + bias, "plain": NOMINAL}, Dataset((first, shifted)))
    assert found["biased"].is_noise
    assert found["biased"].forecasts.overall == pytest.approx(1.0, abs=0.08)
    assert not found["plain"].is_noise
    assert found["biased"].prediction.local_values[1]["b_r"] == pytest.approx(0.02, abs=0.002)


def test_errors_of_a_search_and_of_a_comparison_are_the_same() -> None:
    """Declared levels measure both, though the search estimates its noise again."""
    train = Dataset((record("a", 1, -20.0), record("b", 2, -20.0, amplitude=0.25)))
    test = Dataset((record("c", 3, -20.0),))
    found = improve(NOMINAL, train, test, candidates=[CUBIC])
    assert not np.allclose(found.base_fit.noise.sensors, NOISE, rtol=1e-3)
    fits = {"nominal": found.base_fit, "improved": found.fit}
    by_default = compare(fits, test)
    np.testing.assert_array_equal(by_default.sigma, NOISE)
    errors = [found.base_error["test"], found.final_error["test"]]
    for same in (by_default, compare(fits, test, sigma=found.yardstick.sigma)):
        np.testing.assert_allclose([part.relative for part in same.models], errors, rtol=2e-3)
    doubled = compare(fits, test, sigma=2.0 * NOISE)
    np.testing.assert_allclose([2.0 * part.relative for part in doubled.models], errors, rtol=2e-3)
