"""How often the improvement was right, from finished cases."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

Entry = Mapping[str, Any]
LARGEST_GROUP = 3
RISE = 1.02  # validation error after a claim over that before, from which the two contradict


@dataclass(frozen=True)
class Rate:
    """A share of cases with its 95 % Wilson interval (NaN for a number that is no share)."""

    name: str
    value: float
    count: int
    low: float
    high: float
    target: str


def measures(entries: Sequence[Entry]) -> dict[str, Any]:
    """All measures of a run, as plain data.

    Keys: ``n_cases``, ``rates`` (rows of :class:`Rate`), ``by_effect``, ``failures``.
    """
    return {
        "n_cases": len(entries),
        "rates": [asdict(rate) for rate in _rates(entries) if rate.count],
        "by_effect": _by_effect(entries),
        "failures": [_failure(entry) for entry in entries if faults(entry)],
    }


def aborted(entry: Entry) -> bool:
    """Whether the improvement ended without a result."""
    return "error" in entry


def claims(entry: Entry) -> bool:
    """Whether anything is claimed."""
    return bool(entry.get("steps"))


def names_of(entry: Entry, name: str) -> set[str]:
    """Names under which a hidden effect may be claimed."""
    return {name, *entry.get("same_as", {}).get(name, ())}


def right_first(entry: Entry) -> bool:
    """Whether the first effect claimed is one of the hidden ones."""
    right = set().union(*(names_of(entry, name) for name in entry["effects"]))
    return claims(entry) and entry["steps"][0]["added"] in right


def right_group(entry: Entry) -> bool:
    """Whether a hidden effect is the first claimed, or in its group of at most three."""
    if not claims(entry):
        return False
    group = set(entry["steps"][0]["group"])
    right = set().union(*(names_of(entry, name) for name in entry["effects"]))
    return right_first(entry) or (len(group) <= LARGEST_GROUP and bool(group & right))


def accepted(entry: Entry) -> bool:
    """Whether every hidden effect is claimed, itself or in a group of at most three."""
    named: set[str] = set()
    for step in entry.get("steps", ()):
        named.add(step["added"])
        if len(step["group"]) <= LARGEST_GROUP:
            named |= set(step["group"])
    return all(named & names_of(entry, name) for name in entry["effects"])


def more_claimed(entry: Entry) -> bool:
    """Whether more effects are claimed than are hidden."""
    return len(entry.get("steps", ())) > len(entry["effects"])


def contradicts(entry: Entry) -> bool:
    """Whether a claim stands beside a validation error that rises with it, or is no number."""
    if not claims(entry):
        return False
    before = _value(entry["base_error"].get("test"))
    for step in entry["steps"]:
        after = _value(step["test_error"])
        # From an infinite error anything finite is an improvement.
        if not np.isfinite(after) or (np.isfinite(before) and after > RISE * before):
            return True
        before = after
    return False


def _value(text: Any) -> float:
    return float("nan") if text is None else float(text)


def ratio(entry: Entry) -> float:
    """Validation error of what was found over that of the true structure; NaN without both."""
    found, true = (_value(entry.get(f"{kind}_validation")) for kind in ("found", "true"))
    return found / true if np.isfinite(true) and true > 0 else float("nan")


def _rates(entries: Sequence[Entry]) -> list[Rate]:
    rates = []
    for vehicle in (None, *dict.fromkeys(entry["vehicle"] for entry in entries)):
        own = [e for e in entries if vehicle in (None, e["vehicle"])]
        head = f"{vehicle or 'all'}: "
        seen = [e for e in own if e["hidden"] == "single" and e["detectable"]]
        rates += [
            _share(head + "right effect first", right_first, seen, ""),
            _share(head + "right effect first or in its group", right_group, seen, ""),
            _share(head + "right effect accepted", accepted, seen, ">= 0.95"),
            _share(head + "no abort", lambda e: not aborted(e), own, "1"),
            _share(
                head + "nothing hidden: false claims",
                claims,
                [e for e in own if e["hidden"] == "none"],
                "<= 0.02",
            ),
        ]
    for condition in ("white", "waves", "input_noise"):
        own = [e for e in entries if e["condition"] == condition]
        none = [e for e in own if e["hidden"] == "none"]
        seen = [e for e in own if e["hidden"] == "single" and e["detectable"]]
        rates.append(_share(f"{condition}, nothing hidden: false claims", claims, none, "<= 0.02"))
        rates.append(_share(f"{condition}: right effect accepted", accepted, seen, ">= 0.95"))
    for declared, words in ((True, "noise declared"), (False, "noise not declared")):
        seen = [
            e
            for e in entries
            if e["hidden"] == "single" and e["detectable"] and e["declared"] is declared
        ]
        rates.append(_share(f"{words}: right effect accepted", accepted, seen, ">= 0.95"))
    pairs = [e for e in entries if e["hidden"] == "pair" and e["detectable"]]
    hidden = [e for e in entries if e["hidden"] != "none"]
    rates += [
        _share("two hidden: both found", accepted, pairs, ""),
        _share("two hidden: one of them first", right_group, pairs, ""),
        _share("claims more than is hidden", more_claimed, hidden, ""),
        _share("claim beside a validation error that rises", contradicts, entries, "0"),
        _share("hidden effects that are detectable", lambda e: e["detectable"], hidden, ""),
    ]
    ratios = np.array([r for r in map(ratio, entries) if not np.isnan(r)])
    seconds = np.array([e["processor_seconds"] for e in entries])
    for percent in (50, 90):
        words = f"validation error, found over true structure: {percent} %"
        rates.append(_number(words, ratios, percent))
    for percent in (50, 90):
        rates.append(_number(f"processor seconds of a case: {percent} %", seconds, percent))
    return rates


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


def _number(name: str, values: np.ndarray, percent: float) -> Rate:
    value = float(np.percentile(values, percent)) if len(values) else np.nan
    return Rate(name, value, len(values), np.nan, np.nan, "")


def _by_effect(entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """Per vehicle and single hidden effect: detectable cases, right ones, and rivals."""
    table = []
    single = [e for e in entries if e["hidden"] == "single"]
    for vehicle, name in sorted({(e["vehicle"], e["effects"][0]) for e in single}):
        own = [e for e in single if (e["vehicle"], e["effects"][0]) == (vehicle, name)]
        shown = [e for e in own if e["detectable"]]
        wrong = [e for e in shown if not right_group(e)]
        table.append(
            {
                "vehicle": vehicle,
                "effect": name,
                "cases": len(own),
                "detectable": len(shown),
                "right_first": sum(map(right_first, shown)),
                "right_group": sum(map(right_group, shown)),
                "mistaken_for": sorted({_first(e) for e in wrong}),
            }
        )
    return table


def _first(entry: Entry) -> str:
    if aborted(entry):
        return "an abort"
    return str(entry["steps"][0]["added"]) if claims(entry) else "nothing"


def faults(entry: Entry) -> list[str]:
    """What went wrong in a case, in words; empty where nothing did."""
    found = []
    if aborted(entry):
        found.append(f"aborted: {entry['error']}")
    elif entry["hidden"] == "none":
        if claims(entry):
            found.append("false claim")
    elif entry["detectable"]:
        if not claims(entry):
            found.append("refused")
        elif not accepted(entry):
            found.append("one of two missed" if right_group(entry) else "wrong effect")
        elif not right_group(entry):
            found.append("wrong effect first")
        elif more_claimed(entry):
            found.append("claims too much")
    if contradicts(entry):
        found.append("claim beside a validation error that rises")
    return found


def _failure(entry: Entry) -> dict[str, Any]:
    return {
        "case": entry["key"],
        "hidden": [f"{n} ({entry['true_gains'][n]:.0f})" for n in entry["effects"]],
        "added": [s["added"] for s in entry.get("steps", ())],
        "group": entry["steps"][0]["group"] if claims(entry) else [],
        "refused": entry.get("rejected", []),
        "order": entry.get("order", [])[:3],
        "ratio": ratio(entry),
        "faults": faults(entry),
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
            "One hidden effect; of the detectable cases:",
            "",
            "| vehicle | hidden effect | cases | detectable | first | or in its group "
            "| otherwise |",
            "|---|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {row['vehicle']} | {row['effect']} | {row['cases']} | {row['detectable']} "
            f"| {row['right_first']} | {row['right_group']} | {', '.join(row['mistaken_for'])} |"
            for row in found["by_effect"]
        ]
    if found["failures"]:
        lines += [
            "",
            "What went wrong (expected gains in twice the log-likelihood):",
            "",
            "| case | hidden (gain) | claimed | first group | refused | ranked first "
            "| error over true | fault |",
            "|---|---|---|---|---|---|---|---|",
        ]
        lines += [
            f"| {row['case']} | {', '.join(row['hidden']) or 'nothing'} "
            f"| {', '.join(row['added']) or 'nothing'} | {', '.join(row['group'])} "
            f"| {', '.join(row['refused'])} | {', '.join(row['order'])} | {row['ratio']:.3f} "
            f"| {'; '.join(row['faults'])} |"
            for row in found["failures"]
        ]
    return "\n".join(lines)
