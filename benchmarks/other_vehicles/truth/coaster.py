r"""A 50 m coaster in surge, sway and yaw, seen by compass and satellite position only.

.. math::

    (m - X_{\dot u})\dot u &= m v r + Q X_{uu} u_r|u_r| + T_{nn} n|n| \\
    (m - Y_{\dot v})\dot v &= -m u r + Q(Y_v u_r v_r + L Y_r u_r r + Y_\delta u_r^2\delta) \\
    (I_z - N_{\dot r})\dot r &= QL(N_v u_r v_r + L N_r u_r r + N_\delta u_r^2\delta)

:math:`Q = \rho L^2/2`. Lower-case derivatives are nondimensional, of the order that
Clarke, Gedling & Hine (1983), Trans. RINA 125, give for a hull of L/B = 5.8, B/T = 3
and block coefficient 0.65 (m' = 0.013, Y'_v about -0.02, N'_r about -0.004); rudder
derivatives are those of a rudder of 2 % of L T; drag 38 kN at 5 m/s. A current acts
through the relative velocity, its rotation in body axes left out of added mass.
"""

from __future__ import annotations

import numpy as np

from benchmarks.other_vehicles.truth.simulator import Sizes, vehicle

LENGTH, DENSITY = 50.0, 1025.0
Q = 0.5 * DENSITY * LENGTH**2  # kg/m
MASS_PRIME = 0.5 * DENSITY * LENGTH**3
SURGE = (0.0130 + 0.0007) * MASS_PRIME
SWAY = (0.0130 + 0.0100) * MASS_PRIME
YAW = (0.00081 + 0.00050) * MASS_PRIME * LENGTH**2
MASS = 0.0130 * MASS_PRIME


def rate(x: np.ndarray, d: np.ndarray, p: Sizes, h: Sizes, f: np.ndarray) -> np.ndarray:
    """Time derivative of ``u v r psi x y``."""
    u, v, r, psi = x[:4]
    n, delta = d
    cos, sin = np.cos(psi), np.sin(psi)
    north, east = h.get("current_north", 0.0), h.get("current_east", 0.0)
    u_r = u - north * cos - east * sin
    v_r = v - east * cos + north * sin
    wind_north, wind_east = h.get("wind_north", 0.0), h.get("wind_east", 0.0)
    surge = MASS * v * r + Q * p["X_uu"] * u_r * abs(u_r) + p["T_nn"] * n * abs(n) + f[0]
    surge = surge + wind_north * cos + wind_east * sin
    surge = surge + h.get("X_vr", 0.0) * v_r * r + h.get("X_vv", 0.0) * v_r**2
    sway = -MASS * u * r + f[1] + wind_east * cos - wind_north * sin
    sway = sway + Q * u_r * (p["Y_v"] * v_r + LENGTH * p["Y_r"] * r + p["Y_d"] * u_r * delta)
    sway = sway + h.get("Y_absvv", 0.0) * v_r * abs(v_r)
    yaw = Q * LENGTH * u_r * (p["N_v"] * v_r + LENGTH * p["N_r"] * r + p["N_d"] * u_r * delta)
    yaw = yaw + h.get("N_rrr", 0.0) * r**3 + h.get("N_absvr", 0.0) * abs(v_r) * r + f[2]
    inertia = YAW + h.get("yaw_inertia", 0.0)
    along, across = u * cos - v * sin, u * sin + v * cos
    return np.stack([surge / SURGE, sway / SWAY, yaw / inertia, r, along, across])


def measure(x: np.ndarray, p: Sizes, h: Sizes) -> np.ndarray:
    """Heading and position."""
    return x[3:6]


COASTER = vehicle("coaster", rate, measure)
