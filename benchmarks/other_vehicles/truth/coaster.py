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

import math

import numpy as np

from benchmarks.other_vehicles.truth.simulator import (
    Hidden,
    Manoeuvre,
    Sizes,
    Vehicle,
    constant,
    multisine,
    steps,
    zigzag,
)

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


def _start(revolutions: float) -> dict[str, float]:
    """Speed that a rate of revolution keeps up."""
    return {"u": revolutions * math.sqrt(FIXED["T_nn"] / (-Q * FREE["X_uu"]))}


FREE = {
    "X_uu": -0.0012,
    "Y_v": -0.018,
    "N_v": -0.005,
    "N_r": -0.0040,
    "Y_d": 0.0045,
    "N_d": -0.0022,
}
FIXED = {"Y_r": 0.0035, "T_nn": 2400.0}
_DEGREE = math.radians(1.0)
_PSI = 3


def _zigzag(degrees: float, revolutions: float) -> Manoeuvre:
    # A positive rudder turns to port.
    rudder = zigzag(-degrees * _DEGREE, degrees * _DEGREE, _PSI, begin=10.0)
    return Manoeuvre(
        f"zigzag_{degrees:g}_{degrees:g}",
        _start(revolutions),
        {"n": constant(revolutions), "rudder": rudder},
    )


COASTER = Vehicle(
    name="coaster",
    states=("u", "v", "r", "psi", "x", "y"),
    inputs=("n", "rudder"),
    noise={"psi": 0.2 * _DEGREE, "x": 0.5, "y": 0.5},
    rate=rate,
    measure=measure,
    free=FREE,
    fixed=FIXED,
    sample=1.0,
    duration=360.0,
    substep=0.25,
    integrator="rk4",
    forces={"X": 8e2, "Y": 2e3, "N": 3e4},
    force_time=4.0,
    logged=("rudder", 0.5 * _DEGREE),
    hidden={
        "current": Hidden({"current_north": 0.3, "current_east": 0.3}),
        "wind_force": Hidden({"wind_north": 6e3, "wind_east": 6e3}),
        "yaw_cubic_damping": Hidden({"N_rrr": 2.5e10}, -1),
        "sway_crossflow": Hidden({"Y_absvv": 8e4}, -1),
        "rudder_neutral_angle": Hidden({"offset:rudder": 0.02}),
        "rudder_lag": Hidden({"lag:rudder": 2.5}, 1),
        "heading_lag": Hidden({"sensor_lag:psi": 1.5}, 1),
        "bias_psi": Hidden({"bias:psi": 0.03}),
        "speed_loss_in_turn": Hidden({"X_vr": 4e5, "X_vv": -2e4}, 1),
        "yaw_drift_yaw": Hidden({"N_absvr": 5e7}, -1),
        "rudder_backlash": Hidden({"backlash:rudder": 0.03}, 1),
        "rudder_zero": Hidden({"zero:rudder": 0.03}, per_record=True),
        "yaw_added_inertia_error": Hidden({"yaw_inertia": 0.3 * YAW}, 1),
        "yaw_damping": Hidden({"N_r": FREE["N_r"]}, lacking=True),
    },
    train=(
        _zigzag(20.0, 4.0),
        Manoeuvre(
            "circle_15",
            _start(4.0),
            {"n": constant(4.0), "rudder": steps([(20.0, -15 * _DEGREE), (240.0, 10 * _DEGREE)])},
        ),
        Manoeuvre(
            "speed_steps",
            _start(2.5),
            {
                "n": steps([(0.0, 2.5), (60.0, 4.5), (180.0, 3.0), (270.0, 4.0)]),
                "rudder": zigzag(-10 * _DEGREE, 10 * _DEGREE, _PSI, begin=10.0),
            },
        ),
    ),
    validation=(
        _zigzag(15.0, 3.5),
        Manoeuvre(
            "multisine",
            _start(4.2),
            {
                "n": constant(4.2),
                "rudder": multisine(4 * _DEGREE, (180.0, 97.0, 53.0, 31.0, 17.0), seed=3),
            },
        ),
    ),
)
