"""From a white fit to the likelihood of innovations: which noise, how strong, with everything else.

What :mod:`oed_sysid.likelihood.score_test` finds is where levels begin. Colour of sensors, noise of
logged inputs and times of their own are admitted one after the other, each where it is worth it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.compiled.filtering import (
    FORCE_VARIANCE,
    FilterKernel,
)
from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.gauss_newton import (
    POLISH_STEPS,
    FilteredSolution,
    Progress,
    solve_filtered,
)
from oed_sysid.likelihood.information import autocorrelation
from oed_sysid.likelihood.noise_levels import credible_levels
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.projection import bounded_step
from oed_sysid.likelihood.score_test import ScoreTest, Setting, moved
from oed_sysid.likelihood.sea import declared_sea, with_sea
from oed_sysid.likelihood.shooting import Point
from oed_sysid.physics.model import Model

# Gain in twice the log-likelihood from which a colour of a sensor, or a time of its own for each
# disturbance, is worth its freedom.
WORTH_COLOUR, WORTH_TIMES = 10.0, 12.0
# Correlation of neighbouring innovations, in standard errors, that asks for a coloured sensor.
COLOURED = 4.0
# Colour below this share of the white level has vanished.
VANISHED = 0.02
# Where a level that is admitted begins at least, in its natural unit.
LEAST_START = 1.0
# Decades above these levels that are climbed for the likeliest, and the stride of the climb: where
# a model hardly damps what disturbs it, records tell of levels far below those that act.
DECADES, STRIDE = 21, 3
# High-frequency content, over the level declared, from which levels also begin at what
# these show.
LOUD = 1.5
# Steps of everything else before levels move too.
HELD_STEPS = 2
# Iterations after which the likeliest of several starts goes on, and the others only where they
# promise to overtake; and the difference of twice the log-likelihood below which two are one.
FIRST_LOOK, SAME_PLACE = 3, 10.0
# Steps with forces of first order before a sea is asked for: under swell they do not converge.
BEFORE_SEA = 8
# Fall of the cost promised where an earlier fit ended, below which no step is taken at frozen gain;
# and steps at frozen gain before the exact ones where those before did not converge.
ARRIVED, UNFINISHED = 0.2, 3


def fit_disturbed(
    model: Model,
    dataset: Dataset,
    setting: Setting,
    starts: Sequence[Start],
    test: ScoreTest,
    *,
    kernel: FilterKernel | None = None,
    max_iterations: int = 40,
    polish: int = POLISH_STEPS,
    progress: Callable[[Progress], None] | None = None,
) -> FilteredSolution | None:
    """Estimate parameters, start states and noise together.

    Colour of sensors is admitted only where innovations without it are correlated from
    sample to sample; disturbances share one correlation time unless times of their own
    are clearly likelier.

    Parameters
    ----------
    model, dataset, setting
    starts : sequence of Start
        Values and start states to begin at; the likeliest wins.
    test : ScoreTest
        Where levels begin.
    kernel : FilterKernel, optional
        Of a larger model.
    max_iterations, polish
        See :func:`~oed_sysid.likelihood.gauss_newton.solve_filtered`.
    progress : callable, optional

    Returns
    -------
    FilteredSolution or None
        None where the filter diverges from every start.
    """
    unit = test.unit
    begin = replace(
        test.noise,
        colour=np.zeros_like(test.noise.colour),
        force=np.where(
            [place in setting.known for place in test.noise.places],
            test.noise.force,
            np.maximum(test.noise.force, LEAST_START * unit.force),
        ),
    )
    beginnings = [(start, begin) for start in starts]
    if (loud := _noisier(begin, dataset, setting)) is not None:
        beginnings += [(start, loud) for start in starts if start.noise is None]
    begun = []
    for start, noise in beginnings:
        own = noise if start.noise is None else _carried(noise, start.noise, setting)
        problem = Filtered(
            model.with_values(dict(start.values)),
            dataset,
            setting.as_in(dataset, own, unit),
            kernel=kernel,
            known_starts=setting.known_starts,
        )
        if start.noise is None:
            begun.append((problem, *_begun(problem, start, setting, noise)))
        else:
            point = problem.point(start.initial, start.local, own)
            begun.append((problem, point, problem.objective(point.unknowns)))
    best = _stayed(begun, starts)
    if best is None:
        best = _raced(begun, min(max_iterations, BEFORE_SEA), progress)
        if best is not None and setting.any_sea:
            best = with_sea(best, setting, max_iterations=max_iterations)
        if best is not None and setting.seas:
            best = declared_sea(best, setting, max_iterations=max_iterations)
        if best is not None and best.reason == "iterations" and max_iterations > BEFORE_SEA:
            best = _continued(best, max_iterations - BEFORE_SEA, progress)
    if best is None:
        return None
    best = with_colour(best, setting, max_iterations=max_iterations)
    best = with_input_noise(best, setting)
    best = with_own_times(best, setting)
    if polish:
        more = 0 if best.reason == "converged" else UNFINISHED
        again = solve_filtered(best.problem, best.point, max_iterations=more, polish=polish)
        if again is not None:
            stood = not more and again.reason == "iterations"
            best = replace(
                again,
                iterations=again.iterations + best.iterations,
                reason=best.reason if stood else again.reason,
            )
    return best


def _continued(
    found: FilteredSolution, max_iterations: int, progress: Callable[[Progress], None] | None
) -> FilteredSolution:
    """Go on from where the iterations ended."""
    again = solve_filtered(
        found.problem, found.point, max_iterations=max_iterations, polish=0, callback=progress
    )
    if again is None:
        return found
    return replace(again, iterations=found.iterations + again.iterations)


def _noisier(begin: NoiseModel, dataset: Dataset, setting: Setting) -> NoiseModel | None:
    """Sensors at their high-frequency content, where it clearly exceeds what was declared.

    Levels that are to be estimated begin at what was declared. Where that is far too small, forces
    that follow every wiggle seem likely, and parameters follow the forces.
    """
    shown, seen = credible_levels(dataset)
    loud = setting.estimated & seen & (shown > LOUD * begin.white)
    return replace(begin, white=np.where(loud, shown, begin.white)) if loud.any() else None


def _stayed(
    begun: Sequence[tuple[Filtered, Point, float]], starts: Sequence[Start]
) -> FilteredSolution | None:
    """The one beginning itself, where an earlier fit ended and steps promise next to nothing."""
    if len(begun) > 1 or starts[0].noise is None:
        return None
    problem, point, _ = begun[0]
    found = solve_filtered(problem, point, max_iterations=0, polish=0)
    if found is None or found.promise > ARRIVED:
        return None
    return replace(found, reason="converged")


def _raced(
    begun: Sequence[tuple[Filtered, Point, float]],
    max_iterations: int,
    progress: Callable[[Progress], None] | None,
) -> FilteredSolution | None:
    """The likeliest end from several beginnings, the leader after a first look first.

    Where a beginning arrives at the same likelihood as another, they are one.
    """
    apart: list[tuple[Filtered, Point, float]] = []
    for one in sorted(begun, key=lambda one: one[2]):
        if not apart or one[2] - apart[-1][2] > SAME_PLACE:
            apart.append(one)

    def ahead(problem: Filtered, point: Point, most: int) -> FilteredSolution | None:
        return solve_filtered(problem, point, max_iterations=most, polish=0, callback=progress)

    if len(apart) == 1:
        return ahead(apart[0][0], apart[0][1], max_iterations)
    looked = [ahead(problem, point, min(FIRST_LOOK, max_iterations)) for problem, point, _ in apart]
    best: FilteredSolution | None = None
    for found in sorted((one for one in looked if one is not None), key=lambda one: one.cost):
        end: FilteredSolution | None = found
        if best is not None and found.cost - found.promise >= best.cost:
            continue
        if found.reason != "converged":
            end = ahead(found.problem, found.point, max_iterations)
        if end is not None and (best is None or end.cost < best.cost):
            best = end
    return best


def _begun(
    problem: Filtered, start: Start, setting: Setting, begin: NoiseModel
) -> tuple[Point, float]:
    """The likeliest levels, again after some steps of everything else; and the objective.

    Levels and time would otherwise first follow the misfit of wrong values, and then come back.
    """
    levels = problem.layout.levels
    others = problem.point(start.initial, start.local, begin).unknowns[: levels.start]
    point, objective, decade = _likeliest_level(problem, others, setting, begin)
    held = Filtered(
        problem.model,
        problem.dataset,
        problem.levels.starting(problem.noise(point.unknowns)).held(),
        kernel=problem.kernel,
        known_starts=problem.known_starts,
    )
    found = solve_filtered(held, Point(others, ()), max_iterations=HELD_STEPS, polish=0)
    if found is None:
        return point, objective
    there, less, _ = _likeliest_level(problem, found.point.unknowns, setting, begin, decade)
    return (there, less) if less < objective else (point, objective)


def _likeliest_level(
    problem: Filtered,
    others: np.ndarray,
    setting: Setting,
    begin: NoiseModel,
    near: int | None = None,
) -> tuple[Point, float, int]:
    """Point with the likeliest decade of levels at given other unknowns, its objective, the decade.

    The objective is flat where the levels do nothing yet, falls, and rises where they are too
    large: strides find the valley, single decades its floor, which is ``near`` where that is known.
    """
    free = np.array([place not in setting.known for place in begin.places], dtype=bool)
    tried: dict[int, tuple[Point, float, int]] = {}

    def attempt(decade: int) -> float:
        if decade < 0:
            return np.inf
        if decade not in tried:
            force = np.where(free, 10.0**decade * begin.force, begin.force)
            levels = problem.levels.vector(replace(begin, force=force))
            point = Point(np.concatenate([others, levels]), ())
            tried[decade] = point, problem.objective(point.unknowns), decade
        return tried[decade][1]

    least, best = np.inf, 0
    for decade in range(0, DECADES + 1, STRIDE) if near is None else (near,):
        found = attempt(decade)
        if found < least - 1.0:
            least, best = found, decade
        elif np.isfinite(least) and (not np.isfinite(found) or best > 0):
            break
    for way in (-1, 1):
        decade = best
        while attempt(decade + way) < attempt(decade) and decade + way <= DECADES + 1:
            decade += way
    return min(tried.values(), key=lambda one: one[1])


@dataclass(frozen=True, eq=False)
class Start:
    """Where an estimation begins: values, start states and values of each record.

    Levels are looked for unless ``noise`` gives those of an earlier fit.
    """

    values: Mapping[str, float]
    initial: Sequence[np.ndarray]
    local: Sequence[Mapping[str, float]]
    noise: NoiseModel | None = None


def _carried(begin: NoiseModel, earlier: NoiseModel, setting: Setting) -> NoiseModel:
    """Levels and times of an earlier fit at the places that both know."""
    force, time = begin.force.copy(), begin.force_time.copy()
    for index, place in enumerate(begin.places):
        if place not in setting.known and place in earlier.places:
            level, lasting = earlier.level(place)
            force[index] = max(level, force[index])
            time[index] = lasting or time[index]
    coloured = setting.colour & (earlier.colour > 0)
    places, seas = begin.places, earlier.seas
    if seas:  # instead of forces of first order, but for those that joined them
        stay = np.isin(places, (*earlier.places, *setting.known))
        force, time = force[stay], time[stay]
        places = tuple(p for p, kept in zip(places, stay, strict=True) if kept)
    return replace(
        begin,
        places=places,
        seas=seas,
        white=np.where(setting.estimated | coloured, earlier.white, begin.white),
        colour=np.where(coloured, earlier.colour, 0.0),
        colour_time=np.where(coloured, earlier.colour_time, begin.colour_time),
        force=force,
        force_time=time,
    )


def with_colour(
    found: FilteredSolution, setting: Setting, *, max_iterations: int = 40
) -> FilteredSolution:
    """Admit coloured noise of the sensors whose innovations ask for it, and estimate again."""
    if not setting.colour:
        return found
    for _ in range(2):
        problem = found.problem
        has = np.zeros(len(setting.white), dtype=bool)
        has[problem.levels.coloured] = True
        asks = correlated(problem, found.point.unknowns) & ~has
        if not asks.any():
            break
        noise = problem.noise(found.point.unknowns)
        noise = replace(noise, colour=np.where(asks, 0.5 * noise.white, noise.colour))
        again = moved(found, setting, noise, has | asks, max_iterations=max_iterations)
        if again is None or found.objective - again.objective < WORTH_COLOUR:
            break
        found = again
    return _without_vanished_colour(found, setting, max_iterations)


def _without_vanished_colour(
    found: FilteredSolution, setting: Setting, max_iterations: int
) -> FilteredSolution:
    """Where the colour that was admitted vanishes, the white level is bounded or declared again."""
    noise = found.noise
    has = np.zeros(len(setting.white), dtype=bool)
    has[found.problem.levels.coloured] = True
    vanished = has & (noise.colour < VANISHED * setting.white)
    if not vanished.any():
        return found
    white = np.where(setting.estimated, np.maximum(noise.white, setting.least_white), setting.white)
    noise = replace(
        noise,
        white=np.where(vanished, white, noise.white),
        colour=np.where(vanished, 0.0, noise.colour),
    )
    again = moved(found, setting, noise, has & ~vanished, max_iterations=max_iterations)
    return found if again is None else again


def with_input_noise(found: FilteredSolution, setting: Setting) -> FilteredSolution:
    """Let noise on logged inputs in where the records ask for it, and estimate again.

    A logged angle is a measurement too: what moves the vehicle is the angle without the noise of
    its sensor, white from sample to sample.
    """
    noise = found.noise
    new = [place for place in setting.inputs if place.name not in noise.places]
    if not new:
        return found
    wide = replace(
        noise,
        force=np.append(noise.force, np.zeros(len(new))),
        force_time=np.append(noise.force_time, np.zeros(len(new))),
        places=(*noise.places, *(place.name for place in new)),
    )
    unit = found.problem.levels.unit
    unit = replace(
        unit,
        force=np.append(unit.force, np.ones(len(new))),
        force_time=1.0,
        places=wide.places,
    )
    coloured = noise.colour > 0
    own = not found.problem.levels.shares_a_time
    still = moved(found, setting, wide, coloured, own_times=own, max_iterations=0, unit=unit)
    if still is None:
        return found
    block = still.problem.layout.levels
    matrix, right = still.matrix[block, block], still.right[block]
    limits, here = still.problem.limits, still.point.unknowns[block]
    lower, upper = limits.lower[block] - here, limits.upper[block] - here
    matrix = matrix + np.diag(limits.prior_weight[block])
    step = bounded_step(matrix, right, lower, upper, 0.0)
    if 2.0 * right @ step - step @ matrix @ step < WORTH_COLOUR:
        return found
    level = np.sqrt(np.maximum(step, 0.0))
    begin = wide.force.copy()
    for (kind, index), size in zip(still.problem.levels.entries, level, strict=True):
        if kind == FORCE_VARIANCE and index >= len(noise.places):
            begin[index] = size
    asked = begin > 0
    asked[: len(noise.places)] = True
    begun = replace(
        wide,
        force=begin[asked],
        force_time=wide.force_time[asked],
        places=tuple(p for p, a in zip(wide.places, asked, strict=True) if a),
    )
    natural = np.where(np.arange(len(begin)) < len(noise.places), unit.force, begin)
    unit = replace(unit, force=natural[asked], force_time=1.0, places=begun.places)
    again = moved(found, setting, begun, coloured, own_times=own, unit=unit)
    if again is None or found.objective - again.objective < WORTH_COLOUR:
        return found
    # Noise that the log does not show is something else that the inputs happen to explain.
    most = setting.most_input
    levels = zip(again.noise.places, again.noise.force, strict=True)
    return found if any(level > most.get(place, np.inf) for place, level in levels) else again


def with_own_times(found: FilteredSolution, setting: Setting) -> FilteredSolution:
    """Give every disturbance a time of its own where that is clearly likelier."""
    problem = found.problem
    noise = problem.noise(found.point.unknowns)
    if (
        not problem.levels.shares_a_time
        or np.sum((noise.force > 0) & (noise.force_time > 0)) + problem.levels.n_coloured < 2
    ):
        return found
    coloured = noise.colour > 0
    again = moved(found, setting, noise, coloured, own_times=True, max_iterations=0)
    if again is None:
        return found
    right = again.right
    limits = again.problem.limits
    unknowns = again.point.unknowns
    step = bounded_step(
        again.matrix + np.diag(limits.prior_weight),
        right + limits.prior_weight * (limits.prior_mean - unknowns),
        limits.lower - unknowns,
        limits.upper - unknowns,
        0.0,
    )
    if 2.0 * float(right @ step) < WORTH_TIMES:
        return found
    freed = moved(found, setting, noise, coloured, own_times=True)
    if freed is None or found.objective - freed.objective < WORTH_TIMES:
        return found
    return freed


def correlated(problem: Filtered, unknowns: np.ndarray) -> np.ndarray:
    """Outputs whose neighbouring innovations are clearly correlated, ``(n_outputs,)``."""
    found = problem.passes(unknowns, columns=False)
    n_outputs = len(problem.model.outputs)
    lag_one, count = np.zeros(n_outputs), np.zeros(n_outputs)
    for record, part in zip(problem.records, found, strict=True):
        if record.independent:
            continue
        white = part.innovations / np.sqrt(part.variances)
        for column in range(n_outputs):
            seen = int(np.isfinite(white[:, column]).sum())
            if seen > 20:
                lag_one[column] += seen * float(autocorrelation(white[:, column], 1)[1])
                count[column] += seen
    share = lag_one / np.maximum(count, 1.0)
    return np.abs(share) > COLOURED / np.sqrt(np.maximum(count, 1.0))
