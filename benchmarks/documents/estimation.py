"""Numbers of `docs/estimation.md`: what acts on records, what a fit states, how often it holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from benchmarks.documents.page import Numbers, Page
from benchmarks.random_forces.run import run
from benchmarks.spikes import case

SETS, SEED = 30, 6600
SPIKES, SPIKE_SEED = 20, 6601
# Vehicles of a row: world by name.
Vehicles = Mapping[str, str]
WORLDS: Mapping[str, tuple[str, Vehicles]] = {
    "white": (
        "nothing but noise of the sensors",
        {"diving plane": "white", "ship": "ship_white", "drone": "drone_white"},
    ),
    "forces": (
        "first-order forces: 2 s, 5 s, gusts of two samples",
        {
            "diving plane": "medium",
            "diving plane, 5 s": "medium_5s",
            "ship": "ship_gusts",
            "drone": "drone_gusts",
        },
    ),
    "swell": (
        "swell, 8 s (JONSWAP)",
        {
            "ship, zigzags": "ship_swell",
            "ship, rudder by the clock": "ship_designed",
            "drone": "drone_swell",
            "diving plane": "remus_swell",
        },
    ),
    "seas": (
        "two seas of equal power; a long-crested sea met by a ship that turns",
        {
            "ship, 10 and 5 s": "ship_two_seas",
            "drone, 8 and 4 s": "drone_two_seas",
            "ship, from the bow": "ship_bow_sea",
            "ship, from the stern": "ship_stern_sea",
        },
    ),
    "helm": (
        "a helmsman who answers a noisy heading",
        {"ship": "ship_helm_white", "ship, first-order forces": "ship_helm_gusts"},
    ),
}
KINDS: Mapping[str, str] = {
    "clean": "no spikes",
    "2%_20_up": "2 % of 20 standard deviations, one-sided",
    "2%_5": "2 % of 5",
    "bursts": "2 % in bursts of two to five, either sign",
    "zeros": "2 % that read zero, five to twenty samples",
    "held": "2 % held at the last value, five to twenty",
}
SPOILT: Mapping[str, Sequence[str]] = {
    "spikes": ("white", "ship_white"),
    "spikes_in_forces": ("medium", "ship_gusts"),
}


def worlds(name: str) -> Numbers:
    """What fits state of one kind of disturbance, by vehicle."""
    title, vehicles = WORLDS[name]
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
        title: [case(world, kind, SPIKES, SPIKE_SEED) for world in SPOILT[name]]
        for kind, title in KINDS.items()
    }
    return {"kinds": kinds, "failed": sum(row["not_ok"] for pair in kinds.values() for row in pair)}


PAGE = Page(
    "estimation",
    {name: partial(worlds, name) for name in WORLDS}
    | {name: partial(spoilt, name) for name in SPOILT},
)
