"""The kernel's results from CasADi's interpreter, one call per step."""

from __future__ import annotations

import casadi as ca
import numpy as np

from oed_sysid.compiled.graph import Graph, build
from oed_sysid.model import Model


class Interpreted:
    """The same results from CasADi's interpreter, one call per step."""

    def __init__(self, graph: Graph, step: float) -> None:
        self.graph = graph
        self.step = step  # not the graph's: models of one structure share a graph
        free = list(graph.free_indices)

        def differentiated(function: ca.Function, z_index: int, p_index: int) -> ca.Function:
            symbols = [
                ca.SX.sym(function.name_in(i), function.sparsity_in(i))
                for i in range(function.n_in())
            ]
            results = function.call(symbols)
            blocks = []
            for result in results:
                by_p = ca.jacobian(result, symbols[p_index])[:, free]
                blocks.append(ca.densify(ca.horzcat(ca.jacobian(result, symbols[z_index]), by_p)))
            return ca.Function(
                f"{function.name()}_dense", symbols, [*results, *blocks], {"cse": True}
            )

        self._advance = differentiated(graph.advance, 0, 3)
        self._sample = differentiated(graph.sample, 0, 2)
        self._start = differentiated(graph.start, 0, 2)

    def start(
        self, own: np.ndarray, inputs: np.ndarray, values: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`oed_sysid.compiled.kernels.Kernel.start`."""
        z, dz = self._start(own, inputs, values, time)
        return np.array(z).ravel(), np.array(dz)

    def run(
        self,
        times: np.ndarray,
        inputs: np.ndarray,
        values: np.ndarray,
        nodes: np.ndarray,
        starts: np.ndarray,
        carry: bool,
        results: tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray, np.ndarray | None],
    ) -> int:
        """Fill the results as the compiled loop does; return -1 or the failing sample."""
        z_out, y_out, dy_out, ends, dends = results
        n, n_full = len(times), self.graph.n_full
        linear = np.array(self.graph.linear_inputs, dtype=float)
        derive = dy_out is not None
        z = nodes[0]
        s = np.eye(n_full, dy_out.shape[2]) if dy_out is not None else np.empty((0, 0))
        for segment, first in enumerate(starts):
            stop = starts[segment + 1] if segment + 1 < len(starts) else n
            z = z if carry else nodes[segment]
            if derive:
                s = np.eye(n_full, s.shape[1])
            for k in range(first, stop):
                if not np.isfinite(z).all():
                    return k
                z_out[k] = z
                since = times[k] - times[k - 1] if k else (times[1] - times[0] if n > 1 else 1.0)
                y, after, dy, dafter = self._sample(z, inputs[k], values, times[k], since)
                y_out[k] = np.array(y).ravel()
                z = np.array(after).ravel()
                if dy_out is not None:
                    dy_out[k] = _chain_rule(np.array(dy), s)
                    s = _chain_rule(np.array(dafter), s)
                if k + 1 == n:
                    break
                interval = times[k + 1] - times[k]
                steps = max(1, int(np.ceil(interval / self.step - 1e-9)))
                slope = linear * (inputs[k + 1] - inputs[k]) / steps
                for i in range(steps):
                    begin, end = inputs[k] + i * slope, inputs[k] + (i + 1) * slope
                    t, h = times[k] + i * interval / steps, interval / steps
                    moved, dmoved = self._advance(z, begin, end, values, t, h)
                    z = np.array(moved).ravel()
                    if derive:
                        s = _chain_rule(np.array(dmoved), s)
            ends[segment] = z
            if dends is not None:
                dends[segment] = s
        return -1


def _chain_rule(jacobian: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Combine a dense ``[d/dz, d/dp]`` with the sensitivities ``s`` of ``z``."""
    n_full = len(s)
    with np.errstate(over="ignore", invalid="ignore"):  # an explosion is told by the states
        result = jacobian[:, :n_full] @ s
    result[:, n_full:] += jacobian[:, n_full:]
    return result


_CACHE: dict[tuple[str, float], Interpreted] = {}


def interpreted(model: Model) -> Interpreted:
    """Return the interpreted kernel of a model, built at most once per structure."""
    key = (model.structure_key(), model.step)
    if key not in _CACHE:
        _CACHE[key] = Interpreted(build(model), model.step)
    return _CACHE[key]
