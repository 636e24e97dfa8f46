"""Limits that are stated beside those that vehicles keep: another integrator, waves, 25 % off.

    OMP_NUM_THREADS=1 python -m benchmarks.limits --vehicles 5000 --spread 0.2 0.3

The REMUS-like vehicle in the diving plane, dives of 60 s from 20 m, pitch within 45 degrees,
depth 2 to 60 m, disturbance forces of 0.1 N, 0.3 N and 0.06 N m over 1 s. Each command is judged
twice:
by `assess_limits` on vehicles drawn with coefficients up to `--spread` off, and by the equations of
`benchmarks.missing_physics.simulator` (Runge-Kutta at 0.01 s in plain NumPy, forces held for
0.1 s, limits looked at every 0.01 s) on vehicles drawn anew. The commands are 3-2-1-1s of
`--degrees`, and one designed with caution at a sample of `--sample`, of which the share on the card
is taken. The two shares should differ by no more than two points; both are counts, and the standard
error of their difference is printed beside it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.harness import machine, verdict
from benchmarks.missing_physics.simulator import PRIORS, SAMPLE, STEP, SUBSTEPS, Case, Fin, _Truth
from oed_sysid import Experiment, NoiseModel, Problem, load_problem
from oed_sysid.design import (
    Caution,
    Design,
    DOptimal,
    Knowledge,
    Levels,
    Search,
    Trial,
    assess_limits,
    design_experiment,
)
from oed_sysid.errors import DesignError
from oed_sysid.experiments.manoeuvres import ThreeTwoOneOne
from oed_sysid.experiments.simulation import simulate

FORCES, FORCE_TIME = np.array([0.1, 0.3, 0.06]), 1.0
DURATION, DEPTH, THRUST = 60.0, 20.0, 9.0
SPEED = math.sqrt(THRUST / 3.9)
BATCH = 2000  # vehicles side by side: what fits into the processor's cache
PITCH, LEAST, MOST = math.radians(45.0), 2.0, 60.0


def forces_of(n: int, times: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Random forces ``(n_times, 3, n)`` of vehicles side by side, stationary."""
    memory = math.exp(-SAMPLE / FORCE_TIME)
    forces = rng.standard_normal((len(times), 3, n))
    forces[1:] *= math.sqrt(1 - memory**2)
    for k in range(1, len(times)):
        forces[k] += memory * forces[k - 1]
    return forces * FORCES[:, None]


def kept(commands: np.ndarray, spread: float, n: int, rng: np.random.Generator) -> float:
    """Share of fresh vehicles that keep the limits under commands ``(n_times, 2)``."""
    times = np.arange(len(commands)) * SAMPLE
    found = 0
    for begin in range(0, n, BATCH):
        count = min(BATCH, n - begin)
        vehicles = [
            {p: v * (1 + spread * rng.uniform(-1, 1)) for p, v in PRIORS.items()}
            for _ in range(count)
        ]
        forces = forces_of(count, times, rng)
        found += int(inside(commands[:, :, None], vehicles, forces, (SPEED, DEPTH)).sum())
    return found / n


def inside(
    commands: np.ndarray,
    vehicles: Sequence[Mapping[str, float]],
    forces: np.ndarray,
    start: tuple[float, float],
) -> np.ndarray:
    """Which vehicles keep the limits, side by side.

    Parameters
    ----------
    commands : ndarray (n_times, 2, n_vehicles or 1)
        Fin, rad, and thrust, N, held from sample to sample.
    vehicles : sequence of mapping
        Derivatives by name.
    forces : ndarray (n_times, 3, n_vehicles)
        X, Z in N, M in N m, held from sample to sample.
    start : tuple of float
        Speed, m/s, and depth, m.

    Returns
    -------
    ndarray of bool (n_vehicles,)
    """
    n = len(vehicles)
    truth = _Truth([Case("v", values) for values in vehicles])
    commands = np.broadcast_to(commands, (*commands.shape[:2], n))
    state = np.zeros((9, n))
    state[0] = state[7] = start[0]
    state[4] = state[6] = start[1]
    fin = Fin(truth, commands[0, 0])
    kept = np.ones(n, dtype=bool)
    for k in range(len(commands) - 1):
        fin.command(commands[k, 0])
        for sub in range(SUBSTEPS):
            time = k * SAMPLE + sub * STEP
            state = truth.advance(state, time, fin.advance(sub), commands[k, 1], forces[k])
            pitch, depth = state[3], state[4]
            kept &= (np.abs(pitch) <= PITCH) & (depth >= LEAST) & (depth <= MOST)
    return kept


