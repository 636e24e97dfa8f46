"""Records and CSV files: validated, cut, unwrapped, copies recognised, or an error says why."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from altered import part
from marks import slow
from yaw_vehicle import NOISE, yaw_record

from oed_sysid import Model, MultipleShooting, OedSysidError, Parameter, State, load_problem
from oed_sysid.data.dataset import Dataset, Record, check_disjoint, overlap, read_csv, write_csv
from oed_sysid.data.record import clear_wraps, unwrapped
from oed_sysid.errors import DataError
from oed_sysid.physics.channels import Channels, Input, Output

CHANNELS = Channels(
    inputs=(Input("fin", "rad", column="fin_command"), Input("thrust", "N")),
    outputs=(Output("theta", "rad"), Output("z", "m"), Output("q", "rad/s")),
)
HEADER = "t [s],fin_command [deg],thrust [kN],theta [rad],z [m],q [deg/s]"
N_ROWS = 8

Write = Callable[..., Path]


def rows(n_rows: int = N_ROWS) -> list[list[str]]:
    """Cells of a plausible log that fits HEADER."""
    return [
        [f"{0.5 * i:g}", f"{5 * (-1) ** i}", "0.12", f"{0.01 * i:g}", f"{10 + i}", f"{i}"]
        for i in range(n_rows)
    ]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a CSV file from a header and cells."""

    def write_file(
        header: str = HEADER,
        cells: list[list[str]] | None = None,
        name: str = "dive.csv",
        delimiter: str = ",",
    ) -> Path:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        lines = [delimiter.join(row) for row in (rows() if cells is None else cells)]
        path.write_text("\n".join([header.replace(",", delimiter), *lines, ""]), encoding="utf-8")
        return path

    return write_file


def record(name: str = "a", n_samples: int = 11) -> Record:
    """Return a short record with a constant thrust."""
    times = 0.5 * np.arange(n_samples)
    inputs = np.column_stack([np.sin(times), np.full(n_samples, 9.0)])
    outputs = np.column_stack([np.cos(times), times, times**2])
    return Record(name, times, inputs, outputs, CHANNELS)


def test_header_units_are_converted(write: Write) -> None:
    """Degrees and kilonewtons become radians and newtons."""
    dive = read_csv(write(), CHANNELS)["dive"]
    assert dive.input("fin")[0] == pytest.approx(math.radians(5.0), rel=1e-15)
    assert dive.input("thrust")[0] == pytest.approx(120.0)
    assert dive.output("q")[3] == pytest.approx(math.radians(3.0))
    assert dive.output("z")[2] == 12.0
    assert dive.sample_time == 0.5
    assert dive.missing_outputs == ()


def test_suffix_headers_and_milliseconds(write: Write) -> None:
    """Units may stand in suffixes, as real logs have them."""
    cells = [[str(50 * i), "180", str(i)] for i in range(6)]
    channels = Channels((Input("delta", "rad"),), (Output("u", "m/s", column="u_mps_derived"),))
    data = read_csv(write("time_ms,delta_deg,u_mps_derived", cells), channels)[0]
    assert data.sample_time == pytest.approx(0.05)
    assert data.input("delta")[0] == pytest.approx(math.pi)
    assert data.output("u")[5] == 5.0


def test_sign_of_a_channel(write: Write) -> None:
    """A log with the opposite sign convention is turned round while reading."""
    channels = Channels((Input("fin", "rad", column="fin_command", sign=-1.0),), CHANNELS.outputs)
    dive = read_csv(write(), channels)[0]
    assert dive.input("fin")[0] == pytest.approx(-math.radians(5.0))


def test_column_may_name_the_whole_header(write: Write) -> None:
    """Of two columns of one name, ``column`` chooses by the whole header."""
    header = "t_s,x [m],theta_deg,theta_rad"
    cells = [[str(i), "0", "57.3", "0.5"] for i in range(6)]
    path = write(header, cells)
    with pytest.raises(DataError, match="'theta_deg' and 'theta_rad' both look like 'theta'"):
        read_csv(path, Channels((), (Output("theta", "rad"),)))
    chosen = Channels((), (Output("theta", "rad", column="theta_rad"),))
    assert read_csv(path, chosen)[0].output("theta")[0] == 0.5


def test_extra_columns_are_remembered(write: Write) -> None:
    """A column nobody asked for is ignored, whatever its unit, and noted."""
    cells = [[*row, "1", "2"] for row in rows()]
    dive = read_csv(write(HEADER + ",remark (type),altitude", cells), CHANNELS)[0]
    assert dive.ignored_columns == ("remark (type)", "altitude")


