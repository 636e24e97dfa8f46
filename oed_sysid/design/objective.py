r"""Trajectory, information and their change with the commands, for one set of values.

The number that a search maximises, with its gradient, limits included. The rows ``R`` are
derivatives of the outputs over their noise, from each edge of a run on by the chain rule. With
nuisance unknowns ``0`` (start states), parameters ``p`` and what is known before,
:math:`\Lambda_0` and :math:`\Lambda`,

.. math::
    M = R'R + \Lambda_0, \qquad E = (-M_{p0} M_{00}^{-1},\; I), \qquad
    F = M_{pp} - M_{p0} M_{00}^{-1} M_{0p} + \Lambda

and the criterion :math:`\varphi(F)` changes with a number :math:`\xi` of the commands by

.. math:: \frac{d\varphi}{d\xi} = 2 \left\langle R S, \frac{dR}{d\xi} \right\rangle, \qquad
    S = E' \frac{\partial \varphi}{\partial F} E

with one weight ``2 R S`` for all numbers, and :math:`dR` by restarting at the edge before the first
command that changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.design.criteria import eliminate, soft_minimum
from oed_sysid.design.knowledge import ExpectedInformation
from oed_sysid.design.trial import Task
from oed_sysid.design.vehicles import ScenarioRun, Scenarios
from oed_sysid.design.waveforms import Shape
from oed_sysid.information.bound import unknowns
from oed_sysid.runtime.constants import DIFFERENCE_STEP, RUNAWAY
from oed_sysid.runtime.threads import in_chunks


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One evaluation of a vehicle.

    Attributes
    ----------
    rows : ndarray (n_times, n_outputs, n_columns)
        Scaled derivatives of the outputs by nuisance unknowns, parameters and
        rival shifts, in noise units.
    signals : ndarray (n_times, n_full + n_outputs)
        Full states and outputs.
    nodes : ndarray (n_edges, n_full)
        States at the edges.
    chains : ndarray (n_edges, n_full + n_free, n_kept)
        From derivatives by the state at an edge, and by free parameters, to
        scaled derivatives by the kept unknowns.
    rival_nodes : tuple of ndarray (n_edges, n_rival_full)
        States of the rivals at the edges.
    """

    rows: np.ndarray
    signals: np.ndarray
    nodes: np.ndarray
    chains: np.ndarray
    rival_nodes: tuple[np.ndarray, ...]


