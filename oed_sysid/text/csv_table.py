"""Tables of numbers as text: headers, cells, and where in the file a fault is.

This module knows nothing of channels or units; :mod:`oed_sysid.data.dataset` does.
Reading is quick for good files. Only when the quick path fails is the file read
cell by cell, to name the row and the column.

A cell is the number or the time that it holds, or what is wrong with it. The text of a file is
its encoding, its lines, and what it is if it is no text. Loggers and spreadsheets write UTF-8,
UTF-16 with a mark, and Latin-1 (for the degree sign); those are read. Everything else is said by
its name.
"""

from __future__ import annotations

import codecs
import csv
import io
import os
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np

from oed_sysid.errors import DataError
from oed_sysid.runtime import files
from oed_sysid.runtime.constants import LONGEST_LINE, TABLE_BYTES
from oed_sysid.runtime.tables import tables
from oed_sysid.text import SAYS
from oed_sysid.text.units import is_unit, parse_header

# -- one cell of a table ---------------------------------------------------------------


# A sample that was not taken, in the words of loggers, spreadsheets and programs.
MISSING = frozenset(
    {"", "nan", "na", "n/a", "#n/a", "null", "none", "nat", "<na>", "-nan", "nan(ind)", "-nan(ind)"}
    | {"1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "nan(snan)", "missing"}
)
_CLOCK = re.compile(r"(\d{1,3}):(\d{2}):(\d{2}(?:[.,]\d+)?)")
# Day, month and year with points between them, in one order wherever they are written so.
_POINTS = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})[T ]+(\d{1,2}:.+)")
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}")
_KNOWN = tables(__file__, "file_kinds")
# Patterns of cells that are no number, and what to do about them.
_COMPLAINTS = tuple((re.compile(one, re.IGNORECASE), words) for one, words in _KNOWN["complaints"])


def number(cell: str, *, comma: bool) -> float | None:
    """Number in a cell, NaN for a missing sample, None if it is something else.

    Parameters
    ----------
    cell : str
        The text.
    comma : bool
        Whether a comma may be the decimal mark.

    Examples
    --------
    >>> number("1,5", comma=True), number("1,5", comma=False), number(" n/a", comma=False)
    (1.5, None, nan)
    """
    text = cell.strip()
    if text.lower() in MISSING:
        return float("nan")
    if comma:
        if "," in text and "." in text:
            return None
        text = text.replace(",", ".", 1)
    if "_" in text or not text.isascii():
        return None
    try:
        return float(text)
    except ValueError:
        return None


def time_stamp(cell: str) -> tuple[float, str] | None:
    """Seconds of a time of day or of an ISO time, and which of the two; None for others.

    Seconds of an ISO time count from 1970, in UTC if it states a zone.

    Examples
    --------
    >>> time_stamp("00:01:02.5"), time_stamp("1970-01-01T00:00:01Z"), time_stamp("5.0")
    ((62.5, 'clock'), (1.0, 'zoned'), None)
    """
    text = cell.strip()
    match = _CLOCK.fullmatch(text)
    if match:
        hours, minutes, seconds = match.groups()
        parts = int(minutes), float(seconds.replace(",", "."))
        if parts[0] > 59 or parts[1] >= 60.0:
            return None
        return 3600.0 * int(hours) + 60.0 * parts[0] + parts[1], "clock"
    if (pointed := _POINTS.fullmatch(text)) is not None:
        day, month, year, clock = pointed.groups()
        text = f"{year}-{month:0>2}-{day:0>2}T{clock.replace(',', '.'):0>8}"
    if not _DATE.match(text):
        return None
    try:
        moment = datetime.fromisoformat(text.replace(" UTC", "Z"))
    except ValueError:
        return None
    past = moment - datetime(1970, 1, 1, tzinfo=None if moment.tzinfo is None else UTC)
    # Whole seconds and the rest apart: microseconds survive.
    seconds_since = past.days * 86400 + past.seconds + past.microseconds * 1e-6
    return seconds_since, "zoned" if moment.tzinfo is not None else "date"


