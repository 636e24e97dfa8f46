"""Estimators where records are not what the model simulates: one table of a page.

python -m benchmarks.real_world [--seeds 20] [--problems ...] [--worlds ...] [--store out/worlds]

Every estimator has its default settings and the same data, start values and declared levels; none
is tuned. Finished runs stay in the store and are never run again, so that a run can be stopped,
resumed and enlarged; the table in docs/benchmark_estimators.md is written from what is there.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness import between
from oed_sysid.baselines.benchmark import OURS, WORLDS, Row, benchmark
from oed_sysid.baselines.contest import (
    BELIEVERS,
    OURS_BELIEVING,
    OURS_DISTURBED,
    OURS_DISTURBED_BELIEVING,
)

PAGE = Path(__file__).resolve().parent.parent / "docs" / "benchmark_estimators.md"
BEGIN, END = "<!-- real world: begin -->", "<!-- real world: end -->"
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
    """One line per problem and world: errors of determined parameters and their bound, per cent."""
    lines = [
        "| problem | world | seeds | determined | bound | "
        + " | ".join(estimators)
        + " | place | with a prior |",
        "|" + "---|" * (len(estimators) + 7),
    ]
    for problem, world in dict.fromkeys((row.problem, row.world) for row in rows):
        found = {r.estimator: r for r in rows if (r.problem, r.world) == (problem, world)}
        shown = {name: row for name, row in found.items() if not row.refused}
        errors = {name: _pooled(row) for name, row in shown.items()}
        plain = {name: error for name, error in errors.items() if name not in BELIEVING}
        told = {name: error for name, error in errors.items() if name in BELIEVING}
        cells = []
        for name in estimators:
            if name not in errors:
                cells.append("cannot")
                continue
            text = f"{100 * errors[name]:.3g}"
            failed = f" ({shown[name].n_failed} failed)" if shown[name].n_failed else ""
            least = min((told if name in BELIEVING else plain).values())
            cells.append((f"**{text}**" if errors[name] <= NEAR * least else text) + failed)
        seeds = max(row.n_runs for row in found.values())
        any_row = next(iter(shown.values()))
        known = f"{any_row.n_determined} of {any_row.n_parameters} | {100 * any_row.bound:.3g}"
        places = _place(plain, FAMILY), _place(told, BELIEVING_FAMILY)
        title = WORLDS[world].title
        lines.append(
            f"| {problem} | {title} | {seeds} | {known} | " + " | ".join((*cells, *places)) + " |"
        )
    return lines


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


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the grid and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--problems", nargs="+", default=list(PROBLEMS))
    parser.add_argument("--worlds", nargs="+", default=list(WORLDS))
    parser.add_argument("--estimators", nargs="+", default=list(ESTIMATORS))
    parser.add_argument("--store", default="out/worlds")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--output", type=Path, default=PAGE)
    given = parser.parse_args(arguments)
    result = benchmark(
        given.problems,
        given.estimators,
        noise=[NOISE],
        seeds=given.seeds,
        worlds=given.worlds,
        store=given.store,
        n_jobs=given.jobs,
    )
    lines = table(result.rows, given.estimators)
    print("\n".join(lines))
    page = given.output.read_text(encoding="utf-8") if given.output.is_file() else ""
    given.output.write_text(between(page, BEGIN, END, lines), encoding="utf-8")


if __name__ == "__main__":
    main()
