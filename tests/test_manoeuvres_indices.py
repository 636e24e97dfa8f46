"""Indices of standard manoeuvres against closed forms."""

import math

import numpy as np
import pytest

from oed_sysid.errors import DataError
from oed_sysid.experiments.manoeuvres import ZigZag, turning_indices, zigzag_indices

RADIUS, SPEED = 150.0, 5.0


def circle(*, side=1, course=0.4, approach=0.0, turned=3 * math.pi, step=0.5, drift=0.0):
    """Return t, x, y, psi of a straight approach and a circle with constant drift angle."""
    rate = SPEED / RADIUS
    times = np.arange(0, approach + turned / rate + step, step)
    arc = rate * np.maximum(times - approach, 0)
    along = SPEED * np.minimum(times, approach) + RADIUS * np.sin(arc)
    across = side * RADIUS * (1 - np.cos(arc))
    x = 30 + along * math.cos(course) - across * math.sin(course)
    y = -70 + along * math.sin(course) + across * math.cos(course)
    return times, x, y, course + side * (arc + drift)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("course", [0.0, 0.4, 3.1, -2.0])
@pytest.mark.parametrize("approach", [0.0, 40.5])
def test_circle_of_constant_radius(side, course, approach):
    """Advance and transfer equal the radius, the tactical diameter is twice it."""
    times, x, y, heading = circle(side=side, course=course, approach=approach)
    wrapped = np.angle(np.exp(1j * heading))
    result = turning_indices(times, x, y, wrapped, execute=approach)
    assert result.side == side
    for value, exact in (
        (result.advance, RADIUS),
        (result.transfer, RADIUS),
        (result.tactical_diameter, 2 * RADIUS),
        (result.steady_radius, RADIUS),
        (result.steady_diameter, 2 * RADIUS),
        (result.time_90, math.pi / 2 * RADIUS / SPEED),
        (result.time_180, math.pi * RADIUS / SPEED),
        (result.steady_speed_ratio, 1.0),
    ):
        assert value == pytest.approx(exact, rel=2e-4)
    assert result.drift == pytest.approx(0.0, abs=2e-3)
    assert ("starboard" if side > 0 else "port") in result.report()
    assert result.to_dict()["advance"] == result.advance


@pytest.mark.parametrize("side", [1, -1])
def test_drift_is_positive_with_the_bow_inside(side):
    """With the bow 8 degrees inside the track, the drift is +8 degrees to either side."""
    drift = math.radians(8)
    times, x, y, heading = circle(side=side, drift=drift)
    assert turning_indices(times, x, y, heading).drift == pytest.approx(drift, abs=2e-3)


def test_measured_speed_gives_the_speed_loss():
    """A log that falls to 60 percent by the steady turn gives that ratio."""
    times, x, y, heading = circle()
    speed = 8.0 * (0.6 + 0.4 * np.exp(-times / 10))
    result = turning_indices(times, x, y, heading, speed=speed)
    assert result.steady_speed_ratio == pytest.approx(0.6, abs=1e-3)


def test_noise_is_averaged_in_the_steady_radius():
    """With 1 m position noise the radius of 150 m is right within 1 m, over 20 seeds."""
    times, x, y, heading = circle()
    errors = []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(size=(2, len(times)))
        result = turning_indices(times, x + noise[0], y + noise[1], heading)
        errors.append(result.steady_radius - RADIUS)
    assert np.sqrt(np.mean(np.square(errors))) < 1.0


def test_short_turns_are_refused_or_left_without_steady_values():
    """Below 180 degrees an error says what was reached; below 450 there is no steady part."""
    times, x, y, heading = circle(turned=math.radians(150), step=0.01)
    with pytest.raises(DataError, match=r"reaches 150\.\d degrees"):
        turning_indices(times, x, y, heading)
    result = turning_indices(*circle(turned=math.radians(400)))
    assert result.steady_radius is None
    assert result.steady_diameter is None
    assert "too short" in result.report()
    assert turning_indices(*circle(turned=math.radians(400)), steady_from=math.pi).steady_radius


def nomoto(manoeuvre, *, gain, time_constant, step=0.02, duration=120.0, turn_rate=None):
    """Return t, psi, order and angle of T r' + r = K delta; exact for held rudders."""
    control = manoeuvre.controller()
    times = np.arange(0, duration, step)
    heading = rate = angle = 0.0
    rows = []
    decay = math.exp(-step / time_constant)
    for time in times:
        order = control.command(time, {"psi": heading})
        if turn_rate is None:
            angle = order
        rows.append((heading, order, angle))
        final = gain * angle
        heading += final * step + (rate - final) * time_constant * (1 - decay)
        rate = final + (rate - final) * decay
        if turn_rate is not None:
            angle += min(max(order - angle, -turn_rate * step), turn_rate * step)
    return times, *np.array(rows).T