class VehicleInformation:
    """One set of parameter values under which commands are judged.

    Parameters
    ----------
    expected : ExpectedInformation
        Model at these values, criterion, noise, what is known before, and absent effects that the
        criterion asks for.
    times : ndarray (n_times,)
        Sample times, s.
    edges : ndarray of int (n_edges,)
        Samples from which a changed trajectory can be restarted; starts with 0.
    own : ndarray (n_own,)
        Start state.
    """

    def __init__(
        self, expected: ExpectedInformation, times: np.ndarray, edges: np.ndarray, own: np.ndarray
    ) -> None:
        model = expected.model
        self.times, self.own, self.sigma = times, own, expected.raised * expected.sigma
        self.measure, shifts = expected.measure(), expected.shifts
        self.prior = expected.relative(expected.before)
        self.edges = np.ascontiguousarray(edges, dtype=np.intc)
        self.kernel = kernel(model)
        self.values = model.value_vector
        self.rivals: list[tuple[Kernel, np.ndarray, float]] = []
        if shifts is not None:
            values = [(kernel(rival), rival.value_vector) for rival in shifts.models]
            factors = map(float, shifts.factors)
            self.rivals = [(*one, factor) for one, factor in zip(values, factors, strict=True)]
        self.columns, weights = unknowns(model, expected.start)
        self.n_nuisance = len(weights)
        units = [one.scale for one in model.states]
        units += [parameter.magnitude for parameter in model.free_parameters]
        self.scales = np.array(units)[self.columns]
        # Of nuisance unknowns only; priors on parameters are added to the information later.
        self.nuisance_prior = (weights * self.scales[: self.n_nuisance]) ** 2

    def evaluation(self, commands: np.ndarray) -> Evaluation | None:
        """Evaluate commands ``(n_times, n_inputs)``; None where a trajectory diverges."""
        runner = self.kernel
        z, dz = runner.start(self.own, commands[0], self.values, float(self.times[0]))
        run = runner.run(
            self.times,
            commands,
            self.values,
            z,
            starts=self.edges,
            from_nodes=0,
            sensitivities=True,
        )
        dy, dends = run.output_sensitivities, run.end_sensitivities
        if not run.ok or not np.isfinite(dy).all():
            return None
        n_full = runner.n_full
        maps = np.empty((len(self.edges), *dz.shape))
        # Chain rule from edge to edge: derivatives of the state by start and parameters.
        maps[0] = dz
        for i in range(len(self.edges) - 1):
            maps[i + 1] = dends[i, :, :n_full] @ maps[i]
            maps[i + 1, :, runner.n_own :] += dends[i, :, n_full:]
        chains = self._chains(maps)
        rows = np.empty((*run.outputs.shape, len(self.columns) + len(self.rivals)))
        stops = [*self.edges[1:], len(self.times)]
        for i, (first, stop) in enumerate(zip(self.edges, stops, strict=True)):
            rows[first:stop, :, : len(self.columns)] = dy[first:stop] @ chains[i]
        if (others := self._rivals(commands, run.outputs)) is None:
            return None
        nodes = []
        for position, (moved, states) in enumerate(others, start=len(self.columns)):
            rows[:, :, position] = moved
            nodes.append(states[self.edges])
        rows /= self.sigma[:, None]
        if not np.abs(rows).max() < RUNAWAY:
            return None
        signals = np.hstack([run.states, run.outputs])
        return Evaluation(rows, signals, run.states[self.edges], chains, tuple(nodes))

    def change(
        self,
        evaluation: Evaluation,
        commands: np.ndarray,
        edge: int,
        by_rows: np.ndarray,
        columns: np.ndarray,
    ) -> tuple[float, np.ndarray] | None:
        """Return what changed commands do to a linear function of the rows, and to signals.

        Parameters
        ----------
        evaluation : Evaluation
            Of the commands before.
        commands : ndarray (n_times, n_inputs)
            Different from an edge on only.
        edge : int
            Which edge.
        by_rows : ndarray (n_times, n_outputs, n_columns)
            Weights of the rows.
        columns : ndarray of int (n_limits,)
            Signals of interest.

        Returns
        -------
        change : float
            Of the weighted sum of rows.
        signals : ndarray (n_times - first, n_limits)
            Change of the signals, from the edge on; None where the trajectory
            diverges.
        """
        first = int(self.edges[edge])
        times, part = self.times[first:], commands[first:]
        z, chain = evaluation.nodes[edge], evaluation.chains[edge]
        # A start depends on the commands as well, where something remembers; later nodes are kept.
        if edge == 0:
            z, dz = self.kernel.start(self.own, commands[0], self.values, float(times[0]))
            chain = self._chains(dz[None])[0]
        run = self.kernel.run(times, part, self.values, z, sensitivities=True)
        if not run.ok:
            return None
        n_kept = len(self.columns)
        weights = by_rows[first:] / self.sigma[:, None]
        # <W, S chain> = <W chain', S>: one product, no copy of the sensitivities.
        pulled = weights[:, :, :n_kept].reshape(-1, n_kept) @ chain.T
        total = float(np.vdot(pulled, run.output_sensitivities))
        nodes = [every[edge] for every in evaluation.rival_nodes] if edge else []
        if (others := self._rivals(part, run.outputs, first, nodes)) is None:
            return None
        for position, (moved, _) in enumerate(others, start=n_kept):
            total += float(np.vdot(weights[:, :, position], moved))
        # What the same rows were worth before: the difference is the change.
        total -= float(np.vdot(by_rows[first:], evaluation.rows[first:]))
        signals = np.hstack([run.states, run.outputs])[:, columns]
        return total, signals - evaluation.signals[first:, columns]

    def _rivals(
        self,
        commands: np.ndarray,
        outputs: np.ndarray,
        first: int = 0,
        nodes: Sequence[np.ndarray] = (),
    ) -> list[tuple[np.ndarray, np.ndarray]] | None:
        """Shifts of some outputs by every rival from a sample on, and its states.

        None where one diverges.
        """
        times, found = self.times[first:], []
        begin = float(times[0])
        for i, (rival, values, factor) in enumerate(self.rivals):
            node = nodes[i] if nodes else rival.start(self.own, commands[0], values, begin)[0]
            if not (other := rival.run(times, commands, values, node)).ok:
                return None
            found.append((factor * (other.outputs - outputs), other.states))
        return found

    def _chains(self, maps: np.ndarray) -> np.ndarray:
        """See :class:`Evaluation`; ``maps`` are derivatives of the states at the edges."""
        n_edges, n_full, n_unknowns = maps.shape
        n_own = len(self.own)
        chains = np.zeros((n_edges, n_full + n_unknowns - n_own, n_unknowns))
        chains[:, :n_full] = maps
        chains[:, n_full:, n_own:] = np.eye(n_unknowns - n_own)
        return chains[:, :, self.columns] * self.scales

    def worth(self, evaluation: Evaluation) -> tuple[float, np.ndarray]:
        """Criterion and its derivative by the whole information matrix."""
        flat = evaluation.rows.reshape(-1, evaluation.rows.shape[2])
        # Scaled information on nuisance unknowns, parameters and rival shifts.
        matrix = flat.T @ flat
        index = np.arange(self.n_nuisance)
        # What is known of starts is information too; on parameters it is added per vehicle.
        matrix[index, index] += self.nuisance_prior
        reduced, mapping = eliminate(matrix, self.n_nuisance)
        n_known = len(self.prior)
        reduced[:n_known, :n_known] += self.prior
        value, gradient = self.measure(reduced)
        return value, mapping.T @ gradient @ mapping


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
    evaluations : tuple of Evaluation
        One for each vehicle.
    scenarios : tuple of ScenarioRun
        One for each uncertain vehicle; empty where limits of these were not looked at.
    """

    numbers: np.ndarray
    commands: np.ndarray
    value: float
    excess: float
    evaluations: tuple[Evaluation, ...]
    scenarios: tuple[ScenarioRun, ...] = ()

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
    signals : ndarray (n_vehicles, n_times, n_limits, size)
        Of the limited signals by the numbers.
    scenarios : mapping of int to ndarray (n_times, n_limits, size)
        The same of the decisive uncertain vehicles.
    """

    criterion: np.ndarray
    signals: np.ndarray
    scenarios: Mapping[int, np.ndarray] = field(default_factory=dict)


