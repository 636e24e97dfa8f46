"""Which estimator, when, and by how much: eight systems, six worlds, all methods.

python -m benchmarks.comparison [--seeds 20] [--problems ...] [--worlds ...] [--estimators ...]

All estimators have the same records, start values and declared noise; each is run as its best user
would run it without knowing what acts (:data:`oed_sysid.baselines.contest.CONTESTANTS`). A case is
one problem in one world with one seed. What is in the store is never run again, so that a grid can
be stopped, resumed and enlarged; docs/comparison.md and its picture are written from the store.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import (
    RESULTS,
    ROOT,
    Row,
    Store,
    command,
    known,
    markdown,
    run_cases,
    write_page,
)
from benchmarks.tables import tables
from oed_sysid.baselines.benchmark import DETERMINED, logarithms_of_ratios
from oed_sysid.baselines.contest import (
    BELIEVERS,
    OURS_DISTURBED,
    OURS_DISTURBED_BELIEVING,
    OURS_DISTURBED_IPOPT,
    OURS_DISTURBED_TOLD,
    POPULATIONS,
    Cell,
    Outcome,
    run_cell,
)
from oed_sysid.baselines.world import WORLDS
from oed_sysid.results.estimator_plots import plot_comparison
from oed_sysid.results.style import save_figure

PAGE = ROOT / "docs" / "comparison.md"
STORE = Store(
    RESULTS / "comparison.jsonl",
    lambda row: (row["problem"], row["world"], row["seed"], *sorted(row["runs"])),
)
NOISE = 1.0  # per cent of the peak
DATA = tables(__file__)
SYSTEMS, ACTING, ESTIMATORS = (DATA[part] for part in ("systems", "acting", "estimators"))
# Who is told as much, by what our default is then called: start values to 50 %; the true start
# state of a single run, and a region.
TOLD = {
    OURS_DISTURBED_BELIEVING: BELIEVERS,
    OURS_DISTURBED_TOLD: POPULATIONS,
}


# -- cases -----------------------------------------------------------------------------


def run_case(problem: str, world: str, seed: int, *estimators: str) -> Row:
    """Run estimators on one record: a line of the store."""
    runs: Row = {}
    for name in estimators:
        outcome = run_cell(Cell(problem, name, NOISE, seed=seed, world=world))
        determined = [key for key, bound in outcome.bounds.items() if bound < DETERMINED]
        bounds = np.array([outcome.bounds[key] for key in determined])
        runs[name] = _brief(outcome, determined)
    return {
        "problem": problem,
        "world": world,
        "seed": seed,
        "determined": [len(determined), len(outcome.bounds)],
        "bound": _short(np.sqrt(np.mean(bounds**2))),
        "runs": runs,
    }


def _brief(outcome: Outcome, determined: Sequence[str]) -> list[object] | str:
    """Error of determined parameters, intervals that hold, of how many, failed, s; or why not."""
    if outcome.status == "refused":
        return outcome.message
    # A run without estimates is as wrong as knowing nothing.
    errors = np.array([outcome.errors.get(key, -1.0) for key in determined])
    held = [outcome.covered[key] for key in determined if key in outcome.covered]
    error = _short(np.sqrt(np.mean(errors**2)))
    return [error, sum(held), len(held), int(outcome.failed), _short(outcome.seconds)]


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def merged(rows: Iterable[Row]) -> dict[tuple[str, str, int], Row]:
    """Cases, with all estimators that ran on each."""
    found: dict[tuple[str, str, int], Row] = {}
    for row in rows:
        key = row["problem"], row["world"], row["seed"]
        before = found[key]["runs"] if key in found else {}
        found[key] = {**row, "runs": {**before, **row["runs"]}}
    return found


def missing(
    problems: Sequence[str], worlds: Sequence[str], seeds: int, estimators: Sequence[str]
) -> Iterator[tuple[Any, ...]]:
    """What is still to be run, the first seed of everything first."""
    done = merged(STORE.rows())
    for seed, problem, world in product(range(seeds), problems, worlds):
        run = done.get((problem, world, seed), {"runs": {}})["runs"]
        if left := sorted(set(estimators) - set(run)):
            yield problem, world, seed, *left


# -- what they say -------------------------------------------------------------------------


def cells(rows: Iterable[Row]) -> dict[tuple[str, str, str], list[list[float]] | str]:
    """Runs by problem, world and estimator; the reason where it cannot treat the problem."""
    found: dict[tuple[str, str, str], list[list[float]] | str] = {}
    for row in rows:
        for name, run in row["runs"].items():
            key = row["problem"], row["world"], name
            if isinstance(run, str):
                found.setdefault(key, run)
            elif isinstance(runs := found.setdefault(key, []), list):
                runs.append(run)
    return found


def default_for(name: str) -> str:
    """Our default, told as much as an estimator."""
    return next((own for own, told in TOLD.items() if name in (own, *told)), OURS_DISTURBED)


def ratios(rows: Sequence[Row], world: str, name: str) -> dict[str, float]:
    """By problem: median over seeds of an estimator's error over that of our default.

    Our default is told what the estimator is told. Both have the same records, so that what these
    have in common cancels.
    """
    ours = default_for(name)
    pairs: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        own, other = row["runs"].get(ours), row["runs"].get(name)
        if row["world"] == world and isinstance(own, list) and isinstance(other, list):
            pairs.setdefault(row["problem"], []).append((other[0], own[0]))
    return {
        problem: float(np.exp(np.median(logarithms_of_ratios(*np.transpose(errors)))))
        for problem, errors in pairs.items()
    }


def summary(rows: Sequence[Row], worlds: Sequence[str], estimators: Sequence[str]) -> np.ndarray:
    """Geometric means of the ratios over the problems, ``(n_estimators, n_worlds)``."""
    means = []
    for name in estimators:
        found = (np.array([*ratios(rows, world, name).values()]) for world in worlds)
        means.append([np.exp(np.mean(np.log(own))) if len(own) else np.nan for own in found])
    return np.array(means)


def headline(rows: Sequence[Row]) -> list[str]:
    """Where our default is first, within the scatter or behind, cell by cell."""
    least: list[float] = []
    others = [name for name in ESTIMATORS if name != OURS_DISTURBED_IPOPT]  # the same estimator
    for world, own in product(ACTING, (OURS_DISTURBED, *TOLD)):
        names = [name for name in others if default_for(name) == own != name]
        rivals = [ratios(rows, world, name) for name in names]
        for problem in SYSTEMS:
            if errors := [found[problem] for found in rivals if problem in found]:
                least.append(min(errors))
    first, behind = sum(x >= 1.0 for x in least), sum(x < 1 / 1.1 for x in least)
    total, near = len(least), len(least) - first - behind
    seeds = len({row["seed"] for row in rows})
    return [
        f"{len(rows)} records, up to {seeds} seeds. In {first} of {total} comparisons (a system in "
        "a world, among those that are told as much) no estimator errs less than the default in "
        f"the median; in {near} the best rival errs less by up to a tenth, in {behind} by more."
    ]


def per_world(rows: Sequence[Row]) -> list[str]:
    """Error over that of our default, mean over systems, and how many systems it can treat."""
    table = summary(rows, list(ACTING), list(ESTIMATORS))
    lines = []
    for (name, title), values in zip(ESTIMATORS.items(), table, strict=True):
        treated = {p for world in ACTING for p in ratios(rows, world, name)}
        shown = ["–" if np.isnan(x) else f"{x:.3g}" for x in values]
        lines.append((title, f"{len(treated)} of {len(SYSTEMS)}", *shown))
    return markdown(("estimator", "systems", *ACTING.values()), lines)


def per_system(rows: Sequence[Row], problem: str) -> list[str]:
    """Median error of determined parameters, per cent, intervals that hold, and the reasons."""
    own = [row for row in rows if row["problem"] == problem]
    found = cells(own)
    lines, reasons = [], {}
    for name, title in ESTIMATORS.items():
        shown = []
        for world in ACTING:
            runs = found.get((problem, world, name))
            if isinstance(runs, str):
                reasons.setdefault(runs, []).append(title)
            shown.append(_cell(runs))
        if any(shown):
            lines.append((title, *shown))
    bounds = [[row["bound"] for row in own if row["world"] == world] for world in ACTING]
    least = (f"{100 * np.median(one or [np.nan]):.3g}" for one in bounds)
    lines.append(("*least possible on average*", *least))
    table = markdown(("estimator", *ACTING.values()), lines)
    whys = (f"- {', '.join(dict.fromkeys(who))}: {why}." for why, who in reasons.items())
    return [*table, "", *whys]


def _cell(runs: list[list[float]] | str | None) -> str:
    """Median error, per cent, and in brackets the share of intervals that hold and failed runs."""
    if not isinstance(runs, list):
        return ""
    held, stated = sum(run[1] for run in runs), sum(run[2] for run in runs)
    failed = sum(run[3] for run in runs)
    told = [f"{100 * held / stated:.0f} %"] if stated else []
    told += [f"{failed:.0f}/{len(runs)} failed"] if failed else []
    brackets = f" ({', '.join(told)})" if told else ""
    return f"{100 * np.median([run[0] for run in runs]):.3g}{brackets}"


def tables(rows: Sequence[Row]) -> str:
    """Everything that the page says of the store."""
    lines = [*headline(rows), "", *per_world(rows), ""]
    for problem, title in SYSTEMS.items():
        own = [row for row in rows if row["problem"] == problem]
        n_known, n_all = own[0]["determined"] if own else (0, 0)
        seeds = len({row["seed"] for row in own})
        lines += [
            f"### {title}",
            "",
            f"`{problem}`: {seeds} seeds; the data determine {n_known} of {n_all} parameters.",
            "",
            *per_system(rows, problem),
            "",
        ]
    return "\n".join(lines)


def write(output: Path = PAGE) -> None:
    """Write the page and its picture from the store."""
    rows = list(merged(STORE.rows()).values())
    write_page(output, tables(rows), "comparison")
    table = summary(rows, list(ACTING), list(ESTIMATORS))
    ax = plot_comparison(table, list(ESTIMATORS.values()), list(ACTING.values()))
    save_figure(ax.figure, output.with_suffix(".png"))


def main(
    *,
    seeds: int = 20,
    problems: Sequence[str] = tuple(SYSTEMS),
    worlds: Sequence[str] = tuple(ACTING),
    estimators: Sequence[str] = tuple(ESTIMATORS),
    jobs: int = 1,
    minutes: float = 1e9,
) -> None:
    """Run what is not in the store, and write page and picture.

    Parameters
    ----------
    seeds : int
        records of each system in each world
    problems, worlds, estimators : sequence of str
        what is run
    """
    for world in worlds:
        known(world, WORLDS, "world")
    if minutes:
        keys = missing(problems, worlds, seeds, estimators)
        run_cases(
            STORE,
            {key: partial(run_case, *key) for key in keys},
            n_jobs=jobs,
            minutes=minutes,
            tell=lambda row: f"{row['problem']} {row['world']} seed {row['seed']}",
        )
    write()


if __name__ == "__main__":
    command(main)
