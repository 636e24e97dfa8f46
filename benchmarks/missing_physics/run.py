"""Run the improvement over many hidden-effect cases and tabulate how often it is right.

    OMP_NUM_THREADS=1 python -m benchmarks.missing_physics "single/white:40 none/white:20"

Finished cases are kept as lines of JSON and never computed again.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from benchmarks.missing_physics.cases import Draw, draws, simulate_draws
from benchmarks.missing_physics.judge import judge
from benchmarks.missing_physics.measures import as_markdown, measures
from oed_sysid.runtime.files import write_text

RESULTS = Path(__file__).resolve().parent.parent / "results" / "missing_physics.jsonl"
PLAN = (
    "single/white:320 none/white:200 pair/white:60 unknown/white:40 "
    "none/colour5:20 none/colour9:20 none/force_mid:20 none/force_high:20 none/gust_mid:20 "
    "single/colour5:40 single/force_mid:40 single/gust_mid:40"
)
BATCH = 40
BY_HAND = "<!-- by hand -->\n"
PAGE = """# How often missing physics is found

Simulated records of a small AUV in the diving plane hide one effect, two, none, or one that
is in no vocabulary; `oed_sysid.evidence.improve` gets the nominal model, 40 candidate effects,
three training records and two validation ones. The simulator (`benchmarks/missing_physics/`)
shares no code with the package: Runge-Kutta at 0.01 s in plain NumPy, commands from a relay on
the pitch angle or from steps, true derivatives 9 % about the believed ones, amplitudes from a
fifth to three times typical. It reproduces the records of another simulator to their noise.

*Detectable* means that the true structure, fitted by the same means from the truth, gains more
than 13.4 in twice the log-likelihood (one false claim in a hundred searches over 40
candidates): weaker effects do not show in these records, whatever the method. Errors are over
whole records in units of the noise. *colour5* and *colour9* is sensor noise with correlation 0.5
and 0.9 from sample to sample; *force* is a random force and moment on every axis, correlated
over 1 s, *mid* 0.1 N, 0.3 N, 0.06 N m (*low* 0.3 and *high* 3 times that); *gust* is drawn anew
every 0.1 s, five times larger.

    make setup
    .venv/bin/python -m benchmarks.missing_physics --table docs/missing_physics.md

continues where the last run stopped (`benchmarks/results/missing_physics.jsonl`).

"""


def run(
    plan: str = PLAN,
    *,
    results: Path = RESULTS,
    n_jobs: int = 2,
    deadline: float | None = None,
    tell: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Run all cases of a plan that are not on disk yet, and measure all that are.

    Parameters
    ----------
    plan : str
        See :func:`benchmarks.missing_physics.cases.draws`.
    results : Path
        Lines of JSON, one per finished case.
    n_jobs : int
        Processes.
    deadline : float, optional
        Time of day (seconds since the epoch) after which no result is waited for.
    tell : callable
        Told about the progress.

    Returns
    -------
    dict
        Measures, see :func:`benchmarks.missing_physics.measures.measures`.
    """
    results.parent.mkdir(parents=True, exist_ok=True)
    mend(results)
    done = {entry["key"] for entry in load(results)}
    wanted = draws(plan)
    left = [draw for draw in wanted if draw.key not in done]
    tell(f"{len(wanted)} cases, {len(wanted) - len(left)} of them done")
    began = time.perf_counter()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for finished, entry in enumerate(_entries(left, n_jobs), start=1):
        with results.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")
        pace = (time.perf_counter() - began) / finished
        tell(
            f"{finished}/{len(left)} {entry['key']} {_summary(entry)} "
            f"({pace:.1f} s per case, {pace * (len(left) - finished) / 60:.0f} min left)"
        )
        if deadline is not None and time.time() > deadline:
            tell("out of time: the rest is left for the next run")
            break
    keys = {draw.key for draw in wanted}
    return measures([entry for entry in load(results) if entry["key"] in keys])


def _entries(left: Sequence[Draw], n_jobs: int) -> Iterator[dict[str, Any]]:
    """Judge cases in parallel, simulated a batch at a time, as they finish."""
    with Parallel(n_jobs=n_jobs, return_as="generator_unordered") as workers:
        for first in range(0, len(left), BATCH):
            batch = left[first : first + BATCH]
            jobs = (
                delayed(judge)(draw, case, records)
                for draw, (case, records) in zip(batch, simulate_draws(batch), strict=True)
            )
            yield from workers(jobs)


def mend(results: Path) -> None:
    """Cut off the part of a line that a killed run may have left."""
    text = results.read_text(encoding="utf-8") if results.exists() else ""
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        write_text(results, whole)


def load(results: Path) -> list[dict[str, Any]]:
    """Finished cases."""
    if not results.exists():
        return []
    return [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]


def _summary(entry: dict[str, Any]) -> str:
    if "error" in entry:
        return f"FAILED {entry['error']}"
    added = " + ".join(step["added"] for step in entry["steps"]) or "nothing"
    hidden = " + ".join(entry["effects"]) or "nothing"
    sight = "" if entry["detectable"] else " (invisible)"
    return f"{hidden}{sight} -> {added}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line of the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("plan", nargs="?", default=PLAN)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--until", help="local time of day, as 12:55")
    parser.add_argument("--measure", action="store_true", help="run nothing: measure what is there")
    parser.add_argument("--table", type=Path, help="write the measures there as Markdown")
    options = parser.parse_args(arguments)
    deadline = None
    if options.until:
        now = time.localtime()
        hour, minute = map(int, options.until.split(":"))
        deadline = time.mktime((*now[:3], hour, minute, 0, *now[6:]))
    if options.measure:
        found = measures(load(options.results))
    else:
        found = run(
            options.plan,
            results=options.results,
            n_jobs=options.jobs,
            deadline=deadline,
            tell=lambda text: print(text, flush=True),
        )
    text = as_markdown(found)
    print(text)
    if options.table:
        write_text(options.table, page(text, options.table))


def page(table: str, path: Path) -> str:
    """The page with new tables; what was written by hand below the old ones stays."""
    old = path.read_text(encoding="utf-8") if path.exists() else ""
    _, mark, by_hand = old.partition(BY_HAND)
    return f"{PAGE}{table}\n" + (f"\n{mark}{by_hand}" if mark else "")
