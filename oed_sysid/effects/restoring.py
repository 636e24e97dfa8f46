"""Weight, buoyancy and restoring moments."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed_sysid.effects.amplitudes import amplitude
from oed_sysid.effects.base import Force
from oed_sysid.effects.derivatives import derivative
from oed_sysid.parameters import Parameter

FOSSEN = "Fossen (2021), Handbook of marine craft hydrodynamics and motion control, ch. 4, Wiley."
IMO = "IMO (2008), Intact stability code, resolution MSC.267(85)."
NAYFEH = "Nayfeh & Mook (1979), Nonlinear oscillations, ch. 2, Wiley."


def excess_buoyancy(
    name: str = "excess_buoyancy", *, angle: str = "theta", scale: float = 2.0, value: float = 0.0
) -> Force:
    r"""Weight that buoyancy does not carry, :math:`E = W - B`, in the diving plane.

    >>> excess_buoyancy().terms
    {'X': '-E_excess_buoyancy*sin(theta)', 'Z': 'E_excess_buoyancy*cos(theta)'}
    """
    size = amplitude(name, "N", scale=scale, value=value, description="weight minus buoyancy")
    return Force(
        name,
        {"X": f"-{size.name}*sin({angle})", "Z": f"{size.name}*cos({angle})"},
        (size,),
        description="weight differs from buoyancy",
        source=FOSSEN,
        needs="several speeds: a constant force, where hull and fin forces grow with speed",
    )


def cg_offset(
    name: str = "cg_offset_x",
    *,
    axis: str = "M",
    angle: str = "theta",
    scale: float = 0.5,
    value: float = 0.0,
) -> Force:
    r"""Centre of gravity ahead of that of buoyancy: :math:`M = -E\cos\theta`, :math:`E = x_gW`."""
    size = amplitude(name, "N m", scale=scale, value=value, description="lever times weight")
    return Force(
        name,
        {axis: f"-{size.name}*cos({angle})"},
        (size,),
        description="centres of gravity and buoyancy are apart along the hull",
        source=FOSSEN,
        needs="several speeds: a constant moment, where fin moments grow with speed",
    )


def metacentric_moment(
    name: str,
    axis: str,
    angle: str,
    *,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    r"""Righting moment :math:`-E\sin\theta` with :math:`E = \overline{BG}\,W`."""
    size = amplitude(name, "N m", scale=scale, value=value, parameter=parameter)
    return Force(
        name,
        {axis: f"-{size.name}*sin({angle})"},
        (size,),
        description="righting moment of a low centre of gravity",
        source=FOSSEN,
        needs=f"large {angle} at low speed",
    )


def cubic_restoring(
    name: str,
    axis: str = "K",
    angle: str = "phi",
    *,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    r"""Hardening or softening of the restoring moment, :math:`E\,\varphi^3`."""
    return derivative(
        name,
        f"{axis}_{angle * 3}",
        scale=scale,
        value=value,
        parameter=parameter,
        source=NAYFEH,
        needs=f"small and large {angle}: the natural frequency changes with amplitude",
    )


def heel_moment(
    name: str,
    axis: str = "K",
    *,
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    """Constant moment of shifted cargo or steady wind."""
    return derivative(
        name,
        f"{axis}_0",
        scale=scale,
        value=value,
        parameter=parameter,
        description="constant heeling moment",
        source=IMO,
        needs="a mean angle that is not zero; nothing tells it from a bias of the angle's sensor",
    )


def righting_arm_table(
    name: str,
    angles: Sequence[float],
    arms: Sequence[float],
    *,
    axis: str = "K",
    angle: str = "phi",
    scale: float | None = None,
    value: float = 0.0,
    parameter: str | None = None,
) -> Force:
    r"""Righting moment from a tabulated arm, :math:`-E\,\overline{GZ}(\varphi)`, :math:`E = W`.

    ``angles`` in rad, ascending, and ``arms`` in m; linear in between.
    """
    size = amplitude(name, "N", scale=scale, value=value, parameter=parameter)
    table = f"{name}_arm"
    return Force(
        name,
        {axis: f"-{size.name}*{table}({angle})"},
        (size,),
        tables={table: (np.asarray(angles, float), np.asarray(arms, float))},
        description="righting arm curve",
        source=IMO,
        needs=f"{angle} over the whole range of the table",
    )


def hull_compressibility(
    name: str = "hull_compressibility",
    *,
    axis: str = "Z",
    depth: str = "z",
    reference: float = 10.0,
    scale: float = 0.15,
    value: float = 0.0,
) -> Force:
    r"""Buoyancy lost with depth, :math:`Z = E\,(z - z_0)`; absent at the reference depth."""
    size = amplitude(name, "N/m", scale=scale, value=value, description="force per depth")
    zero = Parameter(f"depth_{name}", reference, "m", fixed=True, description="depth of trim")
    return Force(
        name,
        {axis: f"{size.name}*({depth} - {zero.name})"},
        (size, zero),
        amplitudes=(size.name,),
        description="the hull is compressed more than the water",
        source=FOSSEN,
        needs="a change of depth that is large against the manoeuvre",
    )
