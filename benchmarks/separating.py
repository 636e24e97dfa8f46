"""Confusable pairs of effects: told apart by one designed dive? (`--show`: what is finished)

    OMP_NUM_THREADS=1 python -m benchmarks.separating

A first, gentle dive of the REMUS-like vehicle shows that something is missing, but not what: two of
forty candidate effects explain it alike. One dive is designed to tell them apart, simulated with
either of the two as the truth (`benchmarks.missing_physics.simulator`), and all forty candidates
are ranked on both dives together. Pairs are chosen before anything is simulated, from the
information of the first dive alone: those whose signatures are most alike, both of which show there
at a size at which the other fits as well (expected 2 dlogL of 3 or less, at most 1.5 times
typical). Each effect is in three pairs at most.
"""

from __future__ import annotations

import zlib
from collections import Counter
from dataclasses import replace
from functools import partial
from itertools import combinations
from time import process_time

import numpy as np

from benchmarks.harness import RESULTS, Row, Store, markdown, study
from benchmarks.missing_physics.cases import true_derivatives
from benchmarks.missing_physics.simulator import PRIORS, TRAIN, Case, simulate
from oed_sysid import Dataset, Problem, Record, load_problem
from oed_sysid.design import Caution, Discriminate, Levels, Search, Trial, design_experiment
from oed_sysid.design.criteria import eliminate, told_apart
from oed_sysid.design.result import Design
from oed_sysid.evidence.rank import Ranking, rank
from oed_sysid.evidence.study import Study
from oed_sysid.information.bound import RunInformation
from oed_sysid.information.shifts import Shifts
from oed_sysid.likelihood.gauss_newton import FilteredSolution

STORE = Store(RESULTS / "separating.jsonl", lambda row: (row["truth"], row["rival"]))
FIRST = next(m for m in TRAIN if m.name == "train_zigzag_5_5")
N_PAIRS, MOST_EACH = 10, 3
# Expected 2 dlogL of the truth over its rival in the first dive, and over the nominal model.
ALIKE, SHOWN = 3.0, 25.0
LARGEST = 1.5  # size, of the usual one
DURATION, SAMPLE = 90.0, 0.1


def record(problem: Problem, case: Case, commands: np.ndarray | None = None) -> Record:
    """Simulate the first dive, or given commands, with what is true."""
    ((found,),) = simulate([case], [FIRST], commands=commands)
    name = FIRST.name if commands is None else "designed"
    return Record(name, found.times, found.inputs, found.outputs, problem.channels)


def pairs(problem: Problem) -> list[tuple[str, str, float, float]]:
    """Confusable pairs with the sizes of both members, as shares of the usual ones."""
    model = problem.model
    shifts = Shifts.of(model, problem.effects)
    first = record(problem, Case("nothing", PRIORS))
    weights = [1.0 / (p.prior_std or np.inf) ** 2 for p in model.free_parameters]
    n = len(weights)
    matrix = RunInformation(model, shifts=shifts).matrix(first)
    assert matrix is not None
    matrix[:n, :n] += np.diag(weights)
    gram, _ = eliminate(matrix, n)
    alone = [float(np.sum(g.weight * gram[np.ix_(g.columns, g.columns)])) for g in shifts.groups]
    rows = []
    for i, j in combinations(range(len(shifts.groups)), 2):
        if len(shifts.groups[i].columns) + len(shifts.groups[j].columns) > 2:
            continue  # a wave has a phase and a frequency: it is like nothing
        a, b = shifts.groups[i].columns[0], shifts.groups[j].columns[0]
        left = max(1.0 - gram[a, b] ** 2 / (gram[a, a] * gram[b, b]), 1e-12)
        sizes = [min(LARGEST, float(np.sqrt(ALIKE / (left * alone[k])))) for k in (i, j)]
        if min(sizes[0] ** 2 * alone[i], sizes[1] ** 2 * alone[j]) >= SHOWN:
            rows.append((left, i, j, *sizes))
    chosen: list[tuple[str, str, float, float]] = []
    used = Counter[int]()
    for _, i, j, *both in sorted(rows):
        if max(used[i], used[j]) < MOST_EACH and len(chosen) < N_PAIRS:
            chosen.append((shifts.names[i], shifts.names[j], *both))
            used.update((i, j))
    return chosen


def case_of(problem: Problem, truth: str, size: float, pair: str) -> Case:
    """Draw the true derivatives; the effect has its size of the scale, either sign in turn."""
    effect = problem.effect(truth)
    seed = zlib.crc32(f"{pair}/{truth}".encode())
    rng = np.random.default_rng(seed)
    derivatives = true_derivatives(rng)
    (amplitude,) = (p for p in effect.parameters if p.name in effect.amplitude_names)
    value = size * amplitude.magnitude
    if truth == "fin_rate_limit":  # the simulator takes the rate, the candidate its inverse
        value = 1.0 / value
    elif amplitude.upper <= 0:
        value = -value
    return Case(f"{pair}/{truth}", derivatives, {truth: value}, seed=seed)


