"""The check of logs: every kind of fault named with its size, and silence on clean logs."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import patrol_boat
import pytest
from altered import altered, overwritten, part, trials
from kinematic_logs import (
    DIVER,
    ESSO,
    HSVA,
    SHIP,
    Fault,
    Vehicle,
    free_running,
    log,
    match,
    read_filled,
)
from marks import slow
from motion import UNITS, outputs, small, states
from scipy.fft import dct
from scipy.linalg import expm
from scipy.signal import lfilter
from simple_models import nomoto
from yaw_vehicle import TRUE, yaw_data, yaw_model

from benchmarks.spoilt_logs import COPIES as SPOILS
from benchmarks.spoilt_logs import Act, named_as, replayed, spoil
from oed_sysid import Experiment, Input, Model, Output, Solver, State, ZigZag, check, simulate
from oed_sysid.cli import main
from oed_sysid.data.dataset import Dataset, Record, read_csv, write_csv
from oed_sysid.evidence import inputs
from oed_sysid.evidence.check import LogCheck, advised, corrected_copies, with_estimates
from oed_sysid.evidence.contrasts import Candidate, Found, contrasts, fitted_law, laws, readings
from oed_sysid.evidence.corrections import as_measured, lagged
from oed_sysid.evidence.inputs import between_runs, scaled_inputs
from oed_sysid.evidence.readings import Evidence, as_readings
from oed_sysid.evidence.relations import Relation, integral, relations, spare_signals
from oed_sysid.evidence.result import Correction
from oed_sysid.evidence.screens import screen
from oed_sysid.evidence.traces import Trace
from oed_sysid.evidence.words import rival
from oed_sysid.experiments.problem import Problem, load_problem
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_levels import first_order
from oed_sysid.likelihood.start_guess import kinematic_states, measured_states
from oed_sysid.physics import Force, actuator_delay, sensor_bias, sensor_scale
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.constants import BEYOND


@pytest.fixture(scope="module")
def dives() -> tuple:
    """Three simulated runs of the diving plane with declared noise, and their problem."""
    problem = load_problem("remus_diving_plane")
    runs = [problem.experiments[n] for n in ("zigzag_5_5", "zigzag_10_10", "steps")]
    return problem, trials(problem.model, runs, 4)


# Copies of which `make test` checks one of each way to find a fault, in one record; signs, columns,
# biases and delays are there in other tests.
QUICK = ("q_deg", "spikes", "w_dead")

# -- spoilt copies ---------------------------------------------------------------------------


def test_simulated_records_are_clean(dives) -> None:  # type: ignore[no-untyped-def]
    """Records that agree raise nothing suspect, in full and in the quick part."""
    problem, data = dives
    found = check(data, problem)
    assert found.ok
    assert found.warning() == ""
    assert check(data, problem.model).ok
    assert len(found.relations) == 2


@pytest.fixture(scope="module")
def judged(dives) -> Callable[[str], tuple[Dataset, LogCheck]]:  # type: ignore[no-untyped-def]
    """Each spoilt copy with what the check finds in it, checked once."""
    problem, data = dives

    @cache
    def found(name: str) -> tuple[Dataset, LogCheck]:
        copy = spoil(Dataset(data.records[:1]) if name in QUICK else data, name)
        return copy, check(copy, problem)

    return found


@pytest.mark.parametrize("name", [*QUICK, *slow(*(name for name in SPOILS if name not in QUICK))])
def test_spoilt_copy_is_named_and_nothing_else(judged, name: str) -> None:  # type: ignore[no-untyped-def]
    """Each of fifteen spoilt copies of a simulated record is named exactly."""
    assert named_as(judged(name)[1], name)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("q_deg", 'write the header as "q [deg/s]"'),
        *slow(
            ("theta_sign", 'Output("theta", "rad", sign=-1)'),
            ("u_w_swap", 'Output("u", "m/s", column="w")'),
            ("fin_sign", 'Input("fin_command", "rad", sign=-1)'),
            ("earth", 'expression="-u*sin(theta) + w*cos(theta)"'),
        ),
    ],
)
def test_fix_is_a_line_for_the_problem_file(judged, name: str, line: str) -> None:  # type: ignore[no-untyped-def]
    """The line to write stands in the finding."""
    assert line in judged(name)[1].serious[0].fix


@pytest.mark.parametrize(
    "name", ["spikes", *slow("theta_sign", "u_w_swap", "earth", "z_late", "q_bias")]
)
def test_corrected_copy_is_clean(dives, judged, tmp_path, name: str) -> None:  # type: ignore[no-untyped-def]
    """A corrected copy, written and read back, passes; what was done is said."""
    problem, _ = dives
    data, found = judged(name)
    copies, done = corrected_copies(data, problem, found)
    assert len(done) == 1
    for record in copies:
        write_csv(record, tmp_path / f"{record.name}.csv")
    again = read_csv(tmp_path, problem.channels)
    assert check(again, problem, inputs=False).ok


# -- sizes -----------------------------------------------------------------------------------

SIZED = [
    (DIVER, Fault("lever", ("w",), 0.5, "q")),
    *slow(
        (DIVER, Fault("bias", ("q",), 0.006)),
        (SHIP, Fault("scale", ("u",), 0.04)),
        (SHIP, Fault("delay", ("x", "y"), 0.8)),
        (DIVER, Fault("scale", ("u",), -0.05)),
        (DIVER, Fault("delay", ("z",), 0.6)),
        (SHIP, Fault("bias", ("v",), 0.1)),
        (SHIP, Fault("lever", ("v",), -4.0, "r")),
    ),
]


@pytest.mark.parametrize(("vehicle", "fault"), SIZED, ids=lambda x: getattr(x, "kind", ""))
def test_size_of_a_fault_lies_within_four_standard_deviations(
    vehicle: Vehicle, fault: Fault
) -> None:
    """A fault of one size is the only finding, and its interval is not far from the truth."""
    found = check(log(vehicle, fault), vehicle.model, inputs=False)
    one = match(found, fault)
    assert len(found.serious) == 1
    assert one is not None
    assert one.size is not None
    assert one.interval is not None
    half = 0.5 * (one.interval[1] - one.interval[0])
    assert abs(one.size - fault.size) < 2.0 * half
    assert half < 0.2 * abs(fault.size)


@pytest.mark.slow
def test_lag_of_all_but_the_positions_is_said_of_them() -> None:
    """Positions that come first mean that everything else is late."""
    found = check(log(SHIP, Fault("delay", ("u", "v", "psi", "r"), 0.9)), SHIP.model, inputs=False)
    one = found.serious[0]
    assert len(found.serious) == 1
    assert set(one.signals) == {"u", "v", "psi", "r"}
    assert one.size == pytest.approx(0.9, abs=0.05)


@pytest.mark.parametrize("late", ["psi", "r"])
def test_of_two_signals_one_late_is_the_other_early_and_no_second_fault(late: str) -> None:
    """Nothing is measured before it happens; the delay of the other is told as the same."""
    whole = log(SHIP, Fault("delay", (late,), 0.4))
    kept = [np.nan if name not in ("psi", "r") else 1.0 for name in whole.channels.output_names]
    data = Dataset(record.with_outputs(record.outputs * kept) for record in whole)
    found = check(data, SHIP.model, inputs=False)
    (one,) = found.serious
    assert (one.kind, one.signals, one.alternatives) == ("delay", (late,), ())
    assert one.size == pytest.approx(0.4, abs=0.1)
    states = {a.signal: a.state for a in found.judged if a.fault == "delay"}
    assert states[late] == "found"


def test_earth_fixed_velocities_at_rates_of_their_own_are_named() -> None:
    """Positions, velocities and heading are seldom measured at the same samples."""

    def every(n: int, series: np.ndarray) -> np.ndarray:
        return np.where(np.arange(series.size) % n, np.nan, series)

    def fixed(record: Record, turn: float) -> np.ndarray:
        level = record.output("u") + 1j * record.output("v")
        return every(2, (level * np.exp(1j * (record.output("psi") - turn))).real)

    data = altered(
        log(SHIP, runs=1),
        x=lambda record: every(5, record.output("x")),
        y=lambda record: every(5, record.output("y")),
        u=lambda record: fixed(record, 0.0), v=lambda record: fixed(record, 0.5 * np.pi),
    )  # fmt: skip
    (found,) = check(data, SHIP.model, inputs=False).serious
    assert (found.kind, found.signals) == ("frame", ("u", "v"))


def test_bias_of_pitch_and_misalignment_are_one_group() -> None:
    """What kinematics cannot tell apart is named as a group."""
    data = altered(
        log(DIVER, runs=2),
        u=lambda record: record.output("u") - 0.04 * record.output("w"),
        w=lambda record: record.output("w") + 0.04 * record.output("u"),
    )
    found = check(data, DIVER.model, inputs=False)
    assert len(found.serious) == 1
    text = " ".join((found.serious[0].name, *found.serious[0].alternatives))
    assert "bias" in text
    assert "theta" in text
    assert "misalignment" in text


@pytest.mark.parametrize("angle", [90.0, *slow(45.0, 180.0)])
def test_turned_velocities_and_a_heading_that_is_off_are_one_group(angle: float) -> None:
    """A log that is mounted wrong by any angle blames the heading, and the velocities as well."""
    cos, sin = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    data = altered(
        log(SHIP, runs=1),
        u=lambda record: cos * record.output("u") + sin * record.output("v"),
        v=lambda record: cos * record.output("v") - sin * record.output("u"),
    )
    found = check(data, SHIP.model, inputs=False)
    assert len(found.serious) == 1
    told = (found.serious[0].name, *found.serious[0].alternatives)
    assert any("psi" in one for one in told)
    # Both of the other sign are turned by half a turn.
    (turned,) = (one for one in told if "u and v" in one and "other sign" not in one)
    size = 180.0 if "180 deg" in turned else float(turned.split("(")[1].split()[0])
    assert abs(size) == pytest.approx(angle, abs=0.5)


def test_sensor_effect_of_the_model_is_no_alarm() -> None:
    """A bias that the model allows for is told, but does not make the log suspect."""
    model = DIVER.model + sensor_bias("bias_q", "q", "rad/s", scale=0.01)
    data = log(DIVER, Fault("bias", ("q",), 0.008), runs=2)
    records = tuple(replace(record, channels=model.channels) for record in data)
    found = check(Dataset(records), model, inputs=False)
    assert found.ok
    assert found.named("bias", "q") is not None


LOCAL = [
    ("step", "q", 0.012, lambda y, t: y + 0.012 * (t >= 0.4)),
    *slow(
        ("bias", "q", -0.01, lambda y, t: y - 0.01),
        ("drift", "q", 0.03 / 87.0, lambda y, t: y + 0.03 * t),
    ),
    ("burst", "z", 0.3, lambda y, t: y + 0.3 * ((t >= 0.5) & (t < 0.512))),
    ("scale", "u", 0.08, lambda y, t: 1.08 * y),
]


@pytest.mark.parametrize(("kind", "name", "size", "change"), LOCAL, ids=lambda x: str(x)[:6])
def test_faults_of_one_record_are_named_there(kind, name, size, change) -> None:  # type: ignore[no-untyped-def]
    """A bias, step, drift, burst and scale in the second of three records, within a fifth."""
    data = log(DIVER)
    y = data[1].output(name)
    spoilt = altered(data, 1, **{name: change(y, np.linspace(0.0, 1.0, y.size))})
    found = check(spoilt, DIVER.model, inputs=False)
    one = found.serious[0]
    assert (one.kind, one.signals, one.records) == (kind, (name,), ("run_1",))
    assert one.size == pytest.approx(size, rel=0.2)
    assert len(found.serious) == 1 or kind != "bias"


def test_rate_of_a_clock_is_told_from_a_delay() -> None:
    """A depth whose clock runs one per cent slow: 0.9 s at the end, none at the beginning."""

    def slow(record: Record) -> np.ndarray:
        times = record.times - record.times[0]
        return np.interp(0.99 * times, times, record.output("z"))

    data = altered(log(DIVER, runs=2), z=slow)
    (one,) = check(data, DIVER.model, inputs=False).serious
    assert (one.kind, one.signals) == ("clock", ("z",))
    assert one.size == pytest.approx(0.01, abs=0.002)


def test_made_samples_are_told() -> None:
    """A depth that was joined by straight lines, and a column that was written twice."""

    def joined(record: Record) -> np.ndarray:
        return np.interp(record.times, record.times[::5], record.output("z")[::5])

    (one,) = check(altered(log(DIVER), z=joined), DIVER.model, inputs=False).serious
    assert (one.kind, one.signals) == ("interpolated", ("z",))
    assert one.size == pytest.approx(0.5, abs=0.02)
    twice = altered(log(DIVER), 0, w=lambda record: record.output("u"))
    assert check(twice, DIVER.model, inputs=False).serious[0].kind == "copied"


def test_a_fit_counts_what_was_measured() -> None:
    """A value held for ten samples counts once: the error of a slope is that of the line.

    Counted as logged it would be too small by the root of ten.
    """
    rng, t = np.random.default_rng(5), 0.1 * np.arange(2000)
    model = small("line", "x [m]", {"x": "a"}, {"a [m/s]": 0.1})
    slow = 0.2 * t[::10] + 0.3 * rng.standard_normal(200)
    record = Record("run", t, np.zeros((2000, 0)), np.repeat(slow, 10)[:, None], model.channels)
    logged = Dataset((record,))
    found = check(logged, model)
    measured, words = as_measured(logged, found)
    assert found.ok
    assert "x was measured every 1 s" in words[0]
    kept = np.isfinite(measured[0].output("x"))
    assert np.array_equal(np.flatnonzero(kept), np.arange(0, 2000, 10))
    fitter = MultipleShooting(coloured="never", disturbances="none")
    fit, blind = (fitter.fit(model, data) for data in (measured, logged))
    line = 0.3 / np.sqrt(np.sum((t[::10] - t[::10].mean()) ** 2))
    assert fit.std_errors["a"] == pytest.approx(line, rel=0.1)
    assert abs(fit.values["a"] - 0.2) < 3.0 * line
    assert blind.std_errors["a"] == pytest.approx(line / np.sqrt(10.0), rel=0.1)
    assert as_measured(measured, check(measured, model)) == (measured, ())


def test_what_was_tested_is_said() -> None:
    """Every signal and fault has a row; sizes are those that a fault of that size shows from."""
    found = check(log(DIVER, runs=2), DIVER.model)
    rows = {(one.fault, one.signal): one for one in found.judged}
    assert rows["bias", "q"].state == "tested"
    assert rows["bias", "z"].state == "not tested"
    assert rows["step", "q"].state == rows["jitter", "theta"].state == "tested"
    assert rows["sign", "fin"].state == "not tested"
    assert "fin" in found.verdict
    assert "What was tested" in found.report()
    spoilt = check(log(DIVER, Fault("bias", ("q",), 0.006), runs=2), DIVER.model)
    assert {(o.fault, o.signal) for o in spoilt.judged if o.state == "found"} == {("bias", "q")}


def test_an_input_in_degrees_is_beyond_its_limit() -> None:
    """Degrees under rad are named even where no parameter has a prior to hold them against."""
    data = log(DIVER)
    fin = 0.3 * np.sign(np.sin(0.3 * data[0].times))[:, None]
    right = Dataset(tuple(replace(r, inputs=fin) for r in data))
    wrong = Dataset(tuple(replace(r, inputs=np.degrees(fin)) for r in data))
    assert check(right, DIVER.model).ok
    found = check(wrong, DIVER.model)
    assert [one.name for one in found.serious] == ["limit fin"]
    assert found.suspect


# -- screens ---------------------------------------------------------------------------------


def test_a_kink_is_no_spike() -> None:
    """A rudder that moves at its rate limit leaves no spike in a noise-free rate."""
    t = np.arange(400) * 0.1
    y = np.interp(t, [0.0, 10.0, 12.0, 25.0, 27.0, 40.0], [0.0, 0.0, 1.0, 1.0, -1.0, -1.0])
    assert not screen(Trace("run", t, {"y": y}, {"y": "m"}, {"y": 0.0}))


def test_copy_of_a_record_is_recognised_when_shifted_and_thinned() -> None:
    """The same samples under another name, time and rate are a copy."""
    data = log(DIVER)
    first = data[0]
    copy = replace(first.thin(3).rename("another"), times=first.thin(3).times + 1000.0)
    found = check(Dataset((*data.records, copy)), DIVER.model, inputs=False)
    one = found.named("duplicate")
    assert one is not None
    assert set(one.records) == {first.name, "another"}


def test_step_of_the_clock_is_told_from_a_gap() -> None:
    """Missing time changes the position; a clock that was set does not."""
    data = log(DIVER)
    record = data[0]
    later = record.times + np.where(np.arange(record.n_samples) >= 400, 5.0, 0.0)
    jumped = Dataset((replace(record, times=later), *data.records[1:]))
    assert check(jumped, DIVER.model, inputs=False).named("clock") is not None
    kept = np.r_[0:400, 450 : record.n_samples]
    gap = Dataset((part(record, kept), *data.records[1:]))
    found = check(gap, DIVER.model, inputs=False)
    assert found.named("clock") is None
    assert found.named("gap") is not None
    assert found.ok


# -- mathematics -----------------------------------------------------------------------------


def test_integral_is_of_fourth_order() -> None:
    """Half the step leaves about a sixteenth of the error inside a record."""
    errors = []
    for n in (40, 80):
        t = np.linspace(0.0, 6.0, n + 1)
        errors.append(np.abs(integral(t, np.cos(t)[:, None])[n // 3, 0] - np.sin(t[n // 3])))
    assert errors[1] < errors[0] / 4.0
    assert errors[0] < 1e-3


def afloat(names: list[str], scale: float) -> tuple[Model, Dataset]:
    """Depth, heave velocity and altitude, which is scaled, of a float at rest and in motion."""
    model = Model(
        "float", states("z w"), (Input("T", "N"),),
        (*outputs("z w"), Output("alt", "m", expression="30 - z")),
        {"z": "w", "w": "k*T - d*w"}, parameters=(Parameter("k", 0.1), Parameter("d", 0.3)),
    )  # fmt: skip
    model = replace(model, outputs=tuple(o for o in model.outputs if o.name in names))
    rng, t, runs = np.random.default_rng(0), np.arange(500) * 0.5, []
    for moved in (0.0, 1.0, 1.3):
        z = 15.0 + moved * (3.0 * np.sin(0.06 * t) + np.cos(0.17 * t))
        w = moved * (0.18 * np.cos(0.06 * t) - 0.17 * np.sin(0.17 * t))
        right = {"z": z, "w": w, "alt": scale * (30.0 - z)}
        noise = {"z": 0.02, "w": 0.02, "alt": 0.05}
        logged = [right[n] + noise[n] * rng.standard_normal(t.size) for n in names]
        nothing = np.zeros((t.size, 1))
        runs.append(Record(f"{moved}", t, nothing, np.column_stack(logged), model.channels))
    return model, Dataset(runs)


@pytest.mark.parametrize("names", ["z w", "z alt", "z w alt"])
def test_noise_is_no_scale_of_the_signal_that_it_is_in(names: str) -> None:
    """A run at rest makes no sensor wrong, nor do signals that would agree if all were nothing."""
    model, data = afloat(names.split(), 1.0)
    assert check(data, model, inputs=False).ok


@pytest.mark.parametrize("names", ["z alt", "z w alt"])
def test_a_scale_is_found_beside_a_run_at_rest(names: str) -> None:
    """An altitude that is 5 % too large is all that is wrong; of two depths either may be."""
    model, data = afloat(names.split(), 1.05)
    (found,) = check(data, model, inputs=False).serious
    assert found.kind == "scale"
    assert abs(found.size) == pytest.approx(0.05, abs=0.003)
    assert names == "z alt" or found.signals == ("alt",)


def rolling(seed: int, late: int = 0) -> tuple[Model, Dataset]:
    """Roll and its rate, five samples a period, of a hull that is steered by six sines in gusts."""
    model = Model("roll", states("phi p"), (), outputs("phi p"), {"phi": "p", "p": "-p"})
    rng, t, dt = np.random.default_rng(seed), 0.8 * np.arange(420), 0.1
    lines = 2.0 * np.pi * np.arange(1, 7) / rng.uniform(32.0, 64.0)
    phases = rng.uniform(0.0, 2.0 * np.pi, 6)

    def rates(x: np.ndarray, rudder: float, force: float) -> np.ndarray:
        p, r, phi = x
        yaw = 0.22 * rudder - 0.35 * r - 1.3 * r * abs(r) + 0.05 * phi
        return np.array([force + 0.7 * rudder - 2.5 * r - 0.55 * p - 2.7 * np.sin(phi), yaw, p])

    x, force, rudder, seen = np.zeros(3), 0.0, 0.0, []
    for k in range(8 * t.size):
        if k % 8 == 0:  # commands are held from sample to sample
            rudder = float(np.clip(np.sin(lines * dt * k + phases).sum() / 15.0, -0.3, 0.3))
            seen.append(x)
        force += -0.5 * dt * force + 0.006 * np.sqrt(dt) * rng.standard_normal()
        middle = x + 0.5 * dt * rates(x, rudder, force)
        x = x + dt * rates(x + 0.5 * dt * rates(middle, rudder, force), rudder, force)
    right = np.array(seen)[:, [2, 0]]
    right[late:, 1] = right[: t.size - late, 1]
    logged = right + [0.0074, 0.0089] * rng.standard_normal((t.size, 2))
    return model, Dataset((Record("run", t, np.zeros((t.size, 0)), logged, model.channels),))


@pytest.mark.parametrize("seed", [29, 34])
def test_signals_are_not_late_together_by_a_period(seed: int) -> None:
    """Undone, two delays of 4.4 and 4.7 s, or two clocks, left more than there was."""
    model, data = rolling(seed)
    assert not check(data, model).findings


def test_a_late_signal_of_a_periodic_motion_is_found() -> None:
    """A rate that is a sample late, or the angle that is early, is all that is wrong."""
    model, data = rolling(29, late=1)
    (found,) = check(data, model).serious
    assert (found.kind, abs(found.size)) == ("delay", pytest.approx(0.8, abs=0.1))


def rolling_fast(every: int, logged: float = 1.0) -> tuple[Model, Dataset]:
    """Roll of about 2.8 s every 0.4 s, and its rate at every so many samples."""
    model = Model("roll", states("phi p"), (), outputs("phi p"), {"phi": "p", "p": "-p"})
    rng, t = np.random.default_rng(3), 0.4 * np.arange(400)
    size, angle = 0.08 + 0.03 * np.sin(0.21 * t), 2.2 * t + 0.8 * np.sin(0.13 * t)
    phi = size * np.sin(angle)
    p = 0.0063 * np.cos(0.21 * t) * np.sin(angle)
    p += size * np.cos(angle) * (2.2 + 0.104 * np.cos(0.13 * t))
    measured = np.column_stack([phi, logged * p]) + [0.009, 0.018] * rng.standard_normal((400, 2))
    measured[np.arange(400) % every > 0, 1] = np.nan
    return model, Dataset((Record("run", t, np.zeros((400, 0)), measured, model.channels),))


@pytest.mark.parametrize("every", [5, 6])
def test_a_rate_that_is_sampled_too_seldom_is_not_asked(every: int) -> None:
    """Fewer than two samples a period: of six, a right angle was 'converted from deg twice'."""
    model, data = rolling_fast(every)
    found = check(data, model)
    assert not found.findings
    assert "Whether phi' = p: too few samples, phi moves between them." in found.unchecked


def test_a_rate_that_is_sampled_seldom_enough_is_asked() -> None:
    """Of three and a half samples a period a wrong sign is named."""
    model, data = rolling_fast(2, logged=-1.0)
    assert check(data, model).serious[0].kind == "sign"


def test_a_depth_in_millimetres_is_named() -> None:
    """What is a thousand times too large is its own noise, in which no scale stands out."""
    model, data = afloat(["z", "w"], 1.0)
    spoilt = altered(data, z=lambda record: 1000.0 * record.output("z"))
    (found,) = check(spoilt, model, inputs=False).serious
    assert (found.kind, found.signals) == ("unit", ("z",))


@pytest.mark.parametrize("named", ["dot(u)", "push - c*u", "a"])
def test_accelerations_are_held_against_their_velocity(named: str) -> None:
    """Right ones agree although a thrust that is held makes them jump; late and wrong ones do not.

    By the exact solution over each step, whatever the output calls the acceleration.
    """
    signals, law = {"a": "push - c*u"}, {"u": "a" if named == "a" else "push - c*u"}
    model = Model(
        "sled", (State("u", "m/s"),), (Input("push", "m/s^2"),),
        (Output("u", "m/s"), Output("ax", "m/s^2", expression=named)), law,
        signals=signals if named == "a" else {}, parameters=(Parameter("c", 0.6, "1/s"),),
    )  # fmt: skip
    rng, t = np.random.default_rng(0), 0.2 * np.arange(400)
    push = np.sin(np.outer(t, 2.0 * np.pi / np.array([7.0, 11.0, 17.0]))).sum(axis=1)
    u = first_order(np.append(0.0, 2.0 * push[:-1]), 1.0 - np.exp(-0.1))
    right = push - 0.5 * u

    def found(ax: np.ndarray) -> list:
        noisy = np.column_stack([u, ax]) + [0.01, 0.02] * rng.standard_normal((400, 2))
        record = Record("run", t, push[:, None], noisy, model.channels)
        return check(Dataset((record,)), model).findings

    assert not found(right)
    if named != "push - c*u":  # a force without a name is no measured one
        late = found(np.append(right[:1].repeat(2), right[:-2]))[0]
        assert (late.kind, late.signals) == ("delay", ("ax",))
        assert late.size == pytest.approx(0.4, abs=0.05)
        turned = found(-right)[0]
        assert turned.kind == "sign"
        assert {*turned.signals} <= {"u", "ax"}  # one equation tells that one of them is


@pytest.mark.parametrize("logged", [1.0, 1.1])
def test_accelerations_that_are_held_make_no_scale(logged: float) -> None:
    """Between samples a velocity moves on straight lines; splines take 2 % of it away.

    A real error of 10 % leads what is found, and its interval holds both.
    """
    law = {"z": "w", "w": "A*push"}
    buoy = small("buoy", "z [m], w [m/s] <- push [m/s^2]", law, {"A": 1.0}, step=0.5)
    rng, t = np.random.default_rng(0), 0.5 * np.arange(400)
    push = np.cos(2.0 * np.pi * t / 6.0)
    w = np.append(0.0, np.cumsum(0.5 * push)[:-1])
    z = np.append(0.0, np.cumsum(0.25 * (w[1:] + w[:-1])))
    measured = np.column_stack([z, logged * w]) + 0.01 * rng.standard_normal((400, 2))
    record = Record("run", t, push[:, None], measured, buoy.channels)
    found = check(Dataset((record,)), buoy, inputs=False).serious
    assert bool(found) == (logged != 1.0)
    for one in found[:1]:
        assert (one.kind, one.signals) == ("scale", ("w",))
        assert one.interval[0] < 0.1 < one.interval[1]


def test_noise_of_an_equation_is_recovered() -> None:
    """Levels of white noise plus a random walk come out within their own error."""
    rng = np.random.default_rng(0)
    law = laws(np.pi * np.arange(1, 240) / 240)
    found = []
    for _ in range(20):
        walks = np.cumsum(0.3 * rng.standard_normal((3, 240)), axis=1)
        noise = rng.standard_normal((3, 240)) + walks + 5.0
        power = (dct(noise, axis=1, norm="ortho")[:, 1:] ** 2).ravel()
        shares = fitted_law(power, np.tile(law, 3), np.zeros(len(law)))
        found.append(shares @ law / (1.0 + 0.09 * law[4]))
    ratio = np.mean(found, axis=0)
    assert np.all(ratio[:10] > 0.7)
    assert np.all(ratio[:10] < 1.4)
    assert np.all(np.abs(ratio[20:] - 1.0) < 0.15)


def test_noise_laws_are_those_of_the_transform() -> None:
    """White noise, a random walk and first-order noise have the variances that are said."""
    rng = np.random.default_rng(1)
    n, law = 120, laws(np.pi * np.arange(1, 120) / 120)
    white = rng.standard_normal((4000, n))
    coloured = lfilter([0.2], [1.0, -0.8], np.hstack([white[:, ::-1], white]), axis=1)[:, n:]
    for noise, row, near in (
        (white, 0, 0.12),
        (np.cumsum(white, axis=1), 4, 0.12),
        (coloured, 2, 0.35),
    ):
        power = np.mean(dct(noise, axis=1, norm="ortho")[:, 1:] ** 2, axis=0)
        assert np.all(np.abs(power / law[row] - 1.0) < near)


@pytest.mark.parametrize("period", [6.0, 9.0])
def test_noise_of_a_sea_is_recovered_about_its_period(period: float) -> None:
    """Integrated forces of a band have their variance in it, and make none far below it."""
    rng, n, rate = np.random.default_rng(0), 240, 2.0 * np.pi / period
    pole = np.exp((-0.175 + 1j) * rate)
    resonance = [1.0, -2.0 * pole.real, abs(pole) ** 2]
    forces = lfilter([1.0, -1.0], resonance, rng.standard_normal((300, 2 * n)), axis=1)[:, n:]
    power = dct(np.cumsum(forces, axis=1), axis=1, norm="ortho")[:, 1:] ** 2
    law = laws(np.pi * np.arange(1, n) / n, forced=True)
    found = [
        fitted_law(some.ravel(), np.tile(law, 3), np.zeros(len(law))) @ law
        for some in np.split(power[:60], 20)
    ]
    ratio = np.mean(found, axis=0) / power.mean(axis=0)
    peak = round(2.0 * n / period)
    for place in (5, peak // 2, 3 * peak // 2, 2 * peak):
        assert np.mean(ratio[place - 3 : place + 2]) == pytest.approx(1.0, abs=0.2)
    assert 0.4 < np.mean(ratio[peak - 3 : peak + 2]) < 1.2


DATA = Path(os.environ.get("OED_SYSID_DATA", "nowhere"))


# -- answers that are faster than the sampling --------------------------------------------------

PUBLISHED = ("auv_diving_plane", "nomoto_sparse_heading", "online_ship", "sailboat")


def published_log(name: str) -> tuple[Problem, Dataset]:
    """What the truth of a problem logs in its experiments."""
    problem = load_problem(name)
    return problem, trials(problem.true_model(), problem.experiments.values(), (0,))


@pytest.mark.parametrize("name", [*PUBLISHED, *slow("torpedo", "catamaran", "remus_6dof")])
def test_the_published_vehicles_log_nothing_wrong(name: str) -> None:
    """Nothing is suspect, the roll rate of a sailboat after its sheet was let go included.

    Sampled at 5 Hz it is a single high sample, which used to be called a spike, and without which
    the roll angle asks for another scale of the rate.
    """
    problem, data = published_log(name)
    assert not check(data, problem).suspect


@pytest.mark.slow
def test_beside_fast_answers_faults_are_found() -> None:
    """Spikes anywhere, a wrong scale and a wrong sign of the same roll rate are named."""
    problem, data = published_log("sailboat")

    def with_rate(change) -> LogCheck:  # type: ignore[no-untyped-def]
        return check(altered(data, p=lambda record: change(record.output("p"))), problem)

    rows = np.arange(37, 500, 50)  # in the middle between steps of the sheet
    spoilt = with_rate(lambda p: p + 0.5 * np.isin(np.arange(p.size), rows))
    assert [f.kind for f in spoilt.findings if f.suspect] == ["spikes"]
    assert spoilt.findings[0].size >= 0.8 * rows.size * len(data)
    scale = with_rate(lambda p: 1.3 * p).serious[0]
    assert (scale.kind, scale.signals) == ("scale", ("p",))
    assert scale.size == pytest.approx(0.3, abs=0.06)
    turned = with_rate(lambda p: -p)
    assert {f.kind for f in turned.findings if f.suspect} == {"sign"}


# -- statistics and measured data ------------------------------------------------------------


@pytest.mark.slow
def test_intervals_hold() -> None:
    """Of forty fitted biases and lever arms at least 34 lie in their 95 % interval."""
    held = 0
    for seed in range(20):
        for vehicle, fault in (
            (DIVER, Fault("bias", ("q",), 0.006)),
            (SHIP, Fault("lever", ("v",), 4.0, "r")),
        ):
            found = check(log(vehicle, fault, seed=seed), vehicle.model, inputs=False)
            one = match(found, fault)
            held += one is not None and one.interval[0] < fault.size < one.interval[1]
    assert held >= 34


needs_data = pytest.mark.skipif(
    not (DATA / "hidden_effects").is_dir(), reason="third-party data is not here"
)


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "kvlcc2_hsva_zigzag").is_dir(), reason="data is not here")
def test_earth_fixed_velocities_of_the_towing_tank_are_named_unaided() -> None:
    """In every file whose velocity columns are along the tank this is the one finding."""
    model = free_running(HSVA, "delta")
    files = sorted((DATA / "kvlcc2_hsva_zigzag").glob("HSVA*.csv"))
    for path in files:
        found = check(read_csv(path, model.channels), model)
        assert found.named("frame", "u") is not None, path.name
    assert len(files) == 10


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "esso_osaka").is_dir(), reason="data is not here")
def test_lag_of_the_esso_osaka_files_is_found_in_all_twelve() -> None:
    """Velocities and heading come 0.7 to 1.1 s after the positions; headings wrap in six."""
    model = free_running(ESSO, "delta_rudder", wrap=True)
    lags, wraps = [], 0
    for path in sorted((DATA / "esso_osaka").glob("*.csv")):
        with warnings.catch_warnings(record=True) as notes:
            warnings.simplefilter("always")
            data = read_filled(path, model)
        wraps += any("unwrapped" in str(n.message) for n in notes)
        found = check(data, model)
        one = found.named("delay", "u")
        assert one is not None, path.name
        lags.append(one.size)
    assert wraps == 6
    assert len(lags) == 12
    assert min(lags) > 0.7
    assert max(lags) < 1.1


TWO = ("zigzag_5_5", "zigzag_10_10")


@pytest.fixture(scope="module")
def dives_inputs() -> tuple[Problem, Dataset]:
    """Four simulated runs of the diving plane, and their problem."""
    problem = load_problem("remus_diving_plane")
    return problem, trials(problem.model, problem.experiments.values(), (0,))


def with_dead(data: Dataset, name: str, *numbers: int) -> Dataset:
    """Copies in which a sensor shows its first value for ever."""
    first = {name: lambda record: np.full(record.n_samples, record.output(name)[0])}
    return altered(data, *numbers, **first)


@pytest.mark.parametrize("name", ["q", *slow("u", "w", "theta", "z")])
def test_a_dead_output_is_the_only_finding(dives_inputs, name: str) -> None:  # type: ignore[no-untyped-def]
    """The inputs are judged without it, or not at all; nothing is singular."""
    problem, data = dives_inputs
    found = check(with_dead(data, name), problem)
    assert [(one.kind, one.signals) for one in found.serious] == [("dead", (name,))]


def test_records_without_the_speed_are_left_out_of_the_judgement(dives_inputs) -> None:  # type: ignore[no-untyped-def]
    """Of a speed that follows from z' where the pitch is not zero the samples at level are lost.

    With it dead in one record the others still show a fin of the other sign; with it dead in all
    of them nothing is claimed, and the report says so.
    """
    problem, data = dives_inputs[0], Dataset([dives_inputs[1][name] for name in TWO])
    fin = np.array(problem.model.input_names) == "fin_command"
    turned = Dataset([replace(r, inputs=np.where(fin, -r.inputs, r.inputs)) for r in data])
    one = check(with_dead(turned, "u", 0), problem)
    assert {(f.kind, f.signals) for f in one.serious} == {
        ("dead", ("u",)),
        ("sign", ("fin_command",)),
    }
    every = check(with_dead(turned, "u"), problem)
    assert [f.kind for f in every.serious] == ["dead"]
    assert any(line.startswith("Signs and units of inputs") for line in every.unchecked)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        (None, lambda t, y: y),
        *slow(
            ("unit", lambda t, y: np.degrees(y)),
            ("sign", lambda t, y: -y),
            ("delay", lambda t, y: np.interp(t - 0.5, t, y)),
        ),
    ],
)
def test_an_input_is_named_where_the_values_differ_from_the_nominal_ones(kind, change) -> None:  # type: ignore[no-untyped-def]
    """Truth is drawn from the priors; a fin that is right raises nothing, a wrong one its fault."""
    problem = load_problem("remus_diving_plane")
    rng = np.random.default_rng(11)
    drawn = {p.name: rng.normal(p.prior_mean, p.prior_std) for p in problem.model.free_parameters}
    fin = problem.model.input_names.index("fin_command")
    runs = []
    for name in TWO[:1] if kind == "unit" else TWO:
        run = problem.experiments[name]
        record = simulate(problem.model.with_values(drawn), run, rng=rng, name=name)
        inputs = record.inputs.copy()
        inputs[:, fin] = change(record.times, inputs[:, fin])
        runs.append(replace(record, inputs=inputs))
    found = check(Dataset(tuple(runs)), problem)
    expected = [] if kind is None else [(kind, ("fin_command",))]
    assert [(one.kind, one.signals) for one in found.serious] == expected
    if kind == "delay":
        assert found.serious[0].size == pytest.approx(0.5, abs=0.1)
    states = {one.fault: one.state for one in found.judged if one.signal == "fin_command"}
    assert states["sign"] == ("found" if kind == "sign" else "tested")


def believed_yaw() -> Model:
    """The yaw model whose priors are the truth."""
    units = (("K", "1/s"), ("T", "s"), ("alpha", "s^2"))
    return yaw_model(**{
        name: Parameter(name, TRUE[name], unit, prior_mean=TRUE[name], prior_std=0.2 * TRUE[name])
        for name, unit in units
    })  # fmt: skip


def test_an_input_that_never_repeats_a_value_is_judged() -> None:
    """A measured rudder angle stands still nowhere; what is asked of inputs is asked of it."""
    rng = np.random.default_rng(0)
    data = Dataset(
        tuple(
            replace(r, inputs=r.inputs + 1e-4 * rng.standard_normal(r.inputs.shape))
            for r in yaw_data()
        )
    )
    found = check(data, believed_yaw())
    assert found.findings == ()
    states = {one.fault: one.state for one in found.judged if one.signal == "delta"}
    assert set(states) == {*inputs.ASKED}
    assert set(states.values()) == {"tested"}


def test_a_unit_is_not_undone_by_a_coefficient_of_nothing() -> None:
    """Rudder angles times 57.3 with a gain of a fifty-seventh are no explanation; a sign may be."""
    model = believed_yaw()
    traces, _ = inputs._traces(yaw_data(), model, ())
    evidence = Evidence(inputs._question(traces, model, timed=True), traces)
    assert evidence.gained([Correction("unit", ("delta",), np.degrees(1.0))]) == -np.inf
    assert evidence.gained([Correction("unit", ("delta",), 1.2)]) == pytest.approx(0.0, abs=3.0)


def test_a_lag_of_a_signal_that_ends_early_is_that_of_its_samples() -> None:
    """What a delay has left undefined at an end of a record stays so, and nothing else."""
    t = 0.1 * np.arange(100)
    whole = lagged(t, np.sin(t), 0.5)
    late = lagged(t, np.where(t < 9.0, np.sin(t), np.nan), 0.5)
    assert late[:90] == pytest.approx(whole[:90], abs=1e-12)
    assert np.isnan(late[90:]).all()


def test_fast_motion_is_not_smaller_for_the_nominal_model() -> None:
    """A yaw rate with a period of fifteen samples keeps its size, and loses half of its noise."""
    model, t, rng = believed_yaw(), 0.2 * np.arange(600), np.random.default_rng(0)
    motion = np.column_stack([-np.cos(2.0 * np.pi * t / 3.0), np.sin(2.0 * np.pi * t / 3.0)])
    record = Record(
        "run", t, np.zeros((600, 1)), motion + 0.02 * rng.standard_normal((600, 2)), model.channels
    )
    (trace,), _ = inputs._traces(Dataset((record,)), model, ())
    taken, true = trace.values[inputs.smooth("r")], motion[:, 1]
    assert taken @ true / (taken @ taken) == pytest.approx(1.0, abs=0.05)
    slow = replace(record, outputs=record.outputs - motion)
    (trace,), _ = inputs._traces(Dataset((slow,)), model, ())
    assert np.std(trace.values[inputs.smooth("r")]) == pytest.approx(0.01, rel=0.1)


def test_records_that_are_broken_in_one_equation_tell_nothing_of_inputs() -> None:
    """Two pieces of one equation and none of another are not one of each."""
    t, rng = 0.1 * np.arange(600), np.random.default_rng(0)
    rates = {n: np.sin(k * t) + 0.01 * rng.standard_normal(600) for k, n in enumerate("pqr", 1)}
    angles = {name: np.cumsum(rates["pqr"[k]]) * 0.1 for k, name in enumerate("abc")}
    rates["p"][250:350], rates["r"][:] = np.nan, np.nan
    values = {**rates, **angles}
    units = dict.fromkeys("pqr", "rad/s") | dict.fromkeys("abc", "rad")
    trace = Trace("run", t, values, units, dict.fromkeys(units, 0.01))
    equations = tuple(
        Relation(angle, (rate,), rate, True, (("rate", rate),), {})
        for angle, rate in zip("abc", "pqr", strict=True)
    )
    assert len([*contrasts(trace, equations, [])]) == len(equations)
    assert not [*inputs._changes_by(trace, "p", equations)]


def test_an_input_that_was_not_logged_is_missed_by_the_motion(dives_inputs) -> None:  # type: ignore[no-untyped-def]
    """A fin that never moves in the log of zigzags is dead; thrust, of one equation, is not asked.

    Sizes of what never moves are not tested, and the table says so.
    """
    problem, data = dives_inputs
    still = Dataset(tuple(replace(r, inputs=0.0 * r.inputs + r.inputs[0]) for r in data))
    found = check(still, problem)
    assert [(one.kind, one.signals) for one in found.serious] == [("dead", ("fin_command",))]
    rows = [one for one in found.judged if one.signal in problem.model.input_names]
    assert {one.state for one in rows} == {"not tested"}
    assert all(one.says for one in rows)


def of_dives(problem: Problem, act: Act, names: tuple[str, ...] = TWO) -> Dataset:
    """Records in which something else acted than the fin commands that were logged."""
    rng, runs = np.random.default_rng(3), [problem.experiments[name] for name in names]
    return Dataset([replayed(problem.model, run, act, k, rng) for k, run in enumerate(runs)])


def test_an_input_without_effect_is_told_from_the_moment_on() -> None:
    """The fin is let go at 60 % of the second run: all of its effect is lost there, and then."""
    problem = load_problem("remus_diving_plane")
    data = of_dives(problem, lambda t, y, k: np.where((k == 1) & (t > 0.6 * t[-1]), 0.0, y))
    (found,) = check(data, problem).serious
    assert (found.kind, found.signals, found.records) == (
        "lost",
        ("fin_command",),
        ("zigzag_10_10",),
    )
    assert found.size == pytest.approx(1.0, abs=0.05)
    at = float(found.says.split("t = ")[1].split(" s")[0])
    assert at == pytest.approx(54.0, abs=1.5)


def lagging(t: np.ndarray, y: np.ndarray, k: int) -> np.ndarray:
    """Commands after a first-order lag of half a second."""
    keep = np.exp(-(t[1] - t[0]) / 0.5)
    return lfilter([1.0 - keep], [1.0, -keep], y)


@pytest.mark.parametrize(
    ("kind", "act"), [("lag", lagging), *slow(("delay", lambda t, y, k: np.interp(t - 0.5, t, y)))]
)
def test_a_command_in_place_of_the_feedback_is_a_lag(kind: str, act) -> None:  # type: ignore[no-untyped-def]
    """What lags by half a second in first order is told from what comes late by as much."""
    problem = load_problem("remus_diving_plane")
    records = of_dives(problem, act, TWO[1:] if kind == "lag" else TWO)
    found = check(records, problem)
    assert found.ok  # good to know: a model that lacks physics shows the like
    assert as_measured(records, found) == (records, ())
    assert [one.kind for one in found.findings if "fin_command" in one.signals] == [kind]


def test_a_declared_delay_is_known() -> None:
    """A rudder that acts a second after its command, by the model too, is not late.

    A pulse of the command changes the yaw rate two samples later, by K/T less what has decayed.
    """
    model = believed_yaw() + actuator_delay("late", "delta", value=1.0, max_delay=1.0, step=0.5)
    late = yaw_data()
    ahead = [np.vstack([r.inputs[2:], r.inputs[[-1] * 2]]) for r in late]
    commanded = Dataset(tuple(replace(r, inputs=u) for r, u in zip(late, ahead, strict=True)))
    assert check(commanded, model).findings == ()
    (trace,), _ = inputs._traces(Dataset((commanded[0],)), model, ())
    (nominal,) = inputs._nominal(model)
    values = {name: trace.values[name] for name in nominal.signals}
    pulse = np.eye(trace.times.size)[10]
    answer = nominal.along(values, trace.times, {"delta": pulse})
    assert np.flatnonzero(np.abs(answer) > 1e-9).tolist() == [12]
    rate, share = TRUE["K"] / TRUE["T"], 0.5 / TRUE["T"]
    assert answer[12] == pytest.approx(rate * (1.0 - share / 2.0), rel=0.01)


def test_noise_of_the_states_is_the_least_walk_of_a_nominal_equation() -> None:
    """Noise of the yaw rate in its own damping, summed over the samples of each block."""
    model = believed_yaw()
    (trace, *_), _ = inputs._traces(yaw_data(), model, ())
    (piece,) = contrasts(trace, inputs._nominal(model))
    slope = (1.0 + 3.0 * TRUE["alpha"] * trace.values["r"] ** 2) / TRUE["T"]
    level = np.sqrt(np.mean(slope**2)) * trace.noise["r"]
    assert piece.walk == pytest.approx(level**2 * trace.step * piece.span, rel=0.15)


def test_noise_of_the_states_is_no_fault_of_an_input() -> None:
    """Coefficients of a noisy sway velocity come out too small: rudders are no stronger for it."""
    problem = load_problem("remus_6dof")
    runs = [problem.experiments[name] for name in ("cruise", "wide")]
    assert check(trials(problem.model, runs, 0), problem).findings == ()


@pytest.mark.parametrize("logged", [0.5, 1.0, 2.0])
def test_an_input_of_another_scale_shows_in_the_coefficients(dives_inputs, logged: float) -> None:  # type: ignore[no-untyped-def]
    """Both coefficients of the fin are off by one factor, which its log is off by."""
    problem, data = dives_inputs
    factors = np.where(np.array(problem.model.input_names) == "fin_command", logged, 1.0)
    some = Dataset(tuple(replace(r, inputs=r.inputs * factors) for r in data))
    found = scaled_inputs(MultipleShooting(disturbances="none").fit(problem.model, some))
    assert [one.signals for one in found] == [("fin_command",)] * (logged != 1.0)
    for one in found:
        assert not one.suspect
        assert one.interval[0] < 1.0 - 1.0 / logged < one.interval[1]


def test_a_parameter_that_is_another_one_in_one_run_is_named(dives_inputs) -> None:  # type: ignore[no-untyped-def]
    """Eight per cent more restoring moment in one of four runs, and nothing in four alike."""
    problem, data = dives_inputs
    heavier = problem.model.with_values({"zgW": 1.08 * problem.model.values["zgW"]})
    run = problem.experiments[data[2].name]
    other = simulate(heavier, run, rng=np.random.default_rng(4), name=data[2].name)
    estimator = MultipleShooting(disturbances="none")
    assert between_runs(estimator.fit(problem.model, data)) == ()
    fit = estimator.fit(problem.model, Dataset((*data[:2], other, *data[3:])))
    (one,) = between_runs(fit)
    assert (one.kind, one.signals, one.records) == ("run", ("zgW",), (data[2].name,))
    assert not one.suspect
    assert one.size == pytest.approx(0.08, abs=0.02)


@pytest.mark.parametrize("seed", [1, *slow(2, 3)])
def test_an_offset_of_an_input_is_told_and_is_no_delay(seed: int) -> None:
    """A rudder whose zero is off by 0.05 rad where the speed changes; a right one says nothing."""
    assert check(patrol_boat.sailings(seed), patrol_boat.BOAT).findings == ()
    logged = patrol_boat.sailings(seed, lambda angle: angle + 0.05)
    (one,) = check(logged, patrol_boat.BOAT).findings
    assert (one.kind, one.signals, one.suspect) == ("bias", ("rudder",), False)
    assert one.size == pytest.approx(0.05, abs=0.0025)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "size", "seconds"), [("step", 0.05, 60.0), ("burst", 0.1, 3.0)])
def test_a_zero_of_an_input_that_jumps_is_told_with_its_moment(
    kind: str, size: float, seconds: float
) -> None:
    """A rudder that is off from the middle of a record on, for good or for a moment."""

    def off(angle: np.ndarray) -> np.ndarray:
        since = 120.0 * np.arange(angle.size) / (angle.size - 1) - 60.0
        return angle + size * ((since >= 0.0) & (since < seconds))

    found = check(patrol_boat.sailings(0, off), patrol_boat.BOAT).serious
    assert [(one.kind, one.signals) for one in found] == [(kind, ("rudder",))] * 2
    for one in found:
        # Of a moment its length is uncertain as well.
        assert one.size == pytest.approx(size, rel=0.05 if kind == "step" else 0.25)
        at = float(one.says.split("t = ")[1].split(" s")[0])
        assert at == pytest.approx(60.0, abs=1.0)


def twice_lost(angle: np.ndarray) -> np.ndarray:
    """The angles with two drop-outs of four samples."""
    lost = np.isin(np.arange(angle.size), [250, 251, 252, 253, 400, 401, 402, 403])
    return np.where(lost, 0.0, angle)


def stuck_for_a_while(angle: np.ndarray) -> np.ndarray:
    """The angles without those of twelve seconds."""
    return np.concatenate([angle[:200], np.full(60, angle[200]), angle[260:]])


@pytest.mark.parametrize(
    ("kind", "n_samples", "spoilt"),
    [
        (None, 0, lambda angle: angle),
        *slow(("frozen", 59, stuck_for_a_while), ("dropouts", 8, twice_lost)),
        ("held", 450, lambda angle: np.repeat(angle[::4], 4)[: angle.size]),
    ],
)
def test_a_measured_input_does_not_repeat_itself(kind, n_samples: int, spoilt) -> None:  # type: ignore[no-untyped-def]
    """Angles with noise, linear between samples, were measured; commands may stand still."""
    rng, every = np.random.default_rng(0), patrol_boat.BOAT
    boat = replace(
        every, inputs=(replace(every.inputs[0], interpolation="linear"), *every.inputs[1:])
    )
    data = patrol_boat.sailings(3, lambda y: spoilt(y + 0.004 * rng.standard_normal(y.size)))
    faults, _ = inputs._repeated(data, boat)
    assert [(one.kind, one.rows.size) for one in faults] == [(kind, n_samples)] * 2 * bool(kind)
    assert inputs._repeated(data, every)[0] == []
    measured = Dataset(tuple(replace(one, channels=boat.channels) for one in data))
    found = check(measured, boat)
    named = [one for one in found.findings if one.kind in inputs.REPEATED]
    assert [(one.kind, one.suspect) for one in named] == [(kind, True)] * 2 * bool(kind)
    assert as_measured(measured, found) == (measured, ())


def test_a_speed_from_positions_that_are_sampled_slowly_keeps_its_size() -> None:
    """Of positions every second, a sway velocity with a period of five seconds."""
    t = 0.1 * np.arange(600)
    channels = Model(
        "drift", (State("y", "m"), State("v", "m/s")), (), (Output("y", "m"),),
        {"y": "v", "v": "-k*v"}, parameters=(Parameter("k", 0.1, "1/s", prior_std=0.1),),
    )  # fmt: skip
    frequency = 2.0 * np.pi / 5.0
    y = np.where(np.arange(600) % 10 == 0, np.sin(frequency * t) / frequency, np.nan)
    record = Record("run", t, np.zeros((600, 0)), y[:, None], channels.channels)
    (trace,) = inputs._trace(record, channels)
    inside, true = slice(50, -50), np.cos(frequency * t)
    taken = trace.values[inputs.smooth("v")][inside]
    assert taken @ true[inside] / np.sum(true[inside] ** 2) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("seed", [5, *slow(7)])
def test_an_input_that_is_stuck_is_told_from_a_late_one(seed: int) -> None:
    """A rudder angle that stands still from the middle on, while the boat goes on turning."""

    def stuck(angle: np.ndarray) -> np.ndarray:
        return np.where(np.arange(angle.size) < angle.size // 2, angle, angle[angle.size // 2])

    found = check(patrol_boat.sailings(seed, stuck), patrol_boat.BOAT)
    assert {(one.kind, one.signals) for one in found.findings} == {("frozen", ("rudder",))}
    assert {one.records for one in found.findings} == {(name,) for name in found.records}


def test_a_fit_says_which_run_has_another_parameter(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    """What is no fault of the log, and no reason not to fit, is said above the estimates."""
    problem = load_problem("online_ship")
    values, paths = problem.model.values, []
    for factor, (name, run) in zip((1.0, 1.3), problem.experiments.items(), strict=True):
        vehicle = problem.model.with_values({"N_delta": factor * values["N_delta"]})
        paths.append(str(tmp_path / f"{name}.csv"))
        write_csv(simulate(vehicle, run, rng=np.random.default_rng(0)), paths[-1])
    assert main(["fit", "online_ship", *paths]) == 0
    assert f"in {name} from the other runs" in capsys.readouterr().out


def test_values_far_from_their_priors_make_a_log_suspect(dives_inputs) -> None:  # type: ignore[no-untyped-def]
    """The gate of all certificates: the same log, once with values that were expected."""
    problem, data = dives_inputs
    fit = MultipleShooting(disturbances="none").fit(problem.model, data)
    log = LogCheck((), data.names)
    assert with_estimates(log, fit).ok
    first = problem.model.free_parameters[0]
    moved = fit.model.with_values({first.name: first.prior_mean + 1.2 * BEYOND * first.prior_std})
    gate = with_estimates(log, replace(fit, model=moved))
    assert [(one.kind, one.signals) for one in gate.serious] == [("far", (first.name,))]


@pytest.mark.parametrize("loud", [1.0, 3.0])
def test_what_a_fit_finds_to_be_motion_is_no_noise(loud: float) -> None:
    """A rate that answers a new command with every sample; its noise is as declared, or thrice."""
    model = Model(
        "spinner", states("r"), (Input("d", "1"),), outputs("r", r=0.01), {"r": "b*d - c*r"},
        parameters=(Parameter("b", 7.0), Parameter("c", 9.0)), step=0.1,
    )  # fmt: skip
    rng, r = np.random.default_rng(0), np.zeros(400)
    commands = rng.standard_normal(400)
    for k in range(399):  # exact for a held command
        r[k + 1] = commands[k] + (r[k] - commands[k]) * np.exp(-0.8)
    seen = r + loud * 0.01 * rng.standard_normal(400)
    data = Dataset((Record("run", 0.1 * np.arange(400), commands[:, None], seen[:, None],
                           model.channels),))  # fmt: skip
    log = check(data, model)
    assert log.named("noise", "r").size > 30.0
    fit = MultipleShooting(disturbances="none").fit(model, data)
    (told,) = [one.size for one in fit.concerns if one.kind == "noise_level"] or [1.0]
    assert told == pytest.approx(loud, rel=0.1)
    assert (with_estimates(log, fit).named("noise", "r") is None) is (loud == 1.0)


def test_a_claim_that_puts_the_log_right_answers_its_findings() -> None:
    """A scale of x reads as one of v in x' = v: undone with its estimate, nothing is left of it."""
    law, values = {"x": "v", "v": "b*u - d*v"}, {"b [m/s^2]": 0.3, "d [1/s]": 0.4}
    noise = {"x": 0.02, "v": 0.01}
    model = small("sled", "x [m], v [m/s] <- u [1]", law, values, noise, step=0.1)
    rng = np.random.default_rng(5)
    times, commands = np.arange(400) * 0.1, np.repeat(rng.choice([-1.0, 1.0], 20), 20)
    v = np.zeros(400)
    for k in range(399):  # exact for a held command
        v[k + 1] = 0.75 * commands[k] + (v[k] - 0.75 * commands[k]) * np.exp(-0.04)
    x = np.cumsum(np.append(0.0, 0.75 * commands[:-1] * 0.1 - np.diff(v) / 0.4))
    seen = np.column_stack([0.8 * x, v]) + rng.standard_normal((400, 2)) * [0.02, 0.01]
    data = Dataset((Record("run", times, commands[:, None], seen, model.channels),))
    log = check(data, model)
    assert [one.name for one in log.serious] == ["scale v"]
    for right, effect in (
        (True, sensor_scale("scale_x", "x", scale=0.1)),
        (False, sensor_bias("bias_v", "v", "m/s", scale=0.1)),
    ):
        fit = MultipleShooting(disturbances="none").fit(model + effect, data)
        assert with_estimates(log, fit, [effect]).ok is right


