r"""Hydrodynamic derivatives: everything that their names say.

A derivative is written ``AXIS_factors[dot]``. ``Z_absww`` is the coefficient
of :math:`|w|w` in the heave force, written :math:`Z_{w|w|}` in print. From the
name follow the unit, the prime scale, the LaTeX symbol and the term itself, so
that none of them is ever typed a second time.

* axis: ``X Y Z`` (forces) and ``K M N`` (moments);
* factors: ``u v w p q r phi theta``, the control angles ``delta dr ds db``
  (rudder or general, rudder, stern plane, bow plane), each optionally after
  ``abs``; ``0`` stands for no factor, a constant force or moment;
* ``dot`` at the end: derivative with respect to an acceleration.

``uu`` is :math:`u^2`, not :math:`u|u|`, which is ``absuu``. Radians are
dropped from mechanics: ``M_uq`` is in ``kg m``, not ``kg m/rad``.

References
----------
.. [1] SNAME (1950). Nomenclature for treating the motion of a submerged body
   through a fluid. Technical and Research Bulletin 1-5.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby

from oed_sysid.errors import ModelError
from oed_sysid.text import SAYS
from oed_sysid.text.units import MOST_CHARACTERS, Dimension, dimension

AXES: Mapping[str, str] = {
    "X": "surge force",
    "Y": "sway force",
    "Z": "heave force",
    "K": "roll moment",
    "M": "pitch moment",
    "N": "yaw moment",
}
FACTOR_UNITS: Mapping[str, str] = {
    **dict.fromkeys(("u", "v", "w"), "m/s"),
    **dict.fromkeys(("p", "q", "r"), "1/s"),
    **dict.fromkeys(("phi", "theta", "delta", "dr", "ds", "db"), "1"),
}
_LATEX = {name: f"\\{name}" for name in ("phi", "theta", "delta")}
_LATEX |= {f"d{side}": rf"\delta_{side}" for side in "rsb"}
_GREEK = frozenset(
    {"alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda"}
    | {"mu", "nu", "xi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega"}
)
_SYMBOLS = "|".join(sorted(FACTOR_UNITS, key=len, reverse=True))
_FACTOR = re.compile(rf"(abs)?({_SYMBOLS})")
_NAME = re.compile(rf"([XYZKMN])_(?:0|((?:(?:abs)?(?:{_SYMBOLS}))+?)(dot)?)")


@dataclass(frozen=True)
class Factor:
    """One factor of a term: a symbol, as it is or as its absolute value."""

    symbol: str
    absolute: bool = False


@dataclass(frozen=True)
class Derivative:
    """What the name of a hydrodynamic derivative says.

    Parameters
    ----------
    name : str
        The name, for instance ``"Z_absww"``.
    axis : str
        ``X Y Z K M`` or ``N``.
    factors : tuple of Factor
        In the order of the name; empty for a constant.
    is_dot : bool
        Whether the only factor is an acceleration.

    Examples
    --------
    >>> derivative = parse("N_absvr")
    >>> derivative.axis, [factor.symbol for factor in derivative.factors]
    ('N', ['v', 'r'])
    >>> derivative.description
    'yaw moment per |v|r'
    """

    name: str
    axis: str
    factors: tuple[Factor, ...]
    is_dot: bool = False

    @property
    def dimension(self) -> Dimension:
        """Dimension of the axis divided by that of the factors."""
        total = dimension("N" if self.axis in "XYZ" else "N m")
        for factor in self.factors:
            total = total / dimension(FACTOR_UNITS[factor.symbol])
        return total * dimension("s") if self.is_dot else total

    @property
    def description(self) -> str:
        """Words for a table, such as ``heave force per w|w|``."""
        return AXES[self.axis] + (f" per {self.product_text}" if self.factors else ", constant")

    @property
    def product_text(self) -> str:
        """The factors as a reader writes them: ``w|w|``, ``u^2 ds``."""
        pieces = []
        for factor, power in _powers(self._printed_order()):
            symbol = self.symbol(factor)
            text = f"|{symbol}|" if factor.absolute else symbol
            pieces.append(text if power == 1 else f"{text}^{power}")
        return " ".join(pieces).replace(" |", "|").replace("| ", "|")

    @property
    def latex(self) -> str:
        r"""LaTeX without dollar signs, such as ``Z_{w|w|}``."""
        if not self.factors:
            return f"{self.axis}_{{0}}"
        if self.is_dot:
            return f"{self.axis}_{{\\dot{{{self.factors[0].symbol}}}}}"
        pieces = []
        for factor in self._printed_order():
            symbol = _LATEX.get(factor.symbol, factor.symbol)
            pieces.append(f"|{symbol}|" if factor.absolute else symbol)
        return f"{self.axis}_{{{_glue(pieces)}}}"

    def symbol(self, factor: Factor) -> str:
        """Name of a factor's signal, ``wdot`` for an acceleration."""
        return f"{factor.symbol}dot" if self.is_dot else factor.symbol

    def _printed_order(self) -> tuple[Factor, ...]:
        """Factors with ``|w| w`` turned into the printed order ``w |w|``."""
        ordered = list(self.factors)
        for i in range(len(ordered) - 1):
            first, second = ordered[i], ordered[i + 1]
            if first.absolute and not second.absolute and first.symbol == second.symbol:
                ordered[i], ordered[i + 1] = second, first
        return tuple(ordered)


