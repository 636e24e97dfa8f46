r"""The tanker in surge, sway and yaw, from full ahead to full astern.

Midship is the origin, :math:`Q = \frac\rho2 L d`:

.. math::
    (m + m_x)\dot u - (m + m_y) v r - m x_G r^2 &= X_H + X_P + X_R\\
    (m + m_y)\dot v + m x_G \dot r + (m + m_x) u r &= Y_H + Y_P + Y_R\\
    (I_z + m x_G^2 + J_z)\dot r + m x_G(\dot v + u r) &= N_H + N_P + N_R

The hull's forces are the linear ones of a wing with :math:`|u|` for the speed, so that they
hold astern, and the cross-flow drag of strips along the length, which stays when the ship
turns on the spot (Yoshimura, Nakao & Ishibashi 2009, MARSIM). Thrust ahead is
:math:`\rho(D^4 k_0 n^2 + D^3 k_1 n u_P)`, which has no division by the revolutions; astern
the propeller slipstream meets the stern and pushes it sideways. The rudder's normal force
:math:`\frac\rho2 A_R f_\alpha V_R (u_R\sin\delta - v_R\cos\delta)` is Fujii's with the
angle of attack written out: it holds for flow from any side.

A positive rudder turns to starboard here, unlike in the KVLCC2 records.
"""

from __future__ import annotations

import math

import numpy as np

from oed_sysid import Force, Input, Model, Output, State

from .particulars import HULL, INERTIA, PROPELLER, RUDDER, SHIP

YOSHIMURA = "Yoshimura, Nakao & Ishibashi (2009), Unified mathematical model, MARSIM."
YASUKAWA = "Yasukawa & Yoshimura (2015), J. Mar. Sci. Technol. 20, 37-52."
MIYAUCHI = "Miyauchi et al. (2022), J. Mar. Sci. Technol. 27, 1065-1083."


def _strips(factor: str, moment: bool) -> str:
    """Integral of |v + c r x| (v + c r x) over x/L, or of that times x/L, by five Gauss points."""
    places, weights = np.polynomial.legendre.leggauss(5)
    terms = []
    for place, weight in zip(0.5 * places, 0.5 * weights, strict=True):
        flow = f"(v_r + {factor}*r*L*({place:.9f}))"
        arm = f"*({place:.9f})" if moment else ""
        terms.append(f"{weight:.9f}*{flow}*sqrt({flow}**2 + 1e-8){arm}")
    return "(" + " + ".join(terms) + ")"


SIGNALS = {
    "Q": "0.5*rho*L*d",
    # Velocity through the water; a current changes these two.
    "u_r": "u",
    "v_r": "v",
    "n_ahead": "max(n, 0)",
    "n_astern": "max(-n, 0)",
    "u_P": "u_r*(1 - w_P)",
    "thrust": "rho*D_P**3*n_ahead*(k_0*D_P*n_ahead + k_1*u_P)",
    # Slipstream far behind the propeller, from momentum theory, squared.
    "jet": f"max(u_P**2 + {8 / math.pi:.9f}*thrust/(rho*D_P**2), 0)",
    "u_W": "epsilon*u_P",
    "u_J": "epsilon*(u_P + kappa*(sqrt(jet + 1e-6) - sqrt(u_P**2 + 1e-6)))",
    # The slipstream reaches the rudder when the propeller turns ahead and the ship moves ahead.
    "u_R": "u_W*(n_ahead <= 0) + sqrt(eta*u_J**2 + (1 - eta)*u_W**2 + 1e-6)*(n_ahead > 0)",
    "across": "v_r + l_R_prime*L*r",
    "v_R": "-gamma_R*across*(1 - gamma_side*tanh(across/v_side))",
    "V_R": "sqrt(u_R**2 + v_R**2)",
    "F_N": "0.5*rho*A_R*f_alpha*V_R*(u_R*sin(delta) - v_R*cos(delta))",
}

RIGID_BODY = Force(
    "rigid_body",
    {
        "X": "(m + Q*L*m_y_prime)*v*r + m*x_G*r*r",
        "Y": "-(m + Q*L*m_x_prime)*u*r",
        "N": "-m*x_G*u*r",
    },
    description="centripetal terms of mass and added mass",
    source=YASUKAWA,
)
HULL_FORCE = Force(
    "hull",
    {
        "X": "Q*(-R_0_prime*max(u_r, 0)**2 + R_A_prime*min(u_r, 0)**2 + X_vr_prime*L*v_r*r)",
        "Y": "Q*(Y_v_prime*abs(u_r)*v_r + Y_r_prime*L*u_r*r - C_D*" + _strips("C_rY", False) + ")",
        "N": "Q*L*(N_v_prime*u_r*v_r + N_r_prime*L*abs(u_r)*r - C_D*" + _strips("C_rN", True) + ")",
    },
    HULL,
    amplitudes=(),
    description="resistance, lift and Munk moment, cross-flow drag of strips",
    source=YOSHIMURA,
)
PROPELLER_FORCE = Force(
    "propeller",
    {
        "X": "(1 - t_P)*thrust - rho*D_P**3*n_astern*(k_A*D_P*n_astern + k_AJ*u_r)",
        "Y": "Y_T*thrust + rho*D_P**3*n_astern*(Y_A*D_P*n_astern + Y_AJ*u_r)",
        "N": "0.5*L*(N_T*thrust + rho*D_P**3*n_astern*(N_A*D_P*n_astern + N_AJ*u_r))",
    },
    PROPELLER,
    amplitudes=(),
    description="propeller ahead and astern",
    source=MIYAUCHI,
)
RUDDER_FORCE = Force(
    "rudder",
    {
        "X": "-(1 - t_R)*F_N*sin(delta)",
        "Y": "-(1 + a_H)*F_N*cos(delta)",
        "N": "-(x_R + a_H*x_H_prime*L)*F_N*cos(delta)",
    },
    RUDDER,
    amplitudes=(),
    description="rudder in the wake and in the propeller slipstream",
    source=YASUKAWA,
)

# How far a rigid body in three degrees of freedom is believed 100 s ahead, not the sensors'
# noise, which is ten times smaller: it sets the weight of the records against the priors.
OUTPUTS = (
    Output("u", "m/s", "surge velocity", noise_std=0.015, column="u_velo"),
    Output("v", "m/s", "sway velocity", noise_std=0.015, column="vm_velo"),
    Output("r", "rad/s", "yaw rate", noise_std=math.radians(0.4), column="r_angvelo"),
    Output("psi", "rad", "heading", noise_std=math.radians(5.0), column="psi_hat"),
)
MMG = Model(
    name="MMG model for low speeds, no wind",
    states=(
        State("u", "m/s", "surge velocity", scale=0.3),
        State("v", "m/s", "sway velocity", scale=0.05),
        State("r", "rad/s", "yaw rate", scale=0.03),
        State("psi", "rad", "heading"),
    ),
    inputs=(
        Input("delta", "rad", "rudder angle", interpolation="linear", column="delta_rudder"),
        Input("n", "1/s", "propeller revolutions", interpolation="linear", column="n_prop"),
        Input("wind_north", "m/s", "velocity of the air to the north", interpolation="linear"),
        Input("wind_east", "m/s", "velocity of the air to the east", interpolation="linear"),
    ),
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
    effects=(RIGID_BODY, HULL_FORCE, PROPELLER_FORCE, RUDDER_FORCE),
    parameters=(*SHIP, *INERTIA),
    step=0.5,
)
