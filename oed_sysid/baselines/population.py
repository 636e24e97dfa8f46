"""Searches by populations of simulated trajectories."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.optimize import differential_evolution

from oed_sysid.baselines.equations import check_free
from oed_sysid.baselines.regression import (
    CONVERGED,
    Baseline,
    Regression,
    assumed_levels,
    positive,
)
from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError, library, located
from oed_sysid.experiments.trajectory import simulate_batch
from oed_sysid.likelihood.covariance import is_coloured, sandwich
from oed_sysid.likelihood.estimate import Status
from oed_sysid.likelihood.estimator import check_choice
from oed_sysid.likelihood.information import Information, coloured_score_covariance
from oed_sysid.likelihood.noise_levels import given_levels, root_mean_square
from oed_sysid.likelihood.start_guess import check_channels, first_state
from oed_sysid.physics.model import Model

UNFINISHED = Status(
    "iterations",
    "the limit of generations was reached before the search had gathered. Raise n_generations, or "
    "start MultipleShooting from here with warm=fit.",
)
DIVERGED = Status("diverged", "every candidate diverged. Narrow the bounds, or reduce model.step.")


class TrajectoryCost:
    r"""Mean square of scaled residuals over all records, for many candidates at once.

    .. math:: J(\theta) = \frac1N \sum_{k,i} \left(\frac{y_{ki} - \hat y_{ki}(\theta)}{s_i}\right)^2

    Trajectories start where ``initial`` says, else at the measured states
    (averaged over the first samples), else at zero. A start is never searched
    for: its noise ends up in the parameters, and in their stated errors.

    Parameters
    ----------
    model : Model
        All free parameters need finite bounds.
    dataset : Dataset
        Measured records.
    scale : str or mapping of str to float
        ``"noise"`` takes the noise level of each output, ``"peak"`` its largest
        magnitude; a mapping gives one number per output.
    initial : mapping of str to float
        Known start of some states, the same for all records.
    n_workers : int or None
        Threads; as many as cores by default.
    """

    def __init__(
        self,
        model: Model,
        dataset: Dataset,
        *,
        scale: str | Mapping[str, float] = "noise",
        initial: Mapping[str, float] | None = None,
        n_workers: int | None = None,
    ) -> None:
        check_channels(model, dataset)
        _check_searchable(model)
        self.model, self.dataset, self.n_workers = model, dataset, n_workers
        free = model.free_parameters
        self.lower, self.upper = np.array([(p.lower, p.upper) for p in free]).T
        self._columns = [model.parameter_names.index(name) for name in model.free_names]
        self.scales = output_scales(model, dataset, scale)
        self.initial = dict(initial or {})
        located(ModelError, "initial names", self.initial, model.state_names)
        self._starts = [first_state(model, record, self.initial) for record in dataset]
        self.n_evaluations = 0

    def at(self, shares: np.ndarray) -> np.ndarray:
        """Parameters ``(n, n_free)`` at shares of the way from the lower to the upper bounds."""
        return self.lower + shares * (self.upper - self.lower)

    def finite(self, population: np.ndarray) -> np.ndarray:
        """Costs for libraries that want finite numbers: 1e30 where the model diverges."""
        return np.minimum(self(population), 1e30)

    def __call__(self, population: np.ndarray) -> np.ndarray:
        """Costs ``(n,)`` of candidates ``(n, n_free)``; infinite where the model diverges."""
        population = np.atleast_2d(population)
        values = np.tile(self.model.value_vector, (len(population), 1))
        values[:, self._columns] = population
        total = np.zeros(len(population))
        count = 0
        for own, record in zip(self._starts, self.dataset, strict=True):
            # A missing sample weighs nothing.
            present = np.isfinite(record.outputs)
            weights = present / self.scales
            measured = np.where(present, record.outputs, 0.0)
            count += int(present.sum())
            # Members simulated at once: 64 MB, whatever the length of the record.
            room = max(1, 64_000_000 // (8 * record.outputs.size))
            for first in range(0, len(values), room):
                part = slice(first, first + room)
                found = simulate_batch(
                    self.model,
                    record.times,
                    inputs=record.inputs,
                    values=values[part],
                    initials=own,
                    n_workers=self.n_workers,
                )
                found -= measured
                found *= weights
                flat = found.reshape(len(found), -1)
                with np.errstate(over="ignore", invalid="ignore"):
                    total[part] += np.einsum("ij,ij->i", flat, flat)
        self.n_evaluations += len(population)
        return np.where(np.isfinite(total), total / count, np.inf)

    def ended(self, best: np.ndarray, iterations: int, status: Status, **facts: Any) -> Regression:
        """Where a search ended, ``(n_free,)``, with the errors there; facts besides."""
        status = status if np.isfinite(self(best)[0]) else DIVERGED
        facts = {"evaluations": self.n_evaluations, **facts}
        information, covariance, coloured = self.errors(best)
        return Regression(best, covariance, information, coloured, status, iterations, facts=facts)

    def errors(self, best: np.ndarray) -> tuple[Information, np.ndarray, bool]:
        """Errors of the best candidate ``(n_free,)``: those of least squares at the optimum.

        Returns
        -------
        information : Information
            As if residuals were white.
        covariance : ndarray (n_free, n_free)
            Widened by the noise of the measured start states.
        coloured : bool
            Whether it accounts for errors correlated in time.
        """
        model, runner = self.model, kernel(self.model)
        values = model.value_vector
        values[self._columns] = best
        jacobians, residuals, starts = [], [], []
        for own, record in zip(self._starts, self.dataset, strict=True):
            run = runner.simulate(record.times, record.inputs, values, own, sensitivities=True)
            slopes = run.output_sensitivities
            residuals.append(record.outputs - run.outputs)
            seen = np.isfinite(residuals[-1])[:, :, None] & np.isfinite(slopes)
            by_start, by_free = np.split(np.where(seen, slopes, 0.0), [runner.n_own], axis=2)
            jacobians.append(by_free)
            starts.append(by_start)
        levels = given_levels(model.outputs)
        found = np.maximum(np.nan_to_num(root_mean_square(residuals)), 1e-9 * self.scales)
        sigma = np.where(np.isfinite(levels), levels, found)
        magnitudes = np.array([p.magnitude for p in model.free_parameters])

        def stacked(parts: list[np.ndarray], units: np.ndarray) -> np.ndarray:
            return np.vstack([(part / units[:, None]).reshape(-1, part.shape[2]) for part in parts])

        def informed(units: np.ndarray) -> Information:
            return Information.from_jacobian(
                model.free_names, stacked(jacobians, units), magnitudes
            )

        # The search weighed outputs by its own scales; errors follow from these weights.
        scaled = [residual / self.scales for residual in residuals]
        coloured = is_coloured(scaled)
        if coloured:
            middle = coloured_score_covariance(
                [j / self.scales[:, None] for j in jacobians], scaled
            )
        else:
            noisy = stacked(jacobians, self.scales**2 / sigma)
            middle = noisy.T @ noisy
        # What the noise of the measured start states adds to the covariance of the score.
        sources = {output.source: i for i, output in enumerate(model.outputs)}
        measured = {name: sigma[column] for name, column in sources.items()}
        measured |= dict.fromkeys(self.initial, 0.0)
        spread = np.array([measured.get(name, 0.0) for name in model.state_names])
        for jacobian, start in zip(jacobians, starts, strict=True):
            mixed = stacked([jacobian], self.scales).T @ (stacked([start], self.scales) * spread)
            middle = middle + mixed @ mixed.T
        return informed(sigma), sandwich(informed(self.scales).covariance, middle), coloured


def _check_searchable(model: Model) -> None:
    """Raise :class:`ModelError` where the free parameters span no region to search."""
    check_free(model, "a search")
    free = model.free_parameters
    if unbounded := [p.name for p in free if not np.isfinite([p.lower, p.upper]).all()]:
        raise ModelError(
            f"{', '.join(unbounded)} have no finite bounds, and a search needs a region. Give "
            "lower and upper with model.with_parameter(replace(parameter, lower=..., "
            "upper=...)), or use MultipleShooting, which needs none."
        )


def output_scales(model: Model, dataset: Dataset, scale: str | Mapping[str, float]) -> np.ndarray:
    """Scale of the residuals of each output, see :class:`TrajectoryCost`."""
    names = model.output_names
    if not isinstance(scale, str):
        return positive(scale, names, "output")
    check_choice("scale", scale, ("noise", "peak"))
    if scale == "noise":
        return assumed_levels(model, dataset)
    peaks = np.nanmax(np.abs(np.vstack([record.outputs for record in dataset])), axis=0)
    if not np.all(peaks > 0):
        flat = names[int(np.argmin(peaks))]
        raise DataError(f"Output {flat!r} is zero all the time and has no peak to scale with.")
    return peaks


@dataclass(frozen=True, kw_only=True)
class TrajectorySearch(Baseline):
    """Search of the least misfit of trajectories: settings and the way to a fit that all share.

    Parameters
    ----------
    scale : str or mapping of str to float
        Scale of the residuals of each output, see :class:`TrajectoryCost`.
    initial : mapping of str to float
        Known start of some states; others are measured, or zero.
    seed : int
        Of the random numbers; the same seed gives the same result.
    n_workers : int or None
        Threads; all cores by default.

    Notes
    -----
    All free parameters need finite bounds. ``extras["evaluations"]`` of a fit says how many
    candidates were simulated.
    """

    scale: str | Mapping[str, float] = "noise"
    initial: Mapping[str, float] | None = None
    seed: int = 0
    n_workers: int | None = None

    @abstractmethod
    def _search(self, cost: TrajectoryCost) -> Regression:
        """Search the region for the least cost."""

    def _estimate(self, model: Model, dataset: Dataset) -> Regression:
        """Search the free parameters within their bounds."""
        return self._search(
            TrajectoryCost(
                model, dataset, scale=self.scale, initial=self.initial, n_workers=self.n_workers
            )
        )


UPDATES = ("particle", "dimension")


@dataclass(frozen=True)
class DifferentialSwarm(TrajectorySearch):
    r"""Search by a swarm that mixes personal bests, the best of all, and differences.

    .. math::
        x_i^{k+1} = r\,p_i^k + (1 - r)\,p_g^k + \omega\,(p_{i_1}^k - p_{i_2}^k),
        \qquad r \sim U[0, 1]

    with personal bests :math:`p`, the best of all :math:`p_g` and two random members. A better
    position replaces the personal best. A coordinate outside its bounds is drawn anew between the
    personal best and the bound. All particles are simulated at once, on all cores.

    Parameters
    ----------
    n_particles, n_generations : int
        Size of the swarm and number of moves.
    omega : float
        Weight of the difference.
    draw : str
        Whether ``r`` is one number per ``"particle"`` or per ``"dimension"``;
        the source does not say, and the first converges far better.
    distinct : bool
        Whether the two members of the difference must differ. The source does not say. Where they
        may be the same, now and then a particle moves on the line between its own best and the best
        of all, and the search converges many times faster (two problems, three seeds each).
    tolerance : float
        The swarm has converged when its costs differ by less than this share
        of the least one, or from it by less than this number.
    scale, initial, seed, n_workers
        See :class:`TrajectorySearch`.

    References
    ----------
    Chen, Yan & Wang (2011), Parameter identification of a torpedo by
    differential swarm, J. Ship Mechanics 15(4); equal to barebones differential
    evolution with personal bests: Omran, Engelbrecht & Salman (2009), European
    J. Operational Research 196.

    Examples
    --------
    >>> DifferentialSwarm(30, 50, draw="dimension").name
    'differential swarm (30 particles, 50 generations)'
    """

    words: ClassVar[str] = (
        "differential swarm ({n_particles} particles, {n_generations} generations)"
    )
    n_particles: int = 60
    n_generations: int = 300
    omega: float = 1.0
    draw: str = "particle"
    distinct: bool = False
    tolerance: float = 1e-8

    def __post_init__(self) -> None:
        check_choice("draw", self.draw, UPDATES)
        if self.n_particles < 4 or self.n_generations < 1:
            raise ModelError(
                f"A swarm of {self.n_particles} particles and {self.n_generations} generations is "
                "too small. Give at least 4 particles and 1 generation."
            )

    def _search(self, cost: TrajectoryCost) -> Regression:
        """Move the swarm; ``extras["history"]`` holds the least cost of each generation."""
        rng = np.random.default_rng(self.seed)
        best = rng.uniform(cost.lower, cost.upper, (self.n_particles, len(cost.lower)))
        values = cost(best)
        history, status = [float(values.min())], CONVERGED
        for _ in range(self.n_generations):
            moved = self._moved(best, best[np.argmin(values)], rng)
            moved = redrawn(moved, best, cost.lower, cost.upper, rng)
            found = cost(moved)
            better = found < values
            best[better], values[better] = moved[better], found[better]
            history.append(float(values.min()))
            alike = np.ptp(values) <= max(self.tolerance * values.min(), 1e-300)
            if alike or values.max() <= self.tolerance**2:
                break
        else:
            spread = best.std(axis=0) / np.maximum(cost.upper - cost.lower, 1e-300)
            wide = [n for n, s in zip(cost.model.free_names, spread, strict=True) if s > 0.05]
            if wide:
                status = Status(
                    "iterations",
                    f"the swarm has not gathered yet in {', '.join(wide)}. Raise n_generations, "
                    "narrow the bounds, or start MultipleShooting from here with warm=fit.",
                )
        return cost.ended(
            best[np.argmin(values)], len(history) - 1, status, history=np.array(history)
        )

    def _moved(self, best: np.ndarray, leader: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """New positions ``(n_particles, n_free)``."""
        n, n_free = best.shape
        share = rng.uniform(size=(n, 1 if self.draw == "particle" else n_free))
        first, second = rng.integers(n, size=n), rng.integers(int(self.distinct), n, size=n)
        if self.distinct:
            second = (first + second) % n
        return share * best + (1 - share) * leader + self.omega * (best[first] - best[second])


def redrawn(
    moved: np.ndarray,
    best: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Draw every coordinate outside its bounds anew, between personal best and bound.

    Arrays are ``(n_particles, n_free)``, bounds ``(n_free,)``.
    """
    share = rng.uniform(size=moved.shape)
    result = np.where(moved < lower, lower + share * (best - lower), moved)
    return np.where(moved > upper, upper - share * (upper - best), result)


