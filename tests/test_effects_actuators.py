"""Actuator and sensor stages against fine simulation and closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from oed_sysid import physics as effects
from oed_sysid.compiled.kernels import Kernel
from oed_sysid.physics import Effect
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.physics.model import Model

STEP = 0.1
FINE = 2000
COMMANDS = np.repeat([0.0, 0.2, -0.15, -0.12, 0.0, 0.01, 0.3, 0.28], 4)


def integrator(*chain: Effect) -> Model:
    """Rate equal to the actual deflection, so that the state sums its means."""
    return Model(
        "integrator",
        states=(State("x", "rad s"),),
        inputs=(Input("command", "rad"),),
        outputs=(Output("x", "rad s"),),
        kinematics={"x": "d"},
        actuators={"d": "command"},
        effects=chain,
        step=STEP,
    )


def means(*chain: Effect, commands: np.ndarray = COMMANDS) -> np.ndarray:
    """Mean actual deflection of every step, ``(n_commands,)``."""
    model = integrator(*chain)
    kernel = Kernel(model, compiled=False)
    inputs = np.append(commands, 0.0)[:, None]
    times = STEP * np.arange(len(inputs))
    z, _ = kernel.start(np.zeros(1), inputs[0], model.value_vector, 0.0)
    run = kernel.run(times, inputs, model.value_vector, z)
    return np.diff(run.outputs[:, 0]) / STEP


def fine_means(advance: Callable[[float, float, float], float]) -> np.ndarray:
    """Mean of ``actual = advance(actual, command, dt)`` by many small steps."""
    actual, result = COMMANDS[0], []
    for command in COMMANDS:
        total = 0.0
        for _ in range(FINE):
            before = actual
            actual = advance(actual, command, STEP / FINE)
            total += 0.5 * (before + actual)
        result.append(total / FINE)
    return np.array(result)


def test_lag_is_exact() -> None:
    """The mean of a lagged held command equals that of a fine simulation."""
    lag = 0.17
    fine = fine_means(lambda a, c, dt: c + (a - c) * math.exp(-dt / lag))
    np.testing.assert_allclose(means(effects.actuator_lag("lag", "d", value=lag)), fine, atol=1e-8)


def test_rate_limit_is_exact() -> None:
    """The mean under a rate limit equals that of a fine simulation."""
    rate = 0.35
    limit = effects.rate_limit("limit", "d", value=1 / rate)
    fine = fine_means(lambda a, c, dt: a + float(np.clip(c - a, -rate * dt, rate * dt)))
    np.testing.assert_allclose(means(limit), fine, atol=2e-5)
    assert effects.maximum_rate(limit) == pytest.approx(rate)
    assert effects.maximum_rate(effects.rate_limit("none", "d")) == math.inf


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.1, 0.237, 0.4])
def test_delay_is_exact(delay: float) -> None:
    """The mean of a delayed held command is the overlap of its two neighbours."""
    effect = effects.actuator_delay("delay", "d", max_delay=0.4, step=STEP, value=delay)
    whole, part = divmod(delay / STEP + 1e-12, 1.0)
    padded = np.concatenate([np.full(6, COMMANDS[0]), COMMANDS])
    late = [padded[6 - int(whole) - i : len(padded) - int(whole) - i] for i in (0, 1)]
    np.testing.assert_allclose(means(effect), (1 - part) * late[0] + part * late[1], atol=1e-12)


def test_delay_longer_than_register_is_refused() -> None:
    """A delay cannot leave the register that was sized for it."""
    effect = effects.actuator_delay("delay", "d", max_delay=0.4, step=STEP)
    assert effect.parameters[0].upper == 0.4
    assert len(effect.memory) == 4


def test_backlash_plays() -> None:
    """The actual value waits inside the play and follows on its flank."""
    play = effects.backlash("play", "d", value=0.05)
    actual, expected = COMMANDS[0], []
    for command in COMMANDS:
        actual = min(max(actual, command - 0.05), command + 0.05)
        expected.append(actual)
    np.testing.assert_allclose(means(play), expected, atol=1e-12)


def test_deadband_offset_stall_gain_saturation() -> None:
    """Static errors of an actuator follow their formulas."""
    d = COMMANDS
    shrunk = np.sign(d) * np.maximum(np.abs(d) - 0.05, 0)
    np.testing.assert_allclose(means(effects.deadband("e", "d", value=0.05)), shrunk, atol=1e-12)
    for effect, expected in (
        (effects.actuator_offset("e", "d", value=0.02), d + 0.02),
        (effects.stall("e", "d", value=2.0), d * (1 - 2 * d**2)),
        (effects.actuator_gain_error("e", "d", value=-0.1), 0.9 * d),
        (effects.saturation("e", "d", 0.1), np.clip(d, -0.1, 0.1)),
    ):
        np.testing.assert_allclose(means(effect), expected, atol=1e-12)


def test_chain_starts_at_rest() -> None:
    """A lag after an offset, delay and play starts where the first command leaves it."""
    chain = (
        effects.actuator_offset("offset", "d", value=0.1),
        effects.actuator_delay("delay", "d", value=0.25),
        effects.actuator_lag("lag", "d", value=0.5),
        effects.backlash("play", "d", value=0.05),
    )
    constant = np.full(8, 0.2)
    np.testing.assert_allclose(means(*chain, commands=constant), 0.3, atol=1e-12)


def test_thrust_decay_falls_linearly() -> None:
    """Thrust falls by the stated fraction per second, held over a step."""
    constant = np.full(5, 2.0)
    decay = effects.thrust_decay("decay", "d", value=0.5)
    expected = 2.0 * (1 - 0.5 * STEP * np.arange(5))
    np.testing.assert_allclose(means(decay, commands=constant), expected, atol=1e-12)


# -- sensors -----------------------------------------------------------------------


def ramp(*chain: Effect, n: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Times and measured value of a state that grows at 2 per second from 1."""
    model = Model(
        "ramp",
        states=(State("x", "m"),),
        inputs=(),
        outputs=(Output("x", "m"),),
        kinematics={"x": "2"},
        effects=chain,
        step=STEP,
    )
    kernel = Kernel(model, compiled=False)
    times = STEP * np.arange(n)
    z, _ = kernel.start(np.ones(1), np.zeros(0), model.value_vector, 0.0)
    run = kernel.run(times, np.zeros((n, 0)), model.value_vector, z)
    return times, run.outputs[:, 0]


