"""Records of a diving-plane vehicle, simulated without the package."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from oed_sysid import Dataset, Record, load_problem

PROBLEM = load_problem("remus_diving_plane")
NOISE = np.array([0.02, 0.02, 0.004, 0.004, 0.03])
MASS, INERTIA = 30.48, 3.45
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
    state: np.ndarray, fin: float, thrust: float, true: dict[str, float], extra: Extra
) -> np.ndarray:
    """Rates of u, w, q, theta, z."""
    u, w, q, theta, z = state
    x, heave, pitch = extra(u, w, q, theta, z, fin, thrust)
    x += true["X_uu"] * u * abs(u) + thrust - MASS * q * w
    heave += MASS * u * q + true["Z_uw"] * u * w + true["Z_uq"] * u * q
    heave += true["Z_uuds"] * u * u * fin
    pitch += true["M_uw"] * u * w + true["M_uq"] * u * q + true["M_uuds"] * u * u * fin
    pitch -= true["zgW"] * math.sin(theta)
    # (m - Z_wdot) w' - Z_qdot q' = Z,  -M_wdot w' + (I - M_qdot) q' = M
    a, b, d = MASS + 35.5, 1.93, INERTIA + 4.88
    det = a * d - b * b
    return np.array(
        [
            x / (MASS + 0.93),
            (d * heave - b * pitch) / det,
            (a * pitch - b * heave) / det,
            q,
            -u * math.sin(theta) + w * math.cos(theta),
        ]
    )


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
    truth, inputs = np.empty((len(times), 5)), np.empty((len(times), 2))
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
        truth[k], inputs[k] = state, (sent, push)
        fin, step = fin_of(sent), 0.1 / SUBSTEPS
        for _ in range(SUBSTEPS):
            k1 = rates(state, fin, push, true, extra)
            k2 = rates(state + step / 2 * k1, fin, push, true, extra)
            k3 = rates(state + step / 2 * k2, fin, push, true, extra)
            k4 = rates(state + step * k3, fin, push, true, extra)
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    outputs = sensors(truth) + noise * NOISE * rng.standard_normal(truth.shape)
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
