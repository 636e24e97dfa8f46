"""Effects at each stage of the chain, against hand calculations and their contract."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import motion
import numpy as np
import pytest
import vehicles
from marks import slow
from motion import small
from scipy.integrate import solve_ivp

from oed_sysid import Actuator, Force, Model, Parameter, Sensor, load_problem, simulate_inputs
from oed_sysid import physics as effects
from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.errors import DataError, ModelError
from oed_sysid.physics import Effect
from oed_sysid.physics.words import _factors, _labels, in_words
from oed_sysid.testing import check_effect
from oed_sysid.text import expressions

DIVING = effects.diving_plane_effects()
SHIP = effects.surface_ship_effects()
ROLL = effects.roll_effects(inertia=2.0, frequency=1.0)

# What breaks the mirror outright, and what keeps it if its amplitude is mirrored too.
ODD = {
    *("excess_buoyancy", "cg_offset_x", "hull_asymmetry_heave", "hull_asymmetry_pitch"),
    *("current_vertical", "wave_heave_force", "fin_offset", "bias_w", "bias_q", "bias_theta"),
    *("dvl_misalignment", "rudder_neutral_angle", "single_screw_asymmetry", "wave_yaw_moment"),
    "rudder_neutral_angle_by_record",
    *("bias_r", "bias_psi", "log_misalignment", "heel_moment", "wave_roll_moment", "bias_phi"),
}
UNCLAIMED = {"hull_compressibility", "nonlinear_yaw_damping", "current", "wind", "cogging"}
UNCLAIMED |= {"current_by_record", "wind_by_record"}


GENERIC = (
    effects.derivative("term", "Z_ww", scale=20.0),
    effects.actuator_gain_error("gain", "ds"),
    effects.sensor_delay("theta_delay", "theta", max_delay=0.5),
    effects.sensor_drift("drift", "z", "m/s", scale=0.01),
    effects.sensor_lag("gyro_lag", "q"),
    effects.added_mass_coupling("coupling", ("Z", "q"), ("M", "w"), scale=1.0),
    effects.added_mass_factor("loading", {("Z", "w"): "-Z_wdot", ("M", "q"): "-M_qdot"}),
    effects.cubic_damping("cubic", "M", "q", scale=200.0),
    effects.coupling("lift", "Z", "w_r", scale=5.0),
)
BEARINGS = np.linspace(-np.pi, np.pi, 13)
TABULATED = effects.wind_load(
    "wind",
    {"X": (BEARINGS, np.cos(BEARINGS)), "Y": (BEARINGS, np.sin(BEARINGS))},
    speed=15.0,
    direction=1.0,
    area=900.0,
    length=160.0,
)
ARM = effects.righting_arm_table("gz", [-1.0, -0.33, 0.0, 0.33, 1.0], [0.2, -0.1, 0, 0.1, -0.2])
MECHANICAL = (
    *effects.mechanical_effects(force=1.0, stiffness=2.0),
    effects.bouc_wen_hysteresis(
        "hysteresis", "K", "p", yielding=0.1, unit="N m", displacement_unit="rad"
    ),
    effects.delayed_force("late", "K", "phi", unit="N m/rad", start="phi", delay=0.3),
)


def pendulum(*effects: Effect) -> Model:
    """A driven pendulum of unit inertia."""
    known = {"J": (1.0, "kg m^2"), "k": (2.0, "N m/rad")}
    return small(
        "pendulum",
        "phi [rad], p [rad/s] <- torque [N m]",
        {"phi": "p"},
        [Parameter(name, *said, fixed=True) for name, said in known.items()],
        interpolation="linear",
        axes={"K": "p"},
        inertia={("K", "p"): "J"},
        effects=(Force("drive", {"K": "torque - k*phi"}), *effects),
        step=0.01,
    )


# Vehicle, effects, what it does in the probe, and what changes sign in its mirror.
DIVES = {"initial": vehicles.DIVING_START, "inputs": vehicles.DIVING_INPUTS}
SAILS = {"initial": vehicles.SHIP_START, "inputs": vehicles.SHIP_INPUTS}
CARRIED = (
    (vehicles.remus, DIVING, DIVES, vehicles.DIVING_MIRROR),
    (vehicles.remus, GENERIC, DIVES, ()),
    (vehicles.ship, SHIP, SAILS, vehicles.SHIP_MIRROR),
    (vehicles.ship, [TABULATED], SAILS, ()),
    (vehicles.roll_oscillator, [*ROLL, ARM], {}, vehicles.ROLL_MIRROR),
    (pendulum, MECHANICAL, {"initial": {"phi": 0.4, "p": 0.3}}, ("phi", "p", "torque")),
)
CONTRACTS = [
    pytest.param(vehicle, effect, probe, mirror, id=f"{vehicle.__name__}-{effect.name}")
    for vehicle, of, probe, mirror in CARRIED
    for effect in of
]


@pytest.mark.parametrize("size", [{"n_times": 8, "n_points": 1}, *slow({})], ids=["short", ""])
@pytest.mark.parametrize(("vehicle", "effect", "probe", "mirror"), CONTRACTS)
def test_effect_keeps_the_contract(
    vehicle: Callable[[], Model], effect: Effect, probe: dict, mirror: tuple[str, ...], size: dict
) -> None:
    """Units, derivatives, an absence at zero and the claimed symmetry, on a vehicle of its kind."""
    claimed = {"mirror": mirror, "amplitude_sign": -1 if effect.name in ODD else 1}
    claimed = {} if effect.name in UNCLAIMED else claimed
    check_effect(effect, vehicle(), rng=np.random.default_rng(3), **probe, **size, **claimed)


def test_vocabulary_is_complete() -> None:
    """The diving plane has the identifiers of the hidden-effect records, once each."""
    identifiers = [effect.name for effect in DIVING]
    assert len(identifiers) == len(set(identifiers)) == 40
    parameters = [p.name for effect in DIVING for p in effect.parameters]
    assert len(parameters) == len(set(parameters))
    single = [e for e in DIVING if e.name != "wave_heave_force"]
    assert all(e.amplitude_names == (f"E_{e.name}",) for e in single)
    assert len((vehicles.remus() + DIVING).effects) == 42


@pytest.mark.parametrize(
    ("effect", "complaint"),
    [
        (Force("bare", {"Z": "E*w"}, (Parameter("E", 0.0, "kg/s", scale=1.0),)), "has no source"),
        (
            Force("wrong_unit", {"Z": "E*w"}, (Parameter("E", 0.0, "kg/m", scale=1.0),)),
            "'E\\*w' is in kg/s, expected N",
        ),
        (
            Actuator("present", {"ds": "ds*exp(E) + 0.01"}, (Parameter("E", 0.0, "1", scale=0.1),)),
            "is not absent at zero",
        ),
        (Sensor("inert", {"u": "u + 0*E"}, (Parameter("E", 0.0, "m/s", scale=1.0),)), "no output"),
        (
            Actuator("corner", {"ds": "max(ds, ds + E)"}, (Parameter("E", 0.0, "rad", scale=0.1),)),
            "sensitivity to E at zero",
        ),
        (
            Force("lopsided", {"Z": "E*w**2"}, (Parameter("E", 0.0, "kg/m", scale=9.0),)),
            "symmetric",
        ),
    ],
)
def test_contract_finds_fault(effect: Effect, complaint: str) -> None:
    """Each promise of the contract can be broken, and the message says which."""
    with pytest.raises(AssertionError, match=complaint):
        check_effect(
            effect,
            vehicles.remus(),
            rng=np.random.default_rng(8),
            initial=vehicles.DIVING_START,
            inputs=vehicles.DIVING_INPUTS,
            mirror=vehicles.DIVING_MIRROR,
            n_times=8,
            n_points=1,
        )


STEP = 0.1
FINE = 2000
COMMANDS = np.repeat([0.0, 0.2, -0.15, -0.12, 0.0, 0.01, 0.3, 0.28], 4)


def integrator(*chain: Effect) -> Model:
    """Rate equal to the actual deflection, so that the state sums its means."""
    signals, drive = "x [rad s] <- command [rad]", {"d": "command"}
    return small("integrator", signals, {"x": "d"}, actuators=drive, effects=chain, step=STEP)


def means(*chain: Effect, commands: np.ndarray = COMMANDS) -> np.ndarray:
    """Mean actual deflection of every step, ``(n_commands,)``."""
    model = integrator(*chain)
    inputs = np.append(commands, 0.0)[:, None]
    times = STEP * np.arange(len(inputs))
    run = motion.ran(model, times, inputs, np.zeros(1), compiled=False)
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


def test_a_gain_that_fades_counts_from_the_start_of_the_record() -> None:
    """Thrust of a battery that sags: the same run an hour later is the same run."""
    sag = effects.actuator_fading("sag", ("a", "b"), value=-0.01)
    signals = "x [m] <- a [m/s], b [m/s]"
    model = small("two", signals, {"x": "a + 2*b"}, effects=(sag,), step=0.1)
    times, inputs = np.linspace(0.0, 20.0, 41), np.ones((41, 2))
    for later in (0.0, 3600.0):
        run = simulate_inputs(model, later + times, inputs=inputs, initial={"x": 0.0})
        expected = 3.0 * (times - 0.005 * times**2)
        np.testing.assert_allclose(run.signal("x"), expected, atol=1e-9)


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
    model = small("ramp", "x [m]", {"x": "2"}, effects=chain, step=STEP)
    times = STEP * np.arange(n)
    run = motion.ran(model, times, np.zeros((n, 0)), np.ones(1), compiled=False)
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
    """A shared lag, delay, limit, dead band or play moves each channel as its own effect would."""

    def pair(*effects):
        push = Force("push", {"x": "a", "y": "b"})
        signals, still = "x [m], y [m] <- a [rad], b [rad]", {"x": "0", "y": "0"}
        return small("pair", signals, still, effects=(*effects, push), step=0.1)

    times = 0.1 * np.arange(80)
    inputs = np.column_stack([np.sign(np.sin(2 * times)), 0.4 * np.sign(np.cos(times))])
    for make, value in (
        (effects.actuator_lag, 0.3),
        (effects.actuator_delay, 0.25),
        (effects.rate_limit, 1.5),
        (effects.deadband, 0.1),
        (effects.backlash, 0.1),
    ):
        shared = pair(make("both", ("a", "b"), value=value))
        single = pair(make("one", "a", value=value), make("two", "b", value=value))
        assert len(shared.free_names) == 1
        found = []
        for model in (shared, single):
            found.append(motion.ran(model, times, inputs, np.zeros(2)).outputs)
        np.testing.assert_allclose(found[0], found[1], rtol=1e-13, atol=1e-14)
        assert np.abs(found[0][-1]).max() > 0.05


def evaluate(effect: Effect, key: str, **scope: float) -> float:
    """Value of one term of an effect at its present parameters."""
    values = {p.name: p.value for p in effect.parameters} | scope
    for name, text in effect.definitions.items():
        values[name] = float(expressions.to_numpy(text, values, effect.tables))
    return float(expressions.to_numpy(effect.terms[key], values, effect.tables))


def accelerations(model: Model, own: list[float], command: list[float]) -> np.ndarray:
    """Rates of the model's states by a tiny step."""
    kernel, h = Kernel(model, compiled=False), 1e-6
    z, _ = kernel.start(np.array(own), np.array(command), model.value_vector, 0.0)
    times, inputs = np.array([0.0, h]), np.tile(command, (2, 1))
    run = kernel.run(times, inputs, model.value_vector, z)
    return (run.ends[0] - z)[: kernel.n_own] / h