def test_missing_output_is_noted(write: Write) -> None:
    """An output without a column is all NaN and named in the record."""
    header = HEADER.replace("q [deg/s]", "roll [deg]")
    dive = read_csv(write(header), CHANNELS)[0]
    assert dive.missing_outputs == ("q",)
    assert np.all(np.isnan(dive.output("q")))


def test_several_files_folder_and_pattern(write: Write, tmp_path: Path) -> None:
    """Lists, folders and patterns give one record per file, named after it."""
    paths = [write(name=name) for name in ("run_2.csv", "run_1.csv")]
    assert read_csv(paths, CHANNELS).names == ("run_2", "run_1")
    assert read_csv(tmp_path, CHANNELS).names == ("run_1", "run_2")
    assert read_csv(str(tmp_path / "run_*.csv"), CHANNELS).names == ("run_1", "run_2")
    assert read_csv(paths[0], CHANNELS, name="dive").names == ("dive",)
    with pytest.raises(DataError, match="given for 2 files"):
        read_csv(paths, CHANNELS, name="dive")


def test_equal_file_names_in_two_folders(write: Write) -> None:
    """Files of the same name are told apart by their folders."""
    paths = [write(name="monday/dive.csv"), write(name="tuesday/dive.csv")]
    assert read_csv(paths, CHANNELS).names == ("monday/dive", "tuesday/dive")


def test_path_that_leads_nowhere(tmp_path: Path) -> None:
    """A wrong path, an empty folder and an empty list are told apart."""
    with pytest.raises(DataError, match="no file, folder or pattern"):
        read_csv(tmp_path / "absent.csv", CHANNELS)
    with pytest.raises(DataError, match=r"holds no \*\.csv"):
        read_csv(tmp_path, CHANNELS)
    with pytest.raises(DataError, match="No files"):
        read_csv([], CHANNELS)


def test_units_argument(write: Write) -> None:
    """Units of headers that cannot be changed are given by name."""
    path = write("t,fin_command,thrust,theta,z,q")
    with pytest.raises(DataError, match=r"Column 't' of dive.csv has no unit.*'t \[s\]'"):
        read_csv(path, CHANNELS)
    units = {"t": "s", "fin": "deg", "thrust": "kN", "theta": "rad", "z": "m"}
    with pytest.raises(DataError, match=r"'q \[rad/s\]'.*units=\{'q': 'rad/s'\}"):
        read_csv(path, CHANNELS, units=units)
    dive = read_csv(path, CHANNELS, units={**units, "q": "deg/s"})[0]
    assert dive.output("q")[3] == pytest.approx(math.radians(3.0))
    with pytest.raises(DataError, match=r"'thetta'.*Did you mean 'theta'"):
        read_csv(path, CHANNELS, units={**units, "q": "deg/s", "thetta": "rad"})


def test_dimensionless_channel_needs_no_unit(write: Write) -> None:
    """A ratio may have no unit, and percent is converted."""
    cells = [[str(i), "50"] for i in range(6)]
    channels = Channels((), (Output("valve", "1"),))
    assert read_csv(write("t_s,valve", cells), channels)[0].outputs[0, 0] == 50.0
    assert read_csv(write("t_s,valve [%]", cells), channels)[0].outputs[0, 0] == 0.5


def test_name_that_ends_like_a_unit(write: Write) -> None:
    """delta_s is the stern plane, not delta in seconds."""
    cells = [[str(i), "5", "0"] for i in range(6)]
    channels = Channels((Input("delta_s", "rad"),), (Output("z", "m"),))
    with pytest.raises(DataError, match=r"has no unit. Write the header as 'delta_s \[rad\]'"):
        read_csv(write("t_s,delta_s,z_m", cells), channels)
    data = read_csv(write("t_s,delta_s [deg],z_m", cells), channels)[0]
    assert data.inputs[0, 0] == pytest.approx(math.radians(5.0))


def test_channel_in_degrees(write: Write) -> None:
    """A channel that is not declared in SI is refused before it does harm."""
    channels = Channels((), (Output("theta", "deg"),))
    with pytest.raises(DataError, match=r"declare it in \[rad\]"):
        read_csv(write(), channels)


