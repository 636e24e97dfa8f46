"""The physical dimension of an expression, from those of its names.

A name without a stated unit is unknown; unknown is allowed anywhere and
spreads, so that only what can be derived is checked. Bare numbers are
dimensionless, except zero and numbers so small that they only guard a
division.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping

from oed_sysid.errors import ModelError
from oed_sysid.language import expressions
from oed_sysid.language.units import Dimension

_GUARD = 1e-6
LARGEST_POWER = 100
_SAME = ("abs", "floor", "min", "max", "clip", "where")
_RATIO = ("atan2",)


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
        ``None`` where it cannot be derived.

    Raises
    ------
    ModelError
        If unlike quantities are added or compared, or a function such as
        ``sin`` is given something that has a dimension.

    Examples
    --------
    >>> from oed_sysid.language.units import dimension
    >>> known = {"Z_absww": dimension("kg/m"), "w": dimension("m/s"), "q": dimension("rad/s")}
    >>> str(dimension_of("Z_absww*w*abs(w)", known))
    'N'
    >>> dimension_of("w + q", known)
    Traceback (most recent call last):
    oed_sysid.errors.ModelError: In 'w + q', m/s meets rad/s. Check the units of the parameters.
    """
    return _Walk(expression, dimensions).of(expressions.parse(expression))


class _Walk:
    """One pass over a syntax tree; the whole expression is kept for messages."""

    def __init__(self, expression: str, dimensions: Mapping[str, Dimension | None]) -> None:
        self.expression = expression
        self.dimensions = dimensions

    def of(self, node: ast.expr) -> Dimension | None:
        match node:
            case ast.Constant():
                return None if abs(node.value) <= _GUARD else Dimension()  # type: ignore[arg-type]
            case ast.Name():
                return Dimension() if node.id == "pi" else self.dimensions.get(node.id)
            case ast.BoolOp():
                for value in node.values:
                    self.of(value)
                return Dimension()
            case ast.UnaryOp():
                return self.of(node.operand)
            case ast.BinOp():
                return self._binary(node)
            case ast.Compare():
                self._same([self.of(node.left), self.of(node.comparators[0])])
                return Dimension()
            case ast.Call():
                return self._call(node)
        return None

    def _binary(self, node: ast.BinOp) -> Dimension | None:
        left, right = self.of(node.left), self.of(node.right)
        if isinstance(node.op, ast.Add | ast.Sub):
            return self._same([left, right])
        if isinstance(node.op, ast.Pow):
            self._same([right, Dimension()])
            if left is None or left.is_dimensionless:
                return left
            try:
                power = float(ast.literal_eval(node.right))
            except (ValueError, TypeError, SyntaxError, OverflowError):
                raise ModelError(
                    f"In {self.expression!r}, {left} has an exponent that is not a number."
                ) from None
            if not abs(power) <= LARGEST_POWER:
                raise ModelError(
                    f"In {self.expression!r}, {left} has the exponent {power:g}: expected one "
                    f"between -{LARGEST_POWER} and {LARGEST_POWER}."
                )
            return left**power
        if left is None or right is None:
            return None
        return left * right if isinstance(node.op, ast.Mult) else left / right

    def _call(self, node: ast.Call) -> Dimension | None:
        name = node.func.id  # type: ignore[attr-defined]
        arguments = [self.of(argument) for argument in node.args]
        if name in _SAME:
            return self._same(arguments[1:] if name == "where" else arguments)
        if name in _RATIO:
            self._same(arguments)
            return Dimension()
        if name == "sign":
            return Dimension()
        if name == "sqrt":
            return None if arguments[0] is None else arguments[0] ** 0.5
        if name in expressions.FUNCTIONS:
            self._same([*arguments, Dimension()])
            return Dimension()
        return None  # a table: neither axis states a unit

    def _same(self, dimensions: list[Dimension | None]) -> Dimension | None:
        known = [dimension for dimension in dimensions if dimension is not None]
        for other in known[1:]:
            if other != known[0]:
                raise ModelError(
                    f"In {self.expression!r}, {known[0]} meets {other}. "
                    "Check the units of the parameters."
                )
        return known[0] if known else None