def test_drag_opposes_motion_and_is_odd() -> None:
    """Quadratic drag with a negative coefficient opposes either direction."""
    drag = effects.quadratic_drag("drag", "Z", "w_r", value=-100.0)
    assert evaluate(drag, "Z", w_r=0.2) == pytest.approx(-4.0)
    assert evaluate(drag, "Z", w_r=-0.2) == pytest.approx(4.0)
    assert drag.parameters[0].unit == "kg/m"


@pytest.mark.parametrize(
    ("effect", "unit"),
    [
        (effects.linear_damping("e", "X", "u_r"), "kg/s"),
        (effects.quadratic_drag("e", "M", "q"), "kg m^2"),
        (effects.crossed_drag("e", "N", "v_r", "r"), "kg m"),
        (effects.induced_drag("e", "w_r"), "kg/m"),
        (effects.deflection_drag("e", "ds"), "kg/m"),
        (effects.cubic_restoring("e"), "N m"),
        (effects.fluid_memory("e", "Z", "w"), "kg/s"),
        (effects.added_mass_error("e", "M", "q"), "kg m^2"),
    ],
)
def test_units_follow_from_names(effect: Effect, unit: str) -> None:
    """The unit of an amplitude is derived, never typed."""
    assert effect.parameters[0].unit == unit


