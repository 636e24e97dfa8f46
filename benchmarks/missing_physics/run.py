"""Run the improvement over many hidden-effect cases and tabulate how often it is right.

    OMP_NUM_THREADS=1 python -m benchmarks.missing_physics "single/white:40 none/white:20"

Finished cases are kept as lines of JSON and never computed again.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.harness import RESULTS as FOLDER
from benchmarks.harness import Row, Store, run_cases
from benchmarks.missing_physics.cases import Draw, draws, simulate_draws
from benchmarks.missing_physics.judge import judge
from benchmarks.missing_physics.measures import as_markdown, measures
from oed_sysid.runtime.files import write_text

RESULTS = FOLDER / "missing_physics.jsonl"
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
and 0.9 from sample to sample; *force* is a disturbance force and moment on every axis, correlated
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
    results, n_jobs, deadline, tell
        See :func:`benchmarks.harness.run_cases`.

    Returns
    -------
    dict
        Measures, see :func:`benchmarks.missing_physics.measures.measures`.
    """
    wanted = {draw.key: draw for draw in draws(plan)}

    def jobs(left: Sequence[Hashable]) -> Iterator[Callable[[], Row]]:
        """Simulated a batch at a time."""
        chosen: list[Draw] = [wanted[str(key)] for key in left]
        for first in range(0, len(chosen), BATCH):
            batch = chosen[first : first + BATCH]
            for draw, (case, records) in zip(batch, simulate_draws(batch), strict=True):
                yield partial(judge, draw, case, records)

    return measures(
        run_cases(
            Store(results), list(wanted), jobs,
            n_jobs=n_jobs, deadline=deadline, tell=_summary, say=tell,
        )
    )  # fmt: skip


def _summary(entry: Row) -> str:
    if "error" in entry:
        return f"{entry['key']} FAILED {entry['error']}"
    added = " + ".join(step["added"] for step in entry["steps"]) or "nothing"
    hidden = " + ".join(entry["effects"]) or "nothing"
    sight = "" if entry["detectable"] else " (invisible)"
    return f"{entry['key']} {hidden}{sight} -> {added}"


def main(
    plan: str = PLAN,
    *,
    jobs: int = 2,
    results: Path = RESULTS,
    until: str = "",
    measure: bool = False,
    table: Path | None = None,
) -> None:
    """Run what is missing and print the measures.

    Parameters
    ----------
    plan : str
        kinds of cases and how many, as "single/white:40 none/white:20"
    jobs : int
        processes
    results : Path
        store of finished cases
    until : str
        local time of day after which no result is waited for, as 12:55
    measure : bool
        run nothing: measure what is there
    table : Path
        write the measures there as Markdown
    """
    deadline = None
    if until:
        now = time.localtime()
        hour, minute = map(int, until.split(":"))
        deadline = time.mktime((*now[:3], hour, minute, 0, *now[6:]))
    if measure:
        found = measures(Store(results).rows())
    else:
        found = run(plan, results=results, n_jobs=jobs, deadline=deadline,
                    tell=lambda text: print(text, flush=True))  # fmt: skip
    text = as_markdown(found)
    print(text)
    if table:
        write_text(table, page(text, table))


def page(table: str, path: Path) -> str:
    """The page with new tables; what was written by hand below the old ones stays."""
    old = path.read_text(encoding="utf-8") if path.exists() else ""
    _, mark, by_hand = old.partition(BY_HAND)
    return f"{PAGE}{table}\n" + (f"\n{mark}{by_hand}" if mark else "")
