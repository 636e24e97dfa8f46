"""Closed-loop family: zigzags whose angles and switching values are designed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from oed_sysid.design.caution import Guards
from oed_sysid.design.objective import Objective, Score
from oed_sysid.design.parametrisation import Grid
from oed_sysid.errors import DesignError, OedSysidError
from oed_sysid.experiment import Experiment
from oed_sysid.manoeuvres import ZigZagLike
from oed_sysid.model import Model
from oed_sysid.simulation import simulate

# Shares of the largest angles of the command, and of the attitude.
_SIZES = (0.03, 0.1, 0.25, 0.5, 1.0)


@dataclass(frozen=True)
class ZigZags:
    """Zigzags that reverse on a measured attitude, each swing with its own angles.

    Being closed over the vehicle, they keep attitude limits also when the
    model is wrong, and they work for vehicles that are unstable on their own.
    The search is random, then local; there is no gradient through a switch.

    Parameters
    ----------
    feedback : str
        Attitude on which the command reverses.
    largest_switch : float
        Largest switching angle, rad.
    n_swings : int
        Swings with angles of their own; the last pair is repeated.
    n_trials : int
        Simulations in all.
    """

    feedback: str
    largest_switch: float
    n_swings: int = 4
    n_trials: int = 250

    @property
    def name(self) -> str:
        """Name for reports."""
        return f"zigzag of {self.n_swings} free swings on {self.feedback}"


def search_zigzags(
    family: ZigZags,
    objective: Objective,
    grid: Grid,
    model: Model,
    *,
    sign: int,
    constants: dict[str, float],
    initial: dict[str, float],
    rng: np.random.Generator,
    guards: Guards | None = None,
    progress: Callable[[int, Score], None] | None = None,
) -> tuple[Score | None, Score | None, Experiment | None]:
    """Return the best zigzag within the limits, the nearest one, and its experiment.

    With guards, each of them closes the loop itself and enough have to keep the limits.

    Raises
    ------
    DesignError
        If several inputs are to be designed.
    """
    if len(grid.inputs) != 1:
        raise DesignError(
            f"A zigzag commands one input, not {', '.join(grid.inputs)}. Give inputs=[one of them] "
            "and constants for the others."
        )
    n = family.n_swings
    span = float(min(grid.upper[0] - grid.neutral[0], grid.neutral[0] - grid.lower[0]))
    rate = None if not np.isfinite(grid.rates[0]) else float(grid.rates[0])

    def plan(numbers: np.ndarray) -> Experiment:
        return Experiment(
            "designed zigzag",
            ZigZagLike(
                grid.inputs[0],
                tuple(float(x) for x in span * np.maximum(numbers[:n], 0.02)),
                tuple(float(x) for x in family.largest_switch * np.maximum(numbers[n:], 0.02)),
                feedback=(family.feedback,), rate=rate, sign=sign, start=grid.step,
                neutral=float(grid.neutral[0]), reference=None,
            ),
            duration=float(grid.times[-1]), sample_time=grid.step, constants=constants,
            initial=initial, feedback="true",
        )  # fmt: skip

    def judge(numbers: np.ndarray) -> Score | None:
        try:
            record = simulate(model, plan(numbers), noise=False)
        except OedSysidError:
            return None
        score = objective.score_commands(record.inputs, numbers, guarded=False)
        return score if np.isfinite(score.value) else None

    def is_safe(numbers: np.ndarray) -> bool:
        if guards is None:
            return True
        experiment, failed = plan(numbers), 0
        for index, other in enumerate(guards.models):
            try:
                commands = simulate(other, experiment, noise=False).inputs
                failed += guards.run(index, commands).excess > 0
            except OedSysidError:
                failed += 1
            if failed > guards.n_waived:
                return False
        return True

    best: Score | None = None
    nearest: Score | None = None
    # Regular zigzags of all sizes first: swings of their own pay only near a good one.
    regular = [np.repeat(pair, n) for pair in product(_SIZES, _SIZES)]
    n_random = len(regular) + family.n_trials // 4
    width = 0.3
    for trial in range(family.n_trials):
        if trial < len(regular):
            numbers = regular[trial]
        elif trial < n_random or best is None:
            numbers = rng.uniform(0.05, 1.0, 2 * n)
        else:
            moved = rng.random(2 * n) < max(0.3, 1.0 / n)
            numbers = np.clip(best.numbers + width * moved * rng.standard_normal(2 * n), 0.02, 1.0)
        score = judge(numbers)
        if score is None:
            continue
        if nearest is None or score.excess < nearest.excess:
            nearest = score
        if score.feasible and (best is None or score.value > best.value) and is_safe(numbers):
            best = score
            width = min(0.4, 1.3 * width) if trial >= n_random else width
            if progress is not None:
                progress(trial, score)
        elif trial >= n_random:
            width = max(0.03, 0.97 * width)
    return best, nearest, None if best is None else plan(best.numbers)
