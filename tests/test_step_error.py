"""Trajectories that hang on the integration step are told apart from those that do not."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Input, Model, MultipleShooting, Output, Parameter, Solver, State
from oed_sysid.data.record import Record
from oed_sysid.likelihood.judgement import step_change


def relay(force: str) -> Model:
    """A mass on a force that switches with its position, in steps that are coarse for a jump."""
    return Model(
        "relay",
        (State("x", "m"), State("u", "m/s")),
        (Input("push", "N"),),
        (Output("x", "m", noise_std=1e-3), Output("u", "m/s", noise_std=1e-3)),
        {"x": "u", "u": f"push - stiffness*{force} - 0.1*u"},
        parameters=(Parameter("stiffness", 1.0, "N", lower=0.0),),
        step=0.1,
    )


def shaken(model: Model, n: int = 200) -> Dataset:
    """Noise-free motion by steps so fine that they are taken for the truth."""
    fine = 200
    times = 0.1 * np.arange(n)
    state, states = np.array([0.3, 0.0]), []
    jumps = "sign" in model.equations()
    for _ in times:
        states.append(state.copy())
        for _ in range(fine):
            pull = np.sign(state[0]) if jumps else np.tanh(state[0])
            rate = np.array([state[1], -pull - 0.1 * state[1]])
            state = state + rate * 0.1 / fine
    record = Record("shaken", times, np.zeros((n, 1)), np.array(states), model.channels)
    return Dataset((record,))


@pytest.mark.parametrize(("force", "hangs"), [("sign(x)", True), ("tanh(x)", False)])
def test_a_jumping_force_is_noticed(force: str, hangs: bool) -> None:
    """A relay changes with the step by more than the noise, a smooth spring does not."""
    model = relay(force)
    data = shaken(model)
    fit = MultipleShooting(disturbances="none", solver=Solver(max_iterations=5)).fit(model, data)
    size, output, record = step_change(fit)
    assert (size > 0.5) == hangs
    if hangs:
        assert output in model.output_names
        assert record == "shaken"


def test_the_status_says_so() -> None:
    """A fit that fails on the stairs of a relay names the output, the record and the step."""
    model = relay("sign(x)")
    fit = MultipleShooting(solver=Solver(max_iterations=3)).fit(
        model.with_values({"stiffness": 1.3}), shaken(model)
    )
    assert not fit.status.ok
    assert "integration step" in fit.status.advice
    assert "'shaken'" in fit.status.advice
