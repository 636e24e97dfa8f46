"""Nominal model of the motor with an unbalanced load: a plain differential equation."""

from __future__ import annotations

from benchmarks.other_vehicles.models.base import Nominal, candidates
from oed_sysid import Force, Input, Model, Output, Parameter, State

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


NOMINAL = Nominal(build, candidates("motor"), {"viscous_damping": VISCOUS})
