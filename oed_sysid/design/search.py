"""From rough manoeuvres to an optimum: quasi-Newton steps with priced limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import minimize

from oed_sysid.design.objective import Objective, Score

# Inner distance kept from the limits, as a share of their width, while searching.
_MARGIN = 2e-3
_FIRST_PRICE = 300.0
_PRICE_GROWTH = 4.0


@dataclass(frozen=True)
class Progress:
    """What a design search reports."""

    start: int
    round: int
    value: float
    excess: float


@dataclass(frozen=True, eq=False)
class Found:
    """Best member that keeps all limits, and how the search went.

    Attributes
    ----------
    best : Score or None
        None where nothing keeps the limits.
    nearest : Score
        Smallest excess met, for words about what cannot be kept.
    values : tuple of float
        Criterion reached from each start.
    """

    best: Score | None
    nearest: Score
    values: tuple[float, ...]


def refine(
    objective: Objective,
    start: Score,
    *,
    n_rounds: int = 6,
    n_steps: int = 40,
    report: Callable[[int, Score], None] | None = None,
) -> tuple[Score | None, Score]:
    """Maximise from one start by an augmented Lagrangian and L-BFGS-B.

    Parameters
    ----------
    objective : Objective
        Criterion and limits.
    start : Score
        Where to begin.
    n_rounds, n_steps : int
        Rounds of prices, and quasi-Newton steps in each.
    report : callable, optional
        Called with round and score.

    Returns
    -------
    best : Score or None
        Best member met that keeps all limits.
    nearest : Score
        The member with the smallest excess.

    References
    ----------
    J. Nocedal, S. Wright, *Numerical Optimization*, 2nd ed. (2006), chapters 9
    and 17.
    """
    best = start if start.feasible else None
    nearest = start
    limited = bool(objective.corridor.names)
    shape = [(len(view.signals), len(objective.corridor.names), 2) for view in start.views]
    prices = [np.zeros(s) for s in shape]
    weight, previous = _FIRST_PRICE, np.inf
    numbers = start.numbers
    for index in range(n_rounds if limited else 1):
        latest: list[Score] = []

        def cost(
            x: np.ndarray,
            prices: list[np.ndarray] = prices,
            weight: float = weight,
            latest: list[Score] = latest,
        ) -> tuple[float, np.ndarray]:
            nonlocal best, nearest
            score = objective.score(x)
            if not np.isfinite(score.value):
                return 1e10, np.zeros_like(x)
            if score.feasible and (best is None or score.value > best.value):
                best = score
            if score.excess < nearest.excess:
                nearest = score
            total, multipliers = score.value, []
            for view, price in zip(score.views, prices, strict=True):
                paid = _paid(objective, view.signals, price, weight)
                multipliers.append(paid)
                total -= float(np.sum(paid**2 - price**2)) / (2 * weight)
            latest[:] = [score]
            return -total, -objective.gradient(score, multipliers)

        steps = n_steps if limited else 5 * n_steps
        result = minimize(
            cost, numbers, jac=True, method="L-BFGS-B", bounds=[(0.0, 1.0)] * len(numbers),
            options={"maxiter": steps, "maxfun": 2 * steps, "ftol": 1e-6, "maxcor": 20},
        )  # fmt: skip
        numbers = result.x
        score = objective.score(numbers)
        if not np.isfinite(score.value):
            break
        if report is not None:
            report(index, score)
        prices = [
            _paid(objective, view.signals, price, weight)
            for view, price in zip(score.views, prices, strict=True)
        ]
        if score.excess > 0.3 * previous:
            weight *= _PRICE_GROWTH
        previous = max(score.excess, 1e-12)
        best = _repaired(objective, score, best)
    return best, nearest if best is None else best


def _paid(
    objective: Objective, signals: np.ndarray, price: np.ndarray, weight: float
) -> np.ndarray:
    excess = objective.corridor.excess(signals, n_times=len(signals)) + _MARGIN
    return np.maximum(0.0, price + weight * np.where(np.isfinite(excess), excess, -1e3))


def _repaired(objective: Objective, score: Score, best: Score | None) -> Score | None:
    """Move an end point that is slightly outside back towards the best one inside."""
    if score.feasible:
        return score if best is None or score.value > best.value else best
    if best is None or score.excess > 0.2:
        return best
    for share in (0.98, 0.95, 0.9, 0.8, 0.6):
        trial = objective.score(best.numbers + share * (score.numbers - best.numbers))
        if trial.feasible:
            return trial if trial.value > best.value else best
    return best


def search(
    objective: Objective,
    begin: list[Score],
    *,
    n_steps: int = 25,
    progress: Callable[[Progress], None] | None = None,
) -> Found:
    """Refine several starts roughly, the best one further.

    Parameters
    ----------
    objective : Objective
        Criterion and limits.
    begin : list of Score
        Starts; at least one.
    n_steps : int
        Quasi-Newton steps in each round of prices.
    progress : callable, optional
        Called with a :class:`Progress` after each round.
    """
    nearest = min(begin, key=lambda score: score.excess)
    rough: list[Score] = []

    def tell(number: int, index: int, score: Score) -> None:
        if progress is not None:
            progress(Progress(number, index, score.value, score.excess))

    values = []
    for number, start in enumerate(begin):
        found, close = refine(
            objective, start, n_rounds=3, n_steps=n_steps, report=partial(tell, number)
        )
        values.append(float("-inf") if found is None else found.value)
        if found is not None:
            rough.append(found)
        nearest = min(nearest, close, key=lambda score: score.excess)
    if not rough:
        return Found(None, nearest, tuple(values))
    best = max(rough, key=lambda score: score.value)
    found, _ = refine(
        objective, best, n_rounds=4, n_steps=2 * n_steps, report=partial(tell, len(begin))
    )
    return Found(found or best, nearest, tuple(values))
