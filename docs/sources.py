"""What pictures and notebooks depend on, so that they are made again only where that changed."""

from __future__ import annotations

import hashlib
from pathlib import Path

import matplotlib

ROOT = Path(__file__).resolve().parent.parent


def digest(*files: Path) -> str:
    """Of these files, the package, the problems and Matplotlib."""
    said = hashlib.sha256(matplotlib.__version__.encode())
    parts = [path for part in ("oed_sysid", "problems") for path in (ROOT / part).rglob("*.*")]
    for path in [*files, *sorted(parts)]:
        if path.suffix in (".py", ".c", ".csv", ".toml", ".txt", ".md", ".ipynb"):
            said.update(path.name.encode() + path.read_bytes())
    return said.hexdigest()


def changed(stamp: Path, now: str) -> bool:
    """Whether a stamp, a file that :func:`digest` was written to, is missing or an older one."""
    return not stamp.exists() or stamp.read_text(encoding="utf-8") != now
