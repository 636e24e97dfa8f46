r"""What the model without wind may leave out.

The wind's velocity relative to the ship, :math:`a_x, a_y` in body axes, is made of the
measured wind and the ship's own motion; with :math:`V_A = \sqrt{a_x^2 + a_y^2}`

.. math::
    X &= \tfrac{\rho_A}{2} A_T C_X a_x V_A,\\
    Y &= \tfrac{\rho_A}{2} A_L (C_{Y1} \sin\gamma + C_{Y3} \sin 3\gamma) V_A^2,\\
    N &= \tfrac{\rho_A}{2} A_L L
         (C_{N1} \sin\gamma + \tfrac12 C_{N2} \sin 2\gamma + C_{N3} \sin 3\gamma) V_A^2,

with :math:`\sin\gamma = a_y/V_A`: the terms of Fujiwara's series (Fujiwara, Ueno & Nimura
1998) that these records can tell apart. The plain projected-area formula, a drag coefficient
of one on the area that the wind meets, is :math:`C_X = C_{Y1} = 1` and nothing else.
"""

from __future__ import annotations

from oed_sysid import Actuator, Force, Parameter
from oed_sysid.physics import (
    Effect,
    actuator_lag,
    added_mass_coupling,
    amplitude,
    crossed_drag,
    current_horizontal_plane,
    quadratic_drag,
    rudder_neutral_angle,
    sensor_bias,
    sensor_lag,
    sensor_scale,
)

from .particulars import AIR_DENSITY, DRAUGHT, FRONT_AREA, LENGTH, SIDE_AREA, known

FUJIWARA = (
    "Fujiwara, Ueno & Nimura (1998), Estimation of wind forces and moments acting on ships, "
    "J. Soc. Nav. Archit. Japan 183."
)
FORCE = 0.5 * 1000.0 * LENGTH * DRAUGHT  # prime scale, kg/m

AIR = {
    "a_x": "wind_north*cos(psi) + wind_east*sin(psi) - u",
    "a_y": "-wind_north*sin(psi) + wind_east*cos(psi) - v",
    "V_A": "sqrt(a_x**2 + a_y**2 + 1e-6)",
}
SHIP_IN_AIR = (
    known("rho_air", AIR_DENSITY, "kg/m^3", "density of the air"),
    known("A_front", FRONT_AREA, "m^2", "area seen from ahead, above the water"),
    known("A_side", SIDE_AREA, "m^2", "area seen from abeam, above the water"),
)


def _coefficient(name: str, description: str, scale: float = 0.5) -> Parameter:
    """Wind coefficient, 0 where there is no wind force."""
    return Parameter(
        name,
        0.0,
        "1",
        lower=-3.0,
        upper=3.0,
        prior_mean=0.0,
        prior_std=1.0,
        scale=scale,
        description=description,
    )


WIND = Force(
    "wind",
    {
        "X": "0.5*rho_air*A_front*E_wind_X*a_x*V_A",
        "Y": "0.5*rho_air*A_side*(E_wind_Y1*a_y*V_A + E_wind_Y3*third)",
        "N": "0.5*rho_air*A_side*L*(E_wind_N1*a_y*V_A + E_wind_N2*a_x*a_y + E_wind_N3*third)",
    },
    (
        _coefficient("E_wind_X", "along the ship"),
        _coefficient("E_wind_Y1", "across the ship"),
        _coefficient("E_wind_Y3", "across the ship, third harmonic of the angle", 0.1),
        _coefficient("E_wind_N1", "moment of a wind from abeam", 0.1),
        _coefficient("E_wind_N2", "moment of a wind from the bow or the quarter", 0.1),
        _coefficient("E_wind_N3", "moment, third harmonic of the angle", 0.1),
        *SHIP_IN_AIR,
    ),
    definitions={**AIR, "third": "(3*a_y*V_A**2 - 4*a_y**3)/V_A"},
    description="force of the measured wind on hull and superstructure",
    source=FUJIWARA,
    needs="wind that is not small beside the ship's speed, on several headings",
)
STEADY_PUSH = Force(
    "steady_push",
    {
        "X": "E_steady_push_north*cos(psi) + E_steady_push_east*sin(psi)",
        "Y": "-E_steady_push_north*sin(psi) + E_steady_push_east*cos(psi)",
    },
    (
        amplitude("steady_push_north", "N", scale=0.3),
        amplitude("steady_push_east", "N", scale=0.3),
    ),
    description="steady force from one side, whatever the measured wind says",
    needs="several headings",
)
PROPELLER_LAG = actuator_lag("propeller_lag", "n", scale=0.5)
WAKE_BY_DRIFT = Force(
    "thrust_in_drift",
    {"X": "thrust*E_thrust_in_drift*v*v/(u*u + v*v + slow_square)"},
    (
        amplitude("thrust_in_drift", "1", scale=1.0),
        known("slow_square", 0.01, "m^2/s^2", "keeps the ratio finite at rest"),
    ),
    description="drift moves the propeller out of the hull's wake",
    needs="large drift with the propeller ahead",
)
RUDDER_SCALE = Actuator(
    "rudder_scale",
    {"delta": "delta*(1 + E_rudder_scale)"},
    (amplitude("rudder_scale", "1", scale=0.1),),
    description="the rudder's angle is logged with a wrong scale",
    needs="small and large rudder angles",
)


def effects() -> tuple[Effect, ...]:
    """Candidates, the wind first."""
    return (
        WIND,
        STEADY_PUSH,
        current_horizontal_plane(scale=0.02),
        WAKE_BY_DRIFT,
        quadratic_drag("yaw_crossflow", "N", "r", scale=0.01 * FORCE * LENGTH**3),
        crossed_drag("sway_drift_yaw", "Y", "v", "r", scale=0.1 * FORCE * LENGTH),
        crossed_drag("yaw_drift_yaw", "N", "v", "r", scale=0.1 * FORCE * LENGTH**2),
        added_mass_coupling(
            "sway_yaw_inertia", ("Y", "r"), ("N", "v"), scale=0.01 * FORCE * LENGTH**2
        ),
        rudder_neutral_angle(scale=0.01),
        RUDDER_SCALE,
        actuator_lag("rudder_lag", "delta", scale=0.5),
        PROPELLER_LAG,
        sensor_bias("bias_v", "v", "m/s", scale=0.005),
        sensor_bias("bias_r", "r", "rad/s", scale=0.001),
        sensor_scale("scale_r", "r", scale=0.03),
        sensor_lag("sway_lag", "v", scale=0.5),
    )
