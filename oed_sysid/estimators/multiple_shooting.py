"""Maximum likelihood by multiple shooting: the project's own estimator."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.dataset import Dataset
from oed_sysid.errors import DataError, ModelError
from oed_sysid.estimators.losses import loss_by_name
from oed_sysid.estimators.noise_levels import (
    given_levels,
    noise_floor,
    residual_levels,
    signal_spread,
)
from oed_sysid.estimators.summary import summarise
from oed_sysid.fit import Fit
from oed_sysid.free_nodes import climb
from oed_sysid.gauss_newton import Progress, Solution, solve
from oed_sysid.model import Model
from oed_sysid.shooting import Point, Shooting

# Lengths, in samples, of the free-node intervals on the wide way in; beyond the
# last one they triple until they reach the length of a shooting interval.
LADDER = (2, 4, 10, 30)
# A start trajectory further off than this (in noise units, per sample) is far.
FAR = 1e3


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
        record; infinity is single shooting.
    noise : str or sequence of float
        ``"auto"`` takes declared noise levels and estimates the others,
        ``"given"`` insists on declared ones, ``"estimate"`` estimates all; or
        one standard deviation per output.
    loss : str
        ``"square"``, or for outliers ``"huber"`` or ``"student"``.
    start : str
        ``"auto"``, ``"near"`` (trust the start values) or ``"wide"``.
    max_iterations, tolerance
        See :func:`oed_sysid.shooting.solve`.
    coloured : str
        ``"auto"`` reports the sandwich covariance where residuals are
        correlated; ``"never"`` and ``"always"`` force it.
    progress : callable or None
        Called with a :class:`~oed_sysid.shooting.Progress` after every iteration.
    """

    interval: float | None = None
    noise: str | Sequence[float] = "auto"
    loss: str = "square"
    start: str = "auto"
    max_iterations: int = 100
    tolerance: float = 1e-6
    coloured: str = "auto"
    progress: Callable[[Progress], None] | None = None

    def __post_init__(self) -> None:
        if self.start not in ("auto", "near", "wide"):
            raise ModelError(f"start is {self.start!r}. Choose auto, near or wide.")
        if self.coloured not in ("auto", "never", "always"):
            raise ModelError(f"coloured is {self.coloured!r}. Choose auto, never or always.")
        if isinstance(self.noise, str) and self.noise not in ("auto", "given", "estimate"):
            raise ModelError(
                f"noise is {self.noise!r}. Choose auto, given, estimate or a list of levels."
            )
        loss_by_name(self.loss)

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        interval = "" if self.interval is None else f", interval {self.interval:g} s"
        loss = "" if self.loss == "square" else f", {self.loss} loss"
        return f"multiple shooting{interval}{loss}"

    def fit(
        self,
        model: Model,
        dataset: Dataset,
        *,
        warm: Fit | None = None,
        initial_states: Sequence[Mapping[str, float]] | None = None,
    ) -> Fit:
        """Estimate the free parameters and initial states.

        Parameters
        ----------
        model : Model
            Its values are the start values.
        dataset : Dataset
            Measured records with the model's channels.
        warm : Fit, optional
            Start from the parameters and initial states of an earlier fit to
            the same records, possibly of a model with other effects.
        initial_states : sequence of mapping, optional
            Start guesses of states that are not measured, per record.

        Returns
        -------
        Fit
            Even when the iterations fail: see ``fit.status``.

        Raises
        ------
        DataError, ModelError
            If data and model do not belong together.
        """
        began = time.perf_counter()
        sigma, estimated = self._levels(model, dataset, warm)
        if warm is not None:
            known = set(model.parameter_names)
            model = model.with_values({k: v for k, v in warm.values.items() if k in known})
            if initial_states is None and len(warm.initial_states) == len(dataset):
                initial_states = [
                    dict(zip(warm.model.state_names, map(float, own), strict=True))
                    for own in warm.initial_states
                ]
        shooting = Shooting(
            model,
            dataset,
            sigma,
            interval=self.interval,
            loss=loss_by_name(self.loss),
            initial_states=initial_states,
        )
        point = shooting.start_point()
        if warm is not None and initial_states is not None:
            point = _with_initial_states(shooting, point, initial_states)
        solution, iterations = self._solve(shooting, point)
        if solution is None:
            return summarise(
                shooting, None, estimated, self.name, iterations, began, coloured=self.coloured
            )
        rounds = 12 if estimated.any() else 0
        for _ in range(rounds):
            levels = residual_levels(solution.linearisation.residuals, shooting.layout.n_unknowns)
            levels = np.maximum(levels, 1e-9 * signal_spread(dataset))
            new = np.where(estimated, levels, sigma)
            change = np.max(np.abs(np.log(new / sigma)))
            sigma = new
            shooting = shooting.with_sigma(sigma)
            if change < 1e-3:
                break
            again = solve(
                shooting,
                solution.point,
                max_iterations=self.max_iterations,
                tolerance=self.tolerance,
                callback=self.progress,
            )
            if again is None:
                break
            solution, iterations = again, iterations + again.iterations
        return summarise(
            shooting, solution, estimated, self.name, iterations, began, coloured=self.coloured
        )

    def _levels(
        self, model: Model, dataset: Dataset, warm: Fit | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Start values of the noise levels and which of them to estimate."""
        if not isinstance(self.noise, str):
            levels = np.asarray(self.noise, dtype=float)
            if levels.shape != (len(model.outputs),) or not np.all(levels > 0):
                raise ModelError(
                    f"noise gives {levels.shape} levels, expected {len(model.outputs)} positive "
                    f"ones, for {', '.join(model.output_names)}."
                )
            return levels, np.zeros(len(levels), dtype=bool)
        declared = given_levels(model.outputs)
        if self.noise == "given" and not np.all(np.isfinite(declared)):
            unknown = [o.name for o in model.outputs if o.noise_std is None]
            raise DataError(
                f"The noise level of {', '.join(unknown)} is not declared. Set noise_std on these "
                "outputs, or use noise='auto' to estimate it."
            )
        estimated = (
            np.ones(len(declared), dtype=bool)
            if self.noise == "estimate"
            else ~np.isfinite(declared)
        )
        floor = noise_floor(dataset)
        if warm is not None and warm.sigma.shape == floor.shape:
            floor = np.where(estimated, warm.sigma, floor)
        else:
            # Model errors dominate at first; a floor far below them would stiffen the start.
            floor = np.maximum(floor, 0.02 * signal_spread(dataset))
        return np.where(estimated, floor, declared), estimated

    def _solve(self, shooting: Shooting, point: Point) -> tuple[Solution | None, int]:
        options = {
            "max_iterations": self.max_iterations,
            "tolerance": self.tolerance,
            "callback": self.progress,
        }
        far = self.start == "wide" or (self.start == "auto" and _is_far(shooting, point))
        first = None if far else solve(shooting, point, **options)  # type: ignore[arg-type]
        if self.start == "near" or (first is not None and first.reason == "converged"):
            return first, first.iterations if first else 0
        second = solve(shooting, wide_start(shooting, point), **options)  # type: ignore[arg-type]
        done = sum(s.iterations for s in (first, second) if s is not None)
        found = [s for s in (first, second) if s is not None]
        if not found:
            return None, done
        return min(found, key=lambda s: (s.reason != "converged", s.cost)), done


def wide_start(shooting: Shooting, point: Point) -> Point:
    """Climb the ladder of free-node intervals from a far start."""
    shortest = min(len(record.times) for record in shooting.records)
    rungs = list(LADDER)
    while 3 * rungs[-1] <= shooting.interval_samples < shortest:
        rungs.append(3 * rungs[-1])
    plain = shooting.with_loss(None)
    unknowns = point.unknowns
    for n_samples in rungs:
        if 2 * n_samples <= shortest:
            unknowns = climb(plain, unknowns, n_samples)
    return shooting.start_point(unknowns)


def _is_far(shooting: Shooting, point: Point) -> bool:
    lin = shooting.linearise(point)
    if lin is None:
        return True
    count = sum(int(np.isfinite(residual).sum()) for residual in lin.residuals)
    return shooting.cost(lin, point.unknowns) > 0.5 * FAR * count


def _with_initial_states(
    shooting: Shooting, point: Point, initial_states: Sequence[Mapping[str, float]]
) -> Point:
    unknowns = point.unknowns.copy()
    for index, states in enumerate(initial_states):
        columns = shooting.layout.record_columns(index)[: shooting.layout.n_own]
        for column, name in zip(columns, shooting.model.state_names, strict=True):
            if name in states:
                unknowns[column] = states[name]
    return replace(point, unknowns=unknowns)
