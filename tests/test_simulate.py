"""Simulation: experiments, their records, steady states, linear models."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from motion import small
from scipy.integrate import solve_ivp
from simple_models import AUV, NOMOTO, PENDULUM, K, T

from benchmarks import truth
from oed_sysid import Experiment, Input, Limits, Model, Output, State, simulate, simulate_inputs
from oed_sysid.errors import DesignError, SimulationError
from oed_sysid.experiments import manoeuvres as m
from oed_sysid.experiments.simulation import equilibrium, linearise, simulate_batch

DIVE = Experiment(
    "dive",
    m.ZigZagLike("fin", 0.2, 0.15, rate=0.3),
    duration=100.0,
    sample_time=0.1,
    constants={"thrust": 9.0},
    initial={"u": 1.5, "z": 10.0},
)


def test_step_response_of_first_order_nomoto() -> None:
    """Yaw rate and heading after a rudder step follow the closed form (Nomoto 1957)."""
    times = np.linspace(0.0, 60.0, 121)
    run = simulate_inputs(NOMOTO, times, inputs={"rudder": 0.2})
    rate = K * 0.2 * (1 - np.exp(-times / T))
    np.testing.assert_allclose(run.signal("r"), rate, atol=1e-10)
    heading = K * 0.2 * (times - T * (1 - np.exp(-times / T)))
    np.testing.assert_allclose(run.signal("psi"), heading, atol=1e-9)


def test_pendulum_keeps_its_energy() -> None:
    """A pendulum without friction loses less than 1e-7 of its energy in 50 swings."""
    run = simulate_inputs(PENDULUM, np.linspace(0.0, 200.0, 2001), inputs={}, initial=[2.0, 0.0])
    energy = run.signal("rate") ** 2 / 2 - 4 * np.cos(run.signal("angle"))
    assert np.ptp(energy) < 1e-7 * 4


def moving(t: float, x: np.ndarray, fin: float, slope: float) -> tuple[float, ...]:
    """Rates of the diving plane, without the package."""
    return truth.rates(x, (fin + slope * t, 9.0), truth.TRUE, np.sin, np.cos)


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_memory_moves_as_in_a_simulation_with_error_control(interpolation: str) -> None:
    """Lags of the fin and of the depth's sensor, for held and for linear commands."""
    times, step, start = np.linspace(0.0, 12.0, 61), 0.05, np.array([1.5, 0.0, 0.0, 0.0, 10.0])
    commands = 0.2 * np.sin(times)
    inputs = tuple(replace(channel, interpolation=interpolation) for channel in AUV.inputs)
    run = simulate_inputs(
        replace(AUV, inputs=inputs, step=step), times,
        inputs={"fin": commands, "thrust": 9.0}, initial=start,
    )  # fmt: skip
    state, fin, depth, expected = start, commands[0], start[4], [start[2:]]
    fades, slow = np.exp(-step / 0.3), np.exp(-step / 0.5)
    share = 0.3 / step * (1 - fades)
    for command, change in zip(commands, np.diff(commands), strict=False):
        slope = (interpolation == "linear") * change / 0.2
        for begin in command + slope * step * np.arange(4):
            acts = begin + (fin - begin) * share, slope * (1 - share)
            order = begin + slope * step / 2
            fin = order + (fin - order) * fades
            path = solve_ivp(moving, (0.0, step), state, args=acts, rtol=1e-9, atol=1e-11)
            before, state = state[4], path.y[:, -1]
            # Within a step the depth is linear, and the sensor follows it with a lag.
            behind = 0.5 * (state[4] - before) / step
            depth = state[4] - behind + (depth - before + behind) * slow
        expected.append(np.array([state[2], state[3], depth]))
    np.testing.assert_allclose(run.outputs, expected, atol=3e-6)


def test_zigzag_reverses_on_what_is_measured() -> None:
    """Without noise each reversal is at the first sample at or beyond the switch."""
    test = Experiment("zz", m.ZigZag("rudder", 0.2, 0.2), duration=120.0, sample_time=0.5)
    record = simulate(NOMOTO, test, noise=False)
    rudder, psi = record.input("rudder"), record.output("psi")
    changes = np.flatnonzero(np.diff(rudder)) + 1
    assert len(changes) >= 3
    for side, k in zip([1, -1] * 5, changes, strict=False):
        assert side * psi[k] >= 0.2 > side * psi[k - 1]
    assert record.channels == NOMOTO.channels


