"""A trajectory with error control, against which the fixed step of the package is judged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from oed_sysid.compiled import graph as graph_module
from oed_sysid.compiled.graph import Graph
from oed_sysid.experiments.trajectory import Trajectory, input_array, start_array, state_scales
from oed_sysid.physics.model import Model


def reference_trajectory(
    model: Model,
    times: ArrayLike,
    *,
    inputs: Mapping[str, ArrayLike] | ArrayLike,
    initial: Mapping[str, float] | ArrayLike | None = None,
    tolerance: float = 1e-13,
) -> Trajectory:
    """Simulate with SUNDIALS CVODES, which controls its own error.

    Actuators with memory are sampled maps and keep the model's step; the motion
    between is integrated to the tolerance. Without them the result does not
    depend on the step at all. It is hundreds of times slower than
    :func:`simulate_inputs`.

    Parameters
    ----------
    model, times, inputs, initial
        As in :func:`simulate_inputs`.
    tolerance : float
        Relative tolerance, and absolute in units of each state's size.

    Returns
    -------
    Trajectory

    Raises
    ------
    RuntimeError
        If the integrator gives up.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Output, State
    >>> decay = Model("decay", (State("x", "m"),), (), (Output("x", "m"),), {"x": "-x"})
    >>> exact = reference_trajectory(decay, [0.0, 1.0], inputs={}, initial={"x": 1.0})
    >>> print(f"{exact.signal('x')[-1]:.9f}")
    0.367879441
    """
    moments = np.asarray(times, dtype=float)
    commands = input_array(model, len(moments), inputs)
    graph = graph_module.build(model)
    values = model.value_vector
    advance = _integrator(graph, tolerance)
    linear = np.array(graph.linear_inputs, dtype=float)
    z = np.array(graph.start(start_array(model, initial), commands[0], values, moments[0])).ravel()
    states = np.empty((len(moments), graph.n_states))
    outputs = np.empty((len(moments), len(model.outputs)))
    steps_to = np.diff(moments)
    # Actuators that depend on memory, time or step depend on the length of the step; without them
    # CVODES goes from sample to sample.
    sampled = any(graph.actuate.jac_sparsity(0, index).nnz() for index in (0, 3, 4))
    longest = model.step if sampled else np.inf
    for k, time in enumerate(moments):
        states[k] = z[: graph.n_states]
        since = steps_to[max(k - 1, 0)] if len(moments) > 1 else 1.0
        y, after = graph.sample(z, commands[k], values, time, since)
        outputs[k], z = np.array(y).ravel(), np.array(after).ravel()
        if k + 1 == len(moments):
            break
        n_steps = max(1, int(np.ceil(steps_to[k] / longest - 1e-9)))
        h = steps_to[k] / n_steps
        slope = linear * (commands[k + 1] - commands[k]) / n_steps
        for i in range(n_steps):
            begin = commands[k] + i * slope
            z = _step(graph, advance, z, (begin, begin + slope, values, time + i * h, h))
    return Trajectory(
        times=moments,
        inputs=commands,
        states=states,
        outputs=outputs,
        input_names=model.input_names,
        state_names=graph.state_names,
        output_names=model.output_names,
    )


def _integrator(graph: Graph, tolerance: float) -> ca.Function:
    """Integrator over one step, in time from 0 to 1, so that it is built once."""
    model, n_inputs = graph.model, len(graph.model.inputs)
    x = ca.SX.sym("x", graph.n_states)
    memory = ca.SX.sym("memory", graph.n_actuator_memory)
    begin, end = ca.SX.sym("begin", n_inputs), ca.SX.sym("end", n_inputs)
    p = ca.SX.sym("p", len(model.all_parameters))
    start, h, fraction = ca.SX.sym("start"), ca.SX.sym("h"), ca.SX.sym("fraction")
    linear = ca.DM([float(flag) for flag in graph.linear_inputs])
    command = begin + fraction * linear * (end - begin) if n_inputs else begin
    signals, _ = graph.actuate(memory, command, p, start, h)
    ode = h * graph.rates(x, signals, p, start + fraction * h)
    problem = {"x": x, "t": fraction, "p": ca.vertcat(memory, begin, end, p, start, h), "ode": ode}
    options: dict[str, Any] = {
        "linear_multistep_method": "adams",
        "reltol": tolerance,
        "abstol": tolerance * float(min(state_scales(model, graph.n_states), default=1.0)),
        "max_num_steps": 100_000,
    }
    return ca.integrator("reference", "cvodes", problem, 0.0, 1.0, options)


def _step(
    graph: Graph, advance: ca.Function, z: np.ndarray, step: tuple[np.ndarray, ...]
) -> np.ndarray:
    """Full state after one step; the actuators' memory moves as in the kernel."""
    begin, end, values, time, h = step
    first, second = graph.n_states, graph.n_states + graph.n_actuator_memory
    memory = z[first:second]
    middle = (begin + end) / 2 if any(graph.linear_inputs) else begin
    _, memory_next = graph.actuate(memory, middle, values, time, h)
    x = advance(x0=z[:first], p=np.concatenate([memory, begin, end, values, [time, h]]))["xf"]
    return np.concatenate([np.array(x).ravel(), np.array(memory_next).ravel(), z[second:]])
