"""How likely a disturbance at one place of the signal chain is.

One disturbance at a time is let into the linear deviations; its variance is
estimated by restricted maximum likelihood, so that a place is not rewarded for
what the parameters could do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.diagnosis.innovations import Deviations, NoiseModel
from oed_sysid.diagnosis.restricted import Grounds, Restricted, restricted
from oed_sysid.diagnosis.stages import Place

# Levels that are tried first, in units that move some output by its noise, and the
# ratio within which the best is settled.
LEVELS = (0.03, 0.12, 0.5, 2.0, 8.0)
SETTLED = 1.15


@dataclass(frozen=True, eq=False)
class Evidence:
    """One place with the most likely size of its disturbance.

    Attributes
    ----------
    place : Place
    gain : float
        Gain in twice the log-likelihood over white noise alone.
    level : float
        Standard deviation of the disturbance, in the place's unit.
    records : sequence of Deviations
        Linear deviations driven at the place.
    noise : NoiseModel
        White noise and the disturbance.
    solution : Restricted
        With the unknowns that go with it.
    """

    place: Place
    gain: float
    level: float
    records: Sequence[Deviations]
    noise: NoiseModel
    solution: Restricted


def evidence(
    grounds: Grounds,
    where: Sequence[Place],
    records: Sequence[Sequence[Deviations]],
    correlation_time: float,
) -> list[Evidence]:
    """Evidence for every place, largest first.

    Parameters
    ----------
    grounds : Grounds
    where : sequence of Place
    records : sequence of sequence of Deviations
        For every place, the deviations of all records.
    correlation_time : float
        Of the disturbances, s.
    """
    quiet = NoiseModel(
        grounds.white,
        np.zeros_like(grounds.white),
        np.zeros(1),
        force_time=correlation_time,
    )
    base = restricted(grounds, [quiet], [records[0]])[0].objective
    units = [unit_level(lines, grounds.white, correlation_time) for lines in records]
    logs = np.log(LEVELS)
    found = _at_levels(grounds, quiet, records, [unit * np.exp(logs) for unit in units])
    result = []
    best_logs = []
    for solutions in found:
        values = np.array([s.objective for s in solutions])
        best_logs.append(logs[int(np.argmin(values))])
    step = logs[1] - logs[0]
    tables = [{float(x): s for x, s in zip(logs, solutions, strict=True)} for solutions in found]
    while step > np.log(SETTLED):
        step /= 2.0
        trials = [np.array([centre - step, centre + step]) for centre in best_logs]
        levels = [unit * np.exp(t) for unit, t in zip(units, trials, strict=True)]
        for index, solutions in enumerate(_at_levels(grounds, quiet, records, levels)):
            for x, solution in zip(trials[index], solutions, strict=True):
                tables[index][float(x)] = solution
            best_logs[index] = min(tables[index], key=lambda x: tables[index][x].objective)
    for index, place in enumerate(where):
        solution = tables[index][best_logs[index]]
        level = float(units[index] * np.exp(best_logs[index]))
        gain = max(base - solution.objective, 0.0)
        noise = replace(quiet, force=np.array([level]))
        result.append(Evidence(place, gain, level, records[index], noise, solution))
    return sorted(result, key=lambda e: -e.gain)


def unit_level(records: Sequence[Deviations], white: np.ndarray, correlation_time: float) -> float:
    """Disturbance that moves some output by its noise within one correlation time."""
    sizes = []
    for line in records:
        span = max(1, min(round(correlation_time / line.sample_time), len(line.output) // 2))
        moved = np.zeros(line.output.shape[2])
        largest = []
        for k in range(len(line.output) - 1):
            if k % span == 0:
                largest.append(np.max(np.abs(line.output[k] @ moved) / white))
                moved = np.zeros_like(moved)
            moved = line.transition[k] @ moved + line.force_gain[k, :, 0]
        sizes.append(np.median(largest[1:]) if len(largest) > 1 else 0.0)
    size = float(np.mean(sizes))
    return 1.0 / size if size > 0 else 1.0


def _at_levels(
    grounds: Grounds,
    quiet: NoiseModel,
    records: Sequence[Sequence[Deviations]],
    levels: Sequence[np.ndarray],
) -> list[list[Restricted]]:
    """Restricted likelihoods of every place at its levels."""
    models, lines = [], []
    for place_lines, place_levels in zip(records, levels, strict=True):
        for level in place_levels:
            models.append(replace(quiet, force=np.array([level])))
            lines.append(place_lines)
    found = restricted(grounds, models, lines)
    count = len(levels[0])
    return [found[i * count : (i + 1) * count] for i in range(len(levels))]
