"""Derivative names: what they say about unit, scale and print."""

from __future__ import annotations

import pytest

from oed_sysid.errors import ModelError
from oed_sysid.text import notation
from oed_sysid.text.units import dimension


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("Z_w", "kg/s"),
        ("Z_uw", "kg/m"),
        ("Z_uq", "kg"),
        ("Z_uuds", "kg/m"),
        ("Z_absww", "kg/m"),
        ("Z_wdot", "kg"),
        ("Z_qdot", "kg m"),
        ("M_wdot", "kg m"),
        ("M_qdot", "kg m^2"),
        ("M_uw", "kg"),
        ("M_uq", "kg m"),
        ("M_uuds", "kg"),
        ("M_qq", "kg m^2"),
        ("N_absvr", "kg m"),
        ("Y_rrr", "kg m s"),
        ("K_absp", "kg m^2/s"),
        ("K_phi", "N m"),
        ("X_0", "N"),
        ("Z_ds", "N"),
    ],
)
def test_unit(name: str, unit: str) -> None:
    """The unit is that of the axis divided by that of the factors."""
    assert notation.unit(name) == unit


@pytest.mark.parametrize(
    ("name", "exponents"),
    [
        ("X_udot", (3, 0)),
        ("Y_v", (2, 1)),
        ("Y_r", (3, 1)),
        ("N_v", (3, 1)),
        ("N_r", (4, 1)),
        ("Y_delta", (2, 2)),
        ("N_delta", (3, 2)),
        ("M_qdot", (5, 0)),
        ("Z_uw", (2, 0)),
        ("Z_uq", (3, 0)),
        ("M_uuds", (3, 0)),
        ("Y_vvr", (3, -1)),
    ],
)
def test_prime_exponents(name: str, exponents: tuple[int, int]) -> None:
    """Lengths and speeds of the prime system agree with SNAME's tables."""
    assert notation.prime_exponents(name) == exponents


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


@pytest.mark.parametrize(
    ("name", "latex", "text", "term"),
    [
        ("Z_absww", "Z_{w|w|}", "Z_absww w|w|", "Z_absww*abs(w)*w"),
        ("Z_wabsw", "Z_{w|w|}", "Z_wabsw w|w|", "Z_wabsw*w*abs(w)"),
        ("N_absvr", "N_{|v|r}", "N_absvr |v|r", "N_absvr*abs(v)*r"),
        ("K_absp", "K_{|p|}", "K_absp |p|", "K_absp*abs(p)"),
        ("X_uu", "X_{uu}", "X_uu u^2", "X_uu*u**2"),
        ("Z_uuds", r"Z_{uu\delta_s}", "Z_uuds u^2 ds", "Z_uuds*u**2*ds"),
        ("K_phip", r"K_{\phi p}", "K_phip phi p", "K_phip*phi*p"),
        ("Z_wdot", r"Z_{\dot{w}}", "Z_wdot wdot", "Z_wdot*wdot"),
        ("Y_0", "Y_{0}", "Y_0", "Y_0"),
    ],
)
def test_print(name: str, latex: str, text: str, term: str) -> None:
    """Symbol, text and expression follow from the name."""
    assert notation.latex(name) == latex
    assert notation.term_text(name) == text
    assert notation.term(name) == term


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
