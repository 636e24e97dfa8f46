"""Multistart: one estimator from many start values, the best result kept.

Profile likelihood: how far one parameter can move before the data object.

A standard error assumes that the misfit is a parabola. The profile does not:
the parameter is held at one value after the other, everything else is
estimated anew, and the interval ends where the misfit has risen by the
quantile of the chi-squared distribution (Venzon & Moolgavkar 1988).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.special import gammaincinv

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError, located
from oed_sysid.likelihood.covariance import ReducedProblem
from oed_sysid.likelihood.estimate import Attempts
from oed_sysid.likelihood.estimator import Estimator, check_count, check_positive
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import Solution, nowhere, solve
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.shooting import Point, Shooting, loss_by_name
from oed_sysid.likelihood.unknowns import KnownStarts
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.constants import NEGLIGIBLE
from oed_sysid.runtime.parallel import CellProgress, run_cells

# Twice the log-likelihood may differ by this much among starts that found the same optimum, and at
# the end of a profile from its quantile: a quarter of a per cent of a 95 % interval.
SAME_OPTIMUM = 2.0 * NEGLIGIBLE


@dataclass(frozen=True)
class Multistart:
    """Repeat an estimation from start values spread over a region.

    Where several optima exist, one start proves nothing. Starts run on all
    cores, or on a cluster (:mod:`oed_sysid.runtime.parallel`).

    Parameters
    ----------
    estimator : Estimator
        By default :class:`MultipleShooting`.
    n_starts : int
        Starts, of which the first is the model's own values.
    span : float
        Where a parameter has no finite bounds, starts lie within so many of its
        typical magnitudes of its value. Within finite bounds they are uniform.
    seed : int
        Of the start values.
    n_jobs : int
        Processes; all cores by default.
    store : path, optional
        Folder that keeps the fits, so that an interrupted multistart goes on.
        It belongs to one model, data set and estimator.
    progress : callable, optional
        Called with a :class:`~oed_sysid.runtime.parallel.CellProgress` after every start.

    Examples
    --------
    >>> Multistart(n_starts=5, seed=1).name
    'multiple shooting, best of 5 starts'
    """

    estimator: Estimator = field(default_factory=MultipleShooting)
    n_starts: int = 20
    span: float = 1.0
    seed: int = 0
    n_jobs: int = -1
    store: str | Path | None = None
    progress: Callable[[CellProgress], None] | None = None

    def __post_init__(self) -> None:
        check_count("n_starts", self.n_starts, least=2)
        check_positive("span", self.span, "Give a positive number.", infinite=True)

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return f"{self.estimator.name}, best of {self.n_starts} starts"

    def starts(self, model: Model) -> list[dict[str, float]]:
        """Start values: the model's own, then a Latin hypercube over the region."""
        # Here, not above: SciPy's statistics take a third of a second to import.
        from scipy.stats.qmc import LatinHypercube

        free = model.free_parameters
        if not free:
            raise ModelError(f"Model {model.name!r} has no free parameter to start elsewhere.")
        shares = LatinHypercube(len(free), rng=np.random.default_rng(self.seed))
        lower, upper = np.array([self._region(p) for p in free]).T
        spread = lower + shares.random(self.n_starts - 1) * (upper - lower)
        logged = np.array([p.log for p in free])
        spread[:, logged] = np.exp(spread[:, logged])
        rows = ([p.value for p in free], *spread)
        return [dict(zip(model.free_names, map(float, row), strict=True)) for row in rows]

    def _region(self, parameter: Parameter) -> tuple[float, float]:
        """Least and greatest start value; their logarithms where that is what is estimated."""
        low, high, value = parameter.lower, parameter.upper, parameter.value
        reach = self.span * parameter.magnitude
        if parameter.log:
            low, high = (np.log(end) if end > 0 else -np.inf for end in (low, high))
            value, reach = np.log(value), self.span
        return (
            low if np.isfinite(low) else value - reach,
            high if np.isfinite(high) else value + reach,
        )

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate from every start; return the most likely result.

        Returns
        -------
        Fit
            ``fit.attempts`` tells where every start ended; see
            :func:`oed_sysid.results.plot_waterfall`.
        """
        began = time.perf_counter()
        starts = self.starts(model)
        cells = {f"seed {self.seed}, start {i}": start for i, start in enumerate(starts)}
        work = partial(_fit_from, self.estimator, model, dataset)
        run = run_cells(work, cells, store=self.store, n_jobs=self.n_jobs, progress=self.progress)
        fits = list(run.values())
        likelihoods = np.array([fit.log_likelihood for fit in fits])
        # Priors are part of what is sought; noise levels that are estimated are too.
        goals = np.array([_goal(fit) for fit in fits])
        ok = np.array([fit.status.ok for fit in fits])
        best = max(range(len(fits)), key=lambda i: (ok[i], goals[i]))
        arrived = ok & (2.0 * (goals[best] - goals) < SAME_OPTIMUM)
        return replace(
            fits[best],
            estimator=self.name,
            seconds=time.perf_counter() - began,
            iterations=sum(fit.iterations for fit in fits),
            attempts=Attempts(tuple(starts), likelihoods, -2.0 * goals, ok, int(arrived.sum())),
        )


def _fit_from(
    estimator: Estimator, model: Model, dataset: Dataset, start: Mapping[str, float]
) -> Fit:
    return estimator.fit(model.with_values(dict(start)), dataset)


def _goal(fit: Fit) -> float:
    """Log-likelihood and log-density of the priors, up to a constant."""
    away = []
    for name, value in fit.values.items():
        one = fit.model.parameter(name)
        if one.prior_std is not None and one.prior_mean is not None:
            off = np.log(value / one.prior_mean) if one.log else value - one.prior_mean
            away.append(off / one.prior_std)
    for known, own in zip(fit.start_states, fit.initial_states, strict=False):
        values = dict(zip(fit.model.state_names, own, strict=True))
        away += [(values[name] - mean) / std for name, (mean, std) in known.items() if std > 0]
    total = fit.log_likelihood - 0.5 * float(np.sum(np.square(away)))
    return total if np.isfinite(total) else -np.inf


@dataclass(frozen=True, eq=False)
class Profile:
    """Profile likelihood of one parameter.

    Attributes
    ----------
    name, unit : str
        The parameter.
    estimate : float
        Value of the fit.
    level : float
        Confidence level of the interval.
    lower, upper : float
        Ends of the interval; infinite where the data do not bound it.
    values, rises : ndarray (n_points,)
        The curve, by increasing value: held value and the rise of twice the
        negative log-likelihood over its least value.
    threshold : float
        Rise at the ends of the interval.
    lower_end, upper_end : str
        Why the interval ends there: ``data``, ``bound``, ``open`` or
        ``diverged`` (beyond the end no trajectory is finite).

    Examples
    --------
    What :func:`profile` returns.
    """

    name: str
    unit: str
    estimate: float
    level: float
    lower: float
    upper: float
    values: np.ndarray
    rises: np.ndarray
    threshold: float
    lower_end: str
    upper_end: str

    @property
    def is_bounded(self) -> bool:
        """Whether the data themselves end the interval on both sides."""
        return self.lower_end == self.upper_end == "data"

    def report(self) -> str:
        """Return the interval in words."""
        text = (
            f"{self.name} = {self.estimate:.6g} {self.unit}".rstrip()
            + f", {100 * self.level:g} % interval [{self.lower:.6g}, {self.upper:.6g}]"
        )
        words = {
            "bound": "it ends at the parameter's bound, not because of the data",
            "open": f"the data do not bound it (tried as far as {self.values[0]:.3g} to "
            f"{self.values[-1]:.3g})",
            "diverged": "beyond it the model diverges",
        }
        for side, end in (("below", self.lower_end), ("above", self.upper_end)):
            if end in words:
                text += f"; {side}, {words[end]}"
        least = float(self.rises.min())
        if least < -0.1:
            best = self.values[int(self.rises.argmin())]
            text += (
                f"; a better fit was found at {best:.6g} (twice the log-likelihood rises by "
                f"{-least:.3g}): fit again from there"
            )
        return text + "."


def profile(
    fit: Fit,
    name: str,
    *,
    level: float = 0.95,
    loss: str = "square",
    interval: float | None = None,
) -> Profile:
    """Profile likelihood interval of one estimated parameter.

    Parameters
    ----------
    fit : Fit
        Its noise levels are kept; where its residuals are coloured the misfit
        counts less, by the ratio of the two variances of this parameter.
    name : str
        A parameter that all records share.
    level : float
        Confidence level.
    loss, interval
        As given to the estimator of the fit.

    Returns
    -------
    Profile

    Raises
    ------
    ModelError
        If the level is no share between 0 and 1, or the fit has no such parameter.

    Examples
    --------
    Of a parameter of a fit, with the interval that the data give it::

        found = profile(fit, "T")
        found.lower, found.upper
    """
    located(ModelError, "This fit has no shared parameter", [name], fit.names)
    if not 0.0 < level < 1.0:
        raise ModelError(f"level is {level}. Give a share between 0 and 1, for instance 0.95.")
    shooting = Shooting(
        fit.model,
        fit.dataset,
        fit.sigma,
        interval=interval,
        loss=loss_by_name(loss),
        known_starts=KnownStarts.of(fit.model, fit.dataset, fit.start_states or None),
    )
    walker = _Walker(shooting, fit, name, level)
    lower, lower_end = walker.find_end(-1.0)
    upper, upper_end = walker.find_end(1.0)
    curve = np.array(sorted(walker.curve))
    natural = np.exp if fit.model.parameter(name).log else np.asarray
    lower, upper = float(natural(lower)), float(natural(upper))
    return Profile(
        name=name,
        unit=fit.model.parameter(name).unit,
        estimate=float(natural(walker.estimate)),
        level=level,
        lower=lower,
        upper=upper,
        values=natural(curve[:, 0]),
        rises=curve[:, 1],
        threshold=walker.threshold,
        lower_end=lower_end,
        upper_end=upper_end,
    )


class _Walker:
    """Walks away from the optimum with one parameter held, everything else refitted."""

    def __init__(self, shooting: Shooting, fit: Fit, name: str, level: float) -> None:
        self.shooting = shooting
        self.position = shooting.layout.shared_names.index(name)
        found = solve(shooting, shooting.continuous(shooting.warm_unknowns(fit)))
        if not np.isfinite(found.cost):
            raise ModelError("The fit's own trajectory diverges; there is nothing to profile.")
        self.best = found
        self.estimate = float(found.point.unknowns[self.position])
        unknowns = found.point.unknowns
        white = ReducedProblem(shooting, found.linearisation, unknowns).information.covariance
        variance = white[self.position, self.position]
        reported = fit.std_errors[name] ** 2
        usable = np.isfinite(variance) and np.isfinite(reported) and variance > 0
        inflation = float(reported / variance) if usable else 1.0
        # Quantile of chi-squared of one degree of freedom (Wilks), times what colour adds to
        # variances.
        self.threshold = 2.0 * float(gammaincinv(0.5, level)) * inflation
        scale = float(shooting.limits.scale[self.position])
        slope = float(shooting.layout.shared_values(unknowns)[1][self.position])
        self.step = float(np.sqrt(reported)) / slope if usable else 0.1 * scale
        self.curve: list[tuple[float, float]] = [(self.estimate, 0.0)]

    def find_end(self, direction: float) -> tuple[float, str]:
        """Where the rise crosses the threshold on one side, and what ends it."""
        limits = self.shooting.limits
        bound = float((limits.lower if direction < 0 else limits.upper)[self.position])
        inner, inner_rise, solution = self.estimate, 0.0, self.best
        step = self.step
        for _ in range(12):  # doublings, after which the side is open
            value = inner + direction * step
            at_bound = (value - bound) * direction >= 0
            value = bound if at_bound else value
            there = self._refit(value, solution)
            if not np.isfinite(there.cost):
                if step < 1e-3 * self.step:
                    return inner, "diverged"
                step /= 4.0
                continue
            rise = self._record(value, there)
            if rise >= self.threshold:
                return self._refine((inner, inner_rise), (value, rise), solution)
            inner, inner_rise, solution = value, rise, there
            if at_bound:
                return bound, "bound"
            step *= 2.0
        return direction * np.inf, "open"

    def _refine(
        self, inner: tuple[float, float], outer: tuple[float, float], near: Solution
    ) -> tuple[float, str]:
        """Find the crossing between two values, secant steps on the root of the rise."""
        root, value = np.sqrt(self.threshold), outer[0]
        for _ in range(12):
            # The rise is nearly a parabola, so that its root is nearly straight.
            low, high = np.sqrt(max(inner[1], 0.0)), np.sqrt(outer[1])
            share = np.clip((root - low) / max(high - low, 1e-12), 0.05, 0.95)
            value = inner[0] + share * (outer[0] - inner[0])
            there = self._refit(value, near)
            rise = self._record(value, there)
            if abs(rise - self.threshold) < SAME_OPTIMUM:
                break
            if rise < self.threshold:
                inner, near = (value, rise), there
            else:
                outer = (value, rise if np.isfinite(rise) else outer[1])
        return float(value), "data"

    def _record(self, value: float, solution: Solution) -> float:
        rise = 2.0 * (solution.cost - self.best.cost)
        if np.isfinite(rise):
            self.curve.append((value, rise))
        return rise

    def _refit(self, value: float, near: Solution) -> Solution:
        """Everything else estimated at a held value; of infinite cost where no search ends well."""
        unknowns = near.point.unknowns.copy()
        unknowns[self.position] = value
        held = self.shooting.holding(np.array([self.position]), np.array([value]))
        # The neighbour's trajectory first; if that leads nowhere, the measurements.
        for start in (Point(unknowns, near.point.nodes), held.start_point(unknowns)):
            found = solve(held, start)
            if np.isfinite(found.cost) and found.reason != "stalled":
                return found
        return Solution(nowhere(held, found.point), 0, "diverged")
