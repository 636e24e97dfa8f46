"""Tables of numbers as text: headers, cells, and where in the file a fault is.

This module knows nothing of channels or units; :mod:`oed_sysid.data.dataset` does.
Reading is quick for good files. Only when the quick path fails is the file read
cell by cell, to name the row and the column.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from oed_sysid.errors import DataError
from oed_sysid.runtime import files
from oed_sysid.text.csv_cells import complaint, number, time_stamp
from oed_sysid.text.csv_text import lines_of, remark_before
from oed_sysid.text.units import dimension, parse_header

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
    stamps : mapping of int to str
        Columns of times of day or ISO times, as seconds since the first row, with
        the text of the first.
    faults : mapping of int to str
        Columns with something that is no number, with the message; NaN throughout.
    """

    path: Path
    headers: tuple[str, ...]
    values: np.ndarray
    row_numbers: np.ndarray
    stamps: Mapping[int, str] = field(default_factory=dict)
    faults: Mapping[int, str] = field(default_factory=dict)


def read_table(path: Path, *, columns_of_text: bool = False) -> Table:
    """Read a file with one header line and numbers below it.

    Comma, semicolon and tab are understood as delimiters, and the decimal comma
    where the delimiter is another. An empty cell or ``nan`` is a missing sample.
    Blank lines and lines that start with ``#`` are skipped, but for headers that stand so above
    the first numbers, as ``numpy.savetxt`` writes them. A column of times of
    day or ISO times becomes seconds since its first row.

    Parameters
    ----------
    path : Path
        The file.
    columns_of_text : bool
        Keep a column with something else than numbers as a fault, for the
        caller to judge whether the column is needed.

    Raises
    ------
    DataError
        If the file is missing, has no rows, or has a cell that is not a number;
        the message names row and column.
    """
    numbered = lines_of(path)
    if numbered and _is_numbers(numbered[0][1]):
        title = remark_before(path, numbered[0][0])
        if title is not None and _is_title(title[1], numbered[0][1]):
            numbered = [title, *numbered]
    if len(numbered) < 2:
        what = "is empty" if not numbered else "holds no rows of numbers"
        raise DataError(
            f"{path.name} {what}. Expected a header line such as 't [s],theta [deg]' and one row "
            "per sample."
        )
    header_line = numbered[0][1]
    delimiter = max(_DELIMITERS, key=header_line.count)
    headers = [cell.strip() for cell in _cells(header_line, delimiter)]
    lines = [line for _, line in numbered[1:]]
    numbers = [number for number, _ in numbered[1:]]
    if len(headers) > 1 and headers[-1] == "" and all(li.endswith(delimiter) for li in lines):
        headers, lines = headers[:-1], [line[: -len(delimiter)] for line in lines]
    _check_layout(path, header_line, delimiter, lines)
    _check_headers(path, headers)
    _check_second_line(path, headers, _cells(lines[0], delimiter))
    values = _quick_values(lines, delimiter, len(headers))
    if values is not None:
        return Table(path, tuple(headers), values, np.array(numbers))
    rows = _rows(path, lines, numbers, delimiter, headers)
    table = Table(
        path, tuple(headers), np.full((len(rows), len(headers)), np.nan), np.array(numbers)
    )
    stamps: dict[int, str] = {}
    faults: dict[int, str] = {}
    for column, header in enumerate(headers):
        cells = [row[column] for row in rows]
        try:
            stamped = _stamps(path, header, cells, numbers)
            if stamped is not None:
                table.values[:, column] = stamped
                stamps[column] = cells[0].strip()
            else:
                table.values[:, column] = _numbers(path, header, cells, numbers, delimiter)
        except DataError as error:
            if not columns_of_text:
                raise
            faults[column] = str(error)
    return Table(path, table.headers, table.values, table.row_numbers, stamps, faults)


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


def _is_numbers(line: str) -> bool:
    """Whether a line holds a number in each cell, whatever the delimiter, and so is no header."""
    cells = re.split(r"[;\t,]", line)
    return all(number(cell, comma=True) is not None for cell in cells)


