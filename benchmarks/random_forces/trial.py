"""One data set through the estimator under test, by the public API alone."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.harness import ignorant
from benchmarks.random_forces.scenarios import DATA, VEHICLES, Scenario
from benchmarks.random_forces.simulator import Run, Set, believed
from oed_sysid import (
    Dataset,
    Fit,
    Input,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    State,
    load_problem,
)
from oed_sysid.data.record import Record


@dataclass(frozen=True)
class Outcome:
    """What one fit said.

    Attributes
    ----------
    number : int
        Of the data set.
    truth, estimates, std_errors : dict
        By parameter; NaN where the fit raised.
    status : str
    concerns : tuple of str
        What the fit warns of: its status if it did not converge, and its ``concerns``.
    force : dict or None
        Level and time of the disturbance force of each equation, where a fit tells them.
    seconds : float
        Processor time of the fit.
    by_output : dict
        Share of a fresh record within the 95 % band, its start states estimated.
    sea : dict or None
        What :func:`sea_of` tells.
    disturbed : bool
        Whether process noise was taken in.
    left_out, spoilt : int
        Samples that were taken for spikes, and that are.
    said : bool
        Whether the fit says that process noise has taken the work of physics.
    """

    number: int
    truth: dict[str, float]
    estimates: dict[str, float]
    std_errors: dict[str, float]
    status: str
    concerns: tuple[str, ...]
    force: dict[str, tuple[float, float]] | None
    seconds: float
    by_output: dict[str, float] = field(default_factory=dict)
    sea: dict[str, Any] | None = None
    disturbed: bool = False
    left_out: int = 0
    spoilt: int = 0
    said: bool = False


@lru_cache(maxsize=4)
def nominal_model(vehicle: str) -> Model:
    """The nominal model without priors: every state measured, equations as a user writes them."""
    if vehicle == "remus":
        return ignorant(load_problem("remus_diving_plane").model)
    own, units = VEHICLES[vehicle], DATA["units"]
    states = zip(own.states, own.noise_std, strict=True)
    shared = (Parameter(name, value, scale=abs(value)) for name, value in own.believed.items())
    by_record = (Parameter(n, 0.0, scale=std, per_record=True) for n, std in own.local.items())
    return Model(
        name=vehicle,
        states=tuple(State(name, units[name]) for name in own.states),
        inputs=(Input("rudder", "rad"),),
        outputs=tuple(Output(name, units[name], noise_std=std) for name, std in states),
        kinematics={name: DATA["equations"][vehicle][name] for name in own.states},
        parameters=(*shared, *by_record),
        step=min(own.sample_time, 0.5),
    )


def dataset(scenario: Scenario, model: Model, runs: Sequence[Run]) -> Dataset:
    """Records of the package; rows that were dropped are not in them."""
    records = []
    for run in runs:
        there = np.ones(len(run.times), dtype=bool)
        if scenario.dropped:
            there = np.isfinite(run.outputs).any(axis=1)
        parts = (run.times[there], run.inputs[there], run.outputs[there])
        records.append(Record(run.name, *parts, model.channels))
    return Dataset(records)


def outcome(scenario: Scenario, data: Set, settings: Mapping[str, Any]) -> Outcome:
    """Fit a data set, predict its fresh record, and keep what matters."""
    model = nominal_model(scenario.vehicle).with_values(believed(scenario))
    if scenario.hidden:
        model = model.fix(*VEHICLES[scenario.vehicle].local)
    names = tuple(VEHICLES[scenario.vehicle].believed)
    began = time.process_time()
    try:
        estimator = MultipleShooting(**{n: v for n, v in settings.items() if n != "predict"})
        fit = estimator.fit(model, dataset(scenario, model, data.runs))
    except Exception as error:  # a benchmark counts failures, it does not stop at them
        empty = dict.fromkeys(names, float("nan"))
        kind = f"raised {type(error).__name__}: {error}"
        seconds = time.process_time() - began
        return Outcome(data.number, data.truth, empty, empty, kind, (), None, seconds)
    seconds = time.process_time() - began
    by_output = {}
    if settings.get("predict", True):
        prediction = fit.predict(dataset(scenario, model, (data.fresh,)))
        # An output that is not predicted at all (NaN) is not covered.
        by_output = {n: float(np.nan_to_num(v)) for n, v in prediction.coverage().items()}
    return Outcome(
        number=data.number,
        truth=data.truth,
        estimates={name: fit.values[name] for name in names},
        std_errors={name: fit.std_errors[name] for name in names},
        status=fit.status.code,
        concerns=concerns(fit),
        force=forces(fit, scenario.vehicle),
        seconds=seconds,
        by_output=by_output,
        sea=sea_of(fit, scenario.vehicle),
        disturbed=fit.noise.has_forces,
        left_out=sum(count for count, _ in fit.excluded.values()),
        said=bool(fit.whole_runs.said),
    )


def sea_of(fit: Fit, vehicle: str) -> dict[str, Any] | None:
    """Period, width, shape and levels of the sea that a fit claims."""
    if not fit.noise.seas:
        return None
    sea = fit.noise.seas[0]
    levels = {place.removeprefix("force "): v for place, v in sea.levels.items()}
    return {
        "period": sea.period, "bandwidth": sea.bandwidth, "shape": sea.shape,
        "levels": {name: float(levels.get(name, 0.0)) for name in VEHICLES[vehicle].forces},
    }  # fmt: skip


def concerns(fit: Fit) -> tuple[str, ...]:
    """What a fit warns of, in few words each."""
    found = [] if fit.status.ok else [fit.status.code]
    return (*found, *(concern.kind for concern in fit.concerns))


def forces(fit: Fit, vehicle: str) -> dict[str, tuple[float, float]] | None:
    """Level and time of each disturbance force, where the fit has them."""
    names, levels = VEHICLES[vehicle].forces, np.atleast_1d(fit.noise.force)
    if not len(levels):  # none was admitted
        return dict.fromkeys(names, (0.0, float("nan")))
    times = np.broadcast_to(np.asarray(fit.noise.force_time, dtype=float), levels.shape)
    if len(levels) < len(names):
        return None
    pairs = zip(names, levels, times, strict=False)
    return {name: (float(level), float(tau)) for name, level, tau in pairs}
