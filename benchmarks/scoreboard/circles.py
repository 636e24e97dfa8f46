"""KVLCC2: 35 degree turning circles from zigzags of at most 30 degrees."""

from __future__ import annotations

import math

from benchmarks.scoreboard.row import Row
from oed_sysid import MultipleShooting, load_problem
from oed_sysid.predictions.turning_circle import turning_circle

LENGTH = 7.0  # m
SHIP = {"speed": 1.179, "rate": math.radians(15.8), "length": LENGTH}
EFFECTS = ("helm_zero", "rudder_lift_shape", "propeller_wake_by_drift")
# Free-running tests of the 7 m model in lengths: Yasukawa & Yoshimura (2015), table 4.
MEASURED = {
    ("advance", "starboard"): (3.25, "-2.0 %"),
    ("advance", "port"): (3.11, "-1.8 %"),
    ("tactical_diameter", "starboard"): (3.34, "+3.1 %"),
    ("tactical_diameter", "port"): (3.08, "+6.2 %"),
}
SOURCE = "Alexandersson et al. (2022), Ocean Eng. 266"


def score() -> list[Row]:
    """Errors of the standard model of this package, per cent of the measured index."""
    ship = load_problem("kvlcc2", variant="mmg")
    model = ship.model + [ship.effect(name) for name in EFFECTS]
    circle = turning_circle(
        MultipleShooting(disturbances="none").fit(model, ship.data()), **SHIP, n_draws=0
    )
    rows = []
    for (quantity, side), (measured, published) in MEASURED.items():
        error = 100 * (circle.value(quantity, side) / LENGTH / measured - 1)
        what = f"KVLCC2 35 deg circle, {quantity.replace('_', ' ')} to {side}, error"
        note = f"MMG + {', '.join(EFFECTS)}; measured {measured} L"
        rows.append(Row(what, error, f"{published}, {SOURCE}", "%", note))
    return rows
