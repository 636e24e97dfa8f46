"""Run the improvement on vehicles that nobody tuned for, and tabulate how often it is right.

    OMP_NUM_THREADS=1 python -m benchmarks.other_vehicles coaster motor --cases 20 --jobs 1

Finished cases are kept as lines of JSON in the store and never computed again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.harness import RESULTS, Row, Store, run_cases, write_page
from benchmarks.other_vehicles.cases import Draw, draws
from benchmarks.other_vehicles.judge import judge
from benchmarks.other_vehicles.measures import as_markdown, measures
from benchmarks.other_vehicles.truth import VEHICLES
from benchmarks.rates import summary

STORE = RESULTS / "other_vehicles.jsonl"
CASES = 60


def run(
    vehicles: Sequence[str] = tuple(VEHICLES),
    *,
    cases: int = CASES,
    only: Sequence[int] = (),
    store: Path = STORE,
    n_jobs: int = 1,
    limit: float = 600.0,
    deadline: float | None = None,
    tell: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Run all cases that are not in the store yet, and measure all that are.

    Parameters
    ----------
    vehicles : sequence of str
        Any of coaster, catamaran, auv, motor.
    cases : int
        Cases of every vehicle.
    only : sequence of int
        Numbers of cases, where not all are wanted.
    store, n_jobs, deadline, tell
        See :func:`benchmarks.harness.run_cases`.
    limit : float
        Longest processor time that one improvement may take, s.

    Returns
    -------
    dict
        Measures, see :func:`benchmarks.other_vehicles.measures.measures`.
    """
    wanted = draws(vehicles, max((cases, *(number + 1 for number in only))))
    if only:
        wanted = [draw for draw in wanted if draw.number in only]
    return measures(judged(wanted, store, n_jobs, deadline, tell, limit=limit))


def judged(
    wanted: Sequence[Draw],
    store: Path,
    n_jobs: int = 1,
    deadline: float | None = None,
    tell: Callable[[str], None] = print,
    **settings: Any,
) -> list[Row]:
    """The wanted cases that are finished, after those that were missing have run."""
    by_key = {draw.key: draw for draw in wanted}
    return run_cases(
        Store(store), list(by_key),
        lambda left: (partial(judge, by_key[str(key)], **settings) for key in left),
        n_jobs=n_jobs, deadline=deadline, tell=summary, say=tell,
    )  # fmt: skip


def main(
    vehicles: Sequence[str] = tuple(VEHICLES),
    *,
    cases: int = CASES,
    only: Sequence[int] = (),
    jobs: int = 1,
    store: Path = STORE,
    limit: float = 600.0,
    minutes: float = 1e9,
    measure: bool = False,
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
    jobs : int
        processes
    store : Path
        store of finished cases
    limit : float
        processor seconds for one improvement
    minutes : float
        wait for no case after that
    measure : bool
        run nothing: measure what is there
    table : Path
        write the measures there as Markdown
    """
    if measure:
        found = measures([e for e in Store(store).rows() if e["vehicle"] in vehicles])
    else:
        found = run(
            vehicles, cases=cases, only=only, store=store, n_jobs=jobs, limit=limit,
            deadline=time.time() + 60.0 * minutes,
        )  # fmt: skip
    text = as_markdown(found)
    print(text)
    if table:
        write_page(table, text)
