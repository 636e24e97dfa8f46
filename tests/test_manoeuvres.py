"""Manoeuvres: what they command, around which trim, and the indices of standard ones."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from oed_sysid.errors import DataError, ModelError
from oed_sysid.experiments import manoeuvres as m
from oed_sysid.experiments.indices import rudder_legs

EVERY_KIND = [
    m.Constant("thrust", 700.0),
    m.ZigZag("rudder", 0.2, 0.1, rate=0.05, first=-1, start=2.0, sign=-1, trim=0.01),
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
        (lambda: m.ZigZag("fin", 0.1, 0.1, feedback=("theta",), lead=1.0), "then its rate"),
        (
            lambda: m.ZigZag("fin", 0.1, 0.1, feedback=("theta", "q"), lead=1.0, keep_gain=0.1),
            "then its rate, then the signal kept",
        ),
        (lambda: m.ZigZag("fin", 0.1, 0.1, lead=-1.0), "lead"),
        (lambda: m.Excitation.from_dict({"kind": "waltz"}), r"'waltz'.*zigzag"),
        (lambda: m.Excitation.from_dict({"kind": "zigzag", "speed": 3}), r"'speed'\. It has input"),
        (lambda: m.Excitation.from_dict({"kind": "zigzag", "input": "rudder"}), "lacks a setting"),
        (
            lambda: m.Manoeuvre.from_dict(m.Combined((m.Constant("thrust", 1.0),)).to_dict()),
            r"Excitation\.from_dict",
        ),
    ],
)
def test_bad_settings_are_refused_with_advice(make, words):
    """A setting or a stored kind that makes no sense is refused, and the message names it."""
    with pytest.raises(ModelError, match=words):
        make()


def test_held_commands_ignore_rounding_of_times():
    """Switches fall on the sample meant, although 3 * 0.1 is not 0.3 in binary."""
    times = 0.1 * np.arange(60)
    steps = m.Piecewise("rudder", [0.1 * k + 0.2 for k in range(50)], list(range(50)))
    np.testing.assert_array_equal(steps.commands(times)[2:52], np.arange(50))
    bits = m.PRBS("rudder", 1.0, bit_time=0.1, order=5).commands(times)
    np.testing.assert_array_equal(bits[:31], m.maximum_length_sequence(5))


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


@pytest.mark.parametrize(
    ("manoeuvre", "times", "commands", "duration", "rtol"),
    [
        # Put on at 2 rad/s from 1 s, 0.6 rad is reached after 0.3 s, on any grid.
        (
            m.TurningCircle("rudder", -0.6, start=1.0, rate=2.0),
            [0.9, 1.0, 1.15, 1.3, 7.0],
            [0, 0, -0.3, -0.6, -0.6],
            None,
            1e-7,
        ),
        # The angle is held for the turn, and zero afterwards.
        (
            m.PullOut("rudder", -0.3, turn_duration=20.0, start=5.0),
            [4.9, 5.0, 24.9, 25.0, 99.0],
            [0, -0.3, -0.3, 0, 0],
            45.0,
            0.0,
        ),
        # The first recorded sample is played at start; the ends are held.
        (
            m.FromRecord("rudder", [50.0, 52.0], [0.1, 0.3], interpolation="linear", start=10.0),
            [0.0, 11.0, 12.0, 20.0],
            [0.1, 0.2, 0.3, 0.3],
            12.0,
            1e-7,
        ),
    ],
    ids=["ramp", "pull-out", "replay"],
)
def test_commands_of_the_closed_form(manoeuvre, times, commands, duration, rtol):
    """Ramps are exact between samples, and angles are held for as long as they should."""
    np.testing.assert_allclose(manoeuvre.commands(times), commands, rtol=rtol)
    assert manoeuvre.duration == duration


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


@pytest.mark.parametrize("order", range(2, 17))
def test_prbs_has_the_autocorrelation_of_maximum_length(order):
    """Circular autocorrelation: n at lag zero and -1 elsewhere, for every register."""
    sequence = m.maximum_length_sequence(order, seed=1 + order // 3)
    length = 2**order - 1
    power = np.abs(np.fft.rfft(sequence)) ** 2
    correlation = np.fft.irfft(power, n=length)
    assert set(sequence) == {-1.0, 1.0}
    assert correlation[0] == pytest.approx(length)
    np.testing.assert_allclose(correlation[1:], -1.0, atol=1e-6 * length)


def test_prbs_seed_shifts_and_period_repeats():
    """Another seed gives the same period, shifted; the command repeats after it."""
    sequences = {
        tuple(np.roll(m.maximum_length_sequence(5, seed=seed), -shift))
        for seed in (1, 7, 31)
        for shift in range(31)
    }
    assert len(sequences) == 31
    prbs = m.PRBS("rudder", 0.2, bit_time=3.0, order=5, start=6.0)
    times = np.arange(0, 300, 1.0)
    commands = prbs.commands(times)
    assert not np.any(commands[:6])
    np.testing.assert_array_equal(commands[6:100], commands[6 + 93 : 100 + 93])
    assert prbs.duration == 6.0 + 93.0


def test_multisine_spectrum_lies_on_its_lines_only():
    """The FFT of one period shows the given amplitudes and nothing between them."""
    harmonics, sizes = [2, 3, 5, 11], [0.1, 0.2, 0.05, 0.15]
    signal = m.Multisine("rudder", np.array(harmonics) / 50.0, amplitudes=sizes)
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
    good = m.Multisine("rudder", lines, peak=0.3)
    naive = m.Multisine("rudder", lines, phases=np.zeros(n_lines), peak=0.3)
    naive_crest, crest = (
        one.largest / np.sqrt(np.sum(np.square(one.amplitudes)) / 2) for one in (naive, good)
    )
    assert naive_crest == pytest.approx(np.sqrt(2 * n_lines), rel=2e-3)
    assert crest < 2.0
    np.testing.assert_allclose(good.phases, m.schroeder_phases(np.ones(n_lines)))


@pytest.mark.parametrize("frequencies", [[0.01, 0.02, 0.05], [0.01, 0.01 * np.sqrt(2), 0.031]])
def test_multisine_peak_is_a_limit_and_is_used(frequencies):
    """The command stays below the peak; with a common period it comes within 0.2 %."""
    signal = m.Multisine("rudder", frequencies, amplitudes=[3.0, 2.0, 1.0], peak=0.35)
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
    chirp = m.Chirp(
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


CRUISE = 70.0  # rad/s of a propeller
SWINGS: tuple[m.OpenLoop, ...] = (
    m.ThreeTwoOneOne("n", 15.0, unit_time=2.0, start=1.0),
    m.Doublet("n", 15.0, pulse_time=2.0, start=1.0),
    m.PRBS("n", 15.0, bit_time=1.0, order=4, start=1.0),
    m.Multisine("n", [0.1, 0.2], amplitudes=[5.0, 5.0], start=1.0),
    m.Chirp("n", 15.0, first_frequency=0.1, last_frequency=0.5, sweep_time=10.0, start=1.0),
    m.TurningCircle("n", 15.0, start=1.0, rate=5.0),
    m.PullOut("n", 15.0, turn_duration=5.0, start=1.0, rate=5.0),
    m.Spiral("n", (5.0, 0.0, -5.0), hold=5.0, start=1.0, rate=5.0),
)


@pytest.mark.parametrize("swing", SWINGS, ids=lambda swing: swing.kind)
def test_trim_shifts_the_whole_command(swing: m.OpenLoop) -> None:
    """The command about 70 rad/s is that about zero plus 70, before, during and after."""
    times = np.linspace(0.0, 20.0, 201)
    shifted = replace(swing, trim=CRUISE)
    np.testing.assert_allclose(shifted.commands(times), CRUISE + swing.commands(times))
    assert shifted.commands([0.0])[0] == CRUISE
    assert m.Excitation.from_dict(shifted.to_dict()) == shifted
    older = {"neutral" if name == "trim" else name: v for name, v in shifted.to_dict().items()}
    assert m.Excitation.from_dict(older) == shifted
    assert shifted.commands(times).min() > 50.0


@pytest.mark.parametrize("kind", sorted({type(swing) for swing in SWINGS}, key=str))
def test_old_spelling_of_trim_says_the_new_one(kind: type[m.OpenLoop]) -> None:
    """An argument that is gone names what to write."""
    with pytest.raises(ModelError, match="trim="):
        kind("n", 1.0, neutral=CRUISE)  # type: ignore[call-arg]


def test_reverse_spiral_steers_about_trim() -> None:
    """Without error and before its start a reverse spiral holds the trim command."""
    spiral = m.ReverseSpiral(
        "n", (0.0,), hold=9.0, gain=2.0, reset_time=5.0, limit=0.3, start=1.0, trim=0.1
    )
    control = spiral.controller()
    assert control.command(0.0, {"r": 0.0}) == pytest.approx(0.1)
    assert control.command(1.0, {"r": 0.0}) == pytest.approx(0.1)
    assert control.command(2.0, {"r": -0.05}) == pytest.approx(0.1 + 0.1 + 0.02)


STEP = 0.05


def nomoto(
    manoeuvre,
    *,
    gain,
    time_constant=8.0,
    step=STEP,
    duration=200.0,
    turn_rate=None,
    heading=0.0,
    name="psi",
):
    """Return t, psi, order and angle of T r' + r = K delta; exact for held rudders."""
    control = manoeuvre.controller()
    times = np.arange(0, duration, step)
    rate = angle = 0.0
    rows = []
    decay = math.exp(-step / time_constant)
    for time in times:
        order = control.command(time, {name: heading})
        if turn_rate is None:
            angle = order
        rows.append((heading, order, angle))
        final = gain * angle
        heading += final * step + (rate - final) * time_constant * (1 - decay)
        rate = final + (rate - final) * decay
        if turn_rate is not None:
            angle += min(max(order - angle, -turn_rate * step), turn_rate * step)
    return times, *np.array(rows).T


