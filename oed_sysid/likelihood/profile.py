"""Profile likelihood: how far one parameter can move before the data object.

A standard error assumes that the misfit is a parabola. The profile does not:
the parameter is held at one value after the other, everything else is
estimated anew, and the interval ends where the misfit has risen by the
quantile of the chi-squared distribution (Venzon & Moolgavkar 1988).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from oed_sysid.errors import ModelError
from oed_sysid.likelihood.beginning import warm_unknowns
from oed_sysid.likelihood.covariance import ReducedProblem
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.gauss_newton import Solution, solve
from oed_sysid.likelihood.losses import loss_by_name
from oed_sysid.likelihood.shooting import Point, Shooting
from oed_sysid.likelihood.unknowns import KnownStarts

# Doublings of the step before a side is declared open, and refinements of an end.
MAXIMUM_DOUBLINGS = 12
REFINEMENTS = 12
# An end is known well enough when the misfit is within this share of its quantile.
CLOSE = 2e-3


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
    """
    if name not in fit.names:
        raise ModelError(
            f"{name!r} is not a shared parameter of this fit. There are: {', '.join(fit.names)}."
        )
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
    walker = _Walker(shooting, fit, name)
    threshold = 2.0 * float(gammaincinv(0.5, level)) * walker.inflation
    lower, lower_end = walker.find_end(-1.0, threshold)
    upper, upper_end = walker.find_end(1.0, threshold)
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
        threshold=threshold,
        lower_end=lower_end,
        upper_end=upper_end,
    )


class _Walker:
    """Walks away from the optimum with one parameter held, everything else refitted."""

    def __init__(self, shooting: Shooting, fit: Fit, name: str) -> None:
        self.shooting = shooting
        self.position = shooting.layout.shared_names.index(name)
        found = solve(shooting, shooting.continuous(warm_unknowns(shooting, fit)))
        if found is None:
            raise ModelError("The fit's own trajectory diverges; there is nothing to profile.")
        self.best = found
        self.estimate = float(found.point.unknowns[self.position])
        unknowns = found.point.unknowns
        white = ReducedProblem(shooting, found.linearisation, unknowns).information.covariance
        variance = white[self.position, self.position]
        reported = fit.covariance[fit.names.index(name), fit.names.index(name)]
        usable = np.isfinite(variance) and np.isfinite(reported) and variance > 0
        self.inflation = float(reported / variance) if usable else 1.0
        scale = float(shooting.limits.scale[self.position])
        slope = float(shooting.layout.shared_values(unknowns)[1][self.position])
        self.step = float(np.sqrt(reported)) / slope if usable else 0.1 * scale
        self.curve: list[tuple[float, float]] = [(self.estimate, 0.0)]

    def find_end(self, direction: float, threshold: float) -> tuple[float, str]:
        """Where the rise crosses the threshold on one side, and what ends it."""
        limits = self.shooting.limits
        bound = float((limits.lower if direction < 0 else limits.upper)[self.position])
        inner, inner_rise, solution = self.estimate, 0.0, self.best
        step = self.step
        for _ in range(MAXIMUM_DOUBLINGS):
            value = inner + direction * step
            at_bound = (value - bound) * direction >= 0
            value = bound if at_bound else value
            there = self._refit(value, solution)
            if there is None:
                if step < 1e-3 * self.step:
                    return inner, "diverged"
                step /= 4.0
                continue
            rise = self._record(value, there)
            if rise >= threshold:
                return self._refine((inner, inner_rise), (value, rise), solution, threshold)
            inner, inner_rise, solution = value, rise, there
            if at_bound:
                return bound, "bound"
            step *= 2.0
        return direction * np.inf, "open"

    def _refine(
        self,
        inner: tuple[float, float],
        outer: tuple[float, float],
        solution: Solution,
        threshold: float,
    ) -> tuple[float, str]:
        """Find the crossing between two values, secant steps on the root of the rise."""
        root = np.sqrt(threshold)
        value = outer[0]
        for _ in range(REFINEMENTS):
            low, high = np.sqrt(max(inner[1], 0.0)), np.sqrt(outer[1])
            share = np.clip((root - low) / max(high - low, 1e-12), 0.05, 0.95)
            value = inner[0] + share * (outer[0] - inner[0])
            there = self._refit(value, solution)
            if there is None:
                outer = (value, outer[1])
                continue
            rise = self._record(value, there)
            if abs(rise - threshold) < CLOSE * threshold:
                break
            if rise < threshold:
                inner, solution = (value, rise), there
            else:
                outer = (value, rise)
        return float(value), "data"

    def _record(self, value: float, solution: Solution) -> float:
        rise = 2.0 * (solution.cost - self.best.cost)
        self.curve.append((value, rise))
        return rise

    def _refit(self, value: float, near: Solution) -> Solution | None:
        unknowns = near.point.unknowns.copy()
        unknowns[self.position] = value
        held = self.shooting.holding(np.array([self.position]), np.array([value]))
        # The neighbour's trajectory first; if that leads nowhere, the measurements.
        for start in (Point(unknowns, near.point.nodes), held.start_point(unknowns)):
            found = solve(held, start)
            if found is not None and np.isfinite(found.cost) and found.reason != "stalled":
                return found
        return None
