"""One iterate of multiple shooting: what it costs and what a step would gain.

Two ways to the same numbers. :class:`Exact` holds the sensitivities of every
sample, as covariances and robust losses need them. :class:`Gathered` holds sums
of their products only, gathered while the trajectory runs: several times
faster, and for least squares enough, save that rounding errors are
squared where an unstable trajectory amplifies them. Iterations therefore run on
gathered sums and end on exact ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from oed_sysid.compiled.normal_equations import Blocks, gather
from oed_sysid.likelihood.shooting import Linearisation, Point, Shooting
from oed_sysid.likelihood.unknowns import node_maps


class Iterate(Protocol):
    """What a search asks of a point."""

    @property
    def point(self) -> Point:
        """Unknowns and nodes."""

    @property
    def cost(self) -> float:
        """Half the (robust) sum of squares of residuals and priors, defects excluded."""

    @property
    def defect(self) -> float:
        """Sum of the scaled jumps at all nodes."""

    @property
    def maps(self) -> tuple[np.ndarray, ...]:
        """Change of the nodes per unknown, per record."""

    @property
    def offsets(self) -> tuple[np.ndarray, ...]:
        """Change of the nodes that closes the defects, per record."""

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Gauss-Newton matrix and right-hand side, priors excluded."""

    def predicted(self, step: np.ndarray) -> float:
        """Cost of the linearised problem after a full step, defects closed."""


class Exact:
    """A point with the sensitivities of every sample; see :class:`Iterate`."""

    def __init__(self, shooting: Shooting, point: Point, lin: Linearisation) -> None:
        self._shooting, self.point, self.linearisation = shooting, point, lin
        self.cost = shooting.cost(lin, point.unknowns)
        self.defect = shooting.defect(lin)
        self.maps, self.offsets = lin.node_maps, lin.node_offsets

    @classmethod
    def at(cls, shooting: Shooting, point: Point) -> Exact | None:
        """Evaluate a point; None where a trajectory diverges."""
        lin = shooting.linearise(point)
        return None if lin is None else cls(shooting, point, lin)

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Iterate`."""
        return self._shooting.normal_equations(self.linearisation)

    def predicted(self, step: np.ndarray) -> float:
        """See :class:`Iterate`."""
        return self._shooting.predicted_cost(self.linearisation, self.point.unknowns, step)


@dataclass(frozen=True, eq=False)
class Gathered:
    """A point with gathered sums, for least squares; see :class:`Iterate`.

    Attributes
    ----------
    closed : float
        Half the sum of squares once the defects are closed, to first order,
        at unchanged unknowns, priors excluded.
    """

    shooting: Shooting
    point: Point
    cost: float
    defect: float
    maps: tuple[np.ndarray, ...]
    offsets: tuple[np.ndarray, ...]
    matrix: np.ndarray
    right: np.ndarray
    closed: float

    @classmethod
    def at(cls, shooting: Shooting, point: Point) -> Gathered | None:
        """Evaluate a point; None where a trajectory diverges."""
        n = shooting.layout.n_unknowns
        matrix, right = np.zeros((n, n)), np.zeros(n)
        squares = closed = defect = 0.0
        maps, offsets = [], []
        for index, record in enumerate(shooting.records):
            values = shooting.values(point.unknowns, index)
            z0, dz0 = shooting.full_start(point.unknowns, index)
            nodes = np.vstack([z0[None], point.nodes[index]])
            blocks = gather(
                shooting.kernel,
                record.times,
                record.inputs,
                values,
                nodes,
                record.outputs,
                shooting.sigma,
                starts=shooting.starts[index],
                linked=True,
            )
            slopes = shooting.slopes(point.unknowns, index)
            n_own = shooting.layout.n_own
            part = None if blocks is None else _condensed(blocks, nodes, dz0, n_own, slopes)
            if blocks is None or part is None:
                return None
            found, map_, defects = part
            columns = shooting.layout.record_columns(index)
            matrix[np.ix_(columns, columns)] += found[:-1, :-1]
            right[columns] += found[:-1, -1]
            closed += 0.5 * float(found[-1, -1])
            squares += 0.5 * float(blocks.gram[:, -1, -1].sum())
            defect += float(np.abs(defects / shooting.state_scale).sum())
            n_full = nodes.shape[1]
            maps.append(map_[1:, :n_full, :-1])
            offsets.append(map_[1:, :n_full, -1])
        cost = squares + shooting.prior_cost(point.unknowns)
        return cls(
            shooting, point, cost, defect, tuple(maps), tuple(offsets), matrix, right, closed
        )

    def equations(self) -> tuple[np.ndarray, np.ndarray]:
        """See :class:`Iterate`."""
        return self.matrix, self.right

    def predicted(self, step: np.ndarray) -> float:
        """See :class:`Iterate`."""
        change = float(step @ (0.5 * (self.matrix @ step) - self.right))
        return self.closed + change + self.shooting.prior_cost(self.point.unknowns + step)


def _condensed(
    blocks: Blocks, nodes: np.ndarray, dz0: np.ndarray, n_own: int, slopes: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Products ``[J t]' [J t]`` of a record's condensed rows and closed residuals.

    Also the maps of its nodes and the defects; None where these overflow.
    """
    assert blocks.ends is not None
    assert blocks.end_sensitivities is not None
    defects = blocks.ends[:-1] - nodes[1:]
    with np.errstate(over="ignore", invalid="ignore"):
        maps = node_maps(blocks.end_sensitivities, defects, dz0, n_own, slopes)
        # Residuals once the defects are closed are one more combination of [J r].
        wide = np.zeros((len(nodes), blocks.gram.shape[1], maps.shape[2]))
        wide[:, :-1] = maps
        wide[:, :-1, -1] *= -1.0
        wide[:, -1, -1] = 1.0
        found = (wide.transpose(0, 2, 1) @ (blocks.gram @ wide)).sum(axis=0)
    if not (np.isfinite(found).all() and np.isfinite(maps).all()):
        return None
    return found, maps, defects
