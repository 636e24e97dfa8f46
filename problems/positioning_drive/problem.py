"""Positioning drive: a carriage on a screw, driven by a motor, its position measured.

The nominal model is a mass with viscous friction; what else holds the carriage back is to be found.
The record is of a closed loop: the controller answers the position, so force and motion know of
each other.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from oed_sysid import (
    Dataset,
    Force,
    Input,
    Limits,
    Model,
    Output,
    Parameter,
    Problem,
    Record,
    State,
)
from oed_sysid.data.third_party import fetch
from oed_sysid.errors import DataError
from oed_sysid.physics import (
    actuator_lag,
    cubic_damping,
    mechanical_effects,
    quadratic_drag,
)

ORIGINAL = "emps/DATA_EMPS.mat"
THIN = 10  # milliseconds to a sample: the force is the mean of ten, held; the position is as read
HALVES = ("train_first_half", "test_second_half")

VISCOUS = Force(
    "viscous_friction",
    {"X": "X_v*v"},
    (Parameter("X_v", -200.0, "N s/m", upper=0.0, description="viscous friction"),),
    description="friction that grows with speed",
)
MOTOR = Force("motor", {"X": "F"}, description="force of the motor at the carriage")

model = Model(
    name="positioning drive, mass and viscous friction",
    states=(
        State("x", "m", "position", scale=0.1),
        State("v", "m/s", "velocity", scale=0.1),
    ),
    inputs=(Input("F", "N", "force of the motor", column="force_N"),),
    outputs=(Output("x", "m", "position", column="position_m"),),
    axes={"X": "v"},
    inertia={("X", "v"): "m"},
    kinematics={"x": "v"},
    effects=(VISCOUS, MOTOR),
    parameters=(Parameter("m", 90.0, "kg", lower=10.0, description="mass with the rotor's share"),),
    step=0.001 * THIN,
)

effects = (
    *(
        effect
        for effect in mechanical_effects("X", "x", "v", force=50.0, rotates=False, speed=0.1)
        if effect.name != "viscous_friction"
    ),
    Force(
        "offset",
        {"X": "X_0"},
        (Parameter("X_0", 0.0, "N", lower=-50.0, upper=50.0, scale=2.0),),
        description="constant force",
        needs="motion in both directions",
    ),
    quadratic_drag("quadratic_friction", "X", "v", scale=200.0),
    cubic_damping("cubic_friction", "X", "v", scale=2000.0),
    actuator_lag("motor_lag", "F", scale=0.01),
)


def original(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Force, N, and position, m, of a record of the bench as it is published (MATLAB, 1 kHz).

    Raises
    ------
    DataError
        If the file does not hold time, position, voltage and force per volt.
    """
    from scipy.io import loadmat

    content = loadmat(str(path))
    if lacking := [name for name in ("t", "qm", "vir", "gtau") if name not in content]:
        raise DataError(
            f"{path.name} has no variable {lacking[0]}; expected t [s], qm [m], vir [V], gtau [N/V]."
        )
    position, voltage = (np.ravel(content[name]).astype(float) for name in ("qm", "vir"))
    return float(np.ravel(content["gtau"])[0]) * voltage, position


def read(path: Path, name: str) -> Record:
    """A record of the bench at a tenth of its rate."""
    force, position = original(path)
    n = len(position) // THIN
    return Record(
        name,
        0.001 * THIN * np.arange(n),
        force[: n * THIN].reshape(n, THIN).mean(axis=1)[:, None],
        position[: n * THIN : THIN, None],
        model.channels,
        name,
    )


def records() -> Dataset:
    """First half to learn from, second half to judge by."""
    whole = read(fetch(ORIGINAL), ORIGINAL)
    middle = whole.times[whole.n_samples // 2]
    first = whole.window(0.0, middle - 0.0005 * THIN)
    second = whole.window(middle, whole.times[-1])
    return Dataset(
        tuple(
            Record(name, r.times - r.times[0], r.inputs, r.outputs, model.channels, r.source)
            for name, r in zip(HALVES, (first, second), strict=True)
        )
    )


problem = Problem(
    name="positioning_drive",
    title="Electro-mechanical positioning drive with dry friction",
    model=model,
    effects=effects,
    limits=Limits(inputs={"F": (-150.0, 150.0)}),
    records=records,
    published={"m": 95.1, "X_v": -203.5, "E_coulomb_friction": 20.4, "X_0": 3.16},
    references=(
        "Janot, Gautier & Brunot (2019), Data set and reference models of EMPS, Workshop on "
        "Nonlinear System Identification Benchmarks",
    ),
    description="Force and position of a carriage: find which friction it has.",
)
