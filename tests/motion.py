"""States and outputs of vehicles under the usual names of their motion."""

from __future__ import annotations

from oed_sysid import Output, State

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