def _powers(factors: tuple[Factor, ...]) -> list[tuple[Factor, int]]:
    """Equal neighbours with their number: u u ds is u twice and ds once."""
    return [(factor, len(list(group))) for factor, group in groupby(factors)]


def _glue(pieces: list[str]) -> str:
    r"""Join LaTeX symbols, with a space where ``\phi u`` would read ``\phiu``."""
    text = ""
    for piece in pieces:
        needs_space = re.search(r"\\[a-z]+$", text) and piece[0].isalpha()
        text += f" {piece}" if needs_space else piece
    return text


def is_derivative(name: str) -> bool:
    """Tell whether a name follows the notation.

    Examples
    --------
    >>> is_derivative("Z_uuds"), is_derivative("zgW"), is_derivative("M_wqdot")
    (True, False, False)
    """
    try:
        parse(name)
    except ModelError:
        return False
    return True


@lru_cache(maxsize=1024)
def parse(name: str) -> Derivative:
    """Read the name of a hydrodynamic derivative.

    Raises
    ------
    ModelError
        If the name does not follow the notation.

    Examples
    --------
    >>> parse("Z_wdot").is_dot, parse("X_uu").factors[1]
    (True, Factor(symbol='u', absolute=False))
    """
    if not isinstance(name, str) or len(name) > MOST_CHARACTERS:
        raise ModelError(SAYS["no_name"].format(name=name, most=MOST_CHARACTERS))
    match = _NAME.fullmatch(name)
    if match is None:
        raise ModelError(SAYS["no_derivative"].format(name=name, factors=" ".join(FACTOR_UNITS)))
    axis, text, dot = match.groups()
    found = _FACTOR.findall(text or "")
    factors = tuple(Factor(symbol, bool(absolute)) for absolute, symbol in found)
    if dot and (len(factors) != 1 or factors[0].absolute or factors[0].symbol not in "uvwpqr"):
        raise ModelError(SAYS["no_acceleration"].format(name=name, text=text))
    return Derivative(name, axis, factors, bool(dot))


def unit(name: str) -> str:
    """SI unit of a derivative, radians dropped.

    Examples
    --------
    >>> [unit(name) for name in ("Z_uw", "M_uq", "Z_qdot", "M_qdot", "Z_w", "K_phi")]
    ['kg/m', 'kg m', 'kg m', 'kg m^2', 'kg/s', 'N m']
    """
    return str(parse(name).dimension)


