r"""A small catamaran with a propeller on each hull: surge, sway and yaw, fully instrumented.

.. math::

    (m - X_{\dot u})\dot u &= (m - Y_{\dot v}) v r + X_u u + X_{uu} u|u| + T_l + T_r \\
    (m - Y_{\dot v})\dot v &= -(m - X_{\dot u}) u r + Y_v v \\
    (I_z - N_{\dot r})\dot r &= \mu(Y_{\dot v} - X_{\dot u}) u v + N_r r + b(T_l - T_r)

with velocities through the water in all hydrodynamic terms and :math:`T = k n|n|` per
propeller, half as strong astern; skegs leave a share :math:`\mu` of the Munk moment.
Sizes are of the order of the two-metre Otter vehicle (Fossen 2021, Handbook of marine
craft hydrodynamics and motion control, ch. 6: 55 kg, thrusters 0.4 m off the centre
line, about 100 N each at full speed).
"""

from __future__ import annotations

import numpy as np

from benchmarks.other_vehicles.truth.simulator import Sizes, vehicle

MASS, X_UDOT, Y_VDOT = 62.0, -6.0, -70.0  # kg
INERTIA = 18.0 + 16.0  # kg m2, with added inertia
ARM = 0.4  # m


def rate(x: np.ndarray, d: np.ndarray, p: Sizes, h: Sizes, f: np.ndarray) -> np.ndarray:
    """Time derivative of ``u v r psi x y``."""
    u, v, r, psi = x[:4]
    cos, sin = np.cos(psi), np.sin(psi)
    north, east = h.get("current_north", 0.0), h.get("current_east", 0.0)
    u_r = u - north * cos - east * sin
    v_r = v - east * cos + north * sin
    left, right = (p["k"] * n * np.abs(n) * np.where(n < 0, 0.5, 1.0) for n in d)
    push = left * (1 + h.get("left_loss", 0.0)) + right
    push = push * (1 + h.get("speed_loss", 0.0) * u_r)
    wind_north, wind_east = h.get("wind_north", 0.0), h.get("wind_east", 0.0)
    surge = (MASS - Y_VDOT) * v_r * r + p["X_u"] * u_r + p["X_uu"] * u_r * abs(u_r) + push
    surge = surge + wind_north * cos + wind_east * sin + f[0]
    surge = surge + h.get("X_rr", 0.0) * r**2 + h.get("X_vr", 0.0) * v_r * r
    sway = -(MASS - X_UDOT) * u_r * r + p["Y_v"] * v_r + f[1]
    sway = sway + wind_east * cos - wind_north * sin + h.get("Y_ur", 0.0) * u_r * r
    sway = sway + h.get("Y_absvv", 0.0) * v_r * abs(v_r)
    yaw = (Y_VDOT - X_UDOT) * u_r * v_r * p["munk"] + p["N_r"] * r
    yaw = yaw + ARM * (left * (1 + h.get("left_loss", 0.0)) - right) + f[2]
    yaw = yaw + h.get("N_absrr", 0.0) * r * abs(r) + h.get("N_rrr", 0.0) * r**3
    yaw = yaw + h.get("N_v", 0.0) * v_r
    inertia = INERTIA + h.get("yaw_inertia", 0.0)
    return np.stack(
        [
            surge / (MASS - X_UDOT),
            sway / (MASS - Y_VDOT),
            yaw / inertia,
            r,
            u * cos - v * sin,
            u * sin + v * cos,
        ]
    )


def measure(x: np.ndarray, p: Sizes, h: Sizes) -> np.ndarray:
    """Speeds, yaw rate, heading and position; the log may be turned or astern of the origin."""
    turn, ahead = h.get("misalignment", 0.0), h.get("lever_arm", 0.0)
    u, v, r = x[:3]
    return np.stack([u - turn * v, v + turn * u - ahead * r, r, x[3], x[4], x[5]])


CATAMARAN = vehicle("catamaran", rate, measure)