@pytest.mark.parametrize(("gain", "sign"), [(0.1, 1), (-0.1, -1)])
@pytest.mark.parametrize("first", [1, -1])
def test_zigzag_reverses_at_the_switch(gain, sign, first):
    """The rudder reverses on the first sample beyond +-10 degrees from the approach heading."""
    ten = math.radians(10)
    test = m.ZigZag("rudder", ten, ten, first=first, sign=sign, start=3.0)
    times, headings, commands, _ = nomoto(test, gain=gain, heading=0.7)
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
    plain = m.ZigZag("fin", angle, angle, feedback=("theta",))
    leading = m.ZigZag("fin", angle, 2 * angle, feedback=("theta", "q"), lead=1.5)
    spread = {
        test: [np.abs(drift(test, quick=quick)[:, 0]).max() for quick in (0.5, 2.0)]
        for test in (plain, leading)
    }
    assert max(spread[leading]) <= 2 * angle
    assert max(spread[plain]) > 1.2 * max(spread[leading])


def test_a_zigzag_about_a_keeper_stays_at_its_depth():
    """A vehicle that noses up drifts away, and stays near where the depth is kept."""
    angle = math.radians(10)
    free = m.ZigZag("fin", angle, angle, feedback=("theta",))
    kept = m.ZigZag("fin", angle, angle, feedback=("theta", "z"), keep_gain=0.03)
    gone = [np.abs(drift(test, climb=0.02)[:, 1] - 20.0).max() for test in (free, kept)]
    assert gone[1] < 0.5 * gone[0]
    assert type(kept).from_dict(kept.to_dict()) == kept


