"""Properties that hold for everything that can be written, tried on what nobody thought of."""

from __future__ import annotations

import json
import string
import tempfile
from fractions import Fraction
from functools import partial
from pathlib import Path

import casadi as ca
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, given, settings
from simple_models import NOMOTO

from benchmarks import fuzz
from oed_sysid import Force, Model, OedSysidError, Parameter, Record, read_csv, simulate, write_csv
from oed_sysid.experiments import manoeuvres as m
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.likelihood.archive import decode, encode
from oed_sysid.likelihood.fit import ARCHIVED
from oed_sysid.physics.channels import Channels, Input, Output, State
from oed_sysid.text import expressions, notation, units
from oed_sysid.text.dimensions import dimension_of
from oed_sysid.text.units import OFFSETS, UNITS

few = settings(max_examples=40, deadline=None, derandomize=True)
# -- units -----------------------------------------------------------------------------

symbols = st.sampled_from(sorted(set(UNITS) - set(OFFSETS) - {"", "-"}))
powers = st.integers(-3, 3).filter(bool)
products = st.lists(st.tuples(symbols, powers), min_size=1, max_size=3)
# Libraries compiled with fast mathematics switch subnormal numbers off in a whole process.
floats = partial(st.floats, allow_subnormal=False)
numbers = floats(-1e6, 1e6, allow_nan=False)


def written(product: list[tuple[str, int]]) -> str:
    """A unit as a product of powers."""
    return " ".join(f"{symbol}^{power}" for symbol, power in product)


@few
@given(products, numbers)
def test_factors_multiply(product: list[tuple[str, int]], value: float) -> None:
    """A product of units converts by the product of their factors, and so do dimensions."""
    factor, expected = 1.0, units.dimension("1")
    for symbol, power in product:
        factor *= float(units.to_si(1.0, symbol)[0]) ** power
        expected = expected * units.dimension(symbol) ** power
    assume(1e-50 < factor < 1e50)
    try:
        converted, si_unit = units.to_si(value, written(product))
    except OedSysidError as error:
        assert "exponents beyond" in str(error)  # noqa: PT017
        return
    assert converted == pytest.approx(factor * value, rel=1e-12)
    assert units.dimension(written(product)) == expected
    assert units.dimension(si_unit) == expected


@few
@given(products)
def test_si_units_are_fixed_points(product: list[tuple[str, int]]) -> None:
    """The unit that a conversion ends in is read again, and converts to itself by one."""
    try:
        _, si_unit = units.to_si(1.0, written(product))
    except OedSysidError:
        assume(False)
    value, again = units.to_si(1.0, si_unit)
    assert (float(value), again) == (1.0, si_unit)


@few
@given(st.sampled_from(["m", "kg m/s^2", "V"]), st.fractions(-2, 2, max_denominator=4))
def test_fractional_powers_print_and_read(unit: str, power: Fraction) -> None:
    """Any power of a dimension is printed so that it is read as the same."""
    dimension = units.dimension(unit) ** power
    assert units.dimension(str(dimension)) == dimension


# -- notation --------------------------------------------------------------------------

factor_lists = st.lists(
    st.tuples(st.booleans(), st.sampled_from(list(notation.FACTOR_UNITS))), min_size=1, max_size=4
)


@few
@given(st.sampled_from("XYZKMN"), factor_lists)
def test_names_say_their_factors(axis: str, chosen: list[tuple[bool, str]]) -> None:
    """A name built of factors is read as these factors; unit and term agree with them."""
    name = f"{axis}_" + "".join("abs" * absolute + symbol for absolute, symbol in chosen)
    derivative = notation.parse(name)
    assert [(f.absolute, f.symbol) for f in derivative.factors] == chosen
    known = {symbol: units.dimension(unit) for symbol, unit in notation.FACTOR_UNITS.items()}
    known[name] = derivative.dimension
    force = units.dimension("N" if axis in "XYZ" else "N m")
    assert dimension_of(notation.term(name), known) == force
    values = {symbol: -1.0 - 0.1 * i for i, symbol in enumerate(notation.FACTOR_UNITS)}
    expected = np.prod([abs(values[s]) if a else values[s] for a, s in chosen])
    got = expressions.to_numpy(notation.term(name), values | {name: 2.0})
    assert float(got) == pytest.approx(2.0 * expected)


# -- expressions -----------------------------------------------------------------------

leaves = st.sampled_from(["u", "w", "q", "2", "0.5", "1e-3", "7"])


def grow(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    """Expressions of expressions."""
    return st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*"]), inner).map(
            lambda t: f"({t[0]} {t[1]} {t[2]})"
        ),
        inner.map(lambda x: f"(-{x})"),
        inner.map(lambda x: f"sin({x})"),
        inner.map(lambda x: f"abs({x})"),
        inner.map(lambda x: f"tanh({x})"),
        inner.map(lambda x: f"({x})**2"),
        st.tuples(inner, inner).map(lambda t: f"max({t[0]}, {t[1]})"),
        st.tuples(inner, inner, inner).map(lambda t: f"where({t[0]} < {t[1]}, {t[2]}, {t[0]})"),
    )


