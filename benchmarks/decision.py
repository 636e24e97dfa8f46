"""Computing time of the decision to stop or to go on, for the problems shipped.

    OMP_NUM_THREADS=1 python -m benchmarks.decision [problems]

For every problem the library of candidate runs is made as `campaign` makes it, at the speeds of all
its experiments, on four vehicles 10 per cent off. What is known is the information of the first run
of the library, as after one run; the goal is half of the errors that it leaves, for every
parameter. The sea is moderate. The least processor time of three calls is taken, after a first one,
which is printed as well: a campaign has compiled its model when it fitted the run.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from benchmarks.harness import machine
from oed_sysid import load_problem
from oed_sysid.design import ParameterGoal, candidate_runs, decide
from oed_sysid.design.vehicles import draw_models
from oed_sysid.errors import OedSysidError
from oed_sysid.information import information_of, sea_noise

# Problem and variant.
CASES = (
    ("remus_diving_plane", None), ("online_ship", None), ("kvlcc2", "mmg"),
    ("nomoto_sparse_heading", None), ("torpedo", None), ("remus_6dof", None), ("esso_osaka", None),
)  # fmt: skip
TARGET, REPEATS = 1.0, 3


def timed(name: str, variant: str | None) -> str:
    """One row of the table."""
    problem = load_problem(name, variant=variant)
    model, rng = problem.model, np.random.default_rng(0)
    patterns = list(problem.experiments.values())
    vehicles = draw_models(model, 0.1, 4, None, rng)
    runs = candidate_runs(model, patterns, limits=problem.limits, rng=rng, vehicles=vehicles)
    sea = sea_noise(model, "moderate", patterns)
    known = information_of(model, runs[0].experiment, noise=sea)
    sizes = [model.parameter(n).reference for n in known.names]
    goals = [
        ParameterGoal(n, float(np.clip(0.5 * error / size, 1e-6, 5.0)))
        for n, error, size in zip(known.names, known.std_errors, sizes, strict=True)
    ]
    taken = []
    for _ in range(REPEATS + 1):
        began = time.process_time()
        found = decide(model, runs, goals, rng=np.random.default_rng(0), noise=sea, prior=known)
        taken.append(time.process_time() - began)
    samples = max(len(run.experiment.times) for run in runs)
    label = name if variant is None else f"{name}, {variant}"
    again = min(taken[1:])
    return (
        f"| {label} | {len(known.names)} | {len(runs)} runs of {samples} samples | "
        f"{found.action} | {taken[0]:.2f} | {again:.2f} | "
        f"{'met' if again < TARGET else 'MISSED'} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("problems", nargs="*", help="by default all that the package ships")
    chosen = parser.parse_args().problems
    print(machine())
    print("| problem | parameters | library | decision | first call, s | again, s "
          f"| target < {TARGET:g} s |")  # fmt: skip
    print("|---|---|---|---|---|---|---|")
    for name, variant in CASES:
        if chosen and name not in chosen:
            continue
        try:
            print(timed(name, variant), flush=True)
        except OedSysidError as error:
            print(f"| {name} | - | {error} | | | | | |", flush=True)


if __name__ == "__main__":
    main()
