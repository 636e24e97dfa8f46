r"""Whether what disturbs a vehicle is a sea, and which: its period, width, shape and levels.

At the estimate with forces of first order, resonators (:mod:`oed_sysid.compiled.filtering`) are
admitted with variance zero in every equation at once. With the score ``s`` and the information
``I`` of everything unknown, resonators last,

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
and beside them once more whether waves are one, and of which shape. Where these show nothing at the
fit to white noise the same is asked there (:func:`sea_beside_white`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import compress

import numpy as np
from scipy.special import chdtrc, chdtri, comb

from oed_sysid.compiled.filtering import FOURTH, SHAPES
from oed_sysid.likelihood.between_records import CHANCE, FEWEST
from oed_sysid.likelihood.filtered import NEXT_PERIOD, Filtered
from oed_sysid.likelihood.gauss_newton import FEW, FIRST_STEPS, NEAR, FilteredSolution
from oed_sysid.likelihood.noise_model import STEPS_OF_PERIOD, NoiseModel, Sea
from oed_sysid.likelihood.noise_parts import (
    DECADES,
    WORTH,
    admitted,
    begun,
    fall,
    first_home,
    joined,
    more_unknowns,
    solved,
    white_innovations,
    with_own_times,
)
from oed_sysid.likelihood.score_test import TIMES, Scored, ScoreTest, Setting, Start, moved, posed
from oed_sysid.likelihood.smoother import smoothable

# Probability, where no sea acts, of a look at one output that leads to the test of a period: at a
# tenth of it a weak sea of few waves is missed in two of ten records, doubled the test is asked at
# half of the periods.
LOOK = 0.05


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
    least = float(chdtri(more_unknowns(found, problem), CHANCE))
    begin = moved(found, problem, 0)
    if fall(found, begin) + 2.0 * begin.promise < least:
        return found
    again = moved(found, problem, setting.max_iterations)
    broad = any(sea.is_broad for sea in again.noise.seas)  # too few waves of a record tell one
    return found if broad or fall(found, again) < least else again


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
    return fall(rival, sea) - 2.0 * rival.promise >= 2.0 * WORTH


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
    for record, white in white_innovations(found.problem, found.point.unknowns):
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
    near = first_home(tried, partial(solved, most=FIRST_STEPS - FEW, tolerance=NEAR))
    if near.finite is None:
        return near
    noise, free = near.noise, replace(known, shape=None)
    shaped = [replace(noise.seas[0], shape=shape) for shape in shapes]
    looked = [again(near, replace(noise, seas=(one,)), free, FEW) for one in shaped]

    to_the_end = partial(solved, most=setting.max_iterations)
    best = first_home(looked, to_the_end)
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


def beside_a_sea(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """Forces of first order beside a sea."""
    sample = min(record.sample_time for record in found.problem.records)
    rest = [place for place in setting.at_sea if place not in found.noise.places]
    times, known = [count * sample for count in TIMES], [Sea()] * len(found.noise.seas)
    return joined(found, setting, rest, times, known)


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
