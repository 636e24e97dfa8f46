r"""Records in windows whose start states are free: globalisation, and predictions ahead.

With the windows :math:`w` of all records, their start states :math:`z_w` about guesses from the
measurements :math:`\hat z_w` with weights :math:`\Omega`, and the outputs :math:`h` of the
trajectory that begins there, the cost is

.. math::
    c(p) = \tfrac12 \sum_w \min_{z_w} \Big[ \sum_{k \in w}
        \frac{|y_k - h(\varphi(t_k; z_w, p))|^2}{\sigma^2}
        + (z_w - \hat z_w)' \Omega\, (z_w - \hat z_w) \Big] + \text{priors}.

The start states are eliminated window by window (Schur complements), so that an iteration costs the
same whatever the length of the windows; iterations are those of
:mod:`oed_sysid.likelihood.gauss_newton`. Independent tests, such as captive ones, are not cut and
begin from the start states that are given.

Far from the truth, trajectories over a whole record explode and their derivatives are useless. Over
a second or so, from measured states, they do not. Dropping continuity altogether gives a problem
that is nearly linear in the parameters; its solution starts the real one (:func:`wide_start`).

How far ahead a fit has to be right is a horizon :math:`H` (:func:`solve_windows`). Windows of that
length overlap by one sample, so that every transition from a sample to the next belongs to exactly
one, and begin from states of their own, :math:`\Omega = 0`. Over one step this is a regression of
the motion on the state before; over the whole record it is maximum likelihood with white noise.
Where the structure is wrong a long horizon lets its misfit into the derivatives, a short one weighs
noise in the states more. Errors are those of :mod:`oed_sysid.likelihood.covariance`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from oed_sysid.data.record import Record
from oed_sysid.errors import DataError, ModelError
from oed_sysid.likelihood.gauss_newton import (
    Convergence,
    Descent,
    Equations,
    Iterate,
    Progress,
    Solution,
    StepControl,
    nowhere,
)
from oed_sysid.likelihood.shooting import Follows, Point, Shooting
from oed_sysid.likelihood.start_guess import VAGUE
from oed_sysid.runtime.constants import ROUNDING

# What a start state weighs that stays at its guess, to rounding of its scale.
HELD = ROUNDING**-2.0
# Lengths, in samples, of the windows in the globalisation phase; beyond the
# last one they triple until they reach the length of a shooting interval.
LADDER = (2, 4, 10, 30)
# Where windows are free no line is searched: damping alone shortens a step.
CONTROL = StepControl(lengths=1, most_damping=1e6)
# Far from the truth the first step is not trusted.
CAREFUL = replace(CONTROL, damping=1e-3)


@dataclass(frozen=True, eq=False)
class Elimination:
    """Normal equations of the parameters, start states eliminated.

    Attributes
    ----------
    matrix : ndarray (n_free, n_free)
    right : ndarray (n_free,)
    solved : ndarray (n_segments, n_full, n_free + 1)
        Start states answer a step of the parameters by the last column minus
        the others times that step.
    gain : float
        Right-hand sides times solutions of the start states: twice what they
        alone would gain.
    """

    matrix: np.ndarray
    right: np.ndarray
    solved: np.ndarray
    gain: float


@dataclass(frozen=True, eq=False)
class Part:
    """Some windows of one record, run in one go; what lies between is run over, not counted."""

    record: int
    starts: np.ndarray
    counted: np.ndarray
    stop: int


class Windows:
    """Free windows of one model and data set.

    Parameters
    ----------
    shooting : Shooting
        The records, their layout, limits and noise levels.
    parts : sequence of Part
        How the records are cut.
    weight : ndarray (n_records, n_full)
        Of the distance of start states from their guesses.
    unknowns : ndarray (n_unknowns,), optional
        Where to begin; by default at the start values.
    horizon : float, optional
        Length of a window, s, where that is what is asked for.
    """

    def __init__(
        self,
        shooting: Shooting,
        parts: Sequence[Part],
        weight: np.ndarray,
        unknowns: np.ndarray | None = None,
        horizon: float | None = None,
    ) -> None:
        self.shooting, self.weight, self.horizon = shooting, weight, horizon
        self.limits = shooting.limits
        self.windows = tuple(part for part in parts if part.counted.any())
        begin = shooting.start_unknowns() if unknowns is None else unknowns
        guesses = [shooting.state_guess(begin, i) for i in range(len(shooting.records))]
        self.guesses = tuple(guesses[part.record][part.starts] for part in self.windows)
        self.start = Point(begin, self.guesses)

    @classmethod
    def apart(cls, shooting: Shooting, unknowns: np.ndarray, n_samples: int) -> Windows:
        """Windows side by side, start states held by what is measured."""
        parts = []
        for index, record in enumerate(shooting.records):
            length = record.n_samples if record.independent else n_samples
            stop = record.n_samples // length * length
            starts = np.arange(0, stop, length, dtype=np.intc)
            parts.append(Part(index, starts, np.ones(len(starts), dtype=bool), stop))
        # Measured start states stay near the measurement, simulated ones may leave their guesses:
        # with start states held, even wild parameters enter almost linearly.
        std = np.where(np.isfinite(shooting.guess_std), shooting.guess_std, np.inf)
        weight = np.minimum(std, VAGUE * shooting.state_scale) ** -2.0
        return cls(shooting, parts, weight, unknowns)

    @classmethod
    def overlapping(
        cls, shooting: Shooting, horizon: float, unknowns: np.ndarray | None = None
    ) -> Windows:
        """Windows of a horizon, s, that overlap by one sample; own states are free.

        Every transition from a sample to the next belongs to exactly one.
        """
        parts = [p for i, record in enumerate(shooting.records) for p in _cut(i, record, horizon)]
        weight = (VAGUE * shooting.state_scale) ** -2.0
        weight[shooting.layout.n_own :] = HELD
        weights = np.tile(weight, (len(shooting.records), 1))
        return cls(shooting, parts, weights, unknowns, horizon)

    def rated(self, shooting: Shooting) -> Windows:
        """The same windows where the noise levels are those of another problem."""
        other = copy.copy(self)
        other.shooting = shooting
        return other

    @property
    def n_windows(self) -> int:
        """Number of windows of the records that are series in time."""
        records = self.shooting.records
        return sum(int(p.counted.sum()) for p in self.windows if not records[p.record].independent)

    @property
    def n_unknowns(self) -> int:
        """Number of shared parameters and start states that the outputs can tell."""
        layout = self.shooting.layout
        # A window of few samples tells no more start states than it has outputs.
        own = min(layout.n_own, len(self.shooting.sigma))
        return len(layout.shared) + self.n_windows * own

    def at(self, point: Point) -> Iterate:
        """Cost and normal equations of the parameters."""
        grams, closed = [], 0.0
        for part, at, away in self._away(point):
            gram = self.products(part, point.unknowns, at)
            if gram is None:
                return nowhere(self, point)
            grams.append(gram)
            square = float(gram[:, -1, -1].sum() + np.sum(self.weight[part.record] * away**2))
            closed += 0.5 * square

        def equations(damping: float) -> Equations:
            n = self.shooting.layout.n_unknowns
            matrix, right = np.zeros((n, n)), np.zeros(n)
            alone, follows = 0.0, []
            for (part, _, away), gram in zip(self._away(point), grams, strict=True):
                found = self._eliminated(part, gram, away, damping)
                columns = self.columns(part)
                matrix[np.ix_(columns, columns)] += found.matrix
                right[columns] += found.right
                alone += 0.5 * found.gain
                follows.append((-found.solved[:, :, :-1], found.solved[:, :, -1]))
            return Equations(matrix, right, closed - alone, tuple(follows))

        return Iterate(self, point, closed + self.limits.prior_cost(point.unknowns), equations)

    def _away(self, point: Point) -> Iterator[tuple[Part, np.ndarray, np.ndarray]]:
        """Every part, its start states, and how far the counted ones are from their guesses."""
        for part, at, guess in zip(self.windows, point.nodes, self.guesses, strict=True):
            still = self.shooting.records[part.record].independent
            yield part, at, 0.0 * at[part.counted] if still else (at - guess)[part.counted]

    def _eliminated(
        self, part: Part, gram: np.ndarray, away: np.ndarray, damping: float
    ) -> Elimination:
        """Normal equations of the parameters from one part."""
        if self.shooting.records[part.record].independent:
            # Begins from its given start, which nothing moves but the parameters.
            summed = gram.sum(axis=0)
            solved = np.zeros((*away.shape, gram.shape[2]))
            return Elimination(summed[:-1, :-1], summed[:-1, -1], solved, 0.0)
        weight = self.weight[part.record]
        return eliminate(gram, away, weight, damping)

    def told(self, point: Point) -> Iterator[tuple[Part, np.ndarray, np.ndarray]]:
        """Every part, its information about the parameters, and the score of each window."""
        n_free = len(self.shooting.layout.free_names)
        for part, at, away in self._away(point):
            gram = self.products(part, point.unknowns, at)
            assert gram is not None
            found = self._eliminated(part, gram, away, 0.0)
            first = gram.shape[1] - n_free - 1
            # Score of the parameters less what the start states, estimated along, have taken of
            # it.
            cross = gram[:, :first, first:-1]
            moved = found.solved[:, :first, -1]
            scores = gram[:, first:-1, -1] - np.einsum("wij,wi->wj", cross, moved)
            yield part, found.matrix, scores

    def products(self, part: Part, unknowns: np.ndarray, at: np.ndarray) -> np.ndarray | None:
        """Products ``[J r]' [J r]`` of the counted windows of a part; None where it diverges.

        Columns are start states (not of independent tests), unknowns of the record's free
        parameters, and residuals.
        """
        shooting = self.shooting
        record, n_full = shooting.records[part.record], shooting.kernel.n_full
        z0, by_unknowns = shooting.full_start(unknowns, part.record)
        nodes = z0[None] if record.independent else at
        seen, values = slice(part.stop), shooting.values(unknowns, part.record)
        blocks = shooting.kernel.gather(
            record.times[seen], record.inputs[seen], values, nodes, record.outputs[seen],
            shooting.sigma, starts=part.starts, linked=False,
        )  # fmt: skip
        if blocks is None:
            return None
        gram = blocks.gram[part.counted]
        if not shooting.layout.is_plain:
            slopes = shooting.slopes(unknowns, part.record)
            scale = np.concatenate([np.ones(n_full), slopes, [1.0]])
            # Parameters that are unknown as logarithms: the chain rule, on both sides.
            gram = gram * scale[:, None] * scale
        if record.independent:
            # A window that begins from its given start: its columns by the unknown parameters.
            wide = np.eye(gram.shape[1])[:, n_full:]
            wide[:n_full, :-1] = by_unknowns[:, shooting.layout.n_own :]
            gram = wide.T @ gram @ wide
        return gram

    def paths(self, point: Point) -> list[tuple[np.ndarray, np.ndarray]]:
        """Outputs and states of the windows, put together per record.

        Where two windows meet, the sample is that of the window which it ends.
        """
        shooting = self.shooting
        found = shooting.no_paths()
        for part, at in zip(self.windows, point.nodes, strict=True):
            record = shooting.records[part.record]
            z0, _ = shooting.full_start(point.unknowns, part.record)
            nodes = z0[None] if record.independent else at
            run = shooting.kernel.run(
                record.times, record.inputs, shooting.values(point.unknowns, part.record), nodes,
                starts=part.starts,
            )  # fmt: skip
            outputs, states = found[part.record]
            stops = np.append(part.starts[1:], record.n_samples)
            for start, stop in zip(part.starts[part.counted], stops[part.counted], strict=True):
                rows = slice(start if start == 0 else start + 1, stop)
                outputs[rows], states[rows] = run.outputs[rows], run.states[rows]
        return found

    def residuals(self, point: Point) -> list[np.ndarray]:
        """Measured less predicted ``(n_times, n_outputs)``, per record."""
        pairs = zip(self.shooting.records, self.paths(point), strict=True)
        return [record.outputs - outputs for record, (outputs, _) in pairs]

    def columns(self, part: Part) -> np.ndarray:
        """Positions of a part's free parameters among all unknowns."""
        layout = self.shooting.layout
        return layout.record_columns(part.record)[layout.n_own :]

    def move(self, point: Point, follows: Follows, step: np.ndarray, length: float) -> Point:
        """The point after a step of the unknowns and what it implies for the start states."""
        unknowns = np.clip(point.unknowns + length * step, self.limits.lower, self.limits.upper)
        nodes = []
        for part, at, (map_, offset) in zip(self.windows, point.nodes, follows, strict=True):
            moved = at.copy()
            moved[part.counted] += length * (map_ @ step[self.columns(part)] + offset)
            nodes.append(moved)
        return Point(unknowns, tuple(nodes))


