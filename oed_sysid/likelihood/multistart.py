"""Multistart: one estimator from many start values, the best result kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.base import Estimator
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.parallel import CellProgress, run_cells

# Twice the log-likelihood may differ by this much among starts that found the same optimum.
SAME_OPTIMUM = 0.02


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
    """

    estimator: Estimator = field(default_factory=MultipleShooting)
    n_starts: int = 20
    span: float = 1.0
    seed: int = 0
    n_jobs: int = -1
    store: str | Path | None = None
    progress: Callable[[CellProgress], None] | None = None

    def __post_init__(self) -> None:
        if self.n_starts < 2:
            raise ModelError(f"n_starts is {self.n_starts}. Give 2 or more.")
        if not self.span > 0:
            raise ModelError(f"span is {self.span}. Give a positive number.")

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return f"{self.estimator.name}, best of {self.n_starts} starts"

    def starts(self, model: Model) -> list[dict[str, float]]:
        """Start values: the model's own, then a Latin hypercube over the region."""
        # Here, not above: SciPy's statistics take a third of a second to import.
        from scipy.stats.qmc import LatinHypercube

        free = model.free_parameters
        own = dict(model.values)
        if not free:
            raise ModelError(f"Model {model.name!r} has no free parameter to start elsewhere.")
        shares = LatinHypercube(len(free), rng=np.random.default_rng(self.seed))
        rows = shares.random(self.n_starts - 1)
        lower, upper = np.array([self._region(p) for p in free]).T
        spread = lower + rows * (upper - lower)
        logged = np.array([p.log for p in free])
        spread[:, logged] = np.exp(spread[:, logged])
        names = model.free_names
        drawn = [dict(zip(names, map(float, row), strict=True)) for row in spread]
        return [{name: own[name] for name in names}, *drawn]

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
            ``extras`` holds, per start, ``"start_values"``, ``"log_likelihoods"``,
            ``"objectives"`` (minus twice the same, with priors; see
            :func:`oed_sysid.results.plot_waterfall`) and whether it ``"converged"``;
            ``"arrived"`` counts the starts that found the optimum that is returned.
        """
        began = time.perf_counter()
        starts = self.starts(model)
        cells = {f"seed {self.seed}, start {i}": start for i, start in enumerate(starts)}
        work = partial(_fit_from, self.estimator, model, dataset)
        fits = list(
            run_cells(
                work, cells, store=self.store, n_jobs=self.n_jobs, progress=self.progress
            ).values()
        )
        likelihoods = np.array([fit.log_likelihood for fit in fits])
        # Priors are part of what is sought; noise levels that are estimated are too.
        goals = np.array([_goal(fit) for fit in fits])
        ok = np.array([fit.status.ok for fit in fits])
        best = max(range(len(fits)), key=lambda i: (ok[i], goals[i]))
        arrived = ok & (2.0 * (goals[best] - goals) < SAME_OPTIMUM)
        extras = {
            **fits[best].extras,
            "start_values": tuple(starts),
            "log_likelihoods": likelihoods,
            "objectives": -2.0 * goals,
            "converged": ok,
            "arrived": int(arrived.sum()),
        }
        return replace(
            fits[best],
            estimator=self.name,
            seconds=time.perf_counter() - began,
            iterations=sum(fit.iterations for fit in fits),
            extras=extras,
        )


def _fit_from(
    estimator: Estimator, model: Model, dataset: Dataset, start: Mapping[str, float]
) -> Fit:
    return estimator.fit(model.with_values(dict(start)), dataset)


def _goal(fit: Fit) -> float:
    """Log-likelihood and log-density of the priors, up to a constant."""
    total = fit.log_likelihood
    for name, value in fit.values.items():
        parameter = fit.model.parameter(name)
        if parameter.prior_std is not None and parameter.prior_mean is not None:
            away = value - parameter.prior_mean
            if parameter.log:
                away = np.log(value / parameter.prior_mean)
            total -= 0.5 * (away / parameter.prior_std) ** 2
    for known, own in zip(fit.start_states, fit.initial_states, strict=False):
        for name, (mean, std) in known.items():
            if std > 0:
                found = own[fit.model.state_names.index(name)]
                total -= 0.5 * ((found - mean) / std) ** 2
    return total if np.isfinite(total) else -np.inf