def complaint(cell: str) -> str:
    """Say what a cell holds instead of a number, and what to do.

    Examples
    --------
    >>> complaint("0x1F")
    "'0x1F' is hexadecimal. Write decimal numbers."
    """
    text = cell.strip()
    shown = repr(text if len(text) <= 40 else text[:37] + "...")
    for pattern, words in _COMPLAINTS:
        if pattern.fullmatch(text):
            return f"{shown} {words}."
    return f"{shown} is not a number. Leave the cell empty, or write nan, for a missing sample."


# -- the text of a file ----------------------------------------------------------------


# What lines of other texts look like, how many of them tell, what they are, and what to do.
_LINES = tuple((re.compile(one).fullmatch, *others) for one, *others in _KNOWN["lines"])
# How files that are often taken for tables begin, what they are, and what to do.
_KINDS = tuple((start.encode("latin-1"), what, advice) for start, what, advice in _KNOWN["kinds"])
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_CONTROL = dict.fromkeys((*range(9), *range(14, 32), 127))


def text_lines(path: Path) -> list[tuple[int, str]]:
    """Return the lines of any text file with their numbers, the first being 1.

    Blank lines and lines that start with ``#`` are left out. Line ends of any
    system are understood, also mixed.

    Raises
    ------
    DataError
        If the file is missing, cannot be read, or is no text.
    """
    return _numbered(_text(path))


def _numbered(text: str) -> list[tuple[int, str]]:
    return [
        (number, line)
        for number, line in enumerate(_split(text), start=1)
        # A row of delimiters alone holds nothing: spreadsheets append some.
        if line.strip(' \t,;\f\v"') and not line.lstrip().startswith("#")
    ]


def _remark_before(text: str, row: int) -> tuple[int, str] | None:
    """Number and text of the remark (``#``) right above a row; None if there is none."""
    for number, line in reversed(list(enumerate(_split(text)[: row - 1], start=1))):
        if line.strip():
            stripped = line.lstrip()
            return (number, stripped.lstrip("#").strip()) if stripped.startswith("#") else None
    return None


def _check_kind(path: Path, lines: list[tuple[int, str]]) -> None:
    """Refuse text that is no table, in words of what it is."""
    first = [line for _, line in lines[:2]]
    for is_one, n_lines, what, advice in _LINES:
        if first and all(map(is_one, first[:n_lines])):
            raise DataError(f"{path.name} holds {what}, not a table. {advice}.")
    for number, line in lines:
        if line.startswith(("<<<<<<< ", ">>>>>>> ")) or line.rstrip() == "=======":
            raise DataError(SAYS["merge_mark"].format(number=number, path=path))


def _split(text: str) -> list[str]:
    """Lines, whatever system they end on."""
    return re.split(r"\r\n|\n|\r", text) if "\r" in text else text.split("\n")


def _check_file(path: Path) -> None:
    """Refuse what is no file that can be read."""
    files.check_file(path)
    if path.stat().st_size > TABLE_BYTES:
        raise DataError(f"{path.name} has more than {TABLE_BYTES >> 30} GB. Cut it into parts.")


def _text(path: Path) -> str:
    """Text of a file, all of it."""
    _check_file(path)
    return _decoded(path, files.read_bytes(path))


def kind_of(content: bytes) -> tuple[str, str] | None:
    """What a file that is no text begins like, and what to do with it for a table."""
    return next(((what, do) for start, what, do in _KINDS if content.startswith(start)), None)


def _decoded(path: Path, content: bytes) -> str:
    """Text of the bytes of a file, in the encoding that they are in."""
    if kind := kind_of(content):
        raise DataError(f"{path.name} is {kind[0]}, not a table. {kind[1]}.")
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            try:
                return _checked(path, content.decode(encoding))
            except UnicodeDecodeError as error:
                raise DataError(
                    f"{path.name} is marked as {encoding.upper()} but breaks off or is damaged at "
                    f"byte {error.start}. Write it again, as UTF-8."
                ) from None
    if content.count(0) > len(content) // 5:
        raise DataError(_wide(path, content))
    try:
        return _checked(path, content.decode("utf-8"))
    except UnicodeDecodeError:
        return _checked(path, content.decode("latin-1"))


