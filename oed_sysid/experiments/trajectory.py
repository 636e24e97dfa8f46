"""Trajectories of a model for inputs that are known in advance: one, or many at once.

Many at once run over threads, because the compiled kernel leaves Python's lock.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from oed_sysid.compiled import graph as graph_module
from oed_sysid.compiled.kernels import kernel
from oed_sysid.errors import SimulationError, listed, located
from oed_sysid.experiments import SAYS
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import RUNAWAY
from oed_sysid.runtime.threads import in_chunks

# Real-axis limit of stability of the classical Runge-Kutta method: |1 + z + z^2/2 + z^3/6 + z^4/24|
# is one again where 1 + z/2 + z^2/6 + z^3/24 vanishes.
_STABLE_PRODUCT = -float(np.roots([1.0 / 24.0, 1.0 / 6.0, 1.0 / 2.0, 1.0]).real.min())


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States and noise-free outputs over time.

    Attributes
    ----------
    times : ndarray (n_times,)
        In s.
    inputs : ndarray (n_times, n_inputs)
        Commands.
    states : ndarray (n_times, n_states)
        The model's own states, then those that effects add; NaN after a failure.
    outputs : ndarray (n_times, n_outputs)
        What the sensors say, without noise; NaN after a failure.
    input_names, state_names, output_names : tuple of str
        Names of the columns.
    failed_at : int
        First sample that is not finite, or -1.

    Examples
    --------
    >>> t = np.arange(3.0)
    >>> run = Trajectory(t, t[:, None], t[:, None], t[:, None], ("delta",), ("psi",), ("psi",))
    >>> run.ok, run.output("psi")
    (True, array([0., 1., 2.]))
    """

    times: np.ndarray = field(repr=False)
    inputs: np.ndarray = field(repr=False)
    states: np.ndarray = field(repr=False)
    outputs: np.ndarray = field(repr=False)
    input_names: tuple[str, ...]
    state_names: tuple[str, ...]
    output_names: tuple[str, ...]
    failed_at: int = -1

    @property
    def ok(self) -> bool:
        """Whether the whole trajectory is finite."""
        return self.failed_at < 0

    def signal(self, name: str) -> np.ndarray:
        """Return one signal, shape ``(n_times,)``.

        A state goes before an output of the same name, and that before an
        input: ``signal("z")`` is the true depth, ``output("z")`` the measured.
        """
        known = self.signals
        located(SimulationError, "This trajectory has no signal", [name], known)
        return known[name]

    def output(self, name: str) -> np.ndarray:
        """Return one noise-free output, shape ``(n_times,)``."""
        lacking = "This trajectory has no output"
        return self.outputs[:, located(SimulationError, lacking, [name], self.output_names)[0]]

    @property
    def signals(self) -> dict[str, np.ndarray]:
        """All signals by name, as :meth:`signal` gives them."""
        names = (*self.state_names, *self.output_names, *self.input_names)
        columns = (*self.states.T, *self.outputs.T, *self.inputs.T)
        found: dict[str, np.ndarray] = {}
        for name, column in zip(names, columns, strict=True):
            found.setdefault(name, column)
        return found


def simulate_inputs(
    model: Model,
    times: ArrayLike,
    *,
    inputs: Mapping[str, ArrayLike] | ArrayLike,
    initial: Mapping[str, float] | ArrayLike | None = None,
    throw: bool = True,
) -> Trajectory:
    """Simulate a model for given inputs, without noise.

    Parameters
    ----------
    model : Model
        The model, at its parameter values.
    times : array_like (n_times,)
        Increasing times, s.
    inputs : array_like (n_times, n_inputs), or mapping of str to array_like
        Commands; in a mapping each is a number or of shape ``(n_times,)``.
    initial : mapping of str to float, or array_like (n_own,)
        Start values of the model's own states; those left out are zero.
    throw : bool
        Raise if the trajectory diverges, to no number or beyond 1e12 of a state's scale;
        otherwise see ``failed_at``.

    Returns
    -------
    Trajectory

    Raises
    ------
    SimulationError
        If inputs or start do not fit, or the trajectory diverges.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Output, State
    >>> tank = Model("tank", (State("z", "m"),), (), (Output("z", "m"),), {"z": "-0.5*sqrt(z)"})
    >>> run = simulate_inputs(tank, np.linspace(0, 2, 21), inputs={}, initial={"z": 4.0})
    >>> print(run.signal("z")[-1].round(6))
    2.25
    """
    moments = np.asarray(times, dtype=float)
    if moments.ndim != 1 or len(moments) < 2 or not np.all(np.diff(moments) > 0):
        raise SimulationError("Times have to be two or more, increasing strictly. Sort them.")
    commands = input_array(model, len(moments), inputs)
    own = start_array(model, initial)
    run = kernel(model).simulate(moments, commands, model.value_vector, own)
    trajectory = Trajectory(
        times=moments,
        inputs=commands,
        states=run.states[:, : len(model.all_state_names)],
        outputs=run.outputs,
        input_names=model.input_names,
        state_names=model.all_state_names,
        output_names=model.output_names,
        failed_at=run.failed_at,
    )
    if throw and (end := _runaway(model, trajectory)) >= 0:
        raise SimulationError(_divergence(model, trajectory, end))
    return trajectory


