"""Contract that every manoeuvre fulfils, and the open-loop shapes."""

import json
import math

import numpy as np
import pytest

from oed_sysid.errors import ModelError
from oed_sysid.experiments import manoeuvres as m

EVERY_KIND = [
    m.Constant("thrust", 700.0),
    m.ZigZag("rudder", 0.2, 0.1, rate=0.05, first=-1, start=2.0, sign=-1, neutral=0.01),
    m.ZigZagLike("fin_command", (0.3, 0.2), 0.1, rate=0.2),
    m.TurningCircle("rudder", -0.6, start=5.0, rate=0.04),
    m.PullOut("rudder", 0.3, turn_duration=20.0),
    m.Spiral("rudder", [0.2, 0.0, -0.2], hold=10.0, rate=0.05),
    m.ReverseSpiral("rudder", [0.01, -0.01], hold=9.0, gain=5.0, reset_time=20.0, limit=0.6),
    m.Doublet("rudder", 0.2, pulse_time=2.0, first=-1),
    m.ThreeTwoOneOne("fin_command", 0.1, unit_time=1.5, start=1.0),
    m.PRBS("rudder", 0.1, bit_time=0.5, order=5, seed=9),
    m.Multisine("rudder", np.array([0.1, 0.2, 0.3]), peak=0.2),
    m.Chirp("rudder", 0.1, first_frequency=0.05, last_frequency=0.5, sweep_time=20.0, law="log"),
    m.Piecewise("rudder", np.array([0.0, 1.0, 3.0]), [0.0, 0.2, -0.1], interpolation="linear"),
    m.FromRecord("rudder", [100.0, 101.0], [0.1, 0.2], record="trial_3"),
    m.Combined((m.Constant("thrust", 1.0), m.ZigZag("rudder", 0.2, 0.1))),
    m.Sequence((m.Doublet("rudder", 0.2, pulse_time=2.0), m.ZigZag("rudder", 0.2, 0.1))),
    m.RateLimited(m.Doublet("rudder", 0.2, pulse_time=2.0), 0.1),
    m.Saturated(m.Chirp("z", 1, first_frequency=1, last_frequency=1, sweep_time=9), 0.5),
]


def by_kind(excitation):
    """Name a test after the kind."""
    return excitation.kind


@pytest.mark.parametrize("excitation", EVERY_KIND, ids=by_kind)
def test_survives_json(excitation):
    """A manoeuvre stored in JSON comes back equal, with equal words and hash."""
    stored = excitation.to_dict()
    text = json.dumps(stored)
    assert json.loads(text) == stored
    revived = m.Excitation.from_dict(json.loads(text))
    assert revived == excitation
    assert hash(revived) == hash(excitation)
    assert revived.describe() == excitation.describe()


def test_every_exported_kind_is_checked():
    """The list above holds every concrete excitation that the package exports."""
    exported = {
        item
        for name in m.__all__
        if isinstance(item := getattr(m, name), type)
        and issubclass(item, m.Excitation)
        and not item.__abstractmethods__
    }
    assert exported == {type(excitation) for excitation in EVERY_KIND}


@pytest.mark.parametrize("excitation", EVERY_KIND, ids=by_kind)
def test_controllers_are_fresh_and_finite(excitation):
    """Two runs of fresh controllers give the same finite commands for every input."""
    signals = {"psi": 0.0, "theta": 0.0, "r": 0.0}
    runs = []
    for _ in range(2):
        controllers = excitation.controllers()
        assert tuple(controllers) == excitation.inputs
        runs.append([m.command_all(controllers, 0.25 * k, signals) for k in range(120)])
    assert runs[0] == runs[1]
    assert all(math.isfinite(value) for row in runs[0] for value in row.values())
    assert set(excitation.feedback) <= set(signals)
    assert isinstance(excitation.feedback, tuple)
    assert "\n" not in excitation.describe()
    assert excitation.duration is None or excitation.duration > 0


