"""How often the right place is accused.

    OMP_NUM_THREADS=1 python -m benchmarks.locating

The cases are those of ``benchmarks/missing_physics``, which asks for the terms that are proposed.
Nothing but the nominal model is given: no candidate effects, no amplitudes.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial

import numpy as np

from benchmarks.harness import RESULTS, Row, Store, markdown, study
from benchmarks.missing_physics.cases import DATA, UNKNOWN_TERMS, Draw, draws, simulate_draws
from benchmarks.missing_physics.judge import datasets, nominal
from benchmarks.missing_physics.simulator import Case
from oed_sysid.evidence.locate import locate
from oed_sysid.evidence.study import Study

# Without the unknown moment w^3 of positive sign, which throws the vehicle over.
PLAN = "single/white:40 none/white:10 unknown/white:5 unknown/white:6-15 unknown/white:16-20"


def right_places(case: Case) -> tuple[str, ...]:
    """Places that may be accused of what is hidden."""
    for name in case.effects:
        if name not in UNKNOWN_TERMS:
            return tuple(DATA["effects"][name]["places"])
        axis = DATA["unknown"][name]["axis"]
        return ("force X", "actuator T") if axis == "X" else (f"force {axis}",)
    return ()


def outcome(draw: Draw) -> Row:
    """Which place is accused in one case, which are right, and how long it took, s."""
    ((case, records),) = simulate_draws([draw])
    train, test = datasets(nominal(), records)
    begun, fit = Study.begin(nominal().model, train, test, (), known_noise=False)
    began, right = time.perf_counter(), right_places(case)
    found = locate(fit, begun.unit)
    seconds = time.perf_counter() - began
    near = {place.name for place in found.places[:2]} | set(found.group)
    return {
        "key": draw.key, "hidden": ", ".join(case.effects) or "nothing", "right": list(right),
        "best": found.best, "group": list(found.group), "near": bool(near & set(right)),
        "seconds": seconds,
    }  # fmt: skip


def table(outcomes: Sequence[Row]) -> str:
    """Measures as Markdown."""
    hidden, nothing = ([o for o in outcomes if bool(o["right"]) is so] for so in (True, False))
    seen, false = ([o for o in part if o["best"] is not None] for part in (hidden, nothing))
    counts = {
        "a place is accused, something hidden": (len(seen), hidden),
        "right place first": (sum(o["best"] in o["right"] for o in seen), seen),
        "right place in the first two or in the group": (sum(o["near"] for o in seen), seen),
        "false accusations, nothing hidden": (len(false), nothing),
    }
    seconds = f"{np.median([o['seconds'] for o in outcomes]):.1f}"
    found = [(words, f"{count} of {len(all_)}") for words, (count, all_) in counts.items()]
    lines = [*found, ("seconds to locate, median", seconds)]
    return "\n".join(markdown(("measure", "value"), lines))


def cases(plan: str = PLAN) -> dict[str, partial[Row]]:
    """Cases of a plan by name.

    Parameters
    ----------
    plan : str
        kinds of cases and how many, as "single/white:40 none/white:10"
    """
    return {draw.key: partial(outcome, draw) for draw in draws(plan)}


def told(row: Row) -> str:
    """Which places are accused in a case."""
    return f"{row['key']} {row['hidden']}: {', '.join(row['group']) or 'noise'}"


if __name__ == "__main__":
    study(cases, table, Store(RESULTS / "locating.jsonl"), tell=told)
