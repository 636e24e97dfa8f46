"""Whole runs: does a fit say where process noise holds physics, and which values replay best?

    OMP_NUM_THREADS=1 python -m benchmarks.whole_runs "single/white:40 unknown/white:40"

Cases are those of a plan of `benchmarks.missing_physics`, whose effects the nominal model of the
diving plane lacks, and nominal models on measured records, of which some are left out
(:data:`MEASURED`). Where disturbances alone act, `benchmarks.random_forces` counts the same.

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
from benchmarks.missing_physics.cases import Draw, draws, simulate_draws
from benchmarks.missing_physics.judge import datasets, nominal
from oed_sysid import Dataset, Model, MultipleShooting, load_problem, replayed
from oed_sysid.likelihood.whole_runs import rms, whole_runs

PLAN = "single/white:40 unknown/white:40 none/force_mid:40 none/gust_mid:40"
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


def hidden(draw: Draw) -> Row:
    """One case of the diving plane."""
    ((_, records),) = simulate_draws([draw])
    return nominal_runs(nominal().model, *datasets(nominal(), records))


def measured(name: str, left_out: Sequence[str]) -> Row:
    """One set of measured records."""
    title, _, variant = name.partition("/")
    problem = load_problem(title, variant=variant or None)
    return nominal_runs(problem.model, *problem.data().split(left_out))


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


def case(kind: str, number: int, ask: Callable[[], Row]) -> Row:
    """One case, or what it raised."""
    try:
        return {"key": [kind, number], **ask()}
    except Exception as error:  # counted, not stopped at
        return {"key": [kind, number], "error": f"{type(error).__name__}: {error}"}


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


def cases(plan: str = PLAN) -> dict[tuple[str, int], partial[Row]]:
    """Cases of a plan, and the measured records.

    Parameters
    ----------
    plan : str
        kinds of cases and how many, as "single/white:40 none/white:10-20"
    """
    asked = {(f"{d.hidden}/{d.condition}", d.number): partial(hidden, d) for d in draws(plan)}
    asked |= {("measured", i): partial(measured, *one) for i, one in enumerate(MEASURED)}
    return {key: partial(case, *key, ask) for key, ask in asked.items()}


if __name__ == "__main__":
    kept = Store(RESULTS / "whole_runs.jsonl", key=lambda row: tuple(row["key"]))
    study(cases, table, kept, tell=lambda row: f"{row['key']} {row.get('said')}")
