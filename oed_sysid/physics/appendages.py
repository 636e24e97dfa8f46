r"""What is mounted on a body: thrusters and fins, with place and direction.

A force :math:`F` at the place :math:`r` has the moment :math:`r \times F` about the
origin. A fin of normal :math:`n` (the side to which a positive angle lifts) sees the flow
:math:`v_f = \nu_{r1} + \omega \times r` of its own place,

.. math:: F = L\,u_f (u_f\,\delta - v_f \cdot n)\,n - D\,u_f^2\delta^2\,e_x, \qquad
          L = \tfrac{\rho}{2} S\,C_{L\alpha},

the lift of a thin wing at small angles of attack; Prestero (2001), section 4.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from oed_sysid.errors import ModelError
from oed_sysid.physics.base import Force
from oed_sysid.physics.momentum import AXES
from oed_sysid.physics.parameters import Parameter
from oed_sysid.physics.texts import Component, Place, cross, minus, plus, text_of, times

FOSSEN = "Fossen (2011), Handbook of marine craft hydrodynamics and motion control, ch. 9, Wiley."
PRESTERO = "Prestero (2001), Verification of a six-degree of freedom simulation model, MIT."
NORMALS: Mapping[str, Place] = {"horizontal": (0, 0, -1), "vertical": (0, 1, 0)}


def placed(name: str, at: Sequence[float | Parameter]) -> tuple[list[str], list[Parameter]]:
    """Coordinates of a place as texts, and a parameter for each that is not zero."""
    if len(at) != 3:
        raise ModelError(f"{name!r} has the place {at!r}; give x, y and z in m.")
    texts, parameters = [], []
    for letter, value in zip("xyz", at, strict=True):
        if not isinstance(value, Parameter) and float(value) == 0.0:
            texts.append("0")
            continue
        if not isinstance(value, Parameter):
            value = Parameter(
                f"{letter}_{name}", float(value), "m", fixed=True, description=f"place of {name}"
            )
        parameters.append(value)
        texts.append(value.name)
    return texts, parameters


def thruster(
    name: str,
    thrust: str,
    *,
    axes: Sequence[str],
    at: Sequence[float | Parameter] = (0.0, 0.0, 0.0),
    direction: Place = (1, 0, 0),
    torque: str = "0",
    parameters: Sequence[Parameter] = (),
) -> Force:
    """Thrust at a place in a direction; see :meth:`RigidBody.thruster`.

    >>> thruster("port", "T_p", axes="XYN", at=(-1.0, -0.5, 0.0)).terms
    {'X': 'T_p', 'N': '-y_port*T_p'}
    """
    place, own = placed(name, at)
    along = [text_of(component) for component in direction]
    force = [times(thrust, component) for component in along]
    moment = [
        plus(lever, times(torque, component))
        for lever, component in zip(cross(place, force), along, strict=True)
    ]
    return Force(
        name,
        _on(axes, [*force, *moment], name),
        (*parameters, *own),
        description=f"thrust of {name}",
        source=FOSSEN,
        needs="several thrusts at several speeds",
        amplitudes=(),
    )


def fin(
    name: str,
    deflection: str,
    *,
    axes: Sequence[str],
    flow: Sequence[str],
    turning: Sequence[str],
    at: Sequence[float | Parameter],
    normal: str | Place,
    lift: float | Parameter,
    drag: float | Parameter | None = None,
) -> Force:
    """Lift and drag of a fin; see :meth:`RigidBody.fin`."""
    place, own = placed(name, at)
    if isinstance(normal, str) and normal not in NORMALS:
        raise ModelError(
            f"Fin {name!r} has the normal {normal!r}. Choose horizontal, vertical, or (x, y, z)."
        )
    side = [text_of(c) for c in (NORMALS[normal] if isinstance(normal, str) else normal)]
    swept = cross(turning, place)
    ahead, *across = (plus(v, w) for v, w in zip(flow, swept, strict=True))
    u, v = f"{name}_u", f"{name}_v"
    into = plus(*(times(n, part) for n, part in zip(side[1:], across, strict=True)))
    slope = _coefficient(lift, f"L_{name}", "kg/m", f"lift slope of {name}")
    parameters = [slope]
    angle = plus(times(u, deflection), minus(v)) if into != "0" else times(u, deflection)
    push = times(slope.name, u, angle)
    force = [times(push, n) for n in side]
    if drag is not None:
        loss = _coefficient(drag, f"D_{name}", "kg/m", f"drag of a deflected {name}")
        parameters.append(loss)
        force[0] = plus(force[0], minus(times(loss.name, f"{u}**2", f"({deflection})**2")))
    return Force(
        name,
        _on(axes, [*force, *cross(place, force)], name),
        (*parameters, *own),
        definitions={u: ahead, v: into} if into != "0" else {u: ahead},
        description=f"lift{' and drag' if drag is not None else ''} of {name}",
        source=PRESTERO,
        needs=f"{deflection} of varied size at several speeds",
        amplitudes=tuple(p.name for p in parameters if not p.fixed),
    )


def _coefficient(value: float | Parameter, name: str, unit: str, words: str) -> Parameter:
    if isinstance(value, Parameter):
        return value
    return Parameter(name, float(value), unit, lower=0.0, description=words)


def _on(axes: Sequence[str], six: Sequence[Component], name: str) -> dict[str, str]:
    """Terms of the axes that a body has; none is an error."""
    terms = {
        axis: str(text)
        for axis, text in zip(AXES, six, strict=True)
        if axis in axes and text != "0"
    }
    if not terms:
        raise ModelError(
            f"{name!r} acts on none of the axes {', '.join(axes)} of this body. Check its "
            "direction."
        )
    return terms