@pytest.mark.parametrize("first", [1, -1])
def test_zigzag_of_nomoto_model(first):
    """Overshoot of T r' + r = K delta after reversal at yaw rate r: closed form.

    With F = K delta the rate after the reversal is (r + F) exp(-t/T) - F, zero
    at T ln(1 + r/F), where the heading has grown by T r - F T ln(1 + r/F).
    """
    gain, time_constant, ten = 0.12, 10.0, math.radians(10)
    test = ZigZag("rudder", ten, ten, first=first, start=4.0)
    times, heading, order, _ = nomoto(test, gain=gain, time_constant=time_constant)
    speed = np.full_like(times, 6.0)
    result = zigzag_indices(times, heading + 3.1, order, speed=speed)

    push = gain * ten
    second = int(np.flatnonzero(np.isclose(times, result.executes[1]))[0])
    turn_time = result.initial_turning_time
    rate = push * (1 - math.exp(-turn_time / time_constant))
    zero = time_constant * math.log1p(rate / push)
    assert result.executes[0] == pytest.approx(4.0)
    assert order[second] == -order[second - 1]
    assert abs(heading[second]) >= ten > abs(heading[second - 1])
    assert result.initial_turning_heading == pytest.approx(ten, abs=rate * 0.02)
    assert result.initial_turning_track == pytest.approx(6.0 * turn_time)
    assert result.first_overshoot == pytest.approx(time_constant * rate - push * zero, rel=1e-4)
    assert result.check_times[0] == pytest.approx(zero, abs=0.002)
    assert result.second_overshoot > result.first_overshoot
    assert result.period == pytest.approx(result.executes[3] - result.executes[1])
    zero_heading = times[np.flatnonzero((times > 4.0) & (first * heading < 0))[0]]
    assert result.reach == pytest.approx(zero_heading - 4.0, abs=0.021)
    assert "overshoot" in result.report()
    assert tuple(result.to_dict()["executes"]) == result.executes


def test_order_and_slow_rudder_angle_agree():
    """Executes found from the order and from a 3 deg/s rudder angle differ by a sample."""
    test = ZigZag("rudder", 0.3, 0.2, start=5.0)
    times, heading, order, angle = nomoto(
        test, gain=0.1, time_constant=9.0, step=0.1, turn_rate=math.radians(3)
    )
    by_order = zigzag_indices(times, heading, order)
    by_angle = zigzag_indices(times, heading, angle)
    np.testing.assert_allclose(by_angle.executes, by_order.executes, atol=0.11)
    np.testing.assert_allclose(by_angle.overshoots, by_order.overshoots, atol=2e-3)


def test_zigzag_in_a_wrapped_heading():
    """A compass that jumps at 180 degrees gives the same indices."""
    ten = math.radians(10)
    times, heading, order, _ = nomoto(ZigZag("rudder", ten, ten), gain=0.2, time_constant=5.0)
    wrapped = np.angle(np.exp(1j * (heading + math.pi)))
    np.testing.assert_allclose(
        zigzag_indices(times, wrapped, order).overshoots,
        zigzag_indices(times, heading, order).overshoots,
        atol=1e-12,
    )


def test_zigzag_that_ends_early_is_explained():
    """No reversal, or no turning back after it, is refused with the reason."""
    ten = math.radians(10)
    times, heading, order, _ = nomoto(ZigZag("rudder", ten, ten), gain=0.12, time_constant=10.0)
    second = int(np.flatnonzero(np.diff(order))[0]) + 1
    with pytest.raises(DataError, match="never reversed"):
        zigzag_indices(times[:second], heading[:second], order[:second])
    short = slice(0, second + 20)
    with pytest.raises(DataError, match="before the heading turns back"):
        zigzag_indices(times[short], heading[short], order[short])
    longer = slice(0, second + 800)
    result = zigzag_indices(times[longer], heading[longer], order[longer], execute=0.0)
    assert result.second_overshoot is None or result.period is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"x": [0.0, 1.0]}, "'x' of shape"),
        ({"heading": [0.0, math.nan, 1.0, 2.0]}, "1 missing value"),
        ({"times": [0.0, 2.0, 1.0, 3.0]}, "increasing"),
        ({"execute": 99.0}, "outside the record"),
    ],
)
def test_records_that_cannot_be_used(change, words):
    """Shapes, gaps, unsorted times and an execute outside the record are named."""
    record = {name: [0.0, 1.0, 2.0, 3.0] for name in ("times", "x", "y", "heading")} | change
    with pytest.raises(DataError, match=words):
        turning_indices(**record)
