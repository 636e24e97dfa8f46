"""The same equations compiled by numba, for peers that want a simulator."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from benchmarks.peers.task import NOISE, STEP, rates

_rates = njit(rates)


@njit
def simulate(inputs: np.ndarray, p: np.ndarray, x0: np.ndarray) -> np.ndarray:
    n = len(inputs)
    path = np.empty((n, 5))
    x = x0.copy()
    k = np.empty((4, 5))
    for i in range(n):
        path[i] = x
        for stage in range(4):
            h = 0.0 if stage == 0 else (STEP if stage == 3 else STEP / 2)
            y = x + h * k[stage - 1] if stage else x
            found = _fast(y, inputs[i], p)
            for j in range(5):
                k[stage, j] = found[j]
        x = x + STEP / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
    return path


@njit
def _fast(x: np.ndarray, command: np.ndarray, p: np.ndarray) -> list[float]:
    return _rates(x, command, p, math.sin, math.cos)


def residuals(unknowns: np.ndarray, inputs: np.ndarray, outputs: np.ndarray) -> np.ndarray:
    """Weighted residuals ``(n * 5,)``; large where the model diverges."""
    path = simulate(inputs, unknowns[:8], unknowns[8:])
    scaled = (path - outputs) / NOISE
    return np.nan_to_num(scaled, nan=1e6, posinf=1e6, neginf=-1e6).ravel()
