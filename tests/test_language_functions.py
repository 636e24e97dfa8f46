"""Tables, functions of CasADi symbols, and outputs that see rates and forces."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from oed_sysid import (
    Actuator,
    ExtraState,
    Force,
    Function,
    Input,
    Model,
    Output,
    Parameter,
    Sensor,
    State,
)
from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.archive import decode, encode
from oed_sysid.testing.problem_contract import check_effect
from oed_sysid.text import expressions
from oed_sysid.text.callables import interpolate

GRID = (
    np.array([0.0, 1.0, 3.0]),
    np.array([-1.0, 0.0, 2.0, 5.0]),
    np.array([[0.0, 1.0, 4.0, 2.0], [3.0, -1.0, 2.0, 8.0], [5.0, 6.0, -7.0, 1.0]]),
)


def sled(**changes: object) -> Model:
    """Mass on a rail with a push, speed measured."""
    parts: dict[str, object] = {
        "states": (State("x", "m"), State("v", "m/s")),
        "inputs": (Input("push", "N"),),
        "outputs": (Output("v", "m/s"),),
        "axes": {"X": "v"},
        "inertia": {("X", "v"): "m"},
        "kinematics": {"x": "v"},
        "effects": (Force("push", {"X": "push"}),),
        "parameters": (Parameter("m", 2.0, "kg"), Parameter("k", 0.5, "N s/m")),
        "step": 0.05,
    }
    return Model("sled", **(parts | changes))  # type: ignore[arg-type]


def drive(model: Model, n: int = 60) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, commands and start of a short run."""
    times = 0.05 * np.arange(n)
    inputs = np.sign(np.sin(3 * times))[:, None] * np.ones((1, len(model.inputs)))
    return times, inputs, np.array([0.1, 0.4])


def test_bilinear_tables_agree_inside_and_outside() -> None:
    """SciPy, NumPy and CasADi agree within the grid; beyond it the end slopes continue."""
    from scipy.interpolate import RegularGridInterpolator

    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    text = expressions.to_casadi("f(x, y)", {"x": x, "y": y}, {"f": GRID})
    function = ca.Function("f", [x, y], [text])
    rng = np.random.default_rng(1)
    inside = np.column_stack([rng.uniform(0, 3, 50), rng.uniform(-1, 5, 50)])
    exact = RegularGridInterpolator(GRID[:2], GRID[2])(inside)
    np.testing.assert_allclose(interpolate(GRID, *inside.T), exact, atol=1e-13)
    points = rng.uniform(-4, 8, (50, 2))
    ours = expressions.to_numpy("f(x, y)", {"x": points[:, 0], "y": points[:, 1]}, {"f": GRID})
    np.testing.assert_allclose(ours, [float(function(*p)) for p in points], atol=1e-11)
    assert float(interpolate(GRID, -1.0, 0.0)) == pytest.approx(1.0 + 2.0)


def test_table_at_a_number_is_that_number_symbolically() -> None:
    """A plain number as argument gives what the table has there, in one and two dimensions."""
    x = ca.SX.sym("x")
    line = ([0.0, 2.0], [1.0, 5.0])
    text = expressions.to_casadi("f(x, 0.5) + g(1.0)", {"x": x}, {"f": GRID, "g": line})
    found = float(ca.Function("f", [x], [text])(0.7))
    assert found == pytest.approx(float(interpolate(GRID, 0.7, 0.5)) + 3.0)


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        (([0.0, 0.0], [1.0, 2.0]), "does not increase"),
        (([0.0, 1.0], [1.0, 2.0, 3.0]), "expected \\(2,\\)"),
        (([0.0, 1.0], [0.0, 1.0], [[1.0, 2.0]]), "expected \\(2, 2\\)"),
        (([0.0, 1.0], [1.0, np.nan]), "not finite"),
        (([0.0, 1.0],), "expected \\(x, y\\)"),
    ],
)
def test_wrong_tables_are_refused(table: tuple, complaint: str) -> None:
    """A table that does not fit its grid is refused when the effect is made."""
    with pytest.raises(ModelError, match=complaint):
        Force("f", {"X": "gz(v)"}, tables={"gz": table})


def test_number_of_arguments_is_checked() -> None:
    """A table of two arguments called with one is an error of construction."""
    with pytest.raises(ModelError, match="got 1 arguments, expected 2"):
        sled(effects=(Force("f", {"X": "gz(v)"}, tables={"gz": GRID}),))


def soft_drag(v, E_drag, steep):
    """Drag with a conditional, as a user would write it."""
    speed = ca.sqrt(v**2 + 1e-4)
    return ca.if_else(v > 0, -E_drag * v * speed, -0.5 * E_drag * v * speed * ca.exp(-steep))


