"""Question: after how many samples does a tanker know its own K and T?

The measured 15/5 zigzag of the KVLCC2 model (HSVA) is fed sample by sample to
the on-line LS-SVM, as it would be on board: every 1.5 s one more row of
Nomoto's difference equation, r(k+1) - r(k) = h/T (K delta - r), with rudder and
rate averaged over the step. Two recursions of the same estimator run side by side:
the published one, which carries an inverse, and the one of flat cost. They ought to
agree at every sample; whether they do depends on the weight C. K and T with their
95 % bands over the time of the samples are drawn in tanker_on_line.png.
"""

import warnings

import numpy as np

from oed_sysid import load_problem
from oed_sysid.baselines.online import IncrementalLSSVM, RecursiveLSSVM
from oed_sysid.errors import PrecisionWarning
from oed_sysid.results import new_figure, plot_history, save_figure

STEP, WEIGHT = 1.5, 1e8  # s; a large C: features and targets are small numbers
AVERAGE = np.array([0.5, 1.0, 1.0, 0.5]) / 3  # over the four records' samples of a step

problem = load_problem("kvlcc2")
record = problem.data()["15_05"]
rate, rudder = record.output("r"), record.input("delta")
ends = np.arange(0, 303, 3)
rows = np.array([[AVERAGE @ s[k : k + 4] for s in (rate, rudder)] for k in ends[:-1]])
targets = np.diff(rate[ends])

published = {C: IncrementalLSSVM(C=C, method="inverse") for C in (3e5, WEIGHT)}
flat = RecursiveLSSVM(C=WEIGHT)
for machine in (*published.values(), flat):
    machine.start(rows[:2], targets[:2])
history = []
for row, target in zip(rows[2:], targets[2:], strict=True):
    for machine in (*published.values(), flat):
        machine.update(row, target)
    by_rate, by_rudder = flat.coefficients
    # Standard errors of K and T from the spread of the residuals so far, to first order.
    seen = len(history) + 3
    variance = np.mean((targets[:seen] - flat.predict(rows[:seen])) ** 2)
    slopes = np.array([[by_rudder / by_rate, -1.0], [STEP / by_rate, 0.0]]) / by_rate
    stds = np.sqrt(variance * np.diag(slopes @ flat.inverse[:2, :2] @ slopes.T))
    history.append((-by_rudder / by_rate, -STEP / by_rate, *stds))

figure, axes = new_figure(2, 1, size=(6.4, 4.4), sharex=True)
times, values = STEP * np.arange(3, 3 + len(history)), np.array(history)
for k, (name, unit) in enumerate((("K", "1/s"), ("T", "s"))):
    ax = axes[k, 0]
    plot_history(times, values[:, k], values[:, 2 + k], name=name, unit=unit, ax=ax)
axes[1, 0].set_xlabel("time [s]")
save_figure(figure, "tanker_on_line.png")

print("samples   K [1/s]    T [s], 95 %")
for count in (10, 20, 30, 50, 70, 100):
    gain, time, _, spread = history[count - 3]
    print(f"{count:7d}   {gain:7.3f}   {time:5.1f} ± {1.96 * spread:.1f}")
found = values[:, :2]
away = np.abs(found / found[-1] - 1).max(axis=1)
settled = 3 + int(np.flatnonzero(away > 0.1)[-1]) + 1
print()
for weight, machine in published.items():
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", PrecisionWarning)
        by_rate, by_rudder = machine.coefficients
    print(
        f"published recursion, C = {weight:.0e}: K = {-by_rudder / by_rate:.3f} 1/s, "
        f"T = {-STEP / by_rate:.1f} s; its equations are met to {machine.residual:.0e} of the "
        f"targets{', and it warns' if said else ''}"
    )
print()
print(
    f"On line, K = {found[-1, 0]:.3f} 1/s and T = {found[-1, 1]:.1f} s after 100 samples; both "
    f"stay within 10 % of that from sample {settled} on (published: 50)."
)
