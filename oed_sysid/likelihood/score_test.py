r"""What stays the same while the noise of some records is looked for, and its score tests.

At any point :class:`Scored` sums the equations of what is absent there beside those of everything
that is estimated: noise whose variance is zero, or functions that a disturbance may be of
(:mod:`oed_sysid.likelihood.laws`). At a fit without process noise :func:`score_test` asks all
levels at once.

Do disturbance forces act? A test at a fit that takes all that is left for white noise.

There every disturbance has variance zero. The likelihood has a slope ``s`` and an information
``I`` in each variance, and

.. math:: T = \max_{d \ge 0}\; 2 s' d - d' I d

is what letting them in would gain in twice the log-likelihood (Silvapulle & Sen 2005,
*Constrained statistical inference*, ch. 3). With three forces, five sensors and three times, white
data stay below 6.8 in 95 and below 9.2 in 99 of 100 cases; above ``TOLD_APART`` disturbances are
admitted and estimated with everything else, and stay only where that is likelier.

Both come from one pass of the filter with all these variances at zero, where nothing is corrected:

.. math::
    \frac{\partial S_k}{\partial \sigma_j^2} = h' D_k h, \quad
    D_{k+1} = F D_k F' + Q_j', \quad
    m_{k+1} = F (m_k + D_k h\, e_k / S), \quad \partial e_k = -h' m_k
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property, partial

import numpy as np

from oed_sysid.compiled.filtering import FilterKernel, FilterPass, filter_kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import MINIMUM_SAMPLES
from oed_sysid.errors import SimulationError
from oed_sysid.likelihood.departures import TWOFOLD
from oed_sysid.likelihood.disturbances import Place
from oed_sysid.likelihood.filtered import FARTHEST, Filtered, disturbed_model
from oed_sysid.likelihood.gauss_newton import FROZEN_TOLERANCE, FilteredSolution, solve_filtered
from oed_sysid.likelihood.noise_levels import credible_levels, given_levels, shown_in_log
from oed_sysid.likelihood.noise_model import (
    Levels,
    NoiseModel,
    Sea,
    correlation_times,
    disturbance_names,
)
from oed_sysid.likelihood.projection import gain_within, score_beside
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.likelihood.unknowns import KnownStarts
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import IMMATERIAL, MATERIAL

# Share of the white level seen in the high-frequency content that an estimate must leave standing.
LEAST_SEEN = 1.0 - MATERIAL
# Slow noise of a sensor, over what was declared or its high-frequency content shows, beyond which
# it is none: noise with correlation 0.9 from sample to sample is at 4 times its high-frequency
# content, with 0.98 at 10. At 8 a search of tanks that overflow takes the overflow for such noise.
DRIFTS = 10.0


@dataclass(frozen=True, eq=False)
class Setting:
    """What stays the same while noise is looked for.

    Attributes
    ----------
    model : Model
    dataset : Dataset
    places : sequence of Place
        Where disturbances may act.
    white : ndarray (n_outputs,)
        White levels to begin with.
    estimated : ndarray of bool (n_outputs,)
        Which of these are unknown.
    colour : bool
        Whether sensors may have coloured noise.
    declared : ndarray (n_outputs,), optional
        Levels that hold, although they are estimated, unless those of their own pay; else NaN.
    logged : sequence of Place
        Logged inputs, which may be noisy: white from sample to sample, admitted where it pays.
    known : sequence of str
        Places whose level and time are known.
    known_starts : KnownStarts or None
        Start states that are held or known with a stated error.
    drifting : bool
        Otherwise slow noise far above the high-frequency content of a sensor is none of its own.
    seas : sequence of Sea
        Those that are declared; what they leave out is unknown.
    any_sea : bool
        Whether others are looked for.
    any_zero : bool
        Whether sensors may be off by a constant in each record, as a part of their noise.
    max_iterations : int
        Of each step of the search.
    kernel : FilterKernel, optional
        Of a larger model; by default of the model with all disturbances.
    """

    model: Model
    dataset: Dataset
    places: Sequence[Place]
    white: np.ndarray
    estimated: np.ndarray
    _: KW_ONLY
    colour: bool = True
    declared: np.ndarray | None = None
    logged: Sequence[Place] = ()
    known: Sequence[str] = ()
    known_starts: KnownStarts | None = None
    drifting: bool = True
    seas: Sequence[Sea] = ()
    any_sea: bool = False
    any_zero: bool = False
    max_iterations: int = 40
    kernel: FilterKernel | None = None

    def problem(
        self, start: Start, levels: Levels, dataset: Dataset | None = None
    ) -> tuple[Filtered, np.ndarray]:
        """Likelihood of the model at the values of a start, and the unknowns there."""
        problem = Filtered(
            self.model.with_values(dict(start.values)),
            dataset or self.dataset,
            levels,
            kernel=self._filter,
            known_starts=self.known_starts,
        )
        return problem, problem.point(start.initial, start.local).unknowns

    @cached_property
    def _filter(self) -> FilterKernel:
        """One filter for all disturbances that may be asked for."""
        return self.kernel or filter_kernel(disturbed_model(self.model, self.disturbances))

    @cached_property
    def _seen(self) -> tuple[np.ndarray, np.ndarray]:
        return credible_levels(self.dataset)

    @cached_property
    def least_white(self) -> np.ndarray:
        """What the high-frequency content shows is there, whatever could explain of it.

        Of a sensor with a declared level not more than that, since quick forces show there, too.
        """
        (floor, seen), declared = self._seen, given_levels(self.model.outputs)
        return np.where(seen, LEAST_SEEN * np.fmin(np.minimum(floor, self.white), declared), 0.0)

    @cached_property
    def most_colour(self) -> np.ndarray:
        """Level above which slow noise of a sensor is none, ``(n_outputs,)``."""
        floor, seen = self._seen
        known = seen & (not self.drifting)
        return np.where(known, DRIFTS * np.maximum(floor, self.white), np.inf)

    @cached_property
    def most_input(self) -> dict[str, float]:
        """Level above which noise of a logged input would show in the log itself, by place."""
        return {
            place.name: TWOFOLD * shown_in_log(self.dataset, place.channel) for place in self.logged
        }

    @property
    def inputs(self) -> tuple[Place, ...]:
        """Logged inputs that may be noisy: neither held nor smooth to the last digit."""
        return tuple(place for place in self.logged if self.most_input[place.name] > 0)

    @property
    def sea(self) -> Sea | None:
        """The sea that is declared, one without any number where one may be; else None."""
        return self.seas[0] if self.seas else Sea() if self.any_sea else None

    @property
    def at_sea(self) -> tuple[str, ...]:
        """Places at which waves may act: forces whose level is not known."""
        names = [place.name for place in self.places if place.stage == "force"]
        return tuple(name for name in names if name not in self.known)

    @property
    def disturbances(self) -> tuple[str, ...]:
        """Parameters of the filtered model that may be disturbances."""
        names = [place.name for place in (*self.places, *self.inputs)]
        names += [place for sea in self.seas for place in sea.places]
        return tuple(dict.fromkeys(disturbance_names(names)))

    def noise(self, time: float) -> NoiseModel:
        """White noise, and disturbances of zero level."""
        places = [place.name for place in self.places]
        times = [0.0 if place.stage == "actuator" else time for place in self.places]
        white = NoiseModel.white_only(self.white, self.model.output_names)
        return replace(white, colour_time=time).with_places(places, times)

    def levels(
        self,
        dataset: Dataset,
        noise: NoiseModel,
        unit: NoiseModel,
        colour: np.ndarray | None = None,
        *,
        own_times: bool | None = None,
        seas: Sequence[Sea] | None = None,
    ) -> Levels:
        """Unknown levels, begun at a noise model, colours and own times by default as it has them.

        Of its ``seas`` those declared are known as far as declared, unless others are given.
        """
        noise = noise.on(*dataset.names)
        colour = noise.colour > 0 if colour is None else colour
        own_times = noise.has_own_times if own_times is None else own_times
        if seas is None:
            declared = tuple(self.seas) or (Sea(),)
            seas = (*declared, *declared[:1] * len(noise.seas))  # every record's own is known alike
        remembers = colour & np.isfinite(noise.colour_time)
        known = {place: level for sea in unit.seas for place, level in (sea.levels or {}).items()}
        known |= dict(zip(unit.places, unit.force, strict=True))

        def natural(places: Sequence[str], levels: np.ndarray) -> np.ndarray:
            pairs = zip(places, levels, strict=True)
            return np.array([known.get(place, max(level, 1e-9)) for place, level in pairs])

        return Levels.of(
            noise,
            # What a white fit leaves may be far above any sensor's noise, and so no unit of it.
            replace(
                unit,
                white=np.minimum(unit.white, self.white),
                force=natural(noise.places, noise.force),
                force_time=1.0,
                places=noise.places,
                seas=tuple(s.with_levels(natural(s.places, s.level)) for s in noise.seas),
            ),
            # Where colour is admitted, the white level has to make room for it, for a zero not.
            white=self.estimated | remembers,
            colour=colour,
            force=np.array([place not in self.known for place in noise.places], dtype=bool),
            own_times=own_times,
            # ... and most of the high-frequency content may be its own.
            least_white=np.where(remembers, IMMATERIAL, 1.0) * self.least_white,
            most_colour=self.most_colour,
            times=correlation_times(dataset),
            seas=seas,
        )


def posed(
    found: FilteredSolution,
    setting: Setting,
    noise: NoiseModel,
    colour: np.ndarray | None = None,
    *,
    own_times: bool | None = None,
    unit: NoiseModel | None = None,
    seas: Sequence[Sea] | None = None,
    longest_hold: float | None = None,
) -> Filtered:
    """The problem of a solution with other levels unknown, begun at a noise model.

    Coloured sensors are by default those of ``noise``, and forces that act keep times of their own;
    of ``seas`` is unknown what they leave out. Forces are held no longer than the waves of
    ``noise`` may be, or than ``longest_hold``, s.
    """
    problem = found.problem
    unit = problem.levels.unit if unit is None else unit
    if own_times is None:
        own_times = not problem.levels.shares_a_time and bool(np.any(noise.force > 0))
    levels = setting.levels(problem.dataset, noise, unit, colour, own_times=own_times, seas=seas)
    return problem.posed(levels, longest_hold=longest_hold)


@dataclass(frozen=True, eq=False)
class Scored:
    """A point of a likelihood, at which the score of what is absent there is asked.

    Attributes
    ----------
    problem : Filtered
    unknowns : ndarray (n_unknowns,)
    passes : sequence of FilterPass
        With the derivatives of every innovation.
    """

    problem: Filtered
    unknowns: np.ndarray
    passes: Sequence[FilterPass]

    @classmethod
    def at(cls, found: FilteredSolution, longest_hold: float | None = None) -> Scored:
        """The end of an estimation, forces perhaps held over shorter steps."""
        problem, unknowns = found.problem, found.point.unknowns
        if longest_hold is not None:
            problem = problem.posed(longest_hold=longest_hold)
        return cls(problem, unknowns, problem.passes(unknowns, rows=True))

    @cached_property
    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and right-hand side of all unknowns, priors in both."""
        told = self.problem.gathered(self.unknowns, self.passes)
        return self.problem.limits.with_priors(*told, self.unknowns)

    @cached_property
    def scatter(self) -> float:
        """Mean square of the innovations in standard deviations, where it exceeds one."""
        squares = [part.innovations**2 / part.variances for part in self.passes]
        return max(float(np.nanmean(np.concatenate(squares))), 1.0)

    def beside(self, added: Iterable[np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
        """The equations with ``count`` absent ones, last.

        Parameters
        ----------
        added : iterable of ndarray (n_times, n_outputs, count or 2 count)
            Per record, derivatives by what is absent of the innovations in standard deviations, and
            of the logarithms of their variances behind these where there are any.
        count : int
        """
        known, right = self.equations
        levels, scale = self.problem.layout.levels, self.problem.levels.scale
        cross, own, slope = np.zeros((len(right), count)), np.zeros((count, count)), np.zeros(count)
        for index, (part, columns) in enumerate(zip(self.passes, added, strict=True)):
            where, size = self.problem.columns_of(self.unknowns, index)
            seen = np.isfinite(part.innovations)
            white = part.innovations[seen] / np.sqrt(part.variances[seen])
            rows, new = part.rows[seen], columns[seen]
            mean, spread = new[:, :count], new[:, count:]
            cross[where] += size[:, None] * (rows[:, : len(where)].T @ mean)
            own += mean.T @ mean
            slope -= mean.T @ white
            if spread.size:  # of an innovation the variance tells half of what its mean does
                cross[levels] += 0.5 * scale[:, None] * (rows[:, len(where) :].T @ spread)
                own += 0.5 * spread.T @ spread
                slope -= 0.5 * spread.T @ (1.0 - white**2)
        return np.block([[known, cross], [cross.T, own]]), np.append(right, slope)

    def score(
        self, added: Iterable[np.ndarray], count: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Information, score and own information of absent ones, all over :attr:`scatter`.

        Parameters
        ----------
        added, count
            See :meth:`beside`.

        Returns
        -------
        information : ndarray (count, count)
            With everything estimated too.
        score : ndarray (count,)
        own : ndarray (count,)
            The diagonal of the information if everything were known.
        """
        matrix, right = self.beside(added, count)
        absent = len(self.unknowns) + np.arange(count)
        found = score_beside(matrix, right, absent, self.problem.open_unknowns(0))
        information, score, own = (one / self.scatter for one in (*found, np.diag(matrix)[absent]))
        return information, score, own

    def gain(self, wide: Filtered, names: Sequence[str]) -> tuple[float, np.ndarray]:
        """What some variances that are zero would gain, everything else following, and the step.

        Noise of variance zero leaves the filter as it is; one pass tells the derivatives of the
        innovations by it.

        Parameters
        ----------
        wide : Filtered
            The same problem with these variances among its levels.
        names : sequence of str
            Theirs, as :attr:`~oed_sysid.likelihood.noise_model.Levels.names` has them.

        Returns
        -------
        gain : float
            In twice the log-likelihood.
        variances : ndarray (n_names,)
            To begin with, in squared units of their places.
        """
        problem, nothing = self.problem, np.zeros(len(names))
        new = wide.levels.only(np.isin(wide.levels.names, names))
        alone = wide.posed(new, longest_hold=problem.longest_hold)
        begin = alone.beside(self.unknowns).unknowns
        passes = alone.passes(begin, levels_only=True, rows=True)
        if not all(part.ok for part in passes):
            return 0.0, nothing
        size = np.tile(new.scale, 2)
        added = (part.rows * size for part in passes)
        matrix, right = self.beside(added, len(names))
        limits, own = problem.limits, len(self.unknowns)
        lower = np.append(limits.lower - self.unknowns, nothing)
        upper = np.append(limits.upper - self.unknowns, nothing)
        _, without = gain_within(matrix, right, lower, upper)
        upper[own:] = np.inf
        step, gain = gain_within(matrix, right, lower, upper)
        return gain - without, np.maximum(step[own:], 0.0) * new.scale


def moved(
    found: FilteredSolution, problem: Filtered, most: int, tolerance: float = FROZEN_TOLERANCE
) -> FilteredSolution:
    """Estimate again from a solution with other levels unknown, in at most so many steps."""
    point = problem.beside(found.point.unknowns)
    return solve_filtered(problem, point, max_iterations=most, tolerance=tolerance, polish=0)


# Correlation times that are tried, in samples.
TIMES = (5.0, 20.0, 60.0)


@dataclass(frozen=True, eq=False)
class Start:
    """Where an estimation begins: values, start states and values of each record.

    Levels are looked for unless ``noise`` gives those of an earlier fit.
    """

    values: Mapping[str, float]
    initial: Sequence[np.ndarray]
    local: Sequence[Mapping[str, float]]
    noise: NoiseModel | None = None

    @classmethod
    def at(cls, shooting: Shooting, unknowns: np.ndarray, noise: NoiseModel | None = None) -> Start:
        """Where an estimation with process noise begins, at some unknowns of one without."""
        states, local = shooting.initial_states(unknowns), shooting.layout.local_values(unknowns)
        return cls(shooting.model.values, states, local, noise)


@dataclass(frozen=True, eq=False)
class ScoreTest:
    """What letting disturbances in would gain at a white fit.

    Attributes
    ----------
    gain : float
        ``T``, in twice the log-likelihood.
    noise : NoiseModel
        One-step estimate of all levels.
    unit : NoiseModel
        Natural size of every level: that of which the records begin to tell.
    """

    gain: float
    noise: NoiseModel
    unit: NoiseModel

    @property
    def quiet(self) -> NoiseModel:
        """White noise of the fit that was tested, beside which nothing acts."""
        nothing = np.zeros_like(self.noise.force)
        return replace(self.noise, colour=np.zeros_like(self.noise.white), force=nothing)


def score_test(setting: Setting, start: Start, *, times: Sequence[float] = ()) -> ScoreTest:
    """Test at a white fit whether forces act or sensors are coloured.

    Parameters
    ----------
    setting : Setting
    start : Start
        Where the white fit ended.
    times : sequence of float, optional
        Correlation times that are tried, s; by default :data:`TIMES`, in samples.
    """
    records = setting.dataset
    sample = float(np.median([record.sample_time for record in records]))
    look = partial(_score_at, setting, start)
    tried = [look(records, time) for time in times or [count * sample for count in TIMES]]
    best = max(tried, key=lambda one: one.gain)
    if np.isfinite(best.gain):
        return best
    # The model on its own diverges: sizes from where it has not yet done so.
    length = max(record.n_samples for record in records) // 2
    while length >= MINIMUM_SAMPLES:
        heads = (one.window(-np.inf, one.times[:length][-1]) for one in records)
        found = look(Dataset(tuple(heads)), TIMES[0] * sample)
        if np.isfinite(found.gain):
            return replace(found, gain=np.inf)
        length //= 2
    raise SimulationError(
        f"Model {setting.model.name!r} diverges within {MINIMUM_SAMPLES} samples of the start of a "
        "record. Check signs and units of its values, or bound its parameters."
    )


def _score_at(setting: Setting, start: Start, dataset: Dataset, time: float) -> ScoreTest:
    quiet = setting.noise(time)
    n_forces, n_outputs = len(quiet.force), len(quiet.white)
    one = replace(quiet, force=np.ones(n_forces), colour=quiet.white)
    # Where every level but the white ones is zero, times have no slope.
    levels = Levels.of(quiet, one, white=True, colour=setting.colour, force=True)
    levels = levels.only(levels.are_variances)
    problem, unknowns = setting.problem(start, levels, dataset)
    found = problem.passes(unknowns, levels_only=True)
    count, block = len(levels), problem.layout.levels
    with np.errstate(over="ignore", invalid="ignore"):
        matrix, right = problem.gathered(unknowns, found)
    matrix, right = matrix[block, block], right[block]
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        return ScoreTest(np.inf, quiet, one)
    white = np.zeros(count, dtype=bool)
    white[n_forces : n_forces + n_outputs] = True
    # White levels may fall to make room, as far as in a step, and rise where nobody declared them.
    lower = np.where(white, 1.0 / FARTHEST - 1.0, 0.0)
    upper = np.full(count, np.inf)
    upper[white] = np.where(setting.estimated, np.inf, 0.0)
    step, both = gain_within(matrix, right, lower, upper)
    _, alone = gain_within(matrix, right, white * lower, np.where(white, upper, 0.0))
    # The variance of which the records begin to tell.
    natural = 1.0 / np.sqrt(np.maximum(np.diag(matrix)[:n_forces], 1e-300))
    colour = np.zeros(n_outputs)
    if setting.colour:
        colour = np.sqrt(np.maximum(step[n_forces + n_outputs :], 0.0)) * quiet.white
    return ScoreTest(
        both - alone,
        replace(quiet, force=np.sqrt(np.maximum(step[:n_forces], 0.0)), colour=colour),
        replace(one, force=np.sqrt(natural)),
    )
