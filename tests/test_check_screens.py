"""Screens of single signals: bursts, drop-outs, steps, copies, what is unexplained."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from altered import altered, trials
from kinematic_logs import DIVER, SHIP, Vehicle, log
from marks import slow
from motion import small

from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Force, Record, load_problem, read_csv, simulate_inputs, write_csv
from oed_sysid.cli import main
from oed_sysid.errors import ModelError
from oed_sysid.evidence.check import LogCheck, check, corrected_copies, why_not_more
from oed_sysid.evidence.contrasts import UNEXPLAINED, unexplained
from oed_sysid.evidence.relations import relations
from oed_sysid.evidence.remainder import Remains
from oed_sysid.evidence.screens import bursts, jitter, screen, screened, steps
from oed_sysid.evidence.traces import Trace, after_steps
from oed_sysid.likelihood.noise_levels import cubic_weights, first_order, off_cubic
from oed_sysid.physics import actuator_offset, backlash, in_each_record, steady_wind

TIMES = np.arange(800) * 0.1


def wave(seed: int = 0, noise: float = 0.01, mean: float = 0.0) -> np.ndarray:
    """A sine with noise, of a hundredth of its size if no other is given."""
    rng = np.random.default_rng(seed)
    return mean + np.sin(0.5 * TIMES) + noise * rng.standard_normal(TIMES.size)


def traced(series: np.ndarray, steps: tuple[int, ...] = ()) -> Trace:
    """A record of one signal with its noise, and of a command that steps up at some samples."""
    command = np.isin(np.arange(TIMES.size), steps).cumsum().astype(float)[:, None]
    return Trace("run", TIMES, {"y": series}, {"y": "m"}, {"y": 0.01}, inputs=command)


def found_in(series: np.ndarray) -> dict[str, list[int]]:
    """Rows of all faults of one signal, by kind."""
    return {fault.kind: fault.rows.tolist() for fault in screen(traced(series))}


def test_cubic_through_four_neighbours() -> None:
    """Cubics are followed exactly by groups of every length; a step of one sample is not."""
    t = np.arange(40.0)
    for length in (1, 2, 6):
        assert np.allclose(off_cubic(0.01 * t**3 - t, length), 0.0, atol=1e-9)
        assert np.allclose(cubic_weights(length).sum(axis=1), 1.0)
    lifted = np.zeros(40)
    lifted[10:13] = 1.0
    assert off_cubic(lifted, 3)[8].tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("length", [2, 3, 4, 5, 6, 8])
@pytest.mark.parametrize("size", [0.3, -2.0])
def test_groups_are_found_with_all_their_samples(length: int, size: float) -> None:
    """Four groups of equal or of alternating sign, in one record of 800 samples."""
    rows = np.concatenate([first + np.arange(length) for first in (60, 231, 402, 655)])
    for signs in (np.ones(length), (-1.0) ** np.arange(length)):
        series = wave()
        series[rows] += size * np.tile(signs, 4)
        assert found_in(series) == {"spikes": rows.tolist()}


def test_neighbouring_spikes_of_other_sign_are_one_group() -> None:
    """Two spikes with one good sample between them are found together with it."""
    series = wave()
    series[300] += 1.0
    series[302] -= 1.0
    assert found_in(series) == {"spikes": [300, 301, 302]}


def test_clean_noise_holds_no_groups() -> None:
    """None in two hundred clean records of 800 samples, half of them with coloured noise."""
    alarms = 0
    for seed in range(200):
        rng = np.random.default_rng((1, seed))
        noise = rng.standard_normal(TIMES.size)
        noise = gauss_markov(noise, 0.8) if seed % 2 else noise
        series = np.sin(0.5 * TIMES) + 0.05 * noise
        alarms += len(bursts(TIMES, series, np.zeros(TIMES.size, dtype=bool), 8.5, 0.02))
    assert alarms == 0


def test_several_small_spikes_are_no_heavy_tail() -> None:
    """Nine of ten times the noise are found; Student's noise of five freedoms has none."""
    hits, alarms = 0, 0
    for seed in range(40):
        rng = np.random.default_rng((2, seed))
        spiky = wave(seed)
        spiky[rng.choice(TIMES.size, 9, replace=False)] += 0.1 * np.resize([1.0, -1.0], 9)
        hits += "spikes" in found_in(spiky)
        alarms += "spikes" in found_in(wave(seed, 0.0) + 0.01 * rng.standard_t(5, TIMES.size))
    assert hits >= 30
    assert alarms == 0