class Objective:
    """Criterion of a task over a family of commands, on all its vehicles.

    Parameters
    ----------
    task : Task
        Vehicles, limits, and what is expected of runs.
    shape : Shape
        Family of commands.
    n_workers : int
        Threads for the gradient.
    """

    def __init__(self, task: Task, shape: Shape, n_workers: int = 1) -> None:
        self.task, self.shape, self.bounds = task, shape, task.bounds
        times, edges, own = task.grid.times, shape.edges, task.own
        each = map(task.expected.on, task.models)
        self.vehicles = [VehicleInformation(expected, times, edges, own) for expected in each]
        self.scenarios = None
        if task.bounds.names and task.scenarios:
            self.scenarios = Scenarios(
                task.scenarios, times, edges, own, task.bounds, task.n_waived, task.waves
            )
        self._n_workers = n_workers if self.vehicles[0].kernel.library else 1
        self.n_evaluations = 0

    def all_commands(self, numbers: np.ndarray) -> np.ndarray:
        """Commands of all inputs, ``(n_batch, n_times, n_inputs)``."""
        designed = self.shape.commands(numbers)
        trim = self.task.trim
        commands = np.broadcast_to(trim, (*designed.shape[:2], len(trim))).copy()
        commands[:, :, self.task.positions] = designed
        return commands

    def score(
        self,
        numbers: np.ndarray,
        *,
        commands: np.ndarray | None = None,
        with_scenarios: bool = True,
    ) -> Score:
        """Evaluate one member of the family, on uncertain vehicles too where asked.

        Commands ``(n_times, n_inputs)`` are given where they are no member of a shape.
        """
        played = self.all_commands(numbers)[0] if commands is None else commands
        self.n_evaluations += 1
        evaluations: list[Evaluation] = []
        values: list[float] = []
        for vehicle in self.vehicles:
            if (evaluation := vehicle.evaluation(played)) is None:
                return Score(numbers, played, -np.inf, np.inf, ())
            evaluations.append(evaluation)
            values.append(vehicle.worth(evaluation)[0])
        value = self._combined(values)[0]
        excess = max(self.bounds.worst(self.bounds.limited(one.signals)) for one in evaluations)
        runs: list[ScenarioRun] = []
        if (scenarios := self.scenarios) is not None and with_scenarios:
            fly = partial(scenarios.run, commands=played)
            runs = in_chunks(fly, len(scenarios), self._n_workers)
            excess = max(excess, scenarios.level(runs))
        return Score(numbers, played, value, excess, tuple(evaluations), tuple(runs))

    def _combined(self, values: Sequence[float]) -> tuple[float, np.ndarray]:
        """Mean or soft minimum over the vehicles, and the weights of their gradients."""
        array = np.asarray(values)
        if self.task.softness is None or len(array) == 1:
            return float(array.mean()), np.full(len(array), 1.0 / len(array))
        return soft_minimum(array, self.task.softness)

    def linearise(self, score: Score) -> Slope:
        """Derivatives of the criterion and of the limited signals by the numbers."""
        size = self.shape.size
        # A difference towards the middle stays within the box.
        signs = np.where(score.numbers > 0.5, -1.0, 1.0)
        commands = self.all_commands(score.numbers + np.diag(DIFFERENCE_STEP * signs))
        judged = zip(self.vehicles, score.evaluations, strict=True)
        parts = [vehicle.worth(evaluation) for vehicle, evaluation in judged]
        _, weights = self._combined([value for value, _ in parts])
        slopes = [
            # d tr(S M(J)) with M = J'J is 2 <J S, dJ>: one weight for all numbers of the family.
            2 * weight * (one.rows @ slope)
            for weight, one, (_, slope) in zip(weights, score.evaluations, parts, strict=True)
        ]
        scenarios, edges, columns = self.scenarios, self.vehicles[0].edges, self.bounds.columns
        decisive = scenarios.decisive(score.scenarios) if scenarios and score.scenarios else []
        n_limited = len(scenarios.bounds.names) if scenarios else 0
        by_scenario = {i: np.zeros((len(self.task.grid.times), n_limited, size)) for i in decisive}
        gradient = np.zeros(size)
        signals = np.zeros((len(self.vehicles), len(self.task.grid.times), len(columns), size))

        def one(index: int) -> None:
            # Before the first changed command everything is as it was: the run is restarted there.
            differs = np.flatnonzero((commands[index] != score.commands).any(axis=1))
            if not len(differs):
                return
            step = DIFFERENCE_STEP * signs[index]
            # A linearly interpolated command acts from the sample before.
            edge = int(np.searchsorted(edges, max(differs[0] - 1, 0), "right")) - 1
            for i, vehicle in enumerate(self.vehicles):
                change = vehicle.change(
                    score.evaluations[i], commands[index], edge, slopes[i], columns
                )
                if change is not None:
                    gradient[index] += change[0] / step
                    signals[i, edges[edge] :, :, index] = change[1] / step
            for i, by_numbers in by_scenario.items():
                assert scenarios is not None
                moved = scenarios.change(i, score.scenarios[i], commands[index], edge)
                by_numbers[edges[edge] :, :, index] = moved / step

        self.n_evaluations += size
        in_chunks(one, size, self._n_workers)
        return Slope(gradient, signals, by_scenario)
