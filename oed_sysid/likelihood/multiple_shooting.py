"""Maximum likelihood by multiple shooting: the project's own estimator."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError, SimulationError, respelled
from oed_sysid.likelihood import estimator, noise_levels
from oed_sysid.likelihood.departures import (
    CLEARLY,
    clear_departure,
    clear_starts,
    estimate_departures,
    followed,
)
from oed_sysid.likelihood.disturbances import Place, chosen_places, commands, declared_noise
from oed_sysid.likelihood.estimate import Departure, ProcessNoiseTest
from oed_sysid.likelihood.estimator import Solver
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import (
    FEW,
    FIRST_STEPS,
    FilteredSolution,
    Progress,
    Solution,
    solve,
)
from oed_sysid.likelihood.integration import resolved
from oed_sysid.likelihood.judgement import concerns_of, with_verdict
from oed_sysid.likelihood.laws import posed_again
from oed_sysid.likelihood.noise_model import Disturbances, NoiseModel, forces_in, seas_in
from oed_sysid.likelihood.nonlinear_program import constrained, solve_constrained, solve_within
from oed_sysid.likelihood.random_forces import fit_disturbed
from oed_sysid.likelihood.score_test import ScoreTest, Setting, Start, score_test
from oed_sysid.likelihood.sea_search import sea_beside_white
from oed_sysid.likelihood.shooting import Point, Shooting, loss_by_name
from oed_sysid.likelihood.smoother import outlying
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.likelihood.summary import Procedure, summarise, summarise_filtered
from oed_sysid.likelihood.unknowns import KnownStarts, StartState
from oed_sysid.likelihood.windows import check_horizon, solve_windows, wide_start
from oed_sysid.physics.base import RandomProcess
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import MATERIAL, ROUNDING, TOLD_APART
from oed_sysid.runtime.threads import one_thread

# Ends of a white fit that are where it was going.
ENDED = ("converged", "enough")
# Ends of a fit whose values are not returned where another fit has ended well.
FAILED = ("stalled", "diverged", "runaway", "integration", "degenerate")

Minimiser = Callable[..., Solution]


@dataclass(frozen=True)
class MultipleShooting:
    """Maximum-likelihood estimation by condensed multiple shooting.

    All records are fitted at once, initial states free. The generalized
    Gauss-Newton method follows Bock (1987), *Randwertproblemmethoden zur
    Parameteridentifizierung*, with a line search on an exact penalty function.
    Far from the solution a ladder of short free-node intervals finds the way.

    Parameters
    ----------
    interval : float or None
        Length of a shooting interval, s. ``None`` chooses about thirty per
        record, of at most a hundred samples; infinity is single shooting.
    noise : str or sequence of float
        ``"auto"`` takes declared noise levels and estimates the others, and those that the records
        show to be too small (:func:`~oed_sysid.likelihood.noise_levels.believed_levels`);
        ``"given"`` insists on declared ones, ``"estimate"`` estimates all; or
        one standard deviation per output.
    loss : str
        ``"auto"`` is the square, and leaves out samples that clearly are spikes at the fit
        without process noise, before process noise is tested for (NaN in the fit's own data,
        counted in ``fit.excluded`` and in the report); ``"square"`` keeps them;
        ``"huber"`` and ``"student"`` let them count less. With a ``horizon``, ``"auto"`` is
        the square.
    start : str
        ``"auto"``, ``"near"`` (trust the start values) or ``"wide"``.
    coloured : str
        ``"auto"`` reports the sandwich covariance where residuals are
        correlated; ``"never"`` and ``"always"`` force it.
    progress : callable or None
        Called with a :class:`~oed_sysid.likelihood.gauss_newton.Progress` after every iteration.
    solver : Solver
        Method, iterations, tolerance; constraints among parameters.
    disturbances : str, Sea or sequence of these
        Disturbance forces. ``"auto"`` tests at the white fit whether any act (a score test
        at variance zero) and, if so, estimates their levels and times with everything
        else; ``"none"`` takes residuals for sensor noise; ``"all"`` admits a force in
        every equation; or the equations, states or places that are disturbed, such as
        ``("Z", "M")`` or ``("actuator fin",)``. Where forces act, narrow-band ones are tested
        for and taken in their place (:mod:`oed_sysid.likelihood.sea_search`);
        ``Sea(period=8.0)`` declares one, of which what is left out is estimated; ``"sea"`` is
        ``Sea()``. See
        :mod:`oed_sysid.likelihood.noise_model`.
    horizon : float or None
        How far ahead the fit has to be right, s: records are predicted in windows of this
        length, each from a start state of its own (:mod:`oed_sysid.likelihood.windows`). ``None``
        predicts whole records. A short horizon keeps misfit of structure out of the
        derivatives; disturbance forces are then not looked for.

    Examples
    --------
    >>> MultipleShooting(loss="student", disturbances="none").name
    'multiple shooting, student loss'
    """

    interval: float | None = None
    noise: str | Sequence[float] = "auto"
    loss: str = "auto"
    start: str = "auto"
    coloured: str = "auto"
    progress: Callable[[Progress], None] | None = None
    solver: Solver = Solver()  # noqa: RUF009 (frozen)
    disturbances: Disturbances = "auto"
    horizon: float | None = None

    def __post_init__(self) -> None:
        estimator.check_choice("start", self.start, ("auto", "near", "wide"))
        estimator.check_choice("coloured", self.coloured, ("auto", "never", "always"))
        estimator.check_levels(self.noise)
        estimator.check_disturbances(self.disturbances)
        if self.interval is not None:
            advice = "Give a positive length in s, infinity for single shooting, or None."
            estimator.check_positive("Shooting interval", self.interval, advice, infinite=True)
        if not isinstance(self.solver, Solver):
            raise ModelError(f"solver is {self.solver!r}. Write solver=Solver({self.solver!r}).")
        loss_by_name(self.loss)
        if self.horizon is not None:
            advice = "Give seconds above zero, or None, which predicts whole records."
            estimator.check_positive("horizon", self.horizon, advice)
        forces, ahead = self.disturbances not in ("auto", "none"), self.horizon is not None
        program, asked = self.solver.method == "ipopt", f"disturbances={self.disturbances!r}"
        if ahead and forces:
            raise ModelError(f"{asked} needs whole records. Drop it or the horizon.")
        if ahead and any((program, self._white_only, self.interval is not None)):
            raise ModelError(
                "A horizon goes with Solver('gauss-newton'), loss='auto' or 'square' and "
                "interval=None: its windows are the intervals."
            )
        if forces and self._white_only:
            raise ModelError(
                f"{asked} goes with loss='square' or 'auto'. Drop the other setting, or take "
                "disturbances='none'."
            )

    @property
    def _white_only(self) -> bool:
        """Whether the settings leave no room for disturbance forces."""
        return self.loss not in ("auto", "square")

    @property
    def _leaves_out(self) -> bool:
        """Whether samples that stand out are left out."""
        return self.loss == "auto" and self.horizon is None

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        interval = "" if self.interval is None else f", interval {self.interval:g} s"
        loss = "" if self.loss in ("auto", "square") else f", {self.loss} loss"
        solver = ", IPOPT" if self.solver.method == "ipopt" else ""
        horizon = "" if self.horizon is None else f", {self.horizon:g} s ahead"
        return f"multiple shooting{interval}{loss}{solver}{horizon}"

    def fit(
        self,
        model: Model,
        dataset: Dataset,
        *,
        warm: Fit | None = None,
        initial_states: Sequence[Mapping[str, float]] | None = None,
        start_states: StartState | Sequence[StartState] | None = None,
    ) -> Fit:
        """Estimate the free parameters and initial states.

        Parameters
        ----------
        model : Model
            Its values are the start values.
        dataset : Dataset
            Measured records with the model's channels.
        warm : Fit, optional
            Start from the free parameters of an earlier fit, possibly of a
            model with other effects, and from its initial states where it saw
            the same record. Its noise levels start those to be estimated.
        initial_states : sequence of mapping, optional
            Start guesses of states, one mapping per record; by default from
            the measurements.
        start_states : mapping or sequence of mapping, optional
            What is known of the start states, one mapping for all records or one
            for each: a number is held exactly, a pair ``(value, std)`` is a value
            with its standard error, and a state that is not named is free.

        Returns
        -------
        Fit
            Even when the iterations fail: see ``fit.status``.

        Raises
        ------
        DataError, ModelError
            If data and model do not belong together.
        """
        with one_thread():
            known = KnownStarts.of(model, dataset, start_states)
            guessed = KnownStarts.of(model, dataset, initial_states, "initial_states")
            if warm is not None and warm.integration is not None:
                model = replace(model, step=min(model.step, warm.model.step))
            given = _Given(model, dataset, warm, guessed, known)

            def again(step: float, at: Fit) -> Fit:
                finer = replace(model, step=step)
                return self._fit(replace(given, model=finer, warm=at, initial_states=None))

            return resolved(self._fit(given), again)

    def begun(self, model: Model, dataset: Dataset) -> Fit:
        """Where another estimation may begin: a fit that may depend on the integration step.

        Parameters, returns and errors are those of :meth:`fit`.
        """
        with one_thread():
            return self._fit(_Given(model, dataset, None, None, None))

    def departing(
        self, fit: Fit, starts: KnownStarts | None = None
    ) -> tuple[Departure | None, float]:
        """The departure that explains most of what a fit to white noise leaves, if one is clear.

        Parameters
        ----------
        fit : Fit
            To white noise.
        starts : KnownStarts, optional
            What is known of its start states.

        Returns
        -------
        Departure or None
            Where it is most of the misfit, estimated to its end.
        float
            Log-likelihood of the records without it.
        """
        one = clear_departure(fit, estimate_departures(fit))
        if one is None:
            return None, -np.inf
        if one.share < 0.5:  # most of the misfit is something else
            return one, fit.log_likelihood + 0.5 * one.gain
        plain = replace(self, loss="square", disturbances="none", coloured="never")

        def refit(records: Dataset) -> Fit:
            return plain._fit(_Given(fit.model, records, fit, None, starts))

        return followed(fit, one, refit)

    def _fit(self, given: _Given) -> Fit:
        """The fit with process noise where it acts; by IPOPT from that without constraints."""
        check_channels(given.model, given.dataset)
        wanted = self._wants_process_noise(given.model, given.dataset)
        if wanted and self.solver.method == "ipopt":
            return self._of_innovations(given) or self._by_shooting(given, wanted=False)
        return self._by_shooting(given, wanted=wanted)

    def _by_shooting(self, given: _Given, *, wanted: bool) -> Fit:
        """The fit with process noise if it is ``wanted``, after first steps without or all of them.

        First steps to white noise lead where process noise, or what departs, has bent them.
        """
        soon = self._by_steps(given, wanted=wanted, patient=False)
        if not wanted or soon.status.ok or soon.status.code in _STAYS:
            return soon
        late = self._by_steps(given, wanted=wanted, patient=True)
        return late if late.status.ok else soon

    def _by_steps(self, given: _Given, *, wanted: bool, patient: bool) -> Fit:
        task, warm = self._task(given), given.warm
        model = task.shooting.model
        point = task.shooting.warm_point(warm if given.initial_states is None else None)
        # Where process noise may follow, residuals that are no white noise end the iterations
        # soon, and their autocorrelation is weighed only if none does.
        task = replace(task, carried=_carried(task.shooting, point, warm) if wanted else None)
        end = self._without_process_noise(task, point, early=wanted and not patient)
        fit = white = self._summary(task, end, weighed=not wanted)
        disturbed = None
        if fit.status.code != "interrupted":
            fit = self._without_spikes(fit, task)
            fit, disturbed = self._disturbed(fit, task) if wanted else (fit, None)
        if disturbed is not None:
            disturbed = replace(disturbed, excluded=fit.excluded)
            disturbed = _judged(self._settled(disturbed, given), model)
            code = _fault(disturbed, fit)
            if not code or not self._tests(model):
                return disturbed
            fit = _failed(fit, code)
        fit = _judged(self._weighed(fit, white, task, end) if wanted else fit, model)
        return fit if disturbed is None else _either(fit, disturbed)

    def _of_innovations(self, given: _Given) -> Fit | None:
        """The fit by IPOPT where process noise acts, from that without constraints; else None."""
        condensed = replace(
            self, solver=replace(self.solver, method="gauss-newton", constraints=())
        )
        free = condensed._fit(given)
        if free.status.code == "interrupted":
            return free
        if free.noise.is_white or not free.status.ok:
            return None
        began = time.perf_counter()
        problem, begin = posed_again(free, given.known_starts, levels=True)
        ended = solve_constrained(
            problem,
            Point(begin, ()),
            self.solver.constraints,
            max_iterations=self.solver.max_iterations,
            tolerance=self.solver.tolerance,
        )
        end = FilteredSolution(*ended)
        if end.finite is None:
            return None
        iterations, name = free.iterations + end.iterations, f"{self.name}, disturbance forces"
        how = Procedure(name, free.sigma_estimated, iterations, began - free.seconds)
        found = constrained(summarise_filtered(end, how), end, self.solver.constraints)
        own = with_levels(found.model, found.noise)
        found = replace(found, model=own, process_noise=free.process_noise, excluded=free.excluded)
        return _judged(found, given.model)

    def _task(self, given: _Given) -> _Task:
        """The problem without process noise, and what is known of it."""
        began = time.perf_counter()
        model, dataset, warm = given.model, given.dataset, given.warm
        earlier = None if warm is None else warm.sigma
        sigma, estimated = noise_levels.start_levels(model, dataset, self.noise, earlier)
        if warm is not None:
            values = warm.model.values | warm.values
            model = model.within_bounds({n: values[n] for n in model.free_names if n in values})
        shooting = Shooting(
            model,
            dataset,
            sigma,
            interval=self.interval,
            loss=loss_by_name(self.loss),
            initial_states=given.initial_states,
            known_starts=given.known_starts,
        )
        shooting.check_enough_samples()
        if self.horizon is not None:
            check_horizon(shooting, self.horizon)
        how = Procedure(self.name, estimated, 0, began, self.coloured)
        return _Task(shooting, how)

    def _wants_process_noise(self, model: Model, dataset: Dataset) -> bool:
        """Whether process noise is to be tested for or estimated."""
        asked = self.disturbances != "none" or bool(declared_noise(model))
        series = not all(record.independent for record in dataset)
        return asked and series and self.horizon is None and not self._white_only

    def _tests(self, model: Model) -> bool:
        """Whether the records decide if process noise acts, and nobody has asked for it."""
        return self.disturbances == "auto" and not declared_noise(model)

    def _without_process_noise(self, task: _Task, point: Point, *, early: bool) -> Solution:
        """Iterations and levels of white noise; they end early where process noise may follow."""
        shooting, minimise = task.shooting, self._minimiser()
        carried = task.carried is not None
        # Soon where disturbance forces are known from an earlier fit.
        patience = FEW if carried else FIRST_STEPS
        first = partial(minimise, enough=_bent(shooting, patience)) if early else minimise
        end = first(shooting, point) if carried else self._solve(shooting, point, first)
        if carried and end.reason == "diverged":
            end = self._solve(shooting, point, first)
        return _with_noise(end, task.how.estimated, minimise)

    def _summary(self, task: _Task, end: Solution, *, weighed: bool = True) -> Fit:
        fit = summarise(end, replace(task.how, iterations=end.iterations), weighed=weighed)
        if end.reason == "diverged":
            return fit
        return constrained(fit, end, self.solver.constraints)

    def _weighed(self, fit: Fit, white: Fit, task: _Task, end: Solution) -> Fit:
        """The fit without process noise to its end, its errors with autocorrelated residuals."""
        early = end.reason == "enough"
        tests = any(record.independent for record in fit.dataset)
        if fit.covariance is not white.covariance or not (early or tests or fit.coloured):
            return fit
        if early:
            again = self._minimiser()(end.shooting, end.point)
            end = end if again.reason == "diverged" else _after(again, end)
        return replace(self._summary(task, end), process_noise=fit.process_noise)

    def _without_spikes(self, fit: Fit, task: _Task) -> Fit:
        """Fit again without samples that stand out alone, and how many of how many they were."""
        # Beside known process noise those that stand out are looked for at the end.
        if task.carried or not self._leaves_out:
            return fit
        plain = replace(self, loss="square", disturbances="none")
        # While some are left, they must not bend the residuals in which they are looked for.
        few = replace(self.solver, max_iterations=min(FIRST_STEPS, self.solver.max_iterations))
        # Nobody asks for the errors of these.
        looking = replace(plain, loss="student", solver=few, coloured="never")
        before, spent = _measured(fit.dataset), [fit.iterations]

        def again_by(way: MultipleShooting, dataset: Dataset, earlier: Fit | None) -> Fit:
            known = task.shooting.known_starts
            found = way._fit(_Given(task.shooting.model, dataset, earlier, None, known))
            spent.append(found.iterations)
            return found

        def without(again: Fit) -> Fit:
            for _ in range(4):  # large ones hide small ones
                left = _left(again, before)
                if left is None:
                    break
                again = again_by(looking, left, again)
            return again

        again = without(fit)
        outputs = [record.outputs for record in fit.dataset]
        if not (fit.status.ok or _is_white(again)) and noise_levels.stand_out(outputs):
            # Bent so far that none shows, or by process noise, which no samples take away: first
            # steps that outliers do not bend tell which.
            robust = without(again_by(looking, fit.dataset, None))
            if np.any(_measured(robust.dataset) < before):
                again = robust
        if again is fit:
            return fit
        again = again_by(plain, again.dataset, again)
        return replace(again, iterations=sum(spent), excluded=_excluded(again, before))

    def _settled(self, first: Fit, given: _Given) -> Fit:
        """The fit once more without the samples that stand out of its own motion, and no others."""
        fit = first
        for _ in range(4 * self._leaves_out):
            sides = _outlying(fit, given)
            if not sides.explained(fit, first):
                return first
            if sides.stay(at_first=fit is first):
                break
            data = noise_levels.without_spikes(given.dataset, sides.off)
            again = replace(self, loss="square")._fit(replace(given, dataset=data))
            if fit.status.ok and not again.status.ok:
                break
            fit = replace(again, excluded=_excluded(again, _measured(given.dataset)))
            if not fit.noise.has_forces:
                break
        return fit

    def _disturbed(self, fit: Fit, task: _Task) -> tuple[Fit, Fit | None]:
        """Go on from a white fit with process noise and autocorrelated sensors, where they act.

        Returns
        -------
        Fit
            The white one, with what was tested.
        Fit or None
            The one with process noise; None where none acts, or its estimation failed.
        """
        model = task.shooting.model
        declared = declared_noise(model)
        places, tests = self._places(model, declared), self._tests(model)
        if places is None:
            return fit, None
        setting = self._setting(fit, task, places, declared)
        starts = _starts(fit, setting)
        try:
            test = _score(fit, setting, starts[0], task.carried, tests=tests)
        except SimulationError:  # the model itself diverges: the status says so
            return fit, None
        fit = replace(fit, process_noise=ProcessNoiseTest(test.gain))
        if tests and _nothing_shows(test, fit, setting):
            return fit, None
        test = replace(test, noise=_declared_levels(test.noise, declared))
        begun = (starts,) if task.carried is None else ([task.carried], starts)
        found = self._likelier(fit, task, setting, begun, test)
        if found is None:
            return _failed(fit, "diverged"), None
        if tests and _no_likelier(found, fit):
            return fit, None
        own = with_levels(found.model, found.noise)
        asked = ProcessNoiseTest(test.gain)
        if fit.names:  # departures of signals and starts of actuators, which the forces absorb
            near = self._near(fit, found, task) if fit.status.code == "enough" else fit
            departure, told = self.departing(near, task.shooting.known_starts)
            asked = ProcessNoiseTest(
                test.gain,
                departure=departure,
                actuator_starts=clear_starts(fit),
                departure_likelier=told > found.log_likelihood,
            )
        return fit, replace(found, process_noise=asked, model=own)

    def _near(self, fit: Fit, found: Fit, task: _Task) -> Fit:
        """A fit to white noise near one with process noise, where that before it ended early.

        What departs may have bent the early one so far that it no longer shows.
        """
        few = replace(self.solver, max_iterations=FIRST_STEPS)
        plain = replace(
            self, loss="square", disturbances="none", coloured="never", solver=few, start="near"
        )
        near = plain._fit(_Given(fit.model, fit.dataset, found, None, task.shooting.known_starts))
        return near if near.log_likelihood > fit.log_likelihood else fit

    def _places(self, model: Model, declared: Sequence[RandomProcess]) -> tuple[Place, ...] | None:
        """Where process noise may act; None where there is no such place."""
        asked = forces_in(self.disturbances)
        try:
            places = () if asked == "none" else chosen_places(model, asked)
        except ModelError:
            if self._tests(model):
                return None  # no equation in which a force could act
            if not declared:
                raise
            places = ()
        own = chosen_places(model, [process.place for process in declared])
        return tuple(dict.fromkeys((*places, *own)))

    def _setting(
        self, fit: Fit, task: _Task, places: Sequence[Place], declared: Sequence[RandomProcess]
    ) -> Setting:
        """What stays the same while noise is looked for."""
        floor, _ = noise_levels.credible_levels(fit.dataset)
        model, estimated = task.shooting.model, task.how.estimated
        chosen = self.disturbances not in ("auto", "all")
        stated = noise_levels.given_levels(model.outputs)
        own = self.noise if isinstance(self.noise, str) else "given"
        return Setting(
            model,
            fit.dataset,
            places,
            np.where(estimated, np.minimum(fit.sigma, floor), fit.sigma),
            estimated,
            declared=np.where(estimated, stated, np.nan) if own == "auto" else None,
            logged=() if chosen else commands(model),
            known=[process.place for process in declared if process.known],
            known_starts=task.shooting.known_starts,
            seas=seas_in(self.disturbances),
            any_sea=True,
            any_zero=True,
            max_iterations=self.solver.max_iterations,
        )

    def _likelier(
        self,
        fit: Fit,
        task: _Task,
        setting: Setting,
        begun: Sequence[Sequence[Start]],
        test: ScoreTest,
    ) -> Fit | None:
        """The first fit with process noise that is likelier, else the last; None if all fail."""
        found = None
        for starts in begun:
            try:
                solution = fit_disturbed(setting, starts, test, progress=self.progress)
            except np.linalg.LinAlgError:  # equations without numbers: no way on from there
                continue
            if solution.finite is None:
                continue
            iterations = fit.iterations + solution.iterations
            how = replace(task.how, name=f"{self.name}, disturbance forces", iterations=iterations)
            found = constrained(summarise_filtered(solution, how), solution)
            if not _no_likelier(found, fit):
                break
        return found

    def _minimiser(self) -> Minimiser:
        """What turns a problem and a point into a solution."""
        minimise: Minimiser = solve
        if self.horizon is not None:
            minimise = partial(solve_windows, horizon=self.horizon)
        if self.solver.method == "ipopt":
            minimise = partial(solve_within, constraints=self.solver.constraints)
        return partial(
            minimise,
            max_iterations=self.solver.max_iterations,
            tolerance=self.solver.tolerance,
            callback=self.progress,
        )

    def _solve(self, shooting: Shooting, point: Point, minimise: Minimiser) -> Solution:
        """Iterate from near, from far, or from both, and return the better end."""
        if self.start == "near" or self.horizon is not None:
            return minimise(shooting, point)
        ends, begin = list[Solution](), shooting.misfit(point)
        if self.start != "wide":
            ends.append(minimise(shooting, point))
            # A local minimum is worth a second attempt only if the start was doubtful.
            if _trusted(begin, shooting, ends[0]):
                return ends[0]
        try:
            ends.append(minimise(shooting, wide_start(shooting, point)))
        except KeyboardInterrupt:
            if not any(end.finite for end in ends):
                raise
            return replace(ends[0], reason="interrupted")
        return _better(ends)


_GONE = {
    name: f"solver=Solver({name}=...)" for name in ("max_iterations", "tolerance", "constraints")
}
MultipleShooting.__init__ = respelled(ModelError, _GONE)(MultipleShooting.__init__)  # type: ignore[method-assign]


# Ends that other first steps do not change.
_STAYS = ("interrupted", "degenerate", "integration")


@dataclass(frozen=True, eq=False)
class _Given:
    """What a fit is asked for: model and records, an earlier fit, and what is known of starts."""

    model: Model
    dataset: Dataset
    warm: Fit | None
    initial_states: KnownStarts | None
    known_starts: KnownStarts | None


@dataclass(frozen=True, eq=False)
class _Task:
    """What the stages of one fit share: the problem at its start values, and how it is solved.

    ``carried`` is where an earlier fit with process noise ended, to go on from.
    """

    shooting: Shooting
    how: Procedure
    carried: Start | None = None


def _after(end: Solution, *earlier: Solution) -> Solution:
    """An end, the iterations that led elsewhere before counted too."""
    return replace(end, iterations=end.iterations + sum(one.iterations for one in earlier))


def _with_noise(end: Solution, estimated: np.ndarray, minimise: Minimiser) -> Solution:
    """Alternate between noise levels and everything else until the levels stay."""
    shooting = end.shooting
    if end.reason == "diverged" or not estimated.any():
        return end
    least = ROUNDING * noise_levels.signal_spread(shooting.dataset)
    for _ in range(12):  # three or four suffice as a rule
        shown = noise_levels.residual_levels(end.residuals, end.problem.n_unknowns)
        sigma = np.where(estimated, np.maximum(shown, least), shooting.sigma)
        change = float(np.max(np.abs(np.log(sigma / shooting.sigma))))
        shooting = shooting.having(sigma=sigma)
        if change < 1e-3 or end.reason == "interrupted":
            break
        again = minimise(shooting, end.point)
        if again.reason == "diverged":
            break
        end = _after(again, end)
    return end.rated(shooting)


def _trusted(begin: float, shooting: Shooting, found: Solution) -> bool:
    """Whether an end is no doubtful minimum: it began or ended where noise may be what is left."""
    if found.reason not in ENDED:
        return found.reason == "interrupted"
    return min(begin, shooting.misfit(found.point)) < CLEARLY**2


def _better(ends: Sequence[Solution]) -> Solution:
    """The best of some ends, with the iterations of all."""
    best = min(ends, key=lambda s: (s.cost, s.reason not in ENDED))
    return _after(best, *(one for one in ends if one is not best))


def _judged(fit: Fit, begun: Model) -> Fit:
    """The fit with the values that it began from, and a status that holds for its own."""
    return with_verdict(replace(fit, nominal={p.name: p.value for p in begun.free_parameters}))


def _fault(disturbed: Fit, white: Fit) -> str:
    """How a fit with process noise failed; empty where its values are to be returned."""
    if disturbed.status.code in FAILED:
        return disturbed.status.code
    own, other = (
        all(np.isfinite(part).all() for part in fit.predictions) for fit in (disturbed, white)
    )
    # Those are runs from starts that the filter estimated; whole runs have their own.
    alone = not own and other and bool(disturbed.whole_runs.diverging)
    return "diverged" if alone else ""


def _either(fit: Fit, disturbed: Fit) -> Fit:
    """The fit without process noise unless it failed, too, and the other one has numbers.

    One that depends on its integration steps may be cured by finer ones
    (:func:`~oed_sysid.likelihood.integration.resolved`); one that has not converged is not.
    """
    curable = disturbed.status.code == "integration" and not fit.status.ok
    failed = curable or fit.status.code in FAILED
    return disturbed if failed and np.isfinite(disturbed.estimates).all() else fit


def _failed(fit: Fit, code: str) -> Fit:
    """The fit without process noise, told how the one with it ended."""
    assert fit.process_noise is not None
    return replace(fit, process_noise=replace(fit.process_noise, failed=code))


def _starts(fit: Fit, setting: Setting) -> list[Start]:
    """Where a fit with process noise begins: at the white fit, and at the values that were given.

    What the white one takes for noise may have bent its values into a valley of their own.
    """
    begin = Shooting(setting.model, fit.dataset, setting.white, known_starts=setting.known_starts)
    nominal = Start.at(begin, begin.start_unknowns())
    here = Start(fit.model.values, fit.initial_states, fit.local_values)
    return [here, nominal] if np.isfinite(fit.cost) else [nominal]


def _score(
    fit: Fit, setting: Setting, start: Start, carried: Start | None, *, tests: bool
) -> ScoreTest:
    """The score test at a white fit; where it only ``tests``, noisier sensors are asked first.

    Correlation times of the process noise that an earlier fit found come before others. Where
    forces of first order show nothing a sea is asked for.
    """

    def asked(setting: Setting) -> ScoreTest:
        test = score_test(setting, start)
        if not tests or test.gain >= TOLD_APART:
            return test
        return replace(test, gain=max(test.gain, sea_beside_white(setting, start, test)))

    quiet = replace(setting, white=np.maximum(fit.sigma, setting.white))
    factors = {one.signal: one.size for one in concerns_of(fit, "noise_level")} if tests else {}
    sizes = np.array([factors.get(name, 0.0) for name in fit.model.output_names])
    sizes[fit.sigma_estimated] = 0.0
    if (sizes > 1.0).any():
        # White noise above the declared level is no process noise.
        noisier = replace(quiet, white=np.maximum(sizes, 1.0) * quiet.white)
        test = asked(noisier)
        if test.gain < TOLD_APART:
            return test
    if carried is not None and carried.noise is not None:
        noise = carried.noise
        times = np.unique(noise.force_time[(noise.force > 0) & (noise.force_time > 0)]).tolist()
        test = score_test(quiet, start, times=times)
        if test.gain >= TOLD_APART:
            return test
    return asked(quiet)


def _excluded(fit: Fit, before: np.ndarray) -> dict[str, tuple[int, int]]:
    """Samples that were left out, of how many ``(n_outputs,)`` before, by output."""
    gone = (before - _measured(fit.dataset)).tolist()
    rows = zip(fit.model.output_names, gone, before.tolist(), strict=True)
    return {name: (count, n) for name, count, n in rows if count}


def _left(fit: Fit, before: np.ndarray) -> Dataset | None:
    """The records without samples that stand out alone; None where none does, or it diverged.

    ``before`` are the samples ``(n_outputs,)`` that were measured.
    """
    if not all(np.isfinite(part).all() for part in fit.predictions):
        return None
    taken = before - _measured(fit.dataset)
    known = ~fit.sigma_estimated
    single = noise_levels.spike_masks(
        fit.series,
        declared=known,
        taken=taken,
        stepped=lambda: [noise_levels.input_steps(record) for record in fit.dataset],
    )
    outputs = [record.outputs for record in fit.dataset]
    held = noise_levels.held_masks(outputs, fit.series, fit.sigma)
    masks = [one | other for one, other in zip(single, held, strict=True)]
    if not any(mask.any() for mask in masks):
        return None
    return noise_levels.without_spikes(fit.dataset, masks)


@dataclass(frozen=True, eq=False)
class _Sides:
    """Samples that a fit has left out, those that stand out of it, and whether no others do."""

    left: Sequence[np.ndarray]
    off: Sequence[np.ndarray]
    understood: bool

    def stay(self, *, at_first: bool) -> bool:
        """Whether few change sides, of a first fit none to those that stand out."""
        anew = any(np.any(b & ~a) for a, b in zip(self.left, self.off, strict=True))
        return noise_levels.settled(self.left, self.off) and not (at_first and anew)

    def explained(self, fit: Fit, first: Fit) -> bool:
        """Whether spikes explain what stands out, or the fit is none to go by.

        A first fit that spikes have bent hides some; of one that they have not, none stand out
        because others are gone: there it is the motion that is not understood.
        """
        bent = bool(first.excluded) or not first.status.ok
        hidden = bent or fit is first or noise_levels.settled(self.left, self.off)
        return not fit.status.ok or (self.understood and hidden)


def _outlying(fit: Fit, given: _Given) -> _Sides:
    """What stands out of the motion of a fit among all samples that were given."""
    pairs = zip(given.dataset, fit.dataset, strict=True)
    left = [np.isnan(kept.outputs) & ~np.isnan(one.outputs) for one, kept in pairs]
    stay = noise_levels.repeating(left, [record.outputs for record in given.dataset])
    try:
        whole = posed_again(replace(fit, dataset=given.dataset), given.known_starts)
        return _Sides(left, *outlying(*whole, stay))
    except (SimulationError, np.linalg.LinAlgError):
        return _Sides(left, left, understood=True)


def _measured(dataset: Dataset) -> np.ndarray:
    """Measured samples of every output, shape ``(n_outputs,)``."""
    return np.isfinite(np.vstack([record.outputs for record in dataset])).sum(axis=0)


def _carried(shooting: Shooting, point: Point, warm: Fit | None) -> Start | None:
    """Where an earlier fit with disturbance forces or coloured sensors ended, to go on from."""
    if warm is None or warm.noise is None or warm.noise.is_white:
        return None
    return Start.at(shooting, point.unknowns, warm.noise)


def _is_white(fit: Fit) -> bool:
    """Whether white noise of its levels may have left a fit's residuals; see :func:`_bent`."""
    errors = np.concatenate([part.ravel() for part in fit.series])
    with np.errstate(over="ignore"):  # of a run that diverges
        return bool(np.isfinite(errors).any() and np.nanmean(errors**2) <= CLEARLY**2)


