"""Lasting jumps of a signal: named with size, time and record, undone, and told from answers."""

from __future__ import annotations

import json

import numpy as np
import pytest

from benchmarks.compatibility import DIVER, SHIP, log, motions
from oed_sysid import Dataset, Model, check, load_problem, quick_check, simulate
from oed_sysid.evidence.check import corrected_copies
from oed_sysid.evidence.screens import screen, screened, steps
from oed_sysid.evidence.traces import Trace

TIMES = np.arange(800) * 0.1
GOOD = np.zeros(800, dtype=bool)


def wave(seed: int = 0, noise: float = 0.01) -> np.ndarray:
    """A sine with noise."""
    rng = np.random.default_rng(seed)
    return np.sin(0.5 * TIMES) + noise * rng.standard_normal(TIMES.size)


def jumping(data: Dataset, jumps: dict[str, tuple[int, int, float]]) -> Dataset:
    """Copies of records; a signal jumps in one of them (number, first row after, size)."""
    records = list(data.records)
    for name, (number, row, size) in jumps.items():
        outputs = records[number].outputs.copy()
        outputs[row:, data.channels.output_names.index(name)] += size
        records[number] = records[number].with_outputs(outputs)
    return Dataset(tuple(records))


def ships() -> Dataset:
    """A clean log of a ship."""
    rng = np.random.default_rng(2)
    return log(SHIP, motions(SHIP, rng), (), 0.0, rng)


def dives() -> Dataset:
    """A clean log of a diving vehicle."""
    rng = np.random.default_rng(2)
    return log(DIVER, motions(DIVER, rng), (), 0.0, rng)


@pytest.mark.parametrize("size", [0.9, -1.0, 5.0])
@pytest.mark.parametrize("row", [15, 400, 783])
def test_row_and_size_of_a_jump(row: int, size: float) -> None:
    """A jump is found at its sample, within four standard errors of its size."""
    series = wave()
    series[row:] += size
    (found,) = steps(TIMES, series, GOOD, 0.05)
    assert found.row == row
    # Lines through five samples, half a sample ahead, are uncertain by 1.28 times the noise.
    assert found.size == pytest.approx(size, abs=4.0 * 0.0128)


def test_sizes_are_better_than_those_of_two_short_lines() -> None:
    """Over a hundred records the error is below the noise; two short lines have 1.28 times it."""
    errors = []
    for seed in range(100):
        series = wave(seed)
        series[400:] += 1.0
        (found,) = steps(TIMES, series, GOOD, 0.05)
        errors.append(found.size - 1.0)
    assert np.std(errors) < 0.011
    assert abs(np.mean(errors)) < 0.003


def test_motion_is_no_jump() -> None:
    """Noise, ramps, corners, and one sample that is off hold no jump."""
    alarms = 0
    for seed in range(200):
        series = wave(seed, 0.2 * (seed % 5) / 4.0 + 0.01)
        alarms += len(steps(TIMES, series, GOOD, 0.05))
    assert alarms == 0
    ramp = np.interp(np.arange(800), [0, 300, 304, 800], [0.0, 0.0, 1.0, 1.0])
    assert not steps(TIMES, ramp, GOOD, 0.05)
    spike = wave()
    spike[300] += 2.0
    trace = Trace("run", TIMES, {"y": spike}, {"y": "m"}, {"y": 0.01})
    assert [fault.kind for fault in screen(trace)] == ["spikes"]


def test_jumps_after_steps_of_the_inputs_are_answers() -> None:
    """Four jumps right after the four steps of an input are none; elsewhere they are."""
    starts = np.array([100, 300, 500, 700])
    pushed = np.zeros(TIMES.size, dtype=bool)
    pushed[(starts[:, None] + np.arange(3)).ravel()] = True
    for shift, expected in ((0, 0), (40, 4)):
        series = wave()
        for sign, start in zip((1.0, -1.0, 1.0, -1.0), starts, strict=True):
            series[start + shift :] += sign
        trace = Trace("run", TIMES, {"y": series}, {"y": "m"}, {"y": 0.01}, pushed=pushed)
        faults, _ = screened([trace])
        assert sum(fault.rows.size for fault in faults) == expected


