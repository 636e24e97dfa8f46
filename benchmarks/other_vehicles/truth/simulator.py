r"""Simulation of a true vehicle: several records at once, in plain NumPy.

.. math::

    \dot x = f(x, d(u), w; p, h), \qquad y = s(x; p, h) + e

with commands :math:`u` held over a sample, actual deflections :math:`d`, random
forces :math:`w` (first-order Gauss-Markov, held over a sample), parameters
:math:`p` and the sizes :math:`h` of what is hidden. A state array is
``(n_states, n_columns)``; a column is a record, or one sample of one where
:mod:`benchmarks.other_vehicles.truth.detect` asks for single steps.

Some effects are the same for every vehicle and are applied here, by keys such
as ``"lag:rudder"``: ``deadband``, ``backlash``, ``offset``, ``zero`` (one per record) and ``lag``
of an input; ``sensor_lag``, ``scale`` and ``bias`` of an output.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.tables import tables
from benchmarks.truth import gauss_markov, runge_kutta

Pilot = Callable[[float, np.ndarray], float]
Signal = Callable[[], Pilot]  # a fresh pilot for every run


def steps(levels: Sequence[tuple[float, float]]) -> Signal:
    """Levels ``(from time, value)``, held; zero before the first.

    >>> pilot = steps([(0.0, 1.0), (5.0, 2.0)])()
    >>> pilot(4.9, None), pilot(5.0, None)
    (1.0, 2.0)
    """

    def pilot(time: float, _: np.ndarray) -> float:
        return next((v for t, v in reversed(levels) if time >= t - 1e-9), 0.0)

    return lambda: pilot


def constant(value: float) -> Signal:
    """One value."""
    return steps([(0.0, value)])


def zigzag(amplitude: float, switch: float, state: int, *, begin: float) -> Signal:
    """Relay: reverses when ``state`` has moved by ``switch`` in the direction of the command.

    ``amplitude`` below zero where a positive command turns the state the other way.
    """

    def fresh() -> Pilot:
        side, first = [1.0], [math.nan]

        def pilot(time: float, x: np.ndarray) -> float:
            if math.isnan(first[0]):
                first[0] = float(x[state])
            if time < begin - 1e-9:
                return 0.0
            if side[0] * (x[state] - first[0]) > switch:
                side[0] = -side[0]
            return side[0] * amplitude

        return pilot

    return fresh


def multisine(
    amplitude: float, periods: Sequence[float], *, seed: int, base: float = 0.0
) -> Signal:
    """Sum of sines of equal size with random phases."""
    phases = np.random.default_rng(seed).uniform(0, 2 * math.pi, len(periods))

    def pilot(time: float, _: np.ndarray) -> float:
        waves = zip(periods, phases, strict=True)
        return base + amplitude * sum(math.sin(2 * math.pi * time / t + a) for t, a in waves)

    return lambda: pilot


def around(base: Signal, change: Signal, side: float) -> Signal:
    """A signal, and a part of it that acts to one side."""

    def fresh() -> Pilot:
        common, turning = base(), change()
        return lambda time, x: common(time, x) + side * turning(time, x)

    return fresh


Sizes = Mapping[str, "float | np.ndarray"]
Rate = Callable[[np.ndarray, np.ndarray, Sizes, Sizes, np.ndarray], np.ndarray]
Measure = Callable[[np.ndarray, Sizes, Sizes], np.ndarray]
Settle = Callable[[np.ndarray, np.ndarray, np.ndarray, Sizes, Sizes, np.ndarray], np.ndarray]
Derivative = Callable[..., np.ndarray]


@dataclass(frozen=True)
class Manoeuvre:
    """One run: where it starts, and a signal per input."""

    name: str
    start: Mapping[str, float]
    commands: Mapping[str, Signal]


@dataclass(frozen=True)
class Hidden:
    """Something that a nominal model may lack.

    Attributes
    ----------
    sizes : dict
        Typical size of each key of the simulator.
    sign : int
        Sign that physics prescribes, 0 for either.
    per_record : bool
        Whether the size differs from record to record.
    lacking : bool
        The sizes are parameters of the true vehicle that the nominal model of
        such a case does without.
    same_as : tuple of str
        Candidates that are the same model in other words; naming one is right.
    """

    sizes: Mapping[str, float]
    sign: int = 0
    per_record: bool = False
    lacking: bool = False
    same_as: tuple[str, ...] = ()


@dataclass(frozen=True)
class Vehicle:
    """A true vehicle and its trials.

    Attributes
    ----------
    rate, measure : callable
        Right-hand side ``(state, deflections, parameters, hidden, forces)`` and
        outputs ``(state, parameters, hidden)``; arrays have a column per record.
    free, fixed : dict
        Parameters: those that a nominal model estimates, and those it knows.
    sample, duration, substep : float
        In s.
    noise : dict
        Standard deviation of each output.
    forces : dict
        Standard deviation of the disturbance force on each axis, by name.
    force_time : float
        Its correlation time, s.
    logged : str
        Input whose log is noisy where a case asks for it, with that noise.
    settle : callable, optional
        Applied after every substep (what a jump needs).
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    noise: Mapping[str, float]
    rate: Rate
    measure: Measure
    free: Mapping[str, float]
    fixed: Mapping[str, float]
    sample: float
    duration: float
    substep: float
    forces: Mapping[str, float]
    force_time: float
    logged: tuple[str, float]
    hidden: Mapping[str, Hidden]
    train: tuple[Manoeuvre, ...]
    validation: tuple[Manoeuvre, ...]
    settle: Settle | None = None

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the measured signals."""
        return tuple(self.noise)

    @property
    def times(self) -> np.ndarray:
        """Times of all samples, s."""
        return np.arange(round(self.duration / self.sample) + 1) * self.sample

    @property
    def parameters(self) -> dict[str, float]:
        """All parameters."""
        return {**self.fixed, **self.free}


def vehicle(name: str, rate: Rate, measure: Measure, settle: Settle | None = None) -> Vehicle:
    """The vehicle whose numbers, hidden effects and trials stand in ``name.toml``."""
    data = tables(__file__, name)
    hidden = {key: Hidden(**_frozen(row)) for key, row in data.pop("hidden").items()}
    trials = {
        part: tuple(_manoeuvre(row, data["states"], data["inputs"]) for row in data.pop(part))
        for part in ("train", "validation")
    }
    noise = {key: _number(level) for key, level in data.pop("noise").items()}
    return Vehicle(
        name, rate=rate, measure=measure, settle=settle, hidden=hidden, noise=noise, **trials,
        **{"fixed": {}, **_frozen(data)},
    )  # fmt: skip


def _frozen(row: Mapping[str, Any]) -> dict[str, Any]:
    """A row of data, its lists as tuples."""
    return {
        k: tuple(map(_number, v)) if isinstance(v, list) else _number(v) for k, v in row.items()
    }


def _number(value: Any) -> Any:
    """A value as it is, or degrees as ``"5 deg"`` in rad."""
    is_angle = isinstance(value, str) and value.endswith(" deg")
    return float(value.removesuffix(" deg")) * math.radians(1.0) if is_angle else value


def _manoeuvre(row: dict[str, Any], states: list[str], inputs: list[str]) -> Manoeuvre:
    """A manoeuvre from data: a signal for each input, or what ``both`` have and sets ``apart``."""
    if "both" in row:
        both, apart = (_signal(row[part], states) for part in ("both", "apart"))
        pairs = zip(inputs, (1.0, -1.0), strict=True)
        commands = {name: around(both, apart, side) for name, side in pairs}
    else:
        commands = {name: _signal(said, states) for name, said in row["commands"].items()}
    return Manoeuvre(row["name"], row["start"], commands)


def _signal(said: Any, states: list[str]) -> Signal:
    """A constant, or a signal by its kind and its options."""
    if not isinstance(said, dict):
        return constant(_number(said))
    ((kind, options),) = said.items()
    if kind == "steps":
        return steps([(time, _number(value)) for time, value in options])
    settings = _frozen(options)
    if kind == "zigzag":
        return zigzag(**settings | {"state": states.index(settings["state"])})
    return multisine(**settings)


@dataclass(frozen=True, eq=False)
class Runs:
    """Simulated manoeuvres, arrays ``(n_records, n_times, n)``.

    Attributes
    ----------
    names : tuple of str
    times : ndarray (n_times,)
    commands : ndarray
        What was commanded.
    effective : ndarray
        What the actuators' lags were fed with: commands after dead band, play, offset.
    states : ndarray
        Vehicle, then actual deflections, then lagged sensors.
    forces : ndarray
    clean, outputs : ndarray
        Without and with sensor noise.
    logged : ndarray
        Inputs as a log has them.
    """

    names: tuple[str, ...]
    times: np.ndarray
    commands: np.ndarray
    effective: np.ndarray
    states: np.ndarray
    forces: np.ndarray
    clean: np.ndarray
    outputs: np.ndarray
    logged: np.ndarray


@dataclass(frozen=True, eq=False)
class Plant:
    """A vehicle with everything that acts on it between two samples."""

    vehicle: Vehicle
    parameters: Sizes
    hidden: Sizes = field(default_factory=dict)

    def of(self, key: str) -> float | np.ndarray:
        """Size of a hidden effect, zero where it is absent."""
        return self.hidden.get(key, 0.0)

    def start(self, state: np.ndarray, effective: np.ndarray) -> np.ndarray:
        """Full state of a vehicle at rest in its actuators and sensors."""
        seen = self.vehicle.measure(state, self.parameters, self.hidden)
        return np.concatenate([state, effective, seen])

    def deflections(self, full: np.ndarray, effective: np.ndarray) -> np.ndarray:
        """What acts: the lagged value where an input has a lag."""
        n = len(self.vehicle.states)
        lagged = full[n : n + len(effective)]
        return np.stack(
            [
                np.where(np.greater(self.of(f"lag:{name}"), 0.0), lagged[i], effective[i])
                for i, name in enumerate(self.vehicle.inputs)
            ]
        )

    def derivative(self, effective: np.ndarray, forces: np.ndarray) -> Derivative:
        """Right-hand side of the full state for held commands and forces, alike at all stages."""
        vehicle, n = self.vehicle, len(self.vehicle.states)
        n_inputs = len(vehicle.inputs)
        lags = [self.of(f"lag:{name}") for name in vehicle.inputs]
        late = [self.of(f"sensor_lag:{name}") for name in vehicle.outputs]
        moving = [i for i, lag in enumerate(lags) if np.any(lag)]
        filtered = [i for i, lag in enumerate(late) if np.any(lag)]

        def rate(full: np.ndarray, _: int = 0) -> np.ndarray:
            done = np.zeros_like(full)
            acting = self.deflections(full, effective) if moving else effective
            done[:n] = vehicle.rate(full[:n], acting, self.parameters, self.hidden, forces)
            for i in moving:
                done[n + i] = (effective[i] - full[n + i]) / lags[i]
            if filtered:
                seen = vehicle.measure(full[:n], self.parameters, self.hidden)
                for i in filtered:
                    row = n + n_inputs + i
                    done[row] = (seen[i] - full[row]) / late[i]
            return done

        return rate

    def advance(self, full: np.ndarray, effective: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Full state one sample later."""
        vehicle = self.vehicle
        rate = self.derivative(effective, forces)
        count = round(vehicle.sample / vehicle.substep)
        n = len(vehicle.states)
        for _ in range(count):
            after = runge_kutta(rate, full, vehicle.sample / count)
            if vehicle.settle is not None:
                acting = self.deflections(after, effective)
                after[:n] = vehicle.settle(
                    full[:n], after[:n], acting, self.parameters, self.hidden, forces
                )
            full = after
        return full

    def measure(self, full: np.ndarray) -> np.ndarray:
        """Outputs without noise."""
        vehicle, n = self.vehicle, len(self.vehicle.states)
        seen = vehicle.measure(full[:n], self.parameters, self.hidden)
        lagged = full[n + len(vehicle.inputs) :]
        rows = []
        for i, name in enumerate(vehicle.outputs):
            late = np.greater(self.of(f"sensor_lag:{name}"), 0.0)
            value = np.where(late, lagged[i], seen[i])
            rows.append(value * (1 + self.of(f"scale:{name}")) + self.of(f"bias:{name}"))
        return np.stack(rows)

    def effective(self, command: np.ndarray, play: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Commands after dead band, play and offset; and the play's new position."""
        rows, held = [], []
        for i, name in enumerate(self.vehicle.inputs):
            value = command[i]
            dead = self.of(f"deadband:{name}")
            value = np.sign(value) * np.maximum(np.abs(value) - dead, 0.0)
            half = self.of(f"backlash:{name}")
            value = np.clip(play[i], value - half, value + half)
            held.append(value)
            rows.append(value + self.of(f"offset:{name}") + self.of(f"zero:{name}"))
        return np.stack(rows), np.stack(held)


def simulate(
    vehicle: Vehicle,
    hidden: Sizes,
    *,
    rng: np.random.Generator,
    waves: float = 0.0,
    input_noise: float = 0.0,
    parameters: Sizes | None = None,
    manoeuvres: Sequence[Manoeuvre] | None = None,
) -> Runs:
    """Simulate all manoeuvres of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
    hidden : mapping
        Sizes of what is hidden; arrays have an entry per manoeuvre.
    rng : numpy.random.Generator
        Draws forces and noise.
    waves : float
        Size of the disturbance forces, in those that the vehicle states.
    input_noise : float
        Noise of the logged input, in that of ``vehicle.logged``.
    parameters : mapping, optional
        By default the vehicle's own.
    manoeuvres : sequence of Manoeuvre, optional
        By default the training ones, then those of validation.
    """
    runs = tuple(manoeuvres or (*vehicle.train, *vehicle.validation))
    n_records, times = len(runs), vehicle.times
    plant = Plant(vehicle, parameters or vehicle.parameters, hidden)
    memory = float(np.exp(-vehicle.sample / vehicle.force_time))
    levels = waves * np.array(list(vehicle.forces.values()))
    shape = (n_records, len(times), len(levels))
    forces = levels * gauss_markov(rng.standard_normal(shape), memory, axis=1)
    state = np.array([[run.start.get(name, 0.0) for run in runs] for name in vehicle.states])
    pilots = [[run.commands[name]() for run in runs] for name in vehicle.inputs]

    def command(time: float) -> np.ndarray:
        return np.array(
            [[pilot(time, state[:, r]) for r, pilot in enumerate(row)] for row in pilots]
        )

    commands, effective, states, clean = [], [], [], []
    n = len(vehicle.states)
    full = play = np.empty(0)
    for k, time in enumerate(times):
        wanted = command(float(time))
        reached, play = plant.effective(wanted, wanted if k == 0 else play)
        if k == 0:
            full = plant.start(state, reached)
        commands.append(wanted.T)
        effective.append(reached.T)
        states.append(full.T)
        clean.append(plant.measure(full).T)
        if k + 1 < len(times):
            full = plant.advance(full, reached, forces[:, k].T)
            state = full[:n]
    noise = np.array([vehicle.noise[name] for name in vehicle.outputs])
    seen = np.stack(clean, 1)
    sent = np.stack(commands, 1)
    logged = sent.copy()
    channel, size = vehicle.logged
    error = rng.standard_normal(sent.shape[:2])
    logged[:, :, vehicle.inputs.index(channel)] += input_noise * size * error
    return Runs(
        tuple(run.name for run in runs),
        times,
        sent,
        np.stack(effective, 1),
        np.stack(states, 1),
        forces,
        seen,
        seen + noise * rng.standard_normal(seen.shape),
        logged,
    )