def test_time_column(write: Write) -> None:
    """The time column is found by name, or asked for."""
    with pytest.raises(DataError, match="no time column"):
        read_csv(write(HEADER.replace("t [s]", "clock [s]")), CHANNELS)
    path = write(HEADER.replace("t [s]", "clock [s]"))
    assert read_csv(path, CHANNELS, time="clock")[0].n_samples == N_ROWS
    with pytest.raises(DataError, match="more than one time column"):
        read_csv(write(HEADER.replace("z [m]", "time [s]")), CHANNELS)


def test_a_thrust_T_is_no_time(write: Write) -> None:
    """A column T beside the time t is a signal; only names that are equal are ambiguous."""
    path = write(HEADER)
    extra = path.with_name("thrust.csv")
    lines = path.read_text().splitlines()
    extra.write_text("\n".join([lines[0] + ",T [N]", *(line + ",5.0" for line in lines[1:])]))
    assert read_csv(extra, CHANNELS)[0].n_samples == N_ROWS


def test_degrees_declared_as_radians(write: Write) -> None:
    """An angle of many turns in [rad] raises a warning that points to the caller."""
    cells = [[*row[:3], str(i * 10), *row[4:]] for i, row in enumerate(rows())]
    with pytest.warns(UserWarning, match=r"reaches 70 rad.*'theta \[deg\]'") as caught:
        read_csv(write(cells=cells), CHANNELS)
    assert caught[0].filename == __file__


def test_round_trip(tmp_path: Path) -> None:
    """Numbers, gaps, signs and column names survive writing and reading exactly."""
    rng = np.random.default_rng(1)
    channels = Channels(
        (Input("fin", "rad", column="fin_deg", sign=-1.0),),
        (Output("theta", "rad"), Output("z", "m"), Output("ratio", "1"), Output("q", "rad/s")),
    )
    outputs = rng.normal(size=(40, 4)) * [1e-9, 1e9, 1.0, 1.0]
    outputs[3, 0] = np.nan
    outputs[:, 3] = np.nan
    times = 1466704.0 + np.cumsum(rng.uniform(0.1, 0.2, 40))
    before = Record(
        "dive", times, rng.normal(size=(40, 1)), outputs, channels, missing_outputs=("q",)
    )
    write_csv(before, tmp_path / "dive.csv")
    after = read_csv(tmp_path / "dive.csv", channels)["dive"]
    np.testing.assert_array_equal(after.times, before.times)
    np.testing.assert_array_equal(after.inputs, before.inputs)
    np.testing.assert_array_equal(after.outputs, before.outputs)
    assert after.missing_outputs == ("q",)


def test_dataset_access() -> None:
    """Records are found by name and number, iterated and added."""
    dataset = Dataset((record("a"), record("b"))) + record("c")
    assert dataset.names == ("a", "b", "c")
    assert dataset["b"] is dataset[1]
    assert [r.name for r in dataset] == ["a", "b", "c"]
    assert len(dataset + Dataset((record("d"),))) == 4
    assert dataset.n_samples == 33
    with pytest.raises(DataError, match=r"no record 'd'\. It has a, b, c"):
        dataset["d"]


def test_split() -> None:
    """A split keeps order, loses nothing and leaves no side empty."""
    dataset = Dataset(record(name) for name in ("zigzag_1", "zigzag_2", "turn"))
    train, test = dataset.split(test=["zigzag_2"])
    assert (train.names, test.names) == (("zigzag_1", "turn"), ("zigzag_2",))
    assert dataset.split("turn")[1].names == ("turn",)
    with pytest.raises(DataError, match="Did you mean 'zigzag_2'"):
        dataset.split(test=["zigzag2"])
    with pytest.raises(DataError, match="leaves one side empty"):
        dataset.split(test=dataset.names)
    with pytest.raises(DataError, match="leaves one side empty"):
        dataset.split(test=[])


def test_dataset_refuses_mixtures() -> None:
    """Equal names and different channels do not make a dataset."""
    with pytest.raises(DataError, match="Two records are called 'a'"):
        Dataset((record("a"), record("a")))
    other = Record("b", np.arange(6.0), [], np.arange(6.0), Channels((), (Output("phi", "rad"),)))
    with pytest.raises(DataError, match="'b' has other channels than 'a'"):
        Dataset((record("a"), other))
    with pytest.raises(DataError, match="at least one record"):
        Dataset(())


CHANNELS_RECORD = Channels((Input("fin", "rad"),), (Output("theta", "rad"), Output("q", "rad/s")))
TIMES = 0.5 * np.arange(11)


