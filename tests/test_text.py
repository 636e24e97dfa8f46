"""Units, names of derivatives, expressions and functions that people write."""

from __future__ import annotations

import math
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from motion import ran
from scipy.interpolate import RegularGridInterpolator

from benchmarks.tables import tables
from oed_sysid import Actuator, ExtraState, Force, Function, Input, Output, Parameter, Sensor, State
from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.errors import DataError, ModelError
from oed_sysid.likelihood.archive import decode, encode
from oed_sysid.physics.model import Model
from oed_sysid.testing import check_effect
from oed_sysid.text import expressions, notation
from oed_sysid.text.callables import interpolate
from oed_sysid.text.dimensions import dimension_of
from oed_sysid.text.units import dimension, parse_header, same_dimension, to_si

TABLES = tables(__file__)


@pytest.mark.parametrize(
    ("value", "unit", "expected", "si_unit"),
    [
        (180.0, "deg", math.pi, "rad"),
        (180.0, "°", math.pi, "rad"),
        (90.0, "deg/s", math.pi / 2, "rad/s"),
        (90.0, "degps", math.pi / 2, "rad/s"),
        (1.0, "kn", 1852.0 / 3600.0, "m/s"),
        (36.0, "km/h", 10.0, "m/s"),
        (600.0, "rpm", 10.0, "1/s"),
        (10.0, "rps", 10.0, "1/s"),
        (2.0, "kN", 2000.0, "N"),
        (2.0, "kNm", 2000.0, "N m"),
        (2.0, "kN m", 2000.0, "N m"),
        (1.5, "bar", 1.5e5, "Pa"),
        (231.0, "cc", 231e-6, "m^3"),
        (3.0, "cm3", 3e-6, "m^3"),
        (1004.5, "kgm3", 1004.5, "kg/m^3"),
        (1.0045, "g/cc", 1004.5, "kg/m^3"),
        (12.0, "cm", 0.12, "m"),
        (250.0, "ms", 0.25, "s"),
        (20.0, "degC", 293.15, "K"),
        (50.0, "%", 0.5, "1"),
        (5.0, "", 5.0, "1"),
        (4.0, "N·m", 4.0, "N m"),
        (1.0, "m s⁻²".replace("⁻²", "^-2"), 1.0, "m/s^2"),
        (9.81, "m/s²", 9.81, "m/s^2"),
        (3.0, "mV", 0.003, "V"),
    ],
)
def test_to_si(value: float, unit: str, expected: float, si_unit: str) -> None:
    """Each accepted unit converts by its definition."""
    converted, name = to_si([value], unit)
    assert converted[0] == pytest.approx(expected, rel=1e-15)
    assert name == si_unit


def test_to_si_copies() -> None:
    """The caller's array is neither changed nor shared."""
    values = np.array([1.0, np.nan])
    converted, _ = to_si(values, "m")
    converted[0] = 5.0
    assert values[0] == 1.0
    assert np.isnan(converted[1])


@pytest.mark.parametrize(("header", "said"), TABLES["headers"].items())
def test_parse_header(header: str, said: list[str]) -> None:
    """Brackets and suffixes give name and unit; other words are left alone."""
    assert parse_header(header) == (*said, None)[:2]


@pytest.mark.parametrize(("unit", "text"), TABLES["dimensions"].items())
def test_dimension_text(unit: str, text: str) -> None:
    """Dimensions print as a reader would write them, and read back equal."""
    assert str(dimension(unit)) == text
    assert dimension(text) == dimension(unit)


def test_dimension_algebra() -> None:
    """Products, quotients and powers of dimensions are exact."""
    energy = dimension("N") * dimension("m")
    assert energy == dimension("J")
    assert energy / dimension("kg") == dimension("m/s") ** 2
    assert (energy / dimension("kg")) ** 0.5 == dimension("m/s")
    assert dimension("s") ** Fraction(1, 3) * dimension("s") ** Fraction(2, 3) == dimension("s")
    assert (energy / energy).is_dimensionless
    assert hash(dimension("N m/rad")) == hash(dimension("N m"))


def test_parentheses_and_order() -> None:
    """A slash divides the next factor only; parentheses hold several."""
    assert dimension("W/m/K") == dimension("W/(m K)") != dimension("W/m K")
    assert dimension("1/(m/s)") == dimension("s/m")


