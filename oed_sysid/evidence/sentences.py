"""What a search for missing physics says: sentences by what they are about, filled in by facts."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import Any

SAYS: dict[str, dict[str, str]] = tomllib.loads(
    files(__package__).joinpath("sentences.toml").read_text("utf-8")
)


def say(about: str, row: str, **facts: Any) -> str:
    """A sentence of the table."""
    return SAYS[about][row].format(**facts)
