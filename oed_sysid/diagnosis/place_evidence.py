"""How likely a disturbance at one place of the signal chain is.

One disturbance at a time is let into the linear deviations; its variance is
estimated by restricted maximum likelihood, so that a place is not rewarded for
what the parameters could do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.errors import SimulationError
from oed_sysid.noise.disturbances import Place
from oed_sysid.noise.kalman import Deviations, NoiseModel
from oed_sysid.noise.linearisation import Along, smoothed_states
from oed_sysid.noise.restricted_likelihood import Grounds, Restricted, restricted

# Levels that are tried first, in units that move some output by its noise, and the
# ratio within which the best is settled.
LEVELS = (0.03, 0.12, 0.5, 2.0, 8.0)
SETTLED = 1.15
# At the edge of the levels tried, so small a gain is not followed.
FLAT = 0.2
# Levels tried beyond the first ones, at most.
MOST_ROUNDS = 6
# Relinearisations of the most likely places.
REFINEMENTS = 2


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
    grounds : Grounds
        Sensitivities and residuals of the linearisation that was used.
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
    grounds: Grounds
    records: Sequence[Deviations]
    noise: NoiseModel
    solution: Restricted


def evidence(
    found: Along, chosen: Sequence[int] | None = None, *, correlation_time: float
) -> list[Evidence]:
    """Evidence for places of the chain, largest first.

    Parameters
    ----------
    found : Along
        The linearised model.
    chosen : sequence of int, optional
        Positions of the places to judge; all by default.
    correlation_time : float
        Of the disturbances, s.
    """
    chosen = range(len(found.where)) if chosen is None else chosen
    # A level that nobody declared must not make every misfit evidence for a disturbance.
    stated = all(output.noise_std is not None for output in found.system.model.outputs)
    grounds = replace(found.grounds, scale_known=stated)
    nothing = np.zeros_like(grounds.white)
    quiet = NoiseModel(grounds.white, nothing, np.zeros(1), force_time=correlation_time)
    records = [[stretch.alone(index) for stretch in found.stretches] for index in chosen]
    units = found.units(correlation_time)[list(chosen)]
    base = restricted(grounds, [quiet], [records[0]])[0].objective
    logs = np.log(LEVELS)
    tables = [
        {float(x): s for x, s in zip(logs, solutions, strict=True)}
        for solutions in _at_levels(grounds, quiet, records, np.outer(units, LEVELS))
    ]
    for _ in range(MOST_ROUNDS):
        trials = {i: x for i, x in enumerate(map(_next_level, tables)) if x is not None}
        if not trials:
            break
        wanted = [records[i] for i in trials]
        sizes = np.array([[units[i] * np.exp(x)] for i, x in trials.items()])
        for (i, x), parts in zip(
            trials.items(), _at_levels(grounds, quiet, wanted, sizes), strict=True
        ):
            tables[i][x] = parts[0]
    best = [_best(table) for table in tables]
    result = []
    for position, index in enumerate(chosen):
        solution = tables[position][best[position]]
        level = solution.scale * float(units[position] * np.exp(best[position]))
        gain = max(base - solution.objective, 0.0)
        noise = replace(quiet, white=solution.scale * quiet.white, force=np.array([level]))
        lines = records[position]
        result.append(Evidence(found.where[index], gain, level, grounds, lines, noise, solution))
    return sorted(result, key=lambda e: -e.gain)


def refined(found: Along, first: Evidence) -> Evidence:
    """Evidence for one place where the model is linearised with that disturbance let in.

    The parameters bend to a missing effect; where the right place is disturbed
    they straighten, and what a disturbance there does changes with them. At
    the wrong place they may bend further still: of what is found on the way
    the least counts, so that no place profits from a linearisation that does
    not settle.
    """
    base = first.solution.objective + first.gain
    settled = first
    linear, present = found, first
    gains = []
    for _ in range(REFINEMENTS):
        try:
            linear, present = _relinearised(linear, present)
        except (SimulationError, np.linalg.LinAlgError):
            gains.append(first.gain)
            break
        gain = base - present.solution.objective
        if not np.isfinite(gain):
            gains.append(first.gain)
            break
        gains.append(max(gain, 0.0))
        settled = present
    return replace(settled, gain=min(gains))


def _relinearised(linear: Along, present: Evidence) -> tuple[Along, Evidence]:
    """One step of :func:`refined`."""
    nodes = smoothed_states(linear, present.noise, present.records)
    system = linear.system.moved(present.solution.correction[: len(linear.system.names)])
    again = system.linearise(nodes, linear.noise)
    index = again.where.index(present.place)
    return again, evidence(again, [index], correlation_time=present.noise.force_time)[0]


def _next_level(table: dict[float, Restricted]) -> float | None:
    """Logarithm of the level to try next; None where the best one is settled.

    The vertex of the parabola through the best level and its neighbours, or
    further out where the best one has a neighbour on one side only.
    """
    known = sorted(table)
    index = known.index(_best(table))
    if index in (0, len(known) - 1):
        inward = known[1] if index == 0 else known[-2]
        flat = table[inward].objective - table[known[index]].objective < FLAT
        return None if flat else 2.0 * known[index] - inward
    low, centre, high = known[index - 1 : index + 2]
    left, right = centre - low, high - centre
    below = (table[low].objective - table[centre].objective) / left
    above = (table[high].objective - table[centre].objective) / right
    if not np.isfinite(below + above):
        trial = centre - 0.5 * left if np.isfinite(below) else centre + 0.5 * right
    else:
        trial = centre + 0.5 * (below * right - above * left) / max(below + above, 1e-12)
    return None if min(abs(trial - x) for x in known) < np.log(SETTLED) else float(trial)


def _best(table: dict[float, Restricted]) -> float:
    return min(table, key=lambda x: table[x].objective)


def _at_levels(
    grounds: Grounds,
    quiet: NoiseModel,
    records: Sequence[Sequence[Deviations]],
    levels: np.ndarray,
) -> list[list[Restricted]]:
    """Restricted likelihoods of every place at its levels, shape ``(n_places, n_levels)``."""
    models = [replace(quiet, force=np.array([level])) for level in levels.ravel()]
    lines = [part for part in records for _ in range(levels.shape[1])]
    found = restricted(grounds, models, lines)
    count = levels.shape[1]
    return [found[i * count : (i + 1) * count] for i in range(len(records))]