def test_heavy_vehicle_sinks() -> None:
    """More weight than buoyancy accelerates downwards, along earth's vertical."""
    level = vehicles.remus()
    heavy = level + effects.excess_buoyancy(value=2.0)
    still = [0.0, 0.0, 0.0, 0.0, 10.0]
    change = accelerations(heavy, still, [0.0, 0.0]) - accelerations(level, still, [0.0, 0.0])
    assert change[1] > 0
    assert evaluate(effects.excess_buoyancy(value=2.0), "X", theta=np.pi / 2) == pytest.approx(-2.0)


@pytest.mark.parametrize("theta", [0.0, 0.5, -1.2])
def test_buoyancy_lost_with_depth_acts_along_the_vertical(theta: float) -> None:
    """At any pitch a compressed hull is as much too heavy as a ballasted one, in X and in Z."""
    pressed = effects.hull_compressibility(value=0.3, reference=4.0)
    heavy = effects.excess_buoyancy(value=0.3 * (14.0 - 4.0))
    for axis, part in (("X", -np.sin(theta)), ("Z", np.cos(theta))):
        assert evaluate(pressed, axis, theta=theta, z=14.0) == pytest.approx(3.0 * part)
        assert evaluate(heavy, axis, theta=theta) == pytest.approx(3.0 * part)
    sinking = effects.hull_compressibility(value=0.3, reference=4.0, axes=["Z"], angle=None)
    assert evaluate(sinking, "Z", z=14.0) == pytest.approx(3.0)
    with pytest.raises(ModelError, match="no axis 'Y'"):
        effects.hull_compressibility(axes=["Y"])


