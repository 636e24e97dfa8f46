"""Hidden effects, whoever simulates: what a search claims, what could be found, how often it is.

:func:`searched` runs and reads a search, and :func:`as_markdown` tells its measures. A benchmark
brings its cases, what could have been found in them (``detectable``), and the rates that it wants.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from benchmarks.harness import TWO_SIDED_95, Row, markdown, places_of
from oed_sysid import Dataset, Model, improve
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.physics import Effect

Entry = Mapping[str, Any]
LARGEST_GROUP = 3
AS_GOOD = 1.05  # error of a model over that of the true structure, up to which it is as good


def _rate(
    name: str, value: float, count: int, target: str, low: float = np.nan, high: float = np.nan
) -> Row:
    """A number, of how many cases, its 95 % interval if it is a share, and what is wanted."""
    row = {"name": name, "value": value, "count": count}
    return row | {"low": low, "high": high, "target": target}


def share(
    name: str, is_so: Callable[[Entry], Any], entries: Sequence[Entry], target: str = ""
) -> Row:
    """Share of cases of which something is so, with Wilson's interval."""
    n = len(entries)
    if n == 0:
        return _rate(name, np.nan, 0, target)
    value = sum(bool(is_so(entry)) for entry in entries) / n
    z = TWO_SIDED_95
    centre = (value + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * np.sqrt(value * (1 - value) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    low, high = max(float(centre - half), 0.0), min(float(centre + half), 1.0)
    return _rate(name, value, n, target, low, high)


def number(name: str, values: Iterable[float], percent: float, target: str = "") -> Row:
    """Percentile of numbers that are no share."""
    known = list(values)
    value = float(np.percentile(known, percent)) if known else np.nan
    return _rate(name, value, len(known), target)


def finite(value: float) -> float | str:
    """A number that JSON can hold, or its name."""
    return float(value) if np.isfinite(value) else str(float(value))


def read(found: Improvement) -> Row:
    """What benchmarks want to know of an improvement: the one place that names its attributes."""
    return {
        "verdict": str(found.verdict),
        "kind": found.remains.kind,
        "words": [str(line) for line in found.advice],
        "steps": [
            {
                "added": step.added,
                # Axis on which a force acts, else the stage of the effect.
                "equation": "+".join(step.effect.terms)
                if step.effect.stage == "force"
                else step.effect.stage,
                "group": list(step.group),
                "evidence": step.claim.training,
                "needed": step.claim.needed,
                "test_gain": step.claim.validation,
                "train_error": finite(step.train_error),
                "test_error": finite(step.test_error),
            }
            for step in found.steps
        ],
        "order": list(found.ranking.order[:8]),
        "gains": {refit.name: round(refit.gain, 2) for refit in found.ranking.refits},
        "rejected": list(found.rejected),
        "remainder": finite(found.remainder),
        "proposed": [dict(term) for term in found.proposed],
        "base_error": {k: finite(v) for k, v in found.base_error.items()},
        "final_error": {k: finite(v) for k, v in found.final_error.items()},
    }


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise :class:`TimeoutError` in the main thread when that much processor time is spent."""

    def stop(number: int, frame: object) -> None:
        raise TimeoutError(f"not finished after {seconds:g} s of processor time")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def searched(
    model: Model,
    train: Dataset,
    test: Dataset,
    candidates: Sequence[Effect] | None,
    *,
    limit: float = 600.0,
) -> tuple[Improvement | None, Row]:
    """Search for what is missing: what was found, and all that benchmarks want to know of it.

    A search that breaks, or takes more than ``limit`` seconds of processor time, is a result
    too: ``error`` and ``traceback`` in place of what :func:`read` tells.
    """
    began, processor = time.perf_counter(), time.process_time()
    found, told = None, {}
    try:
        with at_most(limit):
            found = improve(model, train, test, candidates=candidates)
        told = read(found)
    except Exception as error:
        told = {"error": f"{type(error).__name__}: {error}", "traceback": places_of(error)}
    told["seconds"] = time.perf_counter() - began
    told["processor_seconds"] = time.process_time() - processor
    return found, told


def detectable(gains: Iterable[float], needed: float) -> bool:
    """Whether every hidden effect shows: what it gains with all others in the model is enough.

    Of gains in the records at hand (refits of the true structure) that is the threshold of a claim.
    Gains that are *expected* scatter about their expectation, and need a margin above it.
    """
    return all(gain >= needed for gain in gains)


def claims(entry: Entry) -> bool:
    """Whether anything is claimed."""
    return bool(entry.get("steps"))


def names_of(entry: Entry, name: str) -> set[str]:
    """Names under which a hidden effect may be claimed."""
    return {name, *entry.get("same_as", {}).get(name, ())}


def _right(entry: Entry) -> set[str]:
    """All names that are right."""
    return set().union(*(names_of(entry, name) for name in entry["effects"]))


def right_first(entry: Entry) -> bool:
    """Whether the first effect claimed is one of the hidden ones."""
    return claims(entry) and entry["steps"][0]["added"] in _right(entry)


def right_group(entry: Entry) -> bool:
    """Whether a hidden effect is the first claimed, or in its group of at most three."""
    if not claims(entry):
        return False
    group = set(entry["steps"][0]["group"])
    return right_first(entry) or (len(group) <= LARGEST_GROUP and bool(group & _right(entry)))


def of_kind(entries: Iterable[Entry], hidden: str, *conditions: str) -> list[Entry]:
    """Cases that hide so much under conditions that begin so; under any without conditions."""
    starts = conditions or ("",)
    return [e for e in entries if e["hidden"] == hidden and e["condition"].startswith(starts)]


def first_claim(entry: Entry) -> str:
    """What a case ended in."""
    if "error" in entry:
        return "an abort"
    return str(entry["steps"][0]["added"]) if claims(entry) else "nothing"


def summary(entry: Entry) -> str:
    """One case in one line."""
    hidden = " + ".join(entry["effects"]) or "nothing"
    sight = "" if entry.get("detectable") else " (invisible)"
    if "error" in entry:
        return f"{entry['key']} {hidden}{sight} -> FAILED {entry['error'][:120]}"
    added = " + ".join(step["added"] for step in entry["steps"]) or "nothing"
    return f"{entry['key']} {hidden}{sight} -> {added} ({entry['processor_seconds']:.1f} s)"


def by_effect(entries: Iterable[Entry]) -> list[dict[str, Any]]:
    """Per vehicle and single hidden effect: cases, detectable ones, right ones, and rivals."""
    table = []
    single = [(e.get("vehicle", ""), name, e) for e in entries for name in e["effects"]]
    for vehicle, name in sorted({(vehicle, name) for vehicle, name, _ in single}):
        own = [e for of, effect, e in single if (of, effect) == (vehicle, name)]
        shown = [e for e in own if e["detectable"]]
        wrong = {first_claim(e) for e in shown if not right_first(e)}
        table.append(
            {
                "vehicle": vehicle,
                "effect": name,
                "cases": len(own),
                "detectable": len(shown),
                "right_first": sum(map(right_first, shown)),
                "right_group": sum(map(right_group, shown)),
                "mistaken_for": sorted(wrong),
            }
        )
    return table


def as_markdown(
    found: Mapping[str, Any],
    effects: tuple[str, Mapping[str, str]],
    failures: tuple[str, Mapping[str, str]],
) -> str:
    """Measures as Markdown: rates, then what became of every effect, then what went wrong.

    Parameters
    ----------
    found : mapping
        ``n_cases``, ``rates``, ``by_effect``, ``failures`` and, where cases broke, ``broken``.
    effects, failures : tuple of str and mapping
        The sentence above either table, and the keys of its rows by their heads.
    """
    rows = []
    for rate in found["rates"]:
        interval = "" if np.isnan(rate["low"]) else f"{rate['low']:.3f} to {rate['high']:.3f}"
        value = f"{rate['value']:.3f}"
        rows.append((rate["name"], value, interval, rate["count"], rate["target"]))
    head = ("measure", "value", "95 % interval", "cases", "target")
    lines = [f"{found['n_cases']} cases.", "", *markdown(head, rows)]
    for (words, columns), table in ((effects, found["by_effect"]), (failures, found["failures"])):
        cells = [[_cell(row[key]) for key in columns.values()] for row in table]
        lines += ["", words, "", *markdown(list(columns), cells)] if cells else []
    if found.get("broken"):
        lines += ["", "Cases that broke:", ""]
        lines += [f"- {row['case']}: {row['error']}" for row in found["broken"]]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    """A list by commas, a fraction to three digits."""
    if isinstance(value, float):
        return f"{value:.3f}"
    return ", ".join(value) if isinstance(value, list) else str(value)
