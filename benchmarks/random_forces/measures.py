"""Numbers and tables from the fits of many data sets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
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
WITHIN = 0.2  # of a level or a time


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
        "sea": _sea(scenario, outcomes),
        "forces": _forces(scenario, [o.force for o in outcomes if o.force is not None]),
    }
    both = [i for i, o in enumerate(outcomes) if o.number in known]
    if both:
        fits = of_reference([outcomes[i] for i in both], known)
        found["reference"] = _against(scenario, fits, error[both])
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
        "prediction": share(np.array([[*one.values()] for one in banded])) if banded else None,
        "by_output": {
            output: float(100 * np.mean([one[output] for one in banded]))
            for output in (banded[0] if banded else ())
        },
    }


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
    names = list(VEHICLES[scenario.vehicle].believed)
    own, z = errors(fits, names)
    found = estimated(names, own, z)
    scale = np.sqrt(np.mean(own**2, axis=0))
    return {
        "sets": len(fits),
        "error_ratio": float(np.sqrt(np.mean((error / scale) ** 2))),
        **{name: found[name] for name in ("coverage", "coverage_error", "z")},
    }


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
    """Markdown: a row for each scenario, then what else is told of each."""
    groups = {f"{found['scenario']}: {found['title']}": found for found in results}
    rows = ([column(found) for column in COLUMNS.values()] for found in groups.values())
    lines = markdown(
        ("scenario", *COLUMNS), ((name, *row) for name, row in zip(groups, rows, strict=True))
    )
    return "\n".join([*lines, "", *map(_further, results)])


def _pair(value: float, error: float) -> str:
    return f"{value:.1f} ± {error:.1f}"


def _range(numbers: Sequence[float]) -> str:
    return "{:.2f} ({:.2f} to {:.2f})".format(*numbers)


def _of_reference(found: Mapping[str, Any]) -> str:
    known = found.get("reference")
    if known is None:
        return "–"
    return f"{known['error_ratio']:.2f}; {_pair(known['coverage'], known['coverage_error'])}"


COLUMNS: dict[str, Callable[[Mapping[str, Any]], object]] = {
    "sets": lambda found: found["sets"],
    "coverage, %": lambda found: _pair(found["coverage"], found["coverage_error"]),
    "z": lambda found: f"{found['z']:.2f}",
    "error over the reference's; its coverage, %": _of_reference,
    "flagged, %": lambda found: f"{found['flagged']:.0f}",
    "physics said to be missing, %": lambda found: f"{found['said']:.0f}",
    "prediction, %": lambda found: _pair(*found["prediction"]) if found["by_output"] else "–",
    "any force found, %": lambda found: (
        f"{found['forces']['found']:.0f}" if found["forces"] else "–"
    ),
    "sea claimed, %": lambda found: f"{found['sea']['claimed']:.0f}",
    "CPU, s": lambda found: f"{found['seconds']:.3f}",
}


def _further(found: Mapping[str, Any]) -> str:
    """Levels of forces and of a sea, parameters, bands and warnings of one scenario, in words."""
    parts = [
        f"force {name}: level / true {_range(f['level'])}, time / true {_range(f['time'])}, both "
        f"within 20 % in {f['within']:.0f} %"
        for name, f in (found["forces"] or {}).items()
        if name != "found"
    ]
    sea = found["sea"]
    if "period" in sea:
        levels = ", ".join(f"{v:.2f}" for v in sea["level"])
        parts.append(
            f"sea: period / true {_range(sea['period'])}, within 10 % in "
            f"{sea['period_within']:.0f} %; levels / true {levels}, within 25 % in "
            f"{sea['level_within']:.0f} %"
        )
    parts += [
        f"{name}: rms error {part['relative_rms']:.2g} %, coverage {part['coverage']:.0f} %, bias "
        f"{found['bias'][name]:+.2f}"
        for name, part in found["by_parameter"].items()
    ]
    for words, told in (("prediction of {} {:.0f} %", "by_output"), ("{} in {}", "concerns"),
                        ("{}: {}", "status")):  # fmt: skip
        parts += [words.format(name, value) for name, value in found[told].items()]
    return f"- {found['scenario']}: {'; '.join(parts)}."
