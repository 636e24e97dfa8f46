"""The bench on which models are compared: records, noise units, first fit, errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.diagnosis.correlation_times import with_correlation_times
from oed_sysid.diagnosis.greybox import GreyBox, Task, estimate, residuals, with_noise
from oed_sysid.diagnosis.linearise import SuperModel, deviations, disturbed_equations
from oed_sysid.effects import Effect
from oed_sysid.errors import DataError, ModelError, SimulationError
from oed_sysid.estimators.multiple_shooting import MultipleShooting
from oed_sysid.fitting.fit import Fit
from oed_sysid.fitting.noise_levels import credible_levels, given_levels
from oed_sysid.model import Model
from oed_sysid.noise.kalman import Deviations, NoiseModel

# Correlation times to begin with, in samples: 1 s and 0.4 s in a log of ten samples a second.
FORCE_TIME, COLOUR_TIME = 10.0, 4.0
# Share of the white level seen in the fastest wiggles that an estimate must leave standing.
LEAST_SEEN = 0.7


@dataclass(frozen=True, eq=False)
class Workbench:
    """Training and test records with the super-model of all candidates.

    Attributes
    ----------
    train : Task
        At the linearisation of the present model.
    test : Task or None
        The same on the untouched records.
    plain : Fit or None
        The believed model by plain least squares; None where that fails.
    """

    train: Task
    test: Task | None
    plain: Fit | None = None

    @classmethod
    def build(
        cls,
        model: Model,
        train: Dataset,
        test: Dataset | None,
        candidates: Sequence[Effect],
        *,
        known_noise: bool,
    ) -> tuple[Workbench, GreyBox]:
        """Join model and candidates, and fit the model as it is believed."""
        levels = given_levels(model.outputs)
        if known_noise and not np.all(np.isfinite(levels)):
            unknown = [o.name for o in model.outputs if o.noise_std is None]
            raise DataError(
                f"The noise of {', '.join(unknown)} is not declared, so it cannot be taken as "
                "known. Set noise_std on these outputs, or let the noise be estimated."
            )
        floor, seen = credible_levels(train)
        white = np.where(np.isfinite(levels), levels, floor)
        # What the fastest wiggles show is there, whatever disturbances could explain of it.
        least = np.where(seen, LEAST_SEEN * np.minimum(floor, white), 0.0)
        super_model = SuperModel.build(model, candidates)
        n_forces = len(disturbed_equations(model))
        if n_forces == 0:
            raise ModelError(
                f"Model {model.name!r} has no equation with a parameter in which physics could be "
                "missing."
            )
        sample = float(np.median([record.sample_time for record in train]))
        units = NoiseModel(
            white,
            white,
            np.ones(n_forces),
            colour_time=COLOUR_TIME * sample,
            force_time=FORCE_TIME * sample,
        )
        found = MultipleShooting(max_iterations=40, coloured="never").fit(model, train)
        plain = found if np.isfinite(found.cost) else None
        settled, problem = [], None
        for fit, task in _first_fits(super_model, train, units, least, known_noise, plain):
            untouched = None if test is None else replace(task, dataset=test, deviations=())
            try:
                settled.append(cls(task, untouched, plain).resettle(fit))
            except SimulationError as error:
                problem = error
        if problem is not None and not settled:
            raise problem
        bench, best = min(settled, key=lambda pair: pair[1].objective)
        return bench.timed(best)

    def at(self, fit: GreyBox) -> Workbench:
        """Return the bench linearised along the trajectories of a fit."""
        train = replace(self.train, deviations=_linearise(self.train, fit))
        test = self.test
        if test is not None:
            states = self.test_states(fit)
            base = self._base_at(fit)
            test = replace(test, deviations=deviations(base, test.dataset, states))
        return replace(self, train=train, test=test)

    def settle(self, fit: GreyBox) -> tuple[Workbench, GreyBox]:
        """Linearise along a fit and estimate once more, correlation times included."""
        bench, again = self.resettle(fit)
        return bench.timed(again)

    def resettle(self, fit: GreyBox) -> tuple[Workbench, GreyBox]:
        """Linearise along a fit and estimate once more in the new linearisation."""
        bench = self.at(fit)
        again = estimate(bench.train, fit.names, fit.values, fit.initial, fit.noise)
        return bench, again if again is not None else with_noise(bench.train, fit, fit.noise)

    def timed(self, fit: GreyBox) -> tuple[Workbench, GreyBox]:
        """Look for better correlation times, and estimate once more where there are."""
        task, judged = with_correlation_times(self.train, fit)
        if judged is fit:
            return self, fit
        final = estimate(task, judged.names, judged.values, judged.initial, judged.noise)
        return replace(self, train=task), final if final is not None else judged

    def test_states(self, fit: GreyBox) -> list[np.ndarray]:
        """Trajectories of a fit on the test records, initial states fitted to them."""
        assert self.test is not None
        found = on_records(self.test, fit)
        if found is None:
            raise SimulationError(
                "The fitted model diverges on a test record. Leave the record out, or bound the "
                "parameters."
            )
        return [run.states for run in found.runs]

    def _base_at(self, fit: GreyBox) -> Model:
        base = self.train.super_model.base
        known = set(base.parameter_names)
        return base.with_values({k: v for k, v in fit.values.items() if k in known})

    def test_objective(self, fit: GreyBox) -> float:
        """Minus twice the log-likelihood on the test records, nothing fitted but their starts."""
        assert self.test is not None
        task = self.test
        start = on_records(task, fit)
        if start is None:
            return np.inf
        found = estimate(
            task, (), fit.values, start.initial, fit.noise, update_noise=False, max_iterations=6
        )
        return np.inf if found is None else found.objective

    def errors(self, fit: GreyBox, sigma: np.ndarray) -> dict[str, float]:
        """Prediction errors of a fit's structure, in units of the noise.

        Root mean squares over all outputs and whole records. The parameters are
        those of plain least squares on the training records, as any user would
        fit them, so that the believed model is not made to look worse than it
        is; on test records nothing but the initial states is fitted.

        Returns
        -------
        dict
            ``train`` and ``test``; NaN without test records, infinite where the
            model diverges.
        """
        return self.relative(self.rms(fit), sigma)

    def relative(self, rms: Mapping[str, np.ndarray], sigma: np.ndarray) -> dict[str, float]:
        """Errors of all outputs together, in units of the noise, from those of each."""
        tasks = {"train": self.train, "test": self.test}
        found = {}
        for key, task in tasks.items():
            count = np.zeros(len(sigma)) if task is None else _counts(task.dataset)
            seen = count > 0
            total = float(np.sum(count[seen] * (rms[key][seen] / sigma[seen]) ** 2))
            found[key] = float(np.sqrt(total / count.sum())) if seen.any() else np.nan
        return found

    def rms(self, fit: GreyBox) -> dict[str, np.ndarray]:
        """Errors as in :meth:`errors`, of each output in its unit, shape ``(n_outputs,)``."""
        fits = [least_squares(self.train, fit, fit.names, fit.initial)]
        if self.plain is not None and set(fit.names) == set(self.plain.model.free_names):
            # Here least squares may have found a better, if absurd, place to start from.
            values = dict(fit.values) | self.plain.model.values
            own = replace(fit, values=values)
            fits.append(least_squares(self.train, own, fit.names, self.plain.initial_states))
        fitted = min((f for f in fits if f is not None), key=lambda f: f.objective, default=fit)
        found = {"train": _misfit(self.train, fitted)}
        found["test"] = np.full_like(found["train"], np.nan)
        if self.test is not None:
            starts = starting_states(self.test.super_model.base, self.test.dataset)
            there = least_squares(self.test, fitted, (), starts)
            lost = np.full_like(found["train"], np.inf)
            found["test"] = lost if there is None else _misfit(self.test, there)
        return found


def _misfit(task: Task, fit: GreyBox) -> np.ndarray:
    squares = [np.nansum(part**2, axis=0) for part in residuals(task.dataset, fit.outputs)]
    return np.sqrt(np.sum(squares, axis=0) / np.maximum(_counts(task.dataset), 1))


def _counts(dataset: Dataset) -> np.ndarray:
    """Measured samples of each output."""
    return np.sum([np.isfinite(record.outputs).sum(axis=0) for record in dataset], axis=0)


def on_records(task: Task, fit: GreyBox) -> GreyBox | None:
    """Fit only the initial states of a task's records, by plain least squares."""
    starts = starting_states(task.super_model.base, task.dataset)
    return least_squares(task, fit, (), starts)


