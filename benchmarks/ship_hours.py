r"""Ship hours of planned programmes for the errors that standard trials leave, vehicles 30 % off.

    OMP_NUM_THREADS=1 python -m benchmarks.ship_hours --vehicles 100     (--show: what is finished)

A programme is planned once on the believed vehicle, of which nothing is known but that every
coefficient is within 30 per cent (uniform), and judged on vehicles drawn from that (`TASKS`,
docs/programme.md). With information :math:`F_p` of the programme and :math:`F_s` of the standard
trials on the drawn vehicle, in units of the believed values and without priors, and hours
:math:`h_p, h_s`, turnarounds included, the programme needs

.. math:: \rho_D = \frac{h_p}{h_s} \left(\frac{\det F_s}{\det F_p}\right)^{1/n}, \qquad
    \rho_A = \frac{h_p}{h_s}\, \frac{\mathrm{tr}\, F_p^{-1}}{\mathrm{tr}\, F_s^{-1}}

of the ship time for the same geometric mean (D), or root mean square (A), of the errors; programmes
may be repeated in part. A programme with a run that diverges on a vehicle counts as infinitely
long there. Every run is played once in waves drawn for it, and its commands and forces are
integrated by `benchmarks.missing_physics.simulator` (no code of the package): a vehicle counts as
kept if all runs together never left a limit.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.harness import RESULTS, Row, Store, command, ignorant, tabulate
from benchmarks.missing_physics.simulator import Case, Truth, integrate
from benchmarks.realised import sea
from oed_sysid import AOptimal, DOptimal, Experiment, Limits, Model, NoiseModel, load_problem
from oed_sysid.design import Budget, Knowledge, ProgrammeSearch, design_programme
from oed_sysid.errors import OedSysidError
from oed_sysid.experiments.manoeuvres import TurningCircle, ZigZag
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information import information_of, sea_noise
from oed_sysid.likelihood.realisation import at_sea

STORE = Store(RESULTS / "ship_hours.jsonl")
SPREAD, TURNAROUND, N_RUNS = 0.3, 600.0, 4
SHRUNK = (1.0, 0.8, 0.6, 0.45, 0.3)  # angles of cautious standard trials
CRITERIA = {"D": DOptimal(), "A": AOptimal()}
BATCH = 20
THRUSTS = (5.0, 9.0, 14.0)  # N, the second that of the standard trials, the last the most there is
# Targets: share of the standard programme's ship time; share of vehicles that keep the limits.
TARGETS, KEPT = {"D": 0.5, "A": 0.25}, 0.95
# Limits of the REMUS-like vehicle: pitch, rad, and depth, m.
PITCH, LEAST, MOST = math.radians(45.0), 2.0, 60.0


@dataclass(frozen=True, eq=False)
class Task:
    """A believed vehicle, its sea, its limits, and the standard trials."""

    name: str
    model: Model
    patterns: tuple[Experiment, ...]
    limits: Limits
    sea: NoiseModel
    standard: tuple[Experiment, ...]
    durations: tuple[float, ...] | None = None


def zigzag(
    pattern: Experiment, size: float, channel: str, feedback: str, rate: float | None = None
) -> Experiment:
    """Zigzag of equal angles, degrees, closed over the vehicle."""
    angle = math.radians(size)
    shape = ZigZag(channel, angle, angle, feedback=(feedback,), sign=-1, rate=rate)
    return replace(pattern, name=f"zigzag {size:g}/{size:g}", manoeuvre=(shape,), feedback="true")


def auv(durations: tuple[float, ...] | None = None) -> Task:
    """The REMUS-like vehicle."""
    problem = load_problem("remus_diving_plane")
    model = ignorant(problem.model)
    patterns = tuple(
        replace(
            problem.experiment("zigzag_10_10"), duration=60.0, constants={"thrust": thrust},
            initial={"u": math.sqrt(thrust / -model.values["X_uu"]), "z": 25.0},
        )
        for thrust in THRUSTS
    )  # fmt: skip
    standard = tuple(zigzag(patterns[1], size, "fin_command", "theta") for size in (10, 20))
    name = "auv" if durations is None else "auv long"
    return Task(name, model, patterns, problem.limits, sea(model, 1.0), standard, durations)


def cautious(task: Task) -> tuple[Experiment, ...]:
    """The standard trials, each smaller and slower until it keeps the limits as surely as asked."""
    if not task.limits.signals:
        return task.standard
    vehicles = [drawn(task, 10_000 + number) for number in range(100)]
    found = []
    for run in task.standard:
        shape = run.excitation
        assert isinstance(shape, ZigZag)
        tried = (
            replace(
                zigzag(pattern, share * math.degrees(shape.switch), shape.input, *shape.feedback),
                duration=max(task.durations or (float(run.duration or 0.0),)),
            )
            for share in SHRUNK
            for pattern in reversed(task.patterns)
        )
        found.append(
            next(one for one in tried if limits_kept(task, vehicles, [one], 1).mean() >= KEPT)
        )
    return tuple(found)


def tanker() -> Task:
    """The tanker of `problems/online_ship`."""
    problem = load_problem("online_ship")
    model = ignorant(problem.model)
    pattern = replace(problem.experiment("zigzag_10_10"), duration=600.0)
    moderate = sea_noise(model, "moderate", [pattern])
    rate = problem.limits.rates["delta"]
    standard = tuple(zigzag(pattern, size, "delta", "psi", rate) for size in (10, 20))
    circle = replace(
        pattern, name="circle 35", feedback="true",
        manoeuvre=(TurningCircle("delta", math.radians(35.0), rate=rate),),
    )  # fmt: skip
    return Task("tanker", model, (pattern,), problem.limits, moderate, (*standard, circle))


TASKS = {"auv": auv, "auv long": partial(auv, (60.0, 300.0)), "tanker": tanker}


def planned(task: Task, criterion: str) -> dict[str, Any]:
    """Plan a programme on the believed vehicle."""
    began = time.process_time()
    found = design_programme(
        task.model,
        task.patterns,
        limits=task.limits,
        rng=np.random.default_rng(0),
        criterion=CRITERIA[criterion],
        budget=Budget(n_runs=N_RUNS, turnaround=TURNAROUND),
        search=ProgrammeSearch(durations=task.durations),
        knowledge=Knowledge(noise=task.sea, spread=SPREAD, prior=None),
    )
    return {
        "task": task.name, "plan": criterion, "runs": [run.name for run in found.runs],
        "experiments": [run.experiment.to_dict() for run in found.runs],
        "certainty": {name: one.probability for name, one in found.assurances.items()},
        "together": found.kept, "share": found.share, "seconds": time.process_time() - began,
    }  # fmt: skip


def drawn(task: Task, number: int) -> Model:
    """Vehicle of a number, the same in every call."""
    rng = np.random.default_rng([7, number])
    off = {p.name: p.value * (1 + SPREAD * rng.uniform(-1, 1)) for p in task.model.free_parameters}
    return task.model.with_values(off)


def told(task: Task, vehicle: Model, runs: Sequence[Experiment]) -> np.ndarray:
    """Information of runs on a vehicle, in units of the believed values."""
    sizes = np.array([task.model.parameter(n).reference for n in vehicle.free_names])
    total = np.zeros((len(sizes),) * 2)
    for run in runs:
        total += information_of(vehicle, run, noise=task.sea, priors=None).matrix
    return total * sizes[:, None] * sizes


def hours_of(runs: Sequence[Experiment]) -> float:
    """Ship time, h."""
    return sum(float(run.duration or 0.0) + TURNAROUND for run in runs) / 3600.0


def shares(ours: np.ndarray, theirs: np.ndarray, hours: float) -> dict[str, float]:
    """Ship time relative to that of the standard trials; ``hours`` is the ratio as planned."""
    n = len(ours)
    logs = [np.linalg.slogdet(matrix)[1] for matrix in (ours, theirs)]
    traces = [float(np.trace(np.linalg.inv(matrix))) for matrix in (ours, theirs)]
    return {
        "D": hours * float(np.exp((logs[1] - logs[0]) / n)), "A": hours * traces[0] / traces[1],
    }  # fmt: skip


def limits_kept(
    task: Task, vehicles: Sequence[Model], runs: Sequence[Experiment], seed: int
) -> np.ndarray:
    """Which vehicles keep all limits in all runs, in waves, by the foreign equations."""
    kept = np.ones(len(vehicles), dtype=bool)
    for index, run in enumerate(runs):
        free = replace(run, limits=Limits())
        inputs = []
        for number, vehicle in enumerate(vehicles):
            rng = np.random.default_rng([seed, index, number])
            meant, planned_run = at_sea(vehicle, free, task.sea, rng=rng)
            inputs.append(simulate(meant, planned_run, noise=False).inputs)
        commands, forces = np.split(np.stack(inputs, axis=2), [2], axis=1)
        kept &= inside(run, vehicles, forces, lambda k, _, given=commands: tuple(given[k]))
    return kept


def inside(
    run: Experiment,
    vehicles: Sequence[Model],
    forces: np.ndarray,
    command: Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> np.ndarray:
    """Which vehicles keep the limits, side by side.

    Parameters
    ----------
    run : Experiment
        Says where all begin.
    vehicles : sequence of Model
    forces : ndarray (n_times, 3, n_vehicles)
        X, Z in N, M in N m, held from sample to sample.
    command : callable
        See :func:`benchmarks.missing_physics.simulator.integrate`.

    Returns
    -------
    ndarray of bool (n_vehicles,)
    """
    n = len(vehicles)
    truth = Truth([Case("v", dict(vehicle.values)) for vehicle in vehicles])
    begin = np.full(n, run.initial["u"]), np.full(n, run.initial["z"])
    kept = np.ones(n, dtype=bool)
    for _, state in integrate(truth, begin, forces, command):
        pitch, depth = state[3], state[4]
        kept &= (np.abs(pitch) <= PITCH) & (depth >= LEAST) & (depth <= MOST)
    return kept


def judged(
    task: Task,
    plans: dict[str, dict[str, Any]],
    careful: Sequence[Experiment],
    numbers: Sequence[int],
) -> list[dict[str, Any]]:
    """Several drawn vehicles: ship time of each programme, and whether limits were kept."""
    vehicles = [drawn(task, number) for number in numbers]
    programmes = {
        name: [Experiment.from_dict(one) for one in plan["experiments"]]
        for name, plan in plans.items()
    }
    rows: list[dict[str, Any]] = []
    for number, vehicle in zip(numbers, vehicles, strict=True):
        row: dict[str, Any] = {"task": task.name, "vehicle": number}
        rows.append(row)
        usual = {"": list(task.standard), " cautious": list(careful)}
        try:
            theirs = {word: told(task, vehicle, runs) for word, runs in usual.items()}
        except OedSysidError as error:
            row["failed"] = str(error)
            continue
        for name, runs in programmes.items():
            for word, trials in usual.items():
                ratio = hours_of(runs) / hours_of(trials)
                try:
                    row[name + word] = shares(told(task, vehicle, runs), theirs[word], ratio)[name]
                except OedSysidError:
                    row[name + word] = math.inf
    if task.limits.signals:
        standard = {"standard": list(task.standard), "cautious": list(careful)}
        for name, runs in {**programmes, **standard}.items():
            distinct = list({run.name: run for run in runs}.values())
            found = limits_kept(task, vehicles, distinct, numbers[0])
            for row, kept in zip(rows, found, strict=True):
                row[f"kept {name}"] = bool(kept)
    return rows


def span(group: Sequence[Row], key: str) -> str:
    """Median of a number over the vehicles, and its 10 and 90 % quantiles."""
    low, middle, high = np.quantile([row[key] for row in group], [0.1, 0.5, 0.9], method="higher")
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def count(group: Sequence[Row], key: str) -> str:
    """How many vehicles a flag holds of."""
    flags = [bool(row[key]) for row in group if key in row]
    return f"{sum(flags)} of {len(flags)}" if flags else "-"


COLUMNS: dict[str, Callable[[tuple[str, str], list[Row]], object]] = {
    "vehicle": lambda key, _: key[0],
    "criterion": lambda key, _: key[1],
    "runs planned": lambda _, group: ", ".join(group[0]["runs"]),
    "judged": lambda key, group: len([row for row in group if key[1] in row]),
    "share of the standard trials' ship time: median (10 to 90 % of the vehicles)": (
        lambda key, group: span([row for row in group if key[1] in row], key[1])
    ),
    "target": lambda key, _: f"{TARGETS[key[1]]:g}",
    "of the cautious ones": lambda key, group: span(
        [row for row in group if key[1] in row], f"{key[1]} cautious"
    ),
    "limits kept: planned": lambda key, group: count(group, f"kept {key[1]}"),
    "standard": lambda _, group: count(group, "kept standard"),
    "cautious": lambda _, group: count(group, "kept cautious"),
}


def table(rows: Sequence[Row]) -> str:
    """What is finished as Markdown: of each vehicle and criterion the plan, then the judged."""
    groups = {
        (row["task"], row["plan"]): [
            row,
            *(one for one in rows if one["task"] == row["task"] and "vehicle" in one),
        ]
        for name in TASKS
        for row in rows
        if row["task"] == name and "plan" in row
    }
    lines = tabulate(groups, COLUMNS)
    if failed := sum("failed" in row for row in rows):
        lines += ["", f"{failed} vehicles could not be judged: a standard trial diverges."]
    return "\n".join(lines)


def judge_all(name: str, vehicles: int) -> None:
    """Plan what is not planned yet, and judge it on vehicles that are not in the store."""
    task = TASKS[name]()
    mine = [row for row in STORE.rows() if row["task"] == name]
    plans = {row["plan"]: row for row in mine if "plan" in row}
    for criterion in CRITERIA:
        if criterion not in plans:
            plans[criterion] = planned(task, criterion)
            STORE.add(plans[criterion])
    careful = cautious(task)
    there = {row["vehicle"] for row in mine if "vehicle" in row}
    missing = [number for number in range(vehicles) if number not in there]
    for begin in range(0, len(missing), BATCH):
        STORE.add(*judged(task, plans, careful, missing[begin : begin + BATCH]))
        print(f"{name}: {begin + BATCH} more", flush=True)


def main(*, vehicles: int = 100, tasks: Sequence[str] = tuple(TASKS), show: bool = False) -> None:
    """Run what is missing, print the table.

    Parameters
    ----------
    vehicles : int
        vehicles drawn
    tasks : sequence of str
        auv, auv long, tanker
    """
    for name in () if show else tasks:
        judge_all(name, vehicles)
    print(table(STORE.rows()))


if __name__ == "__main__":
    command(main)
