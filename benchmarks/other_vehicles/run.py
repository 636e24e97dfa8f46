"""Run the improvement on vehicles that nobody tuned for, and tabulate how often it is right.

    OMP_NUM_THREADS=1 python -m benchmarks.other_vehicles coaster motor --cases 20 --jobs 1
    OMP_NUM_THREADS=1 python -m benchmarks.other_vehicles --cases 18 --unprepared

``--unprepared`` names no candidate: `improve` makes its own from the model and the records. What is
hidden is then an *unknown effect*, found if whole validation runs err at most 1.05 times as much as
with the true structure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from benchmarks import rates
from benchmarks.harness import RESULTS, Row, Store
from benchmarks.other_vehicles.cases import draws
from benchmarks.other_vehicles.judge import judge
from benchmarks.other_vehicles.truth import VEHICLES

STORE = Store(RESULTS / "other_vehicles.jsonl")


def cases(
    vehicles: Sequence[str] = tuple(VEHICLES),
    *,
    cases: int = 60,
    only: Sequence[int] = (),
    limit: float = 600.0,
    unprepared: bool = False,
) -> dict[str, Callable[[], Row]]:
    """Cases of some vehicles by name.

    Parameters
    ----------
    vehicles : sequence of str
        coaster, catamaran, auv, motor
    cases : int
        cases of every vehicle
    only : sequence of int
        numbers of cases
    limit : float
        processor seconds for one improvement
    unprepared : bool
        name no candidate
    """
    ending = "/unprepared" if unprepared else ""
    return {
        draw.key + ending: partial(judge, draw, limit=limit, prepared=not unprepared)
        for draw in draws(vehicles, max((cases, *(number + 1 for number in only))))
        if not only or draw.number in only
    }


def table(rows: Sequence[Row]) -> str:
    """Measures of finished cases as Markdown, those without candidates apart."""
    named = [row for row in rows if row.get("prepared", True)]
    bare = [
        row | {"hidden": "unknown"} if row["effects"] else row for row in rows if row not in named
    ]
    return "\n\n".join(rates.table(rates.measures(part)) for part in (named, bare) if part)
