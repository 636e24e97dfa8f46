r"""Attitude: rotation between body axes and NED, by Euler angles or a unit quaternion.

.. math::

    \dot\eta_1 = R(\Theta)\,\nu_1, \qquad
    \dot\varphi = p + (q\sin\varphi + r\cos\varphi)\tan\theta, \quad
    \dot\theta = q\cos\varphi - r\sin\varphi, \quad
    \dot\psi = (q\sin\varphi + r\cos\varphi)/\cos\theta

with the zyx convention, Fossen (2011), section 2.2.1; singular at
:math:`\theta = \pm 90` degrees. The quaternion :math:`e = (e_0, e_1, e_2, e_3)`, scalar
first, has no singularity,

.. math:: \dot e = \tfrac12 T(e)\,\omega,

section 2.2.2. The rotation divides by its length, so that no start value that an estimator tries
can be invalid and errors of integration in it have no effect; it is not pulled to one, as is usual
in simulations, because its length would then be seen through the integration error of the pull
alone, and an estimator would go after that. The first state is ``de0``, :math:`e_0 - 1`, so that
states of zero are the attitude of zero angles and not nothing.

References
----------
Fossen (2011), Handbook of marine craft hydrodynamics and motion control, ch. 2, Wiley.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

from oed_sysid.physics.texts import minus, plus, times

QUATERNION = ("de0", "e1", "e2", "e3")


@dataclass(frozen=True)
class Attitude:
    """How a body is oriented.

    Attributes
    ----------
    states : dict of str to str
        ``state -> rate``.
    signals : dict of str to str
        Entries of the rotation matrix that are worth a name.
    rotation : tuple of tuple of str
        Rotation matrix from body axes to NED.
    angles : dict of str to str
        Roll, pitch and yaw as expressions of the states.
    """

    states: dict[str, str]
    signals: dict[str, str]
    rotation: tuple[tuple[str, ...], ...]
    angles: dict[str, str]


def rotation(present: Collection[str]) -> tuple[tuple[str, ...], ...]:
    """Rotation matrix from body axes to NED by the angles that are present; the others are zero.

    >>> rotation(["theta"])[2]
    ('-sin(theta)', '0', 'cos(theta)')
    """

    def c(angle: str) -> str:
        return f"cos({angle})" if angle in present else "1"

    def s(angle: str) -> str:
        return f"sin({angle})" if angle in present else "0"

    return (
        (
            times(c("psi"), c("theta")),
            plus(times(c("psi"), s("theta"), s("phi")), minus(times(s("psi"), c("phi")))),
            plus(times(s("psi"), s("phi")), times(c("psi"), s("theta"), c("phi"))),
        ),
        (
            times(s("psi"), c("theta")),
            plus(times(c("psi"), c("phi")), times(s("psi"), s("theta"), s("phi"))),
            plus(times(s("psi"), s("theta"), c("phi")), minus(times(c("psi"), s("phi")))),
        ),
        (minus(s("theta")), times(c("theta"), s("phi")), times(c("theta"), c("phi"))),
    )


def euler(active: Collection[str]) -> Attitude:
    """Euler angles of the rotations among ``active`` velocities; the others stay zero.

    >>> euler("uvr").rotation[0]
    ('cos(psi)', '-sin(psi)', '0')
    >>> euler("uvpr").states["psi"]
    'r*cos(phi)'
    """
    p, q, r = (rate if rate in active else "0" for rate in "pqr")
    present = [name for name, rate in (("phi", p), ("theta", q), ("psi", r)) if rate != "0"]

    sine, cosine = ("sin(phi)", "cos(phi)") if "phi" in present else ("0", "1")
    across = plus(times(q, sine), times(r, cosine))
    tangent = "tan(theta)" if "theta" in present else "0"
    yaw = across if "theta" not in present else f"({across})/cos(theta)"
    rates = {
        "phi": plus(p, times(across, tangent)),
        "theta": plus(times(q, cosine), minus(times(r, sine))),
        "psi": yaw,
    }
    rows = rotation(present)
    states = {name: rates[name] for name in present}
    named, signals = _named(rows) if len(present) > 1 else (rows, {})
    return Attitude(states, signals, named, {name: name for name in present})


def quaternion() -> Attitude:
    """Unit quaternion of a body that turns about all three axes."""
    rates = {
        "e0": "0.5*(-e1*p - e2*q - e3*r)",
        "e1": "0.5*(e0*p - e3*q + e2*r)",
        "e2": "0.5*(e3*p + e0*q - e1*r)",
        "e3": "0.5*(-e2*p + e1*q + e0*r)",
    }
    states = {state: rates[name] for state, name in zip(QUATERNION, rates, strict=True)}
    rows = (
        ("1 - 2*(e2**2 + e3**2)/e_norm", "2*(e1*e2 - e3*e0)/e_norm", "2*(e1*e3 + e2*e0)/e_norm"),
        ("2*(e1*e2 + e3*e0)/e_norm", "1 - 2*(e1**2 + e3**2)/e_norm", "2*(e2*e3 - e1*e0)/e_norm"),
        ("2*(e1*e3 - e2*e0)/e_norm", "2*(e2*e3 + e1*e0)/e_norm", "1 - 2*(e1**2 + e2**2)/e_norm"),
    )
    named, signals = _named(rows)
    angles = {
        "phi": "atan2(R_32, R_33)",
        "theta": "asin(clip(-R_31, -1, 1))",
        "psi": "atan2(R_21, R_11)",
    }
    norm = "e0**2 + e1**2 + e2**2 + e3**2"
    return Attitude(states, {"e0": "1 + de0", "e_norm": norm, **signals}, named, angles)


def _named(
    rows: tuple[tuple[str, ...], ...],
) -> tuple[tuple[tuple[str, ...], ...], dict[str, str]]:
    """Give every entry that is not a single word a name."""
    names = [[f"R_{i}{j}" for j in (1, 2, 3)] for i in (1, 2, 3)]
    signals: dict[str, str] = {}
    table = []
    for i in range(3):
        row = []
        for j in range(3):
            text = rows[i][j]
            if text not in ("0", "1"):
                signals[names[i][j]] = text
            row.append(text if text in ("0", "1") else names[i][j])
        table.append(tuple(row))
    return tuple(table), signals


def quaternion_of(phi: float, theta: float, psi: float) -> dict[str, float]:
    """States of the quaternion of Euler angles in rad.

    >>> {name: round(value, 4) for name, value in quaternion_of(0.0, 0.0, math.pi).items()}
    {'de0': -1.0, 'e1': 0.0, 'e2': 0.0, 'e3': 1.0}
    """
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(angle / 2), math.sin(angle / 2)) for angle in (phi, theta, psi)
    )
    return {
        "de0": cy * cp * cr + sy * sp * sr - 1.0,
        "e1": cy * cp * sr - sy * sp * cr,
        "e2": sy * cp * sr + cy * sp * cr,
        "e3": sy * cp * cr - cy * sp * sr,
    }