def test_zigzag_rate_limit_holds_in_closed_loop():
    """The rudder moves at 5 deg/s at most, reaches both sides and stays around trim."""
    rate, trim = math.radians(5), 0.02
    test = m.ZigZag("rudder", 0.3, 0.2, rate=rate, trim=trim, start=1.0)
    _, _, commands, _ = nomoto(test, gain=0.3, heading=0.7)
    assert np.max(np.abs(np.diff(commands))) == pytest.approx(rate * STEP)
    assert commands[0] == trim
    assert commands.max() == pytest.approx(0.3 + trim)
    assert commands.min() == pytest.approx(-0.3 + trim)


def test_zigzag_like_changes_its_swings():
    """Each swing has its own amplitude and switch; the last ones are kept."""
    dive = m.ZigZagLike("fin_command", (0.35, 0.2, 0.1), (0.2, 0.1), start=2.0)
    times, pitch, commands, _ = nomoto(dive, gain=-0.3, name="theta")
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
    control = m.ZigZag("rudder", 0.2, 0.1).controller()
    headings = [math.nan, 1.0, 1.05, math.nan, 1.11, math.nan]
    commands = [control.command(time, {"psi": psi}) for time, psi in enumerate(headings)]
    assert commands == [0.2, 0.2, 0.2, 0.2, -0.2, -0.2]


