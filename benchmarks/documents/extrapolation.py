"""Numbers of `docs/extrapolation.md`: circles of a tanker and turns of Esso Osaka from zigzags."""

from __future__ import annotations

from collections.abc import Mapping

from benchmarks.documents import turns
from benchmarks.documents.measured_data import ran
from benchmarks.documents.page import Numbers, Page
from benchmarks.harness import named
from oed_sysid import Dataset, Fit, MultipleShooting, load_problem
from problems.kvlcc2.averaging import StructureAverage
from problems.kvlcc2.captive import captive_tests
from problems.kvlcc2.manoeuvring import MMG
from problems.kvlcc2.mavmm import MAVMM, wake
from problems.kvlcc2.missing import manoeuvring_effects
from problems.kvlcc2.structures import HORIZONS, REGRESSION, SIDES, ahead, circles, weighed

# 35 degree circles of a third basin, from their positions, in lengths: starboard, port.
YARDSTICK = {
    "advance": (3.09, 3.02),
    "tactical_diameter": (3.33, 3.08),
    "steady_diameter": (2.62, 2.51),
}
AHEAD = (0.5, 2.0, 10.0, 40.0)  # s
THREE = ("helm_zero", "rudder_lift_shape", "propeller_wake_by_drift")


def errors(found: Mapping[str, float]) -> dict[str, list[float]]:
    """Errors of both circles against the yardstick, per cent, by quantity: starboard, port."""
    return {
        quantity: [
            100 * (found[f"{quantity} {side}"] / value - 1)
            for side, value in zip(SIDES, values, strict=True)
        ]
        for quantity, values in YARDSTICK.items()
    }


def _zigzags() -> Dataset:
    return load_problem("kvlcc2", variant="mmg").data()


def _mechanical(runs: Dataset) -> Fit:
    """The MMG model with three effects, fitted ten seconds ahead: where its searches begin."""
    effects = {effect.name: effect for effect in manoeuvring_effects()}
    return ahead(HORIZONS[0]).fit(MMG + [effects[name] for name in THREE], runs)


def horizons() -> Numbers:
    """Errors of the circles by how far ahead the fit had to predict the zigzags."""
    runs = _zigzags()
    polynomial = REGRESSION.fit(MAVMM.with_values(wake()), runs).model
    mechanical = _mechanical(runs).model
    found: dict[str, dict[str, object]] = {}
    for horizon in AHEAD:
        found[f"{horizon:g} s"] = {
            label: errors(circles(ahead(horizon).fit(model, runs)))
            for label, model in (("MAVMM", polynomial), ("MMG", mechanical))
        }
    found["whole runs"] = {"MMG": errors(circles(weighed(1.0).fit(mechanical, runs)))}
    return {"errors": found, "runs": len(runs)}


def captive() -> Numbers:
    """Errors in the forces of static tests, and in the circles, without and with these fitted."""
    runs, tests = _zigzags(), captive_tests()
    mechanical = _mechanical(runs).model
    whole = MultipleShooting(disturbances="none", noise="given")
    alone = whole.fit(mechanical, runs)
    together = tests.fit(whole, mechanical, runs)
    polynomial = REGRESSION.fit(MAVMM.with_values(wake()), runs)
    fits = {"zigzags": alone, "both": together, "MAVMM": polynomial}
    return {
        "tests": len(next(iter(tests.forces.values()))),
        "forces": {label: dict(tests.relative_errors(fit.model)) for label, fit in fits.items()},
        "circles": {label: errors(circles(fit)) for label, fit in fits.items()},
    }


def _averaged(average: StructureAverage) -> list[Numbers]:
    """The structures of an average, heaviest first."""
    names = ("name", "weight", "step", "forces", "drift", "values", "note")
    return [
        {name: getattr(one, name) for name in names} | {"values": dict(one.values)}
        for one in average.structures
    ]


def tanker() -> Numbers:
    """The average of structures for KVLCC2's circles, by its example."""
    names = ran("tanker_turning_circle")
    average = names["average"]
    intervals = {name: list(average.interval(name)) for name in average.values}
    published = names["PUBLISHED"]
    return {
        "structures": [
            dict(one) | {"errors": errors(one["values"]) if one["weight"] > 0 else {}}
            for one in _averaged(average)
        ],
        "values": dict(average.values),
        "intervals": intervals,
        "errors": errors(average.values),
        "held": [
            intervals[f"{quantity} {side}"][0] <= value <= intervals[f"{quantity} {side}"][1]
            for quantity, values in YARDSTICK.items()
            for side, value in zip(SIDES, values, strict=True)
        ],
        "published": {
            name: [value, 100 * (average.values[name] / value - 1), *intervals[name]]
            for name, value in published.items()
        },
    }


def esso_osaka() -> Numbers:
    """Four turns of Esso Osaka from its zigzags, by the same rule."""
    data = load_problem("esso_osaka").data()
    average, measured = turns.predicted(named(data, "zigzag"), named(data, "turn"))
    rows: dict[str, dict[str, Numbers]] = {}
    for name, value in measured.items():
        quantity, run = name.split(maxsplit=1)
        low, high = average.interval(name)
        rows.setdefault(run, {})[quantity] = {
            "measured": value,
            "error": 100 * (average.values[name] / value - 1),
            "half_width": 50 * (high - low) / average.values[name],
            "held": bool(low <= value <= high),
        }
    return {"turns": rows, "structures": _averaged(average), "rungs": list(average.rungs)}


def reach() -> Numbers:
    """What the same structures reach where turns are fitted as well."""
    return turns.reach()


PAGE = Page(
    "extrapolation",
    {s.__name__: s for s in (horizons, captive, tanker, esso_osaka, reach)},
)
