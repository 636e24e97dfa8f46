"""Question: how well do two zigzags determine the steering of a ship?

A first-order steering model is written down, two zigzags are simulated with
noise, and the parameters are estimated from them. Everything a real log would
need is the same, except that `read_csv` takes the place of `simulate`.
"""

from math import radians

import numpy as np

from oed_sysid import (
    Dataset,
    Experiment,
    Input,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    State,
    ZigZag,
)
from oed_sysid.experiments.simulation import simulate

TRUE = {"K": 0.1, "T": 12.0}

ship = Model(
    name="first-order steering",
    states=(State("psi", "rad", "heading"), State("r", "rad/s", "yaw rate", scale=0.02)),
    inputs=(Input("rudder", "rad", "rudder angle"),),
    outputs=(
        Output("psi", "rad", "heading", noise_std=0.002),
        Output("r", "rad/s", "yaw rate", noise_std=0.001),
    ),
    kinematics={"psi": "r", "r": "(K*rudder - r)/T"},
    parameters=(
        Parameter("K", 0.05, "1/s", description="rudder gain, a guess"),
        Parameter("T", 5.0, "s", lower=0.5, description="time constant, a guess"),
    ),
)

rng = np.random.default_rng(1)
runs = [
    Experiment(
        f"zigzag_{degrees}",
        ZigZag("rudder", radians(degrees), radians(degrees)),
        duration=200.0,
        sample_time=0.5,
    )
    for degrees in (10, 20)
]
data = Dataset(tuple(simulate(ship.with_values(TRUE), run, rng=rng) for run in runs))

fit = MultipleShooting().fit(ship, data)
print(fit.report())

print()
for name, truth in TRUE.items():
    low, high = fit.interval(name)
    inside = "contains" if low <= truth <= high else "misses"
    print(f"{name}: 95 % interval {low:.5g} to {high:.5g} {inside} the true {truth:g}")
