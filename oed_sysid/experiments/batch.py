"""Many trajectories at once, over threads: the compiled kernel leaves Python's lock."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike

from oed_sysid.compiled.kernels import kernel
from oed_sysid.errors import SimulationError
from oed_sysid.experiments.trajectory import input_array, start_array
from oed_sysid.physics.model import Model


def simulate_batch(
    model: Model,
    times: ArrayLike,
    *,
    inputs: Mapping[str, ArrayLike] | ArrayLike,
    values: ArrayLike,
    initials: Mapping[str, float] | ArrayLike | None = None,
    n_workers: int | None = None,
) -> np.ndarray:
    """Simulate a model for many parameter sets, start states or inputs.

    Parameters
    ----------
    model : Model
        The model.
    times : array_like (n_times,)
        Increasing times, s, the same for all.
    inputs : array_like (n_times, n_inputs) or (n_batch, n_times, n_inputs), or mapping
        Commands, the same for all or one set each.
    values : array_like (n_batch, n_parameters)
        All parameters in the order of ``model.parameter_names``.
    initials : mapping, or array_like (n_own,) or (n_batch, n_own)
        Start values of the model's own states, the same for all or one each.
    n_workers : int, optional
        Threads; by default as many as there are cores.

    Returns
    -------
    ndarray (n_batch, n_times, n_outputs)
        Noise-free outputs; NaN from where a trajectory diverged.

    Raises
    ------
    SimulationError
        If the shapes do not fit together.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Output, State
    >>> from oed_sysid.physics.parameters import Parameter
    >>> decay = Model(
    ...     "decay", (State("x", "m"),), (), (Output("x", "m"),), {"x": "-a*x"},
    ...     parameters=(Parameter("a", 1.0, "1/s"),),
    ... )
    >>> y = simulate_batch(
    ...     decay, [0.0, 0.5, 1.0], inputs={}, values=[[1.0], [2.0]], initials={"x": 1.0}
    ... )
    >>> print(y[:, -1, 0].round(4))
    [0.3679 0.1353]
    """
    moments = np.asarray(times, dtype=float)
    table = np.ascontiguousarray(np.atleast_2d(np.asarray(values, dtype=float)))
    n_batch, n_parameters = table.shape
    if n_parameters != len(model.all_parameters):
        raise SimulationError(
            f"Values have {n_parameters} columns; model {model.name!r} has the "
            f"{len(model.all_parameters)} parameters {', '.join(model.parameter_names)}."
        )
    commands = _inputs(model, len(moments), inputs, n_batch)
    starts = _starts(model, initials, n_batch)
    runner = kernel(model)
    outputs = np.full((n_batch, len(moments), len(model.outputs)), np.nan)

    def run(member: int) -> None:
        own_inputs = commands[member if len(commands) > 1 else 0]
        own = starts[member if len(starts) > 1 else 0]
        z, _ = runner.start(own, own_inputs[0], table[member], moments[0])
        outputs[member] = runner.run(moments, own_inputs, table[member], z).outputs

    def run_all(members: Iterable[int]) -> None:
        for member in members:
            run(member)

    # The interpreter keeps Python's lock; threads would only get in each other's way.
    workers = (n_workers or os.cpu_count() or 1) if runner.is_compiled else 1
    if workers == 1 or n_batch == 1:
        run_all(range(n_batch))
        return outputs
    # A few chunks per worker: short runs cost less than handing them over one by one.
    chunks = np.array_split(np.arange(n_batch), min(n_batch, 4 * workers))
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(run_all, chunks))
    return outputs


def _inputs(
    model: Model, n_times: int, inputs: Mapping[str, ArrayLike] | ArrayLike, n_batch: int
) -> list[np.ndarray]:
    """One array of commands for all, or one for each member."""
    if not isinstance(inputs, Mapping):
        array = np.asarray(inputs, dtype=float)
        if array.ndim == 3:
            if len(array) != n_batch:
                raise SimulationError(
                    f"There are {len(array)} sets of inputs but {n_batch} sets of values. Give as "
                    "many of both, or one set of inputs for all."
                )
            return [input_array(model, n_times, member) for member in array]
    return [input_array(model, n_times, inputs)]


def _starts(
    model: Model, initials: Mapping[str, float] | ArrayLike | None, n_batch: int
) -> list[np.ndarray]:
    """One start state for all, or one for each member."""
    if initials is not None and not isinstance(initials, Mapping):
        array = np.asarray(initials, dtype=float)
        if array.ndim == 2:
            if len(array) != n_batch:
                raise SimulationError(
                    f"There are {len(array)} start states but {n_batch} sets of values. Give as "
                    "many of both, or one start state for all."
                )
            return [start_array(model, member) for member in array]
    return [start_array(model, initials)]
