"""The kernel's results from CasADi's interpreter, one call per step."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from oed_sysid.compiled.graph import DIVERGED, Graph, build, differentiated
from oed_sysid.physics.model import Model

# Times and inputs of a record.
Commands = tuple[np.ndarray, np.ndarray]


class Interpreted:
    """The same results from CasADi's interpreter, one call per step."""

    def __init__(self, graph: Graph, step: float) -> None:
        self.graph = graph
        self.step = step  # not the graph's: models of one structure share a graph

        def dense(function: ca.Function, arguments: tuple[int, ...], p: int) -> Callable[..., Any]:
            count = function.n_out()
            found = differentiated(function, arguments, p, graph.free_indices, "rows")

            def call(*values: Any) -> list[np.ndarray]:
                """Results, then of each its derivatives by all arguments side by side."""
                out = [np.array(part) for part in found(*values)]
                n = len(arguments)
                blocks = [np.hstack(out[count + n * i : count + n * (i + 1)]) for i in range(count)]
                return [*(part.ravel() for part in out[:count]), *blocks]

            return call

        self._advance = dense(graph.advance, (0, 3), 3)
        self._sample = dense(graph.sample, (0, 2), 2)
        #: See :meth:`oed_sysid.compiled.kernels.Kernel.start`.
        self.start = dense(graph.start, (0, 2), 2)

    def sample(
        self, z: np.ndarray, record: Commands, k: int, values: np.ndarray, hold: float = np.inf
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Outputs and state after a measurement, and the derivatives of both ``[d/dz, d/dp]``.

        Sensor memory has last taken in the beginning of the integration step before, which is none
        longer than what disturbances are held for.
        """
        times, inputs = record
        before = max(k, 1)
        interval = times[before] - times[before - 1] if len(times) > 1 else 1.0
        held = interval / max(1, int(np.ceil(interval / hold - 1e-6)))
        since = held / self._steps(held)
        return self._sample(z, inputs[k], values, times[k], since)

    def _steps(self, interval: float) -> int:
        """Integration steps of an interval."""
        return max(1, int(np.ceil(interval / self.step - 1e-9)))

    def move(
        self,
        z: np.ndarray,
        s: np.ndarray,
        record: Commands,
        k: int,
        values: np.ndarray,
        part: tuple[int, int] = (0, 1),
    ) -> tuple[np.ndarray, np.ndarray]:
        """State and sensitivities after one of several equal parts of the time to sample k + 1.

        Sensor memory takes in the beginning of every step but the first, the sample's own.
        """
        times, inputs = record
        (step, steps), interval = part, times[k + 1] - times[k]
        inner = self._steps(interval / steps)
        change = np.array(self.graph.linear_inputs, dtype=float) * (inputs[k + 1] - inputs[k])
        h = interval / steps / inner
        for j in range(inner):
            begin, end = (step + j / inner) / steps, (step + (j + 1) / inner) / steps
            t, first = times[k] + begin * interval, inputs[k] + begin * change
            if step + j > 0 and self.graph.n_sensor_memory:
                _, z, _, dz = self._sample(z, first, values, t, h)
                s = chained(dz, s)
            z, dz = self._advance(z, first, inputs[k] + end * change, values, t, h)
            s = chained(dz, s)
        return z, s

    def run(
        self,
        times: np.ndarray,
        inputs: np.ndarray,
        values: np.ndarray,
        nodes: np.ndarray,
        starts: np.ndarray,
        from_nodes: int,
        results: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    ) -> int:
        """Fill the results as the compiled loop does; return -1 or the failing sample."""
        z_out, y_out, dy_out, ends, dends = results
        n, n_full, record = len(times), self.graph.n_full, (times, inputs)
        z = nodes[0]
        for segment, (first, stop) in enumerate(pairwise([*starts, n])):
            node = nodes[segment * (from_nodes > 0)]
            z, s = np.append(node[:from_nodes], z[from_nodes:]), np.eye(n_full, dy_out.shape[2])
            for k in range(first, stop):
                if not abs(z.sum()) < DIVERGED:
                    return k
                z_out[k] = z
                y_out[k], z, dy, dafter = self.sample(z, record, k, values)
                dy_out[k], s = chained(dy, s), chained(dafter, s)
                if k + 1 == n:
                    break
                z, s = self.move(z, s, record, k, values)
            ends[segment], dends[segment] = z, s
        return -1


def chained(jacobian: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Combine a dense ``[d/dz, d/dp]`` with the sensitivities ``s`` of ``z``, which may be none."""
    n_full = len(s)
    with np.errstate(over="ignore", invalid="ignore"):  # an explosion is told by the states
        result = jacobian[:, :n_full] @ s
    result[:, n_full:] += jacobian[:, n_full : s.shape[1]]
    return result


_CACHE: dict[tuple[str, float], Interpreted] = {}


def interpreted(model: Model) -> Interpreted:
    """Return the interpreted kernel of a model, built at most once per structure."""
    key = (model.structure_key(), model.step)
    if key not in _CACHE:
        _CACHE[key] = Interpreted(build(model), model.step)
    return _CACHE[key]