def record_record(**changes: object) -> Record:
    """Return a valid record with some fields changed."""
    fields = {
        "name": "dive_1",
        "times": TIMES,
        "inputs": np.sin(TIMES)[:, None],
        "outputs": np.column_stack([np.cos(TIMES), TIMES]),
        "channels": CHANNELS_RECORD,
    }
    return Record(**(fields | changes))


def test_properties() -> None:
    """Counts, durations and columns are those of the arrays."""
    dive = record_record()
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
    assert record_record(times=TIMES + rng.uniform(-1e-4, 1e-4, 11)).is_uniform
    assert not record_record(times=np.where(TIMES > 2.0, TIMES + 0.5, TIMES)).is_uniform


def test_arrays_are_copied_and_locked() -> None:
    """Neither the caller's array nor the record's changes the other."""
    outputs = np.ones((11, 2))
    dive = record_record(outputs=outputs)
    outputs[0, 0] = 7.0
    assert dive.outputs[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        dive.outputs[0, 0] = 7.0


def test_single_signal_as_a_vector() -> None:
    """One input may come as a vector, and a free decay has none."""
    assert record_record(inputs=np.sin(TIMES)).inputs.shape == (11, 1)
    free = Record("decay", TIMES, [], np.cos(TIMES), Channels((), (Output("phi", "rad"),)))
    assert free.inputs.shape == (11, 0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": TIMES[:, None]}, r"times of shape \(11, 1\)"),
        (
            {"times": TIMES[:4], "inputs": TIMES[:4], "outputs": np.ones((4, 2))},
            "4 samples; at least 5",
        ),
        ({"times": TIMES[:9]}, "has 9 times but 11 rows of inputs"),
        ({"outputs": np.ones((9, 2))}, r"11 times but 9 rows of outputs \(theta, q\)"),
        ({"outputs": np.ones((2, 11))}, r"Expected time first, \(11, 2\)"),
        ({"times": np.where(TIMES == 2.0, 9.0, TIMES)}, "runs backwards at index 5"),
        ({"times": np.where(TIMES == 2.0, 1.5, TIMES)}, "repeats at index 4"),
        ({"times": np.where(TIMES == 2.0, np.nan, TIMES)}, "not a finite number at index 4"),
        (
            {"inputs": np.where(TIMES == 2.0, np.nan, 1.0)},
            r"'fin' is nan at index 4 \(t = 2 s\).*known at every time",
        ),
        (
            {"outputs": np.full((11, 2), np.inf)},
            "'theta' is infinite.*Mark missing samples with NaN",
        ),
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
        record_record(**changes)


def test_constant_channels() -> None:
    """Signals that never change are named, missing ones are not."""
    outputs = np.column_stack([np.ones(11), TIMES * np.nan])
    dive = record_record(inputs=np.zeros(11), outputs=outputs, missing_outputs=("q",))
    assert dive.constant_channels == ("fin", "theta")


def test_window_keeps_times() -> None:
    """A window has the original times, its borders included."""
    part = record_record().window(1.0, 4.0)
    assert (part.times[0], part.times[-1], part.n_samples) == (1.0, 4.0, 7)
    with pytest.raises(DataError, match="1 samples; at least 5"):
        record_record().window(1.0, 1.2)


def test_window_without_a_slow_output() -> None:
    """An output that has no sample in a window is noted as missing there."""
    outputs = np.column_stack([TIMES, np.where(TIMES < 1.0, 1.0, np.nan)])
    assert record_record(outputs=outputs).window(1.0, 4.0).missing_outputs == ("q",)


def test_thin() -> None:
    """Every second sample is kept as it was."""
    thinned = record_record().thin(2)
    np.testing.assert_array_equal(thinned.times, TIMES[::2])
    np.testing.assert_array_equal(thinned.outputs, record_record().outputs[::2])
    with pytest.raises(DataError, match="step of 1 or more"):
        record_record().thin(0)


def test_rename_and_with_outputs() -> None:
    """A changed copy leaves the rest and the original as they were."""
    dive = record_record()
    other = dive.rename("dive_2").with_outputs(np.zeros((11, 2)))
    assert (other.name, other.output("q")[3], dive.output("q")[3]) == ("dive_2", 0.0, 1.5)
    np.testing.assert_array_equal(other.inputs, dive.inputs)
    with pytest.raises(DataError, match="Expected time first"):
        dive.with_outputs(np.zeros((11, 3)))


def test_outputs_come_back() -> None:
    """Simulated outputs may fill a column that the measurement lacks."""
    outputs = np.column_stack([TIMES, TIMES * np.nan])
    dive = record_record(outputs=outputs, missing_outputs=("q",))
    assert dive.with_outputs(np.ones((11, 2))).missing_outputs == ()


def test_segments_partition_the_record() -> None:
    """Pieces of about the wanted duration hold every sample exactly once."""
    pieces = record_record().segments(2.4)
    assert [piece.name for piece in pieces] == ["dive_1_1", "dive_1_2"]
    np.testing.assert_array_equal(np.concatenate([piece.times for piece in pieces]), TIMES)
    assert record_record().segments(100.0)[0].n_samples == 11
    with pytest.raises(DataError, match="duration above 0"):
        record_record().segments(0.0)


T = np.arange(200) * 0.5
TURNING = np.radians(300.0 + 1.5 * T)  # from 300 to 449 degrees: passes north once
WRAPPED = np.mod(TURNING, 2.0 * np.pi)


def channels(*, wrap: bool) -> Channels:
    """A rudder and a heading."""
    return Channels((Input("rudder", "rad"),), (Output("psi", "rad", wrap=wrap),))


def record_angles(psi: np.ndarray, *, wrap: bool) -> Record:
    """A record with a given heading."""
    return Record("run", T, np.zeros(T.size), psi, channels(wrap=wrap))


def test_wrapped_heading_is_made_continuous_and_said() -> None:
    """A declared compass that passes north comes out without the jump, with a note."""
    found = record_angles(WRAPPED, wrap=True)
    assert np.allclose(found.output("psi"), TURNING, atol=1e-12)
    assert "unwrapped: 1 full turn" in found.notes[0]
    assert found.window(10.0, 90.0).notes == found.notes


def test_plus_minus_180_is_unwrapped_with_gaps() -> None:
    """The cut at 180 degrees and missing samples make no difference."""
    psi = np.mod(TURNING - 2.0 + np.pi, 2.0 * np.pi) - np.pi
    psi[::7] = np.nan
    rest = record_angles(psi, wrap=True).output("psi") - (TURNING - 2.0)
    assert np.nanmax(np.abs(rest - np.nanmean(rest))) < 1e-12


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: record_angles(WRAPPED, wrap=False), r'Output\("psi", "rad", wrap=True\)'),
        (lambda: record_angles(np.degrees(WRAPPED), wrap=False), r"psi \[deg\]"),
        (lambda: Output("z", "m", wrap=True), "only an angle"),
    ],
    ids=["undeclared", "degrees as radians", "a length"],
)
def test_what_does_not_wrap_as_declared_is_refused(make: Callable[[], object], words: str) -> None:
    """A jump of a full turn stops with the declaration that helps; a length never wraps."""
    with pytest.raises(OedSysidError, match=words):
        make()


