"""Where each unknown of an estimation sits, between which bounds, with which prior.

Unknowns, in order: shared free parameters, then for each record its initial
states and its own (``per_record``) parameters, then levels of the noise, where
these are estimated together with the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oed_sysid.model import Model


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
    """

    free_names: tuple[str, ...]
    shared: np.ndarray
    local: np.ndarray
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
        begin = len(self.shared) + index * width
        columns = np.empty(self.n_own + len(self.free_names), dtype=int)
        columns[: self.n_own] = begin + np.arange(self.n_own)
        columns[self.n_own + self.shared] = np.arange(len(self.shared))
        columns[self.n_own + self.local] = begin + self.n_own + np.arange(len(self.local))
        return columns

    @property
    def shared_names(self) -> tuple[str, ...]:
        """Names of the shared free parameters."""
        return tuple(self.free_names[i] for i in self.shared)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of every unknown; local ones carry the record's index."""
        names = list(self.shared_names)
        for record in range(self.n_records):
            names += [f"x0[{record}][{i}]" for i in range(self.n_own)]
            names += [f"{self.free_names[i]}[{record}]" for i in self.local]
        names += [f"noise[{i}]" for i in range(self.n_levels)]
        return tuple(names)


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
    def of(cls, model: Model, layout: Layout) -> Limits:
        """Limits that a model's parameters and states declare."""
        n = layout.n_unknowns
        lower, upper, scale = np.full(n, -np.inf), np.full(n, np.inf), np.ones(n)
        mean, weight = np.zeros(n), np.zeros(n)
        parameters = model.free_parameters
        scales = [*(s.scale for s in model.states), *(p.magnitude for p in parameters)]
        known = [p.prior_std is not None for p in parameters]
        for index in range(layout.n_records):
            columns = layout.record_columns(index)
            free = columns[layout.n_own :]
            scale[columns] = scales
            lower[free] = [p.lower for p in parameters]
            upper[free] = [p.upper for p in parameters]
            mean[free[known]] = [p.prior_mean for p in parameters if p.prior_std is not None]
            weight[free[known]] = [p.prior_std**-2 for p in parameters if p.prior_std is not None]
        return cls(lower, upper, mean, weight, scale)


def node_maps(
    end_sensitivities: np.ndarray, defects: np.ndarray, dz0: np.ndarray, n_own: int
) -> np.ndarray:
    """Start states of all intervals, and free parameters, by the unknowns of a record.

    Parameters
    ----------
    end_sensitivities : ndarray (n_segments, n_full, n_full + n_free)
        Derivatives of each interval's end by its start and the free parameters.
    defects : ndarray (n_segments - 1, n_full)
        Jumps at the nodes.
    dz0 : ndarray (n_full, n_own + n_free)
        Derivatives of the first state.
    n_own : int
        Number of initial states among the unknowns.

    Returns
    -------
    ndarray (n_segments, n_full + n_free, n_own + n_free + 1)
        Columns: own initial states, free parameters, and the closing of the defects.
    """
    n_segments, n_full, n_columns = end_sensitivities.shape
    n_free = n_columns - n_full
    maps = np.zeros((n_segments, n_columns, n_own + n_free + 1))
    maps[:, n_full:, n_own:-1] = np.eye(n_free)
    maps[0, :n_full, :-1] = dz0
    for i in range(n_segments - 1):
        maps[i + 1, :n_full] = end_sensitivities[i] @ maps[i]
        maps[i + 1, :n_full, -1] += defects[i]
    return maps
