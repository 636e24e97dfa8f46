"""Run the improvement on vehicles that nobody tuned for, and tabulate how often it is right.

    OMP_NUM_THREADS=1 python -m benchmarks.other_vehicles coaster motor --cases 20 --jobs 1

Finished cases are kept as lines of JSON in the store and never computed again.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from benchmarks.other_vehicles.cases import draws
from benchmarks.other_vehicles.judge import judge
from benchmarks.other_vehicles.measures import as_markdown, measures
from benchmarks.other_vehicles.truth import VEHICLES

STORE = Path(__file__).resolve().parent.parent / "results" / "other_vehicles.jsonl"
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
    store : Path
        Lines of JSON, one per finished case.
    n_jobs : int
        Processes.
    limit : float
        Longest processor time that one improvement may take, s.
    deadline : float, optional
        Time (seconds since the epoch) after which no new result is waited for.
    tell : callable
        Told about the progress.

    Returns
    -------
    dict
        Measures, see :func:`benchmarks.other_vehicles.measures.measures`.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    store.parent.mkdir(parents=True, exist_ok=True)
    wanted = draws(vehicles, max((cases, *(number + 1 for number in only))))
    if only:
        wanted = [draw for draw in wanted if draw.number in only]
    done = {entry["key"] for entry in load(store)}
    left = [draw for draw in wanted if draw.key not in done]
    tell(f"{len(wanted)} cases, {len(wanted) - len(left)} of them done")
    if store.exists() and not store.read_text(encoding="utf-8").endswith("\n"):
        with store.open("a", encoding="utf-8") as file:  # after a line that was cut short
            file.write("\n")
    with Parallel(n_jobs=n_jobs, return_as="generator_unordered") as workers:
        entries = workers(delayed(judge)(draw, limit=limit) for draw in left)
        for finished, entry in enumerate(entries, start=1):
            with store.open("a", encoding="utf-8") as file:
                file.write(json.dumps(entry) + "\n")
            tell(f"{finished}/{len(left)} {entry['key']} {summary(entry)}")
            if deadline is not None and time.time() > deadline:
                tell("out of time: the rest is left for the next run")
                break
    keys = {draw.key for draw in wanted}
    return measures([entry for entry in load(store) if entry["key"] in keys])


def load(store: Path) -> list[dict[str, Any]]:
    """Finished cases; a line that was cut short by a kill is left out."""
    if not store.exists():
        return []
    found = []
    for line in store.read_text(encoding="utf-8").splitlines():
        try:
            found.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return found


def summary(entry: dict[str, Any]) -> str:
    """One case in one line."""
    hidden = " + ".join(entry["effects"]) or "nothing"
    sight = "" if entry["detectable"] else " (invisible)"
    if "error" in entry:
        return f"{hidden}{sight} -> FAILED {entry['error'][:120]}"
    added = " + ".join(step["added"] for step in entry["steps"]) or "nothing"
    return f"{hidden}{sight} -> {added} ({entry['processor_seconds']:.1f} s)"


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line of the benchmark."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.other_vehicles", description=__doc__.splitlines()[0]
    )
    parser.add_argument("vehicles", nargs="*", default=[], help=", ".join(VEHICLES))
    parser.add_argument("--cases", type=int, default=CASES, help="cases of every vehicle")
    parser.add_argument("--only", type=int, nargs="*", default=[], help="numbers of cases")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--store", type=Path, default=STORE)
    parser.add_argument(
        "--limit", type=float, default=600.0, help="processor seconds for one improvement"
    )
    parser.add_argument("--minutes", type=float, help="start no wait beyond this")
    parser.add_argument("--measure", action="store_true", help="run nothing: measure what is there")
    parser.add_argument("--table", type=Path, help="write the measures there as Markdown")
    options = parser.parse_args(arguments)
    vehicles = options.vehicles or list(VEHICLES)
    if options.measure:
        found = measures([e for e in load(options.store) if e["vehicle"] in vehicles])
    else:
        found = run(
            vehicles,
            cases=options.cases,
            only=options.only,
            store=options.store,
            n_jobs=options.jobs,
            limit=options.limit,
            deadline=time.time() + 60 * options.minutes if options.minutes else None,
            tell=lambda text: print(text, flush=True),
        )
    text = as_markdown(found)
    print(text)
    if options.table:
        options.table.write_text(f"{PAGE}{text}\n", encoding="utf-8")
