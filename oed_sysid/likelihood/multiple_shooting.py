"""Maximum likelihood by multiple shooting: the project's own estimator."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import partial

import numpy as np

from oed_sysid.compiled.filtering import filter_kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError, SimulationError
from oed_sysid.likelihood.departures import clear_delay, clear_starts, estimate_delays
from oed_sysid.likelihood.disturbances import chosen_places
from oed_sysid.likelihood.disturbances import places as every_place
from oed_sysid.likelihood.estimator import (
    check_count,
    check_disturbances,
    check_levels,
    check_positive,
)
from oed_sysid.likelihood.filtered import disturbed_model
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import Progress, Solution, solve
from oed_sysid.likelihood.horizons import fit_horizons
from oed_sysid.likelihood.judgement import level_concerns, with_verdict
from oed_sysid.likelihood.noise_levels import (
    credible_levels,
    residual_levels,
    signal_spread,
    spike_masks,
    start_levels,
    without_spikes,
)
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.nonlinear_program import NonlinearProgram
from oed_sysid.likelihood.random_forces import (
    Start,
    fit_disturbed,
)
from oed_sysid.likelihood.score_test import CLEAR, Setting, score_test
from oed_sysid.likelihood.shooting import Point, Shooting, loss_by_name
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.likelihood.starts import (
    DOUBTFUL,
    FAR,
    GOOD,
    check_enough_samples,
    check_initial_states,
    misfit,
    warm_model,
    warm_point,
    wide_start,
)
from oed_sysid.likelihood.summary import summarise, summarise_filtered, with_step_advice
from oed_sysid.likelihood.unknowns import KnownStarts, StartState
from oed_sysid.physics.base import RandomProcess
from oed_sysid.physics.model import Model
from oed_sysid.physics.unknown import random_effects
from oed_sysid.runtime.threads import one_thread

# Residuals of a white fit, in noise, beyond which its values may be bent far off by what it takes
# for noise: random forces are then looked for from the start values too.
BENT = 3.0
# Iterations of a white fit after which such residuals end it where random forces are looked for,
# or known from an earlier fit, and the share of the cost that has to be left.
PATIENCE, KNOWN, ENOUGH = 8, 2, 0.7
# Ends of a white fit that are where it was going.
ENDED = ("converged", "enough")
# Ends of a fit whose values are not returned where another fit has ended well.
FAILED = ("stalled", "diverged", "runaway", "integration", "degenerate")
# Of two ends the one that converged is taken unless its cost is higher by this factor; an end that
# leaves this share of an output's motion is doubted.
WORSE, HALF = 1.2, 0.5
# Most alternations between noise levels and parameters; three or four suffice as a rule.
NOISE_ROUNDS = 12

# Most rounds in which spikes are looked for; large ones hide small ones.
SPIKE_ROUNDS = 4

Minimiser = Callable[..., Solution | None]


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
        ``"auto"`` takes declared noise levels and estimates the others,
        ``"given"`` insists on declared ones, ``"estimate"`` estimates all; or
        one standard deviation per output.
    loss : str
        ``"auto"`` is the square, and leaves out samples that clearly are spikes at the fit
        without process noise, before process noise is tested for (NaN in the fit's own data,
        counted in ``extras["excluded"]`` and in the report); ``"square"`` keeps them;
        ``"huber"`` and ``"student"`` let them count less. With a ``horizon``, ``"auto"`` is
        the square.
    start : str
        ``"auto"``, ``"near"`` (trust the start values) or ``"wide"``.
    max_iterations, tolerance
        See :func:`oed_sysid.likelihood.gauss_newton.solve`.
    coloured : str
        ``"auto"`` reports the sandwich covariance where residuals are
        correlated; ``"never"`` and ``"always"`` force it.
    progress : callable or None
        Called with a :class:`~oed_sysid.likelihood.gauss_newton.Progress` after every iteration.
    solver : str
        ``"gauss-newton"``, condensed and fast; or ``"ipopt"``, which holds
        every node as an unknown and takes constraints.
    hessian : str
        For IPOPT: ``"gauss-newton"`` or ``"exact"``.
    disturbances : str or sequence of str
        Random forces. ``"auto"`` tests at the white fit whether any act (a score test
        at variance zero) and, if so, estimates their levels and times with everything
        else; ``"none"`` takes residuals for sensor noise; ``"all"`` lets a force into
        every equation; or the equations, states or places that are disturbed, such as
        ``("Z", "M")`` or ``("actuator fin",)``. See :mod:`oed_sysid.likelihood.noise`.
    horizon : float or None
        How far ahead the fit has to be right, s: records are predicted in windows of this
        length, each from a start state of its own (:mod:`oed_sysid.likelihood.horizons`). ``None``
        predicts whole records. A short horizon keeps misfit of structure out of the
        derivatives; random forces are then not looked for.
    constraints : sequence of str
        For IPOPT: comparisons among parameters, such as ``"M_uq < 0"`` or
        ``"Y_v*N_r > N_v*Y_r"``. Standard errors ignore them.
    """

    interval: float | None = None
    noise: str | Sequence[float] = "auto"
    loss: str = "auto"
    start: str = "auto"
    max_iterations: int = 100
    tolerance: float = 1e-6
    coloured: str = "auto"
    progress: Callable[[Progress], None] | None = None
    solver: str = "gauss-newton"
    hessian: str = "gauss-newton"
    constraints: Sequence[str] = ()
    disturbances: str | Sequence[str] = "auto"
    horizon: float | None = None

    def __post_init__(self) -> None:
        if self.start not in ("auto", "near", "wide"):
            raise ModelError(f"start is {self.start!r}. Choose auto, near or wide.")
        if self.coloured not in ("auto", "never", "always"):
            raise ModelError(f"coloured is {self.coloured!r}. Choose auto, never or always.")
        check_levels(self.noise)
        check_disturbances(self.disturbances)
        if self.interval is not None:
            advice = "Give a positive length in s, infinity for single shooting, or None."
            check_positive("Shooting interval", self.interval, advice, infinite=True)
        if self.solver not in ("gauss-newton", "ipopt"):
            raise ModelError(f"solver is {self.solver!r}. Choose gauss-newton or ipopt.")
        if self.hessian not in ("exact", "gauss-newton"):
            raise ModelError(f"hessian is {self.hessian!r}. Choose exact or gauss-newton.")
        if self.constraints and self.solver != "ipopt":
            raise ModelError(
                "Constraints among parameters need solver='ipopt'; bounds of single parameters "
                "do not: give them as Parameter(lower=..., upper=...)."
            )
        check_count("max_iterations", self.max_iterations)
        check_positive("tolerance", self.tolerance, "Give a positive number.")
        loss_by_name(self.loss)
        if self.horizon is not None:
            self._check_horizon()
        if self.disturbances not in ("auto", "none") and self._white_only:
            raise ModelError(
                f"disturbances={self.disturbances!r} goes with solver='gauss-newton' and "
                "loss='square' or 'auto'. Drop the other setting, or take disturbances='none'."
            )

    def _check_horizon(self) -> None:
        """Refuse settings that short predictions have no place for."""
        advice = "Give seconds above zero, or None, which predicts whole records."
        check_positive("horizon", self.horizon, advice)
        if self.disturbances not in ("auto", "none"):
            raise ModelError(
                f"disturbances={self.disturbances!r} needs whole records. Drop it or the horizon."
            )
        squares = self.loss in ("auto", "square")
        if self.solver != "gauss-newton" or not squares or self.interval is not None:
            raise ModelError(
                "A horizon goes with solver='gauss-newton', loss='auto' or 'square' and "
                "interval=None: its windows are the intervals."
            )

    @property
    def _white_only(self) -> bool:
        """Whether the settings leave no room for random forces."""
        return self.solver == "ipopt" or self.loss not in ("auto", "square")

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        interval = "" if self.interval is None else f", interval {self.interval:g} s"
        loss = "" if self.loss in ("auto", "square") else f", {self.loss} loss"
        solver = f", IPOPT with {self.hessian} Hessian" if self.solver == "ipopt" else ""
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
            return self._fit(model, dataset, warm, initial_states, known)

    def _fit(
        self,
        model: Model,
        dataset: Dataset,
        warm: Fit | None,
        initial_states: Sequence[Mapping[str, float]] | None,
        known_starts: KnownStarts | None,
    ) -> Fit:
        began = time.perf_counter()
        check_channels(model, dataset)
        check_initial_states(model, dataset, initial_states)
        earlier = None if warm is None else warm.sigma
        sigma, estimated = start_levels(model, dataset, self.noise, earlier)
        if warm is not None:
            model = warm_model(model, warm)
        shooting = Shooting(
            model,
            dataset,
            sigma,
            interval=self.interval,
            loss=loss_by_name(self.loss),
            initial_states=initial_states,
            known_starts=known_starts,
        )
        check_enough_samples(shooting)
        if self.horizon is not None:
            if known_starts is not None and known_starts.of_series(dataset):
                raise ModelError(
                    "start_states are those of whole records; windows of a horizon begin from "
                    "states of their own. Drop one of the two."
                )
            return fit_horizons(
                shooting,
                self.horizon,
                estimated,
                estimator=self.name,
                max_iterations=self.max_iterations,
                tolerance=self.tolerance,
                coloured=self.coloured,
                progress=self.progress,
            )
        if self.solver == "ipopt":
            shooting = shooting.with_intervals(shooting.interval_samples)
        point = shooting.start_point()
        if warm is not None and initial_states is None:
            point = warm_point(shooting, warm)
        minimise = self._minimiser(shooting)
        asked = self.disturbances != "none" or bool(random_effects(model.effects))
        tests = any(record.independent for record in dataset)
        series = not all(record.independent for record in dataset)
        wanted = asked and series and not self._white_only
        # Where random forces may follow, residuals that are no white noise end the iterations
        # soon, and their colour is weighed only if none do.
        carried = _carried(shooting, point, warm) if wanted else None
        patience = PATIENCE if carried is None else KNOWN
        first = partial(minimise, enough=_bent(shooting, patience)) if wanted else minimise
        solution = None if carried is None else first(shooting, point)
        iterations = 0 if solution is None else solution.iterations
        if solution is None:
            solution, iterations = self._solve(shooting, point, first)
        if solution is not None and estimated.any():
            shooting, solution, more = self._estimate_noise(shooting, solution, estimated, minimise)
            iterations += more
        described = partial(
            summarise, estimated=estimated, estimator=self.name, began=began, coloured=self.coloured
        )
        fit = white = described(shooting, solution, iterations=iterations, weighed=not wanted)
        told: dict[str, object] = {
            "magnitudes": {p.name: p.magnitude for p in model.free_parameters},
            "nominal": {p.name: p.value for p in model.free_parameters},
        }
        if self.loss == "auto" and fit.status.code != "interrupted":
            fit, excluded = self._without_spikes(fit, model, known_starts)
            told |= {"excluded": excluded} if excluded else {}

        def judged(fit: Fit) -> Fit:
            """The fit with all that is told of it, and a status that holds for its values."""
            fit = with_step_advice(fit, shooting, solution)
            return with_verdict(replace(fit, extras={**fit.extras, **told}))

        disturbed = None
        if wanted and fit.status.code != "interrupted":
            left = fit.dataset
            fit, disturbed = self._disturbed(
                fit, model, left, estimated, began, known_starts, carried
            )
        if disturbed is not None:
            disturbed = judged(disturbed)
            chosen = self.disturbances != "auto" or bool(random_effects(model.effects))
            if chosen or disturbed.status.code not in FAILED:
                return disturbed
            told["process_noise_failed"] = disturbed.status.code
        early = solution is not None and solution.reason == "enough"
        if wanted and fit.covariance is white.covariance and (early or tests or fit.coloured):
            if solution is not None and early:
                solution = minimise(shooting, solution.point) or solution
                iterations += solution.iterations
            whole = described(shooting, solution, iterations=iterations)
            kept = {key: told for key, told in fit.extras.items() if key not in white.extras}
            fit = replace(whole, extras={**kept, **whole.extras})
        fit = judged(fit)
        unusable = fit.status.code in FAILED
        if disturbed is not None and unusable and np.isfinite(disturbed.estimates).all():
            return disturbed  # no better without process noise
        return fit

    def _without_spikes(
        self, fit: Fit, model: Model, known_starts: KnownStarts | None
    ) -> tuple[Fit, dict[str, tuple[int, int]]]:
        """Fit again without samples that stand out alone, and how many of how many they were."""
        before, again, iterations = _measured(fit.dataset), fit, fit.iterations
        plain = replace(self, loss="square", disturbances="none")
        # While some are left, they must not bend the residuals in which they are looked for.
        looking = plain if self.solver == "ipopt" else replace(plain, loss="student")
        for _ in range(SPIKE_ROUNDS):
            if not all(np.isfinite(part).all() for part in again.predictions):
                break
            masks = spike_masks(
                again.series,
                declared=~again.sigma_estimated,
                taken=before - _measured(again.dataset),
            )
            if not any(mask.any() for mask in masks):
                break
            left = without_spikes(again.dataset, masks)
            again = looking._fit(model, left, again, None, known_starts)
            iterations += again.iterations
        if again is fit:
            return fit, {}
        again = plain._fit(model, again.dataset, again, None, known_starts)
        after = _measured(again.dataset)
        counts = {
            name: (int(n - m), int(n))
            for name, n, m in zip(model.output_names, before, after, strict=True)
            if m < n
        }
        return replace(again, iterations=iterations + again.iterations), counts

    def _disturbed(
        self,
        fit: Fit,
        model: Model,
        dataset: Dataset,
        estimated: np.ndarray,
        began: float,
        known_starts: KnownStarts | None,
        carried: Start | None,
    ) -> tuple[Fit, Fit | None]:
        """Go on from a white fit with process noise and autocorrelated sensors, where they act.

        Returns
        -------
        Fit
            The white one, with what was tested.
        Fit or None
            The one with process noise; None where none acts, or its estimation failed.
        """
        declared = [e.noise for e in random_effects(model.effects) if e.noise is not None]
        auto = self.disturbances == "auto" and not declared
        asked = "all" if self.disturbances == "auto" else self.disturbances
        chosen = self.disturbances not in ("auto", "all")
        try:
            places = () if asked == "none" else chosen_places(model, asked)
        except ModelError:
            if self.disturbances == "auto" and not declared:
                return fit, None  # no equation in which a force could act
            if not declared:
                raise
            places = ()
        own = chosen_places(model, [process.place for process in declared])
        places = tuple(dict.fromkeys((*places, *own)))
        floor, _ = credible_levels(dataset)
        white = np.where(estimated, np.minimum(fit.sigma, floor), fit.sigma)
        inputs = [place for place in every_place(model) if place.stage == "actuator"]
        setting = Setting.of(
            dataset,
            places,
            white,
            estimated,
            inputs=() if chosen else inputs,
            known=[process.place for process in declared if process.known],
            known_starts=known_starts,
        )
        kernel = filter_kernel(disturbed_model(model, setting.disturbances))
        starts = [Start(fit.model.values, fit.initial_states, fit.local_values)]
        left = np.nan_to_num(np.array(list(fit.rms.values())) / white, posinf=np.inf)
        if not np.isfinite(fit.cost) or left.max() > BENT:
            begin = Shooting(model, dataset, white, known_starts=known_starts)
            unknowns = begin.start_unknowns()
            own_states = [begin.initial_state(unknowns, i) for i in range(len(begin.records))]
            nominal = Start(model.values, own_states, [{}] * len(own_states))
            starts = [*starts, nominal] if np.isfinite(fit.cost) else [nominal]
        quiet = replace(setting, white=np.maximum(fit.sigma, white))
        first = starts[0]
        at = model.with_values(dict(first.values))
        try:
            if auto and (larger := _larger_noise(fit, quiet.white)).any():
                # White noise above the declared level is no random force.
                louder = replace(quiet, white=np.where(larger, larger, quiet.white))
                gain = score_test(at, dataset, louder, first.initial, first.local, kernel).gain
                if gain < CLEAR:
                    return replace(fit, extras={**fit.extras, "disturbance_test": gain}), None
            look = partial(score_test, at, dataset, quiet, first.initial, first.local, kernel)
            test = look(times=_times(carried))
            if carried is not None and test.gain < CLEAR:
                test = look()
        except SimulationError:  # the model itself diverges: the status says so
            return fit, None
        fit = replace(fit, extras={**fit.extras, "disturbance_test": test.gain})
        if auto and test.gain < CLEAR:
            return fit, None
        test = replace(test, noise=_declared_levels(test.noise, declared))
        found = None
        for begun in ([carried], starts) if carried is not None else (starts,):
            try:
                solution = fit_disturbed(
                    model,
                    dataset,
                    setting,
                    begun,
                    test,
                    kernel=kernel,
                    max_iterations=self.max_iterations,
                    progress=self.progress,
                )
            except np.linalg.LinAlgError:  # equations without numbers: no way on from there
                solution = None
            if solution is None:
                continue
            name, iterations = f"{self.name}, random forces", fit.iterations + solution.iterations
            found = summarise_filtered(
                solution, estimated, name, iterations, began, coloured=self.coloured
            )
            if not _no_likelier(found, fit):
                break
        if found is None:
            return replace(fit, extras={**fit.extras, "process_noise_failed": "diverged"}), None
        extras = {**found.extras, "disturbance_test": test.gain}
        # Random forces absorb a delay, and the start of an actuator: both are looked for without.
        if fit.names and (late := clear_delay(fit, estimate_delays(fit))) is not None:
            extras["white_delay"] = (late.signal, late.kind, late.seconds, late.std)
        if fit.names and (elsewhere := clear_starts(fit)):
            extras["white_starts"] = tuple(astuple(one) for one in elsewhere)
        if auto and _no_likelier(found, fit):
            return fit, None
        return fit, replace(found, extras=extras, model=with_levels(found.model, found.noise))

    def _estimate_noise(
        self,
        shooting: Shooting,
        solution: Solution,
        estimated: np.ndarray,
        minimise: Minimiser,
    ) -> tuple[Shooting, Solution, int]:
        """Alternate between noise levels and everything else until the levels stay."""
        iterations = 0
        least = 1e-9 * signal_spread(shooting.dataset)
        for _ in range(NOISE_ROUNDS):
            residuals = solution.linearisation.residuals
            levels = residual_levels(residuals, shooting.n_unknowns)
            sigma = np.where(estimated, np.maximum(levels, least), shooting.sigma)
            change = float(np.max(np.abs(np.log(sigma / shooting.sigma))))
            shooting = shooting.with_sigma(sigma)
            if change < 1e-3 or solution.reason == "interrupted":
                break
            again = minimise(shooting, solution.point)
            if again is None:
                break
            solution, iterations = again, iterations + again.iterations
        cost = shooting.cost(solution.linearisation, solution.point.unknowns)
        return shooting, replace(solution, cost=cost), iterations

    def _minimiser(self, shooting: Shooting) -> Minimiser:
        """What turns a problem and a point into a solution."""
        minimise: Minimiser = solve
        if self.solver == "ipopt":
            minimise = NonlinearProgram(
                shooting, hessian=self.hessian, constraints=self.constraints
            ).solve
        return partial(
            minimise,
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
            callback=self.progress,
        )

    def _solve(
        self, shooting: Shooting, point: Point, minimise: Minimiser
    ) -> tuple[Solution | None, int]:
        begin = 0.0 if self.start == "near" else misfit(shooting, point)
        far = self.start == "wide" or (self.start == "auto" and begin > FAR)
        first = None if far else minimise(shooting, point)
        if self.start == "near" or (first is not None and first.reason == "interrupted"):
            return first, first.iterations if first else 0
        # A local minimum is worth a second attempt only if the start was doubtful.
        trusted = begin < DOUBTFUL or (first is not None and misfit(shooting, first.point) < GOOD)
        if first is not None and first.reason in ENDED and trusted:
            return first, first.iterations
        try:
            second = minimise(shooting, wide_start(shooting, point))
        except KeyboardInterrupt:
            if first is None:
                raise
            return replace(first, reason="interrupted"), first.iterations
        if self.start == "auto" and first is None and not _explains(shooting, second):
            first = minimise(shooting, point)  # what looked far may be the better side
        found = [s for s in (first, second) if s is not None]
        if not found:
            return None, 0
        least = min(s.cost for s in found)
        best = min(found, key=lambda s: (s.cost > WORSE * least, s.reason not in ENDED, s.cost))
        return best, sum(s.iterations for s in found)