@pytest.mark.parametrize(("factor", "kind"), [(-1.0, "sign"), (30.0 / np.pi, "unit"), (1.3, "")])
def test_a_sensor_that_is_another_reading_is_a_finding_of_the_log(factor: float, kind: str) -> None:
    """A relative error of -2 is a sign, one of 8.55 rpm, one of 0.3 an error of a sensor."""
    right = yaw_data()
    column = right.channels.output_names.index("r")
    by = np.where(np.arange(len(right.channels.outputs)) == column, factor, 1.0)
    data = Dataset(tuple(one.with_outputs(one.outputs * by) for one in right))
    effect = sensor_scale("scale_r", "r", scale=0.1, value=factor - 1.0)
    model = yaw_model().with_values(TRUE) + effect
    fit = MultipleShooting(disturbances="none").fit(model, data)
    assert fit.values["E_scale_r"] == pytest.approx(factor - 1.0, rel=0.05)
    told = with_estimates(LogCheck((), data.names), fit, [effect])
    assert (told.suspect, *[(one.kind, one.signals) for one in told.serious]) == (
        (True, (kind, ("r",))) if kind else (False,)
    )
    if kind:
        assert told.serious[0].correction.value == pytest.approx(1.0 / factor)


def test_physics_that_was_claimed_answers_what_its_lack_made_of_an_input() -> None:
    """A cubic moment reads as a delay of the fin; one that acts with the fin may be its fault."""
    problem = load_problem("remus_diving_plane")
    size = Parameter("e", 0.0, "1", scale=100.0)
    cubic, with_fin = (
        Force("moment", {"M": term}, (size,), amplitudes=("e",)) for term in ("e*w**3", "e*ds*w**2")
    )
    truth = (problem.model + cubic).with_values({"e": -480.0})
    runs = trials(truth, [problem.experiments["zigzag_10_10"]], 4)
    log = check(runs, problem.model)
    assert ("fin_command",) in [one.signals for one in log.serious]
    for claimed, answers in ((cubic, True), (with_fin, False)):
        fit = MultipleShooting(disturbances="none").fit(problem.model + claimed, runs)
        left = [one.signals for one in with_estimates(log, fit, [claimed]).serious]
        assert (("fin_command",) not in left) is answers


