"""Numbers of `docs/performance.md`: how long things take, and the same fit by others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial

from benchmarks.documents.page import Numbers, Page
from benchmarks.fit_peers import PEERS, STARTS, compared, pythons
from benchmarks.harness import machine
from benchmarks.speed import PARTS

SPEED: dict[str, Sequence[str]] = {
    "calls": ("kernel", "information", "fit_speed", "likelihood", "score", "swarm", "startup"),
    # Processes that begin later count the peak memory of this one as theirs.
    "long": ("tables", "growth", "long_search", "six_degrees"),
}


def timed(names: Sequence[str]) -> Numbers:
    """What parts of `benchmarks.speed` measured, beside its target."""
    rows = [
        {"part": name, **asdict(found), "met": bool(found.met)}
        for name in names
        for found in PARTS[name]()
    ]
    return {"machine": machine(), "rows": rows}


def peers() -> Numbers:
    """The same fit by this package and by others, from two starts."""
    starts = [{"share": share, "rows": [*compared([*PEERS], share, pythons())]} for share in STARTS]
    return {"machine": machine(), "starts": starts}


PAGE = Page(
    "performance",
    {**{name: partial(timed, parts) for name, parts in SPEED.items()}, "peers": peers},
)
