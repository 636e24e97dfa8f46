"""The check of logs: every kind of fault named with its size, and silence on clean logs."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.compatibility import (
    DIVER,
    SHIP,
    SPOILS,
    Fault,
    is_named,
    log,
    match,
    motions,
    named_as,
    spoil,
)
from oed_sysid import Dataset, check, load_problem, quick_check, read_csv, write_csv
from oed_sysid.evidence.blocks import Colour, estimate, integral
from oed_sysid.evidence.check import corrected_copies
from oed_sysid.evidence.screens import screen
from oed_sysid.evidence.traces import Trace
from oed_sysid.experiments.simulation import simulate


@pytest.fixture(scope="module")
def dives() -> tuple:
    """Three simulated runs of the diving plane with declared noise, and their problem."""
    problem = load_problem("remus_diving_plane")
    rng = np.random.default_rng(4)
    names = ("zigzag_5_5", "zigzag_10_10", "steps")
    runs = tuple(simulate(problem.model, problem.experiments[n], rng=rng) for n in names)
    return problem, Dataset(runs)


def diving_log(*faults: Fault, seed: int = 0, colour: float = 0.0) -> Dataset:
    """A log of the diving plane with faults."""
    rng = np.random.default_rng(seed)
    return log(DIVER, motions(DIVER, rng), faults, colour, rng)


def ship_log(*faults: Fault, seed: int = 0, colour: float = 0.0) -> Dataset:
    """A log of a ship with faults."""
    rng = np.random.default_rng(seed)
    return log(SHIP, motions(SHIP, rng), faults, colour, rng)


# -- spoilt copies ---------------------------------------------------------------------------


def test_simulated_records_are_clean(dives) -> None:  # type: ignore[no-untyped-def]
    """Records that agree raise nothing suspect, in full and in the quick part."""
    problem, data = dives
    found = check(data, problem)
    assert found.ok
    assert found.warning() == ""
    assert quick_check(data, problem.model).ok
    assert len(found.relations) == 2


@pytest.mark.parametrize("name", SPOILS)
def test_spoilt_copy_is_named_and_nothing_else(dives, name: str) -> None:  # type: ignore[no-untyped-def]
    """Each of fifteen spoilt copies of a simulated record is named exactly."""
    problem, data = dives
    assert named_as(check(spoil(data, name), problem), name)


@pytest.mark.parametrize(
    "name", ["theta_sign", "q_deg", "q_sign", "z_up", "z_feet", "u_w_swap", "earth", "w_dead"]
)
def test_quick_part_names_what_is_there_or_not(dives, name: str) -> None:  # type: ignore[no-untyped-def]
    """Signs, units, columns and axes need no second look."""
    problem, data = dives
    found = quick_check(spoil(data, name), problem.model)
    assert named_as(found, name)
    assert found.verdict.startswith("Log suspect")


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("theta_sign", 'Output("theta", "rad", sign=-1)'),
        ("q_deg", 'write the header as "q [deg/s]"'),
        ("u_w_swap", 'Output("u", "m/s", column="w")'),
        ("fin_sign", 'Input("fin_command", "rad", sign=-1)'),
        ("earth", 'expression="-u*sin(theta) + w*cos(theta)"'),
    ],
)
def test_fix_is_a_line_for_the_problem_file(dives, name: str, line: str) -> None:  # type: ignore[no-untyped-def]
    """The line to write stands in the finding."""
    problem, data = dives
    assert line in check(spoil(data, name), problem).serious[0].fix


@pytest.mark.parametrize("name", ["theta_sign", "u_w_swap", "earth", "z_late", "spikes", "q_bias"])
def test_corrected_copy_is_clean(dives, tmp_path, name: str) -> None:  # type: ignore[no-untyped-def]
    """A corrected copy, written and read back, passes; what was done is said."""
    problem, data = dives
    spoilt = spoil(data, name)
    copies, done = corrected_copies(spoilt, problem, check(spoilt, problem, inputs=False))
    assert len(done) == 1
    for record in copies:
        write_csv(record, tmp_path / f"{record.name}.csv")
    again = read_csv(tmp_path, problem.channels)
    assert check(again, problem, inputs=False).ok


# -- sizes -----------------------------------------------------------------------------------

SIZED = [
    (diving_log, Fault("bias", ("q",), 0.006)),
    (diving_log, Fault("scale", ("u",), -0.05)),
    (diving_log, Fault("delay", ("z",), 0.6)),
    (diving_log, Fault("lever", ("w",), 0.5, "q")),
    (ship_log, Fault("bias", ("v",), 0.1)),
    (ship_log, Fault("scale", ("u",), 0.04)),
    (ship_log, Fault("delay", ("x", "y"), 0.8)),
    (ship_log, Fault("lever", ("v",), -4.0, "r")),
]


@pytest.mark.parametrize(("make", "fault"), SIZED, ids=lambda x: getattr(x, "kind", ""))
def test_size_of_a_fault_lies_within_four_standard_deviations(make, fault: Fault) -> None:  # type: ignore[no-untyped-def]
    """A fault of one size is the only finding, and its interval is not far from the truth."""
    vehicle = DIVER if make is diving_log else SHIP
    found = check(make(fault), vehicle.model, inputs=False)
    one = match(found, fault)
    assert len(found.serious) == 1
    assert one is not None
    assert one.size is not None
    assert one.interval is not None
    half = 0.5 * (one.interval[1] - one.interval[0])
    assert abs(one.size - fault.size) < 2.0 * half
    assert half < 0.2 * abs(fault.size)


def test_lag_of_all_but_the_positions_is_said_of_them() -> None:
    """Positions that come first mean that everything else is late."""
    found = check(ship_log(Fault("delay", ("u", "v", "psi", "r"), 0.9)), SHIP.model, inputs=False)
    one = found.serious[0]
    assert len(found.serious) == 1
    assert set(one.signals) == {"u", "v", "psi", "r"}
    assert one.size == pytest.approx(0.9, abs=0.05)


def test_bias_of_pitch_and_misalignment_are_one_group() -> None:
    """What kinematics cannot tell apart is named as a group."""
    data = diving_log()
    records = []
    for record in data:
        u, w = record.output("u"), record.output("w")
        columns = dict(zip(record.channels.output_names, record.outputs.T, strict=True))
        columns |= {"u": u - 0.04 * w, "w": w + 0.04 * u}
        records.append(record.with_outputs(np.column_stack(list(columns.values()))))
    found = check(Dataset(tuple(records)), DIVER.model, inputs=False)
    assert len(found.serious) == 1
    text = " ".join((found.serious[0].name, *found.serious[0].alternatives))
    assert "bias" in text
    assert "theta" in text
    assert "misalignment" in text


def test_sensor_effect_of_the_model_is_no_alarm() -> None:
    """A bias that the model allows for is told, but does not make the log suspect."""
    from oed_sysid.physics import sensor_bias

    model = DIVER.model + sensor_bias("bias_q", "q", "rad/s", scale=0.01)
    data = diving_log(Fault("bias", ("q",), 0.008))
    records = tuple(replace(record, channels=model.channels) for record in data)
    found = check(Dataset(records), model, inputs=False)
    assert found.ok
    assert found.named("bias", "q") is not None


# -- screens ---------------------------------------------------------------------------------


def screened(change, n: int = 800) -> dict[str, object]:  # type: ignore[no-untyped-def]
    """Faults of one noisy signal after a change, by kind."""
    rng = np.random.default_rng(2)
    t = np.arange(n) * 0.1
    y = np.sin(0.5 * t) + 0.01 * rng.standard_normal(n)
    trace = Trace("run", t, {"y": change(y)}, {"y": "m"})
    trace = replace(trace, noise={"y": 0.01})
    return {fault.kind: fault for fault in screen(trace)}


def test_clean_signal_passes_all_screens() -> None:
    """A sine with noise has nothing to say."""
    assert not screened(lambda y: y)


def test_screens_name_what_happened() -> None:
    """Spikes, drop-outs, frozen, cut-off, held, coarse and dead signals, each by its name."""

    def changed(rows, value):  # type: ignore[no-untyped-def]
        def change(y: np.ndarray) -> np.ndarray:
            y = y.copy()
            y[rows] = value if not callable(value) else value(y[rows])
            return y

        return change

    hit = np.array([100, 300, 555])
    assert list(screened(changed(hit, lambda v: v + 0.4))["spikes"].rows) == list(hit)  # type: ignore[attr-defined]
    lost = np.array([80, 201, 202, 390, 511, 640])
    assert list(screened(changed(lost, -9.0))["dropouts"].rows) == list(lost)  # type: ignore[attr-defined]
    frozen = screened(changed(slice(200, 230), 0.123))
    assert set(frozen) == {"frozen"}
    assert "saturated" in screened(lambda y: np.minimum(y, 0.8))
    assert screened(lambda y: np.repeat(y[::5], 5))["held"].amount == pytest.approx(0.5)  # type: ignore[attr-defined]
    assert "quantised" in screened(lambda y: np.round(y * 10.0) / 10.0)


def test_a_kink_is_no_spike() -> None:
    """A rudder that moves at its rate limit leaves no spike in a noise-free rate."""
    t = np.arange(400) * 0.1
    y = np.interp(t, [0.0, 10.0, 12.0, 25.0, 27.0, 40.0], [0.0, 0.0, 1.0, 1.0, -1.0, -1.0])
    assert not screen(Trace("run", t, {"y": y}, {"y": "m"}, {"y": 0.0}))


def test_copy_of_a_record_is_recognised_when_shifted_and_thinned() -> None:
    """The same samples under another name, time and rate are a copy."""
    data = diving_log()
    first = data[0]
    copy = replace(first.thin(3).rename("another"), times=first.thin(3).times + 1000.0)
    found = check(Dataset((*data.records, copy)), DIVER.model, inputs=False)
    one = found.named("duplicate")
    assert one is not None
    assert set(one.records) == {first.name, "another"}


def test_step_of_the_clock_is_told_from_a_gap() -> None:
    """Missing time changes the position; a clock that was set does not."""
    data = diving_log()
    record = data[0]
    later = record.times + np.where(np.arange(record.n_samples) >= 400, 5.0, 0.0)
    jumped = Dataset((replace(record, times=later), *data.records[1:]))
    assert check(jumped, DIVER.model, inputs=False).named("clock") is not None
    kept = np.r_[0:400, 450 : record.n_samples]
    gap = replace(
        record, times=record.times[kept], inputs=record.inputs[kept], outputs=record.outputs[kept]
    )
    found = check(Dataset((gap, *data.records[1:])), DIVER.model, inputs=False)
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


def test_noise_of_an_equation_is_recovered() -> None:
    """Levels of white noise plus a random walk come out within their own error."""
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(20):
        parts = []
        for _ in range(3):
            walk = np.cumsum(0.3 * rng.standard_normal(240))
            e = rng.standard_normal(240) + walk + 5.0
            parts.append(np.column_stack([e, np.arange(240.0)]))
        ratios.append(estimate(parts, 0.0, 0.0).walk_variance / 0.09)
    assert 0.8 < np.mean(ratios) < 1.25


def test_whitening_makes_a_random_walk_white() -> None:
    """Whitened noise of the assumed kind has unit variance and no correlation."""
    rng = np.random.default_rng(1)
    level, rho, theta = 2.0, 0.7, 0.4
    steps = np.zeros(20_000)
    noise = level * rng.standard_normal(20_000)
    for k in range(1, steps.size):
        steps[k] = rho * steps[k - 1] + noise[k] - theta * noise[k - 1]
    white = Colour(level, rho, theta).whiten(np.cumsum(steps)[:, None])[100:, 0]
    assert white.std() == pytest.approx(1.0, abs=0.03)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.03


def test_result_is_plain_data_and_words(dives) -> None:  # type: ignore[no-untyped-def]
    """The dictionary holds what the report says."""
    problem, data = dives
    found = check(spoil(data, "q_bias"), problem, inputs=False)
    plain = json.loads(json.dumps(found.to_dict()))
    assert plain["suspect"] is True
    assert plain["findings"][0]["name"] == "bias q"
    low, high = plain["findings"][0]["interval"]
    assert low < 0.01 < high
    assert "bias" in found.report()
    assert "0.57" in found.report()


def test_group_of_a_fault_counts_as_named() -> None:
    """The benchmark's reading of groups sees rivals in the list of alternatives."""
    found = check(ship_log(Fault("scale", ("r",), 0.05)), SHIP.model, inputs=False)
    assert is_named(found, Fault("scale", ("r",), 0.05))
    assert not is_named(found, Fault("bias", ("u",), 0.05))
    assert math.isfinite(found.duration)
