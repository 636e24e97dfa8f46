"""One line of the table, and the files that a line needs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from oed_sysid.data.third_party import data_folder


@dataclass(frozen=True)
class Row:
    """A figure of ours beside the published one.

    Parameters
    ----------
    what : str
        Quantity and the records that it is taken on.
    ours : float or None
        Measured here; None if a file is missing.
    published : str
        Best or reference figure in the literature, with its source; ``"-"`` if there is none.
    unit : str
        Of ``ours``.
    note : str
        What was fitted to what, or which file is missing.
    """

    what: str
    ours: float | None
    published: str
    unit: str = ""
    note: str = ""

    def cells(self) -> tuple[str, str, str, str]:
        """Cells of the Markdown table."""
        ours = "missing"
        if self.ours is not None:
            # Three digits tell; of a likelihood those behind the point do.
            ours = f"{self.ours:{'.2f' if abs(self.ours) >= 100 else '.3g'}} {self.unit}".strip()
        return self.what, ours, self.published, self.note


def place(path: str) -> Path:
    """Where a file of the data folder lies, or has to be put."""
    return data_folder() / path


def missing(what: str, published: str, path: str, content: str) -> Row:
    """Row of a benchmark whose file is not at hand."""
    return Row(what, None, published, note=f"put {content} at `{path}` in the data folder")


def wanted(what: str, published: str, path: str, content: str) -> Row | None:
    """The row that says so if a file is missing; None if it is there."""
    return None if place(path).is_file() else missing(what, published, path, content)
