"""The tanker: real zigzags of HSVA, from Nomoto's equation to a turning circle."""

from __future__ import annotations

import math

import numpy as np
import pytest

from oed_sysid import Dataset, MultipleShooting, load_problem, simulate_inputs, turning_circle
from oed_sysid.baselines import IncrementalLSSVM
from oed_sysid.data import third_party
from oed_sysid.testing import check_effect

HEADING = load_problem("kvlcc2")
MMG = load_problem("kvlcc2", variant="mmg")
HULL = load_problem("kvlcc2", variant="linear_hull")
# Chosen by runs left out; what is extrapolated stops before the last one, see the README.
CHOSEN = ("helm_zero", "rudder_lift_shape", "propeller_wake_by_drift", "propeller_race")
HELD_OUT = "20_05"
LENGTH, SPEED, RATE = 7.0, 1.179, math.radians(15.8)

needs_data = pytest.mark.skipif(
    not (third_party.data_folder() / "kvlcc2_hsva_zigzag").is_dir(),
    reason="third-party data is not in OED_SYSID_DATA",
)


def chosen_model(names=CHOSEN):
    """The MMG model with the effects that the training records ask for."""
    return MMG.model + [MMG.effect(name) for name in names]


@pytest.fixture(scope="module")
def heading():
    """Records of rudder, heading and yaw rate."""
    return HEADING.data()


@pytest.fixture(scope="module")
def motion():
    """Records of rudder, surge, sway, yaw rate and heading."""
    return MMG.data()


@pytest.fixture(scope="module")
def without_20_05(motion):
    """The chosen model fitted to all runs but one."""
    return MultipleShooting(disturbances="none").fit(chosen_model(), motion.split(HELD_OUT)[0])


@pytest.mark.parametrize("variant", ["default", "linear_hull"])
def test_effects_are_absent_at_zero(variant: str) -> None:
    """All candidates together, at zero, leave a turn as it was."""
    problem = load_problem("kvlcc2", variant=variant)
    times = np.arange(0.0, 40.0, 0.5)
    start = {"u": SPEED} if "u" in problem.model.state_names else {}
    plain, loaded = (
        simulate_inputs(model, times, inputs={"delta": 0.1}, initial=start).outputs
        for model in (problem.model, problem.model + [e.absent() for e in problem.effects])
    )
    assert np.abs(plain).max() > 0.1
    assert loaded == pytest.approx(plain, abs=1e-9)


# The slipstream of the thrust in a turn is that of the straight course until drift moves the
# propeller out of the wake, which is an effect of its own: alone it changes nothing.
@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [one.name for one in HULL.effects if one.name != "race_from_thrust"]
)
def test_effects_keep_the_contract(name: str) -> None:
    """Effects written for this ship, and the library's beside them, do as they promise."""
    check_effect(
        HULL.effect(name),
        HULL.model,
        rng=np.random.default_rng(1),
        initial={"u": SPEED},
        inputs={"delta": (-0.4, 0.4)},
    )


def test_second_order_is_two_first_orders_in_a_row() -> None:
    """The lead-lag and the yaw equation together have the step response of the textbook."""
    gain, slow, quick, zero, rudder = -0.2, 15.0, 3.0, 5.0, 0.1
    model = load_problem("kvlcc2", variant="second_order").model
    model = model.with_values(
        {"K": gain, "T": slow, "E_second_order": 1 - zero / quick, "T_2": quick}
    )
    times = np.arange(0.0, 60.0, 0.1)
    inputs = np.where(times > 0, rudder, 0.0)
    rate = simulate_inputs(model, times, inputs={"delta": inputs}).output("r")
    first = (slow - zero) / (slow - quick) * np.exp(-times / slow)
    second = (zero - quick) / (slow - quick) * np.exp(-times / quick)
    assert rate == pytest.approx(gain * rudder * (1 - first - second), abs=6e-4)


def test_published_coefficients_turn_a_symmetric_ship() -> None:
    """With the published values both circles are alike and of a tanker's size."""
    circle = turning_circle(MMG.model, speed=SPEED, rate=RATE, length=LENGTH)
    for quantity, low, high in (("advance", 3.0, 4.0), ("tactical_diameter", 3.0, 4.2)):
        port, starboard = (circle.value(quantity, side) for side in ("port", "starboard"))
        assert port == pytest.approx(starboard, rel=1e-6)
        assert low * LENGTH < port < high * LENGTH


@needs_data
def test_records_have_the_signs_of_the_model(motion) -> None:
    """Rudder to port lets the yaw rate fall; body speeds agree with heading and track."""
    assert len(motion) == 10
    for record in motion:
        rudder, rate = record.input("delta"), record.output("r")
        first = int(np.argmax(np.abs(rudder) > math.radians(5.0)))
        assert rudder[first] * rate[first + 8] < 0
        slope = np.gradient(record.output("psi"), record.times)
        assert np.std(slope - rate) < 0.1 * np.std(rate)
        # The pivot is ahead of midship: the stern swings out, the bow in.
        assert np.corrcoef(record.output("v"), rate)[0, 1] < -0.8


