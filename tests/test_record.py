"""Records: validated once, never changed, cut without counting a sample twice."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError
from oed_sysid.physics.channels import Channels, Input, Output

CHANNELS = Channels((Input("fin", "rad"),), (Output("theta", "rad"), Output("q", "rad/s")))
TIMES = 0.5 * np.arange(11)


def record(**changes: object) -> Record:
    """Return a valid record with some fields changed."""
    fields = {
        "name": "dive_1",
        "times": TIMES,
        "inputs": np.sin(TIMES)[:, None],
        "outputs": np.column_stack([np.cos(TIMES), TIMES]),
        "channels": CHANNELS,
    }
    return Record(**(fields | changes))


def test_properties() -> None:
    """Counts, durations and columns are those of the arrays."""
    dive = record()
    assert (dive.n_samples, dive.duration, dive.sample_time) == (11, 5.0, 0.5)
    assert dive.is_uniform
    np.testing.assert_array_equal(dive.output("q"), TIMES)
    np.testing.assert_array_equal(dive.input("fin"), np.sin(TIMES))
    assert dive.constant_channels == ()
    with pytest.raises(DataError, match=r"no output 'thetta'\. It has theta, q. Did you mean"):
        dive.output("thetta")


def test_jitter_is_uniform_and_a_gap_is_not() -> None:
    """Rounded times count as uniform, a missing row does not."""
    rng = np.random.default_rng(0)
    assert record(times=TIMES + rng.uniform(-1e-4, 1e-4, 11)).is_uniform
    assert not record(times=np.where(TIMES > 2.0, TIMES + 0.5, TIMES)).is_uniform


def test_arrays_are_copied_and_locked() -> None:
    """Neither the caller's array nor the record's changes the other."""
    outputs = np.ones((11, 2))
    dive = record(outputs=outputs)
    outputs[0, 0] = 7.0
    assert dive.outputs[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        dive.outputs[0, 0] = 7.0


def test_single_signal_as_a_vector() -> None:
    """One input may come as a vector, and a free decay has none."""
    assert record(inputs=np.sin(TIMES)).inputs.shape == (11, 1)
    free = Record("decay", TIMES, [], np.cos(TIMES), Channels((), (Output("phi", "rad"),)))
    assert free.inputs.shape == (11, 0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": TIMES[:, None]}, r"times of shape \(11, 1\)"),
        ({"times": TIMES[:9]}, "has 9 times but 11 rows of inputs"),
        ({"outputs": np.ones((9, 2))}, r"11 times but 9 rows of outputs \(theta, q\)"),
        ({"outputs": np.ones((2, 11))}, r"Expected time first, \(11, 2\)"),
        ({"times": np.where(TIMES == 2.0, 9.0, TIMES)}, "runs backwards at index 5"),
        ({"times": np.where(TIMES == 2.0, 1.5, TIMES)}, "repeats at index 4"),
        ({"times": np.where(TIMES == 2.0, np.nan, TIMES)}, "not a finite number at index 4"),
        ({"inputs": np.where(TIMES == 2.0, np.nan, 1.0)}, r"'fin' is nan at index 4 \(t = 2 s\)"),
        ({"outputs": np.full((11, 2), np.inf)}, "'theta' is infinite"),
        ({"outputs": np.column_stack([TIMES, TIMES * np.nan])}, r"missing_outputs=\('q',\)"),
        ({"missing_outputs": ("q",)}, "declares 'q' missing, but it has samples"),
        ({"missing_outputs": ("p",)}, "declares 'p' missing, but the outputs are theta, q"),
        (
            {"outputs": np.full((11, 2), np.nan), "missing_outputs": ("theta", "q")},
            "no measured output",
        ),
    ],
)
def test_faults_are_refused(changes: dict[str, object], message: str) -> None:
    """Every fault is refused at construction, in words."""
    with pytest.raises(DataError, match=f"Record 'dive_1'.*{message}"):
        record(**changes)


def test_too_few_samples() -> None:
    """Four samples are not a record."""
    with pytest.raises(DataError, match="4 samples; at least 5"):
        Record("short", TIMES[:4], TIMES[:4], np.ones((4, 2)), CHANNELS)


def test_constant_channels() -> None:
    """Signals that never change are named, missing ones are not."""
    outputs = np.column_stack([np.ones(11), TIMES * np.nan])
    dive = record(inputs=np.zeros(11), outputs=outputs, missing_outputs=("q",))
    assert dive.constant_channels == ("fin", "theta")


def test_window_keeps_times() -> None:
    """A window has the original times, its borders included."""
    part = record().window(1.0, 4.0)
    assert (part.times[0], part.times[-1], part.n_samples) == (1.0, 4.0, 7)
    with pytest.raises(DataError, match="1 samples; at least 5"):
        record().window(1.0, 1.2)


def test_window_without_a_slow_output() -> None:
    """An output that has no sample in a window is noted as missing there."""
    outputs = np.column_stack([TIMES, np.where(TIMES < 1.0, 1.0, np.nan)])
    assert record(outputs=outputs).window(1.0, 4.0).missing_outputs == ("q",)


def test_thin() -> None:
    """Every second sample is kept as it was."""
    thinned = record().thin(2)
    np.testing.assert_array_equal(thinned.times, TIMES[::2])
    np.testing.assert_array_equal(thinned.outputs, record().outputs[::2])
    with pytest.raises(DataError, match="step of 1 or more"):
        record().thin(0)


def test_rename_and_with_outputs() -> None:
    """A changed copy leaves the rest and the original as they were."""
    dive = record()
    other = dive.rename("dive_2").with_outputs(np.zeros((11, 2)))
    assert (other.name, other.output("q")[3], dive.output("q")[3]) == ("dive_2", 0.0, 1.5)
    np.testing.assert_array_equal(other.inputs, dive.inputs)
    with pytest.raises(DataError, match="Expected time first"):
        dive.with_outputs(np.zeros((11, 3)))


def test_outputs_come_back() -> None:
    """Simulated outputs may fill a column that the measurement lacks."""
    outputs = np.column_stack([TIMES, TIMES * np.nan])
    dive = record(outputs=outputs, missing_outputs=("q",))
    assert dive.with_outputs(np.ones((11, 2))).missing_outputs == ()


def test_segments_partition_the_record() -> None:
    """Pieces of about the wanted duration hold every sample exactly once."""
    pieces = record().segments(2.4)
    assert [piece.name for piece in pieces] == ["dive_1_1", "dive_1_2"]
    np.testing.assert_array_equal(np.concatenate([piece.times for piece in pieces]), TIMES)
    assert record().segments(100.0)[0].n_samples == 11
    with pytest.raises(DataError, match="duration above 0"):
        record().segments(0.0)