@pytest.mark.parametrize(("output", "rate"), ["uq", "ur", "vp", "vr", "wp", "wq"])
def test_a_velocity_off_the_origin_has_the_sign_of_the_cross_product(
    output: str, rate: str
) -> None:
    """``E`` is the coordinate of the sensor: v + omega x r."""
    turning = np.array(["p", "q", "r"]) == rate
    across = "uvw".index(output)
    place = np.eye(3)[3 - across - "pqr".index(rate)]
    arm = effects.sensor_lever_arm("arm", output, rate, value=0.7)
    found = evaluate(arm, output, **{output: 1.5, rate: 0.2})
    assert found == pytest.approx(1.5 + np.cross(0.2 * turning, 0.7 * place)[across])


@pytest.mark.parametrize("theta", [0.0, 0.3, -1.0])
def test_drifting_with_the_current_is_rest(theta: float) -> None:
    """A vehicle that moves with the water has no velocity through it."""
    ahead, down = effects.current_forward(value=0.4), effects.current_down(value=0.1)
    u = 0.4 * np.cos(theta) - 0.1 * np.sin(theta)
    w = 0.4 * np.sin(theta) + 0.1 * np.cos(theta)
    for key, over_ground in (("u_r", u), ("w_r", w)):
        once = evaluate(ahead, key, **{key: over_ground}, theta=theta)
        assert evaluate(down, key, **{key: once}, theta=theta) == pytest.approx(0.0, abs=1e-15)


def test_current_in_the_horizontal_plane_is_earth_fixed() -> None:
    """Heading east, a current towards the east comes from astern."""
    current = effects.current_horizontal_plane(north=0.2, east=0.5)
    assert evaluate(current, "u_r", u_r=5.0, psi=np.pi / 2) == pytest.approx(4.5)
    assert evaluate(current, "v_r", v_r=0.0, psi=np.pi / 2) == pytest.approx(0.2)


