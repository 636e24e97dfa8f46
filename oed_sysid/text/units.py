"""Exact conversion of units at the edge, and the algebra of dimensions.

Inside the package every number is SI (m, s, kg, rad, N, ...). This module is
called where numbers come in: it reads the unit from a column header, converts
the column, and compares dimensions.

The radian counts as dimensionless in comparisons (``N m/rad`` equals ``N m``)
but is remembered, so that units print as they were meant and a reader of data
can tell ``rad/s`` from revolutions ``1/s``.

Every unit that is understood, with its factor to SI.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, lru_cache
from math import floor, inf, log10, pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from oed_sysid.errors import DataError
from oed_sysid.runtime.tables import tables

# -- every unit that is understood -----------------------------------------------------


_TABLE = tables(__file__)
# Symbols that the package calculates with.
SI = tuple(_TABLE["dimensions"])
# unit: (factor to SI, SI unit).
UNITS: dict[str, tuple[float, str]] = {symbol: (1.0, symbol) for symbol in SI}
for _unit, _names in _TABLE["factors"].items():
    UNITS |= {name: (factor, _unit) for name, factor in _names.items()}
OFFSETS: dict[str, float] = _TABLE["offsets"]
SPELLINGS: dict[str, str] = _TABLE["spellings"]
# What people write for units, in small letters.
_MEANT = {word: unit for unit, words in _TABLE["meant"].items() for word in words}


# -- exact conversion of units at the edge ---------------------------------------------


_BASES = ("kg", "m", "s", "A", "K")


@dataclass(frozen=True, eq=False)
class Dimension:
    """Powers of kg, m, s, A and K, and of the radian, which does not take part in equality.

    Supports ``*``, ``/``, ``**`` and equality. Unknown units are powers of whole numbers.

    Parameters
    ----------
    powers : mapping
        Exponent of every symbol.

    Examples
    --------
    >>> force = dimension("kg") * dimension("m/s^2")
    >>> force == dimension("N"), str(force / dimension("m^2/s^2"))
    (True, 'kg/m')
    >>> str(dimension("N m") ** Fraction(1, 2) * dimension("s"))
    'kg^(1/2) m'
    """

    powers: Mapping[str | int, Fraction] = field(default_factory=dict)

    def __mul__(self, other: Dimension) -> Dimension:
        found = dict(self.powers)
        for symbol, n in other.powers.items():
            found[symbol] = found.get(symbol, 0) + n
        return Dimension({symbol: n for symbol, n in found.items() if n})

    def __truediv__(self, other: Dimension) -> Dimension:
        return self * other**-1

    def __pow__(self, power: float | Fraction) -> Dimension:
        exact = power if isinstance(power, int) else Fraction(power).limit_denominator(1000)
        return Dimension({symbol: n * exact for symbol, n in self.powers.items() if exact})

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Dimension) and not (self / other).powers.keys() - {"rad"}

    def __hash__(self) -> int:
        return hash(frozenset(self.plain.powers.items()))

    @property
    def is_dimensionless(self) -> bool:
        """Whether every exponent is zero (angles are dimensionless)."""
        return not self.powers.keys() - {"rad"}

    @property
    def radian(self) -> Fraction:
        """Exponent of the radian."""
        return self.powers.get("rad", Fraction(0))

    @property
    def plain(self) -> Dimension:
        """The same without radians."""
        return Dimension({symbol: n for symbol, n in self.powers.items() if symbol != "rad"})

    @property
    def unknown(self) -> dict[int, Fraction]:
        """Exponents of unknown units, by number."""
        return {index: n for index, n in self.powers.items() if isinstance(index, int)}

    @property
    def known(self) -> Dimension:
        """The same with unknown units taken as one."""
        return Dimension({key: n for key, n in self.powers.items() if not isinstance(key, int)})

    def __str__(self) -> str:
        if (name := _NAMED_DIMENSIONS.get(self.plain)) is not None:
            return _text({**name, "rad": self.radian})
        symbols = {base: self.powers[base] for base in _BASES if base in self.powers}
        # Electrical units read best with whichever of V and A needs fewer symbols.
        volts = symbols.get("A", Fraction(0))
        with_volt = (self.plain * _DIMENSIONS["V"] ** volts).powers
        if volts and "A" not in with_volt and len(with_volt) + 1 < len(symbols):
            symbols = {base: with_volt[base] for base in _BASES if base in with_volt}
            symbols["V"] = -volts
        return _text({**symbols, "rad": self.radian})


_DIMENSIONS = {
    symbol: Dimension(
        {base: Fraction(n) for base, n in zip((*_BASES, "rad"), exponents, strict=True) if n}
    )
    for symbol, exponents in _TABLE["dimensions"].items()
}
_NAMED_DIMENSIONS: dict[Dimension, dict[str, Fraction]] = {
    _DIMENSIONS["J"]: {"N": Fraction(1), "m": Fraction(1)},
    **{_DIMENSIONS[name]: {name: Fraction(1)} for name in ("N", "Pa", "W", "V")},
}

# As a header's suffix these would more often be part of the name than a unit.
_NOT_A_SUFFIX = frozenset({"", "1", "-", "%", "°", "t", "g", "l"})
# Beyond these a text is no name and no unit that anyone measures in; fractions would not end.
MOST_CHARACTERS, LARGEST_EXPONENT = 80, 12
_NUMBER = r"-?\d+(?:\.\d{1,3})?(?!\d)"
_SIGN = r"\s*(?:\*\*|\^)\s*"
_FACTOR = re.compile(
    rf"([^\W\d_]+\d*|[%°]|1(?![\d.]))(?:{_SIGN}\((-?\d{{1,3}})/(\d{{1,3}})\)|(?:{_SIGN}|\s*)({_NUMBER}))?"
)


@dataclass(frozen=True)
class _Unit:
    """A parsed unit: factor and powers of SI symbols."""

    factor: float = 1.0
    symbols: Dimension = field(default_factory=Dimension)
    offset: float = 0.0

    @cached_property
    def dimension(self) -> Dimension:
        """Powers of the base units."""
        total = Dimension()
        for symbol, n in self.symbols.powers.items():
            total *= _DIMENSIONS[str(symbol)] ** n
        return total


def _parse(unit: str) -> _Unit:
    if not isinstance(unit, str):
        raise DataError(
            f"A unit is text, such as 'm/s', but this is a {type(unit).__name__}: {unit!r:.60}."
        )
    return _parse_text(unit)


@lru_cache(maxsize=1024)
def _parse_text(unit: str) -> _Unit:
    if len(unit) > MOST_CHARACTERS:
        raise DataError(
            f"The unit [{unit:.30}...] has {len(unit)} characters. Write a short product."
        )
    text = unit.strip()
    for spelling, symbol in SPELLINGS.items():
        text = text.replace(spelling, symbol)
    if text in ("", "-"):
        return _Unit()
    if text in OFFSETS:
        factor, symbol = UNITS[text]
        return _Unit(factor, _symbols(symbol), OFFSETS[text])
    if re.search(r"\w[%°]|[%°]\w", text):
        raise _unknown(text, unit)  # "deg%": parts of a product have a mark or a space between
    product = _product(text, unit)
    factor, symbols = 1.0, Dimension()
    for name, n in product.powers.items():
        size, si_unit = UNITS[str(name)]
        factor *= size ** float(n)
        symbols *= _symbols(si_unit) ** n
    if not 1e-60 < factor < 1e60 or any(abs(n) > LARGEST_EXPONENT for n in symbols.powers.values()):
        raise _too_large(unit)
    return _Unit(factor, symbols)


def _product(text: str, unit: str) -> Dimension:
    """Powers of the units in ``a b^2/(c d)``, by Python's arithmetic."""
    found: dict[str, Dimension] = {}

    def factor(match: re.Match[str]) -> str:
        name, above, below, number = match.groups()
        exponent = Fraction(int(above), int(below) or 1) if above else Fraction(number or 1)
        if name not in UNITS and number is None:
            short = name.rstrip("0123456789")
            name, exponent = short, exponent * int(name[len(short) :] or 1)
        if name not in UNITS or name in OFFSETS:
            raise _unknown(name, unit)
        if abs(exponent) > LARGEST_EXPONENT:
            raise _too_large(unit)
        found[f"x{len(found)}"] = Dimension({} if name == "1" else {name: exponent})
        return f" x{len(found) - 1} "

    terms = _FACTOR.sub(factor, text).replace("·", "*")
    if left := re.sub(r"x\d+|[\s*/()]", "", terms):
        raise _unknown(left[0], unit)
    if re.search(r"\(\s*\)", terms):
        raise _unknown("()", unit)
    if alone := re.search(r"(?:^|[*/(])\s*([*/])|([*/])\s*(?:$|\))", terms):
        mark = alone[1] or alone[2]
        raise DataError(f"{mark!r} stands alone in the unit [{unit}]. Write 'kg m^2/s^2', say.")
    try:
        # What stands side by side is a product; nothing but names made here is left in the text.
        whole = re.sub(r"(?<=[\d)])\s*(?=[x(])", "*", " ".join(terms.split()))
        return eval(whole, {"__builtins__": {}}, found)
    except SyntaxError:
        raise _unknown("(" if terms.count("(") > terms.count(")") else ")", unit) from None


