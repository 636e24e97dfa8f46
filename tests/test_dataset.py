"""Datasets and CSV files: what is read is what was measured, or an error says why."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from oed_sysid.data.dataset import Dataset, Record, read_csv, write_csv
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


def test_empty_cells_are_nan(write: Write) -> None:
    """Empty cells and nan, wherever they are, become samples that were not taken."""
    cells = rows()
    cells[2][3] = ""
    cells[4][4] = " nan "
    cells[3][5] = ""
    cells[5][3:6] = ["", "", ""]
    dive = read_csv(write(cells=cells), CHANNELS)[0]
    assert np.isnan(dive.outputs).sum() == 6
    assert np.isnan(dive.output("theta")[2])
    assert dive.output("theta")[3] == pytest.approx(0.03)


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


def test_row_numbers_count_blank_lines(write: Write) -> None:
    """The row of a message is that of the file, with its blank lines and comments."""
    cells = rows()
    cells[4][0] = "0"
    path = write(cells=cells)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(["# from the logger", lines[0], "", *lines[1:]]))
    with pytest.raises(DataError, match="Row 8 of"):
        read_csv(path, CHANNELS)


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


def test_a_long_file_is_read_whole(tmp_path: Path) -> None:
    """10 000 rows of 14 columns, some cells empty, come back as they were written."""
    n_rows = 10_000
    outputs = tuple(Output(f"y{i}", "m") for i in range(13))
    values = np.random.default_rng(2).normal(size=(n_rows, 13))
    values[::7, 3] = np.nan
    channels = Channels((), outputs)
    path = tmp_path / "long.csv"
    write_csv(Record("long", 0.05 * np.arange(n_rows), [], values, channels), path)
    data = read_csv(path, channels)
    assert data[0].outputs.shape == (n_rows, 13)
    np.testing.assert_allclose(data[0].outputs, values, rtol=1e-11)


def test_dataset_access() -> None:
    """Records are found by name and number, iterated and added."""
    dataset = Dataset((record("a"), record("b"))) + record("c")
    assert dataset.names == ("a", "b", "c")
    assert dataset["b"] is dataset[1]
    assert [r.name for r in dataset] == ["a", "b", "c"]
    assert len(dataset + Dataset((record("d"),))) == 4
    assert dataset.n_samples == 33
    with pytest.raises(DataError, match=r"no record 'd'\. The records are a, b, c"):
        dataset["d"]


def test_split() -> None:
    """A split keeps order, loses nothing and leaves no side empty."""
    dataset = Dataset(tuple(record(name) for name in ("zigzag_1", "zigzag_2", "turn")))
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
