"""Run the improvement on vehicles that nobody tuned for, and tabulate how often it is right.

    OMP_NUM_THREADS=1 python -m benchmarks.other_vehicles coaster motor --cases 20 --jobs 1
    OMP_NUM_THREADS=1 python -m benchmarks.other_vehicles --cases 18 --unprepared

``--unprepared`` names no candidate: `improve` makes its own from the model and the records. *Right*
is then an error of whole validation runs of at most 1.05 times that of the true structure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from benchmarks.harness import RESULTS, Row, Store, run_cases
from benchmarks.other_vehicles.cases import draws
from benchmarks.other_vehicles.judge import judge
from benchmarks.other_vehicles.measures import as_markdown, measures, unprepared_table
from benchmarks.other_vehicles.truth import VEHICLES
from benchmarks.rates import summary, told

CASES = 60


def run(
    vehicles: Sequence[str] = tuple(VEHICLES),
    *,
    cases: int = CASES,
    only: Sequence[int] = (),
    store: Path = RESULTS / "other_vehicles.jsonl",
    n_jobs: int = 1,
    limit: float = 600.0,
    minutes: float = 1e9,
    prepared: bool = True,
    tell: Callable[[str], None] = print,
) -> list[Row]:
    """Run all cases that are not in the store yet, and return all that are finished.

    See :func:`main`; candidates are named where they are ``prepared``, and ``tell`` takes progress.
    """
    # Candidates are named unless it is said, so that cases of a store are what they were.
    settings = {"limit": limit} | ({} if prepared else {"prepared": False})
    wanted = {
        draw.key: partial(judge, draw, **settings)
        for draw in draws(vehicles, max((cases, *(number + 1 for number in only))))
        if not only or draw.number in only
    }
    return run_cases(Store(store), wanted, n_jobs=n_jobs, minutes=minutes, tell=summary, say=tell)


def main(
    vehicles: Sequence[str] = tuple(VEHICLES),
    *,
    cases: int = CASES,
    only: Sequence[int] = (),
    jobs: int = 1,
    store: Path | None = None,
    limit: float = 600.0,
    minutes: float = 1e9,
    measure: bool = False,
    unprepared: bool = False,
    table: Path | None = None,
) -> None:
    """Run what is missing and print the measures.

    Parameters
    ----------
    vehicles : sequence of str
        coaster, catamaran, auv, motor
    cases : int
        cases of every vehicle
    only : sequence of int
        numbers of cases
    unprepared : bool
        name no candidate
    """
    name = "unprepared" if unprepared else "other_vehicles"
    place = store or RESULTS / f"{name}.jsonl"
    if measure:
        rows = [row for row in Store(place).rows() if row["vehicle"] in vehicles]
    else:
        rows = run(
            vehicles, cases=cases, only=only, store=place, n_jobs=jobs, limit=limit,
            minutes=minutes, prepared=not unprepared,
        )  # fmt: skip
    told(unprepared_table(rows) if unprepared else as_markdown(measures(rows)), table)