def _too_large(unit: str) -> DataError:
    return DataError(
        f"The unit [{unit}] has exponents beyond {LARGEST_EXPONENT}. No measurement has."
    )


@lru_cache(maxsize=256)
def _symbols(si_unit: str) -> Dimension:
    if si_unit == "1":
        return Dimension()
    return Dimension({si_unit: Fraction(1)}) if si_unit in _DIMENSIONS else _parse(si_unit).symbols


def _unknown(part: str, unit: str) -> DataError:
    accepted = ", ".join(sorted(UNITS, key=str.lower))
    if part in OFFSETS:
        return DataError(f"[{unit}] mixes {part} with other units. Use K for differences.")
    small = {name.lower(): name for name in reversed(UNITS)} | _MEANT
    # A degree sign may have been read in the wrong encoding, such as Â°.
    degree = "deg" if not part.isascii() and "°" in unit else None
    meant = small.get(part.lower(), degree)
    hint = f" Did you mean {meant!r}?" if meant else ""
    if not part.isascii() and latin(part) in UNITS:
        hint = f" It is not {latin(part)!r}: {foreign(part)}."
    return DataError(
        f"Unknown unit {part!r} in [{unit}].{hint} Accepted are {accepted}, "
        "and products such as 'kg m^2/s^2' or '1/s'."
    )


