"""Numbers of `docs/estimation.md`: what acts on records, what a fit states, how often it holds."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from benchmarks.documents.page import Numbers, Page
from benchmarks.random_forces.run import run
from benchmarks.spikes import case
from benchmarks.tables import tables

SETS, SEED = 30, 6600
SPIKES, SPIKE_SEED = 20, 6601
DATA = tables(__file__)


def worlds(name: str) -> Numbers:
    """What fits state of one kind of disturbance, by vehicle."""
    title, vehicles = DATA["worlds"][name].values()
    settings = {"disturbances": "auto", "loss": "auto", "predict": False}
    found = run([*vehicles.values()], sets=SETS, seed=SEED, settings=settings)
    rows = {vehicle: _told(measured) for vehicle, measured in zip(vehicles, found, strict=True)}
    return {"title": title, "vehicles": rows, "failed": sum(row["failed"] for row in rows.values())}


def _told(measured: Mapping[str, Any]) -> dict[str, Any]:
    """What the page says of one world."""
    parts = measured["by_parameter"].values()
    return {
        "held": measured["coverage"],
        "doubt": measured["coverage_error"],
        "worst": min(part["coverage"] for part in parts),
        "ratio": measured["z"],
        "bias": max(abs(bias) for bias in measured["bias"].values()),
        "sea": measured["sea"],
        "forces": measured["forces"],
        "concerns": measured["concerns"],
        "failed": sum(n for code, n in measured["status"].items() if code != "converged"),
    }


def spoilt(name: str) -> Numbers:
    """What fits make of spikes, diving plane and ship, by kind."""
    kinds = {
        title: [case(world, kind, SPIKES, SPIKE_SEED) for world in DATA["spoilt"][name]]
        for kind, title in DATA["kinds"].items()
    }
    return {"kinds": kinds, "failed": sum(row["not_ok"] for pair in kinds.values() for row in pair)}


PAGE = Page(
    "estimation",
    {name: partial(worlds, name) for name in DATA["worlds"]}
    | {name: partial(spoilt, name) for name in DATA["spoilt"]},
)
