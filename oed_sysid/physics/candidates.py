"""Ready-made candidate effects for the usual kinds of vehicle.

What a diagnosis tries when the user names nothing else. Each has one amplitude
(two where a direction or a phase is unknown), called ``"E_" + identifier``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from oed_sysid.physics import forces, signals
from oed_sysid.physics.base import Effect, Force, amplitude
from oed_sysid.physics.table import FOSSEN
from oed_sysid.physics.variants import day_to_day
from oed_sysid.runtime.tables import tables
from oed_sysid.text import expressions, notation

SEA_WATER_DENSITY = 1025.0  # kg/m3, at 15 degrees Celsius and 3.5 per cent salinity

_SETS = tables(__file__)


def listed(kind: str, **known: Any) -> list[Any]:
    """Effects of one set of ``candidates.toml``, for what is known of a vehicle.

    A row that asks for what is None is left out: this vehicle has no such thing. A problem leaves
    out what its model lacks the signals for.
    """
    numbers = {name: x for name, x in known.items() if isinstance(x, int | float)}
    lacking = {f"={name}" for name, x in known.items() if x is None}

    def value(given: Any) -> Any:
        if isinstance(given, Mapping):
            return {key: value(text) for key, text in given.items()}
        if not isinstance(given, str) or not given.startswith("="):
            return given
        formula = given[1:]
        if formula in known:
            return known[formula]
        for name in expressions.names(formula) - set(numbers):
            size = {key: numbers[key] for key in ("density", "length", "speed")}
            numbers[name] = notation.prime_scale(name, **size)
        return float(expressions.to_numpy(formula, numbers))

    made = (
        _CONSTRUCTORS[effect](
            name=name.format(**known),
            **{key: value(given) for part in arguments for key, given in part.items()},
        )
        for name, effect, *arguments in _SETS[kind]
        if not any(lacking & {x for x in part.values() if isinstance(x, str)} for part in arguments)
    )
    return [replace(effect, optional=True) for effect in made]


def product(*, name: str, axis: str, factor: str, unit: str, scale: float, **words: Any) -> Force:
    """A force in proportion to a product of signals; ``words`` are description and needs."""
    size = amplitude(name, unit, scale=scale)
    return Force(name, {axis: f"{size.name}*{factor}"}, (size,), source=FOSSEN, **words)


_CONSTRUCTORS: Mapping[str, Any] = {**vars(forces), **vars(signals), "product": product}


def diving_plane_effects(*, step: float = 0.1) -> tuple[Effect, ...]:
    """Candidate effects of a small AUV in the diving plane.

    The model has states ``u w q theta z``, flow signals ``u_r w_r``, actuator
    signals ``ds T``, axes ``X Z M`` and outputs named as the states. Scales suit
    a vehicle of about 30 kg and 1.5 m at 1.5 m/s.

    Parameters
    ----------
    step : float
        Shortest integration step in s, which sizes the register of the delay.

    Returns
    -------
    tuple of Effect
        Candidates; their amplitudes are zero.

    Examples
    --------
    >>> effects = diving_plane_effects()
    >>> len(effects), effects[0].name, effects[0].amplitude_names
    (40, 'heave_crossflow_drag', ('E_heave_crossflow_drag',))
    """
    return tuple(listed("diving_plane", step=step))


def surface_ship_effects(
    *,
    length: float = 160.93,
    speed: float = 7.72,
    density: float = SEA_WATER_DENSITY,
    thrust: str = "T",
) -> tuple[Effect, ...]:
    """Candidate effects of a surface ship in surge, sway and yaw.

    The model has states ``u v r psi x y``, flow signals ``u_r v_r``, actuator
    signals ``delta`` and ``thrust``, axes ``X Y N`` and outputs named as the
    states. Scales are typical prime-system values times size and speed; the
    defaults are those of the Mariner class at 15 knots.

    Parameters
    ----------
    length : float
        Length in m.
    speed : float
        Service speed in m/s.
    density : float
        Density of the water in kg/m3.
    thrust : str
        Actuator signal of the thrust.

    Returns
    -------
    tuple of Effect
        Candidates; their amplitudes are zero. What differs from day to day (current, wind, trim of
        the rudder) is there twice, shared and of its own size in every record.

    Examples
    --------
    >>> [effect.name for effect in surface_ship_effects()][:3]
    ['yaw_crossflow', 'sway_crossflow', 'sway_drift_yaw']
    """
    prime = {"density": density, "length": length, "speed": speed}
    made = listed(
        "surface_ship",
        **prime,
        thrust=thrust,
        yaw_rate=0.3 * speed / length,  # of a moderate turn
        mass=3e-3 * notation.prime_scale("Y_vdot", **prime),
        spin=1e-4 * notation.prime_scale("N_rdot", **prime),
    )
    return (*made, *day_to_day(made))


def roll_effects(*, inertia: float, frequency: float) -> tuple[Effect, ...]:
    """Candidate effects of a rolling ship or a roll-decay test.

    The model has states ``phi p``, axis ``K`` and outputs named as the states.

    Parameters
    ----------
    inertia : float
        Roll inertia with added inertia, in kg m2.
    frequency : float
        Natural frequency in rad/s.

    Returns
    -------
    tuple of Effect
        Candidates; their amplitudes are zero.

    Examples
    --------
    >>> [effect.name for effect in roll_effects(inertia=2.0, frequency=1.5)][:3]
    ['roll_linear_damping', 'roll_quadratic_damping', 'roll_cubic_damping']
    """
    stiffness = inertia * frequency**2
    return tuple(listed("roll", inertia=inertia, frequency=frequency, stiffness=stiffness))


def mechanical_effects(
    axis: str = "K",
    position: str = "phi",
    velocity: str = "p",
    *,
    force: float,
    rotates: bool = True,
    speed: float = 1.0,
    stiffness: float | None = None,
    periods: int = 6,
) -> tuple[Force, ...]:
    """Candidate effects of a motor, joint or pendulum.

    Parameters
    ----------
    axis, position, velocity : str
        Names in the model.
    force : float
        Typical torque in N m (force in N where it does not rotate).
    rotates : bool
        Whether the position is an angle.
    speed : float
        Typical velocity in rad/s (m/s).
    stiffness : float, optional
        Of a spring that the model holds; only then a dead zone is among the candidates.
    periods : int
        Cogging periods per turn.

    Returns
    -------
    tuple of Force
        Candidates; their amplitudes are zero.

    Examples
    --------
    >>> [effect.name for effect in mechanical_effects(force=2.0)][:3]
    ['viscous_friction', 'coulomb_friction', 'stribeck_friction']
    """
    load, turn, way = ("N m", "rad/s", "rad") if rotates else ("N", "m/s", "m")
    known = {"axis": axis, "position": position, "velocity": velocity, "periods": periods}
    known |= {"load": load, "turn": turn, "way": way, "spring": f"{load}/{way}"}
    known |= {"force": force, "speed": speed, "stiffness": stiffness}
    known |= {"dry": 0.1 * force, "slow": 0.02 * speed}
    kinds = {"friction": True, "rotation": rotates, "spring": stiffness is not None}
    return tuple(one for kind, fits in kinds.items() if fits for one in listed(kind, **known))
