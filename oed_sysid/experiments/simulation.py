"""Simulation: records of experiments, trajectories, batches, and steady states.

================================  ==================================================
:func:`simulate`                  a record of an experiment, with noise
:func:`simulate_inputs`           a trajectory for given inputs
:func:`simulate_batch`            many parameter sets or start states at once
:func:`equilibrium`               a trim condition
:func:`linearise`                 a linear state-space model around it
================================  ==================================================

Manoeuvres that react are simulated sample by sample or many at once: a decision is taken at each
sample on what is measured there while the command before it still acts. Controllers that foresee
their commands let whole windows be simulated at once; where one reacts earlier, the window is cut
there. The commands are the same to the last bit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oed_sysid.compiled.kernels import Run, kernel
from oed_sysid.data.dataset import Record
from oed_sysid.errors import SimulationError
from oed_sysid.experiments import SAYS
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.manoeuvres import command_all
from oed_sysid.experiments.steady import Equilibrium, equilibrium, linearise
from oed_sysid.experiments.trajectory import (
    Trajectory,
    simulate_batch,
    simulate_inputs,
    start_array,
)
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import ROUNDING

__all__ = [
    "Equilibrium",
    "Trajectory",
    "equilibrium",
    "linearise",
    "simulate",
    "simulate_batch",
    "simulate_inputs",
    "trajectory_of",
]


def simulate(
    model: Model,
    experiment: Experiment,
    *,
    rng: np.random.Generator | None = None,
    noise: bool = True,
    name: str | None = None,
) -> Record:
    """Run an experiment on a model and return what would be logged.

    Parameters
    ----------
    model : Model
        The model, at its parameter values.
    experiment : Experiment
        What is commanded, and from which state.
    rng : numpy.random.Generator
        Source of the measurement noise; needed if there is any.
    noise : bool
        Add white normal noise of each output's ``noise_std``.
    name : str, optional
        Name of the record; by default that of the experiment.

    Returns
    -------
    Record
        Inputs as commanded and outputs as measured.

    Raises
    ------
    DesignError
        If the experiment does not fit the model, or its commands break a limit.
    SimulationError
        If the trajectory diverges, or noise is wanted but not known.

    Notes
    -----
    A manoeuvre with feedback decides at each sample on the measurement of that
    sample, which is taken while the previous command still acts. An input that
    is interpolated linearly then moves from the previous command to the new
    one; the measurement on which a decision is taken still has it constant.

    Examples
    --------
    >>> from math import radians
    >>> from oed_sysid.physics.channels import Input, Output, State
    >>> from oed_sysid.experiments.manoeuvres import ZigZag
    >>> nomoto = Model(
    ...     "Nomoto", (State("psi", "rad"), State("r", "rad/s")), (Input("rudder", "rad"),),
    ...     (Output("psi", "rad", noise_std=0.002),), {"psi": "r", "r": "(0.1*rudder - r)/10"},
    ... )
    >>> test = Experiment("zigzag", ZigZag("rudder", 0.2, 0.2), duration=90.0, sample_time=0.5)
    >>> record = simulate(nomoto, test, rng=np.random.default_rng(1))
    >>> record.n_samples, int((np.diff(record.input("rudder")) != 0).sum())
    (181, 2)
    """
    if not isinstance(model, Model) or not isinstance(experiment, Experiment):
        found = " and ".join(type(one).__name__ for one in (model, experiment))
        raise SimulationError(f"Expected a model and an experiment, in this order; got {found}.")
    experiment.check_model(model)
    # Drawn before the run: a manoeuvre that reacts sees the noise that is logged.
    added = _draw_noise(model, experiment, len(experiment.times), rng) if noise else None
    run = trajectory_of(model, experiment, noise=added)
    outputs = run.outputs if added is None else run.outputs + added
    source = f"simulation of {model.name}: {experiment.describe()}"
    return Record(
        name or experiment.name, run.times, run.inputs, outputs, model.channels, source=source
    )


def trajectory_of(
    model: Model, experiment: Experiment, *, noise: np.ndarray | None = None
) -> Trajectory:
    """What a vehicle does in an experiment; one that reacts closes its loop on this vehicle.

    Parameters
    ----------
    model : Model
    experiment : Experiment
    noise : ndarray (n_times, n_outputs), optional
        What is added to the outputs before a manoeuvre sees them.

    Returns
    -------
    Trajectory
        States and noise-free outputs at the times of the experiment.

    Raises
    ------
    DesignError
        If the experiment does not fit the model, or commands of a loop leave their limits.
    SimulationError
        If the vehicle diverges.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading")
    >>> trajectory_of(ship.model, next(iter(ship.experiments.values()))).state_names
    ('psi', 'r')
    """
    experiment.check_model(model)
    times = experiment.times
    if experiment.reacts:
        inputs = _Loop(model, experiment, noise).run()
        signals = dict(zip(model.input_names, inputs.T, strict=True))
        experiment.check_limits(*experiment.limits.violations(times, signals))
    else:
        inputs = experiment.commands(model.input_names)
    return simulate_inputs(model, times, inputs=inputs, initial=experiment.initial)


def _draw_noise(
    model: Model, experiment: Experiment, n_times: int, rng: np.random.Generator | None
) -> np.ndarray:
    """Noise of all outputs, shape ``(n_times, n_outputs)``."""
    stds = {output.name: output.noise_std for output in model.outputs} | dict(experiment.noise)
    if unknown := [name for name, std in stds.items() if std is None]:
        raise SimulationError(
            SAYS["unknown_noise"].format(names=", ".join(unknown), unknown=unknown)
        )
    if not (scales := np.array([stds[name] for name in model.output_names], dtype=float)).any():
        return np.zeros((n_times, len(scales)))
    if rng is None:
        raise SimulationError(
            "Noise needs a generator: pass rng=np.random.default_rng(seed), or noise=False."
        )
    return rng.standard_normal((n_times, len(scales))) * scales


# -- manoeuvres that react ----------------------------------------------------------------


def _seen(model: Model, experiment: Experiment) -> tuple[dict[str, int], set[str]]:
    """Columns of the signals that manoeuvres react to, and which of these are true states."""
    states, outputs = model.all_state_names, model.output_names
    wanted = [name for one in experiment.manoeuvres for name in one.feedback]
    true = {*wanted} - {*outputs} if experiment.feedback == "measured" else {*wanted} & {*states}
    return {name: (states if name in true else outputs).index(name) for name in wanted}, true


class _Loop:
    """A run of controllers and vehicle, window by window."""

    def __init__(self, model: Model, experiment: Experiment, noise: np.ndarray | None) -> None:
        reacting = [one for one in experiment.manoeuvres if one.feedback]
        self.controllers = {one.input: one.controller() for one in reacting}
        self.times, names = experiment.times, model.input_names
        self.columns = [names.index(name) for name in self.controllers]
        self.values, self.runner = model.value_vector, kernel(model)
        self.own = start_array(model, experiment.initial)
        self.seen, self.states = _seen(model, experiment)
        self.noise = noise if experiment.feedback == "measured" else None
        # Before the first decision the commanded inputs are at rest.
        self.rest = np.array([experiment.constants.get(name, 0.0) for name in names])
        self.linear = any(channel.interpolation == "linear" for channel in model.inputs)
        self.inputs = np.zeros((len(self.times), len(names)))
        for name, commands in experiment.known_commands().items():
            self.inputs[:, names.index(name)] = commands

    def run(self) -> np.ndarray:
        """Commands ``(n_times, n_inputs)`` of the whole run."""
        times, inputs = self.times, self.inputs
        z, _ = self.runner.start(self.own, self.rest, self.values, times[0])
        first = self.runner.run(times[:2], np.stack([self.rest, self.rest]), self.values, z)
        inputs[0, self.columns] = self._decide(0, first, 0)
        # What remembers begins at the first command, once that is decided.
        z, _ = self.runner.start(self.own, inputs[0], self.values, times[0])
        k, turns, slope = 1, 1, np.zeros(len(self.columns))
        while k < len(times):
            # Ahead as if no command reacted but went on as it does, for as long as most did.
            n = min(2 * k // turns, len(times) - k)
            going = inputs[k - 1, self.columns] + np.outer(np.arange(1, n + 1), slope)
            inputs[k : k + n, self.columns] = going
            going = going.tolist()
            commands = inputs[k - 1 : k + n].copy()
            window = self.runner.run(times[k - 1 : k + n], commands, self.values, z)
            sees = self._measured(times[k - 1 : k + n], commands, window)
            for row in range(1, n + 1):
                now = k + row - 1
                if 0 <= window.failed_at <= row:
                    inputs[now:] = inputs[now - 1]
                    return inputs  # simulate_inputs will fail at the same place, with words
                decided = self._decide(now, sees, row)
                inputs[now, self.columns] = decided
                if moved := any(
                    abs(one - other) > ROUNDING * (1 + abs(other))
                    for one, other in zip(decided, going[row - 1], strict=True)
                ):
                    break
            k, turns = k + row, turns + moved
            # A rudder that moves at its rate goes on so for many samples.
            slope = inputs[k - 1, self.columns] - inputs[k - 2, self.columns]
            z = window.states[row]
            if moved and self.linear:
                two = slice(k - 2, k)
                last = self.runner.run(times[two], inputs[two], self.values, window.states[row - 1])
                z = last.states[1]
        return inputs

    def _measured(self, times: np.ndarray, commands: np.ndarray, window: Run) -> Run:
        """What is measured at each sample of a window while the command before it still acts.

        Each sample is one step from the state of the one before. Steps that begin at even and at
        odd samples make two records of segments of two samples.
        """
        # States are not touched by a command of the same sample.
        untouched = self.states == self.seen.keys() and not self.linear
        if untouched or np.all(commands == commands[0]):
            return window
        states, outputs = window.states.copy(), window.outputs.copy()
        for first in range(min(2, len(times) - 1)):
            starts = np.arange(first, len(times) - 1, 2)
            span = slice(first, starts[-1] + 2)
            held = commands[span].copy()
            # The measurement of a sample is taken while the command of the one before still acts.
            held[1::2] = held[::2]
            begin = window.states[starts]
            part = self.runner.run(times[span], held, self.values, begin, starts=starts - first)
            states[starts + 1], outputs[starts + 1] = part.states[1::2], part.outputs[1::2]
        return replace(window, states=states, outputs=outputs)

    def _decide(self, sample: int, window: Run, row: int) -> list[float]:
        """Commands of the inputs that react, on what is seen in a row of a window."""
        noisy = window.outputs[row] + (0.0 if self.noise is None else self.noise[sample])
        true = window.states[row]
        seen = {n: float((true if n in self.states else noisy)[i]) for n, i in self.seen.items()}
        return list(command_all(self.controllers, float(self.times[sample]), seen).values())