def state_scales(model: Model, n_states: int) -> np.ndarray:
    """Sizes of the states, those of effects 1."""
    own = [state.scale for state in model.states]
    return np.array(own + [1.0] * (n_states - len(own)))


def _runaway(model: Model, trajectory: Trajectory) -> int:
    """First sample at which the state is no number, or none that a vehicle has; -1 for none."""
    states = trajectory.states[: trajectory.failed_at] if not trajectory.ok else trajectory.states
    beyond = np.abs(states) > RUNAWAY * np.maximum(state_scales(model, states.shape[1]), 1.0)
    found = np.flatnonzero(beyond.any(axis=1))
    return int(found[0]) if found.size else trajectory.failed_at


def input_array(
    model: Model, n_times: int, inputs: Mapping[str, ArrayLike] | ArrayLike
) -> np.ndarray:
    """Return inputs as an array ``(n_times, n_inputs)``, or raise."""
    names = model.input_names
    if isinstance(inputs, Mapping):
        if set(inputs) != set(names):
            raise SimulationError(
                f"Model {model.name!r} has the inputs {listed(names)}; got "
                f"{listed(inputs)}. Give a value or an array for each."
            )
        columns = [np.broadcast_to(np.asarray(inputs[name], float), n_times) for name in names]
        commands = np.column_stack([np.empty((n_times, 0)), *columns])
    else:
        commands = np.asarray(inputs, dtype=float)
        if commands.shape == (n_times * len(names),) and len(names) < 2:
            commands = commands.reshape(n_times, len(names))
    if commands.shape != (n_times, len(names)):
        raise SimulationError(
            f"Inputs have shape {commands.shape}; expected time first, ({n_times}, {len(names)}), "
            f"with the columns {listed(names)}."
        )
    if not np.isfinite(commands).all():
        row, column = np.argwhere(~np.isfinite(commands))[0]
        raise SimulationError(
            f"Input {names[column]!r} is {commands[row, column]} at sample {row}. A command needs "
            "a value at every sample."
        )
    return np.ascontiguousarray(commands)


def start_array(model: Model, initial: Mapping[str, float] | ArrayLike | None) -> np.ndarray:
    """Return the model's own start states ``(n_own,)``, or raise."""
    names = model.state_names
    given = {} if initial is None else initial
    if isinstance(given, Mapping):
        located(SimulationError, f"Model {model.name!r} has no state", given, names)
        own = np.array([given.get(name, 0.0) for name in names], dtype=float)
    else:
        own = np.asarray(given, dtype=float)
    if own.shape != (len(names),) or not np.isfinite(own).all():
        raise SimulationError(
            f"The start state is {own}; expected {len(names)} finite numbers: {', '.join(names)}."
        )
    return own


def _divergence(model: Model, trajectory: Trajectory, end: int) -> str:
    """Say which state grew, when, and what to do about it; ``end`` is the first sample lost."""
    last, is_number = end - 1, end != trajectory.failed_at
    if last < 0 and not is_number:
        return str(SAYS["no_number"].format(model))
    state = trajectory.states[end if is_number else last]
    worst = int(np.argmax(np.abs(state) / state_scales(model, len(state))))
    value = f"{trajectory.state_names[worst]} = {state[worst]:.4g}"
    if last < 0:
        return str(SAYS["no_vehicle"].format(model, value=value))
    advice = SAYS["too_large"]
    if (fastest := _fastest_mode(model, trajectory)) * model.step > _STABLE_PRODUCT:
        step = _STABLE_PRODUCT / fastest / 2
        advice = SAYS["too_fast"].format(model, fastest=fastest, step=step)
    times = {"begin": trajectory.times[last], "end": trajectory.times[end]}
    which = "latter" if is_number else "last finite sample"
    return str(SAYS["diverged"].format(model, **times, which=which, value=value, advice=advice))