def ranked(
    problem: Problem, train: Dataset, also: tuple[str, ...]
) -> tuple[Study, FilteredSolution, Ranking]:
    """Rank all candidates on records; both members of the pair are refitted whatever they score."""
    study, base = Study.begin(problem.model, train, None, problem.effects, known_noise=False)
    return study, base, rank(study, base, study.candidates, also=also)


def designed(
    problem: Problem, study: Study, base: FilteredSolution, ranking: Ranking, pair: tuple[str, str]
) -> Design:
    """Design the dive that tells two effects apart, at the amplitudes that the first one gave."""
    refits = {refit.name: refit.fit.values for refit in ranking.refits}
    # One structure with all candidates, compiled once: only values differ.
    wide = problem.model + [effect.absent() for effect in problem.effects]
    rivals = [replace(wide.with_values(dict(refits[name])), name=name) for name in pair]
    fit = study.result(base, "first dive")
    speed = float(np.sqrt(9.0 / 3.9))
    return design_experiment(
        fit,
        Trial(
            limits=problem.limits,
            duration=DURATION,
            sample_time=1.0,
            trim={"thrust": 9.0},
            initial={"u": speed, "z": 10.0},
        ),
        criterion=Discriminate(rivals, against_believed=False),
        caution=Caution(0.9, n_sets=20, n_checks=40, others=rivals),
        rng=np.random.default_rng(0),
        search=Search(family=Levels(30), n_starts=1, n_candidates=12, n_steps=6, n_workers=1),
    )


def commands_of(design: Design) -> np.ndarray:
    """Commands at every sample of the simulator, held."""
    times = np.arange(round(DURATION / SAMPLE) + 1) * SAMPLE
    rows = np.searchsorted(design.trajectory.times, times + 1e-9, side="right") - 1
    return design.trajectory.inputs[rows]


def judged(problem: Problem, truth: str, rival: str, size: float) -> Row:
    """One truth: the first dive, the designed one, and the ranking on both."""
    began = process_time()
    pair = (truth, rival)
    case = case_of(problem, truth, size, "+".join(sorted(pair)))
    first = record(problem, case)
    study, base, before = ranked(problem, Dataset([first]), pair)
    design = designed(problem, study, base, before, pair)
    second = record(problem, case, commands_of(design))
    _, _, after = ranked(problem, Dataset([first, second]), pair)
    groups = [[r.name for r in one.group()] for one in (before, after)]
    evidence = [{r.name: r.evidence for r in one.refits} for one in (before, after)]
    margin = [e.get(truth, -np.inf) - max(e.get(rival, -np.inf), 0.0) for e in evidence]
    return {
        "pair": sorted(pair),
        "truth": truth,
        "rival": rival,
        "size": size,
        "group_before": groups[0],
        "group_after": groups[1],
        "margin_before": margin[0],
        "margin_after": margin[1],
        "expected": design.misfits.get((truth, rival), np.nan),
        "pitch": float(np.degrees(np.abs(second.outputs[:, 3]).max())),
        "first": after.refits[0].name if after.refits else "",
        "confused": truth in groups[0] and rival in groups[0],
        "separated": bool(groups[1]) and groups[1][0] == truth and rival not in groups[1],
        "alone": groups[1] == [truth],
        "seconds": process_time() - began,
    }


def table(rows: list[Row]) -> str:
    """Finished cases as Markdown."""
    head = (
        "truth", "rival", "size, of usual", "confused before", "expected 2 dlogL", "found",
        "told apart", "group after",
    )  # fmt: skip
    cells = [
        (
            f"`{row['truth']}`",
            f"`{row['rival']}`",
            f"{row['size']:.2g}",
            f"{'yes' if row['confused'] else 'no'} ({row['margin_before']:.1f})",
            f"{row['expected']:.0f} (certain to {told_apart(row['expected']):.0%})",
            f"{row['margin_after']:.0f}",
            "yes" if row["separated"] else "NO",
            ", ".join(row["group_after"]),
        )
        for row in rows
    ]
    done = sum(row["separated"] for row in rows)
    return "\n".join(
        [*markdown(head, cells), "", f"Told apart: {done} of {len(rows)} (target 18 of 20)."]
    )


def cases() -> dict[tuple[str, str], partial[Row]]:
    """Either member of every pair as the truth."""
    problem = load_problem("remus_diving_plane")
    return {
        (truth, rival): partial(judged, problem, truth, rival, size)
        for a, b, size_a, size_b in pairs(problem)
        for truth, rival, size in ((a, b, size_a), (b, a, size_b))
    }


def told(row: Row) -> str:
    """How far a truth is ahead of its rival, before and after the designed dive."""
    before, after = row["margin_before"], row["margin_after"]
    return f"{row['truth']} / {row['rival']}: {before:.1f} -> {after:.1f}"


if __name__ == "__main__":
    study(cases, table, STORE, tell=told)
