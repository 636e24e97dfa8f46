"""Controllers as files: replayed against a simulator that shares no code with the package."""

from __future__ import annotations

import math
import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from simple_models import nomoto

from benchmarks.truth import NAMES, TRUE, rates, runge_kutta
from oed_sysid import Experiment, Limits, Model, Parameter, Piecewise, ZigZag, load_problem
from oed_sysid.design import AbortRule, Servo, assess_limits, played, write_controller
from oed_sysid.errors import DesignError
from oed_sysid.experiments.manoeuvres import ReverseSpiral, TurningCircle, ZigZagLike
from oed_sysid.experiments.simulation import simulate

K, T = 0.25, 6.0
SERVO = {"rudder": Servo(2, -0.6, 0.6, 1000, 2000)}
RUNS = {
    "zigzag": ZigZag("rudder", 0.3, 0.25, rate=0.1, start=3.0),
    "ahead": ZigZag(
        "rudder", 0.35, 0.3, feedback=("psi", "r", "psi"), lead=2.0, keep_gain=0.4, trim=0.02
    ),
    "swings": ZigZagLike("rudder", (0.3, 0.2), (0.2, 0.3), feedback=("psi",), sign=1, rate=0.2),
    "circle": TurningCircle("rudder", 0.25, start=5.0),
}


def ship() -> Model:
    """Nomoto's ship."""
    return nomoto(K, T, noise=(0.001, 0.001), step=0.05)


def experiment(name: str, **change: Any) -> Experiment:
    """A run of a minute and a half."""
    given: dict[str, Any] = {"duration": 90.0, "sample_time": 0.5, "feedback": "true"} | change
    return Experiment(name, **({"manoeuvre": RUNS[name]} | given))


def sail(
    step: Callable[[float, float, float], tuple[float, str | None]], gain: float = K
) -> tuple[np.ndarray, str | None]:
    """Commands of a controller on a ship integrated by Euler's method in short steps."""
    psi = r = 0.0
    commands = []
    for k in range(181):
        command, why = step(0.5 * k, psi, r)
        if why is not None:
            return np.array(commands), why
        commands.append(command)
        for _ in range(500):
            psi, r = psi + 1e-3 * r, r + 1e-3 * (gain * command - r) / T
    return np.array(commands), None


def by_law(path: Path) -> Callable[[float, float, float], tuple[float, str | None]]:
    """The law of a Python file, fed as its own reader would."""
    run = runpy.run_path(str(path))["Run"]()

    def step(time: float, psi: float, r: float) -> tuple[float, str | None]:
        orders, why = run.step(time, {"psi": psi, "r": r})
        return orders["rudder"], why

    return step


def by_lua(path: Path) -> Callable[[float, float, float], tuple[float, str | None]]:
    """The script in Lua's own interpreter, with an autopilot of a few lines around it."""
    lua = pytest.importorskip("lupa").LuaRuntime()
    now: dict[str, float] = {"t": 0.0, "psi": 0.0, "r": 0.0, "pulse": 1500.0}
    said: list[str] = []
    vector = lua.eval(
        "function(x, y, z) return {x = function() return x end, y = function() return y end, "
        "z = function() return z end} end"
    )
    names = lua.globals()
    wrapped = lambda angle: math.remainder(angle, 2 * math.pi)  # noqa: E731
    names.now, names.vector = now, vector
    names.ahrs = lua.table_from(
        {
            "get_roll": lambda _: 0.0,
            "get_pitch": lambda _: 0.0,
            "get_yaw": lambda _: wrapped(now["psi"]),
            "get_gyro": lambda _: vector(0.0, 0.0, now["r"]),
            "get_relative_position_NED_origin": lambda _: None,
            "get_velocity_NED": lambda _: None,
        }
    )
    names.millis = lambda: lua.table_from({"tofloat": lambda _: 1000.0 * now["t"]})
    names.rc = lua.table_from({"get_aux_cached": lambda _, __: 2})
    names.gcs = lua.table_from({"send_text": lambda _, __, text: said.append(text)})

    def pulse(_: Any, channel: int, width: int, __: int) -> None:
        assert channel == 1
        now["pulse"] = width

    names.SRV_Channels = lua.table_from({"set_output_pwm_chan_timeout": pulse})
    script = path.read_text()
    update: list[Any] = []

    def step(time: float, psi: float, r: float) -> tuple[float, str | None]:
        now.update(t=time, psi=psi, r=r)
        if not update:
            update.append(lua.execute(script)[0])
        else:
            update[0]()
        ended = [text for text in said if not text.endswith("is ready")]
        return -0.6 + 1.2 * (now["pulse"] - 1000) / 1000, ended[0] if ended else None

    return step


