"""What needs no code, facts and sentences, stands in TOML beside the module that reads it."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any


def tables(module: str, name: str = "") -> dict[str, Any]:
    """The tables of a module.

    Parameters
    ----------
    module : str
        Its ``__file__``.
    name : str
        Of a TOML file in its folder; by default the one that is called as the module.

    Returns
    -------
    dict
        As TOML says them.
    """
    own = Path(module)
    return tomllib.loads(own.with_name(f"{name or own.stem}.toml").read_text(encoding="utf-8"))
