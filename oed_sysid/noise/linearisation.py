"""Linear dynamics along the trajectory that a vehicle most likely took.

A model that lacks physics, run on its own, soon leaves the vehicle's track;
what is linear there says little about what happened here. With all forces of
the noise model let in, the smoothed trajectory stays near the measurements.
The model is linearised along it, its one-step errors are carried as defects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Record
from oed_sysid.diagnosis.greybox import GreyBox, Task
from oed_sysid.errors import SimulationError
from oed_sysid.model import Model
from oed_sysid.noise.disturbances import Place, disturbance, places
from oed_sysid.noise.kalman import Deviations, NoiseModel
from oed_sysid.noise.restricted_likelihood import Grounds, restricted
from oed_sysid.noise.smoother import smooth

# Most relinearisations; they stop when the trajectory moves by less than this, as its outputs
# show it in units of the noise (root mean square).
ROUNDS, STILL = 8, 0.1
# Smallest force that is let in, as a share of the one that moves an output by its noise.
LEAST_FORCE = 0.1
# Smallest white sensor noise, as a share of its unit: a level that colour has taken over
# would make one sensor the whole truth.
LEAST_WHITE = 0.5


@dataclass(frozen=True, eq=False)
class Stretch:
    """Linear dynamics of one record.

    Attributes
    ----------
    states : ndarray (n_times, n_full)
        Trajectory along which the model is linearised.
    transition : ndarray (n_times, n_full, n_full)
    gains : ndarray (n_times, n_full, n_places)
        Effect on the next state of each disturbance, held between samples.
    output : ndarray (n_times, n_outputs, n_full)
    direct : ndarray (n_times, n_outputs, n_places)
        Effect of each disturbance on the outputs at once.
    columns : ndarray (n_times, n_outputs, n_names + n_own + 1)
        Derivatives by parameters and initial states, then the residual, all
        of the linear model.
    sensitivities : ndarray (n_times, n_full, n_names + n_own)
        Derivatives of the states.
    drift : ndarray (n_times, n_full)
        Where the linear model goes if nothing acts, relative to ``states``.
    present : ndarray (n_times, n_outputs)
    sample_time : float
    """

    states: np.ndarray
    transition: np.ndarray
    gains: np.ndarray
    output: np.ndarray
    direct: np.ndarray
    columns: np.ndarray
    sensitivities: np.ndarray
    drift: np.ndarray
    present: np.ndarray
    sample_time: float

    def deviations(self, chosen: Sequence[int]) -> Deviations:
        """Deviations driven by some of the disturbances."""
        return Deviations(
            self.transition,
            np.ascontiguousarray(self.gains[:, :, list(chosen)]),
            self.output,
            self.present,
            self.sample_time,
        )

    def alone(self, index: int) -> Deviations:
        """Deviations driven by one disturbance, its direct effect on outputs included.

        A disturbance shows in an output at once through one more state, a
        sample late: harmless to one that is correlated over seconds.
        """
        n, size = len(self.states), self.states.shape[1]
        transition = np.zeros((n, size + 1, size + 1))
        transition[:, :size, :size] = self.transition
        gain = np.ones((n, size + 1, 1))
        gain[:, :size, 0] = self.gains[:, :, index]
        output = np.concatenate([self.output, self.direct[:, :, index : index + 1]], axis=2)
        return Deviations(transition, gain, output, self.present, self.sample_time)


@dataclass(frozen=True, eq=False)
class Along:
    """A fit linearised along smoothed trajectories.

    Attributes
    ----------
    system : System
        What was linearised.
    stretches : tuple of Stretch
        One per record.
    grounds : Grounds
        Sensitivities and residuals of all records.
    noise : NoiseModel
        Noise model under which the trajectories were smoothed.
    """

    system: System
    stretches: tuple[Stretch, ...]
    grounds: Grounds
    noise: NoiseModel

    @property
    def where(self) -> tuple[Place, ...]:
        """Places of the chain, in the order of the gains."""
        return self.system.where

    @property
    def forces(self) -> tuple[int, ...]:
        """Positions of the equations' forces among the places."""
        return tuple(i for i, place in enumerate(self.where) if place.stage == "force")

    def units(self, correlation_time: float) -> np.ndarray:
        """Disturbances that move some output by its noise within a correlation time.

        Returns
        -------
        ndarray (n_places,)
        """
        sizes = [_response(s, self.grounds.white, correlation_time) for s in self.stretches]
        size = np.mean(sizes, axis=0)
        return 1.0 / np.where(size > 0, size, 1.0)

    @property
    def joint(self) -> list[Deviations]:
        """Deviations driven by all forces, per record."""
        return [stretch.deviations(self.forces) for stretch in self.stretches]


