"""Whole runs: does a fit say where process noise holds physics, and which values replay best?

    OMP_NUM_THREADS=1 python -m benchmarks.whole_runs [kinds] [--cases 40] [--first 0]

``single/...``, ``unknown/...`` and ``pair/...`` hide effects of `benchmarks.missing_physics` from
the nominal model of the diving plane; ``none/...`` hide nothing. ``measured`` are nominal models on
measured records, of which some are left out (:data:`MEASURED`). Where disturbances alone act,
`benchmarks.random_forces` counts the same.

``said`` is the share of fits with process noise that say that it has taken the work of physics
(``fit.whole_runs.said``); ``replay`` the whole-run error on records left out, start states
fitted to the whole run, of the values for runs (``replayed``) over that of the better of two fits,
with process noise and without.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from benchmarks.harness import RESULTS, Row, Store, grouped, study, tabulate
from benchmarks.missing_physics.cases import draws, simulate_draws
from benchmarks.missing_physics.judge import datasets, nominal
from oed_sysid import Dataset, Model, MultipleShooting, load_problem, replayed
from oed_sysid.likelihood.whole_runs import rms, whole_runs

KINDS = ("single/white", "unknown/white", "none/force_mid", "none/gust_mid", "measured")
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


def hidden(kind: str, number: int) -> Row:
    """One case of the diving plane."""
    ((case, records),) = simulate_draws(draws(f"{kind}:{number}-{number + 1}"))
    found = nominal_runs(nominal().model, *datasets(nominal(), records))
    return {"effects": dict(case.effects), **found}


def measured(number: int) -> Row:
    """One set of measured records."""
    name, left_out = MEASURED[number]
    title, _, variant = name.partition("/")
    problem = load_problem(title, variant=variant or None)
    train, test = problem.data().split(left_out)
    return {"set": [name, *left_out], **nominal_runs(problem.model, train, test)}


def nominal_runs(model: Model, train: Dataset, test: Dataset) -> Row:
    """What whole runs say of the nominal model, fitted as by default, and which values replay best.

    ``replay`` is the whole-run error on the test records with the values for runs, over that of the
    better of two fits: with process noise and without.
    """
    fit = MultipleShooting().fit(model, train)
    calm = MultipleShooting(disturbances="none").fit(model, train)
    levels = fit.whole_runs.each("noise")
    errors = [
        float(np.sqrt(np.nanmean((rms(whole_runs(one.model, test, levels)) / levels) ** 2)))
        for one in (fit, calm, replayed(fit))
    ]
    best = min(errors[:2])
    return {
        "process_noise": fit.noise.has_forces,
        "said": bool(fit.whole_runs.said),
        "unasked": fit.whole_runs.unasked,
        "z": [None if np.isnan(z) else float(z) for z in fit.whole_runs.each("z")],
        "errors": [float(np.nan_to_num(error, posinf=1e9)) for error in errors],
        "replay": errors[2] / best if np.isfinite(best) else None,
    }


def case(kind: str, number: int) -> Row:
    """One case, or what it raised."""
    try:
        found = measured(number) if kind == "measured" else hidden(kind, number)
    except Exception as error:  # counted, not stopped at
        found = {"error": f"{type(error).__name__}: {error}"}
    return {"key": [kind, number], **found}


def percent(values: Sequence[bool]) -> str:
    """Share and how many of how many."""
    return f"{100 * np.mean(values):.0f} % ({sum(values)} of {len(values)})" if values else "-"


def _replay(rows: Sequence[Row], of: Callable[[np.ndarray], float]) -> str:
    ratios = _ratios(rows)
    return f"{of(np.array(ratios)):.2f}" if ratios else "-"


def _ratios(rows: Sequence[Row]) -> list[float]:
    return [row["replay"] for row in _noisy(rows) if row.get("replay")]


def _noisy(rows: Sequence[Row]) -> list[Row]:
    """Cases that take process noise in."""
    return [row for row in rows if row.get("process_noise")]


COLUMNS: dict[str, Callable[..., object]] = {
    "kind": lambda kind, _: kind,
    "cases": lambda _, rows: len(rows),
    "raised": lambda _, rows: sum("error" in row for row in rows),
    "with process noise": lambda _, rows: len(_noisy(rows)),
    "structure said": lambda _, rows: percent([row["said"] for row in _noisy(rows)]),
    "replay, geometric mean": lambda _, rows: _replay(rows, lambda r: np.exp(np.mean(np.log(r)))),
    "within 1.1": lambda _, rows: percent([ratio < 1.1 for ratio in _ratios(rows)]),
    "within 1.25": lambda _, rows: percent([ratio < 1.25 for ratio in _ratios(rows)]),
    "worst": lambda _, rows: _replay(rows, np.max),
}


def table(rows: Sequence[Row]) -> str:
    """What was found by kind, as Markdown."""
    return "\n".join(tabulate(grouped(rows, lambda row: row["key"][0]), COLUMNS))


def cases(
    kinds: Sequence[str] = KINDS, *, cases: int = 40, first: int = 0
) -> dict[tuple[str, int], partial[Row]]:
    """Cases of some kinds.

    Parameters
    ----------
    kinds : sequence of str
        of cases; all by default
    cases : int
        of each kind
    first : int
        number of the first
    """
    numbers = range(first, first + cases)
    return {
        (kind, number): partial(case, kind, number)
        for kind in kinds
        for number in (range(len(MEASURED)) if kind == "measured" else numbers)
    }


if __name__ == "__main__":
    kept = Store(RESULTS / "whole_runs.jsonl", key=lambda row: tuple(row["key"]))
    study(cases, table, kept, tell=lambda row: f"{row['key']} {row.get('said')}")
