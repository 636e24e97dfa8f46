"""Records of a diving-plane vehicle, simulated without the package."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from benchmarks import truth
from oed_sysid import Dataset, Record, load_problem

PROBLEM = load_problem("remus_diving_plane")
SUBSTEPS = 5

# Extra generalized forces (X, Z, M) as a function of u, w, q, theta, z, fin, thrust.
Extra = Callable[[float, float, float, float, float, float, float], tuple[float, float, float]]
# What a sensor makes of the true u, w, q, theta, z.
Sensors = Callable[[np.ndarray], np.ndarray]


def nothing(*_: float) -> tuple[float, float, float]:
    """No extra force."""
    return 0.0, 0.0, 0.0


def derivatives(rng: np.random.Generator) -> dict[str, float]:
    """Believed hydrodynamic derivatives, each off by some eight per cent."""
    model = PROBLEM.model
    return {
        name: model.values[name] * (1.0 + 0.08 * float(rng.standard_normal()))
        for name in model.free_names
    }


def rates(
    state: np.ndarray, _: int, fin: float, thrust: float, true: dict[str, float], extra: Extra
) -> np.ndarray:
    """Rates of u, w, q, theta, z."""
    push = extra(*state, fin, thrust)
    own = [true[name] for name in truth.NAMES]
    return np.array(truth.rates(state, (fin, thrust), own, math.sin, math.cos, push))


def simulate(
    name: str,
    seed: int,
    true: dict[str, float],
    extra: Extra = nothing,
    *,
    fin_of: Callable[[float], float] = lambda command: command,
    sensors: Sensors = lambda truth: truth,
    amplitude: float = 0.17,
    switch: float = 0.17,
    thrust: float = 9.0,
    duration: float = 60.0,
    noise: float = 1.0,
    boost: float = 1.25,
) -> Record:
    """Zigzag in pitch (with ``switch``) or random fin steps (without), by classical Runge-Kutta.

    After half the time the thrust is multiplied by ``boost``.
    """
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, duration, 0.1)
    state = np.array([math.sqrt(thrust / 3.9), 0.0, 0.0, 0.0, 10.0])
    state[:4] += 0.01 * rng.standard_normal(4)
    clean, inputs = np.empty((len(times), 5)), np.empty((len(times), 2))
    command, held = amplitude, 0
    for k, t in enumerate(times):
        if switch > 0:
            command = -amplitude if state[3] < -switch else command
            command = amplitude if state[3] > switch else command
        elif held == 0:
            command = amplitude * rng.uniform(-1.0, 1.0) + 0.4 * (0.6 * state[3] + state[2])
            held = int(rng.integers(10, 40))
        held -= 1
        sent = command if t >= 2.0 else 0.0
        push = thrust * (1.0 if t < duration / 2 else boost)
        clean[k], inputs[k] = state, (sent, push)
        fin, step = fin_of(sent), 0.1 / SUBSTEPS
        for _ in range(SUBSTEPS):
            state = truth.runge_kutta(rates, state, step, fin, push, true, extra)
    outputs = sensors(clean) + noise * truth.NOISE * rng.standard_normal(clean.shape)
    return Record(name, times, inputs, outputs, PROBLEM.channels)


def records(seed: int, extra: Extra = nothing, **options) -> tuple[Dataset, Dataset, dict]:  # type: ignore[no-untyped-def, type-arg]
    """Two training records, a validation one and the true derivatives."""
    true = derivatives(np.random.default_rng(seed))
    train = Dataset(
        (
            simulate("zigzag", 10 * seed + 1, true, extra, **options),
            simulate("steps", 10 * seed + 2, true, extra, switch=0.0, amplitude=0.15, **options),
        )
    )
    test = Dataset(
        (
            simulate(
                "judge", 10 * seed + 3, true, extra, amplitude=0.22, switch=0.2, thrust=8.0,
                **options,
            ),
        )
    )  # fmt: skip
    return train, test, true
