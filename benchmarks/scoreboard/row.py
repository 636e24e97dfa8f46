"""One line of the table, the files that a line needs, and what to say of a file at fault."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from oed_sysid.data.third_party import data_folder
from oed_sysid.errors import DataError, OedSysidError

LONGEST_REASON = 400  # characters


@dataclass(frozen=True)
class Row:
    """A figure of ours beside the published one.

    Parameters
    ----------
    what : str
        Quantity and the records that it is taken on.
    ours : float or None
        Measured here; None if a file is missing or at fault.
    published : str
        Best or reference figure in the literature, with its source; ``"-"`` if there is none.
    unit : str
        Of ``ours``.
    note : str
        What was fitted to what, or which file is missing, or what is wrong with it.
    instead : str
        What stands in place of a figure that is None.
    """

    what: str
    ours: float | None
    published: str
    unit: str = ""
    note: str = ""
    instead: str = "missing"

    def cells(self) -> tuple[str, str, str, str]:
        """Cells of the Markdown table."""
        ours = self.instead
        if self.ours is not None:
            # Three digits tell; of a likelihood those behind the point do.
            ours = f"{self.ours:{'.2f' if abs(self.ours) >= 100 else '.3g'}} {self.unit}".strip()
        texts = (self.what, ours, self.published, self.note)
        # A bar or a line's end within a text would end the cell.
        what, ours, published, note = (" ".join(text.split()).replace("|", "\\|") for text in texts)
        return what, ours, published, note


def place(path: str) -> Path:
    """Where a file of the data folder lies, or has to be put."""
    return data_folder() / path


def missing(what: str, published: str, path: str, content: str) -> Row:
    """Row of a benchmark whose file is not at hand."""
    return Row(what, None, published, note=f"put {content} at `{path}` in the data folder")


def reason(error: Exception) -> str:
    """What went wrong, in words and without the place of the data folder."""
    text = " ".join(str(error).split()).replace(str(data_folder()), "the data folder")
    if not isinstance(error, OedSysidError):
        text = (
            f"unforeseen {type(error).__name__}: {text or 'no text'}; compare the file with the "
            "form that its missing row or its problem's README asks for"
        )
    return text if len(text) <= LONGEST_REASON else text[: LONGEST_REASON - 3] + "..."


def refused(what: str, published: str, file: str, error: Exception) -> Row:
    """Row of a file that cannot be scored, and why."""
    note = f"cannot be scored: {file}: {reason(error)}"
    return Row(what, None, published, note=note, instead="cannot be scored")


def attempted(
    what: str, published: str, file: str, score: Callable[[], Iterable[Row]]
) -> list[Row]:
    """The rows of one file, or the row that says why there are none.

    Whatever is wrong with a file must not take the other rows with it, so every error is caught.
    """
    try:
        return list(score())
    except Exception as error:
        return [refused(what, published, file, error)]


SEPARATORS = (",", ";", "\t")


Found = TypeVar("Found")


@dataclass(frozen=True)
class Table:
    """Cells of the wanted columns.

    Parameters
    ----------
    file : str
        Name of the file, for messages.
    columns : mapping of str to tuple of str
        Cells by column, one for each row that is not empty.
    lines : tuple of int
        Line of each row in the file.
    decimal : str
        Mark of decimals.
    """

    file: str
    columns: Mapping[str, tuple[str, ...]]
    lines: tuple[int, ...]
    decimal: str

    def __len__(self) -> int:
        return len(self.lines)

    def numbers(self, name: str, rows: slice = slice(None)) -> np.ndarray:
        """A column as numbers, ``(n_rows,)``.

        Raises
        ------
        DataError
            If a cell is empty, no number or not finite.
        """
        cells, lines = self.columns[name][rows], self.lines[rows]
        values = np.empty(len(cells))
        for k, (cell, line) in enumerate(zip(cells, lines, strict=True)):
            try:
                values[k] = float(cell.replace(self.decimal, "."))
            except ValueError:
                values[k] = np.nan
            if not np.isfinite(values[k]):
                raise DataError(
                    f"{self.file}, line {line}, column {name}: expected a finite number, got "
                    f"{cell!r}. Correct or leave out the line."
                )
        return values


def plain(text: str) -> str:
    """A name in small letters, with underscores between its words.

    Examples
    --------
    >>> plain(' "Tactical diameter"')
    'tactical_diameter'
    """
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def read_table(path: Path, wanted: Mapping[str, Sequence[str]]) -> Table:
    """Read the wanted columns of a file by their names; others are passed over.

    Parameters
    ----------
    path : Path
        Text separated by commas, semicolons or tabs, with a header. Empty lines and empty columns
        are passed over. With semicolons or tabs decimals may have a comma.
    wanted : mapping of str to sequence of str
        Names of the columns, and what else they may be called.

    Raises
    ------
    DataError
        If the file is empty, no text, without header, without a wanted column or without rows.
    """
    content = path.read_bytes()
    columns = ", ".join(wanted)
    if not content.strip():
        raise DataError(f"{path.name} is empty. Expected a header with the columns {columns}.")
    if b"\0" in content:
        raise DataError(f"{path.name} is not plain text. Save it as UTF-8 with commas.")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    numbered = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip(' \t,;"')]
    if not numbered:
        raise DataError(f"{path.name} has separators only. Expected the columns {columns}.")
    separator = max(SEPARATORS, key=numbered[0][1].count)
    rows = list(csv.reader([line for _, line in numbered], delimiter=separator))
    header = [plain(cell) for cell in rows[0]]
    where = {}
    for name, others in wanted.items():
        spellings = [plain(one) for one in (name, *others)]
        found = [spelling for spelling in spellings if spelling in header]
        if not found:
            raise DataError(_lacking(path.name, name, columns, rows[0]))
        if header.count(found[0]) > 1:
            raise DataError(f"{path.name} has two columns {name}. Leave one.")
        where[name] = header.index(found[0])
    if len(rows) == 1:
        raise DataError(f"{path.name} has a header but no rows of {columns}. Add them.")
    body = rows[1:]
    cells = {
        name: tuple(row[k].strip() if k < len(row) else "" for row in body)
        for name, k in where.items()
    }
    lines = tuple(line for line, _ in numbered[1:])
    return Table(path.name, cells, lines, "." if separator == "," else ",")


def _lacking(file: str, name: str, columns: str, first: Sequence[str]) -> str:
    """Message for a column that is not in the header."""
    cells = [cell.strip() for cell in first if cell.strip()]
    if any(re.fullmatch(r"[-+]?[\d.,]+(e[-+]?\d+)?", cell, re.IGNORECASE) for cell in cells):
        return (
            f"{file} has no header: its first line is {', '.join(cells)[:60]!r}. Expected the "
            f"columns {columns}; write their names into the first line."
        )
    return (
        f"{file} has no column {name}; its columns are {', '.join(cells)[:120]}. Expected "
        f"{columns}, in any order; rename them."
    )


def first_readable(
    paths: Sequence[Path], readers: Sequence[Callable[[Path], Found]]
) -> tuple[Found, str]:
    """What the first file that can be read holds, and why others before it could not.

    Parameters
    ----------
    paths : sequence of Path
        Files that may be there, the preferred one first.
    readers : sequence of callable
        One for each.

    Raises
    ------
    Exception
        That of the preferred file, if none can be read.
    """
    faults: list[Exception] = []
    for path, read in zip(paths, readers, strict=True):
        if not path.is_file():
            continue
        try:
            return read(path), "; ".join(map(reason, faults))
        except Exception as error:  # a library's own error types differ from file to file
            faults.append(error)
    raise faults[0] if faults else DataError(f"There is no {paths[0].name}.")
