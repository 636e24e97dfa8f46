"""Differential swarm: the population search of the torpedo paper, as reconstructed."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError
from oed_sysid.estimators.baselines.trajectory_cost import TrajectoryCost
from oed_sysid.fitting.fit import Fit, Status
from oed_sysid.model import Model

UPDATES = ("particle", "dimension")


@dataclass(frozen=True)
class DifferentialSwarm:
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
    scale : str or mapping of str to float
        Scale of the residuals of each output, see
        :class:`~oed_sysid.estimators.baselines.trajectory_cost.TrajectoryCost`.
    initial : mapping of str to float
        Known start of some states; others are measured, or zero.
    tolerance : float
        The swarm has converged when its costs differ by less than this share
        of the least one, or from it by less than this number.
    seed : int
        Of the random numbers; the same seed gives the same result.
    n_workers : int or None
        Threads; all cores by default.
    progress : callable or None
        Called with the generation and the least cost.

    References
    ----------
    Chen, Yan & Wang (2011), Parameter identification of a torpedo by
    differential swarm, J. Ship Mechanics 15(4); equal to barebones differential
    evolution with personal bests: Omran, Engelbrecht & Salman (2009), European
    J. Operational Research 196.
    """

    n_particles: int = 60
    n_generations: int = 300
    omega: float = 1.0
    draw: str = "particle"
    distinct: bool = False
    scale: str | Mapping[str, float] = "noise"
    initial: Mapping[str, float] | None = None
    tolerance: float = 1e-8
    seed: int = 0
    n_workers: int | None = None
    progress: Callable[[int, float], None] | None = None

    def __post_init__(self) -> None:
        if self.draw not in UPDATES:
            raise ModelError(f"draw is {self.draw!r}. Choose one of {', '.join(UPDATES)}.")
        if self.n_particles < 4 or self.n_generations < 1:
            raise ModelError(
                f"A swarm of {self.n_particles} particles and {self.n_generations} generations is "
                "too small. Give at least 4 particles and 1 generation."
            )

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return (
            f"differential swarm ({self.n_particles} particles, {self.n_generations} generations)"
        )

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Search the free parameters within their bounds.

        Returns
        -------
        Fit
            ``extras["history"]`` holds the least cost of each generation.

        Raises
        ------
        ModelError
            If a free parameter has no finite bounds.
        """
        began = time.perf_counter()
        cost = TrajectoryCost(
            model, dataset, scale=self.scale, initial=self.initial, n_workers=self.n_workers
        )
        rng = np.random.default_rng(self.seed)
        best = rng.uniform(cost.lower, cost.upper, (self.n_particles, len(cost.lower)))
        values = cost(best)
        history = [float(values.min())]
        converged = False
        generation = 0
        for generation in range(1, self.n_generations + 1):
            moved = self._moved(best, best[np.argmin(values)], rng)
            moved = redrawn(moved, best, cost.lower, cost.upper, rng)
            found = cost(moved)
            better = found < values
            best[better], values[better] = moved[better], found[better]
            history.append(float(values.min()))
            if self.progress is not None:
                self.progress(generation, history[-1])
            gap = values.max() - values.min()
            converged = bool(gap <= max(self.tolerance * values.min(), 1e-300))
            converged |= bool(values.max() <= self.tolerance**2)
            if converged:
                break
        status = Status("converged", "")
        if not converged:
            spread = best.std(axis=0) / np.maximum(cost.upper - cost.lower, 1e-300)
            wide = [n for n, s in zip(model.free_names, spread, strict=True) if s > 0.05]
            if wide:
                status = Status(
                    "iterations",
                    f"the swarm has not gathered yet in {', '.join(wide)}. Raise n_generations, "
                    "narrow the bounds, or start MultipleShooting from here with warm=fit.",
                )
        return cost.fit(
            best[np.argmin(values)],
            estimator=self.name,
            began=began,
            iterations=generation,
            status=status,
            extras={"history": np.array(history)},
        )

    def _moved(self, best: np.ndarray, leader: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """New positions ``(n_particles, n_free)``."""
        n, n_free = best.shape
        columns = 1 if self.draw == "particle" else n_free
        share = rng.uniform(size=(n, columns))
        first = rng.integers(n, size=n)
        if self.distinct:
            second = (first + rng.integers(1, n, size=n)) % n
        else:
            second = rng.integers(n, size=n)
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
