"""How often missing physics is found where nobody has named a candidate.

    OMP_NUM_THREADS=1 python -m benchmarks.unprepared [coaster ...] [--cases 12] [--minutes 30]

The cases of :mod:`benchmarks.other_vehicles`, their truth simulated without the package, but
`improve` gets no candidates and makes its own from the model and the records. Names differ from
those of the truth, so a case is judged by what the found model predicts: *right* is an error of
whole validation runs of at most 1.05 times that of the true structure fitted to the same records.
Finished cases are kept in the store.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.other_vehicles.cases import draws
from benchmarks.other_vehicles.judge import judge
from benchmarks.other_vehicles.run import load
from benchmarks.other_vehicles.truth import VEHICLES

STORE = Path(__file__).resolve().parent / "results" / "unprepared.jsonl"
RIGHT = 1.05


def ratio(entry: dict[str, Any]) -> float:
    """Error of whole validation runs over that of the true structure; infinite if there is none."""
    found, true = (float(entry.get(f"{one}_validation", "inf")) for one in ("found", "true"))
    return found / true if true > 0 else float("inf")


def table(entries: Sequence[dict[str, Any]]) -> str:
    """Rates by vehicle as Markdown."""
    lines = [
        "| vehicle | hidden and detectable | right | claims, mean | right where not detectable | "
        "nothing hidden | claims there | aborted | processor s, median |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
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
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run cases that are not in the store, and print the table of all that are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("vehicles", nargs="*", default=list(VEHICLES))
    parser.add_argument("--cases", type=int, default=12, help="cases of every vehicle")
    parser.add_argument("--minutes", type=float, default=1e9, help="begin no case after that")
    parser.add_argument("--store", type=Path, default=STORE)
    given = parser.parse_args(arguments)
    end = time.time() + 60.0 * given.minutes
    done = {entry["key"] for entry in load(given.store)}
    given.store.parent.mkdir(parents=True, exist_ok=True)
    for draw in draws(given.vehicles, given.cases):
        if draw.key in done or time.time() > end:
            continue
        entry = judge(draw, prepared=False)
        with given.store.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")
        added = ", ".join(step["added"] for step in entry.get("steps", ())) or "nothing"
        hidden = ", ".join(entry["effects"]) or "nothing"
        print(f"{entry['key']}: {hidden} -> {added}, {ratio(entry):.3f}", flush=True)
    kept = [entry for entry in load(given.store) if entry["vehicle"] in given.vehicles]
    print(table(kept))


if __name__ == "__main__":
    main()
