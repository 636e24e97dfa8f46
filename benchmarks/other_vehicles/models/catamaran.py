"""Nominal model of the two-propeller catamaran, everything measured."""

from __future__ import annotations

import math

from benchmarks.other_vehicles.models.base import (
    Nominal,
    force,
    horizontal_plane,
    known,
    wind,
    zero,
)
from oed_sysid import Force, Input, Model, Parameter
from oed_sysid.physics import (
    actuator_lag,
    added_mass_error,
    amplitude,
    coupling,
    cubic_damping,
    current_horizontal_plane,
    deadband,
    linear_damping,
    quadratic_drag,
    sensor_bias,
    sensor_lag,
    sensor_lever_arm,
    sensor_misalignment,
    sensor_scale,
    thrust_speed_loss,
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


PROPELLERS = ("n_l", "n_r")
CANDIDATES = (
    current_horizontal_plane(scale=0.1),
    wind(2.0),
    quadratic_drag("yaw_quadratic_damping", "N", "r", scale=20.0),
    cubic_damping("yaw_cubic_damping", "N", "r", scale=30.0),
    quadratic_drag("sway_crossflow", "Y", "v_r", scale=60.0),
    quadratic_drag("yaw_crossflow_moment", "N", "v_r", scale=20.0),
    force(
        "left_propeller_loss",
        {"X": "T_l", "N": "arm*T_l"},
        "1",
        0.05,
        "the left propeller gives another thrust than the right one",
    ),
    actuator_lag("propeller_lag", PROPELLERS, scale=0.4),
    deadband("propeller_deadband", PROPELLERS, "1/s", scale=0.5),
    thrust_speed_loss(thrust="(T_l + T_r)", scale=0.1),
    TURN_LOSS,
    zero("left_zero", "n_l", "1/s", scale=0.2),
    force("yaw_trim", {"N": "1"}, "N m", 1.0, "constant yaw moment"),
    coupling("sway_yaw_coupling", "Y", "r", scale=10.0),
    linear_damping("yaw_sway_moment", "N", "v_r", scale=8.0),
    linear_damping("sway_yaw_force", "Y", "r", scale=10.0),
    added_mass_error("surge_added_mass_error", "X", "u", scale=8.0, bound=50.0),
    added_mass_error("sway_added_mass_error", "Y", "v", scale=20.0, bound=110.0),
    added_mass_error("yaw_added_inertia_error", "N", "r", scale=6.0, bound=28.0),
    sensor_lag("heading_lag", "psi", scale=0.3),
    sensor_lag("yaw_rate_lag", "r", scale=0.3),
    sensor_lag("log_lag", ("u", "v"), scale=0.3),
    sensor_lag("position_lag", ("x", "y"), scale=0.5),
    sensor_bias("bias_u", "u", "m/s", scale=0.03),
    sensor_bias("bias_v", "v", "m/s", scale=0.03),
    sensor_bias("bias_r", "r", "rad/s", scale=0.005),
    sensor_bias("bias_psi", "psi", "rad", scale=0.03),
    sensor_scale("scale_u", "u", scale=0.04),
    sensor_scale("scale_r", "r", scale=0.04),
    sensor_misalignment("log_misalignment", "u", "v", scale=0.03),
    sensor_lever_arm("log_lever_arm", "v", "r", scale=0.3),
)

NOMINAL = Nominal(build, CANDIDATES, {"sway_damping": SWAY_DAMPING})
