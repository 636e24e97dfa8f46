"""What is fitted and measured, by the command line or for a page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from benchmarks.harness import RESULTS, Row, Store, grouped, known
from benchmarks.random_forces import reference
from benchmarks.random_forces.measures import measure
from benchmarks.random_forces.measures import table as tabulated
from benchmarks.random_forces.scenarios import SCENARIOS
from benchmarks.random_forces.simulator import Set, simulate
from benchmarks.random_forces.trial import Outcome, outcome

STORE = Store(RESULTS / "random_forces.jsonl")
SETS, SEED = 40, 0
KINDS = ("auto", "none", "all")


@dataclass(frozen=True)
class Task:
    """A data set to be fitted, and settings of ``MultipleShooting``."""

    scenario: str
    seed: int
    number: int
    settings: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Name of the case."""
        return f"{self.scenario}/{self.seed}/{self.number} {sorted(self.settings.items())}"


def tasks(
    names: Sequence[str], sets: int, seed: int, settings: Mapping[str, Any]
) -> dict[str, Task]:
    """So many data sets of each scenario."""
    every = [Task(name, seed, number, settings) for name in names for number in range(sets)]
    return {task.key: task for task in every}


def calls(left: Sequence[Task]) -> Iterator[Callable[[], Row]]:
    """What fits each data set; those of a scenario are simulated side by side."""
    for (name, seed), own in grouped(left, lambda task: (task.scenario, task.seed)).items():
        sets = simulate(SCENARIOS[name], seed, [task.number for task in own])
        for task, data in zip(own, sets, strict=True):
            yield partial(fitted, task, data)


def fitted(task: Task, data: Set) -> Row:
    """One fit, and of which data it is."""
    found = asdict(outcome(SCENARIOS[task.scenario], data, task.settings))
    how = {"scenario": task.scenario, "seed": task.seed, "settings": repr(dict(task.settings))}
    return {"key": task.key, **how, "data": data.fingerprint, "fit": found}


def measured(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Measures of every scenario: see :func:`~benchmarks.random_forces.measures.measure`."""
    results = []
    groups = grouped(rows, lambda row: (row["scenario"], row["seed"], row["settings"]))
    for (name, seed, _), own in groups.items():
        scenario, outcomes = SCENARIOS[name], [Outcome(**row["fit"]) for row in own]
        data = {row["fit"]["number"]: row["data"] for row in own}
        results.append(measure(scenario, outcomes, reference.known(scenario, seed, data)))
    return results


def run(
    names: Sequence[str], *, sets: int = SETS, seed: int = SEED, settings: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Fit anew, keeping nothing, and measure."""
    return measured([call() for call in calls([*tasks(names, sets, seed, settings).values()])])


def table(rows: Sequence[Row]) -> str:
    """Measures as Markdown."""
    return tabulated(measured(rows))


def cases(
    scenarios: Sequence[str] = tuple(SCENARIOS),
    *,
    sets: int = SETS,
    seed: int = SEED,
    disturbances: str = "auto",
    fit_only: bool = False,
    loss: str = "square",
) -> dict[str, Task]:
    """Data sets of some scenarios.

    Parameters
    ----------
    scenarios : sequence of str
        all of them by default
    sets : int
        data sets per scenario
    seed : int
        of the data sets
    disturbances : str
        auto, none, all or names as Z,M
    fit_only : bool
        no predictions: much quicker
    loss : str
        square, huber or student
    """
    names = [known(name, SCENARIOS, "scenario") for name in scenarios]
    places = disturbances if disturbances in KINDS else tuple(disturbances.split(","))
    settings = {"disturbances": places, "loss": loss} | ({"predict": False} if fit_only else {})
    return tasks(names, sets, seed, settings)
