"""Nominal model of the two-propeller catamaran, everything measured."""

from __future__ import annotations

import math

from benchmarks.other_vehicles.models.base import Nominal
from oed_sysid import Actuator, Force, Input, Memory, Model, Output, Parameter, State
from oed_sysid.physics import (
    added_mass_error,
    amplitude,
    coupling,
    cubic_damping,
    current_horizontal_plane,
    linear_damping,
    quadratic_drag,
    sensor_bias,
    sensor_lag,
    sensor_lever_arm,
    sensor_misalignment,
    sensor_scale,
)


def _known(name: str, value: float, unit: str, description: str) -> Parameter:
    return Parameter(name, value, unit, fixed=True, description=description)


CONSTANTS = (
    _known("m", 62.0, "kg", "mass"),
    _known("I_zz", 18.0, "kg m^2", "yaw inertia"),
    _known("X_udot", -6.0, "kg", "surge added mass"),
    _known("Y_vdot", -70.0, "kg", "sway added mass"),
    _known("N_rdot", -16.0, "kg m^2", "yaw added inertia"),
    _known("arm", 0.4, "m", "propellers off the centre line"),
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
WIND = Force(
    "wind_force",
    {
        "X": "E_wind_north*cos(psi) + E_wind_east*sin(psi)",
        "Y": "E_wind_east*cos(psi) - E_wind_north*sin(psi)",
    },
    (amplitude("wind_north", "N", scale=2.0), amplitude("wind_east", "N", scale=2.0)),
    description="constant force from a fixed direction",
    needs="several headings",
)
_DECAY = "exp(-h/(E_propeller_lag + 1e-9))"
_LAGGED = "{0} + ({1} - {0})*E_propeller_lag/h*(1 - decay)"
PROPELLER_LAG = Actuator(
    "propeller_lag",
    {
        "n_l": _LAGGED.format("n_l", "actual_l"),
        "n_r": _LAGGED.format("n_r", "actual_r"),
    },
    (amplitude("propeller_lag", "s", scale=0.4, positive=True),),
    definitions={"decay": _DECAY},
    memory=(
        Memory("actual_l", "n_l + (actual_l - n_l)*decay", "n_l"),
        Memory("actual_r", "n_r + (actual_r - n_r)*decay", "n_r"),
    ),
    description="both propellers follow with one first-order lag",
)
_DEAD = "where(abs({0}) > E_propeller_deadband, {0} - E_propeller_deadband*sign({0}), 0)"
PROPELLER_DEADBAND = Actuator(
    "propeller_deadband",
    {"n_l": _DEAD.format("n_l"), "n_r": _DEAD.format("n_r")},
    (amplitude("propeller_deadband", "1/s", scale=0.5, positive=True),),
    description="revolutions below a threshold give no thrust, those above lose it",
)
LEFT_LOSS = Force(
    "left_propeller_loss",
    {"X": "E_left_propeller_loss*T_l", "N": "arm*E_left_propeller_loss*T_l"},
    (amplitude("left_propeller_loss", "1", scale=0.05, bound=0.9),),
    description="the left propeller gives another thrust than the right one",
)
SPEED_LOSS = Force(
    "thrust_speed_loss",
    {"X": "E_thrust_speed_loss*(T_l + T_r)*u_r"},
    (amplitude("thrust_speed_loss", "s/m", scale=0.1),),
    description="thrust falls with the speed of advance",
)
TURN_LOSS = Force(
    "speed_loss_in_turn",
    {"X": "E_turn_rr*r**2 + E_turn_vr*v_r*r"},
    (amplitude("turn_rr", "kg m", scale=20.0), amplitude("turn_vr", "kg", scale=15.0)),
    description="speed falls in a turn",
)
LEFT_ZERO = Actuator(
    "left_zero",
    {"n_l": "n_l + E_left_zero"},
    (amplitude("left_zero", "1/s", scale=0.2, per_record=True),),
    description="zero of the left drive, set anew before each run",
)
YAW_TRIM = Force(
    "yaw_trim",
    {"N": "E_yaw_trim"},
    (amplitude("yaw_trim", "N m", scale=1.0),),
    description="constant yaw moment",
)


def build(declared: bool, lacking: str | None) -> Model:
    """The nominal model."""
    levels = (0.02, 0.02, 0.006, math.radians(0.5), 0.3, 0.3)
    names = ("u", "v", "r", "psi", "x", "y")
    units = ("m/s", "m/s", "rad/s", "rad", "m", "m")
    scales = (1.0, 0.2, 0.2, 1.0, 20.0, 20.0)
    parts = (INERTIAL, DRAG, SWAY_DAMPING, THRUST)
    thrust = "where({0} > 0, k*{0}**2, -k*{0}**2/2)"
    return Model(
        name="two-propeller catamaran",
        states=tuple(State(n, u, scale=s) for n, u, s in zip(names, units, scales, strict=True)),
        inputs=(Input("n_left", "1/s", "left propeller"), Input("n_right", "1/s", "right one")),
        outputs=tuple(
            Output(n, u, noise_std=level if declared else None)
            for n, u, level in zip(names, units, levels, strict=True)
        ),
        axes={"X": "u", "Y": "v", "N": "r"},
        inertia={
            ("X", "u"): "m - X_udot",
            ("Y", "v"): "m - Y_vdot",
            ("N", "r"): "I_zz - N_rdot",
        },
        kinematics={
            "psi": "r",
            "x": "u*cos(psi) - v*sin(psi)",
            "y": "u*sin(psi) + v*cos(psi)",
        },
        actuators={"n_l": "n_left", "n_r": "n_right"},
        signals={
            "u_r": "u",
            "v_r": "v",
            "T_l": thrust.format("n_l"),
            "T_r": thrust.format("n_r"),
        },
        effects=tuple(part for part in parts if part.name != lacking),
        parameters=CONSTANTS,
        step=0.0625,
    )


CANDIDATES = (
    current_horizontal_plane(scale=0.1),
    WIND,
    quadratic_drag("yaw_quadratic_damping", "N", "r", scale=20.0),
    cubic_damping("yaw_cubic_damping", "N", "r", scale=30.0),
    quadratic_drag("sway_crossflow", "Y", "v_r", scale=60.0),
    quadratic_drag("yaw_crossflow_moment", "N", "v_r", scale=20.0),
    LEFT_LOSS,
    PROPELLER_LAG,
    PROPELLER_DEADBAND,
    SPEED_LOSS,
    TURN_LOSS,
    LEFT_ZERO,
    YAW_TRIM,
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
