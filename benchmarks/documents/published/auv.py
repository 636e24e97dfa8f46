"""Xu, Zou, Yin and Cao (2012): an AUV in the diving plane, by LS-SVM."""

from __future__ import annotations

from benchmarks.documents.page import Numbers, paper
from oed_sysid import Dataset
from oed_sysid.baselines import EquationError
from oed_sysid.baselines.equations import exact_rates

WEIGHT = 3e4  # C as published
RULES = ("simpson", "trapezoid")  # which the page compares over runs
STARTS = (0.7, 1.3)  # start values over the truth


def zigzag() -> Numbers:
    """The published run: errors in per cent by every way to take accelerations, and without."""
    script = paper("auv_diving_plane")
    record = script.published_run()
    values, order = script.ways(record), script.sensitivities(record)
    fits = {factor: script.shooting(record, factor) for factor in STARTS}
    full, reduced = script.problem.model, script.problem.variant("reduced").model
    return {
        "free": len(script.TRUTH),
        "exact": max(abs(error) for error in exact_errors().values()) / 100,
        "errors": {label: script.errors(found) for label, found in values.items()},
        "beyond": {label: len(script.beyond(found)) for label, found in values.items()},
        "explained": [
            label
            for label, found in values.items()
            if script.least_sensitive(script.beyond(found), order)
        ],
        "removed": [name for name in full.free_names if name not in reduced.free_names],
        "reduced": script.reduced_errors(record),
        "weighted": script.weighted(record, WEIGHT),
        "forms": {
            "dimensionless": script.apart(*script.forms(record, script.DIMENSIONLESS)),
            "newton": script.apart(*script.forms(record, "raw")),
        },
        "shooting": {
            str(factor): max(map(abs, script.errors(fit.values).values()))
            for factor, fit in fits.items()
        },
    }


def exact_errors() -> dict[str, float]:
    """Errors with exact accelerations, without a ridge, per cent."""
    script = paper("auv_diving_plane")
    data = Dataset((script.published_run(),))
    rates = exact_rates(script.problem.model, data)
    values = EquationError(rule="exact", rates=rates).fit(script.problem.model, data).values
    found: dict[str, float] = script.errors(values)
    return found


def excitations() -> Numbers:
    """How many coefficients err by more than 5 %, by run and by way."""
    script = paper("auv_diving_plane")
    runs = {
        label: {way: len(script.beyond(found)) for way, found in script.ways(record).items()}
        for label, record in script.excitations().items()
    }
    plain, *richer = runs.values()
    return {
        "runs": runs,
        "plain": [plain[rule] for rule in RULES],
        "richer": [run[rule] for run in richer for rule in RULES],
        "one_step": max(run["one step"] for run in runs.values()),
    }
