"""A two-metre catamaran that steers by its two propellers."""

from __future__ import annotations

from pathlib import Path

from oed_sysid import Experiment, Input, Limits, Parameter, Problem, read_csv
from oed_sysid.experiments.manoeuvres import PRBS, Doublet, ThreeTwoOneOne
from oed_sysid.physics.bodies import catamaran_effects, rigid_body

FOLDER = Path(__file__).parent
CRUISE = 70.0  # rad/s of both propellers

BODY = rigid_body(
    3,
    mass=80.0,
    inertia=Parameter("I_zz", 25.0, prior_std=3.0, description="about the origin"),
    centre_of_gravity=(0.1, 0.0, 0.0),
    added_mass=[
        Parameter("X_udot", -8.0, fixed=True),
        Parameter("Y_vdot", -120.0, prior_std=20.0),
        Parameter("N_rdot", -35.0, fixed=True, description="its sum with I_zz is what shows"),
    ],
)
HULL = BODY.hull(
    [
        Parameter("X_u", -40.0, prior_std=12.0, description="linear drag"),
        Parameter("X_absuu", -18.0, prior_std=6.0, description="quadratic drag"),
        Parameter("Y_v", -140.0, prior_std=40.0),
        Parameter("Y_uv", -120.0, prior_std=40.0, description="lift of the two hulls"),
        Parameter("N_uv", 80.0, prior_std=25.0, description="lift behind the middle"),
        Parameter("N_r", -60.0, prior_std=20.0),
        Parameter("N_absrr", -120.0, prior_std=40.0),
    ]
)
PROPELLERS = (
    BODY.thruster("port", "T_port", at=(-0.8, -0.4, 0.0)),
    BODY.thruster("starboard", "T_starboard", at=(-0.8, 0.4, 0.0)),
)

model = BODY.model(
    "catamaran with two propellers",
    inputs=(
        Input("n_port", "rad/s", "port propeller"),
        Input("n_starboard", "rad/s", "starboard propeller"),
    ),
    actuators={
        "T_port": "k_n*n_port*abs(n_port)",
        "T_starboard": "k_n*n_starboard*abs(n_starboard)",
    },
    effects=(HULL, *PROPELLERS),
    parameters=(
        Parameter("k_n", 0.011, "kg m", fixed=True, description="thrust per n|n|, bollard pull"),
    ),
    noise={"u": 0.02, "v": 0.02, "r": 0.005, "psi": 0.01, "x": 0.3, "y": 0.3},
    step=0.05,
)

LIMITS = Limits(inputs={"n_port": (0.0, 104.0), "n_starboard": (0.0, 104.0)})


def run(name: str, port, starboard) -> Experiment:
    """Sixty seconds from cruise."""
    return Experiment(
        name,
        (port, starboard),
        duration=60.0,
        sample_time=0.2,
        initial=BODY.start(u=1.2),
        limits=LIMITS,
    )


RUNS = (
    run(
        "steps",
        ThreeTwoOneOne("n_port", 20.0, unit_time=4.0, start=2.0, trim=CRUISE),
        ThreeTwoOneOne("n_starboard", 20.0, unit_time=5.0, start=4.0, first=-1, trim=CRUISE),
    ),
    run(
        "random",
        PRBS("n_port", 25.0, bit_time=2.0, order=5, trim=CRUISE),
        PRBS("n_starboard", 25.0, bit_time=3.0, order=5, seed=9, trim=CRUISE),
    ),
    run(
        "turns",
        Doublet("n_port", 30.0, pulse_time=12.0, start=5.0, trim=CRUISE),
        Doublet("n_starboard", 30.0, pulse_time=12.0, start=5.0, first=-1, trim=CRUISE),
    ),
)

problem = Problem(
    "catamaran",
    model,
    length=2.0,
    draught=0.2,
    title="Catamaran with two propellers",
    effects=catamaran_effects(
        BODY, length=2.0, speed=1.3, draught=0.2, outputs=("u", "v", "r"), known=HULL, step=0.05
    ),
    experiments={experiment.name: experiment for experiment in RUNS},
    limits=LIMITS,
    # What made the records in data/.
    truth={
        "I_zz": 26.5,
        "Y_vdot": -131.0,
        "X_u": -34.0,
        "X_absuu": -21.0,
        "Y_v": -155.0,
        "Y_uv": -105.0,
        "N_uv": 71.0,
        "N_r": -52.0,
        "N_absrr": -140.0,
        "E_propeller_lag": 0.4,
        "E_thrust_asymmetry": 0.06,
    },
    records=lambda: read_csv(FOLDER / "data", model.channels),
    references=(
        "Fossen (2021), Handbook of marine craft hydrodynamics and motion control, Wiley",
        "Fossen & Perez, Marine Systems Simulator, otter.m (mass, thrust and size)",
    ),
    description="Two propellers, no rudder: which part of the motion does the model miss?",
)
