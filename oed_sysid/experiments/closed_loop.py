"""Commands of manoeuvres that react to what they see, sample by sample or many at once.

A decision is taken at each sample on what is measured there while the command before it still
acts. Controllers that foresee their commands let whole windows be simulated at once; where one
reacts earlier, the window is cut there. The commands are the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from oed_sysid.compiled.kernels import Kernel, Run, kernel
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.manoeuvres import Controller, command_all
from oed_sysid.experiments.trajectory import start_array, state_names
from oed_sysid.physics.model import Model

# Samples that are simulated at once while a manoeuvre that reacts goes on as foreseen: at first, at
# most, and at most while it only holds its commands.
_FIRST_AHEAD, _MOST_AHEAD, _MOST_HELD = 16, 256, 64


def closed_loop(model: Model, experiment: Experiment, noise: np.ndarray | None) -> np.ndarray:
    """Commands of manoeuvres that react to signals.

    Parameters
    ----------
    model : Model
    experiment : Experiment
    noise : ndarray (n_times, n_outputs) or None
        What is added to the outputs before a manoeuvre sees them.

    Returns
    -------
    ndarray (n_times, n_inputs)
    """
    controllers = experiment.excitation.controllers() if experiment.excitation else {}
    times, names = experiment.times, model.input_names
    values, runner = model.value_vector, kernel(model)
    own = start_array(model, experiment.initial)
    signals = _Signals(model, experiment, noise)
    constants = experiment.constants
    linear = any(channel.interpolation == "linear" for channel in model.inputs)

    # Before the first decision the commanded inputs are at rest.
    before = np.array([constants.get(name, 0.0) for name in names])
    z, _ = runner.start(own, before, values, times[0])
    window = runner.run(times[:2], np.stack([before, before]), values, z)
    inputs = np.empty((len(times), len(names)))
    held = _decide(controllers, names, constants, times[0], signals.at(0, window, 0))
    inputs[0] = held
    z, _ = runner.start(own, inputs[0], values, times[0])
    k, ahead = 1, _FIRST_AHEAD
    while k < len(times):
        # Ahead with the commands foreseen, as far as they last: most manoeuvres hold for seconds.
        n = min(ahead, len(times) - k)
        plan = _foreseen(controllers, names, constants, times[k : k + n])
        if plan is None:
            n = min(n, _MOST_HELD)
        commands = np.empty((n + 1, len(names)))
        commands[0] = inputs[k - 1]
        commands[1:] = inputs[k - 1] if plan is None else plan
        window = runner.run(times[k - 1 : k + n], commands, values, z)
        sees = window
        if (linear or not signals.of_states) and not np.all(commands == commands[0]):
            sees = _seen(runner, times[k - 1 : k + n], commands, values, window)
        sure = 0
        if plan is not None:
            seen = signals.between(k, sees, n)
            sure = min(n, *(c.undisturbed(times[k : k + n], seen) for c in controllers.values()))
            if 0 <= window.failed_at <= sure:
                sure = max(window.failed_at - 1, 0)
            for controller in controllers.values():
                controller.skip(times[k : k + sure])
            inputs[k : k + sure] = plan[:sure]
            k += sure
        row, moved = sure, False
        for row in range(sure + 1, n + 1):
            if 0 <= window.failed_at <= row:
                inputs[k:] = inputs[k - 1]
                return inputs  # simulate_inputs will fail at the same place, with words
            inputs[k] = _decide(controllers, names, constants, times[k], signals.at(k, sees, row))
            moved = not np.array_equal(inputs[k], commands[row])
            k += 1
            # Beyond it the window knows other commands than these.
            if moved or plan is not None:
                break
        z = window.states[row]
        if moved and linear:
            z = runner.run(
                times[k - 2 : k], inputs[k - 2 : k], values, window.states[row - 1]
            ).states[1]
        ahead = _FIRST_AHEAD if row < n or moved else min(2 * ahead, _MOST_AHEAD)
    return inputs


def _seen(
    runner: Kernel, times: np.ndarray, commands: np.ndarray, values: np.ndarray, window: Run
) -> Run:
    """What is measured at each sample of a window while the command before it still acts.

    Each sample is one step from the state of the one before. Steps that begin at even and at odd
    samples make two records of segments of two samples.
    """
    states, outputs = window.states.copy(), window.outputs.copy()
    for first in range(min(2, len(times) - 1)):
        starts = np.arange(first, len(times) - 1, 2)
        stop = starts[-1] + 2
        held = commands[first:stop].copy()
        held[1::2] = held[::2]
        part = runner.run(
            times[first:stop], held, values, window.states[starts], starts=starts - first
        )
        states[starts + 1], outputs[starts + 1] = part.states[1::2], part.outputs[1::2]
    return replace(window, states=states, outputs=outputs)


def _foreseen(
    controllers: Mapping[str, Controller],
    names: tuple[str, ...],
    constants: Mapping[str, float],
    times: np.ndarray,
) -> np.ndarray | None:
    """Commands ``(n_times, n_inputs)`` while nothing reacts; None if one cannot tell."""
    plan = np.empty((len(times), len(names)))
    for column, name in enumerate(names):
        if name not in controllers:
            plan[:, column] = constants[name]
            continue
        found = controllers[name].foreseen(times)
        if found is None:
            return None
        plan[:, column] = found
    return plan


def _decide(
    controllers: Mapping[str, Controller],
    names: tuple[str, ...],
    constants: Mapping[str, float],
    time: float,
    signals: Mapping[str, float],
) -> list[float]:
    """Commands of all inputs at one sample."""
    commands = command_all(controllers, float(time), signals)
    return [commands[name] if name in commands else constants[name] for name in names]


class _Signals:
    """What the manoeuvres see: the signals they react to, measured or true."""

    def __init__(self, model: Model, experiment: Experiment, noise: np.ndarray | None) -> None:
        states, outputs = state_names(model), model.output_names
        wanted = experiment.excitation.feedback if experiment.excitation else ()
        measured = experiment.feedback == "measured"
        self._noise = noise if measured else None
        self._outputs = {
            name: outputs.index(name)
            for name in wanted
            if name in outputs and (measured or name not in states)
        }
        self._states = {name: states.index(name) for name in wanted if name not in self._outputs}

    @property
    def of_states(self) -> bool:
        """Whether all are states, which a command of the same sample does not touch."""
        return not self._outputs

    def between(self, sample: int, window: Run, n: int) -> dict[str, np.ndarray]:
        """Signals ``(n,)`` from one sample on, found in the rows of a short run after the first."""
        seen = {name: window.states[1 : n + 1, i] for name, i in self._states.items()}
        for name, index in self._outputs.items():
            seen[name] = window.outputs[1 : n + 1, index]
            if self._noise is not None:
                seen[name] = seen[name] + self._noise[sample : sample + n, index]
        return seen

    def at(self, sample: int, window: Run, row: int) -> dict[str, float]:
        """Signals at one sample, found in one row of a short run."""
        seen = {name: float(window.states[row, i]) for name, i in self._states.items()}
        for name, index in self._outputs.items():
            seen[name] = float(window.outputs[row, index])
            if self._noise is not None:
                seen[name] += self._noise[sample, index]
        return seen
