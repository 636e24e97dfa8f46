"""States and outputs of vehicles under the usual names of their motion; runs of any model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed_sysid import Model, Output, State
from oed_sysid.compiled.kernels import Kernel, Run

ANGLES = ("phi", "theta", "psi")
UNITS = {
    **{name: "m" for name in "xyz"},
    **{name: "rad" for name in ANGLES},
    **{name: "m/s" for name in "uvw"},
    **{name: "rad/s" for name in "pqr"},
}


def states(names: str, **scales: float) -> tuple[State, ...]:
    """States of these names, some of another typical size than one."""
    return tuple(State(name, UNITS[name], scale=scales.get(name, 1.0)) for name in names.split())


def outputs(names: str, **noise: float) -> tuple[Output, ...]:
    """Measurements of these states, with the noise levels that are declared."""
    return tuple(Output(name, UNITS[name], noise_std=noise.get(name)) for name in names.split())


def ran(
    model: Model,
    times: np.ndarray,
    inputs: np.ndarray,
    own: Sequence[float] | np.ndarray,
    compiled: bool | None = None,
    **options: object,
) -> Run:
    """Trajectory from own states, with options of the kernel's run."""
    code = Kernel(model, compiled=compiled)
    z, _ = code.start(np.asarray(own, dtype=float), inputs[0], model.value_vector, times[0])
    return code.run(times, inputs, model.value_vector, z, **options)  # type: ignore[arg-type]
