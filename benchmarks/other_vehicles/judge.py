"""One case: improve the nominal model, and compare with what is true."""

from __future__ import annotations

import numpy as np

from benchmarks.harness import Row
from benchmarks.other_vehicles.cases import Case, Draw, draw_case
from benchmarks.other_vehicles.models import nominal
from benchmarks.other_vehicles.truth.simulator import Runs, Vehicle
from benchmarks.rates import detectable, finite, judged
from oed_sysid import Dataset, Model, MultipleShooting, Record, compare
from oed_sysid.evidence.improvement import Improvement

# Expected gain in twice the log-likelihood from which an effect counts as detectable. A claim
# among 40 candidates needs about 14; 36 is six standard deviations of one amplitude, so that
# 49 cases in 50 exceed 16.
DETECTABLE = 36.0
# On validation records a claim needs a gain as well; from this on it cannot be missed.
CONFIRMABLE = 16.0


def datasets(vehicle: Vehicle, runs: Runs, model: Model) -> tuple[Dataset, Dataset]:
    """Training and validation records."""
    records = tuple(
        Record(name, runs.times, runs.logged[i], runs.outputs[i], model.channels)
        for i, name in enumerate(runs.names)
    )
    n_train = len(vehicle.train)
    return Dataset(records[:n_train]), Dataset(records[n_train:])


def nominal_model(case: Case) -> Model:
    """What the improvement starts from: the structure without what is hidden, values wrong."""
    model = nominal(case.draw.vehicle).model(case.draw.declared, case.lacking)
    return model.with_values({k: v for k, v in case.start.items() if k in model.parameter_names})


def true_model(case: Case) -> Model:
    """The nominal structure with what is hidden, at true values."""
    own = nominal(case.draw.vehicle)
    model = own.model(case.draw.declared, None)
    values = {k: v for k, v in case.parameters.items() if k in model.parameter_names}
    for name in case.effects:
        if name == case.lacking:
            continue
        model = model + own.effect(name)
        sizes = {key: case.hidden[key] for key in case.vehicle.hidden[name].sizes}
        plain = {k: float(v) if np.ndim(v) == 0 else 0.0 for k, v in sizes.items()}
        values |= own.values(name, plain)
    return model.with_values(values)


def judge(draw: Draw, *, limit: float = 600.0, prepared: bool = True) -> Row:
    """Draw a case, improve its nominal model, and compare with the truth.

    ``limit`` is the processor time that the improvement may take, s; beyond it the case
    counts as aborted. Candidates are the vehicle's own, or none is named where they are not
    ``prepared``.
    """
    case = draw_case(draw)
    model = nominal_model(case)
    train, validation = datasets(case.vehicle, case.runs, model)
    gains = {name: case.gain(name) for name in case.effects}
    entry: Row = {
        "key": draw.key,
        "vehicle": draw.vehicle,
        "hidden": draw.hidden,
        "condition": draw.condition,
        "declared": draw.declared,
        "effects": list(case.effects),
        "same_as": {name: list(case.vehicle.hidden[name].same_as) for name in case.effects},
        "sizes": {k: np.asarray(v).tolist() for k, v in case.hidden.items()},
        "true_gains": {name: gain.train for name, gain in gains.items()},
        "detectable": detectable((gain.train for gain in gains.values()), DETECTABLE)
        and detectable((gain.validation for gain in gains.values()), CONFIRMABLE),
    }
    if not prepared:
        entry |= {"key": f"{draw.key}/unprepared", "prepared": False}

    def against_truth(found: Improvement | None) -> Row:
        """Validation errors of what was found and of the true structure, by one means."""
        models = {"true": MultipleShooting().fit(true_model(case), train).model}
        models |= {} if found is None else {"found": found.model}
        errors = compare(models, validation).models
        return {f"{part.label}_validation": finite(part.relative) for part in errors}

    offered = nominal(draw.vehicle).effects(case.lacking) if prepared else None
    return judged(entry, model, (train, validation), offered, against_truth, limit=limit)