def _wide(path: Path, content: bytes) -> str:
    """Say what a file full of zero bytes is."""
    even, odd = content[::2].count(0), content[1::2].count(0)
    if max(even, odd) > 0.4 * len(content) / 2 and min(even, odd) < 0.1 * len(content) / 2:
        return SAYS["wide_letters"].format(path=path)
    return SAYS["zero_bytes"].format(path=path)


def _checked(path: Path, text: str) -> str:
    """Refuse bytes that no text has."""
    if len(text.translate(_CONTROL)) == len(text):
        return text
    at = next(index for index, letter in enumerate(text) if ord(letter) in _CONTROL)
    row = len(_split(text[:at]))
    byte = ord(text[at])
    what = "a zero byte" if byte == 0 else f"the control character {byte:#04x}"
    raise DataError(SAYS["control_character"].format(row=row, path=path, what=what))


# -- tables of numbers as text ---------------------------------------------------------


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
    stamps: dict[int, str] = field(default_factory=dict)
    faults: dict[int, str] = field(default_factory=dict)


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
    _check_file(path)
    quick = _quick(path, columns_of_text)
    return _cell_by_cell(path, columns_of_text) if quick is None else quick


def _cell_by_cell(path: Path, columns_of_text: bool) -> Table:
    """Read the table so that whatever is wrong is named with its row and column."""
    headers, delimiter, closed, rows_of_text = _layout(path, _text(path))
    lines = [line[: -len(delimiter)] if closed else line for _, line in rows_of_text]
    numbers = [number for number, _ in rows_of_text]
    rows = _rows(path, lines, numbers, delimiter, headers)
    table = Table(
        path, tuple(headers), np.full((len(rows), len(headers)), np.nan), np.array(numbers)
    )
    for index, cells in enumerate(zip(*rows, strict=True)):
        column = _Column(headers[index], cells[0], delimiter != ",")
        try:
            table.values[:, index] = _values(path, column, cells, numbers)
            if column.form:
                table.stamps[index] = column.first.strip()
        except DataError as error:
            if not columns_of_text:
                raise
            table.faults[index] = str(error)
    return table


def _layout(path: Path, text: str) -> tuple[list[str], str, bool, list[tuple[int, str]]]:
    """Headers, delimiter, whether rows end on one too, and the rows with their line numbers."""
    numbered = _titled(path, text)
    header_line, rows = numbered[0][1], numbered[1:]
    delimiter = max(_DELIMITERS, key=header_line.count)
    headers = [cell.strip() for cell in _cells(header_line, delimiter)]
    closed = len(headers) > 1 and not headers[-1] and all(li.endswith(delimiter) for _, li in rows)
    headers = headers[:-1] if closed else headers
    first = rows[0][1][: -len(delimiter)] if closed else rows[0][1]
    _check_layout(path, header_line, delimiter, first)
    _check_headers(path, headers)
    _check_second_line(path, headers, _cells(first, delimiter), delimiter)
    return headers, delimiter, closed, rows


def _titled(path: Path, text: str) -> list[tuple[int, str]]:
    """Lines with their numbers, a header first, be it a remark, and rows below it."""
    numbered = _numbered(text)
    if numbered and re.fullmatch(r"\"?sep=.\"?", numbered[0][1].strip(), re.IGNORECASE):
        del numbered[0]  # a spreadsheet's own word for its delimiter
    _check_kind(path, numbered)
    if numbered and _is_numbers(numbered[0][1]):
        title = _remark_before(text, numbered[0][0])
        if title is not None and _is_title(title[1], numbered[0][1]):
            numbered = [title, *numbered]
    if len(numbered) < 2:
        what = "is empty" if not numbered else "holds no rows of numbers"
        raise DataError(SAYS["no_rows"].format(path=path, what=what))
    return numbered


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