DRAG = Force.from_function(
    "soft_drag",
    soft_drag,
    "X",
    parameters=(
        Parameter("E_drag", 0.0, "kg/m", scale=0.5),
        Parameter("steep", 0.3, "1", fixed=True),
    ),
    amplitudes=("E_drag",),
    description="drag that differs ahead and astern",
    source="this test",
    needs="motion both ways",
)


def test_python_function_keeps_the_contract_of_an_effect() -> None:
    """An effect from a Python function has exact Jacobians and is absent at zero."""
    assert DRAG.terms == {"X": "soft_drag(v, E_drag, steep)"}
    check_effect(DRAG, sled().fix("m", "k"), rng=np.random.default_rng(2))


def test_python_function_equals_the_same_text() -> None:
    """Compiled sensitivities of the function equal those of the text it stands for."""
    speed = "sqrt(v**2 + 1e-4)"
    text = f"-E_drag*v*{speed} if v > 0 else -0.5*E_drag*v*{speed}*exp(-steep)"
    written = Force("soft_drag", {"X": text}, DRAG.parameters)
    runs = []
    for effect in (DRAG, written):
        model = (sled() + effect).with_values({"E_drag": 0.7})
        times, inputs, start = drive(model)
        runs.append(kernel(model).run(times, inputs, model.value_vector, start, sensitivities=True))
    np.testing.assert_allclose(runs[0].outputs, runs[1].outputs, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(
        runs[0].output_sensitivities, runs[1].output_sensitivities, rtol=1e-12, atol=1e-13
    )


def test_function_is_stored_and_told_apart() -> None:
    """A stored function comes back equal; another graph is another structure."""
    model = sled() + DRAG
    classes = (Model, State, Input, Output, Force, Parameter, Function)
    again = decode(encode(model), classes)
    assert again.structure_key() == model.structure_key()
    assert again.effects[-1].functions == DRAG.functions
    other = Force.from_function(
        "soft_drag",
        lambda v, E_drag, steep: -E_drag * v * steep,
        "X",
        parameters=DRAG.parameters,
    )
    assert (sled() + other).structure_key() != model.structure_key()
    assert "soft_drag(v, E_drag, steep)" in model.equations()
    v = np.linspace(-1, 1, 5)
    found = again.effects[-1].functions[0].evaluate(v, 1.0, 0.3)
    expected = [float(soft_drag(value, 1.0, 0.3)) for value in v]
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_every_recorded_operation_is_rebuilt() -> None:
    """All elementary operations of a large expression survive storing."""

    def everything(a, b):
        one = ca.sin(a) + ca.tanh(b) * ca.atan2(a, b) - ca.fmod(b, 0.7) + ca.hypot(a, b)
        two = ca.fmin(a, b) ** 3 + ca.fmax(a, 0) ** b + ca.sign(a) * ca.floor(3 * b) - ca.erf(a)
        three = ca.logic_and(a > 0, ca.logic_not(b <= 0.2)) + ca.log(a + 2) / ca.sqrt(b)
        return one + two + three * ca.acos(a / 3) + ca.cosh(b) - ca.asinh(a) + ca.ceil(b) + 1 / b

    function = Function("everything", everything)
    again = Function("everything", function.definition, function.arguments)
    for a, b in ((0.3, 1.4), (0.9, 0.1)):
        exact = float(everything(ca.DM(a), ca.DM(b)))
        assert float(again.evaluate(a, b)) == pytest.approx(exact, rel=1e-13)


@pytest.mark.parametrize(
    ("definition", "complaint"),
    [
        (lambda u: [u, u], "expected one scalar|cannot be called"),
        (lambda u: 1.0 if u > 0 else 0.0, "instead of numpy, math, if"),
        (lambda: 1.0, "does not say its arguments"),
        ("0=add 1 2", "not a function that Function has stored"),
    ],
)
def test_functions_that_are_none_are_refused(definition: object, complaint: str) -> None:
    """What cannot be recorded is refused with what to write instead."""
    with pytest.raises(ModelError, match=complaint):
        Function("f", definition)  # type: ignore[arg-type]


def test_accelerometer_sees_rate_and_force() -> None:
    """dot(v) is force over mass, with sensitivities that equal differences."""
    outputs = (
        Output("a", "m/s^2", expression="dot(v) + k*v*pi"),
        Output("cell", "N", expression='force("X")'),
        Output("part", "N", expression='force("X", "drag")'),
    )
    drag = Force("drag", {"X": "-k*v*abs(v)"})
    model = sled(outputs=outputs, effects=(Force("push", {"X": "push"}), drag))
    times, inputs, start = drive(model)
    run = kernel(model).run(times, inputs, model.value_vector, start, sensitivities=True)
    v = run.states[:, 1]
    force = inputs[:, 0] - 0.5 * v * np.abs(v)
    np.testing.assert_allclose(run.outputs[:, 0], force / 2.0 + 0.5 * v * np.pi, atol=1e-13)
    np.testing.assert_allclose(run.outputs[:, 1], force, atol=1e-13)
    np.testing.assert_allclose(run.outputs[:, 2], -0.5 * v * np.abs(v), atol=1e-13)
    slow = Kernel(model, compiled=False)
    by_interpreter = slow.run(times, inputs, model.value_vector, start, sensitivities=True)
    np.testing.assert_allclose(
        run.output_sensitivities, by_interpreter.output_sensitivities, rtol=1e-12, atol=1e-13
    )
    for column, name in enumerate(model.free_names):
        h = 1e-6
        sides = []
        for sign in (1, -1):
            values = model.with_values({name: model.values[name] + sign * h}).value_vector
            sides.append(kernel(model).run(times, inputs, values, start).outputs)
        difference = (sides[0] - sides[1]) / (2 * h)
        exact = run.output_sensitivities[:, :, 2 + column]
        np.testing.assert_allclose(exact, difference, atol=2e-8)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"kinematics": {"x": "dot(v)"}}, "only outputs and sensor"),
        ({"outputs": (Output("a", "m/s^2", expression="dot(w)"),)}, "Known here: dot\\(v\\)"),
        ({"outputs": (Output("a", "N", expression='force("Y")'),)}, "does not exist"),
        ({"parameters": (Parameter("pi", 3.0, ""), Parameter("m", 2.0, "kg"))}, "reserved"),
    ],
)
def test_rates_are_known_to_sensors_only(changes: dict, complaint: str) -> None:
    """A rate or force where it cannot be known is refused at construction."""
    with pytest.raises(ModelError, match=complaint):
        sled(**changes)


