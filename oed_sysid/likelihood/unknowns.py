r"""Where each unknown of an estimation sits, between which bounds, with which prior.

Unknowns, in order: shared free parameters, then for each record its initial
states and its own (``per_record``) parameters, then levels of the noise, where
these are estimated together with the rest.

A parameter that is declared ``log`` is unknown as its logarithm,

.. math:: p = e^{\vartheta}, \qquad
          \frac{\partial y}{\partial\vartheta} = p\, \frac{\partial y}{\partial p}, \qquad
          C_p = D\, C_\vartheta\, D, \quad D = \mathrm{diag}(p)

so that priors, bounds and steps are relative; :meth:`Layout.natural` and
:meth:`Layout.slopes` are this change of variables. A start state is free, held, or
known with a stated error, that is with a normal prior (:class:`KnownStarts`).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.errors import DataError
from oed_sysid.physics.model import Model

# Of one record: a number is held, a pair is a value and its standard deviation.
StartState = Mapping[str, float | tuple[float, float]]


@dataclass(frozen=True)
class Layout:
    """Where each unknown sits in the vector of unknowns.

    Attributes
    ----------
    free_names : tuple of str
        Free parameters in kernel order.
    shared, local : ndarray of int
        Positions, among the free ones, of shared and of per-record parameters.
    n_own, n_records : int
        Initial states per record; number of records.
    n_levels : int
        Levels and times of the noise.
    logged : ndarray of bool (n_free,)
        Free parameters that are unknown as their logarithms.
    """

    free_names: tuple[str, ...]
    shared: np.ndarray
    local: np.ndarray
    logged: np.ndarray
    n_own: int
    n_records: int
    n_levels: int = 0

    @classmethod
    def of(cls, model: Model, n_records: int, n_levels: int = 0) -> Layout:
        """Layout of a model's unknowns over some records."""
        local = np.array([p.per_record for p in model.free_parameters], dtype=bool)
        return cls(
            free_names=model.free_names,
            shared=np.flatnonzero(~local),
            local=np.flatnonzero(local),
            n_own=len(model.states),
            n_records=n_records,
            n_levels=n_levels,
            logged=np.array([p.log for p in model.free_parameters], dtype=bool),
        )

    @property
    def n_unknowns(self) -> int:
        """Length of the vector of unknowns."""
        own = self.n_records * (self.n_own + len(self.local))
        return len(self.shared) + own + self.n_levels

    @property
    def levels(self) -> slice:
        """Positions of the levels of the noise."""
        return slice(self.n_unknowns - self.n_levels, self.n_unknowns)

    def record_columns(self, index: int) -> np.ndarray:
        """Positions of ``[own states, free parameters]`` of one record among the unknowns."""
        width = self.n_own + len(self.local)
        # Shared parameters stand first, so that each record is one block behind them.
        begin = len(self.shared) + index * width
        columns = np.empty(self.n_own + len(self.free_names), dtype=int)
        columns[: self.n_own] = begin + np.arange(self.n_own)
        columns[self.n_own + self.shared] = np.arange(len(self.shared))
        columns[self.n_own + self.local] = begin + self.n_own + np.arange(len(self.local))
        return columns

    @property
    def own(self) -> np.ndarray:
        """Positions of own states and per-record parameters among those of one record."""
        return np.concatenate([np.arange(self.n_own), self.n_own + self.local])

    @cached_property
    def is_plain(self) -> bool:
        """Whether no parameter is unknown as its logarithm."""
        return not self.logged.any()

    def natural(self, free: np.ndarray) -> np.ndarray:
        """Values of the free parameters ``(n_free,)`` from their unknowns."""
        if self.is_plain:  # asked for at every evaluation
            return free
        with np.errstate(over="ignore"):  # told by a trajectory that is not finite
            return np.where(self.logged, np.exp(np.where(self.logged, free, 0.0)), free)

    def inward(self, values: np.ndarray) -> np.ndarray:
        """Unknowns ``(n_free,)`` that stand for values of the free parameters."""
        with np.errstate(divide="ignore"):  # a lower bound of zero is none
            return np.where(self.logged, np.log(np.where(self.logged, values, 1.0)), values)

    def slopes(self, free: np.ndarray) -> np.ndarray:
        """Derivatives ``(n_free,)`` of the values of free parameters by their unknowns."""
        return np.ones(len(free)) if self.is_plain else np.where(self.logged, self.natural(free), 1)

    def record_slopes(self, unknowns: np.ndarray, record: int) -> np.ndarray:
        """Derivatives of own states and free parameters of a record by their unknowns."""
        free = unknowns[self.record_columns(record)[self.n_own :]]
        return np.concatenate([np.ones(self.n_own), self.slopes(free)])

    def parameters(self, unknowns: np.ndarray, record: int) -> np.ndarray:
        """Values of the free parameters in one record, shape ``(n_free,)``."""
        return self.natural(unknowns[self.record_columns(record)[self.n_own :]])

    def shared_values(self, unknowns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values of the shared parameters and their slopes, each ``(n_shared,)``."""
        free = unknowns[self.record_columns(0)[self.n_own :]]
        return self.natural(free)[self.shared].copy(), self.slopes(free)[self.shared]

    def local_values(self, unknowns: np.ndarray) -> list[dict[str, float]]:
        """Values of per-record parameters by name, a dictionary per record."""
        each = (self.parameters(unknowns, index) for index in range(self.n_records))
        return [{self.free_names[i]: float(own[i]) for i in self.local} for own in each]

    def means(self, model: Model, unknowns: np.ndarray) -> dict[str, float]:
        """Values of the free parameters, within bounds; those of each record at their mean."""
        # Shared ones are equal in all records, so that their mean is their value.
        free = np.array([self.parameters(unknowns, i) for i in range(self.n_records)])
        lower = [p.lower for p in model.free_parameters]
        upper = [p.upper for p in model.free_parameters]
        means = np.clip(free.mean(axis=0), lower, upper)
        return dict(zip(self.free_names, map(float, means), strict=True))

    @property
    def shared_names(self) -> tuple[str, ...]:
        """Names of the shared free parameters."""
        return tuple(self.free_names[i] for i in self.shared)


def on_its_turn(model: Model, record: Record, state: str, value: float) -> float:
    """Start value of a state, moved by full turns to the record's where a wrapped output sees it.

    A compass that begins at 358 degrees and a log that was made continuous from -2 degrees speak
    of the same heading.
    """
    for output in model.outputs:
        if output.wrap and output.source == state and output.name in record.channels.output_names:
            return record.on_its_turn(output.name, value)
    return value


@dataclass(frozen=True, eq=False)
class KnownStarts:
    """What is known of the start states before the data.

    Attributes
    ----------
    mean : ndarray (n_records, n_own)
    std : ndarray (n_records, n_own)
        Zero where the state is held, infinite where nothing is known.
    """

    mean: np.ndarray
    std: np.ndarray

    @classmethod
    def of(
        cls,
        model: Model,
        dataset: Dataset,
        stated: StartState | Sequence[StartState] | None,
        what: str = "start_states",
    ) -> KnownStarts | None:
        """Read ``what`` a user states: one mapping for all records, or one for each.

        Raises
        ------
        DataError
            If a state is unknown, or a value or its error is no number.
        """
        if stated is None:
            return None
        each = [stated] * len(dataset) if isinstance(stated, Mapping) else list(stated)
        if len(each) != len(dataset):
            raise DataError(
                f"{what} gives {len(each)} mappings for {len(dataset)} records. Give one mapping "
                "for all records, or one for each; an empty one leaves it to the data."
            )
        shape = (len(dataset), len(model.states))
        mean, std = np.zeros(shape), np.full(shape, np.inf)
        for index, (record, states) in enumerate(zip(dataset, each, strict=True)):
            for name, entry in states.items():
                where = f"{what} of record {record.name!r}"
                if name not in model.state_names:
                    raise DataError(
                        f"{where} names {name!r}, which is no state of {model.name!r}: "
                        f"{', '.join(model.state_names)}."
                    )
                value, error = _number(entry, f"{where} gives {entry!r} for {name!r}")
                value = on_its_turn(model, record, name, value)
                position = model.state_names.index(name)
                mean[index, position], std[index, position] = value, error
        return cls(mean, std)

    def described(self, model: Model) -> tuple[dict[str, tuple[float, float]], ...]:
        """Value and error of every state that is not free, per record."""
        return tuple(
            {
                name: (float(value), float(error))
                for name, value, error in zip(model.state_names, means, stds, strict=True)
                if np.isfinite(error)
            }
            for means, stds in zip(self.mean, self.std, strict=True)
        )


def _number(entry: object, where: str) -> tuple[float, float]:
    """A value and its standard deviation, zero where none is given."""
    pair = entry if isinstance(entry, tuple | list) else (entry, 0.0)
    value, error = map(float, pair) if len(pair) == 2 else (np.nan, np.nan)
    if not (np.isfinite(value) and error >= 0.0):
        raise DataError(
            f"{where}. Give a number or a pair (value, standard deviation); leave the state out if "
            "nothing is known."
        )
    return value, error


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds, priors and scales of all unknowns, each of shape ``(n_unknowns,)``.

    Attributes
    ----------
    lower, upper : ndarray
        Bounds; an unknown whose bounds coincide is held.
    prior_mean, prior_weight : ndarray
        Normal priors; the weight is the inverse variance, zero where nothing
        is known.
    scale : ndarray
        Typical magnitudes.
    """

    lower: np.ndarray
    upper: np.ndarray
    prior_mean: np.ndarray
    prior_weight: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, model: Model, layout: Layout, starts: KnownStarts | None = None) -> Limits:
        """Limits that a model's parameters declare, and what is known of start states."""
        n = layout.n_unknowns
        lower, upper, scale = np.full(n, -np.inf), np.full(n, np.inf), np.ones(n)
        mean, weight = np.zeros(n), np.zeros(n)
        parameters = model.free_parameters
        # NaN where a parameter has no prior.
        rows = [
            (p.lower, p.upper, p.prior_mean, p.prior_std, 1.0 if p.log else p.magnitude)
            for p in parameters
        ]
        table = np.array(rows, dtype=float).reshape(-1, 5).T
        *bounds, means = layout.inward(table[:3])
        stds, known = table[3], np.isfinite(table[3])
        scales = [*(s.scale for s in model.states), *table[4]]
        for index in range(layout.n_records):
            columns = layout.record_columns(index)
            # Shared parameters are written once for every record, each time the same.
            own, free = columns[: layout.n_own], columns[layout.n_own :]
            scale[columns] = scales
            lower[free], upper[free] = bounds
            mean[free[known]], weight[free[known]] = means[known], stds[known] ** -2.0
            if starts is None:
                continue
            value, std = starts.mean[index], starts.std[index]
            exact, stated = std == 0.0, np.isfinite(std) & (std > 0)
            # Held by equal bounds: the unknown stays in its place, and one layout serves all
            # cases.
            lower[own[exact]] = upper[own[exact]] = value[exact]
            mean[own[stated]], weight[own[stated]] = value[stated], std[stated] ** -2.0
        return cls(lower, upper, mean, weight, scale)

    @property
    def held(self) -> np.ndarray:
        """Whether an unknown may not move, ``(n_unknowns,)``."""
        return self.lower == self.upper

    def prior_cost(self, unknowns: np.ndarray) -> float:
        """Half the weighted sum of squares of the departures from the priors."""
        return 0.5 * float(self.prior_weight @ (unknowns - self.prior_mean) ** 2)

    def with_priors(
        self, matrix: np.ndarray, right: np.ndarray, unknowns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and right-hand side with what the priors add to them."""
        # The prior is a sum of squares, so that its Gauss-Newton terms are exact.
        away = self.prior_weight * (self.prior_mean - unknowns)
        return matrix + np.diag(self.prior_weight), right + away


class Posed:
    """Records, the unknowns of a model over them, and what is known of these before.

    Parameters
    ----------
    model : Model
        Free parameters are unknown; its values are the start values.
    dataset : Dataset
    wide : Model
        The model that is run: itself, or one that holds it.
    known_starts : KnownStarts, optional
        Start states that are held or known with a stated error; by default all are free.
    n_levels : int
        Levels and times of the noise that are unknown.
    """

    def __init__(
        self,
        model: Model,
        dataset: Dataset,
        wide: Model,
        known_starts: KnownStarts | None,
        n_levels: int = 0,
    ) -> None:
        self.model, self.dataset, self.known_starts = model, dataset, known_starts
        self.records: tuple[Record, ...] = tuple(dataset)
        self.layout = Layout.of(model, len(self.records), n_levels)
        self.limits = Limits.of(model, self.layout, known_starts)
        positions = {name: i for i, name in enumerate(wide.parameter_names)}
        self._base = wide.value_vector
        for name, value in model.values.items():
            self._base[positions[name]] = value
        self._free = np.array([positions[name] for name in model.free_names], dtype=int)
        self._columns = tuple(self.layout.record_columns(i) for i in range(len(self.records)))

    def values(self, unknowns: np.ndarray, record: int) -> np.ndarray:
        """Values of all parameters of the model that is run, for one record."""
        values = self._base.copy()
        values[self._free] = self.layout.parameters(unknowns, record)
        return values

    def initial_state(self, unknowns: np.ndarray, record: int) -> np.ndarray:
        """The model's own initial states of one record, shape ``(n_own,)``."""
        return unknowns[self._columns[record][: self.layout.n_own]]

    def initial_states(self, unknowns: np.ndarray) -> list[np.ndarray]:
        """Copies of the model's own initial states of every record."""
        return [self.initial_state(unknowns, i).copy() for i in range(len(self.records))]

    def fill(
        self, unknowns: np.ndarray, record: int, own: np.ndarray, values: Mapping[str, float]
    ) -> None:
        """Set the start states ``(n_own,)`` and parameters of a record, those that are numbers."""
        states, free = np.split(self._columns[record], [self.layout.n_own])
        given = np.array([values.get(name, np.nan) for name in self.layout.free_names])
        told, known = np.isfinite(own), np.isfinite(given)
        unknowns[states[told]] = own[told]
        unknowns[free[known]] = self.layout.inward(np.where(known, given, 1.0))[known]

    def having(self, **changes: object) -> Self:
        """Return the same problem with some attributes changed."""
        other = copy.copy(self)
        other.__dict__.update(changes)
        return other

    def holding(self, positions: np.ndarray, values: np.ndarray) -> Self:
        """Return the same problem with some unknowns held at given values."""
        lower, upper = self.limits.lower.copy(), self.limits.upper.copy()
        lower[positions] = upper[positions] = values
        return self.having(limits=replace(self.limits, lower=lower, upper=upper))


def node_maps(
    end_sensitivities: np.ndarray,
    defects: np.ndarray,
    dz0: np.ndarray,
    n_own: int,
    slopes: np.ndarray,
) -> np.ndarray:
    """Start states of all intervals, and free parameters, by the unknowns of a record.

    Parameters
    ----------
    end_sensitivities : ndarray (n_segments, n_full, n_full + n_free)
        Derivatives of each interval's end by its start and the free parameters.
    defects : ndarray (n_segments - 1, n_full)
        Jumps at the nodes.
    dz0 : ndarray (n_full, n_own + n_free)
        Derivatives of the first state by the unknowns.
    n_own : int
        Number of initial states among the unknowns.
    slopes : ndarray (n_free,)
        Derivatives of the free parameters by their unknowns; one by default.

    Returns
    -------
    ndarray (n_segments, n_full + n_free, n_own + n_free + 1)
        Columns: own initial states, free parameters, and the closing of the defects.
    """
    n_segments, n_full, n_columns = end_sensitivities.shape
    n_free = n_columns - n_full
    maps = np.zeros((n_segments, n_columns, n_own + n_free + 1))
    maps[:, n_full:, n_own:-1] = np.diag(slopes)
    maps[0, :n_full, :-1] = dz0
    for i in range(n_segments - 1):
        maps[i + 1, :n_full] = end_sensitivities[i] @ maps[i]
        maps[i + 1, :n_full, -1] += defects[i]
    return maps