def _check_layout(path: Path, header: str, delimiter: str, first: str) -> None:
    """Refuse what is laid out in another way than a header and rows with one delimiter."""
    if header.count('"') % 2:
        raise DataError(SAYS["open_quotation"].format(path=path))
    units = re.match(r"\s*\[[^\[\]{}\":]{0,20}\]\s*([,;\t]|$)", first)
    opens = ("{", "<") if units else ("{", "[", "<")
    if first.lstrip().startswith(opens) or header.lstrip().startswith(("{", "<")):
        raise DataError(
            f"{path.name} looks like JSON, XML or a web page, not like a table. Export it as CSV."
        )
    _check_delimiter(path, header, delimiter, first)


def _check_delimiter(path: Path, header: str, delimiter: str, first: str) -> None:
    """Refuse other marks between the cells of the header, or of the rows, than those read."""
    if n_columns := header.count(delimiter):
        others = [one for one in (*_DELIMITERS, "|") if first.count(one) == n_columns]
        if others and delimiter not in others:
            raise DataError(
                f"The header of {path.name} has {delimiter!r} between cells, but its rows have "
                f"{others[0]!r}. Use the same everywhere."
            )
        return
    wide = max(_DELIMITERS, key=first.count)
    if first.count(wide):
        raise DataError(
            f"The first line of {path.name}, {header.strip()[:40]!r}, is no header of the "
            f"{first.count(wide) + 1} columns below it. Put # before lines that are remarks."
        )
    for other, words in (("|", "bars (|)"), (None, "spaces")):
        if len(first.split(other)) > 1 and len(header.split(other)) > 1:
            raise DataError(
                f"{path.name} has {words} between its columns. Write commas, semicolons or tabs."
            )


def _check_headers(path: Path, headers: list[str]) -> None:
    _check_no_numbers(path, headers)
    for index, header in enumerate(headers):
        if len(header) > 200:
            raise DataError(
                f"Header {header[:40]!r}... of {path.name} has {len(header)} characters. Write "
                "name and unit only, as 'psi [deg]'."
            )
        if header.count("[") != header.count("]") or header.count("(") != header.count(")"):
            raise DataError(SAYS["open_bracket"].format(header=header, path=path))
        if not header:
            raise DataError(
                f"Column {index + 1} of {path.name} has no header. Name it, or remove the column."
            )
        if header in headers[:index]:
            raise DataError(f"{path.name} has two columns {header!r}. Rename one of them.")


def _check_no_numbers(path: Path, headers: list[str]) -> None:
    """Refuse a first line of numbers, where the header should be."""
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


def _check_second_line(path: Path, headers: list[str], cells: list[str], delimiter: str) -> None:
    """Say it where the units stand in a line of their own."""
    words = [cell.strip().strip("[]()") for cell in cells]
    units = sum(map(_unit, words))
    plain = sum(word.strip("-1") == "" for word in words)
    stated = any(parse_header(header)[1] for header in headers)
    if units and units + plain == len(words) == len(headers) and not stated:
        pairs = zip(headers, words, strict=True)
        shown = delimiter.join(f"{one} [{word}]" if word else one for one, word in pairs)
        raise DataError(
            f"The second line of {path.name} holds units. Put them into the header: '{shown}'."
        )


def _unit(word: str) -> bool:
    if not re.search(r"[^\W\d]|[%°]", word) or word.lower() in ("nan", "na"):
        return False
    return is_unit(word)


def _rows(
    path: Path, lines: list[str], numbers: list[int], delimiter: str, headers: list[str]
) -> list[list[str]]:
    """Cells of all rows, as many as there are headers in each."""
    rows = []
    for number_, line in zip(numbers, lines, strict=True):
        cells = _cells(line, delimiter)
        if len(cells) != len(headers):
            fewer = number_ == numbers[-1] and len(cells) < len(headers)
            title = number_ == numbers[0] and all(number(c, comma=True) is None for c in cells)
            causes = (
                (line.count('"') % 2, "A quotation mark is not closed."),
                (fewer, "It is the last row: the log may have been cut off."),
                (_are_decimal_commas(cells, delimiter, len(headers)),
                 "Commas seem to be decimal marks: put semicolons between cells."),
                (title, "The line above is no header of it. Put # before lines that are remarks."),
                (True, "Leave a cell empty for a missing sample, with its delimiter."),
            )  # fmt: skip
            advice = next(words for holds, words in causes if holds)
            raise DataError(
                f"Row {number_} of {path.name} has {len(cells)} cell{'s' * (len(cells) != 1)}, but "
                f"the header has {len(headers)}. {advice}"
            )
        if [cell.strip() for cell in cells] == headers:
            raise DataError(SAYS["header_again"].format(row=number_, path=path))
        rows.append(cells)
    return rows


