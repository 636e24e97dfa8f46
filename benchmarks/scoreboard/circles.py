"""KVLCC2: 35 degree turning circles from zigzags of at most 30 degrees."""

from __future__ import annotations

from benchmarks.scoreboard.row import Row
from oed_sysid import load_problem
from oed_sysid.prediction.structures import StructureAverage, average_structures, peak_input
from problems.kvlcc2.captive import captive_tests
from problems.kvlcc2.structures import HORIZON, SCORED, SIDES, candidates, circles

# Free-running tests of the 7 m model in lengths: Yasukawa & Yoshimura (2015), table 4.
MEASURED = {
    ("advance", "starboard"): (3.25, "-2.0 %"),
    ("advance", "port"): (3.11, "-1.8 %"),
    ("tactical_diameter", "starboard"): (3.34, "+3.1 %"),
    ("tactical_diameter", "port"): (3.08, "+6.2 %"),
}
SOURCE = "Alexandersson et al. (2022), Ocean Eng. 266, against circles of MARIN"
MODEL = "7 m model, table 4"


def score() -> list[Row]:
    """Errors of the average of structures, per cent of the measured index."""
    runs = load_problem("kvlcc2", variant="mmg").data()
    average = average_structures(
        candidates(runs),
        runs,
        purpose=circles,
        strength=peak_input("delta"),
        horizon=HORIZON,
        tests=captive_tests(),
        scored=[f"{quantity} {side}" for quantity in SCORED for side in SIDES],
    )
    print(average.report(), flush=True)
    return [row_of(*key, average) for key in MEASURED]


def row_of(quantity: str, side: str, average: StructureAverage) -> Row:
    """Error of the prediction of one index."""
    measured, published = MEASURED[quantity, side]
    name = f"{quantity} {side}"
    low, high = average.interval(name)
    return Row(
        f"KVLCC2 35 deg circle, {quantity.replace('_', ' ')} to {side}, error",
        100 * (average.values[name] / measured - 1),
        f"{published}, {SOURCE}",
        "%",
        f"predicted {average.values[name]:.2f} L, 95 % interval {low:.2f} to {high:.2f}; "
        f"measured {measured:g} L ({MODEL})",
    )
