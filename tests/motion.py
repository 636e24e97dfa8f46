"""States and outputs under the usual names of motion, models in few words, runs of any model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from oed_sysid import Input, Model, Output, Parameter, State
from oed_sysid.compiled.kernels import Kernel, Run
from oed_sysid.text.units import parse_header

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


def _named(header: str) -> tuple[str, str]:
    """Name and unit of a header."""
    name, unit = parse_header(header)
    return name, unit or ""


def small(
    name: str,
    signals: str,
    rates: Mapping[str, str] | None = None,
    parameters: Mapping[str, float] | Iterable[Parameter] = (),
    noise: Mapping[str, float] | float | None = None,
    *,
    scales: Mapping[str, float] | None = None,
    interpolation: str = "hold",
    **settings: Any,
) -> Model:
    """A model whose signals are said as headers: ``"x [m], v [m/s] <- force [N]"``.

    All states are measured, or those alone whose noise is given, in that order; parameters are
    numbers by header.
    """
    states, inputs = (
        [_named(one) for one in part.split(", ") if one]
        for part in (*signals.split(" <- "), "")[:2]
    )
    levels = noise if isinstance(noise, Mapping) else dict.fromkeys(dict(states), noise)
    if isinstance(parameters, Mapping):
        parameters = [
            Parameter(own, value, unit)
            for (own, unit), value in zip(map(_named, parameters), parameters.values(), strict=True)
        ]
    return Model(
        name,
        tuple(State(own, unit, scale=(scales or {}).get(own, 1.0)) for own, unit in states),
        tuple(Input(own, unit, interpolation=interpolation) for own, unit in inputs),
        tuple(Output(own, dict(states)[own], noise_std=level) for own, level in levels.items()),
        rates or {},
        parameters=tuple(parameters),
        **settings,
    )


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
