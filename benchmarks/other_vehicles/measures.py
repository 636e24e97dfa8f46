"""How often the improvement was right on vehicles that nothing was tuned for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.harness import Row, grouped, tabulate
from benchmarks.rates import (
    AS_GOOD,
    LARGEST_GROUP,
    Entry,
    by_effect,
    claims,
    names_of,
    number,
    of_kind,
    right_first,
    right_group,
    share,
)
from benchmarks.rates import as_markdown as tables

PERCENT = (50, 90)
RISE = 1.02  # validation error after a claim over that before, from which the two contradict


def measures(entries: Sequence[Entry]) -> dict[str, Any]:
    """All measures of a run, as plain data.

    Keys: ``n_cases``, ``rates`` (see :func:`benchmarks.rates.share`), ``by_effect``,
    ``failures``.
    """
    return {
        "n_cases": len(entries),
        "rates": [rate for rate in _rates(entries) if rate["count"]],
        "by_effect": by_effect(e for e in entries if e["hidden"] == "single"),
        "failures": [_failure(entry) for entry in entries if faults(entry)],
    }


def aborted(entry: Entry) -> bool:
    """Whether the improvement ended without a result."""
    return "error" in entry


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


def _detectable(entries: Sequence[Entry], hidden: str = "single", *conditions: str) -> list[Entry]:
    return [e for e in of_kind(entries, hidden, *conditions) if e["detectable"]]


def _rates(entries: Sequence[Entry]) -> list[Row]:
    rates = _of_vehicle("all", entries)
    for vehicle in dict.fromkeys(entry["vehicle"] for entry in entries):
        rates += _of_vehicle(vehicle, [e for e in entries if e["vehicle"] == vehicle])
    for condition in ("white", "waves", "input_noise"):
        none, seen = of_kind(entries, "none", condition), _detectable(entries, "single", condition)
        rates.append(share(f"{condition}, nothing hidden: false claims", claims, none, "<= 0.02"))
        rates.append(share(f"{condition}: right effect accepted", accepted, seen, ">= 0.95"))
    for declared, words in ((True, "noise declared"), (False, "noise not declared")):
        seen = [e for e in _detectable(entries) if e["declared"] is declared]
        rates.append(share(f"{words}: right effect accepted", accepted, seen, ">= 0.95"))
    return rates + _of_all(entries)


def _of_vehicle(name: str, entries: Sequence[Entry]) -> list[Row]:
    """How often the improvement is right on one vehicle."""
    seen, none = _detectable(entries), of_kind(entries, "none")
    return [
        share(f"{name}: right effect first", right_first, seen),
        share(f"{name}: right effect first or in its group", right_group, seen),
        share(f"{name}: right effect accepted", accepted, seen, ">= 0.95"),
        share(f"{name}: no abort", lambda e: not aborted(e), entries, "1"),
        share(f"{name}: nothing hidden: false claims", claims, none, "<= 0.02"),
    ]


def _of_all(entries: Sequence[Entry]) -> list[Row]:
    """Pairs, contradictions, errors and times over all vehicles."""
    pairs, hidden = _detectable(entries, "pair"), [e for e in entries if e["hidden"] != "none"]
    ratios = [r for r in map(ratio, entries) if not np.isnan(r)]
    seconds = [e["processor_seconds"] for e in entries]
    error, spent = "validation error, found over true structure", "processor seconds of a case"
    return [
        share("two hidden: both found", accepted, pairs),
        share("two hidden: one of them first", right_group, pairs),
        share("claims more than is hidden", more_claimed, hidden),
        share("claim beside a validation error that rises", contradicts, entries, "0"),
        share("hidden effects that are detectable", lambda e: e["detectable"], hidden),
        *(number(f"{error}: {p} %", ratios, p) for p in PERCENT),
        *(number(f"{spent}: {p} %", seconds, p) for p in PERCENT),
    ]


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
        "hidden": [f"{n} ({entry['true_gains'][n]:.0f})" for n in entry["effects"]] or ["nothing"],
        "added": [s["added"] for s in entry.get("steps", ())] or ["nothing"],
        "group": entry["steps"][0]["group"] if claims(entry) else [],
        "refused": entry.get("rejected", []),
        "order": entry.get("order", [])[:3],
        "ratio": ratio(entry),
        "faults": faults(entry),
    }


def as_markdown(found: Mapping[str, Any]) -> str:
    """The measures as Markdown tables."""
    return tables(
        found,
        (
            "One hidden effect; of the detectable cases:",
            {
                "vehicle": "vehicle", "hidden effect": "effect", "cases": "cases",
                "detectable": "detectable", "first": "right_first",
                "or in its group": "right_group", "otherwise": "mistaken_for",
            },
        ),
        (
            "What went wrong (in brackets expected likelihood-ratio statistics):",
            {
                "case": "case", "hidden": "hidden", "claimed": "added",
                "first group": "group", "refused": "refused", "ranked first": "order",
                "error over true": "ratio", "fault": "faults",
            },
        ),
    )  # fmt: skip


def unprepared_table(rows: Sequence[Entry]) -> str:
    """Rates by vehicle where no candidate was named, as Markdown."""
    groups = grouped(rows, lambda row: row["vehicle"])
    return "\n".join(tabulate(groups | {"all": list(rows)}, UNPREPARED))


def _hidden(group: Sequence[Entry], *, detectable: bool) -> list[Entry]:
    """Cases that hide something which shows, or does not."""
    return [row for row in group if row["effects"] and row["detectable"] is detectable]


def _right(group: Sequence[Entry]) -> int:
    """Cases in which what was found predicts as well as the true structure."""
    return sum(ratio(row) <= AS_GOOD for row in group)


UNPREPARED: dict[str, Callable[..., object]] = {
    "vehicle": lambda vehicle, _: vehicle,
    "hidden and detectable": lambda _, group: len(_hidden(group, detectable=True)),
    "right": lambda _, group: _right(_hidden(group, detectable=True)),
    "claims, mean": lambda _, group: "{:.2f}".format(
        np.mean([len(row.get("steps", ())) for row in _hidden(group, detectable=True)] or [0])
    ),
    "right where not detectable": lambda _, group: (
        f"{_right(weak)} of {len(weak)}" if (weak := _hidden(group, detectable=False)) else "-"
    ),
    "nothing hidden": lambda _, group: sum(not row["effects"] for row in group),
    "claims there": lambda _, group: sum(claims(row) and not row["effects"] for row in group),
    "aborted": lambda _, group: sum(map(aborted, group)),
    "processor s, median": lambda _, group: "{:.0f}".format(
        np.median([row["processor_seconds"] for row in group])
    ),
}
