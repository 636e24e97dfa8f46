"""How long a swarm takes: 100 particles, 300 generations, a record of 1,000 samples.

    python -m benchmarks.swarm

The diving plane of a REMUS-like vehicle, eight parameters within half and one
and a half times their values, started from the first samples. Particles are
simulated on all cores by threads (compiled code leaves Python's lock), so time
on the clock counts here.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from benchmarks.efficiency import NOISE, START, vehicle
from benchmarks.measure import machine, verdict
from oed_sysid import Dataset
from oed_sysid.baselines import DifferentialSwarm
from oed_sysid.data.record import Record
from oed_sysid.experiments.simulation import simulate_inputs

N_PARTICLES, N_GENERATIONS, N_SAMPLES = 100, 300, 1000


def main() -> None:
    """Print the time of the search."""
    model = vehicle()
    for parameter in model.free_parameters:
        lower, upper = sorted((0.5 * parameter.value, 1.5 * parameter.value))
        model = model.with_parameter(replace(parameter, lower=lower, upper=upper))
    times = 0.1 * np.arange(N_SAMPLES)
    fin = 0.1 * np.sign(np.sin(2 * np.pi * times / 14.0))
    run = simulate_inputs(model, times, inputs={"fin_command": fin, "thrust": 9.0}, initial=START)
    noise = NOISE * np.random.default_rng(0).standard_normal(run.outputs.shape)
    data = Dataset((Record("dive", times, run.inputs, run.outputs + noise, model.channels),))
    swarm = DifferentialSwarm(
        n_particles=N_PARTICLES, n_generations=N_GENERATIONS, tolerance=0.0, initial=START
    )
    swarm.fit(model, data)
    began, cpu = time.perf_counter(), time.process_time()
    fit = swarm.fit(model, data)
    clock, used = time.perf_counter() - began, time.process_time() - cpu
    n_runs = fit.extras["evaluations"]
    worst = max(abs(fit.values[n] - model.values[n]) / fit.std_errors[n] for n in model.free_names)
    print(machine())
    print(
        f"{fit.iterations} generations, {n_runs} simulations of {N_SAMPLES} samples, processor "
        f"time {used:.1f} s ({1e6 * used / n_runs:.0f} us each); largest error {worst:.1f} "
        f"standard errors"
    )
    print(verdict("swarm, time on the clock", clock, 15.0, "s"))


if __name__ == "__main__":
    main()
