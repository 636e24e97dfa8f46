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

from benchmarks.other_vehicles.truth.simulator import Sizes, vehicle


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


MOTOR = vehicle("motor", rate, measure, settle)
