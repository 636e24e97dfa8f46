"""Shares of finished cases with their intervals and targets, as a table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.harness import markdown

Entry = Mapping[str, Any]
LARGEST_GROUP = 3
TWO_SIDED_95 = 1.96


@dataclass(frozen=True)
class Rate:
    """A share of cases with its 95 % interval and what is wanted.

    Attributes
    ----------
    name : str
    value : float
    count : int
        Cases looked at.
    low, high : float
        Wilson interval of the share; NaN for a number that is no share.
    target : str
    """

    name: str
    value: float
    count: int
    low: float
    high: float
    target: str


def share(
    name: str, is_so: Callable[[Entry], Any], entries: Sequence[Entry], target: str = ""
) -> Rate:
    """Share of cases of which something is so, with Wilson's interval."""
    n = len(entries)
    if n == 0:
        return Rate(name, np.nan, 0, np.nan, np.nan, target)
    value = sum(bool(is_so(entry)) for entry in entries) / n
    z = TWO_SIDED_95
    centre = (value + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * np.sqrt(value * (1 - value) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    low, high = max(float(centre - half), 0.0), min(float(centre + half), 1.0)
    return Rate(name, value, n, low, high, target)


def number(name: str, values: Iterable[float], percent: float, target: str = "") -> Rate:
    """Percentile of numbers that are no share."""
    known = list(values)
    value = float(np.percentile(known, percent)) if known else np.nan
    return Rate(name, value, len(known), np.nan, np.nan, target)


def plain(rates: Iterable[Rate]) -> list[dict[str, Any]]:
    """Rates of any case as plain data."""
    return [asdict(rate) for rate in rates if rate.count]


def claims(entry: Entry) -> bool:
    """Whether anything is claimed."""
    return bool(entry.get("steps"))


def of_kind(entries: Iterable[Entry], hidden: str, *conditions: str) -> list[Entry]:
    """Cases that hide so much under conditions that begin so; under any without conditions."""
    starts = conditions or ("",)
    return [e for e in entries if e["hidden"] == hidden and e["condition"].startswith(starts)]


def rate_table(found: Mapping[str, Any]) -> list[str]:
    """The rates of some measures as Markdown, below the number of cases."""
    rows = []
    for rate in found["rates"]:
        interval = "" if np.isnan(rate["low"]) else f"{rate['low']:.3f} to {rate['high']:.3f}"
        value = f"{rate['value']:.3f}"
        rows.append((rate["name"], value, interval, rate["count"], rate["target"]))
    head = ("measure", "value", "95 % interval", "cases", "target")
    return [f"{found['n_cases']} cases.", "", *markdown(head, rows)]


def section(words: str, head: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """A table below its sentence; nothing without rows."""
    return ["", words, "", *markdown(head, rows)] if rows else []
