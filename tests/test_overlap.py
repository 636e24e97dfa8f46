"""Training and validation records that are the same measurement are told by their noise."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from yaw_vehicle import NOISE, yaw_record

from oed_sysid.data.dataset import Dataset, Record, check_disjoint, overlap, read_csv, write_csv
from oed_sysid.errors import DataError

STEP, SAMPLES = 0.5, 200


def run(seed: int, **options: object) -> Record:
    """A zigzag-like run with its own noise."""
    return yaw_record(f"run_{seed}", np.random.default_rng(seed), **options)


def later(record: Record, seconds: float) -> Record:
    """The same record with another clock."""
    return replace(record, times=record.times + seconds)


def rows(record: Record, chosen: slice) -> Record:
    """A part of a record."""
    return replace(
        record,
        times=record.times[chosen],
        inputs=record.inputs[chosen],
        outputs=record.outputs[chosen],
    )


def rounded(record: Record, digits: int) -> Record:
    """What a file with so many significant digits of the span keeps."""
    quantum = 10.0**-digits * np.ptp(record.outputs, axis=0)
    return record.with_outputs(np.round(record.outputs / quantum) * quantum)


def gaps(record: Record) -> Record:
    """Outputs at other rates: the heading every 3rd, the yaw rate every 2nd sample."""
    outputs = record.outputs.copy()
    outputs[np.arange(len(outputs)) % 3 > 0, 0] = np.nan
    outputs[np.arange(len(outputs)) % 2 > 0, 1] = np.nan
    return record.with_outputs(outputs)


COPIES: dict[str, Callable[[Record], Record]] = {
    "identical": lambda record: record,
    "renamed": lambda record: record.rename("another"),
    "clock set": lambda record: later(record, 3600.25),
    "clock set back": lambda record: later(record, -17.0),
    "thinned": lambda record: record.thin(3),
    "thinned and clock set": lambda record: later(rows(record, slice(1, None, 2)), 12.5),
    "middle part": lambda record: rows(record, slice(60, 120)),
    "short part": lambda record: rows(record, slice(60, 75)),
    "first row dropped": lambda record: rows(record, slice(1, None)),
    "last row dropped": lambda record: rows(record, slice(None, -1)),
    "ends dropped, clock at zero": lambda record: later(rows(record, slice(7, -9)), -3.5),
    "four digits": lambda record: rounded(record, 4),
    "six digits, thinned": lambda record: rounded(record, 6).thin(2),
    "in degrees and back": lambda record: record.with_outputs(
        np.radians(np.degrees(record.outputs).round(9))
    ),
    "one output removed": lambda record: record.with_outputs(record.outputs * [1.0, np.nan]),
    "gaps": gaps,
}


@pytest.mark.parametrize("copy", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("swapped", [False, True])
def test_copies_are_refused(copy: Callable[[Record], Record], swapped: bool) -> None:
    """Every kind of copy is refused, whichever of the two is the training record."""
    original, other = run(1), copy(run(1))
    pair = ((run(2), other), (run(3), original)) if swapped else ((run(2), original), (other,))
    with pytest.raises(DataError, match="is training record") as caught:
        check_disjoint(*pair)
    assert "Validation record" in str(caught.value)


def test_round_trip_through_a_file(tmp_path: Path) -> None:
    """A training record written to CSV in degrees and read again is refused."""
    record = run(1)
    lines = ["t [ms],delta [deg],psi [deg],r [deg/s]"]
    for t, delta, (psi, r) in zip(record.times, record.inputs[:, 0], record.outputs, strict=True):
        lines.append(
            f"{1000 * t:.3f},{np.degrees(delta):.6f},{np.degrees(psi):.6f},{np.degrees(r):.6f}"
        )
    (tmp_path / "test.csv").write_text("\n".join(lines))
    write_csv(record, tmp_path / "exact.csv")
    for name in ("test", "exact"):
        with pytest.raises(DataError, match=f"'{name}' is training record 'run_1'"):
            check_disjoint([record], read_csv(tmp_path / f"{name}.csv", record.channels))


def test_common_part_of_two_cuts() -> None:
    """Two cuts of one long log that share a fifth of their rows are refused, with the clock."""
    log = run(5, n=400)
    first, second = rows(log, slice(0, 200)), later(rows(log, slice(160, 360)), -80.0)
    found = overlap(first, second.rename("second"))
    assert found is not None
    assert found.shift == pytest.approx(80.0)
    assert found.n_equal == found.n_rows == 39


@pytest.mark.parametrize("seed", range(20))
def test_repeated_manoeuvres_are_different_records(seed: int) -> None:
    """The same manoeuvre with other noise, fine or coarsely quantised, is another record."""
    options = {"noise": NOISE * 10.0 ** np.random.default_rng(seed).uniform(-2, 1)}
    first, second = run(seed, **options), run(1000 + seed, **options)
    check_disjoint([first], [second, later(second, 5.0), second.thin(2)])
    for quantum in ([0.02, 0.01], [0.004, 0.002]):
        coarse = [
            one.with_outputs(np.round(one.outputs / quantum) * quantum)
            for one in (run(seed), run(1000 + seed))
        ]
        check_disjoint(coarse[:1], coarse[1:])
        with pytest.raises(DataError, match="is training record"):
            check_disjoint(coarse, [later(coarse[1], 2.0)])


def test_simulations_without_noise_are_different_records() -> None:
    """Other manoeuvres without noise are accepted, also with a common beginning; copies are not."""
    quiet = np.zeros(2)
    periods = (12.0, 18.0, 24.0, 30.0, 45.0, 90.0)
    runs = [run(0, noise=quiet, period=p).rename(f"period {p:g}") for p in periods]
    for index, record in enumerate(runs):
        check_disjoint(runs[:index] + runs[index + 1 :], [record])
        with pytest.raises(DataError, match="is training record"):
            check_disjoint(runs, [later(record.thin(2), 4.0).rename("copy")])


def test_records_that_rest_are_different_records() -> None:
    """A vehicle at rest gives equal rows in every record; they prove nothing."""
    record = run(0)
    still = record.with_outputs(np.zeros_like(record.outputs))
    check_disjoint([still], [still.thin(2), later(still, 3.0)])


def test_shipped_records_are_disjoint() -> None:
    """The records that come with the diving plane do not overlap; doubled ones do."""
    from oed_sysid.experiments.problem import load_problem

    problem = load_problem("remus_diving_plane")
    folder = Path(__file__).parent.parent / "problems" / "remus_diving_plane" / "data"
    train, test = (
        read_csv(str(folder / f"{kind}_*.csv"), problem.channels) for kind in ("train", "test")
    )
    check_disjoint(train, test)
    with pytest.raises(DataError, match="'test_steps' is training record 'test_steps'"):
        check_disjoint(train + test["test_steps"], test)


def test_long_records_are_compared_quickly() -> None:
    """Two records of 20,000 samples are compared in well under a second."""
    rng = np.random.default_rng(0)
    base = run(1)
    times = np.arange(20_000) * 0.1
    signal = np.stack([np.sin(0.05 * times), 0.05 * np.cos(0.05 * times)], axis=1)
    first, second = (
        Record(n, times, times[:, None] * 0, signal + 0.01 * rng.standard_normal(signal.shape),
               base.channels)
        for n in ("a", "b")
    )  # fmt: skip
    began = time.perf_counter()
    assert overlap(first, second) is None
    assert overlap(first, Dataset((first,))[0].thin(7)) is not None
    assert time.perf_counter() - began < 2.0