def test_actuator_that_sees_states() -> None:
    """A push that weakens with speed acts within the equations of motion."""
    weak = Actuator("load", {"push": "push*(1 - k*v)"})
    with_actuator = sled(effects=(weak, Force("push", {"X": "push"})))
    by_hand = sled(effects=(Force("push", {"X": "push*(1 - k*v)"}),))
    results = []
    for model in (with_actuator, by_hand):
        times, inputs, start = drive(model)
        run = kernel(model).run(times, inputs, model.value_vector, start, sensitivities=True)
        results.append((run.outputs, run.output_sensitivities))
    np.testing.assert_allclose(results[0][0], results[1][0], rtol=1e-14)
    np.testing.assert_allclose(results[0][1], results[1][1], rtol=1e-12, atol=1e-14)


def test_actuator_with_inertia() -> None:
    """An actuator with a state of its own follows its rate equation."""
    lag = Actuator(
        "motor", {"push": "actual"}, states=(ExtraState("actual", "(push - actual)/k", "push"),)
    )
    model = sled(effects=(lag, Force("push", {"X": "push"})), step=0.005)
    times = 0.05 * np.arange(40)
    inputs = np.where(times < 0.5, 1.0, -1.0)[:, None]
    z, _ = kernel(model).start(np.zeros(2), inputs[0], model.value_vector, 0.0)
    run = kernel(model).run(times, inputs, model.value_vector, z)
    after = times[10:] - times[10]
    np.testing.assert_allclose(run.states[10:, 2], -1 + 2 * np.exp(-after / 0.5), atol=1e-9)


def test_one_function_for_two_targets() -> None:
    """A function that returns a pair acts on two targets, and one of another length is refused."""

    def pair(v, k):
        return -k * v, 0.1 * v**2

    effect = Force.from_function("pair", pair, ("X", "x"))
    assert effect.terms == {"X": "pair_X(v, k)", "x": "pair_x(v, k)"}
    written = Force("pair", {"X": "-k*v", "x": "0.1*v**2"})
    results = []
    for one in (effect, written):
        model = sled() + one
        times, inputs, start = drive(model)
        results.append(kernel(model).run(times, inputs, model.value_vector, start).states)
    np.testing.assert_allclose(results[0], results[1], rtol=1e-14)
    with pytest.raises(ModelError, match="expected a tuple of 3 results"):
        Force.from_function("pair", pair, ("X", "x", "v"))


def test_actuator_and_sensor_from_functions() -> None:
    """Functions serve every stage: an actuator that saturates softly, a sensor that is bent."""
    soft = Actuator.from_function("soft", lambda push: ca.tanh(push), "push")
    bent = Sensor.from_function("bent", lambda v: v + 0.1 * v**2, "v")
    model = sled(effects=(soft, Force("push", {"X": "push"}), bent))
    times, inputs, start = drive(model)
    run = kernel(model).run(times, inputs, model.value_vector, start)
    v = run.states[:, 1]
    np.testing.assert_allclose(run.outputs[:, 0], v + 0.1 * v**2, rtol=1e-14)
    np.testing.assert_allclose(np.diff(v), 0.05 * np.tanh(inputs[:-1, 0]) / 2.0, rtol=1e-9)
