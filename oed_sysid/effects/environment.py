"""Current, wind and waves.

A current changes the velocity through the water, not the forces themselves.
It is steady and uniform, and the rotation of a steady current in body axes is
left out of the added-mass terms, as in the models that this package ships.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from oed_sysid.effects.amplitudes import amplitude
from oed_sysid.effects.base import Environment, Force
from oed_sysid.parameters import Parameter

CURRENT = "Fossen (2021), Handbook of marine craft hydrodynamics and motion control, ch. 10."
WIND = "Isherwood (1973), Wind resistance of merchant ships, Trans. RINA 115; Fossen (2021) ch. 10."
WAVES = "Faltinsen (1990), Sea loads on ships and offshore structures, ch. 3."
AIR_DENSITY = 1.225  # kg/m3, ICAO standard atmosphere at sea level


def current_forward(
    name: str = "current_horizontal",
    *,
    flow: tuple[str, str] = ("u_r", "w_r"),
    angle: str = "theta",
    scale: float = 0.15,
    value: float = 0.0,
) -> Environment:
    """Horizontal water velocity along the track, diving plane."""
    size = amplitude(name, "m/s", scale=scale, value=value, bound=2.0)
    forward, down = flow
    return Environment(
        name,
        {
            forward: f"{forward} - {size.name}*cos({angle})",
            down: f"{down} - {size.name}*sin({angle})",
        },
        (size,),
        description="steady horizontal current, positive forward",
        source=CURRENT,
        needs="velocity over ground measured, at several speeds",
    )


def current_down(
    name: str = "current_vertical",
    *,
    flow: tuple[str, str] = ("u_r", "w_r"),
    angle: str = "theta",
    scale: float = 0.05,
    value: float = 0.0,
) -> Environment:
    """Vertical water velocity, diving plane, positive down."""
    size = amplitude(name, "m/s", scale=scale, value=value, bound=2.0)
    forward, down = flow
    return Environment(
        name,
        {
            forward: f"{forward} + {size.name}*sin({angle})",
            down: f"{down} - {size.name}*cos({angle})",
        },
        (size,),
        description="steady vertical current, positive down",
        source=CURRENT,
        needs="velocity over ground measured, at several speeds and pitch angles",
    )


def current_horizontal_plane(
    name: str = "current",
    *,
    flow: tuple[str, str] = ("u_r", "v_r"),
    heading: str = "psi",
    scale: float = 0.3,
    north: float = 0.0,
    east: float = 0.0,
) -> Environment:
    """Steady current towards north and east, for a vehicle that turns."""
    n = amplitude(f"{name}_north", "m/s", scale=scale, value=north, bound=3.0)
    e = amplitude(f"{name}_east", "m/s", scale=scale, value=east, bound=3.0)
    forward, starboard = flow
    return Environment(
        name,
        {
            forward: f"{forward} - ({n.name}*cos({heading}) + {e.name}*sin({heading}))",
            starboard: f"{starboard} - ({e.name}*cos({heading}) - {n.name}*sin({heading}))",
        },
        (n, e),
        description="steady horizontal current",
        source=CURRENT,
        needs="position or velocity over ground, on several headings (a turning circle)",
    )


def wave_force(
    name: str,
    axis: str,
    unit: str = "N",
    *,
    frequency: float = 1.0,
    spread: float = 0.4,
    scale: float = 1.0,
    per_record: bool = False,
) -> Force:
    r"""Regular wave, :math:`E_c\cos\omega t + E_s\sin\omega t`, of unknown frequency.

    The frequency of encounter may differ from ``frequency`` by the fraction
    ``spread``; ``per_record`` frees amplitude and phase in every record.
    """
    parts = [
        amplitude(f"{name}_{part}", unit, scale=scale, per_record=per_record)
        for part in ("cos", "sin")
    ]
    low, high = frequency * (1 - spread), frequency * (1 + spread)
    omega = Parameter(f"omega_{name}", frequency, "rad/s", low, high, scale=0.1 * frequency)
    cosine, sine = (part.name for part in parts)
    return Force(
        name,
        {axis: f"{cosine}*cos({omega.name}*t) + {sine}*sin({omega.name}*t)"},
        (*parts, omega),
        amplitudes=(cosine, sine),
        description="force of a regular wave",
        source=WAVES,
        needs="many wave periods, with motion of other frequencies",
    )


def steady_wind(
    name: str = "wind",
    *,
    axes: tuple[str, ...] = ("X", "Y", "N"),
    heading: str = "psi",
    force: float = 1.0,
    arm: float = 1.0,
) -> Force:
    r"""Steady wind on a vehicle whose own speed is small against it, without coefficient tables.

    .. math:: X = E_n\cos\psi + E_e\sin\psi, \quad Y = E_e\cos\psi - E_n\sin\psi, \quad
              N = l\,Y

    Two amplitudes are the force towards north and east; the third, its lever of ``Y``, is a
    length that is zero when the wind pushes at the origin. Like a hull of equal
    resistance from all sides: a first candidate, to be replaced by :func:`wind_load`.

    Parameters
    ----------
    name : str
        Name of the effect.
    axes : tuple of str
        Which of ``X Y N`` the model has.
    heading : str
        State or signal of the heading.
    force, arm : float
        Typical force in N and lever in m.
    """
    north = amplitude(f"{name}_north", "N", scale=force)
    east = amplitude(f"{name}_east", "N", scale=force)
    lever = Parameter(f"arm_{name}", 0.0, "m", -3 * arm, 3 * arm, scale=arm, description="lever")
    side = f"({east.name}*cos({heading}) - {north.name}*sin({heading}))"
    terms = {
        "X": f"{north.name}*cos({heading}) + {east.name}*sin({heading})",
        "Y": side,
        "N": f"{lever.name}*{side}",
    }
    return Force(
        name,
        {axis: terms[axis] for axis in axes},
        (north, east, lever) if "N" in axes else (north, east),
        amplitudes=(north.name, east.name),
        description="force of a steady wind",
        source=WIND,
        needs="several headings to the wind (a turning circle)",
    )


def wind_load(
    name: str,
    coefficients: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    *,
    speed: float,
    direction: float,
    area: float,
    length: float,
    heading: str = "psi",
    scale: float = 0.3,
    value: float = 0.0,
) -> Force:
    r"""Wind load from coefficient tables, :math:`E\,\frac{\rho}{2}AV^2C(\gamma)`.

    ``coefficients`` holds ``axis -> (angles [rad] in ±π, values)``, where the
    angle of attack :math:`\gamma = \operatorname{atan2}(-v_a, -u_a)` is the direction,
    in body axes, that the relative wind blows to: 0 from astern, π/2 from port.
    ``direction`` (from north, clockwise) is where the true wind blows to. Moments are
    multiplied by ``length``. ``E`` is 1 where the tables hold and 0 without any wind load.
    """
    size = amplitude(name, "1", scale=scale, value=value)
    facts = {
        "speed": (speed, "m/s"),
        "direction": (direction, "rad"),
        "area": (area, "m^2"),
        "length": (length, "m"),
        "density": (AIR_DENSITY, "kg/m^3"),
    }
    known = {k: Parameter(f"{k}_{name}", x, unit, fixed=True) for k, (x, unit) in facts.items()}
    blow = f"({known['direction'].name} - {heading})"
    pressure = f"{known['density'].name}/2*{known['area'].name}*(air_u**2 + air_v**2)"
    moment = {axis: f"*{known['length'].name}" if axis in "KMN" else "" for axis in coefficients}
    return Force(
        name,
        {
            axis: f"{size.name}*{pressure}*{name}_{axis}(attack){moment[axis]}"
            for axis in coefficients
        },
        (size, *known.values()),
        amplitudes=(size.name,),
        definitions={
            "air_u": f"u - {known['speed'].name}*cos{blow}",
            "air_v": f"v - {known['speed'].name}*sin{blow}",
            "attack": "atan2(-air_v, 1e-9 - air_u)",
        },
        tables={
            f"{name}_{axis}": (np.asarray(x, float), np.asarray(y, float))
            for axis, (x, y) in coefficients.items()
        },
        description="wind load on the superstructure",
        source=WIND,
        needs="several headings to the wind",
    )
