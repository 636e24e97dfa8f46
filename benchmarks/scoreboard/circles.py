"""KVLCC2: 35 degree turning circles from zigzags of at most 30 degrees."""

from __future__ import annotations

import csv

from benchmarks.scoreboard.row import Row, missing, place
from oed_sysid import load_problem
from oed_sysid.predictions.structures import average_structures, peak_input
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
# Columns side, quantity, lengths: indices of circles that are not part of this repository.
JUDGES = "kvlcc2_circles/indices.csv"


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
    measured = {key: (value, text, "7 m model, table 4") for key, (value, text) in MEASURED.items()}
    judges = place(JUDGES)
    rows = []
    if judges.is_file():
        with judges.open(newline="", encoding="utf-8") as lines:
            for side, quantity, value in list(csv.reader(lines))[1:]:
                published = MEASURED.get((quantity, side), (0.0, "-"))[1]
                measured[quantity, side] = (float(value), published, JUDGES)
    else:
        what = "side,quantity,lengths of circles measured from positions"
        rows.append(missing("KVLCC2 35 deg circles of another basin", SOURCE, JUDGES, what))
    for (quantity, side), (value, published, whose) in measured.items():
        name = f"{quantity} {side}"
        low, high = average.interval(name)
        error = 100 * (average.values[name] / value - 1)
        note = (
            f"predicted {average.values[name]:.2f} L, 95 % interval {low:.2f} to {high:.2f}; "
            f"measured {value} L ({whose})"
        )
        what = f"KVLCC2 35 deg circle, {quantity.replace('_', ' ')} to {side}, error"
        rows.append(Row(what, error, f"{published}, {SOURCE}", "%", note))
    return rows
