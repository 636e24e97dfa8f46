"""Robust losses: how much a residual counts once it is larger than noise can be.

Multiple shooting, condensed: the engine under the estimators.

A record is cut into intervals. The state at the start of each interval is a
*node*; continuity of the trajectory is a constraint. Because nothing but the
nodes links the intervals, the linearised constraints express every node by
the record's own initial state and the parameters, and the least-squares
problem shrinks to these few unknowns (Bock 1987). The cost of one iteration
is linear in the length of the records.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from oed_sysid.compiled.kernels import Kernel, Run, kernel, summable
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError
from oed_sysid.likelihood import start_guess
from oed_sysid.likelihood.estimate import Estimate
from oed_sysid.likelihood.unknowns import KnownStarts, Posed, node_maps
from oed_sysid.physics.model import Model


def huber(residuals: np.ndarray, *, threshold: float = 1.345) -> tuple[np.ndarray, np.ndarray]:
    """Huber's loss: square up to a threshold, linear beyond (Huber 1964).

    At 1.345 it keeps 95 % efficiency on Gaussian noise.

    Parameters
    ----------
    residuals : ndarray
        In units of the noise.
    threshold : float
        Where the loss turns linear, in units of the noise.

    Returns
    -------
    loss, weights : ndarray
        ``loss`` equals the square inside; ``weights`` are those of iteratively
        reweighted least squares.
    """
    size = np.abs(residuals)
    inner = np.fmin(size, threshold)
    return inner * (2 * size - inner), threshold / np.fmax(size, threshold)


def student(residuals: np.ndarray, *, freedom: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    """Negative log-likelihood of Student's t distribution; forgets gross outliers.

    Parameters
    ----------
    residuals : ndarray
        In units of the noise.
    freedom : float
        Degrees of freedom.
    """
    ratio = residuals**2 / freedom
    return (freedom + 1) * np.log1p(ratio), (1 + 1 / freedom) / (1 + ratio)


# Spikes that "auto" leaves out count nothing; the others are squared.
_LOSSES: dict[str, Loss | None] = {
    "auto": None,
    "square": None,
    "huber": huber,
    "student": student,
}


def loss_by_name(name: str) -> Loss | None:
    """Return a loss by name; None is the plain square."""
    if name not in _LOSSES:
        raise ModelError(f"Loss {name!r} is not known. Choose one of {', '.join(_LOSSES)}.")
    return _LOSSES[name]


Loss = Callable[..., tuple[np.ndarray, np.ndarray]]
# How nodes follow a step of the unknowns, and what closes their defects, per record.
Follows = tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Point:
    """One iterate: unknowns and nodes.

    Attributes
    ----------
    unknowns : ndarray (n_unknowns,)
        As laid out by :class:`~oed_sysid.likelihood.unknowns.Layout`.
    nodes : tuple of ndarray (n_segments - 1, n_full)
        State at the start of every interval but the first, per record.
    """

    unknowns: np.ndarray
    nodes: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Residuals, defects and their derivatives at one point.

    Attributes
    ----------
    residuals : tuple of ndarray (n_times, n_outputs)
        Measured minus model, per record; NaN where nothing was measured.
    jacobians : tuple of ndarray (n_times, n_outputs, n_own + n_free)
        Derivative of the outputs with continuity already imposed.
    offsets : tuple of ndarray (n_times, n_outputs)
        First-order change of the outputs when the defects are closed.
    follows : tuple of pair of ndarray
        Change of the nodes per unknown, and when the defects are closed.
    defects : tuple of ndarray (n_segments - 1, n_full)
        Jump of the trajectory at each node.
    """

    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    offsets: tuple[np.ndarray, ...]
    follows: Follows
    defects: tuple[np.ndarray, ...]


