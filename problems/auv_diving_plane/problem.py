"""AUV in the diving plane, identified by LS-SVM: Xu, Zou, Yin and Cao (2012).

Gertler-Hagen equations in prime coefficients; the numbers stand in for the
paper's lost tables, see README.md.
"""

from __future__ import annotations

import math
from dataclasses import replace

from oed_sysid import Experiment, Force, Input, Limits, Model, Output, Parameter, Problem, State
from oed_sysid.manoeuvres import ZigZagLike

GRAVITY = 9.81  # m/s2, turns the stated weight into a mass

NPS = "Healey & Lienard 1993, NPS AUV II"
DERIVED = "from the cross-flow drag coefficient of NPS AUV II"
ASSUMED = "assumed"


def _known(name: str, value: float, unit: str, description: str) -> Parameter:
    return Parameter(name, value, unit, fixed=True, description=description)


def _prime(name: str, value: float, source: str) -> Parameter:
    """Dimensionless coefficient to be identified; the published tables are in 1e-3."""
    return Parameter(name, value, "1", scale=abs(value), description=source)


CONSTANTS = (
    _known("rho", 1025.0, "kg/m^3", "density of sea water"),
    _known("L", 5.3, "m", "length"),
    _known("m", 53_400.0 / GRAVITY, "kg", "mass, weight equals buoyancy"),
    _known("I_yy", 13_587.0, "kg m^2", "pitch moment of inertia"),
    _known("X_udot_prime", -7.6e-3, "1", "known inertial derivative"),
    _known("Z_wdot_prime", -2.4e-1, "1", "known inertial derivative"),
    _known("Z_qdot_prime", -6.8e-3, "1", "known inertial derivative"),
    _known("M_wdot_prime", -6.8e-3, "1", "known inertial derivative"),
    _known("M_qdot_prime", -1.7e-2, "1", "known inertial derivative"),
)

RIGID_BODY = Force(
    "rigid_body", {"X": "-m*w*q", "Z": "m*u*q"}, description="centripetal terms of the rigid body"
)
SURGE = Force(
    "surge",
    {
        "X": "rho/2*L**4*X_qq_prime*q**2 + rho/2*L**3*X_wq_prime*w*q"
        " + rho/2*L**2*(X_uu_prime*u**2 + X_ww_prime*w**2)"
    },
    (
        _prime("X_uu_prime", -3.85e-3, NPS),
        _prime("X_qq_prime", -1.5e-2, NPS),
        _prime("X_wq_prime", -2.0e-1, NPS),
        _prime("X_ww_prime", 1.7e-1, NPS),
    ),
    description="axial drag",
)
HEAVE = Force(
    "heave",
    {
        "Z": "rho/2*L**3*(Z_uq_prime*u*q + Z_wabsq_prime*w*abs(q))"
        " + rho/2*L**2*(Z_uu_prime*u**2 + Z_uw_prime*u*w + Z_uabsw_prime*u*abs(w)"
        " + Z_absww_prime*w*abs(w) + Z_uuds_prime*u**2*delta_s)"
    },
    (
        _prime("Z_uu_prime", -1.0e-3, ASSUMED),
        _prime("Z_uw_prime", -3.0e-1, NPS),
        _prime("Z_uabsw_prime", -5.0e-3, ASSUMED),
        _prime("Z_absww_prime", -6.0e-2, DERIVED),
        _prime("Z_uq_prime", -1.4e-1, NPS),
        _prime("Z_wabsq_prime", -2.0e-2, ASSUMED),
        _prime("Z_uuds_prime", -7.3e-2, NPS),
    ),
    description="heave force of hull and stern planes",
)
PITCH = Force(
    "pitch",
    {
        "M": "rho/2*L**4*M_uq_prime*u*q"
        " + rho/2*L**3*(M_uu_prime*u**2 + M_uw_prime*u*w + M_uabsw_prime*u*abs(w)"
        " + M_absww_prime*w*abs(w) + M_uuds_prime*u**2*delta_s)"
    },
    (
        _prime("M_uu_prime", 2.0e-4, ASSUMED),
        _prime("M_uw_prime", 1.0e-1, NPS),
        _prime("M_uabsw_prime", -2.0e-3, ASSUMED),
        _prime("M_absww_prime", -4.0e-3, ASSUMED),
        _prime("M_uq_prime", -6.8e-2, NPS),
        _prime("M_uuds_prime", -4.1e-2, NPS),
    ),
    description="pitch moment of hull and stern planes",
)
# z_B B = -0.061 m * 53 400 N, made dimensionless by rho/2 L^3 as the other terms of its equation.
RESTORING = Force(
    "restoring",
    {"M": "rho/2*L**3*z_BB_prime*sin(theta)"},
    # Not divided by a speed, unlike the hydrodynamic coefficients.
    (
        replace(
            _prime("z_BB_prime", -0.061 * 53_400.0 / (0.5 * 1025.0 * 5.3**3), NPS), unit="m^2/s^2"
        ),
    ),
    description="centre of buoyancy above that of gravity",
)
THRUST = Force(
    "thrust",
    {"X": "X_T"},
    (Parameter("X_T", 120.0, "N", description="constant thrust, as stated in the paper"),),
    description="constant thrust, the bias of the surge regression",
)

