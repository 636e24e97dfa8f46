"""Turning circles predicted from a model or a fit."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from oed_sysid import Experiment, Input, Model, MultipleShooting, Output, Parameter, State
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.experiments.manoeuvres import ZigZag
from oed_sysid.experiments.simulation import simulate
from oed_sysid.physics import actuator_offset, sensor_bias
from oed_sysid.prediction.turning_circle import QUANTITIES, turning_circle

NOMOTO = Model(
    "Nomoto",
    states=(State("psi", "rad"), State("r", "rad/s", scale=0.02)),
    inputs=(Input("rudder", "rad"),),
    outputs=(
        Output("psi", "rad", noise_std=0.002),
        Output("r", "rad/s", noise_std=0.0005),
    ),
    kinematics={"psi": "r", "r": "(K*rudder - r)/T"},
    parameters=(Parameter("K", 0.1, "1/s"), Parameter("T", 8.0, "s", lower=0.1)),
    step=0.2,
)
# A body that loses speed in the turn and drifts, with known steady values.
DRIFTING = Model(
    "drifting ship",
    states=(
        State("u", "m/s"),
        State("v", "m/s", scale=0.1),
        State("r", "rad/s", scale=0.02),
        State("psi", "rad"),
    ),
    inputs=(Input("rudder", "rad", interpolation="linear"),),
    outputs=(Output("psi", "rad"),),
    kinematics={
        "u": "(2.0 - 10.0*abs(rudder) - u)/5",
        "v": "(-2.0*r - v)/3",
        "r": "(-0.1*rudder - r)/4",
        "psi": "r",
    },
    step=0.2,
)


@pytest.fixture(scope="module")
def fit():
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


def test_uncertainty_follows_the_covariance(fit) -> None:
    """The spread of the steady diameter is that of 1/K, to first order."""
    circle = turning_circle(fit, speed=2.0, rudder=0.3, n_draws=400)
    expected = fit.std_errors["K"] / abs(fit.values["K"])
    diameter = circle.value("steady_diameter", "port")
    assert circle.std("steady_diameter", "port") / diameter == pytest.approx(expected, rel=0.15)
    low, high = circle.interval("steady_diameter", "port")
    assert low < 2 * 2.0 / (0.1 * 0.3) < high
    assert circle.unfinished == {"starboard": 0, "port": 0}


def test_draws_are_reproducible(fit) -> None:
    """The same call gives the same draws, another generator others."""
    one, two = (turning_circle(fit, speed=2.0, rudder=0.3, n_draws=5) for _ in range(2))
    other = turning_circle(fit, speed=2.0, rudder=0.3, n_draws=5, rng=np.random.default_rng(9))
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


def test_report_and_plain_data(fit) -> None:
    """Words have metres and lengths; the dictionary survives JSON."""
    circle = turning_circle(fit, speed=2.0, rudder=0.3, length=10.0, n_draws=20)
    text = circle.report()
    for words in ("17.2 deg", "starboard [L]"):
        assert words in text
    half = 1.96 * circle.std("advance", "starboard")
    assert f"{circle.value('advance', 'starboard'):.3g} +/- {half:.2g}" in text
    data = json.loads(json.dumps(circle.to_dict()))
    assert set(data["sides"]["port"]) == set(QUANTITIES)
    assert "[L]" not in turning_circle(NOMOTO, speed=2.0).report()
    assert math.isnan(turning_circle(NOMOTO, speed=2.0).std("advance", "port"))


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        ({"K": 0.1}, {"side": "left"}, "starboard, port or both"),
        ({"K": 0.1}, {"rudder": -0.3}, "above zero"),
        ({"K": 0.1}, {"rudder": 35.0}, "degrees, give math.radians.35., which is 0.61"),
        ({"K": 0.1}, {"length": 0.0}, "length is 0.0. Give the length of the ship in m"),
        ({"K": 0.1}, {"length": -3.0}, "length is -3.0"),
        ({"K": 0.1}, {"rate": 0.0}, "rate is 0.0. Give rad/s above zero"),
        ({"K": 0.1}, {"n_draws": -3}, "n_draws is -3"),
        ({"K": 0.1}, {"input": "fin"}, "inputs rudder"),
        ({"K": 0.0}, {}, "does not turn|same side"),
    ],
)
def test_mistakes_are_answered(change: dict, arguments: dict, message: str) -> None:
    """Wrong sides, signs and names are named, and a ship that does not steer."""
    with pytest.raises(Exception, match=message) as caught:
        turning_circle(NOMOTO.with_values(change), speed=2.0, **arguments)
    assert type(caught.value).__module__ == "oed_sysid.errors"


def test_a_model_without_heading_cannot_turn() -> None:
    """A turn is told by the heading; a roll model has none."""
    roll = Model("roll", (State("p", "rad/s"),), (Input("fin", "rad"),), (Output("p", "rad/s"),),
                 {"p": "fin - p"})  # fmt: skip
    with pytest.raises(ModelError, match="no state 'psi'"):
        turning_circle(roll, speed=1.0)


def test_what_a_fit_does_not_determine_is_not_drawn(fit) -> None:
    """Without data on a parameter there is no uncertainty to draw, and the error names it."""
    blind = NOMOTO + sensor_bias("nothing", "r", "rad/s", scale=0.01).absent()
    blind = blind.with_parameter(Parameter("E_nothing", 0.0, "rad/s"))
    record = fit.dataset[0]
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
