"""Question: why does a tanker model in a pond not go where its model says?

Twelve measured runs of a 3 m model of Esso Osaka. Seven are there to learn from, five nobody
touches. A model without wind is fitted; `improve` is asked what it lacks, among sensors,
rudder, hull, current and wind, and confirms it on windows kept for that; the answer is added and
fitted, and both models predict the untouched runs in windows of 100 s, each from its first
measured sample.
"""

import numpy as np

from oed_sysid import Dataset, MultipleShooting, improve, load_problem
from oed_sysid.experiments.simulation import simulate_inputs

UNTOUCHED = ("zigzag_12_30", "zigzag_12_20", "turn_10_port_35", "turn_10_starboard_20", "random_6")
PUBLISHED = np.array([0.044, 0.029, np.radians(0.97)])  # rms u, v, r: simulator of the source

problem = load_problem("esso_osaka")
train, test = problem.data().split(test=UNTOUCHED)


def pieces(runs, duration):
    """Windows of about one length; every one begins from where the ship was measured to be."""
    return Dataset(tuple(part for run in runs for part in run.segments(duration)))


def errors(model, runs):
    """Rms error of u, v and r for each run, 100 s ahead, over that of the published simulator."""
    found = {}
    for run in runs:
        parts = []
        for part in run.segments(100.0):
            start = dict(zip(model.state_names, part.outputs[0], strict=True))
            ahead = simulate_inputs(model, part.times, inputs=part.inputs, initial=start)
            parts.append((ahead.outputs - part.outputs)[:, :3])
        found[run.name] = np.sqrt(np.mean(np.vstack(parts) ** 2, axis=0)) / PUBLISHED
    return found


estimator = MultipleShooting(disturbances="none", noise="given")
calm = estimator.fit(problem.model, pieces(train, 25.0))
windows = [run.thin(4) for run in pieces(train, 100.0) if "random" not in run.name]
confirming = windows[1::3]
learning = [window for window in windows if window not in confirming]
improvement = improve(
    calm.model,
    Dataset(tuple(learning)),
    Dataset(tuple(confirming)),
    candidates=problem.effects,
    max_effects=2,
)
print(improvement.report())
print()

first = problem.effect(improvement.steps[0].added)
found = estimator.fit(calm.model + first, pieces(train, 25.0))
print(f"{first.name}:")
for name in first.amplitude_names:
    low, high = found.interval(name)
    print(f"  {name:12}{found.values[name]:7.3f}, 95 % interval {low:6.3f} to {high:6.3f}")
print()
print("error 100 s ahead on untouched runs, over that of the published simulator: u, v, r")
before, after = errors(calm.model, test), errors(found.model, test)
for name in before:
    pair = ["  ".join(f"{share:.2f}" for share in one[name]) for one in (before, after)]
    print(f"  {name:22} without {pair[0]}   with {pair[1]}")
print()
mean = [float(np.mean(list(one.values()))) for one in (before, after)]
print(
    f"Conclusion: {', '.join(step.added for step in improvement.steps)} is missing from the "
    "model. On runs that nobody touched the error "
    f"falls from {mean[0]:.2f} to {mean[1]:.2f} of the published simulator's."
)