def designed(problem: Problem, sea: NoiseModel, spread: float, sample: float) -> Design:
    """Design a dive that keeps its limits on 95 % of the vehicles."""
    return design_experiment(
        problem.model,
        Trial(
            limits=problem.limits,
            duration=DURATION,
            sample_time=sample,
            constants={"thrust": THRUST},
            initial={"u": SPEED, "z": DEPTH},
        ),
        rng=np.random.default_rng(1),
        criterion=DOptimal(),
        caution=Caution(0.95, spread=spread, n_sets=60, n_checks=3000),
        search=Search(family=Levels(20), n_starts=1, n_candidates=20, n_steps=15, n_workers=1),
        knowledge=Knowledge(noise=sea),
    )


def compared(name: str, stated: float, n_stated: int, found: float, n_found: int) -> str:
    """Both shares and their difference, with its standard error."""
    error = math.sqrt(stated * (1 - stated) / n_stated + found * (1 - found) / n_found)
    line = verdict(f"  {name}: difference", 100 * abs(stated - found), 2.0, "points")
    return (
        f"{name}: stated {stated:.1%} ({n_stated} vehicles), kept {found:.1%} ({n_found})\n"
        f"{line} (standard error {100 * error:.1f})"
    )


def main() -> None:
    """Print stated and kept shares for several commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vehicles", type=int, default=1000)
    parser.add_argument("--spread", type=float, nargs="+", default=[0.25])
    parser.add_argument("--degrees", type=float, nargs="*", default=[3.0, 6.0])
    parser.add_argument(
        "--sample",
        type=float,
        nargs="*",
        default=[0.5],
        help="of designed dives, s; none for no design",
    )
    options = parser.parse_args()
    print(machine())
    problem = load_problem("remus_diving_plane")
    sea = NoiseModel(
        np.array([output.noise_std for output in problem.model.outputs]),
        np.zeros(5),
        FORCES,
        force_time=FORCE_TIME,
        outputs=problem.model.output_names,
        places=("force X", "force Z", "force M"),
    )
    runs = [
        Experiment(
            f"3-2-1-1 of {size:g} deg",
            ThreeTwoOneOne("fin_command", math.radians(size), unit_time=3.0),
            duration=DURATION,
            sample_time=0.1,
            constants={"thrust": THRUST},
            initial={"u": SPEED, "z": DEPTH},
            limits=problem.limits,
        )
        for size in options.degrees
    ]
    n = options.vehicles
    for number, spread in enumerate(options.spread):
        for index, run in enumerate(runs):
            rng = np.random.default_rng([10, number, index])
            stated = assess_limits(problem.model, run, rng=rng, spread=spread, vehicles=n, sea=sea)
            free = replace(run, limits=type(run.limits)())
            commands = simulate(problem.model, free, noise=False).inputs
            print(
                compared(
                    f"{run.name}, {spread:.0%} off",
                    stated.probability,
                    n,
                    kept(commands, spread, n, rng),
                    n,
                ),
                flush=True,
            )
        for sample in options.sample:
            try:
                design = designed(problem, sea, spread, sample)
            except DesignError as error:
                print(f"designed at {sample:g} s, {spread:.0%} off: {error}", flush=True)
                continue
            rows = np.repeat(design.trajectory.inputs[:-1], round(sample / SAMPLE), axis=0)
            commands = np.vstack([rows, rows[-1:]])
            found = kept(commands, spread, n, np.random.default_rng([11, number]))
            card = design.assurance
            assert card is not None
            print(
                compared(
                    f"designed at {sample:g} s, {spread:.0%} off",
                    card.probability,
                    card.n_checked,
                    found,
                    n,
                ),
                flush=True,
            )


if __name__ == "__main__":
    main()
