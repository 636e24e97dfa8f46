"""Numbers of `docs/reliability.md`: bad, random and damaged input, and interrupted work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from benchmarks import bad_input, damaged, fuzz, killed
from benchmarks.documents.page import Numbers, Page
from benchmarks.harness import Row

SEED = 20261129
INPUTS, FILES, KILLS = 500_000, 5_200, 20


def counted(measure: Callable[[], Sequence[Row]]) -> Numbers:
    """Rows of one exam."""
    return {"rows": measure()}


PAGE = Page(
    "reliability",
    {
        "mistakes": partial(counted, bad_input.counted),
        "random": partial(counted, partial(fuzz.counted, inputs=INPUTS, seed=SEED)),
        "damaged": partial(counted, partial(damaged.counted, files=FILES, seed=SEED)),
        "killed": partial(counted, partial(killed.counted, kills=KILLS, seed=SEED)),
    },
)
