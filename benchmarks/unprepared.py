"""How often missing physics is found where nobody has named a candidate.

    OMP_NUM_THREADS=1 python -m benchmarks.unprepared [coaster ...] [--cases 12] [--minutes 30]

The cases of :mod:`benchmarks.other_vehicles`, their truth simulated without the package, but
`improve` gets no candidates and makes its own from the model and the records. Names differ from
those of the truth, so a case is judged by what the found model predicts: *right* is an error of
whole validation runs of at most 1.05 times that of the true structure fitted to the same records.
Finished cases are kept in the store.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness import RESULTS, Row, Store, command, grouped, tabulate
from benchmarks.other_vehicles.cases import draws
from benchmarks.other_vehicles.run import judged
from benchmarks.other_vehicles.truth import VEHICLES
from benchmarks.rates import claims

STORE = RESULTS / "unprepared.jsonl"
RIGHT = 1.05


def ratio(entry: Row) -> float:
    """Error of whole validation runs over that of the true structure; infinite if there is none."""
    found, true = (float(entry.get(f"{one}_validation", "inf")) for one in ("found", "true"))
    return found / true if true > 0 else float("inf")


def hidden(group: Sequence[Row], *, detectable: bool) -> list[Row]:
    """Cases that hide something which shows, or does not."""
    return [row for row in group if row["effects"] and row["detectable"] is detectable]


def right(group: Sequence[Row]) -> int:
    """How many cases are right."""
    return sum(ratio(row) <= RIGHT for row in group)


COLUMNS: dict[str, Callable[[str, list[Row]], object]] = {
    "vehicle": lambda vehicle, _: vehicle,
    "hidden and detectable": lambda _, group: len(hidden(group, detectable=True)),
    "right": lambda _, group: right(hidden(group, detectable=True)),
    "claims, mean": lambda _, group: "{:.2f}".format(
        np.mean([len(row.get("steps", ())) for row in hidden(group, detectable=True)] or [0])
    ),
    "right where not detectable": lambda _, group: (
        f"{right(weak)} of {len(weak)}" if (weak := hidden(group, detectable=False)) else "-"
    ),
    "nothing hidden": lambda _, group: sum(not row["effects"] for row in group),
    "claims there": lambda _, group: sum(claims(row) and not row["effects"] for row in group),
    "aborted": lambda _, group: sum("error" in row for row in group),
    "processor s, median": lambda _, group: "{:.0f}".format(
        np.median([row["processor_seconds"] for row in group])
    ),
}


def table(rows: Sequence[Row]) -> str:
    """Rates by vehicle as Markdown."""
    groups = grouped(rows, lambda row: row["vehicle"])
    return "\n".join(tabulate(groups | {"all": list(rows)}, COLUMNS))


def main(
    vehicles: Sequence[str] = tuple(VEHICLES),
    *,
    cases: int = 12,
    minutes: float = 1e9,
    store: Path = STORE,
) -> None:
    """Run cases that are not in the store, and print the table of all that are.

    Parameters
    ----------
    vehicles : sequence of str
        coaster, catamaran, auv, motor
    cases : int
        cases of every vehicle
    minutes : float
        wait for no case after that
    store : Path
        store of finished cases
    """
    judged(draws(vehicles, cases), store, 1, time.time() + 60.0 * minutes, prepared=False)
    print(table([entry for entry in Store(store).rows() if entry["vehicle"] in vehicles]))


if __name__ == "__main__":
    command(main)
