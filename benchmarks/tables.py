"""What needs no code stands in TOML: cases, vehicles and words, beside who reads them."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any


def tables(module: str, name: str = "") -> dict[str, Any]:
    """The tables of a module, in the file of its own name or in another of its folder."""
    own = Path(module)
    path = own.parent / f"{name or own.stem}.toml"
    return tomllib.loads(path.read_text(encoding="utf-8"))