@pytest.mark.parametrize(
    "manoeuvre", [item for item in EVERY_KIND if not item.feedback], ids=by_kind
)
def test_commands_are_those_of_the_controller(manoeuvre):
    """Without feedback, all commands at once equal the commands one by one."""
    times = np.arange(0, 30, 0.1)
    control = manoeuvre.controller()
    one_by_one = [control.command(time, {}) for time in times]
    commands = manoeuvre.commands(times)
    assert commands.shape == times.shape
    np.testing.assert_allclose(commands, one_by_one, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: m.ZigZag("rudder", -0.1, 0.1), "first=-1"),
        (lambda: m.ZigZag("rudder", 0.1, 0.0), "switch 0"),
        (lambda: m.ZigZag("rudder", 0.1, 0.1, rate=0.0), "rate 0"),
        (lambda: m.ZigZag("rudder", 0.1, 0.1, first=0), "first 0"),
        (lambda: m.ZigZag("rudder", 0.1, 0.1, feedback=("psi", "r")), "exactly one"),
        (lambda: m.ZigZag("", 0.1, 0.1), "name of a commanded channel"),
        (lambda: m.ZigZag("rudder", float("nan"), 0.1), "amplitude nan"),
        (lambda: m.ZigZag("rudder", "large", 0.1), "amplitude 'large'"),
        (lambda: m.ZigZagLike("fin", (0.1, -0.1), 0.1), r"amplitudes\[1\]"),
        (lambda: m.ZigZagLike("fin", (), 0.1), "at least 1"),
        (lambda: m.TurningCircle("rudder", 0.0), "moves nothing"),
        (lambda: m.PullOut("rudder", 0.3, turn_duration=-1.0), "turn_duration -1"),
        (lambda: m.Spiral("rudder", [0.1, float("inf")], hold=1.0), "position 1"),
        (lambda: m.Doublet("rudder", -0.1, pulse_time=1.0), "first=-1"),
        (lambda: m.PRBS("rudder", 0.1, bit_time=1.0, order=1), "2 to 16"),
        (lambda: m.PRBS("rudder", 0.1, bit_time=1.0, order=3, seed=8), "1 to 7"),
        (lambda: m.Multisine("rudder", [0.2, 0.1], peak=1.0), "do not increase"),
        (lambda: m.Multisine("rudder", [0.0, 0.1], peak=1.0), "Constant"),
        (lambda: m.Multisine("rudder", [0.1]), "neither amplitudes nor a peak"),
        (lambda: m.Multisine("rudder", [0.1, 0.2], amplitudes=[1.0]), "1 amplitudes"),
        (
            lambda: m.Chirp(
                "z", 1, first_frequency=1, last_frequency=2, sweep_time=1, law="square"
            ),
            "linear, log",
        ),
        (lambda: m.Piecewise("rudder", [0.0, 2.0, 1.0], [0, 0, 0]), "2 is followed by 1"),
        (lambda: m.Piecewise("rudder", [0.0, 1.0], [0.0]), "2 times but 1 values"),
        (lambda: m.Piecewise("rudder", [0, 1], [0, 1], interpolation="cubic"), "hold, linear"),
        (lambda: m.FromRecord("rudder", [0.0, 1.0], [0.0, float("nan")]), "gap"),
        (lambda: m.Constant("thrust", None), "value None"),
    ],
)
def test_bad_settings_are_refused_with_advice(make, words):
    """A setting that makes no sense is refused, and the message names it."""
    with pytest.raises(ModelError, match=words):
        make()


def test_stored_nonsense_is_refused():
    """Unknown kinds and settings, missing settings and wrong classes are named."""
    with pytest.raises(ModelError, match=r"'waltz'.*zigzag"):
        m.Excitation.from_dict({"kind": "waltz"})
    with pytest.raises(ModelError, match=r"speed\. Known: amplitude"):
        m.Excitation.from_dict({"kind": "zigzag", "speed": 3})
    with pytest.raises(ModelError, match="lacks a setting"):
        m.Excitation.from_dict({"kind": "zigzag", "input": "rudder"})
    with pytest.raises(ModelError, match=r"Excitation\.from_dict"):
        m.Manoeuvre.from_dict(m.Combined((m.Constant("thrust", 1.0),)).to_dict())


def test_held_commands_ignore_rounding_of_times():
    """Switches fall on the sample meant, although 3 * 0.1 is not 0.3 in binary."""
    times = 0.1 * np.arange(60)
    steps = m.Piecewise("rudder", [0.1 * k + 0.2 for k in range(50)], list(range(50)))
    np.testing.assert_array_equal(steps.commands(times)[2:52], np.arange(50))
    bits = m.PRBS("rudder", 1.0, bit_time=0.1, order=5).commands(times)
    np.testing.assert_array_equal(bits[:31], m.maximum_length_sequence(5))


