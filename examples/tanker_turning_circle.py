"""Question: do zigzags alone tell how large a tanker's turning circle is?

Ten zigzags of the KVLCC2 tanker hold at most 30 degrees of rudder; the circle has 35, more drift
and a third of the speed. Several models fit the zigzags and differ in the circle. Each is asked how
well it carries beyond what it was fitted to: from weak runs to strong ones, to forces of captive
tests that nobody fitted, and whether its circle stays where it is as runs are added. Their average
by these scores, with its 95 % interval, is the answer. Circles of a 7 m model of this hull are
published and were used for no fit.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))  # for problems/, read from here

from oed_sysid import load_problem
from problems.kvlcc2.averaging import average_structures, peak_input
from problems.kvlcc2.captive import captive_tests
from problems.kvlcc2.structures import (
    HORIZON,
    SCORED,
    SIDES,
    candidates,
    circles,
)

# Yasukawa & Yoshimura (2015), table 4, free-running tests, in lengths.
PUBLISHED = {
    "advance starboard": 3.25,
    "advance port": 3.11,
    "tactical_diameter starboard": 3.34,
    "tactical_diameter port": 3.08,
}

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
print(average.report())

print(
    "\nin lengths                    average  95 % interval   whole runs of MMG  published  error"
)
alone = next(one for one in average.structures if one.name == "MMG, whole runs")
held, errors = 0, []
for name, published in PUBLISHED.items():
    low, high = average.interval(name)
    value = average.values[name]
    held += low <= published <= high
    errors.append(abs(value / published - 1))
    print(
        f"{name:28s}{value:8.2f}   {low:.2f} to {high:.2f}   {alone.values[name]:15.2f} "
        f"{published:10.2f} {100 * (value / published - 1):+6.1f} %"
    )
print(
    f"\nYes, to {100 * sum(errors) / len(errors):.1f} % on the mean; {held} of {len(errors)} "
    "published indices lie in their 95 % intervals. The heaviest structure, "
    f"{average.structures[0].name}, has {100 * average.structures[0].weight:.0f} % of the weight; "
    "no single test would have chosen it, and no single structure says how sure the answer is."
)
