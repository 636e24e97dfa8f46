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

import math

import numpy as np

from benchmarks.other_vehicles.truth.simulator import (
    Hidden,
    Manoeuvre,
    Signal,
    Sizes,
    Vehicle,
    constant,
    multisine,
    steps,
)

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
    """Speeds, yaw rate, heading and position; the log may be turned or off the origin."""
    turn, ahead = h.get("misalignment", 0.0), h.get("lever_arm", 0.0)
    u, v, r = x[:3]
    return np.stack([u - turn * v, v + turn * u - ahead * r, r, x[3], x[4], x[5]])


def _run(name: str, left: Signal, right: Signal, speed: float, heading: float) -> Manoeuvre:
    return Manoeuvre(name, {"u": speed, "psi": heading}, {"n_left": left, "n_right": right})


def _around(base: Signal, change: Signal, side: float) -> Signal:
    """A common rate of revolution, and a part that acts on both sides in opposition."""

    def fresh():  # type: ignore[no-untyped-def]
        common, turning = base(), change()
        return lambda time, x: common(time, x) + side * turning(time, x)

    return fresh


def _turning(name: str, base: Signal, change: Signal, speed: float, heading: float) -> Manoeuvre:
    return _run(name, _around(base, change, 1.0), _around(base, change, -1.0), speed, heading)


def _relay(size: float, switch: float) -> Signal:
    """Zigzag of the difference of revolutions on the heading, about the first one."""

    def fresh():  # type: ignore[no-untyped-def]
        side, first = [1.0], [math.nan]

        def pilot(time: float, x: np.ndarray) -> float:
            if math.isnan(first[0]):
                first[0] = float(x[3])
            if time < 4.0:
                return 0.0
            if side[0] * (x[3] - first[0]) > switch:
                side[0] = -side[0]
            return side[0] * size

        return pilot

    return fresh


_DEGREE = math.radians(1.0)
CATAMARAN = Vehicle(
    name="catamaran",
    states=("u", "v", "r", "psi", "x", "y"),
    inputs=("n_left", "n_right"),
    noise={"u": 0.02, "v": 0.02, "r": 0.006, "psi": 0.5 * _DEGREE, "x": 0.3, "y": 0.3},
    rate=rate,
    measure=measure,
    free={"X_u": -8.0, "X_uu": -16.0, "Y_v": -70.0, "N_r": -28.0, "k": 0.42, "munk": 0.1},
    fixed={},
    sample=0.25,
    duration=100.0,
    substep=0.25,
    integrator="dop853",
    forces={"X": 0.5, "Y": 1.0, "N": 0.25},
    force_time=2.0,
    logged=("n_left", 0.15),
    hidden={
        "current": Hidden({"current_north": 0.12, "current_east": 0.12}),
        "wind_force": Hidden({"wind_north": 2.5, "wind_east": 2.5}),
        "yaw_quadratic_damping": Hidden({"N_absrr": 25.0}, -1),
        "sway_crossflow": Hidden({"Y_absvv": 80.0}, -1),
        "left_propeller_loss": Hidden({"left_loss": 0.08}, -1),
        "propeller_lag": Hidden({"lag:n_left": 0.5, "lag:n_right": 0.5}, 1),
        "propeller_deadband": Hidden({"deadband:n_left": 0.6, "deadband:n_right": 0.6}, 1),
        "thrust_speed_loss": Hidden({"speed_loss": 0.12}, -1),
        "speed_loss_in_turn": Hidden({"X_rr": 30.0, "X_vr": 20.0}, -1),
        "sway_yaw_coupling": Hidden({"Y_ur": 15.0}),
        "yaw_sway_moment": Hidden({"N_v": 10.0}),
        "yaw_added_inertia_error": Hidden({"yaw_inertia": 8.0}, 1),
        "heading_lag": Hidden({"sensor_lag:psi": 0.4}, 1),
        "bias_r": Hidden({"bias:r": 0.008}),
        "log_misalignment": Hidden({"misalignment": 0.04}),
        "log_lever_arm": Hidden({"lever_arm": 0.4}),
        "left_zero": Hidden({"zero:n_left": 0.25}, per_record=True),
        "sway_damping": Hidden({"Y_v": -70.0}, lacking=True),
    },
    train=(
        _turning("zigzag", constant(7.0), _relay(1.5, 25 * _DEGREE), 1.4, 0.4),
        _turning(
            "circles",
            steps([(0.0, 6.0), (50.0, 8.0)]),
            steps([(5.0, 2.0), (55.0, -2.5)]),
            1.1,
            -1.0,
        ),
        _turning(
            "speed_steps",
            steps([(0.0, 3.0), (20.0, 9.0), (45.0, 5.0), (60.0, -3.0), (70.0, 7.0)]),
            multisine(0.7, (31.0, 17.0, 9.0), seed=2),
            0.4,
            2.2,
        ),
    ),
    validation=(
        _turning("zigzag_slow", constant(5.5), _relay(1.0, 15 * _DEGREE), 1.0, -2.0),
        _turning(
            "multisine",
            multisine(1.0, (60.0, 27.0), seed=4, base=7.5),
            multisine(0.9, (43.0, 23.0, 13.0, 7.0), seed=6),
            1.5,
            1.0,
        ),
    ),
)