def test_a_guess_says_where_it_is_lost(dives_inputs) -> None:  # type: ignore[no-untyped-def]
    """The speed from z' is lost at level pitch, the pitch rate from theta' nowhere."""
    problem, data = dives_inputs
    model = problem.model
    measured = measured_states(model, data[1])
    u, q = model.state_names.index("u"), model.state_names.index("q")
    known = {k: series for k, series in measured.items() if k not in (u, q)}
    found = kinematic_states(model, data[1], known)
    assert found[q].rms < 0.1 * np.std(data[1].output("q"))
    assert found[u].rms > np.ptp(data[1].output("u"))


def spoilt(vehicle: Vehicle, seed: int, sizes: dict[int, tuple[str, float]]) -> Dataset:
    """A log in which signals have constant errors, by record."""
    data = log(vehicle, seed=seed)
    for number, (name, size) in sizes.items():
        data = altered(data, number, **{name: data[number].output(name) + size})
    return data


def test_two_records_have_each_their_own() -> None:
    """Errors of opposite sign, which no common bias could say."""
    data = spoilt(SHIP, 0, {0: ("r", 0.006), 2: ("r", -0.004)})
    found = check(data, SHIP.model, inputs=False)
    sizes = {one.records: one.size for one in found.serious}
    assert sizes == {
        ("run_0",): pytest.approx(0.006, abs=4e-4),
        ("run_2",): pytest.approx(-0.004, abs=4e-4),
    }


