r"""What the simulators of the benchmarks share; no code of the package that they judge.

The diving plane of a REMUS-like AUV, eight derivatives and rigid and added masses, from Prestero
(2001), Verification of a six-degree of freedom simulation model, MIT/WHOI:

.. math::

    (m - X_{\dot u})\,\dot u &= -m q w + X_{uu} u|u| + T + w_X \\
    (m - Z_{\dot w})\,\dot w - Z_{\dot q}\,\dot q
        &= m u q + u (Z_{uw} w + Z_{uq} q) + Z_{uuds} u^2 \delta_s + w_Z \\
    -M_{\dot w}\,\dot w + (I_{yy} - M_{\dot q})\,\dot q
        &= u (M_{uw} w + M_{uq} q) + M_{uuds} u^2 \delta_s - z_G W \sin\theta + w_M \\
    \dot\theta &= q, \qquad \dot z = -u \sin\theta + w \cos\theta
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import lfilter

NAMES = ("X_uu", "Z_uw", "Z_uq", "M_uw", "M_uq", "Z_uuds", "M_uuds", "zgW")
TRUE = np.array([-3.9, -40.0, -9.0, 14.0, -9.0, -12.0, -6.15, 5.9])
NOISE = np.array([0.02, 0.02, 0.004, 0.004, 0.03])  # of u, w, q, theta, z
# Mass and pitch inertia, then the added masses X_udot, Z_wdot, Z_qdot, M_wdot, M_qdot.
MASSES = (30.48, 3.45, -0.93, -35.5, -1.93, -1.93, -4.88)


def rates(
    x: Any, command: Any, p: Any, sin: Any, cos: Any, push: Any = (0.0, 0.0, 0.0),
    masses: Any = MASSES,
) -> tuple[Any, ...]:  # fmt: skip
    """Rates of u, w, q, theta, z; forward speed is positive, so u|u| is u^2.

    Written for numbers, arrays, complex steps, symbols and numba alike: ``p`` in the order of
    :data:`NAMES`, ``push`` the disturbance forces on X, Z and M.
    """
    u, w, q, theta = x[0], x[1], x[2], x[3]
    fin, thrust = command[0], command[1]
    m, inertia, x_udot, z_wdot, z_qdot, m_wdot, m_qdot = masses
    heavy, lagging = m - z_wdot, inertia - m_qdot
    determinant = heavy * lagging - z_qdot * m_wdot
    surge = -m * q * w + p[0] * u * u + thrust + push[0]
    heave = m * u * q + u * (p[1] * w + p[2] * q + p[5] * u * fin) + push[1]
    pitch = u * (p[3] * w + p[4] * q + p[6] * u * fin) - p[7] * sin(theta) + push[2]
    return (
        surge / (m - x_udot),
        (lagging * heave + z_qdot * pitch) / determinant,
        (heavy * pitch + m_wdot * heave) / determinant,
        q,
        -u * sin(theta) + w * cos(theta),
    )


def runge_kutta(rate: Callable[..., Any], x: Any, h: float, *given: Any) -> Any:
    """One step of fourth order; the rate is told whether it is at the start, 1 middle or 2 end.

    What else is ``given`` is handed on to it.
    """
    first = rate(x, 0, *given)
    second = rate(x + h / 2 * first, 1, *given)
    third = rate(x + h / 2 * second, 1, *given)
    fourth = rate(x + h * third, 2, *given)
    return x + h / 6 * (first + 2 * second + 2 * third + fourth)


def gauss_markov(draws: np.ndarray, memory: float | np.ndarray, axis: int = 0) -> np.ndarray:
    """Stationary first-order processes of unit variance along an axis, from normal draws."""
    scaled = np.moveaxis(draws * np.sqrt(1.0 - memory**2), axis, 0)
    scaled[0] = np.moveaxis(draws, axis, 0)[0]
    return np.moveaxis(lfilter([1.0], [1.0, -memory], scaled, axis=0), 0, axis)
