r"""From a white fit to the likelihood of innovations: which noise, how strong, with the rest.

What :mod:`oed_sysid.likelihood.score_test` finds is where levels begin. Whether a sea acts is asked
next, then one forward search (:func:`admitted`) over the other parts of the noise model: each is
proposed where a cheap statistic asks for it, estimated with everything else, and stays at one
price.

*Is what disturbs a vehicle a sea?* At the estimate with forces of first order, resonators
(:mod:`oed_sysid.compiled.filtering`) are admitted with variance zero in every equation at once.
With the score ``s`` and the information ``I`` of everything unknown, resonators last,

.. math:: T = \max_{d \ge 0} (2 s' d - d' I d) - \max_{d_r = 0} (2 s' d - d' I d)

is what their variances ``d_r`` would gain in twice the log-likelihood, parameters and levels of
first order projected out. Its largest value over a grid of periods is held against the
:math:`\bar\chi^2` distribution of as many variances at their bound (Silvapulle & Sen 2005,
*Constrained statistical inference*, ch. 3), each period a test of its own.

A period is tested where the spectrum of the innovations may show more than white noise about it
(:func:`_in_spectrum`). At zero most of ``s`` and ``I`` is of the slow part of a force, which start
states and parameters have followed: where ``T`` is below, what the likelihood gains at growing
levels stands for it (:func:`_likeliest_sea`), no more than everything together would gain. Where
either is beyond, resonators are estimated *instead* of the forces, first at the period of the test,
then with everything together; three shapes compete, and the sea stays where it is clearly likelier,
or is beside them. Forces of first order on top are asked last, because a wrong shape lets them in,
and beside them once more whether waves are one, and of which shape.
Where these show nothing at the fit to white noise the same is asked there
(:func:`sea_beside_white`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import compress

import numpy as np
from scipy.special import chdtrc, chdtri, comb

from oed_sysid.compiled.filtering import FORCE_VARIANCE, FOURTH, SHAPES
from oed_sysid.data.record import Record
from oed_sysid.likelihood.between_records import CHANCE, FEWEST, WORTH_TELLING
from oed_sysid.likelihood.departures import TWOFOLD
from oed_sysid.likelihood.estimate import once_a_fit
from oed_sysid.likelihood.filtered import NEXT_PERIOD, Filtered
from oed_sysid.likelihood.gauss_newton import (
    FEW,
    FIRST_STEPS,
    FROZEN_TOLERANCE,
    MOST_DAMPING,
    NEAR,
    Convergence,
    Descent,
    FilteredSolution,
    Iterate,
    Progress,
    StepControl,
    differentiated,
    restricted,
    solve_filtered,
    whitened,
)
from oed_sysid.likelihood.information import autocorrelation
from oed_sysid.likelihood.noise_levels import credible_levels
from oed_sysid.likelihood.noise_model import STEPS_OF_PERIOD, NoiseModel, Sea
from oed_sysid.likelihood.score_test import TIMES, Scored, ScoreTest, Setting, Start, moved, posed
from oed_sysid.likelihood.shooting import Point
from oed_sysid.likelihood.smoother import smoothable
from oed_sysid.runtime.constants import BEYOND

# Gain in twice the log-likelihood from which another kind of noise is worth its freedom; twice that
# of a sea, whose choice among periods and shapes may be worth two or three nats, and of one wave in
# several places, each of which adds a phase and a share. Below, two starts are one.
WORTH = 10.0
# Decades above these levels that are climbed for the likeliest, and the stride of the climb: where
# a model hardly damps what disturbs it, records tell of levels far below those that act.
DECADES, STRIDE = 21, 3
# Probability, where no sea acts, of a look at one output that leads to the test of a period: at a
# tenth of it a weak sea of few waves is missed in two of ten records, doubled the test is asked at
# half of the periods.
LOOK = 0.05
# Ends from which no search goes on.
HOME = ("converged", "diverged")
# Gives the problem with another part of the noise unknown, or None where nothing asks for it.
Proposal = Callable[[FilteredSolution, Setting], Filtered | None]


def begun(problem: Filtered, unknowns: np.ndarray) -> Iterate:
    """A problem begun at some unknowns, of which the cost alone is evaluated."""
    return differentiated(problem, Point(unknowns, ()))


def solved(
    begin: Iterate | FilteredSolution,
    most: int,
    progress: Callable[[Progress], None] | None = None,
    *,
    tolerance: float = FROZEN_TOLERANCE,
    polish: int = 0,
) -> FilteredSolution:
    """The end of at most so many steps at frozen gain, and of those of the filter as it is.

    Where a solution ended the steps go on from what is known there.
    """
    return solve_filtered(
        begin.problem,
        begin.point,
        max_iterations=most,
        tolerance=tolerance,
        polish=polish,
        callback=progress,
        begin=begin.now if isinstance(begin, FilteredSolution) else None,
    )


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


# -- where it begins ---------------------------------------------------------------


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


def climbed(objective: Callable[[int], float]) -> int:
    """The decade of all levels up to which strides make records likelier.

    There may be several valleys where values are far off.
    """
    best = 0
    for decade in range(0, DECADES + 1, STRIDE):
        if objective(decade) < objective(best) - 1.0:
            best = decade
        elif np.isfinite(objective(best)) and (best or not np.isfinite(objective(decade))):
            break
    return best


def likeliest_decade(objective: Callable[[int], float], best: int = 0) -> int:
    """The likeliest decade of all levels next to one, while likelier."""
    for way in (-1, 1):
        while objective(best + way) < objective(best) - 1.0 and best <= DECADES:
            best += way
    return best


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
    return _first_home(
        [solved(one, min(FEW, most), progress) for one in apart],
        lambda one: solved(one, most, progress),
    )


def _first_home(
    looked: Sequence[FilteredSolution],
    on: Callable[[FilteredSolution], FilteredSolution],
) -> FilteredSolution:
    """The likeliest of some ends; after the leader only what promises to overtake goes on."""
    leader, *others = sorted(looked, key=lambda one: one.restricted)
    best = leader if leader.reason in HOME else on(leader)
    for one in others:
        if one.restricted - one.promise < best.restricted:
            end = one if one.reason in HOME else on(one)
            best = min(best, end, key=lambda one: one.restricted)
    return best


# -- parts of the noise model --------------------------------------------------------


def admitted(
    found: FilteredSolution, setting: Setting, parts: Mapping[Proposal, float | None] | None = None
) -> FilteredSolution:
    """Forward search over parts of the noise model, each estimated with everything else.

    A part stays where the restricted likelihood pays its price. Of what nothing is claimed that is
    the weight of its unknowns (Akaike 1974, *A new look at the statistical model identification*,
    IEEE Trans. Automatic Control 19, 716).

    Parameters
    ----------
    found : FilteredSolution
    setting : Setting
    parts : mapping, optional
        Prices of parts, in twice the log-likelihood, None for the weight of their unknowns, by what
        proposes them: this gives the problem with the part, again while that stays, or None where
        nothing asks for it. By default :data:`PARTS`.
    """
    for propose, price in (parts or PARTS).items():
        while problem := propose(found, setting):
            least = 2.0 * _more(found, problem) if price is None else price
            again = moved(found, problem, FEW)
            # Only what promises to pay goes on.
            if again.reason not in HOME and _fall(found, again) + 2.0 * again.promise >= least:
                again = solved(again, setting.max_iterations - FEW)
            if not _is_shown(again.noise, setting) or _fall(found, again) < least:
                break
            found = again
    return found


def _more(found: FilteredSolution, problem: Filtered) -> int:
    """How many unknowns more the noise of a problem has."""
    return len(problem.levels) - len(found.problem.levels)


def _fall(found: FilteredSolution, again: FilteredSolution) -> float:
    """By how much a later fit is likelier, in twice the restricted log-likelihood."""
    return 2.0 * (found.restricted - again.restricted)


def _is_shown(noise: NoiseModel, setting: Setting) -> bool:
    """Whether no noise of a logged input is larger than the log shows.

    It would be something else that the input happens to explain.
    """
    levels = zip(noise.places, noise.force, strict=True)
    return all(level <= setting.most_input.get(place, np.inf) for place, level in levels)


def _joined(
    found: FilteredSolution,
    setting: Setting,
    places: Sequence[str],
    times: Sequence[float],
    known: Sequence[Sea] | None = None,
) -> Filtered | None:
    """Forces at more places, of the time and size that the score says; None below the price."""
    if not places:
        return None
    noise, unit = found.noise, found.problem.levels.unit
    new = [place for place in places if place not in unit.places]
    unit = unit.with_places(new, 1.0, 1.0)

    def score(time: float) -> tuple[float, np.ndarray, float]:
        wide = posed(found, setting, noise.with_places(places, time), unit=unit, seas=known)
        return *_scored(found).gain(wide, [f"{place} level" for place in places]), time

    gain, variances, time = max(map(score, times), key=lambda one: one[0])
    if gain < WORTH:
        return None
    begin = noise.with_places(places, time, np.sqrt(variances))
    # What joins has the size that the score says.
    sizes = dict(zip(unit.places, unit.force, strict=True))
    sizes |= {p: f for p, f in zip(begin.places, begin.force, strict=True) if p in new and f > 0}
    unit = replace(unit, force=np.array([sizes[place] for place in unit.places]))
    # What does not act at first may act for another time.
    asked = (begin.force > 0) | (begin.force_time > 0)
    asked[: len(noise.places)] = True
    return posed(found, setting, begin.only(asked), unit=unit, seas=known)


@once_a_fit
def _scored(found: FilteredSolution) -> Scored:
    """The end of an estimation, at which several parts are asked for."""
    return Scored.at(found)


def _autocorrelated(found: FilteredSolution) -> np.ndarray:
    """Outputs that may have autocorrelated noise."""
    return np.isin(np.arange(len(found.noise.white)), found.problem.levels.coloured)


def autocorrelated_sensors(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """Autocorrelated noise of the sensors whose innovations ask for it."""
    has = _autocorrelated(found)
    asks = setting.colour & correlated(found.problem, found.point.unknowns) & ~has
    if not asks.any():
        return None
    noise = found.noise
    # Away from zero, where a level would have no slope in its time.
    noise = replace(noise, colour=np.where(asks, 0.5 * noise.white, noise.colour))
    return posed(found, setting, noise, has | asks, own_times=False)


def zeros_of_sensors(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """Constants by which sensors are off in each record, in the place of autocorrelated noise.

    Where one is off none is trusted to less than its noise: an error that the records hardly tell
    from a derivative bends that, and its interval would not hold.
    """
    noise, has = found.noise, _autocorrelated(found)
    if not setting.any_zero or noise.zeros.any():
        return None
    off = replace(_alone(noise, has, setting), colour_time=np.inf)
    sizes = noise.colour
    if not has.any():
        names = [f"colour of {name} level" for name in noise.outputs]
        gain, variances = _scored(found).gain(posed(found, setting, off, ~has), names)
        if gain < WORTH:
            return None
        sizes = np.sqrt(variances)
    sized = replace(off, colour=np.maximum(sizes, off.white))
    return posed(found, setting, sized, own_times=False)


def _alone(noise: NoiseModel, which: np.ndarray, setting: Setting) -> NoiseModel:
    """Some sensors without autocorrelated noise, their white noise bounded or declared again."""
    white = np.where(setting.estimated, np.maximum(noise.white, setting.least_white), setting.white)
    return replace(
        noise,
        white=np.where(which, white, noise.white),
        colour=np.where(which, 0.0, noise.colour),
    )


def sensors_for_forces(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """Autocorrelated noise of every sensor in the place of forces.

    Forces are estimated first, and have then grown to explain what is correlated at the sensors.
    """
    noise = found.noise
    if noise.seas or not (_autocorrelated(found).any() and np.any(noise.force > 0)):
        return None
    large = np.maximum(noise.colour, setting.white)
    alone = replace(noise, force=np.zeros_like(noise.force), colour=large)
    return posed(found, setting, alone)


def without_vanished(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """White noise, bounded or declared again, of sensors whose autocorrelated noise vanishes."""
    noise, has = found.noise, _autocorrelated(found)
    vanished = has & (noise.colour < 0.02 * setting.white)
    if not vanished.any():
        return None
    noise = _alone(noise, vanished, setting)
    return posed(found, setting, noise, has & ~vanished, own_times=False)


def noisy_inputs(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """Noise on logged inputs.

    A logged angle is a measurement too: what moves the vehicle is the angle without the noise of
    its sensor, white from sample to sample.
    """
    new = [place.name for place in setting.inputs if place.name not in found.noise.places]
    return _joined(found, setting, new, [0.0])


def inputs_for_forces(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """Noise of logged inputs in the place of forces.

    Forces in the equations in which an input acts explain most of its noise, so that it adds
    little to them; alone it has fewer unknowns, and one signal moves all these equations.
    """
    noise, most = found.noise, setting.most_input
    inputs = [place.name for place in setting.inputs if np.isfinite(most[place.name])]
    if noise.seas or not (inputs and np.any(noise.force > 0)) or {*inputs} & {*noise.places}:
        return None
    shown = [most[place] / TWOFOLD for place in inputs]
    alone = noise.only(np.isin(noise.places, setting.known)).with_places(inputs, 0.0, shown)
    problem = posed(found, setting, alone, own_times=False)
    return problem if _more(found, problem) < 0 else None


def with_own_times(found: FilteredSolution, setting: Setting) -> FilteredSolution:
    """Forces of several times where those are likelier; nothing is claimed of them."""
    return admitted(found, setting, {own_times: None})


def own_times(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """A time of its own for every disturbance that acts."""
    noise, levels = found.noise, found.problem.levels
    lasting = np.sum((noise.force > 0) & (noise.force_time > 0)) + len(levels.coloured)
    if not levels.shares_a_time or lasting < 2:
        return None
    problem = posed(found, setting, noise, own_times=True)
    problem = problem.posed(problem.levels.without_forces(noise.force == 0))
    return problem if moved(found, problem, 0).promise >= _more(found, problem) else None


def beside_a_sea(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """Forces of first order beside a sea."""
    sample = min(record.sample_time for record in found.problem.records)
    rest = [place for place in setting.at_sea if place not in found.noise.places]
    times, known = [count * sample for count in TIMES], [Sea()] * len(found.noise.seas)
    return _joined(found, setting, rest, times, known)


def one_wave(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """One wave that pushes all places of a sea, and what each has besides."""
    seas = found.noise.seas
    if len(seas) != 1 or seas[0].phases is not None or np.sum(seas[0].level > 0) < 2:
        return None
    return _waves(found, setting)


def _waves(found: FilteredSolution, setting: Setting, *, of_each_record: bool = False) -> Filtered:
    """A sea of one wave where it pushes several places, begun at forces that must have acted.

    Of these the coherence of two places and the phase between them are told by the strongest
    eigenvector of their correlations, as analytic signals. A sea of each record has levels in
    proportion to their size there.
    """
    from scipy.signal import hilbert  # takes a third of a second

    (whole,) = found.noise.seas
    sea, first = whole.only(whole.level > 0), len(found.noise.places)
    passes, paths = smoothable(found.problem, found.point.unknowns)
    # A wave and what a place has besides add up.
    processes = np.array([place for place, *_ in whole.processes])
    of_place, products = processes[:, None] == sea.places, []
    for part, path in zip(passes, paths, strict=True):
        acting = path.disturbances(part.innovations[:, :, None])[:, first:, 0]
        forces = hilbert(acting[:, : len(processes)] @ of_place, axis=0)
        products.append(forces.T @ forces.conj() / len(forces))
    usual, seas = np.mean(products, axis=0), []
    names = [(record.name,) for record in found.problem.records]
    for met, product in zip(names, products, strict=True) if of_each_record else [(None, usual)]:
        size, mean = (np.diag(one).real for one in (product, usual))
        share = np.sqrt(np.divide(size, mean, out=np.ones_like(size), where=mean > 0))
        own = replace(sea.with_levels(sea.level * share), records=met)
        seas.append(_in_phase(own, product) if len(sea.places) > 1 else own)
    return posed(found, setting, replace(found.noise, seas=tuple(seas)))


def _in_phase(sea: Sea, product: np.ndarray) -> Sea:
    """One wave in all places, of the phases and shares that products of analytic forces tell."""
    size = np.sqrt(np.diag(product).real)
    size[size == 0.0] = 1.0  # nothing shows it
    strengths, vectors = np.linalg.eigh(product / np.outer(size, size))
    common = vectors[:, -1] * np.exp(-1j * np.angle(vectors[0, -1]))
    share = np.minimum(np.sqrt(strengths[-1]) * np.abs(common), 1.0)
    return replace(
        sea,
        phases=dict(zip(sea.places, -np.angle(common), strict=True)),
        coherence=dict(zip(sea.places, share, strict=True)),
    )


def without_tails(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """Waves of the shape both parts of which have least of a tail at low frequencies."""
    seas, known = found.noise.seas, setting.sea
    if seas[0].phases is None or seas[0].shape == "jonswap" or (known and known.shape):
        return None
    noise = replace(found.noise, seas=tuple(replace(one, shape="jonswap") for one in seas))
    return posed(found, setting, noise)


# Parts in the order in which they are asked for, and their prices: noise of inputs that takes the
# place of forces may be less likely by what the unknowns that it has fewer weigh, and what has
# vanished always goes.
PARTS: Mapping[Proposal, float | None] = {
    autocorrelated_sensors: WORTH,
    zeros_of_sensors: WORTH,
    sensors_for_forces: WORTH,
    without_vanished: -np.inf,
    noisy_inputs: WORTH,
    inputs_for_forces: None,
}


def correlated(problem: Filtered, unknowns: np.ndarray) -> np.ndarray:
    """Outputs whose neighbouring innovations are clearly correlated, ``(n_outputs,)``."""
    n_outputs = len(problem.model.outputs)
    lag_one, count = np.zeros(n_outputs), np.zeros(n_outputs)
    for _, white in _whitened(problem, unknowns):
        for column in range(n_outputs):
            seen = int(np.isfinite(white[:, column]).sum())
            if seen > 20:
                lag_one[column] += seen * float(autocorrelation(white[:, column], 1)[1])
                count[column] += seen
    # Of white innovations it is normal, of variance one over their number (Bartlett 1946).
    share = lag_one / np.maximum(count, 1.0)
    return np.abs(share) > BEYOND / np.sqrt(np.maximum(count, 1.0))


def _whitened(problem: Filtered, unknowns: np.ndarray) -> Iterator[tuple[Record, np.ndarray]]:
    """Records that are series in time, and their innovations in standard deviations."""
    passes = problem.passes(unknowns, columns=False)
    for record, part in zip(problem.records, passes, strict=True):
        if not record.independent:
            yield record, part.innovations / np.sqrt(part.variances)


# -- a sea -------------------------------------------------------------------------


def threshold(n_forces: int, n_tests: int) -> float:
    """Value of the test that is exceeded with probability ``CHANCE`` where no sea acts.

    Of ``n_forces`` independent variances at their bound, ``k`` are positive in one of ``2^n``
    cases for each choice of them.

    >>> round(threshold(3, 8), 1), round(threshold(4, 8), 1)
    (13.0, 14.5)
    """
    from scipy.optimize import brentq  # a fifth of a second, which white fits do without

    count = np.arange(1, n_forces + 1)
    weights = comb(n_forces, count) / 2.0**n_forces
    return float(
        brentq(lambda value: weights @ chdtrc(count, value) - CHANCE / n_tests, 0.0, 200.0)
    )


def with_sea(
    found: FilteredSolution, setting: Setting, begin: Sequence[FilteredSolution] = ()
) -> FilteredSolution:
    """Take a sea for what disturbs the vehicle where the records show one, or one is declared.

    Of a declared one what it leaves out is estimated. A period that is left out is that of the
    likeliest of several ends, one for each peak of the test: with forces of first order a natural
    period of the vehicle may have moved onto the waves, and what is left then has the vehicle's.

    Parameters
    ----------
    found : FilteredSolution
        With forces of first order, near its end.
    setting : Setting
    begin : sequence of FilteredSolution
        Values to begin at, by default those found: under waves parameters may follow forces of
        first order where nothing leads back.

    Returns
    -------
    FilteredSolution
        The same one where no sea is clearly likelier.
    """
    known = setting.sea
    if known is None or found.noise.seas:
        return found
    places = known.places or setting.at_sea
    tried = [known.period] if known.period else _likely_periods(found, setting, places)
    if not (places and tried):
        return found
    seas = (known.filled(_calm(places, period)) for period in tried)
    ends = [_at_sea(found, setting, sea, known, begin or (found,)) for sea in seas]
    sea = min(ends, key=lambda one: one.restricted)
    if sea.finite is None:
        return found
    waves = admitted(sea, setting, {one_wave: 2.0 * WORTH})
    beside = cache(partial(admitted, setting=setting, parts={beside_a_sea: WORTH}))
    if not (setting.seas or _clearly_a_sea(sea, waves, found, setting, beside)):
        return found
    best = admitted(_of_each_record(waves, setting), setting, {without_tails: 0.0})
    while not setting.seas and (both := beside(best)) is not best:
        # What gusts took of waves, or waves of gusts, may have hidden that these are one.
        best = admitted(both, setting, {one_wave: 2.0 * WORTH, without_tails: 0.0})
    return best


def _of_each_record(found: FilteredSolution, setting: Setting) -> FilteredSolution:
    """A sea of its own for every record, where they are likelier than so many unknowns by chance.

    On other headings waves are met with another period, and push by other levels and phases.
    """
    records, known = found.problem.records, setting.sea
    told = known is not None and known.levels is not None
    if told or len(records) < 2 or any(record.independent for record in records):
        return found
    problem = _waves(found, setting, of_each_record=True)
    least = float(chdtri(_more(found, problem), CHANCE))
    begin = moved(found, problem, 0)
    if _fall(found, begin) + 2.0 * begin.promise < least:
        return found
    again = moved(found, problem, setting.max_iterations)
    broad = any(sea.is_broad for sea in again.noise.seas)  # too few waves of a record tell one
    return found if broad or _fall(found, again) < least else again


def _clearly_a_sea(
    sea: FilteredSolution,
    waves: FilteredSolution,
    found: FilteredSolution,
    setting: Setting,
    beside: Callable[[FilteredSolution], FilteredSolution],
) -> bool:
    """Whether a sea is clearly likelier than forces of first order, or is so beside them.

    Waves alone, in several places perhaps one, may explain less than gusts of like size, which may
    be of several times, too.
    """
    if _clearer(sea, found, setting):
        return True
    both = beside(waves)
    return both is not sea and _clearer(both, with_own_times(found, setting), setting)


def _clearer(sea: FilteredSolution, found: FilteredSolution, setting: Setting) -> bool:
    """Whether a sea is clearly likelier than what is without, and its width at no bound."""
    if sea.noise.seas[0].is_broad:
        return False  # as broad as that it is no wave
    # Held over the same shorter steps, these may be as likely.
    problem = posed(found, setting, found.noise, longest_hold=sea.noise.longest_hold)
    again = moved(found, problem, setting.max_iterations)
    rival = min(again, found, key=lambda one: one.restricted)
    return _fall(rival, sea) - 2.0 * rival.promise >= 2.0 * WORTH


def _likely_periods(
    found: FilteredSolution, setting: Setting, places: Sequence[str]
) -> list[float]:
    """Periods at which the test has a peak, s; none where no sea is declared and none shows."""
    tried, gains = _gains_at_sea(found, setting, places)
    if not tried:
        return [found.problem.records[0].duration / 8] if setting.seas else []
    beside = np.pad(gains, 1)
    peaks = (gains > beside[:-2]) & (gains >= beside[2:])
    peaks &= gains >= threshold(len(places), len(tried))
    if setting.seas and not peaks.any():
        return [tried[int(np.argmax(gains))]]
    return list(compress(tried, peaks))


def _gains_at_sea(
    found: FilteredSolution, setting: Setting, places: Sequence[str]
) -> tuple[list[float], np.ndarray]:
    """Periods that are tried, s, and what resonators of each would gain."""
    tried = periods(found) if places else []
    gains, calm = np.zeros(len(tried)), [_calm(places, period) for period in tried]
    asked = _in_spectrum(found, calm) | bool(setting.seas) if tried else gains > 0
    if not asked.any():
        return tried, gains
    sample = max(record.sample_time for record in found.problem.records)
    scored = cache(lambda count: Scored.at(found, sample / count))
    names = [f"sea {place} level" for place in places]
    least = threshold(len(places), len(tried))

    def gain(period: float, sea: Sea) -> float:
        noise, known = replace(found.noise, seas=(sea,)), [replace(sea, levels=None)]
        wide = posed(found, setting, noise, seas=known)
        # Held over as many steps of a sample as a wave needs: those of one number have one filter.
        steps = int(np.ceil(STEPS_OF_PERIOD * sample / period - 1e-6))
        shown = scored(max(steps, 1)).gain(wide, names)[0]
        # At zero most is told by the slow part of a force, which what is estimated has followed.
        return shown if shown >= least else _likeliest_sea(found, setting, found.noise, sea)[1]

    gains[asked] = [gain(*one) for one in compress(zip(tried, calm, strict=True), asked)]
    return tried, gains


def sea_beside_white(setting: Setting, start: Start, test: ScoreTest) -> float:
    """What a sea would gain at a fit to white noise, in twice the log-likelihood; 0 for none.

    Forces of first order are correlated in one sense at all lags. What waves leave changes its
    sense every half wave and may look like none of them.

    Parameters
    ----------
    setting : Setting
        With the white noise of the fit.
    start : Start
        Where it ended.
    test : ScoreTest
        What forces of first order and autocorrelated sensors would gain there.
    """
    levels = setting.levels(setting.dataset, test.quiet, test.unit)
    problem, unknowns = setting.problem(start, levels)
    found, places = FilteredSolution(begun(problem, unknowns), 0, "converged"), setting.at_sea
    tried, gains = _gains_at_sea(found, setting, places)
    most = float(gains.max(initial=0.0))
    return most if most > 0.0 and most >= threshold(len(places), len(tried)) else 0.0


def _in_spectrum(found: FilteredSolution, calm: Sequence[Sea]) -> np.ndarray:
    r"""Seas ``(n_seas,)`` of which the innovations of any output may show more than white noise.

    Vehicle and filter are linear here: a force with a period is in the innovations with the same.
    Of their periodogram :math:`I_j`, of mean one, and the power :math:`g_j` of a resonator

    .. math:: \nu \frac{\sum_j g_j I_j}{\sum_j g_j} \sim \chi^2_\nu, \quad
        \nu = 2 \frac{(\sum_j g_j)^2}{\sum_j g_j^2}

    about, where they are white (Satterthwaite 1946, *Biometrics Bulletin* 2, 110): a look that
    costs one pass of the filter in all, before a test that costs one for each.
    """
    power = weight = squares = 0.0
    for record, white in _whitened(found.problem, found.point.unknowns):
        seen = np.isfinite(white).sum(axis=0)
        ordinates = np.abs(np.fft.rfft(np.nan_to_num(white), axis=0)[1:]) ** 2
        hertz = np.fft.rfftfreq(len(white), record.duration / (len(white) - 1))[1:, None]
        apart = hertz * [one.period for one in calm]
        wide = (apart * [one.bandwidth for one in calm]) ** 2
        share = wide / ((1.0 - apart**2) ** 2 + wide)
        power = power + share.T @ (ordinates / np.maximum(seen, 1))
        weight = weight + share.sum(axis=0)[:, None] * (seen > 0)
        squares = squares + (share**2).sum(axis=0)[:, None] * (seen > 0)
    freedom = 2.0 * weight**2 / np.maximum(squares, np.finfo(float).tiny)
    chance = chdtrc(freedom, freedom * power / np.maximum(weight, np.finfo(float).tiny))
    return np.asarray(np.any(chance < LOOK, axis=1))


def periods(found: FilteredSolution) -> list[float]:
    """Periods of a sea that are tried, s."""
    records = [record for record in found.problem.records if not record.independent]
    shortest = FEWEST * max(record.sample_time for record in records)
    longest = min(record.duration for record in records) / 4  # four waves at least
    if longest < shortest:
        return []
    count = int(np.floor(np.log(longest / shortest) / np.log(NEXT_PERIOD))) + 1
    # Apart by a factor: a resonator sees its neighbours within its width, which is relative.
    return [float(one) for one in shortest * NEXT_PERIOD ** np.arange(count)]


def _calm(places: Sequence[str], period: float) -> Sea:
    """A sea of level zero."""
    return Sea(period, bandwidth=0.3, levels=dict.fromkeys(places, 0.0), shape="velocity")


def _at_sea(
    found: FilteredSolution,
    setting: Setting,
    sea: Sea,
    known: Sea,
    begin: Sequence[FilteredSolution],
) -> FilteredSolution:
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
    begin : sequence of FilteredSolution
        Values to begin at.
    """

    def again(one: FilteredSolution, noise: NoiseModel, known: Sea, most: int) -> FilteredSolution:
        """Some steps of a race, to where next to nothing is left; ``known`` is of the sea."""
        return moved(one, posed(one, setting, noise, seas=[known]), most, NEAR)

    first = found.noise
    # A force of first order and a sea in one place would share its variance: one at a time.
    rivals = np.setdiff1d(sea.places, setting.known)
    alone = first.only(~np.isin(first.places, rivals))
    if known.levels is None:
        sea, _ = _likeliest_sea(found, setting, alone, sea)
    # Everything else first, lest period and width follow its misfit.
    held = replace(known, period=sea.period, bandwidth=sea.bandwidth)
    shapes = [known.shape] if known.shape else [*SHAPES]
    # One of a resonator's shapes may lead off where the other leads straight on.
    pairs = [shape for shape in shapes if SHAPES[shape] != FOURTH] or shapes
    noises = [replace(alone, seas=(replace(sea, shape=shape),)) for shape in pairs]
    tried = [again(one, noise, held, FEW) for noise in noises for one in begin]
    near = _first_home(tried, partial(solved, most=FIRST_STEPS - FEW, tolerance=NEAR))
    if near.finite is None:
        return near
    noise, free = near.noise, replace(known, shape=None)
    shaped = [replace(noise.seas[0], shape=shape) for shape in shapes]
    looked = [again(near, replace(noise, seas=(one,)), free, FEW) for one in shaped]

    to_the_end = partial(solved, most=setting.max_iterations)
    best = _first_home(looked, to_the_end)
    return to_the_end(best) if best in looked else best


def _likeliest_sea(
    found: FilteredSolution, setting: Setting, noise: NoiseModel, sea: Sea
) -> tuple[Sea, float]:
    """The sea beside some noise with the likeliest of some levels, and its gain over none.

    In twice the log-likelihood, all else held. Levels are in proportion to those of first order, or
    where there are none to those of which the records begin to tell; half a decade follows the
    other up to where they are clearly too large.
    """
    unit = found.problem.levels.unit
    size = np.array([max(found.noise.level(p)[0], unit.level(p)[0]) for p in sea.places])

    def objective(one: Sea) -> float:
        wide, known = replace(noise, seas=(one,)), [replace(one, levels=None)]
        problem = posed(found, setting, wide, seas=known)
        return problem.objective(problem.beside(found.point.unknowns).unknowns)

    likeliest, least = sea, np.inf
    for half in range(-2, 2 * DECADES):
        one = sea.with_levels(0.6 * 10.0 ** (half / 2) * size)
        cost = objective(one)
        if cost < least:
            likeliest, least = one, cost
        elif not cost < least + WORTH:
            break
    return likeliest, objective(sea.with_levels(0.0 * size)) - least