def _fastest_mode(model: Model, trajectory: Trajectory) -> float:
    """Largest magnitude of an eigenvalue of the rates at the first sample, 1/s."""
    graph = graph_module.build(model)
    own, first = trajectory.states[0, : graph.n_own], trajectory.inputs[0]
    values, time = model.value_vector, float(trajectory.times[0])
    z, _ = kernel(model).start(own, first, values, time)
    memory = z[graph.n_states : graph.n_states + graph.n_actuator_memory]
    signals, _ = graph.actuate(memory, first, values, time, model.step)
    matrix = np.array(graph.rates.jacobian()(trajectory.states[0], signals, values, time, 0)[0])
    return float(np.abs(np.linalg.eigvals(matrix)).max()) if np.isfinite(matrix).all() else 0.0


# -- many at once -----------------------------------------------------------------------


def simulate_batch(
    model: Model,
    times: ArrayLike,
    *,
    inputs: Mapping[str, ArrayLike] | ArrayLike,
    values: ArrayLike,
    initials: Mapping[str, float] | ArrayLike | None = None,
    n_workers: int | None = None,
) -> np.ndarray:
    """Simulate a model for many parameter sets, start states or inputs.

    Parameters
    ----------
    model : Model
        The model.
    times : array_like (n_times,)
        Increasing times, s, the same for all.
    inputs : array_like (n_times, n_inputs) or (n_batch, n_times, n_inputs), or mapping
        Commands, the same for all or one set each.
    values : array_like (n_batch, n_parameters)
        All parameters in the order of ``model.parameter_names``.
    initials : mapping, or array_like (n_own,) or (n_batch, n_own)
        Start values of the model's own states, the same for all or one each.
    n_workers : int, optional
        Threads; by default as many as there are cores.

    Returns
    -------
    ndarray (n_batch, n_times, n_outputs)
        Noise-free outputs; NaN from where a trajectory diverged.

    Raises
    ------
    SimulationError
        If the shapes do not fit together.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Output, State
    >>> from oed_sysid.physics.parameters import Parameter
    >>> decay = Model(
    ...     "decay", (State("x", "m"),), (), (Output("x", "m"),), {"x": "-a*x"},
    ...     parameters=(Parameter("a", 1.0, "1/s"),),
    ... )
    >>> y = simulate_batch(
    ...     decay, [0.0, 0.5, 1.0], inputs={}, values=[[1.0], [2.0]], initials={"x": 1.0}
    ... )
    >>> print(y[:, -1, 0].round(4))
    [0.3679 0.1353]
    """
    moments = np.asarray(times, dtype=float)
    table = np.ascontiguousarray(np.atleast_2d(np.asarray(values, dtype=float)))
    n_batch, n_parameters = table.shape
    if n_parameters != len(model.all_parameters):
        raise SimulationError(
            f"Values have {n_parameters} columns; model {model.name!r} has the "
            f"{len(model.all_parameters)} parameters {', '.join(model.parameter_names)}."
        )
    each = _each(inputs, 3, n_batch, "sets of inputs")
    commands = [input_array(model, len(moments), one) for one in each]
    starts = [start_array(model, one) for one in _each(initials, 2, n_batch, "start states")]
    runner = kernel(model)
    outputs = np.full((n_batch, len(moments), len(model.outputs)), np.nan)

    def run(member: int) -> None:
        own_inputs, own = commands[member % len(commands)], starts[member % len(starts)]
        outputs[member] = runner.simulate(moments, own_inputs, table[member], own).outputs

    # The interpreter keeps Python's lock; threads would only get in each other's way.
    in_chunks(run, n_batch, (n_workers or os.cpu_count() or 1) if runner.library else 1)
    return outputs


def _each(given: Any, n_dimensions: int, n_batch: int, words: str) -> list[Any]:
    """One part of an array for each member, or all of it for all."""
    if given is None or isinstance(given, Mapping):
        return [given]
    array = np.asarray(given, dtype=float)
    if array.ndim < n_dimensions:
        return [given]
    if len(array) != n_batch:
        raise SimulationError(
            f"There are {len(array)} {words} but {n_batch} sets of values. Give as many of both, "
            f"or one of {words} for all."
        )
    return list(array)
