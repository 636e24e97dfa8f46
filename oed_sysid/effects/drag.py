"""Damping and drag: linear, quadratic, cubic, crossed and induced."""

from __future__ import annotations

from oed_sysid.effects.base import Force
from oed_sysid.effects.derivatives import derivative, factor_of

FALTINSEN = "Faltinsen (1990), Sea loads on ships and offshore structures, ch. 6, Cambridge."
FOSSEN = "Fossen (2021), Handbook of marine craft hydrodynamics and motion control, ch. 6, Wiley."
HOERNER = "Hoerner (1965), Fluid-dynamic drag, ch. 7 (drag due to lift)."
PRESTERO = "Prestero (2001), Verification of a six-degree of freedom simulation model, MIT."
FEDYAEVSKY = "Fedyaevsky & Sobolev (1964), Control and stability in ship design."


def linear_damping(
    name: str,
    axis: str,
    velocity: str,
    *,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    """Force proportional to a velocity: skin friction at low Reynolds number, wave making.

    >>> linear_damping("surge_linear_drag", "X", "u_r").terms
    {'X': 'E_surge_linear_drag*u_r'}
    """
    return derivative(
        name,
        f"{axis}_{factor_of(velocity)}",
        symbols={factor_of(velocity): velocity},
        scale=scale,
        value=value,
        parameter=parameter,
        source=FOSSEN,
        needs=f"low and high {velocity}, to tell it from quadratic drag",
    )


def quadratic_drag(
    name: str,
    axis: str,
    velocity: str,
    *,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    r"""Separated-flow drag :math:`E\,v|v|`; on another axis than the velocity's, its moment.

    >>> quadratic_drag("heave_crossflow_drag", "Z", "w_r", parameter="Z_absww").terms
    {'Z': 'Z_absww*abs(w_r)*w_r'}
    """
    factor = factor_of(velocity)
    return derivative(
        name,
        f"{axis}_abs{factor}{factor}",
        symbols={factor: velocity},
        scale=scale,
        value=value,
        parameter=parameter,
        source=FALTINSEN,
        needs=f"large {velocity} at varied forward speed",
    )


def cubic_damping(
    name: str,
    axis: str,
    velocity: str,
    *,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    """Damping that grows with the third power of a velocity."""
    factor = factor_of(velocity)
    return derivative(
        name,
        f"{axis}_{factor * 3}",
        symbols={factor: velocity},
        scale=scale,
        value=value,
        parameter=parameter,
        source=FOSSEN,
        needs=f"small and large {velocity}",
    )


def crossed_drag(
    name: str,
    axis: str,
    absolute: str,
    velocity: str,
    *,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    r"""Cross-flow drag of combined drift and turn, such as :math:`E\,|v_r|r`."""
    first, second = factor_of(absolute), factor_of(velocity)
    return derivative(
        name,
        f"{axis}_abs{first}{second}",
        symbols={first: absolute, second: velocity},
        scale=scale,
        value=value,
        parameter=parameter,
        source=FEDYAEVSKY,
        needs=f"large {absolute} and {velocity} in varied proportion",
    )


def induced_drag(
    name: str,
    velocity: str,
    *,
    axis: str = "X",
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    r"""Drag due to lift, :math:`E\,w_r^2`: resistance grows with the angle of attack."""
    factor = factor_of(velocity)
    return derivative(
        name,
        f"{axis}_{factor * 2}",
        symbols={factor: velocity},
        scale=scale,
        value=value,
        parameter=parameter,
        source=HOERNER,
        needs=f"large {velocity} while forward speed is measured",
    )


def deflection_drag(
    name: str,
    deflection: str,
    *,
    axis: str = "X",
    velocity: str = "u_r",
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    r"""Drag of a deflected fin or rudder, :math:`E\,u_r^2 d^2`."""
    return derivative(
        name,
        f"{axis}_uu{deflection * 2}",
        symbols={"u": velocity},
        scale=scale,
        value=value,
        parameter=parameter,
        source=HOERNER,
        needs=f"large {deflection}, held and alternating",
    )


def hull_asymmetry(
    name: str,
    axis: str,
    *,
    velocity: str = "u_r",
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    r"""Lift or moment of a hull that is not symmetric, :math:`E\,u_r^2`."""
    return derivative(
        name,
        f"{axis}_uu",
        symbols={"u": velocity},
        scale=scale,
        value=value,
        parameter=parameter,
        source=PRESTERO,
        needs="several speeds, to tell it from offsets that do not grow with speed",
    )
