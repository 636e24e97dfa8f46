"""From a white fit to the likelihood of innovations: which noise, how strong, with the rest.

What :mod:`oed_sysid.likelihood.score_test` finds is where levels begin. Whether a sea acts is asked
next (:mod:`oed_sysid.likelihood.sea_search`), then one forward search over the other parts of the
noise model (:mod:`oed_sysid.likelihood.noise_parts`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import numpy as np

from oed_sysid.compiled.filtering import FORCE_VARIANCE
from oed_sysid.likelihood.between_records import WORTH_TELLING
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.gauss_newton import (
    FEW,
    FIRST_STEPS,
    MOST_DAMPING,
    NEAR,
    Convergence,
    Descent,
    FilteredSolution,
    Iterate,
    Progress,
    StepControl,
    restricted,
    solve_filtered,
    whitened,
)
from oed_sysid.likelihood.noise_levels import credible_levels
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.noise_parts import (
    STRIDE,
    WORTH,
    admitted,
    as_declared,
    begun,
    climbed,
    first_home,
    likeliest_decade,
    solved,
    with_own_times,
)
from oed_sysid.likelihood.score_test import ScoreTest, Setting, Start
from oed_sysid.likelihood.sea_search import with_sea
from oed_sysid.likelihood.shooting import Point


def fit_disturbed(
    setting: Setting,
    starts: Sequence[Start],
    test: ScoreTest,
    *,
    polish: int = FIRST_STEPS,
    progress: Callable[[Progress], None] | None = None,
) -> FilteredSolution:
    """Estimate parameters, start states and noise together.

    Colour of sensors is admitted only where innovations without it are correlated from
    sample to sample; disturbances share one correlation time unless times of their own
    are likelier by the weight of these unknowns. Nothing is claimed of a time, and one
    for all leaves stated errors too small where they differ.

    Parameters
    ----------
    setting : Setting
        With the model and the records.
    starts : sequence of Start
        Values and start states to begin at; the likeliest wins.
    test : ScoreTest
        Where levels begin.
    polish : int
        See :func:`~oed_sysid.likelihood.gauss_newton.solve_filtered`.
    progress : callable, optional
    """
    beginnings = _beginnings(setting, starts, test)
    stayed = _stayed(beginnings, starts)
    best = stayed or _raced_to_sea(beginnings, setting, progress)
    if best.finite is None:
        return best
    best, setting = as_declared(best, setting)
    best = admitted(best, setting)
    apart = with_own_times(best, setting)
    if apart is stayed or not polish:
        return apart
    end = _polished(apart, polish)
    # What frozen gains leave is more than this price: a part that ends nowhere was none.
    return end if apart is best or end.reason == "converged" else _polished(best, polish)


def _beginnings(setting: Setting, starts: Sequence[Start], test: ScoreTest) -> list[Iterate]:
    """Every start with every noise to begin with; one whose noise is given only with that."""
    begun_at = [
        (start, _begun(setting, start, noise, test.unit))
        for count, noise in enumerate(_noises(setting, test))
        for start in starts
        if not count or start.noise is None
    ]
    # Beside those whose levels were looked for, given ones count only where they are likelier.
    least = min(one.cost for _, one in begun_at)
    return [one for start, one in begun_at if start.noise is None or not one.cost > least]


def _noises(setting: Setting, test: ScoreTest) -> list[NoiseModel]:
    """Noise to begin with: as declared and tested, and with sensors as loud as they show."""
    free = ~np.isin(test.noise.places, setting.known)
    begin = replace(
        test.noise,
        colour=np.zeros_like(test.noise.colour),
        force=np.maximum(test.noise.force, np.where(free, test.unit.force, 0.0)),
    )
    # Levels that are to be estimated begin at what was declared. Where that is far below the
    # high-frequency content, forces that follow every wiggle seem likely, and parameters follow
    # the forces: there levels begin at what these show, too.
    shown, seen = credible_levels(setting.dataset)
    loud = setting.estimated & seen & (shown > WORTH_TELLING * begin.white)
    louder = replace(begin, white=np.where(loud, shown, begin.white))
    return [begin, louder] if loud.any() else [begin]


def _raced_to_sea(
    beginnings: Sequence[Iterate], setting: Setting, progress: Callable[[Progress], None] | None
) -> FilteredSolution:
    """The likeliest end with forces of first order, or with a sea where there is one."""
    best = _raced(beginnings, min(setting.max_iterations, FIRST_STEPS), progress)
    if best.finite is not None:
        starts = (FilteredSolution(one, 0, "iterations") for one in beginnings)
        best = with_sea(best, setting, (best, *starts))
    left = setting.max_iterations - FIRST_STEPS
    if best.reason != "iterations" or left <= 0:
        return best
    again = solved(best, left, progress)
    return replace(again, iterations=best.iterations + again.iterations)


def _polished(found: FilteredSolution, polish: int) -> FilteredSolution:
    """The end by the exact gradient, which has the last word only where it finds a way."""
    more = 0 if found.reason == "converged" else FEW
    again = solved(found, more, polish=polish)
    stood = not more and again.reason == "iterations"
    reason = found.reason if stood else again.reason
    return replace(again, iterations=again.iterations + found.iterations, reason=reason)


def _begun(setting: Setting, start: Start, begin: NoiseModel, unit: NoiseModel) -> Iterate:
    """The likeliest levels, again after some steps of everything else; or those of an earlier fit.

    Levels and time would otherwise first follow the misfit of wrong values, and then come back.
    """
    own = begin if start.noise is None else _carried(begin, start.noise, setting)
    problem, unknowns = setting.problem(start, setting.levels(setting.dataset, own, unit))
    if start.noise is not None:
        return begun(problem, unknowns)
    first = _likeliest_level(problem, unknowns, begin)
    levels = problem.levels.starting(problem.noise(first.point.unknowns)).held()
    held = problem.posed(levels)
    found = solve_filtered(held, held.beside(unknowns), max_iterations=2, polish=0)
    later = _likeliest_level(problem, found.point.unknowns, levels.noise, climb=False)
    return min(first, later, key=lambda one: one.cost)


def _likeliest_level(
    problem: Filtered, others: np.ndarray, begin: NoiseModel, *, climb: bool = True
) -> Iterate:
    r"""Point with the likeliest level of each force at given other unknowns.

    The likelihood is flat where the levels do nothing yet, rises, and falls where they are too
    large: strides find the valley of all together, if they are to ``climb``. There each variance
    follows its own score by the expected information, all else held,

    .. math:: d \leftarrow d + I^{-1} s ,

    exact in one step where noise of that shape is all there is (Fisher's scoring), because where
    values are far off nothing tells the proportions that the levels begin with.
    """
    forces = [index for kind, index in problem.levels.entries if kind == FORCE_VARIANCE]
    start = problem.layout.levels.start
    # These come first among the levels.
    variances = slice(start, start + len(forces))
    stride = 10.0 ** (2 * STRIDE)

    def at(decade: int) -> np.ndarray:
        force = begin.force.copy()
        force[forces] *= 10.0**decade
        return problem.beside(others, replace(begin, force=force)).unknowns

    def these(
        unknowns: np.ndarray, matrix: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of a step: of these variances a stride, of all else none."""
        least, most = np.zeros_like(lower), np.zeros_like(upper)
        most[variances] = (stride - 1.0) * unknowns[variances]
        least[variances] = (1.0 / stride - 1.0) * unknowns[variances]
        return np.maximum(lower, least), np.minimum(upper, most)

    objective = cache(lambda decade: problem.objective(at(decade)))
    decade = climbed(objective) if climb else 0
    if len(forces) < 2:  # no proportions: single decades tell it as well
        return begun(problem, at(likeliest_decade(objective, decade)))
    evaluate = partial(whitened, levels_only=True)
    first = evaluate(problem, Point(at(decade), ()))
    control = StepControl(FEW, MOST_DAMPING)
    descent = Descent(first, evaluate, Convergence(0.5), control, these)
    descent.run(FIRST_STEPS)
    return descent.lowest


def _carried(begin: NoiseModel, earlier: NoiseModel, setting: Setting) -> NoiseModel:
    """Levels and times of an earlier fit at the places that both know."""
    force, time = begin.force.copy(), begin.force_time.copy()
    for index, place in enumerate(begin.places):
        if place not in setting.known and place in earlier.places:
            level, lasting = earlier.level(place)
            force[index] = max(level, force[index])
            time[index] = lasting or time[index]
    coloured = setting.colour & (earlier.colour > 0)
    found = replace(
        begin,
        seas=earlier.seas,
        white=np.where(setting.estimated | coloured, earlier.white, begin.white),
        colour=np.where(coloured, earlier.colour, 0.0),
        colour_time=np.where(coloured, earlier.colour_time, begin.colour_time),
        force=force,
        force_time=time,
    )
    if not earlier.seas:
        return found
    # Instead of forces of first order, but for those that joined them.
    return found.only(np.isin(begin.places, (*earlier.places, *setting.known)))


def _stayed(beginnings: Sequence[Iterate], starts: Sequence[Start]) -> FilteredSolution | None:
    """The beginning itself, where an earlier fit ended and steps promise next to nothing."""
    if len(beginnings) > 1 or starts[0].noise is None:
        return None
    begin = beginnings[0]
    ended = FilteredSolution(restricted(begin.problem, begin.point), 0, "converged")
    stays = ended.finite is not None and ended.promise <= NEAR
    return replace(ended, now=ended.now.kept(begin.cost)) if stays else None


def _raced(
    beginnings: Sequence[Iterate], most: int, progress: Callable[[Progress], None] | None
) -> FilteredSolution:
    """The likeliest end from several beginnings, the leader after a first look first.

    Where a beginning arrives at the same likelihood as another, they are one.
    """
    apart: list[Iterate] = []
    for one in sorted(beginnings, key=lambda one: one.cost):
        if not apart or 2.0 * (one.cost - apart[-1].cost) > WORTH:
            apart.append(one)
    if len(apart) == 1:
        return solved(apart[0], most, progress)
    return first_home(
        [solved(one, min(FEW, most), progress) for one in apart],
        lambda one: solved(one, most, progress),
    )
