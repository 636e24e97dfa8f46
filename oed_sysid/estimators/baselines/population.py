"""Known population searches on the trajectory misfit, through established libraries."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution

from oed_sysid.data.dataset import Dataset
from oed_sysid.estimators.baselines.optional_libraries import optional
from oed_sysid.estimators.baselines.trajectory_cost import TrajectoryCost
from oed_sysid.fitting.fit import Fit, Status
from oed_sysid.model import Model

UNFINISHED = Status(
    "iterations",
    "the limit of generations was reached before the search had gathered. Raise n_generations, or "
    "start MultipleShooting from here with warm=fit.",
)
# A diverging candidate costs this much, because the libraries want finite numbers.
WORST = 1e30


@dataclass(frozen=True)
class DifferentialEvolution:
    """Differential evolution of SciPy on the trajectory misfit, whole generations at once.

    Parameters
    ----------
    n_particles, n_generations : int
        Size of the population and number of generations.
    scale, initial, n_workers
        See :class:`~oed_sysid.estimators.baselines.swarm.DifferentialSwarm`.
    tolerance : float
        Relative spread of the costs at which to stop.
    seed : int
        Of the random numbers.

    References
    ----------
    Storn & Price (1997), J. Global Optimization 11.
    """

    n_particles: int = 60
    n_generations: int = 400
    scale: str | Mapping[str, float] = "noise"
    initial: Mapping[str, float] | None = None
    tolerance: float = 1e-6
    seed: int = 0
    n_workers: int | None = None

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return f"differential evolution ({self.n_particles} members)"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Search the free parameters within their bounds."""
        began = time.perf_counter()
        cost = TrajectoryCost(
            model, dataset, scale=self.scale, initial=self.initial, n_workers=self.n_workers
        )
        span = cost.upper - cost.lower
        n_free = len(span)
        found = differential_evolution(
            lambda unit: np.minimum(cost(cost.lower + unit.T * span), WORST),
            [(0.0, 1.0)] * n_free,
            maxiter=self.n_generations,
            popsize=max(1, round(self.n_particles / n_free)),
            tol=self.tolerance,
            rng=np.random.default_rng(self.seed),
            vectorized=True,
            updating="deferred",
            polish=False,
        )
        status = Status("converged", "") if found.success else UNFINISHED
        return cost.fit(
            cost.lower + found.x * span,
            estimator=self.name,
            began=began,
            iterations=int(found.nit),
            status=status,
        )


@dataclass(frozen=True)
class CovarianceMatrixAdaptation:
    """CMA-ES of the package cma on the trajectory misfit.

    Parameters
    ----------
    n_particles : int or None
        Population; None takes what the package advises.
    n_generations : int
        Most generations.
    spread : float
        First standard deviation, as a share of the bounds' distance.
    scale, initial, n_workers, seed
        See :class:`~oed_sysid.estimators.baselines.swarm.DifferentialSwarm`.

    References
    ----------
    Hansen & Ostermeier (2001), Evolutionary Computation 9.
    """

    n_particles: int | None = None
    n_generations: int = 400
    spread: float = 0.25
    scale: str | Mapping[str, float] = "noise"
    initial: Mapping[str, float] | None = None
    seed: int = 0
    n_workers: int | None = None

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return "CMA-ES"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Search the free parameters within their bounds, from the middle of these."""
        began = time.perf_counter()
        cma = optional("cma", "cma", wanted_by="CovarianceMatrixAdaptation")
        cost = TrajectoryCost(
            model, dataset, scale=self.scale, initial=self.initial, n_workers=self.n_workers
        )
        span = cost.upper - cost.lower
        options: dict[str, Any] = {
            "bounds": [0.0, 1.0],
            # Zero would mean a seed from the clock.
            "seed": self.seed + 1,
            "maxiter": self.n_generations,
            "verbose": -9,
        }
        if self.n_particles is not None:
            options["popsize"] = self.n_particles
        search = cma.CMAEvolutionStrategy(np.full(len(span), 0.5), self.spread, options)
        while not search.stop():
            members = np.array(search.ask())
            search.tell(list(members), list(np.minimum(cost(cost.lower + members * span), WORST)))
        done = "maxiter" not in search.stop()
        return cost.fit(
            cost.lower + np.clip(search.result.xbest, 0.0, 1.0) * span,
            estimator=self.name,
            began=began,
            iterations=int(search.result.iterations),
            status=Status("converged", "") if done else UNFINISHED,
        )


@dataclass(frozen=True)
class ParticleSwarm:
    """Particle swarm of the package pymoo on the trajectory misfit.

    Parameters
    ----------
    n_particles, n_generations : int
        Size of the swarm and number of moves.
    scale, initial, n_workers, seed
        See :class:`~oed_sysid.estimators.baselines.swarm.DifferentialSwarm`.

    References
    ----------
    Kennedy & Eberhart (1995), Particle swarm optimization, IEEE Int. Conf.
    Neural Networks.
    """

    n_particles: int = 60
    n_generations: int = 400
    scale: str | Mapping[str, float] = "noise"
    initial: Mapping[str, float] | None = None
    seed: int = 0
    n_workers: int | None = None

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return f"particle swarm ({self.n_particles} particles)"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Search the free parameters within their bounds."""
        began = time.perf_counter()
        swarm = optional("pymoo.algorithms.soo.nonconvex.pso", "pymoo", wanted_by="ParticleSwarm")
        problems = optional("pymoo.core.problem", "pymoo", wanted_by="ParticleSwarm")
        optimize = optional("pymoo.optimize", "pymoo", wanted_by="ParticleSwarm")
        cost = TrajectoryCost(
            model, dataset, scale=self.scale, initial=self.initial, n_workers=self.n_workers
        )

        def evaluate(_: object, x: np.ndarray, out: dict[str, np.ndarray], *__: object) -> None:
            out["F"] = np.minimum(cost(x), WORST)[:, None]

        kind = type("Misfit", (problems.Problem,), {"_evaluate": evaluate})
        problem = kind(n_var=len(cost.lower), n_obj=1, xl=cost.lower, xu=cost.upper)
        found = optimize.minimize(
            problem,
            swarm.PSO(pop_size=self.n_particles),
            ("n_gen", self.n_generations),
            seed=self.seed,
            verbose=False,
        )
        values = found.pop.get("F").ravel()
        gathered = np.ptp(values) <= 1e-3 * values.min()
        return cost.fit(
            np.asarray(found.X, dtype=float),
            estimator=self.name,
            began=began,
            iterations=self.n_generations,
            status=Status("converged", "") if gathered else UNFINISHED,
        )