def eliminate(
    gram: np.ndarray, away: np.ndarray, weight: np.ndarray, damping: float
) -> Elimination:
    """Eliminate the start states of independent segments.

    Parameters
    ----------
    gram : ndarray (n_segments, n_columns + 1, n_columns + 1)
        As in :class:`Blocks`.
    away : ndarray (n_segments, n_full)
        Start states minus their guesses.
    weight : ndarray (n_full,)
        What these differences weigh, above zero.
    damping : float
        Share by which the diagonal of the start states is raised.
    """
    n_full = len(weight)
    damped, diagonal = gram[:, :n_full, :n_full].copy(), range(n_full)
    damped[:, diagonal, diagonal] += weight
    damped[:, diagonal, diagonal] *= 1.0 + damping
    both = gram[:, :n_full, n_full:].copy()
    both[:, :, -1] -= weight * away
    # Equilibrated, and raised by rounding: what two start states share must not stop the step.
    scale = 1.0 / np.sqrt(np.maximum(damped[:, diagonal, diagonal], np.finfo(float).tiny))
    damped *= scale[:, :, None] * scale[:, None, :]
    damped[:, diagonal, diagonal] += n_full * np.finfo(float).eps
    # (G_zz + Omega)^-1 [G_zp, b_z]: how start states follow the parameters, and their own step.
    solved = scale[:, :, None] * np.linalg.solve(damped, scale[:, :, None] * both)
    # By axes: reshaping cannot infer sizes where no parameter is free.
    reduced = gram[:, n_full:-1, n_full:].sum(axis=0) - np.tensordot(
        both[:, :, :-1], solved, axes=([0, 1], [0, 1])
    )
    gain = float(np.vdot(both[:, :, -1], solved[:, :, -1]))
    return Elimination(reduced[:, :-1], reduced[:, -1], solved, gain)


