"""One line of the table, the files that a line needs, and what to say of a file at fault."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

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


def held_back(
    what: str, published: str, path: str, content: str, score: Callable[[], Iterable[Row]]
) -> list[Row]:
    """The rows of a file if it is at hand, else the row that says what to put where."""
    if not place(path).is_file():
        return [missing(what, published, path, content)]
    return attempted(what, published, path, score)


def reason(error: Exception) -> str:
    """What went wrong, in words and without the place of the data folder."""
    text = " ".join(str(error).split()).replace(str(data_folder()), "the data folder")
    if not isinstance(error, OedSysidError):
        text = (
            f"unforeseen {type(error).__name__}: {text or 'no text'}; compare the file with the "
            "form that its missing row or its problem's README asks for"
        )
    return text if len(text) <= LONGEST_REASON else text[: LONGEST_REASON - 3] + "..."


def attempted(
    what: str, published: str, file: str, score: Callable[[], Iterable[Row]]
) -> list[Row]:
    """The rows of one file, or the row that says why there are none.

    Whatever is wrong with a file must not take the other rows with it, so every error is caught.
    """
    try:
        return list(score())
    except Exception as error:
        note = f"cannot be scored: {file}: {reason(error)}"
        return [Row(what, None, published, note=note, instead="cannot be scored")]


def columns(path: Path, *names: str) -> list[np.ndarray]:
    """Columns of a CSV file by name, each ``(n_rows,)``; other columns are passed over.

    Raises
    ------
    DataError
        If a column is not there, or holds what is no finite number.
    """
    try:
        table = np.genfromtxt(path, delimiter=",", names=True, encoding="utf-8-sig")
        found = [np.atleast_1d(table[name]) for name in names]
    except (ValueError, IndexError) as error:
        raise DataError(
            f"{path.name} has no column {names[0]}, or not the others. Expected "
            f"{', '.join(names)}, separated by commas below a header."
        ) from error
    if not np.isfinite(found).all():
        raise DataError(f"{path.name}: {', '.join(names)} are not all finite numbers.")
    return found
