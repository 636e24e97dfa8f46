"""Nominal model of the vehicle in six degrees of freedom; position is not measured."""

from __future__ import annotations

from benchmarks.other_vehicles.models.base import Nominal, candidates, guess, known
from oed_sysid import Environment, Force, Input, Model, Output, Parameter, State
from oed_sysid.physics import (
    Sensor,
    amplitude,
)

CONSTANTS = (
    known("m", 30.5, "kg", "mass"),
    known("I_xx", 0.8, "kg m^2", "roll inertia"),
    known("I_yy", 3.45, "kg m^2", "pitch and yaw inertia"),
    known("X_udot", -0.93, "kg", "surge added mass"),
    known("Y_vdot", -35.5, "kg", "sway and heave added mass"),
    known("K_pdot", -0.2, "kg m^2", "roll added inertia"),
    known("M_qdot", -4.88, "kg m^2", "pitch and yaw added inertia"),
    known("T_nn", 0.014, "N s^2", "thrust per n^2"),
    known("a_Q", 0.03, "m", "propeller torque over thrust"),
)
RIGID = Force(
    "rigid_body",
    {
        "X": "m*(r*v - q*w)",
        "Y": "m*(p*w - r*u)",
        "Z": "m*(q*u - p*v)",
        "M": "(I_yy - I_xx)*r*p",
        "N": "(I_xx - I_yy)*p*q",
    },
    description="rotation of a rigid body",
)
IDEAL = Force(
    "ideal_fluid",
    {
        "X": "Y_vdot*(q*w_r - r*v_r)",
        "Y": "X_udot*u_r*r - Y_vdot*w_r*p",
        "Z": "Y_vdot*v_r*p - X_udot*u_r*q",
        "M": "(X_udot - Y_vdot)*u_r*w_r + (K_pdot - M_qdot)*r*p",
        "N": "(Y_vdot - X_udot)*u_r*v_r + (M_qdot - K_pdot)*p*q",
    },
    description="rotation of the added mass",
)
HULL = Force(
    "hull",
    {
        "X": "X_uu*u_r*abs(u_r)",
        "Y": "Y_uv*u_r*v_r + Y_ur*u_r*r",
        "Z": "Z_uw*u_r*w_r + Z_uq*u_r*q",
        "M": "M_uw*u_r*w_r + M_uq*u_r*q",
        "N": "N_uv*u_r*v_r + N_ur*u_r*r",
    },
    (
        guess("X_uu", -3.9, "kg/m"),
        guess("Y_uv", -40.0, "kg/m"),
        guess("Y_ur", 9.0, "kg"),
        guess("Z_uw", -40.0, "kg/m"),
        guess("Z_uq", -9.0, "kg"),
        guess("M_uw", -20.6, "kg"),
        guess("M_uq", -9.0, "kg m"),
        guess("N_uv", 20.6, "kg"),
        guess("N_ur", -11.0, "kg m"),
    ),
    description="drag and lift of the hull",
)
FINS = Force(
    "fins",
    {
        "Y": "Y_uudr*u_r**2*dr",
        "Z": "Z_uuds*u_r**2*ds",
        "M": "M_uuds*u_r**2*ds",
        "N": "N_uudr*u_r**2*dr",
    },
    (
        guess("Y_uudr", 12.0, "kg/m"),
        guess("Z_uuds", -12.0, "kg/m"),
        guess("M_uuds", -6.15, "kg"),
        guess("N_uudr", -6.15, "kg"),
    ),
    description="lift of the fins",
)
ROLL_DAMPING = Force(
    "roll_damping",
    {"K": "K_p*p"},
    (Parameter("K_p", -1.0, "kg m^2/s", -20.0, 20.0, scale=0.5),),
    description="roll damping",
)
RESTORING = Force(
    "restoring",
    {"K": "-zgW*cos(theta)*sin(phi)", "M": "-zgW*sin(theta)"},
    (guess("zgW", 5.9, "N m"),),
    description="centre of gravity below that of buoyancy",
)
PROPELLER = Force("propeller", {"X": "T", "K": "-a_Q*T"}, description="thrust and torque")
# Flow that a current north and east makes in body axes.
CURRENT = Environment(
    "current",
    {
        "u_r": "u_r - E_current_north*cos(theta)*cos(psi) - E_current_east*cos(theta)*sin(psi)",
        "v_r": "v_r - E_current_north*(sin(phi)*sin(theta)*cos(psi) - cos(phi)*sin(psi))"
        " - E_current_east*(sin(phi)*sin(theta)*sin(psi) + cos(phi)*cos(psi))",
        "w_r": "w_r - E_current_north*(cos(phi)*sin(theta)*cos(psi) + sin(phi)*sin(psi))"
        " - E_current_east*(cos(phi)*sin(theta)*sin(psi) - sin(phi)*cos(psi))",
    },
    (
        amplitude("current_north", "m/s", scale=0.1, bound=1.5),
        amplitude("current_east", "m/s", scale=0.1, bound=1.5),
    ),
    description="steady horizontal current",
)


