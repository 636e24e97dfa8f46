"""Command line: simulate, fit, compare with the reference, tabulate."""

from __future__ import annotations

import json as plain
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.harness import known, markdown
from benchmarks.random_forces import reference as cache
from benchmarks.random_forces.measures import errors, estimated, measure, table
from benchmarks.random_forces.scenarios import SCENARIOS, VEHICLES, Scenario
from benchmarks.random_forces.simulator import Set, simulate
from benchmarks.random_forces.trial import Outcome, outcome
from oed_sysid.runtime.files import write_text

SETS, SEED = 40, 0
KINDS = ("auto", "none", "all", "known")


def run(
    names: Sequence[str],
    *,
    sets: int = SETS,
    seed: int = SEED,
    settings: Mapping[str, Any] | None = None,
    json_file: Path | None = None,
) -> list[dict[str, Any]]:
    """Measure the estimator in some scenarios.

    Parameters
    ----------
    names : sequence of str
        Of :data:`~benchmarks.random_forces.scenarios.SCENARIOS`.
    sets, seed : int
        Number of data sets, and which.
    settings : mapping
        Of ``MultipleShooting``.
    json_file : Path, optional
        Written after every set: all measures and every single fit. Sets that it holds already,
        of the same seed and settings, are not fitted again.

    Returns
    -------
    list of dict
        See :func:`~benchmarks.random_forces.measures.measure`.
    """
    entries = cache.load()
    told = {k: repr(v) for k, v in (settings or {}).items()}
    results, single = list[dict[str, Any]](), _kept(json_file, seed, told)

    def keep() -> None:
        """Write what is there so far, whole or not at all."""
        if json_file is not None:
            content = {"seed": seed, "settings": told, "scenarios": results, "fits": single}
            write_text(json_file, plain.dumps(content, indent=1))

    for name in names:
        scenario = SCENARIOS[name]
        began = time.perf_counter()
        data = simulate(scenario, seed, range(sets))
        kept = {one["number"]: Outcome(**one) for one in single.get(name, ())}
        for one in data:
            if one.number not in kept:
                kept[one.number] = outcome(scenario, one, settings or {})
                single[name] = [asdict(each) for each in kept.values()]
                keep()
        outcomes = [kept[one.number] for one in data]
        results.append(measure(scenario, outcomes, cache.known(entries, scenario, seed, data)))
        last = results[-1]
        tell(
            f"{name}: coverage {last['coverage']:.1f} %, z {last['z']:.2f}, flagged "
            f"{last['flagged']:.0f} % ({time.perf_counter() - began:.0f} s)"
        )
        keep()
    return results


def _kept(json_file: Path | None, seed: int, settings: Mapping[str, str]) -> dict[str, Any]:
    """Fits of an earlier run of the same seed and settings."""
    if json_file is None or not json_file.exists():
        return {}
    earlier = plain.loads(json_file.read_text(encoding="utf-8"))
    same = earlier["seed"] == seed and earlier["settings"] == settings
    return dict(earlier["fits"]) if same else {}


def tell(text: str) -> None:
    """Progress, beside the tables."""
    print(text, file=sys.stderr, flush=True)


def compute_reference(names: Sequence[str], sets: int, seed: int) -> None:
    """Fill the cache, and say whether the reference is what it should be."""
    entries = cache.load()
    head = ("scenario", "sets", "coverage, %", "z", "converged", "levels and times / true, median")
    print("\n".join(markdown(head, ())))
    for name in names:
        scenario = SCENARIOS[name]
        data = simulate(scenario, seed, range(sets))
        if cache.complete(entries, scenario, seed, data, tell):
            cache.save(entries)
        print(reference_row(scenario, data, cache.known(entries, scenario, seed, data)), flush=True)


def reference_row(
    scenario: Scenario, data: Sequence[Set], lines: Mapping[int, Mapping[str, Any]]
) -> str:
    """One row about the reference itself."""
    rows = [lines[one.number] for one in data]
    fits = [SimpleNamespace(truth=one.truth, **row) for one, row in zip(data, rows, strict=True)]
    names = list(VEHICLES[scenario.vehicle].believed)
    found = estimated(names, *errors(fits, names))
    noise = cache.structure(scenario)
    ratios = {
        name: np.median([row["estimates"][name] for row in rows]) / noise.values[name]
        for name in noise.free
    }
    told = ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items())
    converged = 100 * np.mean([row["converged"] for row in rows])
    return (
        f"| {scenario.name} | {len(rows)} | {found['coverage']:.1f} ± {found['coverage_error']:.1f}"
        f" | {found['z']:.2f} | {converged:.0f} % | {told} |"
    )


def main(
    scenarios: Sequence[str] = tuple(SCENARIOS),
    *,
    sets: int = SETS,
    seed: int = SEED,
    json: Path | None = None,
    reference: bool = False,
    disturbances: str = "auto",
    fit_only: bool = False,
    loss: str = "square",
) -> None:
    """Coverage and errors under disturbance forces and imperfect sensors.

    Parameters
    ----------
    scenarios : sequence of str
        all of them by default
    sets : int
        data sets per scenario
    seed : int
        of the data sets
    json : Path
        write measures and every fit there
    reference : bool
        compute the reference instead
    disturbances : str
        auto, none, all, known (swell) or names as Z,M
    fit_only : bool
        no predictions: much quicker
    loss : str
        square, huber or student
    """
    names = [known(name, SCENARIOS, "scenario") for name in scenarios]
    if reference:
        return compute_reference(names, sets, seed)
    places = disturbances if disturbances in KINDS else tuple(disturbances.split(","))
    settings = {"disturbances": places, "loss": loss} | ({"predict": False} if fit_only else {})
    print(table(run(names, sets=sets, seed=seed, settings=settings, json_file=json)))
    return None