@pytest.mark.parametrize("name", RUNS)
@pytest.mark.parametrize("kind", ["ros2", "moos", "ardupilot"])
def test_the_file_flies_the_run(name: str, kind: str, tmp_path: Path) -> None:
    """On another simulator the file commands what the manoeuvre commands there."""
    path = write_controller(tmp_path / "run", ship(), experiment(name), kind, servos=SERVO)
    control = RUNS[name].controllers()["rudder"]
    expected, _ = sail(lambda t, psi, r: (control.command(t, {"psi": psi, "r": r}), None))
    if kind == "ardupilot":
        # On the same motion: pulses of whole microseconds would change it, and so the reversals.
        motion: list[tuple[float, float, float]] = []
        control = RUNS[name].controllers()["rudder"]

        def steered(t: float, psi: float, r: float) -> tuple[float, None]:
            motion.append((t, psi, r))
            return control.command(t, {"psi": psi, "r": r}), None

        sail(steered)
        script = by_lua(path)
        assert [script(*one)[0] for one in motion] == pytest.approx(expected, abs=6.1e-4)
    else:
        found, why = sail(by_law(path))
        assert why is None
        assert found == pytest.approx(expected, abs=1e-12)
    assert len(set(np.sign(expected))) > 1


@pytest.mark.parametrize("kind", ["ros2", "ardupilot"])
def test_a_rule_breaks_the_run_off(kind: str, tmp_path: Path) -> None:
    """Beyond a rule the trim command follows, and the reason is said."""
    rule = AbortRule("r", -0.02, 0.02, 0.0, True)
    run = experiment("zigzag")
    path = write_controller(tmp_path / "run", ship(), run, kind, aborts=[rule], servos=SERVO)
    found, why = sail((by_lua if kind == "ardupilot" else by_law)(path))
    assert why is not None
    assert "ABORT: r" in why
    assert 6 < len(found) < 40


def test_limits_are_rules_by_default(tmp_path: Path) -> None:
    """Limits on the motion break a run off where nothing else is given."""
    run = experiment("zigzag", limits=Limits(signals={"psi": (-0.1, math.inf)}))
    path = write_controller(tmp_path / "run.py", ship(), run, "ros2")
    _, why = sail(by_law(path))
    assert why is not None
    assert "psi" in why


def test_odometry_is_read_in_the_axes_of_a_vehicle(tmp_path: Path) -> None:
    """East-north-up becomes north-east-down; a heading goes on past half a turn."""
    names = runpy.run_path(
        str(write_controller(tmp_path / "r.py", ship(), experiment("zigzag"), "ros2"))
    )
    heading = math.radians(100.0)
    yaw = math.pi / 2 - heading
    turn = SimpleNamespace(w=math.cos(yaw / 2), x=0.0, y=0.0, z=math.sin(yaw / 2))
    place, speed = (
        SimpleNamespace(x=a, y=b, z=c) for a, b, c in ((3.0, 5.0, -2.0), (1.0, 0.2, 0.1))
    )
    rates = SimpleNamespace(x=0.01, y=0.02, z=0.03)
    message = SimpleNamespace(
        pose=SimpleNamespace(pose=SimpleNamespace(position=place, orientation=turn)),
        twist=SimpleNamespace(twist=SimpleNamespace(linear=speed, angular=rates)),
    )
    seen = names["signals_of"](message, heading + 2 * math.pi)
    assert (seen["x"], seen["y"], seen["z"]) == (5.0, 3.0, 2.0)
    assert (seen["v"], seen["w"], seen["q"], seen["r"]) == (-0.2, -0.1, -0.02, -0.03)
    assert seen["psi"] == pytest.approx(heading + 2 * math.pi)
    assert seen["theta"] == pytest.approx(0.0)