def test_controller_misuse_is_explained():
    """A missing signal, a time that runs back and open-loop use of feedback are refused."""
    test = m.ZigZag("rudder", 0.2, 0.1)
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
    trial = m.Combined([m.Constant("thrust", 700.0), m.ZigZag("rudder", 0.2, 0.1, feedback="psi")])
    controllers = trial.controllers()
    assert trial.feedback == ("psi",)
    assert trial.duration is None
    assert m.command_all(controllers, 0.0, {"psi": 0.0}) == {"thrust": 700.0, "rudder": 0.2}
    assert m.command_all(controllers, 1.0, {"psi": 0.2}) == {"thrust": 700.0, "rudder": -0.2}
    with pytest.raises(ModelError, match="once only"):
        m.Combined((m.Constant("thrust", 1.0), m.Constant("thrust", 2.0)))
    with pytest.raises(ModelError, match="at least one"):
        m.Combined(())
    with pytest.raises(ModelError, match="got a Combined"):
        m.Combined((trial,))


def test_sequence_runs_each_part_on_its_own_clock():
    """A zigzag after a doublet takes its reference heading when its turn comes."""
    parts = m.Sequence((m.Doublet("rudder", 0.2, pulse_time=2.0), m.ZigZag("rudder", 0.1, 0.05)))
    control = parts.controller()
    headings = {0: 0.0, 2: 0.5, 4: 1.0, 5: 1.04, 6: 1.06}
    commands = [control.command(time, {"psi": psi}) for time, psi in headings.items()]
    assert commands == [0.2, -0.2, 0.1, 0.1, -0.1]
    assert parts.duration is None
    assert m.Sequence(parts.manoeuvres[:1]).duration == 4.0
    with pytest.raises(ModelError, match="Give durations"):
        m.Sequence((m.ZigZag("rudder", 0.1, 0.05), m.Constant("rudder", 0.0)))
    with pytest.raises(ModelError, match="Use Combined"):
        m.Sequence((m.Constant("rudder", 0.0), m.Constant("thrust", 0.0)), durations=[1.0])
    with pytest.raises(ModelError, match="3 durations"):
        m.Sequence(
            (m.Constant("rudder", 0.0), m.Constant("rudder", 1.0)), durations=[1.0, 2.0, 3.0]
        )


def test_wrappers_pass_feedback_on():
    """A zigzag cut off and slowed still reacts to the heading."""
    slow = m.RateLimited(m.Saturated(m.ZigZag("rudder", 0.3, 0.1), 0.2), 0.1)
    assert slow.feedback == ("psi",)
    assert slow.input == "rudder"
    _, headings, commands, _ = nomoto(slow, gain=0.3)
    assert np.max(np.abs(commands)) == pytest.approx(0.2)
    assert np.max(np.abs(np.diff(commands))) == pytest.approx(0.1 * STEP)
    assert headings.max() > 0.1
    assert headings.min() < -0.1
    with pytest.raises(ModelError, match="got a str"):
        m.Saturated("zigzag", 0.2)


def test_saturation_leaves_small_commands_alone():
    """Below the limit the wrapped commands are unchanged."""
    prbs = m.PRBS("rudder", 0.1, bit_time=1.0)
    times = np.arange(0, 100.0)
    np.testing.assert_array_equal(m.Saturated(prbs, 0.2).commands(times), prbs.commands(times))


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
    result = m.turning_indices(times, x, y, wrapped, execute=approach)
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
    assert m.turning_indices(times, x, y, heading).drift == pytest.approx(drift, abs=2e-3)


def test_measured_speed_gives_the_speed_loss():
    """A log that falls to 60 percent by the steady turn gives that ratio."""
    times, x, y, heading = circle()
    speed = 8.0 * (0.6 + 0.4 * np.exp(-times / 10))
    result = m.turning_indices(times, x, y, heading, speed=speed)
    assert result.steady_speed_ratio == pytest.approx(0.6, abs=1e-3)


def test_noise_is_averaged_in_the_steady_radius():
    """With 1 m position noise the radius of 150 m is right within 1 m, over 20 seeds."""
    times, x, y, heading = circle()
    errors = []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(size=(2, len(times)))
        result = m.turning_indices(times, x + noise[0], y + noise[1], heading)
        errors.append(result.steady_radius - RADIUS)
    assert np.sqrt(np.mean(np.square(errors))) < 1.0


def test_short_turns_are_refused_or_left_without_steady_values():
    """Below 180 degrees an error says what was reached; below 450 there is no steady part."""
    times, x, y, heading = circle(turned=math.radians(150), step=0.01)
    with pytest.raises(DataError, match=r"reaches 150\.\d degrees"):
        m.turning_indices(times, x, y, heading)
    result = m.turning_indices(*circle(turned=math.radians(400)))
    assert result.steady_radius is None
    assert result.steady_diameter is None
    assert "too short" in result.report()
    assert m.turning_indices(*circle(turned=math.radians(400)), steady_from=math.pi).steady_radius


