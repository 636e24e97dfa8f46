"""How often the improvement was right, from finished cases."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.missing_physics.truth import UNKNOWN_TERMS

Entry = Mapping[str, Any]
LARGEST_GROUP = 3


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


def measures(entries: Sequence[Entry]) -> dict[str, Any]:
    """All measures of a benchmark run, as plain data.

    Keys: ``rates`` (rows of :class:`Rate`), ``by_effect``, ``failures``,
    ``broken``.
    """
    broken = [entry for entry in entries if "error" in entry]
    sound = [entry for entry in entries if "error" not in entry]
    rates = [*_rates(sound)]
    return {
        "n_cases": len(entries),
        "rates": [asdict(rate) for rate in rates],
        "by_effect": _by_effect(_kind(sound, "single", "white")),
        "failures": [_failure(entry) for entry in sound if _is_failure(entry)],
        "broken": [{"case": entry["key"], "error": entry["error"]} for entry in broken],
    }


def _kind(entries: Sequence[Entry], hidden: str, *conditions: str) -> list[Entry]:
    return [e for e in entries if e["hidden"] == hidden and e["condition"].startswith(conditions)]


def right_first(entry: Entry) -> bool:
    """Whether the first effect added is one of the hidden ones."""
    return bool(entry["steps"]) and entry["steps"][0]["added"] in entry["effects"]


def right_group(entry: Entry) -> bool:
    """Whether a hidden effect is in the first step's group of at most three."""
    if not entry["steps"]:
        return False
    group = entry["steps"][0]["group"]
    return len(group) <= LARGEST_GROUP and bool(set(group) & set(entry["effects"]))


def first_three(entry: Entry) -> bool:
    """Whether a hidden effect is among the three first of the ranking."""
    return bool(set(entry["order"][:3]) & set(entry["effects"]))


def claims(entry: Entry) -> bool:
    """Whether anything is claimed."""
    return bool(entry["steps"])


def all_found(entry: Entry) -> bool:
    """Whether every hidden effect was added."""
    return set(entry["effects"]) <= {step["added"] for step in entry["steps"]}


def exactly_found(entry: Entry) -> bool:
    """Whether every hidden effect was added and nothing else."""
    return set(entry["effects"]) == {step["added"] for step in entry["steps"]}


def right_equation(entry: Entry) -> bool:
    """Whether what was added acts on the axis of the hidden unknown term, and nowhere else."""
    (name,) = entry["effects"]
    return {step["equation"] for step in entry["steps"]} == {UNKNOWN_TERMS[name][0]}


def _rates(entries: Sequence[Entry]) -> list[Rate]:
    single = _kind(entries, "single", "white")
    shown = [e for e in single if e["detectable"]]
    pairs = [e for e in _kind(entries, "pair", "white") if e["detectable"]]
    disturbed = ("colour", "force", "gust")
    rates = [
        _share("single, detectable: right effect first", right_first, shown, ">= 0.95"),
        _share("single, detectable: in the first group (<= 3)", right_group, shown, ">= 0.98"),
        _share("single, detectable: in the first three", first_three, shown, ">= 0.99"),
        _share("single, detectable: found and nothing else", exactly_found, shown, ""),
        _share("single: detectable", lambda e: e["detectable"], single, ""),
        _share("nothing hidden: false claims", claims, _kind(entries, "none", "white"), "<= 0.02"),
        _share("two, both detectable: both found", all_found, pairs, ">= 0.85"),
        _share("two, both detectable: exactly both", exactly_found, pairs, ""),
        _share("two, both detectable: one of them first", right_first, pairs, ""),
    ]
    for condition in sorted({e["condition"] for e in entries if e["condition"] != "white"}):
        none = _kind(entries, "none", condition)
        rates.append(_share(f"{condition}, nothing hidden: false claims", claims, none, "<= 0.05"))
        seen = [e for e in _kind(entries, "single", condition) if e["detectable"]]
        rates.append(_share(f"{condition}, detectable: right first", right_first, seen, ">= 0.90"))
    rates.append(
        _share(
            "disturbed, nothing hidden: false claims",
            claims,
            _kind(entries, "none", *disturbed),
            "<= 0.05",
        )
    )
    with_truth = [e for e in (*single, *_kind(entries, "pair", "white")) if e["effects"]]
    ratios = np.array([e["final_error"]["test"] / e["true_test_error"] for e in with_truth])
    rates += [
        _number("test error after / true structure's: median", ratios, 50, "<= 1.02"),
        _number("test error after / true structure's: 90th percentile", ratios, 90, "<= 1.10"),
    ]
    unknown = _kind(entries, "unknown", "white")
    rates += [
        _share(
            "unknown effect: test error after <= 1.05 x true term's",
            lambda e: e["final_error"]["test"] <= 1.05 * e["true_test_error"],
            [e for e in unknown if e["detectable"]],
            ">= 0.85",
        ),
        _share(
            "unknown effect: only the right equation is changed",
            right_equation,
            [e for e in unknown if e["detectable"]],
            ">= 0.95",
        ),
    ]
    seconds = np.array([e["processor_seconds"] for e in entries])
    rates.append(_number("processor seconds per case: median", seconds, 50, "<= 10"))
    rates.append(_number("processor seconds per case: 90th percentile", seconds, 90, ""))
    return [rate for rate in rates if rate.count]


