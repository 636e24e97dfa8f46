"""Multiple shooting, condensed: the engine under the estimators.

A record is cut into intervals. The state at the start of each interval is a
*node*; continuity of the trajectory is a constraint. Because nothing but the
nodes links the intervals, the linearised constraints express every node by
the record's own initial state and the parameters, and the least-squares
problem shrinks to these few unknowns (Bock 1987). The cost of one iteration
is linear in the length of the records.

Unknowns, in order: global free parameters, then for each record its initial
states and its local (``per_record``) parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.dataset import Dataset, Record
from oed_sysid.kernels import Kernel, kernel
from oed_sysid.model import Model
from oed_sysid.start_states import check_channels, cut, measured_states

Loss = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Layout:
    """Where each unknown sits in the vector of unknowns.

    Attributes
    ----------
    free_names : tuple of str
        Free parameters in kernel order.
    shared, local : ndarray of int
        Positions, among the free ones, of global and of per-record parameters.
    n_own, n_records : int
        Initial states per record; number of records.
    """

    free_names: tuple[str, ...]
    shared: np.ndarray
    local: np.ndarray
    n_own: int
    n_records: int

    @property
    def n_unknowns(self) -> int:
        """Length of the vector of unknowns."""
        return len(self.shared) + self.n_records * (self.n_own + len(self.local))

    def record_columns(self, index: int) -> np.ndarray:
        """Positions of ``[own states, free parameters]`` of one record among the unknowns."""
        width = self.n_own + len(self.local)
        begin = len(self.shared) + index * width
        columns = np.empty(self.n_own + len(self.free_names), dtype=int)
        columns[: self.n_own] = begin + np.arange(self.n_own)
        columns[self.n_own + self.shared] = np.arange(len(self.shared))
        columns[self.n_own + self.local] = begin + self.n_own + np.arange(len(self.local))
        return columns

    @property
    def names(self) -> tuple[str, ...]:
        """Name of every unknown; local ones carry the record's index."""
        names = [self.free_names[i] for i in self.shared]
        for record in range(self.n_records):
            names += [f"x0[{record}][{i}]" for i in range(self.n_own)]
            names += [f"{self.free_names[i]}[{record}]" for i in self.local]
        return tuple(names)


@dataclass(frozen=True, eq=False)
class Point:
    """One iterate: unknowns and nodes.

    Attributes
    ----------
    unknowns : ndarray (n_unknowns,)
        As laid out by :class:`Layout`.
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
    node_maps, node_offsets : tuples of ndarrays
        Change of the nodes per unknown, and when the defects are closed.
    defects : tuple of ndarray (n_segments - 1, n_full)
        Jump of the trajectory at each node.
    """

    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    offsets: tuple[np.ndarray, ...]
    node_maps: tuple[np.ndarray, ...]
    node_offsets: tuple[np.ndarray, ...]
    defects: tuple[np.ndarray, ...]


