"""Question: does a plan survive the ship, from the file that steers her to going home?

A run is chosen, written as a controller and flown from that file by a ship that shares no code
with the model and has other coefficients. `oed-sysid watch` estimates while her log grows; then the
fit decides on another run. Logs, pages and the report go to out/fly_the_plan.
"""

import json
import runpy
import subprocess
import sys
import time as clock
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np

from oed_sysid import Dataset, MultipleShooting, load_problem, read_csv
from oed_sysid.design import candidate_runs, decide, goals_of, write_controller

place = Path("out/fly_the_plan")
place.mkdir(parents=True, exist_ok=True)
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
rows = (("inertia_Yv", "inertia_Yr"), ("inertia_Nv", "inertia_Nr"))
mass = np.array([[v[name] for name in row] for row in rows]) * [L, L**2] / V**2
damping = np.array([[off["Y_v"], off["Y_r"] * L], [off["N_v"], off["N_r"] * L]]) / V
inverse, rudder = np.linalg.inv(mass), np.array([off["Y_delta"], off["N_delta"]])


def sail(steer, log: Path) -> None:
    """The run in steps of a tenth of a second; the log gets a line with every sample."""
    x, heading = np.zeros(2), 0.0
    with log.open("w", encoding="utf-8", buffering=1) as lines:
        print("t [s],delta [rad],v [m/s],r [rad/s],psi [rad]", file=lines)
        for time in np.arange(0.0, pattern.duration + 0.1, pattern.sample_time):
            orders, ended = steer.step(time, {"psi": heading, "v": x[0], "r": x[1]})
            if ended:
                return print(f"  {time:4.0f} s  {ended}")
            noise = [one.noise_std * rng.standard_normal() for one in model.outputs]
            print(time, orders["delta"], *np.add([*x, heading], noise), sep=",", file=lines)
            clock.sleep(0.005)  # six hundred times as fast as the ship
            for _ in range(round(pattern.sample_time / 0.1)):
                x = x + 0.1 * inverse @ (damping @ x + rudder * orders["delta"])
                heading += 0.1 * x[1]


logs, known = [], model
while (decision := decide(known, runs, goals, rng=rng)).next_run is not None and len(logs) < 4:
    run, name = decision.next_run.experiment, f"run_{len(logs) + 1}"
    print(f"{name}: {run.name}")
    controller = runpy.run_path(str(write_controller(place / f"{name}.py", model, run, "ros2")))
    log, found = place / f"{name}.csv", place / f"{name}.json"
    log.touch()
    watch = [sys.executable, "-m", "oed_sysid", "watch", "online_ship", "--source", str(log)]
    watch += ["--silence", "1", "--goal", "2", "--html", str(found.with_suffix(".html"))]
    with subprocess.Popen([*watch, "--json", str(found)]) as watched:
        sail(controller["Run"](), log)
    assert watched.returncode == 0
    logs.append(read_csv(log, model.channels)[0])
    start = json.loads(found.read_text(encoding="utf-8"))["values"]
    known = fit = MultipleShooting().fit(model.with_values(start), Dataset(tuple(logs)))
fit.document().write(place / "report.html")
worst = max(abs(fit.values[name] / off[name] - 1) for name in fit.names)
print(decision.answer(len(logs), len(logs) * pattern.duration / 3600))
print(f"Conclusion: after {len(logs)} run(s) every coefficient is within {worst:.1%}: {place}")
