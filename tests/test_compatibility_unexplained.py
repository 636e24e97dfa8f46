"""Equations that fail in a way that no finding explains, and what is not corrected then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.compatibility import DIVER, SHIP, Vehicle, log, motions
from oed_sysid import Dataset, check, load_problem, read_csv, simulate, write_csv
from oed_sysid.cli import main
from oed_sysid.evidence.check import SHARE, corrected_copies, misfit, why_not_more
from oed_sysid.evidence.relations import relations
from oed_sysid.evidence.traces import Trace


def clean_log(vehicle: Vehicle, seed: int = 0, colour: float = 0.0) -> Dataset:
    """A log without faults."""
    rng = np.random.default_rng(seed)
    return log(vehicle, motions(vehicle, rng), (), colour, rng)


def with_output(data: Dataset, number: int, name: str, series: np.ndarray) -> Dataset:
    """Copies of records, one output of one of them replaced."""
    outputs = data[number].outputs.copy()
    outputs[:, data.channels.output_names.index(name)] = series
    records = list(data.records)
    records[number] = data[number].with_outputs(outputs)
    return Dataset(tuple(records))


def wandering(data: Dataset) -> Dataset:
    """The yaw rate of the second record comes from the first one."""
    return with_output(data, 1, "r", data[0].output("r"))


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


def test_share_and_time_of_a_misfit() -> None:
    """A jump of 90 degrees is what is left of a heading that swings by half a radian."""
    (equation,) = (one for one in relations(SHIP.model, set(), set()) if one.target == "psi")
    found = misfit(heading(np.pi / 2.0, 0.5), equation)
    assert found is not None
    # One block changes by pi/2, the other 199 by 0.05 cos(0.1 t).
    usual = 199.0 * 0.05**2 / 2.0
    assert found.share == pytest.approx(np.sqrt((np.pi / 2.0) ** 2 / (usual + 2.56)), rel=0.05)
    assert found.time == pytest.approx(100.0, abs=1.0)
    assert misfit(heading(0.0, 0.5), equation) is None


def test_noise_that_leaves_everything_is_no_misfit() -> None:
    """A heading that hardly turns is all noise, and no equation fails for that."""
    (equation,) = (one for one in relations(SHIP.model, set(), set()) if one.target == "psi")
    quiet = heading(0.0, 1e-4)
    assert misfit(quiet, equation) is None
    still = replace(quiet, noise={"psi": 1e-5, "r": 1e-6})
    found = misfit(still, equation)
    assert found is not None
    assert found.share > 0.9


def test_the_equation_the_record_and_the_time_are_named() -> None:
    """A rate of another record is no sign, unit or size: the heading stays unexplained there."""
    data = clean_log(SHIP)
    found = check(wandering(data), SHIP.model, inputs=False)
    one = found.named("unexplained", "psi")
    assert one is not None
    assert one.records == (data[1].name,)
    assert one.size > SHARE
    assert found.contradictory
    psi_r = next(row for row in found.balances if row.relation == "psi' = r")
    assert psi_r.after > 0.2
    assert check(data, SHIP.model, inputs=False).ok


def test_only_bad_samples_are_corrected_then() -> None:
    """A unit that was found is not undone while an equation fails; empty cells are written."""
    data = clean_log(SHIP)
    spoilt = wandering(data)
    spiky = spoilt[0].output("u").copy()
    spiky[[200, 500]] += 3.0
    spoilt = with_output(spoilt, 0, "u", spiky)
    for number in range(3):
        spoilt = with_output(spoilt, number, "y", -spoilt[number].output("y"))
    found = check(spoilt, SHIP.model, inputs=False)
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


def test_fix_writes_what_was_logged_where_an_equation_fails(tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    """The command says why it corrects nothing, and its copies equal the records."""
    problem = load_problem("remus_diving_plane")
    rng = np.random.default_rng(3)
    runs = Dataset(
        tuple(
            simulate(problem.model, problem.experiments[name], rng=rng, name=name)
            for name in ("zigzag_5_5", "zigzag_10_10", "steps")
        )
    )
    runs = with_output(runs, 1, "theta", runs[2].output("theta"))
    for record in runs:
        write_csv(record, tmp_path / f"{record.name}.csv")
    fixed = tmp_path / "fixed"
    assert main(["check", "remus_diving_plane", str(tmp_path), "--fix", str(fixed)]) == 1
    assert "Not corrected" in capsys.readouterr().err
    logged = read_csv(tmp_path, problem.channels)
    for record in read_csv(fixed, problem.channels):
        assert np.allclose(record.outputs, logged[record.name].outputs, rtol=1e-9)


@pytest.mark.parametrize("colour", [0.0, 0.7, 0.95])
def test_noise_of_any_colour_is_no_misfit(colour: float) -> None:
    """Clean logs of both vehicles leave less than a third of every left side."""
    for vehicle in (DIVER, SHIP):
        found = check(clean_log(vehicle, 3, colour), vehicle.model, inputs=False)
        assert found.named("unexplained") is None
        assert max(row.after for row in found.balances) < SHARE