def test_closed_loop_record_is_reproduced_by_its_own_inputs() -> None:
    """Replaying the logged commands gives the logged outputs, with lags and rate limits too."""
    record = simulate(AUV, DIVE, noise=False)
    run = simulate_inputs(AUV, record.times, inputs=record.inputs, initial=DIVE.initial)
    np.testing.assert_array_equal(run.outputs, record.outputs)
    assert np.abs(np.diff(record.input("fin"))).max() <= 0.3 * 0.1 * (1 + 1e-9)
    assert (np.abs(np.diff(np.sign(record.input("fin")))) > 0).sum() >= 5


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("feedback", ["true", "measured"])
def test_looking_ahead_changes_no_bit(interpolation: str, feedback: str, monkeypatch) -> None:
    """Closed loops go many samples at once; the record is that of one sample at a time."""
    changed = tuple(replace(one, interpolation=interpolation) for one in AUV.inputs)
    model, test = replace(AUV, inputs=changed), replace(DIVE, feedback=feedback)
    ahead = simulate(model, test, noise=False)
    # Where nothing counts as going on as it did, one sample is simulated at a time.
    monkeypatch.setattr("oed_sysid.experiments.simulation.ROUNDING", -1.0)
    stepwise = simulate(model, test, noise=False)
    assert len(np.unique(ahead.inputs)) > 10
    np.testing.assert_array_equal(ahead.inputs, stepwise.inputs)
    np.testing.assert_array_equal(ahead.outputs, stepwise.outputs)


def test_linear_inputs_in_closed_loop() -> None:
    """A linearly interpolated rudder is decided causally and replays exactly."""
    rudder = Input("rudder", "rad", interpolation="linear")
    model = replace(NOMOTO, inputs=(rudder,))
    zigzag = m.ZigZag("rudder", 0.2, 0.2, rate=0.1)
    record = simulate(model, Experiment("zz", zigzag, duration=90.0, sample_time=0.5), noise=False)
    run = simulate_inputs(model, record.times, inputs=record.inputs)
    np.testing.assert_array_equal(run.outputs, record.outputs)
    assert np.ptp(record.input("rudder")) == pytest.approx(0.4)


def test_feedback_on_true_signals_ignores_noise() -> None:
    """With feedback='true' noise does not move the reversals; with 'measured' it does."""
    noisy = {"psi": 0.05, "r": 1e-3}
    settings = {"duration": 120.0, "sample_time": 0.5, "noise": noisy}
    clean = simulate(NOMOTO, Experiment("a", m.ZigZag("rudder", 0.2, 0.2), **settings), noise=False)
    results = {
        feedback: simulate(
            NOMOTO,
            Experiment("a", m.ZigZag("rudder", 0.2, 0.2), feedback=feedback, **settings),
            rng=np.random.default_rng(5),
        )
        for feedback in ("true", "measured")
    }
    np.testing.assert_array_equal(results["true"].inputs, clean.inputs)
    assert (results["measured"].inputs != clean.inputs).any()


def test_noise_has_the_stated_standard_deviation() -> None:
    """Over 4000 samples the noise is as large as stated, within 4 standard errors."""
    test = Experiment("a", m.Constant("rudder", 0.0), duration=400.0, noise={"r": 0.02})
    record = simulate(NOMOTO, test, rng=np.random.default_rng(3))
    tolerance = 4 / np.sqrt(2 * record.n_samples)
    assert record.output("psi").std() == pytest.approx(0.003, rel=tolerance)
    assert record.output("r").std() == pytest.approx(0.02, rel=tolerance)
    again = simulate(NOMOTO, test, rng=np.random.default_rng(3))
    np.testing.assert_array_equal(again.outputs, record.outputs)


def test_noise_needs_a_generator_and_a_size() -> None:
    """Neither is guessed."""
    test = Experiment("a", m.Constant("rudder", 0.0), duration=5.0)
    with pytest.raises(SimulationError, match="default_rng"):
        simulate(NOMOTO, test)
    unknown = replace(NOMOTO, outputs=(Output("psi", "rad"),))
    with pytest.raises(SimulationError, match="noise of psi is not known"):
        simulate(unknown, test, rng=np.random.default_rng(1))
    assert simulate(unknown, test, noise=False, name="b").name == "b"


def test_closed_loop_commands_respect_limits() -> None:
    """A zigzag larger than its limit is refused by name."""
    limits = Limits(inputs={"rudder": (-0.1, 0.1)})
    test = Experiment("zz", m.ZigZag("rudder", 0.2, 0.2), duration=20.0, limits=limits)
    with pytest.raises(DesignError, match="input 'rudder' reaches"):
        simulate(NOMOTO, test, noise=False)