def _are_decimal_commas(cells: list[str], delimiter: str, n_columns: int) -> bool:
    """Whether a line has more cells than columns because numbers were cut at their commas."""
    whole = all(re.fullmatch(r"\s*[+-]?\d+\s*", cell) for cell in cells)
    return delimiter == "," and whole and n_columns < len(cells) <= 2 * n_columns


@dataclass(frozen=True)
class _Column:
    """What a column holds, told by its first cell: times in one form, or numbers."""

    header: str
    first: str
    comma: bool  # whether it may be the decimal mark

    @cached_property
    def form(self) -> str:
        """Form of its times; empty where it holds none."""
        stamp = time_stamp(self.first)
        return "" if stamp is None else stamp[1]

    @property
    def kind(self) -> str:
        """``n`` for numbers or nothing, ``s`` for times, ``t`` for a text."""
        return "s" if self.form else "t" if self.value(self.first) is None else "n"

    def value(self, cell: str) -> float | None:
        """Number or seconds in a cell; None of what is neither, or a time in another form."""
        if not self.form:
            return number(cell, comma=self.comma)
        found = time_stamp(cell)
        return found[0] if found is not None and found[1] == self.form else None

    def seconds(self, block: bytes, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Times of the cells of a block, each from its first byte to its last."""
        cells = zip(first.tolist(), last.tolist(), strict=True)
        found = [self.value(block[a:b].decode()) for a, b in cells]
        if None in found:
            raise ValueError
        return np.array(found, dtype=float)

    def fault(self, path: Path, row: int, cell: str) -> str:
        """Say where a cell without a value stands, and what is wrong with it."""
        words = (
            f"{cell.strip()!r:.50} is no time in the form of the first, {self.first.strip()!r}. "
            "Write all in one form."
            if self.form
            else complaint(cell)
        )
        return f"Row {row} of {path.name}, column {self.header!r}: {words}"


def _values(path: Path, column: _Column, cells: Sequence[str], rows: list[int]) -> np.ndarray:
    """Numbers of one column, or seconds since its first row; the first wrong cell is named."""
    found = [column.value(cell) for cell in cells]
    if None in found:
        wrong = found.index(None)
        raise DataError(column.fault(path, rows[wrong], cells[wrong]))
    values = np.array(found, dtype=float)
    if column.form:
        return np.round(values - values[0], 6)
    if column.comma and any("," in cell for cell in cells):
        points = [index for index, cell in enumerate(cells) if "." in cell]
        if points:
            raise DataError(
                f"Column {column.header!r} of {path.name} has decimal commas, but row "
                f"{rows[points[0]]} has a point: {cells[points[0]].strip()!r}. Decimal mark or "
                "separator of thousands? Write all numbers in one way."
            )
    return values


# -- good files, in blocks ---------------------------------------------------------------


# Bytes that are parsed at once; to read fewer takes no longer than to load a faster reader.
_BLOCK = 1 << 22
_BLANK = re.compile(rb"(?<![^,])[ \t\v\f]+(?![^,])")
_WORDS = re.compile(
    rb"(?i)(?<![^,])[ \t]*(?:%s)[ \t]*(?![^,])"
    % b"|".join(re.escape(word).encode() for word in sorted(MISSING - {""}))
)


def _quick(path: Path, columns_of_text: bool) -> Table | None:
    """Read a table by NumPy's parser, block after block; None where anything is unusual.

    Nearly all files consist of lines with equal numbers of cells, each a number or nothing.
    Columns that begin with a time or a text are cut out of the bytes before.
    """
    try:
        with path.open("rb") as stream:
            lines, row, start = _first_row(path, stream)
            if "t" in lines.kinds and not columns_of_text:
                return None
            parts = [lines.parsed(block) for block in _blocks(stream, start)]
    except (DataError, OSError, ValueError, DeprecationWarning):
        return None
    return lines.table(path, row, parts)


def _first_row(path: Path, stream: BinaryIO) -> tuple[_Lines, int, int]:
    """How the rows of a file are laid out, the number of the first, and where it begins, bytes."""
    head = stream.read(LONGEST_LINE)
    head = head[: head.rfind(b"\n") + 1]
    if b"\r" in head.replace(b"\r\n", b""):
        raise ValueError
    headers, delimiter, closed, rows = _layout(path, _decoded(path, head))
    row, cells = rows[0][0], _cells(rows[0][1], delimiter)
    if len(cells) != len(headers) + closed:
        raise ValueError
    pairs = zip(headers, cells, strict=False)
    columns = tuple(_Column(header, cell, delimiter != ",") for header, cell in pairs)
    start = sum(len(line) + 1 for line in head.split(b"\n")[: row - 1])
    return _Lines(delimiter.encode(), columns, closed), row, start


def _blocks(stream: BinaryIO, start: int) -> Iterator[bytes]:
    """Whole lines, some megabytes of them at a time, without the line end of the last."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(size - LONGEST_LINE, start))
    left = size - start - len(tail := stream.read()) + len(tail.rstrip(b"\r\n"))
    stream.seek(start)
    rest = b""
    while left > 0 and (more := stream.read(min(_BLOCK, left))):
        left -= len(more)
        block = rest + more
        cut = block.rfind(b"\n") if left else len(block)
        if cut >= 0:
            yield block[:cut]
        rest = block[cut + 1 :]


@dataclass(frozen=True)
class _Lines:
    """How the lines of a good file are laid out: delimiter, and what each column holds."""

    delimiter: bytes
    columns: tuple[_Column, ...]
    closed: bool  # with a delimiter behind the last cell

    @cached_property
    def kinds(self) -> list[str]:
        """Kind of each column."""
        return [column.kind for column in self.columns]

    def table(
        self, path: Path, row: int, parts: list[tuple[np.ndarray, dict[int, np.ndarray]]]
    ) -> Table:
        """Put parsed blocks together; ``row`` is the number of their first line."""
        n_rows = sum(len(numbers) for numbers, _ in parts)
        # Every column in one piece of memory, as they are read one by one.
        values = np.empty((len(self.kinds), n_rows)).T
        numeric = np.flatnonzero(np.array(self.kinds) == "n")
        where = slice(None) if len(numeric) == len(self.kinds) else numeric
        end = 0
        for numbers, _ in parts:
            begin, end = end, end + len(numbers)
            values[begin:end, where] = numbers
        headers = tuple(column.header for column in self.columns)
        table = Table(path, headers, values, np.arange(row, row + n_rows))
        for index, (kind, column) in enumerate(zip(self.kinds, self.columns, strict=True)):
            if kind == "s":
                seconds = np.concatenate([times[index] for _, times in parts])
                values[:, index] = np.round(seconds - seconds[0], 6)
                table.stamps[index] = column.first.strip()
            elif kind == "t":
                values[:, index] = np.nan
                table.faults[index] = column.fault(path, row, column.first)
        return table

    def parsed(self, block: bytes) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Numbers of all lines, shape ``(n_lines, n_numeric)``, and seconds of columns of times.

        Raises
        ------
        ValueError, DeprecationWarning
            If anything is unusual: a quotation mark, another number of cells, no number.
        """
        if b"\r" in block:
            block = block.replace(b"\r\n", b"\n")
        if any(mark in block for mark in (b'"', b"\r", b"#")):
            raise ValueError
        code = np.frombuffer(block, np.uint8)
        marks = np.flatnonzero((code == self.delimiter[0]) | (code == ord("\n")))
        ends = np.append(marks, code.size).reshape(-1, len(self.kinds) + self.closed)
        if np.any(code[ends[:-1, -1]] != ord("\n")) or block.count(b"\n") != len(ends) - 1:
            raise ValueError
        block, seconds = self._cut(block, ends)
        values = _floats(self._plain(block), self.kinds.count("n"))
        if len(values) != len(ends) or np.isnan(values).all(axis=1).any():
            raise ValueError
        return values, seconds

    def _cut(self, block: bytes, ends: np.ndarray) -> tuple[bytes, dict[int, np.ndarray]]:
        """The bytes without the columns that hold no numbers, and the times among these."""
        apart = [index for index, kind in enumerate(self.kinds) if kind != "n"]
        apart += [len(self.kinds)] if self.closed else []
        if not apart:
            return block, {}
        starts = np.append(0, ends.ravel()[:-1] + 1).reshape(ends.shape)
        change, seconds = np.zeros(len(block) + 2, np.int8), {}
        for index in apart:
            first, last = starts[:, index], ends[:, index]
            if index == len(self.kinds) and np.any(first != last):
                raise ValueError
            if self.kinds[index : index + 1] == ["s"]:
                seconds[index] = self.columns[index].seconds(block, first, last)
            # With the delimiter before it, or behind it where no number stands before.
            before = "n" in self.kinds[:index]
            change[first - before] += 1
            change[last + 1 - before] -= 1
        keep = np.cumsum(change[: len(block)], dtype=np.int8) == 0
        return np.frombuffer(block, np.uint8)[keep].tobytes(), seconds

    def _plain(self, block: bytes) -> bytes:
        """Rows of numbers with commas between them and decimal points."""
        if self.delimiter == b",":
            return block
        if b"," in block and b"." in block:
            raise ValueError
        return block.translate(bytes.maketrans(b"," + self.delimiter, b".,"))


@cache
def _arrow() -> ModuleType | None:
    """The reader of pyarrow, faster than NumPy's and as exact, where there is one."""
    try:
        return import_module("pyarrow.csv")
    except ImportError:
        return None


def _numbers(column: Any) -> np.ndarray:
    """Numbers of a column of pyarrow; its own way to NumPy would load pandas."""
    present, values = column.buffers()
    found = np.frombuffer(values, float, len(column))
    if not column.null_count:
        return found
    bits = np.frombuffer(present, np.uint8)
    return np.where(np.unpackbits(bits, count=len(column), bitorder="little"), found, np.nan)


def _floats(rows: bytes, width: int) -> np.ndarray:
    """Numbers of rows ``(n_rows, width)``; nothing, and the words for nothing, are NaN."""
    if (arrow := _arrow() if len(rows) > _BLOCK else None) is not None:
        names = list(map(str, range(width)))
        with suppress(ValueError):  # whatever is unusual: NumPy's reader takes it, or refuses it
            table = arrow.read_csv(
                io.BytesIO(rows),
                read_options=arrow.ReadOptions(
                    column_names=names, use_threads=False, block_size=len(rows) + 1
                ),
                parse_options=arrow.ParseOptions(quote_char=False, ignore_empty_lines=False),
                convert_options=arrow.ConvertOptions(
                    column_types=dict.fromkeys(names, "float64"), null_values=[""]
                ),
            )
            return np.stack([_numbers(column.chunk(0)) for column in table.columns]).T
    body = rows.replace(b"\n", b",")
    # Cells of blanks alone: NumPy would read the -1 by which its parser says that there is none.
    if any(blank in body for blank in (b" ", b"\t", b"\v", b"\f")):
        body = _BLANK.sub(b"", body)
    if b",," in body or body.startswith(b",") or body.endswith(b","):
        body = b",%s," % body
        body = body.replace(b",,", b",nan,").replace(b",,", b",nan,")[1:-1]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(body, sep=" ,").reshape(-1, width)
        except (ValueError, DeprecationWarning):
            return np.fromstring(_WORDS.sub(b"nan", body), sep=" ,").reshape(-1, width)
