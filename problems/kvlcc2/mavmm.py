r"""The tanker in surge, sway and yaw: a modified Abkowitz model.

Alexandersson, Mao & Ringsberg (2022) [3]: the hull and the rudder in polynomials, the rudder's
force in proportion to what flows over it, the thrust among them. With the instantaneous speed
:math:`U`, :math:`q = \frac\rho2 L^2 U^2`, :math:`c = u/U`, :math:`v' = v/U`,
:math:`r' = r L/U` and :math:`T' = T/q`,

.. math::
    X/q &= X_u c + X_{uu} c^2 + X_{rr} r'^2 + X_{vr} v' r' + X_{\delta\delta}\delta^2
        + (1 - t) T'\\
    Y/q &= Y_u c + Y_v v' + Y_r r' + Y_{ur} c r' + Y_T T' - 2 R\\
    N/(qL) &= N_u c + N_v v' + N_r r' + N_{ur} c r' + N_T T' + R,\qquad
    R = (N_\delta + N_{\delta T} T' + N_{\delta vv} v'^2)\,\delta

:math:`c r'` beside :math:`r'` is what tells a turn that slows the ship from one that does not; it,
the thrust in :math:`R` and constants for a single screw decide circles. All
equations are linear in what is unknown, so that one-step regression serves.

The wake fraction comes from the measured thrust before anything else is fitted (:func:`wake`):
with the drift at the stern the screw leaves the hull's wake, to one side more than to the other.
The rudder angle is positive with its trailing edge to port.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oed_sysid import Force, Output, Parameter, read_csv
from oed_sysid.data.third_party import fetch, registered

from .manoeuvring import MMG
from .particulars import APPROACH_SPEED, PROPELLER, SHIP, known
from .zigzags import FOLDER, STEP, run_name

SOURCE = "Alexandersson, Mao & Ringsberg (2022), Ocean Eng. 266, 112940."


def _derivative(name: str, scale: float, description: str) -> Parameter:
    """A derivative in the prime system that nothing is believed of."""
    return Parameter(name, 0.0, "1", scale=scale, description=description)


SURGE = (
    _derivative("X_u_prime", 0.01, "resistance, linear"),
    _derivative("X_uu_prime", 0.01, "resistance, quadratic"),
    _derivative("X_rr_prime", 0.001, "drag of yaw"),
    _derivative("X_vr_prime", 0.01, "drag of drift and yaw"),
    _derivative("X_deltadelta_prime", 0.002, "drag of the rudder"),
)
SWAY = (
    _derivative("Y_u_prime", 0.0001, "side force on a straight course"),
    _derivative("Y_v_prime", 0.02, "side force of drift"),
    _derivative("Y_r_prime", 0.02, "side force of yaw"),
    _derivative("Y_ur_prime", 0.02, "its change with the speed loss"),
    _derivative("Y_T_prime", 0.05, "side force of the single screw"),
)
YAW = (
    _derivative("N_u_prime", 0.0001, "moment on a straight course"),
    _derivative("N_v_prime", 0.01, "Munk moment"),
    _derivative("N_r_prime", 0.01, "yaw damping"),
    _derivative("N_ur_prime", 0.01, "its change with the speed loss"),
    _derivative("N_T_prime", 0.05, "moment of the single screw"),
)
RUDDER = (
    _derivative("N_delta_prime", 0.001, "moment of the rudder"),
    _derivative("N_deltaT_prime", 0.4, "its share in the propeller slipstream"),
    _derivative("N_deltavv_prime", 0.02, "its change with drift"),
)
# Wake fraction: 0.46 + c_0 + c_1 (u - U_0) + c_2 delta + c_3 delta^2, and by the side of the drift
# at the stern beta_P = beta + 0.48 r' its square and its size.
WAKE_NAMES = (*(f"c_w{i}" for i in range(4)), "c_w_ss", "c_w_pp", "c_w_s", "c_w_p")
WAKE = tuple(known(name, 0.0, "1", "wake fraction, from the thrust") for name in WAKE_NAMES)

SIGNALS = {
    "U": "sqrt(u*u + v*v + 1e-9)",
    "Q": "0.5*rho*L*d",
    "q": "0.5*rho*L*L*U*U",
    "c": "u/U",
    "v_n": "v/U",
    "r_n": "r*L/U",
    "beta_P": "atan2(-v, u) + 0.48*r_n",
    "wake": "0.46 + c_w0 + c_w1*(u - U_0) + c_w2*delta + c_w3*delta**2 + (beta_P > 0)*"
    "(c_w_ss*beta_P**2 + c_w_s*beta_P) + (beta_P <= 0)*(c_w_pp*beta_P**2 - c_w_p*beta_P)",
    "J": "u*(1 - wake)/(n_P*D_P)",
    "thrust": "rho*n_P**2*D_P**4*(k_0 + k_1*J + k_2*J*J)",
    "T_n": "thrust/q",
    "R_n": "(N_delta_prime + N_deltaT_prime*T_n + N_deltavv_prime*v_n**2)*delta",
}
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
    (*SURGE, *SWAY, *YAW, *RUDDER, known("t_P", 0.25, "1", "thrust deduction")),
    amplitudes=(),
    description="modified Abkowitz model",
    source=SOURCE,
)
MAVMM = replace(
    MMG,
    name="modified Abkowitz model",
    signals=SIGNALS,
    effects=(MMG.effect("rigid_body"), POLYNOMIAL),
    parameters=(
        *SHIP,
        *PROPELLER,
        known("m_x_prime", 0.022, "1", "surge added mass"),
        known("m_y_prime", 0.223, "1", "sway added mass"),
        known("J_z_prime", 0.011, "1", "yaw added inertia"),
        known("U_0", APPROACH_SPEED, "m/s", "approach speed"),
        *WAKE,
    ),
)
# Signals that the wake is found from: the motion, and the thrust that the propeller's shaft shows.
THRUST = replace(
    MMG,
    outputs=(*MMG.outputs, Output("thrust", "N", "thrust", noise_std=1.0, column="thrust_N")),
)


def wake(*, step: int = STEP) -> dict[str, float]:
    """Coefficients of the wake fraction, by least squares on the measured thrust of all runs.

    The thrust of each sample gives a thrust coefficient, the open-water curve its advance ratio,
    and this with the speed the wake fraction.

    Returns
    -------
    dict of str to float
        Values of the parameters ``c_w...`` of :data:`MAVMM`.
    """
    constant = MAVMM.values
    names, targets = [], []
    for path in registered(FOLDER):
        run = read_csv(fetch(path), THRUST.channels, name=run_name(path))[0].thin(step)
        u, v, r, delta = (run.output("u"), run.output("v"), run.output("r"), run.input("delta"))
        scale = constant["rho"] * constant["n_P"] ** 2 * constant["D_P"] ** 4
        k_0, k_1, k_2 = (constant[f"k_{i}"] for i in range(3))
        missing = k_0 - run.output("thrust") / scale
        advance = (-k_1 - np.sqrt(k_1**2 - 4 * k_2 * missing)) / (2 * k_2)
        targets.append(1 - advance * constant["n_P"] * constant["D_P"] / u - 0.46)
        speed = np.hypot(u, v)
        stern = np.arctan2(-v, u) + 0.48 * r * constant["L"] / speed
        starboard = stern > 0
        names.append(
            np.column_stack(
                [
                    np.ones_like(u),
                    u - APPROACH_SPEED,
                    delta,
                    delta**2,
                    np.where(starboard, stern**2, 0.0),
                    np.where(starboard, 0.0, stern**2),
                    np.where(starboard, stern, 0.0),
                    np.where(starboard, 0.0, -stern),
                ]
            )
        )
    found, *_ = np.linalg.lstsq(np.vstack(names), np.concatenate(targets), rcond=None)
    return dict(zip(WAKE_NAMES, map(float, found), strict=True))
