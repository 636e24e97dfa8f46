"""Globalisation: short intervals whose start states are all free.

Far from the truth, trajectories over a whole record explode and their
derivatives are useless. Over a second or so, from measured states, they do
not. Dropping continuity altogether gives a problem that is nearly linear in
the parameters; its solution starts the real one.

Where an estimation begins: checks, an earlier fit, and the globalisation phase.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.normal_equations import eliminate, gather
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.projection import bounded_step
from oed_sysid.likelihood.shooting import Point, Shooting
from oed_sysid.physics.model import Model

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


# Lengths, in samples, of the free-node intervals on the globalisation phase; beyond the
# last one they triple until they reach the length of a shooting interval.
LADDER = (2, 4, 10, 30)
# Mean square misfit, in noise units, from which a start is far; from which it is
# doubtful; and which a good fit stays below.
FAR, DOUBTFUL, GOOD = 500.0, 30.0, 4.0

InitialStates = Sequence[Mapping[str, float]]


def check_enough_samples(shooting: Shooting) -> None:
    """Raise :class:`DataError` where there are fewer samples than unknowns."""
    layout = shooting.layout
    n_samples = sum(int(np.isfinite(record.outputs).sum()) for record in shooting.records)
    n_priors = int(np.count_nonzero(shooting.limits.prior_weight))
    n_states = layout.n_records * layout.n_own
    if n_samples + n_priors < layout.n_unknowns - min(int(shooting.limits.held.sum()), n_states):
        raise DataError(
            f"{n_samples} measured samples and {n_priors} priors cannot determine "
            f"{layout.n_unknowns} unknowns ({len(layout.shared)} parameters and, for each of "
            f"{layout.n_records} records, {layout.n_own} initial states and {len(layout.local)} "
            "parameters of its own). Add records, fix parameters, or give them a prior_std."
        )


def check_initial_states(
    model: Model, dataset: Dataset, initial_states: InitialStates | None
) -> None:
    """Raise :class:`DataError` where start guesses do not belong to model and records."""
    if initial_states is None:
        return
    if isinstance(initial_states, Mapping) or len(initial_states) != len(dataset):
        raise DataError(
            f"initial_states gives {len(initial_states)} guesses for {len(dataset)} records. Give "
            "a list with one mapping for each record; an empty one leaves it to the data."
        )
    for record, guess in zip(dataset, initial_states, strict=True):
        for name, value in guess.items():
            if name not in model.state_names:
                raise DataError(
                    f"The initial guess of record {record.name!r} names {name!r}, which is no "
                    f"state of {model.name!r}: {', '.join(model.state_names)}."
                )
            if not np.isfinite(value):
                raise DataError(
                    f"The initial guess of {name!r} of record {record.name!r} is {value}. Give a "
                    "number, or leave it out."
                )


def warm_model(model: Model, warm: Fit) -> Model:
    """Return the model with its free parameters at an earlier fit's values, within bounds."""
    free = {parameter.name: parameter for parameter in model.free_parameters}
    earlier = warm.model.values | warm.values
    return model.with_values(
        {
            name: float(np.clip(earlier[name], parameter.lower, parameter.upper))
            for name, parameter in free.items()
            if name in earlier and np.isfinite(earlier[name])
        }
    )


def warm_unknowns(shooting: Shooting, warm: Fit) -> np.ndarray:
    """Start values with the initial states and local parameters of an earlier fit.

    They are taken where the earlier fit saw a record of the same name.
    """
    unknowns, layout = shooting.start_unknowns(), shooting.layout
    positions = {name: i for i, name in enumerate(shooting.model.state_names)}
    for index, record in enumerate(shooting.records):
        if record.name not in warm.dataset.names:
            continue
        earlier = warm.dataset.names.index(record.name)
        if warm.dataset[earlier].times[0] != record.times[0]:
            continue
        columns = layout.record_columns(index)
        states = zip(warm.model.state_names, warm.initial_states[earlier], strict=True)
        for name, value in states:
            if name in positions and np.isfinite(value):
                unknowns[columns[positions[name]]] = value
        for position in layout.local:
            value = warm.local_values[earlier].get(layout.free_names[position], np.nan)
            if np.isfinite(value):
                place = columns[layout.n_own + position]
                unknowns[place] = layout.inward(np.full(len(layout.free_names), value))[position]
    return np.clip(unknowns, shooting.limits.lower, shooting.limits.upper)


def warm_point(shooting: Shooting, warm: Fit) -> Point:
    """Start on the trajectory of an earlier fit; on the measurements where it diverges."""
    unknowns = warm_unknowns(shooting, warm)
    point = shooting.continuous(unknowns)
    if all(np.isfinite(nodes).all() for nodes in point.nodes):
        return point
    return shooting.start_point(unknowns)


def wide_start(shooting: Shooting, point: Point) -> Point:
    """Climb the ladder of free-node intervals from a far start."""
    records = [r for r in shooting.records if not r.independent] or shooting.records
    shortest = min(len(record.times) for record in records)
    rungs = list(LADDER)
    while 3 * rungs[-1] <= shooting.interval_samples < shortest:
        rungs.append(3 * rungs[-1])
    plain = shooting.with_loss(None)
    unknowns = point.unknowns
    for n_samples in rungs:
        if 2 * n_samples <= shortest:
            unknowns = climb(plain, unknowns, n_samples)
    return shooting.start_point(unknowns)


def misfit(shooting: Shooting, point: Point) -> float:
    """Mean square residual in units of noise; infinite where the model diverges."""
    squares, count = 2.0 * shooting.prior_cost(point.unknowns), 0
    for index, record in enumerate(shooting.records):
        z0, _ = shooting.full_start(point.unknowns, index)
        run = shooting.kernel.run(
            record.times,
            record.inputs,
            shooting.values(point.unknowns, index),
            np.vstack([z0[None], point.nodes[index]]),
            starts=shooting.starts[index],
        )
        present = np.isfinite(record.outputs)
        scaled = ((record.outputs - run.outputs) / shooting.sigma)[present]
        if not run.ok or not np.isfinite(scaled).all():
            return np.inf
        squares += float(scaled @ scaled)
        count += len(scaled)
    return squares / max(count, 1)
