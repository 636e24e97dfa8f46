"""A ship, a pendulum and an AUV whose actuator and sensor have memory, for simulation."""

from __future__ import annotations

from motion import outputs, states

from oed_sysid import Actuator, Force, Input, Memory, Model, Output, Parameter, Sensor, State

K, T = 0.08, 12.0


def nomoto(
    gain: float = K, time: float = T, *, noise: tuple[float | None, float | None] = (3e-3, 1e-3),
    rudder: str = "rudder", **settings: object,
) -> Model:  # fmt: skip
    """Heading and yaw rate of a ship of Nomoto's first order."""
    return Model(
        "Nomoto",
        states=(State("psi", "rad"), State("r", "rad/s", scale=0.05)),
        inputs=(Input(rudder, "rad"),),
        outputs=(
            Output("psi", "rad", noise_std=noise[0]),
            Output("r", "rad/s", noise_std=noise[1]),
        ),
        kinematics={"psi": "r", "r": f"(K*{rudder} - r)/T"},
        parameters=(Parameter("K", gain, "1/s"), Parameter("T", time, "s", lower=0.1)),
        **settings,  # type: ignore[arg-type]
    )


NOMOTO = nomoto()
PENDULUM = Model(
    "pendulum",
    states=(State("angle", "rad"), State("rate", "rad/s")),
    inputs=(),
    outputs=(Output("angle", "rad"),),
    kinematics={"angle": "rate", "rate": "-4*sin(angle)"},
    step=0.01,
)
# Diving plane of a small AUV; actuator lag and depth-sensor lag have memory.
AUV = Model(
    "AUV",
    states=states("u w q theta z", w=0.1, q=0.1, theta=0.1),
    inputs=(Input("fin", "rad"), Input("thrust", "N")),
    outputs=outputs("q theta z", q=0.004, theta=0.004, z=0.03),
    axes={"X": "u", "Z": "w", "M": "q"},
    inertia={
        **{("X", "u"): "31.4", ("Z", "w"): "66", ("M", "q"): "8.33"},
        **{("Z", "q"): "1.93", ("M", "w"): "1.93"},
    },
    kinematics={"theta": "q", "z": "-u*sin(theta) + w*cos(theta)"},
    actuators={"ds": "fin", "T": "thrust"},
    effects=(
        Force(
            "hull",
            {
                "X": "X_uu*u*abs(u) + T - 30.5*q*w",
                "Z": "30.5*u*q - 40*u*w - 9*u*q - 12*u**2*ds",
                "M": "14*u*w - 9*u*q - 6.15*u**2*ds - 5.9*sin(theta)",
            },
            (Parameter("X_uu", -3.9, "kg/m"),),
        ),
        Actuator(
            "fin_lag",
            {"ds": "ds + (before - ds)*0.3/h*(1 - exp(-h/0.3))"},
            memory=(Memory("before", "ds + (before - ds)*exp(-h/0.3)", "fin"),),
        ),
        Sensor(
            "depth_lag",
            {"z": "lagged"},
            definitions={"lagged": "z + (before - z)*exp(-h/0.5)"},
            memory=(Memory("before", "lagged", "z"),),
        ),
    ),
)
