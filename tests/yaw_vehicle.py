"""A ship's nonlinear yaw motion, as a model and as an independent hand-written simulator."""

from __future__ import annotations

import numpy as np
from motion import small

from benchmarks.truth import runge_kutta
from oed_sysid import Dataset, Model, Parameter, Record

TRUE = {"K": 0.12, "T": 8.0, "alpha": 12.0}
NOISE = np.array([0.004, 0.0015])


def yaw_model(**changes: Parameter) -> Model:
    """Norrbin's model ``T r' + r + alpha r^3 = K delta`` with heading and rate measured."""
    parameters = {
        "K": Parameter("K", TRUE["K"], "1/s"),
        "T": Parameter("T", TRUE["T"], "s", lower=0.5),
        "alpha": Parameter("alpha", TRUE["alpha"], "s^2"),
    } | changes
    return small(
        "yaw",
        "psi [rad], r [rad/s] <- delta [rad]",
        {"psi": "r", "r": "(K*delta - r - alpha*r**3)/T"},
        parameters.values(),
        scales={"r": 0.05},
        step=0.5,
    )


def simulate_yaw(
    times: np.ndarray, delta: np.ndarray, start: np.ndarray, values: dict[str, float]
) -> np.ndarray:
    """Heading and rate by a Runge-Kutta method without the package, ``(n_times, 2)``."""

    def rate(state: np.ndarray, _: int, rudder: float) -> np.ndarray:
        r = state[1]
        return np.array([r, (values["K"] * rudder - r - values["alpha"] * r**3) / values["T"]])

    states = np.empty((len(times), 2))
    states[0] = start
    for k in range(len(times) - 1):
        n = max(1, int(np.ceil((times[k + 1] - times[k]) / 0.5 - 1e-9)))
        h = (times[k + 1] - times[k]) / n
        x = states[k]
        for _ in range(n):
            x = runge_kutta(rate, x, h, delta[k])
        states[k + 1] = x
    return states


def yaw_record(
    name: str,
    rng: np.random.Generator,
    *,
    n: int = 200,
    step: float = 0.5,
    period: float = 30.0,
    start: tuple[float, float] = (0.1, 0.01),
    irregular: bool = False,
    noise: np.ndarray = NOISE,
    values: dict[str, float] | None = None,
) -> Record:
    """A noisy record of the truth, rudder switching between two angles."""
    times = np.arange(n) * step
    if irregular:
        times = np.cumsum(rng.uniform(0.3, 1.7, n)) * step
    delta = 0.3 * np.sign(np.sin(2 * np.pi * times / period)) + 0.05
    clean = simulate_yaw(times, delta, np.array(start), TRUE | (values or {}))
    outputs = clean + noise * rng.standard_normal(clean.shape)
    return Record(name, times, delta[:, None], outputs, yaw_model().channels)


def yaw_data(seed: int = 0, **options: object) -> Dataset:
    """Three records of different lengths and manoeuvres."""
    rng = np.random.default_rng(seed)
    return Dataset(
        (
            yaw_record("a", rng, n=200, **options),
            yaw_record("b", rng, n=120, period=18.0, start=(0.0, 0.0), **options),
            yaw_record("c", rng, n=61, period=45.0, start=(-0.2, -0.02), **options),
        )
    )
