r"""The tanker in surge, sway and yaw: the MMG standard model.

Yasukawa & Yoshimura (2015), J. Mar. Sci. Technol. 20, 37-52 [1]; midship is the
origin. Hull coefficients are those of [1], made dimensionless by
:math:`\frac\rho2 L d U^2` and :math:`\frac\rho2 L^2 d U^2`. The published values
are the means of the priors; their spread of about 30 per cent is what different
basins and different ways of analysis differ by.

The rudder angle is positive with its trailing edge to port, as in the records;
[1] counts it the other way.
"""

from __future__ import annotations

import math

from oed_sysid import Force, Input, Model, Output, Parameter, State

from .particulars import PROPELLER, RUDDER, SHIP, known

SOURCE = "Yasukawa & Yoshimura (2015), Introduction of MMG standard method, J. Mar. Sci. Tech. 20."


def believed(
    name: str, value: float, spread: float, description: str, *, unit: str = "1"
) -> Parameter:
    """Return a published value that the data may correct."""
    return Parameter(
        name,
        value,
        unit,
        prior_mean=value,
        prior_std=spread,
        scale=max(abs(value), spread),
        description=description,
    )


ADDED_MASS = (
    known("m_x_prime", 0.022, "1", "surge added mass"),
    believed("m_y_prime", 0.223, 0.022, "sway added mass"),
    known("J_z_prime", 0.011, "1", "yaw added inertia"),
)
RESISTANCE = (
    believed("R_0_prime", 0.018, 0.004, "resistance; [1] has 0.022 for another propeller"),
    believed("X_vv_prime", -0.040, 0.06, "drag of drift"),
    believed("X_vr_prime", 0.002, 0.05, "drag of drift and yaw"),
    believed("X_rr_prime", 0.011, 0.02, "drag of yaw"),
)
LINEAR_HULL = (
    believed("Y_v_prime", -0.315, 0.095, "side force of drift"),
    believed("Y_r_prime", 0.083, 0.030, "side force of yaw"),
    believed("N_v_prime", -0.137, 0.041, "Munk moment"),
    believed("N_r_prime", -0.049, 0.015, "yaw damping"),
)
CUBIC_HULL = (
    believed("Y_vvv_prime", -1.607, 0.8, "side force"),
    believed("Y_vvr_prime", 0.379, 0.4, "side force"),
    believed("Y_vrr_prime", -0.391, 0.3, "side force"),
    believed("Y_rrr_prime", 0.008, 0.03, "side force"),
    believed("N_vvv_prime", -0.030, 0.2, "yaw moment"),
    believed("N_vvr_prime", -0.294, 0.15, "yaw moment"),
    believed("N_vrr_prime", 0.055, 0.06, "yaw moment"),
    believed("N_rrr_prime", -0.013, 0.012, "yaw moment"),
)
PROPULSION = (
    believed("t_P", 0.22, 0.05, "thrust deduction"),
    # 45 N soon after the release at 1.17 m/s, with the open-water curve; [1]: 0.40.
    known("w_P0", 0.46, "1", "wake fraction on a straight course"),
    known("x_P_prime", -0.48, "1", "propeller, in lengths"),
)
STEERING = (
    believed("t_R", 0.387, 0.08, "steering resistance deduction"),
    believed("a_H", 0.312, 0.06, "rudder force increase by the hull"),
    known("x_H_prime", -0.464, "1", "where this increase acts"),
    believed("gamma_R0", 0.52, 0.15, "flow straightening; [1]: 0.395 and 0.640, by side"),
    believed("l_R_prime", -0.710, 0.10, "effective place of the rudder in yaw"),
    believed("epsilon", 1.09, 0.15, "wake at the rudder to wake at the propeller"),
    known("kappa", 0.50, "1", "acceleration by the propeller"),
    known("f_alpha", 2.747, "1", "lift slope of the rudder"),
)

SIGNALS = {
    "U": "sqrt(u*u + v*v)",
    "Q": "0.5*rho*L*d",
    "beta": "atan2(-v, u)",
    "r_n": "r*L/U",
    "beta_P": "beta - x_P_prime*r_n",
    "u_P": "u*(1 - w_P0)",
    "J": "u_P/(n_P*D_P)",
    "thrust": "rho*n_P**2*D_P**4*(k_0 + k_1*J + k_2*J*J)",
    # The rudder's inflow starts from the wake of the straight course: with the wake that the
    # measured thrust shows in a turn, the yaw moment of these runs is explained less well.
    "u_W": "u*(1 - w_P0)",
    "J_W": "u_W/(n_P*D_P)",
    "K_W": "k_0 + k_1*J_W + k_2*J_W*J_W",
    "beta_R": "beta - l_R_prime*r_n",
    "gamma_R": "gamma_R0",
    "v_R": "U*gamma_R*beta_R",
    "eta": "D_P/H_R",
    "race": f"1 + kappa*(sqrt(1 + {8 / math.pi:.9f}*K_W/(J_W*J_W)) - 1)",
    "u_R": "epsilon*u_W*sqrt(eta*race*race + 1 - eta)",
    "alpha_R": "-delta - atan2(v_R, u_R)",
    "lift": "f_alpha*sin(alpha_R)",
    "F_N": "0.5*rho*A_R*(u_R*u_R + v_R*v_R)*lift",
}

