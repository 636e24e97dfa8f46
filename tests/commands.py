"""What a command of the package tells as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from oed_sysid.cli import DONE, main


def told(folder: Path, line: Iterable[object], status: int = DONE) -> dict:
    """Numbers that a command writes into a folder when it ends with this status."""
    file = folder / "told.json"
    assert main([*map(str, line), "--json", str(file)]) == status
    return json.loads(file.read_text(encoding="utf-8"))
