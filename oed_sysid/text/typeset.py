"""Expressions as a reader writes them: plain text and LaTeX; people's words in generated code.

Sums and products are flattened first, so that signs are collected in front
and no parentheses remain that only the syntax tree needed.
"""

from __future__ import annotations

import ast
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from oed_sysid.text import notation
from oed_sysid.text.units import SPELLINGS

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_COMPARE_TEXT = {ast.Lt: "<", ast.LtE: "≤", ast.Gt: ">", ast.GtE: "≥"}
_COMPARE_LATEX = {ast.Lt: "<", ast.LtE: r"\le", ast.Gt: ">", ast.GtE: r"\ge"}
_LATEX_FUNCTIONS = frozenset(("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "min", "max"))
_LATEX_NAMES = {
    "asin": r"\arcsin",
    "acos": r"\arccos",
    "atan": r"\arctan",
    "log": r"\ln",
    "sign": r"\operatorname{sgn}",
}


@dataclass
class Product:
    """A flattened product: sign, factors above and below the line."""

    negative: bool = False
    above: list[ast.expr] = field(default_factory=list)
    below: list[ast.expr] = field(default_factory=list)


def terms(node: ast.expr, negative: bool = False) -> list[Product]:
    """Flatten a sum into signed products."""
    match node:
        case ast.BinOp(op=ast.Add()):
            return terms(node.left, negative) + terms(node.right, negative)
        case ast.BinOp(op=ast.Sub()):
            return terms(node.left, negative) + terms(node.right, not negative)
        case ast.UnaryOp(op=ast.USub()):
            return terms(node.operand, not negative)
        case ast.UnaryOp(op=ast.UAdd()):
            return terms(node.operand, negative)
    product = Product(negative)
    _collect(node, product, above=True)
    return [product]


def _collect(node: ast.expr, product: Product, *, above: bool) -> None:
    match node:
        case ast.BinOp(op=ast.Mult()):
            _collect(node.left, product, above=above)
            _collect(node.right, product, above=above)
        case ast.BinOp(op=ast.Div()):
            _collect(node.left, product, above=above)
            _collect(node.right, product, above=not above)
        case ast.UnaryOp(op=ast.USub()):
            product.negative = not product.negative
            _collect(node.operand, product, above=above)
        case _:
            (product.above if above else product.below).append(node)


class Printer(ABC):
    """Writes a syntax tree; what differs between the kinds of print is abstract."""

    def sum(self, node: ast.expr) -> str:
        """Write any expression."""
        if isinstance(node, ast.Compare):
            return self.comparison(node)
        if isinstance(node, ast.BoolOp):
            word = self.word("and" if isinstance(node.op, ast.And) else "or")
            return word.join(self.condition(value) for value in node.values)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return f"{self.word('not').lstrip()}{self.condition(node.operand)}"
        text = ""
        for product in terms(node):
            if text:
                text += " - " if product.negative else " + "
            elif product.negative:
                text = "-"
            text += self.product(product)
        return text

    def condition(self, node: ast.expr) -> str:
        """Write a condition so that it can stand beside ``and``, ``or`` and ``not``."""
        text = self.sum(node)
        return self.parentheses(text) if isinstance(node, ast.BoolOp) else text

    def factor(self, node: ast.expr) -> str:
        """Write an expression so that it can stand in a product."""
        match node:
            case ast.Constant():
                return self.number(float(node.value))  # type: ignore[arg-type]
            case ast.Name():
                return self.name(node.id)
            case ast.Call():
                return self.call(node.func.id, node.args)  # type: ignore[attr-defined]
            case ast.BinOp(op=ast.Pow()):
                return self.power(node.left, node.right)
        return self.parentheses(self.sum(node))

    def base(self, node: ast.expr) -> str:
        """Write an expression so that an exponent can follow."""
        simple = isinstance(node, ast.Name | ast.Constant | ast.Call)
        return self.factor(node) if simple else self.parentheses(self.sum(node))

    @abstractmethod
    def product(self, product: Product) -> str:
        """Write a product without its sign."""

    @abstractmethod
    def comparison(self, node: ast.Compare) -> str:
        """Write a condition."""

    @abstractmethod
    def word(self, word: str) -> str:
        """Write ``and``, ``or`` or ``not`` with the space around it."""

    @abstractmethod
    def number(self, value: float) -> str:
        """Write a number."""

    @abstractmethod
    def name(self, name: str) -> str:
        """Write a symbol."""

    @abstractmethod
    def call(self, function: str, arguments: list[ast.expr]) -> str:
        """Write a function of arguments."""

    @abstractmethod
    def power(self, base: ast.expr, exponent: ast.expr) -> str:
        """Write a power."""

    @abstractmethod
    def parentheses(self, text: str) -> str:
        """Put parentheses around a sum."""


class TextPrinter(Printer):
    """``Z_absww w |w| - m g sin(theta)²``."""

    def product(self, product: Product) -> str:
        """Factors side by side; a dot keeps two numbers apart."""
        single = len(product.above) == 1 and not product.below
        pieces = [
            self.sum(node) if single and isinstance(node, ast.Compare) else self.factor(node)
            for node in product.above
        ]
        text = self._joined(pieces) or "1"
        if not product.below:
            return text
        below = self._joined([self.factor(node) for node in product.below])
        return f"{text}/{below}" if len(product.below) == 1 else f"{text}/({below})"

    @staticmethod
    def _joined(pieces: list[str]) -> str:
        text = ""
        for piece in pieces:
            text += (" · " if piece[0].isdigit() else " ") if text else ""
            text += piece
        return text

    def comparison(self, node: ast.Compare) -> str:
        """Write ``a ≤ b``."""
        symbol = _COMPARE_TEXT[type(node.ops[0])]
        return f"{self.sum(node.left)} {symbol} {self.sum(node.comparators[0])}"

    def word(self, word: str) -> str:
        """`` and ``."""
        return f" {word} "

    def number(self, value: float) -> str:
        """Six significant digits."""
        return f"{value:g}"

    def name(self, name: str) -> str:
        """Return the name as it is."""
        return name

    def call(self, function: str, arguments: list[ast.expr]) -> str:
        """``|x|`` for the absolute value, ``f(x, y)`` otherwise."""
        inner = ", ".join(self.sum(argument) for argument in arguments)
        return f"|{inner}|" if function == "abs" else f"{function}({inner})"

    def power(self, base: ast.expr, exponent: ast.expr) -> str:
        """Superscripts for whole numbers."""
        text = self.sum(exponent)
        if text.lstrip("-").isdigit():
            return self.base(base) + text.translate(_SUPERSCRIPT)
        simple = isinstance(exponent, ast.Name | ast.Constant)
        return f"{self.base(base)}^{text if simple else self.parentheses(text)}"

    def parentheses(self, text: str) -> str:
        """``(text)``."""
        return f"({text})"


class LatexPrinter(Printer):
    r"""``Z_{w|w|} w \left|w\right| - m g \sin^{2}\theta``, without dollar signs."""

    def product(self, product: Product) -> str:
        """Thin juxtaposition, and a fraction where something is below the line."""
        alone = len(product.above) == 1
        pieces = [self.sum(n) if alone and product.below else self.factor(n) for n in product.above]
        text = self._joined(pieces) or "1"
        if not product.below:
            return text
        below = self.sum(product.below[0]) if len(product.below) == 1 else None
        below = below or self._joined([self.factor(node) for node in product.below])
        return f"\\frac{{{text}}}{{{below}}}"

    @staticmethod
    def _joined(pieces: list[str]) -> str:
        text = ""
        for piece in pieces:
            text += (r" \cdot " if piece[0].isdigit() else r" \, ") if text else ""
            text += piece
        return text

    def comparison(self, node: ast.Compare) -> str:
        r"""Write ``a \le b``."""
        symbol = _COMPARE_LATEX[type(node.ops[0])]
        return f"{self.sum(node.left)} {symbol} {self.sum(node.comparators[0])}"

    def word(self, word: str) -> str:
        r"""``\land``, ``\lor`` or ``\lnot``."""
        return {"and": r" \land ", "or": r" \lor ", "not": r" \lnot "}[word]

    def number(self, value: float) -> str:
        """Six significant digits, powers of ten written out."""
        mantissa, _, exponent = f"{value:g}".partition("e")
        if not exponent:
            return mantissa
        power = f"10^{{{int(exponent)}}}"
        return power if mantissa == "1" else rf"{mantissa} \cdot {power}"

    def name(self, name: str) -> str:
        """Symbol of a parameter or signal, as the notation has it."""
        if name == "pi":
            return r"\pi"
        kind, _, inside = name.removesuffix(")").partition("(")
        if inside and kind == "dot":
            return rf"\dot{{{notation.latex(inside)}}}"
        if inside:
            axis, _, effect = inside.partition(", ")
            spelled = effect.replace("_", r"\_")
            return rf"{axis}_{{\mathrm{{{spelled}}}}}" if effect else rf"\Sigma {axis}"
        return notation.latex(name)

    def call(self, function: str, arguments: list[ast.expr]) -> str:
        """Bars, roots and cases have their own form."""
        inner = [self.sum(argument) for argument in arguments]
        if function == "abs":
            return rf"\left|{inner[0]}\right|"
        if function == "floor":
            return rf"\left\lfloor {inner[0]} \right\rfloor"
        if function == "sqrt":
            return rf"\sqrt{{{inner[0]}}}"
        if function == "where":
            rows = rf"{inner[1]} & {inner[0]} \\ {inner[2]} & \text{{otherwise}}"
            return rf"\begin{{cases}} {rows} \end{{cases}}"
        return self._function(function) + self.parentheses(", ".join(inner))

    @staticmethod
    def _function(name: str) -> str:
        if name in _LATEX_FUNCTIONS:
            return f"\\{name}"
        spelled = name.replace("_", r"\_")
        return _LATEX_NAMES.get(name, rf"\operatorname{{{spelled}}}")

    def power(self, base: ast.expr, exponent: ast.expr) -> str:
        """Exponents in braces."""
        return f"{self.base(base)}^{{{self.sum(exponent)}}}"

    def parentheses(self, text: str) -> str:
        r"""``\left(text\right)``."""
        return rf"\left({text}\right)"


# -- words of people in generated code --------------------------------------------------


def safe(text: str, also: str = "") -> str:
    """Text that ends no comment and no string and begins no code, in any language of this package.

    Letters, digits, spaces and ``_ . + -`` stay; other letters become their number, anything
    else an underscore. The text itself stands in the JSON file beside the code.

    Parameters
    ----------
    text : str
        What somebody called something.
    also : str
        Characters that stay too.

    Examples
    --------
    >>> safe('dive 1 */ int main(void) {')
    'dive 1 __ int main_void_ _'
    >>> safe("ψ_0")
    'u03c8_0'
    """

    def one(character: str) -> str:
        if character.isascii() and (character.isalnum() or character in f" _.+-{also}"):
            return character
        return f"u{ord(character):04x}" if character.isalnum() else "_"

    return "".join(map(one, str(text)))


def safe_unit(unit: str) -> str:
    """A unit in ASCII, without signs that mean something in code.

    >>> safe_unit("kg·m²/°"), safe_unit("%")
    ('kg m^2/deg', 'percent')
    """
    for spelling, symbol in {**SPELLINGS, "°": "deg", "%": "percent"}.items():
        unit = unit.replace(spelling, symbol)
    return safe(re.sub(r"[·*\s]+", " ", unit.replace("**", "^")), "/^()")
