"""A wide way in: short intervals whose start states are all free.

Far from the truth, trajectories over a whole record explode and their
derivatives are useless. Over a second or so, from measured states, they do
not. Dropping continuity altogether gives a problem that is nearly linear in
the parameters; its solution starts the real one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.normal_equations import eliminate, gather
from oed_sysid.likelihood.projection import bounded_step
from oed_sysid.likelihood.shooting import Point, Shooting

# Simulated start states may leave their guesses by this many state scales (soft).
# Measured ones stay near the measurement: with start states held, even wild
# parameters enter almost linearly.
NODE_FREEDOM = 10.0
# The way in only has to arrive nearby: stop when an iteration gains less than this share.
ENOUGH = 1e-2


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


@dataclass(frozen=True, eq=False)
class _Evaluation:
    """Cost, and per record the products of its segments and how far its nodes have moved."""

    cost: float
    grams: tuple[np.ndarray, ...]
    away: tuple[np.ndarray, ...]


class _FreeNodes:
    """Levenberg-Marquardt on parameters and independent interval starts."""

    def __init__(self, shooting: Shooting, unknowns: np.ndarray, n_samples: int) -> None:
        self.shooting = shooting
        self.lengths, self.guesses = [], []
        for index, record in enumerate(shooting.records):
            n = len(record.times)
            # Independent tests may be fewer than the samples of an interval.
            length = min(n_samples, n) if record.independent else n_samples
            guess = shooting.state_guess(unknowns, index)
            self.lengths.append(length)
            self.guesses.append(guess[: n // length * length : length])
        std = np.where(np.isfinite(shooting.guess_std), shooting.guess_std, np.inf)
        self.node_weights = np.minimum(std, NODE_FREEDOM * shooting.state_scale) ** -2.0

    def evaluate(self, unknowns: np.ndarray, nodes: list[np.ndarray]) -> _Evaluation | None:
        """Cost and normal equations; None where a trajectory is not finite."""
        s = self.shooting
        cost, grams, moved = s.prior_cost(unknowns), [], []
        for index, record in enumerate(s.records):
            stop = len(nodes[index]) * self.lengths[index]
            blocks = gather(
                s.kernel,
                record.times[:stop],
                record.inputs[:stop],
                s.values(unknowns, index),
                nodes[index],
                record.outputs[:stop],
                s.sigma,
                starts=np.arange(0, stop, self.lengths[index], dtype=np.intc),
                linked=False,
            )
            if blocks is None:
                return None
            away = nodes[index] - self.guesses[index]
            squares = float(blocks.gram[:, -1, -1].sum())
            cost += 0.5 * (squares + float(np.sum(self.node_weights[index] * away**2)))
            grams.append(blocks.gram)
            moved.append(away)
        return _Evaluation(cost, tuple(grams), tuple(moved))

    def solve(self, unknowns: np.ndarray, max_iterations: int) -> np.ndarray:
        limits = self.shooting.limits
        nodes = self.guesses
        now = self.evaluate(unknowns, nodes)
        if now is None:
            return unknowns
        damping = 1e-3
        for _ in range(max_iterations):
            step, moves, gain = self._step(unknowns, now, damping)
            if gain < ENOUGH * now.cost:
                break
            trial = np.clip(unknowns + step, limits.lower, limits.upper)
            trial_nodes = [node + move for node, move in zip(nodes, moves, strict=True)]
            new = self.evaluate(trial, trial_nodes)
            if new is not None and new.cost < now.cost:
                done = now.cost - new.cost < ENOUGH * now.cost
                unknowns, nodes, now = trial, trial_nodes, new
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
        self, unknowns: np.ndarray, now: _Evaluation, damping: float
    ) -> tuple[np.ndarray, list[np.ndarray], float]:
        """Step of the unknowns, of the nodes per record, and what they should gain."""
        limits, layout = self.shooting.limits, self.shooting.layout
        matrix = np.diag(limits.prior_weight)
        right = limits.prior_weight * (limits.prior_mean - unknowns)
        eliminated, gain = [], 0.0
        for index, (gram, away) in enumerate(zip(now.grams, now.away, strict=True)):
            columns = layout.record_columns(index)[layout.n_own :]
            found = eliminate(self.shooting.kernel, gram, away, self.node_weights[index], damping)
            slopes = layout.slopes(unknowns[columns])
            eliminated.append((columns, slopes, found))
            matrix[np.ix_(columns, columns)] += found.matrix * slopes[:, None] * slopes
            right[columns] += found.right * slopes
            gain += 0.5 * found.gain
        lower, upper = limits.lower - unknowns, limits.upper - unknowns
        step = bounded_step(matrix, right, lower, upper, damping)
        gain += float(right @ step - 0.5 * step @ matrix @ step)
        moves = [found.moves(slopes * step[columns]) for columns, slopes, found in eliminated]
        return step, moves, gain
