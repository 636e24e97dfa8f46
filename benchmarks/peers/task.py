"""The task that every peer solves, written without this project's own model.

Fit eight derivatives and five initial states of the diving plane of a
REMUS-like vehicle to one record of 2,400 samples of five outputs, by least
squares weighted with the noise, from derivatives that are too small. Commands are
held between samples, one Runge-Kutta step of fourth order per sample.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

NAMES = ("X_uu", "Z_uw", "Z_uq", "M_uw", "M_uq", "Z_uuds", "M_uuds", "zgW")
TRUE = np.array([-3.9, -40.0, -9.0, 14.0, -9.0, -12.0, -6.15, 5.9])
NOISE = np.array([0.02, 0.02, 0.004, 0.004, 0.03])
STEP = 0.1
# Mass, pitch inertia and added masses, as in the problem remus_diving_plane.
M, I_YY = 30.48, 3.45
X_UDOT, Z_WDOT, Z_QDOT, M_WDOT, M_QDOT = -0.93, -35.5, -1.93, -1.93, -4.88
A, B, C, D = M - Z_WDOT, -Z_QDOT, -M_WDOT, I_YY - M_QDOT
DETERMINANT = A * D - B * C


def rates(x: Any, command: Any, p: Any, sin: Any, cos: Any) -> list[Any]:
    """Rates of u, w, q, theta, z; forward speed is positive, so u|u| is u^2."""
    u, w, q, theta = x[0], x[1], x[2], x[3]
    fin, thrust = command[0], command[1]
    surge = thrust + p[0] * u * u - M * q * w
    heave = M * u * q + p[1] * u * w + p[2] * u * q + p[5] * u * u * fin
    pitch = p[3] * u * w + p[4] * u * q + p[6] * u * u * fin - p[7] * sin(theta)
    return [
        surge / (M - X_UDOT),
        (D * heave - B * pitch) / DETERMINANT,
        (A * pitch - C * heave) / DETERMINANT,
        q,
        -u * sin(theta) + w * cos(theta),
    ]


def load() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times ``(n,)``, commands ``(n, 2)`` and measured outputs ``(n, 5)``."""
    with np.load(sys.argv[-1]) as file:
        return file["times"], file["inputs"], file["outputs"]


def share() -> float:
    """Start values as a share of the true ones."""
    with np.load(sys.argv[-1]) as file:
        return float(file["share"])


def begin(outputs: np.ndarray) -> np.ndarray:
    """Unknowns at the start: wrong derivatives, then the first measurement."""
    return np.concatenate([share() * TRUE, outputs[0]])


def used() -> float:
    """Processor time of this process and of the programs it has called, s."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def report(solve: Callable[[], np.ndarray], build: float = 0.0, repeats: int = 1) -> None:
    """Time a solution and print it with its estimates as JSON."""
    taken = []
    for _ in range(repeats):
        began = used()
        found = solve()
        taken.append(used() - began)
    result = {"seconds": min(taken), "build": build, "estimates": np.asarray(found).tolist()}
    print(json.dumps(result))
