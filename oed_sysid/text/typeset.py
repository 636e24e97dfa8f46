"""Expressions as a reader writes them: plain text and LaTeX; people's words in generated code.

Sums and products are flattened first, so that signs are collected in front
and no parentheses remain that only the syntax tree needed.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass, field
from typing import ClassVar

from oed_sysid.text import notation
from oed_sysid.text.units import SPELLINGS

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LATEX_FUNCTIONS = frozenset(("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "min", "max"))
_LATEX_FORMS = {
    "abs": r"\left|{0}\right|",
    "floor": r"\left\lfloor {0} \right\rfloor",
    "sqrt": r"\sqrt{{{0}}}",
    "where": r"\begin{{cases}} {1} & {0} \\ {2} & \text{{otherwise}} \end{{cases}}",
}
_LATEX_NAMES = {"log": r"\ln", "sign": r"\operatorname{sgn}"}
_LATEX_NAMES |= {f"a{name}": rf"\arc{name}" for name in ("sin", "cos", "tan")}


@dataclass
class Product:
    """A flattened product: sign, factors above and below the line."""

    negative: bool = False
    above: list[ast.expr] = field(default_factory=list)
    below: list[ast.expr] = field(default_factory=list)

    def multiply(self, node: ast.expr, *, above: bool = True) -> None:
        """Multiply by the factors of an expression, or divide by them."""
        match node:
            case ast.BinOp(op=ast.Mult() | ast.Div()):
                self.multiply(node.left, above=above)
                self.multiply(node.right, above=above is isinstance(node.op, ast.Mult))
            case ast.UnaryOp(op=ast.USub() | ast.UAdd()):
                self.negative ^= isinstance(node.op, ast.USub)
                self.multiply(node.operand, above=above)
            case _:
                (self.above if above else self.below).append(node)


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
    product.multiply(node)
    return [product]


class TextPrinter:
    """Writes a syntax tree as plain text, ``Z_absww w |w| - m g sin(theta)²``."""

    # Between factors, between a factor and a number; what opens and closes; words of logic.
    gaps, brackets = (" ", " · "), ("(", ")")
    comparisons: ClassVar = {ast.Lt: "<", ast.LtE: "≤", ast.Gt: ">", ast.GtE: "≥"}
    words: ClassVar = {word: f" {word} " for word in ("and", "or", "not")}

    def sum(self, node: ast.expr) -> str:
        """Write any expression."""
        if isinstance(node, ast.Compare):
            return self.comparison(node)
        if isinstance(node, ast.BoolOp):
            word = self.words[type(node.op).__name__.lower()]
            return word.join(self.condition(value) for value in node.values)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return f"{self.words['not'].lstrip()}{self.condition(node.operand)}"
        products = terms(node)
        text = "".join(f" {'-' if one.negative else '+'} {self.product(one)}" for one in products)
        return "-" * products[0].negative + text[3:]

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

    def product(self, product: Product) -> str:
        """Write a product without its sign: factors side by side, a mark between two numbers."""
        above = [
            self.sum(node) if self.stands_alone(node, product) else self.factor(node)
            for node in product.above
        ]
        text = self.joined(above) or "1"
        return self.quotient(text, product.below) if product.below else text

    def joined(self, pieces: list[str]) -> str:
        """Factors with what stands between them."""
        others = (self.gaps[piece[0].isdigit()] + piece for piece in pieces[1:])
        return "".join([*pieces[:1], *others])

    def comparison(self, node: ast.Compare) -> str:
        """Write a condition, as ``a ≤ b``."""
        symbol = self.comparisons[type(node.ops[0])]
        return f"{self.sum(node.left)} {symbol} {self.sum(node.comparators[0])}"

    def parentheses(self, text: str) -> str:
        """Put parentheses around a sum."""
        return f"{self.brackets[0]}{text}{self.brackets[1]}"

    def stands_alone(self, node: ast.expr, product: Product) -> bool:
        """Whether a factor needs no parentheses: a condition that is all of its term."""
        return len(product.above) == 1 and not product.below and isinstance(node, ast.Compare)

    def quotient(self, above: str, below: list[ast.expr]) -> str:
        """Write a fraction, ``a/b``."""
        text = self.joined([self.factor(node) for node in below])
        return f"{above}/{text}" if len(below) == 1 else f"{above}/({text})"

    def number(self, value: float) -> str:
        """Write a number, to six significant digits."""
        return f"{value:g}"

    def name(self, name: str) -> str:
        """Write a symbol: the name as it is."""
        return name

    def call(self, function: str, arguments: list[ast.expr]) -> str:
        """Write a function: ``|x|`` for the absolute value, ``f(x, y)`` otherwise."""
        inner = ", ".join(self.sum(argument) for argument in arguments)
        return f"|{inner}|" if function == "abs" else f"{function}({inner})"

    def power(self, base: ast.expr, exponent: ast.expr) -> str:
        """Write a power, with superscripts for whole numbers."""
        text = self.sum(exponent)
        if text.lstrip("-").isdigit():
            return self.base(base) + text.translate(_SUPERSCRIPT)
        simple = isinstance(exponent, ast.Name | ast.Constant)
        return f"{self.base(base)}^{text if simple else self.parentheses(text)}"


class LatexPrinter(TextPrinter):
    r"""LaTeX without dollar signs, ``Z_{w|w|} w \left|w\right| - m g \sin^{2}\theta``."""

    gaps, brackets = (r" \, ", r" \cdot "), (r"\left(", r"\right)")
    comparisons: ClassVar = {ast.Lt: "<", ast.LtE: r"\le", ast.Gt: ">", ast.GtE: r"\ge"}
    words: ClassVar = {"and": r" \land ", "or": r" \lor ", "not": r" \lnot "}

    def stands_alone(self, node: ast.expr, product: Product) -> bool:
        """All that is above a line."""
        return len(product.above) == 1 and bool(product.below)

    def quotient(self, above: str, below: list[ast.expr]) -> str:
        r"""``\frac{a}{b}``."""
        alone = len(below) == 1
        text = self.sum(below[0]) if alone else self.joined([self.factor(node) for node in below])
        return f"\\frac{{{above}}}{{{text}}}"

    def number(self, value: float) -> str:
        """Powers of ten written out."""
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
        if function in _LATEX_FORMS:
            return _LATEX_FORMS[function].format(*inner)
        spelled = function.replace("_", r"\_")
        known = f"\\{function}" if function in _LATEX_FUNCTIONS else rf"\operatorname{{{spelled}}}"
        return _LATEX_NAMES.get(function, known) + self.parentheses(", ".join(inner))

    def power(self, base: ast.expr, exponent: ast.expr) -> str:
        """Exponents in braces."""
        return f"{self.base(base)}^{{{self.sum(exponent)}}}"


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