def test_divergence_names_state_and_time_and_step() -> None:
    """A step that is too long is recognised, and a finite escape is not blamed on it."""
    stiff = replace(NOMOTO.with_values({"T": 0.1}), step=1.0)
    with pytest.raises(SimulationError, match=r"'Nomoto' diverged .* r = .*step=0.1"):
        simulate_inputs(stiff, np.arange(800.0), inputs={"rudder": 0.1})
    escape = Model("escape", (State("x", "m"),), (), (Output("x", "m"),), {"x": "x*x"})
    with pytest.raises(SimulationError, match=r"x = .*Check signs"):
        simulate_inputs(escape, np.arange(0, 5.0, 0.1), inputs={}, initial={"x": 1.0})
    run = simulate_inputs(
        escape, np.arange(0, 5.0, 0.1), inputs={}, initial={"x": 1.0}, throw=False
    )
    assert not run.ok
    assert np.isnan(run.outputs[run.failed_at :]).all()
    assert np.isfinite(run.states[: run.failed_at]).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"inputs": np.zeros((4, 1))}, r"expected time first, \(5, 1\)"),
        ({"inputs": {"fin": 0.0}}, "has the inputs rudder"),
        ({"inputs": {"rudder": [0, 0, np.nan, 0, 0]}}, "'rudder' is nan at sample 2"),
        ({"inputs": {"rudder": 0.0}, "initial": {"v": 1.0}}, "'v'"),
        ({"inputs": {"rudder": 0.0}, "initial": [0.0]}, "2 finite numbers: psi, r"),
    ],
)
def test_inputs_and_start_are_checked(settings: dict, message: str) -> None:
    """Shapes and names are compared with the model before anything runs."""
    with pytest.raises(SimulationError, match=message):
        simulate_inputs(NOMOTO, np.arange(5.0), **settings)


def test_signals_by_name() -> None:
    """True state and lagging measurement of the same name are told apart."""
    run = simulate_inputs(
        AUV,
        np.arange(0, 20, 0.1),
        inputs={"fin": 0.1, "thrust": 9.0},
        initial={"u": 1.5, "z": 10.0},
    )
    assert np.abs(run.signal("z") - run.output("z")).max() > 0.01
    np.testing.assert_array_equal(run.signal("fin"), 0.1)
    assert set(run.signals) == {"u", "w", "q", "theta", "z", "fin", "thrust"}
    with pytest.raises(SimulationError, match="no signal 'phi'"):
        run.signal("phi")


@pytest.mark.parametrize("n_workers", [1, 2])
def test_batch_equals_loop(n_workers: int) -> None:
    """Every member is what a single simulation gives, whatever the number of threads."""
    rng = np.random.default_rng(2)
    times = np.arange(0, 30, 0.2)
    models = [AUV.with_values({"X_absuu": drag}) for drag in (-3.9, -4.5, -2.0, -3.0, -8.0)]
    values = np.array([model.value_vector for model in models])
    inputs = rng.normal(size=(5, len(times), 2)) * [0.1, 1.0] + [0.0, 9.0]
    starts = np.column_stack([rng.uniform(1, 2, 5), np.zeros((5, 3)), rng.uniform(5, 15, 5)])
    together = simulate_batch(
        AUV, times, inputs=inputs, values=values, initials=starts, n_workers=n_workers
    )
    for member, model in enumerate(models):
        alone = simulate_inputs(model, times, inputs=inputs[member], initial=starts[member])
        np.testing.assert_array_equal(together[member], alone.outputs)


def runaway(initial: float = 1.0, rate: float = 3.0) -> tuple[Model, Experiment]:
    """A model that grows without bound, but stays a number in 40 s."""
    model = small("runaway", "w [m/s] <- fin [rad]", {"w": f"{rate}*w + fin"}, noise=0.1)
    return model, Experiment(
        "hold", m.Constant("fin", 0.1), duration=40.0, sample_time=0.1, initial={"w": initial}
    )


def test_state_that_runs_away_is_no_simulation() -> None:
    """A state of 1e49 m/s is a number, but divergence is said, with the state and the time."""
    model, experiment = runaway()
    with pytest.raises(
        SimulationError, match=r"'runaway' diverged .* 9\.1 and 9\.2 s; the latter has w = 1e\+12"
    ):
        simulate(model, experiment, rng=np.random.default_rng(0))
    times = np.linspace(0.0, 40.0, 401)
    with pytest.raises(SimulationError, match="Check signs of damping"):
        simulate_inputs(model, times, inputs={"fin": 0.1}, initial={"w": 1.0})
    run = simulate_inputs(model, times, inputs={"fin": 0.1}, initial={"w": 1.0}, throw=False)
    assert run.ok
    assert run.signal("w")[-1] > 1e49
    with pytest.raises(SimulationError, match="starts with w = 1e\\+13, which no vehicle has"):
        simulate_inputs(model, times, inputs={"fin": 0.1}, initial={"w": 1e13})


