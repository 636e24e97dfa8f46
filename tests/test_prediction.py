"""Predictions of manoeuvres, with their uncertainty."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from altered import with_inputs
from motion import small
from simple_models import nomoto
from turning_ship import record as turning_record
from yaw_vehicle import NOISE, TRUE, simulate_yaw, yaw_data, yaw_model, yaw_record

from oed_sysid import Dataset, Experiment, Fit, Force, Input, Model, Parameter, Record, simulate
from oed_sysid.baselines import EquationError, MultipleShooting
from oed_sysid.errors import DataError, ModelError, SimulationError
from oed_sysid.experiments.manoeuvres import Piecewise, ZigZag
from oed_sysid.likelihood.captive import CaptiveTests
from oed_sysid.physics import actuator_offset, sensor_bias
from oed_sysid.prediction.speed_polar import SailingNames, speed_polar
from oed_sysid.prediction.turning_circle import turning_circle
from oed_sysid.results import new_figure, plot_polar, plot_prediction_error
from problems.kvlcc2.averaging import Structure, average_structures, ladder, peak_input


@pytest.fixture(scope="module")
def fit() -> Fit:
    """A fit to a short record, so that its uncertainty matters."""
    data = Dataset((yaw_record("train", np.random.default_rng(0), n=80),))
    return MultipleShooting(noise=NOISE, coloured="never").fit(yaw_model(), data)


def new_record(seed: int, **options: object) -> Dataset:
    """A record that the fit has not seen."""
    rng = np.random.default_rng(100 + seed)
    return Dataset((yaw_record("test", rng, n=150, period=50.0, **options),))


def test_given_initial_state_is_used_as_it_is(fit: Fit) -> None:
    """With the state given, the prediction is the plain simulation."""
    data = new_record(0)
    prediction = fit.predict(data, initial={"psi": 0.1, "r": 0.01})
    record = data[0]
    expected = simulate_yaw(record.times, record.inputs[:, 0], np.array([0.1, 0.01]), fit.values)
    assert np.allclose(prediction.outputs[0], expected, atol=1e-10)
    assert np.all(prediction.model_std[0][0] < 1e-12)


def test_estimated_initial_state_is_the_least_squares_one(fit: Fit) -> None:
    """With parameters held, the initial state minimises the misfit on that record."""
    data = new_record(1)
    prediction = fit.predict(data)
    own = np.array(list(prediction.initial_states[0].values()))
    record = data[0]

    def cost(start: np.ndarray) -> float:
        model = simulate_yaw(record.times, record.inputs[:, 0], start, fit.values)
        return float(np.sum(((record.outputs - model) / NOISE) ** 2))

    for change in np.vstack([np.eye(2), -np.eye(2)]) * 1e-4:
        assert cost(own) < cost(own + change)
    assert prediction.way == "fit"
    assert "all shared parameters held" in prediction.report()


def test_errors_are_measured_by_all_noise_of_a_sensor(fit: Fit) -> None:
    """Where most noise is autocorrelated, errors are not told in units of the little white part."""
    white = fit.noise.white
    noise = replace(fit.noise, white=0.1 * white, colour=white, colour_time=np.full(2, 5.0))
    prediction = replace(fit, noise=noise).predict(fit.dataset)
    np.testing.assert_allclose(prediction.sensors, np.hypot(0.1, 1.0) * white)
    (line, *_) = (
        one for one in plot_prediction_error(prediction, "r").get_lines() if one.get_rasterized()
    )
    np.testing.assert_allclose(
        line.get_ydata(), prediction.residuals[0][:, 1] / prediction.sensors[1]
    )


@pytest.mark.slow
def test_bands_are_those_of_a_monte_carlo() -> None:
    """Model bands equal the spread of predictions over many training sets."""
    target = new_record(2, noise=np.zeros(2))
    given = {"psi": 0.1, "r": 0.01}
    predictions, stds = [], []
    for seed in range(150):
        train = Dataset((yaw_record("train", np.random.default_rng(seed), n=80),))
        fit = MultipleShooting(noise=NOISE, coloured="never").fit(yaw_model(), train)
        prediction = fit.predict(target, initial=given)
        predictions.append(prediction.outputs[0])
        stds.append(prediction.model_std[0])
    spread, stated = np.std(predictions, axis=0), np.median(stds, axis=0)
    late = slice(20, None)
    assert np.median(stated[late] / spread[late]) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("initial", ["fit", "first"])
def test_bands_cover_new_measurements(fit: Fit, initial: str) -> None:
    """Bands of model and noise cover about 95 % of new samples."""
    shares = []
    for seed in range(30):
        shares.append(fit.predict(new_record(seed), initial=initial).coverage())
    for name in ("psi", "r"):
        mean = np.mean([share[name] for share in shares])
        # From a single sample the whole record errs together: thirty records say less.
        assert mean > (0.92 if initial == "fit" else 0.85)
        assert initial == "first" or mean < 0.98


def test_prediction_knows_missing_samples(fit: Fit) -> None:
    """Outputs are predicted at every time; only measured samples count in the errors."""
    record = new_record(3)[0]
    outputs = record.outputs.copy()
    outputs[:, 1] = np.nan
    outputs[::2, 0] = np.nan
    prediction = fit.predict(Dataset((record.with_outputs(outputs),)))
    assert np.isfinite(prediction.outputs[0]).all()
    assert np.isfinite(prediction.std[0]).all()
    assert np.isnan(prediction.rms["r"])
    assert prediction.rms["psi"] < 2 * NOISE[0]


def test_training_record_is_reproduced(fit: Fit) -> None:
    """On its own record the prediction is the fit."""
    prediction = fit.predict(fit.dataset)
    assert np.allclose(prediction.outputs[0], fit.predictions[0], atol=1e-6)


@pytest.mark.parametrize(
    ("initial", "words"),
    [("last", "Choose 'fit'"), ({"psi": 0.0}, "value for each"), ({"yaw": 0.0}, "value for each")],
)
def test_unclear_initial_states_are_refused(fit: Fit, initial: object, words: str) -> None:
    """What the prediction starts from has to be clear."""
    with pytest.raises(DataError, match=words):
        fit.predict(new_record(0), initial=initial)


def test_identifiable_combination_predicts_with_finite_bands() -> None:
    """A parameter that does not matter leaves bands finite; one that does makes them infinite."""
    data = yaw_data(5)
    model = yaw_model()
    still = with_inputs(data, lambda record: 0 * record.inputs)
    fit = MultipleShooting(noise=NOISE, coloured="never").fit(model, still)
    assert np.isinf(fit.std_errors["K"])
    assert np.isfinite(fit.predict(still).std[0]).all()
    assert np.isinf(fit.predict(data).std[0]).any()
    assert TRUE["K"] > 0


SHOOTING = MultipleShooting(disturbances="none")
TIMES = np.arange(0.0, 10.0, 0.2)


def body(drag: str, *parameters: str) -> Model:
    """A body that slows down."""
    force = Force("drag", {"X": drag}, tuple(Parameter(name, 1.0, "1") for name in parameters))
    inertia = {("X", "u"): "10"}
    return small(drag, "u [m/s]", noise=0.01, axes={"X": "u"}, inertia=inertia, effects=(force,))


LINEAR = Structure("linear", body("-a*u", "a"), SHOOTING)
QUADRATIC = Structure("quadratic", body("-b*u*abs(u)", "b"), SHOOTING)
CUBIC = Structure("cubic", body("-d*u**3", "d"), SHOOTING)


def runs(*speeds: float) -> Dataset:
    """Quadratic drag of 2 kg/m, integrated in closed form, with noise."""
    rng = np.random.default_rng(0)
    records = []
    for speed in speeds:
        clean = speed / (1 + 0.2 * speed * TIMES[:, None])
        noisy = clean + 0.01 * rng.standard_normal(clean.shape)
        empty = np.empty((len(TIMES), 0))
        records.append(Record(f"from {speed}", TIMES, empty, noisy, LINEAR.model.channels))
    return Dataset(records)


def resistance(fit) -> dict[str, float]:
    """Resistance at 4 m/s, twice the strongest record."""
    powers = {"a": 4.0, "b": 16.0, "d": 64.0}
    return {"resistance": sum(fit.values[name] * powers[name] for name in fit.names)}


def first(run: Record) -> float:
    """Strength: speed at the start."""
    return float(run.output("u")[0])


def test_the_right_structure_carries_the_average() -> None:
    """Weights are the scores to minus the fourth, and the interval holds the truth."""
    average = average_structures(
        (LINEAR, QUADRATIC, CUBIC),
        runs(0.5, 1.0, 1.5, 2.0),
        purpose=resistance,
        strength=first,
        horizon=5.0,
    )
    best = average.structures[0]
    assert best.name == "quadratic"
    assert best.weight > 0.9
    low, high = average.interval("resistance")
    assert low < 32.0 < high
    scores = np.array([one.score for one in average.structures])
    weights = np.array([one.weight for one in average.structures])
    assert weights == pytest.approx(scores**-4.0 / np.sum(scores**-4.0))
    expected = sum(one.weight * one.values["resistance"] for one in average.structures)
    assert average.values["resistance"] == pytest.approx(expected)
    spread = average.between["resistance"] ** 2 + average.within["resistance"] ** 2
    floor = 0.015 * average.values["resistance"]
    assert average.std["resistance"] == pytest.approx(np.sqrt(spread + floor**2))
    assert json.loads(json.dumps(average.to_dict()))["structures"][0]["name"] == "quadratic"


def test_forces_nobody_fitted_decide_where_records_cannot() -> None:
    """Slow runs alone leave the power open; a towing test at 4 m/s closes it."""
    slow = runs(0.5, 0.55, 0.6)
    towing = CaptiveTests("towing", {"u": [3.0, 4.0]}, {}, {"X": [-18.0, -32.0]}, {"X": 0.5})
    settings = {"purpose": resistance, "strength": first, "horizon": 5.0}
    without, with_tests = (
        average_structures((LINEAR, QUADRATIC), slow, tests=tests, **settings)
        for tests in (None, towing)
    )
    share = [
        next(one.weight for one in average.structures if one.name == "quadratic")
        for average in (without, with_tests)
    ]
    assert share[1] > share[0]
    errors = [abs(average.values["resistance"] - 32.0) for average in (without, with_tests)]
    assert errors[1] < errors[0]


def test_what_fails_weighs_nothing_and_is_named() -> None:
    """A purpose that one structure cannot serve takes it out of the average."""

    def picky(fit) -> dict[str, float]:
        if fit.names == ("a",):
            raise SimulationError("It never turns. Look elsewhere.")
        return resistance(fit)

    data = runs(0.5, 1.0, 2.0)
    average = average_structures(
        (LINEAR, QUADRATIC), data, purpose=picky, strength=first, horizon=5.0
    )
    assert [one.weight for one in average.structures] == pytest.approx([1.0, 0.0])
    assert average.structures[1].note == "It never turns"
    assert average.between["resistance"] == 0.0
    with pytest.raises(ModelError, match="No structure gives"):
        average_structures((LINEAR, LINEAR), data, purpose=picky, strength=first, horizon=5.0)


def test_the_ladder_goes_from_weak_to_strong() -> None:
    """Records of one strength stay together, three rungs at most, the strongest never trained."""
    data = runs(0.5, 0.51, 1.0, 1.5, 2.0, 2.5)
    rungs = ladder(data, first)
    assert [len(weaker) for weaker, _ in rungs] == [3, 4, 5]
    assert all("from 2.5" in stronger for _, stronger in rungs)
    with pytest.raises(DataError, match="No two records"):
        ladder(runs(1.0, 1.001), first)
    zigzag = turning_record("zigzag", np.random.default_rng(0))
    assert peak_input("rudder")(zigzag) == 0.5


def test_judges_are_not_trained_on() -> None:
    """A structure that was fitted to the tests may not be judged by them."""
    towing = CaptiveTests("towing", {"u": [3.0, 4.0]}, {}, {"X": [-18.0, -32.0]}, {"X": 0.5})
    informed = Structure("informed", QUADRATIC.model, SHOOTING, towing)
    settings = {"purpose": resistance, "strength": first, "horizon": 5.0}
    data = runs(0.5, 1.0, 2.0)
    with pytest.raises(ModelError, match="shall judge"):
        average_structures((informed, LINEAR), data, tests=towing, **settings)
    both = average_structures((informed, LINEAR), data, **settings)
    assert both.structures[0].name == "informed"
    assert both.values["resistance"] == pytest.approx(32.0, rel=0.02)


def test_copies_and_parts_of_the_judges_are_recognised() -> None:
    """Tests are compared by what they hold: motion, inputs and a force, not by who holds them."""
    towing = CaptiveTests("towing", {"u": [3.0, 4.0]}, {}, {"X": [-18.0, -32.0]}, {"X": 0.5})
    part = CaptiveTests("half", {"u": [4.0, 5.0]}, {}, {"X": [-32.0, -50.0]}, {"X": 1.0})
    again = CaptiveTests("again", {"u": [3.0, 4.0]}, {}, {"X": [-18.3, -31.8]}, {"X": 0.5})
    assert [towing.shared(other) for other in (towing, part, again)] == [2, 1, 0]
    settings = {"purpose": resistance, "strength": first, "horizon": 5.0}
    data = runs(0.5, 1.0, 2.0)
    for fitted, words in ((part, "1 of the 2 tests"), (towing, "2 of the 2 tests")):
        copy = CaptiveTests("copy", fitted.motions, {}, fitted.forces, fitted.noise)
        informed = Structure("informed", QUADRATIC.model, SHOOTING, copy)
        with pytest.raises(ModelError, match=words):
            average_structures((informed, LINEAR), data, tests=towing, **settings)
    repeated = Structure("repeated", QUADRATIC.model, SHOOTING, again)
    found = average_structures((repeated, LINEAR), data, tests=towing, **settings)
    assert found.structures[0].name == "repeated"


def of_zero(fit) -> dict[str, float]:
    """A wanted quantity, and one that is zero."""
    return {**resistance(fit), "side": 0.0}


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"purpose": of_zero}, "Quantity 'side' is 0 with structure 'linear'"),
        ({"purpose": lambda fit: {}}, "gives no quantity"),
        ({"purpose": lambda fit: fit.values}, "gives a with structure 'linear' and b with"),
        ({"scored": ["resistence"]}, "'resistence'.* Did you mean 'resistance'"),
        ({"floor": -0.5}, "floor is -0.5. Give a share"),
        ({"horizon": 0.0}, "horizon 0; it must be above zero. Give seconds"),
    ],
)
def test_settings_that_give_no_weights_are_refused(settings: dict, words: str) -> None:
    """Nothing about zero, no unknown or differing quantity is averaged."""
    usual = {"purpose": resistance, "strength": first, "horizon": 5.0, **settings}
    with pytest.raises(ModelError, match=words):
        average_structures((LINEAR, QUADRATIC), runs(0.5, 1.0, 2.0), **usual)


def test_what_is_about_zero_may_be_wanted_and_not_scored() -> None:
    """The report leaves shares of nothing out."""
    usual = {"purpose": of_zero, "strength": first, "horizon": 5.0}
    average = average_structures(
        (LINEAR, QUADRATIC), runs(0.5, 1.0, 2.0), scored=["resistance"], **usual
    )
    assert average.values["side"] == 0.0
    (line,) = [line for line in average.report().splitlines() if line.startswith("  side")]
    assert line.split()[1:] == ["0", "0", "to", "0", "-", "-", "-"]


# Thrust ~ wind^2 sin(angle) with a quadratic optimum at 0.6 rad of sheet; drag ~ drag*u^2.
CART = small(
    "land yacht",
    "u [m/s], r [rad/s], psi [rad] <- delta [rad], sheet [rad], wind_speed [m/s], wind_from [rad]",
    {
        "u": "(sin(wind_from - psi)*wind_speed**2*(1 - (sheet - 0.6)**2) - drag*u*abs(u))/10",
        "r": "delta - 0.1 - r",
        "psi": "r",
    },
    [Parameter("drag", 4.0, "kg/m", lower=0.1)],
    {"u": 0.01, "r": 1e-3, "psi": 1e-3},
)
ANGLES = np.radians([30.0, 60.0, 90.0])
SHEETS = (0.2, 0.6, 1.0)


def test_speed_is_that_of_the_balance() -> None:
    """Thrust equals drag: u = wind*sqrt(sin(angle)/drag), at the sheet of most thrust."""
    polar = speed_polar(CART, wind_speed=5.0, angles=ANGLES, sheets=SHEETS)
    assert polar.speeds == pytest.approx(5.0 * np.sqrt(np.sin(ANGLES) / 4.0), rel=1e-6)
    assert polar.sheets == pytest.approx(0.6)
    assert polar.states["delta"] == pytest.approx(0.1)
    assert "land yacht" in polar.report()


def test_band_follows_the_uncertainty_of_the_fit() -> None:
    """Speed goes with drag to the power -1/2: its relative spread is half that of the drag."""
    run = Experiment(
        "gusts",
        Piecewise("wind_speed", (0.0, 10.0, 20.0), (3.0, 6.0, 4.0)),
        duration=30.0,
        sample_time=0.5,
        constants={"delta": 0.1, "sheet": 0.6, "wind_from": 1.5},
        initial={"u": 1.0},
    )
    data = Dataset((simulate(CART, run, rng=np.random.default_rng(3)),))
    fit = EquationError(coloured="never").fit(CART, data)
    polar = speed_polar(fit, wind_speed=5.0, angles=ANGLES, sheets=SHEETS, n_draws=100)
    share = fit.std_errors["drag"] / fit.values["drag"]
    low, high = polar.interval(0.95)
    assert (high - low) / polar.speeds == pytest.approx(2 * 1.96 * share / 2, rel=0.2)
    assert np.all((low < polar.speeds) & (polar.speeds < high))
    plain = speed_polar(fit.model, wind_speed=5.0, angles=ANGLES, sheets=SHEETS)
    assert np.isnan(plain.interval()[0]).all()
    ax = plot_polar(polar, truth=plain)
    assert np.allclose(ax.lines[0].get_ydata(), polar.speeds)
    assert "m/s" in ax.get_title()


def test_no_wind_from_ahead_is_said() -> None:
    """Straight into the wind nothing drives: no speed, and the table says none."""
    polar = speed_polar(CART, wind_speed=5.0, angles=[-0.5], sheets=SHEETS)
    assert math.isnan(polar.speeds[0])
    assert "none" in polar.report()
    assert polar.to_dict()["speeds"] == [None]


def test_missing_channels_are_named() -> None:
    """Other names of channels can be told, and a wrong one is named."""
    renamed = replace(CART, name="without a sheet", inputs=CART.inputs)
    with pytest.raises(ModelError, match="no input 'main_sheet'"):
        speed_polar(
            renamed,
            wind_speed=5.0,
            angles=ANGLES,
            sheets=SHEETS,
            names=SailingNames(sheet="main_sheet"),
        )
    with pytest.raises(ModelError, match="at least one angle"):
        speed_polar(CART, wind_speed=5.0, angles=[], sheets=SHEETS)


def test_polar_needs_polar_axes() -> None:
    """Square axes are refused with words."""
    polar = speed_polar(CART, wind_speed=5.0, angles=ANGLES[:1], sheets=SHEETS)
    _, axes = new_figure(1, 1, size=(3, 3))
    with pytest.raises(DataError, match="polar axes"):
        plot_polar(polar, ax=axes[0, 0])


NOMOTO = nomoto(0.1, 8.0, noise=(0.002, 0.0005), step=0.2)
# A body that loses speed in the turn and drifts, with known steady values.
DRIFTING = small(
    "drifting ship",
    "u [m/s], v [m/s], r [rad/s], psi [rad] <- rudder [rad]",
    {
        "u": "(2.0 - 10.0*abs(rudder) - u)/5",
        "v": "(-2.0*r - v)/3",
        "r": "(-0.1*rudder - r)/4",
        "psi": "r",
    },
    noise={"psi": None},
    scales={"v": 0.1, "r": 0.02},
    interpolation="linear",
    step=0.2,
)


@pytest.fixture(scope="module")
def fit_turning():
    """A Nomoto model fitted to a zigzag."""
    test = Experiment("zigzag", ZigZag("rudder", 0.2, 0.1), duration=150.0, sample_time=0.5)
    record = simulate(NOMOTO, test, rng=np.random.default_rng(4))
    return MultipleShooting(disturbances="none").fit(NOMOTO, Dataset((record,)))


def test_steady_turn_of_nomoto_is_a_circle_of_known_size() -> None:
    """Without speed loss the diameter is 2 U/(K delta); the lag adds U T to the advance."""
    circle = turning_circle(NOMOTO, speed=2.0, rudder=0.3)
    radius = 2.0 / (0.1 * 0.3)
    for side in ("starboard", "port"):
        assert circle.value("steady_diameter", side) == pytest.approx(2 * radius, rel=1e-4)
        assert circle.value("advance", side) == pytest.approx(radius + 2.0 * 8.0, rel=0.05)
        assert circle.value("speed_ratio", side) == pytest.approx(1.0, abs=1e-9)
        assert circle.value("drift", side) == pytest.approx(0.0, abs=1e-3)
    assert circle.value("advance", "port") == pytest.approx(circle.value("advance", "starboard"))


def test_speed_loss_and_drift_come_from_the_model() -> None:
    """Steady speed, drift angle and radius agree with the steady state by hand."""
    circle = turning_circle(DRIFTING, speed=2.0, rudder=0.1, side="port", length=4.0)
    surge, rate = 2.0 - 10.0 * 0.1, 0.1 * 0.1
    sway = 2.0 * rate
    speed = math.hypot(surge, sway)
    assert circle.sides == ("port",)
    assert circle.value("speed_ratio", "port") == pytest.approx(speed / 2.0, rel=1e-3)
    assert circle.value("steady_diameter", "port") == pytest.approx(2 * speed / rate, rel=1e-3)
    assert circle.value("drift", "port") == pytest.approx(math.atan2(sway, surge), rel=1e-2)


def test_side_is_found_whatever_the_sign_of_the_rudder() -> None:
    """A positive rudder that turns to port makes the port circle, with a slow rudder as well."""
    slow = turning_circle(DRIFTING, speed=2.0, rudder=0.1, rate=0.01)
    quick = turning_circle(DRIFTING, speed=2.0, rudder=0.1)
    assert slow.sides == ("starboard", "port")
    for side in slow.sides:
        later = slow.value("time_90", side) - quick.value("time_90", side)
        assert 3.0 < later < 10.0  # the rudder takes ten seconds


def test_uncertainty_follows_the_covariance(fit_turning) -> None:
    """The spread of the steady diameter is that of 1/K, to first order."""
    circle = turning_circle(fit_turning, speed=2.0, rudder=0.3, n_draws=150)
    expected = fit_turning.std_errors["K"] / abs(fit_turning.values["K"])
    diameter = circle.value("steady_diameter", "port")
    assert circle.std("steady_diameter", "port") / diameter == pytest.approx(expected, rel=0.15)
    low, high = circle.interval("steady_diameter", "port")
    assert low < 2 * 2.0 / (0.1 * 0.3) < high
    assert circle.unfinished == {"starboard": 0, "port": 0}


def test_draws_are_reproducible(fit_turning) -> None:
    """The same call gives the same draws, another generator others."""
    one, two = (turning_circle(fit_turning, speed=2.0, rudder=0.3, n_draws=5) for _ in range(2))
    other = turning_circle(
        fit_turning, speed=2.0, rudder=0.3, n_draws=5, rng=np.random.default_rng(9)
    )
    first = one.draws["port"]["advance"]
    assert np.array_equal(first, two.draws["port"]["advance"])
    assert not np.array_equal(first, other.draws["port"]["advance"])


def test_imperfect_sensors_do_not_bend_the_track_and_actuators_do() -> None:
    """A biased compass leaves the circle alone; a rudder with an offset turns tighter one way."""
    plain = turning_circle(NOMOTO, speed=2.0, rudder=0.2)
    biased = turning_circle(
        NOMOTO + sensor_bias("bias", "r", "rad/s", scale=0.01, value=0.02), speed=2.0, rudder=0.2
    )
    offset = turning_circle(
        NOMOTO + actuator_offset("offset", "rudder", scale=0.02, value=0.02), speed=2.0, rudder=0.2
    )
    for side in plain.sides:
        assert biased.value("advance", side) == pytest.approx(plain.value("advance", side))
    ratio = offset.value("steady_diameter", "port") / offset.value("steady_diameter", "starboard")
    assert ratio == pytest.approx(0.22 / 0.18, rel=1e-3)


ROLL = small("roll", "p [rad/s] <- fin [rad]", {"p": "fin - p"})
TWO_INPUTS = replace(NOMOTO, inputs=(*NOMOTO.inputs, Input("fin", "rad")))


@pytest.mark.parametrize(
    ("model", "arguments", "message"),
    [
        (NOMOTO, {"side": "left"}, "starboard, port or both"),
        (NOMOTO, {"rudder": -0.3}, "above zero"),
        (NOMOTO, {"rudder": 35.0}, "degrees, give math.radians.35., which is 0.61"),
        (NOMOTO, {"length": 0.0}, "length 0; .* Give the length of the ship in m"),
        (NOMOTO, {"length": -3.0}, "length -3; it must be above zero"),
        (NOMOTO, {"rate": 0.0}, "rate 0; it must be above zero. Give rad/s"),
        (NOMOTO, {"n_draws": -3}, "n_draws is -3"),
        (NOMOTO.with_values({"K": 0.0}), {}, "does not turn|same side"),
        (TWO_INPUTS, {}, "inputs rudder, fin; a turning circle needs"),
        (ROLL, {}, "no state 'psi'"),
    ],
)
def test_mistakes_are_answered(model: Model, arguments: dict, message: str) -> None:
    """Wrong sides, signs and names are named, and ships that no rudder steers by a heading."""
    with pytest.raises(Exception, match=message) as caught:
        turning_circle(model, speed=2.0, **arguments)
    assert type(caught.value).__module__ == "oed_sysid.errors"


def test_what_a_fit_does_not_determine_is_not_drawn(fit_turning) -> None:
    """Without data on a parameter there is no uncertainty to draw, and the error names it."""
    blind = NOMOTO + sensor_bias("nothing", "r", "rad/s", scale=0.01).absent()
    blind = blind.with_parameter(Parameter("E_nothing", 0.0, "rad/s"))
    record = fit_turning.dataset[0]
    unseen = record.with_outputs(np.column_stack([record.output("psi"), np.full(301, np.nan)]))
    poor = MultipleShooting(disturbances="none").fit(blind, Dataset((unseen,)))
    with pytest.raises(ModelError, match="does not determine E_nothing"):
        turning_circle(poor, speed=2.0)


def test_a_speed_that_the_propulsion_does_not_keep_is_noted() -> None:
    """The ship runs at 2 m/s whatever speed it is given; from there the approach is steady."""
    steady = turning_circle(DRIFTING, speed=2.0, rudder=0.1)
    assert steady.notes == ()
    slow = turning_circle(DRIFTING, speed=0.02, rudder=0.1)
    assert slow.value("speed_ratio", "port") > 40
    (note,) = slow.notes
    assert "approach at 0.02 m/s is not steady: with this propulsion the ship keeps 2 m/s" in note
    assert note in slow.report()
    assert slow.to_dict()["notes"] == [note]
    assert turning_circle(NOMOTO, speed=0.02, rudder=0.1).notes == ()


@pytest.mark.parametrize(("push", "neutral"), [(0.01, -5.73), (0.03, 0.0)])
def test_a_neutral_rudder_beyond_the_range_is_noted(push: float, neutral: float) -> None:
    """A turn that takes 5.7 deg to stop is stopped; one that takes 17 deg is not, and said so."""
    model = replace(NOMOTO, kinematics={"psi": "r", "r": f"(K*(rudder + {10 * push}) - r)/T"})
    circle = turning_circle(model, speed=1.0, rudder=0.6)
    assert math.degrees(circle.neutral) == pytest.approx(neutral, abs=0.01)
    assert len(circle.notes) == (not neutral)
    if not neutral:
        assert "not straight: a course takes -17.2 deg, which is beyond" in circle.report()
