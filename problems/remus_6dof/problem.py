"""REMUS in six degrees of freedom, with the numbers of Prestero's thesis.

Tables are those of the thesis's appendices; README.md says which are doubtful.
"""

from __future__ import annotations

import math
from pathlib import Path

from oed_sysid import Experiment, Input, Limits, Parameter, Problem, read_csv
from oed_sysid.experiments.manoeuvres import ZigZag, ZigZagLike
from oed_sysid.physics.bodies import rigid_body, underwater_vehicle_effects

FOLDER = Path(__file__).parent
PRIOR = 0.1  # relative: semi-empirical numbers, some of them adjusted by factors of ten


def believed(name: str, value: float, words: str = "") -> Parameter:
    """A number of the thesis, believed to ten per cent."""
    return Parameter(name, value, prior_std=PRIOR * abs(value), description=words)


BODY = rigid_body(
    6,
    mass=30.48,  # 299 N / 9.81 m/s2, table A.1
    inertia=(0.177, 3.45, 3.45),  # table 2.4
    centre_of_gravity=(0.0, 0.0, 0.0196),  # table A.4, origin at the centre of buoyancy
    added_mass={  # table C.5
        "X_udot": -0.93,
        "Y_vdot": -35.5,
        "Y_rdot": 1.93,
        "Z_wdot": -35.5,
        "Z_qdot": -1.93,
        "K_pdot": -0.0704,
        "M_qdot": -4.88,
        "N_rdot": -4.88,
    },
    weight=299.0,  # table A.1
    buoyancy=306.0,  # table 2.3; table A.1 prints 308
    position=("z",),
)
HULL = BODY.hull(
    [
        believed("X_absuu", -1.62, "axial drag, table C.1"),
        believed("Y_absvv", -1310.0, "cross-flow drag, table C.2"),
        believed("Z_absww", -1310.0, "cross-flow drag; table C.2 prints -131, see README"),
        Parameter("Y_absrr", 0.632, fixed=True, description="table C.2"),
        Parameter("Z_absqq", -0.632, fixed=True, description="table C.2"),
        believed("K_abspp", -0.130, "rolling resistance, table C.3"),
        Parameter("M_absww", 3.18, fixed=True, description="table C.2"),
        believed("M_absqq", -188.0, "table C.2"),
        Parameter("N_absvv", -3.18, fixed=True, description="table C.2"),
        believed("N_absrr", -94.0, "table C.2"),
        believed("Y_uv", -18.96, "body lift: table C.4 less the fins' 9.64"),
        believed("Z_uw", -18.96, "body lift: table C.4 less the fins' 9.64"),
        believed("M_uw", -4.47, "body lift moment, table C.4"),
        believed("N_uv", 4.47, "body lift moment, table C.4"),
    ],
    source="Prestero (2001), tables C.1 to C.4",
)
FINS = {
    name: BODY.fin(
        name,
        signal,
        at=(-0.638, 0.0, 0.0),  # table A.5
        normal=normal,
        lift=Parameter(f"L_{name}", 9.64, "kg/m", lower=0.0, prior_std=0.964),  # table B.1
    )
    for name, signal, normal in (("stern_planes", "ds", "horizontal"), ("rudder", "dr", "vertical"))
}
# K_prop/X_prop of table C.9: the propeller turns the hull against its own rotation.
TORQUE_ARM = Parameter("k_Q", -0.543 / 3.86, "m", fixed=True, description="torque per thrust")
PROPELLER = BODY.thruster("propeller", "T", torque="k_Q*T", parameters=(TORQUE_ARM,))

NOISE = {
    "u": 0.01,
    "v": 0.01,
    "w": 0.01,
    "p": 0.005,
    "q": 0.003,
    "r": 0.003,
    "phi": 0.005,
    "theta": 0.003,
    "psi": 0.005,
    "z": 0.03,
}

model = BODY.model(
    "REMUS, six degrees of freedom",
    inputs=(
        Input("stern_command", "rad", "stern plane command"),
        Input("rudder_command", "rad", "rudder command"),
        Input("thrust", "N", "propeller thrust"),
    ),
    actuators={"ds": "stern_command", "dr": "rudder_command", "T": "thrust"},
    effects=(HULL, *FINS.values(), PROPELLER),
    noise=NOISE,
    step=0.05,
)

MAX_FIN = math.radians(13.6)  # table A.5
LIMITS = Limits(
    inputs={
        "stern_command": (-MAX_FIN, MAX_FIN),
        "rudder_command": (-MAX_FIN, MAX_FIN),
        "thrust": (0.0, 8.0),
    },
    signals={"theta": (-math.radians(45), math.radians(45)), "z": (1.0, 60.0)},
)


def run(name: str, stern: float, rudder: float, thrust: float) -> Experiment:
    """Zigzags in pitch and heading at once (degrees); the hull is unstable in pitch and yaw."""
    speed = math.sqrt(thrust / 1.62)
    return Experiment(
        name,
        (
            ZigZagLike("stern_command", math.radians(stern), math.radians(4.0), start=1.0),
            ZigZag(
                "rudder_command", math.radians(rudder), math.radians(rudder), start=2.0, sign=-1
            ),
        ),
        duration=60.0,
        sample_time=0.2,
        constants={"thrust": thrust},
        initial=BODY.start(u=speed, z=20.0),
        limits=LIMITS,
    )


RUNS = (
    run("slow", 11.0, 6.0, 2.5),
    run("cruise", 9.0, 8.0, 3.86),  # X_prop of table C.9: 1.54 m/s
    run("fast", 8.0, 6.0, 6.0),
    run("wide", 12.0, 12.0, 3.86),
)

problem = Problem(
    "remus_6dof",
    model,
    length=1.33,
    title="REMUS in six degrees of freedom",
    effects=underwater_vehicle_effects(
        BODY, length=1.33, diameter=0.191, speed=1.54, outputs=tuple(NOISE), known=HULL, step=0.05
    ),
    experiments={experiment.name: experiment for experiment in RUNS},
    limits=LIMITS,
    # What made the records in data/: the vehicle differs from the thesis, and has what it lacks.
    truth={
        "X_absuu": -1.78,
        "Y_absvv": -1180.0,
        "Z_absww": -1240.0,
        "M_absqq": -201.0,
        "Y_uv": -17.6,
        "M_uw": -4.9,
        "L_stern_planes": 9.1,
        "L_rudder": 10.3,
        "E_fin_lag": 0.25,
        "E_current_north": 0.12,
        "E_current_east": -0.08,
    },
    records=lambda: read_csv(FOLDER / "data", model.channels),
    published={"cruise_speed": 1.54, "pitch_poles": (0.432 + 0.183j, 0.432 - 0.183j)},
    references=(
        "Prestero (2001), Verification of a six-degree of freedom simulation model for the REMUS "
        "autonomous underwater vehicle, MIT/WHOI, tables 2.3, 2.4, 8.2 and appendices A to C",
        "Fossen (2011), Handbook of marine craft hydrodynamics and motion control, Wiley",
    ),
    description="A torpedo-shaped vehicle: what do zigzags in pitch and heading at once tell?",
)