def test_same_dimension() -> None:
    """Radians count as one; everything else has to agree."""
    assert same_dimension("deg/s", "1/s")
    assert same_dimension("kN m", "kg m2/s2")
    assert not same_dimension("m", "rad")


@pytest.mark.parametrize(
    "unit", ["furlong", "m/furlong", "kg m)", "(m", "m,s", "deg C", "m/-", "()", "m ( )", "m/()"]
)
def test_unknown_unit(unit: str) -> None:
    """An unknown unit is refused with the list of those accepted."""
    with pytest.raises(DataError, match=r"(?s)Unknown unit.*deg.*kg m\^2/s\^2"):
        to_si([1.0], unit)


def test_offset_unit_in_a_product() -> None:
    """A temperature with an offset cannot be multiplied."""
    with pytest.raises(DataError, match="Use K for differences"):
        dimension("W/degC")


@pytest.mark.parametrize(("name", "unit"), TABLES["derivative_units"].items())
def test_unit(name: str, unit: str) -> None:
    """The unit is that of the axis divided by that of the factors."""
    assert notation.unit(name) == unit


@pytest.mark.parametrize(("name", "exponents"), TABLES["prime_exponents"].items())
def test_prime_exponents(name: str, exponents: list[int]) -> None:
    """Lengths and speeds of the prime system agree with SNAME's tables."""
    assert notation.prime_exponents(name) == tuple(exponents)


@pytest.mark.parametrize("name", ["X_uu", "Y_r", "Z_qdot", "K_phi", "M_absww", "N_rrr"])
def test_prime_scale_has_the_unit_of_the_derivative(name: str) -> None:
    """Density, length and speed to their exponents give the derivative's dimension."""
    n, k = notation.prime_exponents(name)
    scale = dimension("kg/m^3") * dimension("m") ** n * dimension("m/s") ** k
    assert scale == notation.parse(name).dimension


def test_prime_scale_of_a_known_ship() -> None:
    """A scale is rho/2 L^4 U for the yaw damping of a 304.8 m tanker at 8.23 m/s."""
    scale = notation.prime_scale("N_r", density=1025.0, length=304.8, speed=8.23)
    assert scale == pytest.approx(0.5 * 1025.0 * 304.8**4 * 8.23)


@pytest.mark.parametrize(("name", "printed"), TABLES["printed"].items())
def test_print(name: str, printed: list[str]) -> None:
    """Symbol, text and expression follow from the name."""
    assert [notation.latex(name), notation.term_text(name), notation.term(name)] == printed


def test_term_with_other_symbols() -> None:
    """A term can be written in velocities through the water."""
    term = notation.term("M_uuds", symbols={"u": "u_r", "ds": "fin"})
    assert term == "M_uuds*u_r**2*fin"


def test_term_evaluates_to_what_it_says() -> None:
    """The expression of Z_absww is odd in w."""
    term = notation.term("Z_absww")
    value = eval(term, {"abs": abs}, {"Z_absww": -2.0, "w": -3.0})
    assert value == 18.0


@pytest.mark.parametrize("name", ["zgW", "Z", "Z_", "A_w", "Z_wx", "Z_dot", "Z_abs", "Z_w_q"])
def test_other_names_are_refused(name: str) -> None:
    """A name outside the notation is an error that shows examples."""
    assert not notation.is_derivative(name)
    with pytest.raises(ModelError, match=r"Z_absww, M_uuds or Z_wdot"):
        notation.parse(name)


@pytest.mark.parametrize("name", ["Z_wqdot", "Z_abswdot", "Z_thetadot"])
def test_dot_needs_one_velocity(name: str) -> None:
    """An acceleration derivative has exactly one velocity factor."""
    with pytest.raises(ModelError, match="one velocity factor"):
        notation.parse(name)


def test_latex_of_other_parameters() -> None:
    """Parameters outside the notation still print."""
    assert notation.latex("zgW") == r"\mathrm{zgW}"
    assert notation.latex("omega") == r"\omega"
    assert notation.latex("T_1") == "T_{1}"
    assert notation.latex("Z_absww_prime") == "Z'_{w|w|}"
    assert notation.latex("M_uuds_prime") == r"M'_{uu\delta_s}"


