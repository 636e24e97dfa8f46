"""Tables of cases that need no code: TOML beside the module that tests them."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any


def tables(module: str) -> dict[str, Any]:
    """The tables that stand beside a module, by name."""
    return tomllib.loads(Path(module).with_suffix(".toml").read_text(encoding="utf-8"))