def least_squares(
    task: Task, fit: GreyBox, names: Sequence[str], initial: Sequence[np.ndarray]
) -> GreyBox | None:
    """Estimate parameters and initial states as if residuals were white noise."""
    white = replace(task.units, force=0 * task.units.force, colour=0 * task.units.colour)
    idle = replace(task, deviations=[_idle(record.outputs) for record in task.dataset])
    return estimate(idle, names, fit.values, initial, white, update_noise=False, max_iterations=25)


def _idle(outputs: np.ndarray) -> Deviations:
    """Deviations of a record whose noise is white: the dynamics do not enter."""
    present = np.isfinite(outputs).astype(float)
    nothing = np.zeros((0, 0, 0))
    return Deviations(nothing, nothing, nothing, present, 1.0)


def starting_states(model: Model, dataset: Dataset) -> list[np.ndarray]:
    """Initial states that the first samples suggest, zero where not measured."""
    from oed_sysid.fitting.start_guess import measured_states

    starts = []
    for record in dataset:
        own = np.zeros(len(model.states))
        for position, series in measured_states(model, record).items():
            own[position] = series[0]
        starts.append(own)
    return starts


def _linearise(task: Task, fit: GreyBox) -> list[Deviations]:
    base = task.super_model.base
    known = set(base.parameter_names)
    model = base.with_values({k: v for k, v in fit.values.items() if k in known})
    return deviations(model, task.dataset, [run.states for run in fit.runs])


