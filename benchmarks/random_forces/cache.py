"""The reference's numbers, kept beside the benchmark: one line a data set.

A line reads ``"scenario/seed/number": [fingerprint of the data, 1 if converged,
estimates, standard errors]``; parameters come in the order of
``Vehicle.believed``, then the noise that :func:`~benchmarks.random_forces.reference.structure`
leaves free. Where the simulator changes, the fingerprint differs and the line is
computed anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.random_forces.reference import Maximum, reference, structure
from benchmarks.random_forces.scenarios import SCENARIOS, Scenario
from benchmarks.random_forces.simulator import Set
from benchmarks.random_forces.vehicles import VEHICLES

PATH = Path(__file__).with_name("reference.json")
DIGITS = 7  # of an estimate


def key(scenario: Scenario, seed: int, number: int) -> str:
    """Name of an entry."""
    return f"{scenario.name}/{seed}/{number}"


def names(scenario: Scenario) -> list[str]:
    """What the reference estimates, in order."""
    return [*VEHICLES[scenario.vehicle].believed, *structure(scenario).free]


def load(path: Path = PATH) -> dict[str, dict[str, Any]]:
    """All entries."""
    if not path.exists():
        return {}
    entries = {}
    for name, line in json.loads(path.read_text(encoding="utf-8")).items():
        fingerprint, converged, estimates, std_errors = line
        order = names(SCENARIOS[name.partition("/")[0]])
        entries[name] = {
            "data": fingerprint,
            "estimates": dict(zip(order, estimates, strict=True)),
            "std_errors": dict(zip(order, std_errors, strict=True)),
            "converged": bool(converged),
        }
    return entries


def save(entries: dict[str, dict[str, Any]], path: Path = PATH) -> None:
    """Write all entries, one on a line, sorted."""
    lines = []
    for name in sorted(entries, key=_order):
        line = entries[name]
        numbers = [
            line["data"],
            int(line["converged"]),
            list(line["estimates"].values()),
            list(line["std_errors"].values()),
        ]
        lines.append(f"{json.dumps(name)}: {json.dumps(numbers, separators=(',', ':'))}")
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _order(name: str) -> tuple[str, int, int]:
    scenario, seed, number = name.split("/")
    return scenario, int(seed), int(number)


def entry(data: Set, found: Maximum) -> dict[str, Any]:
    """One line of the file."""
    return {
        "data": data.fingerprint,
        "estimates": {name: _short(value) for name, value in found.estimates.items()},
        "std_errors": {name: _short(value, 3) for name, value in found.std_errors.items()},
        "converged": found.converged,
    }


def _short(value: float, digits: int = DIGITS) -> float:
    return float(f"{value:.{digits}g}")


def known(
    entries: dict[str, dict[str, Any]], scenario: Scenario, seed: int, sets: Sequence[Set]
) -> dict[int, dict[str, Any]]:
    """Entries of these data sets, by number; those of other data are left out."""
    found = {}
    for data in sets:
        line = entries.get(key(scenario, seed, data.number))
        if line is not None and abs(line["data"] / data.fingerprint - 1.0) < 1e-7:
            found[data.number] = line
    return found


def complete(
    entries: dict[str, dict[str, Any]],
    scenario: Scenario,
    seed: int,
    sets: Sequence[Set],
    tell: Callable[[str], None],
) -> int:
    """Compute what is missing; return how many that were."""
    have = known(entries, scenario, seed, sets)
    missing = [data for data in sets if data.number not in have]
    for data in missing:
        entries[key(scenario, seed, data.number)] = entry(data, reference(scenario, data))
    tell(f"{scenario.name}: reference of {len(missing)} data sets, {len(have)} were there")
    return len(missing)
