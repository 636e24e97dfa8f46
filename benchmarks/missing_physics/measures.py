"""How often the improvement was right, from finished cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.harness import Row
from benchmarks.missing_physics.cases import DATA
from benchmarks.rates import (
    AS_GOOD,
    Entry,
    by_effect,
    claims,
    number,
    of_kind,
    right_first,
    right_group,
    share,
)
from benchmarks.rates import as_markdown as tables


def measures(entries: Sequence[Entry]) -> dict[str, Any]:
    """All measures of a benchmark run, as plain data.

    Keys: ``rates`` (see :func:`benchmarks.rates.share`), ``by_effect``, ``failures``,
    ``broken``.
    """
    broken = [entry for entry in entries if "error" in entry]
    sound = [entry for entry in entries if "error" not in entry]
    return {
        "n_cases": len(entries),
        "rates": [rate for rate in _rates(sound) if rate["count"]],
        "by_effect": by_effect(of_kind(sound, "single", "white")),
        "failures": [_failure(entry) for entry in sound if _is_failure(entry)],
        "broken": [{"case": entry["key"], "error": entry["error"]} for entry in broken],
    }


def first_three(entry: Entry) -> bool:
    """Whether a hidden effect is among the three first of the ranking."""
    return bool(set(entry["order"][:3]) & set(entry["effects"]))


def all_found(entry: Entry) -> bool:
    """Whether every hidden effect was added."""
    return set(entry["effects"]) <= {step["added"] for step in entry["steps"]}


def exactly_found(entry: Entry) -> bool:
    """Whether every hidden effect was added and nothing else."""
    return set(entry["effects"]) == {step["added"] for step in entry["steps"]}


def right_equation(entry: Entry) -> bool:
    """Whether what was added acts on the axis of the hidden unknown term, and nowhere else."""
    (name,) = entry["effects"]
    return {step["equation"] for step in entry["steps"]} == {DATA["unknown"][name]["axis"]}


def as_good(entry: Entry) -> bool:
    """Whether the error on the test records is that of the true structure."""
    return bool(float(entry["final_error"]["test"]) <= AS_GOOD * entry["true_test_error"])


def _rates(entries: Sequence[Entry]) -> list[Row]:
    single, none = of_kind(entries, "single", "white"), of_kind(entries, "none", "white")
    pair, unknown = of_kind(entries, "pair", "white"), of_kind(entries, "unknown", "white")
    shown, pairs, terms = ([e for e in k if e["detectable"]] for k in (single, pair, unknown))
    rates = [
        share("single, detectable: right effect first", right_first, shown, ">= 0.95"),
        share("single, detectable: in the first group (<= 3)", right_group, shown, ">= 0.98"),
        share("single, detectable: in the first three", first_three, shown, ">= 0.99"),
        share("single, detectable: found and nothing else", exactly_found, shown),
        share("single: detectable", lambda e: e["detectable"], single),
        share("nothing hidden: false claims", claims, none, "<= 0.02"),
        share("two, both detectable: both found", all_found, pairs, ">= 0.85"),
        share("two, both detectable: exactly both", exactly_found, pairs),
        share("two, both detectable: one of them first", right_first, pairs),
    ]
    for condition in sorted({e["condition"] for e in entries} - {"white"}):
        words, none = f"{condition}, nothing hidden", of_kind(entries, "none", condition)
        rates.append(share(f"{words}: false claims", claims, none, "<= 0.05"))
        seen = [e for e in of_kind(entries, "single", condition) if e["detectable"]]
        rates.append(share(f"{condition}, detectable: right first", right_first, seen, ">= 0.90"))
    disturbed = of_kind(entries, "none", "colour", "force", "gust")
    known = [e for e in (*single, *pair) if e["effects"]]
    ratios = [float(e["final_error"]["test"]) / e["true_test_error"] for e in known]
    seconds = [e["processor_seconds"] for e in entries]
    error, spent = "test error after / true structure's", "processor seconds per case"
    better = "unknown effect: test error after <= 1.05 x true term's"
    right = "unknown effect: only the right equation is changed"
    return [
        *rates,
        share("disturbed, nothing hidden: false claims", claims, disturbed, "<= 0.05"),
        number(f"{error}: median", ratios, 50, "<= 1.02"),
        number(f"{error}: 90th percentile", ratios, 90, "<= 1.10"),
        share(better, as_good, terms, ">= 0.85"),
        share(right, right_equation, terms, ">= 0.95"),
        number(f"{spent}: median", seconds, 50, "<= 10"),
        number(f"{spent}: 90th percentile", seconds, 90),
    ]


def _is_failure(entry: Entry) -> bool:
    if entry["hidden"] == "none":
        return claims(entry)
    if not entry["detectable"]:
        return False
    if entry["hidden"] == "unknown":
        return not as_good(entry)
    return not exactly_found(entry)


def _failure(entry: Entry) -> dict[str, Any]:
    steps = [f"{s['added']} ({s['evidence']:.1f})" for s in entry["steps"]]
    truth = [f"{n} ({entry['true_gains'][n]:.1f})" for n in entry["effects"]]
    return {
        "case": entry["key"],
        "hidden": truth or ["nothing"],
        "added": steps or ["nothing"],
        "first_group": list(entry["steps"][0]["group"]) if entry["steps"] else [],
        "refused": list(entry["rejected"]),
        "test_error": float(entry["final_error"]["test"]),
        "true_test_error": entry["true_test_error"],
    }


def as_markdown(found: Mapping[str, Any]) -> str:
    """The measures as Markdown tables."""
    return tables(
        found,
        (
            "One hidden effect, white noise; of the detectable cases:",
            {
                "hidden effect": "effect", "cases": "cases", "detectable": "detectable",
                "first": "right_first", "in the group": "right_group",
                "mistaken for": "mistaken_for",
            },
        ),
        (
            "Cases that went wrong (in brackets likelihood-ratio statistics):",
            {
                "case": "case", "hidden": "hidden", "added": "added",
                "first group": "first_group", "refused": "refused", "test error": "test_error",
                "best": "true_test_error",
            },
        ),
    )  # fmt: skip