@pytest.mark.parametrize(
    ("data", "model", "signal", "size", "unit"),
    [
        (ships(), SHIP.model, "psi", np.pi / 2.0, "rad"),
        (ships(), SHIP.model, "r", -0.1, "rad/s"),
        (dives(), DIVER.model, "z", 2.0, "m"),
    ],
)
def test_a_jump_is_the_only_finding_and_is_undone(
    data: Dataset, model: Model, signal: str, size: float, unit: str
) -> None:
    """A compass, a gyro and a depth that were set anew: size, record, and the equations after."""
    spoilt = jumping(data, {signal: (1, 400, size)})
    found = check(spoilt, model, inputs=False)
    (one,) = found.serious
    assert (one.kind, one.signals, one.records, one.unit) == (
        "step",
        (signal,),
        (data[1].name,),
        unit,
    )
    noise = (SHIP if model is SHIP.model else DIVER).noise[signal]
    assert one.size == pytest.approx(size, abs=4.0 * 1.28 * noise)
    assert one.correction is not None
    assert one.correction.rows == {data[1].name: (400,)}
    assert f"t = {data[1].times[400]:.6g} s" in one.says
    clean = check(data, model, inputs=False)
    for before, after in zip(clean.balances, found.balances, strict=True):
        assert after.after == pytest.approx(before.after, abs=0.02)
    assert quick_check(spoilt, model).named("step", signal) is not None
    stored = json.loads(json.dumps(found.to_dict()))["findings"][0]["correction"]
    assert stored["rows"] == {data[1].name: [400]}
    assert stored["sizes"][data[1].name] == [one.size]


def test_size_is_said_in_degrees_and_corrected_copies_pass() -> None:
    """Jumps of two signals in one log are both undone in the copies."""
    data = ships()
    spoilt = jumping(data, {"psi": (0, 300, np.pi / 2.0), "y": (2, 500, -40.0)})
    found = check(spoilt, SHIP.model, inputs=False)
    assert {(f.kind, f.signals) for f in found.serious} == {("step", ("psi",)), ("step", ("y",))}
    heading = found.named("step", "psi")
    assert heading is not None
    assert heading.size == pytest.approx(np.pi / 2.0, abs=4.0 * 0.004)
    assert f"{np.degrees(heading.size):+.3g} deg" in heading.says
    copies, done = corrected_copies(spoilt, SHIP.model, found)
    assert len(done) == 2
    assert np.allclose(copies[0].output("psi"), data[0].output("psi"), atol=0.03)
    assert np.allclose(copies[2].output("y"), data[2].output("y"), atol=0.6)
    assert check(copies, SHIP.model, inputs=False).ok


def test_an_underwater_vehicle_whose_compass_was_reset() -> None:
    """In six degrees of freedom, in all four records, between the steps of the rudder."""
    problem = load_problem("remus_6dof")
    model = problem.true_model()
    runs = [
        simulate(model, run, rng=np.random.default_rng((3, k)), name=name)
        for k, (name, run) in enumerate(problem.experiments.items())
    ]
    data = Dataset(tuple(runs))
    spoilt = data
    for k in range(len(runs)):
        spoilt = jumping(spoilt, {"psi": (k, 150, np.pi / 2.0)})
    (one,) = check(spoilt, problem).serious
    assert (one.kind, one.signals, one.records) == ("step", ("psi",), data.names)
    assert one.correction is not None
    assert all(rows == (150,) for rows in one.correction.rows.values())
    assert one.size == pytest.approx(np.pi / 2.0, abs=0.05)


def test_a_heading_that_catches_up_is_not_shifted() -> None:
    """A compass that coasted through a turn is right after its jump: nothing is subtracted."""
    data = ships()
    outputs = data[1].outputs.copy()
    heading = outputs[:, data.channels.output_names.index("psi")]
    turned = np.abs(heading[30:] - heading[:-30])
    first = int(np.argmax(turned))
    rng = np.random.default_rng(0)
    heading[first : first + 30] = heading[first] + 0.004 * rng.standard_normal(30)
    records = (data[0], data[1].with_outputs(outputs), data[2])
    found = check(Dataset(records), SHIP.model, inputs=False)
    one = found.named("step", "psi")
    assert one is not None
    assert one.size == pytest.approx(heading[first + 30] - heading[first], abs=0.05)
    assert one.correction is None
    assert "caught up" in one.says
