"""Kinematics of the vehicles whose logs are judged; their dynamics nobody uses."""

from __future__ import annotations

from oed_sysid import Input, Model, Output, Parameter, State


def model(name: str, kinematics: dict[str, str], units: dict[str, str]) -> Model:
    """Kinematics with first-order responses of all velocities."""
    rates = {n: f"(K*fin - {n})/T" for n in units if n not in kinematics}
    return Model(
        name,
        states=tuple(State(n, u) for n, u in units.items()),
        inputs=(Input("fin", "rad"),),
        outputs=tuple(Output(n, u) for n, u in units.items()),
        kinematics=kinematics | rates,
        parameters=(Parameter("K", 1.0), Parameter("T", 5.0, "s")),
    )


def diving_plane() -> Model:
    """Surge, heave and pitch."""
    return model(
        "diving plane",
        {"theta": "q", "z": "-u*sin(theta) + w*cos(theta)"},
        {"u": "m/s", "w": "m/s", "q": "rad/s", "theta": "rad", "z": "m"},
    )


def ship() -> Model:
    """Surge, sway and yaw."""
    return model(
        "ship",
        {"psi": "r", "x": "u*cos(psi) - v*sin(psi)", "y": "u*sin(psi) + v*cos(psi)"},
        {"u": "m/s", "v": "m/s", "r": "rad/s", "psi": "rad", "x": "m", "y": "m"},
    )