@needs_data
def test_published_gain_and_time_constant(heading) -> None:
    """The difference equation gives the published K and T on the 15/5 zigzag.

    One hundred steps of 1.5 s, rudder and rate averaged over each step.
    """
    record, weights = heading["15_05"], np.array([0.5, 1.0, 1.0, 0.5]) / 3
    ends = np.arange(0, 303, 3)  # 1.5 s

    def mean(signal: np.ndarray) -> np.ndarray:
        return np.array([weights @ signal[k : k + 4] for k in ends[:-1]])

    features = np.column_stack([mean(record.output("r")), mean(record.input("delta"))])
    targets = np.diff(record.output("r")[ends])
    machine = IncrementalLSSVM(C=1e9)
    machine.start(features[:2], targets[:2])
    for row, target in zip(features[2:], targets[2:], strict=True):
        machine.update(row, target)
    first, second = machine.coefficients
    assert -second / first == pytest.approx(HEADING.published["K"], rel=0.05)
    assert -1.5 / first == pytest.approx(HEADING.published["T"], rel=0.05)


@needs_data
def test_gain_and_time_constant_depend_on_the_manoeuvre(heading) -> None:
    """Fitted run by run, Nomoto's constants differ by far more than their errors."""
    found = {}
    for name in ("25_05", "15_05", "10_01"):
        fit = MultipleShooting(disturbances="none").fit(HEADING.model, Dataset((heading[name],)))
        assert fit.status.ok
        found[name] = fit.values
    assert found["15_05"]["T"] > 1.5 * found["25_05"]["T"]
    assert found["15_05"]["K"] < 1.5 * found["25_05"]["K"] < 0


@needs_data
def test_held_out_zigzag(heading, motion, without_20_05) -> None:
    """A run that no fit has seen: heading five times better than Nomoto, speeds in the scatter."""
    fit = without_20_05
    assert fit.status.ok
    assert fit.seconds < 60
    assert fit.coloured
    train, test = heading.split(HELD_OUT)
    nomoto = MultipleShooting(disturbances="none").fit(HEADING.model, train)
    error = fit.predict(motion.split(HELD_OUT)[1]).rms
    assert nomoto.predict(test).rms["psi"] > 5.0 * error["psi"]
    assert math.degrees(error["psi"]) < 0.35
    # Twice the scatter between two runs of the same test, see README.
    assert error["v"] < 0.010
    assert math.degrees(error["r"]) < 0.14
    assert error["u"] < 0.0084


@needs_data
def test_race_of_the_propeller_is_weaker_than_published(without_20_05) -> None:
    """The race factor is well determined, below the published 0.5, and helps runs left out."""
    size = without_20_05.values["E_propeller_race"]
    assert -0.5 < size < -4 * without_20_05.std_errors["E_propeller_race"]


@needs_data
def test_rudder_zero_of_one_run_stands_out(without_20_05) -> None:
    """The 30/5 run was made with another rudder zero than the others, by about a degree."""
    names = without_20_05.dataset.names
    zeros = {
        name: math.degrees(local["E_helm_zero"])
        for name, local in zip(names, without_20_05.local_values, strict=True)
    }
    others = [zero for name, zero in zeros.items() if name != "30_05"]
    assert zeros["30_05"] > 0.7
    assert max(map(abs, others)) < 0.7


@needs_data
def test_strongest_zigzag_from_the_weaker_ones(heading, motion) -> None:
    """Fitted to at most 25 degrees of rudder, the 30 degree run is predicted five times better."""
    name = "30_05"
    fit = MultipleShooting(disturbances="none").fit(chosen_model(), motion.split(name)[0])
    nomoto = MultipleShooting(disturbances="none").fit(HEADING.model, heading.split(name)[0])
    error = fit.predict(motion.split(name)[1]).rms["psi"]
    assert nomoto.predict(heading.split(name)[1]).rms["psi"] > 5.0 * error


@needs_data
def test_turning_circle_from_zigzags_alone(motion) -> None:
    """A 35 degree circle extrapolated from zigzags is that of this hull, as published.

    Free-running 7 m model, Yasukawa & Yoshimura (2015), table 4, in lengths: advance 3.25 and
    3.11, tactical diameter 3.34 and 3.08, to starboard and port. Not used for fitting.
    """
    fit = MultipleShooting(disturbances="none").fit(chosen_model(CHOSEN[:3]), motion)
    assert fit.status.ok
    circle = turning_circle(fit, speed=SPEED, rate=RATE, length=LENGTH, n_draws=20)
    published = {"starboard": (3.25, 3.34), "port": (3.11, 3.08)}
    for side, (advance, diameter) in published.items():
        assert circle.value("advance", side) / LENGTH == pytest.approx(advance, rel=0.05)
        assert circle.value("tactical_diameter", side) / LENGTH == pytest.approx(diameter, rel=0.2)
        assert circle.std("tactical_diameter", side) / LENGTH < 0.3
        assert 0.3 < circle.value("speed_ratio", side) < 0.45