def test_the_table_is_another_run() -> None:
    """Played open loop, vehicles with another trim turn away; the closed loop holds them."""
    trim = Parameter("d", 0.02, "rad")
    ship_ = ship()
    rate = "(K*(rudder + d) - r)/T"
    parameters = (*ship_.parameters, trim)
    askew = replace(ship_, kinematics={"psi": "r", "r": rate}, parameters=parameters)
    run = experiment("zigzag", duration=600.0, limits=Limits(signals={"psi": (-0.8, 0.8)}))
    table = played(askew, run)
    assert not table.reacts
    here = simulate(askew, run, noise=False).inputs
    assert table.commands(["rudder"]) == pytest.approx(here)
    closed, open_ = (
        assess_limits(askew, one, rng=np.random.default_rng(0), spread=0.3, vehicles=60)
        for one in (run, table)
    )
    assert closed.probability > 0.9
    assert open_.probability < 0.7


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"kind": "plc"}, "no controller 'plc'"),
        ({"servos": {}}, "servo for rudder"),
        ({"servos": {"rudder": Servo(1, -0.1, 0.1)}}, "reach from"),
        ({"aborts": [AbortRule("sway", -1, 1, 0.0, True)]}, "sway"),
    ],
)
def test_what_cannot_be_flown_is_said(change: dict[str, Any], match: str, tmp_path: Path) -> None:
    """Messages name what is missing."""
    given: dict[str, Any] = {"kind": "ardupilot", "servos": SERVO} | change
    with pytest.raises(DesignError, match=match):
        write_controller(tmp_path / "run", ship(), experiment("zigzag"), given.pop("kind"), **given)


def test_a_loop_that_no_zigzag_is_is_refused(tmp_path: Path) -> None:
    """A reverse spiral steers on other rules."""
    spiral = ReverseSpiral("rudder", (0.02, -0.02), hold=40.0, gain=5.0, reset_time=10.0, limit=0.3)
    run = replace(experiment("zigzag"), manoeuvre=spiral, duration=80.0)
    with pytest.raises(DesignError, match="reacts as no zigzag"):
        write_controller(tmp_path / "run", ship(), run, "ros2")


def test_a_mission_is_flown_as_planned(tmp_path: Path) -> None:
    """Pymavlink reads the mission; played on a simulator of its own it is the planned motion."""
    mavwp = pytest.importorskip("pymavlink.mavwp")
    auv = load_problem("remus_diving_plane")
    pattern = auv.experiment("zigzag_10_10")
    fins = Piecewise("fin_command", (0.0, 0.5, 8.5, 12.25, 20.0), (0.0, 0.1, -0.12, 0.05, 0.0))
    start = {"u": 1.5, "z": 10.0}
    run = Experiment("steps", fins, duration=30.0, sample_time=0.05, initial=start,
                     constants=pattern.constants)  # fmt: skip
    servos = {"fin_command": Servo(2, -0.35, 0.35, 900, 2100), "thrust": Servo(3, 0.0, 14.0)}
    path = write_controller(tmp_path / "m.waypoints", auv.model, run, "mission", servos=servos)
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(path)) == len(path.read_text().splitlines()) - 1
    assert loader.wp(0).command == 16  # home
    now = {2: 1500.0, 3: 1100.0}
    state, played_states = np.array([1.5, 0.0, 0.0, 0.0, 10.0]), []
    for number in range(1, loader.count()):
        item = loader.wp(number)
        if item.command == 183:
            now[int(item.param1)] = item.param2
            continue
        assert item.command == 93
        command = -0.35 + 0.7 * (now[2] - 900) / 1200, 14.0 * (now[3] - 1100) / 800
        for _ in range(round(item.param1 / 0.01)):
            played_states.append(state)
            rate = lambda x, _, command=command: np.array(rates(x, command, TRUE, np.sin, np.cos))  # noqa: E731
            state = runge_kutta(rate, state, 0.01)
    assert len(played_states) == 3000
    assert now[2] == 1500
    planned = simulate(auv.model.with_values(dict(zip(NAMES, TRUE, strict=True))), run, noise=False)
    found = np.array(played_states)[: planned.n_samples * 5 : 5]
    apart = np.abs(found - planned.outputs[: len(found)]).max(axis=0)
    assert np.all(apart < [0.02, 0.01, 0.01, 0.01, 0.05]), apart  # pulses are whole microseconds
    assert np.ptp(found[:, 3]) > 0.3


def test_a_mission_serves_no_feedback_and_no_quick_orders(tmp_path: Path) -> None:
    """What a mission cannot do is said, and what can."""
    with pytest.raises(DesignError, match="no feedback"):
        write_controller(tmp_path / "m", ship(), experiment("zigzag"), "mission", servos=SERVO)
    quick = Piecewise("rudder", (0.0, 0.5, 2.0, 2.5), (0.0, 0.1, 0.2, 0.0))
    run = experiment("circle", manoeuvre=quick)
    with pytest.raises(DesignError, match="apart"):
        write_controller(tmp_path / "m", ship(), run, "mission", servos=SERVO)
    with pytest.raises(DesignError, match="needs a servo"):
        write_controller(tmp_path / "m", ship(), experiment("circle"), "mission")