def _is_title(remark: str, first: str) -> bool:
    """Whether a remark holds one header for each cell of the first row of numbers."""
    delimiter = max(_DELIMITERS, key=remark.count)
    cells = _cells(remark, delimiter)
    return (
        remark.count(delimiter) == first.count(delimiter) > 0
        and all(cell.strip() for cell in cells)
        and any(parse_header(cell)[1] is not None for cell in cells)
    )


def _cells(line: str, delimiter: str) -> list[str]:
    """Cells of one line; quotes protect delimiters."""
    try:
        return next(csv.reader([line], delimiter=delimiter))
    except csv.Error:  # a cell longer than any number
        return line.split(delimiter)


def _check_layout(path: Path, header: str, delimiter: str, lines: list[str]) -> None:
    """Refuse what is laid out in another way than a header and rows with one delimiter."""
    first = lines[0]
    if header.count('"') % 2:
        raise DataError(
            f"A quotation mark in the header of {path.name} is not closed in its line. Write the "
            "header in one line, without line breaks in names."
        )
    units = re.match(r"\s*\[[^\[\]{}\":]{0,20}\]\s*([,;\t]|$)", first)
    opens = ("{", "<") if units else ("{", "[", "<")
    if first.lstrip().startswith(opens) or header.lstrip().startswith(("{", "<")):
        raise DataError(
            f"{path.name} looks like JSON, XML or a web page, not like a table. Export it as CSV."
        )
    n_columns = header.count(delimiter)
    if n_columns and first.count(delimiter) != n_columns:
        others = [one for one in (*_DELIMITERS, "|") if first.count(one) == n_columns]
        if others:
            raise DataError(
                f"The header of {path.name} has {delimiter!r} between cells, but its rows have "
                f"{others[0]!r}. Use the same everywhere."
            )
    if not any(header.count(one) for one in _DELIMITERS):
        wide = max(_DELIMITERS, key=first.count)
        if first.count(wide):
            raise DataError(
                f"The first line of {path.name}, {header.strip()[:40]!r}, is no header of the "
                f"{first.count(wide) + 1} columns below it. Put # before lines that are remarks."
            )
        for other, words in (("|", "bars (|)"), (None, "spaces")):
            if len(first.split(other)) > 1 and len(header.split(other)) > 1:
                raise DataError(
                    f"{path.name} has {words} between its columns. Write commas, semicolons or "
                    "tabs."
                )


def _check_headers(path: Path, headers: list[str]) -> None:
    known: set[str] = set()
    numeric = [header for header in headers if number(header, comma=True) is not None and header]
    if numeric and (len(numeric) == len(headers) or len(numeric) >= max(2, len(headers) - 1)):
        turned = len(numeric) < len(headers)
        raise DataError(
            f"The first line of {path.name} holds numbers, not headers. "
            + (
                "Signals seem to stand in rows: turn the table, one column per signal."
                if turned
                else "Put a line such as 't [s],theta [deg]' above it."
            )
        )
    for index, header in enumerate(headers):
        if len(header) > 200:
            raise DataError(
                f"Header {header[:40]!r}... of {path.name} has {len(header)} characters. Write "
                "name and unit only, as 'psi [deg]'."
            )
        if header.count("[") != header.count("]") or header.count("(") != header.count(")"):
            raise DataError(
                f"Header {header!r:.60} of {path.name} has a bracket that is not closed. Write "
                "units as 'psi [deg]'."
            )
        if not header:
            raise DataError(
                f"Column {index + 1} of {path.name} has no header. Name it, or remove the column."
            )
        if header in known:
            raise DataError(f"{path.name} has two columns {header!r}. Rename one of them.")
        known.add(header)


def _check_second_line(path: Path, headers: list[str], cells: list[str]) -> None:
    """Say it where the units stand in a line of their own."""
    words = [cell.strip().strip("[]()") for cell in cells]
    if len(words) != len(headers) or not all(
        word.strip("-1") == "" or _unit(word) for word in words
    ):
        return
    if sum(_unit(word) for word in words) and not any(parse_header(one)[1] for one in headers):
        shown = ",".join(
            f"{header} [{word or '-'}]" for header, word in zip(headers, words, strict=True)
        )
        raise DataError(
            f"The second line of {path.name} holds units. Put them into the header: '{shown}'."
        )


