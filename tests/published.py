"""Numbers of ``published.toml``, which others published or computed."""

from __future__ import annotations

import tomllib
from pathlib import Path

PUBLISHED = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
