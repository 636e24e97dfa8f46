"""Zigzags closed over a vehicle, and their composition."""

import math

import numpy as np
import pytest

from oed_sysid.errors import ModelError
from oed_sysid.experiments.manoeuvres import (
    PRBS,
    Combined,
    Constant,
    Doublet,
    RateLimited,
    Saturated,
    Sequence,
    ZigZag,
    ZigZagLike,
    command_all,
)

STEP = 0.05


def sail(manoeuvre, *, gain=0.1, time_constant=8.0, duration=200.0, heading=0.7, name="psi"):
    """Run a manoeuvre on Nomoto's model T r' + r = K delta, and return t, psi, delta."""
    control = manoeuvre.controller()
    times = np.arange(0, duration, STEP)
    headings, commands = np.empty_like(times), np.empty_like(times)
    rate = 0.0
    for index, time in enumerate(times):
        headings[index] = heading
        commands[index] = control.command(time, {name: heading})
        heading += STEP * rate
        rate += STEP * (gain * commands[index] - rate) / time_constant
    return times, headings, commands


@pytest.mark.parametrize(("gain", "sign"), [(0.1, 1), (-0.1, -1)])
@pytest.mark.parametrize("first", [1, -1])
def test_zigzag_reverses_at_the_switch(gain, sign, first):
    """The rudder reverses on the first sample beyond +-10 degrees from the approach heading."""
    ten = math.radians(10)
    test = ZigZag("rudder", ten, ten, first=first, sign=sign, start=3.0)
    times, headings, commands = sail(test, gain=gain)
    assert not np.any(commands[times < 3.0])
    assert commands[np.isclose(times, 3.0)] == pytest.approx(first * ten)
    reversals = np.flatnonzero(np.diff(commands[times >= 3.0])) + 1 + np.sum(times < 3.0)
    assert len(reversals) >= 4
    deviation = headings - 0.7
    side = first * sign
    for reversal in reversals:
        assert side * deviation[reversal] >= ten > side * deviation[reversal - 1]
        side = -side
    np.testing.assert_allclose(np.abs(commands[times >= 3.0]), ten)


def drift(test, *, duration=120.0, quick=1.0, climb=0.0):
    """Pitch with little damping and a depth that follows it; pitch and depth, one row a sample."""
    control = test.controller()
    pitch, rate, depth, seen = 0.0, 0.0, 20.0, []
    for time in np.arange(0, duration, STEP):
        command = control.command(time, {"theta": pitch, "q": rate, "z": depth})
        seen.append((pitch, depth))
        pitch += STEP * rate
        rate += STEP * quick * (command - 0.2 * rate - 0.1 * pitch + climb)
        depth -= STEP * 1.5 * math.sin(pitch)
    return np.array(seen)


def test_a_zigzag_that_looks_ahead_swings_alike_on_slow_and_quick_vehicles():
    """With a lead, a vehicle four times as quick swings no further; without, much further."""
    angle = math.radians(10)
    plain = ZigZag("fin", angle, angle, feedback=("theta",))
    leading = ZigZag("fin", angle, 2 * angle, feedback=("theta", "q"), lead=1.5)
    spread = {
        test: [np.abs(drift(test, quick=quick)[:, 0]).max() for quick in (0.5, 2.0)]
        for test in (plain, leading)
    }
    assert max(spread[leading]) <= 2 * angle
    assert max(spread[plain]) > 1.2 * max(spread[leading])


def test_a_zigzag_about_a_keeper_stays_at_its_depth():
    """A vehicle that noses up drifts away, and stays near where the depth is kept."""
    angle = math.radians(10)
    free = ZigZag("fin", angle, angle, feedback=("theta",))
    kept = ZigZag("fin", angle, angle, feedback=("theta", "z"), keep_gain=0.03)
    gone = [np.abs(drift(test, climb=0.02)[:, 1] - 20.0).max() for test in (free, kept)]
    assert gone[1] < 0.5 * gone[0]
    assert type(kept).from_dict(kept.to_dict()) == kept


def test_signals_of_a_zigzag_are_as_many_as_it_reacts_to():
    """A lead without the rate, and a keeper without its signal, are named."""
    with pytest.raises(ModelError, match="then its rate"):
        ZigZag("fin", 0.1, 0.1, feedback=("theta",), lead=1.0)
    with pytest.raises(ModelError, match="then its rate, then the signal kept"):
        ZigZag("fin", 0.1, 0.1, feedback=("theta", "q"), lead=1.0, keep_gain=0.1)
    with pytest.raises(ModelError, match="lead"):
        ZigZag("fin", 0.1, 0.1, lead=-1.0)


def test_zigzag_rate_limit_holds_in_closed_loop():
    """The rudder moves at 5 deg/s at most, reaches both sides and stays around neutral."""
    rate, neutral = math.radians(5), 0.02
    test = ZigZag("rudder", 0.3, 0.2, rate=rate, neutral=neutral, start=1.0)
    _, _, commands = sail(test, gain=0.3)
    assert np.max(np.abs(np.diff(commands))) == pytest.approx(rate * STEP)
    assert commands[0] == neutral
    assert commands.max() == pytest.approx(0.3 + neutral)
    assert commands.min() == pytest.approx(-0.3 + neutral)


