r"""The tanker ahead, as a modified Abkowitz model with wind.

The equations, the terms and their names are those of the KVLCC2 problem's ``mavmm.py``, which
has the source; here the thrust follows from the revolutions with the textbook's coefficients,
for it was not measured, and a positive rudder turns to starboard. Linear in what is unknown.
"""

from __future__ import annotations

from dataclasses import replace

from oed_sysid import Force, Parameter

from .manoeuvring import MMG
from .missing import WIND
from .particulars import INERTIA, PROPELLER, SHIP, known

SOURCE = "Alexandersson, Mao & Ringsberg (2022), Ocean Eng. 266, 112940."
NAMES = {
    "X": ("X_u", "X_uu", "X_rr", "X_vr", "X_deltadelta"),
    "Y": ("Y_u", "Y_v", "Y_r", "Y_ur", "Y_T"),
    "N": ("N_u", "N_v", "N_r", "N_ur", "N_T", "N_delta", "N_deltaT", "N_deltavv"),
}
DERIVATIVES = tuple(
    Parameter(f"{name}_prime", 0.0, "1", scale=0.01, description="derivative, prime system")
    for names in NAMES.values()
    for name in names
)
# Textbook values, which a fit of the MMG model may change and this one takes as they are.
TAKEN = tuple(
    known(p.name, p.value, "1", f"{p.description}, nominal")
    for p in (*INERTIA, *PROPELLER)
    if p.name in ("m_y_prime", "J_z_prime", "k_0", "k_1", "t_P", "w_P")
)
POLYNOMIAL = Force(
    "hull_and_rudder",
    {
        "X": "q*(X_u_prime*c + X_uu_prime*c*c + X_rr_prime*r_n**2 + X_vr_prime*v_n*r_n"
        " + X_deltadelta_prime*delta**2) + (1 - t_P)*thrust",
        "Y": "q*(Y_u_prime*c + Y_v_prime*v_n + Y_r_prime*r_n + Y_ur_prime*c*r_n"
        " + Y_T_prime*T_n - 2*R_n)",
        "N": "q*L*(N_u_prime*c + N_v_prime*v_n + N_r_prime*r_n + N_ur_prime*c*r_n"
        " + N_T_prime*T_n + R_n)",
    },
    DERIVATIVES,
    amplitudes=(),
    description="modified Abkowitz model",
    source=SOURCE,
)
MAVMM = replace(
    MMG,
    name="modified Abkowitz model, wind included",
    signals={
        "Q": "0.5*rho*L*d",
        "U": "sqrt(u*u + v*v + 1e-4)",
        "q": "0.5*rho*L*L*U*U",
        "c": "u/U",
        "v_n": "v/U",
        "r_n": "r*L/U",
        "n_ahead": "max(n, 0)",
        "thrust": "rho*D_P**3*n_ahead*(k_0*D_P*n_ahead + k_1*u*(1 - w_P))",
        "T_n": "thrust/q",
        "R_n": "(N_delta_prime + N_deltaT_prime*T_n + N_deltavv_prime*v_n**2)*delta",
    },
    effects=(MMG.effect("rigid_body"), POLYNOMIAL, WIND),
    parameters=(*SHIP, *TAKEN),
)
