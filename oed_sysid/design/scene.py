"""Trajectory, information and their change with the commands, for one set of values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.model import Model
from oed_sysid.sensitivity.bound import start_weights
from oed_sysid.sensitivity.noise import Noise
from oed_sysid.sensitivity.shifts import Shifts

# Relative sensitivities beyond this, in noise units, belong to a trajectory that runs away.
_DIVERGED = 1e9


@dataclass(frozen=True, eq=False)
class View:
    """One evaluation of a scene.

    Attributes
    ----------
    rows : ndarray (n_times, n_outputs, n_columns)
        Scaled derivatives of the outputs by nuisance unknowns, parameters and
        rival shifts, in noise units, not prewhitened.
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


class Scene:
    """One set of parameter values under which commands are judged.

    Parameters
    ----------
    model : Model
        At these values.
    times : ndarray (n_times,)
        Sample times, s.
    edges : ndarray of int (n_edges,)
        Samples from which a changed trajectory can be restarted; starts with 0.
    own : ndarray (n_own,)
        Start state.
    noise : Noise
        Of the outputs.
    start : str or mapping
        See :func:`~oed_sysid.sensitivity.bound.information_of`.
    shifts : Shifts, optional
        What absent effects and rival models would do.
    """

    def __init__(
        self,
        model: Model,
        times: np.ndarray,
        edges: np.ndarray,
        own: np.ndarray,
        noise: Noise,
        *,
        start: object = "unknown",
        shifts: Shifts | None = None,
    ) -> None:
        self.model, self.times, self.own, self.noise = model, times, own, noise
        self.edges = np.ascontiguousarray(edges, dtype=np.intc)
        self.kernel = kernel(model)
        self.values = model.value_vector
        self.rivals: tuple[tuple[Kernel, np.ndarray, float], ...] = ()
        if shifts is not None:
            self.rivals = tuple(
                (runner, rival.value_vector, float(factor))
                for runner, rival, factor in zip(
                    shifts.kernels, shifts.models, shifts.factors, strict=True
                )
            )
        n_own, free = len(model.states), model.free_parameters
        weights = start_weights(model, start)  # type: ignore[arg-type]
        states = [i for i in range(n_own) if np.isfinite(weights[i])]
        local = [n_own + i for i, p in enumerate(free) if p.per_record]
        shared = [n_own + i for i, p in enumerate(free) if not p.per_record]
        self.columns = np.array([*states, *local, *shared], dtype=int)
        self.n_nuisance = len(states) + len(local)
        self.names = tuple(free[i - n_own].name for i in shared)
        self.scales = np.array(
            [
                *(model.states[i].scale for i in states),
                *(free[i - n_own].magnitude for i in (*local, *shared)),
            ]
        )
        # Of nuisance unknowns only; priors on parameters are added to the information later.
        known = [weights[i] for i in states]
        known += [1.0 / (free[i - n_own].prior_spread or np.inf) for i in local]
        self.nuisance_prior = (np.array(known) * self.scales[: self.n_nuisance]) ** 2

    def view(self, commands: np.ndarray) -> View | None:
        """Evaluate commands ``(n_times, n_inputs)``; None where a trajectory diverges."""
        runner = self.kernel
        z, dz = runner.start(self.own, commands[0], self.values, float(self.times[0]))
        run = runner.run(
            self.times, commands, self.values, z, starts=self.edges, carry=True, sensitivities=True
        )
        dy, dends = run.output_sensitivities, run.end_sensitivities
        if not run.ok or dy is None or dends is None or not np.isfinite(dy).all():
            return None
        n_full = runner.n_full
        maps = np.empty((len(self.edges), *dz.shape))
        maps[0] = dz
        for i in range(len(self.edges) - 1):
            maps[i + 1] = dends[i, :, :n_full] @ maps[i]
            maps[i + 1, :, runner.n_own :] += dends[i, :, n_full:]
        chains = self._chains(maps)
        rows = np.empty((*run.outputs.shape, len(self.columns) + len(self.rivals)))
        stops = [*self.edges[1:], len(self.times)]
        for i, (first, stop) in enumerate(zip(self.edges, stops, strict=True)):
            rows[first:stop, :, : len(self.columns)] = dy[first:stop] @ chains[i]
        rival_nodes = []
        for position, (rival, values, factor) in enumerate(self.rivals):
            node, _ = rival.start(self.own, commands[0], values, float(self.times[0]))
            other = rival.run(self.times, commands, values, node)
            if not other.ok:
                return None
            rows[:, :, len(self.columns) + position] = factor * (other.outputs - run.outputs)
            rival_nodes.append(other.states[self.edges])
        rows /= self.noise.sigma[:, None]
        if not np.abs(rows).max() < _DIVERGED:
            return None
        signals = np.hstack([run.states, run.outputs])
        return View(rows, signals, run.states[self.edges], chains, tuple(rival_nodes))

    def change(
        self,
        view: View,
        commands: np.ndarray,
        edge: int,
        by_rows: np.ndarray,
        columns: np.ndarray,
    ) -> tuple[float, np.ndarray] | None:
        """Return what changed commands do to a linear function of the rows, and to signals.

        Parameters
        ----------
        view : View
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
        z, chain = view.nodes[edge], view.chains[edge]
        if edge == 0:
            z, dz = self.kernel.start(self.own, commands[0], self.values, float(times[0]))
            chain = self._chains(dz[None])[0]
        run = self.kernel.run(times, part, self.values, z, sensitivities=True)
        if not run.ok or run.output_sensitivities is None:
            return None
        n_kept, n_full = len(self.columns), self.kernel.n_full
        weights = by_rows[first:] / self.noise.sigma[:, None]
        # <W, S chain> = <W chain', S>: one product, no copy of the sensitivities.
        pulled = weights[:, :, :n_kept].reshape(-1, n_kept) @ chain.T
        total = float(np.vdot(pulled, run.output_sensitivities))
        for position, (rival, values, factor) in enumerate(self.rivals):
            node = view.rival_nodes[position][edge]
            if edge == 0:
                node, _ = rival.start(self.own, commands[0], values, float(times[0]))
            other = rival.run(times, part, values, node)
            if not other.ok:
                return None
            moved = factor * (other.outputs - run.outputs)
            total += float(np.vdot(weights[:, :, n_kept + position], moved))
        total -= float(np.vdot(by_rows[first:], view.rows[first:]))
        signals = np.empty((len(times), len(columns)))
        for index, column in enumerate(columns):
            source = run.states[:, column] if column < n_full else run.outputs[:, column - n_full]
            signals[:, index] = source - view.signals[first:, column]
        return total, signals

    def _chains(self, maps: np.ndarray) -> np.ndarray:
        """See :class:`View`; ``maps`` are derivatives of the states at the edges."""
        n_edges, n_full, n_unknowns = maps.shape
        n_own = len(self.own)
        chains = np.zeros((n_edges, n_full + n_unknowns - n_own, n_unknowns))
        chains[:, :n_full] = maps
        chains[:, n_full:, n_own:] = np.eye(n_unknowns - n_own)
        return chains[:, :, self.columns] * self.scales

    def information(self, rows: np.ndarray) -> np.ndarray:
        """Scaled information on ``[nuisance, parameters, rival shifts]``."""
        white = self.whitened(rows).reshape(-1, rows.shape[2])
        matrix = white.T @ white
        index = np.arange(self.n_nuisance)
        matrix[index, index] += self.nuisance_prior
        return matrix

    def whitened(self, rows: np.ndarray) -> np.ndarray:
        """Rows with the colour of the noise removed."""
        if self.noise.is_white:
            return rows
        present = np.ones(rows.shape[:2], dtype=bool)
        unit = Noise(np.ones(rows.shape[1]), self.noise.coefficients)
        return unit.whiten(rows, present)

    def unwhitened(self, weights: np.ndarray) -> np.ndarray:
        """Adjoint of :meth:`whitened`, for gradients."""
        if self.noise.is_white:
            return weights
        n_times, n_outputs = weights.shape[:2]
        result = weights.copy()
        present = np.ones((n_times, 1), dtype=bool)
        for column in range(n_outputs):
            colour = self.noise.coefficients[column]
            if colour:
                unit = Noise(np.ones(1), (colour,))
                matrix = unit.whiten(np.eye(n_times)[:, None, :], present)[:, 0]
                result[:, column] = matrix.T @ weights[:, column]
        return result
