"""The reference's numbers, kept beside the benchmark: one line a data set.

An entry holds the fingerprint of its data; where the simulator changes, it is
computed anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.random_forces.reference import Maximum, reference
from benchmarks.random_forces.scenarios import Scenario
from benchmarks.random_forces.simulator import Set

PATH = Path(__file__).with_name("reference.json")
DIGITS = 7


def key(scenario: Scenario, seed: int, number: int) -> str:
    """Name of an entry."""
    return f"{scenario.name}/{seed}/{number}"


def load(path: Path = PATH) -> dict[str, dict[str, Any]]:
    """All entries."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def save(entries: dict[str, dict[str, Any]], path: Path = PATH) -> None:
    """Write all entries, one on a line, sorted."""
    lines = [
        f"{json.dumps(name)}: {json.dumps(entries[name], separators=(',', ':'))}"
        for name in sorted(entries, key=_order)
    ]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def _order(name: str) -> tuple[str, int, int]:
    scenario, seed, number = name.split("/")
    return scenario, int(seed), int(number)


def entry(data: Set, found: Maximum) -> dict[str, Any]:
    """One line of the file."""
    return {
        "data": data.fingerprint,
        "estimates": {name: _short(value) for name, value in found.estimates.items()},
        "std_errors": {name: _short(value, 4) for name, value in found.std_errors.items()},
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
