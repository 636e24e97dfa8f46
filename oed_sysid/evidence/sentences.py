"""What a search for missing physics says: sentences by what they are about, filled in by facts."""

from __future__ import annotations

from typing import Any

from oed_sysid.runtime.tables import tables

SAYS: dict[str, dict[str, str]] = tables(__file__)


def say(about: str, row: str, **facts: Any) -> str:
    """A sentence of the table."""
    return SAYS[about][row].format(**facts)