# Letters of Cyrillic and Greek that look like those of Latin.
_LOOKS = str.maketrans(
    "аеорсухіјѕԁԛԝһкгвмнтАВЕКМНОРСТУХІЈЅοΑΒΕΖΗΙΚΜΝΟΡΤΥΧ",
    "aeopcyxijsdqwhkrbmhtABEKMHOPCTYXIJSoABEZHIKMNOPTYX",
)


def latin(text: str) -> str:
    """The text in the letters that it looks like, Greek letters by their names.

    >>> latin("\u0440si"), latin("\u03c8"), latin("delta_\u0430")
    ('psi', 'psi', 'delta_a')
    """
    if text.isascii():
        return text
    named = (unicodedata.name(letter, "").split() for letter in text.translate(_LOOKS))
    return "".join(
        words[-1].lower() if words[:1] == ["GREEK"] else letter
        for letter, words in zip(text.translate(_LOOKS), named, strict=True)
    )


def foreign(text: str) -> str:
    """Say which letter of a text is none of the keyboard's.

    >>> foreign("\u0440si")
    "its 'р' is the letter CYRILLIC SMALL LETTER ER"
    """
    letter = next(letter for letter in text if not letter.isascii())
    return f"its {letter!r} is the letter {unicodedata.name(letter, 'without a name')}"


def _text(symbols: Mapping[Any, Fraction]) -> str:
    """Write exponents as ``kg m^2/s^2`` or ``m/(s V)``."""

    def power(symbol: str, n: Fraction) -> str:
        if n == 1:
            return symbol
        return f"{symbol}^{n}" if n.denominator == 1 else f"{symbol}^({n})"

    above = [power(symbol, n) for symbol, n in symbols.items() if n > 0]
    below = [power(symbol, -n) for symbol, n in symbols.items() if n < 0]
    numerator = " ".join(above) or "1"
    if not below:
        return numerator
    return f"{numerator}/{below[0]}" if len(below) == 1 else f"{numerator}/({' '.join(below)})"


def dimension(unit: str) -> Dimension:
    """Return the dimension of a unit.

    Parameters
    ----------
    unit : str
        A unit or a product such as ``"kg m2/rad2"``, ``"N m s"`` or ``"1/s"``;
        ``""``, ``"-"`` and ``"1"`` mean dimensionless.

    Raises
    ------
    DataError
        If a part of the unit is unknown.

    Examples
    --------
    >>> str(dimension("kg m/rad")), dimension("kg m/rad") == dimension("kg m")
    ('kg m/rad', True)
    >>> str(dimension("V/s")), str(dimension("kn"))
    ('V/s', 'm/s')
    """
    return _parse(unit).dimension


def same_dimension(a: str, b: str) -> bool:
    """Tell whether two units measure the same thing; the radian counts as one.

    Examples
    --------
    >>> same_dimension("deg/s", "rad/s"), same_dimension("m", "rad")
    (True, False)
    """
    return dimension(a) == dimension(b)


def is_unit(text: str) -> bool:
    """Whether a text is a unit that is known."""
    try:
        return dimension(text) is not None and bool(text)
    except DataError:
        return False


def converts(unit: str, needed: str) -> bool:
    """Whether numbers in a unit can be given in another one.

    Dimensions ignore the radian, but revolutions read as radians are wrong by 2 pi.
    """
    found, wanted = dimension(unit), dimension(needed)
    return found == wanted and found.radian == wanted.radian