def test_zigzag_like_changes_its_swings():
    """Each swing has its own amplitude and switch; the last ones are kept."""
    dive = ZigZagLike("fin_command", (0.35, 0.2, 0.1), (0.2, 0.1), start=2.0)
    times, pitch, commands = sail(dive, gain=-0.3, heading=0.0, name="theta")
    reversals = np.flatnonzero(np.diff(commands)) + 1
    np.testing.assert_allclose(
        commands[reversals[:5]], [0.35, -0.2, 0.1, -0.1, 0.1], err_msg="amplitudes"
    )
    at_reversal = pitch[reversals[1:5]]
    np.testing.assert_allclose(at_reversal, [-0.2, 0.1, -0.1, 0.1], atol=5e-3)
    assert np.all(np.abs(at_reversal) >= np.array([0.2, 0.1, 0.1, 0.1]))
    assert times[reversals[0]] == pytest.approx(2.0)


def test_missing_measurements_keep_the_order():
    """NaN means not sampled: the command is kept, and the reference waits for a value."""
    control = ZigZag("rudder", 0.2, 0.1).controller()
    headings = [math.nan, 1.0, 1.05, math.nan, 1.11, math.nan]
    commands = [control.command(time, {"psi": psi}) for time, psi in enumerate(headings)]
    assert commands == [0.2, 0.2, 0.2, 0.2, -0.2, -0.2]


def test_controller_misuse_is_explained():
    """A missing signal, a time that runs back and open-loop use of feedback are refused."""
    test = ZigZag("rudder", 0.2, 0.1)
    control = test.controller()
    with pytest.raises(ModelError, match=r"'psi'.*\(r\)"):
        control.command(0.0, {"r": 0.0})
    control.command(5.0, {"psi": 0.0})
    with pytest.raises(ModelError, match="fresh controller"):
        control.command(4.0, {"psi": 0.0})
    with pytest.raises(ModelError, match="reacts to psi"):
        test.commands([0.0, 1.0])


def test_combined_commands_every_input():
    """Constant thrust with a zigzag: one command each, feedback of both."""
    trial = Combined([Constant("thrust", 700.0), ZigZag("rudder", 0.2, 0.1, feedback="psi")])
    controllers = trial.controllers()
    assert trial.feedback == ("psi",)
    assert trial.duration is None
    assert command_all(controllers, 0.0, {"psi": 0.0}) == {"thrust": 700.0, "rudder": 0.2}
    assert command_all(controllers, 1.0, {"psi": 0.2}) == {"thrust": 700.0, "rudder": -0.2}
    with pytest.raises(ModelError, match="once only"):
        Combined((Constant("thrust", 1.0), Constant("thrust", 2.0)))
    with pytest.raises(ModelError, match="at least one"):
        Combined(())
    with pytest.raises(ModelError, match="got a Combined"):
        Combined((trial,))


def test_sequence_runs_each_part_on_its_own_clock():
    """A zigzag after a doublet takes its reference heading when its turn comes."""
    parts = Sequence((Doublet("rudder", 0.2, pulse_time=2.0), ZigZag("rudder", 0.1, 0.05)))
    control = parts.controller()
    headings = {0: 0.0, 2: 0.5, 4: 1.0, 5: 1.04, 6: 1.06}
    commands = [control.command(time, {"psi": psi}) for time, psi in headings.items()]
    assert commands == [0.2, -0.2, 0.1, 0.1, -0.1]
    assert parts.duration is None
    assert Sequence(parts.manoeuvres[:1]).duration == 4.0
    with pytest.raises(ModelError, match="Give durations"):
        Sequence((ZigZag("rudder", 0.1, 0.05), Constant("rudder", 0.0)))
    with pytest.raises(ModelError, match="Use Combined"):
        Sequence((Constant("rudder", 0.0), Constant("thrust", 0.0)), durations=[1.0])
    with pytest.raises(ModelError, match="3 durations"):
        Sequence((Constant("rudder", 0.0), Constant("rudder", 1.0)), durations=[1.0, 2.0, 3.0])


def test_wrappers_pass_feedback_on():
    """A zigzag cut off and slowed still reacts to the heading."""
    slow = RateLimited(Saturated(ZigZag("rudder", 0.3, 0.1), 0.2), 0.1)
    assert slow.feedback == ("psi",)
    assert slow.input == "rudder"
    _, headings, commands = sail(slow, gain=0.3, heading=0.0)
    assert np.max(np.abs(commands)) == pytest.approx(0.2)
    assert np.max(np.abs(np.diff(commands))) == pytest.approx(0.1 * STEP)
    assert headings.max() > 0.1
    assert headings.min() < -0.1
    with pytest.raises(ModelError, match="got a str"):
        Saturated("zigzag", 0.2)


def test_saturation_leaves_small_commands_alone():
    """Below the limit the wrapped commands are unchanged."""
    prbs = PRBS("rudder", 0.1, bit_time=1.0)
    times = np.arange(0, 100.0)
    np.testing.assert_array_equal(Saturated(prbs, 0.2).commands(times), prbs.commands(times))
