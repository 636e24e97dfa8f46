"""Time and memory of a search for missing physics in half an hour at 50 Hz.

    OMP_NUM_THREADS=1 python -m benchmarks.long_search

One dive of a REMUS-like vehicle, 90,000 samples of five outputs, the vocabulary of the shipped
problem as candidates; a quadratic drag in heave is hidden. Targets: 60 s and 1.5 GB. The search is
handed the whole record and splits it itself. With ``--samples N`` a shorter dive.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Sequence

import numpy as np

from benchmarks.efficiency import NOISE, START
from benchmarks.measure import machine, verdict
from oed_sysid import Dataset, Record, improve, load_problem
from oed_sysid.experiments.simulation import simulate_inputs

SAMPLES, STEP = 90_000, 0.02
HIDDEN = {"Zww": -40.0}


def main(arguments: Sequence[str] | None = None) -> None:
    """Simulate, search and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=SAMPLES)
    samples = parser.parse_args(arguments).samples
    problem = load_problem("remus_diving_plane")
    hidden = next(e for e in problem.effects if e.name == "heave_crossflow_drag")
    names = [p.name for p in hidden.parameters]
    truth = (problem.model + hidden).with_values(dict(zip(names, HIDDEN.values(), strict=True)))
    times = STEP * np.arange(samples)
    fin = 0.1 * np.sign(np.sin(2 * np.pi * times / 14.0)) + 0.05 * np.sin(0.9 * times)
    run = simulate_inputs(truth, times, inputs={"fin_command": fin, "thrust": 9.0}, initial=START)
    noise = NOISE * np.random.default_rng(0).standard_normal(run.outputs.shape)
    model = problem.model
    data = Dataset((Record("dive", times, run.inputs, run.outputs + noise, model.channels),))
    print(machine())
    wall, processor = time.perf_counter(), time.process_time()
    found = improve(model, data, candidates=problem.effects)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    added = ", ".join(step.added for step in found.steps) or "nothing"
    label = f"improve, {samples} samples, {len(problem.effects)} candidates ({added})"
    print(verdict(label, wall, 60.0, "s"))
    print(f"processor time {processor:.1f} s")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(verdict("peak memory", peak, 1.5, "GiB"))


if __name__ == "__main__":
    main()
