r"""Do random forces act, which, how strongly: from a white fit to the likelihood of innovations.

At a fit that takes residuals for white noise, every disturbance has variance zero. There the
likelihood has a slope ``s`` and an information ``I`` in each variance, and

.. math:: T = \max_{d \ge 0}\; 2 s' d - d' I d

is what letting them in would gain in twice the log-likelihood (Silvapulle & Sen 2005,
*Constrained statistical inference*, ch. 3). White data stay below 2 in 99 of 100 records; above
``CLEAR`` disturbances are let in and estimated with everything else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.compiled.filtering import (
    COLOUR_VARIANCE,
    FORCE_VARIANCE,
    WHITE_VARIANCE,
    FilterKernel,
)
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import SimulationError
from oed_sysid.fitting.filtered import Filtered
from oed_sysid.fitting.gauss_newton import (
    POLISH_STEPS,
    FilteredSolution,
    Progress,
    solve_filtered,
)
from oed_sysid.fitting.noise_levels import credible_levels
from oed_sysid.fitting.shooting import Point
from oed_sysid.fitting.unknowns import KnownStarts
from oed_sysid.information import autocorrelation
from oed_sysid.model import Model
from oed_sysid.noise.disturbances import DISTURBANCE, Place, disturbance
from oed_sysid.noise.levels import LONGEST, SHORTEST, Levels
from oed_sysid.noise.model import NoiseModel
from oed_sysid.projection import bounded_step

# Correlation times that are tried, in samples.
TIMES = (5.0, 20.0, 60.0)
# Gain in twice the log-likelihood from which disturbances count as real, and from which a
# colour of a sensor, or a time of its own for each disturbance, is worth its freedom.
CLEAR, WORTH_COLOUR, WORTH_TIMES = 6.0, 10.0, 12.0
# Correlation of neighbouring innovations, in standard errors, that asks for a coloured sensor.
COLOURED = 4.0
# Share of the white level seen in the fastest wiggles that an estimate must leave standing.
LEAST_SEEN = 0.7
# ... and the share of that where a sensor is coloured.
COLOUR_SEEN = 0.1
# Colour below this share of the white level has vanished.
VANISHED = 0.02
# Where a level that is let in begins at least, in its natural unit.
LEAST_START = 1.0
# Decades above these levels that are climbed for the likeliest, and the stride of the climb: where
# a model hardly damps what disturbs it, records tell of levels far below those that act.
DECADES, STRIDE = 21, 3
# Steps of everything else before levels move too.
HELD_STEPS = 2
# Iterations after which a further start is given up unless it promises to overtake.
FIRST_LOOK = 3
# Samples from the start of each record that give the sizes of disturbances where the model on
# its own leaves the numbers later.
HEADS = (100, 30, 10)


@dataclass(frozen=True, eq=False)
class Setting:
    """What stays the same while noise is looked for.

    Attributes
    ----------
    places : tuple of Place
        Where disturbances may act.
    white : ndarray (n_outputs,)
        White levels to begin with.
    estimated : ndarray of bool (n_outputs,)
        Which of these are unknown.
    least_white : ndarray (n_outputs,)
        What the fastest wiggles show is there, whatever disturbances could explain of it.
    colour : bool
        Whether sensors may have coloured noise.
    inputs : tuple of Place
        Logged inputs, which may be noisy: white from sample to sample, let in where it pays.
    known : tuple of str
        Places whose level and time are known.
    known_starts : KnownStarts or None
        Start states that are held or known with a stated error.
    """

    places: tuple[Place, ...]
    white: np.ndarray
    estimated: np.ndarray
    least_white: np.ndarray
    colour: bool = True
    inputs: tuple[Place, ...] = ()
    known: tuple[str, ...] = ()
    known_starts: KnownStarts | None = None

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        places: Sequence[Place],
        white: np.ndarray,
        estimated: np.ndarray,
        *,
        colour: bool = True,
        inputs: Sequence[Place] = (),
        known: Sequence[str] = (),
        known_starts: KnownStarts | None = None,
    ) -> Setting:
        """Setting of some records."""
        floor, seen = credible_levels(dataset)
        least = np.where(seen, LEAST_SEEN * np.minimum(floor, white), 0.0)
        return cls(
            tuple(places),
            white,
            estimated,
            least,
            colour,
            tuple(inputs),
            tuple(known),
            known_starts,
        )

    @property
    def disturbances(self) -> tuple[str, ...]:
        """Parameters of the filtered model that may be disturbances."""
        own = (place for place in self.inputs if place not in self.places)
        return tuple(disturbance(place).name for place in (*self.places, *own))

    def times(self, dataset: Dataset) -> tuple[float, float]:
        """Shortest and longest correlation time, s."""
        shortest = SHORTEST * min(record.sample_time for record in dataset)
        return shortest, max(LONGEST * min(record.duration for record in dataset), 4.0 * shortest)

    def noise(self, model: Model, time: float) -> NoiseModel:
        """White noise, and disturbances of zero level."""
        nothing = np.zeros_like(self.white)
        return NoiseModel(
            self.white,
            nothing,
            np.zeros(len(self.places)),
            time,
            np.array([0.0 if place.stage == "actuator" else time for place in self.places]),
            model.output_names,
            tuple(place.name for place in self.places),
        )

    def levels(
        self,
        dataset: Dataset,
        noise: NoiseModel,
        unit: NoiseModel,
        colour: np.ndarray,
        *,
        own_times: bool = False,
    ) -> Levels:
        """Unknown levels, begun at a noise model, some outputs coloured."""
        known = dict(zip(unit.places, unit.force, strict=True))
        sizes = [
            known.get(place, max(level, 1e-9))
            for place, level in zip(noise.places, noise.force, strict=True)
        ]
        return Levels.of(
            noise,
            # What a white fit leaves may be far above any sensor's noise, and so no unit of it.
            replace(
                unit,
                white=np.minimum(unit.white, self.white),
                force=np.array(sizes),
                force_time=1.0,
                places=noise.places,
            ),
            [f"{DISTURBANCE}{place.replace(' ', '_', 1)}" for place in noise.places],
            # Where colour is let in, the white level has to make room for it.
            white=self.estimated | colour,
            colour=colour,
            force=np.array([place not in self.known for place in noise.places], dtype=bool),
            own_times=own_times,
            # ... and most of the fastest wiggles may be its own.
            least_white=np.where(colour, COLOUR_SEEN, 1.0) * self.least_white,
            times=self.times(dataset),
        )


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """What letting disturbances in would gain at a white fit.

    Attributes
    ----------
    gain : float
        ``T``, in twice the log-likelihood.
    time : float
        Correlation time with the largest gain, s.
    noise : NoiseModel
        One-step estimate of all levels.
    unit : NoiseModel
        Natural size of every level: that of which the records begin to tell.
    """

    gain: float
    time: float
    noise: NoiseModel
    unit: NoiseModel


def score_test(
    model: Model,
    dataset: Dataset,
    setting: Setting,
    initial: Sequence[np.ndarray],
    local: Sequence[Mapping[str, float]],
    kernel: FilterKernel | None = None,
) -> ScoreTest:
    """Test at a white fit whether forces act or sensors are coloured.

    Parameters
    ----------
    model : Model
        At the fitted values.
    dataset : Dataset
    setting : Setting
    initial : sequence of ndarray (n_own,)
        Start states, per record.
    local : sequence of mapping
        Values of per-record parameters.
    kernel : FilterKernel, optional
        Of a larger model.
    """
    sample = float(np.median([record.sample_time for record in dataset]))
    best: ScoreTest | None = None
    for count in TIMES:
        found = _score_at(model, dataset, setting, initial, local, count * sample, kernel)
        if best is None or found.gain > best.gain:
            best = found
    assert best is not None
    if np.isfinite(best.gain):
        return best
    # The model on its own leaves the numbers: sizes from where it has not yet done so.
    for length in HEADS:
        heads = Dataset(tuple(_head(record, length) for record in dataset))
        found = _score_at(model, heads, setting, initial, local, TIMES[0] * sample, kernel)
        if np.isfinite(found.gain):
            return replace(found, gain=np.inf)
    raise SimulationError(
        f"Model {model.name!r} diverges within {HEADS[-1]} samples of the start of a record. "
        "Check signs and units of its values, or bound its parameters."
    )


def _head(record: Record, length: int) -> Record:
    """The first samples of a record."""
    part = slice(0, max(length, 5))
    return replace(
        record, times=record.times[part], inputs=record.inputs[part], outputs=record.outputs[part]
    )


def _score_at(
    model: Model,
    dataset: Dataset,
    setting: Setting,
    initial: Sequence[np.ndarray],
    local: Sequence[Mapping[str, float]],
    time: float,
    kernel: FilterKernel | None,
) -> ScoreTest:
    quiet = setting.noise(model, time)
    n_forces, n_outputs = len(quiet.force), len(quiet.white)
    one = replace(quiet, force=np.ones(n_forces), colour=quiet.white)
    levels = Levels.of(
        quiet,
        one,
        [disturbance(place).name for place in setting.places],
        white=np.ones(n_outputs, dtype=bool),
        colour=np.full(n_outputs, setting.colour),
        force=np.ones(n_forces, dtype=bool),
    )
    problem = Filtered(model, dataset, levels, kernel=kernel)
    point = problem.point(initial, local)
    found = problem.passes(point.unknowns)
    vast = ScoreTest(np.inf, time, quiet, one)
    if not all(part.ok for part in found):
        return vast
    matrix, right = problem.gathered(point.unknowns, found)
    variances = np.array(
        [k in (FORCE_VARIANCE, WHITE_VARIANCE, COLOUR_VARIANCE) for k, _ in levels.entries]
    )
    wanted = np.arange(problem.layout.n_unknowns)[problem.layout.levels][variances]
    matrix, right = matrix[np.ix_(wanted, wanted)], right[wanted]
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        return vast
    kinds = np.array([k for k, _ in levels.entries])[variances]
    white = kinds == WHITE_VARIANCE
    # White levels may fall to make room, and rise where nobody declared them.
    lower = np.where(white, -0.9, 0.0)
    upper = np.full(len(kinds), np.inf)
    upper[white] = np.where(setting.estimated, np.inf, 0.0)
    step = bounded_step(matrix, right, lower, upper, 0.0)
    alone = bounded_step(
        matrix, right, np.where(white, lower, 0.0), np.where(white, upper, 0.0), 0.0
    )
    gain = float(2 * right @ step - step @ matrix @ step)
    gain -= float(2 * right @ alone - alone @ matrix @ alone)
    # The variance of which the records begin to tell.
    natural = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    force = kinds == FORCE_VARIANCE
    colour = np.zeros(n_outputs)
    if setting.colour:
        colour = np.sqrt(np.maximum(step[kinds == COLOUR_VARIANCE], 0.0)) * quiet.white
    return ScoreTest(
        gain,
        time,
        replace(quiet, force=np.sqrt(np.maximum(step[force], 0.0)), colour=colour),
        replace(one, force=np.sqrt(natural[force])),
    )


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
        See :func:`~oed_sysid.fitting.gauss_newton.solve_filtered`.
    progress : callable, optional

    Returns
    -------
    FilteredSolution or None
        None where the filter leaves the numbers from every start.
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
    nowhere = np.zeros(len(setting.white), dtype=bool)
    begun = []
    for start in starts:
        levels = setting.levels(dataset, begin, unit, nowhere)
        problem = Filtered(
            model.with_values(dict(start.values)),
            dataset,
            levels,
            kernel=kernel,
            known_starts=setting.known_starts,
        )
        begun.append((problem, *_begun(problem, start, setting, begin)))
    best: FilteredSolution | None = None
    for problem, point, _ in sorted(begun, key=lambda one: one[2]):
        found = solve_filtered(
            problem,
            point,
            max_iterations=max_iterations if best is None else FIRST_LOOK,
            polish=0,
            callback=progress,
        )
        if found is None or best is None:
            best = best or found
            continue
        if found.cost - found.promise < best.cost and found.reason != "converged":
            found = solve_filtered(
                problem, found.point, max_iterations=max_iterations, polish=0, callback=progress
            )
        best = found if found is not None and found.cost < best.cost else best
    if best is None:
        return None
    best = with_colour(best, setting, max_iterations=max_iterations)
    best = with_input_noise(best, setting)
    best = with_own_times(best, setting)
    if polish:
        again = solve_filtered(best.problem, best.point, max_iterations=3, polish=polish)
        best = replace(again, iterations=again.iterations + best.iterations) if again else best
    return best


def _begun(
    problem: Filtered, start: Start, setting: Setting, begin: NoiseModel
) -> tuple[Point, float]:
    """The likeliest levels, again after some steps of everything else; and the objective.

    Levels and time would otherwise first follow the misfit of wrong values, and then come back.
    """
    point, objective = _likeliest_level(problem, start, setting, begin)
    held = Filtered(
        problem.model,
        problem.dataset,
        problem.levels.starting(problem.noise(point.unknowns)).held(),
        kernel=problem.kernel,
        known_starts=problem.known_starts,
    )
    others = Point(point.unknowns[: problem.layout.levels.start], ())
    found = solve_filtered(held, others, max_iterations=HELD_STEPS, polish=0)
    if found is None:
        return point, objective
    nearer = replace(start, values=found.values, initial=found.initial, local=found.local)
    there = _likeliest_level(problem, nearer, setting, begin)
    return there if there[1] < objective else (point, objective)


def _likeliest_level(
    problem: Filtered, start: Start, setting: Setting, begin: NoiseModel
) -> tuple[Point, float]:
    """Point at the start's values and the likeliest decade of levels; its objective.

    The objective is flat where the levels do nothing yet, falls, and rises where they are too
    large: strides find the valley, single decades its floor.
    """
    free = np.array([place not in setting.known for place in begin.places], dtype=bool)
    tried: dict[int, tuple[Point, float]] = {}

    def attempt(decade: int) -> float:
        force = np.where(free, 10.0**decade * begin.force, begin.force)
        point = problem.point(start.initial, start.local, replace(begin, force=force))
        tried[decade] = point, problem.objective(point.unknowns)
        return tried[decade][1]

    least, best = np.inf, 0
    for decade in range(0, DECADES + 1, STRIDE):
        found = attempt(decade)
        if found < least - 1.0:
            least, best = found, decade
        elif np.isfinite(least) and (not np.isfinite(found) or best > 0):
            break
    for decade in (best - 1, best + 1):
        if decade >= 0 and decade not in tried:
            attempt(decade)
    return min(tried.values(), key=lambda one: one[1])


@dataclass(frozen=True, eq=False)
class Start:
    """Where an estimation begins: values, start states and values of each record."""

    values: Mapping[str, float]
    initial: Sequence[np.ndarray]
    local: Sequence[Mapping[str, float]]


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
    """Where the colour that was let in vanishes, the white level is bounded or declared again."""
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
    return again


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


def moved(
    found: FilteredSolution,
    setting: Setting,
    noise: NoiseModel,
    colour: np.ndarray,
    *,
    own_times: bool = False,
    max_iterations: int = 40,
    unit: NoiseModel | None = None,
) -> FilteredSolution | None:
    """Estimate again from a solution with other levels unknown."""
    old = found.problem
    unit = old.levels.unit if unit is None else unit
    levels = setting.levels(old.dataset, noise, unit, colour, own_times=own_times)
    problem = Filtered(
        old.model, old.dataset, levels, kernel=old.kernel, known_starts=setting.known_starts
    )
    unknowns = np.concatenate([found.point.unknowns[: old.layout.levels.start], levels.vector()])
    return solve_filtered(problem, Point(unknowns, ()), max_iterations=max_iterations, polish=0)


def correlated(problem: Filtered, unknowns: np.ndarray) -> np.ndarray:
    """Outputs whose neighbouring innovations are clearly correlated, ``(n_outputs,)``."""
    found = problem.passes(unknowns, columns=False)
    n_outputs = len(problem.model.outputs)
    lag_one, count = np.zeros(n_outputs), np.zeros(n_outputs)
    for part in found:
        white = part.innovations / np.sqrt(part.variances)
        for column in range(n_outputs):
            seen = int(np.isfinite(white[:, column]).sum())
            if seen > 20:
                lag_one[column] += seen * float(autocorrelation(white[:, column], 1)[1])
                count[column] += seen
    share = lag_one / np.maximum(count, 1.0)
    return np.abs(share) > COLOURED / np.sqrt(np.maximum(count, 1.0))
