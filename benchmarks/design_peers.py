"""The same excitation designed by us and by Pyomo.DoE: what it tells, how long it takes.

    OMP_NUM_THREADS=1 python -m benchmarks.design_peers [cases] [--python PATH]

The peer runs in a process of its own with the interpreter of ``--python`` (``pip install pyomo
numpy scipy pandas packaging`` there) and begins with a square wave; ``--begin ours`` lets it try to
improve on our design instead. Each tool is asked for the criterion that it is judged by. Both
designs are judged by our information, and simulated against the limits. Times are on the clock,
processor times in brackets.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import radians
from pathlib import Path

import numpy as np

from benchmarks.design import CRITERIA as OURS
from benchmarks.design import remus
from benchmarks.fit_peers import run_peer
from benchmarks.harness import command, known, machine
from oed_sysid import Experiment, Model, information_of
from oed_sysid.design import Design, Knowledge, Levels, Search, design_experiment
from oed_sysid.design.library import as_piecewise
from oed_sysid.experiments.simulation import Trajectory, simulate, simulate_inputs

VEHICLE = remus()
STEP = VEHICLE.sample_time
# The peer knows no limits of rates.
LIMITS = replace(VEHICLE.vehicle, rates={})
REACH = LIMITS.inputs["fin_command"][1]
LONGEST = 480.0
# Of Pyomo.DoE: scale of sensitivities, relative step of differences, margin of pitch, solver.
SCALE, DIFFERENCE, MARGIN, IPOPT = 1e-3, 1e-2, radians(0.5), ("max_iter=500",)


@dataclass(frozen=True)
class Case:
    """How long, how many levels, and which parameters are free (the others are known)."""

    duration: float
    n_levels: int
    free: tuple[str, ...] = ()

    @property
    def model(self) -> Model:
        """Our model with these parameters free and no priors."""
        names = VEHICLE.model.free_names
        return VEHICLE.model.fix(*(n for n in names if self.free and n not in self.free))

    @property
    def owner(self) -> np.ndarray:
        """Which level each sample holds ``(n_times,)``; -1, trim, at the first."""
        n_times = round(self.duration / STEP) + 1
        edges = 1 + np.floor(np.arange(self.n_levels) * (n_times - 1) / self.n_levels)
        return np.searchsorted(edges, np.arange(n_times), side="right") - 1


CASES = {
    "small": Case(20.0, 10, ("Z_uw", "M_uw", "M_uq", "M_uuds")),
    "medium": Case(30.0, 15),
    "long": Case(60.0, 30),
    "narrow": Case(120.0, 60, ("Z_uw", "M_uw", "M_uq", "M_uuds")),
    "whole": Case(120.0, 60),
}


# What is asked, of us and of the peer. Its E needs cyipopt, which no wheel brings.
CRITERIA = {"D": "determinant", "A": "trace", "E": ""}


def designed(case: Case, n_starts: int = 3, criterion: str = "D") -> Design:
    """Design by us, with the settings that a user gets, but one thread."""
    return design_experiment(
        case.model,
        replace(VEHICLE, duration=case.duration).trial(LIMITS),
        criterion=OURS[criterion],
        rng=np.random.default_rng(1),
        search=Search(family=Levels(case.n_levels), n_starts=n_starts, n_workers=1),
        knowledge=Knowledge(prior=None, start="known"),
    )


def played(case: Case, levels: np.ndarray) -> Experiment:
    """The experiment with these levels."""
    owner = case.owner
    fin = np.where(owner < 0, 0.0, np.asarray(levels)[owner])
    return Experiment(
        "levels", (as_piecewise("fin_command", STEP * np.arange(len(owner)), fin),),
        duration=case.duration, sample_time=STEP, constants=VEHICLE.constants,
        initial=VEHICLE.initial,
    )  # fmt: skip


def judge(case: Case, levels: np.ndarray) -> tuple[dict[str, float], np.ndarray, Trajectory]:
    """All criteria, relative standard errors, and the run without noise."""
    model, experiment = case.model, played(case, levels)
    sizes = np.abs([model.values[name] for name in model.free_names])
    found = information_of(model, experiment, priors=None, start="known")
    matrix = found.matrix * sizes[:, None] * sizes
    value = {
        "D": found.log_determinant + 2 * float(np.sum(np.log(sizes))),
        "A": float(np.sqrt(np.trace(np.linalg.inv(matrix)) / len(sizes))),
        "E": float(1.0 / np.sqrt(np.linalg.eigvalsh(matrix)[0])),
    }
    record = simulate(model, experiment, noise=False)
    run = simulate_inputs(model, record.times, inputs=record.inputs, initial=VEHICLE.initial)
    return value, found.std_errors / sizes, run


def square(case: Case) -> np.ndarray:
    """Square wave of four seconds a side."""
    side = max(1, round(4.0 * case.n_levels / case.duration))
    return REACH / 2 * (-1.0) ** (np.arange(case.n_levels) // side)


def inside(case: Case, levels: np.ndarray, pitch: float) -> np.ndarray:
    """Smaller levels, until pitch stays below so many radians."""
    while np.abs(judge(case, levels)[2].signal("theta")).max() > pitch:
        levels = 0.98 * levels
    return levels


def levels_of(case: Case, design: Design) -> np.ndarray:
    """Levels ``(n_levels,)`` of one of our designs."""
    position = [i.name for i in case.model.inputs].index("fin_command")
    fin = design.trajectory.inputs[:, position]
    return np.array([fin[case.owner == i][0] for i in range(case.n_levels)])


def row(name: str, case: Case, levels: np.ndarray, clock: float, used: float) -> str:
    value, errors, run = judge(case, levels)
    limits = "; ".join(LIMITS.violations(run.times, run.signals)) or "limits kept"
    return (
        f"  {name:26} D (log det) {value['D']:7.2f}, A (root mean square error) {value['A']:.3%}, "
        f"E (longest axis) {value['E']:.3%}; worst error {errors.max():.2%}; "
        f"{clock:6.1f} s ({used:.1f} s); {limits}"
    )


def compare(
    name: str, case: Case, asked: str, python: str, *, starts: int, begin_ours: bool
) -> None:
    """One case and criterion by both."""
    free = case.model.free_names
    print(f"{name}, criterion {asked}: {case.duration:g} s, {case.n_levels} levels, "
          f"{len(free)} parameters")  # fmt: skip
    clock, used = time.perf_counter(), time.process_time()
    design = designed(case, starts, asked)
    ours = levels_of(case, design)
    clock, used = time.perf_counter() - clock, time.process_time() - used
    print(row("oed_sysid", case, ours, clock, used), flush=True)
    if not CRITERIA[asked]:
        print("  Pyomo.DoE                  asked for this it wants cyipopt, which is not there")
        return
    # Its rule of integration differs from ours: bounds a little tighter keep the true limits.
    first = inside(case, ours if begin_ours else square(case), radians(44) - MARGIN)
    print(row("start of Pyomo.DoE", case, first, 0.0, 0.0), flush=True)
    run = judge(case, first)[2]
    guess = np.stack([run.signal(s.name) for s in case.model.states], axis=1)
    low, high = np.full(5, -np.inf), np.full(5, np.inf)
    low[3:], high[3:] = np.transpose([LIMITS.signals["theta"], LIMITS.signals["z"]])
    low[3] += MARGIN
    high[3] -= MARGIN
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "task.npz"
        np.savez(
            path, objective=np.array(CRITERIA[asked]), times=run.times, owner=case.owner,
            start=guess[0], levels=first, guess=guess, corridor=np.stack([low, high]), reach=REACH,
            thrust=VEHICLE.constants["thrust"], free=np.array(free), scale=SCALE, step=DIFFERENCE,
            options=np.array(IPOPT),
        )  # fmt: skip
        found = run_peer(("benchmarks.peers.pyomo_doe",), path, [python], LONGEST)
    if isinstance(found, str):
        print(f"  Pyomo.DoE                  {found}", flush=True)
        return
    levels = np.clip(found["levels"], -REACH, REACH)
    print(row("Pyomo.DoE", case, levels, found["clock"], found["seconds"]))
    values = judge(case, ours)[0][asked], judge(case, levels)[0][asked]
    ahead = values[0] - values[1] if asked == "D" else float(np.log(values[1] / values[0]))
    own = found["value"] - 2 * len(free) * np.log(SCALE)
    print(
        f"    {found['status']}; of it {found['solve']:.1f} s optimisation; its own log det "
        f"{own:.2f}; clock over ours {found['clock'] / clock:.0f}; ours ahead in {asked} by "
        f"{ahead:.3f} {'of log det' if asked == 'D' else 'of the logarithm'}",
        flush=True,
    )


def main(
    cases: Sequence[str] = ("small", "medium"),
    *,
    python: str = sys.executable,
    criteria: Sequence[str] = tuple(CRITERIA),
    begin: str = "square",
    starts: int = 3,
) -> None:
    """Print the table.

    Parameters
    ----------
    cases : sequence of str
        small, medium, long, narrow, whole
    python : str
        interpreter that has Pyomo
    criteria : sequence of str
        D, A, E
    begin : str
        square or ours
    starts : int
        starts that we refine
    """
    print(machine())
    designed(replace(CASES["small"], free=()))  # the kernel is compiled once
    for name, asked in product(cases, criteria):
        case, asked = CASES[known(name, CASES, "case")], known(asked, CRITERIA, "criterion")
        compare(name, case, asked, python, starts=starts, begin_ours=begin == "ours")


if __name__ == "__main__":
    command(main)