@pytest.mark.slow
@pytest.mark.parametrize("sizes", [(0.006, 0.010, 0.004), (0.02, 0.04, 0.03)])
def test_each_record_has_a_bias_of_its_own(sizes: tuple[float, ...]) -> None:
    """Of one sign and three sizes: no step that sets in after the first samples of a record."""
    data = spoilt(SHIP, 0, {number: ("r", size) for number, size in enumerate(sizes)})
    found = check(data, SHIP.model, inputs=False).serious
    assert {(one.kind, one.signals) for one in found} == {("bias", ("r",))}
    told = np.zeros(3)
    for one in found:
        own = [int(name.removeprefix("run_")) for name in one.records] or range(3)
        told[own] += one.size
    np.testing.assert_allclose(told, sizes, atol=4e-4)


def test_the_copy_changes_that_record_only() -> None:
    """Undone where it was found, and nowhere else."""
    clean, data = spoilt(DIVER, 2, {}), spoilt(DIVER, 2, {1: ("q", 0.01)})
    copies, done = corrected_copies(data, DIVER.model, check(data, DIVER.model, inputs=False))
    assert len(done) == 1
    for number, (copy, before, true) in enumerate(zip(copies, data, clean, strict=True)):
        expected = true if number == 1 else before
        np.testing.assert_allclose(copy.outputs, expected.outputs, atol=5e-4)