class Shooting(Posed):
    """Least squares over multiple-shooting trajectories of one model and data set.

    Parameters
    ----------
    model : Model
        Its values are the start values.
    dataset : Dataset
        Measured records, with the model's channels.
    sigma : ndarray (n_outputs,)
        Standard deviation of the noise of each output.
    interval : float or None
        Length of a shooting interval, s; ``None`` cuts each record into about
        thirty, infinity into one (single shooting).
    loss : callable or None
        Robust loss ``scaled residuals -> (loss, weights)``; ``None`` is the square.
    initial_states : KnownStarts, optional
        Start guesses of states; by default from the measurements.
    known_starts : KnownStarts, optional
        Start states that are held or known with a stated error; by default all are free.
    runner : Kernel, optional
        What runs the model; by default its own kernel.
    """

    def __init__(
        self,
        model: Model,
        dataset: Dataset,
        sigma: np.ndarray,
        *,
        runner: Kernel | None = None,
        interval: float | None = None,
        loss: Loss | None = None,
        initial_states: KnownStarts | None = None,
        known_starts: KnownStarts | None = None,
    ) -> None:
        start_guess.check_channels(model, dataset)
        super().__init__(model, dataset, model, known_starts)
        self.kernel: Kernel = runner or kernel(model)
        self.sigma = np.asarray(sigma, dtype=float)
        self.loss = loss
        self.starts = tuple(start_guess.cut(record, interval) for record in self.records)
        self._told = [one for one in (initial_states, known_starts) if one is not None]
        # States of effects and memories of actuators start in equilibrium and have no unknowns.
        extra = self.kernel.n_full - self.kernel.n_own
        self.state_scale = np.array([*(state.scale for state in model.states), *np.ones(extra)])
        self._guess_states()

    def _guess_states(self) -> None:
        """Series of states from measurements, and how far to trust them."""
        series, stds = [], np.full((len(self.records), self.kernel.n_full), np.nan)
        columns = start_guess.measured_columns(self.model)
        for index, record in enumerate(self.records):
            measured = start_guess.measured_states(self.model, record)
            stds[index, list(measured)] = [self.sigma[columns[state]] for state in measured]
            for state, guess in start_guess.kinematic_states(self.model, record, measured).items():
                stds[index, state], measured[state] = guess.std, guess.series
            series.append(measured)
        self._series = tuple(series)
        # Standard deviation of the guesses ``(n_records, n_full)``, NaN where simulated.
        self.guess_std = stds

    # -- points --------------------------------------------------------------------

    def white(self, unknowns: np.ndarray) -> np.ndarray:
        """Levels of the white noise of the sensors, ``(n_outputs,)``."""
        return self.sigma

    def full_start(self, unknowns: np.ndarray, record: int) -> tuple[np.ndarray, np.ndarray]:
        """Full state at a record's first sample, and its derivatives by the unknowns."""
        data = self.records[record]
        # By the chain rule: what remembers starts where the own states and the parameters put it.
        own, values = self.initial_state(unknowns, record), self.values(unknowns, record)
        z0, dz0 = self.kernel.start(own, data.inputs[0], values, data.times[0])
        if not self.layout.is_plain:
            dz0[:, self.layout.n_own :] *= self.slopes(unknowns, record)
        return z0, dz0

    def slopes(self, unknowns: np.ndarray, record: int) -> np.ndarray:
        """Derivatives of a record's parameters by their unknowns, ``(n_free,)``."""
        return self.layout.slopes(unknowns[self._columns[record][self.layout.n_own :]])

    def run(
        self,
        unknowns: np.ndarray,
        record: int,
        nodes: np.ndarray | None = None,
        *,
        sensitivities: bool = False,
    ) -> Run:
        """Simulate a record, whole or from the nodes of its intervals."""
        data, (z0, _) = self.records[record], self.full_start(unknowns, record)
        return self.kernel.run(
            data.times,
            data.inputs,
            self.values(unknowns, record),
            z0 if nodes is None else np.vstack([z0[None], nodes]),
            starts=None if nodes is None else self.starts[record],
            sensitivities=sensitivities,
        )

    def no_paths(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Outputs and full states per record, each NaN: of what has not been run."""
        counts = len(self.sigma), self.kernel.n_full
        rows = [record.n_samples for record in self.records]
        return [(np.full((n, counts[0]), np.nan), np.full((n, counts[1]), np.nan)) for n in rows]

    def start_unknowns(self) -> np.ndarray:
        """Start values: parameters of the model, initial states from the data."""
        unknowns = np.zeros(self.layout.n_unknowns)
        for index, columns in enumerate(self._columns):
            own = np.zeros(self.layout.n_own)
            for position, series in self._series[index].items():
                own[position] = series[0]
            for one in self._told:
                known = np.isfinite(one.std[index])
                own[known] = one.mean[index][known]
            unknowns[columns] = [*own, *self.layout.inward(self._base[self._free])]
        return unknowns

    def state_guess(self, unknowns: np.ndarray, record: int) -> np.ndarray:
        """Guess of the full state at every sample, ``(n_times, n_full)``.

        Measured states follow their measurement; the others are simulated from them, in short
        pieces, so that wild parameters cannot carry them far.
        """
        values, (z0, _) = self.values(unknowns, record), self.full_start(unknowns, record)
        measured, data = self._series[record], self.records[record]
        n = len(data.times)
        series = np.empty((n, len(z0)))
        if len(measured) < len(z0):
            starts = start_guess.cut(data, None)
            z = z0
            for first, stop in zip(starts, [*starts[1:], n - 1], strict=True):
                part = slice(first, stop + 1)
                run = self.kernel.run(data.times[part], data.inputs[part], values, z)
                # A wild start value must not carry nonsense from piece to piece.
                tame = np.abs(run.states) < 1e3 * (1 + np.abs(z) + self.state_scale)
                series[part] = np.where(tame, run.states, z)
                z = series[stop].copy()
                for state, column in measured.items():
                    z[state] = column[stop]
        for state, column in measured.items():
            series[1:, state] = column[1:]
        series[0] = z0
        return series

    def start_point(self, unknowns: np.ndarray | None = None) -> Point:
        """Nodes from the measurements where a state is measured, else by simulation.

        Parameters
        ----------
        unknowns : ndarray (n_unknowns,), optional
            Start values; by default :meth:`start_unknowns`.
        """
        if unknowns is None:
            unknowns = self.start_unknowns()
        nodes = tuple(
            self.state_guess(unknowns, index)[starts[1:]]
            for index, starts in enumerate(self.starts)
        )
        return Point(unknowns.copy(), nodes)

    def continuous(self, unknowns: np.ndarray) -> Point:
        """Return the point whose nodes lie on the simulated trajectory."""
        # Defects vanish: multiple shooting at such a point is single shooting.
        runs = (self.run(unknowns, index).states for index in range(len(self.records)))
        cuts = zip(runs, self.starts, strict=True)
        return Point(unknowns, tuple(states[starts[1:]] for states, starts in cuts))

    def move(self, point: Point, follows: Follows, step: np.ndarray, length: float) -> Point:
        """Return the point after a step of the unknowns and the step this implies for nodes.

        ``follows`` is that of a :class:`Linearisation`.
        """
        nodes = []
        for columns, own, (map_, offset) in zip(self._columns, point.nodes, follows, strict=True):
            # The step of the unknowns moves the nodes with it; the offset closes their defects.
            nodes.append(own + length * (map_ @ step[columns] + offset))
        unknowns = point.unknowns + length * step
        return Point(np.clip(unknowns, self.limits.lower, self.limits.upper), tuple(nodes))

    # -- evaluation ----------------------------------------------------------------

    def linearise(self, point: Point) -> Linearisation | None:
        """Residuals and condensed derivatives, or None where a trajectory diverges."""
        parts = []
        for index in range(len(self.records)):
            part = self._linearise_record(point, index)
            if part is None:
                return None
            parts.append(part)
        return Linearisation(*(tuple(column) for column in zip(*parts, strict=True)))

    def _linearise_record(self, point: Point, index: int) -> tuple[Any, ...] | None:
        """A record's outputs by its unknowns alone; None where this overflows."""
        record, starts = self.records[index], self.starts[index]
        run = self.run(point.unknowns, index, point.nodes[index], sensitivities=True)
        if not run.ok or not np.isfinite(run.ends[:-1]).all():
            return None
        dy = run.output_sensitivities
        n_full, defects = self.kernel.n_full, run.ends[:-1] - point.nodes[index]
        _, dz0 = self.full_start(point.unknowns, index)
        with np.errstate(over="ignore", invalid="ignore"):
            slopes = self.slopes(point.unknowns, index)
            maps = node_maps(run.end_sensitivities, defects, dz0, self.layout.n_own, slopes)
            condensed = np.empty((*run.outputs.shape, maps.shape[2]))
            flat = condensed.reshape(-1, maps.shape[2])
            rows = dy.reshape(-1, dy.shape[2])
            # One product for each interval: its sensitivities by the state at its node, times what
            # that node is by the unknowns.
            edges = np.append(starts, len(record.times)) * dy.shape[1]
            for i, (first, stop) in enumerate(pairwise(edges)):
                np.matmul(rows[first:stop], maps[i], out=flat[first:stop])
            squares = np.einsum("tij,tij,i->j", condensed, condensed, self.sigma**-2.0)
        if not summable(squares):
            return None
        return (
            record.outputs - run.outputs,
            condensed[:, :, :-1],
            condensed[:, :, -1],
            (maps[1:, :n_full, :-1], maps[1:, :n_full, -1]),
            defects,
        )

    def normal_equations(self, lin: Linearisation) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and right-hand side, priors excluded.

        Returns
        -------
        matrix : ndarray (n_unknowns, n_unknowns)
        right : ndarray (n_unknowns,)
        """
        n = self.layout.n_unknowns
        matrix, right = np.zeros((n, n)), np.zeros(n)
        for index, columns in enumerate(self._columns):
            # Residuals once the defects are closed, to first order, and weights of a robust loss
            # there, as of iteratively reweighted least squares.
            closed = lin.residuals[index] - lin.offsets[index]
            scaled, weights = self.scaled(closed), np.isfinite(closed).astype(float)
            if self.loss is not None:
                weights *= self.loss(scaled)[1]
            root = np.sqrt(weights)
            target = root * scaled
            jacobian = lin.jacobians[index] * (root / self.sigma)[:, :, None]
            flat = jacobian.reshape(-1, jacobian.shape[2])
            matrix[np.ix_(columns, columns)] += flat.T @ flat
            right[columns] += flat.T @ target.ravel()
        return matrix, right

    def scaled(self, residual: np.ndarray) -> np.ndarray:
        """Residuals in units of noise, 0 where missing."""
        return np.where(np.isfinite(residual), residual, 0.0) / self.sigma

    def _misfit(self, residual: np.ndarray) -> float:
        """Half the (robust) sum of squares of one record's residuals."""
        scaled = self.scaled(residual)
        if self.loss is not None:
            return 0.5 * float(np.sum(self.loss(scaled)[0]))
        return 0.5 * float(np.vdot(scaled, scaled))

    def cost(self, lin: Linearisation, unknowns: np.ndarray) -> float:
        """Half the (robust) sum of squares of residuals and priors; defects excluded."""
        return self.limits.prior_cost(unknowns) + sum(map(self._misfit, lin.residuals))

    def closed_cost(self, lin: Linearisation) -> float:
        """Half the (robust) sum of squares once the defects are closed, to first order."""
        pairs = zip(lin.residuals, lin.offsets, strict=True)
        return sum(self._misfit(residual - offset) for residual, offset in pairs)

    def defect(self, lin: Linearisation) -> float:
        """Sum of the scaled jumps at all nodes."""
        return float(sum(np.abs(d / self.state_scale).sum() for d in lin.defects))

    # -- the same problem, slightly changed ------------------------------------------

    def part(self, indices: Sequence[int], unknowns: np.ndarray) -> tuple[Shooting, np.ndarray]:
        """The problem of some of the records alone, and its unknowns."""
        known = self.known_starts
        chosen = list(indices)
        alone = Shooting(
            self.model,
            Dataset(tuple(self.records[i] for i in chosen)),
            self.sigma,
            known_starts=known and KnownStarts(known.mean[chosen], known.std[chosen]),
            runner=self.kernel,
        )
        own = np.empty(alone.layout.n_unknowns)
        for columns, index in zip(alone._columns, chosen, strict=True):
            own[columns] = unknowns[self._columns[index]]
        return alone, own

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns without start states of independent tests, which have none."""
        tests = sum(record.independent for record in self.records)
        return self.layout.n_unknowns - tests * self.layout.n_own

    # -- where it begins -------------------------------------------------------------

    def check_enough_samples(self) -> None:
        """Raise :class:`DataError` where there are fewer samples than unknowns."""
        layout = self.layout
        n_samples = sum(int(np.isfinite(record.outputs).sum()) for record in self.records)
        n_priors = int(np.count_nonzero(self.limits.prior_weight))
        held = min(int(self.limits.held.sum()), layout.n_records * layout.n_own)
        if n_samples + n_priors < layout.n_unknowns - held:
            raise DataError(
                f"{n_samples} measured samples and {n_priors} priors cannot determine "
                f"{layout.n_unknowns} unknowns ({len(layout.shared)} parameters and, for each of "
                f"{layout.n_records} records, {layout.n_own} initial states and "
                f"{len(layout.local)} parameters of its own). Add records, fix parameters, or give "
                "them a prior_std."
            )

    def warm_unknowns(self, warm: Estimate) -> np.ndarray:
        """Start values with the initial states and local parameters of an earlier fit.

        Of its records those count that are here too and begin at the same time.
        """
        unknowns = self.start_unknowns()
        local_names = [self.layout.free_names[i] for i in self.layout.local]
        earlier = {(record.name, record.times[0]): i for i, record in enumerate(warm.dataset)}
        for index, record in enumerate(self.records):
            i = earlier.get((record.name, record.times[0]))
            if i is not None:
                states = dict(zip(warm.model.state_names, warm.initial_states[i], strict=True))
                own = np.array([states.get(name, np.nan) for name in self.model.state_names])
                local = {n: v for n, v in warm.local_values[i].items() if n in local_names}
                self.fill(unknowns, index, own, local)
        return np.clip(unknowns, self.limits.lower, self.limits.upper)

    def warm_point(self, warm: Estimate | None) -> Point:
        """Start on the trajectory of an earlier fit; on the measurements where it diverges."""
        if warm is None:
            return self.start_point()
        unknowns = self.warm_unknowns(warm)
        point = self.continuous(unknowns)
        finite = all(np.isfinite(nodes).all() for nodes in point.nodes)
        return point if finite else self.start_point(unknowns)

    def misfit(self, point: Point) -> float:
        """Mean square residual in units of noise; infinite where the model diverges."""
        squares, count = 2.0 * self.limits.prior_cost(point.unknowns), 0
        for index, record in enumerate(self.records):
            run = self.run(point.unknowns, index, point.nodes[index])
            present = np.isfinite(record.outputs)
            scaled = ((record.outputs - run.outputs) / self.sigma)[present]
            if not run.ok or not np.isfinite(scaled).all():
                return np.inf
            squares += float(scaled @ scaled)
            count += len(scaled)
        return squares / max(count, 1)
