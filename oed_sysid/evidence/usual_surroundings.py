"""Water, air and weight, where nobody named a candidate: currents, winds and buoyancy."""

from __future__ import annotations

from collections.abc import Iterator

from oed_sysid.evidence.dictionary import HORIZONTAL
from oed_sysid.evidence.sizes import Sizes
from oed_sysid.physics import Effect, Environment, Force, forces
from oed_sysid.physics.frames import rotation
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter

# Share of the speed that a current has, and of the accelerations seen that a load makes.
OF_SPEED, OF_LOAD = 0.1, 0.2


def usual_surroundings(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Currents, winds and weight that a model can take, absent."""
    yield from _flows(model, sizes)
    yield from _winds(model, sizes)
    yield from _weights(model, sizes)


def _flows(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Currents: in the flow where the model has one, else as a drift of its positions."""
    states = {text: signal for signal, text in model.signals.items() if text in model.state_names}
    angles = set(model.state_names)
    speed = sizes.level.get("u", 1.0)
    if {"u", "v", "w"} <= set(states) and {"phi", "theta", "psi"} <= angles:
        yield _current(states, OF_SPEED * speed)
    elif {"u", "v"} <= set(states) and "psi" in angles:
        flow = (states["u"], states["v"])
        yield forces.current_horizontal_plane(flow=flow, scale=OF_SPEED * speed)
    elif "u" in states and "psi" in angles and "v" not in angles:
        yield _head_current(states["u"], OF_SPEED * speed)
    if {"u", "w"} <= set(states) and "theta" in angles and "v" not in states:
        flow = (states["u"], states["w"])
        yield forces.current_forward(flow=flow, scale=OF_SPEED * speed)
        yield forces.current_down(flow=flow, scale=0.5 * OF_SPEED * speed)
    if "u" in states or not model.axes:
        return
    for state in model.states:
        if state.name in (*HORIZONTAL, "z", "zeta") and state.name in model.kinematics:
            name = f"drift_{state.name}"
            size = Parameter(f"E_{name}", 0.0, f"{state.unit}/s", scale=OF_SPEED * speed)
            yield Force(
                name,
                {state.name: size.name},
                (size,),
                description=f"current that carries the vehicle along {state.name}",
                source=forces.CURRENT,
                needs=f"{state.name} and velocities through the water",
            )


def _current(flow: dict[str, str], scale: float) -> Effect:
    """A current towards north, east and down on a vehicle of any attitude."""
    towards = [
        Parameter(f"E_current_{way}", 0.0, "m/s", -20 * scale, 20 * scale, scale=scale)
        for way in ("north", "east", "down")
    ]
    # Columns of the rotation to north, east and down are axes of the body.
    columns = zip(*rotation(("phi", "theta", "psi")), strict=True)
    terms = {
        flow[state]: flow[state]
        + "".join(f" - {size.name}*({text})" for size, text in zip(towards, column, strict=True))
        for state, column in zip("uvw", columns, strict=True)
    }
    return Environment(
        "current",
        terms,
        tuple(towards),
        description="steady current",
        source=forces.CURRENT,
        needs="position or velocity over ground, on several headings",
    )


def _head_current(flow: str, scale: float) -> Effect:
    """A current of which a vehicle without sway meets the part along its heading."""
    north, east = (
        Parameter(f"E_current_{way}", 0.0, "m/s", -20 * scale, 20 * scale, scale=scale)
        for way in ("north", "east")
    )
    return Environment(
        "current",
        {flow: f"{flow} - ({north.name}*cos(psi) + {east.name}*sin(psi))"},
        (north, east),
        description="steady horizontal current along the heading",
        source=forces.CURRENT,
        needs="velocity over ground, on several headings",
    )


def _weights(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """Weight in water, where an angle turns it."""
    if "Z" not in model.axes or not {"phi", "theta"} & set(model.state_names):
        return
    size = Parameter("E_weight", 0.0, "N", scale=OF_LOAD * sizes.force("Z", model.axes["Z"]))
    pulls = zip("XYZ", rotation(model.state_names)[2], strict=True)
    yield Force(
        "weight",
        {a: f"{size.name}*({text})" for a, text in pulls if a in model.axes and text != "0"},
        (size,),
        description="weight less buoyancy differs from its nominal value",
        source=forces.WEIGHT,
        needs="several pitch angles",
    )


def _winds(model: Model, sizes: Sizes) -> Iterator[Effect]:
    """A steady wind, where the heading is a state."""
    axes = tuple(axis for axis in ("X", "Y", "N") if axis in model.axes)
    if not {"X", "Y"} <= set(axes) or "psi" not in model.state_names:
        return
    across = sizes.force("Y", model.axes["Y"])
    arm = sizes.force("N", model.axes["N"]) / across if "N" in axes and across > 0 else 1.0
    yield forces.steady_wind(axes=axes, force=OF_LOAD * across or 1.0, arm=arm or 1.0)
