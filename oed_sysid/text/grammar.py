"""The grammar of expressions: which functions texts know, what is refused, how trees are walked."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from functools import lru_cache, reduce
from typing import Any

import casadi as ca
import numpy as np

from oed_sysid.errors import ModelError

SYMBOLIC: dict[str, Callable[..., Any]] = {
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "asin": ca.asin,
    "acos": ca.acos,
    "atan": ca.atan,
    "atan2": ca.atan2,
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "sqrt": ca.sqrt,
    "exp": ca.exp,
    "log": ca.log,
    "abs": ca.fabs,
    "sign": ca.sign,
    "floor": ca.floor,
    "min": lambda *x: reduce(ca.fmin, x),
    "max": lambda *x: reduce(ca.fmax, x),
    "clip": lambda x, low, high: ca.fmin(ca.fmax(x, low), high),
    "where": ca.if_else,
    "and": lambda *x: reduce(ca.logic_and, x),
    "or": lambda *x: reduce(ca.logic_or, x),
    "not": ca.logic_not,
}
NUMERIC: dict[str, Callable[..., Any]] = {
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "abs": np.abs,
    "sign": np.sign,
    "floor": np.floor,
    "min": lambda *x: reduce(np.minimum, x),
    "max": lambda *x: reduce(np.maximum, x),
    "clip": lambda x, low, high: np.minimum(np.maximum(x, low), high),
    "where": np.where,
    "and": lambda *x: reduce(np.logical_and, x),
    "or": lambda *x: reduce(np.logical_or, x),
    "not": np.logical_not,
}
FUNCTIONS = tuple(name for name in SYMBOLIC if name not in ("and", "or", "not"))
CONSTANTS = {"pi": math.pi}
MANY = ("min", "max")  # two arguments or more
ARGUMENT_COUNT = {"atan2": 2, "min": 2, "max": 2, "where": 3, "clip": 3}
_PARTS = (ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Call, ast.Name, ast.Constant, ast.Compare)
_LESS = (ast.operator, ast.unaryop, ast.boolop, ast.cmpop, ast.expr_context)

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: lambda a, b: a < b,
    ast.LtE: lambda a, b: a <= b,
    ast.Gt: lambda a, b: a > b,
    ast.GtE: lambda a, b: a >= b,
}


def walk(node: ast.expr, scope: Mapping[str, Any], library: Mapping[str, Callable]) -> Any:
    """Value of a tree from the values of its names, by the functions of a library."""
    match node:
        case ast.Constant():
            return float(node.value)  # type: ignore[arg-type]
        case ast.Name():
            return CONSTANTS[node.id] if node.id in CONSTANTS else scope[node.id]
        case ast.UnaryOp(op=ast.Not()):
            return library["not"](walk(node.operand, scope, library))
        case ast.UnaryOp():
            value = walk(node.operand, scope, library)
            return -value if isinstance(node.op, ast.USub) else value
        case ast.BinOp():
            if isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant):
                base, power = walk(node.left, scope, library), node.right.value
                # Products have simpler derivatives than a general power.
                return base * base if power == 2 else base**power
            operator = _BINARY[type(node.op)]
            return operator(walk(node.left, scope, library), walk(node.right, scope, library))
        case ast.Compare():
            return _COMPARE[type(node.ops[0])](
                walk(node.left, scope, library), walk(node.comparators[0], scope, library)
            )
        case ast.BoolOp():
            join = library["and" if isinstance(node.op, ast.And) else "or"]
            return join(*(walk(value, scope, library) for value in node.values))
        case ast.Call():
            function = library[node.func.id]  # type: ignore[attr-defined]
            return function(*(walk(argument, scope, library) for argument in node.args))
    raise ModelError(f"Expression node {type(node).__name__} is not known.")


# Beyond these a text is not what a person wrote, and would exhaust the stack.
MOST_CHARACTERS, DEEPEST = 20_000, 150
_INSTEAD = {
    ast.BitXor: "Write ** for a power.",
    ast.Mod: "Write a - b*floor(a/b) for what repeats.",
    ast.FloorDiv: "Write floor(a/b), or / for a quotient.",
    ast.MatMult: "Write * for a product.",
}


def parse(expression: str) -> ast.expr:
    """Parse one expression.

    Parameters
    ----------
    expression : str
        Python arithmetic over names and the functions of this module.

    Returns
    -------
    ast.expr
        The syntax tree.

    Raises
    ------
    ModelError
        If the text is not an expression of the allowed kind.
    """
    if not isinstance(expression, str):
        raise ModelError(
            f"An expression is text, but this is a {type(expression).__name__}: "
            f"{expression!r:.60}. Put it in quotation marks."
        )
    return _parse(expression)


@lru_cache(maxsize=4096)
def _parse(expression: str) -> ast.expr:
    shown = f"Expression {expression!r:.200}"
    if len(expression) > MOST_CHARACTERS:
        raise ModelError(
            f"{shown} has {len(expression)} characters, more than {MOST_CHARACTERS}. Name parts of "
            "it in definitions or signals."
        )
    try:
        tree = ast.parse(expression.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ModelError(
            f"{shown} cannot be read ({getattr(error, 'msg', error)}). "
            "Write ordinary arithmetic, for instance 'Z_absww*w*abs(w)'."
        ) from None
    level, depth = [tree], 0
    while level:
        depth += 1
        level = [child for node in level for child in ast.iter_child_nodes(node)]  # type: ignore[misc]
    if depth > DEEPEST:
        raise ModelError(
            f"{shown} is nested {depth} deep, more than {DEEPEST}. Name parts of it in definitions "
            "or signals."
        )
    tree = _Plain(expression).visit(tree)
    for node in ast.walk(tree):
        if not isinstance(node, (*_PARTS, *_LESS)):
            raise ModelError(
                f"Expression {expression!r} uses {type(node).__name__}, which is not arithmetic. "
                f"Use + - * / **, comparisons and the functions {', '.join(FUNCTIONS)}."
            )
        if isinstance(node, ast.Call) and (not isinstance(node.func, ast.Name) or node.keywords):
            raise ModelError(f"Expression {expression!r} calls something that is not a function.")
        if isinstance(node, ast.Constant) and type(node.value) not in (int, float):
            raise ModelError(f"Expression {expression!r} holds {node.value!r}: expected numbers.")
        _check_operator(node, shown)
    _constant(tree, shown)
    return tree


def _check_operator(node: ast.AST, shown: str) -> None:
    """Refuse operators that look like arithmetic and are none here."""
    if isinstance(node, ast.BinOp) and type(node.op) not in _BINARY:
        raise ModelError(
            f"{shown} uses the operator {type(node.op).__name__}, which is no arithmetic of "
            f"numbers. {_INSTEAD.get(type(node.op), 'Use + - * / and **.')}"
        )
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Invert):
        raise ModelError(f"{shown} uses ~. Write 'not' before a condition.")
    if isinstance(node, ast.Compare) and type(node.ops[0]) not in _COMPARE:
        raise ModelError(
            f"{shown} compares with {type(node.ops[0]).__name__}. Use <, <=, > or >=: two computed "
            "numbers are never exactly equal."
        )


def _constant(node: ast.AST, shown: str) -> float | None:
    """Value of a part without names; refused where it is no finite real number."""
    parts = [
        _constant(child, shown)
        for child in ast.iter_child_nodes(node)
        if isinstance(child, ast.expr) and child is not getattr(node, "func", None)
    ]
    if isinstance(node, ast.Name):
        return CONSTANTS.get(node.id)
    if any(part is None for part in parts):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div) and parts[1] == 0.0:
            raise ModelError(f"{shown} divides by zero.")
        return None
    if isinstance(node, ast.Call) and node.func.id not in FUNCTIONS:  # type: ignore[attr-defined]
        return None
    try:
        with np.errstate(all="ignore"):
            value = walk(node, {}, NUMERIC)  # type: ignore[arg-type]
        number = complex(value)
    except (ArithmeticError, TypeError, ValueError):  # the number of arguments is checked later
        number = complex("nan") if not isinstance(node, ast.Call) else 0j
    if number.imag or not np.isfinite(number.real):
        raise ModelError(
            f"{shown} contains {ast.unparse(node):.60}, which is no finite real number."
        )
    return number.real


class _Plain(ast.NodeTransformer):
    """Rewrite what has a shorter form: conditional, chained comparison, dot and force."""

    def __init__(self, expression: str) -> None:
        self.expression = expression

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        parts = [self.visit(part) for part in (node.test, node.body, node.orelse)]
        return ast.Call(ast.Name("where", ast.Load()), parts, [])

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        sides = [self.visit(side) for side in (node.left, *node.comparators)]
        pairs = [
            ast.Compare(left, [operator], [right])
            for left, operator, right in zip(sides[:-1], node.ops, sides[1:], strict=True)
        ]
        return pairs[0] if len(pairs) == 1 else ast.BoolOp(ast.And(), list(pairs))

    def visit_Call(self, node: ast.Call) -> ast.expr:
        function = node.func.id if isinstance(node.func, ast.Name) else ""
        if function not in ("dot", "force"):
            self.generic_visit(node)
            return node
        texts = [
            part.id
            if isinstance(part, ast.Name)
            else part.value
            if isinstance(part, ast.Constant) and isinstance(part.value, str)
            else ""
            for part in node.args
        ]
        most = 1 if function == "dot" else 2
        if not 1 <= len(texts) <= most or not all(texts) or node.keywords:
            raise ModelError(
                f'Expression {self.expression!r}: write dot(state), as dot(v), and force("axis") '
                'or force("axis", "effect"), as force("Y", "rudder").'
            )
        return ast.Name(f"{function}({', '.join(texts)})", ast.Load())