texts = st.recursive(leaves, grow, max_leaves=12)
PYTHON = {"abs": abs, "max": max, "sin": np.sin, "tanh": np.tanh}
PYTHON["where"] = lambda condition, a, b: a if condition else b


@few
@given(texts, st.tuples(*[floats(-2, 2)] * 3))
def test_expressions_are_what_python_says(text: str, point: tuple[float, float, float]) -> None:
    """NumPy and CasADi give what Python's own arithmetic gives."""
    scope = dict(zip(("u", "w", "q"), point, strict=True))
    expected = float(eval(text, {"__builtins__": {}}, PYTHON | scope))
    assume(abs(expected) < 1e12)
    assert float(expressions.to_numpy(text, scope)) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    symbolic = {name: ca.SX.sym(name) for name in scope}
    function = ca.Function("f", list(symbolic.values()), [expressions.to_casadi(text, symbolic)])
    assert float(function(*point)) == pytest.approx(expected, rel=1e-9, abs=1e-12)


@few
@given(texts)
def test_expressions_print(text: str) -> None:
    """Every expression prints as text and as LaTeX, with braces that close."""
    assert expressions.to_text(text)
    latex = expressions.to_latex(text)
    assert latex.count("{") == latex.count("}")


@pytest.mark.parametrize(
    "text",
    [
        *("(-1)**0.5", "10**400", "1e999", "1/0", "u/0", "u % 2", "u << 2", "~u", "u^2"),
        *("u == 1", "u != 1", "True", "1j", "'a'", "u.x", "u[0]", "[u]", "f(*u)"),
        *("sqrt(-1)", "log(0)", "exp(1000)", "lambda: 1", "(u := 1)", ""),
        *("u,", "9" * 400),
        *("+".join(["u"] * 5000), "(" * 400 + "u" + ")" * 400, "-" * 500 + "u", "u\0"),
        *("abs(" * 200 + "u" + ")" * 200, "sin(x=1)", "u()()", "u @ w", "u // 2"),
    ],
    ids=lambda text: repr(text[:20]),
)  # fmt: skip
def test_refused_where_they_are_written(text: str) -> None:
    """What cannot be evaluated is refused when an effect or a model is made of it."""
    with pytest.raises(OedSysidError):
        Force("wrong", {"X": text}, (Parameter("E", 0.0),))
    with pytest.raises(OedSysidError):
        Model("wrong", (State("u", "1"),), (), (Output("u", "1"),), {"u": text})


def test_deepest_expression_still_works() -> None:
    """At the limit of depth every use of an expression still has stack enough."""
    text = "+".join(["u"] * (expressions.DEEPEST - 2))
    assert float(expressions.to_numpy(text, {"u": 1.0})) == expressions.DEEPEST - 2
    assert expressions.to_text(text)
    assert expressions.to_latex(text)
    assert str(dimension_of(text, {"u": units.dimension("m")})) == "m"


# -- files -----------------------------------------------------------------------------

signals = st.lists(
    st.one_of(floats(-1e30, 1e30, allow_nan=False), st.just(float("nan"))),
    min_size=6,
    max_size=6,
)
names = st.text(alphabet=string.ascii_letters, min_size=1, max_size=6).filter(
    lambda name: name.lower() not in ("t", "time", "times", "timestamp")
)


@few
@given(
    st.lists(names, min_size=3, max_size=3, unique_by=str.lower),
    st.lists(floats(1e-3, 1e3), min_size=6, max_size=6),
    st.lists(floats(-1e30, 1e30, allow_nan=False), min_size=6, max_size=6),
    st.tuples(signals, signals),
    st.sampled_from([1.0, -1.0]),
)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_csv_is_read_as_it_was_written(
    channels: list[str], steps: list[float], command: list[float], measured: tuple, sign: float
) -> None:
    """Every record comes back from CSV to the last bit, with gaps, signs and any names."""
    outputs = np.array(measured).T
    assume(all(np.isfinite(column).any() for column in outputs.T))
    assume(not any(name.isupper() and name in units.UNITS for name in channels))
    record = Record(
        "run",
        np.cumsum(steps),
        np.array(command)[:, np.newaxis],
        outputs,
        Channels(
            (Input(f"{channels[0]}_in", "N", sign=sign),),
            (Output(f"{channels[1]}_a", "m"), Output(f"{channels[2]}_b", "rad/s", sign=sign)),
        ),
    )
    with tempfile.TemporaryDirectory() as folder:
        write_csv(record, Path(folder) / "run.csv")
        try:
            again = read_csv(Path(folder) / "run.csv", record.channels)["run"]
        except OedSysidError as error:
            assert "seems to mark missing samples" in str(error)  # noqa: PT017
            return
    np.testing.assert_array_equal(again.times, record.times)
    np.testing.assert_array_equal(again.inputs, record.inputs)
    np.testing.assert_array_equal(again.outputs, record.outputs)
    assert again.content_hash == record.content_hash