def test_a_short_hump_is_no_group() -> None:
    """A half sine of ten samples and a ramp that turns back rise from sample to sample."""
    nothing = np.zeros(TIMES.size, dtype=bool)
    hump = np.zeros(TIMES.size)
    hump[200:211] = np.sin(np.linspace(0.0, np.pi, 11))
    assert not bursts(TIMES, hump, nothing, 8.5, 0.02)
    ramp = np.interp(np.arange(800), [0, 300, 303, 306, 800], [0.0, 0.0, 1.0, 0.0, 0.0])
    assert not bursts(TIMES, ramp, nothing, 8.5, 0.02)


@pytest.mark.parametrize(("length", "n_found"), [(2, 8), (None, 4)], ids=["groups", "jumps"])
def test_what_follows_steps_of_the_inputs_is_an_answer(length: int | None, n_found: int) -> None:
    """Groups or jumps that begin right after the four steps of an input are none; elsewhere are."""
    starts = (100, 300, 500, 700)
    for shift, expected in ((0, 0), (40, n_found)):
        series = wave()
        for sign, start in zip((1.0, -1.0, 1.0, -1.0), starts, strict=True):
            begin = start + shift
            series[begin : length and begin + length] += 1.0 if length else sign
        faults, (marked,) = screened([traced(series, starts)])
        assert sum(fault.rows.size for fault in faults) == expected
        assert not length or ("y" in marked.fast) is (shift == 0)


@pytest.mark.parametrize("late", [0, 40])
def test_a_slow_sensor_sees_an_answer_in_its_next_samples(late: int) -> None:
    """It jumps by its second sample after a step of an input; long after, by itself."""
    series = wave()
    series[308 + late :] += 1.0
    series[np.arange(TIMES.size) % 5 > 0] = np.nan
    faults, _ = screened([traced(series, (301,))])
    assert [(fault.kind, fault.rows.tolist()) for fault in faults] == [("step", [350])] * (late > 0)
    assert late == 0 or faults[0].amount == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("signal", ["q", "theta", *slow("w", "z")])
def test_groups_in_a_log_are_the_only_finding(signal: str) -> None:
    """Three bursts of two to five samples of a dive: spikes, no bias, scale or delay."""
    problem = load_problem("remus_diving_plane")
    data = trials(problem.model, [problem.experiments["zigzag_10_10"]], 1)
    series = data[0].output(signal).copy()
    size = 8.0 * series.std()
    for first, length in ((100, 2), (290, 3), (480, 5)):
        series[first : first + length] += size
    found = check(altered(data, **{signal: series}), problem)
    assert [(one.kind, one.signals, one.size) for one in found.serious] == [
        ("spikes", (signal,), 10.0)
    ]


RUNS = ((100, 3), (290, 8), (520, 15))
ROWS = np.concatenate([np.arange(first, first + length) for first, length in RUNS])


@pytest.mark.parametrize("value", [0.0, 6.0, -1.0])
def test_runs_that_a_signal_falls_to_at_once_are_dropouts(value: float) -> None:
    """Runs of 3, 8 and 15 samples below or above everything else, with all their samples."""
    series = wave(mean=3.0)
    series[ROWS] = value
    assert found_in(series) == {"dropouts": ROWS.tolist()}


@pytest.mark.parametrize(("kind", "first", "last"), [("dropouts", 290, 298), ("frozen", 200, 230)])
def test_a_single_run_of_one_value_is_enough(kind: str, first: int, last: int) -> None:
    """Zeros beyond all other values, or a value of the signal's own that it stays at."""
    series = wave(mean=3.0)
    series[first:last] = 0.0 if kind == "dropouts" else series[first]
    # What was there before it froze is no fault.
    assert found_in(series) == {kind: list(range(first + (kind == "frozen"), last))}


def test_what_freezes_farthest_out_is_frozen_and_not_cut_off() -> None:
    """A drift that stops and leaps on was at no limit, although no other sample lies so far out."""
    series = wave() - 0.5 * TIMES
    series[:30] = series[0]
    assert found_in(series) == {"frozen": [*range(1, 30)]}