class Shooting:
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
    initial_states : sequence of mapping, optional
        Start guesses of unmeasured states, per record.
    """

    def __init__(
        self,
        model: Model,
        dataset: Dataset,
        sigma: np.ndarray,
        *,
        interval: float | None = None,
        loss: Loss | None = None,
        initial_states: Sequence[Mapping[str, float]] | None = None,
    ) -> None:
        check_channels(model, dataset)
        self.model = model
        self.dataset = dataset
        self.records: tuple[Record, ...] = tuple(dataset)
        self.kernel: Kernel = kernel(model)
        self.sigma = np.asarray(sigma, dtype=float)
        self.loss = loss
        parameters = model.free_parameters
        local = np.array([p.per_record for p in parameters], dtype=bool)
        self.layout = Layout(
            free_names=model.free_names,
            shared=np.flatnonzero(~local),
            local=np.flatnonzero(local),
            n_own=self.kernel.n_own,
            n_records=len(self.records),
        )
        names = model.parameter_names
        self._free_index = np.array([names.index(n) for n in model.free_names], dtype=int)
        self._base_values = model.value_vector
        self._starts = tuple(cut(record, interval) for record in self.records)
        self._guesses = tuple(initial_states or ({},) * len(self.records))
        self._columns = tuple(self.layout.record_columns(i) for i in range(len(self.records)))
        self._bounds_and_priors()

    def _bounds_and_priors(self) -> None:
        n = self.layout.n_unknowns
        self.lower, self.upper = np.full(n, -np.inf), np.full(n, np.inf)
        self.prior_mean, self.prior_weight = np.zeros(n), np.zeros(n)
        for columns in self._columns:
            positions = columns[self.layout.n_own :]
            for position, parameter in zip(positions, self.model.free_parameters, strict=True):
                self.lower[position], self.upper[position] = parameter.lower, parameter.upper
                if parameter.prior_std is not None:
                    self.prior_mean[position] = parameter.prior_mean
                    self.prior_weight[position] = parameter.prior_std**-2
        scales = [parameter.magnitude for parameter in self.model.free_parameters]
        self.unknown_scale = np.ones(n)
        state_scales = [state.scale for state in self.model.states]
        for columns in self._columns:
            self.unknown_scale[columns] = [*state_scales, *scales]
        extra = self.kernel.n_full - self.kernel.n_own
        self.state_scale = np.array([*state_scales, *np.ones(extra)])

    # -- points --------------------------------------------------------------------

    def values(self, unknowns: np.ndarray, record: int) -> np.ndarray:
        """Values of all parameters for one record, shape ``(n_parameters,)``."""
        values = self._base_values.copy()
        values[self._free_index] = unknowns[self._columns[record][self.layout.n_own :]]
        return values

    def initial_state(self, unknowns: np.ndarray, record: int) -> np.ndarray:
        """The model's own initial states of one record, shape ``(n_own,)``."""
        return unknowns[self._columns[record][: self.layout.n_own]]

    def start_point(self, unknowns: np.ndarray | None = None) -> Point:
        """Nodes from the measurements where a state is measured, else by simulation.

        Parameters
        ----------
        unknowns : ndarray (n_unknowns,), optional
            Start values; by default those of the model and of the data.
        """
        guess = unknowns is None
        if unknowns is None:
            unknowns = np.zeros(self.layout.n_unknowns)
        nodes = []
        unknowns = unknowns.copy()
        for index, record in enumerate(self.records):
            measured = measured_states(self.model, record)
            if guess:
                own = np.zeros(self.layout.n_own)
                for name, value in self._guesses[index].items():
                    own[self.model.state_names.index(name)] = value
                for position, series in measured.items():
                    own[position] = series[0]
                free = self._base_values[self._free_index]
                unknowns[self._columns[index]] = np.concatenate([own, free])
            nodes.append(self._start_nodes(unknowns, index, measured))
        return Point(unknowns, tuple(nodes))

    def _start_nodes(
        self, unknowns: np.ndarray, index: int, measured: Mapping[int, np.ndarray]
    ) -> np.ndarray:
        record, starts = self.records[index], self._starts[index]
        values = self.values(unknowns, index)
        z, _ = self.kernel.start(
            self.initial_state(unknowns, index), record.inputs[0], values, record.times[0]
        )
        nodes = np.empty((len(starts), self.kernel.n_full))
        for segment, first in enumerate(starts):
            if segment:
                part = slice(starts[segment - 1], first + 1)
                run = self.kernel.run(record.times[part], record.inputs[part], values, z)
                following = run.states[-1] if run.ok else z.copy()
                # A wild start value must not carry nonsense from node to node.
                tame = np.abs(following) < 1e3 * (1 + np.abs(z) + self.state_scale)
                z = np.where(tame, following, z)
                for position, series in measured.items():
                    z[position] = series[first]
            nodes[segment] = z
        return nodes[1:]

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

    def _linearise_record(self, point: Point, index: int) -> tuple[np.ndarray, ...] | None:
        record, starts = self.records[index], self._starts[index]
        values = self.values(point.unknowns, index)
        own = self.initial_state(point.unknowns, index)
        z0, dz0 = self.kernel.start(own, record.inputs[0], values, record.times[0])
        nodes = np.vstack([z0[None], point.nodes[index]])
        run = self.kernel.run(
            record.times, record.inputs, values, nodes, starts=starts, sensitivities=True
        )
        dy, dends = run.output_sensitivities, run.end_sensitivities
        if not run.ok or dy is None or dends is None or not np.isfinite(run.ends[:-1]).all():
            return None
        n_own, n_full = self.layout.n_own, self.kernel.n_full
        jacobian = np.empty((*run.outputs.shape, n_own + self.kernel.n_free))
        offset = np.zeros_like(run.outputs)
        node_map = np.empty((len(nodes), *dz0.shape))
        node_offset = np.zeros_like(nodes)
        defects = run.ends[:-1] - nodes[1:]
        stops = [*starts[1:], len(record.times)]
        node_map[0] = dz0
        for i, (first, stop) in enumerate(zip(starts, stops, strict=True)):
            by_state, by_free = dy[first:stop, :, :n_full], dy[first:stop, :, n_full:]
            jacobian[first:stop] = by_state @ node_map[i]
            jacobian[first:stop, :, n_own:] += by_free
            if i:
                offset[first:stop] = by_state @ node_offset[i]
            if i + 1 < len(nodes):
                node_map[i + 1] = dends[i, :, :n_full] @ node_map[i]
                node_map[i + 1, :, n_own:] += dends[i, :, n_full:]
                node_offset[i + 1] = dends[i, :, :n_full] @ node_offset[i] + defects[i]
        residual = record.outputs - run.outputs
        return residual, jacobian, offset, node_map[1:], node_offset[1:], defects

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
            scaled, weights = self._scaled(lin.residuals[index])
            root = np.sqrt(weights) / self.sigma
            target = np.where(weights > 0, scaled - lin.offsets[index] / self.sigma, 0.0)
            target *= np.sqrt(weights)
            jacobian = lin.jacobians[index] * root[:, :, None]
            flat = jacobian.reshape(-1, jacobian.shape[2])
            matrix[np.ix_(columns, columns)] += flat.T @ flat
            right[columns] += flat.T @ target.ravel()
        return matrix, right

    def _scaled(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals in units of noise (0 where missing) and their weights."""
        present = np.isfinite(residual)
        scaled = np.where(present, residual, 0.0) / self.sigma
        weights = present.astype(float)
        if self.loss is not None:
            weights *= self.loss(scaled)[1]
        return scaled, weights

    def cost(self, lin: Linearisation, unknowns: np.ndarray) -> float:
        """Half the (robust) sum of squares of residuals and priors; defects excluded."""
        total = 0.5 * float(self.prior_weight @ (unknowns - self.prior_mean) ** 2)
        for residual in lin.residuals:
            scaled, _ = self._scaled(residual)
            total += 0.5 * float(
                np.sum(self.loss(scaled)[0]) if self.loss is not None else np.sum(scaled**2)
            )
        return total

    def predicted_cost(self, lin: Linearisation, unknowns: np.ndarray, step: np.ndarray) -> float:
        """Cost of the linearised problem after a full step, defects closed."""
        total = 0.5 * float(self.prior_weight @ (unknowns + step - self.prior_mean) ** 2)
        for index, columns in enumerate(self._columns):
            change = lin.offsets[index] + lin.jacobians[index] @ step[columns]
            scaled, _ = self._scaled(lin.residuals[index] - change)
            total += 0.5 * float(
                np.sum(self.loss(scaled)[0]) if self.loss is not None else np.sum(scaled**2)
            )
        return total

    def defect(self, lin: Linearisation) -> float:
        """Sum of the scaled jumps at all nodes."""
        return float(sum(np.abs(d / self.state_scale).sum() for d in lin.defects))

    def move(self, point: Point, lin: Linearisation, step: np.ndarray, length: float) -> Point:
        """Return the point after a step of the unknowns and the step this implies for nodes."""
        nodes = []
        for index, columns in enumerate(self._columns):
            change = lin.node_maps[index] @ step[columns] + lin.node_offsets[index]
            nodes.append(point.nodes[index] + length * change)
        unknowns = np.clip(point.unknowns + length * step, self.lower, self.upper)
        return Point(unknowns, tuple(nodes))

    def continuous(self, unknowns: np.ndarray) -> Point:
        """Return the point whose nodes lie on the simulated trajectory."""
        nodes = []
        for index, record in enumerate(self.records):
            values = self.values(unknowns, index)
            own = self.initial_state(unknowns, index)
            z0, _ = self.kernel.start(own, record.inputs[0], values, record.times[0])
            run = self.kernel.run(record.times, record.inputs, values, z0)
            nodes.append(run.states[self._starts[index][1:]])
        return Point(unknowns, tuple(nodes))

    def with_intervals(self, n_samples: int) -> Shooting:
        """Return the same problem cut into intervals of ``n_samples`` samples."""
        other = object.__new__(Shooting)
        other.__dict__.update(self.__dict__)
        other._starts = tuple(
            np.arange(0, len(record.times), n_samples, dtype=np.intc) for record in self.records
        )
        return other

    def with_loss(self, loss: Loss | None) -> Shooting:
        """Return the same problem with another loss."""
        other = object.__new__(Shooting)
        other.__dict__.update(self.__dict__)
        other.loss = loss
        return other

    def with_sigma(self, sigma: np.ndarray) -> Shooting:
        """Return the same problem with other noise levels."""
        other = object.__new__(Shooting)
        other.__dict__.update(self.__dict__)
        other.sigma = np.asarray(sigma, dtype=float)
        return other


def replace_values(model: Model, shooting: Shooting, unknowns: np.ndarray) -> Model:
    """Return the model at the estimated values; local parameters take their mean."""
    layout = shooting.layout
    values: dict[str, list[float]] = {name: [] for name in layout.free_names}
    for columns in (layout.record_columns(i) for i in range(layout.n_records)):
        for name, value in zip(layout.free_names, unknowns[columns[layout.n_own :]], strict=True):
            values[name].append(float(value))
    return model.with_values({name: float(np.mean(v)) for name, v in values.items()})
