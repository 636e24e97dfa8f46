"""Unmanned sailboat in surge, sway, roll and yaw, by Bayesian regression: Chen, Deng and Xu (2023).

The dimensions are the paper's; its force curves are lost and stand-ins are used,
see README.md.
"""

from __future__ import annotations

import math

from oed_sysid import (
    Combined,
    Experiment,
    Force,
    Input,
    Limits,
    Model,
    Output,
    Parameter,
    Piecewise,
    Problem,
    State,
    ZigZag,
)
from oed_sysid.physics import hull_derivatives

GRAVITY = 9.81  # m/s2


def _known(name: str, value: float, unit: str, description: str) -> Parameter:
    return Parameter(name, value, unit, fixed=True, description=description)


CONSTANTS = (
    _known("m", 27.7, "kg", "mass, from the stated displacement and sway added mass"),
    _known("m_x", 1.719, "kg", "surge added mass, as stated"),
    _known("m_y", 18.910, "kg", "sway added mass, as stated"),
    _known("I_zz_total", 5.593, "kg m^2", "Izz + Jzz, as stated"),
    _known("I_xx_total", 0.709, "kg m^2", "Ixx + Jxx, as stated"),
    _known("GM", 0.20, "m", "metacentric height, assumed"),
    _known("g", GRAVITY, "m/s^2", "gravity"),
    _known("rho_a", 1.225, "kg/m^3", "density of air"),
    _known("rho_w", 1025.0, "kg/m^3", "density of sea water"),
    _known("A_s", 0.512, "m^2", "sail area, of a like boat"),
    _known("z_s", -0.85, "m", "centre of effort, above the origin"),
    _known("x_m", 0.10, "m", "mast ahead of the origin"),
    _known("A_r", 2 * 0.0162, "m^2", "area of both rudders, of a like boat"),
    _known("x_r", -0.60, "m", "rudders behind the origin"),
    _known("z_r", 0.05, "m", "centre of the rudders below the origin"),
    _known("tilt", math.radians(30.0), "rad", "inclination of the twin rudders"),
)

RIGID_BODY = Force(
    "rigid_body",
    {"X": "(m + m_y)*v*r", "Y": "-(m + m_x)*u*r"},
    description="centripetal terms, added masses included, as in the source",
)
RESTORING = Force(
    "restoring",
    {"K": "-m*g*GM*sin(phi)"},
    description="righting moment; missing in the readable part of the source",
)
# Attached flow of a wing of finite aspect ratio goes over into that of a flat plate.
SAIL = Force(
    "sail",
    {
        "X": "thrust",
        "Y": "side",
        "K": "-z_s*side",
        "N": "x_m*side + z_s*sin(phi)*thrust",
    },
    definitions={
        "bearing": "wind_from - psi",
        "air_x": "-wind_speed*cos(bearing) - u",
        "air_y": "(-wind_speed*sin(bearing) - (v - p*z_s))*cos(phi)",
        "wind_angle": "atan2(-air_y, -air_x)",
        # The boom swings across while the wind passes the last ten degrees to dead astern. A boom
        # that jumped would make the trajectory depend on the integration step.
        "swing": "tanh((3.14159265358979 - abs(wind_angle))/0.175)",
        "trim": "sign(wind_angle)*min(sheet, abs(wind_angle))*swing",
        "attack": "wind_angle - trim",
        "stalled": "1 - exp(-(attack/0.436)**2)",
        "lift": "(1 - stalled)*3.49*attack + stalled*1.1*sin(2*attack)",
        "drag": "0.015 + (1 - stalled)*lift**2/7.85 + stalled*1.8*sin(attack)**2",
        "push": "rho_a/2*A_s*(air_x**2 + air_y**2)*cos(phi)",
        "thrust": "push*(lift*sin(wind_angle) - drag*cos(wind_angle))",
        "side": "-push*(lift*cos(wind_angle) + drag*sin(wind_angle))",
    },
    description="wing sail whose angle is limited by the sheet",
    source="thin wing of aspect ratio 2.5 and flat plate, joined at 25 degrees",
)
RUDDERS = Force(
    "rudders",
    {
        "X": "press*(lift*cos(tilt)*sin(drift) - drag*cos(drift))",
        "Y": "side",
        "K": "-z_r*side",
        "N": "x_r*side",
    },
    definitions={
        "across": "v + x_r*r - p*z_r",
        "drift": "atan2(across, u)",
        "attack": "delta - cos(tilt)*drift",
        "stalled": "1 - exp(-(attack/0.436)**2)",
        "lift": "(1 - stalled)*3.9*attack + stalled*1.1*sin(2*attack)",
        "drag": "0.01 + (1 - stalled)*lift**2/9.4 + stalled*1.8*sin(attack)**2",
        "press": "rho_w/2*A_r*(u**2 + across**2)",
        "side": "-press*(lift*cos(tilt)*cos(drift) + drag*sin(drift))",
    },
    description="inclined twin rudders",
    source="thin wing of aspect ratio 3 and flat plate, joined at 25 degrees",
)