def test_sparse_or_fast_headings_are_left_alone() -> None:
    """Jumps that may be real turns are not called wraps."""
    rng = np.random.default_rng(0)
    assert clear_wraps(np.radians([10.0, 350.0, 20.0, 340.0, 200.0])) is None
    assert clear_wraps(rng.uniform(0.0, 2.0 * np.pi, 50)) is None
    assert clear_wraps(np.cumsum(rng.standard_normal(500)) * 0.1) is None
    step = np.concatenate([np.zeros(50), np.full(50, 3.0)])
    assert clear_wraps(step) is None


def test_thinning_a_continuous_heading_does_not_turn_it_back() -> None:
    """More than half a turn between thinned samples stays what it is."""
    fast = record_angles(np.mod(np.radians(20.0) * np.arange(T.size), 2.0 * np.pi), wrap=True)
    thin = fast.thin(15)
    assert np.allclose(np.diff(thin.output("psi")), np.radians(300.0))


def test_noise_at_north_does_not_add_turns() -> None:
    """A compass that flickers around north is unwrapped to the flicker."""
    rng = np.random.default_rng(1)
    true = 0.01 * rng.standard_normal(300)
    assert np.ptp(unwrapped(np.mod(true, 2.0 * np.pi))) < 0.1


def test_reading_a_wrapped_file_says_so(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A CSV file in degrees is unwrapped in radians, and the user is told."""
    path = tmp_path / "run.csv"
    rows = [f"{t},0,{np.degrees(p)}" for t, p in zip(T, WRAPPED, strict=True)]
    path.write_text("\n".join(["t [s],rudder [deg],psi [deg]", *rows]), encoding="utf-8")
    with pytest.warns(UserWarning, match="unwrapped"):
        data = read_csv(path, channels(wrap=True))
    assert np.ptp(data[0].output("psi")) == pytest.approx(np.ptp(TURNING))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert data[0].thin(2).n_samples == 100


def test_turns_within_a_gap_are_counted_by_the_rates_beside_it() -> None:
    """A ship that turns on while its compass is silent for 80 s comes out where it is."""
    t = np.arange(0.0, 200.0, 0.5)
    rng = np.random.default_rng(0)
    true = np.radians(6.0) * t
    logged = np.mod(true + 0.005 * rng.standard_normal(t.size), 2.0 * np.pi)
    logged[(t > 60.0) & (t < 140.0)] = np.nan
    whole = unwrapped(logged, times=t)
    assert np.nanmax(np.abs(whole - true)) < 0.03
    assert np.nanmax(np.abs(unwrapped(logged) - true)) > 6.0


def test_gap_between_unlike_rates_adds_no_turn() -> None:
    """Where the rates beside a gap disagree, or nothing turns, no turn is invented."""
    t = np.arange(0.0, 200.0, 0.5)
    slow = 0.5 * np.sin(0.05 * t)
    slow[(t > 60.0) & (t < 110.0)] = np.nan
    np.testing.assert_array_equal(unwrapped(slow, times=t), slow)
    turning = np.where(t < 60.0, 0.2 * t, 12.0)
    turning[(t > 58.0) & (t < 140.0)] = np.nan
    found = unwrapped(np.mod(turning, 2.0 * np.pi), times=t)
    assert abs(found[-1] - found[110]) < np.pi


def test_residuals_of_a_heading_are_on_the_circle_and_others_are_not() -> None:
    """A prediction one turn away is right for a compass, and wrong for what does not wrap."""
    signals = Channels(
        (Input("rudder", "rad"),), (Output("psi", "rad", wrap=True), Output("phi", "rad"))
    )
    run = Record("run", T, np.zeros(T.size), np.column_stack([WRAPPED, TURNING]), signals)
    whole = run.outputs + 2.0 * np.pi + 0.01
    errors = run.residuals(whole)
    assert errors[:, 0] == pytest.approx(-0.01, abs=1e-9)
    assert errors[:, 1] == pytest.approx(-0.01 - 2.0 * np.pi)


@pytest.mark.parametrize("start", [300.0, -60.0, 660.0])
def test_a_start_heading_is_moved_to_the_turn_of_the_record(start: float) -> None:
    """The same compass course on any turn begins the same trajectory, with errors of noise size."""
    model = Model(
        "heading",
        states=(State("psi", "rad", "heading"),),
        inputs=(Input("rudder", "rad"),),
        outputs=(Output("psi", "rad", noise_std=0.01, wrap=True),),
        kinematics={"psi": "rate + rudder"},
        parameters=(Parameter("rate", 0.02, "rad/s"),),
    )
    noise = 0.01 * np.random.default_rng(2).standard_normal(T.size)
    log = Record("run", T, np.zeros(T.size), np.mod(TURNING + noise, 2 * np.pi), model.channels)
    fit = MultipleShooting(disturbances="none").fit(
        model, Dataset((log,)), start_states={"psi": np.radians(start)}
    )
    assert fit.rms["psi"] == pytest.approx(0.01, rel=0.2)
    assert fit.values["rate"] == pytest.approx(np.radians(1.5), rel=0.01)
    errors = fit.predict(Dataset((log,)), initial={"psi": np.radians(start)}).residuals[0]
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.01, rel=0.2)


STEP, SAMPLES = 0.5, 200


def run(seed: int, **options: object) -> Record:
    """A zigzag-like run with its own noise."""
    return yaw_record(f"run_{seed}", np.random.default_rng(seed), **options)


def later(record: Record, seconds: float) -> Record:
    """The same record with another clock."""
    return replace(record, times=record.times + seconds)


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
    "thinned and clock set": lambda record: later(part(record, slice(1, None, 2)), 12.5),
    "middle part": lambda record: part(record, slice(60, 120)),
    "short part": lambda record: part(record, slice(60, 75)),
    "first row dropped": lambda record: part(record, slice(1, None)),
    "last row dropped": lambda record: part(record, slice(None, -1)),
    "ends dropped, clock at zero": lambda record: later(part(record, slice(7, -9)), -3.5),
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
    first, second = part(log, slice(0, 200)), later(part(log, slice(160, 360)), -80.0)
    found = overlap(first, second.rename("second"))
    assert found.shift == pytest.approx(80.0)
    assert found.n_equal == found.n_rows == 39


@pytest.mark.parametrize("seed", [*range(5), *slow(*range(5, 20))])
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
