"""Typical sizes of everything in a set of records: what scales candidates that nobody sized."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np

from oed_sysid.compiled.kernels import Kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood.disturbances import disturbance, places
from oed_sysid.likelihood.start_guess import kinematic_states, measured_states, slope
from oed_sysid.physics.model import Model
from oed_sysid.text import expressions


@dataclass(frozen=True)
class Sizes:
    """Typical sizes, by name.

    Attributes
    ----------
    swing : dict
        Standard deviation of every state, output and actuator signal.
    level : dict
        Root mean square of the same.
    rate : dict
        Root mean square of the rate of change of every state.
    mobility : dict
        What a unit force in an equation adds to the rate of its state.
    sample, step : float
        Median sample time and shortest integration step, s.
    """

    swing: dict[str, float]
    level: dict[str, float]
    rate: dict[str, float]
    mobility: dict[str, float]
    sample: float
    step: float

    def force(self, equation: str, state: str) -> float:
        """Force or rate in an equation that makes the accelerations seen."""
        return self.rate[state] / self.mobility[equation]


def sizes_of(model: Model, dataset: Dataset) -> Sizes:
    """Sizes that a model's signals have along records, their states measured or guessed."""
    names = model.state_names
    pooled: dict[str, list[np.ndarray]] = {}
    slopes: dict[str, list[np.ndarray]] = {}
    for record in dataset:
        seen = measured_states(model, record)
        series = dict(seen)
        series |= {k: guess.series for k, guess in kinematic_states(model, record, seen).items()}
        for position, values in series.items():
            pooled.setdefault(names[position], []).append(values)
            slopes.setdefault(names[position], []).append(slope(record.times, values)[0])
        known = dict(zip(model.input_names, record.inputs.T, strict=True))
        scope = {**model.values, **known, "t": record.times, "h": record.sample_time}
        for name, text in model.actuator_signals.items():
            if not expressions.functions(text) & {f.name for f in model.functions}:
                found = expressions.to_numpy(text, scope, model.tables)
                known[name] = np.broadcast_to(found, record.times.shape)
        known |= dict(zip(model.output_names, record.outputs.T, strict=True))
        for name, column in known.items():
            if name not in names:
                pooled.setdefault(name, []).append(column[np.isfinite(column)])
    joined = {name: np.concatenate(parts) for name, parts in pooled.items()}
    swing = {name: float(np.std(values)) for name, values in joined.items() if values.size}
    level = {
        name: float(np.sqrt(np.mean(values**2))) for name, values in joined.items() if values.size
    }
    duration = float(np.median([record.times[-1] - record.times[0] for record in dataset]))
    rates = {
        name: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for name, parts in slopes.items()
    }
    for state in model.states:  # of a state that nothing tells, what its declaration says
        swing.setdefault(state.name, state.scale)
        level.setdefault(state.name, state.scale)
        rates.setdefault(state.name, 10.0 * state.scale / duration)
    sample = float(np.median([record.sample_time for record in dataset]))
    shortest = min(
        record.sample_time / max(ceil(record.sample_time / model.step - 1e-9), 1)
        for record in dataset
    )
    begin = {name: float(values[0]) for name, values in joined.items()}
    mobility = _mobility(model, dataset, begin)
    return Sizes(swing, level, rates, mobility, sample, shortest)


def _mobility(model: Model, dataset: Dataset, begin: dict[str, float]) -> dict[str, float]:
    """What a unit force in every equation adds to the rate of its state, at the first sample."""
    where = [place for place in places(model) if place.stage == "force"]
    forced = model + [disturbance(place) for place in where]
    kernel = Kernel(forced, compiled=False)
    record = dataset[0]
    time = 0.1 * min(model.step, record.sample_time)  # too short for damping to matter
    times = record.times[0] + np.array([0.0, time])
    own = np.array([begin.get(name, 0.0) for name in model.state_names])
    start, _ = kernel.start(own, record.inputs[0], forced.value_vector, times[0])
    run = kernel.run(
        times, record.inputs[:2], forced.value_vector, start[None, :], sensitivities=True
    )
    ends = np.asarray(run.end_sensitivities)[0]
    found = {}
    for place in where:
        state = model.axes.get(place.signal, place.signal)
        column = kernel.n_full + forced.free_names.index(disturbance(place).name)
        moved = float(ends[model.state_names.index(state), column]) / time
        found[place.signal] = abs(moved) if np.isfinite(moved) and moved else 1.0
    return found