LEVER_ARM = Sensor(
    "log_lever_arm",
    {"v": "v + E_log_lever_arm*r", "w": "w - E_log_lever_arm*q"},
    (amplitude("log_lever_arm", "m", scale=0.2),),
    description="the speed log sits ahead of the origin",
)


def build(declared: bool, lacking: str | None) -> Model:
    """The nominal model."""
    levels = (0.02, 0.02, 0.02, 0.006, 0.004, 0.004, 0.006, 0.005, 0.01, 0.03)
    measured = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "z")
    units = dict.fromkeys("uvw", "m/s") | dict.fromkeys("pqr", "rad/s")
    units |= dict.fromkeys(("phi", "theta", "psi"), "rad") | dict.fromkeys("xyz", "m")
    scales = {"v": 0.1, "w": 0.1, "p": 0.1, "q": 0.1, "r": 0.1, "phi": 0.1, "theta": 0.1}
    parts = (RIGID, IDEAL, HULL, FINS, ROLL_DAMPING, RESTORING, PROPELLER)
    return Model(
        name="AUV in six degrees of freedom",
        states=tuple(State(n, u, scale=scales.get(n, 1.0)) for n, u in units.items()),
        inputs=(
            Input("stern", "rad", "stern planes"),
            Input("rudder", "rad", "rudders"),
            Input("n", "1/s", "propeller"),
        ),
        outputs=tuple(
            Output(n, units[n], noise_std=level if declared else None)
            for n, level in zip(measured, levels, strict=True)
        ),
        axes={"X": "u", "Y": "v", "Z": "w", "K": "p", "M": "q", "N": "r"},
        inertia={
            ("X", "u"): "m - X_udot",
            ("Y", "v"): "m - Y_vdot",
            ("Z", "w"): "m - Y_vdot",
            ("K", "p"): "I_xx - K_pdot",
            ("M", "q"): "I_yy - M_qdot",
            ("N", "r"): "I_yy - M_qdot",
        },
        kinematics={
            "phi": "p + (q*sin(phi) + r*cos(phi))*tan(theta)",
            "theta": "q*cos(phi) - r*sin(phi)",
            "psi": "(q*sin(phi) + r*cos(phi))/cos(theta)",
            "x": "u*cos(theta)*cos(psi) + v*(sin(phi)*sin(theta)*cos(psi) - cos(phi)*sin(psi))"
            " + w*(cos(phi)*sin(theta)*cos(psi) + sin(phi)*sin(psi))",
            "y": "u*cos(theta)*sin(psi) + v*(sin(phi)*sin(theta)*sin(psi) + cos(phi)*cos(psi))"
            " + w*(cos(phi)*sin(theta)*sin(psi) - sin(phi)*cos(psi))",
            "z": "-u*sin(theta) + v*sin(phi)*cos(theta) + w*cos(phi)*cos(theta)",
        },
        actuators={"ds": "stern", "dr": "rudder", "T": "T_nn*n*abs(n)"},
        signals={"u_r": "u", "v_r": "v", "w_r": "w"},
        effects=tuple(part for part in parts if part.name != lacking),
        parameters=CONSTANTS,
        step=0.05,
    )


NOMINAL = Nominal(build, candidates("auv", CURRENT, LEVER_ARM), {"roll_damping": ROLL_DAMPING})
