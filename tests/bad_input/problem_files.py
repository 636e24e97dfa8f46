"""Problem files that cannot be worked with, with what has to be said about each when loaded.

``SOUND`` is a small problem that loads; most entries of ``REFUSED`` change one
text in it. Each entry: kind, files of the folder by name, words.
"""

from __future__ import annotations

from typing import Any

from bad_input import text_of
from benchmarks.tables import tables

DATA = tables(__file__)
SOUND: str = DATA["sound"]


def files_of(row: dict[str, Any]) -> dict[str, str | bytes]:
    """Files of a folder by name, from a row of the table."""
    return row.get("files") or {row.get("only", "problem.py"): text_of(row, SOUND)}


REFUSED: tuple[tuple[str, dict[str, str | bytes], tuple[str, ...]], ...] = tuple(
    (row["kind"], files_of(row), tuple(row["words"])) for row in DATA["refused"]
)
