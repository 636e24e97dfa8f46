"""How likely a disturbance at one place of the signal chain is.

One disturbance at a time is let into the linear deviations; its variance is
estimated by restricted maximum likelihood, so that a place is not rewarded for
what the parameters could do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.diagnosis.along import Along, smoothed_states
from oed_sysid.diagnosis.innovations import Deviations, NoiseModel
from oed_sysid.diagnosis.restricted import Grounds, Restricted, restricted
from oed_sysid.diagnosis.stages import Place
from oed_sysid.errors import SimulationError

# Levels that are tried first, in units that move some output by its noise, and the
# ratio within which the best is settled.
LEVELS = (0.03, 0.12, 0.5, 2.0, 8.0)
SETTLED = 1.15
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
    grounds = found.grounds
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
    best = [_best(table) for table in tables]
    step = logs[1] - logs[0]
    while step > np.log(SETTLED):
        step /= 2.0
        trials = np.array([[centre - step, centre + step] for centre in best])
        solutions = _at_levels(grounds, quiet, records, units[:, None] * np.exp(trials))
        for table, at, parts in zip(tables, trials, solutions, strict=True):
            table.update({float(x): s for x, s in zip(at, parts, strict=True)})
        best = [_best(table) for table in tables]
    result = []
    for position, index in enumerate(chosen):
        solution = tables[position][best[position]]
        level = float(units[position] * np.exp(best[position]))
        gain = max(base - solution.objective, 0.0)
        noise = replace(quiet, force=np.array([level]))
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
