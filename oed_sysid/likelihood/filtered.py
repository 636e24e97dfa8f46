r"""Maximum likelihood with disturbance forces: the problem that the iterates evaluate.

.. math::
    -2 \log L(p, x_0, \eta) = \sum_k \frac{e_k^2}{S_k} + \log S_k + \text{priors}

with innovations ``e`` and variances ``S`` of an extended Kalman filter, one scalar measurement
at a time (:mod:`oed_sysid.compiled.filtering`). Unknown together are parameters ``p``, start
states and parameters of each record, and levels and times ``eta`` of the noise. Two gradients
serve: along the filtered path at frozen gain, cheap and nearly exact for ``p``; and that of the
filter as it is, by differences of whole filters, for the last steps and for the errors.

The covariance of start states is zero, and columns carry them instead: what is known of them
enters as a prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from oed_sysid.compiled.filtering import (
    SEA_PERIOD,
    Along,
    Disturbed,
    FilterKernel,
    FilterPass,
    filter_kernel,
)
from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood.disturbances import DISTURBANCE, Place, disturbance
from oed_sysid.likelihood.noise_model import Levels, NoiseModel, step_within
from oed_sysid.likelihood.shooting import Follows, Point
from oed_sysid.likelihood.unknowns import KnownStarts, Posed
from oed_sysid.physics.model import Model
from oed_sysid.runtime.threads import both_cores

# Most that a variance clear of zero by its standard deviation, or a time, grows or shrinks in one
# step.
FARTHEST, LONGER = 10.0, 3.0
# Ratio of periods of a sea that are tried, and most that one changes in a step: a wave of bandwidth
# 0.3 is half as strong at the next one.
NEXT_PERIOD = 1.4


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What other records say about the shared parameters.

    Attributes
    ----------
    mean : ndarray (n_shared,)
    information : ndarray (n_shared, n_shared)
    """

    mean: np.ndarray
    information: np.ndarray