def test_wind_from_astern_pushes() -> None:
    """Wind that blows where the ship is heading pushes it; from port, to starboard."""
    angles = np.linspace(-np.pi, np.pi, 721)
    tables = {"X": (angles, np.cos(angles)), "Y": (angles, np.sin(angles))}
    wind = effects.wind_load(
        "wind", tables, speed=10.0, direction=0.0, area=500.0, length=100.0, value=1.0
    )
    pressure = 0.5 * 1.225 * 500.0 * 100.0
    assert evaluate(wind, "X", u=0.0, v=0.0, psi=0.0) == pytest.approx(pressure, rel=1e-4)
    starboard = -np.pi / 2  # heading west, a wind towards north comes from port
    assert evaluate(wind, "Y", u=0.0, v=0.0, psi=starboard) == pytest.approx(pressure, rel=1e-4)


@pytest.mark.parametrize(("value", "limit"), [(2.0, 0.5), (8.0, 0.125), (0.0, math.inf)])
def test_an_unknown_limit_cuts_commands_off(value: float, limit: float) -> None:
    """The actual value is the command within the limit and the limit beyond, of either sign."""
    effect = effects.unknown_limit("limit", "d", value=value)
    np.testing.assert_allclose(means(effect), np.clip(COMMANDS, -limit, limit), atol=1e-12)


def test_a_start_beside_the_command_fades() -> None:
    """An actuator that begins elsewhere comes to its command with its time constant."""
    start = effects.actuator_start("start", "d", time_constant=0.4)
    assert start.parameters[0].per_record
    moved = means(start.with_values({"E_start": 0.3})) - COMMANDS
    np.testing.assert_allclose(moved, 0.3 * np.exp(-STEP * np.arange(len(moved)) / 0.4), atol=1e-12)


def hidden(effect: Effect, force: Callable[[float], float]) -> np.ndarray:
    """Velocity of a unit mass that only a hidden state pushes, driven by a force on a command."""
    pushed = {"axes": {"X": "v"}, "inertia": {("X", "v"): "1"}, "effects": (effect,)}
    model = small("mass", "v [m/s] <- d [N]", {}, step=0.01, **pushed)
    times = 0.01 * np.arange(300)
    inputs = np.array([[force(t)] for t in times])
    built = kernel(model)
    z, _ = built.start(np.zeros(1), inputs[0], model.value_vector, 0.0)
    return built.run(times, inputs, model.value_vector, z[None]).outputs[:, 0]


