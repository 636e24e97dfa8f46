"""A wide way in: short intervals whose start states are all free.

Far from the truth, trajectories over a whole record explode and their
derivatives are useless. Over a second or so, from measured states, they do
not. Dropping continuity altogether gives a problem that is nearly linear in
the parameters; its solution starts the real one.
"""

from __future__ import annotations

import numpy as np

from oed_sysid.gauss_newton import bounded_step
from oed_sysid.shooting import Point, Shooting
from oed_sysid.start_states import measured_columns

# Start states may leave their guesses by this many state scales (soft).
NODE_FREEDOM = 10.0
# Measured ones stay near the smoothed measurement, in units of its noise: with
# start states held, even wild parameters enter almost linearly.
MEASURED_FREEDOM = 1.0


def free_node_start(
    shooting: Shooting, point: Point, *, n_samples: int, max_iterations: int = 30
) -> Point:
    """Improve the parameters of a point with free-node intervals of ``n_samples`` samples.

    Parameters
    ----------
    shooting : Shooting
        The problem; bounds, priors and noise levels are taken from it.
    point : Point
        Start point.
    n_samples : int
        Length of an interval.
    max_iterations : int
        Most Levenberg-Marquardt iterations.

    Returns
    -------
    Point
        A point with better parameters and data-driven nodes.
    """
    problem = _FreeNodes(shooting, point, n_samples)
    unknowns = problem.solve(point.unknowns, max_iterations)
    return shooting.start_point(unknowns)


Blocks = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class _FreeNodes:
    """Levenberg-Marquardt on parameters and independent interval starts."""

    def __init__(self, shooting: Shooting, point: Point, n_samples: int) -> None:
        self.shooting = shooting
        self.length = n_samples
        fine = shooting.with_intervals(n_samples)
        start = fine.start_point(point.unknowns)
        self.nodes = []
        for index, record in enumerate(shooting.records):
            n_segments = len(record.times) // n_samples
            z0, _ = shooting.kernel.start(
                shooting.initial_state(point.unknowns, index),
                record.inputs[0],
                shooting.values(point.unknowns, index),
                record.times[0],
            )
            self.nodes.append(np.vstack([z0[None], start.nodes[index]])[:n_segments])
        self.guesses = [nodes.copy() for nodes in self.nodes]
        self.node_weight = (NODE_FREEDOM * shooting.state_scale) ** -2.0
        for state, output in measured_columns(shooting.model).items():
            self.node_weight[state] = (MEASURED_FREEDOM * shooting.sigma[output]) ** -2.0

    def evaluate(
        self, unknowns: np.ndarray, nodes: list[np.ndarray]
    ) -> tuple[float, list[Blocks]] | None:
        """Cost and, per record, the blocks of the normal equations."""
        s = self.shooting
        cost = 0.5 * float(s.prior_weight @ (unknowns - s.prior_mean) ** 2)
        blocks = []
        for index, record in enumerate(s.records):
            n_segments = len(nodes[index])
            stop = n_segments * self.length
            starts = np.arange(0, stop, self.length, dtype=np.intc)
            run = s.kernel.run(
                record.times[:stop],
                record.inputs[:stop],
                s.values(unknowns, index),
                nodes[index],
                starts=starts,
                sensitivities=True,
            )
            dy = run.output_sensitivities
            if not run.ok or dy is None or not np.isfinite(dy).all():
                return None
            residual = record.outputs[:stop] - run.outputs
            present = np.isfinite(residual)
            scaled = np.where(present, residual, 0.0) / s.sigma
            away = nodes[index] - self.guesses[index]
            cost += 0.5 * float(np.sum(scaled**2) + np.sum(self.node_weight * away**2))
            jacobian = dy * (present / s.sigma)[:, :, None]
            jacobian = jacobian.reshape(n_segments, -1, dy.shape[2])
            target = scaled.reshape(n_segments, -1, 1)
            n_full = s.kernel.n_full
            by_node, by_free = jacobian[:, :, :n_full], jacobian[:, :, n_full:]
            node_matrix = by_node.transpose(0, 2, 1) @ by_node + np.diag(self.node_weight)
            cross = by_node.transpose(0, 2, 1) @ by_free
            node_right = (by_node.transpose(0, 2, 1) @ target)[:, :, 0] - self.node_weight * away
            flat = by_free.reshape(-1, by_free.shape[2])
            blocks.append(
                (node_matrix, cross, node_right, flat.T @ flat, flat.T @ target.reshape(-1))
            )
        return cost, blocks

    def solve(self, unknowns: np.ndarray, max_iterations: int) -> np.ndarray:
        s = self.shooting
        n_own = s.layout.n_own
        nodes = self.nodes
        state = self.evaluate(unknowns, nodes)
        if state is None:
            return unknowns
        cost, blocks = state
        damping = 1e-3
        for _ in range(max_iterations):
            n = s.layout.n_unknowns
            matrix = np.diag(s.prior_weight)
            right = s.prior_weight * (s.prior_mean - unknowns)
            eliminated = []
            for index, (node_matrix, cross, node_right, free_matrix, free_right) in enumerate(
                blocks
            ):
                columns = s.layout.record_columns(index)[n_own:]
                damped = node_matrix + damping * _diagonals(node_matrix)
                solved = np.linalg.solve(
                    damped, np.concatenate([cross, node_right[:, :, None]], axis=2)
                )
                eliminated.append((columns, solved))
                by_cross, by_right = solved[:, :, :-1], solved[:, :, -1:]
                matrix[np.ix_(columns, columns)] += free_matrix - np.sum(
                    cross.transpose(0, 2, 1) @ by_cross, axis=0
                )
                right[columns] += (
                    free_right - np.sum(cross.transpose(0, 2, 1) @ by_right, axis=0).ravel()
                )
            step = bounded_step(
                matrix[:n, :n], right, s.lower - unknowns, s.upper - unknowns, damping
            )
            trial = np.clip(unknowns + step, s.lower, s.upper)
            trial_nodes = [
                node + solved[:, :, -1] - solved[:, :, :-1] @ step[columns]
                for node, (columns, solved) in zip(nodes, eliminated, strict=True)
            ]
            new = self.evaluate(trial, trial_nodes)
            if new is not None and new[0] < cost:
                small = cost - new[0] < 1e-4 * cost
                unknowns, nodes, (cost, blocks) = trial, trial_nodes, new
                damping = max(damping / 10, 1e-9)
                if small:
                    break
            else:
                damping *= 10
                if damping > 1e6:
                    break
        for index in range(len(s.records)):
            columns = s.layout.record_columns(index)[:n_own]
            unknowns = unknowns.copy()
            unknowns[columns] = nodes[index][0][:n_own]
        return unknowns


def _diagonals(matrices: np.ndarray) -> np.ndarray:
    result = np.zeros_like(matrices)
    index = np.arange(matrices.shape[1])
    result[:, index, index] = matrices[:, index, index]
    return result
