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
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.harness import RESULTS, Store, command, markdown
from benchmarks.other_vehicles.cases import draws
from benchmarks.other_vehicles.run import judged
from benchmarks.other_vehicles.truth import VEHICLES

STORE = RESULTS / "unprepared.jsonl"
RIGHT = 1.05


def ratio(entry: dict[str, Any]) -> float:
    """Error of whole validation runs over that of the true structure; infinite if there is none."""
    found, true = (float(entry.get(f"{one}_validation", "inf")) for one in ("found", "true"))
    return found / true if true > 0 else float("inf")


def table(entries: Sequence[dict[str, Any]]) -> str:
    """Rates by vehicle as Markdown."""
    head = (
        "vehicle", "hidden and detectable", "right", "claims, mean", "right where not detectable",
        "nothing hidden", "claims there", "aborted", "processor s, median",
    )  # fmt: skip
    rows = []
    for vehicle in (*VEHICLES, "all"):
        own = [e for e in entries if vehicle in ("all", e["vehicle"])]
        shown = [e for e in own if e["effects"] and e["detectable"]]
        weak = [e for e in own if e["effects"] and not e["detectable"]]
        bare = [e for e in own if not e["effects"]]
        if not own:
            continue
        seconds = sorted(e["processor_seconds"] for e in own)[len(own) // 2]
        claims = sum(len(e.get("steps", ())) for e in shown) / max(len(shown), 1)
        cells = (
            vehicle,
            len(shown),
            sum(ratio(e) <= RIGHT for e in shown),
            f"{claims:.2f}",
            f"{sum(ratio(e) <= RIGHT for e in weak)} of {len(weak)}",
            len(bare),
            sum(bool(e.get("steps")) for e in bare),
            sum("error" in e for e in own),
            f"{seconds:.0f}",
        )
        rows.append(cells)
    return "\n".join(markdown(head, rows))


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
