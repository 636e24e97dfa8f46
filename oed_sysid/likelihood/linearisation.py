r"""Linear dynamics along the trajectory that a vehicle most likely took.

A model that lacks physics, run on its own, soon leaves the vehicle's track;
what is linear there says little about what happened here. With all forces of
the noise model let in, the smoothed trajectory :math:`\bar x` stays near the measurements:

.. math::
    x_{k+1} - \bar x_{k+1} = A_k (x_k - \bar x_k) + B_k\, \delta p + G_k w_k
    + \left[F(\bar x_k) - \bar x_{k+1}\right]

The model is linearised along it, its one-step errors (the bracket) are carried as defects.
Regressors along a smoothed path hold the noise, so this serves to say where a model fails, for
residual forces and pictures; parameters and their errors come from the filtered path
(:mod:`oed_sysid.likelihood.filtered`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import SimulationError
from oed_sysid.likelihood.disturbances import Place, disturbance, places
from oed_sysid.likelihood.kalman import Deviations
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.restricted_likelihood import Grounds, restricted
from oed_sysid.likelihood.smoother import smooth
from oed_sysid.physics.model import Model

# Most relinearisations; they stop when the trajectory moves by less than this, as its outputs
# show it in units of the noise (root mean square).
ROUNDS, STILL = 8, 0.1
# Deviations that grow by more along a record would leave nothing but rounding errors.
GROWN = 1e10
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


def along(
    model: Model,
    names: Sequence[str],
    dataset: Dataset,
    nodes: Sequence[np.ndarray],
    noise: NoiseModel,
    unit: NoiseModel,
    local: Sequence[Mapping[str, float]] | None = None,
) -> Along:
    """Linearise a fit along the trajectories that its noise model makes most likely.

    Parameters
    ----------
    model : Model
        At the values to linearise at.
    names : sequence of str
        Estimated parameters; those of each record may be among them.
    dataset : Dataset
    nodes : sequence of ndarray (n_times, n_full)
        Full states near the true ones, such as those of a filter, per record.
    noise : NoiseModel
        With a disturbance for every equation.
    unit : NoiseModel
        Natural size of every level.
    local : sequence of mapping, optional
        Values of per-record parameters.
    """
    system = System.of(model, names, dataset, local)
    noise = replace(
        noise,
        white=np.maximum(noise.white, LEAST_WHITE * unit.white),
        force=np.maximum(noise.force, LEAST_FORCE * unit.force),
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
    dataset : Dataset
    model : Model
        At the values to linearise at, with the effects of the fit.
    names : tuple of str
        Estimated parameters that all records share.
    own_names : tuple of str
        Estimated parameters of each record.
    where : tuple of Place
    held : Model
        The model with a disturbance at every place.
    local : tuple of mapping
        Values of parameters of each record.
    """

    dataset: Dataset
    model: Model
    names: tuple[str, ...]
    own_names: tuple[str, ...]
    where: tuple[Place, ...]
    held: Model
    local: tuple[Mapping[str, float], ...]

    @classmethod
    def of(
        cls,
        model: Model,
        names: Sequence[str],
        dataset: Dataset,
        local: Sequence[Mapping[str, float]] | None = None,
    ) -> System:
        """The model of a fit."""
        where = places(model)
        held = model.fix(*(name for name in model.free_names if name not in names))
        held += [disturbance(place) for place in where if place.stage != "sensor"]
        own = tuple(name for name in names if model.parameter(name).per_record)
        shared = tuple(name for name in names if name not in own)
        return cls(dataset, model, shared, own, where, held, tuple(local or ({},) * len(dataset)))

    def values(self, index: int) -> np.ndarray:
        """Values of all parameters for one record."""
        own = {name: v for name, v in self.local[index].items() if name in self.own_names}
        return self.held.with_values(own).value_vector

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
            _stretch(self, index, record, states)
            for index, (record, states) in enumerate(zip(self.dataset, nodes, strict=True))
        )
        columns = tuple(stretch.columns for stretch in stretches)
        grounds = Grounds(columns, _prior(self.model, self.names), noise.white)
        return Along(self, stretches, grounds, noise)


def _prior(model: Model, names: Sequence[str]) -> np.ndarray:
    prior = np.zeros((len(names), 2))
    for position, name in enumerate(names):
        parameter = model.parameter(name)
        if parameter.prior_spread is not None and parameter.prior_mean is not None:
            prior[position] = 1.0, parameter.prior_mean - parameter.value
            prior[position] /= parameter.prior_spread
    return prior


def _stretch(system: System, index: int, record: Record, states: np.ndarray) -> Stretch:
    model, names, where = system.held, system.names, system.where
    compiled, values = kernel(model), system.values(index)
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
    by_own = [free[name] for name in system.own_names]
    n_shared, n_free = len(by_name), len(by_own)
    transition = np.ascontiguousarray(run.end_sensitivities[:, :, :size])
    output = np.ascontiguousarray(run.output_sensitivities[:, :, :size])
    gains, direct = np.zeros((n, size, len(where))), np.zeros((*record.outputs.shape, len(where)))
    for position, place in enumerate(where):
        if place.stage == "sensor":
            direct[:, model.output_names.index(place.signal), position] = 1.0
        else:
            column = free[disturbance(place).name]
            gains[:, :, position] = run.end_sensitivities[:, :, column]
            direct[:, :, position] = run.output_sensitivities[:, :, column]
    # Sensitivities and drift of the linear model, started from the nodes' own first state.
    # Columns: shared parameters, own start states, parameters of the record, what is left.
    _, first = compiled.start(states[0, :n_own], record.inputs[0], values, record.times[0])
    width = n_shared + n_own + n_free + 1
    columns_of = [*range(n_shared), *range(n_shared + n_own, width - 1)]
    both = [*by_name, *by_own]
    drive = np.zeros((n, size, width))
    drive[:, :, columns_of] = run.end_sensitivities[:, :, both]
    drive[:-1, :, -1] = run.ends[:-1] - states[1:]
    moved = np.zeros((n, size, width))
    moved[0][:, columns_of] = first[:, [n_own + column - size for column in both]]
    moved[0, :, n_shared : n_shared + n_own] = first[:, :n_own]
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(n - 1):
            moved[k + 1] = transition[k] @ moved[k] + drive[k]
        columns = output @ moved
    if not np.isfinite(columns).all() or np.abs(columns).max() > GROWN * np.abs(first).max():
        raise SimulationError(
            f"Small deviations of model {model.name!r} grow without bound along record "
            f"{record.name!r}. Cut the record, or bound the parameters."
        )
    columns[:, :, columns_of] += run.output_sensitivities[:, :, both]
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