def _share(name: str, is_so: Callable[[Entry], Any], entries: Sequence[Entry], target: str) -> Rate:
    n = len(entries)
    if n == 0:
        return Rate(name, np.nan, 0, np.nan, np.nan, target)
    share = sum(bool(is_so(entry)) for entry in entries) / n
    z = 1.96
    centre = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z * np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
    return Rate(
        name, share, n, max(float(centre - half), 0.0), min(float(centre + half), 1.0), target
    )


def _number(name: str, values: np.ndarray, percentile: float, target: str) -> Rate:
    if not len(values):
        return Rate(name, np.nan, 0, np.nan, np.nan, target)
    return Rate(name, float(np.percentile(values, percentile)), len(values), np.nan, np.nan, target)


def _by_effect(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """Per hidden effect: cases, detectable ones, right first, in the group."""
    table = []
    for name in sorted({name for entry in entries for name in entry["effects"]}):
        own = [e for e in entries if name in e["effects"]]
        shown = [e for e in own if e["detectable"]]
        table.append(
            {
                "effect": name,
                "cases": len(own),
                "detectable": len(shown),
                "right_first": sum(right_first(e) for e in shown),
                "right_group": sum(right_group(e) for e in shown),
                "mistaken_for": sorted(
                    {e["steps"][0]["added"] if e["steps"] else "nothing" for e in shown} - {name}
                ),
            }
        )
    return table


def _is_failure(entry: Entry) -> bool:
    if entry["hidden"] == "none":
        return claims(entry)
    if not entry["detectable"]:
        return False
    if entry["hidden"] == "unknown":
        return entry["final_error"]["test"] > 1.05 * entry["true_test_error"]
    return not exactly_found(entry)


def _failure(entry: Entry) -> dict[str, Any]:
    steps = [f"{s['added']} ({s['evidence']:.1f})" for s in entry["steps"]]
    truth = [f"{n} ({entry['true_gains'][n]:.1f})" for n in entry["effects"]]
    return {
        "case": entry["key"],
        "hidden": truth,
        "added": steps,
        "first_group": list(entry["steps"][0]["group"]) if entry["steps"] else [],
        "refused": list(entry["rejected"]),
        "test_error": entry["final_error"]["test"],
        "true_test_error": entry["true_test_error"],
    }


def as_markdown(found: Mapping[str, Any]) -> str:
    """The measures as Markdown tables."""
    lines = [
        f"{found['n_cases']} cases.",
        "",
        "| measure | value | 95 % interval | cases | target |",
        "|---|---|---|---|---|",
    ]
    for rate in found["rates"]:
        interval = "" if np.isnan(rate["low"]) else f"{rate['low']:.3f} to {rate['high']:.3f}"
        lines.append(
            f"| {rate['name']} | {rate['value']:.3f} | {interval} | {rate['count']} "
            f"| {rate['target']} |"
        )
    if found["by_effect"]:
        lines += [
            "",
            "One hidden effect, white noise; of the detectable cases:",
            "",
            "| hidden effect | cases | detectable | first | in the group | mistaken for |",
            "|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {row['effect']} | {row['cases']} | {row['detectable']} | {row['right_first']} "
            f"| {row['right_group']} | {', '.join(row['mistaken_for'])} |"
            for row in found["by_effect"]
        ]
    if found["failures"]:
        lines += [
            "",
            "Cases that went wrong (gains in twice the log-likelihood):",
            "",
            "| case | hidden (gain) | added (gain) | first group | refused | test error | best |",
            "|---|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {row['case']} | {', '.join(row['hidden']) or 'nothing'} "
            f"| {', '.join(row['added']) or 'nothing'} | {', '.join(row['first_group'])} "
            f"| {', '.join(row['refused'])} | {row['test_error']:.3f} "
            f"| {row['true_test_error']:.3f} |"
            for row in found["failures"]
        ]
    if found["broken"]:
        lines += ["", "Cases that broke:", ""]
        lines += [f"- {row['case']}: {row['error']}" for row in found["broken"]]
    return "\n".join(lines)
