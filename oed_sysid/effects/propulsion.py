"""Propulsion: thrust, its losses and its side effects."""

from __future__ import annotations

from oed_sysid.effects.amplitudes import amplitude
from oed_sysid.effects.base import Actuator, Force
from oed_sysid.parameters import Parameter

CARLTON = "Carlton (2018), Marine propellers and propulsion, ch. 6 and 12, Butterworth-Heinemann."
FOSSEN = "Fossen (2021), Handbook of marine craft hydrodynamics and motion control, ch. 9, Wiley."
HOOFT = "Hooft & Nienhuis (1994), The prediction of the ship's manoeuvrability, SNAME Trans. 102."


def thrust_decay(
    name: str = "thrust_decay", signal: str = "T", *, scale: float = 0.0015, value: float = 0.0
) -> Actuator:
    """Thrust that falls with time, ``T (1 - E t)``, as a battery does; short records only."""
    size = amplitude(name, "1/s", scale=scale, value=value)
    return Actuator(
        name,
        {signal: f"{signal}*(1 - {size.name}*t)"},
        (size,),
        description="thrust changes during the record at the same command",
        source=CARLTON,
        needs="a long record at constant command",
    )


def thrust_speed_loss(
    name: str = "thrust_speed_loss",
    *,
    axis: str = "X",
    thrust: str = "T",
    velocity: str = "u_r",
    scale: float = 0.08,
    value: float = 0.0,
) -> Force:
    """Thrust that falls with the advance speed: adds ``E T u_r``, with ``E`` below zero.

    Valid for moderate changes of the advance ratio about bollard pull.
    """
    size = amplitude(name, "s/m", scale=scale, value=value)
    return Force(
        name,
        {axis: f"{size.name}*{thrust}*{velocity}"},
        (size,),
        description="thrust depends on the speed of advance",
        source=CARLTON,
        needs="several thrusts at several speeds, or coasting",
    )


def propeller_thrust(
    name: str = "propeller",
    *,
    axis: str = "X",
    revolutions: str = "n",
    velocity: str = "u_r",
    bollard: float,
    advance: float = 0.0,
) -> Force:
    r"""Thrust of a propeller, :math:`T_{nn}\,n|n| + T_{nu}\,|n|u_r`, for a base model.

    ``bollard`` is :math:`\rho D^4 K_{T0}` in kg m and ``advance`` the (negative)
    slope :math:`\rho D^3 K_{TJ}(1-w)` in kg, with ``n`` in 1/s.
    """
    parameters = (
        Parameter("T_nn", bollard, "kg m", description="thrust per n|n|"),
        Parameter("T_nu", advance, "kg", description="thrust per |n|u"),
    )
    n, u = revolutions, velocity
    return Force(
        name,
        {axis: f"T_nn*{n}*abs({n}) + T_nu*abs({n})*{u}"},
        parameters,
        description="propeller thrust with a linear thrust coefficient",
        source=FOSSEN,
        needs="several rates of revolution at several speeds",
    )


def single_screw_asymmetry(
    name: str = "single_screw_asymmetry",
    *,
    thrust: str = "T",
    arm: float = 1.0,
    scale: float = 0.02,
) -> Force:
    """Side force and yaw moment of a single screw: ``Y = E_Y T`` and ``N = E_N T``.

    ``arm`` is a typical lever in m (half the length), ``scale`` that of the side force.
    """
    side = amplitude(f"{name}_Y", "1", scale=scale)
    yaw = amplitude(f"{name}_N", "m", scale=scale * arm)
    return Force(
        name,
        {"Y": f"{side.name}*{thrust}", "N": f"{yaw.name}*{thrust}"},
        (side, yaw),
        description="a right-handed screw pushes the stern sideways",
        source=HOOFT,
        needs="turns to both sides, at several thrusts",
    )