def _bent(shooting: Shooting, patience: int) -> Callable[[Progress], bool]:
    """Tell when residuals are no white noise of the given levels, wherever iterations end."""
    count = sum(int(np.isfinite(record.outputs).sum()) for record in shooting.records)
    large = 0.5 * CLEARLY**2 * count

    def told(progress: Progress) -> bool:
        # Steps that promise less than a material share of the cost leave these residuals.
        promised = max(progress.decrement, 0.0)
        near = promised < MATERIAL * progress.cost
        return progress.iteration >= patience and near and progress.cost - promised > large

    return told


def with_levels(model: Model, noise: NoiseModel | None) -> Model:
    """The model with its random effects at the levels and times of a noise model."""
    if noise is None:
        return model
    effects = []
    for effect in model.effects:
        process = effect.noise
        if process is not None and process.place in noise.places:
            level, time = noise.level(process.place)
            effect = replace(effect, noise=replace(process, level=level, time=time))
        effects.append(effect)
    return replace(model, effects=tuple(effects))


def _declared_levels(noise: NoiseModel, declared: Sequence[RandomProcess]) -> NoiseModel:
    """Levels to begin with, those that a model's random effects state among them."""
    force, time = noise.force.copy(), noise.force_time.copy()
    for process in declared:
        index = noise.places.index(process.place)
        if process.level > 0:
            force[index] = process.level
        time[index] = process.time
    return replace(noise, force=force, force_time=time)


def _nothing_shows(test: ScoreTest, fit: Fit, setting: Setting) -> bool:
    """Whether a test at the white fit says that no process noise acts, where it can.

    Where residuals are far above what the signals show of noise that nobody declared, values may
    have followed what disturbs them, and a test tells nothing there.
    """
    beyond = np.array(list(fit.rms.values())) > CLEARLY * setting.white
    astray = setting.estimated.any() and (beyond.any() or not np.isfinite(fit.cost))
    return bool(test.gain < TOLD_APART and not astray)


def _no_likelier(disturbed: Fit, white: Fit) -> bool:
    """Whether disturbance forces and colours are not worth their freedom."""
    gain = 2.0 * (disturbed.log_likelihood - white.log_likelihood)
    return bool(gain < TOLD_APART)