def _cut(index: int, record: Record, horizon: float) -> list[Part]:
    """Windows that overlap by one sample, in two passes over the record."""
    n = record.n_samples
    step = n - 1
    if not record.independent:
        step = max(1, min(round(horizon / record.sample_time), step))
    parts = []
    for parity in (0, 1):
        begin = np.arange(parity * step, n - 1, 2 * step)
        # What lies between two windows of a pass is run over.
        starts = np.unique([0, *begin, *(begin + step + 1)])
        starts = starts[starts < n].astype(np.intc)
        parts.append(Part(index, starts, np.isin(starts, begin), n))
    return parts


def climb(shooting: Shooting, unknowns: np.ndarray, n_samples: int) -> np.ndarray:
    """Improve unknowns by windows of ``n_samples`` samples; they stay where these diverge.

    Parameters
    ----------
    shooting : Shooting
        The problem; bounds, priors and noise levels are taken from it.
    unknowns : ndarray (n_unknowns,)
        Where to begin.
    n_samples : int
        Length of a window.
    """
    problem = Windows.apart(shooting, unknowns, n_samples)
    # The way in only has to arrive nearby: it ends with an iteration that gains less than a share.
    enough = Convergence(0.0, share=0.01)
    descent = Descent(problem.at(problem.start), Windows.at, enough, CAREFUL)
    if descent.run(30) == "diverged":
        return unknowns
    found = descent.now.point.unknowns.copy()
    n_own = shooting.layout.n_own
    for part, node in zip(problem.windows, descent.now.point.nodes, strict=True):
        if not shooting.records[part.record].independent:
            found[shooting.layout.record_columns(part.record)[:n_own]] = node[0][:n_own]
    return np.clip(found, shooting.limits.lower, shooting.limits.upper)


