"""KVLCC2, HSVA model at scale 1:45.714: what is known before any fit.

Source: ship data of the HSVA free-running tests (SIMMAN 2008), 7.0 m model,
deep water, without bilge keels, constant revolutions.
"""

from __future__ import annotations

from oed_sysid import Parameter

LENGTH = 7.0  # m, between perpendiculars
APPROACH_SPEED = 1.179  # m/s, Froude number 0.142
RUDDER_RATE = 15.8  # deg/s


def known(name: str, value: float, unit: str, description: str) -> Parameter:
    """Return a number that no fit may change."""
    return Parameter(name, value, unit, fixed=True, description=description)


SHIP = (
    known("rho", 1000.0, "kg/m^3", "density of the tank's water"),
    known("L", LENGTH, "m", "length between perpendiculars"),
    known("d", 0.455, "m", "draught"),
    known("m", 3272.0, "kg", "mass"),
    known("x_G", 0.2436, "m", "centre of gravity ahead of midship, 3.48 % L"),
    known("I_z", 9908.6, "kg m^2", "yaw inertia about the centre of gravity, k_zz 0.2486 L"),
)
PROPELLER = (
    known("D_P", 0.204, "m", "diameter of the stock propeller"),
    known("n_P", 10.2295, "1/s", "revolutions, constant in all runs"),
    # Least squares of the open-water table for 0 <= J <= 0.9; largest error 0.004.
    known("k_0", 0.3242, "1", "thrust coefficient at J = 0"),
    known("k_1", -0.2209, "1", "its slope"),
    known("k_2", -0.1490, "1", "its curvature"),
)
RUDDER = (
    known("A_R", 0.0539, "m^2", "movable rudder area"),
    known("H_R", 0.345, "m", "rudder height"),
    known("x_R", -3.5, "m", "rudder, from midship"),
)
