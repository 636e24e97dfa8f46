"""Nominal model of the motor with an unbalanced load: a plain differential equation."""

from __future__ import annotations

from benchmarks.other_vehicles.models.base import Nominal, force, zero
from oed_sysid import Force, Input, Model, Output, Parameter, State
from oed_sysid.physics import (
    actuator_gain_error,
    actuator_lag,
    actuator_offset,
    backlash,
    deadband,
    rate_limit,
    sensor_bias,
    sensor_lag,
    sensor_scale,
)


def _torque(name: str, term: str, unit: str, scale: float, words: str) -> Force:
    return force(name, {"omega": term}, unit, scale, words)


VISCOUS = Force(
    "viscous_damping",
    {"omega": "-b*omega"},
    (Parameter("b", 0.8, "1/s", -20.0, 20.0, scale=0.5, description="friction over inertia"),),
    description="viscous friction and back electromotive force",
)


def build(declared: bool, lacking: str | None) -> Model:
    """The nominal model."""
    noise = (0.005, 0.03) if declared else (None, None)
    return Model(
        name="motor with an unbalanced load",
        states=(
            State("theta", "rad", "angle"),
            State("omega", "rad/s", "speed"),
        ),
        inputs=(Input("V", "V", "voltage"),),
        outputs=(
            Output("theta", "rad", "angle", noise_std=noise[0]),
            Output("omega", "rad/s", "speed", noise_std=noise[1]),
        ),
        kinematics={"theta": "omega", "omega": "a*V - c*sin(theta)"},
        effects=() if lacking == "viscous_damping" else (VISCOUS,),
        parameters=(
            Parameter("a", 2.5, "rad/s^2/V", 0.0, description="torque over inertia"),
            Parameter("c", 10.0, "1/s^2", 0.0, description="gravity moment over inertia"),
        ),
        step=0.025,
    )


# Dry friction without the jump, as one writes it for a solver of smooth equations.
CANDIDATES = (
    _torque("coulomb_friction", "-tanh(omega/0.02)", "rad/s^2", 0.4, "dry friction"),
    _torque("quadratic_drag", "omega*abs(omega)", "1/rad", 0.1, "drag of a fan"),
    _torque("cubic_damping", "omega**3", "s/rad^2", 0.05, "damping that hardens"),
    _torque("constant_torque", "1", "rad/s^2", 0.5, "constant load"),
    _torque("unbalance", "cos(theta)", "rad/s^2", 0.5, "centre of gravity beside the bar"),
    _torque("cable_spring", "theta", "1/s^2", 0.5, "cable that winds up"),
    _torque("second_harmonic", "sin(2*theta)", "rad/s^2", 0.5, "cogging"),
    _torque("angle_damping", "omega*theta**2", "1/s", 0.2, "friction that grows with the angle"),
    actuator_lag("drive_lag", "V", scale=0.1),
    actuator_offset("drive_offset", "V", "V", scale=0.2),
    zero("drive_zero", "V", "V", scale=0.2),
    rate_limit("drive_rate_limit", "V", "V", scale=0.1),
    deadband("drive_deadband", "V", "V", scale=0.2),
    backlash("drive_backlash", "V", "V", scale=0.2),
    actuator_gain_error("drive_gain", "V", scale=0.1),
    sensor_lag("tacho_lag", "omega", scale=0.05),
    sensor_lag("angle_lag", "theta", scale=0.05),
    sensor_scale("tacho_scale", "omega", scale=0.05),
    sensor_scale("angle_scale", "theta", scale=0.03),
    sensor_bias("bias_theta", "theta", "rad", scale=0.03),
    sensor_bias("bias_omega", "omega", "rad/s", scale=0.05),
)

NOMINAL = Nominal(build, CANDIDATES, {"viscous_damping": VISCOUS})
