"""Candidates that have several shape parameters."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Force, Model, Output, Parameter, Record, State
from oed_sysid.compiled.kernels import kernel
from oed_sysid.evidence.improve import improve


@pytest.mark.parametrize("brim", [1.0, 5.0], ids=["near", "above every level"])
def test_several_shapes_are_estimated_from_their_own_values(brim: float) -> None:
    """Every shape is looked for over its bounds, even where the given value shows nothing."""
    tank = Model(
        "tanks",
        states=(State("upper", "m"), State("lower", "m")),
        inputs=(),
        outputs=(Output("upper", "m"), Output("lower", "m")),
        kinematics={"upper": "-drain*upper", "lower": "drain*upper - drain*lower"},
        parameters=(Parameter("drain", 0.4, "1/s"),),
    )
    overflow = Force(
        "overflow",
        {
            "upper": "-E_overflow*max(upper - brim, 0)",
            "lower": "E_overflow*share*max(upper - brim, 0)",
        },
        (
            Parameter("E_overflow", 0.0, "1/s", lower=0.0, upper=2.0, scale=0.1),
            Parameter("share", 0.5, "1", lower=0.0, upper=1.0),
            Parameter("brim", brim, "m", lower=0.5, upper=6.0),
        ),
        amplitudes=("E_overflow",),
    )
    true = (tank + overflow).with_values({"E_overflow": 0.5, "share": 0.7, "brim": 1.0})
    times = np.arange(0.0, 10.0, 0.1)
    values, own = true.value_vector, np.array([3.0, 0.5])
    runner = kernel(true)
    inputs = np.zeros((times.size, 0))
    start = runner.start(own, inputs[0], values, 0.0)[0]
    clean = runner.run(times, inputs, values, start).outputs
    noisy = clean + 0.002 * np.random.default_rng(2).standard_normal(clean.shape)
    data = Dataset((Record("drain", times, inputs, noisy, tank.channels),))
    found = improve(tank, data, candidates=(overflow,))
    assert [step.added for step in found.steps] == ["overflow"]
    assert abs(found.model.values["share"] - 0.7) < 0.1
    assert abs(found.model.values["brim"] - 1.0) < 0.1
