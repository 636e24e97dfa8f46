r"""Least squares over short predictions: how far ahead a fit has to be right.

A record is cut into windows of a horizon :math:`H` that overlap by one sample, so that every
transition from a sample to the next belongs to exactly one. Each window begins from a state of its
own, and with the outputs :math:`h` of the trajectory that starts there,

.. math::
    \min_{p} \sum_w \min_{x_w} \sum_{k \in w} \frac{|y_k - h(\varphi(t_k; x_w, p))|^2}{\sigma^2}
        + \text{priors}.

Over one step this is a regression of the motion on the state before; over the whole record it is
maximum likelihood with white noise. Where the structure is wrong a long horizon lets its misfit
into the derivatives, a short one weighs noise in the states more.

The start states are eliminated window by window (Schur complements), so that an iteration costs the
same at every horizon. Scores of windows are not independent where residuals are coloured: the
covariance is :math:`H^{-1} B H^{-1}` with :math:`B` their covariance, neighbours within a tenth of
the record included (Newey & West 1987, Econometrica 55). Where windows are too few for that, it is
:math:`H^{-1}` times the residuals' mean square in units of the noise and the samples per
independent one. Independent tests, such as captive ones, are not cut, begin from the start states
that are given, and add to :math:`B` as :mod:`oed_sysid.likelihood.covariance` says.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.normal_equations import gather
from oed_sysid.errors import DataError
from oed_sysid.likelihood.between_records import (
    FEWEST_RECORDS,
    RecordScatter,
    eliminate_own,
    record_scatter,
)
from oed_sysid.likelihood.covariance import tests_middle, tests_stray
from oed_sysid.likelihood.fit import Fit, Status
from oed_sysid.likelihood.gauss_newton import Progress
from oed_sysid.likelihood.information import Information, effective_sample_size
from oed_sysid.likelihood.projection import bounded_step
from oed_sysid.likelihood.shooting import Shooting, replace_values

# What a start state of a window is known to before its samples, in units of the state's scale.
VAGUE = 30.0
HALVINGS = 12
NOISE_ROUNDS = 4
# Share of a record's windows over which scores are taken to be related.
RELATED = 0.1
# Windows per parameter that a covariance from their scores needs.
ENOUGH = 4
_ADVICE = {
    "converged": "",
    "stalled": "no step lowers the misfit, yet the gradient is not zero. Values are the best found;"
    " check bounds and parameters that are not identifiable, or take another horizon.",
    "iterations": "the limit of iterations was reached. Raise max_iterations or start closer.",
    "diverged": "the model diverges within the first horizon. Check signs and units of "
    "the start values, or shorten the horizon.",
}


@dataclass(frozen=True, eq=False)
class _Windows:
    """Every second window of one record; what lies between is run over, not counted."""

    record: int
    starts: np.ndarray
    counted: np.ndarray


@dataclass(frozen=True, eq=False)
class _Evaluation:
    """Sums over all windows at one point."""

    cost: float
    matrix: np.ndarray
    right: np.ndarray
    maps: tuple[np.ndarray, ...]
    scores: tuple[np.ndarray, ...]
    own: tuple[np.ndarray, ...]


class Horizons:
    """Short predictions of one model and data set.

    Parameters
    ----------
    shooting : Shooting
        The records, their layout, limits and noise levels.
    horizon : float
        Length of a window, s; at least one sample step, at most the record.
    """

    def __init__(self, shooting: Shooting, horizon: float) -> None:
        self.shooting, self.horizon = shooting, horizon
        layout = shooting.layout
        # Positions of the parameters among all unknowns; start states are the windows' own.
        width = layout.n_own + len(layout.local)
        self._kept = np.array(
            [
                i
                for i in range(layout.n_unknowns)
                if i < len(layout.shared) or (i - len(layout.shared)) % width >= layout.n_own
            ],
            dtype=int,
        )
        place = {position: i for i, position in enumerate(self._kept)}
        self._columns = [
            np.array([place[c] for c in layout.record_columns(i)[layout.n_own :]], dtype=int)
            for i in range(layout.n_records)
        ]
        self.windows = tuple(
            part
            for index in range(layout.n_records)
            for part in self._cut(index)
            if part.counted.any()
        )

    @property
    def n_windows(self) -> int:
        """Number of windows of the records that are series in time."""
        records = self.shooting.records
        return sum(int(p.counted.sum()) for p in self.windows if not records[p.record].independent)

    def _cut(self, index: int) -> tuple[_Windows, _Windows]:
        """Windows that overlap by one sample, in two passes over the record."""
        record = self.shooting.records[index]
        n = record.n_samples
        step = n - 1
        if not record.independent:
            step = max(1, min(round(self.horizon / record.sample_time), step))
        edges = np.arange(0, n - 1, step)
        parts = []
        for parity in (0, 1):
            starts: list[int] = []
            counted: list[bool] = []
            reached = 0
            for edge in edges[parity::2]:
                if edge > reached:  # a stretch of the other pass
                    starts, counted = [*starts, reached], [*counted, False]
                starts, counted = [*starts, int(edge)], [*counted, True]
                reached = min(int(edge) + step + 1, n)
            if reached < n and starts:
                starts, counted = [*starts, reached], [*counted, False]
            parts.append(
                _Windows(index, np.array(starts, dtype=np.intc), np.array(counted, dtype=bool))
            )
        return parts[0], parts[1]

    def begin(self) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """Unknowns of the start values, and start states of all windows from the measurements."""
        unknowns = self.shooting.start_unknowns()
        guesses = [self.shooting.state_guess(unknowns, i) for i in range(len(self._columns))]
        nodes = tuple(guesses[part.record][part.starts] for part in self.windows)
        return unknowns, nodes

    def evaluate(self, unknowns: np.ndarray, nodes: tuple[np.ndarray, ...]) -> _Evaluation | None:
        """Cost and normal equations of the parameters, start states eliminated."""
        shooting, layout = self.shooting, self.shooting.layout
        n_own, n = layout.n_own, len(self._kept)
        n_full = shooting.kernel.n_full
        matrix, right = np.zeros((n, n)), np.zeros(n)
        cost, maps, scores, sums = 0.0, [], [], []
        weak = np.diag((VAGUE * shooting.state_scale[:n_own]) ** -2.0)
        for part, at in zip(self.windows, nodes, strict=True):
            record = shooting.records[part.record]
            values = shooting.values(unknowns, part.record)
            blocks = gather(
                shooting.kernel,
                record.times,
                record.inputs,
                values,
                self._nodes(unknowns, part, at),
                record.outputs,
                shooting.sigma,
                starts=part.starts,
                linked=False,
            )
            if blocks is None:
                return None
            gram = blocks.gram[part.counted]
            slopes = shooting.slopes(unknowns, part.record)
            if slopes is not None:
                scale = np.concatenate([np.ones(n_full), slopes, [1.0]])
                gram = gram * scale[:, None] * scale
            cost += 0.5 * float(gram[:, -1, -1].sum())
            outer = gram[:, :n_own, n_full:]
            if record.independent:
                solved = np.zeros_like(outer)
                wide = self._from_start(unknowns, part.record)
                reduced = wide.T @ gram @ wide
            else:
                solved = np.linalg.solve(gram[:, :n_own, :n_own] + weak, outer)
                reduced = gram[:, n_full:, n_full:] - np.swapaxes(outer, 1, 2) @ solved
            columns = self._columns[part.record]
            part_sum = np.zeros((n, n))
            part_sum[np.ix_(columns, columns)] = reduced[:, :-1, :-1].sum(axis=0)
            matrix += part_sum
            sums.append(part_sum)
            right[columns] += reduced[:, :-1, -1].sum(axis=0)
            own = np.zeros((len(gram), n))
            own[:, columns] = reduced[:, :-1, -1]
            maps.append(solved)
            scores.append(own)
        cost += shooting.prior_cost(self._without_states(unknowns))
        return _Evaluation(cost, matrix, right, tuple(maps), tuple(scores), tuple(sums))

    def _nodes(self, unknowns: np.ndarray, part: _Windows, at: np.ndarray) -> np.ndarray:
        """Start states of windows; independent tests begin from theirs, which is given."""
        if not self.shooting.records[part.record].independent:
            return at
        return self.shooting.full_start(unknowns, part.record)[0][None]

    def _from_start(self, unknowns: np.ndarray, record: int) -> np.ndarray:
        """Columns of a window that begins from its given start, by the unknown parameters."""
        _, by_unknowns = self.shooting.full_start(unknowns, record)
        by_free = by_unknowns[:, self.shooting.layout.n_own :]
        n_full, n_free = by_free.shape
        wide = np.zeros((n_full + n_free + 1, n_free + 1))
        wide[:n_full, :-1] = by_free
        wide[n_full:] = np.eye(n_free + 1)
        return wide

    def tests(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Jacobian by the parameters, and residuals, of all independent tests in units of noise.

        Returns
        -------
        rows : ndarray (n_tests, n_outputs, n_parameters)
            Zero where nothing was measured.
        scores : ndarray (n_tests, n_outputs)
            NaN where nothing was measured.
        """
        shooting, n = self.shooting, len(self._kept)
        n_outputs, n_full = len(shooting.sigma), shooting.kernel.n_full
        rows, scores = [np.zeros((0, n_outputs, n))], [np.zeros((0, n_outputs))]
        for index, record in enumerate(shooting.records):
            if not record.independent:
                continue
            values, (z0, _) = shooting.values(unknowns, index), shooting.full_start(unknowns, index)
            run = shooting.kernel.run(record.times, record.inputs, values, z0, sensitivities=True)
            assert run.output_sensitivities is not None
            found = run.output_sensitivities
            slopes = shooting.slopes(unknowns, index)
            if slopes is not None:
                found = found * np.concatenate([np.ones(n_full), slopes])
            own = np.zeros((record.n_samples, n_outputs, n))
            own[:, :, self._columns[index]] = found @ self._from_start(unknowns, index)[:-1, :-1]
            own[~np.isfinite(record.outputs)] = 0.0
            rows.append(own / shooting.sigma[:, None])
            scores.append((record.outputs - run.outputs) / shooting.sigma)
        return np.concatenate(rows), np.concatenate(scores)

    def _without_states(self, unknowns: np.ndarray) -> np.ndarray:
        """Unknowns whose start states are at their priors, which do not count here."""
        rest = self.shooting.limits.prior_mean.copy()
        rest[self._kept] = unknowns[self._kept]
        return rest

    def move(
        self,
        unknowns: np.ndarray,
        nodes: tuple[np.ndarray, ...],
        now: _Evaluation,
        step: np.ndarray,
        length: float,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
        """The point after a step of the parameters and what it implies for the start states."""
        n_own = self.shooting.layout.n_own
        limits = self.shooting.limits
        moved = unknowns.copy()
        moved[self._kept] += length * step
        moved = np.clip(moved, limits.lower, limits.upper)
        new = []
        for part, at, solved in zip(self.windows, nodes, now.maps, strict=True):
            change = solved[:, :, -1] - solved[:, :, :-1] @ step[self._columns[part.record]]
            other = at.copy()
            rows = np.flatnonzero(part.counted)
            other[np.ix_(rows, np.arange(n_own))] += length * change
            new.append(other)
        return moved, tuple(new)

    def solve(
        self,
        *,
        max_iterations: int,
        tolerance: float,
        callback: Callable[[Progress], None] | None,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...], _Evaluation | None, int, str]:
        """Gauss-Newton steps, damped where they fail; point, sums, iterations and reason."""
        unknowns, nodes = self.begin()
        now = self.evaluate(unknowns, nodes)
        if now is None:
            return unknowns, nodes, None, 0, "diverged"
        limits, kept, damping = self.shooting.limits, self._kept, 0.0
        weight, mean = limits.prior_weight[kept], limits.prior_mean[kept]
        for iteration in range(1, max_iterations + 1):
            at = unknowns[kept]
            right = now.right + weight * (mean - at)
            matrix = now.matrix + np.diag(weight)
            lower, upper = limits.lower[kept] - at, limits.upper[kept] - at
            full = bounded_step(matrix, right, lower, upper, 0.0)
            if float(full @ (right - 0.5 * (matrix @ full))) < tolerance:
                return unknowns, nodes, now, iteration, "converged"
            for _ in range(HALVINGS):
                step = bounded_step(matrix, right, lower, upper, damping)
                trial = self.move(unknowns, nodes, now, step, 1.0)
                new = self.evaluate(*trial)
                if new is not None and new.cost <= now.cost * (1 + 1e-12) + 1e-12:
                    break
                damping = max(10.0 * damping, 1e-3)
            else:
                return unknowns, nodes, now, iteration, "stalled"
            gained = now.cost - new.cost
            (unknowns, nodes), now = trial, new
            damping = damping / 10.0 if damping > 1e-6 else 0.0
            if callback is not None:
                callback(Progress(iteration, now.cost, 0.0, gained))
        return unknowns, nodes, now, max_iterations, "iterations"

    def residuals(
        self, unknowns: np.ndarray, nodes: tuple[np.ndarray, ...]
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Outputs and states of the windows, put together per record.

        Where two windows meet, the sample is that of the window which it ends.
        """
        shooting = self.shooting
        outputs = [np.full(r.outputs.shape, np.nan) for r in shooting.records]
        states = [np.full((r.n_samples, shooting.kernel.n_full), np.nan) for r in shooting.records]
        for part, at in zip(self.windows, nodes, strict=True):
            record = shooting.records[part.record]
            values = shooting.values(unknowns, part.record)
            nodes_of = self._nodes(unknowns, part, at)
            run = shooting.kernel.run(
                record.times, record.inputs, values, nodes_of, starts=part.starts
            )
            stops = [*part.starts[1:], record.n_samples]
            for start, stop, counted in zip(part.starts, stops, part.counted, strict=True):
                if not counted:
                    continue
                first = start if start == 0 else start + 1
                outputs[part.record][first:stop] = run.outputs[first:stop]
                states[part.record][first:stop] = run.states[first:stop]
        return outputs, states


def check_horizon(shooting: Shooting, horizon: float) -> None:
    """Raise :class:`DataError` where a horizon is shorter than one step of the records."""
    series = [record for record in shooting.records if not record.independent]
    longest = max((record.sample_time for record in series), default=0.0)
    if not horizon >= 0.99 * longest:
        raise DataError(
            f"horizon is {horizon:g} s, and a step of the records {longest:g} s. Give at least one "
            "step; horizon=None predicts whole records."
        )


def fit_horizons(
    shooting: Shooting,
    horizon: float,
    estimated: np.ndarray,
    *,
    estimator: str,
    max_iterations: int,
    tolerance: float,
    coloured: str,
    progress: Callable[[Progress], None] | None = None,
) -> Fit:
    """Fit short predictions.

    Parameters
    ----------
    shooting : Shooting
        The problem.
    horizon : float
        Length of a window, s.
    estimated : ndarray of bool (n_outputs,)
        Noise levels to estimate.
    estimator : str
        Name for reports.
    max_iterations, tolerance, progress
        As in :class:`~oed_sysid.likelihood.multiple_shooting.MultipleShooting`.
    coloured : str
        ``"never"`` reports the inverse information, otherwise the covariance at the head of this
        module.

    Returns
    -------
    Fit
        Its predictions and residuals are those of the windows.
    """
    began = time.perf_counter()
    check_horizon(shooting, horizon)
    problem = Horizons(shooting, horizon)
    settings = {"max_iterations": max_iterations, "tolerance": tolerance, "callback": progress}
    unknowns, nodes, now, iterations, reason = problem.solve(**settings)  # type: ignore[arg-type]
    for _ in range(NOISE_ROUNDS if estimated.any() and now is not None else 0):
        outputs, _ = problem.residuals(unknowns, nodes)
        errors = [r.outputs - o for r, o in zip(shooting.records, outputs, strict=True)]
        found = np.sqrt(np.nanmean(np.vstack(errors) ** 2, axis=0) * problem_freedom(problem))
        sigma = np.where(estimated, np.maximum(found, 1e-12), shooting.sigma)
        if np.max(np.abs(np.log(sigma / shooting.sigma))) < 1e-2:
            break
        shooting = shooting.with_sigma(sigma)
        problem = Horizons(shooting, horizon)
        unknowns, nodes, now, more, reason = problem.solve(**settings)  # type: ignore[arg-type]
        iterations += more
    model, layout = shooting.model, shooting.layout
    outputs, states = problem.residuals(unknowns, nodes)
    information, covariance, scattered = _uncertainty(problem, unknowns, nodes, now, coloured)
    initial = [states[i][0, : layout.n_own].copy() for i in range(layout.n_records)]
    local = []
    for index in range(layout.n_records):
        free = layout.parameters(unknowns, index)
        local.append({layout.free_names[i]: float(free[i]) for i in layout.local})
    return Fit(
        model=replace_values(model, shooting, unknowns),
        dataset=shooting.dataset,
        estimator=estimator,
        names=layout.shared_names,
        estimates=layout.shared_values(unknowns)[0],
        information=information,
        covariance=covariance,
        record_scatter=_between_records(problem, unknowns, now),
        coloured=coloured != "never" and problem.n_windows > 0,
        sigma=shooting.sigma.copy(),
        sigma_estimated=np.asarray(estimated, dtype=bool),
        predictions=tuple(outputs),
        residuals=tuple(r.outputs - o for r, o in zip(shooting.records, outputs, strict=True)),
        states=tuple(states),
        initial_states=tuple(initial),
        local_values=tuple(local),
        cost=np.inf if now is None else now.cost,
        status=Status(reason, _ADVICE[reason]),
        iterations=iterations,
        seconds=time.perf_counter() - began,
        horizon=horizon,
        n_windows=problem.n_windows,
        tests_scatter=scattered,
    )


def _between_records(
    problem: Horizons, unknowns: np.ndarray, now: _Evaluation | None
) -> RecordScatter | None:
    """Scatter of the shared parameters between records; None for fewer than four."""
    limits, layout = problem.shooting.limits, problem.shooting.layout
    records = problem.shooting.records
    if now is None or sum(not record.independent for record in records) < FEWEST_RECORDS:
        return None
    n_shared, n = len(layout.shared), len(problem._kept)
    slopes = layout.shared_values(unknowns)[1]
    weight = limits.prior_weight[problem._kept]
    away = weight * (limits.prior_mean - unknowns)[problem._kept]
    shared = np.arange(n_shared)
    local = np.flatnonzero(~limits.held[problem._kept])
    local = local[local >= n_shared]
    matrices, scores = [], []
    tests = np.zeros((n_shared, n_shared))
    for index in range(layout.n_records):
        matrix, right = np.zeros((n, n)), np.zeros(n)
        for part, added, own in zip(problem.windows, now.own, now.scores, strict=True):
            if part.record == index:
                matrix += added
                right += own.sum(axis=0)
        others = np.intersect1d(local, problem._columns[index])
        matrix[others, others] += weight[others]
        right[others] += away[others]
        information, score = eliminate_own(matrix, right, shared, others)
        if records[index].independent:
            tests += information / slopes[:, None] / slopes
            continue
        matrices.append(information / slopes[:, None] / slopes)
        scores.append(score / slopes)
    return record_scatter(matrices, scores, np.diag(weight[:n_shared] / slopes**2) + tests)


def problem_freedom(problem: Horizons) -> float:
    """By how much fitted start states shrink the residuals' variance; at least one sample's."""
    counted = problem.n_windows
    samples = sum(record.n_samples for record in problem.shooting.records) + counted
    measured = len(problem.shooting.sigma)
    free = samples * measured - counted * min(problem.shooting.layout.n_own, measured)
    return samples * measured / max(free, 1)


def _uncertainty(
    problem: Horizons,
    unknowns: np.ndarray,
    nodes: tuple[np.ndarray, ...],
    now: _Evaluation | None,
    coloured: str,
) -> tuple[Information, np.ndarray, bool]:
    """Information and covariance of the shared parameters, and whether tests scatter."""
    shooting, layout = problem.shooting, problem.shooting.layout
    n_shared = len(layout.shared)
    slopes = layout.shared_values(unknowns)[1]
    scales = shooting.limits.scale[:n_shared] * slopes
    if now is None:
        nothing = Information.from_matrix(
            layout.shared_names, np.zeros((n_shared, n_shared)), scales
        )
        return nothing, nothing.covariance, False
    kept = problem._kept
    held = shooting.limits.held[kept]
    matrix = now.matrix + np.diag(shooting.limits.prior_weight[kept])
    others = np.flatnonzero(~held & (np.arange(len(kept)) >= n_shared))
    gain = (
        np.linalg.pinv(matrix[np.ix_(others, others)], hermitian=True) @ matrix[others, :n_shared]
    )
    reduced = matrix[:n_shared, :n_shared] - matrix[:n_shared, others] @ gain
    information = Information.from_matrix(
        layout.shared_names, reduced / slopes[:, None] / slopes, scales
    )
    covariance = information.covariance
    if coloured == "never" or not n_shared:
        return information, covariance, False
    rows, errors = problem.tests(unknowns)
    rows = (rows[:, :, :n_shared] - rows[:, :, others] @ gain) / slopes
    scattered = bool(len(rows)) and (coloured == "always" or tests_stray(rows, errors, covariance))
    priors = np.diag(shooting.limits.prior_weight[:n_shared] / slopes**2)
    middle = priors + tests_middle(rows, errors, covariance, scattered=scattered)
    if problem.n_windows < ENOUGH * n_shared:
        series = reduced / slopes[:, None] / slopes
        series -= tests_middle(rows, errors, covariance, scattered=False)
        lost = _inflation(problem, unknowns, nodes)
        middle += lost * series - priors
    else:
        middle += _of_windows(problem, now, others, gain, slopes)
    finite = np.flatnonzero(np.isfinite(np.diag(covariance)))
    block = np.ix_(finite, finite)
    result = covariance.copy()
    result[block] = covariance[block] @ middle[block] @ covariance[block]
    return information, result, scattered


def _of_windows(
    problem: Horizons,
    now: _Evaluation,
    others: np.ndarray,
    gain: np.ndarray,
    slopes: np.ndarray,
) -> np.ndarray:
    """Covariance of the summed scores of the windows of all series in time."""
    n_shared = len(slopes)
    by_record: dict[int, list[np.ndarray]] = {}
    for part, scores in zip(problem.windows, now.scores, strict=True):
        if problem.shooting.records[part.record].independent:
            continue
        own = (scores[:, :n_shared] - scores[:, others] @ gain) / slopes
        order = part.starts[part.counted]
        by_record.setdefault(part.record, []).append(np.column_stack([order, own]))
    middle = np.zeros((n_shared, n_shared))
    for parts in by_record.values():
        rows = np.vstack(parts)
        rows = rows[np.argsort(rows[:, 0]), 1:]
        middle += rows.T @ rows
        reach = int(RELATED * len(rows)) + 1
        for lag in range(1, min(reach, len(rows) - 1) + 1):
            related = rows[lag:].T @ rows[:-lag]
            middle += (1 - lag / (reach + 1)) * (related + related.T)
    return middle


def _inflation(problem: Horizons, unknowns: np.ndarray, nodes: tuple[np.ndarray, ...]) -> float:
    """Mean square of the residuals in units of the noise, times samples per independent one."""
    shooting = problem.shooting
    outputs, _ = problem.residuals(unknowns, nodes)
    total, count = 0.0, 0
    for record, predicted in zip(shooting.records, outputs, strict=True):
        if record.independent:
            continue
        scaled = (record.outputs - predicted) / shooting.sigma
        for column in scaled.T:
            seen = column[np.isfinite(column)]
            if len(seen) > 10:
                total += float(np.mean(seen**2)) * len(seen) / effective_sample_size(column)
                count += 1
    return max(total / max(count, 1), 1.0)