@dataclass(frozen=True)
class DifferentialEvolution(TrajectorySearch):
    """Differential evolution of SciPy on the trajectory misfit, whole generations at once.

    Parameters
    ----------
    n_particles, n_generations : int
        Size of the population and number of generations.
    tolerance : float
        Relative spread of the costs at which to stop.
    scale, initial, seed, n_workers
        See :class:`TrajectorySearch`.

    References
    ----------
    Storn & Price (1997), J. Global Optimization 11.

    Examples
    --------
    >>> DifferentialEvolution(30, 50, seed=1).name
    'differential evolution (30 members)'
    """

    words: ClassVar[str] = "differential evolution ({n_particles} members)"
    n_particles: int = 60
    n_generations: int = 400
    tolerance: float = 1e-6

    def _search(self, cost: TrajectoryCost) -> Regression:
        n_free = len(cost.lower)
        found = differential_evolution(
            lambda shares: cost.finite(cost.at(shares.T)),
            [(0.0, 1.0)] * n_free,
            maxiter=self.n_generations,
            popsize=max(1, round(self.n_particles / n_free)),  # SciPy counts per parameter
            tol=self.tolerance,
            rng=np.random.default_rng(self.seed),
            vectorized=True,
            updating="deferred",
            polish=False,
        )
        return cost.ended(
            cost.at(found.x), int(found.nit), CONVERGED if found.success else UNFINISHED
        )