def _measured(dataset: Dataset) -> np.ndarray:
    """Measured samples of every output, shape ``(n_outputs,)``."""
    return np.isfinite(np.vstack([record.outputs for record in dataset])).sum(axis=0)


def _carried(shooting: Shooting, point: Point, warm: Fit | None) -> Start | None:
    """Where an earlier fit with random forces or coloured sensors ended, to go on from."""
    if warm is None or warm.noise is None or warm.noise.is_white:
        return None
    whole, layout = point.unknowns, shooting.layout
    states, local = [], []
    for index in range(len(shooting.records)):
        own = layout.parameters(whole, index)
        states.append(shooting.initial_state(whole, index))
        local.append({layout.free_names[i]: float(own[i]) for i in layout.local})
    return Start(shooting.model.values, states, local, warm.noise)


def _times(carried: Start | None) -> list[float]:
    """Correlation times of the random forces that an earlier fit found, s."""
    noise = None if carried is None else carried.noise
    if noise is None:
        return []
    acting = (noise.force > 0) & (noise.force_time > 0)
    return sorted({float(time) for time in noise.force_time[acting]})


def _bent(shooting: Shooting, patience: int) -> Callable[[Progress], bool]:
    """Tell when residuals are no white noise of the given levels, wherever iterations end."""
    count = sum(int(np.isfinite(record.outputs).sum()) for record in shooting.records)
    large = 0.5 * BENT**2 * count

    def told(progress: Progress) -> bool:
        left = progress.cost - max(progress.decrement, 0.0)
        near = left > ENOUGH * progress.cost
        return progress.iteration >= patience and near and left > large

    return told


def _explains(shooting: Shooting, solution: Solution | None) -> bool:
    """Whether a solution leaves less than half of the motion of every output."""
    if solution is None:
        return False
    spread = signal_spread(shooting.dataset)
    residuals = np.vstack(solution.linearisation.residuals)
    seen = np.isfinite(residuals)
    squares = np.where(seen, residuals, 0.0) ** 2
    left = np.sqrt(squares.sum(axis=0) / np.maximum(seen.sum(axis=0), 1))
    return bool(np.all((left < HALF * spread) | (left < GOOD * shooting.sigma)))


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


def _larger_noise(fit: Fit, white: np.ndarray) -> np.ndarray:
    """White levels that are clearly above the declared ones; zero where they are not."""
    factors = {concern.signal: concern.size for concern in level_concerns(fit)}
    sizes = np.array([factors.get(name, 0.0) for name in fit.model.output_names])
    return np.where(sizes > 1.0, sizes * white, 0.0)


def _no_likelier(disturbed: Fit, white: Fit) -> bool:
    """Whether random forces and colours are not worth their freedom."""
    gain = 2.0 * (disturbed.log_likelihood - white.log_likelihood)
    return bool(gain < CLEAR)