RIGID_BODY = Force(
    "rigid_body",
    {
        "X": "(m + Q*L*m_y_prime)*v*r + m*x_G*r*r",
        "Y": "-(m + Q*L*m_x_prime)*u*r",
        "N": "-m*x_G*u*r",
    },
    description="centripetal terms of mass and added mass",
    source=SOURCE,
)
HULL = Force(
    "hull",
    {
        "X": "Q*(-R_0_prime*u*u + X_vv_prime*v*v + X_vr_prime*L*v*r + X_rr_prime*L*L*r*r)",
        "Y": "Q*U*(Y_v_prime*v + Y_r_prime*L*r)",
        "N": "Q*L*U*(N_v_prime*v + N_r_prime*L*r)",
    },
    (*RESISTANCE, *LINEAR_HULL),
    amplitudes=(),
    description="resistance, drag in a turn, linear lift of the hull",
    source=SOURCE,
)


def _cubic(axis: str) -> str:
    terms = {"vvv": "v**3", "vvr": "L*v*v*r", "vrr": "L*L*v*r*r", "rrr": "L**3*r**3"}
    total = " + ".join(f"{axis}_{name}_prime*{term}" for name, term in terms.items())
    return f"({total})/U"


HULL_CUBIC = Force(
    "hull_cubic",
    {"Y": f"Q*{_cubic('Y')}", "N": f"Q*L*{_cubic('N')}"},
    CUBIC_HULL,
    description="third-order lift and cross-flow of the hull",
    source=SOURCE,
    needs="large drift and yaw rate",
)
PROPELLER_FORCE = Force(
    "propeller", {"X": "(1 - t_P)*thrust"}, PROPULSION, amplitudes=(), source=SOURCE
)
RUDDER_FORCE = Force(
    "rudder",
    {
        "X": "(1 - t_R)*F_N*sin(delta)",
        "Y": "-(1 + a_H)*F_N*cos(delta)",
        "N": "-(x_R + a_H*x_H_prime*L)*F_N*cos(delta)",
    },
    STEERING,
    amplitudes=(),
    description="rudder in the wake and in the propeller slipstream",
    source=SOURCE,
)

# How far a rigid body in three degrees of freedom is believed, not the sensors' noise,
# which is ten times smaller: it sets the weight of the data against the priors.
OUTPUTS = (
    Output("u", "m/s", "surge velocity", noise_std=0.0075, column="u_mps_derived"),
    Output("v", "m/s", "sway velocity", noise_std=0.009, column="v_mps_derived"),
    Output("r", "rad/s", "yaw rate", noise_std=0.00225),
    Output("psi", "rad", "heading", noise_std=0.015),
)
MMG = Model(
    name="MMG standard model",
    states=(
        State("u", "m/s", "surge velocity"),
        State("v", "m/s", "sway velocity", scale=0.1),
        State("r", "rad/s", "yaw rate", scale=0.05),
        State("psi", "rad", "heading", scale=0.3),
    ),
    inputs=(Input("delta", "rad", "measured rudder angle", interpolation="linear"),),
    outputs=OUTPUTS,
    axes={"X": "u", "Y": "v", "N": "r"},
    inertia={
        ("X", "u"): "m + 0.5*rho*L**2*d*m_x_prime",
        ("Y", "v"): "m + 0.5*rho*L**2*d*m_y_prime",
        ("Y", "r"): "m*x_G",
        ("N", "v"): "m*x_G",
        ("N", "r"): "I_z + m*x_G**2 + 0.5*rho*L**4*d*J_z_prime",
    },
    kinematics={"psi": "r"},
    signals=SIGNALS,
    effects=(RIGID_BODY, HULL, HULL_CUBIC, PROPELLER_FORCE, RUDDER_FORCE),
    parameters=(*SHIP, *PROPELLER, *RUDDER, *ADDED_MASS),
    step=0.5,
)