def test_relations_come_from_the_model_in_its_own_names() -> None:
    """States, outputs and signals with unusual names are related through the model's text."""
    model = Model(
        "glider",
        states=(
            State("depth", "m"),
            State("nose", "rad"),
            State("turn", "rad/s"),
            State("V", "m/s"),
        ),
        inputs=(),
        outputs=(
            Output("gauge", "m", expression="depth"),
            Output("tilt", "rad", expression="nose"),
            Output("gyro", "rad/s", expression="turn"),
            Output("log", "m/s", expression="V"),
            Output("climb", "m/s", expression="V*sin(nose)"),
        ),
        kinematics={"depth": "-rise", "nose": "turn", "turn": "-turn/T", "V": "-V/T"},
        signals={"rise": "V*sin(nose)"},
        parameters=(Parameter("T", 1.0, "s"),),
    )
    found = {str(r) for r in relations(model)}
    assert found == {"gauge' = -rise", "tilt' = turn", "climb = V sin(nose)"}
    names = {r.target: set(r.signals) for r in relations(model)}
    assert names == {"gauge": {"log", "tilt"}, "tilt": {"gyro"}, "climb": {"log", "tilt"}}


def test_equations_with_unknown_parameters_are_left_alone() -> None:
    """A current that is to be estimated makes the equation of the position useless here."""
    law = {"x": "u + current", "u": "-u"}
    model = small("drifting", "x [m], u [m/s]", law, {"current [m/s]": 0.0})
    assert relations(model) == ()
    assert len(relations(model.fix("current"))) == 1


