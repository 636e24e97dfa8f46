r"""What stays the same while models are compared: records, candidates, noise, one compiled filter.

Every model on the way is a nominal model and some of the candidate effects, fitted by the
likelihood of :mod:`oed_sysid.likelihood.filtered` with a disturbance force in every equation: a
model
that lacks an effect then admits what it cannot explain, instead of bending its parameters to it.
One compiled filter of all candidates serves every such model.

On validation records a model is judged by how likely it makes them, given what the training
records say of its parameters, with start states and noise levels estimated there:

.. math::
    -2 \log p(y_v | y_t) \approx \min_{\theta, x_0, \eta}
    \left[ -2 \log L_v + (\theta - \hat\theta)' \Lambda (\theta - \hat\theta) \right]
    + \log \det(I + \Lambda^{-1} H_v)

with the information :math:`\Lambda` of the training and :math:`H_v` of the validation records
(Laplace's approximation; Kass & Raftery 1995, *Bayes factors*, J. Am. Stat. Assoc. 90).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from time import perf_counter

import numpy as np

from oed_sysid.compiled.filtering import FilterKernel, filter_kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError, SimulationError
from oed_sysid.evidence.sentences import say
from oed_sysid.likelihood.departures import smoothed_inputs
from oed_sysid.likelihood.disturbances import Place, chosen_places, commands, disturbance
from oed_sysid.likelihood.disturbances import places as every_place
from oed_sysid.likelihood.estimate import Departure, Integration, once_a_fit
from oed_sysid.likelihood.estimator import Solver
from oed_sysid.likelihood.filtered import Filtered, Knowledge, disturbed_model
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import FROZEN_TOLERANCE, FilteredSolution, solve_filtered
from oed_sysid.likelihood.integration import resolved
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_levels import (
    believed_levels,
    credible_levels,
    given_levels,
    residual_levels,
)
from oed_sysid.likelihood.noise_model import Disturbances, Levels, NoiseModel, forces_in, seas_in
from oed_sysid.likelihood.noise_parts import admitted, solved, with_own_times
from oed_sysid.likelihood.projection import eliminate, inverse_of
from oed_sysid.likelihood.random_forces import fit_disturbed
from oed_sysid.likelihood.score_test import ScoreTest, Setting, Start, score_test
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.likelihood.summary import Procedure, summarise_filtered
from oed_sysid.likelihood.whole_runs import WholeRun, rms, whole_runs
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import RANK_TOLERANCE

# A fit to white noise, on the way to one with disturbance forces.
PLAIN = MultipleShooting(solver=Solver(max_iterations=15), coloured="never", disturbances="none")
# What a study is asked of a fit on records: claims and the table of errors ask the same.
_once = partial(once_a_fit, place=1)

# Error of whole validation runs, over that before, that is no rise: arithmetic and parameters a
# little off; and where process noise acts, under which the runs of the better model wander too.
RISE, RISE_DISTURBED = 1.02, 1.25


@dataclass(frozen=True, eq=False)
class Prediction:
    r"""How likely a model makes the validation records, by Laplace's approximation.

    Attributes
    ----------
    misfit : float
        :math:`\min[-2 \log L_v + (\theta - \hat\theta)' \Lambda (\theta - \hat\theta)]`.
    known, joint : ndarray (n_shared, n_shared)
        Information :math:`\Lambda` of the training records about the shared parameters, and that
        of both, :math:`\Lambda + H_v`, in typical sizes; start states eliminated.
    """

    misfit: float
    known: np.ndarray
    joint: np.ndarray

    @property
    def value(self) -> float:
        """Minus twice the log-likelihood."""
        (sign, both), (own_sign, own) = (np.linalg.slogdet(m) for m in (self.joint, self.known))
        return float(self.misfit + (max(both - own, 0.0) if sign > 0 and own_sign > 0 else 0.0))


@dataclass(frozen=True, eq=False)
class Study:
    """Records, candidates and the noise setting of one comparison of models.

    Attributes
    ----------
    base : Model
        The nominal model.
    candidates : tuple of Effect
        What may be missing, absent.
    train : Dataset
    validation : Dataset or None
    setting : Setting
    unit : NoiseModel
        Natural size of every level.
    narrow, kernel : FilterKernel
        Of the nominal model, and of it with all candidates, each with a disturbance at every place
        but the sensors.
    estimated : ndarray of bool (n_outputs,)
        Outputs whose noise nobody declared.
    excluded : mapping of str to pair of int
        Samples of the training records that were left out as spikes, of how many, by output.
    """

    base: Model
    candidates: tuple[Effect, ...]
    train: Dataset
    validation: Dataset | None
    setting: Setting
    unit: NoiseModel
    narrow: FilterKernel
    kernel: FilterKernel
    estimated: np.ndarray
    excluded: Mapping[str, tuple[int, int]]

    @classmethod
    def begin(
        cls,
        model: Model,
        train: Dataset,
        validation: Dataset | None,
        candidates: Sequence[Effect],
        *,
        known_noise: bool,
        disturbances: Disturbances = "auto",
    ) -> tuple[Study, FilteredSolution]:
        """Join model and candidates, and fit the nominal model by steps that resolve its motion.

        Parameters
        ----------
        model : Model
        train, validation : Dataset
            Samples that stand out alone of the motion are left out, as a fit leaves them out.
        candidates : sequence of Effect
        known_noise : bool
            Whether declared levels are right and sensors have no other noise.
        disturbances : str or sequence of str
            Where disturbance forces may act: ``"auto"`` or ``"all"`` of the equations, ``"none"``
            of them, or those that are named.
        """
        levels, white = _declared(model, train, known=known_noise), _white_fit((model,), train)
        train = white.dataset
        validation = validation and _white_fit((white.model,), validation).dataset
        floor, _ = credible_levels(train)
        sigma = np.where(np.isfinite(levels), levels, floor)
        free = np.full(len(sigma), not known_noise)
        tests = train.only_tests
        if tests:  # no disturbance links one with the next
            disturbances = "none"
        inputs = [] if tests else commands(model)
        places, absent = _disturbed_places(model, disturbances)
        # Without disturbance forces, what is slow and far above a sensor's high-frequency content
        # is structure.
        setting = Setting(
            model, train, places, sigma, free,
            colour=not known_noise and not tests, logged=inputs, known=absent,
            drifting=disturbances != "none", seas=seas_in(disturbances),
        )  # fmt: skip
        effects = fitting_candidates(model, candidates)
        # Two in three passes are of the nominal model, at a third to two thirds of the price.
        narrow, kernel = (_kernel(model, one, setting) for one in ((), effects))
        setting = replace(setting, kernel=narrow)
        best, unit = _disturbed(setting, white)
        if best is None:
            raise SimulationError(say("refused", "diverges", model=model.name))
        study = cls(
            model, effects, train, validation, setting, unit, narrow, kernel,
            estimated=~np.isfinite(levels), excluded=white.excluded,
        )  # fmt: skip
        # What long steps leave would be explained by effects.
        best = study.resolved(best)
        step = best.problem.model.step
        narrow, kernel = (study.kernel_by(step, narrow=one) for one in (True, False))
        return replace(study, narrow=narrow, kernel=kernel), best

    def with_candidates(self, effects: Sequence[Effect]) -> Study:
        """The same study with more candidates, compiled anew."""
        joined = fitting_candidates(self.base, (*self.candidates, *effects))
        return replace(self, candidates=joined, kernel=_kernel(self.base, joined, self.setting))

    @cached_property
    def smoothed(self) -> Study | None:
        """The same study of records whose measured inputs are smoothed; None where none is noisy.

        An input that is linear between samples and has noise was measured; commands are as logged.
        """
        linear = {one.name for one in self.base.inputs if one.interpolation == "linear"}
        noisy = [place.channel for place in self.setting.inputs if place.channel in linear]
        if not noisy:
            return None

        def calmed(records: Dataset) -> Dataset:
            return Dataset(tuple(r.with_inputs(smoothed_inputs(r, noisy)) for r in records))

        validation = self.validation and calmed(self.validation)
        setting = replace(self.setting, logged=())  # nothing of them is left to smooth
        return replace(self, train=calmed(self.train), validation=validation, setting=setting)

    # -- fits ------------------------------------------------------------------------

    def kernel_by(self, step: float, *, narrow: bool = False) -> FilterKernel:
        """The compiled filter by some integration step, s, of all candidates or of none."""
        known = self.narrow if narrow else self.kernel
        return known if known.model.step == step else filter_kernel(replace(known.model, step=step))

    def widened(self, found: FilteredSolution) -> FilteredSolution:
        """The same solution by the filter of all candidates."""
        problem = found.problem
        kernel = self.kernel_by(problem.model.step)
        if problem.kernel is kernel:
            return found
        wide = problem.posed(kernel=kernel, longest_hold=problem.longest_hold)
        return replace(found, now=replace(found.now, problem=wide))

    def model(
        self, effects: Sequence[Effect], values: Mapping[str, float], step: float = np.inf
    ) -> Model:
        """The nominal model with some effects, at those of the values that it knows."""
        order = {effect.name: i for i, effect in enumerate(self.candidates)}
        # In the order of the filter's full state.
        model = self.base + sorted(effects, key=lambda e: order.get(e.name, len(order)))
        if step < model.step:
            model = replace(model, step=step)
        # A logarithm that ends at a bound misses it by rounding.
        limits = {p.name: (p.lower, p.upper) for p in model.all_parameters}
        return model.with_values(
            {k: float(np.clip(v, *limits[k])) for k, v in values.items() if k in limits}
        )

    def effects_of(self, found: FilteredSolution) -> tuple[Effect, ...]:
        """Effects that a fit has beside those of the nominal model."""
        return found.problem.model.effects[len(self.base.effects) :]

    def levels(self, noise: NoiseModel, dataset: Dataset) -> Levels:
        """All levels unknown, begun at a noise model."""
        return self.setting.levels(dataset, noise, self.unit)

    def with_levels(self, found: FilteredSolution, levels: Levels) -> FilteredSolution | None:
        """A fit to the training records again, with other levels unknown."""
        return _solved(found.problem.posed(levels, model=found.model), found, 8)

    def estimate(
        self,
        effects: Sequence[Effect],
        values: Mapping[str, float],
        start: FilteredSolution | Start,
        *,
        update_noise: bool = True,
        noise: NoiseModel | None = None,
        max_iterations: int = 25,
        step: float = np.inf,
    ) -> FilteredSolution | None:
        """Estimate the nominal model with some effects on the training records.

        Parameters
        ----------
        effects : sequence of Effect
        values : mapping
            Start values of parameters.
        start : FilteredSolution or Start
            Gives start states, values of each record, and the noise to begin with.
        update_noise : bool
            Whether levels and times are estimated too.
        noise : NoiseModel, optional
            In place of the start's; needed where that has none.
        max_iterations : int
            See :func:`~oed_sysid.likelihood.gauss_newton.solve_filtered`.
        step : float
            Longest integration step, s; that of a fit that is begun from is no longer either.

        Returns
        -------
        FilteredSolution or None
            None where the filter diverges at the start.
        """
        if isinstance(start, FilteredSolution):
            noise, step = noise or start.noise, min(step, start.problem.model.step)
        assert noise is not None
        levels = self.levels(noise, self.train)
        levels = levels if update_noise else levels.held()
        # A filter made for a finer step keeps the memory of delays that goes with it.
        model = self.model(effects, values, min(step, self.kernel.model.step))
        kernel = self.kernel_by(model.step, narrow=not effects)
        problem = Filtered(model, self.train, levels, kernel=kernel)
        return _solved(problem, start, max_iterations)

    def anew(self, found: FilteredSolution, *, at_sea: bool = False) -> FilteredSolution | None:
        """The same effects estimated as the nominal model was, from its values and white noise.

        With ``at_sea`` a sea may act, which is looked for beside declared levels of the sensors.
        None where the model diverges.
        """
        effects, step = self.effects_of(found), found.problem.model.step
        own = {p.name for effect in effects for p in effect.parameters}
        values = {k: v for k, v in found.values.items() if k in own}
        # A size that was found beside other values may lead back there.
        first, *more = (
            self.model(effects, self.base.values | sizes, step)
            for sizes in ((values, usual(effects)) if effects else (values,))
        )
        kernel = self.kernel_by(first.step, narrow=not effects)
        setting = replace(self.setting, model=first, kernel=kernel)
        if at_sea:
            setting = replace(setting, any_sea=True, estimated=self.estimated)
        try:
            end, _ = _disturbed(setting, _white_fit((first, *more), self.train))
        except SimulationError:
            return None
        return end and (self.estimate(effects, end.values, end) if at_sea else end)

    def settle(self, found: FilteredSolution) -> FilteredSolution:
        """Estimate once more, every part of the noise model asked for again."""
        again = solved(found, 25)
        likelier = min(again, found, key=lambda one: one.objective)
        return with_own_times(admitted(likelier, self.setting), self.setting)

    def resolved(self, found: FilteredSolution) -> FilteredSolution:
        """The same by steps that resolve all motion; see :mod:`.likelihood.integration`."""
        ends = {found.problem.model.step: found}

        def again(step: float, fit: Fit) -> Fit:
            before = ends[fit.model.step]
            after = self.estimate(self.effects_of(before), before.values, before, step=step)
            ends[step] = before if after is None else after
            return self.result(ends[step], "")

        return ends[resolved(self.result(found, ""), again).model.step]

    def loosened(self, noise: NoiseModel) -> NoiseModel:
        """Noise levels from which a vanished disturbance can come back, where one may act."""
        known = dict(zip(self.unit.places, self.unit.force, strict=True))
        told = [
            0.0 if name in self.setting.known else known.get(name, 0.0) for name in noise.places
        ]
        return replace(noise, force=np.maximum(noise.force, 0.5 * np.array(told)))

    @_once
    def polished(self, found: FilteredSolution) -> FilteredSolution:
        """A fit at the optimum of the filter as it is, with errors of that."""
        return self.kept(found, solved(found, 2, polish=2).finite)

    def departing(self) -> tuple[Departure | None, float]:
        """What departs from the nominal model in the training records, without process noise.

        With the log-likelihood of the records without it.
        """
        return PLAIN.departing(_white_fit((self.base,), self.train))

    def result(self, found: FilteredSolution, label: str) -> Fit:
        """The fit of a model that was found and polished."""
        how = Procedure(label, self.estimated, found.iterations, perf_counter())
        fit = summarise_filtered(found, how)
        finer = Integration(self.base.step) if fit.model.step < self.base.step else None
        return replace(fit, seconds=0.0, integration=finer, excluded=self.excluded)

    # -- validation ------------------------------------------------------------------

    @_once
    def predict(self, found: FilteredSolution, validation: Dataset) -> Prediction:
        """How likely a model makes the validation records, the training records known.

        Up to a constant that all models share; not at all where the model cannot be run.
        """
        shared = np.arange(len(found.problem.layout.shared))
        scale = found.problem.limits.scale[shared]
        known = information(found, shared)
        # Rounding, where a filter nearly diverges, would leave directions known less than nothing.
        known = inverse_of(inverse_of(known)) + np.diag(RANK_TOLERANCE**2 / scale**2)
        levels = self.levels(self.loosened(found.noise), validation)
        knowledge = Knowledge(found.point.unknowns[shared].copy(), known)
        problem = found.problem.posed(
            levels, model=found.model, dataset=validation, knowledge=knowledge
        )
        alone = self.alone(found, validation)
        solution = alone and _solved(problem, alone, 20)
        if not solution:
            return Prediction(np.inf, known, known)
        sizes = scale[:, None] * scale  # in typical sizes
        return Prediction(solution.objective, known * sizes, information(solution, shared) * sizes)

    def on_records(
        self, found: FilteredSolution, dataset: Dataset, *, same_forces: bool = False
    ) -> FilteredSolution | None:
        """A fit on other records: parameters held, start states and noise levels estimated.

        With ``same_forces`` disturbance forces are as strong and last as long as the fit says; only
        the sensors' levels are estimated.
        """
        same = self.levels(found.noise, dataset).holding_forces()
        levels = same if same_forces else self.levels(self.loosened(found.noise), dataset)
        alone = self.alone(found, dataset)
        return alone and self._held(found, dataset, levels, alone, tolerance=0.01)

    @_once
    def alone(self, found: FilteredSolution, dataset: Dataset) -> FilteredSolution | None:
        """A fit on other records: parameters and noise levels held, start states estimated.

        Where levels are estimated too, it is from here that they are: a start state that is far
        off would be taken for a disturbance force, which it is not.
        """
        # Sizes of single records are far from their mean: whole runs have found them.
        runs = self.runs(found, dataset)
        own = [run.shooting.initial_state(run.unknowns, 0) for run in runs]
        start = Start(found.values, own, [run.local for run in runs])
        return self._held(found, dataset, self.levels(found.noise, dataset).held(), start)

    def _held(
        self,
        found: FilteredSolution,
        dataset: Dataset,
        levels: Levels,
        start: FilteredSolution | Start,
        tolerance: float = FROZEN_TOLERANCE,
    ) -> FilteredSolution | None:
        """Start states, values of each record and open levels, all shared parameters held."""
        problem = found.problem.posed(levels, model=found.model, dataset=dataset)
        shared = np.arange(len(problem.layout.shared))
        point = problem.point(start.initial, start.local)
        held = problem.holding(shared, point.unknowns[shared])
        end = solve_filtered(held, point, max_iterations=15, tolerance=tolerance, polish=0)
        return end.finite

    @_once
    def runs(self, found: FilteredSolution, dataset: Dataset) -> tuple[WholeRun, ...]:
        """Whole runs of the model on its own, start states and values of each record fitted."""
        runner = found.problem.kernel.part(found.model, found.problem.own)
        return whole_runs(found.model, dataset, found.noise.sensors, runner=runner)

    def rms(self, found: FilteredSolution, dataset: Dataset | None) -> np.ndarray:
        """Errors of the model on its own, ``(n_outputs,)``, as `compare` finds them.

        Shared parameters are held, start states fitted to each whole record; infinite where the
        model diverges, NaN without records.
        """
        nothing = np.full(len(self.base.outputs), np.nan)
        return nothing if dataset is None else rms(self.runs(found, dataset))

    def own_error(self, found: FilteredSolution, dataset: Dataset | None = None) -> float:
        """Error of a model on its own over all outputs, in units of the noise.

        By default on the validation records; NaN without any.
        """
        return total_error(self.rms(found, dataset or self.validation) / self.setting.white)

    def rises(
        self, before: FilteredSolution, after: FilteredSolution, allowed: float | None = None
    ) -> bool:
        """Whether the error of whole validation runs rises from a fit to another."""
        old, new = self.own_error(before), self.own_error(after)
        return worse(old, new, allowed or allowed_rise(after))

    def kept(self, before: FilteredSolution, after: FilteredSolution | None) -> FilteredSolution:
        """What a stage returns: what it made, unless it failed or whole validation runs rise.

        As of a claim, by more than arithmetic only where the validation records are likelier.
        """
        if after is None or self.rises(before, after):
            return before
        if self.validation is None or not self.rises(before, after, allowed=RISE):
            return after
        old, new = (self.predict(fit, self.validation).value for fit in (before, after))
        return after if new < old else before


def _solved(
    problem: Filtered, start: FilteredSolution | Start, max_iterations: int
) -> FilteredSolution | None:
    """A fit from start states and values of each record; None where it diverges at once."""
    point = problem.point(start.initial, start.local)
    return solve_filtered(
        problem, point, max_iterations=max_iterations, tolerance=0.01, polish=0
    ).finite


def information(fit: FilteredSolution, at: np.ndarray) -> np.ndarray:
    """What a fit and its priors tell of some unknowns, all others estimated too."""
    matrix = fit.matrix + np.diag(fit.problem.limits.prior_weight)
    return eliminate(matrix, at, np.delete(np.arange(len(matrix)), at))


def allowed_rise(fit: FilteredSolution) -> float:
    """Ratio of whole-run errors that is no rise."""
    return RISE_DISTURBED if fit.noise.has_forces else RISE


def worse(before: float, after: float, allowed: float) -> bool:
    """Whether an error of whole validation runs rises or is infinite; never without any."""
    return not (np.isnan(before) and np.isnan(after)) and not after <= allowed * before


def total_error(rms: np.ndarray) -> float:
    """Root mean square of what was measured, over outputs or samples; NaN without any."""
    seen = ~np.isnan(rms)
    return float(np.sqrt(np.mean(rms[seen] ** 2))) if seen.any() else np.nan


def likelier(*fits: FilteredSolution | None) -> FilteredSolution | None:
    """The likeliest of some fits of one study, of which some may not have come about."""
    return min((fit for fit in fits if fit is not None), key=lambda f: f.objective, default=None)


def _declared(model: Model, dataset: Dataset, *, known: bool) -> np.ndarray:
    """Levels of the sensors as declared, ``(n_outputs,)``; NaN where they are to be estimated."""
    levels = given_levels(model.outputs)
    if not known:
        return believed_levels(model.outputs, dataset)
    if not np.all(np.isfinite(levels)):
        unknown = ", ".join(o.name for o in model.outputs if o.noise_std is None)
        raise DataError(say("refused", "noise", names=unknown))
    return levels


def _disturbed_places(
    model: Model, disturbances: Disturbances
) -> tuple[tuple[Place, ...], list[str]]:
    """Places where disturbance forces may act or physics may be missing; the latter alone."""
    try:
        places = chosen_places(model, "all")
    except ModelError as error:
        raise ModelError(say("refused", "equations", model=model.name)) from error
    asked = forces_in(disturbances)
    acting = () if asked == "none" else chosen_places(model, asked)
    absent = [place.name for place in places if place not in acting]
    return tuple(dict.fromkeys((*places, *acting))), absent


def _kernel(model: Model, effects: Sequence[Effect], setting: Setting) -> FilterKernel:
    """One filter for every model on the way, and for every place where it may fail."""
    chain = [disturbance(p).name for p in every_place(model) if p.stage != "sensor"]
    names = tuple(dict.fromkeys((*setting.disturbances, *chain)))
    return filter_kernel(disturbed_model(model + effects, names))


def fitting_candidates(base: Model, candidates: Sequence[Effect]) -> tuple[Effect, ...]:
    """Candidates that a model can take, absent.

    A candidate that acts on signals the model does not have, or that it already holds, is left
    out.
    """
    absent = tuple(effect.absent() for effect in candidates)
    with suppress(ModelError):
        base + absent
        return absent
    joined, kept = base, list[Effect]()
    for effect in absent:
        with suppress(ModelError):
            joined = joined + effect
            kept.append(effect)
    return tuple(kept)


def _white_fit(models: Sequence[Model], records: Dataset) -> Fit:
    """The likeliest fit to white noise: where an estimation begins, and records without spikes."""
    return min((PLAIN.begun(one, records) for one in models), key=lambda one: one.cost)


def _disturbed(setting: Setting, white: Fit) -> tuple[FilteredSolution | None, NoiseModel]:
    """The fit with disturbances begun at one to white noise, and natural sizes of all levels.

    None where the model diverges along the records.
    """
    shooting = Shooting(setting.model, setting.dataset, setting.white)
    starts = [Start.at(shooting, shooting.start_unknowns())]
    if np.isfinite(white.cost):
        starts.append(Start(white.model.values, white.initial_states, white.local_values))
    test = _best_test(setting, starts)
    level = np.where(np.isin(test.noise.places, setting.known), 0.0, test.noise.force)
    test = replace(test, noise=replace(test.noise, force=level))
    if len(starts) > 1:
        # What no force can do (a rate that is off against its angle) only louder sensors can be.
        loud = np.fmax(residual_levels(white.residuals), test.noise.white)
        starts.append(replace(starts[-1], noise=replace(test.quiet, white=loud)))
    return fit_disturbed(setting, starts, test, polish=0).finite, test.unit


def usual(effects: Sequence[Effect]) -> dict[str, float]:
    """Values of effects as large as they usually are."""
    return {
        p.name: min(p.magnitude, p.upper) if p.name in effect.amplitude_names else p.value
        for effect in effects
        for p in effect.parameters
    }


def _best_test(setting: Setting, starts: Sequence[Start]) -> ScoreTest:
    """Levels to begin with: from the last start, the fitted one, where the model runs there."""
    tests, errors = [], []
    for start in reversed(starts):
        try:
            tests.append(score_test(setting, start))
        except SimulationError as error:
            errors.append(error)
        if tests and np.isfinite(tests[-1].gain):
            return tests[-1]
    if not tests:
        raise errors[-1]
    return tests[0]