# Term counts 8, 10, 10, 10; X_absuu, collinear with X_uu for u > 0, is left out.
DERIVATIVES = {
    "X_u": -0.2, "X_uu": -2.8, "X_vv": 40.0, "X_rr": -0.5,
    "X_pp": -0.3, "X_vr": -4.0, "X_vp": -1.0, "X_rp": 0.5,
    "Y_v": -75.0, "Y_r": 6.0, "Y_p": 10.0, "Y_absvv": -560.0, "Y_absrr": -4.0,
    "Y_abspp": -2.0, "Y_vabsr": -30.0, "Y_absvr": -20.0, "Y_vabsp": -10.0, "Y_absvp": 50.0,
    "N_v": -6.2, "N_r": -6.0, "N_p": 0.3, "N_absvv": -42.0, "N_absrr": -7.0,
    "N_abspp": -0.1, "N_vabsr": -5.0, "N_absvr": -12.0, "N_rabsp": -0.5, "N_absrp": 0.3,
    "K_v": -3.5, "K_r": -0.2, "K_p": -9.0, "K_absvv": -22.0, "K_absrr": 0.5,
    "K_abspp": -1.5, "K_pabsr": -1.0, "K_abspr": -0.7, "K_pabsv": -60.0, "K_abspv": -2.0,
}  # fmt: skip
HULL = hull_derivatives(
    "hull",
    [Parameter(name, value, scale=abs(value)) for name, value in DERIVATIVES.items()],
    symbols={},
    source="Chen, Deng & Xu 2023, eq. (2), form; numbers rounded from a like boat or assumed",
)

model = Model(
    name="unmanned sailboat, 4 degrees of freedom",
    states=(
        State("u", "m/s", "surge velocity"),
        State("v", "m/s", "sway velocity", scale=0.1),
        State("p", "rad/s", "roll rate", scale=0.2),
        State("r", "rad/s", "yaw rate", scale=0.2),
        State("phi", "rad", "heel", scale=0.1),
        State("psi", "rad", "heading"),
    ),
    inputs=(
        Input("delta", "rad", "rudder angle"),
        Input("sheet", "rad", "largest sail angle"),
        Input("wind_speed", "m/s", "true wind speed", interpolation="linear"),
        Input("wind_from", "rad", "direction that the true wind comes from"),
    ),
    outputs=(
        Output("u", "m/s", "surge velocity", noise_std=0.01),
        Output("v", "m/s", "sway velocity", noise_std=0.01),
        Output("p", "rad/s", "roll rate", noise_std=0.005),
        Output("r", "rad/s", "yaw rate", noise_std=0.005),
        Output("phi", "rad", "heel", noise_std=0.005),
        Output("psi", "rad", "heading", noise_std=0.01),
    ),
    axes={"X": "u", "Y": "v", "K": "p", "N": "r"},
    inertia={
        ("X", "u"): "m + m_x",
        ("Y", "v"): "m + m_y",
        ("K", "p"): "I_xx_total",
        ("N", "r"): "I_zz_total",
    },
    kinematics={"phi": "p", "psi": "r*cos(phi)"},
    effects=(RIGID_BODY, HULL, RUDDERS, SAIL, RESTORING),
    parameters=CONSTANTS,
    step=0.05,
)

LIMITS = Limits(
    inputs={
        "delta": (-math.radians(35.0), math.radians(35.0)),
        "sheet": (0.0, math.radians(90.0)),
        "wind_speed": (0.0, 12.0),
    },
    signals={"phi": (-math.radians(60.0), math.radians(60.0))},
)


def _zigzag(name: str, heading: float, rudder: float, switch: float, seed: int) -> Experiment:
    """Rudder zigzag about a course, sheet and wind changing; wind from north."""
    gusts = (3.0, 5.0, 7.0, 4.0, 6.0, 3.5, 6.5, 5.0)
    shift = seed % len(gusts)
    return Experiment(
        name,
        Combined(
            (
                ZigZag("delta", math.radians(rudder), math.radians(switch)),
                Piecewise(
                    "sheet",
                    tuple(5.0 * i for i in range(21)),
                    tuple(math.radians(20.0 + (37 * (i + seed)) % 60) for i in range(21)),
                ),
                Piecewise(
                    "wind_speed",
                    tuple(15.0 * i for i in range(len(gusts))),
                    gusts[shift:] + gusts[:shift],
                    interpolation="linear",
                ),
            )
        ),
        duration=105.0,
        sample_time=0.2,
        constants={"wind_from": 0.0},
        initial={"u": 0.8, "psi": math.radians(heading)},
        feedback="true",
        limits=LIMITS,
    )


problem = Problem(
    name="sailboat",
    title="Unmanned sailboat, by Bayesian regression",
    model=model,
    experiments={
        "reach_20_20": _zigzag("reach_20_20", 100.0, 20.0, 20.0, 1),
        "beat_30_25": _zigzag("beat_30_25", -75.0, 30.0, 25.0, 2),
        "run_30_30": _zigzag("run_30_30", 150.0, 30.0, 30.0, 3),
        "broad_15_30": _zigzag("broad_15_30", -125.0, 15.0, 30.0, 4),
    },
    limits=LIMITS,
    truth={p.name: p.value for p in model.free_parameters},
    references=(
        "Chen Y, Deng D, Xu J 2023, Ship Engineering 45(2), doi 10.13788/j.cnki.cbgc.2023.02.11",
        "Gelman A et al. 2013, Bayesian data analysis, 3rd ed. (Gibbs sampling)",
    ),
    description=(
        "38 hull derivatives of a sailboat from measured accelerations, with their posterior, by "
        "Gibbs sampling."
    ),
)