@dataclass(frozen=True)
class CovarianceMatrixAdaptation(TrajectorySearch):
    """CMA-ES of the package cma on the trajectory misfit.

    Parameters
    ----------
    n_particles : int or None
        Population; None takes what the package advises.
    n_generations : int
        Most generations.
    spread : float
        First standard deviation, as a share of the bounds' distance.
    scale, initial, seed, n_workers
        See :class:`TrajectorySearch`.

    References
    ----------
    Hansen & Ostermeier (2001), Evolutionary Computation 9.

    Examples
    --------
    >>> CovarianceMatrixAdaptation(n_generations=50, seed=1).name
    'CMA-ES'
    """

    words: ClassVar[str] = "CMA-ES"
    n_particles: int | None = None
    n_generations: int = 400
    spread: float = 0.25

    def _search(self, cost: TrajectoryCost) -> Regression:
        cma = library("cma", self.name, extra="baselines", error=ModelError)
        options: dict[str, Any] = {
            "bounds": [0.0, 1.0],
            # Zero would mean a seed from the clock.
            "seed": self.seed + 1,
            "maxiter": self.n_generations,
            "verbose": -9,
        }
        if self.n_particles is not None:
            options["popsize"] = self.n_particles
        # From the middle of the bounds.
        run = cma.CMAEvolutionStrategy(np.full(len(cost.lower), 0.5), self.spread, options)
        while not run.stop():
            members = np.array(run.ask())  # a whole generation is simulated at once
            run.tell(list(members), list(cost.finite(cost.at(members))))
        best = cost.at(np.clip(run.result.xbest, 0.0, 1.0))
        status = UNFINISHED if "maxiter" in run.stop() else CONVERGED
        return cost.ended(best, int(run.result.iterations), status)


