"""Fluid memory: forces that depend on the past of the motion."""

from __future__ import annotations

from oed_sysid.effects.amplitudes import amplitude
from oed_sysid.effects.base import ExtraState, Force
from oed_sysid.language import notation
from oed_sysid.parameters import Parameter

CUMMINS = "Cummins (1962), The impulse response function and ship motions, Schiffstechnik 9."


def fluid_memory(
    name: str,
    axis: str,
    state: str,
    *,
    state_unit: str | None = None,
    time_constant: float = 2.0,
    scale: float | None = None,
    value: float = 0.0,
) -> Force:
    r"""First-order memory :math:`E\,(w - \mu)`, :math:`\dot\mu = (w - \mu)/\tau`.

    The simplest approximation of the convolution with a retardation function:
    nothing in steady motion, damping in quick motion. ``time_constant`` is
    known; free the parameter ``tau_name`` to estimate it.

    Examples
    --------
    >>> fluid_memory("fluid_memory", "Z", "w").terms
    {'Z': 'E_fluid_memory*(w - mu_fluid_memory)'}
    """
    size = amplitude(name, notation.unit(f"{axis}_{state}"), scale=scale, value=value)
    tau = Parameter(f"tau_{name}", time_constant, "s", lower=0.05, upper=60.0, fixed=True)
    slow = f"mu_{name}"
    state_unit = state_unit or ("m/s" if axis in "XYZ" else "rad/s")
    rate = f"({state} - {slow})/{tau.name}"
    return Force(
        name,
        {axis: f"{size.name}*({state} - {slow})"},
        (size, tau),
        states=(ExtraState(slow, rate, state, state_unit),),
        amplitudes=(size.name,),
        description=f"the force of {state} fades with time",
        source=CUMMINS,
        needs="quick and slow motion",
    )