def test_sensor_lag_of_a_ramp() -> None:
    """A first-order lag of a ramp is known in closed form."""
    times, measured = ramp(effects.sensor_lag("lag", "x", value=0.4))
    exact = 1 + 2 * (times - 0.4 * (1 - np.exp(-times / 0.4)))
    np.testing.assert_allclose(measured, exact, atol=1e-9)


def test_sensor_delay_of_a_ramp() -> None:
    """A delayed ramp is the ramp some time ago, once the record is long enough."""
    times, measured = ramp(effects.sensor_delay("delay", "x", value=0.23, max_delay=0.5))
    np.testing.assert_allclose(measured[5:], 1 + 2 * (times[5:] - 0.23), atol=1e-12)
    assert measured[0] == 1.0


def test_sensor_chain_starts_without_transient() -> None:
    """Bias, lag, lag and delay start at the biased first value."""
    chain = (
        effects.sensor_bias("bias", "x", "m", scale=1.0, value=5.0),
        effects.sensor_lag("first", "x", value=0.3),
        effects.sensor_lag("second", "x", value=0.2),
        effects.sensor_delay("delay", "x", value=0.1),
        effects.sensor_drift("drift", "x", "m/s", scale=1.0, value=0.25),
    )
    times, measured = ramp(*chain, n=100)
    assert measured[0] == 6.0
    settled = 6 + 2 * (times[-1] - 0.6) + 0.25 * times[-1]
    assert measured[-1] == pytest.approx(settled, abs=1e-6)


def test_one_parameter_for_several_channels() -> None:
    """Shared lag, delay and rate limit move each channel as its own effect would."""
    from oed_sysid import Force, Input, Model, Output, State
    from oed_sysid.compiled.kernels import kernel
    from oed_sysid.physics import actuator_delay, actuator_lag, rate_limit

    def pair(*effects):
        return Model(
            "pair",
            (State("x", "m"), State("y", "m")),
            (Input("a", "rad"), Input("b", "rad")),
            (Output("x", "m"), Output("y", "m")),
            {"x": "0", "y": "0"},
            effects=(*effects, Force("push", {"x": "a", "y": "b"})),
            step=0.1,
        )

    times = 0.1 * np.arange(80)
    inputs = np.column_stack([np.sign(np.sin(2 * times)), 0.4 * np.sign(np.cos(times))])
    for make, value in ((actuator_lag, 0.3), (actuator_delay, 0.25), (rate_limit, 1.5)):
        shared = pair(make("both", ("a", "b"), value=value))
        single = pair(make("one", "a", value=value), make("two", "b", value=value))
        assert len(shared.free_names) == 1
        found = []
        for model in (shared, single):
            z, _ = kernel(model).start(np.zeros(2), inputs[0], model.value_vector, 0.0)
            found.append(kernel(model).run(times, inputs, model.value_vector, z).outputs)
        np.testing.assert_allclose(found[0], found[1], rtol=1e-13, atol=1e-14)
        assert np.abs(found[0][-1]).max() > 0.05
