"""Nomoto's K and T from a heading that is sampled too rarely: Han, Bai, Yu and Lian (2023).

The vehicle of the paper is not named; K and T are those whose sampling errors
come closest to the published ones, see README.md.
"""

from __future__ import annotations

import math

from oed_sysid import (
    Experiment,
    Force,
    Input,
    Limits,
    Model,
    Output,
    Parameter,
    Problem,
    State,
    ZigZag,
)

RUDDER_RATE = math.radians(15.68)
ANGLE = math.radians(15.0)

model = Model(
    name="first-order Nomoto",
    states=(
        State("psi", "rad", "heading", scale=0.1),
        State("r", "rad/s", "yaw rate", scale=0.1),
    ),
    inputs=(Input("delta", "rad", "rudder angle", interpolation="linear"),),
    outputs=(Output("psi", "rad", "heading", noise_std=math.radians(0.05)),),
    kinematics={"psi": "r"},
    axes={"N": "r"},
    # Both parameters enter linearly in this form, T as an inertia.
    inertia={("N", "r"): "T"},
    effects=(
        Force(
            "turning",
            {"N": "K*delta - r"},
            (Parameter("K", 2.0, "1/s", 0.01, 20.0, description="turning gain"),),
            description="steady turning rate in proportion to the rudder",
            source="Nomoto et al. 1957, On the steering qualities of ships",
        ),
    ),
    parameters=(Parameter("T", 0.3, "s", 0.01, 20.0, description="time constant"),),
    step=0.01,
)

LIMITS = Limits(inputs={"delta": (-ANGLE, ANGLE)}, rates={"delta": RUDDER_RATE})


def _zigzag(name: str, duration: float, rate: float, limits: Limits) -> Experiment:
    """15/15 zigzag, logged every 0.01 s; the sparse records are thinned from it."""
    return Experiment(
        name,
        ZigZag("delta", ANGLE, ANGLE, rate=rate),
        duration=duration,
        sample_time=0.01,
        feedback="true",
        limits=limits,
    )


problem = Problem(
    name="nomoto_sparse_heading",
    title="Nomoto's K and T from sparse headings",
    model=model,
    experiments={
        "zigzag_15_15": _zigzag("zigzag_15_15", 40.0, RUDDER_RATE, LIMITS),
        "fast_rudder": _zigzag("fast_rudder", 60.0, math.radians(30.0), Limits()),
    },
    limits=LIMITS,
    truth={"K": 2.0, "T": 0.3},
    models={
        "K0.5_T0.6": model.with_values({"K": 0.5, "T": 0.6}),
        "K0.5_T1": model.with_values({"K": 0.5, "T": 1.0}),
        "K0.5_T2": model.with_values({"K": 0.5, "T": 2.0}),
    },
    published={
        "sample_times_s": (0.1, 0.2, 0.5),
        # All relative to the values found from 0.1 s, mean over K and T, in per cent.
        "error_at_0.5_s_percent": 33.5,
        "spiral_error_percent": 2.4,
        "spiral_better_than_cubic_by_percent": 1.0,
        "spiral_gain_over_sparse_percent": 31.1,
        "prediction_rms_rad": 0.0258,
    },
    references=(
        "Han L, Bai J, Yu C, Lian L 2023, Ship Science and Technology 45(7) 79-84, "
        "doi 10.3404/j.issn.1672-7649.2023.07.017",
        "Nomoto K, Taguchi T, Honda K, Hirano S 1957, On the steering qualities of ships",
    ),
    description=(
        "Headings every 0.5 s ruin difference formulas. Do curves between the samples repair it, "
        "and does an estimator that simulates need them at all?"
    ),
)
