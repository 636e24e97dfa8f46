"""Bad input by kind, and how an entry becomes a file or a folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any


def written(place: Path, content: str | bytes) -> Path:
    """A file of this content; its folders are made."""
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_bytes(content.encode() if isinstance(content, str) else content)
    return place


def folder_of(place: Path, source: str | Mapping[str, str | bytes]) -> Path:
    """A folder of this problem.py, or of these files."""
    for name, content in ({"problem.py": source} if isinstance(source, str) else source).items():
        written(place / name, content)
    return place


def text_of(row: Mapping[str, Any], sound: str) -> str | bytes:
    """A text from a row of a table: the sound one with changes, or another; in some encoding."""
    text = row.get("whole", sound)
    for old, new in row.get("swaps", ()):
        assert old in text, old
        text = text.replace(old, new, 1)
    text = row.get("begin", "") + text + row.get("end", "")
    return text.encode(row["encoding"]) if "encoding" in row else text
