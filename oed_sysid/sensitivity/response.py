"""What a manoeuvre makes a model do, and how that depends on every unknown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import DesignError
from oed_sysid.experiment import Experiment
from oed_sysid.fitting.start_guess import measured_states
from oed_sysid.model import Model
from oed_sysid.simulation import simulate, simulate_inputs

Run = Experiment | Record


@dataclass(frozen=True, eq=False)
class Response:
    """Outputs of one run and their derivatives.

    Attributes
    ----------
    name : str
        Name of the experiment or record.
    times : ndarray (n_times,)
    inputs : ndarray (n_times, n_inputs)
    initial : ndarray (n_own,)
        The model's own states at the first sample.
    outputs : ndarray (n_times, n_outputs)
        Noise-free outputs.
    states : ndarray (n_times, n_full)
        Full states.
    present : ndarray of bool (n_times, n_outputs)
        Which samples are (or will be) measured.
    jacobian : ndarray (n_times, n_outputs, n_own + n_free)
        Derivatives of the outputs by own start states, then by free parameters.
    noise : mapping of str to float
        Noise levels that differ from the model's in this run.
    """

    name: str
    times: np.ndarray = field(repr=False)
    inputs: np.ndarray = field(repr=False)
    initial: np.ndarray
    outputs: np.ndarray = field(repr=False)
    states: np.ndarray = field(repr=False)
    present: np.ndarray = field(repr=False)
    jacobian: np.ndarray = field(repr=False)
    noise: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Play:
    """Inputs and start of a run, with feedback already resolved.

    Attributes
    ----------
    name : str
    times : ndarray (n_times,)
    inputs : ndarray (n_times, n_inputs)
    initial : ndarray (n_own,)
    present : ndarray of bool (n_times, n_outputs)
    noise : mapping of str to float
    """

    name: str
    times: np.ndarray
    inputs: np.ndarray
    initial: np.ndarray
    present: np.ndarray
    noise: Mapping[str, float] = field(default_factory=dict)


def plays(
    model: Model,
    runs: Run | Dataset | Iterable[Run],
    *,
    initial_states: Sequence[Mapping[str, float] | np.ndarray] | None = None,
) -> tuple[Play, ...]:
    """Return what is commanded in each run, and from which start.

    The commands of an experiment with feedback are those of a run of this
    model without noise; afterwards they are a given history, as they are for
    an estimator that gets the logged commands.

    Parameters
    ----------
    model : Model
        The model.
    runs : Experiment, Record, Dataset or iterable of these
        What is to be run, or was run.
    initial_states : sequence of mapping or ndarray (n_own,), optional
        Start states per run; by default those of the experiment, or the
        smoothed first measurements of a record.
    """
    listed = (runs,) if isinstance(runs, Experiment | Record) else tuple(runs)
    if not listed:
        raise DesignError("There is no experiment or record. Give at least one.")
    if initial_states is not None and len(initial_states) != len(listed):
        raise DesignError(
            f"There are {len(initial_states)} start states for {len(listed)} runs. Give one each."
        )
    found = []
    for index, run in enumerate(listed):
        play = _played(model, run) if isinstance(run, Experiment) else _recorded(model, run)
        if initial_states is not None:
            play = replace(play, initial=_own(model, initial_states[index], play.initial))
        found.append(play)
    return tuple(found)


def respond(model: Model, play: Play) -> Response:
    """Simulate one run with derivatives.

    Raises
    ------
    SimulationError
        If the trajectory diverges, with the state that grew.
    """
    runner = kernel(model)
    values = model.value_vector
    z, dz = runner.start(play.initial, play.inputs[0], values, float(play.times[0]))
    run = runner.run(play.times, play.inputs, values, z, sensitivities=True)
    if not run.ok or run.output_sensitivities is None:
        # The simulator says in words which state grew and what to do.
        simulate_inputs(model, play.times, inputs=play.inputs, initial=play.initial)
        raise DesignError(f"The sensitivities of run {play.name!r} are not finite. Shorten it.")
    return Response(
        name=play.name,
        times=play.times,
        inputs=play.inputs,
        initial=play.initial,
        outputs=run.outputs,
        states=run.states,
        present=play.present,
        jacobian=by_unknowns(run.output_sensitivities, dz, runner.n_own),
        noise=play.noise,
    )


def by_unknowns(by_start: np.ndarray, dz: np.ndarray, n_own: int) -> np.ndarray:
    """Chain derivatives by a full state with those of that state by the unknowns.

    Parameters
    ----------
    by_start : ndarray (n_times, n_outputs, n_full + n_free)
        From a kernel.
    dz : ndarray (n_full, n_own + n_free)
        Derivatives of the full state.
    n_own : int
        Number of the model's own states.

    Returns
    -------
    ndarray (n_times, n_outputs, n_own + n_free)
    """
    n_full = len(dz)
    n_times, n_outputs, n_columns = by_start.shape
    if np.array_equal(dz, np.eye(*dz.shape)):
        return by_start  # the full state is the model's own, the usual case without memory
    flat = by_start.reshape(-1, n_columns)
    jacobian = flat[:, :n_full] @ dz
    jacobian[:, n_own:] += flat[:, n_full:]
    return jacobian.reshape(n_times, n_outputs, -1)


def _played(model: Model, experiment: Experiment) -> Play:
    record = simulate(model, experiment, noise=False)
    return Play(
        name=experiment.name,
        times=record.times,
        inputs=record.inputs,
        initial=_own(model, experiment.initial, np.zeros(len(model.states))),
        present=np.ones(record.outputs.shape, dtype=bool),
        noise=dict(experiment.noise),
    )


def _recorded(model: Model, record: Record) -> Play:
    if record.channels.input_names != model.input_names or (
        record.channels.output_names != model.output_names
    ):
        raise DesignError(
            f"Record {record.name!r} holds other signals than model {model.name!r} has. Read it "
            "with the model's channels."
        )
    own = np.zeros(len(model.states))
    for position, series in measured_states(model, record).items():
        own[position] = series[0]
    return Play(record.name, record.times, record.inputs, own, np.isfinite(record.outputs))


def _own(model: Model, given: Mapping[str, float] | np.ndarray, base: np.ndarray) -> np.ndarray:
    if not isinstance(given, Mapping):
        return np.asarray(given, dtype=float)
    own = base.copy()
    for name, value in given.items():
        own[model.state_names.index(name)] = value
    return own