def test_a_copy_at_a_slower_rate_is_one() -> None:
    """Samples that both signals miss are no difference between them."""
    slow = np.where(np.arange(TIMES.size) % 4, np.nan, wave())
    both = {"y": slow, "z": slow.copy()}
    trace = Trace("run", TIMES, both, dict.fromkeys(both, "m"), dict.fromkeys(both, 0.01))
    assert "copied" in {fault.kind for fault in screen(trace)}


def test_single_dropouts_held_and_coarse_samples_are_told() -> None:
    """Lost samples here and there by their rows, a hold of five by its time, coarse steps."""
    lost = [80, 201, 202, 390, 511, 640]
    series = wave()
    series[lost] = -9.0
    assert found_in(series)["dropouts"] == lost
    (held,) = (one for one in screen(traced(np.repeat(wave()[::5], 5))) if one.kind == "held")
    assert held.amount == pytest.approx(0.5)
    assert "quantised" in found_in(np.round(wave(), 1))


def test_a_slow_signal_stays_on_a_step_of_its_converter() -> None:
    """A rate that settles after each of some commands, in steps of five times its noise."""
    rng = np.random.default_rng(0)
    commands = np.repeat(rng.uniform(-0.1, 0.1, TIMES.size // 40 + 1), 40)[: TIMES.size]
    settled = first_order(commands, 0.3) + 0.002 * rng.standard_normal(TIMES.size)
    assert set(found_in(np.round(settled, 2))) == {"quantised"}


@pytest.mark.parametrize("limit", [2.2, 3.5, 3.8])
def test_a_limit_that_is_approached_cuts_off(limit: float) -> None:
    """A signal that runs into a limit with its usual steps is cut off there, at every crest."""
    series = (np.maximum if limit < 3.0 else np.minimum)(wave(mean=3.0), limit)
    found = found_in(series)
    assert set(found) == {"saturated"}
    # Where noise takes it over the limit for one or two samples, these are no runs.
    assert len(found["saturated"]) > 0.8 * np.sum(series == limit)


def test_the_end_of_a_short_hold_is_no_step() -> None:
    """Five equal samples of a quick signal, and the jump to where it is by then."""
    rng = np.random.default_rng(0)
    series = np.sin(2.0 * TIMES) + 0.01 * rng.standard_normal(TIMES.size)
    for first in (100, 333, 610):
        series[first : first + 5] = series[first]
    assert "step" not in found_in(series)


@pytest.mark.parametrize("signal", ["z", *slow("u")])
def test_zeros_in_a_log_are_dropouts_and_nothing_else(signal: str) -> None:
    """The speed and the depth of a dive are positive: zeros there are no limit."""
    problem = load_problem("remus_diving_plane")
    names = ("zigzag_5_5", "zigzag_10_10")
    data = trials(problem.model, [problem.experiments[name] for name in names], ())
    row = np.arange(data[0].n_samples)
    data = altered(
        data, **{signal: lambda record: np.where(np.isin(row, ROWS), 0.0, record.output(signal))}
    )
    found = check(data, problem)
    assert [(one.kind, one.signals, one.size) for one in found.serious] == [
        ("dropouts", (signal,), 52.0)
    ]


GOOD = np.zeros(800, dtype=bool)


def jumping(data: Dataset, jumps: dict[str, tuple[int, int, float]]) -> Dataset:
    """Copies of records; a signal jumps in one of them (number, first row after, size)."""
    for name, (number, row, size) in jumps.items():
        later = np.arange(data[number].n_samples) >= row
        data = altered(data, number, **{name: data[number].output(name) + size * later})
    return data


@pytest.mark.parametrize("size", [0.9, -1.0, 5.0])
@pytest.mark.parametrize("row", [15, 400, 783])
def test_row_and_size_of_a_jump(row: int, size: float) -> None:
    """A jump is found at its sample, within four standard errors of its size."""
    series = wave()
    series[row:] += size
    ((found, found_size),) = steps(TIMES, series, GOOD, 0.05).items()
    assert found == row
    # Lines through five samples, half a sample ahead, are uncertain by 1.28 times the noise.
    assert found_size == pytest.approx(size, abs=4.0 * 0.0128)


def test_sizes_are_better_than_those_of_two_short_lines() -> None:
    """Over a hundred records the error is below the noise; two short lines have 1.28 times it."""
    errors = []
    for seed in range(100):
        series = wave(seed)
        series[400:] += 1.0
        (found,) = steps(TIMES, series, GOOD, 0.05).values()
        errors.append(found - 1.0)
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
    passing = wave()
    passing[300:308] += 2.0
    assert not steps(TIMES, passing, GOOD, 0.05)
    spike = wave()
    spike[300] += 2.0
    assert [fault.kind for fault in screen(traced(spike))] == ["spikes"]


@pytest.mark.parametrize(
    ("vehicle", "signal", "size", "unit"),
    [(SHIP, "psi", np.pi / 2.0, "rad"), *slow((SHIP, "r", -0.1, "rad/s"), (DIVER, "z", 2.0, "m"))],
)
def test_a_jump_is_the_only_finding_and_is_undone(
    vehicle: Vehicle, signal: str, size: float, unit: str
) -> None:
    """A compass, a gyro and a depth that were set anew: size, record, and the equations after."""
    data, model = log(vehicle, seed=2), vehicle.model
    spoilt = jumping(data, {signal: (1, 400, size)})
    found = check(spoilt, model, inputs=False)
    (one,) = found.serious
    assert (one.kind, one.signals, one.records, one.unit) == (
        "step",
        (signal,),
        (data[1].name,),
        unit,
    )
    assert one.size == pytest.approx(size, abs=4.0 * 1.28 * vehicle.noise[signal])
    assert one.correction.rows == {data[1].name: (400,)}
    assert f"t = {data[1].times[400]:.6g} s" in one.says
    clean = check(data, model, inputs=False)
    for before, after in zip(clean.balances, found.balances, strict=True):
        assert after.after == pytest.approx(before.after, abs=0.02)
    assert check(spoilt, model).named("step", signal) is not None
    stored = json.loads(json.dumps(found.to_dict()))["findings"][0]["correction"]
    assert stored["rows"] == {data[1].name: [400]}
    assert stored["sizes"][data[1].name] == [one.size]


def test_size_is_said_in_degrees_and_corrected_copies_pass() -> None:
    """Jumps of two signals in one log are both undone in the copies."""
    data = log(SHIP, seed=2)
    spoilt = jumping(data, {"psi": (0, 300, np.pi / 2.0), "y": (2, 500, -40.0)})
    found = check(spoilt, SHIP.model, inputs=False)
    assert {(f.kind, f.signals) for f in found.serious} == {("step", ("psi",)), ("step", ("y",))}
    heading = found.named("step", "psi")
    assert heading.size == pytest.approx(np.pi / 2.0, abs=4.0 * 0.004)
    assert f"{np.degrees(heading.size):+.3g} deg" in heading.says
    copies, done = corrected_copies(spoilt, SHIP.model, found)
    assert len(done) == 2
    assert np.allclose(copies[0].output("psi"), data[0].output("psi"), atol=0.03)
    assert np.allclose(copies[2].output("y"), data[2].output("y"), atol=0.6)
    assert check(copies, SHIP.model, inputs=False).ok


@pytest.mark.slow
def test_an_underwater_vehicle_whose_compass_was_reset() -> None:
    """In six degrees of freedom, in all four records, between the steps of the rudder."""
    problem = load_problem("remus_6dof")
    data = spoilt = trials(problem.true_model(), problem.experiments.values(), (3,))
    for k in range(len(data)):
        spoilt = jumping(spoilt, {"psi": (k, 150, np.pi / 2.0)})
    (one,) = check(spoilt, problem).serious
    assert (one.kind, one.signals, one.records) == ("step", ("psi",), data.names)
    assert all(rows == (150,) for rows in one.correction.rows.values())
    assert one.size == pytest.approx(np.pi / 2.0, abs=0.05)


def test_a_heading_that_catches_up_is_not_shifted() -> None:
    """A compass that coasted through a turn is right after its jump: nothing is subtracted."""
    data = log(SHIP, seed=2)
    heading = data[1].output("psi").copy()
    turned = np.abs(heading[30:] - heading[:-30])
    first = int(np.argmax(turned))
    rng = np.random.default_rng(0)
    heading[first : first + 30] = heading[first] + 0.004 * rng.standard_normal(30)
    found = check(altered(data, 1, psi=heading), SHIP.model, inputs=False)
    one = found.named("step", "psi")
    assert one.size == pytest.approx(heading[first + 30] - heading[first], abs=0.05)
    assert one.correction is None
    assert "caught up" in one.says


def test_a_jump_that_no_equation_contradicts_is_a_note() -> None:
    """A tank's level may fall at once, or its sensor was set: nothing else in the log tells."""
    law, values = {"level": "a*pump - b*level"}, {"a [1]": 1.0, "b [1/s]": 0.1}
    tank = small("tank", "level [m] <- pump [m/s]", law, values, 0.01)
    times = np.arange(300.0)
    level = 1.0 + 0.5 * np.sin(0.05 * times) - 0.3 * (times >= 150.0)
    level += 0.01 * np.random.default_rng(0).standard_normal(300)
    pump = 0.1 + 0.05 * np.sin(0.05 * times)
    data = Dataset((Record("run", times, pump[:, None], level[:, None], tank.channels),))
    found = check(data, tank, inputs=False)
    one = found.named("step", "level")
    assert one.size == pytest.approx(-0.3, abs=0.05)
    assert (one.suspect, one.correction, found.suspect) == (False, None, False)
    # Nothing is certified that the check could not judge.
    assert found.unjudged == ("whether level jumped or its sensor was set",)
    assert Remains(0.0, None, unjudged=found.unjudged).kind == "not known"


def heading(jump: float, turning: float, noise: float = 0.002) -> Trace:
    """A heading and its rate over 200 s at 5 Hz; the heading jumps at 100 s."""
    rng = np.random.default_rng(5)
    t = np.arange(1000) * 0.2
    psi = turning * np.sin(0.1 * t) + jump * (t >= 100.0)
    r = 0.1 * turning * np.cos(0.1 * t)
    return Trace(
        "run",
        t,
        {
            "psi": psi + noise * rng.standard_normal(t.size),
            "r": r + 0.1 * noise * rng.standard_normal(t.size),
        },
        {"psi": "rad", "r": "rad/s"},
        {"psi": noise, "r": 0.1 * noise},
    )


def misfit(trace: Trace):  # type: ignore[no-untyped-def]
    """What the equation of the heading leaves in a record; None if noise explains it."""
    equations = tuple(one for one in relations(SHIP.model) if one.target == "psi")
    return next(iter(unexplained([trace], equations)), None)


def test_share_and_time_of_a_misfit() -> None:
    """A jump of 90 degrees is what is left of a heading that swings by half a radian."""
    found = misfit(heading(np.pi / 2.0, 0.5))
    # One block changes by pi/2, the other 199 by 0.05 cos(0.1 t).
    usual = 199.0 * 0.05**2 / 2.0
    assert found.share == pytest.approx(np.sqrt((np.pi / 2.0) ** 2 / (usual + 2.56)), rel=0.05)
    assert found.time == pytest.approx(100.0, abs=1.0)
    assert misfit(heading(0.0, 0.5)) is None


def test_noise_that_leaves_everything_is_no_misfit() -> None:
    """A heading that hardly turns is all noise, and no equation fails for that."""
    quiet = heading(0.0, 1e-4)
    assert misfit(quiet) is None
    still = replace(quiet, noise={"psi": 1e-5, "r": 1e-6})
    found = misfit(still)
    assert found.share > 0.9


@pytest.fixture(scope="module", name="wandered")
def _wandered() -> tuple[Dataset, LogCheck]:
    """A yaw rate of another record, two spikes and a turned signal, with what the check finds."""
    data = log(SHIP)
    spiky = data[0].output("u").copy()
    spiky[[200, 500]] += 3.0
    spoilt = altered(altered(data, 1, r=data[0].output("r")), 0, u=spiky)
    spoilt = altered(spoilt, y=lambda record: -record.output("y"))
    return spoilt, check(spoilt, SHIP.model, inputs=False)


def test_the_equation_the_record_and_the_time_are_named(wandered: tuple[Dataset, LogCheck]) -> None:
    """A rate of another record is no sign, unit or size: the heading stays unexplained there."""
    data, found = wandered
    one = found.named("unexplained", "psi")
    assert one.records == (data[1].name,)
    assert one.size > UNEXPLAINED
    assert found.suspect
    psi_r = next(row for row in found.balances if row.relation == "psi' = r")
    assert psi_r.after > 0.2


def test_only_bad_samples_are_corrected_then(wandered: tuple[Dataset, LogCheck]) -> None:
    """A unit that was found is not undone while an equation fails; empty cells are written."""
    spoilt, found = wandered
    assert found.named("sign", "y") is not None
    copies, done = corrected_copies(spoilt, SHIP.model, found)
    assert done == (found.named("spikes", "u").says,)
    assert "sign y" in why_not_more(found)
    for before, after in zip(spoilt, copies, strict=True):
        kept = np.isfinite(after.outputs)
        assert np.array_equal(after.outputs[kept], before.outputs[kept])
    assert np.flatnonzero(np.isnan(copies[0].output("u"))).tolist() == [200, 500]
    good = replace(found, findings=tuple(f for f in found.findings if f.kind != "unexplained"))
    assert why_not_more(good) == ""
    copies, _ = corrected_copies(spoilt, SHIP.model, good)
    assert np.array_equal(copies[2].output("y"), -spoilt[2].output("y"))


@pytest.mark.slow
def test_fix_writes_what_was_logged_where_an_equation_fails(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    """The command says why it corrects nothing, and its copies equal the records."""
    problem = load_problem("remus_diving_plane")
    names = ("zigzag_5_5", "zigzag_10_10", "steps")
    runs = trials(problem.model, [problem.experiments[name] for name in names], 3)
    runs = altered(runs, 1, theta=runs[2].output("theta"))
    for record in runs:
        write_csv(record, tmp_path / f"{record.name}.csv")
    fixed = tmp_path / "fixed"
    assert main(["check", "remus_diving_plane", str(tmp_path), "--fix", str(fixed)]) == 4
    assert "Not corrected" in capsys.readouterr().err
    logged = read_csv(tmp_path, problem.channels)
    for record in read_csv(fixed, problem.channels):
        assert np.allclose(record.outputs, logged[record.name].outputs, rtol=1e-9)


@pytest.mark.parametrize("colour", [0.95, *slow(0.0, 0.7)])
def test_noise_of_any_colour_is_no_misfit(colour: float) -> None:
    """Clean logs of both vehicles leave less than a third of every left side."""
    for vehicle in (DIVER, SHIP):
        found = check(log(vehicle, seed=3, colour=colour), vehicle.model, inputs=False)
        assert found.named("unexplained") is None
        assert max(row.after for row in found.balances) < UNEXPLAINED


TWIN = small(
    "twin screw",
    "u [m/s], r [rad/s] <- port [N], starboard [N]",
    parameters={"m [kg]": 100.0, "I [kg m^2]": 80.0},
    axes={"X": "u", "N": "r"},
    inertia={("X", "u"): "m", ("N", "r"): "I"},
    effects=(Force("screws", {"X": "port + starboard - 40*u", "N": "port - starboard - 60*r"}),),
    step=0.05,
)
TIMES_SIGNALS = np.arange(400) * 0.1
INPUTS = {
    "port": 20 * np.sin(0.7 * TIMES_SIGNALS),
    "starboard": 15 * np.sin(0.4 * TIMES_SIGNALS + 1),
}


def test_a_size_for_every_record() -> None:
    """Amplitudes are free in every record under names of their own; the shape is shared."""
    wind = steady_wind(axes=("X", "Y", "N"))
    found = in_each_record(wind)
    assert found.amplitude_names == ("E_wind_north_by_record", "E_wind_east_by_record")
    assert found.shape_names == ("arm_wind_by_record", "side_wind_by_record")
    assert [p.per_record for p in found.parameters] == [True, True, False, False]
    same = {f"{p.name}_by_record": p.value for p in wind.parameters}
    assert {p.name: p.value for p in found.parameters} == same
    for axis, text in found.terms.items():
        assert text.replace("_by_record", "") == wind.terms[axis]
    trim = actuator_offset("trim", "port", "N", value=3.0)
    shared, own = (simulate_inputs(TWIN + e, TIMES_SIGNALS, inputs=INPUTS) for e in (trim,
                   in_each_record(trim)))  # fmt: skip
    np.testing.assert_array_equal(shared.outputs, own.outputs)


def test_an_effect_with_memory_is_refused() -> None:
    """Two effects cannot share what one remembers: what to do is said."""
    with pytest.raises(ModelError, match="per_record=True"):
        in_each_record(backlash("play", "port", "N"))


@pytest.mark.parametrize("held", [("train_steps",), *slow((("train_zigzag_5_5",),))])
def test_depth_that_some_records_hold_is_no_other_fault(held: tuple[str, ...]) -> None:
    """A slow depth sensor in one of three records: held there, and nothing else is said."""
    problem = load_problem("remus_diving_plane")
    data = Dataset(record for record in problem.data() if record.name.startswith("train"))
    for number in [data.names.index(name) for name in held]:
        fifth = np.arange(data[number].n_samples) // 5 * 5
        data = altered(data, number, z=data[number].output("z")[fifth])
    found = check(data, problem.model, inputs=False)
    assert [(one.name, one.records) for one in found.findings] == [("held z", held)]


@pytest.mark.slow
def test_motion_that_is_faster_than_the_samples_is_no_noise() -> None:
    """The roll rate of the shipped vehicle swings fast: its noise is as declared."""
    problem = load_problem("remus_6dof")
    found = check(problem.data(), problem.model, inputs=False)
    assert found.named("noise") is None
    loud = [
        record.with_outputs(
            record.outputs + 3.0 * 0.005 * rng.standard_normal(record.outputs.shape)
        )
        for record, rng in zip(problem.data(), map(np.random.default_rng, range(9)), strict=False)
    ]
    said = check(Dataset(loud), problem.model, inputs=False).named("noise", "psi")
    assert said.size == pytest.approx(np.sqrt(10.0), rel=0.05)


# -- times that scatter ----------------------------------------------------------------------


def scattered(size: float, noise: float, seed: int) -> list[Trace]:
    """A heading and its rate as logged: taken beside the times that are written."""
    rng = np.random.default_rng(seed)
    t = np.arange(900) * 0.2
    taken = t + size * rng.standard_normal(t.size)
    louder = 1.0 + 4.0 * np.cos(0.3 * t) ** 2  # in faster turns, which is no jitter
    values = {
        "psi": np.sin(0.3 * taken) + noise * louder * rng.standard_normal(t.size),
        "r": 0.3 * np.cos(0.3 * taken) + 0.5 * noise * rng.standard_normal(t.size),
    }
    return [Trace("run", t, values, {"psi": "rad", "r": "rad/s"})]


def test_standard_deviation_of_scattering_times() -> None:
    """Two signals that share a clock tell how far it scatters, within the errors stated."""
    off = [(j.size - 0.06) / j.std for j in (jitter(scattered(0.06, 5e-3, k)) for k in range(20))]
    assert abs(np.mean(off)) < 1.0
    assert np.max(np.abs(off)) < 4.0


def test_noise_that_follows_the_rate_is_no_jitter() -> None:
    """Only products of signals are asked, whose signs are those of the rates by chance."""
    assert all(jitter(scattered(0.0, 5e-3, seed)).signals == () for seed in range(40))


def test_uneven_times_that_are_right_are_no_jitter() -> None:
    """Cubics go through the times that are written, even or not."""
    rng = np.random.default_rng(2)
    t = np.arange(900) * 0.2 + 0.05 * rng.uniform(-1.0, 1.0, 900)
    values = {
        "psi": np.sin(0.3 * t) + 2e-3 * rng.standard_normal(t.size),
        "r": 0.3 * np.cos(0.3 * t) + 1e-3 * rng.standard_normal(t.size),
    }
    assert jitter([Trace("run", t, values, {"psi": "rad", "r": "rad/s"})]).signals == ()


def test_a_small_step_of_a_held_command_is_a_step() -> None:
    """However small beside others, it is answered; of a command with noise only large ones are."""
    held = np.repeat([0.0, 0.5, 10.0, 9.6], 20)
    assert after_steps(held)[[20, 40, 60]].all()
    noisy = held + 0.01 * np.random.default_rng(0).standard_normal(held.size)
    np.testing.assert_array_equal(np.flatnonzero(after_steps(noisy)), [40, 41, 42])