def test_six_degrees_of_freedom_follow_from_standard_names() -> None:
    """Twelve measured signals with standard names have six equations, right on a random motion."""
    names = tuple(UNITS)
    model = Model(
        "body",
        states=states(" ".join(names)),
        inputs=(),
        outputs=outputs(" ".join(names)),
        kinematics={n: f"-a*{n}" for n in "uvwpqr"} | {n: f"a*{n}" for n in names[:6]},
        parameters=(Parameter("a", 1.0),),
    )
    # Identity kinematics with a parameter: the model does not say; names do not override it.
    assert relations(model) == ()
    free = small("sensors", "s [m]", {"s": "-a*s"}, {"a": 1.0})
    found = {r.target: r for r in relations(free, spare=names)}
    assert set(found) == {"x", "y", "z", "phi", "theta", "psi"}
    rng = np.random.default_rng(3)
    values = {n: rng.uniform(-0.7, 0.7, 40) for n in names}
    t = np.arange(40.0)
    # A heading may count from elsewhere; roll and pitch count from the vertical.
    read = [one.candidate for one in readings([Trace("run", t, values, UNITS)], (*found.values(),))]
    assert {one.signals for one in read if one.kind == "offset"} == {("psi",)}
    speed = sum(found[n](values, t) ** 2 for n in "xyz")
    assert np.allclose(speed, values["u"] ** 2 + values["v"] ** 2 + values["w"] ** 2)
    # Angular velocity from the angles' rates (Fossen 2021, eq. 2.38, inverted).
    rates = {n: found[n](values, t) for n in ("phi", "theta", "psi")}
    p = rates["phi"] - np.sin(values["theta"]) * rates["psi"]
    assert np.allclose(p, values["p"])


