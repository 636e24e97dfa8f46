"""Numbers of ``published.toml``, which others published or computed."""

from __future__ import annotations

from benchmarks.tables import tables

PUBLISHED = tables(__file__)
