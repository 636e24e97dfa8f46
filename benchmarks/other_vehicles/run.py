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

from benchmarks.harness import RESULTS, Row, Store, run_cases
from benchmarks.other_vehicles.cases import Draw, draws
from benchmarks.other_vehicles.judge import judge
from benchmarks.other_vehicles.measures import as_markdown, measures
from benchmarks.other_vehicles.truth import VEHICLES

STORE = RESULTS / "other_vehicles.jsonl"
CASES = 60
PAGE = """# How often missing physics is found on vehicles that nothing was tuned for

| vehicle | states | measured | samples | hidden effects | candidates |
|---|---|---|---|---|---|
| 50 m coaster | 6 | heading, position | 5 x 361, 1 s | 14 | 26 |
| two-propeller catamaran | 6 | speeds, yaw rate, heading, position | 5 x 401, 0.25 s | 18 | 31 |
| AUV, six degrees of freedom | 12 | speeds, rates, attitude, depth | 5 x 301, 0.2 s | 19 | 39 |
| motor with an unbalanced load | 2 | angle, speed | 5 x 501, 0.05 s | 13 | 21 |

Three records train, two validate. The simulators (`benchmarks/other_vehicles/truth/`) share no
code with the package; each has its own integrator (Runge-Kutta, Dormand-Prince of order
eight, Gragg's extrapolation, Runge-Kutta that sticks in dry friction), and without anything
hidden the nominal models give the same records to 1e-6. Free parameters start 10 to 30 %
wrong; every other case of a kind declares no noise levels. *waves* are first-order
Gauss-Markov forces on every axis, *input_noise* is noise on one logged input (0.5 deg of
a rudder or fin). Sizes are 0.3 to 2 times typical. Some effects are parts of the nominal
model that a case leaves out (yaw, sway, roll or viscous damping), so that deviations grow.

*Detectable*: the expected gain of the truth in twice the log-likelihood, computed without the
package by a Kalman filter at the true noise levels, is at least 36 on the training and 16
on the validation records. *Accepted*: claimed, or in the group of at most three of a claim;
names that are the same model in other words count as right.

    OMP_NUM_THREADS=1 python -m benchmarks.other_vehicles --cases 60 --table docs/other_vehicles.md

continues where the last run stopped (`benchmarks/results/other_vehicles.jsonl`).

"""


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


def summary(entry: Row) -> str:
    """One case in one line."""
    hidden = " + ".join(entry["effects"]) or "nothing"
    sight = "" if entry["detectable"] else " (invisible)"
    if "error" in entry:
        return f"{entry['key']} {hidden}{sight} -> FAILED {entry['error'][:120]}"
    added = " + ".join(step["added"] for step in entry["steps"]) or "nothing"
    return f"{entry['key']} {hidden}{sight} -> {added} ({entry['processor_seconds']:.1f} s)"


def main(
    vehicles: Sequence[str] = tuple(VEHICLES),
    *,
    cases: int = CASES,
    only: Sequence[int] = (),
    jobs: int = 1,
    store: Path = STORE,
    limit: float = 600.0,
    minutes: float = 0.0,
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
        start no wait beyond this
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
            deadline=time.time() + 60 * minutes if minutes else None,
            tell=lambda text: print(text, flush=True),
        )  # fmt: skip
    text = as_markdown(found)
    print(text)
    if table:
        table.write_text(f"{PAGE}{text}\n", encoding="utf-8")