plain = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(-(2**60), 2**60), st.text(max_size=8), floats()
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3).map(tuple),
        st.dictionaries(st.text(max_size=4), inner, max_size=3),
    ),
    max_leaves=8,
)


@few
@given(plain)
def test_archive_returns_what_it_was_given(value: object) -> None:
    """Whatever plain data is archived comes back the same, NaN, infinity and -0.0 included."""
    again = decode(json.loads(json.dumps(encode(value), allow_nan=False)), ARCHIVED)
    assert repr(again) == repr(value)


# -- models ----------------------------------------------------------------------------

DRAGS = tuple(
    Force(f"drag_{i}", {"r": f"-E_{i}*r*abs(r)**{i}"}, (Parameter(f"E_{i}", 0.0),))
    for i in (1, 2, 3)
)


@few
@given(
    st.permutations(DRAGS), st.integers(0, 3), st.lists(floats(0.0, 2.0), min_size=3, max_size=3)
)
def test_models_compose(order: list[Force], n: int, sizes: list[float]) -> None:
    """Adding effects and taking them away leads back; values follow their parameters."""
    chosen = order[:n]
    model = NOMOTO + chosen
    assert model.effect_names == tuple(effect.name for effect in chosen)
    assert model.without(*model.effect_names) == NOMOTO
    values = {
        p.name: size for effect, size in zip(chosen, sizes, strict=False) for p in effect.parameters
    }
    valued = model.with_values(values)
    assert {name: valued.values[name] for name in values} == values
    assert valued.structure_key() == model.structure_key()
    assert valued.with_values(model.values) == model
    if n:
        assert model.structure_key() != NOMOTO.structure_key()
    assert decode(encode(valued), ARCHIVED) == valued


# -- manoeuvres ------------------------------------------------------------------------

amplitude = floats(0.02, 0.6)
open_loop = st.one_of(
    st.builds(lambda a: m.Doublet("rudder", a, pulse_time=5.0), amplitude),
    st.builds(lambda a: m.ThreeTwoOneOne("rudder", a, unit_time=3.0), amplitude),
    st.builds(lambda a, s: m.PRBS("rudder", a, bit_time=2.0, order=5, seed=s), amplitude,
              st.integers(1, 30)),
    st.builds(lambda a: m.Multisine("rudder", np.array([0.05, 0.1, 0.3]), peak=a), amplitude),
    st.builds(lambda a, b: m.ZigZag("rudder", a, b), amplitude, floats(0.02, 0.4)),
)  # fmt: skip


@few
@given(open_loop, floats(0.05, 0.4), floats(0.02, 0.2))
def test_manoeuvres_stay_within_limits(manoeuvre: m.Manoeuvre, limit: float, rate: float) -> None:
    """Cut off and slope-limited, no manoeuvre leaves the range or the rate it was given."""
    kept = m.RateLimited(m.Saturated(manoeuvre, limit), rate)
    experiment = Experiment("run", kept, duration=60.0, sample_time=0.5)
    record = simulate(NOMOTO, experiment, rng=np.random.default_rng(0), noise=False)
    command = record.input("rudder")
    assert np.abs(command).max() <= limit * (1 + 1e-9)
    assert np.abs(np.diff(command) / np.diff(record.times)).max() <= rate * (1 + 1e-9)
    limits = Limits(
        inputs={"rudder": (-limit - 1e-9, limit + 1e-9)}, rates={"rudder": rate * 1.0001}
    )
    assert limits.violations(record.times, {"rudder": command}) == ()


# -- fuzzers ---------------------------------------------------------------------------


def test_a_few_thousand_random_inputs() -> None:
    """Random input of every reader ends in a value or in the package's own error, quickly."""
    rows = fuzz.counted(inputs=1500, seed=1)
    assert [row["reader"] for row in rows] == list(fuzz.SHARES)
    assert not sum(row["uncaught"] + row["slower than 2 s"] for row in rows)
    assert sum(row["accepted"] for row in rows) > 100


@pytest.mark.slow
@pytest.mark.parametrize("reader", list(fuzz.SHARES))
def test_many_random_inputs(reader: str) -> None:
    """Tens of thousands of random inputs for each reader, with other seeds than the benchmark."""
    n_inputs = {"problems": 500, "results": 4000}.get(reader, 40_000)
    (row,) = fuzz.counted(inputs=n_inputs, seed=2, only=reader)
    assert (row["uncaught"], row["slower than 2 s"]) == (0, 0)