def test_large_numbers_are_no_divergence() -> None:
    """A northing of 5e6 m and times since 1970 are far from the bound."""
    model, experiment = runaway(initial=1.8e9, rate=0.0)
    assert simulate(model, experiment, noise=False).output("w")[-1] > 1.8e9


def test_batch_marks_divergence_and_checks_shapes() -> None:
    """A member that diverges is NaN from there; the others are not touched."""
    values = [[K, T], [K, 1e-1]]
    stiff = replace(NOMOTO, step=1.0)
    y = simulate_batch(stiff, np.arange(800.0), inputs={"rudder": 0.1}, values=values)
    assert np.isfinite(y[0]).all()
    assert np.isnan(y[1, -1]).all()
    with pytest.raises(SimulationError, match="K, T"):
        simulate_batch(NOMOTO, np.arange(5.0), inputs={"rudder": 0.1}, values=[[1.0]])
    with pytest.raises(SimulationError, match="3 sets of inputs"):
        simulate_batch(NOMOTO, np.arange(5.0), inputs=np.zeros((3, 5, 1)), values=values)
    with pytest.raises(SimulationError, match="3 start states"):
        simulate_batch(
            NOMOTO,
            np.arange(5.0),
            inputs={"rudder": 0.1},
            values=values,
            initials=np.zeros((3, 2)),
        )


def test_open_loop_experiments_need_no_feedback() -> None:
    """Doublet, circle and a rate-limited command run in one go."""
    manoeuvres = (
        m.Doublet("rudder", 0.1, pulse_time=5.0),
        m.TurningCircle("rudder", 0.3, rate=0.05),
        m.RateLimited(m.TurningCircle("rudder", 0.3), 0.05),
    )
    for manoeuvre in manoeuvres:
        record = simulate(NOMOTO, Experiment("a", manoeuvre, duration=30.0), noise=False)
        np.testing.assert_allclose(record.input("rudder"), manoeuvre.commands(record.times))


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
    """Level flight at 1.5 m/s needs thrust -X_absuu u^2; where the limit forbids it, it says so."""
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


SHIP = small(
    "ship",
    "psi [rad], r [rad/s], u [m/s] <- rudder [rad], thrust [N]",
    {"psi": "r", "r": "(0.1*rudder - r)/10", "u": "(thrust - u*abs(u))/100"},
    noise={"psi": 0.01},
)


def test_times_cover_the_duration() -> None:
    """The last sample is at the duration, also where the quotient is not exact in binary."""
    experiment = Experiment("a", m.Constant("rudder", 0.1), duration=0.3, sample_time=0.1)
    assert len(experiment.times) == 4
    assert experiment.times[-1] == pytest.approx(0.3)


def test_duration_comes_from_the_manoeuvre() -> None:
    """A doublet knows how long it takes; a zigzag does not, and the message says what to do."""
    doublet = Experiment("a", m.Doublet("rudder", 0.1, pulse_time=4.0))
    assert doublet.duration == pytest.approx(m.Doublet("rudder", 0.1, pulse_time=4.0).duration)
    with pytest.raises(DesignError, match="no natural end"):
        Experiment("b", m.ZigZag("rudder", 0.2, 0.2))


def test_several_manoeuvres_and_constants_become_columns() -> None:
    """Commands stand in the order of the model's inputs, whoever gives them."""
    both = Experiment(
        "both",
        [m.Constant("thrust", 5.0), m.Piecewise("rudder", [0.0, 1.0], [0.0, 0.2])],
        duration=2.0,
        sample_time=1.0,
    )
    np.testing.assert_allclose(
        both.commands(SHIP.input_names), [[0.0, 5.0], [0.2, 5.0], [0.2, 5.0]]
    )
    held = Experiment("held", duration=2.0, sample_time=1.0, constants={"rudder": 0.1, "thrust": 2})
    np.testing.assert_allclose(held.commands(("thrust", "rudder")), [[2.0, 0.1]] * 3)


