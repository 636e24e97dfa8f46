"""The kernel's results from CasADi's interpreter, one call per step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from oed_sysid.compiled.graph import (
    FRACTIONS,
    GAMMA,
    NEWTON_FLOOR,
    NEWTON_MOST,
    NEWTON_STEP,
    STAGES,
    Graph,
    build,
)
from oed_sysid.physics.model import Model


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

        self._advance: Callable[..., tuple[Any, Any]] = self._implicit
        if graph.model.integrator == "explicit":
            self._advance = differentiated(graph.advance, 0, 3)  # type: ignore[assignment]
        else:
            self._actuate = differentiated(graph.actuate, 0, 2)
            self._rates = _with_all_derivatives(graph, free)
        self._sample = differentiated(graph.sample, 0, 2)
        self._start = differentiated(graph.start, 0, 2)

    def start(
        self, own: np.ndarray, inputs: np.ndarray, values: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """See :meth:`oed_sysid.compiled.kernels.Kernel.start`."""
        z, dz = self._start(own, inputs, values, time)
        return np.array(z).ravel(), np.array(dz)

    def _implicit(
        self,
        z: np.ndarray,
        start: np.ndarray,
        end: np.ndarray,
        values: np.ndarray,
        t: float,
        h: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """One implicit step and its derivatives ``[d/dz, d/dp]``; see :mod:`.graph`."""
        graph = self.graph
        nx, n_full, n_free = graph.n_states, graph.n_full, len(graph.free_indices)
        linear = np.array(graph.linear_inputs, dtype=bool)
        memory = slice(nx, nx + graph.n_actuator_memory)

        def actuated(fraction: float) -> list[np.ndarray]:
            held = np.where(linear, start + fraction * (np.asarray(end) - start), start)
            return [np.array(part) for part in self._actuate(z[memory], held, values, t, h)]

        def widened(block: np.ndarray) -> np.ndarray:
            """Columns by actuator memory and parameters as columns by state and parameters."""
            wide = np.zeros((len(block), n_full + n_free))
            wide[:, memory] = block[:, : memory.stop - nx]
            wide[:, n_full:] = block[:, memory.stop - nx :]
            return wide

        slopes: list[np.ndarray] = []
        by_unknowns: list[np.ndarray] = []
        x, s = z[:nx], np.eye(nx, n_full + n_free)
        for weights, fraction in zip(STAGES, FRACTIONS, strict=True):
            base, s_base = z[:nx].copy(), np.eye(nx, n_full + n_free)
            for weight, slope, by in zip(weights, slopes, by_unknowns, strict=False):
                base, s_base = base + h * weight * slope, s_base + h * weight * by
            d, _, dd, _ = actuated(fraction)
            x, matrix, by_d, by_p = self._stage(x, base, d.ravel(), values, t + fraction * h, h)
            right = s_base + h * GAMMA * (by_d @ widened(dd))
            right[:, n_full:] += h * GAMMA * by_p
            s = np.linalg.solve(matrix, right) if np.isfinite(x).all() else np.full_like(s, np.nan)
            slopes.append((x - base) / (h * GAMMA))
            by_unknowns.append((s - s_base) / (h * GAMMA))
        _, after, _, d_after = actuated(0.5)
        moved = np.concatenate([x, after.ravel(), z[memory.stop :]])
        total = np.eye(n_full, n_full + n_free)
        total[:nx], total[memory] = s, widened(d_after)
        return moved, total

    def _stage(
        self,
        x: np.ndarray,
        base: np.ndarray,
        d: np.ndarray,
        values: np.ndarray,
        t: float,
        h: float,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Solution of a stage, ``I - h gamma f_x`` there, and its other derivatives."""
        identity, arrived = np.eye(len(x)), False
        for _ in range(NEWTON_MOST):
            rate, by_x, by_d, by_p = (np.array(part) for part in self._rates(x, d, values, t))
            move = h * GAMMA * rate.ravel()
            matrix = identity - h * GAMMA * by_x
            if arrived:
                return x, matrix, by_d, by_p
            if not np.isfinite(matrix).all():
                break
            try:
                step = np.linalg.solve(matrix, base + move - x)
            except np.linalg.LinAlgError:
                break
            size = np.maximum(np.maximum(np.abs(x), np.abs(base)), np.abs(move))
            x = x + step
            arrived = bool(np.all(np.abs(step) <= NEWTON_STEP * size + NEWTON_FLOOR))
        return np.full_like(x, np.nan), matrix, by_d, by_p

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


def _with_all_derivatives(graph: Graph, free: list[int]) -> ca.Function:
    """Rates with their dense derivatives by states, actuator signals and free parameters."""
    function = graph.rates
    symbols = [
        ca.SX.sym(function.name_in(i), function.sparsity_in(i)) for i in range(function.n_in())
    ]
    (rate,) = function.call(symbols)
    blocks = [ca.jacobian(rate, symbols[i]) for i in (0, 1, 2)]
    blocks[2] = blocks[2][:, free]
    return ca.Function("rates_all", symbols, [rate, *map(ca.densify, blocks)], {"cse": True})


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