def _first_fits(
    super_model: SuperModel,
    train: Dataset,
    units: NoiseModel,
    least_white: np.ndarray,
    known_noise: bool,
    plain: Fit | None,
) -> list[tuple[GreyBox, Task]]:
    """Fit the believed model roughly, from its own values and from a least-squares fit.

    A least-squares fit of a model that lacks physics may bend its parameters
    far. Which start is the better one shows only once each is settled in the
    linearisation along its own trajectories.
    """
    base = super_model.base
    starts: list[tuple[Mapping[str, float], Sequence[np.ndarray]]] = [
        (base.values, starting_states(base, train))
    ]
    if plain is not None:
        starts.append((plain.model.values, plain.initial_states))
    free = base.free_names
    found: list[tuple[GreyBox, Task]] = []
    for values, initial in starts:
        runs = super_model.run(train, initial, values, sensitivities=False)
        if runs is None:
            continue
        try:
            lines = deviations(base.with_values(values), train, [run.states for run in runs])
        except SimulationError:
            continue
        scaled = replace(units, force=_force_units(lines, units))
        task = Task(super_model, train, lines, scaled, known_noise, least_white)
        quiet = replace(scaled, colour=0 * scaled.colour)
        fit = estimate(task, free, values, initial, quiet, max_iterations=6, tolerance=1.0)
        if fit is not None:
            found.append((fit, task))
    if not found:
        raise SimulationError(
            f"Model {base.name!r} diverges on the training records from every start that was "
            "tried. Check signs and units of its values, or bound its parameters."
        )
    return found


def _force_units(lines: Sequence[Deviations], units: NoiseModel) -> np.ndarray:
    """Force on each axis that moves some output by its noise within a correlation time."""
    sizes = []
    for line in lines:
        held = units.force_time / line.sample_time
        response = np.abs(line.output[:-1] @ line.force_gain[:-1]) * held
        typical = np.median(response, axis=0) / units.white[:, None]
        # A force whose rate passes through kinematics first shows after a while only.
        sizes.append(typical.max(axis=0))
    largest = np.mean(sizes, axis=0)
    return 1.0 / np.where(largest > 0, largest, 1.0)
