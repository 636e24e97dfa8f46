"""Command line: simulate, fit, compare with the reference, tabulate."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Store, known, markdown
from benchmarks.random_forces import reference as cache
from benchmarks.random_forces.measures import errors, estimated, measure, of_reference, table
from benchmarks.random_forces.scenarios import SCENARIOS, VEHICLES, Scenario
from benchmarks.random_forces.simulator import Set, simulate
from benchmarks.random_forces.trial import Outcome, outcome

SETS, SEED = 40, 0
KINDS = ("auto", "none", "all", "known")


def run(
    names: Sequence[str],
    *,
    sets: int = SETS,
    seed: int = SEED,
    settings: Mapping[str, Any] | None = None,
    store: Store | None = None,
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
    store : Store, optional
        Keeps every fit; those that it has, of the same seed and settings, are not made again.

    Returns
    -------
    list of dict
        See :func:`~benchmarks.random_forces.measures.measure`.
    """
    results = list[dict[str, Any]]()
    how = repr(sorted((settings or {}).items()))
    done = store.done() if store else {}
    for name in names:
        scenario, began = SCENARIOS[name], time.perf_counter()
        data, outcomes = simulate(scenario, seed, range(sets)), list[Outcome]()
        for one in data:
            key = f"{cache.key(scenario, seed, one.number)} {how}"
            if key in done:
                outcomes.append(Outcome(**done[key]["fit"]))
                continue
            outcomes.append(outcome(scenario, one, settings or {}))
            if store:
                store.add({"key": key, "fit": asdict(outcomes[-1])})
        results.append(measure(scenario, outcomes, cache.known(scenario, seed, data)))
        last = results[-1]
        tell(
            f"{name}: coverage {last['coverage']:.1f} %, z {last['z']:.2f}, flagged "
            f"{last['flagged']:.0f} % ({time.perf_counter() - began:.0f} s)"
        )
    return results


def tell(text: str) -> None:
    """Progress, beside the tables."""
    print(text, file=sys.stderr, flush=True)


def compute_reference(names: Sequence[str], sets: int, seed: int) -> None:
    """Fill the cache, and say whether the reference is what it should be."""
    rows = list[Sequence[object]]()
    for name in names:
        scenario = SCENARIOS[name]
        data = simulate(scenario, seed, range(sets))
        cache.complete(scenario, seed, data, tell)
        rows.append(reference_row(scenario, data, cache.known(scenario, seed, data)))
    head = ("scenario", "sets", "coverage, %", "z", "converged", "levels and times / true, median")
    print("\n".join(markdown(head, rows)))


def reference_row(
    scenario: Scenario, data: Sequence[Set], lines: Mapping[int, Mapping[str, Any]]
) -> tuple[object, ...]:
    """One row about the reference itself."""
    fits = of_reference(data, lines)
    names = list(VEHICLES[scenario.vehicle].believed)
    found = estimated(names, *errors(fits, names))
    noise = cache.structure(scenario)
    ratios = {
        name: np.median([fit.estimates[name] for fit in fits]) / noise.values[name]
        for name in noise.free
    }
    told = ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items())
    converged = 100 * np.mean([fit.converged for fit in fits])
    coverage = f"{found['coverage']:.1f} ± {found['coverage_error']:.1f}"
    return scenario.name, len(fits), coverage, f"{found['z']:.2f}", f"{converged:.0f} %", told


def main(
    scenarios: Sequence[str] = tuple(SCENARIOS),
    *,
    sets: int = SETS,
    seed: int = SEED,
    store: Path | None = None,
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
    kept = Store(store) if store else None
    print(table(run(names, sets=sets, seed=seed, settings=settings, store=kept)))
    return None
