"""CSV text: what loggers and spreadsheets write, and where a fault is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from oed_sysid.errors import DataError
from oed_sysid.text.csv_table import Table, read_table, write_table

HEADER = "t [s];theta [rad];z [m]"


def read(tmp_path: Path, *lines: str, encoding: str = "utf-8", end: str = "\n") -> Table:
    """Write lines to a file and read them as a table."""
    path = tmp_path / "dive.csv"
    path.write_bytes(end.join(lines).encode(encoding))
    return read_table(path)


@pytest.mark.parametrize("delimiter", [";", "\t", ","])
def test_delimiters_and_gaps(tmp_path: Path, delimiter: str) -> None:
    """Semicolon, tab and comma delimit; empty cells and nan are gaps."""
    lines = (HEADER, "0;1.5;", "1;;2.5", ";nan;3", "3; ;")
    table = read(tmp_path, *(line.replace(";", delimiter) for line in lines))
    nan = np.nan
    expected = [[0, 1.5, nan], [1, nan, 2.5], [nan, nan, 3], [3, nan, nan]]
    np.testing.assert_array_equal(table.values, expected)
    assert table.headers == ("t [s]", "theta [rad]", "z [m]")


@pytest.mark.parametrize("delimiter", [";", "\t"])
def test_decimal_comma(tmp_path: Path, delimiter: str) -> None:
    """Where the comma does not delimit it is the decimal mark, also among quotes."""
    lines = (HEADER, "0;1,5;2", '1;"-2,5e1";')
    table = read(tmp_path, *(line.replace(";", delimiter) for line in lines))
    np.testing.assert_array_equal(table.values, [[0, 1.5, 2], [1, -25.0, np.nan]])


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-8", "latin-1"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\n\n"])
def test_encodings_and_line_ends(tmp_path: Path, encoding: str, end: str) -> None:
    """Byte order marks, Latin-1 degrees, DOS line ends and blank lines are read."""
    table = read(tmp_path, "t [s],phi [°]", "0,1", "1,2", encoding=encoding, end=end)
    assert table.headers == ("t [s]", "phi [°]")
    np.testing.assert_array_equal(table.values, [[0, 1], [1, 2]])


def test_row_numbers(tmp_path: Path) -> None:
    """Rows are counted as an editor counts them, with comments and blank lines."""
    table = read(tmp_path, "# from the logger", HEADER, "", "0;1;2", "# dropout", "1;1;2")
    np.testing.assert_array_equal(table.row_numbers, [4, 6])


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((HEADER, "0;1;2", "1;x;2"), r"Row 3 of dive.csv, column 'theta \[rad\]': 'x' is not"),
        ((HEADER, "0;1;2", "1;2"), "Row 3 of dive.csv has 2 cells, but the header has 3"),
        ((HEADER, "0;1;2;3"), "Row 2 of dive.csv has 4 cells, but the header has 3"),
        ((HEADER,), "holds no rows of numbers"),
        (("",), "is empty"),
        (("0;1;2", "1;1;2"), "holds numbers, not headers"),
        (("0;0;0", "1;0;0"), "holds numbers, not headers"),
        (("t [s];z [m];z [m]", "0;1;2"), r"two columns 'z \[m\]'"),
        (("t [s];;z [m]", "0;1;2"), "Column 2 of dive.csv has no header"),
    ],
)
def test_faults(tmp_path: Path, lines: tuple[str, ...], message: str) -> None:
    """Each fault of a file is reported with its place."""
    with pytest.raises(DataError, match=message):
        read(tmp_path, *lines)


def test_missing_file(tmp_path: Path) -> None:
    """A path that leads nowhere is reported as such."""
    with pytest.raises(DataError, match="There is no file"):
        read_table(tmp_path / "absent.csv")


def test_written_numbers_read_back_exactly(tmp_path: Path) -> None:
    """Every double survives, and so do gaps and a comma in a header."""
    values = np.random.default_rng(0).normal(size=(50, 3)) * [1e-300, 1.0, 1e300]
    values[4, 1] = np.nan
    write_table(tmp_path / "a.csv", ["a", "b, corrected", "c"], values)
    table = read_table(tmp_path / "a.csv")
    np.testing.assert_array_equal(table.values, values)
    assert table.headers[1] == "b, corrected"
