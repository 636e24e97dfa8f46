"""Question: which K and T does a tanker have, and does it matter how one asks?

Nomoto's equation, T r' + r = K delta, on three zigzag tests of the KVLCC2
tanker (7 m model, HSVA). Published: K = -0.2559 1/s, T = 15.68 s, the mean of
these runs, from the difference equation r(k+1) - r(k) = h/T (K delta(k) - r(k))
with 100 steps of h = 1.5 s. A positive rudder turns this ship to port.
"""

import numpy as np

from oed_sysid import Dataset, MultipleShooting, load_problem

STEP = 1.5  # s, three samples of the records
RUNS = ("25_05", "15_05", "10_01")
AVERAGE = np.array([0.5, 1.0, 1.0, 0.5]) / 3

problem = load_problem("kvlcc2")
records = problem.data()


def difference_equation(record, *, averaged):
    """K and T by least squares; `averaged` takes means over each step, not its first sample."""
    ends = np.arange(0, 303, 3)
    rate, rudder = record.output("r"), record.input("delta")
    if averaged:
        means = [[AVERAGE @ s[k : k + 4] for k in ends[:-1]] for s in (rate, rudder)]
        features = np.column_stack(means)
    else:
        features = np.column_stack([rate[ends[:-1]], rudder[ends[:-1]]])
    first, second = np.linalg.lstsq(features, np.diff(rate[ends]), rcond=None)[0]
    return -second / first, -STEP / first


# A trajectory asks more than a difference: over a whole run, errors of the model add up.
print("run      as published      averaged          multiple shooting")
found = []
for name in RUNS:
    record = records[name]
    fit = MultipleShooting(disturbances="none").fit(problem.model, Dataset((record,)))
    ways = [
        difference_equation(record, averaged=False),
        difference_equation(record, averaged=True),
        (fit.values["K"], fit.values["T"]),
    ]
    found.append(ways)
    print(f"{name:8s}", *(f"K {gain:.3f}  T {time:4.1f}  " for gain, time in ways))
means = np.mean(found, axis=0)
print("mean    ", *(f"K {gain:.3f}  T {time:4.1f}  " for gain, time in means))

published = problem.published
gain, time = found[RUNS.index("15_05")][1]
print()
print(
    f"Published: K {published['K']:.3f}, T {published['T']:.1f}: what the averaged difference "
    f"equation finds on the 15/5 run alone (K {gain:.3f}, T {time:.1f}). Taking the rudder at the "
    "start of each step instead of its mean costs a third of T. And the three runs do not agree: "
    "a ship whose damping grows with its turning rate has no K and T, only a K and T per test."
)