def _unit(word: str) -> bool:
    if not re.search(r"[^\W\d]|[%°]", word) or word.lower() in ("nan", "na"):
        return False
    try:
        dimension(word)
    except DataError:
        return False
    return True


def _quick_values(lines: list[str], delimiter: str, n_columns: int) -> np.ndarray | None:
    """Parse in one go; return ``None`` if anything at all is unusual."""
    if any(line.count(delimiter) != n_columns - 1 for line in lines):
        return None
    body = delimiter.join(lines)
    if "_" in body or not body.isascii():
        return None
    if delimiter != "," and "," in body:
        if "." in body:
            return None
        body = body.replace(",", ".")
    try:
        values = [float(cell) if cell.strip() else np.nan for cell in body.split(delimiter)]
    except ValueError:
        return None
    return np.array(values).reshape(len(lines), n_columns)


def _rows(
    path: Path, lines: list[str], numbers: list[int], delimiter: str, headers: list[str]
) -> list[list[str]]:
    """Cells of all rows, as many as there are headers in each."""
    rows = []
    for number_, line in zip(numbers, lines, strict=True):
        cells = _cells(line, delimiter)
        if len(cells) != len(headers):
            cause = (
                "A quotation mark is not closed."
                if line.count('"') % 2
                else "It is the last row: the log may have been cut off."
                if number_ == numbers[-1] and len(cells) < len(headers)
                else "Commas seem to be decimal marks: put semicolons between cells."
                if _are_decimal_commas(cells, delimiter, len(headers))
                else "The line above is no header of it. Put # before lines that are remarks."
                if number_ == numbers[0] and all(number(one, comma=True) is None for one in cells)
                else "Leave a cell empty for a missing sample, with its delimiter."
            )
            raise DataError(
                f"Row {number_} of {path.name} has {len(cells)} "
                f"{'cell' if len(cells) == 1 else 'cells'}, but the header has {len(headers)}. "
                f"{cause}"
            )
        if [cell.strip() for cell in cells] == headers:
            raise DataError(
                f"Row {number_} of {path.name} repeats the header: these are two logs. Cut the "
                "file there and read both parts."
            )
        rows.append(cells)
    return rows


def _are_decimal_commas(cells: list[str], delimiter: str, n_columns: int) -> bool:
    """Whether a line has more cells than columns because numbers were cut at their commas."""
    whole = all(re.fullmatch(r"\s*[+-]?\d+\s*", cell) for cell in cells)
    return delimiter == "," and whole and n_columns < len(cells) <= 2 * n_columns


def _numbers(
    path: Path, header: str, cells: list[str], numbers: list[int], delimiter: str
) -> np.ndarray:
    """Numbers of one column; the first cell that is none is named."""
    comma = delimiter != ","
    values = np.full(len(cells), np.nan)
    for index, cell in enumerate(cells):
        value = number(cell, comma=comma)
        if value is None:
            raise DataError(
                f"Row {numbers[index]} of {path.name}, column {header!r}: {complaint(cell)}"
            )
        values[index] = value
    if comma and any("," in cell for cell in cells):
        points = [index for index, cell in enumerate(cells) if "." in cell]
        if points:
            raise DataError(
                f"Column {header!r} of {path.name} has decimal commas, but row "
                f"{numbers[points[0]]} has a point: {cells[points[0]].strip()!r}. Decimal mark or "
                "separator of thousands? Write all numbers in one way."
            )
    return values


def _stamps(path: Path, header: str, cells: list[str], numbers: list[int]) -> np.ndarray | None:
    """Seconds since the first row, if the column holds times of day or ISO times."""
    first = time_stamp(cells[0])
    if first is None:
        return None
    values = np.full(len(cells), np.nan)
    for index, cell in enumerate(cells):
        found = time_stamp(cell)
        if found is None or found[1] != first[1]:
            raise DataError(
                f"Row {numbers[index]} of {path.name}, column {header!r}: {cell.strip()!r:.50} is "
                f"no time in the form of the first, {cells[0].strip()!r}. Write all in one form."
            )
        values[index] = found[0]
    return np.round(values - values[0], 6)
