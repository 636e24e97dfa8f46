"""Roll decay of a tanker model at zero speed: which damping, and is the spring straight?

One test of the KVLCC2 at scale 1:68, from the first crest after the release on.
The nominal model is the textbook's: linear damping and a linear righting moment
from the known displacement and metacentric height.
"""

from __future__ import annotations

import numpy as np

from oed_sysid import (
    Dataset,
    Force,
    Limits,
    Model,
    Output,
    Parameter,
    Problem,
    Record,
    State,
    read_csv,
)
from oed_sysid.data.third_party import fetch
from oed_sysid.physics import derivative, fluid_memory, roll_effects, sensor_drift

# Particulars of the full-scale ship (model_test_parameters.csv), by Froude to the model.
SCALE = 68.0
VOLUME = 312653.0 / SCALE**3  # m3
METACENTRIC_HEIGHT = 5.73 / SCALE  # m
DENSITY, GRAVITY = 1000.0, 9.81  # kg/m3 (fresh water, as listed there), m/s2
STIFFNESS = DENSITY * GRAVITY * VOLUME * METACENTRIC_HEIGHT  # N m/rad
FREQUENCY = 2.47  # rad/s, from the zero crossings of the record
INERTIA = STIFFNESS / FREQUENCY**2  # kg m2

# The model is pushed over until 24.9 s and rolls freely afterwards.
RELEASE, LARGE_ENDS, END = 26.0, 76.0, 91.6  # s
THIN = 5  # 0.05 s between samples: fifty to a period

DAMPING = Force(
    "roll_damping",
    {"K": "K_p*p"},
    (Parameter("K_p", -3.0, "N m s", upper=0.0, description="linear roll damping"),),
    description="friction, and waves radiated",
)
RIGHTING = Force(
    "righting_moment",
    {"K": "-rho_g_V_GM*phi"},
    (Parameter("rho_g_V_GM", STIFFNESS, "N m", fixed=True, description="hydrostatics"),),
    description="righting moment of the initial metacentric height",
)

model = Model(
    name="roll decay, linear",
    states=(
        State("phi", "rad", "roll angle", scale=0.1),
        State("p", "rad/s", "roll rate", scale=0.3),
    ),
    inputs=(),
    outputs=(Output("phi", "rad", "roll angle", column="phi_rad"),),
    axes={"K": "p"},
    inertia={("K", "p"): "I_xx"},
    kinematics={"phi": "p"},
    effects=(DAMPING, RIGHTING),
    parameters=(
        Parameter(
            "I_xx", INERTIA, "kg m^2", lower=1.0, description="roll inertia with added inertia"
        ),
    ),
    step=0.05,
)

# Linear damping and an error of inertia are free already in the nominal model. There
# are no waves in the basin, and one at the natural frequency would mimic any damping.
LEFT_OUT = ("roll_linear_damping", "roll_added_inertia_error", "wave_roll_moment")
effects = (
    *(e for e in roll_effects(inertia=INERTIA, frequency=FREQUENCY) if e.name not in LEFT_OUT),
    derivative("roll_quadratic_restoring", "K_absphiphi", scale=0.3 * STIFFNESS),
    fluid_memory("roll_fluid_memory", "K", "p", time_constant=1.0, scale=0.05 * INERTIA),
    sensor_drift("drift_phi", "phi", "rad/s", scale=1e-4),
)


def decay(start: float, stop: float, name: str) -> Record:
    """Part of the test between two times in s."""
    whole = read_csv(fetch("kvlcc2_roll_decay/model_test_21337.csv"), model.channels)[0]
    part = whole.window(start, stop).thin(THIN).rename(name)
    times = part.times - part.times[0]
    return Record(name, times, part.inputs, part.outputs, model.channels, part.source)


def records() -> Dataset:
    """The decay from 9.2 to 4.6 degrees to learn from, the last six periods to judge by."""
    return Dataset(
        (decay(RELEASE, LARGE_ENDS, "train_large"), decay(LARGE_ENDS, END, "test_small"))
    )


problem = Problem(
    name="roll_decay",
    title="KVLCC2 roll decay at zero speed, model scale 1:68",
    model=model,
    effects=effects,
    limits=Limits(signals={"phi": (-np.radians(15.0), np.radians(15.0))}),
    records=records,
    published={
        "natural frequency, rad/s": 2.472,
        "linear damping ratio with quadratic damping, 0 kn": 0.0005,
        "quadratic damping over inertia, 1/rad, 0 kn": 0.117,
    },
    references=(
        "SSPA (2018), roll decay tests of the KVLCC2, run 21337, data doi:10.17632/2stvkyngj9.1",
        "Ikeda, Himeno & Tanaka (1978), A prediction method for ship roll damping, Osaka Univ.",
    ),
    description="A linear model fits one amplitude; find what a decay from 9 to 4 degrees shows.",
)
