"""A ship that is steered and disturbed, written out by hand, and its model without what acts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from motion import small

from oed_sysid import Dataset, Parameter, Record

VALUES = [
    Parameter("K", 0.3, "1/s", prior_std=0.1),
    Parameter("T", 3.0, "s", lower=0.1, prior_std=1.0),
]
SIGNALS, LAW = "r [rad/s], psi [rad] <- delta [rad]", {"r": "(K*delta - r)/T", "psi": "r"}
LEVELS = {"psi": 0.002, "r": 0.002}
YAW = small("yaw", SIGNALS, LAW, VALUES, LEVELS, scales={"r": 0.1}, step=0.2)
STEP, LEVEL, TIME, NOISE = 0.2, 0.02, 4.0, 0.002
FADES = np.exp(-STEP / TIME)
# Share of a law in what accelerates the vehicle, at a motion and a command that lags by five
# seconds.
Share = Callable[[float, float, float], float]


# Period of a sea, s, and the width of its spectrum.
PERIOD, WIDTH = 6.0, 0.3


def sailed(
    seed: int,
    answer: float,
    law: Share,
    *,
    drift: Share | None = None,
    level: float = LEVEL,
    shape: str = "",
) -> Record:
    """A ship that a helmsman may steer, disturbed; written out by Euler's method in tenths.

    By a force of first order, or by a sea of a ``shape``: a resonator's velocity or displacement.
    """
    rng = np.random.default_rng(seed)
    times = STEP * np.arange(400)
    orders = np.repeat(rng.choice([-0.3, 0.0, 0.3], 20), 20)
    r = psi = force = lagged = slow = 0.0
    rate = 2.0 * np.pi / PERIOD
    along, across = rng.standard_normal(2)
    rows = []
    for order in orders:
        delta = order - answer * psi
        if drift is not None:
            slow = drift(r, psi, lagged)
        rows.append((delta, psi, r + slow))
        for _ in range(10):
            if shape:
                kick = np.sqrt(2.0 * WIDTH * rate * 0.02) * rng.standard_normal()
                across += 0.02 * rate * (-along - WIDTH * across) + kick
                along += 0.02 * rate * across
                force = level * (across if shape == "velocity" else along)
            push = force + law(r, psi, lagged)
            r, psi = r + 0.02 * ((0.3 * delta - r) / 3.0 + push), psi + 0.02 * r
            lagged += 0.02 / 5.0 * (delta - lagged)
        if not shape:
            force = FADES * force + level * np.sqrt(1 - FADES**2) * rng.standard_normal()
    inputs, outputs = np.array(rows)[:, :1], np.array(rows)[:, 1:]
    noisy = outputs + NOISE * rng.standard_normal(outputs.shape)
    return Record(f"run {seed}", times, inputs, noisy, YAW.channels)


def nothing(r: float, psi: float, lagged: float) -> float:
    """No law at all."""
    return 0.0


def two(seed: int, law: Share = nothing) -> Dataset:
    """Two records under a true disturbance."""
    return Dataset(sailed(2 * seed + k, 0.0, law) for k in (0, 1))
