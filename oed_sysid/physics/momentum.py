r"""Inertia of a body and of the water around it, and the forces that follow from it.

With the momentum :math:`(a, b) = M \nu` of a symmetric matrix :math:`M` the
Coriolis and centripetal forces are

.. math:: -C(\nu)\,\nu = \begin{pmatrix} a \times \nu_2 \\
          a \times \nu_1 + b \times \nu_2 \end{pmatrix},

Fossen (2011), theorem 3.2: :math:`C` is skew, so they do no work. For the rigid body
:math:`M = M_{RB}` (section 3.3) and the velocity is that over ground; for the water
:math:`M = M_A`, minus the acceleration derivatives (section 6.3.1), and the velocity is
that through the water.

References
----------
Fossen (2011), Handbook of marine craft hydrodynamics and motion control, ch. 3 and 6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from oed_sysid.physics.texts import cross, minus, plus, times

VELOCITIES = ("u", "v", "w", "p", "q", "r")
AXES = ("X", "Y", "Z", "K", "M", "N")
Matrix = dict[tuple[int, int], str]


def rigid_matrix(present: Mapping[str, object]) -> Matrix:
    """Entries of the rigid body's inertia about the origin, Fossen (2011), section 3.3.

    ``present`` names the constants that are not zero: ``m x_G y_G z_G I_xx I_xy ...``.

    >>> rigid_matrix(["m", "z_G", "I_xx"])
    {(0, 0): 'm', (1, 1): 'm', (2, 2): 'm', (0, 4): 'm*z_G', (1, 3): '-m*z_G', (3, 3): 'I_xx'}
    """
    entries: Matrix = {(i, i): "m" for i in range(3)}
    levers = {(0, 4): "z_G", (0, 5): "-y_G", (1, 3): "-z_G", (1, 5): "x_G", (2, 3): "y_G"}
    levers[2, 4] = "-x_G"
    for key, lever in levers.items():
        if lever.lstrip("-") in present:
            entries[key] = times("m", lever)
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


def momentum(entries: Matrix, velocity: Sequence[str]) -> list[str]:
    """Momentum of six components as texts."""
    rows: list[list[str]] = [[] for _ in range(6)]
    for (i, j), entry in sorted(entries.items()):
        rows[i].append(times(entry, velocity[j]))
        if i != j:
            rows[j].append(times(entry, velocity[i]))
    return [plus(*row) for row in rows]


def gyroscopic(
    entries: Matrix, velocity: Sequence[str], names: Sequence[str]
) -> tuple[dict[str, str], list[str]]:
    """Definitions of the momentum that is needed, and the forces on six axes."""
    texts = momentum(entries, velocity)
    symbols = ["0" if text == "0" else name for name, text in zip(names, texts, strict=True)]
    first, second = velocity[:3], velocity[3:]
    forces = list(cross(symbols[:3], second))
    moments = zip(cross(symbols[:3], first), cross(symbols[3:], second), strict=True)
    forces += [plus(*pair) for pair in moments]
    definitions = {
        name: text
        for name, text in zip(names, texts, strict=True)
        if text != "0" and any(name in force for force in forces)
    }
    return definitions, forces


def current_rotation(entries: Matrix, velocity: Sequence[str], drift: Sequence[str]) -> list[str]:
    """Added inertia times the rate of a steady current in turning body axes, six axes.

    The current ``drift`` is steady in NED, so that in body axes its rate is minus the
    angular velocity times it; Fossen (2011), section 8.3.
    """
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
    result[:3, 3:] = result[3:, :3] = -_skew(both[:3])
    result[3:, 3:] = -_skew(both[3:])
    return result


def _skew(vector: np.ndarray) -> np.ndarray:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
