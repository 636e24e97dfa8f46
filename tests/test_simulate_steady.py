"""Equilibria and linear models against long simulations, closed forms and differences."""

from __future__ import annotations

import numpy as np
import pytest
from simple_models import AUV, NOMOTO, K, T

from oed_sysid.errors import SimulationError
from oed_sysid.experiments.experiment import Limits
from oed_sysid.experiments.simulation import equilibrium, linearise, simulate_inputs
from oed_sysid.physics.channels import Output, State
from oed_sysid.physics.model import Model


def test_equilibrium_of_a_dive() -> None:
    """With a given fin the AUV settles in a steady dive, as a long simulation confirms."""
    trim = equilibrium(AUV, inputs={"fin": 0.05, "thrust": 9.0})
    assert trim.ok, trim.status
    assert trim.steady == ("u", "w", "q", "theta")
    assert trim.residual < 1e-8
    run = simulate_inputs(
        AUV, np.arange(0, 200, 0.5), inputs={"fin": 0.05, "thrust": 9.0}, initial={"u": 1.5}
    )
    for name in trim.steady:
        assert run.signal(name)[-1] == pytest.approx(trim.states[name], abs=1e-6)


def test_equilibrium_solves_for_inputs_within_limits() -> None:
    """Level flight at 1.5 m/s needs thrust -X_uu u^2; where the limit forbids it, it says so."""
    level = {"fixed": {"u": 1.5, "z": 10.0}, "free": ["fin", "thrust"]}
    wanted = ["u", "w", "q", "theta", "z"]
    trim = equilibrium(AUV, **level, steady=wanted)
    assert trim.ok
    assert trim.inputs["thrust"] == pytest.approx(3.9 * 1.5**2)
    assert trim.inputs["fin"] == pytest.approx(0.0, abs=1e-9)
    weak = equilibrium(AUV, **level, steady=wanted, limits=Limits(inputs={"thrust": (0.0, 5.0)}))
    assert not weak.ok
    assert "u keeps changing" in weak.status
    assert weak.inputs["thrust"] == pytest.approx(5.0, abs=1e-6)


def test_equilibrium_says_what_is_missing() -> None:
    """An input is given or free; nothing is assumed to be zero."""
    with pytest.raises(SimulationError, match="'thrust' is neither given nor free"):
        equilibrium(AUV, inputs={"fin": 0.0})
    with pytest.raises(SimulationError, match="no state or input 'rudder'"):
        equilibrium(AUV, inputs={"fin": 0.0, "thrust": 9.0, "rudder": 1.0})
    with pytest.raises(SimulationError, match="both given and free"):
        equilibrium(AUV, inputs={"fin": 0.0, "thrust": 9.0}, free=["fin"])
    drifting = Model("drift", (State("x", "m"),), (), (Output("x", "m"),), {"x": "1 + x*x"})
    nothing = equilibrium(drifting)
    assert not nothing.ok
    with pytest.raises(SimulationError, match="at an equilibrium only"):
        linearise(drifting, nothing)


def test_linear_model_against_finite_differences() -> None:
    """Matrices are the derivatives of the equations, also by central differences."""
    bare = AUV.without("fin_lag", "depth_lag")
    trim = equilibrium(bare, inputs={"fin": 0.05, "thrust": 9.0})
    linear = linearise(bare, trim)
    assert linear.state_labels == list(bare.state_names)
    assert linear.input_labels == ["fin", "thrust"]
    assert linear.output_labels == ["q", "theta", "z"]
    x = np.array(list(trim.states.values()))
    u = np.array(list(trim.inputs.values()))

    def slope(direction: np.ndarray) -> np.ndarray:
        # A very short run is the rate of the states; central in the deviation.
        ends = []
        for sign in (1e-4, -1e-4):
            start = x + sign * direction[: len(x)]
            command = np.tile(u + sign * direction[len(x) :], (2, 1))
            run = simulate_inputs(bare, [0.0, 1e-4], inputs=command, initial=start)
            ends.append((run.states[1] - start) / 1e-4)
        return (ends[0] - ends[1]) / 2e-4

    columns = np.column_stack([slope(axis) for axis in np.eye(len(x) + len(u))])
    np.testing.assert_allclose(np.hstack([linear.A, linear.B]), columns, atol=2e-3, rtol=1e-3)


def test_linear_model_of_a_linear_model() -> None:
    """The poles of a Nomoto ship are 0 (heading) and -1/T, its yaw gain is K."""
    linear = linearise(NOMOTO, equilibrium(NOMOTO, inputs={"rudder": 0.0}), outputs=["r"])
    np.testing.assert_allclose(np.sort(linear.poles().real), [-1 / T, 0.0], atol=1e-12)
    assert linear(1e-6j)[()].real == pytest.approx(K, rel=1e-4)
    with pytest.raises(SimulationError, match="no output 'u'"):
        linearise(NOMOTO, equilibrium(NOMOTO, inputs={"rudder": 0.0}), outputs=["u"])


def test_settled_sensor_and_actuator_have_unit_gain() -> None:
    """Lags vanish in the linear model: the depth sensor reads depth one to one."""
    linear = linearise(AUV, equilibrium(AUV, inputs={"fin": 0.0, "thrust": 9.0}))
    bare = AUV.without("fin_lag", "depth_lag")
    plain = linearise(bare, equilibrium(bare, inputs={"fin": 0.0, "thrust": 9.0}))
    for name in "ABCD":
        np.testing.assert_allclose(getattr(linear, name), getattr(plain, name), atol=1e-9)
