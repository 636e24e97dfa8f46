r"""Attitude and inertia of a body and of the water around it, as texts of a model.

*Attitude.* With rotation :math:`R(\Theta)` from body axes to NED, Euler angles of the zyx
convention, Fossen (2011), section 2.2.1,

.. math::

    \dot\eta_1 = R(\Theta)\,\nu_1, \qquad
    \dot\varphi = p + (q\sin\varphi + r\cos\varphi)\tan\theta, \quad
    \dot\theta = q\cos\varphi - r\sin\varphi, \quad
    \dot\psi = (q\sin\varphi + r\cos\varphi)/\cos\theta ,

are singular at :math:`\theta = \pm 90` degrees. The quaternion :math:`e = (e_0, e_1, e_2, e_3)`,
scalar first, has no singularity,

.. math:: \dot e = \tfrac12 T(e)\,\omega,

section 2.2.2. The rotation divides by its length, so that no start value that an estimator tries
can be invalid and errors of integration in it have no effect; it is not pulled to one, as is usual
in simulations, because its length would then be seen through the integration error of the pull
alone, and an estimator would go after that. The first state is ``de0``, :math:`e_0 - 1`, so that
states of zero are the attitude of zero angles and not nothing.

*Inertia.* With the momentum :math:`(a, b) = M \nu` of a symmetric matrix :math:`M` the
Coriolis and centripetal forces are

.. math:: -C(\nu)\,\nu = \begin{pmatrix} a \times \nu_2 \\
          a \times \nu_1 + b \times \nu_2 \end{pmatrix},

Fossen (2011), theorem 3.2: :math:`C` is skew, so they do no work. For the rigid body
:math:`M = M_{RB}` (section 3.3) and the velocity is that over ground; for the water
:math:`M = M_A`, minus the acceleration derivatives (section 6.3.1), and the velocity is
that through the water.

References
----------
Fossen (2011), Handbook of marine craft hydrodynamics and motion control, ch. 2, 3 and 6, Wiley.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

VELOCITIES = ("u", "v", "w", "p", "q", "r")
AXES = ("X", "Y", "Z", "K", "M", "N")
QUATERNION = ("de0", "e1", "e2", "e3")
DEGREES: Mapping[int, str] = {3: "uvr", 4: "uvpr", 6: "uvwpqr"}
MOTIONS = dict(zip(("surge", "sway", "heave", "roll", "pitch", "yaw"), VELOCITIES, strict=True))
LABELS = {
    **{v: f"{m} velocity" for m, v in MOTIONS.items() if v in "uvw"},
    **{v: f"{m} rate" for m, v in MOTIONS.items() if v in "pqr"},
    **{"x": "north", "y": "east", "z": "depth", "phi": "roll angle", "theta": "pitch angle"},
    "psi": "heading",
}
UNITS = {
    **dict.fromkeys("uvw", "m/s"),
    **dict.fromkeys("pqr", "rad/s"),
    **dict.fromkeys("xyz", "m"),
    **dict.fromkeys(("phi", "theta", "psi"), "rad"),
    **dict.fromkeys(QUATERNION, "1"),
}
SIZES = {"v": 0.3, "w": 0.3, "p": 0.2, "q": 0.2, "r": 0.2, "x": 10.0, "y": 10.0}
SIZES |= {"phi": 0.3, "theta": 0.3, **dict.fromkeys(QUATERNION, 0.5), "de0": 0.05}

Matrix = dict[tuple[int, int], str]
Component = float | str
Place = Sequence[Component]
Texts = Sequence[str]

_SUM = re.compile(r"(?<![eE*(])[+-]")


# -- sums and products of texts, without zeros and ones ---------------------------------


def text_of(value: Component) -> str:
    """A number or a text as text; whole numbers without a point."""
    if isinstance(value, str):
        return value
    short = f"{value:.12g}"
    return short if float(short) == value else repr(float(value))


def minus(text: str) -> str:
    """The negative of a text."""
    if text == "0":
        return "0"
    return text[1:] if text.startswith("-") and not _is_sum(text[1:]) else f"-{_grouped(text)}"


def times(*factors: str) -> str:
    """Product of texts; sums among them are put in parentheses."""
    if "0" in factors:
        return "0"
    negative = False
    kept = []
    for factor in factors:
        while factor.startswith("-") and not _is_sum(factor[1:]):
            negative, factor = not negative, factor[1:]
        if factor != "1":
            kept.append(_grouped(factor))
    text = "*".join(kept) or "1"
    return f"-{text}" if negative else text


def plus(*terms: str) -> str:
    """Sum of texts.

    >>> plus(times("m", "u"), minus(times("m", "0", "r")), times("1", "q"))
    'm*u + q'
    """
    text, *others = [term for term in terms if term != "0"] or ["0"]
    return text + "".join(f" - {t[1:]}" if t.startswith("-") else f" + {t}" for t in others)


def cross(first: Texts, second: Texts) -> tuple[str, str, str]:
    """Vector product of two vectors of texts.

    >>> cross(("0", "0", "T"), ("x", "0", "0"))
    ('0', 'T*x', '0')
    """
    (a, b, c), (x, y, z) = first, second
    return (
        plus(times(b, z), minus(times(c, y))),
        plus(times(c, x), minus(times(a, z))),
        plus(times(a, y), minus(times(b, x))),
    )


def _is_sum(text: str) -> bool:
    """Whether a sum stands outside of all parentheses."""
    depth, outside = 0, []
    for sign in text:
        depth += (sign == "(") - (sign == ")")
        outside.append(sign if depth == 0 else " ")
    return bool(_SUM.search("".join(outside)[1:]))


def _grouped(text: str) -> str:
    return f"({text})" if _is_sum(text) else text


# -- attitude ---------------------------------------------------------------------------


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
    angles = ("phi", "theta", "psi")
    cr, cp, cy = (f"cos({angle})" if angle in present else "1" for angle in angles)
    sr, sp, sy = (f"sin({angle})" if angle in present else "0" for angle in angles)
    return (
        (
            times(cy, cp),
            plus(times(cy, sp, sr), minus(times(sy, cr))),
            plus(times(sy, sr), times(cy, sp, cr)),
        ),
        (
            times(sy, cp),
            plus(times(cy, cr), times(sy, sp, sr)),
            plus(times(sy, sp, cr), minus(times(cy, sr))),
        ),
        (minus(sp), times(cp, sr), times(cp, cr)),
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

    # Rates of the zyx Euler angles, section 2.2.1, with angles that are not free at zero.
    sine, cosine = ("sin(phi)", "cos(phi)") if "phi" in present else ("0", "1")
    across = plus(times(q, sine), times(r, cosine))
    tangent = "tan(theta)" if "theta" in present else "0"
    yaw = across if tangent == "0" else f"({across})/cos(theta)"
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
    states = {
        "de0": "0.5*(-e1*p - e2*q - e3*r)",
        "e1": "0.5*(e0*p - e3*q + e2*r)",
        "e2": "0.5*(e3*p + e0*q - e1*r)",
        "e3": "0.5*(-e2*p + e1*q + e0*r)",
    }
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
    signals: dict[str, str] = {}
    table = [list(row) for row in rows]
    for i, row in enumerate(table):
        for j, text in enumerate(row):
            if text not in ("0", "1"):
                row[j] = f"R_{i + 1}{j + 1}"
                signals[row[j]] = text
    return tuple(map(tuple, table)), signals


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


# -- inertia and what follows from it ---------------------------------------------------


def rigid_matrix(present: Mapping[str, object]) -> Matrix:
    """Entries of the rigid body's inertia about the origin, Fossen (2011), section 3.3.

    ``present`` names the constants that are not zero: ``m x_G y_G z_G I_xx I_xy ...``.

    >>> rigid_matrix(["m", "z_G", "I_xx"])
    {(0, 0): 'm', (1, 1): 'm', (2, 2): 'm', (0, 4): 'm*z_G', (1, 3): '-m*z_G', (3, 3): 'I_xx'}
    """
    # Upper triangle of M_RB about the origin: m I, the levers -m S(r_G), and the inertia I_b;
    # section 3.3.
    entries: Matrix = {(i, i): "m" for i in range(3)}
    levers = {(0, 4): "z_G", (0, 5): "-y_G", (1, 3): "-z_G", (1, 5): "x_G", (2, 3): "y_G"}
    levers[2, 4] = "-x_G"
    entries |= {key: times("m", arm) for key, arm in levers.items() if arm.lstrip("-") in present}
    # Products of inertia stand with a minus, moments with a plus.
    names = {(3, 3): "I_xx", (4, 4): "I_yy", (5, 5): "I_zz"}
    names |= {(3, 4): "-I_xy", (3, 5): "-I_xz", (4, 5): "-I_yz"}
    entries |= {key: name for key, name in names.items() if name.lstrip("-") in present}
    return entries


def added_matrix(names: Sequence[str]) -> Matrix:
    """Entries of the added inertia from the names of its derivatives, ``-Y_rdot`` and so on.

    >>> added_matrix(["X_udot", "N_vdot"])
    {(0, 0): '-X_udot', (1, 5): '-N_vdot'}
    """
    entries: Matrix = {}
    for name in names:
        i, j = AXES.index(name[0]), VELOCITIES.index(name[2])
        entries[min(i, j), max(i, j)] = f"-{name}"
    return entries


def momentum(entries: Matrix, velocity: Texts) -> list[str]:
    """Momentum of six components as texts."""
    rows: list[list[str]] = [[] for _ in range(6)]
    for (i, j), entry in sorted(entries.items()):
        rows[i].append(times(entry, velocity[j]))
        if i != j:
            rows[j].append(times(entry, velocity[i]))
    return [plus(*row) for row in rows]


def gyroscopic(entries: Matrix, velocity: Texts, names: Texts) -> tuple[dict[str, str], list[str]]:
    """Definitions of the momentum that is needed, and the forces on six axes."""
    texts = momentum(entries, velocity)
    symbols = ["0" if text == "0" else name for name, text in zip(names, texts, strict=True)]
    first, second = velocity[:3], velocity[3:]
    # -C(nu) nu with the linear momentum a and the angular one b: a x nu_2, and
    # a x nu_1 + b x nu_2; theorem 3.2.
    forces = list(cross(symbols[:3], second))
    moments = zip(cross(symbols[:3], first), cross(symbols[3:], second), strict=True)
    forces += [plus(*pair) for pair in moments]
    definitions = {
        name: text
        for name, text in zip(names, texts, strict=True)
        if text != "0" and any(name in force for force in forces)
    }
    return definitions, forces


def current_rotation(entries: Matrix, velocity: Texts, drift: Texts) -> list[str]:
    """Added inertia times the rate of a steady current in turning body axes, six axes.

    The current ``drift`` is steady in NED, so that in body axes its rate is minus the
    angular velocity times it; Fossen (2011), section 8.3.
    """
    # A current that is steady in NED turns backwards in body axes: v_c' = -omega x v_c.
    rate = [*(minus(text) for text in cross(velocity[3:], drift)), "0", "0", "0"]
    return momentum(entries, rate)


def coriolis_matrix(matrix: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Skew Coriolis-centripetal matrix of an inertia matrix, Fossen (2011), theorem 3.2.

    Parameters
    ----------
    matrix : ndarray (6, 6)
        Symmetric inertia matrix about the origin.
    velocity : ndarray (6,)

    Returns
    -------
    ndarray (6, 6)
    """
    both = matrix @ velocity
    result = np.zeros((6, 6))
    # Minus the skew matrix of a vector: its products with the axes.
    result[:3, 3:] = result[3:, :3] = np.cross(both[:3], np.eye(3))
    result[3:, 3:] = np.cross(both[3:], np.eye(3))
    return result