@dataclass(frozen=True)
class ParticleSwarm(TrajectorySearch):
    """Particle swarm of the package pymoo on the trajectory misfit.

    Parameters
    ----------
    n_particles, n_generations : int
        Size of the swarm and number of moves.
    scale, initial, seed, n_workers
        See :class:`TrajectorySearch`.

    References
    ----------
    Kennedy & Eberhart (1995), Particle swarm optimization, IEEE Int. Conf.
    Neural Networks.

    Examples
    --------
    >>> ParticleSwarm(30, 50, seed=1).name
    'particle swarm (30 particles)'
    """

    words: ClassVar[str] = "particle swarm ({n_particles} particles)"
    n_particles: int = 60
    n_generations: int = 400

    def _search(self, cost: TrajectoryCost) -> Regression:
        swarm, problems, optimize = (
            library(f"pymoo.{part}", "The particle swarm", extra="baselines", error=ModelError)
            for part in ("algorithms.soo.nonconvex.pso", "core.problem", "optimize")
        )

        def evaluate(_: object, x: np.ndarray, out: dict[str, np.ndarray], *__: object) -> None:
            out["F"] = cost.finite(x)[:, None]

        kind = type("Misfit", (problems.Problem,), {"_evaluate": evaluate})
        found = optimize.minimize(
            kind(n_var=len(cost.lower), n_obj=1, xl=cost.lower, xu=cost.upper),
            swarm.PSO(pop_size=self.n_particles),
            ("n_gen", self.n_generations),
            seed=self.seed,
            verbose=False,
        )
        values = found.pop.get("F").ravel()
        status = CONVERGED if np.ptp(values) <= 1e-3 * values.min() else UNFINISHED
        return cost.ended(np.asarray(found.X, dtype=float), self.n_generations, status)