class Filtered(Posed):
    """Likelihood of one model, data set and noise model.

    Parameters
    ----------
    model : Model
        Free parameters are unknown; its values are the start values.
    dataset : Dataset
    levels : Levels
        What of the noise is unknown, and all of its values.
    kernel : FilterKernel, optional
        Of a larger model that holds this one; by default of the model with its disturbances.
    known_starts : KnownStarts, optional
        Start states that are held or known with a stated error; by default all are free.
    knowledge : Knowledge, optional
        Joint normal prior of the shared parameters, as another fit left it.
    longest_hold : float, optional
        Longest time over which disturbances are held, s, where samples are further apart; by
        default what the waves of ``levels`` allow.
    """

    def __init__(
        self,
        model: Model,
        dataset: Dataset,
        levels: Levels,
        *,
        kernel: FilterKernel | None = None,
        known_starts: KnownStarts | None = None,
        knowledge: Knowledge | None = None,
        longest_hold: float | None = None,
    ) -> None:
        self.kernel = kernel or filter_kernel(disturbed_model(model, levels.disturbances))
        wide = self.kernel.model
        super().__init__(model, dataset, wide, known_starts, len(levels))
        n = len(self.layout.shared)
        nothing = Knowledge(np.zeros(n), np.zeros((n, n)))
        self.levels, self.knowledge = levels, knowledge or nothing
        self.longest_hold = levels.noise.longest_hold if longest_hold is None else longest_hold
        for name in ("lower", "upper", "prior_mean", "prior_weight"):
            getattr(self.limits, name)[self.layout.levels] = getattr(levels, name)
        if self.knowledge.information.any():  # what other records say holds these priors already
            self.limits.prior_weight[:n] = 0.0
        # Levels that act on each record, and their positions among all.
        self._met = [levels.on(record) for record in self.records]
        self.own = active_components(wide, model)
        both = active_components(wide, model, passing=True)
        commands = any(one.startswith(f"{DISTURBANCE}actuator_") for one in levels.disturbances)
        # What an uncertain command is remembered as is uncertain.
        self.active = both if commands else self.own
        self.passing = np.setdiff1d(both, self.active)

    # -- points --------------------------------------------------------------------

    def alone(self, unknowns: np.ndarray, record: int) -> tuple[np.ndarray, np.ndarray, bool]:
        """Outputs, full states and success of the undisturbed model along one record."""
        run = self.records[record]
        values, own = self.values(unknowns, record), self.initial_state(unknowns, record)
        found = self.kernel.simulate(run.times, run.inputs, values, own)
        return found.outputs, found.states, found.ok

    def noise(self, unknowns: np.ndarray) -> NoiseModel:
        """Noise model at a point."""
        return self.levels.at(unknowns[self.layout.levels])

    def white(self, unknowns: np.ndarray) -> np.ndarray:
        """Levels of the white noise of the sensors at a point, ``(n_outputs,)``."""
        return self.noise(unknowns).white

    def point(
        self,
        initial: Sequence[np.ndarray],
        local: Sequence[Mapping[str, float]] | None = None,
        noise: NoiseModel | None = None,
    ) -> Point:
        """Point at the model's values.

        Parameters
        ----------
        initial : sequence of ndarray (n_own,)
            Start states, per record.
        local : sequence of mapping, optional
            Values of per-record parameters.
        noise : NoiseModel, optional
            By default the one the levels begin with.
        """
        unknowns = np.zeros(self.layout.n_unknowns)
        values = self.model.values
        for index in range(len(self.records)):
            self.fill(unknowns, index, initial[index], values | dict(local[index] if local else {}))
        unknowns[self.layout.levels] = self.levels.vector(noise)
        return Point(np.clip(unknowns, self.limits.lower, self.limits.upper), ())

    def move(self, point: Point, follows: Follows, step: np.ndarray, length: float) -> Point:
        """Return the point after a step; its map says how levels follow times, see `maps`."""
        unknowns = point.unknowns + length * step
        block = self.layout.levels
        unknowns[block] = self.levels.moved(point.unknowns[block], length * step[block], follows[0])
        return Point(np.clip(unknowns, self.limits.lower, self.limits.upper), ())

    def trusted(
        self, unknowns: np.ndarray, matrix: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of a step within which the equations at a point still tell something of levels.

        A variance that stands clear of zero goes to a tenth or ten times of itself at most.
        """
        block = self.layout.levels
        here = unknowns[block]
        variance = self.levels.are_variances
        # Clear of zero: by more than a standard error, which the matrix states.
        clear = variance & (here * np.sqrt(np.diag(matrix)[block]) > 1.0)
        lower, upper = lower.copy(), upper.copy()
        longer = [NEXT_PERIOD if kind == SEA_PERIOD else LONGER for kind, _ in self.levels.entries]
        least = np.where(clear, (1.0 / FARTHEST - 1.0) * here, -np.inf)
        most = np.where(clear, (FARTHEST - 1.0) * here, np.inf)
        lower[block] = np.maximum(lower[block], np.where(variance, least, -np.log(longer)))
        upper[block] = np.minimum(upper[block], np.where(variance, most, np.log(longer)))
        return lower, upper

    def prior_cost(self, unknowns: np.ndarray) -> float:
        """Half the weighted sum of squares of the departures from the priors."""
        away = unknowns[: len(self.layout.shared)] - self.knowledge.mean
        cost = 0.5 * float(away @ self.knowledge.information @ away)
        return cost + self.limits.prior_cost(unknowns)

    def _add_knowledge(self, unknowns: np.ndarray, matrix: np.ndarray, right: np.ndarray) -> None:
        n = len(self.layout.shared)
        # Knowledge of earlier data: a prior with correlations, of the shared parameters alone.
        matrix[:n, :n] += self.knowledge.information
        right[:n] += self.knowledge.information @ (self.knowledge.mean - unknowns[:n])

    def maps(self, point: Point, matrix: np.ndarray) -> tuple[np.ndarray, ...]:
        """How variances follow their times at a point with given equations."""
        block = self.layout.levels
        return (self.levels.following(matrix[block, block], point.unknowns[block]),)

    def posed(
        self,
        levels: Levels | None = None,
        *,
        model: Model | None = None,
        dataset: Dataset | None = None,
        kernel: FilterKernel | None = None,
        knowledge: Knowledge | None = None,
        longest_hold: float | None = None,
    ) -> Filtered:
        """Return the same problem with some of its parts others.

        What is known of start states holds for the same records only; what other records say of
        parameters, and the longest hold, only where given again.
        """
        return Filtered(
            model or self.model,
            dataset or self.dataset,
            self.levels if levels is None else levels,
            kernel=kernel or self.kernel,
            known_starts=None if dataset else self.known_starts,
            knowledge=knowledge,
            longest_hold=longest_hold,
        )

    def beside(self, others: np.ndarray, noise: NoiseModel | None = None) -> Point:
        """Point at given unknowns before the levels, these as they begin or of a noise model."""
        known = others[: self.layout.levels.start]
        return Point(np.append(known, self.levels.vector(noise)), ())

    def open_unknowns(self, first: int) -> np.ndarray:
        """Positions from ``first`` on of what is estimated; levels count as such."""
        held = self.limits.held.copy()
        # A level at zero is held for a step, and may leave zero at the next.
        held[self.layout.levels] = False
        return first + np.flatnonzero(~held[first:])

    # -- evaluation ----------------------------------------------------------------

    def passes(
        self,
        unknowns: np.ndarray,
        *,
        columns: bool = True,
        levels: bool = True,
        levels_only: bool = False,
        rows: bool = False,
        gains: bool = False,
        moves: bool = False,
        names: Sequence[str] | None = None,
        measured: Sequence[np.ndarray] | None = None,
        beyond: Sequence[np.ndarray] | None = None,
        instead_of: tuple[Sequence[FilterPass], int] | None = None,
    ) -> list[FilterPass]:
        """Filter every record.

        Parameters
        ----------
        unknowns : ndarray (n_unknowns,)
        columns : bool
            Whether derivatives are wanted.
        levels, levels_only : bool
            Whether also by the levels of the noise, or by these alone.
        rows : bool
            Whether these of every innovation.
        gains : bool
            Whether gains are kept, for :meth:`replayed`.
        moves : bool
            Whether transitions are kept, too, for :class:`oed_sysid.likelihood.smoother.Path`.
        names : sequence of str, optional
            Columns of parameters; by default all free ones.
        measured : sequence of ndarray, optional
            Measurements in place of those of the records.
        beyond : sequence of ndarray, optional
            Largest squares of innovations, over their variances, that move anything.
        instead_of : tuple, optional
            Passes at a point of which one level, by its number, has moved: it leaves those of
            records on which it does not act.
        """
        levels, columns = columns and levels, columns and not levels_only
        if names is None or not columns:
            names = self.layout.free_names if columns else ()
        run = partial(self.kernel.filter, names=names, own_columns=columns)
        noises, given = self.disturbed(unknowns), {"measured": measured, "beyond": beyond}

        def one(index: int) -> FilterPass:
            own: dict[str, Any] = {n: one[index] for n, one in given.items() if one is not None}
            along = self._along(unknowns, index, noises[index])
            along, (here, met) = replace(along, passing=self.passing, **own), self._met[index]
            entries = here.entries if levels else ()
            part = run(along, levels=entries, rows=rows, gains=gains, moves=moves)
            return _among_all(part, met, len(self.levels)) if levels else part

        if instead_of is None:
            return both_cores(one, range(len(self.records)))
        found, moved = list(instead_of[0]), instead_of[1]
        touched = [index for index, (_, met) in enumerate(self._met) if moved in met]
        for index, part in zip(touched, both_cores(one, touched), strict=True):
            found[index] = part
        return found

    def disturbed(self, unknowns: np.ndarray) -> list[Disturbed]:
        """What is random along each record at a point; one object where it is the same."""
        noise = self.noise(unknowns)
        every = self.levels.disturbed(noise)
        along = []
        for record in self.records:
            here = noise.on(record.name)
            own = every if here is noise else self.levels.disturbed(here)
            if record.independent:
                nothing = np.zeros_like(own.variance), np.zeros_like(own.colour_variance)
                own = replace(own, variance=nothing[0], colour_variance=nothing[1])
            along.append(own)
        return along

    def _along(self, unknowns: np.ndarray, index: int, noise: Disturbed) -> Along:
        """One record, with the model and the noise along it."""
        record = self.records[index]
        return Along(
            record.times,
            record.inputs,
            self.values(unknowns, index),
            self.initial_state(unknowns, index),
            record.outputs,
            noise,
            self.active,
            longest_step=step_within(record.times, self.longest_hold),
        )

    def replayed(
        self,
        wide: Filtered,
        unknowns: np.ndarray,
        found: Sequence[FilterPass],
    ) -> list[np.ndarray] | None:
        """Innovations of a larger model at the gains of passes of this one.

        Parameters
        ----------
        wide : Filtered
            Problem of the larger model, of the same kernel and noise.
        unknowns : ndarray (n_unknowns,)
            Of that problem.
        found : sequence of FilterPass
            Passes of this one that kept their gains.

        Returns
        -------
        list of ndarray (n_times, n_outputs) or None
            Per record; None where the larger model diverges.
        """
        noises = wide.disturbed(unknowns)

        def one(index: int) -> tuple[np.ndarray, bool]:
            along = wide._along(unknowns, index, noises[index])
            step = step_within(along.times, self.longest_hold)
            along = replace(along, active=self.active, longest_step=step)
            return wide.kernel.replay(along, found[index].gains)

        results = both_cores(one, range(len(self.records)))
        return [part for part, _ in results] if all(ok for _, ok in results) else None

    def objective(self, unknowns: np.ndarray) -> float:
        """Minus twice the log-likelihood with priors, up to a constant."""
        found = self.passes(unknowns, columns=False)
        return 2.0 * self.prior_cost(unknowns) + sum(part.objective for part in found)

    def gathered(
        self, unknowns: np.ndarray, found: Sequence[FilterPass]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and right-hand side from passes with derivatives, priors excluded.

        Zero for all others where these are by the levels alone, or without them.
        """
        n, begin = self.layout.n_unknowns, self.layout.levels.start
        matrix, right = np.zeros((n, n)), np.zeros(n)
        for index, part in enumerate(found):
            where, size = self.columns_of(unknowns, index)
            # Levels come last, perhaps alone, and perhaps not at all.
            told = len(part.level_slope)
            levels, scale = slice(begin, begin + told), self.levels.scale[:told]
            end = len(where) - len(self.levels) + told
            own = slice(end - (len(part.gram) - 1), end)
            where, size = where[own], size[own]
            matrix[np.ix_(where, where)] += part.gram[:-1, :-1] * size[:, None] * size
            right[where] -= part.gram[:-1, -1] * size
            matrix[levels, levels] += part.level_information * scale[:, None] * scale
            right[levels] -= part.level_slope * scale
        self._add_knowledge(unknowns, matrix, right)
        return matrix, right

    def columns_of(self, unknowns: np.ndarray, record: int) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns of the columns of a pass, levels last, and units of these, ``(n_columns,)``."""
        levels = self.layout.levels
        where = np.concatenate([self._columns[record], np.arange(levels.start, levels.stop)])
        slopes = self.layout.record_slopes(unknowns, record)
        return where, np.concatenate([slopes, self.levels.scale])

    def differentiated(
        self, unknowns: np.ndarray, base: Sequence[FilterPass], std: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        r"""Matrix and right-hand side of the filter as it is, its gain no longer frozen.

        The derivatives of an innovation :math:`e` by parameters are exact at frozen gain; by
        differences comes only what the gain adds to them,

        .. math:: \frac{de}{d\theta} = \left.\frac{\partial e}{\partial\theta}\right|_K
            + \frac{e(\theta + \delta) - e_K(\theta + \delta)}{\delta} ,

        with :math:`e_K` at the gains of ``base``. So a curved path costs no accuracy where gains
        hardly change, and none at all without process noise; directions that records tell weakly
        drown in the error of whole differences.

        Parameters
        ----------
        unknowns : ndarray (n_unknowns,)
        base : sequence of FilterPass
            Passes there, with the derivatives of every innovation and with their gains.
        std : ndarray (n_unknowns,)
            Sizes of the differences.
        """
        n, n_own, n_levels = self.layout.n_unknowns, self.layout.n_own, len(self.levels)
        width = n_own + len(self.layout.free_names)
        matrix, right = np.zeros((n, n)), np.zeros(n)
        moved = self._moved(unknowns, base, std)
        for index, (columns, part) in enumerate(zip(self._columns, base, strict=True)):
            where, size = self.columns_of(unknowns, index)
            seen = np.isfinite(part.innovations)
            root = np.sqrt(part.variances[seen])
            # Of a scalar innovation: -ln L = (e^2/S + ln S) / 2, whose expected information is
            # that of the mean, slope' slope, and of the variance, spread' spread / 2.
            white = part.innovations[seen] / root
            rows = part.rows[seen]
            slope = rows[:, : width + n_levels] * size
            spread = np.zeros_like(slope)
            spread[:, width:] = rows[:, width + n_levels :] * self.levels.scale
            for position, column in enumerate(columns[n_own:], start=n_own):
                (by_gain, variances), length = moved[column, index], std[column]
                slope[:, position] += by_gain[seen] / (root * length)
                # Parameters move the variances of the innovations too, where the vehicle is
                # unstable much.
                spread[:, position] = np.log(variances[seen] / part.variances[seen]) / length
            matrix[np.ix_(where, where)] += slope.T @ slope + 0.5 * spread.T @ spread
            right[where] -= slope.T @ white + 0.5 * spread.T @ (1.0 - white**2)
        self._add_knowledge(unknowns, matrix, right)
        return matrix, right

    def _moved(
        self, unknowns: np.ndarray, base: Sequence[FilterPass], std: np.ndarray
    ) -> dict[tuple[int, int], tuple[np.ndarray, np.ndarray]]:
        """What its own gains do to the innovations of each parameter moved, and their variances.

        By unknown and record; each is moved by ``std``.
        """
        noises = self.disturbed(unknowns)
        jobs = [
            (int(column), index)
            for index, columns in enumerate(self._columns)
            for column in columns[self.layout.n_own :]
        ]

        def one(job: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
            column, index = job
            shifted = unknowns.copy()
            shifted[column] += std[column]
            along = self._along(shifted, index, noises[index])
            whole = self.kernel.filter(replace(along, passing=self.passing), own_columns=False)
            frozen, _ = self.kernel.replay(along, base[index].gains)
            return whole.innovations - frozen, whole.variances

        return dict(zip(jobs, both_cores(one, jobs), strict=True))


def _among_all(part: FilterPass, met: np.ndarray, n_levels: int) -> FilterPass:
    """A pass with derivatives by some levels, as one that tells nothing of all others."""
    if len(met) == n_levels:
        return part
    # The last row of the Gram matrix is that of the innovations themselves.
    begin, whole = len(part.gram) - 1 - len(met), len(part.gram) - 1 - len(met) + n_levels
    where = np.array([*range(begin), *(begin + met), whole], dtype=int)
    gram, slope = np.zeros((whole + 1, whole + 1)), np.zeros(n_levels)
    information = np.zeros((n_levels, n_levels))
    rows = np.zeros((*part.rows.shape[:2], whole + n_levels))
    gram[np.ix_(where, where)], slope[met] = part.gram, part.level_slope
    information[np.ix_(met, met)] = part.level_information
    rows[..., [*where[:-1], *(whole + met)]] = part.rows
    return replace(part, gram=gram, rows=rows, level_slope=slope, level_information=information)


def disturbed_model(model: Model, disturbances: Sequence[str]) -> Model:
    """The model with disturbances as free parameters, each once, all else as it is.

    Random effects that the model holds already are only let loose.
    """
    names = dict.fromkeys(disturbances)
    present = [name for name in names if name in model.parameter_names]
    if present:  # a model that is built anew is checked anew
        model = model.free(*present)
    absent = (name.removeprefix(DISTURBANCE) for name in names if name not in present)
    return model + [disturbance(Place(*name.split("_", 1))) for name in absent]


def active_components(wide: Model, model: Model, *, passing: bool = False) -> np.ndarray:
    """Components of the wide model's full state that a smaller model has.

    With ``passing`` what absent actuator effects remember counts among them, registers of delays
    apart: where a command stands still, derivatives pass an absent backlash through its memory.
    """
    present = frozenset(model.effect_names)
    kept = [True] * len(wide.states)
    kept += [effect.name in present for effect in wide.effects for _ in effect.states]
    for stage in ("actuator", "sensor"):
        passed = passing and stage == "actuator"
        kept += [
            effect.name in present or (passed and not memory.shortest)
            for effect in wide.effects
            if effect.stage == stage
            for memory in effect.memory
        ]
    return np.flatnonzero(kept)
