"""A ship that turns, its candidates, and records of it integrated without the package."""

from __future__ import annotations

from functools import cache

import numpy as np

from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Force, Input, Model, Output, Parameter, Record, State, improve
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.physics import Effect, Sensor, actuator_lag, actuator_offset, sensor_bias

NOISE = np.array([0.01, 0.004])
SAMPLE = 0.2
GAIN, TIME = 0.5, 4.0
CUBIC = Force("cubic_damping", {"r": "n3*r**3"}, (Parameter("n3", 0.0, "s/rad^2", scale=1.0),))
CANDIDATES: tuple[Effect, ...] = (
    CUBIC,
    actuator_offset("rudder_offset", "delta", scale=0.05),
    actuator_lag("rudder_lag", "delta", scale=0.5),
    sensor_bias("bias_r", "r", "rad/s", scale=0.01),
)
GYRO_BIAS = Sensor(
    "bias", {"r": "r + b_r"}, (Parameter("b_r", 0.0, "rad/s", per_record=True, scale=0.01),)
)
SHIP = Model(
    "turning ship",
    states=(State("psi", "rad", "heading"), State("r", "rad/s", "yaw rate", scale=0.1)),
    inputs=(Input("rudder", "rad", "rudder"),),
    outputs=(
        Output("psi", "rad", "heading", noise_std=NOISE[0]),
        Output("r", "rad/s", "yaw rate", noise_std=NOISE[1]),
    ),
    kinematics={"psi": "r", "r": "(K*delta - r)/T"},
    actuators={"delta": "rudder"},
    parameters=(Parameter("K", 0.45, "1/s"), Parameter("T", 3.5, "s", lower=0.1)),
    step=SAMPLE,
)


def rates(state: np.ndarray, rudder: float, cubic: float) -> np.ndarray:
    """Time derivative of heading and yaw rate."""
    return np.array([state[1], (GAIN * rudder - state[1]) / TIME + cubic * state[1] ** 3])


def record(name: str, rng: np.random.Generator, cubic: float = 0.0, **noise: float) -> Record:
    """A zigzag by the clock, with sensor noise and a random yaw acceleration.

    ``colour`` is the correlation of sensor noise from sample to sample; ``force`` the
    standard deviation of the acceleration, correlated over one second; ``amplitude`` of the rudder.
    """
    t = np.arange(0.0, 60.0, SAMPLE)
    swing = noise.get("amplitude", 0.5)
    rudder = swing * np.sign(np.sin(2 * np.pi * t / rng.uniform(14.0, 20.0))) * (t > 3)
    outputs, state = np.empty((len(t), 2)), np.zeros(2)
    force, memory = 0.0, np.exp(-SAMPLE)
    for k, angle in enumerate(rudder):
        outputs[k] = state
        push = np.array([0.0, force])
        for _ in range(5):
            h = SAMPLE / 5
            first = rates(state, angle, cubic) + push
            middle = rates(state + h / 2 * first, angle, cubic) + push
            state = state + h * middle
        drive = noise.get("force", 0.0) * np.sqrt(1 - memory**2)
        force = memory * force + drive * rng.standard_normal()
    outputs += NOISE * gauss_markov(rng.standard_normal(outputs.shape), noise.get("colour", 0.0))
    return Record(name, t, rudder[:, None], outputs, SHIP.channels)


def dataset(seed: int, cubic: float = 0.0, n_records: int = 2, **noise: float) -> Dataset:
    """Records of one ship."""
    rng = np.random.default_rng(seed)
    return Dataset(record(f"zigzag_{i}", rng, cubic, **noise) for i in range(n_records))


@cache
def improved() -> Improvement:
    """A ship whose cubic damping is hidden, once for all tests that look at it."""
    return improve(SHIP, dataset(11, -15.0), dataset(12, -15.0), candidates=CANDIDATES)
