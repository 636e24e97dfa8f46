"""Candidate effects of vehicles that :func:`~oed_sysid.physics.rigid_body` describes.

What a diagnosis tries when the user names nothing else. Only effects on degrees of
freedom that the body has, and on outputs that the model measures, are returned.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from oed_sysid.physics import signals
from oed_sysid.physics.base import Effect, Force, amplitude
from oed_sysid.physics.candidates import SEA_WATER_DENSITY, listed
from oed_sysid.physics.frames import UNITS, VELOCITIES, plus, times
from oed_sysid.physics.rigid_body import RigidBody
from oed_sysid.physics.table import FOSSEN


def underwater_vehicle_effects(
    body: RigidBody,
    *,
    length: float,
    speed: float,
    diameter: float,
    fins: Sequence[str] = ("ds", "dr"),
    thrust: str = "T",
    outputs: Collection[str] | None = None,
    known: Force | None = None,
    step: float = 0.1,
) -> tuple[Effect, ...]:
    """Candidate effects of a slender underwater vehicle.

    Parameters
    ----------
    body : RigidBody
        Its equations of motion.
    length, diameter : float
        In m; they and ``speed`` set typical sizes.
    speed : float
        Typical speed in m/s.
    fins : sequence of str
        Actuator signals of the fins; those with ``s`` in their name act in heave.
    thrust : str
        Actuator signal of the thrust in N.
    outputs : collection of str, optional
        Measured signals that may have errors; by default none is suspected.
    known : Force, optional
        Hull forces of the nominal model: candidates that only repeat a term whose
        derivative is free there are left out.
    step : float
        Shortest integration step in s, for the register of a delay.

    Returns
    -------
    tuple of Effect
        Candidates; their amplitudes are zero.

    Examples
    --------
    >>> from oed_sysid.physics.bodies import rigid_body
    >>> body = rigid_body(6, mass=30.0, inertia=(0.2, 3.4, 3.4))
    >>> found = underwater_vehicle_effects(body, length=1.3, speed=1.5, diameter=0.19)
    >>> len(found), found[0].name
    (46, 'heave_crossflow_drag')
    """
    side = 0.5 * SEA_WATER_DENSITY * diameter * length  # half rho times lateral area
    displaced = SEA_WATER_DENSITY * diameter**2 * length
    spin = SEA_WATER_DENSITY * diameter**2 * length**3 * 0.01
    roll = side * diameter**2 * speed * 0.02
    known_sizes = {"side": side, "displaced": displaced, "spin": spin, "roll": roll}
    known_sizes |= {"length": length, "diameter": diameter, "speed": speed}

    def make(kind: str, **known: Any) -> list[Effect]:
        return listed(f"underwater_{kind}", **known_sizes, **known)

    found = [
        *make("hull"),
        *(effect for fin in fins for effect in make("fin_drag", fin=fin)),
        *_weights(body, displaced * 0.7 * 9.81),
        *make("inertia"),
        body.current(scale=0.1 * speed),
        *make("drive", thrust=thrust),
        *(effect for fin in fins for effect in make("fin", fin=fin)),
        *make("fins", fins=fins, step=step),
        *_sensors(body, outputs or (), speed),
    ]
    return _beyond(known, [effect for effect in found if _suits(effect, body)])


def _suits(effect: Effect, body: RigidBody) -> bool:
    """Whether a body has the axes and the motions that a force or an inertia names."""
    if effect.stage not in ("force", "inertia"):
        return True
    keys = [key if isinstance(key, tuple) else (key,) for key in effect.terms]
    named = {name.removesuffix("_r") for name in effect.uses()} & set(VELOCITIES)
    named |= {part for key in keys for part in key[1:]}
    return all(key[0] in body.axes for key in keys) and named <= set(body.velocities)


def catamaran_effects(
    body: RigidBody,
    *,
    length: float,
    speed: float,
    draught: float,
    thrusts: tuple[str, str] = ("T_port", "T_starboard"),
    outputs: Collection[str] | None = None,
    known: Force | None = None,
    step: float = 0.1,
) -> tuple[Effect, ...]:
    """Candidate effects of a catamaran with two propellers, in surge, sway and yaw.

    Parameters
    ----------
    body : RigidBody
        Its equations of motion.
    length, draught, speed : float
        In m and m/s; they set typical sizes.
    thrusts : pair of str
        Actuator signals of the port and the starboard thrust in N.
    outputs : collection of str, optional
        Measured signals that may have errors.
    known : Force, optional
        Hull forces of the nominal model, as above.
    step : float
        Shortest integration step in s.

    Returns
    -------
    tuple of Effect
        Candidates; their amplitudes are zero.

    Examples
    --------
    Those of the shipped catamaran::

        load_problem("catamaran").effects
    """
    side = SEA_WATER_DENSITY * draught * length  # half rho times lateral area of two hulls
    port, starboard = thrusts
    sizes = {"side": side, "length": length, "speed": speed}
    sides = {"port": port, "starboard": starboard}
    sides |= {"difference": f"({port} - {starboard})", "sum": f"({port} + {starboard})"}
    found = [
        *listed("catamaran", **sizes, **sides),
        body.current(scale=0.1 * speed),
        *listed("catamaran_drive", **sizes, thrusts=thrusts, step=step),
    ]
    return _beyond(known, [*found, *_sensors(body, outputs or (), speed)])


def _beyond(known: Force | None, found: Sequence[Effect]) -> tuple[Effect, ...]:
    """Candidates that say more than a free derivative of the nominal hull does."""
    if known is None:
        return tuple(found)
    free = {parameter.name for parameter in known.parameters if not parameter.fixed}
    held = {
        (axis, part.partition("*")[2])
        for axis, text in known.terms.items()
        for part in text.split(" + ")
        if part.partition("*")[0] in free
    }

    def repeats(effect: Effect) -> bool:
        if effect.stage != "force" or len(effect.terms) != 1 or effect.definitions:
            return False
        ((axis, text),) = effect.terms.items()
        amplitude_name, _, factors = text.partition("*")
        return amplitude_name in effect.amplitude_names and (axis, factors) in held

    return tuple(effect for effect in found if not repeats(effect))


def _weights(body: RigidBody, weight: float) -> list[Effect]:
    """Excess buoyancy, and shifts of the centre of gravity, in any attitude."""
    x, y, z = body.rotation[2]
    name, words = "excess_buoyancy", "weight differs from buoyancy"
    size = amplitude(name, "N", scale=0.01 * weight, description="weight less buoyancy")
    needs = "several speeds: a constant force, where hull and fin forces grow with speed"
    rows = [(name, size, {"X": x, "Y": y, "Z": z}, words, needs)]
    levers = {
        "x": {"M": f"-{z}", "N": y},
        "y": {"K": z, "N": f"-{x}"},
        "z": {"K": f"-{y}", "M": x},
    }
    for letter, arms in levers.items():
        name, words = f"cg_offset_{letter}", f"centre of gravity is shifted along {letter}"
        size = amplitude(name, "N m", scale=0.002 * weight)
        rows.append((name, size, arms, words, "several speeds, or large angles"))
    found: list[Effect] = []
    for name, size, arms, words, needs in rows:
        terms = {
            axis: plus(times(size.name, arm))
            for axis, arm in arms.items()
            if axis in body.axes and arm not in ("0", "-0")
        }
        if terms:
            parts = (size,)
            found.append(Force(name, terms, parts, description=words, source=FOSSEN, needs=needs))
    return found


def _sensors(body: RigidBody, outputs: Collection[str], speed: float) -> list[Effect]:
    """Errors of measured motions."""
    found: list[Effect] = []
    for name in outputs:
        if name in VELOCITIES:
            size = 0.03 * speed if name in "uvw" else 0.01
            found += listed("motion_sensor", output=name, unit=UNITS[name], size=size)
        elif name in body.angles and name != "psi":
            found.append(signals.sensor_bias(f"bias_{name}", name, "rad", scale=0.02))
    if "u" in outputs and "v" in outputs:
        found.append(signals.sensor_misalignment("log_misalignment", "u", "v", scale=0.02))
    return found
