"""Nominal model of the two-propeller catamaran, everything measured."""

from __future__ import annotations

import math

from benchmarks.other_vehicles.models.base import (
    Nominal,
    candidates,
    horizontal_plane,
    known,
)
from oed_sysid import Force, Input, Model, Parameter
from oed_sysid.physics import (
    amplitude,
)

CONSTANTS = (
    known("m", 62.0, "kg", "mass"),
    known("I_zz", 18.0, "kg m^2", "yaw inertia"),
    known("X_udot", -6.0, "kg", "surge added mass"),
    known("Y_vdot", -70.0, "kg", "sway added mass"),
    known("N_rdot", -16.0, "kg m^2", "yaw added inertia"),
    known("arm", 0.4, "m", "propellers off the centre line"),
    Parameter("k", 0.42, "N s^2", 0.0, description="thrust per n^2"),
)
INERTIAL = Force(
    "coriolis",
    {
        "X": "(m - Y_vdot)*v_r*r",
        "Y": "-(m - X_udot)*u_r*r",
        "N": "munk*(Y_vdot - X_udot)*u_r*v_r",
    },
    (Parameter("munk", 0.1, "1", description="share of the ideal Munk moment, after skegs"),),
    description="Coriolis and Munk terms",
)
DRAG = Force(
    "drag",
    {"X": "X_u*u_r + X_uu*u_r*abs(u_r)", "N": "N_r*r"},
    (
        Parameter("X_u", -8.0, "kg/s", description="linear drag"),
        Parameter("X_uu", -16.0, "kg/m", description="quadratic drag"),
        Parameter("N_r", -28.0, "kg m^2/s", description="yaw damping"),
    ),
    description="drag and yaw damping",
)
SWAY_DAMPING = Force(
    "sway_damping",
    {"Y": "Y_v*v_r"},
    (Parameter("Y_v", -70.0, "kg/s", -900.0, 900.0, scale=40.0, description="sway damping"),),
    description="linear sway damping",
)
THRUST = Force("thrust", {"X": "T_l + T_r", "N": "arm*(T_l - T_r)"}, description="both propellers")
TURN_LOSS = Force(
    "speed_loss_in_turn",
    {"X": "E_turn_rr*r**2 + E_turn_vr*v_r*r"},
    (amplitude("turn_rr", "kg m", scale=20.0), amplitude("turn_vr", "kg", scale=15.0)),
    description="speed falls in a turn",
)


def build(declared: bool, lacking: str | None) -> Model:
    """The nominal model."""
    parts = (INERTIAL, DRAG, SWAY_DAMPING, THRUST)
    thrust = "where({0} > 0, k*{0}**2, -k*{0}**2/2)"
    return horizontal_plane(
        "two-propeller catamaran",
        (1.0, 0.2, 0.2, 1.0, 20.0, 20.0),
        {"u": 0.02, "v": 0.02, "r": 0.006, "psi": math.radians(0.5), "x": 0.3, "y": 0.3},
        declared=declared,
        inputs=(Input("n_left", "1/s", "left propeller"), Input("n_right", "1/s", "right one")),
        actuators={"n_l": "n_left", "n_r": "n_right"},
        signals={"T_l": thrust.format("n_l"), "T_r": thrust.format("n_r")},
        effects=tuple(part for part in parts if part.name != lacking),
        parameters=CONSTANTS,
        step=0.0625,
    )


NOMINAL = Nominal(build, candidates("catamaran", TURN_LOSS), {"sway_damping": SWAY_DAMPING})
