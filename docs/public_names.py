"""Public names of the package, by the page of the reference that has them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

PACKAGES = {
    "oed_sysid": "At the top level",
    "oed_sysid.physics": "Effects",
    "oed_sysid.physics.bodies": "Rigid bodies",
    "oed_sysid.experiments.manoeuvres": "Manoeuvres",
    "oed_sysid.experiments.simulation": "Simulation",
    "oed_sysid.data.logs": "Logs in",
    "oed_sysid.evidence.check": "Checks of logs",
    "oed_sysid.baselines": "Estimators",
    "oed_sysid.information": "Sensitivity",
    "oed_sysid.design": "Design of trials",
    "oed_sysid.evidence": "Missing physics",
    "oed_sysid.export": "Models out",
    "oed_sysid.testing": "Contracts for extensions",
    "oed_sysid.baselines.benchmark": "Benchmark of estimators",
    "oed_sysid.results": "Pictures and reports",
}
# Results and parts that users meet without importing them by name.
RESULTS = {
    "oed_sysid.evidence": (
        "compare.Comparison",
        "compare.Diagnosis",
        "improvement.Improvement",
        "improvement.Step",
        "locate.Located",
        "rank.Ranking",
        "remainder.Remains",
    ),
    "oed_sysid.likelihood": (
        "fit.Fit",
        "estimate.Status",
        "judgement.Concern",
        "prediction.Prediction",
        "captive.CaptiveTests",
        "noise_model.NoiseModel",
        "disturbances.Place",
    ),
}
MORE = {"oed_sysid.likelihood": "Results of an estimation"}


def found_at(package: str, name: str) -> Any:
    """What a name stands for; a part of the package may stand before it."""
    part, _, last = f"{package}.{name}".rpartition(".")
    return getattr(import_module(part), last)


def public(package: str, taken: set[int]) -> list[str]:
    """Public classes and functions of a package that no page has yet."""
    listed = getattr(import_module(package), "__all__", ())
    found = []
    for name in [*listed, *RESULTS.get(package, ())]:
        last = name.rpartition(".")[2]
        thing = found_at(package, name)
        # What has another name as well is documented under its own.
        own = getattr(thing, "__name__", last) == last
        if callable(thing) and own and id(thing) not in taken:
            taken.add(id(thing))
            found.append(name)
    return sorted(found, key=str.lower)


def named() -> dict[str, list[str]]:
    """Public names by package; a name stands with the package that defines it."""
    taken: set[int] = set()
    # The top level last: it only hands on what others define.
    return {package: public(package, taken) for package in reversed(PACKAGES | MORE)}