def test_hidden_states_answer_as_their_transfer_functions() -> None:
    """The step answers of first and second order are those of SciPy's integration."""
    lag = effects.hidden_lag("lag", "X", "d", unit="1", time_constant=0.5, value=2.0)
    tank = effects.hidden_oscillator("tank", "X", "d", unit="1", frequency=3.0, value=2.0)
    omega, zeta = (p.value for p in tank.parameters[1:])

    def lagging(t: float, x: np.ndarray) -> list[float]:
        return [2.0 * x[1], (1.0 - x[1]) / 0.5]

    def swinging(t: float, x: np.ndarray) -> list[float]:
        return [2.0 * x[1], x[2], omega**2 * (1.0 - x[1]) - 2.0 * zeta * omega * x[2]]

    times = 0.01 * np.arange(300)
    for effect, rates, n in ((lag, lagging, 2), (tank, swinging, 3)):
        expected = solve_ivp(rates, (0.0, 3.0), np.zeros(n), t_eval=times, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(hidden(effect, lambda t: 1.0), expected.y[0], atol=2e-3)


def test_an_end_stop_pushes_back_beyond_its_place() -> None:
    """Within the stop there is no force; beyond, a spring from there on, of either sign."""
    stop = effects.end_stop("stop", "K", "phi", reach=1.0, scale=5.0, value=5.0)
    (text,) = stop.terms.values()
    angles = np.array([-0.9, -0.5, 0.0, 0.5, 0.9])
    scope = {"phi": angles, "E_stop": 5.0, "stop_stop": 0.6}
    found = expressions.to_numpy(text, scope)
    np.testing.assert_allclose(found, [1.5, 0.0, 0.0, 0.0, -1.5], atol=1e-12)


def test_memory_fades_in_steady_motion() -> None:
    """Fluid memory starts without force and adds none to steady motion."""
    memory = effects.fluid_memory("memory", "Z", "w", value=-15.0)
    assert memory.states[0].initial == "w"
    assert evaluate(memory, "Z", w=0.1, mu_memory=0.1) == 0.0


def test_added_mass_slows_the_response() -> None:
    """Doubling the inertia of sway halves its acceleration."""
    own, command = [7.0, 0.5, 0.0, 0.0, 0.0, 0.0], [0.0, 7e5]
    model = vehicles.ship()
    double = model + effects.added_mass_factor("loading", {("Y", "v"): "m_y"}, scale=1, value=0.9)
    ratio = accelerations(double, own, command)[1] / accelerations(model, own, command)[1]
    assert ratio == pytest.approx(1 / 1.9, rel=1e-6)


def test_hull_derivatives_fill_in_units_and_refuse_added_mass() -> None:
    """Hull terms come from names; accelerations belong to the inertia."""
    hull = effects.hull_derivatives("hull", [Parameter("Z_absww", -100.0)])
    assert hull.parameters[0].unit == "kg/m"
    with pytest.raises(ModelError, match="inertia"):
        effects.hull_derivatives("hull", [Parameter("Z_wdot", -30.0)])


def test_righting_arm_is_interpolated() -> None:
    """A tabulated righting arm is linear between its points."""
    arm = effects.righting_arm_table("gz", [-1.0, 0.0, 1.0], [-0.5, 0.0, 0.5], value=10.0)
    assert evaluate(arm, "K", phi=0.4) == pytest.approx(-2.0)


def test_wave_has_two_amplitudes_and_a_bounded_frequency() -> None:
    """Phase and size are amplitudes; the frequency is a shape within its bounds."""
    wave = effects.wave_force("wave", "Z", frequency=1.0, spread=0.4)
    assert wave.amplitude_names == ("E_wave_cos", "E_wave_sin")
    assert wave.shape_names == ("omega_wave",)
    assert (wave.parameters[2].lower, wave.parameters[2].upper) == pytest.approx((0.6, 1.4))


def states(
    model: Model, torque, end: float = 6.0, phi: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times and states from an angle at rest."""
    times = np.arange(0.0, end, 0.01)
    inputs = torque(times)[:, None]
    return times, motion.ran(model, times, inputs, [phi, 0.0]).states


@pytest.mark.parametrize(
    ("effect", "value", "bounds", "fixed"),
    [
        (effects.coulomb_friction("f", "X", "u", smooth=0.2), 0.2, (-math.inf, math.inf), True),
        (effects.coulomb_friction("f", "X", "u", smooth=0.2, span=4), 0.2, (0.05, 0.8), False),
        (effects.end_stop("stop", "X", "x", reach=2.0), 1.4, (0.6, 2.0), False),
        (effects.wave_force("w", "Z", frequency=2.0, spread=0.5), 2.0, (1.0, 3.0), False),
        (effects.fluid_memory("m", "Z", "w"), 2.0, (0.05, 60.0), True),
    ],
)
def test_parameters_of_a_row_follow_its_arguments(
    effect: Effect, value: float, bounds: tuple[float, float], fixed: bool
) -> None:
    """What a row says of a parameter beside the amplitude are formulas of the arguments."""
    found = effect.parameters[-1]
    assert (found.value, found.lower, found.upper) == pytest.approx((value, *bounds))
    assert found.fixed == fixed


def test_dry_friction_takes_the_same_from_every_swing() -> None:
    """The amplitude of a free swing falls by 2 F/k at each half turn, as Coulomb's law says."""
    friction = effects.coulomb_friction("dry", "K", "p", unit="N m", value=0.1, smooth=0.001)
    _, found = states(pendulum(friction), lambda t: 0 * t, phi=1.0, end=8.0)
    phi, p = found[:, 0], found[:, 1]
    turning = [phi[i] for i in range(2, len(p)) if p[i - 1] * p[i] < 0]
    expected = [-0.9, 0.8, -0.7]
    np.testing.assert_allclose(turning[:3], expected, atol=2e-3)
    _, held = states(pendulum(friction), lambda t: 0.08 * np.minimum(t, 1.0))
    assert np.abs(held[:, 0]).max() < 0.01


def test_dahl_friction_runs_around_a_loop() -> None:
    """Force against displacement encloses the area of friction, as the rule says exactly."""
    effect = effects.dahl_friction(
        "dahl", "K", "p", stiffness=20.0, unit="N m", displacement_unit="rad", value=0.4
    )
    _, found = states(pendulum(effect), lambda t: np.sin(2 * t))
    phi, p, z = found[:, 0], found[:, 1], found[:, 2]
    assert np.abs(z).max() <= 1.0
    # dz/dphi = sigma (1 - sign(p) z): the exponential approach on the first stroke.
    first = int(np.argmax(p[1:] < 0))
    np.testing.assert_allclose(z[:first], 1 - np.exp(-20 * phi[:first]), atol=2e-4)


def test_delayed_force_is_late() -> None:
    """A force of the angle 0.2 s ago equals that of the shifted sine, within 1 per cent."""
    effect = effects.delayed_force(
        "late", "K", "phi", unit="N m/rad", start="phi", delay=0.2, value=0.01
    )
    model = pendulum(effect)
    times, found = states(model, lambda t: np.sin(3 * t), end=12.0)
    low, high, phi = found[:, 2], found[:, 3], found[:, 0]
    second = 12 * (phi - low) - 6 * high
    late = low - high / 2 + second / 12
    expected = np.interp(times - 0.2, times, phi)
    scale = np.abs(phi).max()
    assert np.abs(late - expected)[100:].max() < 0.01 * scale
    assert np.abs(phi - expected)[100:].max() > 0.3 * scale


def test_bouc_wen_against_scipy() -> None:
    """The hysteretic state follows its rule, integrated independently."""
    effect = effects.bouc_wen_hysteresis(
        "h", "K", "p", yielding=0.1, unit="N m", displacement_unit="rad", value=0.6
    )
    times, found = states(pendulum(effect), lambda t: np.sin(2 * t))

    def rates(t: float, x: np.ndarray) -> list[float]:
        v, z = x[1], x[2]
        rate = (v - 0.5 * (abs(v) * abs(z) * z + v * z * z)) / 0.1
        return [v, np.sin(2 * t) - 2 * x[0] - 0.6 * z, rate]

    exact = solve_ivp(rates, (0, times[-1]), np.zeros(3), t_eval=times, rtol=1e-9, atol=1e-11).y.T
    # The command is linear between samples here: 1e-4 of difference.
    np.testing.assert_allclose(found, exact, atol=2e-4)


def test_steady_wind_turns_with_the_heading() -> None:
    """Wind towards north pushes a ship that heads east to port, by more than on its bow."""
    wind = effects.steady_wind()
    assert set(wind.terms) == {"X", "Y", "N"}
    scope = {"E_wind_north": 3.0, "E_wind_east": 0.0, "arm_wind": 2.0, "side_wind": 4.0}
    for heading, expected in ((0.0, [3.0, 0.0, 0.0]), (np.pi / 2, [0.0, -12.0, -24.0])):
        own = scope | {"psi": heading}
        forces = [float(expressions.to_numpy(wind.terms[axis], own)) for axis in ("X", "Y", "N")]
        assert forces == pytest.approx(expected, abs=1e-12)


def test_table_of_two_arguments_from_a_file(tmp_path: Path) -> None:
    """Rows in any order become a grid in SI units."""
    file = tmp_path / "kt.csv"
    rows = ["10,2,5", "0,2,3", "0,1,1", "10,1,2"]
    file.write_text("beta [deg],V [m/s],K [kN]\n" + "\n".join(rows) + "\n")
    x, y, values = effects.table_from_csv(file)
    np.testing.assert_allclose(x, np.radians([0, 10]))
    np.testing.assert_allclose(values, 1000 * np.array([[1, 3], [2, 5]]))
    assert y.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("x [m],y [m],z [m]\n0,0,1\n0,1,2\n1,0,3\n", "0 rows for the point"),
        ("x [m],z\n0,1\n1,2\n", "has no unit"),
        ("x [m],z [m]\n0,1\n1,\n", "row 3"),
        ("x [m],z [m]\n0,1\n0,2\n", "does not increase"),
        ("x [m]\n0\n1\n", "expected two"),
    ],
)
def test_wrong_table_files_are_refused(tmp_path: Path, text: str, complaint: str) -> None:
    """Gaps, missing units and repeated points are named."""
    file = tmp_path / "table.csv"
    file.write_text(text)
    with pytest.raises((DataError, ValueError), match=complaint):
        effects.table_from_csv(file)


