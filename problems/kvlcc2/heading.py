"""The tanker as a heading response: Nomoto's equation and what it leaves out.

The rudder angle is positive with its trailing edge to port, as in the records,
so that K is negative.
"""

from __future__ import annotations

from oed_sysid import ExtraState, Force, Input, Model, Output, Parameter, State
from oed_sysid.physics import (
    Effect,
    actuator_lag,
    amplitude,
    deadband,
    rudder_neutral_angle,
    sensor_bias,
    sensor_scale,
)

from .helm import HELM_ZERO

NOMOTO = "Nomoto et al. (1957), On the steering qualities of ships, Int. Shipbuilding Progress 4."
NORRBIN = "Norrbin (1971), Theory and observations on the use of a mathematical model, SSPA 68."
BECH = "Bech & Wagner Smith (1969), Analogue simulation of ship manoeuvres, HyA report Hy-14."

FIRST_ORDER = Model(
    name="first-order Nomoto",
    states=(
        State("psi", "rad", "heading", scale=0.3),
        State("r", "rad/s", "yaw rate", scale=0.05),
    ),
    inputs=(Input("delta", "rad", "measured rudder angle", interpolation="linear"),),
    outputs=(Output("psi", "rad", "heading"), Output("r", "rad/s", "yaw rate")),
    kinematics={"psi": "r", "r": "(K*delta - r)/T"},
    parameters=(
        Parameter("K", -0.2, "1/s", lower=-2.0, upper=2.0, description="turning ability"),
        Parameter("T", 15.0, "s", lower=0.1, upper=500.0, description="time constant"),
    ),
    step=0.5,
)

# K (1 + T3 s) / ((1 + T s)(1 + T2 s)): the rudder acts through a lead-lag with state x_2.
# E = 1 - T3/T2 is zero where zero and pole cancel, which is the first order.
SECOND_ORDER = Force(
    "second_order",
    {"r": "K/T*E_second_order*(x_2 - delta)"},
    (
        amplitude("second_order", "1", scale=0.5),
        Parameter("T_2", 5.0, "s", lower=0.3, upper=100.0, description="second time constant"),
    ),
    states=(ExtraState("x_2", "(delta - x_2)/T_2", "delta", "rad"),),
    amplitudes=("E_second_order",),
    description="sway and yaw exchange momentum: two time constants and a zero",
    source=NOMOTO,
    needs="quick rudder reversals and steady turns",
)
NORRBIN_DAMPING = Force(
    "norrbin",
    {"r": "-E_norrbin*r**3/T"},
    (amplitude("norrbin", "s^2/rad^2", scale=200.0),),
    description="T r' + r + E r^3 = K delta: damping grows with the turning rate",
    source=NORRBIN,
    needs="weak and strong turns",
)


BECH_DAMPING = Force(
    "bech",
    {"r": "-(E_bech_0 + E_bech_rr*r**2)/T"},
    (
        amplitude("bech_0", "rad/s", scale=0.001),
        amplitude("bech_rr", "s/rad", scale=1.0),
    ),
    description="T r' + r + E_0 + E_rr r^2 = K delta: port and starboard differ",
    source=BECH,
    needs="turns to both sides",
)


def heading_effects() -> tuple[Effect, ...]:
    """Candidates for what Nomoto's first-order equation leaves out."""
    return (
        SECOND_ORDER,
        NORRBIN_DAMPING,
        BECH_DAMPING,
        HELM_ZERO,
        rudder_neutral_angle(scale=0.01),
        actuator_lag("rudder_lag", "delta", scale=0.5),
        deadband("rudder_deadband", "delta", scale=0.01),
        sensor_bias("bias_r", "r", "rad/s", scale=0.001),
        sensor_scale("scale_r", "r", scale=0.03),
    )
