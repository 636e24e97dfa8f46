"""Slocum glider: speed through the water on dives that nothing was fitted to."""

from __future__ import annotations

from benchmarks.scoreboard.row import Row
from oed_sysid import MultipleShooting, load_problem

EFFECTS = ("inertia", "pitch_scale")
SOURCE = (
    "0.0285 m/s dynamic, 0.0480 m/s steady: Merckelbach et al. (2019), "
    "J. Atmos. Oceanic Technol. 36, fitted to the whole log"
)


def score() -> list[Row]:
    """Error of the speed on eight dives."""
    problem = load_problem("slocum_glider")
    data = problem.data()
    train, test = data.split(test=[name for name in data.names if name.startswith("test")])
    rows = []
    for effects in ((), EFFECTS):
        model = problem.model + [problem.effect(name) for name in effects]
        error = MultipleShooting(disturbances="none").fit(model, train).predict(test).rms["speed"]
        what = f"Slocum glider, speed on eight dives, {'steady' if not effects else 'with inertia'}"
        note = "three dives fitted" + (
            f"; {', '.join(effects)}, confirmed on these dives" if effects else ""
        )
        rows.append(Row(what, error, SOURCE, "m/s", note))
    return rows
