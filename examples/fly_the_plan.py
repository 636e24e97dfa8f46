"""Question: does a plan survive the ship, from the file that steers her to going home?

A run is chosen, written as a controller and flown from that file by a ship that shares no code
with the model and has other coefficients. Estimates go along; then the fit decides on another run.
"""

import runpy
from dataclasses import replace
from math import radians
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from oed_sysid import Dataset, MultipleShooting, Record, load_problem
from oed_sysid.baselines import FourierStream
from oed_sysid.design import candidate_runs, decide, goals_of, write_controller

problem = load_problem("online_ship")
rng = np.random.default_rng(5)
# This helm holds an order from one sample to the next.
held = replace(problem.model.inputs[0], interpolation="hold")
model = replace(problem.model, inputs=(held,))
limits = replace(problem.limits, inputs={"delta": (radians(-20), radians(20))})
pattern = problem.experiment("zigzag_10_10")
runs = candidate_runs(model, pattern, limits=limits, rng=rng, kinds=("zigzag",))
goals = goals_of(model, {"all": 0.02})

# The ship herself: every coefficient off by up to 15 %, in matrices of her own.
V, L, v = model.values["V"], model.values["L"], model.values
off = {name: v[name] * (1 + 0.15 * rng.uniform(-1, 1)) for name in model.free_names}
mass = [
    [L * v["inertia_Yv"], L**2 * v["inertia_Yr"]],
    [L * v["inertia_Nv"], L**2 * v["inertia_Nr"]],
]
damping = [[off["Y_v"] / V, off["Y_r"] * L / V], [off["N_v"] / V, off["N_r"] * L / V]]
inverse, rudder = np.linalg.inv(np.array(mass) / V**2), [off["Y_delta"], off["N_delta"]]


def sail(name: str, steer, told: FourierStream) -> Record:
    """The run in steps of a tenth of a second; estimates are said on the way."""
    x, heading, rows = np.zeros(2), 0.0, []
    for k in range(int(pattern.duration / pattern.sample_time) + 1):
        time = k * pattern.sample_time
        orders, ended = steer.step(time, {"psi": heading, "v": x[0], "r": x[1]})
        if ended:
            print(f"  {time:4.0f} s  {ended}")
            break
        seen = np.array([*x, heading]) + [
            o.noise_std * rng.standard_normal() for o in model.outputs
        ]
        told.push(
            time, dict(zip(("delta", "v", "r", "psi"), (orders["delta"], *seen), strict=True))
        )
        rows.append([time, orders["delta"], *seen])
        if k % 75 == 74:
            print(f"  {time:4.0f} s  {told.advice(0.02)}")
        for _ in range(30):
            x = x + 0.1 * inverse @ (damping @ x + np.multiply(rudder, orders["delta"]))
            heading += 0.1 * x[1]
    table = np.array(rows)
    return Record(name, table[:, 0], table[:, 1:2], table[:, 2:], model.channels)


logs, known = [], model
while (decision := decide(known, runs, goals, rng=rng)).next_run is not None and len(logs) < 4:
    run = decision.next_run.experiment
    print(f"Run {len(logs) + 1}: {run.name}")
    with TemporaryDirectory() as folder:
        file = write_controller(Path(folder) / "run.py", model, run, "ros2")
        controller = runpy.run_path(str(file))["Run"]()
    stream = FourierStream(model, duration=pattern.duration, period=pattern.sample_time)
    logs.append(sail(f"run {len(logs) + 1}", controller, stream))
    fit = MultipleShooting().fit(model.with_values(stream.values), Dataset(tuple(logs)))
    known = fit
worst = max(abs(fit.values[name] / off[name] - 1) for name in fit.names)
print(decision.answer(len(logs), len(logs) * pattern.duration / 3600))
print(
    f"Conclusion: after {len(logs)} run(s) every coefficient is within {worst:.1%} of the ship's."
)
