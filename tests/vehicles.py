"""Small models that several tests share."""

from __future__ import annotations

from motion import outputs, states

from oed_sysid import Force, Input, Model, Parameter
from oed_sysid.physics import hull_derivatives, linear_damping, metacentric_moment

DIVING_START = {"u": 1.5, "z": 10.0}
DIVING_INPUTS = {"fin_command": (-0.2, 0.2), "thrust": (7.0, 11.0)}
DIVING_MIRROR = ("w", "q", "theta", "z", "fin_command")
SHIP_START = {"u": 7.7}
SHIP_INPUTS = {"rudder_command": (-0.4, 0.4), "thrust": (6e5, 8e5)}
SHIP_MIRROR = ("v", "r", "psi", "y", "rudder_command")
ROLL_MIRROR = ("phi", "p", "wave_moment")


def known(**values: float) -> tuple[Parameter, ...]:
    """Fixed constants; units by the name's suffix-free convention of the tests below."""
    units = {"m": "kg", "I": "kg m^2"}
    return tuple(
        Parameter(name, value, units.get(name.split("_")[0], ""), fixed=True)
        for name, value in values.items()
    )


def remus() -> Model:
    """REMUS-like AUV in the diving plane, numbers of the hidden-effect records."""
    inertia = known(m=30.48, I_yy=3.45)
    masses = {"X_udot": -0.93, "Z_wdot": -35.5, "Z_qdot": -1.93, "M_wdot": -1.93, "M_qdot": -4.88}
    units = {"X_udot": "kg", "Z_wdot": "kg", "M_qdot": "kg m^2"}
    inertia += tuple(
        Parameter(name, value, units.get(name, "kg m"), fixed=True)
        for name, value in masses.items()
    )
    values = {"X_absuu": -3.9, "Z_uw": -40.0, "Z_uq": -9.0, "Z_uuds": -12.0}
    values |= {"M_uw": 14.0, "M_uq": -9.0, "M_uuds": -6.15}
    return Model(
        "remus",
        states=states("u w q theta z", w=0.1, q=0.1, theta=0.1),
        inputs=(Input("fin_command", "rad"), Input("thrust", "N")),
        outputs=outputs("u w q theta z"),
        axes={"X": "u", "Z": "w", "M": "q"},
        inertia={
            ("X", "u"): "m - X_udot",
            ("Z", "w"): "m - Z_wdot",
            ("Z", "q"): "-Z_qdot",
            ("M", "w"): "-M_wdot",
            ("M", "q"): "I_yy - M_qdot",
        },
        kinematics={"theta": "q", "z": "-u*sin(theta) + w*cos(theta)"},
        actuators={"ds": "fin_command", "T": "thrust"},
        signals={"u_r": "u", "w_r": "w"},
        effects=(
            hull_derivatives(
                "hull",
                [Parameter(name, value) for name, value in values.items()],
                extra={"X": "T - m*q*w", "Z": "m*u*q"},
            ),
            metacentric_moment("righting", "M", "theta", parameter="zgW", value=5.9),
        ),
        parameters=inertia,
    )


def ship() -> Model:
    """Surface ship of the size of the Mariner class, round numbers."""
    values = {"X_absuu": -6.0e3, "Y_uv": -1.4e6, "Y_ur": 1.6e7, "Y_uudelta": 3.3e4}
    values |= {"N_uv": -3.2e7, "N_ur": -3.2e9, "N_uudelta": -2.5e6}
    return Model(
        "ship",
        states=states("u v r psi x y", v=0.5, r=0.01, x=100.0, y=100.0),
        inputs=(Input("rudder_command", "rad"), Input("thrust", "N")),
        outputs=outputs("u v r psi x y"),
        axes={"X": "u", "Y": "v", "N": "r"},
        inertia={("X", "u"): "m_x", ("Y", "v"): "m_y", ("N", "r"): "I_zz"},
        kinematics={"psi": "r", "x": "u*cos(psi) - v*sin(psi)", "y": "u*sin(psi) + v*cos(psi)"},
        actuators={"delta": "rudder_command", "T": "thrust"},
        signals={"u_r": "u", "v_r": "v"},
        effects=(
            hull_derivatives(
                "hull",
                [Parameter(name, value) for name, value in values.items()],
                extra={"X": "T + m*v*r", "Y": "-m*u*r"},
            ),
        ),
        parameters=known(m=1.7e7, m_x=1.8e7, m_y=3.1e7, I_zz=4.8e10),
        step=1.0,
    )


def roll_oscillator() -> Model:
    """Roll of a ship with linear damping, excited by a wave moment."""
    return Model(
        "roll",
        states=states("phi p", phi=0.3, p=0.3),
        inputs=(Input("wave_moment", "N m", interpolation="linear"),),
        outputs=outputs("phi p"),
        axes={"K": "p"},
        inertia={("K", "p"): "I_xx"},
        kinematics={"phi": "p"},
        effects=(
            Force("moment", {"K": "wave_moment"}),
            linear_damping("damping", "K", "p", parameter="K_p", value=-0.2),
            metacentric_moment("righting", "K", "phi", parameter="K_sinphi", value=2.0),
        ),
        parameters=known(I_xx=2.0),
        step=0.1,
    )
