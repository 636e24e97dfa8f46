"""Hide, improve, judge: what a search claims, what could be found, how often it is.

A study brings its cases and what could have been found in them (``detectable``); :func:`judged`
runs and reads the search of one, and :func:`table` tells how often it was right.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from benchmarks.harness import TWO_SIDED_95, Row, grouped, markdown, places_of, table_of
from oed_sysid import Dataset, Model, improve
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.physics import Effect

Entry = Mapping[str, Any]
LARGEST_GROUP = 3
AS_GOOD = 1.05  # error of a model over that of the true structure, up to which it is as good
# Conditions of the diving plane in which less is aimed at: noise and forces with a memory.
DISTURBED = ("colour", "force", "gust")
RISE = 1.02  # validation error after a claim over that before, from which the two contradict


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


def judged(
    entry: Row,
    model: Model,
    records: tuple[Dataset, Dataset],
    offered: Sequence[Effect] | None,
    truth: Callable[[Improvement | None], Row],
    *,
    limit: float = 600.0,
) -> Row:
    """A case after its nominal model was improved, compared with what is true.

    Parameters
    ----------
    entry : dict
        What is known of the case before.
    model, records, offered, limit
        See :func:`searched`.
    truth : callable
        What is true, from what was found.
    """
    found, told = searched(model, *records, offered, limit=limit)
    entry = entry | told
    try:
        with at_most(limit):
            return entry | truth(found)
    except Exception as error:  # a case that breaks is a result too
        return entry | {"truth_error": f"{type(error).__name__}: {error}"}


# -- what is so of a case ---------------------------------------------------------------


def claims(entry: Entry) -> bool:
    """Whether anything is claimed."""
    return bool(entry.get("steps"))


def aborted(entry: Entry) -> bool:
    """Whether the improvement ended without a result."""
    return "error" in entry


def names_of(entry: Entry, name: str) -> set[str]:
    """Names under which a hidden effect may be claimed."""
    return {name, *entry.get("same_as", {}).get(name, ())}


def _right(entry: Entry) -> set[str]:
    """All names that are right."""
    return set().union(*(names_of(entry, name) for name in entry["effects"]))


def _named(step: Row) -> set[str]:
    """What a claim names: its effect, and its group if that has no more than three."""
    group = set(step["group"])
    return {step["added"]} | (group if len(group) <= LARGEST_GROUP else set())


def right_first(entry: Entry) -> bool:
    """Whether the first effect claimed is one of the hidden ones."""
    return claims(entry) and entry["steps"][0]["added"] in _right(entry)


def right_group(entry: Entry) -> bool:
    """Whether a hidden effect is the first claimed, or in its group."""
    return claims(entry) and bool(_named(entry["steps"][0]) & _right(entry))


def accepted(entry: Entry) -> bool:
    """Whether every hidden effect is claimed, itself or in a group."""
    named = set().union(*map(_named, entry.get("steps", ())))
    return all(named & names_of(entry, name) for name in entry["effects"])


def nothing_else(entry: Entry) -> bool:
    """Whether all that is hidden, itself or in a group, and nothing else is claimed."""
    return accepted(entry) and len(entry.get("steps", ())) == len(entry["effects"])


def ratio(entry: Entry) -> float:
    """Validation error of what was found over that of the true structure; NaN without both."""
    found = entry.get("found_validation", entry.get("final_error", {}).get("test", np.nan))
    true = float(entry.get("true_validation", entry.get("true_test_error", np.nan)))
    return float(found) / true if np.isfinite(true) and true > 0 else np.nan


def as_good(entry: Entry) -> bool:
    """Whether what was found predicts as well as the true structure."""
    return ratio(entry) <= AS_GOOD


def right_equation(entry: Entry) -> bool:
    """Whether what was added acts on the axis of the hidden term, and nowhere else."""
    return {step["equation"] for step in entry.get("steps", ())} == {entry["axis"]}


def contradicts(entry: Entry) -> bool:
    """Whether a claim stands beside a validation error that rises with it, or is no number."""
    if not claims(entry):
        return False
    before = float(entry["base_error"].get("test", np.nan))
    for step in entry["steps"]:
        after = float(step.get("test_error", before))  # of older rows nothing is known
        # From an infinite error anything finite is an improvement.
        if not np.isfinite(after) or (np.isfinite(before) and after > RISE * before):
            return True
        before = after
    return False


def faults(entry: Entry) -> list[str]:
    """What went wrong in a case, in words; empty where nothing did."""
    found = []
    if aborted(entry):
        found.append(f"aborted: {entry['error']}")
    elif entry["hidden"] == "none":
        found += ["false claim"] * claims(entry)
    elif entry["hidden"] == "unknown":  # whose name no candidate has
        found += ["worse than the true term"] * (entry["detectable"] and not as_good(entry))
    elif entry["detectable"]:
        if not claims(entry):
            found.append("refused")
        elif not accepted(entry):
            found.append("one of two missed" if right_group(entry) else "wrong effect")
        elif not right_group(entry):
            found.append("wrong effect first")
        elif not nothing_else(entry):
            found.append("claims too much")
    return found + ["claim beside a validation error that rises"] * contradicts(entry)


def summary(entry: Entry) -> str:
    """One case in one line."""
    hidden = " + ".join(entry["effects"]) or "nothing"
    sight = "" if entry.get("detectable") else " (invisible)"
    if aborted(entry):
        return f"{entry['key']} {hidden}{sight} -> FAILED {entry['error'][:120]}"
    added = " + ".join(step["added"] for step in entry["steps"]) or "nothing"
    return f"{entry['key']} {hidden}{sight} -> {added} ({entry['processor_seconds']:.1f} s)"


# -- how often ---------------------------------------------------------------------------


def _rate(
    name: str, value: float, count: int, target: str = "", low: float = np.nan, high: float = np.nan
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


def _percentiles(name: str, values: Iterable[float], targets: tuple[str, str]) -> list[Row]:
    """Median and 90 % quantile of numbers that are no share."""
    known = [value for value in values if not np.isnan(value)]
    found = np.percentile(known or [np.nan], (50, 90)).tolist()
    return [
        _rate(f"{name}: {percent} %", value, len(known), target)
        for percent, value, target in zip((50, 90), found, targets, strict=True)
    ]


def measures(entries: Sequence[Entry]) -> dict[str, Any]:
    """All measures of a study, as plain data.

    Keys: ``n_cases``, ``rates`` (see :func:`share`), ``by_effect``, ``failures``.
    """
    kinds = {"all": list(entries)}
    for key in ("vehicle", "condition"):
        groups = grouped(entries, lambda entry, key=key: entry.get(key, ""))
        kinds |= groups if len(groups) > 1 else {}
    if any(not entry.get("declared", True) for entry in entries):
        words = {True: "noise declared", False: "noise not declared"}
        kinds |= grouped(entries, lambda entry: words[entry["declared"]])
    rates = [rate for name, own in kinds.items() for rate in _of_group(name, own)]
    return {
        "n_cases": len(entries),
        "rates": [rate for rate in (*rates, *_of_all(entries)) if rate["count"]],
        "by_effect": _by_effect(entries),
        "failures": [_failure(entry) for entry in entries if faults(entry)],
    }


def _shown(entries: Iterable[Entry], *hidden: str) -> list[Entry]:
    """Detectable cases that hide so much."""
    return [e for e in entries if e["hidden"] in hidden and e.get("detectable")]


def _of_group(name: str, entries: Sequence[Entry]) -> list[Row]:
    """How often the improvement is right in one group of cases."""
    seen, none = _shown(entries, "single"), [e for e in entries if e["hidden"] == "none"]
    right, false = (">= 0.90", "<= 0.05") if name.startswith(DISTURBED) else (">= 0.95", "<= 0.02")
    return [
        share(f"{name}: right effect first", right_first, seen, right),
        share(f"{name}: right effect accepted", accepted, seen, right),
        share(f"{name}: right effect accepted and nothing else", nothing_else, seen),
        share(f"{name}: nothing hidden: false claims", claims, none, false),
    ]


def _of_all(entries: Sequence[Entry]) -> list[Row]:
    """Pairs, terms that no candidate names, contradictions, errors and times."""
    pairs, terms = _shown(entries, "pair"), _shown(entries, "unknown")
    hidden = [e for e in entries if e["hidden"] != "none"]
    return [
        share("two hidden: both accepted", accepted, pairs, ">= 0.85"),
        share("two hidden: both accepted and nothing else", nothing_else, pairs),
        share("two hidden: one of them first", right_group, pairs),
        share("unknown effect: validation error <= 1.05 x true term's", as_good, terms, ">= 0.85"),
        share("unknown effect: only the right equation is changed", right_equation,
              [e for e in terms if "axis" in e], ">= 0.95"),
        share("claim beside a validation error that rises", contradicts, entries, "0"),
        share("hidden effects that are detectable", lambda e: e.get("detectable"), hidden),
        share("no abort", lambda e: not aborted(e), entries, "1"),
        *_percentiles("validation error, found over true structure",
                      map(ratio, entries), ("<= 1.02", "<= 1.10")),
        *_percentiles("processor seconds of a case",
                      (e["processor_seconds"] for e in entries), ("<= 10", "")),
    ]  # fmt: skip


def _by_effect(entries: Iterable[Entry]) -> list[Row]:
    """Per vehicle and single hidden effect: cases, detectable ones, right ones, and rivals."""
    single = grouped(
        (e for e in entries if e["hidden"] == "single"),
        lambda entry: (entry.get("vehicle", "diving plane"), *entry["effects"]),
    )
    table = []
    for (vehicle, name), own in sorted(single.items()):
        seen = _shown(own, "single")
        wrong = {
            "an abort" if aborted(e) else e["steps"][0]["added"] if claims(e) else "nothing"
            for e in seen
            if not right_first(e)
        }
        table.append(
            {
                "vehicle": vehicle, "hidden effect": name, "cases": len(own),
                "detectable": len(seen), "first": sum(map(right_first, seen)),
                "or in its group": sum(map(right_group, seen)), "otherwise": sorted(wrong),
            }
        )  # fmt: skip
    return table


def _failure(entry: Entry) -> Row:
    gains = entry.get("true_gains", {})
    steps = entry.get("steps", ())
    return {
        "case": entry["key"],
        "hidden": [f"{name} ({gains.get(name, np.nan):.0f})" for name in entry["effects"]]
        or ["nothing"],
        "claimed": [step["added"] for step in steps] or ["nothing"],
        "first group": steps[0]["group"] if steps else [],
        "refused": entry.get("rejected", []),
        "error over true": ratio(entry),
        "fault": faults(entry),
    }


def table(found: Mapping[str, Any]) -> str:
    """Measures as Markdown: rates, then what became of every effect, then what went wrong."""
    rows = []
    for rate in found["rates"]:
        interval = "" if np.isnan(rate["low"]) else f"{rate['low']:.3f} to {rate['high']:.3f}"
        rows.append((rate["name"], f"{rate['value']:.3f}", interval, rate["count"], rate["target"]))
    head = ("measure", "value", "95 % interval", "cases", "target")
    lines = [f"{found['n_cases']} cases.", "", *markdown(head, rows)]
    for words, part in (
        ("One hidden effect; of the detectable cases:", "by_effect"),
        ("What went wrong (in brackets likelihood-ratio statistics of the truth):", "failures"),
    ):
        cells = [{name: _cell(value) for name, value in row.items()} for row in found[part]]
        lines += ["", words, "", *table_of(cells)] if cells else []
    return "\n".join(lines)


def _cell(value: Any) -> str:
    """A list by commas, a fraction to three digits."""
    if isinstance(value, float):
        return f"{value:.3f}"
    return ", ".join(value) if isinstance(value, list) else str(value)
