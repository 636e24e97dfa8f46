"""A sensor that is off in one record only, as a gyro is that was switched on anew."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.compatibility import DIVER, SHIP, Vehicle, log, motions
from oed_sysid import Dataset, check
from oed_sysid.evidence.check import corrected_copies


def spoilt(vehicle: Vehicle, seed: int, sizes: dict[int, tuple[str, float]]) -> Dataset:
    """A log in which signals have constant errors, by record."""
    rng = np.random.default_rng(seed)
    data = log(vehicle, motions(vehicle, rng), (), 0.0, rng)
    records = list(data.records)
    for number, (name, size) in sizes.items():
        outputs = records[number].outputs.copy()
        outputs[:, data.channels.output_names.index(name)] += size
        records[number] = records[number].with_outputs(outputs)
    return Dataset(tuple(records))


@pytest.mark.parametrize(
    ("vehicle", "name", "size"),
    [(SHIP, "r", 0.003), (SHIP, "r", 0.01), (DIVER, "q", -0.01), (DIVER, "theta", 0.05)],
)
def test_the_record_is_named_with_the_size(vehicle: Vehicle, name: str, size: float) -> None:
    """One finding, of that signal in that record; its interval holds the error."""
    found = check(spoilt(vehicle, 1, {1: (name, size)}), vehicle.model, inputs=False)
    (one,) = found.serious
    assert (one.kind, one.signals, one.records) == ("bias", (name,), ("run_1",))
    assert one.interval is not None
    assert one.interval[0] <= size <= one.interval[1]
    assert abs(one.size or 0.0) > 0.8 * abs(size)


def test_two_records_have_each_their_own() -> None:
    """Errors of opposite sign, which no common bias could say."""
    data = spoilt(SHIP, 0, {0: ("r", 0.006), 2: ("r", -0.004)})
    found = check(data, SHIP.model, inputs=False)
    sizes = {one.records: one.size for one in found.serious}
    assert sizes == {
        ("run_0",): pytest.approx(0.006, abs=4e-4),
        ("run_2",): pytest.approx(-0.004, abs=4e-4),
    }


def test_an_error_of_all_records_stays_one_finding() -> None:
    """What one number says is not said three times."""
    data = spoilt(SHIP, 0, {k: ("r", 0.006) for k in range(3)})
    (one,) = check(data, SHIP.model, inputs=False).serious
    assert one.records == ("run_0", "run_1", "run_2")


def test_the_copy_changes_that_record_only() -> None:
    """Undone where it was found, and nowhere else."""
    clean, data = spoilt(DIVER, 2, {}), spoilt(DIVER, 2, {1: ("q", 0.01)})
    copies, done = corrected_copies(data, DIVER.model, check(data, DIVER.model, inputs=False))
    assert len(done) == 1
    for number, (copy, before, true) in enumerate(zip(copies, data, clean, strict=True)):
        expected = true if number == 1 else before
        np.testing.assert_allclose(copy.outputs, expected.outputs, atol=5e-4)
