"""System identification and optimal experiment design for marine vehicles.

Names are imported when they are first used, so that ``import oed_sysid`` is
quick; ``oed_sysid/README.md`` is the map of the package.
"""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

from oed_sysid.runtime.moved import understand_old_paths

understand_old_paths()

# The stub of this file lists the public names, each with the module that holds it.
_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
_HOME = {
    alias.name: str(node.module)
    for node in _STUB.body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}

__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'oed_sysid' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
