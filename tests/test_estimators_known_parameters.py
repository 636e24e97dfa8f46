"""Estimation where every parameter is known and only initial states are not."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Model, MultipleShooting, Output, Parameter, Record, State

DECAY = Model(
    "decay",
    states=(State("x", "m"),),
    inputs=(),
    outputs=(Output("x", "m"),),
    kinematics={"x": "-k*x"},
    parameters=(Parameter("k", 0.5, "1/s", fixed=True),),
)


@pytest.mark.parametrize("start", ["near", "wide"])
def test_initial_state_of_a_known_model(start: str) -> None:
    """The initial state is the closed-form least-squares amplitude of the known decay."""
    times = np.arange(0.0, 6.0, 0.1)
    shape = np.exp(-0.5 * times)
    rng = np.random.default_rng(5)
    measured = 2.0 * shape + 0.05 * rng.standard_normal(times.size)
    data = Dataset((Record("decay", times, [], measured, DECAY.channels),))
    fit = MultipleShooting(start=start).fit(DECAY, data)
    expected = shape @ measured / (shape @ shape)
    assert fit.status.ok
    assert fit.names == ()
    assert fit.covariance.shape == (0, 0)
    assert fit.initial_states[0][0] == pytest.approx(expected, rel=1e-5)
    assert "decay" in fit.report()
