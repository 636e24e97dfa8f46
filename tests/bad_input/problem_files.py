"""Problem files that cannot be worked with, with what has to be said about each when loaded.

``SOUND`` is a small problem that loads; most entries of ``REFUSED`` change one
text in it. Each entry: kind, source (or files of the folder by name), words.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

DATA = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
SOUND: str = DATA["sound"]


def source_of(row: dict[str, Any]) -> str | dict[str, str | bytes]:
    """A problem.py, or the files of a folder, from a row of the table."""
    text = row.get("whole", SOUND)
    for old, new in row.get("swaps", ()):
        assert old in text, old
        text = text.replace(old, new, 1)
    text = row.get("begin", "") + text + row.get("end", "")
    if "encoding" in row:
        return {"problem.py": text.encode(row["encoding"])}
    return {row["only"]: text} if "only" in row else row.get("files", text)


REFUSED: tuple[tuple[str, str | dict[str, str | bytes], tuple[str, ...]], ...] = tuple(
    (row["kind"], source_of(row), tuple(row["words"])) for row in DATA["refused"]
)