SAMPLES = (
    "Z_absww*w*abs(w) - 3*sin(w)**2/q",
    "-(w + q)*abs(q) - (w - q)",
    "where(w > q, w, -q*2)",
    "min(w, q) + max(w, 0)*sign(q)",
    "exp(-w/(q + 1e-9)) + sqrt(abs(w))",
    "atan2(w, q) + w**3 - q**-1",
    "w/q/2*Z_absww",
    "2**q - +w",
)
VALUES = {"w": np.array([0.3, -1.2, 2.0]), "q": np.array([1.1, 0.4, -0.7]), "Z_absww": -4.0}


@pytest.mark.parametrize("text", SAMPLES)
def test_casadi_and_numpy_agree(text: str) -> None:
    """Symbols and arrays give the same numbers."""
    symbols = {name: ca.SX.sym(name) for name in VALUES}
    function = ca.Function("f", list(symbols.values()), [expressions.to_casadi(text, symbols)])
    w, q, z = VALUES["w"], VALUES["q"], VALUES["Z_absww"]
    exact = [float(function(a, b, z)) for a, b in zip(w, q, strict=True)]
    np.testing.assert_allclose(expressions.to_numpy(text, VALUES), exact, rtol=1e-14, atol=1e-14)


def test_tables_agree_inside_and_outside() -> None:
    """A table is linear between points and keeps its end slopes beyond them."""
    tables = {"gz": (np.array([-1.0, 0.0, 2.0]), np.array([3.0, 0.0, 1.0]))}
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [expressions.to_casadi("gz(x)", {"x": x}, tables)])
    points = np.array([-2.0, -0.5, 0.0, 1.0, 4.0])
    values = expressions.to_numpy("gz(x)", {"x": points}, tables)
    np.testing.assert_allclose(values, [6.0, 1.5, 0.0, 0.5, 2.0], atol=1e-14)
    np.testing.assert_allclose(values, [float(function(p)) for p in points], atol=1e-14)


@pytest.mark.parametrize(("text", "complaint"), TABLES["no_arithmetic"].items())
def test_only_arithmetic_is_read(text: str, complaint: str) -> None:
    """Anything but arithmetic is refused with a reason."""
    with pytest.raises(ModelError, match=complaint):
        expressions.parse(text)


def test_unknown_names_are_hinted() -> None:
    """A misspelt name is reported with its neighbours."""
    with pytest.raises(ModelError, match="Did you mean theta"):
        expressions.check("sin(thteta)", ["theta", "q"], where="here")
    with pytest.raises(ModelError, match="unknown function 'sine'"):
        expressions.check("sine(theta)", ["theta"], where="here")
    with pytest.raises(ModelError, match="atan2 in 'atan2\\(q\\)' got 1 arguments"):
        expressions.check("atan2(q)", ["q"], where="here")


@pytest.mark.parametrize(("text", "printed"), TABLES["readable"].items())
def test_text_reads_well(text: str, printed: str) -> None:
    """Signs collect in front and only necessary parentheses remain."""
    assert expressions.to_text(text) == printed


@pytest.mark.parametrize(("text", "printed"), TABLES["latex"].items())
def test_latex(text: str, printed: str) -> None:
    """LaTeX uses the notation of derivatives and fractions."""
    assert expressions.to_latex(text) == printed


def test_latex_of_cases() -> None:
    """A condition becomes an environment of cases."""
    printed = expressions.to_latex("where(a >= b, a, b)")
    assert printed == r"\begin{cases} a & a \ge b \\ b & \text{otherwise} \end{cases}"


KNOWN = {
    "Z": dimension("kg/m"),
    "w": dimension("m/s"),
    "q": dimension("rad/s"),
    "E": dimension("s"),
    "h": dimension("s"),
    "theta": dimension("rad"),
}


@pytest.mark.parametrize(("text", "unit"), TABLES["expressions"].items())
def test_dimension(text: str, unit: str) -> None:
    """The dimension of an expression follows from those of its names."""
    assert dimension_of(text, KNOWN) == dimension(unit)


def test_unknown_units_spread() -> None:
    """What has no stated unit is neither derived nor refused."""
    assert dimension_of("x*w", KNOWN) is None
    assert dimension_of("x + w", KNOWN) == dimension("m/s")
    assert dimension_of("table(w)", KNOWN) is None


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
    run = ran(model, times, inputs, np.zeros(2))
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
