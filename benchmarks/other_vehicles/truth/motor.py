r"""An electric motor that swings an unbalanced load: angle and speed.

.. math::

    \dot\theta = \omega, \qquad \dot\omega = aV - b\omega - c\sin\theta - \dots

The order of the constants is that of a small geared direct-current motor with a
bar (mechanical time constant 1/b of about a second, c = m g l/J). Dry friction is
Coulomb's: it opposes motion with a constant torque and, at rest, whatever is applied
up to that torque (Karnopp 1985, J. Dyn. Sys. Meas. Control 107). With c free, a centre
of gravity beside the bar is the same as a bias of the angle (a sine with a phase), and a
constant load the same as an offset of the voltage.
"""

from __future__ import annotations

import numpy as np

from benchmarks.other_vehicles.truth.simulator import (
    Hidden,
    Manoeuvre,
    Sizes,
    Vehicle,
    multisine,
    steps,
)


def _applied(x: np.ndarray, d: np.ndarray, p: Sizes, h: Sizes, f: np.ndarray) -> np.ndarray:
    """Acceleration by everything but dry friction."""
    theta, omega = x
    drive = p["a"] * d[0] - p["b"] * omega - p["c"] * np.sin(theta) + f[0]
    drive = drive + h.get("torque", 0.0) + h.get("cosine", 0.0) * np.cos(theta)
    drive = drive + h.get("quadratic", 0.0) * omega * np.abs(omega)
    return drive + h.get("spring", 0.0) * theta


def rate(x: np.ndarray, d: np.ndarray, p: Sizes, h: Sizes, f: np.ndarray) -> np.ndarray:
    """Time derivative of angle and speed."""
    drive = _applied(x, d, p, h, f)
    dry = h.get("coulomb", 0.0)
    omega = x[1]
    friction = np.where(omega == 0.0, np.clip(drive, -dry, dry), dry * np.sign(omega))
    return np.stack([omega, drive - friction])


def settle(
    before: np.ndarray, after: np.ndarray, d: np.ndarray, p: Sizes, h: Sizes, f: np.ndarray
) -> np.ndarray:
    """Stop where the speed changed its sign and dry friction can hold the load."""
    dry = h.get("coulomb", 0.0)
    stops = before[1] * after[1] < 0.0
    held = np.abs(_applied(np.stack([after[0], 0 * after[1]]), d, p, h, f)) <= dry
    return np.stack([after[0], np.where(stops & held, 0.0, after[1])])


def measure(x: np.ndarray, p: Sizes, h: Sizes) -> np.ndarray:
    """Angle and speed."""
    return x


def _run(name: str, signal: object, angle: float = 0.0) -> Manoeuvre:
    return Manoeuvre(name, {"theta": angle}, {"V": signal})  # type: ignore[dict-item]


MOTOR = Vehicle(
    name="motor",
    states=("theta", "omega"),
    inputs=("V",),
    noise={"theta": 0.005, "omega": 0.03},
    rate=rate,
    measure=measure,
    free={"a": 2.5, "b": 0.8, "c": 10.0},
    fixed={},
    sample=0.05,
    duration=25.0,
    substep=0.005,
    integrator="rk4",
    forces={"omega": 0.1},
    force_time=0.5,
    logged=("V", 0.1),
    hidden={
        "coulomb_friction": Hidden({"coulomb": 0.5}, 1),
        "quadratic_drag": Hidden({"quadratic": 0.15}, -1),
        "constant_torque": Hidden({"torque": 0.6}, same_as=("drive_offset",)),
        "unbalance": Hidden({"cosine": 0.8}, same_as=("bias_theta",)),
        "cable_spring": Hidden({"spring": 0.6}, -1),
        "drive_lag": Hidden({"lag:V": 0.12}, 1),
        "drive_deadband": Hidden({"deadband:V": 0.3}, 1),
        "drive_backlash": Hidden({"backlash:V": 0.3}, 1),
        "tacho_lag": Hidden({"sensor_lag:omega": 0.06}, 1),
        "tacho_scale": Hidden({"scale:omega": 0.05}),
        "bias_theta": Hidden({"bias:theta": 0.04}, same_as=("unbalance",)),
        "drive_zero": Hidden({"zero:V": 0.25}, per_record=True),
        "viscous_damping": Hidden({"b": 0.8}, lacking=True),
    },
    train=(
        _run("multisine", multisine(0.6, (7.3, 4.1, 2.7, 1.5, 1.1), seed=1)),
        _run(
            "steps",
            steps([(1.0, 1.5), (5.0, -1.0), (9.0, 1.8), (12.0, 0.0), (16.0, -1.8), (20.0, 0.5)]),
        ),
        _run("slow_sweep", multisine(0.9, (23.0, 11.0, 3.3), seed=5), 0.3),
    ),
    validation=(
        _run(
            "steps_other", steps([(1.0, -1.6), (6.0, 1.2), (11.0, -0.6), (14.0, 1.9), (20.0, 0.0)])
        ),
        _run("multisine_other", multisine(0.7, (8.9, 4.7, 2.5, 1.4), seed=9), -0.2),
    ),
    settle=settle,
)