@pytest.mark.parametrize("first", [1, -1])
def test_zigzag_of_nomoto_model(first):
    """Overshoot of T r' + r = K delta after reversal at yaw rate r: closed form.

    With F = K delta the rate after the reversal is (r + F) exp(-t/T) - F, zero
    at T ln(1 + r/F), where the heading has grown by T r - F T ln(1 + r/F).
    """
    gain, time_constant, ten = 0.12, 10.0, math.radians(10)
    test = m.ZigZag("rudder", ten, ten, first=first, start=4.0)
    times, heading, order, _ = nomoto(test, gain=gain, time_constant=time_constant, step=0.02)
    speed = np.full_like(times, 6.0)
    result = m.zigzag_indices(times, heading + 3.1, order, speed=speed)

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
    assert result.overshoots[0] == pytest.approx(time_constant * rate - push * zero, rel=1e-4)
    assert result.check_times[0] == pytest.approx(zero, abs=0.002)
    assert result.overshoots[1] > result.overshoots[0]
    assert result.period == pytest.approx(result.executes[3] - result.executes[1])
    zero_heading = times[np.flatnonzero((times > 4.0) & (first * heading < 0))[0]]
    assert result.reach == pytest.approx(zero_heading - 4.0, abs=0.021)
    assert "overshoot" in result.report()
    assert tuple(result.to_dict()["executes"]) == result.executes


def test_order_and_slow_rudder_angle_agree():
    """Executes found from the order and from a 3 deg/s rudder angle differ by a sample."""
    test = m.ZigZag("rudder", 0.3, 0.2, start=5.0)
    times, heading, order, angle = nomoto(
        test, gain=0.1, time_constant=9.0, step=0.1, turn_rate=math.radians(3)
    )
    by_order = m.zigzag_indices(times, heading, order)
    by_angle = m.zigzag_indices(times, heading, angle)
    np.testing.assert_allclose(by_angle.executes, by_order.executes, atol=0.11)
    np.testing.assert_allclose(by_angle.overshoots, by_order.overshoots, atol=2e-3)


def test_executes_of_a_noisy_slow_rudder():
    """Ramps of 3 deg/s under noise of 0.4 deg tell to 0.2 s when each order was given."""
    rng = np.random.default_rng(0)
    off = []
    for _ in range(20):
        begins = np.cumsum([10.0 + 5.0 * rng.random(), *(40.0 + 30.0 * rng.random(4))])
        times = np.arange(0.0, begins[-1] + 60.0, 0.5)
        legs = [-20.0 * (-1.0) ** k for k in range(1, 5)]
        moves = np.clip(3.0 * (times[:, None] - begins), 0.0, [10.0, *np.abs(legs)])
        angle = moves @ [1.0, *-np.sign(legs)] + 0.4 * rng.standard_normal(len(times))
        off.append(rudder_legs(times, np.radians(angle)).begins - begins)
    assert np.sqrt(np.mean(np.square(off))) < 0.2


def test_zigzag_in_a_wrapped_heading():
    """A compass that jumps at 180 degrees gives the same indices."""
    ten = math.radians(10)
    times, heading, order, _ = nomoto(m.ZigZag("rudder", ten, ten), gain=0.2, time_constant=5.0)
    wrapped = np.angle(np.exp(1j * (heading + math.pi)))
    np.testing.assert_allclose(
        m.zigzag_indices(times, wrapped, order).overshoots,
        m.zigzag_indices(times, heading, order).overshoots,
        atol=1e-12,
    )


def test_zigzag_that_ends_early_is_explained():
    """No reversal, or no turning back after it, is refused with the reason."""
    ten = math.radians(10)
    times, heading, order, _ = nomoto(m.ZigZag("rudder", ten, ten), gain=0.12, time_constant=10.0)
    second = int(np.flatnonzero(np.diff(order))[0]) + 1
    with pytest.raises(DataError, match="never reversed"):
        m.zigzag_indices(times[:second], heading[:second], order[:second])
    short = slice(0, second + 20)
    with pytest.raises(DataError, match="before the heading turns back"):
        m.zigzag_indices(times[short], heading[short], order[short])
    longer = slice(0, second + 800)
    result = m.zigzag_indices(times[longer], heading[longer], order[longer], execute=0.0)
    assert len(result.overshoots) < 2 or result.period is None


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
        m.turning_indices(**record)
