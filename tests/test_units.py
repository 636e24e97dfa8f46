"""Units at the edge: exact factors, headers, dimensions and refusals."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from oed_sysid.errors import DataError
from oed_sysid.text.units import dimension, parse_header, same_dimension, to_si


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


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("w [m/s]", "w", "m/s"),
        ("w[m/s]", "w", "m/s"),
        ("beta(deg)", "beta", "deg"),
        ("ratio [-]", "ratio", "-"),
        ("ratio []", "ratio", "1"),
        ("psi_deg", "psi", "deg"),
        ("x0_m", "x0", "m"),
        ("dx0_mps", "dx0", "mps"),
        ("r_degps", "r", "degps"),
        ("n_rps", "n", "rps"),
        ("thrust_N", "thrust", "N"),
        ("torque_Nm", "torque", "Nm"),
        ("t_s", "t", "s"),
        ("u_V", "u", "V"),
        ("level_cm", "level", "cm"),
        ("speed_kn", "speed", "kn"),
        ("rudder_deg", "rudder", "deg"),
        ("time_ms", "time", "ms"),
        ("temperature_degC", "temperature", "degC"),
        ("density_kgm3", "density", "kgm3"),
        ("phi_deg_inferred", "phi_inferred", "deg"),
        ("U_dvl_mps", "U_dvl", "mps"),
        ("psi_deg [rad]", "psi_deg", "rad"),
        ("theta", "theta", None),
        ("m_pitch", "m_pitch", None),
        ("dive_m_2", "dive_m_2", None),
        ("s", "s", None),
        ("test (type)", "test", "type"),
    ],
)
def test_parse_header(header: str, name: str, unit: str | None) -> None:
    """Brackets and suffixes give name and unit; other words are left alone."""
    assert parse_header(header) == (name, unit)


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        ("kg m/rad", "kg m/rad"),
        ("kg m^2/s^2", "N m"),
        ("kg*m/s**2", "N"),
        ("kg m2/rad2", "kg m^2/rad^2"),
        ("N m s", "kg m^2/s"),
        ("1/s", "1/s"),
        ("rad/s", "rad/s"),
        ("V/s", "V/s"),
        ("m/(s V)", "m/(s V)"),
        ("A", "A"),
        ("K", "K"),
        ("-", "1"),
    ],
)
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


@pytest.mark.parametrize("unit", ["furlong", "m/furlong", "kg m)", "(m", "m,s", "deg C"])
def test_unknown_unit(unit: str) -> None:
    """An unknown unit is refused with the list of those accepted."""
    with pytest.raises(DataError, match=r"(?s)Unknown unit.*deg.*kg m\^2/s\^2"):
        to_si([1.0], unit)


def test_offset_unit_in_a_product() -> None:
    """A temperature with an offset cannot be multiplied."""
    with pytest.raises(DataError, match="Use K for differences"):
        dimension("W/degC")
