"""The number that a search maximises, with its gradient, limits included."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from oed_sysid.design.caution import GuardRun, Guards
from oed_sysid.design.corridor import Corridor
from oed_sysid.design.criteria import Measure
from oed_sysid.design.elimination import eliminate
from oed_sysid.design.parametrisation import Shape
from oed_sysid.design.scene import Scene, View

T = TypeVar("T")
# Difference step of the numbers between 0 and 1; information derivatives are exact.
_STEP = 1e-5


@dataclass(frozen=True, eq=False)
class Score:
    """Value of one candidate.

    Attributes
    ----------
    numbers : ndarray (size,)
        Of the parametrisation.
    commands : ndarray (n_times, n_inputs)
        All inputs of the model.
    value : float
        Criterion, larger is better; minus infinity where a trajectory diverges.
    excess : float
        Largest excess over the limits; above zero is not allowed.
    views : tuple of View
        One for each scene.
    guards : tuple of GuardRun
        One for each uncertain vehicle; empty where limits of these were not looked at.
    """

    numbers: np.ndarray
    commands: np.ndarray
    value: float
    excess: float
    views: tuple[View, ...]
    guards: tuple[GuardRun, ...] = ()

    @property
    def feasible(self) -> bool:
        """Whether all limits are kept."""
        return bool(np.isfinite(self.value) and self.excess <= 1e-9)


@dataclass(frozen=True, eq=False)
class Slope:
    """Derivatives at one candidate.

    Attributes
    ----------
    criterion : ndarray (size,)
        Of the criterion by the numbers.
    signals : ndarray (n_scenes, n_times, n_limits, size)
        Of the limited signals by the numbers.
    guards : mapping of int to ndarray (n_times, n_limits, size)
        The same of the decisive uncertain vehicles.
    """

    criterion: np.ndarray
    signals: np.ndarray
    guards: Mapping[int, np.ndarray] = field(default_factory=dict)


class Objective:
    """Criterion of a parametrised experiment over one or several scenes.

    Parameters
    ----------
    scenes : sequence of Scene
        Sets of values.
    measures : sequence of Measure
        Criterion bound to each scene.
    priors : sequence of ndarray (n_parameters, n_parameters)
        Scaled information at hand before the experiment, per scene.
    shape : Shape
        Family of commands.
    positions : ndarray of int
        Columns of the designed inputs among all inputs.
    constants : ndarray (n_inputs,)
        Values of the other inputs.
    corridor : Corridor
        Limits, kept in every scene.
    softness : float or None
        None averages over scenes; a number takes the soft minimum of this width.
    n_workers : int
        Threads for the gradient.
    guards : Guards, optional
        Uncertain vehicles on which limits are kept.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        measures: Sequence[Measure],
        priors: Sequence[np.ndarray],
        shape: Shape,
        positions: np.ndarray,
        constants: np.ndarray,
        corridor: Corridor,
        *,
        softness: float | None = None,
        n_workers: int = 1,
        guards: Guards | None = None,
    ) -> None:
        self.scenes, self.measures, self.priors = tuple(scenes), tuple(measures), tuple(priors)
        self.shape, self.corridor = shape, corridor
        self._positions, self._constants = positions, constants
        self._softness = softness
        self.guards = guards
        self._n_workers = n_workers if scenes[0].kernel.is_compiled else 1
        self.n_evaluations = 0

    @property
    def times(self) -> np.ndarray:
        """Sample times, s."""
        return self.scenes[0].times

    def all_commands(self, numbers: np.ndarray) -> np.ndarray:
        """Commands of all inputs, ``(n_batch, n_times, n_inputs)``."""
        designed = self.shape.commands(numbers)
        commands = np.broadcast_to(
            self._constants, (*designed.shape[:2], len(self._constants))
        ).copy()
        commands[:, :, self._positions] = designed
        return commands

    def score(self, numbers: np.ndarray, *, guarded: bool = True) -> Score:
        """Evaluate one member of the family; see :meth:`score_commands`."""
        return self.score_commands(self.all_commands(numbers)[0], numbers, guarded=guarded)

    def score_commands(
        self, commands: np.ndarray, numbers: np.ndarray, *, guarded: bool = True
    ) -> Score:
        """Evaluate commands ``(n_times, n_inputs)``, ``guarded`` on uncertain vehicles too."""
        self.n_evaluations += 1
        views = []
        for scene in self.scenes:
            view = scene.view(commands)
            if view is None:
                return Score(numbers, commands, -np.inf, np.inf, ())
            views.append(view)
        values = [self._measured(i, view)[0] for i, view in enumerate(views)]
        excess = max(self.corridor.worst(view.signals) for view in views)
        value = self._combined(values)[0]
        if self.guards is None or not guarded:
            return Score(numbers, commands, value, excess, tuple(views))
        guards = self.guards
        runs = self._each(lambda i: guards.run(i, commands), len(guards))
        excess = max(excess, guards.level(runs))
        return Score(numbers, commands, value, excess, tuple(views), tuple(runs))

    def information(self, scene: int, view: View) -> np.ndarray:
        """Scaled information on parameters (and rival shifts), priors included."""
        matrix = self.scenes[scene].information(view.rows)
        reduced, _ = eliminate(matrix, self.scenes[scene].n_nuisance)
        n = len(self.priors[scene])
        reduced[:n, :n] += self.priors[scene]
        return reduced

    def _measured(self, index: int, view: View) -> tuple[float, np.ndarray]:
        """Criterion of one scene and its derivative by the whole information matrix."""
        scene, prior = self.scenes[index], self.priors[index]
        reduced, mapping = eliminate(scene.information(view.rows), scene.n_nuisance)
        reduced[: len(prior), : len(prior)] += prior
        value, gradient = self.measures[index](reduced)
        return value, mapping.T @ gradient @ mapping

    def _combined(self, values: Sequence[float]) -> tuple[float, np.ndarray]:
        """Mean or soft minimum over the scenes, and the weights of their gradients."""
        array = np.asarray(values)
        if self._softness is None or len(array) == 1:
            return float(array.mean()), np.full(len(array), 1.0 / len(array))
        smallest = array.min()
        weights = np.exp(-(array - smallest) / self._softness)
        value = smallest - self._softness * np.log(weights.mean())
        return float(value), weights / weights.sum()

    def linearise(self, score: Score) -> Slope:
        """Derivatives of the criterion and of the limited signals by the numbers."""
        size = self.shape.size
        signs = np.where(score.numbers > 0.5, -1.0, 1.0)
        commands = self.all_commands(score.numbers + np.diag(_STEP * signs))
        parts = [self._measured(i, view) for i, view in enumerate(score.views)]
        _, weights = self._combined([value for value, _ in parts])
        slopes = []
        for i, scene in enumerate(self.scenes):
            whitened = scene.whitened(score.views[i].rows)
            slopes.append(2 * weights[i] * scene.unwhitened(whitened @ parts[i][1]))
        decisive = self.guards.decisive(score.guards) if self.guards and score.guards else []
        n_guarded = len(self.guards.corridor.names) if self.guards else 0
        by_guard = {i: np.zeros((len(self.times), n_guarded, size)) for i in decisive}
        columns = self.corridor.columns
        gradient = np.zeros(size)
        signals = np.zeros((len(self.scenes), len(self.times), len(columns), size))

        def one(index: int) -> None:
            differs = np.flatnonzero((commands[index] != score.commands).any(axis=1))
            if not len(differs):
                return
            step = _STEP * signs[index]
            for i, scene in enumerate(self.scenes):
                # A linearly interpolated command acts from the sample before.
                edge = int(np.searchsorted(scene.edges, max(differs[0] - 1, 0), "right")) - 1
                change = scene.change(score.views[i], commands[index], edge, slopes[i], columns)
                if change is not None:
                    gradient[index] += change[0] / step
                    signals[i, scene.edges[edge] :, :, index] = change[1] / step
            if self.guards is None:
                return
            edges = self.scenes[0].edges
            edge = int(np.searchsorted(edges, max(differs[0] - 1, 0), "right")) - 1
            for i in decisive:
                moved = self.guards.change(i, score.guards[i], commands[index], edge)
                by_guard[i][edges[edge] :, :, index] = moved / step

        self.n_evaluations += size
        self._each(one, size)
        return Slope(gradient, signals, by_guard)

    def _each(self, work: Callable[[int], T], size: int) -> list[T]:
        """Results of ``work`` for ``0 .. size - 1``, over threads."""
        if self._n_workers == 1:
            return [work(index) for index in range(size)]
        chunks = np.array_split(np.arange(size), 4 * self._n_workers)
        with ThreadPoolExecutor(self._n_workers) as pool:
            parts = pool.map(lambda chunk: [work(int(index)) for index in chunk], chunks)
            return [result for part in parts for result in part]
