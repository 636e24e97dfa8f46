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

# Simulated start states may leave their guesses by this many state scales (soft).
# Measured ones stay near the measurement: with start states held, even wild
# parameters enter almost linearly.
NODE_FREEDOM = 10.0
# The way in only has to arrive nearby: stop when an iteration gains less than this share.
ENOUGH = 1e-3


def free_node_start(
    shooting: Shooting, point: Point, *, n_samples: int, max_iterations: int = 30
) -> Point:
    """Improve the parameters of a point with free-node intervals of ``n_samples`` samples.

    Parameters
    ----------
    shooting : Shooting
        The problem; bounds, priors and noise levels are taken from it.
    point : Point
        Start point; only its unknowns are used.
    n_samples : int
        Length of an interval.
    max_iterations : int
        Most Levenberg-Marquardt iterations.

    Returns
    -------
    Point
        A point with better parameters and data-driven nodes.
    """
    return shooting.start_point(climb(shooting, point.unknowns, n_samples, max_iterations))


def climb(
    shooting: Shooting, unknowns: np.ndarray, n_samples: int, max_iterations: int = 30
) -> np.ndarray:
    """Return better unknowns; see :func:`free_node_start`."""
    return _FreeNodes(shooting, unknowns, n_samples).solve(unknowns, max_iterations)


Blocks = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class _FreeNodes:
    """Levenberg-Marquardt on parameters and independent interval starts."""

    def __init__(self, shooting: Shooting, unknowns: np.ndarray, n_samples: int) -> None:
        self.shooting = shooting
        self.length = n_samples
        self.guesses = []
        for index, record in enumerate(shooting.records):
            stop = len(record.times) // n_samples * n_samples
            guess = shooting.state_guess(unknowns, index)
            self.guesses.append(guess[:stop:n_samples])
        std = np.where(np.isfinite(shooting.guess_std), shooting.guess_std, np.inf)
        self.node_weights = np.minimum(std, NODE_FREEDOM * shooting.state_scale) ** -2.0

    def evaluate(
        self, unknowns: np.ndarray, nodes: list[np.ndarray]
    ) -> tuple[float, list[Blocks]] | None:
        """Cost and, per record, the blocks of the normal equations."""
        s = self.shooting
        cost = s.prior_cost(unknowns)
        blocks = []
        n_full = s.kernel.n_full
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
            if not run.ok or dy is None:
                return None
            residual = record.outputs[:stop] - run.outputs
            scaled, weights = s.scaled(residual)
            away, node_weight = nodes[index] - self.guesses[index], self.node_weights[index]
            cost += 0.5 * float(np.vdot(scaled, scaled) + np.sum(node_weight * away**2))
            jacobian = dy * (weights / s.sigma)[:, :, None]
            jacobian = jacobian.reshape(n_segments, -1, dy.shape[2])
            with np.errstate(over="ignore", invalid="ignore"):
                gram = jacobian.transpose(0, 2, 1) @ jacobian
                right = (scaled.reshape(n_segments, 1, -1) @ jacobian)[:, 0]
            if not np.isfinite(gram).all():
                return None
            gram[:, range(n_full), range(n_full)] += node_weight
            blocks.append(
                (
                    gram[:, :n_full, :n_full],
                    gram[:, :n_full, n_full:],
                    right[:, :n_full] - node_weight * away,
                    gram[:, n_full:, n_full:].sum(axis=0),
                    right[:, n_full:].sum(axis=0),
                )
            )
        return cost, blocks

    def solve(self, unknowns: np.ndarray, max_iterations: int) -> np.ndarray:
        limits = self.shooting.limits
        nodes = self.guesses
        state = self.evaluate(unknowns, nodes)
        if state is None:
            return unknowns
        cost, blocks = state
        damping = 1e-3
        for _ in range(max_iterations):
            step, moves = self._step(unknowns, blocks, damping)
            trial = np.clip(unknowns + step, limits.lower, limits.upper)
            trial_nodes = [node + move for node, move in zip(nodes, moves, strict=True)]
            new = self.evaluate(trial, trial_nodes)
            if new is not None and new[0] < cost:
                done = cost - new[0] < ENOUGH * cost
                unknowns, nodes, (cost, blocks) = trial, trial_nodes, new
                damping = max(damping / 10, 1e-9)
                if done:
                    break
            else:
                damping *= 10
                if damping > 1e6:
                    break
        unknowns = unknowns.copy()
        n_own = self.shooting.layout.n_own
        for index, node in enumerate(nodes):
            unknowns[self.shooting.layout.record_columns(index)[:n_own]] = node[0][:n_own]
        return np.clip(unknowns, limits.lower, limits.upper)

    def _step(
        self, unknowns: np.ndarray, blocks: list[Blocks], damping: float
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Step of the unknowns, and of the nodes per record."""
        limits, layout = self.shooting.limits, self.shooting.layout
        matrix = np.diag(limits.prior_weight)
        right = limits.prior_weight * (limits.prior_mean - unknowns)
        eliminated = []
        for index, (node_matrix, cross, node_right, free_matrix, free_right) in enumerate(blocks):
            columns = layout.record_columns(index)[layout.n_own :]
            damped = node_matrix.copy()
            diagonal = range(node_matrix.shape[1])
            damped[:, diagonal, diagonal] *= 1.0 + damping
            both = np.concatenate([cross, node_right[:, :, None]], axis=2)
            solved = np.linalg.solve(damped, both)
            eliminated.append((columns, solved))
            # By axes: reshaping cannot infer sizes where no parameter is free.
            reduction = np.tensordot(cross, solved, axes=([0, 1], [0, 1]))
            matrix[np.ix_(columns, columns)] += free_matrix - reduction[:, :-1]
            right[columns] += free_right - reduction[:, -1]
        lower, upper = limits.lower - unknowns, limits.upper - unknowns
        step = bounded_step(matrix, right, lower, upper, damping)
        return step, [
            solved[:, :, -1] - solved[:, :, :-1] @ step[columns] for columns, solved in eliminated
        ]
