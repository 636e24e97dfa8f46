"""Esso Osaka, 3 m model: what is known, or believed, before any fit.

Dimensions are those that come with the records [1]; what they leave out is
marked *assumed*.
"""

from __future__ import annotations

import math

from oed_sysid import Parameter

LENGTH, DRAUGHT = 3.0, 0.201  # m
AIR_DENSITY = 1.225  # kg/m3
FRONT_AREA, SIDE_AREA = 0.135, 0.520  # m2, projected, above the water
SOURCE = "Wakita et al. (2022), J. Mar. Sci. Technol. 27, 772-785."


def known(name: str, value: float, unit: str, description: str) -> Parameter:
    """Return a number that no fit may change."""
    return Parameter(name, value, unit, fixed=True, description=description)


def believed(
    name: str,
    value: float,
    spread: float,
    description: str,
    *,
    lower: float = -math.inf,
    upper: float = math.inf,
) -> Parameter:
    """Return a dimensionless number that the data may correct."""
    return Parameter(
        name,
        value,
        "1",
        prior_mean=value,
        prior_std=spread,
        scale=max(abs(value), spread),
        description=description,
        lower=lower,
        upper=upper,
    )


SHIP = (
    known("rho", 1000.0, "kg/m^3", "density of the pond's water"),
    known("L", LENGTH, "m", "length between perpendiculars"),
    known("d", DRAUGHT, "m", "draught"),
    known("m", 244.6, "kg", "mass"),
    known("x_G", 0.094, "m", "centre of gravity ahead of midship"),
    known("I_z", 137.6, "kg m^2", "yaw inertia about the centre of gravity, k_zz L/4, assumed"),
    known("m_x_prime", 0.020, "1", "surge added mass, assumed"),
    known("D_P", 0.084, "m", "propeller diameter"),
    known("A_R", 0.0106, "m^2", "rudder area"),
    known("eta", 0.65, "1", "share of the rudder's height in the propeller slipstream, assumed"),
    known("f_alpha", 2.6, "1", "lift slope of the rudder, aspect ratio about 1.5"),
    known("x_R", -0.5 * LENGTH, "m", "rudder and propeller, from midship"),
)
INERTIA = (
    believed("m_y_prime", 0.21, 0.03, "sway added mass", lower=0.05),
    believed("J_z_prime", 0.011, 0.003, "yaw added inertia", lower=0.001),
)
HULL = (
    believed("R_0_prime", 0.022, 0.008, "resistance ahead", lower=0.0),
    believed("R_A_prime", 0.03, 0.02, "resistance astern", lower=0.0),
    believed("X_vr_prime", 0.0, 0.1, "drag of drift and yaw"),
    believed("Y_v_prime", -0.30, 0.10, "side force of drift"),
    believed("Y_r_prime", 0.07, 0.04, "side force of yaw"),
    believed("N_v_prime", -0.11, 0.04, "Munk moment"),
    believed("N_r_prime", -0.05, 0.02, "yaw damping"),
    believed("C_D", 0.8, 0.4, "cross-flow drag", lower=0.0),
    believed("C_rY", 1.0, 0.5, "weight of yaw in the cross-flow of the side force", lower=0.0),
    believed("C_rN", 0.8, 0.4, "weight of yaw in the cross-flow of the moment", lower=0.0),
)
PROPELLER = (
    believed("k_0", 0.29, 0.04, "thrust coefficient at J = 0, ahead", lower=0.05),
    believed("k_1", -0.30, 0.10, "its slope"),
    believed("t_P", 0.20, 0.05, "thrust deduction"),
    believed("w_P", 0.45, 0.10, "wake fraction", lower=-0.5, upper=0.9),
    believed("k_A", 0.20, 0.05, "thrust coefficient astern", lower=0.0),
    believed("k_AJ", 0.10, 0.15, "its change with speed"),
    believed("Y_A", 0.0, 0.04, "side force of the propeller astern, of rho n^2 D^4"),
    believed("N_A", 0.0, 0.04, "its moment, over half the length"),
    believed("Y_AJ", 0.0, 0.20, "change of the side force with speed"),
    believed("N_AJ", 0.0, 0.20, "change of the moment with speed"),
    believed("Y_T", 0.0, 0.05, "side force of the single screw ahead, of the thrust"),
    believed("N_T", 0.0, 0.05, "its moment, over half the length"),
)
RUDDER = (
    believed("t_R", 0.30, 0.10, "steering resistance deduction"),
    believed("a_H", 0.35, 0.10, "rudder force increase by the hull"),
    known("x_H_prime", -0.45, "1", "where this increase acts"),
    believed("gamma_R", 0.45, 0.15, "flow straightening", lower=0.0),
    believed("gamma_side", 0.0, 0.3, "its difference between the sides, over the mean"),
    known("v_side", 0.02, "m/s", "flow across the rudder that tells one side from the other"),
    believed("l_R_prime", -0.90, 0.20, "effective place of the rudder in yaw"),
    believed("epsilon", 1.1, 0.2, "wake at the rudder to wake at the propeller", lower=0.2),
    believed("kappa", 0.55, 0.15, "acceleration by the propeller", lower=0.0),
)
