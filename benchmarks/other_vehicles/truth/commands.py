"""What is commanded in a run: signals of time and of the vehicle's own state."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

Pilot = Callable[[float, np.ndarray], float]
Signal = Callable[[], Pilot]  # a fresh pilot for every run


def steps(levels: Sequence[tuple[float, float]]) -> Signal:
    """Levels ``(from time, value)``, held; zero before the first.

    >>> pilot = steps([(0.0, 1.0), (5.0, 2.0)])()
    >>> pilot(4.9, None), pilot(5.0, None)
    (1.0, 2.0)
    """

    def fresh() -> Pilot:
        return lambda time, _: next((v for t, v in reversed(levels) if time >= t - 1e-9), 0.0)

    return fresh


def constant(value: float) -> Signal:
    """One value."""
    return steps([(0.0, value)])


def zigzag(
    amplitude: float, switch: float, state: int, *, begin: float = 5.0, base: float = 0.0
) -> Signal:
    """Relay: reverses when ``state`` has moved by ``switch`` in the direction of the command.

    ``amplitude`` below zero where a positive command turns the state the other way.
    """

    def fresh() -> Pilot:
        side = [1.0]

        def pilot(time: float, x: np.ndarray) -> float:
            if time < begin - 1e-9:
                return base
            if side[0] * x[state] > switch:
                side[0] = -side[0]
            return base + side[0] * amplitude

        return pilot

    return fresh


def multisine(
    amplitude: float, periods: Sequence[float], *, seed: int, base: float = 0.0
) -> Signal:
    """Sum of sines of equal size with random phases."""
    phases = np.random.default_rng(seed).uniform(0, 2 * math.pi, len(periods))

    def fresh() -> Pilot:
        return lambda time, _: (
            base
            + amplitude
            * sum(
                math.sin(2 * math.pi * time / period + phase)
                for period, phase in zip(periods, phases, strict=True)
            )
        )

    return fresh


def hold_heading(
    gain: float, damping: float, heading: int, rate: int, course: Signal, limit: float
) -> Signal:
    """Autopilot: proportional and derivative, towards a commanded angle."""

    def fresh() -> Pilot:
        wanted = course()

        def pilot(time: float, x: np.ndarray) -> float:
            error = wanted(time, x) - x[heading]
            return float(np.clip(gain * error - damping * x[rate], -limit, limit))

        return pilot

    return fresh
