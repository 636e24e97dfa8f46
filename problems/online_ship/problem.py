"""Linear sway and yaw of a tanker, identified sample by sample: Xu, Zou and Yin (2012).

The coefficients are those of the Esso 190 000 dwt tanker, because the paper's
table was not found, see README.md.
"""

from __future__ import annotations

import math

from oed_sysid import (
    Experiment,
    Force,
    Input,
    Limits,
    Model,
    Output,
    Parameter,
    Problem,
    State,
    ZigZag,
)

ESSO = "van Berlekom & Goddard 1972, bis system, linearised at 80 rpm"


def _known(name: str, value: float, unit: str, description: str) -> Parameter:
    return Parameter(name, value, unit, fixed=True, description=description)


def _bis(name: str, value: float, description: str) -> Parameter:
    """Dimensionless coefficient in the bis system, to be identified."""
    return Parameter(name, value, "1", scale=abs(value), description=f"{description}; {ESSO}")


CONSTANTS = (
    _known("L", 304.8, "m", "length"),
    _known("V", 8.23, "m/s", "speed"),
    _known("inertia_Yv", 2.020, "1", "theta_1 = m - Y_vdot"),
    _known("inertia_Yr", 0.0, "1", "theta_2 = m x_G - Y_rdot"),
    _known("inertia_Nv", 0.0, "1", "theta_3 = m x_G - N_vdot"),
    _known("inertia_Nr", 0.1232, "1", "theta_4 = I_z - N_rdot"),
)
# c^2 = 0.605 V n + 38.2 n^2 (n = 80/60 1/s) is the squared flow speed at the rudder.
RACE = (0.605 * 8.23 * (80 / 60) + 38.2 * (80 / 60) ** 2) / 8.23**2

HULL = Force(
    "hull",
    {"Y": "Y_v*v/V + Y_r*L/V*r", "N": "N_v*v/V + N_r*L/V*r"},
    (
        _bis("Y_v", -1.205, "theta_5 = Y_v"),
        _bis("Y_r", -0.752, "theta_6 = Y_r - m"),
        _bis("N_v", -0.451, "theta_7 = N_v"),
        _bis("N_r", -0.231, "theta_8 = N_r - m x_G"),
    ),
    description="linear hull forces, centripetal terms included",
)
RUDDER = Force(
    "rudder",
    {"Y": "Y_delta*delta", "N": "N_delta*delta"},
    (
        _bis("Y_delta", 0.208 * RACE, "theta_9 = Y_delta"),
        _bis("N_delta", -0.098 * RACE, "theta_10 = N_delta"),
    ),
    description="rudder force; a positive angle turns to port",
)

model = Model(
    name="tanker, linear sway and yaw",
    states=(
        State("v", "m/s", "sway velocity", scale=0.1),
        State("r", "rad/s", "yaw rate", scale=1e-3),
        State("psi", "rad", "heading", scale=0.1),
    ),
    inputs=(Input("delta", "rad", "rudder angle", interpolation="linear"),),
    outputs=(
        Output("v", "m/s", "sway velocity", noise_std=0.005),
        Output("r", "rad/s", "yaw rate", noise_std=math.radians(0.002)),
        Output("psi", "rad", "heading", noise_std=math.radians(0.1)),
    ),
    # The equations are those of the source: dimensionless, time in seconds.
    axes={"Y": "v", "N": "r"},
    inertia={
        ("Y", "v"): "L/V**2*inertia_Yv",
        ("Y", "r"): "L**2/V**2*inertia_Yr",
        ("N", "v"): "L/V**2*inertia_Nv",
        ("N", "r"): "L**2/V**2*inertia_Nr",
    },
    kinematics={"psi": "r"},
    effects=(HULL, RUDDER),
    parameters=CONSTANTS,
    step=3.0,
)

LIMITS = Limits(
    inputs={"delta": (-math.radians(35.0), math.radians(35.0))},
    rates={"delta": math.radians(2.33)},
)


def _zigzag(degrees: float, duration: float) -> Experiment:
    angle = math.radians(degrees)
    return Experiment(
        f"zigzag_{degrees:g}_{degrees:g}",
        ZigZag("delta", angle, angle, rate=math.radians(2.33), sign=-1),
        duration=duration,
        sample_time=3.0,
        feedback="true",
        limits=LIMITS,
    )


problem = Problem(
    name="online_ship",
    title="Linear sway and yaw of a tanker, on line",
    model=model,
    experiments={"zigzag_5_5": _zigzag(5.0, 600.0), "zigzag_10_10": _zigzag(10.0, 900.0)},
    limits=LIMITS,
    truth={p.name: p.value for p in model.free_parameters},
    published={"samples": 200, "sample_time_s": 3.0, "C": 3e5, "start_samples": 2},
    references=(
        "Xu F, Zou ZJ, Yin JC 2012, On-line identification of ship manoeuvring by incremental "
        "LS-SVM, J. Ship Mechanics 16(3)",
        "Astrom KJ, Kallstrom CG 1976, Identification of ship steering dynamics, Automatica 12",
        "van Berlekom WB, Goddard TA 1972, Maneuvering of large tankers, SNAME Trans. 80",
    ),
    description=(
        "Six coefficients that grow more certain with every sample, at a cost per sample that a "
        "vehicle's computer can pay."
    ),
)
