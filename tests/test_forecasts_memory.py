"""Forecasts begin where commands have left what effects remember."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Input, Model, Output, Parameter, Record, State
from oed_sysid.evidence.forecasts import forecasts
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.physics import Effect, actuator_lag, backlash

YAW = Model(
    "yaw",
    (State("r", "rad/s", scale=0.1), State("psi", "rad")),
    (Input("rudder", "rad"),),
    (Output("r", "rad/s", noise_std=0.001), Output("psi", "rad", noise_std=0.002)),
    {"r": "(K*rudder - r)/T", "psi": "r"},
    parameters=(Parameter("K", 0.3, "1/s"), Parameter("T", 2.0, "s", lower=0.1)),
    step=0.1,
)


@pytest.mark.parametrize(
    ("effect", "size"),
    [(backlash("play", "rudder"), 0.05), (actuator_lag("lag", "rudder"), 3.0)],
)
def test_of_the_truth_forecasts_are_as_good_as_stated(effect: Effect, size: float) -> None:
    """Errors over their stated size are one, with a play and with a slow rudder."""
    rng = np.random.default_rng(4)
    model = (YAW + effect).with_values({effect.amplitude_names[0]: size})
    times = np.arange(0.0, 300.0, 0.2)
    rudder = np.repeat(rng.uniform(-0.3, 0.3, 100), 15)
    run = simulate_inputs(model, times, inputs={"rudder": rudder})
    seen = run.outputs + np.array([0.001, 0.002]) * rng.standard_normal(run.outputs.shape)
    record = Record("run", times, rudder[:, np.newaxis], seen, model.channels)
    found = forecasts(model, Dataset((record,)), np.array([0.001, 0.002]), horizon=10.0)
    assert found.n_forecasts > 20
    ratio = np.sqrt(np.nanmean((found.errors[0] / found.expected[0]) ** 2))
    assert ratio == pytest.approx(1.0, abs=0.1)
