r"""An underwater vehicle in six degrees of freedom, twelve states, fins and one propeller.

.. math::

    M\dot\nu + C_{RB}(\nu)\nu + C_A(\nu_r)\nu_r = \tau_{hull} + \tau_{fins} + \tau_{prop} + g(\eta)

with diagonal rigid and added mass, Kirchhoff's ideal-fluid terms, lift-like hull forces,
Euler angles and a centre of gravity below that of buoyancy (restoring moments
:math:`-zgW\sin\theta`, :math:`-zgW\cos\theta\sin\varphi`). Sizes are of the order of the
REMUS of Prestero (2001), Verification of a six-degree of freedom simulation model,
MIT/WHOI: 30.5 kg, added mass 35.5 kg across, fin lift 12 kg/m; roll inertia larger.
"""

from __future__ import annotations

import numpy as np

from benchmarks.other_vehicles.truth.simulator import Sizes, vehicle

MASS, I_X, I_Y = 30.5, 0.8, 3.45  # kg, kg m2; pitch and yaw alike
X_UDOT, Y_VDOT, K_PDOT, M_QDOT = -0.93, -35.5, -0.2, -4.88
T_NN, TORQUE_ARM = 0.014, 0.03  # N s2; m


def rate(x: np.ndarray, d: np.ndarray, c: Sizes, h: Sizes, f: np.ndarray) -> np.ndarray:
    """Time derivative of ``u v w p q r phi theta psi x y z``."""
    u, v, w, p, q, r, phi, theta, psi = x[:9]
    stern, rudder, n = d
    s1, c1, s2, c2, s3, c3 = (g(a) for a in (phi, theta, psi) for g in (np.sin, np.cos))
    # Rows of the rotation from north-east-down to body axes.
    to_u = np.stack([c2 * c3, c2 * s3, -s2])
    to_v = np.stack([s1 * s2 * c3 - c1 * s3, s1 * s2 * s3 + c1 * c3, s1 * c2])
    to_w = np.stack([c1 * s2 * c3 + s1 * s3, c1 * s2 * s3 - s1 * c3, c1 * c2])
    north, east = h.get("current_north", 0.0), h.get("current_east", 0.0)
    u_r = u - north * to_u[0] - east * to_u[1]
    v_r = v - north * to_v[0] - east * to_v[1]
    w_r = w - north * to_w[0] - east * to_w[1]
    thrust = T_NN * n * np.abs(n)
    heavy, ahead = h.get("excess_weight", 0.0), h.get("cg_ahead", 0.0)
    surge = MASS * (r * v - q * w) + Y_VDOT * (q * w_r - r * v_r)
    surge = surge + c["X_uu"] * u_r * np.abs(u_r) + thrust + heavy * to_u[2] + f[0]
    surge = surge + h.get("speed_loss", 0.0) * thrust * u_r
    surge = surge + h.get("X_ww", 0.0) * (w_r**2 + v_r**2)
    sway = MASS * (p * w - r * u) + X_UDOT * u_r * r - Y_VDOT * w_r * p
    sway = sway + u_r * (c["Y_uv"] * v_r + c["Y_ur"] * r + c["Y_uudr"] * u_r * rudder)
    sway = sway + heavy * to_v[2] + f[1] + h.get("Y_absvv", 0.0) * v_r * np.abs(v_r)
    heave = MASS * (q * u - p * v) + Y_VDOT * v_r * p - X_UDOT * u_r * q
    heave = heave + u_r * (c["Z_uw"] * w_r + c["Z_uq"] * q + c["Z_uuds"] * u_r * stern)
    heave = heave + heavy * to_w[2] + f[2] + h.get("Z_absww", 0.0) * w_r * np.abs(w_r)
    roll = c["K_p"] * p - c["zgW"] * to_v[2] - TORQUE_ARM * thrust + f[3]
    roll = roll + h.get("K_uv", 0.0) * u_r * v_r
    pitch = (I_Y - I_X + K_PDOT - M_QDOT) * r * p + (X_UDOT - Y_VDOT) * u_r * w_r
    pitch = pitch + u_r * (c["M_uw"] * w_r + c["M_uq"] * q + c["M_uuds"] * u_r * stern)
    pitch = pitch - c["zgW"] * s2 - ahead * to_w[2] + f[4]
    pitch = pitch + h.get("M_absqq", 0.0) * q * np.abs(q)
    yaw = (I_X - I_Y - K_PDOT + M_QDOT) * p * q + (Y_VDOT - X_UDOT) * u_r * v_r
    yaw = yaw + u_r * (c["N_uv"] * v_r + c["N_ur"] * r + c["N_uudr"] * u_r * rudder)
    yaw = yaw + ahead * to_v[2] + f[5] + h.get("N_absrr", 0.0) * r * np.abs(r)
    across = MASS - Y_VDOT
    turning = I_Y - M_QDOT
    ground = np.stack([u, v, w])
    moved = [np.sum(np.stack([to_u[i], to_v[i], to_w[i]]) * ground, axis=0) for i in range(3)]
    return np.stack(
        [
            surge / (MASS - X_UDOT),
            sway / across,
            heave / across,
            roll / (I_X - K_PDOT),
            pitch / (turning + h.get("pitch_inertia", 0.0)),
            yaw / turning,
            p + (q * s1 + r * c1) * np.tan(theta),
            q * c1 - r * s1,
            (q * s1 + r * c1) / c2,
            *moved,
        ]
    )


def measure(x: np.ndarray, p: Sizes, h: Sizes) -> np.ndarray:
    """Speeds, rates, attitude and depth; the speed log may be off the origin."""
    ahead = h.get("lever_arm", 0.0)
    v, w = x[1] + ahead * x[5], x[2] - ahead * x[4]
    return np.stack([x[0], v, w, *x[3:9], x[11]])


AUV = vehicle("auv", rate, measure)