def wide_start(shooting: Shooting, point: Point) -> Point:
    """Climb the ladder of free windows from a far start."""
    records = [r for r in shooting.records if not r.independent] or shooting.records
    shortest = min(len(record.times) for record in records)
    rungs, pairs = list(LADDER), zip(shooting.starts, shooting.records, strict=True)
    longest = max(int(np.diff([*own, len(record.times)]).max()) for own, record in pairs)
    while 3 * rungs[-1] <= longest < shortest:
        rungs.append(3 * rungs[-1])
    plain = shooting.having(loss=None)
    unknowns = point.unknowns
    for n_samples in rungs:
        if 2 * n_samples <= shortest:
            unknowns = climb(plain, unknowns, n_samples)
    return shooting.start_point(unknowns)


def check_horizon(shooting: Shooting, horizon: float) -> None:
    """Raise an error where a horizon is shorter than one step, or start states are stated."""
    in_time = [not record.independent for record in shooting.records]
    series = compress(shooting.records, in_time)
    longest = max((record.sample_time for record in series), default=0.0)
    if not horizon >= 0.99 * longest:
        raise DataError(
            f"horizon is {horizon:g} s, and a step of the records {longest:g} s. Give at least one "
            "step; horizon=None predicts whole records."
        )
    known = shooting.known_starts
    if known is not None and np.isfinite(known.std[in_time]).any():
        raise ModelError(
            "start_states are those of whole records; windows of a horizon begin from states of "
            "their own. Drop one of the two."
        )


def solve_windows(
    shooting: Shooting,
    point: Point,
    *,
    horizon: float,
    max_iterations: int,
    tolerance: float,
    callback: Callable[[Progress], None] | None = None,
) -> Solution:
    """Minimise over windows of a horizon.

    Parameters
    ----------
    shooting : Shooting
        The problem.
    point : Point
        Where to begin; only its unknowns are used.
    horizon : float
        Length of a window, s.
    max_iterations, tolerance, callback
        See :func:`oed_sysid.likelihood.gauss_newton.solve`.
    """
    problem = Windows.overlapping(shooting, horizon, point.unknowns)
    descent = Descent(problem.at(problem.start), Windows.at, Convergence(tolerance), CONTROL)
    reason = descent.run(max_iterations, callback=callback)
    return Solution(descent.now, descent.steps + (reason != "diverged"), reason)
