"""REMUS-like AUV in the diving plane, with a vocabulary of effects that may be missing.

States u, w, q, theta, z in body axes, z and depth positive down; the believed
model is linear in its eight derivatives and knows no disturbance.
"""

from __future__ import annotations

import math
from pathlib import Path

from oed_sysid import (
    Dataset,
    Experiment,
    Force,
    Input,
    Limits,
    Model,
    Output,
    Parameter,
    Problem,
    State,
    ThreeTwoOneOne,
    ZigZagLike,
    read_csv,
)
from oed_sysid.physics import diving_plane_effects

RELATIVE_PRIOR = 0.08  # the derivatives are believed to about eight per cent


def _known(name: str, value: float, unit: str, description: str) -> Parameter:
    return Parameter(name, value, unit, fixed=True, description=description)


def _believed(name: str, value: float, unit: str, description: str) -> Parameter:
    return Parameter(
        name,
        value,
        unit,
        prior_mean=value,
        prior_std=RELATIVE_PRIOR * abs(value),
        description=description,
    )


CONSTANTS = (
    _known("m", 30.48, "kg", "mass"),
    _known("I_yy", 3.45, "kg m^2", "pitch moment of inertia"),
    _known("X_udot", -0.93, "kg", "surge added mass"),
    _known("Z_wdot", -35.5, "kg", "heave added mass"),
    _known("Z_qdot", -1.93, "kg m", "coupled added mass"),
    _known("M_wdot", -1.93, "kg m", "coupled added mass"),
    _known("M_qdot", -4.88, "kg m^2", "pitch added inertia"),
)

RIGID_BODY = Force(
    "rigid_body",
    {"X": "-m*q*w", "Z": "m*u*q"},
    description="centripetal terms of the rigid body",
)
HULL = Force(
    "hull",
    {
        "X": "X_uu*u_r*abs(u_r)",
        "Z": "Z_uw*u_r*w_r + Z_uq*u_r*q",
        "M": "M_uw*u_r*w_r + M_uq*u_r*q",
    },
    parameters=(
        _believed("X_uu", -3.9, "kg/m", "axial drag"),
        _believed("Z_uw", -40.0, "kg/m", "hull and fin lift"),
        _believed("Z_uq", -9.0, "kg", "lift due to pitch rate"),
        _believed("M_uw", 14.0, "kg", "Munk moment and fin lift"),
        _believed("M_uq", -9.0, "kg m", "pitch damping"),
    ),
    description="axial drag and linear lift of hull and fins",
)
FINS = Force(
    "fins",
    {"Z": "Z_uuds*u_r**2*ds", "M": "M_uuds*u_r**2*ds"},
    parameters=(
        _believed("Z_uuds", -12.0, "kg/m", "fin lift"),
        _believed("M_uuds", -6.15, "kg", "fin moment"),
    ),
    description="stern plane lift and moment",
)
RESTORING = Force(
    "restoring",
    {"M": "-zgW*sin(theta)"},
    parameters=(_believed("zgW", 5.9, "N m", "metacentric stiffness, z_G W"),),
    description="centre of gravity below centre of buoyancy, neutral buoyancy",
)
THRUST = Force("thrust", {"X": "T"}, description="thrust as commanded")

model = Model(
    name="REMUS-like AUV, diving plane",
    states=(
        State("u", "m/s", "surge velocity"),
        State("w", "m/s", "heave velocity", scale=0.1),
        State("q", "rad/s", "pitch rate", scale=0.1),
        State("theta", "rad", "pitch angle", scale=0.1),
        State("z", "m", "depth"),
    ),
    inputs=(
        Input("fin_command", "rad", "stern plane command"),
        Input("thrust", "N", "propeller thrust"),
    ),
    outputs=(
        Output("u", "m/s", "surge velocity", noise_std=0.02),
        Output("w", "m/s", "heave velocity", noise_std=0.02),
        Output("q", "rad/s", "pitch rate", noise_std=0.004),
        Output("theta", "rad", "pitch angle", noise_std=0.004),
        Output("z", "m", "depth", noise_std=0.03),
    ),
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
    effects=(RIGID_BODY, HULL, FINS, RESTORING, THRUST),
    parameters=CONSTANTS,
    step=0.1,
)


LIMITS = Limits(
    inputs={"fin_command": (-math.radians(20.0), math.radians(20.0)), "thrust": (0.0, 14.0)},
    signals={"theta": (-math.radians(45.0), math.radians(45.0)), "z": (2.0, 60.0)},
)


def _zigzag(degrees: float, switch: float, thrust: float) -> Experiment:
    """Zigzag in pitch at constant thrust, from level trim at 10 m."""
    speed = math.sqrt(thrust / 3.9)
    return Experiment(
        f"zigzag_{degrees:g}_{switch:g}",
        ZigZagLike("fin_command", math.radians(degrees), math.radians(switch), start=2.0),
        duration=90.0,
        sample_time=0.1,
        constants={"thrust": thrust},
        initial={"u": speed, "z": 10.0},
        limits=LIMITS,
    )


def records() -> Dataset:
    """Five runs with something hidden in them; see data/README.md."""
    return read_csv(Path(__file__).parent / "data", model.channels)


problem = Problem(
    name="remus_diving_plane",
    length=1.33,  # m, the REMUS of Prestero (2001)
    title="REMUS-like AUV in the diving plane",
    model=model,
    effects=diving_plane_effects(step=0.1),
    experiments={
        "zigzag_5_5": _zigzag(5.0, 5.0, 5.0),
        "zigzag_10_10": _zigzag(10.0, 10.0, 9.0),
        "zigzag_15_12": _zigzag(15.0, 12.0, 10.0),
        "steps": Experiment(
            "steps",
            ThreeTwoOneOne("fin_command", math.radians(4.0), unit_time=2.0, start=2.0),
            duration=90.0,
            sample_time=0.1,
            constants={"thrust": 9.0},
            initial={"u": 1.5, "z": 10.0},
            limits=LIMITS,
        ),
    },
    limits=LIMITS,
    records=records,
    references=(
        "Prestero 2001, Verification of a six-degree of freedom simulation model for the REMUS "
        "autonomous underwater vehicle, MIT/WHOI (masses, added masses, order of derivatives)",
    ),
    description=(
        "A nominal model that may lack physics: find what the records show and it does not."
    ),
)