def test_rate_limited_ramp_is_exact_between_samples():
    """Put on at 2 rad/s from 1 s, 0.6 rad is reached after 0.3 s, on any grid."""
    circle = m.TurningCircle("rudder", -0.6, start=1.0, rate=2.0)
    np.testing.assert_allclose(
        circle.commands([0.9, 1.0, 1.15, 1.3, 7.0]), [0, 0, -0.3, -0.6, -0.6]
    )


@pytest.mark.parametrize(
    "manoeuvre",
    [
        m.TurningCircle("rudder", 0.6, start=1.0, rate=0.05),
        m.PullOut("rudder", 0.6, turn_duration=4.0, rate=0.05),
        m.Spiral.direct("rudder", 0.4, step=0.1, hold=1.0, rate=0.05),
        m.RateLimited(m.PRBS("rudder", 0.3, bit_time=1.0, order=4), 0.05),
        m.RateLimited(m.Chirp("a", 1, first_frequency=1, last_frequency=2, sweep_time=9), 0.05),
    ],
    ids=by_kind,
)
@pytest.mark.parametrize("step", [0.03, 0.5])
def test_rate_limit_is_never_exceeded(manoeuvre, step):
    """No two samples differ by more than the rate allows, and the limit is used."""
    slopes = np.abs(np.diff(manoeuvre.commands(np.arange(0, 30, step)))) / step
    assert slopes.max() == pytest.approx(0.05)


def test_pull_out_returns_to_midships():
    """A pull-out holds its angle for the turn and zero afterwards."""
    pull = m.PullOut("rudder", -0.3, turn_duration=20.0, start=5.0)
    np.testing.assert_array_equal(
        pull.commands([4.9, 5.0, 24.9, 25.0, 99.0]), [0, -0.3, -0.3, 0, 0]
    )
    assert pull.duration == 45.0


def test_direct_spiral_goes_there_and_back():
    """The spiral visits each angle once each way, including zero, for the hold time."""
    spiral = m.Spiral.direct("rudder", math.radians(-25), step=math.radians(5), hold=30.0)
    angles = np.degrees(spiral.angles)
    np.testing.assert_allclose(angles[:11], np.arange(-25, 26, 5), atol=1e-12)
    np.testing.assert_allclose(angles, angles[::-1])
    assert len(angles) == 21
    assert spiral.duration == 21 * 30.0
    np.testing.assert_allclose(spiral.commands([29.9, 30.0, 1e4]), np.radians([-25, -20, -25]))


def test_reverse_spiral_steers_an_unstable_vehicle():
    """Bech's spiral holds a yaw rate where a straight course is unstable.

    Steady yaw rate of the unstable cubic model: rudder = r**3 - r, here with
    r = 0.5, which a fixed rudder cannot hold.
    """
    step, rate = 0.05, 0.0
    spiral = m.ReverseSpiral("rudder", [0.5, -0.5], hold=60.0, gain=4.0, reset_time=4.0, limit=2.0)
    control = spiral.controller()
    commands, rates = [], []
    for time in np.arange(0, spiral.duration, step):
        commands.append(control.command(time, {"r": rate}))
        rates.append(rate)
        rate += step * (rate - rate**3 + commands[-1])
    for end, wanted in ((1199, 0.5), (2399, -0.5)):
        assert rates[end] == pytest.approx(wanted, abs=1e-4)
        assert commands[end] == pytest.approx(wanted**3 - wanted, abs=1e-3)
    assert max(map(abs, commands)) <= 2.0


def test_multistep_inputs_have_the_published_pattern():
    """3-2-1-1 alternates with these lengths; a doublet has no mean."""
    times = np.arange(0.25, 10, 0.5)
    signs = np.sign(m.ThreeTwoOneOne("fin", 0.1, unit_time=1.0, first=-1).commands(times))
    np.testing.assert_array_equal(signs, [-1] * 6 + [1] * 4 + [-1] * 2 + [1] * 2 + [0] * 6)
    assert np.sum(m.Doublet("fin", 0.1, pulse_time=3.0, start=1.0).commands(times)) == 0


def test_replay_moves_the_record_to_its_start():
    """The first recorded sample is played at start; the ends are held."""
    replay = m.FromRecord("rudder", [50.0, 52.0], [0.1, 0.3], interpolation="linear", start=10.0)
    np.testing.assert_allclose(replay.commands([0.0, 11.0, 12.0, 20.0]), [0.1, 0.2, 0.3, 0.3])
    assert replay.duration == 12.0
