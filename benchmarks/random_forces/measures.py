"""Numbers and tables from the fits of many data sets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.harness import TWO_SIDED_95, markdown
from benchmarks.random_forces.scenarios import VEHICLES, Scenario
from benchmarks.random_forces.simulator import Set
from benchmarks.random_forces.trial import Outcome

# An error of more than this many standard errors counts as this many in z.
LARGEST = 100.0
# Level and time of each disturbance force.
Forces = Mapping[str, tuple[float, float]]
DIFFICULT = ("large", "large_calm", "unstable", "weak", "weak_small")
LARGEST_RATIO = 1.1
FLAGGED = 95.0  # per cent of runs
WITHIN = 0.2  # of a level or a time
STARTS = ("fit", "first")  # what a prediction starts from


def share(values: np.ndarray) -> tuple[float, float]:
    """Mean over data sets (rows) and its Monte-Carlo error, in per cent.

    The parameters of one data set are not independent, so a row counts once.
    """
    rows = 100.0 * np.asarray(values, dtype=float).reshape(len(values), -1).mean(axis=1)
    spread = float(rows.std(ddof=1)) / np.sqrt(len(rows)) if len(rows) > 1 else float("nan")
    return float(rows.mean()), spread


def measure(
    scenario: Scenario, outcomes: Sequence[Outcome], known: Mapping[int, Mapping[str, Any]]
) -> dict[str, Any]:
    """All measures of one scenario.

    Parameters
    ----------
    scenario : Scenario
    outcomes : sequence of Outcome
    known : mapping
        The reference by number of data set (:mod:`~benchmarks.random_forces.reference`).

    Returns
    -------
    dict
        Plain data: see :mod:`benchmarks.random_forces`.
    """
    names = list(VEHICLES[scenario.vehicle].believed)
    error, z = errors(outcomes, names)
    found: dict[str, Any] = {
        "scenario": scenario.name,
        "title": scenario.title,
        "sets": len(outcomes),
        **estimated(names, error, z),
        **_told_by(outcomes),
        "prediction": _bands(outcomes),
        "sea": _sea(scenario, outcomes),
        "forces": _forces(scenario, [o.force for o in outcomes if o.force is not None]),
    }
    both = [i for i, o in enumerate(outcomes) if o.number in known]
    if both:
        fits = of_reference([outcomes[i] for i in both], known)
        found["reference"] = _against(scenario, fits, error[both])
    found["missed"] = missed(scenario, found)
    return found


def estimated(names: Sequence[str], error: np.ndarray, z: np.ndarray) -> dict[str, Any]:
    """Coverage, errors over standard errors and bias, of all parameters and of each."""
    inside = np.abs(z) <= TWO_SIDED_95
    coverage, coverage_error = share(inside)
    sizes = 100 * np.stack([inside.mean(axis=0), np.sqrt(np.mean(error**2, axis=0))], axis=1)
    bias = np.mean(np.clip(z, -LARGEST, LARGEST), axis=0)
    parts = [{"coverage": float(held), "relative_rms": float(rms)} for held, rms in sizes]
    return {
        "coverage": coverage,
        "coverage_error": coverage_error,
        "z": float(np.sqrt(np.mean(np.minimum(np.abs(z), LARGEST) ** 2))),
        "by_parameter": dict(zip(names, parts, strict=True)),
        "bias": dict(zip(names, map(float, bias), strict=True)),
    }


def _told_by(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """What the fits say of themselves, what they took, and how their bands hold by output."""
    flagged = [bool(o.concerns) or o.status != "converged" for o in outcomes]
    banded = [o.by_output for o in outcomes if o.by_output]
    return {
        "flagged": float(100 * np.mean(flagged)),
        "concerns": dict(Counter(kind for o in outcomes for kind in set(o.concerns))),
        "status": dict(Counter(o.status for o in outcomes)),
        "said": float(100 * np.mean([o.said for o in outcomes])),
        "seconds": float(np.median([o.seconds for o in outcomes])),
        "by_output": {
            output: float(100 * np.mean([one[output] for one in banded]))
            for output in (banded[0] if banded else ())
        },
        "misfit": float(np.median([o.misfit for o in outcomes])),
        "local": float(np.sqrt(np.mean(np.square([o.local for o in outcomes])))),
    }


def _bands(outcomes: Sequence[Outcome]) -> dict[str, tuple[float, float]]:
    """Share of new samples that prediction bands hold, by what a prediction starts from."""
    told = {kind: [o.covered[kind] for o in outcomes if kind in o.covered] for kind in STARTS}
    return {kind: share(np.array(shares)) for kind, shares in told.items() if shares}


def missed(scenario: Scenario, found: Mapping[str, Any]) -> list[str]:
    """Targets that are missed, as :mod:`benchmarks.random_forces` states them."""
    lowest = 90.0 if scenario.name in DIFFICULT else 93.0
    names = []
    if not _within(found["coverage"], found["coverage_error"], lowest) and not (
        scenario.may_flag and found["flagged"] >= FLAGGED
    ):
        names.append("coverage")
    ratio = found["reference"]["error_ratio"] if "reference" in found else 0.0
    if any(scenario.force) and ratio > LARGEST_RATIO:
        names.append("errors")
    band = None if scenario.may_flag else found["prediction"].get("fit")
    if band is not None and not _within(*band, 93.0):
        names.append("prediction")
    if not (any(scenario.force) or scenario.may_flag) and found["flagged"] > 100.0 - FLAGGED:
        names.append("false warnings")
    return names


def _within(value: float, error: float, lowest: float, highest: float = 97.0) -> bool:
    slack = 2.0 * error if np.isfinite(error) else 0.0
    return lowest - slack <= value <= highest + slack


def errors(outcomes: Sequence[Any], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors and errors over standard errors, ``(n_sets, n_parameters)``.

    A fit that raised has an error of one and is outside its intervals.
    """
    truth = np.array([[o.truth[n] for n in names] for o in outcomes])
    estimates = np.array([[o.estimates[n] for n in names] for o in outcomes], dtype=float)
    std = np.array([[o.std_errors[n] for n in names] for o in outcomes], dtype=float)
    error = np.where(np.isfinite(estimates), estimates / truth - 1.0, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = (estimates - truth) / std
    # An infinite standard error covers everything; NaN nothing.
    return error, np.where(np.isnan(z), LARGEST, z)


def of_reference(
    data: Iterable[Outcome | Set], lines: Mapping[int, Mapping[str, Any]]
) -> list[SimpleNamespace]:
    """What the reference made of these data sets, with their truth."""
    return [SimpleNamespace(truth=one.truth, **lines[one.number]) for one in data]


def _against(
    scenario: Scenario, fits: Sequence[SimpleNamespace], error: np.ndarray
) -> dict[str, Any]:
    """Errors ``(n_sets, n_parameters)`` over those of the reference on the same data sets."""
    vehicle = VEHICLES[scenario.vehicle]
    names = list(vehicle.believed)
    own, z = errors(fits, names)
    found = estimated(names, own, z)
    scale = np.sqrt(np.mean(own**2, axis=0))
    ratios = np.sqrt(np.mean(error**2, axis=0)) / scale
    told = [_told(fit.estimates, vehicle.forces) for fit in fits] if any(scenario.force) else []
    return {
        "sets": len(fits),
        "error_ratio": float(np.sqrt(np.mean((error / scale) ** 2))),
        "error_ratio_median": float(np.median(ratios)),
        "by_parameter": dict(zip(names, map(float, ratios), strict=True)),
        "relative_rms": {n: part["relative_rms"] for n, part in found["by_parameter"].items()},
        **{name: found[name] for name in ("coverage", "coverage_error", "z")},
        "forces": _forces(scenario, told),
    }


def _told(estimates: Mapping[str, float], names: Sequence[str]) -> Forces:
    """Levels and their one time, as the reference keeps them."""
    return {n: (estimates[f"force {n}"], estimates["force time"]) for n in names}


def _forces(scenario: Scenario, told: Sequence[Forces]) -> dict[str, Any] | None:
    """Found levels and times over the true ones, and how often any force was found."""
    if not told:
        return None
    present = [any(level > 0 for level, _ in forces.values()) for forces in told]
    found: dict[str, Any] = {"found": float(100 * np.mean(present))}
    for name, true in zip(VEHICLES[scenario.vehicle].forces, scenario.force, strict=True):
        if true == 0.0:
            continue
        levels = np.array([forces[name][0] for forces in told]) / true
        times = np.array([forces[name][1] for forces in told]) / scenario.force_time
        good = (np.abs(levels - 1) <= WITHIN) & (np.abs(times - 1) <= WITHIN)
        found[name] = {
            "level": [float(v) for v in np.percentile(levels, [50, 5, 95])],
            "time": [float(v) for v in np.percentile(times, [50, 5, 95])],
            "within": float(100 * good.mean()),
        }
    return found


def _sea(scenario: Scenario, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """How often a sea is claimed, and its period and levels within 10 and 25 % where one acts."""
    found = [o.sea for o in outcomes if o.sea is not None]
    told: dict[str, Any] = {"claimed": float(100 * len(found) / max(len(outcomes), 1))}
    several = scenario.wind_sea or scenario.direction is not None
    if not scenario.swell or several or not found:
        return told
    periods = np.array([sea["period"] for sea in found]) / scenario.swell
    true = np.array(scenario.force)
    levels = np.array([[*sea["levels"].values()] for sea in found]) / true
    told["period"] = [float(v) for v in np.percentile(periods, [50, 5, 95])]
    told["period_within"] = float(100 * np.mean(np.abs(periods - 1) <= 0.1))
    told["level"] = [float(v) for v in np.median(levels, axis=0)]
    told["level_within"] = float(100 * np.mean(np.abs(levels - 1) <= 0.25))
    return told


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: one row a scenario, then levels of forces, then what else is told of each."""
    head = (
        "scenario", "sets", "coverage, %", "z", "error / reference", "flagged, %",
        "prediction, %", "from first, %", "reference: coverage, z", "CPU, s", "targets missed",
    )  # fmt: skip
    parts = (
        markdown(head, map(_cells, results)),
        _force_table(results),
        map(_further, results),
    )
    return "\n\n".join("\n".join(part) for part in parts)


def _cells(r: Mapping[str, Any]) -> tuple[object, ...]:
    """One scenario in the first table."""
    known = r.get("reference")
    ratio = own = "–"
    if known:
        ratio = f"{known['error_ratio']:.2f}"
        own = f"{_pair(known['coverage'], known['coverage_error'])}, {known['z']:.2f}"
    bands = (_pair(*r["prediction"][kind]) if kind in r["prediction"] else "–" for kind in STARTS)
    coverage = _pair(r["coverage"], r["coverage_error"])
    return (
        f"{r['scenario']}: {r['title']}", r["sets"], coverage, f"{r['z']:.2f}", ratio,
        f"{r['flagged']:.0f}", *bands, own, f"{r['seconds']:.3f}",
        ", ".join(r["missed"]) or "all met",
    )  # fmt: skip


def _pair(value: float, error: float) -> str:
    return f"{value:.1f} ± {error:.1f}"


def _range(numbers: Sequence[float]) -> str:
    return "{:.2f} ({:.2f} to {:.2f})".format(*numbers)


def _force_table(results: Sequence[Mapping[str, Any]]) -> list[str]:
    rows = []
    for r in results:
        if r["forces"] is None:
            continue
        told = dict(r["forces"])
        often = f"{told.pop('found'):.0f}"
        if not told:
            rows.append((r["scenario"], "none", "–", "–", "–", often, "–"))
        known = r.get("reference", {}).get("forces")
        for name, f in told.items():
            own = "–"
            if known:
                level, time = (known[name][what][0] for what in ("level", "time"))
                own = f"{level:.2f}, {time:.2f}; {known[name]['within']:.0f}"
            ranges = _range(f["level"]), _range(f["time"])
            rows.append((r["scenario"], name, *ranges, f"{f['within']:.0f}", often, own))
    head = (
        "scenario", "force", "level / true: median (5 to 95 %)", "time / true",
        "both within 20 %, %", "any force found, %", "reference: level, time; within",
    )  # fmt: skip
    return markdown(head, rows) if rows else ["The fits tell no levels of disturbance forces."]


def _parameter(r: Mapping[str, Any], name: str) -> str:
    """Error, coverage and bias of one parameter."""
    part, known = r["by_parameter"][name], r.get("reference")
    beside = f" ({known['relative_rms'][name]:.2g})" if known else ""
    return f"{part['relative_rms']:.2g}{beside}; {part['coverage']:.0f}; {r['bias'][name]:+.2f}"


def _further(r: Mapping[str, Any]) -> str:
    """What the fits of one scenario warn of, seas that they claim, errors, in sentences."""
    kinds = ", ".join(f"{kind} ({count})" for kind, count in r["concerns"].items()) or "nothing"
    states = ", ".join(f"{kind} ({count})" for kind, count in r["status"].items())
    text = f"- {r['scenario']}: misfit {r['misfit']:.3f} x noise; warned of {kinds}; "
    text += f"physics said to be missing in {r['said']:.0f} %; "
    sea = r["sea"]
    text += f"sea claimed in {sea['claimed']:.0f} %; "
    if "period" in sea:
        levels = ", ".join(f"{v:.2f}" for v in sea["level"])
        text += f"period / true {_range(sea['period'])}, within 10 % in {sea['period_within']:.0f} "
        text += f"%; levels / true {levels}, within 25 % in {sea['level_within']:.0f} %; "
    if np.isfinite(r["local"]):
        text += f"parameters of records to {100 * r['local']:.1f} % of their spread; "
    if r["by_output"]:
        bands = ", ".join(f"{name} {value:.0f}" for name, value in r["by_output"].items())
        text += f"prediction by output {bands} %; "
    parts = ", ".join(f"{name} {_parameter(r, name)}" for name in r["by_parameter"])
    return f"{text}status {states}. Rms errors, % (reference), coverage, bias: {parts}."
