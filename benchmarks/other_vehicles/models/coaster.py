"""Nominal model of the 50 m coaster: linear hull and rudder, heading and position measured."""

from __future__ import annotations

import math

from benchmarks.other_vehicles.models.base import (
    Nominal,
    candidates,
    guess,
    horizontal_plane,
    known,
)
from oed_sysid import Force, Input, Model, Parameter

LENGTH, DENSITY = 50.0, 1025.0
MASS = 0.0130 * 0.5 * DENSITY * LENGTH**3

CONSTANTS = (
    known("L", LENGTH, "m", "length between perpendiculars"),
    known("Q", 0.5 * DENSITY * LENGTH**2, "kg/m", "rho L^2/2"),
    known("m", MASS, "kg", "mass"),
    known("X_udot", -0.0007 * 0.5 * DENSITY * LENGTH**3, "kg", "surge added mass"),
    known("Y_vdot", -0.0100 * 0.5 * DENSITY * LENGTH**3, "kg", "sway added mass"),
    known("I_zz", 0.00081 * 0.5 * DENSITY * LENGTH**5, "kg m^2", "yaw inertia"),
    known("N_rdot", -0.00050 * 0.5 * DENSITY * LENGTH**5, "kg m^2", "yaw added inertia"),
    known("T_nn", 2400.0, "kg m", "thrust per n^2"),
)
HULL = Force(
    "hull",
    {
        "X": "m*v*r + Q*X_uu*u_r*abs(u_r)",
        "Y": "-m*u*r + Q*(Y_v*u_r*v_r + L*Y_r*u_r*r)",
        "N": "Q*L*N_v*u_r*v_r",
    },
    (
        guess("X_uu", -0.0012, description="resistance"),
        guess("Y_v", -0.018, "1", "side force of drift"),
        known("Y_r", 0.0035, "1", "side force of yaw rate"),
        guess("N_v", -0.005, "1", "moment of drift"),
    ),
    description="linear hull",
)
YAW_DAMPING = Force(
    "yaw_damping",
    {"N": "Q*L**2*N_r*u_r*r"},
    (Parameter("N_r", -0.0040, "1", -0.05, 0.05, scale=0.002, description="yaw damping"),),
    description="moment of the hull against yaw rate",
)
RUDDER = Force(
    "rudder_force",
    {"Y": "Q*Y_d*u_r**2*delta", "N": "Q*L*N_d*u_r**2*delta"},
    (guess("Y_d", 0.0045, "1", "rudder force"), guess("N_d", -0.0022, "1", "rudder moment")),
    description="rudder",
)
PROPELLER = Force("propeller", {"X": "T"}, description="thrust")


def build(declared: bool, lacking: str | None) -> Model:
    """The nominal model."""
    parts = (HULL, YAW_DAMPING, RUDDER, PROPELLER)
    return horizontal_plane(
        "50 m coaster",
        (1.0, 0.3, 0.02, 1.0, 100.0, 100.0),
        {"psi": math.radians(0.2), "x": 0.5, "y": 0.5},
        declared=declared,
        inputs=(Input("n", "1/s", "propeller"), Input("rudder", "rad", "rudder angle")),
        actuators={"delta": "rudder", "T": "T_nn*n*abs(n)"},
        effects=tuple(part for part in parts if part.name != lacking),
        parameters=CONSTANTS,
        step=0.25,
    )


NOMINAL = Nominal(build, candidates("coaster"), {"yaw_damping": YAW_DAMPING})