model = Model(
    name="AUV in the diving plane (Gertler-Hagen)",
    states=(
        State("u", "m/s", "surge velocity"),
        State("w", "m/s", "heave velocity", scale=0.01),
        State("q", "rad/s", "pitch rate", scale=0.01),
        State("theta", "rad", "pitch angle", scale=0.1),
        State("x", "m", "advance", scale=100.0),
        State("z", "m", "depth", scale=100.0),
    ),
    inputs=(Input("delta_s", "rad", "stern plane angle", interpolation="linear"),),
    outputs=(
        Output("u", "m/s", "surge velocity", noise_std=0.005),
        Output("w", "m/s", "heave velocity", noise_std=0.001),
        Output("q", "rad/s", "pitch rate", noise_std=2e-4),
        Output("theta", "rad", "pitch angle", noise_std=1e-3),
        Output("x", "m", "advance", noise_std=0.5),
        Output("z", "m", "depth", noise_std=0.02),
    ),
    axes={"X": "u", "Z": "w", "M": "q"},
    inertia={
        ("X", "u"): "m - rho/2*L**3*X_udot_prime",
        ("Z", "w"): "m - rho/2*L**3*Z_wdot_prime",
        ("Z", "q"): "-rho/2*L**4*Z_qdot_prime",
        ("M", "w"): "-rho/2*L**4*M_wdot_prime",
        ("M", "q"): "I_yy - rho/2*L**5*M_qdot_prime",
    },
    kinematics={
        "theta": "q",
        "x": "u*cos(theta) + w*sin(theta)",
        "z": "-u*sin(theta) + w*cos(theta)",
    },
    effects=(RIGID_BODY, SURGE, HEAVE, PITCH, RESTORING, THRUST),
    parameters=CONSTANTS,
    step=0.5,
)

FIN = math.radians(5.0)
FIN_RATE = math.radians(2.5)
SWITCH = math.radians(5.0)  # assumed: the paper does not say where the fin reverses
LIMITS = Limits(inputs={"delta_s": (-FIN, FIN)}, rates={"delta_s": FIN_RATE})

# 240 steps of 0.5 s from rest at 100 m depth; a positive fin lowers the bow.
ZIGZAG = Experiment(
    "zigzag_5_5",
    ZigZagLike("delta_s", FIN, SWITCH, rate=FIN_RATE),
    duration=120.0,
    sample_time=0.5,
    initial={"z": 100.0},
    feedback="true",
    limits=LIMITS,
)

# Coefficients that the data hardly show: the paper's conclusion, and ours (README.md).
INSENSITIVE = ("M_absww_prime", "Z_wabsq_prime", "Z_absww_prime", "M_uabsw_prime")

problem = Problem(
    name="auv_diving_plane",
    title="AUV in the diving plane, by LS-SVM",
    model=model,
    experiments={"zigzag_5_5": ZIGZAG},
    limits=LIMITS,
    truth={p.name: p.value for p in model.free_parameters},
    models={"reduced": model.with_values(dict.fromkeys(INSENSITIVE, 0.0)).fix(*INSENSITIVE)},
    published={
        "samples": 240,
        "sample_time_s": 0.5,
        "C": 3e4,
        "coefficients_with_error_above_5_percent": 2,
    },
    references=(
        "Xu F, Zou ZJ, Yin JC, Cao J 2012, Parametric identification and sensitivity analysis for "
        "autonomous underwater vehicles in diving plane, J. Hydrodynamics 24(5), "
        "doi 10.1016/S1001-6058(11)60299-0",
        "Healey & Lienard 1993, Multivariable sliding mode control for autonomous diving and "
        "steering of unmanned underwater vehicles, IEEE J. Oceanic Eng. 18(3) (numbers)",
        "Gertler & Hagen 1967, Standard equations of motion for submarine simulation, NSRDC 2510",
        "Perez & Blanke 2002, Mathematical ship modeling for control applications (sensitivity)",
    ),
    description=(
        "Identify 18 hydrodynamic coefficients from a noise-free zigzag, see which of them the "
        "data hold at all, and drop those that they do not."
    ),
)
