"""A ship, a pendulum and an AUV whose actuator and sensor have memory, for simulation."""

from __future__ import annotations

from dataclasses import replace

from motion import outputs, small
from vehicles import remus

from oed_sysid import Input, Model, Parameter
from oed_sysid.physics import actuator_lag, sensor_lag

K, T = 0.08, 12.0


def nomoto(
    gain: float = K, time: float = T, *, noise: tuple[float | None, float | None] = (3e-3, 1e-3),
    rudder: str = "rudder", **settings: object,
) -> Model:  # fmt: skip
    """Heading and yaw rate of a ship of Nomoto's first order."""
    return small(
        "Nomoto",
        f"psi [rad], r [rad/s] <- {rudder} [rad]",
        {"psi": "r", "r": f"(K*{rudder} - r)/T"},
        [Parameter("K", gain, "1/s"), Parameter("T", time, "s", lower=0.1)],
        {"psi": noise[0], "r": noise[1]},
        scales={"r": 0.05},
        **settings,
    )


NOMOTO = nomoto()
LAW = {"angle": "rate", "rate": "-4*sin(angle)"}
PENDULUM = small("pendulum", "angle [rad], rate [rad/s]", LAW, noise={"angle": None}, step=0.01)
# Diving plane of an AUV, one parameter free; actuator lag and depth-sensor lag have memory.
AUV = replace(
    remus() + actuator_lag("fin_lag", "ds", value=0.3) + sensor_lag("depth_lag", "z", value=0.5),
    name="AUV",
    inputs=(Input("fin", "rad"), Input("thrust", "N")),
    actuators={"ds": "fin", "T": "thrust"},
    outputs=outputs("q theta z", q=0.004, theta=0.004, z=0.03),
)
AUV = AUV.fix(*(name for name in AUV.free_names if name != "X_absuu"))
