r"""Rough manoeuvres from which a search begins.

The pace of each (samples between changes) is drawn from a log-uniform distribution,

.. math:: \log p \sim U\left(\log 2, \log \tfrac{n}{4}\right)

for ``n`` samples, so that slow and quick ones are as frequent; then the wave :math:`g_k \in [-1,
1]` of one of five kinds becomes :math:`\delta_k = \delta_0 + s\, g_k\, (\delta_{max} -
\delta_0)`, with the largest share ``s`` of a falling sequence at which all limits hold.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed_sysid.design.objective import Objective, Score
from oed_sysid.design.parametrisation import Grid

# Amplitudes tried, as shares of the actuator range, until the limits are kept.
_SHARES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.17, 0.1, 0.05, 0.02)


def rough_commands(grid: Grid, rng: np.random.Generator) -> np.ndarray:
    """Return one random manoeuvre ``(n_times, n_inputs)`` between -1 and 1.

    Random telegraph, square wave, random levels, multisine or 3-2-1-1 blocks,
    each at a random pace between two samples and a quarter of the duration.
    """
    n_times, n_inputs = len(grid.times), len(grid.inputs)
    columns = []
    for _ in range(n_inputs):
        pace = float(np.exp(rng.uniform(np.log(2.0), np.log(max(n_times / 4, 3.0)))))
        kind = rng.integers(5)
        index = np.arange(n_times)
        if kind == 0:
            switches = rng.random(n_times) < 1.0 / pace
            column = np.where(np.cumsum(switches) % 2, 1.0, -1.0)
        elif kind == 1:
            column = np.sign(np.sin(np.pi * (index / pace + rng.random())) + 1e-12)
        elif kind == 2:
            column = rng.uniform(-1, 1, n_times)[(index // max(int(pace), 1))]
        elif kind == 3:
            lines = np.exp(rng.uniform(np.log(0.2), np.log(2.0), 6)) * np.pi / pace
            column = np.cos(np.outer(index, lines) + rng.uniform(0, 2 * np.pi, 6)).sum(axis=1)
            column /= np.abs(column).max()
        else:
            unit = max(int(pace / 2), 1)
            block = np.repeat([1.0, -1.0, 1.0, -1.0], np.array([3, 2, 1, 1]) * unit)
            pause = np.zeros(int(rng.uniform(0, 4) * unit))
            pattern = np.concatenate([block, pause, -block, pause])
            column = np.resize(pattern, n_times)
        columns.append(column * rng.choice([-1.0, 1.0]))
    return np.column_stack(columns)


def starts(
    objective: Objective,
    grid: Grid,
    rng: np.random.Generator,
    *,
    n_candidates: int,
    n_starts: int,
    given: Sequence[np.ndarray] = (),
) -> list[Score]:
    """Evaluate rough manoeuvres and return the best, different ones.

    Parameters
    ----------
    objective : Objective
        Criterion and limits.
    grid : Grid
        Where commands have to fit.
    rng : numpy.random.Generator
    n_candidates, n_starts : int
        Manoeuvres tried, and kept.
    given : sequence of ndarray (n_times, n_inputs)
        Manoeuvres of the designed inputs that are tried first, at full size.
    """
    found: list[Score] = []
    for commands in given:
        numbers = objective.shape.start(commands)
        if numbers is not None:
            found += _largest(objective, grid, numbers, guarded=False)
    for _ in range(n_candidates):
        unit = rough_commands(grid, rng)
        numbers = None
        orders = np.where(unit > 0, grid.upper - grid.neutral, grid.neutral - grid.lower) * unit
        numbers = objective.shape.start(grid.limited((grid.neutral + orders)[None])[0])
        if numbers is None:
            numbers = rng.random(objective.shape.size)
        found += _largest(objective, grid, numbers, guarded=False)
    found.sort(key=lambda score: (not score.feasible, -score.value))
    kept: list[Score] = []
    for score in found:
        if np.isfinite(score.value) and all(
            np.sqrt(np.mean((score.numbers - other.numbers) ** 2)) > 0.05 for other in kept
        ):
            kept.append(score)
        if len(kept) == n_starts:
            break
    if objective.guards is None:
        return kept
    if kept:
        objective.guards.waive(objective.score(kept[0].numbers).guards)
    # Many vehicles take time: only what is kept is shrunk until they keep the limits too.
    return [
        smaller
        for score in kept
        for smaller in _largest(objective, grid, score.numbers, guarded=True)
    ]


def again(objective: Objective, grid: Grid, before: Score) -> list[Score]:
    """Return a member of the same family, shrunk until it keeps the limits of this objective."""
    if objective.guards is not None:
        objective.guards.waive(objective.score(before.numbers).guards)
    return _largest(objective, grid, before.numbers, guarded=True)


def _largest(
    objective: Objective, grid: Grid, numbers: np.ndarray, *, guarded: bool
) -> list[Score]:
    """Shrink a manoeuvre towards the neutral command until all limits are kept."""
    still = objective.shape.start(
        np.broadcast_to(grid.neutral, (len(grid.times), len(grid.inputs)))
    )
    if still is None:
        score = objective.score(numbers, guarded=guarded)
        return [score] if np.isfinite(score.value) else []
    last: list[Score] = []
    for share in _SHARES:
        score = objective.score(still + share * (numbers - still), guarded=guarded)
        if score.feasible:
            return [score]
        if np.isfinite(score.value):
            last = [score]
    return last
