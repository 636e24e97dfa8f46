"""Tables of numbers as text: headers, cells, and where in the file a fault is.

This module knows nothing of channels or units; :mod:`oed_sysid.data.dataset` does.
Reading is quick for good files. Only when the quick path fails is the file read
cell by cell, to name the row and the column.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oed_sysid import files
from oed_sysid.errors import DataError

_DELIMITERS = (";", "\t", ",")


@dataclass(frozen=True, eq=False)
class Table:
    """A table of numbers read from a file.

    Parameters
    ----------
    path : Path
        The file.
    headers : tuple of str
        One text per column.
    values : numpy.ndarray
        Shape ``(n_rows, n_columns)``; NaN where a cell is empty.
    row_numbers : numpy.ndarray
        Shape ``(n_rows,)``; line in the file, the first line being 1.
    """

    path: Path
    headers: tuple[str, ...]
    values: np.ndarray
    row_numbers: np.ndarray


def read_table(path: Path) -> Table:
    """Read a file with one header line and numbers below it.

    Comma, semicolon and tab are understood as delimiters, and the decimal comma
    where the delimiter is another. An empty cell or ``nan`` is a missing sample.
    Blank lines and lines that start with ``#`` are skipped.

    Raises
    ------
    DataError
        If the file is missing, has no rows, or has a cell that is not a number;
        the message names row and column.
    """
    if not path.is_file():
        raise DataError(f"There is no file {str(path)!r}. Check the path.")
    numbered = [
        (number, line)
        for number, line in enumerate(_text(path).splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(numbered) < 2:
        raise DataError(
            f"{path.name} holds no rows of numbers. Expected a header line such as "
            "'t [s],theta [deg]' and one row per sample."
        )
    header_line = numbered[0][1]
    delimiter = next((d for d in _DELIMITERS if d in header_line), ",")
    headers = [cell.strip() for cell in next(csv.reader([header_line], delimiter=delimiter))]
    lines = [line for _, line in numbered[1:]]
    if len(headers) > 1 and headers[-1] == "" and all(li.endswith(delimiter) for li in lines):
        headers, lines = headers[:-1], [line[: -len(delimiter)] for line in lines]
    _check_headers(path, headers)
    values = _quick_values(lines, delimiter, len(headers))
    numbers = [number for number, _ in numbered[1:]]
    if values is None:
        values = _careful_values(path, lines, numbers, delimiter, headers)
    return Table(path, tuple(headers), values, np.array(numbers))


def write_table(path: Path, headers: list[str], values: np.ndarray) -> None:
    """Write a table; every number reads back exactly, NaN becomes an empty cell.

    Parameters
    ----------
    path : Path
        The file, overwritten if it exists.
    headers : list of str
        One text per column.
    values : numpy.ndarray
        Shape ``(n_rows, n_columns)``.
    """
    rows = [
        ",".join("" if value != value else repr(value) for value in row) for row in values.tolist()
    ]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(headers)
    files.write_text(path, text.getvalue() + "\n".join([*rows, ""]))


def _text(path: Path) -> str:
    """Text of a file; loggers still write Latin-1, mostly for the degree sign."""
    content = path.read_bytes()
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _check_headers(path: Path, headers: list[str]) -> None:
    try:
        [float(header) for header in headers]
    except ValueError:
        pass
    else:
        raise DataError(
            f"The first line of {path.name} holds numbers, not headers. "
            "Put a line such as 't [s],theta [deg]' above it."
        )
    for index, header in enumerate(headers):
        if not header:
            raise DataError(
                f"Column {index + 1} of {path.name} has no header. Name it, or remove the column."
            )
        if header in headers[:index]:
            raise DataError(f"{path.name} has two columns {header!r}. Rename one of them.")


def _quick_values(lines: list[str], delimiter: str, n_columns: int) -> np.ndarray | None:
    """Parse in one go; return ``None`` if anything at all is unusual."""
    if any(line.count(delimiter) != n_columns - 1 for line in lines):
        return None
    body = delimiter.join(lines)
    if delimiter != ",":
        body = body.replace(",", ".")
    try:
        values = [float(cell) if cell.strip() else np.nan for cell in body.split(delimiter)]
    except ValueError:
        return None
    return np.array(values).reshape(len(lines), n_columns)


def _careful_values(
    path: Path, lines: list[str], numbers: list[int], delimiter: str, headers: list[str]
) -> np.ndarray:
    """Parse cell by cell and say where the first fault is."""
    values = np.full((len(lines), len(headers)), np.nan)
    for index, (number, line) in enumerate(zip(numbers, lines, strict=True)):
        cells = next(csv.reader([line], delimiter=delimiter))
        if len(cells) != len(headers):
            raise DataError(
                f"Row {number} of {path.name} has {len(cells)} cells, but the header has "
                f"{len(headers)}. Leave a cell empty for a missing sample, with its delimiter."
            )
        for column, cell in enumerate(cells):
            text = cell.strip() if delimiter == "," else cell.strip().replace(",", ".")
            try:
                values[index, column] = float(text) if text else np.nan
            except ValueError:
                raise DataError(
                    f"Row {number} of {path.name}, column {headers[column]!r}: {cell!r} is not "
                    "a number. Leave the cell empty, or write nan, for a missing sample."
                ) from None
    return values
