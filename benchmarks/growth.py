"""How time and memory of a fit grow with the record.

    OMP_NUM_THREADS=1 python -m benchmarks.growth

The diving plane of a REMUS-like vehicle, eight parameters 10 % off, one record
of 1,000 to 100,000 samples; every size in a process of its own, so that its
peak memory is its own. All sizes take the same way (``start="near"``: a long
record of a wrong model drifts further from the measurements, which the default
would answer with its wide way in). Iterations differ by what the data hold; the
time of one iteration per sample should stay the same.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

from benchmarks.efficiency import NOISE, START, vehicle
from benchmarks.measure import machine, verdict
from oed_sysid import Dataset, MultipleShooting
from oed_sysid.data.record import Record
from oed_sysid.experiments.simulation import simulate_inputs

SIZES = (1_000, 3_000, 10_000, 30_000, 100_000)
STEP = 0.1


def measure(n_samples: int) -> None:
    """Print least time of a fit (s), its iterations and the peak memory (bytes)."""
    model = vehicle()
    times = STEP * np.arange(n_samples)
    fin = 0.1 * np.sign(np.sin(2 * np.pi * times / 14.0)) + 0.05 * np.sin(0.9 * times)
    run = simulate_inputs(model, times, inputs={"fin_command": fin, "thrust": 9.0}, initial=START)
    noise = NOISE * np.random.default_rng(0).standard_normal(run.outputs.shape)
    data = Dataset((Record("dive", times, run.inputs, run.outputs + noise, model.channels),))
    start = model.with_values({n: 0.9 * model.values[n] for n in model.free_names})
    for parameter in start.free_parameters:
        start = start.with_parameter(replace(parameter, prior_mean=None, prior_std=None))
    repeats, found = max(3, min(20, 30_000 // n_samples)), []
    for _ in range(repeats):
        began = time.process_time()
        fit = MultipleShooting(disturbances="none", noise="given", start="near").fit(start, data)
        found.append(time.process_time() - began)
    assert fit.status.ok, fit.status
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(f"{min(found)} {fit.iterations} {peak}")


def main() -> None:
    """Print the table."""
    if len(sys.argv) > 1:
        measure(int(sys.argv[1]))
        return
    print(machine())
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    rows = []
    print(f"{'samples':>8} {'fit, s':>8} {'iterations':>10} {'us/sample/iteration':>20} {'MiB':>6}")
    for n_samples in SIZES:
        command = [sys.executable, "-m", "benchmarks.growth", str(n_samples)]
        told = subprocess.run(
            command, check=True, capture_output=True, text=True, env=environment
        ).stdout.split()
        seconds, iterations, peak = float(told[-3]), int(told[-2]), float(told[-1])
        each = 1e6 * seconds / n_samples / iterations
        rows.append((n_samples, each, peak))
        print(
            f"{n_samples:>8} {seconds:>8.3f} {iterations:>10} {each:>20.2f} {peak / 2**20:>6.0f}",
            flush=True,
        )
    by_size = {n: each for n, each, _ in rows}
    growth = by_size[SIZES[-1]] / by_size[SIZES[0]] - 1.0
    print(verdict("time per sample and iteration, 100,000 / 1,000, growth", growth, 0.15))
    print(verdict("peak memory", max(peak for *_, peak in rows) / 2**30, 1.0, "GiB"))


if __name__ == "__main__":
    main()
