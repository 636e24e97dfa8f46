"""Numbers of `docs/check.md`: how often faults of logs are found, and how often none is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter

from benchmarks.documents.page import Numbers, Page
from benchmarks.harness import grouped
from benchmarks.spoilt_logs import as_they_are, clean, copies, faults, inputs

SEED = 11000
# Seeds of each part: a seed is one log of each kind and size for either vehicle.
FAULTS, CLEAN, INPUTS = 2, 20, 4
COUNTED = ("first", "named", "suspect", "of")


def found() -> Numbers:
    """Faults by kind and by place among their sizes, both vehicles together."""
    rows = faults(range(SEED, SEED + FAULTS))
    return {
        "seeds": FAULTS,
        "first_seed": SEED,
        "total": _counted(rows),
        "vehicles": {
            name: _counted(own) for name, own in grouped(rows, itemgetter("vehicle")).items()
        },
        "kinds": {
            kind: {
                "all": _counted(own),
                "sizes": [_counted([r for r in own if r["place"] == place]) for place in range(3)],
            }
            for kind, own in grouped(rows, itemgetter("kind")).items()
        },
        "missed": [
            {key: row[key] for key in ("vehicle", "kind", "signals", "size", "suspect", "missed")}
            for row in rows
            if row["named"] < row["of"]
        ],
    }


def _counted(rows: Sequence[Mapping[str, int]]) -> dict[str, int]:
    return {key: sum(row[key] for row in rows) for key in COUNTED}


def quiet() -> Numbers:
    """False alarms by noise, both vehicles together."""
    rows = clean(range(SEED, SEED + CLEAN))
    return {
        "rows": rows,
        "suspect": sum(row["suspect"] for row in rows),
        "of": sum(row["of"] for row in rows),
    }


def commanded() -> Numbers:
    """Faults of inputs against the nominal model with its priors."""
    return {"rows": inputs(range(SEED, SEED + INPUTS))}


def searched() -> Numbers:
    """Spoilt copies through check and search, and records as they are."""
    rows = copies()
    return {
        "rows": rows,
        "named": sum(row["check"] == "named" for row in rows),
        "certified": sum(row["certified"] for row in rows),
        "as_they_are": as_they_are(),
    }


PAGE = Page("check", {"faults": found, "clean": quiet, "inputs": commanded, "copies": searched})
