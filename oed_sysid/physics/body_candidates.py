"""Candidate effects of vehicles that :func:`~oed_sysid.physics.rigid_body` describes.

What a diagnosis tries when the user names nothing else. Only effects on degrees of
freedom that the body has, and on outputs that the model measures, are returned.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

from oed_sysid.physics import forces, signals
from oed_sysid.physics.base import Effect, Force, amplitude
from oed_sysid.physics.candidates import SEA_WATER_DENSITY
from oed_sysid.physics.frames import VELOCITIES, plus, times
from oed_sysid.physics.rigid_body import RigidBody
from oed_sysid.text import notation

_ARMS = {"K": "p", "M": "q", "N": "r"}
FOSSEN = "Fossen (2011), Handbook of marine craft hydrodynamics and motion control, Wiley."


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
    make = forces
    # What each plane of motion has: effect, name, axis, signal and typical size.
    planes = (("Z", "w", "M", "q", "heave", "pitch"), ("Y", "v", "N", "r", "sway", "yaw"))
    found: list[Effect] = []
    for axis, v, moment, rate, word, turn in planes:
        flow = f"{v}_r"
        rows: tuple[tuple[Callable[..., Effect], str, str, str, float], ...] = (
            (make.quadratic_drag, f"{word}_crossflow_drag", axis, flow, side),
            (make.quadratic_drag, f"{turn}_quadratic_damping", moment, rate, side * length**3 / 8),
            (make.quadratic_drag, f"{turn}_crossflow_moment", moment, flow, 0.1 * side * length),
            (
                make.quadratic_drag, f"{word}_quadratic_{turn}_damping", axis, rate,
                0.1 * side * length**2,
            ),
            (make.coupling, f"{word}_lift", axis, flow, 0.2 * side),
            (make.coupling, f"{turn}_munk_moment", moment, flow, 0.05 * side * length),
            (make.coupling, f"{word}_lift_of_{turn}_rate", axis, rate, 0.05 * side * length),
            (make.coupling, f"{turn}_damping", moment, rate, 0.02 * side * length**2),
        )  # fmt: skip
        found += [effect(name, on, by, scale=size) for effect, name, on, by, size in rows]
        found += [
            make.hull_asymmetry(f"hull_asymmetry_{word}", axis, scale=0.005 * side),
            make.hull_asymmetry(f"hull_asymmetry_{turn}", moment, scale=0.002 * side * length),
            make.induced_drag(f"surge_induced_drag_{word}", flow, scale=0.3 * side),
        ]
    found += [
        make.linear_damping("surge_linear_drag", "X", "u_r", scale=0.02 * side * speed),
        make.linear_damping("roll_linear_damping", "K", "p", scale=roll),
        make.quadratic_drag("roll_quadratic_damping", "K", "p", scale=roll),
        *(make.deflection_drag(f"surge_drag_of_{fin}", fin, scale=0.05 * side) for fin in fins),
    ]
    masses = (
        ("surge_added_mass_error", "X", "u", 0.05 * displaced),
        ("sway_added_mass_error", "Y", "v", 0.2 * displaced),
        ("heave_added_mass_error", "Z", "w", 0.2 * displaced),
        ("pitch_added_inertia_error", "M", "q", spin),
        ("yaw_added_inertia_error", "N", "r", spin),
    )
    found += _weights(body, displaced * 0.7 * 9.81)
    found += [
        make.added_mass_error(n, axis, v, scale=size, bound=2 * size) for n, axis, v, size in masses
    ]
    found += [
        body.current(scale=0.1 * speed),
        make.thrust_speed_loss(thrust=thrust, scale=0.1 / speed),
        _reaction(thrust, diameter),
    ]
    for fin in fins:
        found.append(signals.actuator_offset(f"{fin}_offset", fin, scale=0.02))
        found.append(signals.stall(f"{fin}_stall", fin, scale=2.0))
    found += [
        signals.actuator_lag("fin_lag", fins, scale=0.2),
        signals.actuator_delay("fin_delay", fins, max_delay=0.6, step=step, scale=0.2),
        signals.rate_limit("fin_rate_limit", fins, scale=2.0),
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
    """
    side = SEA_WATER_DENSITY * draught * length  # half rho times lateral area of two hulls
    port, starboard = thrusts
    masses = (
        ("surge_added_mass_error", "X", "u", 0.05 * side * length),
        ("sway_added_mass_error", "Y", "v", 0.2 * side * length),
        ("yaw_added_inertia_error", "N", "r", 0.02 * side * length**3),
    )
    found: list[Effect] = [
        forces.linear_damping("surge_linear_drag", "X", "u_r", scale=0.05 * side * speed),
        forces.quadratic_drag("surge_quadratic_drag", "X", "u_r", scale=0.05 * side),
        forces.cubic_damping("surge_wave_resistance", "X", "u_r", scale=0.03 * side / speed),
        forces.linear_damping("sway_linear_damping", "Y", "v_r", scale=0.2 * side * speed),
        forces.quadratic_drag("sway_crossflow_drag", "Y", "v_r", scale=side),
        forces.quadratic_drag("yaw_quadratic_damping", "N", "r", scale=side * length**3 / 16),
        forces.crossed_drag("yaw_drift_damping", "N", "v_r", "r", scale=side * length**2 / 8),
        forces.coupling("sway_lift", "Y", "v_r", scale=0.2 * side),
        forces.coupling("yaw_munk_moment", "N", "v_r", scale=0.05 * side * length),
        forces.coupling("yaw_damping", "N", "r", scale=0.03 * side * length**2),
        forces.coupling("sway_of_yaw_rate", "Y", "r", scale=0.05 * side * length),
        forces.induced_drag("surge_induced_drag", "v_r", scale=0.2 * side),
        _product("speed_loss_in_turn", "X", "v_r*r", "kg", 0.2 * side * length),
        _product("thrust_asymmetry", "X", f"({port} - {starboard})", "1", 0.1),
        _product("thrust_moment", "N", f"({port} + {starboard})", "m", 0.05 * length),
        forces.thrust_speed_loss("port_thrust_speed_loss", thrust=port, scale=0.2 / speed),
        forces.thrust_speed_loss(
            "starboard_thrust_speed_loss", thrust=starboard, scale=0.2 / speed
        ),
        *(forces.added_mass_error(n, axis, v, scale=m, bound=2 * m) for n, axis, v, m in masses),
        body.current(scale=0.1 * speed),
        forces.steady_wind(force=0.02 * side * speed**2, arm=0.2 * length),
        signals.actuator_lag("propeller_lag", thrusts, scale=0.3),
        signals.actuator_delay("propeller_delay", thrusts, max_delay=0.6, step=step, scale=0.2),
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


def _product(name: str, axis: str, factor: str, unit: str, scale: float) -> Force:
    size = amplitude(name, unit, scale=scale)
    words = {
        "speed_loss_in_turn": "resistance of drift and turn together",
        "thrust_asymmetry": "the two propellers push differently",
        "thrust_moment": "equal thrusts turn the vehicle",
    }
    return Force(
        name,
        {axis: f"{size.name}*{factor}"},
        (size,),
        description=words[name],
        source=FOSSEN,
        needs="turns to both sides at several thrusts",
    )


def _reaction(thrust: str, diameter: float) -> Force:
    """Torque of the propeller on the body."""
    size = amplitude("propeller_torque", "m", scale=0.5 * diameter)
    return Force(
        "propeller_torque",
        {"K": f"{size.name}*{thrust}"},
        (size,),
        description="the propeller turns the body the other way",
        source=FOSSEN,
        needs="several thrusts, with roll measured",
    )


def _weights(body: RigidBody, weight: float) -> list[Effect]:
    """Excess buoyancy, and shifts of the centre of gravity, in any attitude."""
    down, axes = body.rotation[2], body.axes
    size = amplitude(
        "excess_buoyancy", "N", scale=0.01 * weight, description="weight less buoyancy"
    )
    pulls = {a: times(size.name, g) for a, g in zip("XYZ", down, strict=True) if g != "0"}
    found: list[Effect] = []
    kept = {axis: text for axis, text in pulls.items() if axis in axes}
    if kept:
        found.append(
            Force(
                "excess_buoyancy",
                kept,
                (size,),
                description="weight differs from buoyancy",
                source=FOSSEN,
                needs="several speeds: a constant force, where hull and fin forces grow with speed",
            )
        )
    x, y, z = down
    for letter, levers in (
        ("x", {"M": f"-{z}", "N": y}),
        ("y", {"K": z, "N": f"-{x}"}),
        ("z", {"K": f"-{y}", "M": x}),
    ):
        shift = amplitude(f"cg_offset_{letter}", "N m", scale=0.002 * weight)
        terms = {
            axis: plus(times(shift.name, g))
            for axis, g in levers.items()
            if axis in axes and g not in ("0", "-0")
        }
        if terms:
            found.append(
                Force(
                    f"cg_offset_{letter}",
                    terms,
                    (shift,),
                    description=f"centre of gravity is shifted along {letter}",
                    source=FOSSEN,
                    needs="several speeds, or large angles",
                )
            )
    return found


def _sensors(body: RigidBody, outputs: Collection[str], speed: float) -> list[Effect]:
    """Errors of measured motions."""
    found: list[Effect] = []
    sizes = {**dict.fromkeys("uvw", 0.03 * speed), **dict.fromkeys("pqr", 0.01)}
    for name in outputs:
        if name in sizes:
            unit = notation.FACTOR_UNITS[name] if name in "uvw" else "rad/s"
            found.append(signals.sensor_bias(f"bias_{name}", name, unit, scale=sizes[name]))
            found.append(signals.sensor_scale(f"scale_{name}", name, scale=0.05))
        elif name in body.angles and name != "psi":
            found.append(signals.sensor_bias(f"bias_{name}", name, "rad", scale=0.02))
    if "u" in outputs and "v" in outputs:
        found.append(signals.sensor_misalignment("log_misalignment", "u", "v", scale=0.02))
    return found