def same_unit(one: str, other: str) -> bool:
    """Whether two texts mean one unit; what is none of the package's does not."""
    if not (is_unit(one) and is_unit(other) and same_dimension(one, other)):
        return False
    return bool(np.isclose(to_si(1.0, one)[0], to_si(1.0, other)[0], rtol=1e-12, atol=0.0))


def to_si(values: ArrayLike, unit: str) -> tuple[np.ndarray, str]:
    """Convert values to SI.

    Parameters
    ----------
    values : array_like
        Numbers in ``unit``, any shape.
    unit : str
        The unit they are in. Revolutions per second and minute become ``1/s``,
        not ``rad/s``.

    Returns
    -------
    converted : numpy.ndarray
        New array of the same shape.
    si_unit : str
        The unit of ``converted``.

    Raises
    ------
    DataError
        If the unit is unknown.

    Examples
    --------
    >>> values, unit = to_si([0.0, 36.0], "km/h")
    >>> print(values[1].round(12), unit)
    10.0 m/s
    >>> print(to_si(15.0, "degC")[0], to_si(90.0, "rpm"))
    288.15 (array(1.5), '1/s')
    """
    parsed = _parse(unit)
    converted = np.array(values, dtype=float) * parsed.factor + parsed.offset
    return np.asarray(converted), _text(parsed.symbols.powers)


def shown_unit(unit: str) -> tuple[float, str]:
    """Return the factor and the unit in which people read a quantity: degrees for radians.

    Parameters
    ----------
    unit : str
        SI unit of a signal.

    Returns
    -------
    factor : float
        How many of the shown unit are one of the unit.
    shown : str

    Examples
    --------
    >>> factor, unit = shown_unit("rad/s")
    >>> f"{0.1 * factor:.3f} {unit}", shown_unit("m/s")
    ('5.730 deg/s', (1.0, 'm/s'))
    """
    if unit == "rad" or unit.startswith(("rad/", "rad ")):
        return 180.0 / pi, f"deg{unit[3:]}"
    return 1.0, unit


# Engineering prefixes of what people read in thousands: forces, moments, powers, pressures.
_PREFIXES = {6: "M", 3: "k", 0: "", -3: "m"}


def scaled(unit: str, largest: float) -> tuple[float, str]:
    """Return the factor and the unit in which a quantity of such a size is read.

    Angles are in degrees; a unit that begins with N, W or Pa has the prefix that leaves numbers
    of one to three digits.

    Parameters
    ----------
    unit : str
        SI unit.
    largest : float
        Largest size, in that unit.

    Examples
    --------
    >>> scaled("N m", 2.5e6), scaled("N", 0.02), scaled("rad", 1.0)[1], scaled("m/s", 2e4)
    ((1e-06, 'MN m'), (1000.0, 'mN'), 'deg', (1.0, 'm/s'))
    """
    factor, shown = shown_unit(unit)
    if not re.match(r"(N|W|Pa)(?![A-Za-z])", shown) or not 0.0 < largest < inf:
        return factor, shown
    power = 3 * floor(log10(largest) / 3)
    power = min(max(power, min(_PREFIXES)), max(_PREFIXES))
    return 10.0**-power, f"{_PREFIXES[power]}{shown}"


def parse_header(text: str) -> tuple[str, str | None]:
    """Split a column header into name and unit.

    Understood are brackets (``w [m/s]``, ``beta(deg)``) and suffixes
    (``psi_deg``, ``dx0_mps``), also before a remark (``phi_deg_inferred``).

    Parameters
    ----------
    text : str
        The header.

    Returns
    -------
    name : str
        The header without its unit.
    unit : str or None
        The unit as written, ``None`` if the header has none. What stands in
        brackets is not checked before it is converted.

    Examples
    --------
    >>> parse_header("w [m/s]"), parse_header("r_degps"), parse_header("m_pitch")
    (('w', 'm/s'), ('r', 'degps'), ('m_pitch', None))
    >>> parse_header("pitch_rad_corrected")
    ('pitch_corrected', 'rad')
    """
    header = text.strip()
    match = re.fullmatch(r"(.*?)\s*(?:\[([^\]]*)\]|\(([^()]*)\))", header)
    if match:
        unit = match.group(2) if match.group(2) is not None else match.group(3)
        return match.group(1).strip(), unit.strip() or "1"
    words = header.split("_")
    for index in range(len(words) - 1, 0, -1):
        word = words[index]
        is_last = index == len(words) - 1
        # A single letter inside a name ("dive_m_2") is too often not a unit.
        if word in UNITS and word not in _NOT_A_SUFFIX and (is_last or len(word) > 1):
            return "_".join(words[:index] + words[index + 1 :]), word
    return header, None