@pytest.mark.parametrize("name", sorted(effects.LIBRARY))
def test_every_row_of_the_library_is_complete(name: str) -> None:
    """A row has its stage, source and needs; its constructor is public and has a paragraph."""
    entry = effects.LIBRARY[name]
    assert entry.row.kind.stage in effects.STAGES
    assert entry.row.source.endswith((".", ")"))
    assert entry.row.needs
    assert entry.row.derivative or entry.row.description
    assert getattr(effects, name) is entry.constructor
    assert entry.constructor.__doc__


@pytest.mark.parametrize("name", sorted(effects.LIBRARY))
def test_the_example_of_every_row_makes_its_effect(name: str) -> None:
    """The example acts at the row's stage, and one of its parameters makes it absent at zero."""
    row = effects.LIBRARY[name].row
    assert row.example.startswith(f"{name}(")
    effect = eval(row.example, vars(effects))
    assert type(effect) is row.kind
    for size in effect.amplitude_names:
        assert size in {one.name for one in effect.parameters}
        assert any(
            size in text for text in (*effect.terms.values(), *effect.definitions.values(),
                                      *(part.update for part in effect.memory))
        )  # fmt: skip


def test_a_row_repeats_its_texts_for_signals_alike() -> None:
    """Several signals share the parameter; each has a memory of its own name."""
    lag = effects.actuator_lag("lag", ("port", "starboard"))
    assert [p.name for p in lag.parameters] == ["E_lag"]
    assert [m.name for m in lag.memory] == ["actual_port", "actual_starboard"]
    assert effects.actuator_lag("lag", "port").memory[0].name == "actual"


