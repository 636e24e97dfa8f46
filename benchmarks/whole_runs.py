r"""Whole runs: does a fit say where process noise holds physics, and which values replay best?

    OMP_NUM_THREADS=1 python -m benchmarks.whole_runs [kinds] [--cases 40] [--first 0]

``single``, ``unknown`` and ``pair`` hide effects of `benchmarks.missing_physics` from the nominal
model of the diving plane; ``none/...`` hide nothing. These count where the default fit takes
process noise in. ``measured`` are nominal models on measured records, of which some are left out
(:data:`MEASURED`). All other kinds are worlds of `benchmarks.random_forces`: the fitted structure
is the true one, and what acts is disturbances alone, a swell among them.

``said`` is the share of fits with process noise that say that it has taken the work of physics
(``fit.whole_runs.said``); ``replay`` the whole-run error on records left out, start states
fitted to the whole run, of the values for runs (``replayed``) over that of the better of two fits,
with process noise and without.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from benchmarks.harness import RESULTS, Row, Store, command, grouped, run_cases, tabulate
from benchmarks.missing_physics.cases import draws, simulate_draws
from benchmarks.missing_physics.judge import _problem, datasets, nominal_runs
from benchmarks.random_forces.scenarios import SCENARIOS
from benchmarks.random_forces.simulator import Set, believed, simulate
from benchmarks.random_forces.trial import dataset, nominal_model
from oed_sysid import MultipleShooting, load_problem

KINDS = (
    "single/white", "unknown/white", "none/force_mid", "none/gust_mid", "small", "medium",
    "ship_gusts", "ship_swell", "drone_swell", "remus_swell", "measured",
)  # fmt: skip
# Problem, or problem and variant, and the records left out.
MEASURED = (
    *(("kvlcc2", (run,)) for run in ("10_05", "15_05", "20_05", "25_05")),
    *(("kvlcc2/mmg", (run,)) for run in ("10_05", "15_05", "20_05", "25_05")),
    ("roll_decay", ("test_small",)),
    ("cascaded_tanks", ("test_second_half",)),
    ("cascaded_tanks/torricelli", ("test_second_half",)),
    ("silverbox", ("test_third_realisation",)),
    ("positioning_drive", ("test_second_half",)),
    ("slocum_glider", tuple(f"test_dive_{number}" for number in (1, 3, 4, 6, 7, 8, 10, 11))),
)


@lru_cache(maxsize=1)
def _sets(world: str, seed: int, first: int, last: int) -> dict[int, Set]:
    """Data sets of a world by number."""
    return {one.number: one for one in simulate(SCENARIOS[world], seed, range(first, last))}


def hidden(kind: str, number: int) -> Row:
    """One case of the diving plane."""
    (draw,) = draws(f"{kind}:{number}-{number + 1}")
    ((case, records),) = simulate_draws([draw])
    problem = _problem()
    found = nominal_runs(problem.model, *datasets(problem, records))
    return {"key": [kind, number], "effects": dict(case.effects), **found}


def measured(number: int) -> Row:
    """One set of measured records."""
    name, left_out = MEASURED[number]
    title, _, variant = name.partition("/")
    problem = load_problem(title, variant=variant or None)
    train, test = problem.data().split(left_out)
    found = nominal_runs(problem.model, train, test)
    return {"key": ["measured", number], "set": [name, *left_out], **found}


def disturbed(world: str, number: int, seed: int, first: int, last: int) -> Row:
    """One data set whose disturbances are true."""
    scenario, data = SCENARIOS[world], _sets(world, seed, first, last)[number]
    model = nominal_model(scenario.vehicle).with_values(believed(scenario))
    fit = MultipleShooting().fit(model, dataset(scenario, model, data.runs))
    runs = fit.whole_runs
    return {
        "key": [world, number],
        "process_noise": runs.process_noise,
        "said": bool(runs.said),
        "unasked": runs.unasked,
        "objections": list(runs.said),
    }


def guarded(key: tuple[str, int], work: Callable[[], Row]) -> Row:
    """The case, or what it raised."""
    try:
        return work()
    except Exception as error:  # counted, not stopped at
        return {"key": list(key), "error": f"{type(error).__name__}: {error}"}


def percent(values: Sequence[bool]) -> str:
    """Share and how many of how many."""
    return f"{100 * np.mean(values):.0f} % ({sum(values)} of {len(values)})" if values else "-"


def line(of: Callable[[list[Row]], object]) -> Callable[[object, list[Row]], object]:
    """A column of cases that take process noise in."""
    return lambda _, rows: of([row for row in rows if row.get("process_noise")])


def _replay(rows: Sequence[Row], of: Callable[[np.ndarray], float]) -> str:
    ratios = [row["replay"] for row in rows if row.get("replay")]
    return f"{of(np.array(ratios)):.2f}" if ratios else "-"


def _within(rows: Sequence[Row], most: float) -> str:
    return percent([row["replay"] < most for row in rows if row.get("replay")])


COLUMNS = {
    "kind": lambda kind, _: kind,
    "cases": lambda _, rows: len(rows),
    "raised": lambda _, rows: sum("error" in row for row in rows),
    "with process noise": lambda _, rows: sum(row.get("process_noise", False) for row in rows),
    "structure said": line(lambda rows: percent([row["said"] for row in rows])),
    "replay, geometric mean": line(
        lambda rows: _replay(rows, lambda r: float(np.exp(np.mean(np.log(r)))))
    ),
    "within 1.1": line(lambda rows: _within(rows, 1.1)),
    "within 1.25": line(lambda rows: _within(rows, 1.25)),
    "worst": line(lambda rows: _replay(rows, lambda r: float(r.max()))),
}


def main(
    kinds: Sequence[str] = KINDS,
    *,
    cases: int = 40,
    first: int = 0,
    seed: int = 5,
    store: Path = RESULTS / "whole_runs.jsonl",
) -> None:
    """Run what is not in the store yet, and print.

    Parameters
    ----------
    kinds : sequence of str
        of cases; all by default
    cases : int
        of each kind
    first : int
        number of the first
    seed : int
        of the worlds
    store : Path
        where finished cases are
    """
    last = first + cases
    wanted: dict[tuple[str, int], Callable[[], Row]] = {}
    for kind in kinds:
        for number in range(len(MEASURED)) if kind == "measured" else range(first, last):
            if kind == "measured":
                work = partial(measured, number)
            elif "/" in kind:
                work = partial(hidden, kind, number)
            else:
                work = partial(disturbed, kind, number, seed, first, last)
            wanted[kind, number] = partial(guarded, (kind, number), work)
    kept = Store(store, key=lambda row: tuple(row["key"]))
    rows = run_cases(kept, wanted, tell=lambda row: f"{row['key']} {row.get('said')}")
    print("\n".join(tabulate(grouped(rows, lambda row: row["key"][0]), COLUMNS)))


if __name__ == "__main__":
    command(main)
