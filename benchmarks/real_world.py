"""Estimators where records are not what the model simulates: one table of a page.

python -m benchmarks.real_world [--seeds 20] [--problems ...] [--worlds ...] [--store out/worlds]

Every estimator has its default settings and the same data, start values and declared levels; none
is tuned. Finished runs stay in the store and are never run again, so that a run can be stopped,
resumed and enlarged; the table in docs/benchmark_estimators.md is written from what is there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness import ROOT, command, markdown, write_page
from oed_sysid.baselines.benchmark import Row, benchmark
from oed_sysid.baselines.contest import (
    BELIEVERS,
    OURS,
    OURS_BELIEVING,
    OURS_DISTURBED,
    OURS_DISTURBED_BELIEVING,
)
from oed_sysid.baselines.world import WORLDS

PAGE = ROOT / "docs" / "benchmark_estimators.md"
PROBLEMS = ("online_ship", "auv_diving_plane", "remus_diving_plane")
NOISE = 1.0  # per cent of the peak
# Short searches that treat these problems; the populations take minutes a run.
ESTIMATORS = (
    OURS,
    OURS_DISTURBED,
    "output_error",
    "equation_error",
    "equation_error_simpson",
    "total_least_squares",
    "ls_svm",
    "online_ls_svm",
    OURS_BELIEVING,
    OURS_DISTURBED_BELIEVING,
    "ekf",
)
# Who knows the start values to a factor is compared with who does, ours with others in each group.
FAMILY = (OURS, OURS_DISTURBED)
BELIEVING_FAMILY = (OURS_BELIEVING, OURS_DISTURBED_BELIEVING)
BELIEVING = (*BELIEVING_FAMILY, *BELIEVERS)
NEAR = 1.10


def table(rows: Sequence[Row], estimators: Sequence[str]) -> list[str]:
    """One line per problem and world: errors of determined parameters, their bound, per cent."""
    head = (
        "problem",
        "world",
        "seeds",
        "determined",
        "bound",
        *estimators,
        "place",
        "with a prior",
    )
    lines = []
    for problem, world in dict.fromkeys((row.problem, row.world) for row in rows):
        found = {r.estimator: r for r in rows if (r.problem, r.world) == (problem, world)}
        shown = {name: row for name, row in found.items() if not row.refused}
        errors = {name: _pooled(row) for name, row in shown.items()}
        plain = {name: error for name, error in errors.items() if name not in BELIEVING}
        told = {name: error for name, error in errors.items() if name in BELIEVING}
        cells = [
            _cell(shown.get(name), min((told if name in BELIEVING else plain).values(), default=0))
            for name in estimators
        ]
        one = next(iter(shown.values()))
        known = f"{one.n_determined} of {one.n_parameters}", f"{100 * one.bound:.3g}"
        places = _place(plain, FAMILY), _place(told, BELIEVING_FAMILY)
        seeds = max(row.n_runs for row in found.values())
        lines.append((problem, WORLDS[world].title, seeds, *known, *cells, *places))
    return markdown((*head, "place", "with a prior"), lines)


def _cell(row: Row | None, least: float) -> str:
    """Error of one estimator, bold where it is near the least."""
    if row is None:
        return "cannot"
    text = f"{100 * _pooled(row):.3g}"
    failed = f" ({row.n_failed} failed)" if row.n_failed else ""
    return (f"**{text}**" if _pooled(row) <= NEAR * least else text) + failed


def _place(errors: Mapping[str, float], family: Sequence[str]) -> str:
    """Where the better of our two is in its group, and where the one that finds out for itself."""
    ours = min((errors[name] for name in family if name in errors), default=np.inf)
    if not np.isfinite(ours):
        return "not run"
    least, default = min(errors.values()), errors.get(family[1], np.inf)
    place = "first" if ours <= least else f"{ours / least:.2g} x the first"
    if default > NEAR * ours:
        place += f"; the disturbed fit {default / least:.2g} x"
    return place


def _pooled(row: Row) -> float:
    """Median over seeds of the error of determined parameters: one failure is no verdict."""
    return float(np.median(row.by_seed))


def main(
    *,
    seeds: int = 20,
    problems: Sequence[str] = PROBLEMS,
    worlds: Sequence[str] = tuple(WORLDS),
    estimators: Sequence[str] = ESTIMATORS,
    store: str = "out/worlds",
    jobs: int = 1,
    output: Path = PAGE,
) -> None:
    """Run the grid and write the table.

    Parameters
    ----------
    seeds : int
        runs of each cell
    problems, worlds, estimators : sequence of str
        what is run
    store : str
        folder of finished runs
    jobs : int
        processes
    output : Path
        page that has the table
    """
    result = benchmark(
        problems, estimators, noise=[NOISE], seeds=seeds, worlds=worlds, store=store, n_jobs=jobs
    )
    lines = table(result.rows, estimators)
    print("\n".join(lines))
    write_page(output, "\n".join(lines), "real world")


if __name__ == "__main__":
    command(main)
