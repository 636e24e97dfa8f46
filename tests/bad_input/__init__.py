"""Bad input by kind, and how an entry becomes a file or a folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


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