def test_spare_columns_are_used(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A heading model checks the positions and speeds that its files hold beside it."""
    data = log(SHIP, Fault("scale", ("u",), 0.06), runs=1)
    heading = nomoto(1.0, 5.0, rudder="fin", noise=(None, None))
    for record in data:
        path = tmp_path / f"{record.name}.csv"
        write_csv(record, path)
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace("x [m]", "x_position_mid [m]", 1), encoding="utf-8")
    read = read_csv(tmp_path, heading.channels)
    assert set(spare_signals(read[0])) == {"x", "y", "u", "v"}
    found = check(read, heading)
    assert found.named("scale", "u") is not None
    assert len(found.relations) == 3


def test_missing_and_sparse_signals_are_no_faults() -> None:
    """Outputs at a slower rate and gaps of an output do not raise alarms."""
    data = log(SHIP)
    row = np.arange(data[0].n_samples)
    lost = {name: row % every > 0 for name, every in (("x", 4), ("y", 4), ("u", 2))}
    lost["psi"] = (row >= 300) & (row < 420)
    for number, record in enumerate(data):
        left = {name: np.where(gone, np.nan, record.output(name)) for name, gone in lost.items()}
        data = altered(data, number, **left)
    assert check(data, SHIP.model, inputs=False).ok


def test_log_without_equations_says_so() -> None:
    """Where nothing relates the signals, that is the verdict."""
    model = small("roll", "phi [rad]", {"phi": "-a*phi"}, {"a [1/s]": 1.0})
    t = np.arange(300) * 0.1
    rng = np.random.default_rng(0)
    record = Record(
        "decay", t, [], np.exp(-0.1 * t) + 0.01 * rng.standard_normal(300), model.channels
    )
    found = check(Dataset((record,)), model)
    assert found.ok
    assert "no equation" in found.verdict
    assert any("phi" in text for text in found.unchecked)


@pytest.mark.parametrize(
    ("fault", "undone"),
    [
        ({"x": ("y", 1.0), "y": ("x", 1.0)}, "x and y are in each other's column"),
        ({}, ""),
        *slow(
            ({"r": ("r", -1.0)}, "r has the wrong sign"),
            ({"u": ("v", -1.0), "v": ("u", 1.0)}, "misalignment of u and v (90"),
        ),
    ],
    ids=lambda one: one if isinstance(one, str) else "",
)
def test_signs_and_axes_are_told_without_a_problem(
    fault: dict[str, tuple[str, float]], undone: str
) -> None:
    """What was done to the axes of a log is found by the standard names of its signals alone."""
    wrong = {
        name: lambda record, other=other, sign=sign: sign * record.output(other)
        for name, (other, sign) in fault.items()
    }
    found = check(altered(log(SHIP, runs=1), **wrong))
    assert found.suspect == bool(fault)
    told = [one.says + " " + " | ".join(one.alternatives) for one in found.findings]
    assert undone in " ".join(told)


def test_a_failed_fit_says_first_what_its_log_shows() -> None:
    """Drop-outs stand before whatever else may stall a fit; a clean log and a good fit do not."""
    clean = yaw_data(21)
    spoilt = overwritten(clean, 0, np.s_[60:70, 1], -9.99)
    early = MultipleShooting(disturbances="none", solver=Solver(max_iterations=1))
    fit = early.fit(yaw_model().with_values({"K": 0.02}), spoilt)
    assert not fit.status.ok
    found = check(spoilt, yaw_model())
    said = advised(fit, found).status
    assert said.code == fit.status.code
    where = [said.advice.index(one.says) for one in found.serious]
    assert where
    assert max(where) < said.advice.index(fit.status.advice)
    assert advised(fit, check(clean, yaw_model())) is fit


def test_moments_are_not_told_by_a_speed_that_is_smoothed_from_positions() -> None:
    """A sway speed from a receiver moves before the rudder that moves it: no delay is asked."""
    priors = {"Yv": -0.1, "Yr": -3.0, "Yd": 0.1, "Nv": -0.002, "Nr": -0.2, "Nd": -0.01}
    sides = {"x": "7*cos(psi) - v*sin(psi)", "y": "7*sin(psi) + v*cos(psi)"}
    law = {"v": "Yv*v + Yr*r + Yd*delta", "r": "Nv*v + Nr*r + Nd*delta", "psi": "r"}
    signals = "v [m/s], r [rad/s], psi [rad], x [m], y [m] <- delta [rad]"
    values = [
        Parameter(n, one, prior_mean=one, prior_std=0.2 * abs(one)) for n, one in priors.items()
    ]
    noise = {"r": 5e-4, "psi": 2e-3, "x": 0.3, "y": 0.3}
    ship = small("ship", signals, law | sides, values, noise, step=0.5)
    turn = ZigZag("delta", 0.35, 0.35, sign=-1, rate=0.05)
    record = simulate(
        ship, Experiment("zigzag", turn, duration=240.0, sample_time=0.5),
        rng=np.random.default_rng(1),
    )  # fmt: skip
    found = check(Dataset((record,)), ship)
    (asked,) = (one for one in found.judged if (one.fault, one.signal) == ("delay", "delta"))
    assert asked.state == "not tested"
    assert asked.says.startswith("v ")
    assert not found.suspect


def held_roll(step: float, factor: float, seed: int, *, logged: bool) -> LogCheck:
    """The check of a roll of 3.8 s, its command held from sample to sample, ``p`` times a factor.

    By the exact solution over each step, :math:`x_{k+1} = e^{Ah} x_k + (1 - e^{Ah}) (c_k, 0)`. The
    nominal model is 10 % off; it has the command where that is ``logged``.
    """
    known = {"damping": 0.55, "stiffness": 2.7}
    text = "-damping*p - stiffness*(phi - command)" if logged else "-damping*p - stiffness*phi"
    model = Model(
        "roll", (State("phi", "rad"), State("p", "rad/s")),
        (Input("command", "rad"),) if logged else (),
        (Output("phi", "rad"), Output("p", "rad/s")), {"phi": "p", "p": text},
        parameters=tuple(Parameter(name, 0.9 * value) for name, value in known.items()),
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    times = np.arange(420) * step
    moves = expm(step * np.array([[0.0, 1.0], [-known["stiffness"], -known["damping"]]]))
    lines, phases = 2.0 * np.pi * np.arange(1, 7) / 45.0, rng.uniform(0.0, 2.0 * np.pi, 6)
    commands = 0.02 * np.sin(np.outer(times, lines) + phases).sum(axis=1, keepdims=True)
    rows = np.zeros((420, 2))
    for k, (command,) in enumerate(commands[:-1]):
        rest = np.array([command, 0.0])
        rows[k + 1] = rest + moves @ (rows[k] - rest)
    rows[:, 1] *= factor
    noisy = rows + 0.001 * rng.standard_normal(rows.shape)
    record = Record("r", times, commands if logged else commands[:, :0], noisy, model.channels)
    return check(Dataset((record,)), model)


@pytest.mark.parametrize("logged", [False, True])
def test_what_a_vehicle_does_between_samples_is_no_scale_of_its_rate(logged: bool) -> None:
    """A rate that is sampled three times a natural period is of no wrong scale.

    Straight lines miss (1.2 s x 1.64 rad/s)^2 / 12, 32 %, under a command that is held.
    """
    for seed in range(3):
        found = held_roll(1.2, 1.0, seed, logged=logged)
        assert not found.findings
        scale = next(one for one in found.judged if (one.fault, one.signal) == ("scale", "p"))
        assert scale.state == "tested"
        assert 0.1 < 0.01 * float(scale.says.removesuffix(" %")) < 1.0


@pytest.mark.parametrize(
    ("step", "factor", "logged"), [(0.2, 0.95, False), (0.4, 1.3, False), (0.8, 1.3, True)]
)
def test_a_wrong_scale_of_a_rate_is_told_from_motion_between_samples(
    step: float, factor: float, logged: bool
) -> None:
    """With its command in the log, five samples a natural period tell a third too much."""
    for seed in range(3):
        (one,) = held_roll(step, factor, seed, logged=logged).findings
        assert (one.kind, one.signals) == ("scale", ("p",))
        assert one.size == pytest.approx(factor - 1.0, abs=0.05)
        assert one.interval[0] < factor - 1.0 < one.interval[1]


def test_what_a_unit_cannot_be_told_from_is_another_unit_as_well() -> None:
    """A rate 57 times too large is an angle that is 57 times too small."""
    turn = 180.0 / np.pi
    angle = Found(Candidate("scale", ("psi",), "1"), 1.0 / turn - 1.0, 1e-4)
    zero = Found(Candidate("bias", ("r",), "rad/s"), 0.1, 0.01)
    rate = Found(Candidate("scale", ("r",), "1"), turn - 1.0, 0.1, 50.0, (angle, zero))
    (unit,) = as_readings(rate, {"r": "rad/s", "psi": "rad"})
    assert (unit.candidate.kind, unit.candidate.signals, unit.gain) == ("unit", ("r",), 50.0)
    other, left = unit.rivals
    assert (other.candidate.kind, other.candidate.signals) == ("unit", ("psi",))
    assert left is zero
    assert rival(other) != rival(angle)


def test_velocities_of_one_instrument_are_in_knots_together(dives) -> None:  # type: ignore[no-untyped-def]
    """Neither alone: one of them in knots would break the equation of the depth."""
    problem, data = dives
    knots = 3600.0 / 1852.0
    spoilt = altered(data, u=lambda r: knots * r.output("u"), w=lambda r: knots * r.output("w"))
    (one,) = check(spoilt, problem).serious
    assert (one.kind, set(one.signals)) == ("unit", {"u", "w"})
    assert one.correction is not None
    assert one.correction.value == pytest.approx(1.0 / knots)
