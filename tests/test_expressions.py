"""Physics as text: reading, evaluating, printing and dimensions."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from oed_sysid.errors import ModelError
from oed_sysid.text import expressions
from oed_sysid.text.dimensions import dimension_of
from oed_sysid.text.units import dimension

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


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("w +", "cannot be read"),
        ("w if q", "cannot be read"),
        ("w % q", "operator Mod"),
        ("w == q", "compares with Eq"),
        ("force()", "write dot"),
        ("[w]", "not arithmetic"),
        ("w.real", "not arithmetic"),
        ("f(w)(q)", "not a function"),
        ("'w'", "expected numbers"),
        ("__import__('os')", "expected numbers"),
    ],
)
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


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("(-u)*sin(theta) + w*cos(theta)", "-u sin(theta) + w cos(theta)"),
        ("m*u*q", "m u q"),
        ("Z_uuds*u_r**2*ds", "Z_uuds u_r² ds"),
        ("a + -b - -c", "a - b + c"),
        ("a - (b - c)", "a - b + c"),
        ("-(a + b)*c", "-(a + b) c"),
        ("a*(b + c)", "a (b + c)"),
        ("(-a)**2", "(-a)²"),
        ("-a**2", "-a²"),
        ("a**-1 + a**(b + 1)", "a⁻¹ + a^(b + 1)"),
        ("a/(b*c)", "a/(b c)"),
        ("a/b*c", "a c/b"),
        ("1/s", "1/s"),
        ("2*3*a", "2 · 3 a"),
        ("q*abs(q)", "q |q|"),
        ("where(a <= b, -a, 0)", "where(a ≤ b, -a, 0)"),
        ("(K*delta - r)/T", "(K delta - r)/T"),
    ],
)
def test_text_reads_well(text: str, printed: str) -> None:
    """Signs collect in front and only necessary parentheses remain."""
    assert expressions.to_text(text) == printed


@pytest.mark.parametrize(
    ("text", "printed"),
    [
        ("Z_absww*w_r", r"Z_{w|w|} \, w_{r}"),
        ("-a/(b + c)", r"-\frac{a}{b + c}"),
        ("abs(q)**2", r"\left|q\right|^{2}"),
        ("sin(theta)", r"\sin\left(\theta\right)"),
        ("sqrt(a + b)", r"\sqrt{a + b}"),
        ("1e-9*a", r"10^{-9} \, a"),
        ("2*3", r"2 \cdot 3"),
        ("log(a)", r"\ln\left(a\right)"),
        ("gz_arm(phi)", r"\operatorname{gz\_arm}\left(\phi\right)"),
    ],
)
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


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("Z*w*abs(w)", "N"),
        ("Z*w**2", "N"),
        ("sqrt(w*w)", "m/s"),
        ("exp(-h/(E + 1e-9))", "1"),
        ("where(E < 2*h, E, 0)", "s"),
        ("atan2(w, w)*sign(w)", "1"),
        ("max(w, 0) - w*theta", "m/s"),
        ("1 + theta + E*q", "1"),
    ],
)
def test_dimension(text: str, unit: str) -> None:
    """The dimension of an expression follows from those of its names."""
    assert dimension_of(text, KNOWN) == dimension(unit)


@pytest.mark.parametrize("text", ["w + q", "w + q + 3.0", "sin(w)", "w > q", "min(w, h)", "2**w"])
def test_unlike_quantities_do_not_meet(text: str) -> None:
    """Adding, comparing or transforming what has unlike dimensions is an error."""
    with pytest.raises(ModelError, match="meets"):
        dimension_of(text, KNOWN)


def test_unknown_units_spread() -> None:
    """What has no stated unit is neither derived nor refused."""
    assert dimension_of("x*w", KNOWN) is None
    assert dimension_of("x + w", KNOWN) == dimension("m/s")
    assert dimension_of("table(w)", KNOWN) is None
