r"""Is what disturbs a vehicle a sea? Narrow-band process noise in place of that of first order.

At the estimate with forces of first order, resonators (:mod:`oed_sysid.compiled.filter_pass`) are
admitted with variance zero in every equation at once. With the score ``s`` and the information
``I`` of everything unknown, resonators last,

.. math:: T = \max_{d \ge 0} (2 s' d - d' I d) - \max_{d_r = 0} (2 s' d - d' I d)

is what their variances ``d_r`` would gain in twice the log-likelihood, parameters and levels of
first order projected out. Its largest value over a grid of periods is held against the
:math:`\bar\chi^2` distribution of as many variances at their bound (Silvapulle & Sen 2005,
*Constrained statistical inference*, ch. 3), each period a test of its own.

Where it is beyond, resonators are estimated *instead* of the forces, first at the period of the
test, then with everything together; both shapes race, and the sea stays where it is clearly
likelier. Forces of first order on top are asked last, because a wrong shape lets them in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import comb
from scipy.stats import chi2

from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.noise_model import SHAPES, NoiseModel, Sea
from oed_sysid.likelihood.projection import bounded_step
from oed_sysid.likelihood.score_test import TIMES, Setting, moved, posed

# Probability of a test above its threshold where no sea acts.
FALSE_SEA = 0.005
# Gain in twice the log-likelihood over first order from which a sea stays: 10 nats, of which the
# choice among periods and shapes may be worth two or three.
WORTH_SEA = 20.0
# ... and over the sea alone from which forces of first order join it.
WORTH_FORCES = 9.0
# Periods that are tried: from so many samples to this share of the shortest record, with a ratio at
# which a wave of the bandwidth that is tried is half as strong at the next one.
FEWEST_SAMPLES, SHARE_OF_RECORD, RATIO, BANDWIDTH = 4.0, 1 / 4, 1.4, 0.3
# Steps with period and width held, and steps of each shape before the likelier goes on alone.
HELD, LOOK = 4, 3
# Levels to begin with, over those of first order.
BEGIN = (0.06, 0.2, 0.6, 2.0)


def threshold(n_forces: int, n_tests: int) -> float:
    """Value of the test that is exceeded with probability ``FALSE_SEA`` where no sea acts.

    Of ``n_forces`` independent variances at their bound, ``k`` are positive in one of ``2^n``
    cases for each choice of them.

    >>> round(threshold(3, 8), 1), round(threshold(4, 8), 1)
    (14.4, 16.0)
    """
    weights = [comb(n_forces, k) / 2.0**n_forces for k in range(n_forces + 1)]

    def beyond(value: float) -> float:
        return sum(w * float(chi2.sf(value, k)) for k, w in enumerate(weights) if k)

    low, high = 0.0, 200.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if beyond(middle) > FALSE_SEA / n_tests else (low, middle)
    return high


def with_sea(
    found: FilteredSolution, setting: Setting, *, max_iterations: int = 40
) -> FilteredSolution:
    """Take a sea for what disturbs the vehicle where the records show one.

    Parameters
    ----------
    found : FilteredSolution
        With forces of first order, near its end.
    setting : Setting
    max_iterations : int

    Returns
    -------
    FilteredSolution
        The same one where no sea is clearly likelier.
    """
    places = _at_sea(setting)
    periods = _periods(found)
    if found.noise.seas or not places or not len(periods):
        return found
    tests = [_tested(found, setting, places, float(period)) for period in periods]
    gain, period = max(zip(tests, map(float, periods), strict=True))
    if gain < threshold(len(places), len(periods)):
        return found
    sea = Sea(period, BANDWIDTH, dict.fromkeys(places, 0.0), "velocity")
    best = estimated(found, setting, sea, Sea(), max_iterations=max_iterations)
    # Held over the same shorter steps, forces of first order may be as likely.
    calm = replace(sea, period=best.noise.seas[0].period) if best is not None else sea
    first = _again(found, setting, replace(found.noise, seas=(calm,)), [calm], max_iterations)
    rival = found if first is None or first.objective > found.objective else first
    if best is None or rival.objective - 2.0 * rival.promise - best.objective < WORTH_SEA:
        return found
    return with_forces(best, setting, max_iterations=max_iterations)


def declared_sea(
    found: FilteredSolution, setting: Setting, *, max_iterations: int = 40
) -> FilteredSolution:
    """Estimate what the declared sea leaves out, in place of forces of first order.

    A period that is left out is that of the largest test.
    """
    known = setting.seas[0]
    places = known.places or _at_sea(setting)
    if found.noise.seas or not places:
        return found
    period = known.period
    if period is None:
        periods = [float(p) for p in _periods(found)] or [found.problem.records[0].duration / 8]
        gains = [_tested(found, setting, places, one) for one in periods]
        period = periods[int(np.argmax(gains))]
    sea = Sea(
        period,
        known.bandwidth or BANDWIDTH,
        known.levels or dict.fromkeys(places, 0.0),
        known.shape or "velocity",
    )
    best = estimated(found, setting, sea, known, max_iterations=max_iterations)
    return found if best is None else best


def _at_sea(setting: Setting) -> tuple[str, ...]:
    """Places at which waves may act: forces whose level is not known."""
    names = (place.name for place in setting.places if place.stage == "force")
    return tuple(name for name in names if name not in setting.known)


def _periods(found: FilteredSolution) -> np.ndarray:
    """Periods that are tried, s."""
    records = [record for record in found.problem.records if not record.independent]
    shortest = FEWEST_SAMPLES * max(record.sample_time for record in records)
    longest = SHARE_OF_RECORD * min(record.duration for record in records)
    if longest < shortest:
        return np.zeros(0)
    count = int(np.floor(np.log(longest / shortest) / np.log(RATIO))) + 1
    return shortest * RATIO ** np.arange(count)


def _again(
    found: FilteredSolution,
    setting: Setting,
    noise: NoiseModel,
    known: Sequence[Sea],
    max_iterations: int,
) -> FilteredSolution | None:
    """Go on from a solution with another noise model; of its seas what ``known`` leaves out."""
    own = not found.problem.levels.shares_a_time and bool(np.any(noise.force > 0))
    return moved(
        found,
        setting,
        noise,
        noise.colour > 0,
        own_times=own,
        max_iterations=max_iterations,
        seas=known,
    )


def score_gain(found: FilteredSolution, names: Sequence[str]) -> tuple[float, np.ndarray]:
    """What some levels that are zero would gain, and the step of all levels.

    Parameters
    ----------
    found : FilteredSolution
        With its equations at a point where these levels are unknown.
    names : sequence of str
        Of these levels, as :attr:`~oed_sysid.likelihood.levels.Levels.names` has them.
    """
    problem = found.problem
    limits, unknowns = problem.limits, found.point.unknowns
    matrix = found.matrix + np.diag(limits.prior_weight)
    right = found.right + limits.prior_weight * (limits.prior_mean - unknowns)
    lower, upper = limits.lower - unknowns, limits.upper - unknowns
    new = problem.layout.levels.start + np.flatnonzero(np.isin(problem.levels.names, names))
    gains, step = [], np.zeros_like(right)
    for held in (new, new[:0]):
        most = upper.copy()
        most[held] = 0.0
        step = bounded_step(matrix, right, np.minimum(lower, most), most, 0.0)
        gains.append(float(2.0 * right @ step - step @ matrix @ step))
    return gains[1] - gains[0], step[problem.layout.levels]


def _tested(
    found: FilteredSolution, setting: Setting, places: Sequence[str], period: float
) -> float:
    """Gain of resonators of a period at variance zero."""
    nothing = Sea(period, BANDWIDTH, dict.fromkeys(places, 0.0), "velocity")
    noise = replace(found.noise, seas=(nothing,))
    still = _again(found, setting, noise, [replace(nothing, levels=None)], 0)
    if still is None:
        return 0.0
    return score_gain(still, [f"sea {place} level" for place in places])[0]


def estimated(
    found: FilteredSolution,
    setting: Setting,
    sea: Sea,
    known: Sea,
    *,
    max_iterations: int = 40,
) -> FilteredSolution | None:
    """Estimate a sea in place of forces of first order.

    Parameters
    ----------
    found : FilteredSolution
        With forces of first order.
    setting : Setting
    sea : Sea
        Where it begins; its levels only where ``known`` says them.
    known : Sea
        What is known of it.
    max_iterations : int

    Returns
    -------
    FilteredSolution or None
        None where the filter diverges.
    """
    first = found.noise
    stay = [p not in sea.places or p in setting.known for p in first.places]
    alone = replace(
        first,
        force=first.force[stay],
        force_time=first.force_time[stay],
        places=tuple(p for p, kept in zip(first.places, stay, strict=True) if kept),
    )
    if known.levels is None:
        sea = _begun(found, setting, alone, sea)
    # Everything else first, lest period and width follow its misfit.
    held = replace(known, period=sea.period, bandwidth=sea.bandwidth)
    begun = _again(found, setting, replace(alone, seas=(sea,)), [held], HELD)
    if begun is None:
        return None
    free = replace(known, shape=None)
    shapes = [known.shape] if known.shape else list(SHAPES)
    looked = []
    for shape in shapes:
        noise = begun.noise
        noise = replace(noise, seas=(replace(noise.seas[0], shape=shape),))
        looked.append(_again(begun, setting, noise, [free], LOOK))
    best: FilteredSolution | None = None
    for one in sorted((one for one in looked if one is not None), key=lambda one: one.cost):
        if best is not None and one.cost - one.promise >= best.cost:
            continue
        end = one
        if one.reason != "converged":
            end = _again(one, setting, one.noise, [free], max_iterations) or one
        if best is None or end.cost < best.cost:
            best = end
    return best


def _begun(found: FilteredSolution, setting: Setting, alone: NoiseModel, sea: Sea) -> Sea:
    """The sea with the likeliest of some levels in proportion to those of first order."""
    unit = found.problem.levels.unit
    natural = np.array([unit.level(place)[0] for place in sea.places])
    first = np.array([found.noise.level(place)[0] for place in sea.places])
    size = np.maximum(first, natural)
    best, least = sea.with_levels(BEGIN[-1] * size), np.inf
    for share in BEGIN:
        tried = sea.with_levels(share * size)
        noise, known = replace(alone, seas=(tried,)), [replace(tried, levels=None)]
        problem = posed(found, setting, noise, alone.colour > 0, seas=known)
        others = found.point.unknowns[: problem.layout.levels.start]
        objective = problem.objective(np.concatenate([others, problem.levels.vector()]))
        if objective < least:
            best, least = tried, objective
    return best


def with_forces(
    found: FilteredSolution, setting: Setting, *, max_iterations: int = 40
) -> FilteredSolution:
    """Let forces of first order join a sea where the records ask for them."""
    noise = found.noise
    places = [place for place in _at_sea(setting) if place not in noise.places]
    if not places:
        return found
    known = setting.seas or [Sea()] * len(noise.seas)
    sample = min(record.sample_time for record in found.problem.records)
    best: tuple[float, NoiseModel] = (0.0, noise)
    for samples in TIMES:
        wide = replace(
            noise,
            force=np.append(noise.force, np.zeros(len(places))),
            force_time=np.append(noise.force_time, np.full(len(places), samples * sample)),
            places=(*noise.places, *places),
        )
        still = _again(found, setting, wide, known, 0)
        if still is None:
            continue
        gain, step = score_gain(still, [f"{place} level" for place in places])
        if gain > best[0]:
            levels = still.problem.levels
            begin = levels.at(np.maximum(levels.vector() + step, levels.lower)).force
            best = gain, replace(wide, force=np.append(noise.force, begin[len(noise.force) :]))
    if best[0] < WORTH_FORCES:
        return found
    again = _again(found, setting, best[1], known, max_iterations)
    if again is None or found.objective - again.objective < WORTH_FORCES:
        return found
    return again
