r"""The physical dimension of an expression, from those of its names.

A bare number may carry any unit: in ``0.5*1025*2500*U*v`` a density and an
area stand as numbers. Its unit is an unknown :math:`x_i` in the exponents of
kg, m, s, A and K. Every part of an expression has a dimension of the form

.. math:: d + \sum_i c_i x_i,

products add such forms, powers scale them, and whatever is added, compared or
given a unit makes two of them equal: linear equations, solved as they come.
What they leave open is dimensionless. An equation between two different
dimensions in which no number is left that could mend it is an error.

A name without a stated unit is unknown; unknown is allowed anywhere and
spreads, so that only what can be derived is checked.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

from oed_sysid.errors import ModelError
from oed_sysid.text import expressions
from oed_sysid.text.expressions import CONSTANTS, NUMERIC, walk
from oed_sysid.text.typeset import Product
from oed_sysid.text.units import LARGEST_EXPONENT, Dimension

_SAME = ("abs", "floor", "min", "max", "clip", "where")


@dataclass(frozen=True)
class _Number:
    """A bare number whose unit is deduced; without a text it is something else unknown."""

    text: str = ""
    where: str = ""
    plain: bool = False


class Deduction:
    """The units of the bare numbers of expressions that belong together, such as a model's.

    Examples
    --------
    >>> from oed_sysid.text.units import dimension
    >>> units = Deduction()
    >>> known = {"U": dimension("m/s"), "v": dimension("m/s")}
    >>> force = units.form("0.5*1025*2500*U*v", known, where="hull")
    >>> units.equal(force, dimension("N"))
    True
    >>> units.notes()
    ('hull: 0.5*1025*2500 is read as kg/m.',)
    """

    def __init__(self) -> None:
        self._numbers: list[_Number] = []
        self._found: dict[int, Dimension] = {}

    def copy(self) -> Deduction:
        """What is known so far, to go on from without a trace."""
        other = Deduction()
        other._numbers, other._found = list(self._numbers), dict(self._found)
        return other

    def form(
        self, expression: str, known: Mapping[str, Dimension | None], *, where: str = ""
    ) -> Dimension | None:
        """Dimension of an expression; ``None`` where a name without a unit decides it.

        Raises
        ------
        ModelError
            As :func:`dimension_of`.
        """
        walk = _Walk(self, expression, known, where)
        form = self.reduced(walk.of(walk.tree))
        is_open = any(not self._text(index) for index in form.unknown)
        return None if is_open else form

    def equal(self, one: Dimension, other: Dimension) -> bool:
        """Make two dimensions equal; False where no unit of a number makes them so."""
        rest = self.reduced(one / other)
        if not rest.unknown:
            return rest.is_dimensionless
        # What is no number first, then numbers that look measured, then 1, 2 and 0.5.
        pivot = min(rest.unknown, key=lambda i: (self._numbers[i].plain, bool(self._text(i)), -i))
        power = rest.unknown[pivot]
        self._found[pivot] = (rest / self.number(pivot) ** power) ** (-1 / power)
        return True

    def reduced(self, form: Dimension) -> Dimension:
        """The form with every unit that has been found put in."""
        while found := [index for index in form.unknown if index in self._found]:
            for index in found:
                form *= (self._found[index] / self.number(index)) ** form.powers[index]
        return form

    def dimension(self, form: Dimension) -> Dimension:
        """Dimension of a form if numbers with an open unit have none."""
        return self.reduced(form).known

    def notes(self) -> tuple[str, ...]:
        """Say which numbers were given a unit, each once; radians are not said."""
        units = self.copy()
        for index, number in enumerate(self._numbers):
            if number.plain:  # 1, 2 and 0.5 have no unit where nothing says one
                units.equal(units.number(index), Dimension())
        lines: list[str] = []
        tied: list[set[int]] = []
        for index, number in enumerate(self._numbers):
            form = units.reduced(units.number(index))
            if not number.text or form.known.is_dimensionless:
                continue
            if not form.unknown:
                lines.append(f"{number.where}: {number.text} is read as {form.plain}.")
            elif all(map(self._text, form.unknown)):
                tied = _merged(tied, {index, *form.unknown})
        lines += [self._tied(group) for group in tied]
        return tuple(dict.fromkeys(lines))

    def _tied(self, group: set[int]) -> str:
        """Say which numbers have units that only fit one another."""
        texts: dict[str, list[str]] = {}
        for index in sorted(group):
            number = self._numbers[index]
            texts.setdefault(number.where, []).append(number.text)
        words = "; ".join(
            f"{where}: {', '.join(dict.fromkeys(each))}" for where, each in texts.items()
        )
        return f"{words} have units that follow from one another; nothing says which."

    def new(self, number: _Number) -> Dimension:
        """An unknown unit more."""
        self._numbers.append(number)
        return self.number(len(self._numbers) - 1)

    def number(self, index: int) -> Dimension:
        """The unit of one number."""
        return Dimension({index: Fraction(1)})

    def _text(self, index: int) -> str:
        return self._numbers[index].text


def _merged(groups: list[set[int]], one: set[int]) -> list[set[int]]:
    """The groups with one more; those that share a member with it become one."""
    return [g for g in groups if not g & one] + [one.union(*(g for g in groups if g & one))]


def dimension_of(expression: str, dimensions: Mapping[str, Dimension | None]) -> Dimension | None:
    """Dimension of an expression.

    Parameters
    ----------
    expression : str
        The expression.
    dimensions : mapping
        Dimension of each name; ``None`` or a missing name means unknown.

    Returns
    -------
    Dimension or None
        ``None`` where it cannot be derived. Bare numbers whose unit nothing
        in the expression says are taken as dimensionless.

    Raises
    ------
    ModelError
        If unlike quantities are added or compared, or a function such as
        ``sin`` is given something that has a dimension, and no unit of a bare
        number would mend it.

    Examples
    --------
    >>> from oed_sysid.text.units import dimension
    >>> known = {"Z_absww": dimension("kg/m"), "w": dimension("m/s"), "q": dimension("rad/s")}
    >>> str(dimension_of("Z_absww*w*abs(w)", known))
    'N'
    >>> str(dimension_of("w + 3.2*q", known))
    'm/s'
    >>> dimension_of("w + q", known)
    Traceback (most recent call last):
    oed_sysid.errors.ModelError: In 'w + q', m/s meets rad/s. Check the units of the parameters.
    """
    units = Deduction()
    form = units.form(expression, dimensions)
    return None if form is None else units.dimension(form)


class _Walk:
    """One pass over a syntax tree; the whole expression is kept for messages."""

    def __init__(
        self, units: Deduction, expression: str, known: Mapping[str, Dimension | None], where: str
    ) -> None:
        self.units = units
        self.expression = expression
        self.known = known
        self.where = where
        self.tree, self.constant, self.numbers = _parts(expression)

    def of(self, node: ast.expr) -> Dimension:
        if id(node) in self.numbers:
            return self._numbers([node], [])
        match node:
            case ast.Name():
                form = Dimension() if node.id in CONSTANTS else self.known.get(node.id)
                return self.units.new(_Number()) if form is None else form
            case ast.UnaryOp():
                return self.of(node.operand)
            case ast.BinOp(op=ast.Mult() | ast.Div()):
                return self._product(node)
            case ast.BinOp(op=ast.Pow()):
                return self._power(node)
            case ast.BinOp():
                return self._same([self.of(node.left), self.of(node.right)])
            case ast.Call():
                return self._call(node)
            case ast.Compare():
                self._same([self.of(node.left), self.of(node.comparators[0])])
                return Dimension()
            case ast.BoolOp():
                for value in node.values:
                    self.of(value)
                return Dimension()
        return self.units.new(_Number())

    def _numbers(self, above: list[ast.expr], below: list[ast.expr]) -> Dimension:
        """The joint unit of the bare numbers of a product."""
        if not above and not below:
            return Dimension()
        # In w/0.05 the number itself has the unit of w.
        first, second = (above, below) if above else (below, above)
        text = "*".join(map(self._written, first))
        text += "".join(f"/{self._written(node)}" for node in second)
        values = [abs(float(walk(node, {}, NUMERIC))) for node in (*above, *below)]
        guard = all(value <= 1e-6 for value in values)  # it only keeps a division from zero
        plain = all(value in (0.5, 1.0, 2.0) for value in values)
        unit = self.units.new(_Number() if guard else _Number(text, self.where, plain))
        return unit if above else unit**-1

    def _written(self, node: ast.expr) -> str:
        text = ast.get_source_segment(self.expression.strip(), node) or ast.unparse(node)
        is_sum = isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub)
        return f"({text})" if is_sum else text

    def _product(self, node: ast.BinOp) -> Dimension:
        product = Product()
        product.multiply(node)
        (above, own), (below, divisors) = map(self._apart, (product.above, product.below))
        form = self._numbers(above, below)
        for factor in own:
            form = form * self.of(factor)
        for factor in divisors:
            form = form / self.of(factor)
        return form

    def _apart(self, factors: Sequence[ast.expr]) -> tuple[list[ast.expr], list[ast.expr]]:
        """Bare numbers, and all other factors."""
        known = self.numbers
        numbers = [factor for factor in factors if id(factor) in known]
        return numbers, [factor for factor in factors if id(factor) not in known]

    def _power(self, node: ast.BinOp) -> Dimension:
        base = self.units.reduced(self.of(node.left))
        if id(node.right) not in self.constant:
            self._same([self.of(node.right), Dimension()])
            if not self.units.equal(base, Dimension()):
                raise ModelError(
                    f"In {self.expression!r}, {base.known} has an exponent that is not a number."
                )
            return Dimension()
        if base.is_dimensionless:
            return base
        power = float(walk(node.right, {}, NUMERIC))
        if not abs(power) <= LARGEST_EXPONENT:
            raise ModelError(
                f"In {self.expression!r}, {base.known} has the exponent {power:g}: expected "
                f"one between -{LARGEST_EXPONENT} and {LARGEST_EXPONENT}."
            )
        return base**power

    def _call(self, node: ast.Call) -> Dimension:
        name = node.func.id  # type: ignore[attr-defined]
        arguments = [self.of(argument) for argument in node.args]
        if name in _SAME:
            return self._same(arguments[1:] if name == "where" else arguments)
        if name == "sqrt":
            return arguments[0] ** 0.5
        if name == "atan2":
            self._same(arguments)
        elif name not in expressions.FUNCTIONS:
            return self.units.new(_Number())  # a table: neither axis states a unit
        elif name != "sign":
            self._same([*arguments, Dimension()])
        return Dimension()

    def _same(self, forms: Iterable[Dimension]) -> Dimension:
        first, *others = forms
        for other in others:
            if not self.units.equal(first, other):
                raise ModelError(
                    f"In {self.expression!r}, {self.units.dimension(first)} meets "
                    f"{self.units.dimension(other)}. Check the units of the parameters."
                )
        return first


@lru_cache(maxsize=4096)
def _parts(expression: str) -> tuple[ast.expr, frozenset[int], frozenset[int]]:
    """The tree, and which of its nodes are constant, and which are bare numbers.

    A part without signals and parameters is constant; it is a bare number if it
    is made of numbers, which pi is not.
    """
    tree = expressions.parse(expression)
    constant: set[int] = set()
    numbers: set[int] = set()

    def look(node: ast.expr) -> None:
        inner = [child for child in ast.iter_child_nodes(node) if isinstance(child, ast.expr)]
        for child in inner:
            look(child)
        own, below = isinstance(node, ast.Constant), {id(child) for child in inner}
        varies = isinstance(node, ast.Name) and node.id not in (*CONSTANTS, *NUMERIC)
        if not varies and below <= constant:
            constant.add(id(node))
            if own or below & numbers:
                numbers.add(id(node))

    look(tree)
    return tree, frozenset(constant), frozenset(numbers)