@pytest.mark.parametrize(
    ("text", "grows"),
    [("-E*abs(q)", "the size of pitch rate"), ("-E*q*abs(q)", "the square of pitch rate")],
)
def test_a_force_by_the_size_of_a_signal_is_said_so(text: str, grows: str) -> None:
    """It does not change its sign with the signal, which a reader has to know."""
    model = load_problem("remus_diving_plane").model
    one = Force("one", {"M": text}, (Parameter("E", 0.0, "N m"),))
    assert f"pitch moment that grows with {grows}, M = " in f"{in_words(one, model)}, M = "


@pytest.mark.parametrize("name", ["remus_diving_plane", "roll_decay", "catamaran"])
def test_what_an_effect_is_said_to_grow_with_is_what_it_grows_with(name: str) -> None:
    """Of a force told as a product, twice a signal is two to its power times the force."""
    problem = load_problem(name)
    labels = _labels(problem.model)
    told = 0
    for effect in problem.effects:
        if (factors := _factors(effect, labels)) is None:
            continue
        (text,) = effect.terms.values()
        powers: dict[str, int] = {}
        for signal, power in factors.items():
            powers[signal.strip("|")] = powers.get(signal.strip("|"), 0) + power
        scope = {one: 0.7 + 0.1 * place for place, one in enumerate(sorted(effect.uses()))}
        force = float(expressions.to_numpy(text, scope))
        for signal in scope.keys() & labels.keys():
            twice = float(expressions.to_numpy(text, scope | {signal: 2.0 * scope[signal]}))
            assert twice / force == pytest.approx(2.0 ** powers.get(signal, 0))
        assert all(labels[signal] in in_words(effect, problem.model) for signal in powers) or (
            effect.description not in {one.description for one in effect.parameters}
        )
        told += 1
    assert told > 2