def prime_exponents(name: str) -> tuple[int, int]:
    r"""Exponents n and k of the prime system, :math:`Y' = Y/(\rho/2\, L^n U^k)`.

    Examples
    --------
    >>> prime_exponents("Y_v"), prime_exponents("N_r"), prime_exponents("Z_wdot")
    ((2, 1), (4, 1), (3, 0))
    """
    powers = parse(name).dimension.powers
    metres, seconds = powers.get("m", 0), powers.get("s", 0)
    return int(metres + 3 + seconds), int(-seconds)


def prime_scale(name: str, *, density: float, length: float, speed: float) -> float:
    r"""Return the divisor that makes a derivative dimensionless.

    .. math:: Y' = \frac{Y}{\frac{\rho}{2} L^n U^k}

    Parameters
    ----------
    name : str
        Name of the derivative.
    density : float
        Water density :math:`\rho` in kg/m^3.
    length : float
        Reference length :math:`L` in m.
    speed : float
        Reference speed :math:`U` in m/s.

    Returns
    -------
    float
        The scale, in the unit of the derivative.

    References
    ----------
    .. [1] SNAME (1950), Bulletin 1-5, the prime system.

    Examples
    --------
    Added mass of the NPS AUV II, Z'_wdot = -0.24 with L = 5.3 m, in kg:

    >>> round(-0.24 * prime_scale("Z_wdot", density=1025.0, length=5.3, speed=1.5))
    -18312
    """
    n, k = prime_exponents(name)
    return 0.5 * density * length**n * speed**k


def latex(name: str) -> str:
    r"""LaTeX symbol of any parameter, without dollar signs.

    A name that ends in ``_prime`` is a nondimensional number and gets a prime.

    Examples
    --------
    >>> [latex(name) for name in ("Z_absww", "N_absvr", "M_uuds", "Z_wdot", "tau_max")]
    ['Z_{w|w|}', 'N_{|v|r}', 'M_{uu\\delta_s}', 'Z_{\\dot{w}}', '\\tau_{max}']
    """
    if name.endswith("_prime"):
        head, mark, rest = latex(name.removesuffix("_prime")).partition("_")
        return f"{head}'{mark}{rest}"
    if is_derivative(name):
        return parse(name).latex
    symbol, _, index = name.partition("_")
    if symbol in _GREEK:
        symbol = f"\\{symbol}"
    elif len(symbol) > 1:
        symbol = f"\\mathrm{{{symbol}}}"
    index = f"\\{index}" if index in _GREEK else index.replace("_", ",")
    return f"{symbol}_{{{index}}}" if index else symbol


def term(name: str, *, symbols: Mapping[str, str] | None = None) -> str:
    """Write the term of a derivative as an expression.

    Parameters
    ----------
    name : str
        Name of the derivative.
    symbols : mapping of str to str, optional
        Other names for factors, for instance ``{"w": "w_r"}`` for the velocity
        through the water.

    Examples
    --------
    >>> term("Z_absww"), term("M_uuds"), term("Z_wdot")
    ('Z_absww*abs(w)*w', 'M_uuds*u**2*ds', 'Z_wdot*wdot')
    >>> term("Z_uw", symbols={"u": "u_r", "w": "w_r"})
    'Z_uw*u_r*w_r'
    """
    derivative = parse(name)
    pieces = [name]
    for factor, power in _powers(derivative.factors):
        symbol = derivative.symbol(factor)
        symbol = (symbols or {}).get(symbol, symbol)
        text = f"abs({symbol})" if factor.absolute else symbol
        pieces.append(text if power == 1 else f"{text}**{power}")
    return "*".join(pieces)


def term_text(name: str) -> str:
    """Write the term of a derivative for a reader.

    Examples
    --------
    >>> term_text("Z_absww"), term_text("Z_uuds")
    ('Z_absww w|w|', 'Z_uuds u^2 ds')
    """
    return f"{name} {parse(name).product_text}".rstrip()