def _response(stretch: Stretch, white: np.ndarray, correlation_time: float) -> np.ndarray:
    """Typical response of the outputs, in noise, to each disturbance held for a while."""
    n, size = stretch.states.shape
    span = max(1, min(round(correlation_time / stretch.sample_time), n // 2))
    moved = np.zeros((size, stretch.gains.shape[2]))
    found = []
    for k in range(n - 1):
        moved = stretch.transition[k] @ moved + stretch.gains[k]
        if (k + 1) % span == 0:
            shown = np.abs(stretch.output[k + 1] @ moved) + np.abs(stretch.direct[k + 1])
            found.append(np.max(shown / white[:, None], axis=0))
            moved = np.zeros_like(moved)
    return np.median(found, axis=0)


def _shown(stretch: Stretch, states: np.ndarray, white: np.ndarray) -> float:
    """How far new states are from those of a stretch, as its outputs show it, in noise."""
    moved = np.einsum("kij,kj->ki", stretch.output, states - stretch.states) / white
    return float(np.sqrt(np.mean(moved**2)))


def fitted_model(task: Task, fit: GreyBox) -> Model:
    """The base model with the effects that a fit has, at its values."""
    names = set(fit.names) | {name for name, value in fit.values.items() if value}
    active = [
        effect
        for effect in task.super_model.candidates
        if names.intersection(effect.amplitude_names)
    ]
    model = task.super_model.base + active
    known = set(model.parameter_names)
    return model.with_values({k: v for k, v in fit.values.items() if k in known})


def along(task: Task, fit: GreyBox) -> Along:
    """Linearise a fit along the trajectories that its noise model makes most likely.

    Parameters
    ----------
    task : Task
    fit : GreyBox
        With estimated noise levels.
    """
    system = System.of(task, fit)
    nodes = system.free_run([run.states[0] for run in fit.runs])
    noise = replace(
        fit.noise,
        white=np.maximum(fit.noise.white, LEAST_WHITE * task.units.white),
        force=np.maximum(fit.noise.force, LEAST_FORCE * task.units.force),
    )
    found = system.linearise(nodes, noise)
    for _ in range(ROUNDS):
        moved = smoothed_states(found, noise, found.joint)
        pairs = zip(found.stretches, moved, strict=True)
        shown = max(_shown(stretch, states, noise.white) for stretch, states in pairs)
        found = system.linearise(moved, noise)
        if shown < STILL:
            break
    return found


@dataclass(frozen=True, eq=False)
class System:
    """A model that can be linearised anywhere, every place of its chain disturbed.

    Attributes
    ----------
    task : Task
    model : Model
        At the values to linearise at, with the effects of the fit.
    names : tuple of str
        Estimated parameters.
    where : tuple of Place
    held : Model
        The model with a disturbance at every place.
    """

    task: Task
    model: Model
    names: tuple[str, ...]
    where: tuple[Place, ...]
    held: Model

    @classmethod
    def of(cls, task: Task, fit: GreyBox) -> System:
        """The model of a fit."""
        model = fitted_model(task, fit)
        where = places(model)
        held = model.fix(*(name for name in model.free_names if name not in fit.names))
        held += [effect for effect in map(disturbance, where) if effect is not None]
        return cls(task, model, fit.names, where, held)

    def moved(self, correction: np.ndarray) -> System:
        """The same at values that differ by a correction, bounds respected."""
        values = {}
        for name, change in zip(self.names, correction, strict=True):
            parameter = self.model.parameter(name)
            moved = parameter.value + float(change)
            values[name] = float(np.clip(moved, parameter.lower, parameter.upper))
        return self.at(values)

    def at(self, values: Mapping[str, float]) -> System:
        """The same at other values of the estimated parameters."""
        own = {name: values[name] for name in self.names}
        return replace(self, model=self.model.with_values(own), held=self.held.with_values(own))

    def free_run(self, starts: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Full states of the model on its own, ``(n_times, n_full)`` per record."""
        compiled, values = kernel(self.held), self.held.value_vector
        result = []
        for record, own in zip(self.task.dataset, starts, strict=True):
            z0, _ = compiled.start(own, record.inputs[0], values, record.times[0])
            run = compiled.run(record.times, record.inputs, values, z0)
            if not run.ok:
                raise SimulationError(
                    f"Model {self.model.name!r} diverges on record {record.name!r} at sample "
                    f"{run.failed_at}. Start from other values, or bound the parameters."
                )
            result.append(run.states)
        return result

    def linearise(self, nodes: Sequence[np.ndarray], noise: NoiseModel) -> Along:
        """Linearise along given states.

        Parameters
        ----------
        nodes : sequence of ndarray (n_times, n_full)
            Full states, per record.
        noise : NoiseModel
            Noise model that goes with them.
        """
        stretches = tuple(
            _stretch(self, record, states)
            for record, states in zip(self.task.dataset, nodes, strict=True)
        )
        columns = tuple(stretch.columns for stretch in stretches)
        grounds = Grounds(columns, _prior(self.model, self.names), noise.white)
        return Along(self, stretches, grounds, noise)


def _prior(model: Model, names: Sequence[str]) -> np.ndarray:
    prior = np.zeros((len(names), 2))
    for position, name in enumerate(names):
        parameter = model.parameter(name)
        if parameter.prior_std is not None and parameter.prior_mean is not None:
            prior[position] = 1.0, parameter.prior_mean - parameter.value
            prior[position] /= parameter.prior_std
    return prior


def _stretch(system: System, record: Record, states: np.ndarray) -> Stretch:
    model, names, where = system.held, system.names, system.where
    compiled, values = kernel(model), model.value_vector
    run = compiled.run(
        record.times,
        record.inputs,
        values,
        states,
        starts=np.arange(record.n_samples, dtype=np.intc),
        sensitivities=True,
    )
    if run.end_sensitivities is None or run.output_sensitivities is None or not run.ok:
        raise SimulationError(
            f"Model {model.name!r} diverges along record {record.name!r} at sample "
            f"{run.failed_at}. Bound its parameters."
        )
    n, size, n_own = record.n_samples, compiled.n_full, compiled.n_own
    free = {name: size + i for i, name in enumerate(model.free_names)}
    by_name = [free[name] for name in names]
    transition = np.ascontiguousarray(run.end_sensitivities[:, :, :size])
    output = np.ascontiguousarray(run.output_sensitivities[:, :, :size])
    gains, direct = np.zeros((n, size, len(where))), np.zeros((*record.outputs.shape, len(where)))
    for index, place in enumerate(where):
        effect = disturbance(place)
        if effect is None:
            direct[:, model.output_names.index(place.signal), index] = 1.0
        else:
            gains[:, :, index] = run.end_sensitivities[:, :, free[effect.name]]
            direct[:, :, index] = run.output_sensitivities[:, :, free[effect.name]]
    # Sensitivities and drift of the linear model, started from the nodes' own first state.
    _, first = compiled.start(states[0, :n_own], record.inputs[0], values, record.times[0])
    drive = np.zeros((n, size, len(names) + n_own + 1))
    drive[:, :, : len(names)] = run.end_sensitivities[:, :, by_name]
    drive[:-1, :, -1] = run.ends[:-1] - states[1:]
    moved = np.zeros((n, size, len(names) + n_own + 1))
    moved[0, :, : len(names)] = first[:, [n_own + free[name] - size for name in names]]
    moved[0, :, len(names) : -1] = first[:, :n_own]
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(n - 1):
            moved[k + 1] = transition[k] @ moved[k] + drive[k]
        columns = output @ moved
    if not np.isfinite(columns).all():
        raise SimulationError(
            f"Small deviations of model {model.name!r} grow without bound along record "
            f"{record.name!r}. Bound its parameters."
        )
    columns[:, :, : len(names)] += run.output_sensitivities[:, :, by_name]
    columns[:, :, -1] = record.outputs - run.outputs - columns[:, :, -1]
    return Stretch(
        states,
        transition,
        gains,
        output,
        direct,
        columns,
        moved[:, :, :-1],
        moved[:, :, -1],
        np.isfinite(record.outputs).astype(float),
        record.sample_time,
    )


def smoothed_states(
    found: Along, noise: NoiseModel, lines: Sequence[Deviations]
) -> list[np.ndarray]:
    """States given all measurements under a noise model, per record.

    Parameters
    ----------
    found : Along
    noise : NoiseModel
    lines : sequence of Deviations
        Driven by the noise model's forces; their states begin with the full
        state.
    """
    solution = restricted(found.grounds, [noise], [lines])[0]
    result = []
    for index, (stretch, line) in enumerate(zip(found.stretches, lines, strict=True)):
        step = solution.correction[found.grounds.unknowns(index)]
        residual = stretch.columns[:, :, -1] - stretch.columns[:, :, :-1] @ step
        smoothed = smooth(noise, line, residual[:, :, None])
        size = stretch.states.shape[1]
        moved = stretch.drift + stretch.sensitivities @ step + smoothed.states[:, :size, 0]
        result.append(stretch.states + moved)
    return result
