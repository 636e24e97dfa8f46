"""Run the improvement over many hidden-effect cases and tabulate how often it is right.

    OMP_NUM_THREADS=1 python -m benchmarks.missing_physics "single/white:40 none/white:20"

Finished cases are kept as lines of JSON and never computed again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from benchmarks import rates
from benchmarks.harness import RESULTS, Row, Store
from benchmarks.missing_physics.cases import DATA, Draw, draws, simulate_draws
from benchmarks.missing_physics.judge import judge

STORE = Store(RESULTS / "missing_physics.jsonl")
PLAN = (
    "single/white:320 none/white:200 pair/white:60 unknown/white:40 "
    "none/colour5:20 none/colour9:20 none/force_mid:20 none/force_high:20 none/gust_mid:20 "
    "single/colour5:40 single/force_mid:40 single/gust_mid:40"
)
BATCH = 40


def cases(plan: str = PLAN) -> dict[str, Draw]:
    """Cases of a plan by name.

    Parameters
    ----------
    plan : str
        kinds of cases and how many, as "single/white:40 none/white:20"
    """
    return {draw.key: draw for draw in draws(plan)}


def calls(left: Sequence[Draw]) -> Iterator[Callable[[], Row]]:
    """What judges each case; they are simulated a batch at a time."""
    for first in range(0, len(left), BATCH):
        batch = left[first : first + BATCH]
        for draw, (case, records) in zip(batch, simulate_draws(batch), strict=True):
            yield partial(judge, draw, case, records)


def measures(rows: Sequence[Row]) -> dict[str, Any]:
    """Measures of finished cases; of terms without a name, also of their equation."""
    axes = {name: {"axis": term["axis"]} for name, term in DATA["unknown"].items()}
    return rates.measures([row | axes.get(next(iter(row["effects"]), ""), {}) for row in rows])


def table(rows: Sequence[Row]) -> str:
    """These measures as Markdown."""
    return rates.table(measures(rows))
