"""A boat that changes its speed in a zigzag, written out by hand, and its model with priors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from motion import small

from oed_sysid import Dataset, Parameter, Record

TRUE = {"Y_u": -0.4, "Y_r": -0.3, "Y_d": -0.09, "N_v": -0.03, "N_r": -0.11, "N_d": 0.016}
NOISE = np.array([0.02, 0.02, 0.002])
BOAT = small(
    "boat",
    "u [m/s], v [m/s], r [rad/s] <- rudder [rad], power [m/s]",
    {
        "u": "(power - u)/8",
        "v": "Y_u*v*u/4 + Y_r*u*r + Y_d*u**2*rudder/6",
        "r": "N_v*u*v + N_r*u*r + N_d*u**2*rudder/6",
    },
    (
        Parameter(name, value, prior_mean=value, prior_std=0.2 * abs(value))
        for name, value in TRUE.items()
    ),
    scales={"v": 0.5, "r": 0.05},
    step=0.2,
)
# What is written in place of the rudder angles that act.
Written = Callable[[np.ndarray], np.ndarray]


def sailed(seed: int, written: Written, angle: float) -> Record:
    """A zigzag by heading of 120 s at 6 m/s, then 4.5 m/s; by Euler's method in fiftieths."""
    rng, h = np.random.default_rng(seed), 0.02
    values = {name: value * (1.0 + 0.1 * rng.standard_normal()) for name, value in TRUE.items()}
    x, psi, rudder, goal, rows = np.array([6.0, 0.0, 0.0]), 0.0, 0.0, angle, []
    for k in range(6001):
        u, v, r = x
        power = 6.0 if k < 3000 else 4.5
        goal = -np.sign(psi) * angle if abs(psi) > angle else goal
        if k % 10 == 0:
            rudder += np.clip(goal - rudder, -0.02, 0.02)
            rows.append((0.1 * k / 5.0, rudder, power, *x))
        x = x + h * np.array([
            (power - u) / 8.0,
            values["Y_u"] * v * u / 4.0 + values["Y_r"] * u * r + values["Y_d"] * u**2 * rudder / 6,
            values["N_v"] * u * v + values["N_r"] * u * r + values["N_d"] * u**2 * rudder / 6,
        ])  # fmt: skip
        psi += h * r
    times, rudder, power, *states = np.array(rows).T
    inputs = np.column_stack([written(rudder), power])
    outputs = np.column_stack(states) + NOISE * rng.standard_normal((times.size, 3))
    return Record(f"zigzag_{seed}_{angle:g}", times, inputs, outputs, BOAT.channels)


def sailings(seed: int, written: Written = lambda angle: angle) -> Dataset:
    """Zigzags of 10 and 20 degrees."""
    return Dataset(sailed(seed, written, angle) for angle in (0.175, 0.35))