def test_an_input_without_value_is_an_error() -> None:
    """No input is silently zero."""
    experiment = Experiment("a", m.Constant("rudder", 0.1), duration=3.0)
    with pytest.raises(DesignError, match=r"constants=\{'thrust': value\}"):
        experiment.commands(SHIP.input_names)
    with pytest.raises(DesignError, match="thrust"):
        experiment.check_model(SHIP)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"duration": 5.0, "sample_time": 0.0}, "sample_time"),
        ({"duration": 5.0, "feedback": "guessed"}, "measured, true"),
        ({"duration": 5.0, "constants": {"rudder": 0.0}}, "Remove one"),
        ({"duration": 5.0, "initial": {"r": math.nan}}, "'r' = nan"),
    ],
)
def test_settings_are_checked(settings: dict, message: str) -> None:
    """A setting that cannot be meant is named."""
    with pytest.raises(DesignError, match=message):
        Experiment("a", m.TurningCircle("rudder", 0.2), **settings)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"initial": {"w": 1.0}}, "no state 'w'"),
        ({"noise": {"u": 1.0}}, "no output 'u'"),
        ({"constants": {"thrust": 1.0, "sail": 1.0}}, "no input 'sail'"),
        ({"limits": Limits(signals={"depth": (0, 5)})}, "no signal 'depth'"),
        ({"limits": Limits(rates={"fin": 1.0})}, "no input 'fin'"),
    ],
)
def test_misfit_with_a_model_is_named(settings: dict, message: str) -> None:
    """Names that the model does not have are found before anything runs."""
    complete = {"duration": 5.0, "constants": {"thrust": 1.0}} | settings
    with pytest.raises(DesignError, match=message):
        Experiment("a", m.TurningCircle("rudder", 0.2), **complete).check_model(SHIP)


def test_feedback_has_to_be_measurable() -> None:
    """A zigzag on a signal that is neither output nor state is refused."""
    zigzag = m.ZigZag("rudder", 0.2, 0.2, feedback=("heading",))
    experiment = Experiment("a", zigzag, duration=5.0, constants={"thrust": 1.0})
    with pytest.raises(DesignError, match="no output or state 'heading'"):
        experiment.check_model(SHIP)
    with pytest.raises(DesignError, match="not known in advance"):
        experiment.commands(SHIP.input_names)


def test_commands_beyond_a_limit_are_refused_with_its_name() -> None:
    """Amplitude, rate, constant and start are each compared with their limit."""
    limits = Limits(inputs={"rudder": (-0.3, 0.3)}, rates={"rudder": 0.1}, signals={"u": (0, 5)})
    with pytest.raises(DesignError, match=r"input 'rudder' reaches 0.4 .* above its limit of 0.3"):
        Experiment("a", m.TurningCircle("rudder", 0.4, rate=0.05), duration=30.0, limits=limits)
    with pytest.raises(DesignError, match="rate of 'rudder'"):
        Experiment("a", m.TurningCircle("rudder", 0.2, start=1.0), duration=30.0, limits=limits)
    with pytest.raises(DesignError, match=r"input 'rudder' reaches -0\.5"):
        Experiment("a", duration=3.0, constants={"rudder": -0.5}, limits=limits)
    with pytest.raises(DesignError, match="signal 'u' reaches 6"):
        Experiment("a", duration=3.0, initial={"u": 6.0}, limits=limits)
    slow = m.RateLimited(m.TurningCircle("rudder", 0.3), 0.1)
    assert Experiment("a", slow, duration=30.0, limits=limits).limits is limits


def test_violations_pass_over_missing_samples() -> None:
    """NaN is no violation, and the worst sample is the one that is reported."""
    limits = Limits(signals={"z": (2.0, 20.0)})
    times = np.arange(4.0)
    assert limits.violations(times, {"z": np.array([np.nan, 5.0, 20.0, 2.0])}) == ()
    (text,) = limits.violations(times, {"z": np.array([np.nan, 1.5, 0.5, 3.0])})
    assert "0.5 at t = 2 s, below its limit of 2" in text


def test_stored_experiment_is_the_same() -> None:
    """Through JSON and back nothing is lost."""
    experiment = Experiment(
        "a",
        [m.ZigZag("rudder", 0.2, 0.1, rate=0.05), m.Constant("thrust", 3.0)],
        duration=60.0,
        sample_time=0.5,
        initial={"u": 2.0},
        noise={"psi": 0.02},
        limits=Limits(inputs={"rudder": (-0.3, 0.3)}, signals={"u": (0.0, math.inf)}),
    )
    stored = json.loads(json.dumps(experiment.to_dict()))
    assert Experiment.from_dict(stored) == experiment
    with pytest.raises(DesignError, match="cannot be read"):
        Experiment.from_dict(stored | {"colour": "red"})
