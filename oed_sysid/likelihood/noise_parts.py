"""Parts of a noise model: each is proposed, estimated with everything else, and stays at one price.

One forward search (:func:`admitted`): a part is proposed where a cheap statistic asks for it (a
score test, correlated innovations), estimated from where the fit without it ended, and stays where
the restricted likelihood pays its price. Before it stand the steps and races that this search, that
for a sea and the beginnings of a fit share.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from oed_sysid.data.record import Record
from oed_sysid.likelihood.departures import TWOFOLD
from oed_sysid.likelihood.estimate import once_a_fit
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.gauss_newton import (
    FEW,
    FROZEN_TOLERANCE,
    FilteredSolution,
    Iterate,
    Progress,
    differentiated,
    solve_filtered,
)
from oed_sysid.likelihood.information import autocorrelation
from oed_sysid.likelihood.noise_model import NoiseModel, Sea
from oed_sysid.likelihood.score_test import Scored, Setting, moved, posed
from oed_sysid.likelihood.shooting import Point
from oed_sysid.runtime.constants import BEYOND

# Gain in twice the log-likelihood from which another kind of noise is worth its freedom; twice that
# of a sea, whose choice among periods and shapes may be worth two or three nats, and of one wave in
# several places, each of which adds a phase and a share. Below, two starts are one.
WORTH = 10.0
# Decades above these levels that are climbed for the likeliest, and the stride of the climb: where
# a model hardly damps what disturbs it, records tell of levels far below those that act.
DECADES, STRIDE = 21, 3
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


def first_home(
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


# -- parts --------------------------------------------------------------------------


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
            least = 2.0 * more_unknowns(found, problem) if price is None else price
            again = moved(found, problem, FEW)
            # Only what promises to pay goes on.
            if again.reason not in HOME and fall(found, again) + 2.0 * again.promise >= least:
                again = solved(again, setting.max_iterations - FEW)
            if not _is_shown(again.noise, setting) or fall(found, again) < least:
                break
            found = again
    return found


def more_unknowns(found: FilteredSolution, problem: Filtered) -> int:
    """How many unknowns more the noise of a problem has."""
    return len(problem.levels) - len(found.problem.levels)


def fall(found: FilteredSolution, again: FilteredSolution) -> float:
    """By how much a later fit is likelier, in twice the restricted log-likelihood."""
    return 2.0 * (found.restricted - again.restricted)


def _is_shown(noise: NoiseModel, setting: Setting) -> bool:
    """Whether no noise of a logged input is larger than the log shows.

    It would be something else that the input happens to explain.
    """
    levels = zip(noise.places, noise.force, strict=True)
    return all(level <= setting.most_input.get(place, np.inf) for place, level in levels)


def joined(
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


def without_a_sea(found: FilteredSolution, setting: Setting) -> Filtered | None:
    """Autocorrelated noise of sensors alone, where a sea was found before that was asked for."""
    noise, has = found.noise, _autocorrelated(found)
    if setting.seas or not (noise.seas and has.any()):
        return None
    return posed(found, setting, replace(noise, seas=()), has, own_times=False)


def as_declared(found: FilteredSolution, setting: Setting) -> tuple[FilteredSolution, Setting]:
    """Sensors as loud as declared, where a level of its own is not worth a claim; and the setting.

    What shows in a log as noise from sample to sample may be quick motion.
    """
    declared = np.full(len(setting.white), np.nan) if setting.declared is None else setting.declared
    for column in np.flatnonzero(np.isfinite(declared)):
        own = np.arange(len(declared)) == column
        held = replace(
            setting,
            estimated=setting.estimated & ~own,
            white=np.where(own, declared, setting.white),
        )
        again = admitted(found, held, {partial(_held_again, own): -WORTH})
        if again is not found:
            found, setting = again, held
    return found, setting


def _held_again(own: np.ndarray, found: FilteredSolution, held: Setting) -> Filtered | None:
    """One sensor at the level of a setting that holds it; None where it is held, or remembers."""
    white = np.where(own, held.white, found.noise.white)
    problem = posed(found, held, replace(found.noise, white=white))
    return problem if more_unknowns(found, problem) < 0 else None


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
    return joined(found, setting, new, [0.0])


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
    return problem if more_unknowns(found, problem) < 0 else None


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
    return problem if moved(found, problem, 0).promise >= more_unknowns(found, problem) else None


# Parts in the order in which they are asked for, and their prices: noise of inputs that takes the
# place of forces may be less likely by what the unknowns that it has fewer weigh, a sea that is no
# longer worth its price goes, and what has vanished always does.
PARTS: Mapping[Proposal, float | None] = {
    autocorrelated_sensors: WORTH,
    without_a_sea: -2.0 * WORTH,
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
    for _, white in white_innovations(problem, unknowns):
        for column in range(n_outputs):
            seen = int(np.isfinite(white[:, column]).sum())
            if seen > 20:
                lag_one[column] += seen * float(autocorrelation(white[:, column], 1)[1])
                count[column] += seen
    # Of white innovations it is normal, of variance one over their number (Bartlett 1946).
    share = lag_one / np.maximum(count, 1.0)
    return np.abs(share) > BEYOND / np.sqrt(np.maximum(count, 1.0))


def white_innovations(
    problem: Filtered, unknowns: np.ndarray
) -> Iterator[tuple[Record, np.ndarray]]:
    """Records that are series in time, and their innovations in standard deviations."""
    passes = problem.passes(unknowns, columns=False)
    for record, part in zip(problem.records, passes, strict=True):
        if not record.independent:
            yield record, part.innovations / np.sqrt(part.variances)
