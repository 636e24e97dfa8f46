"""Limits that are stated beside those that vehicles keep: another integrator, waves, 25 % off.

    OMP_NUM_THREADS=1 python -m benchmarks.limits --vehicles 1000

The REMUS-like vehicle in the diving plane, dives of 60 s from 20 m, pitch within 45 degrees,
depth 2 to 60 m, random forces of 0.1 N, 0.3 N and 0.06 N m over 1 s. Each command is judged twice:
by `assess_limits` on vehicles drawn with coefficients up to `--spread` off, and by the equations of
`benchmarks.missing_physics.simulator` (Runge-Kutta at 0.01 s in plain NumPy, forces held for
0.1 s) on vehicles drawn anew. The two shares should differ by no more than two points.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

import numpy as np

from benchmarks.measure import machine, verdict
from benchmarks.missing_physics.fin import SAMPLE, STEP, SUBSTEPS, Fin
from benchmarks.missing_physics.simulator import PRIORS, Case, _Truth
from oed_sysid import Experiment, NoiseModel, load_problem
from oed_sysid.design import assess_limits
from oed_sysid.manoeuvres import ThreeTwoOneOne
from oed_sysid.noise.realisation import gauss_markov
from oed_sysid.simulation import simulate

FORCES, FORCE_TIME = np.array([0.1, 0.3, 0.06]), 1.0
DURATION, DEPTH, THRUST = 60.0, 20.0, 9.0
SPEED = math.sqrt(THRUST / 3.9)
PITCH, LEAST, MOST = math.radians(45.0), 2.0, 60.0


def kept(commands: np.ndarray, spread: float, n: int, rng: np.random.Generator) -> float:
    """Share of fresh vehicles that keep the limits under commands ``(n_times, 2)``."""
    cases = [
        Case("v", {p: v * (1 + spread * rng.uniform(-1, 1)) for p, v in PRIORS.items()})
        for _ in range(n)
    ]
    truth = _Truth(cases)
    times = np.arange(len(commands)) * SAMPLE
    forces = np.array(
        [[gauss_markov(level, FORCE_TIME, times, rng) for level in FORCES] for _ in range(n)]
    )
    state = np.zeros((9, n))
    state[0] = state[7] = SPEED
    state[4] = state[6] = DEPTH
    fin = Fin(truth, np.full(n, commands[0, 0]))
    inside = np.ones(n, dtype=bool)
    for k, time in enumerate(times):
        pitch, depth = state[3], state[4]
        inside &= (np.abs(pitch) <= PITCH) & (depth >= LEAST) & (depth <= MOST)
        if k + 1 == len(times):
            break
        fin.command(np.full(n, commands[k, 0]))
        thrust = np.full(n, commands[k, 1])
        for sub in range(SUBSTEPS):
            angle = fin.advance(sub)
            state = truth.advance(state, time + sub * STEP, angle, thrust, forces[:, :, k].T)
    return float(inside.mean())


def main() -> None:
    """Print stated and kept shares for several commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=1000)
    parser.add_argument("--spread", type=float, default=0.25)
    parser.add_argument("--degrees", type=float, nargs="+", default=[3.0, 6.0])
    options = parser.parse_args()
    print(machine())
    problem = load_problem("remus_diving_plane")
    sea = NoiseModel(
        np.array([output.noise_std for output in problem.model.outputs]), np.zeros(5), FORCES,
        force_time=FORCE_TIME, outputs=problem.model.output_names,
        places=("force X", "force Z", "force M"),
    )  # fmt: skip
    runs = [
        Experiment(
            f"3-2-1-1 of {size:g} deg",
            ThreeTwoOneOne("fin_command", math.radians(size), unit_time=3.0),
            duration=DURATION, sample_time=0.1, constants={"thrust": THRUST},
            initial={"u": SPEED, "z": DEPTH}, limits=problem.limits,
        )
        for size in options.degrees
    ]  # fmt: skip
    for number, run in enumerate(runs):
        rng = np.random.default_rng(10 + number)
        stated = assess_limits(problem.model, run, rng=rng, spread=options.spread,
                               n_vehicles=options.vehicles, sea=sea)  # fmt: skip
        free = replace(run, limits=type(run.limits)())
        commands = simulate(problem.model, free, noise=False).inputs
        found_share = kept(commands, options.spread, options.vehicles, rng)
        print(f"{run.name}: stated {stated.probability:.1%}, kept {found_share:.1%}; abort rules "
              f"fire on {stated.any_fires:.1%}", flush=True)  # fmt: skip
        gap = 100 * abs(stated.probability - found_share)
        print(verdict(f"  {run.name}: difference", gap, 2.0, "points"), flush=True)


if __name__ == "__main__":
    main()
