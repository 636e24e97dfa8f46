"""Physics written as text: ``"Z_absww * w_r * abs(w_r)"``.

An expression is ordinary Python arithmetic over names. It is parsed once with
:mod:`ast`, checked against a closed list of functions, and then evaluated on
CasADi symbols, on NumPy arrays, as readable text, as LaTeX or as physical
dimensions. Text makes a model printable, comparable, storable and safe to
load, and lets a user write physics without knowing CasADi.

Functions: ``sin cos tan asin acos atan atan2 sinh cosh tanh sqrt exp log abs
sign floor min max clip where``, and the tables and functions that a model or an
effect declares. ``a if c else b`` is ``where(c, a, b)``; conditions are comparisons
joined by ``and``, ``or`` and ``not``; ``pi`` is a number. What a sensor sees may
also name ``dot(state)``, the rate of a state, and ``force("Y")`` or
``force("Y", "effect")``, the sum of all forces on an axis or that of one effect.

Kinks and jumps are allowed, their smoothness is the author's concern: gradients are
exact on either side, and zero where only a condition depends on a parameter.

The grammar of expressions: which functions texts know, what is refused, how trees are walked.
"""

from __future__ import annotations

import ast
import difflib
import math
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache, reduce
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.runtime.constants import LONGEST_LINE
from oed_sysid.text import SAYS, typeset
from oed_sysid.text.callables import Function, Table, library, n_arguments

# -- the grammar of expressions --------------------------------------------------------


# What NumPy calls otherwise than CasADi.
_IN_NUMPY = {"asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2"}
# Every function: on CasADi symbols, and on NumPy arrays.
_LIBRARY: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
    **{
        name: (getattr(ca, name), getattr(np, _IN_NUMPY.get(name, name)))
        for name in (
            *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"),
            *("sqrt", "exp", "log"),
        )
    },
    "abs": (ca.fabs, np.abs),
    "sign": (ca.sign, np.sign),
    "floor": (ca.floor, np.floor),
    "min": (lambda *x: reduce(ca.fmin, x), lambda *x: reduce(np.minimum, x)),
    "max": (lambda *x: reduce(ca.fmax, x), lambda *x: reduce(np.maximum, x)),
    "clip": (
        lambda x, low, high: ca.fmin(ca.fmax(x, low), high),
        lambda x, low, high: np.minimum(np.maximum(x, low), high),
    ),
    "where": (ca.if_else, np.where),
    "and": (lambda *x: reduce(ca.logic_and, x), lambda *x: reduce(np.logical_and, x)),
    "or": (lambda *x: reduce(ca.logic_or, x), lambda *x: reduce(np.logical_or, x)),
    "not": (ca.logic_not, np.logical_not),
}
SYMBOLIC = {name: symbolic for name, (symbolic, _) in _LIBRARY.items()}
NUMERIC = {name: numeric for name, (_, numeric) in _LIBRARY.items()}
# Those that are called by name: logic has words between its operands.
FUNCTIONS = tuple(name for name in _LIBRARY if name not in ("and", "or", "not"))
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
    # Products have simpler derivatives than a general power.
    ast.Pow: lambda a, b: a * a if isinstance(b, float) and b == 2.0 else a**b,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any, Mapping[str, Callable]], Any]] = {
    ast.USub: lambda value, library: -value,
    ast.UAdd: lambda value, library: value,
    ast.Not: lambda value, library: library["not"](value),
}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: lambda a, b: a < b,
    ast.LtE: lambda a, b: a <= b,
    ast.Gt: lambda a, b: a > b,
    ast.GtE: lambda a, b: a >= b,
}


def walk(node: ast.expr, scope: Mapping[str, Any], library: Mapping[str, Callable]) -> Any:
    """Value of a tree from the values of its names, by the functions of a library."""

    def of(*nodes: ast.expr) -> list[Any]:
        return [walk(one, scope, library) for one in nodes]

    match node:
        case ast.Constant():
            return float(node.value)  # type: ignore[arg-type]
        case ast.Name():
            return CONSTANTS[node.id] if node.id in CONSTANTS else scope[node.id]
        case ast.UnaryOp():
            return _UNARY[type(node.op)](of(node.operand)[0], library)
        case ast.BinOp():
            return _BINARY[type(node.op)](*of(node.left, node.right))
        case ast.Compare():
            return _COMPARE[type(node.ops[0])](*of(node.left, node.comparators[0]))
        case ast.BoolOp():
            return library[type(node.op).__name__.lower()](*of(*node.values))
        case ast.Call():
            return library[node.func.id](*of(*node.args))  # type: ignore[attr-defined]
    raise ModelError(f"Expression node {type(node).__name__} is not known.")


# Parts within parts: deeper a text is not what a person wrote, and would exhaust the stack.
DEEPEST = 150
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
    if len(expression) > LONGEST_LINE:
        raise ModelError(
            f"{shown} has {len(expression)} characters, more than {LONGEST_LINE}. Name parts of "
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
        raise ModelError(SAYS["nested"].format(shown=shown, depth=depth, most=DEEPEST))
    tree = _Plain(expression).visit(tree)
    for node in ast.walk(tree):
        _check_part(node, f"Expression {expression!r}")
        _check_operator(node, shown)
    _constant(tree, shown)
    return tree


def _check_part(node: ast.AST, shown: str) -> None:
    """Refuse what is neither arithmetic nor a call of a function by its name."""
    if not isinstance(node, (*_PARTS, *_LESS)):
        raise ModelError(
            f"{shown} uses {type(node).__name__}, which is not arithmetic. "
            f"Use + - * / **, comparisons and the functions {', '.join(FUNCTIONS)}."
        )
    if isinstance(node, ast.Call) and (not isinstance(node.func, ast.Name) or node.keywords):
        raise ModelError(f"{shown} calls something that is not a function.")
    if isinstance(node, ast.Constant) and type(node.value) not in (int, float):
        raise ModelError(f"{shown} holds {node.value!r}: expected numbers.")


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
    if isinstance(node, ast.Name):
        return CONSTANTS.get(node.id)
    # The function of a call is no part of it with a value.
    inner = node.args if isinstance(node, ast.Call) else ast.iter_child_nodes(node)
    parts = [_constant(child, shown) for child in inner if isinstance(child, ast.expr)]
    called = getattr(getattr(node, "func", None), "id", "abs")
    if None in parts or called not in FUNCTIONS:
        if isinstance(getattr(node, "op", None), ast.Div) and parts[1] == 0.0:
            raise ModelError(f"{shown} divides by zero.")
        return None
    number = _value(node)  # type: ignore[arg-type]
    if number.imag or not np.isfinite(number.real):
        raise ModelError(
            f"{shown} contains {ast.unparse(node):.60}, which is no finite real number."
        )
    return number.real


def _value(node: ast.expr) -> complex:
    """What a part without names comes to; NaN where it comes to nothing."""
    try:
        with np.errstate(all="ignore"):
            return complex(walk(node, {}, NUMERIC))
    except (ArithmeticError, TypeError, ValueError):  # the number of arguments is checked later
        return 0j if isinstance(node, ast.Call) else complex("nan")


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
        given = [getattr(part, "id", getattr(part, "value", "")) for part in node.args]
        texts = [one if isinstance(one, str) else "" for one in given]
        most = 1 if function == "dot" else 2
        if not 1 <= len(texts) <= most or not all(texts) or node.keywords:
            raise ModelError(SAYS["rate_or_force"].format(self))
        return ast.Name(f"{function}({', '.join(texts)})", ast.Load())


# -- physics written as text -----------------------------------------------------------


def names(expression: str) -> frozenset[str]:
    """Names that an expression refers to, functions excluded.

    >>> sorted(names("Z_absww*w*abs(w)"))
    ['Z_absww', 'w']
    """
    parse(expression)
    return _names(expression)


@lru_cache(maxsize=4096)
def _names(expression: str) -> frozenset[str]:
    tree = parse(expression)
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return frozenset(
        node.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Name) and id(node) not in called and node.id not in CONSTANTS
    )


def functions(expression: str) -> frozenset[str]:
    """Names of the functions that an expression calls."""
    parse(expression)
    return frozenset(name for name, _ in _calls(expression))


@lru_cache(maxsize=4096)
def _calls(expression: str) -> tuple[tuple[str, int], ...]:
    """Name and number of arguments of every call in an expression."""
    return tuple(
        (node.func.id, len(node.args))
        for node in ast.walk(parse(expression))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    )


def check(
    expression: str,
    known: Iterable[str],
    *,
    where: str,
    tables: Mapping[str, Table | Function] = MappingProxyType({}),
) -> None:
    """Raise :class:`ModelError` if an expression uses an unknown name or function.

    ``tables`` gives the number of arguments of each declared table and function.
    """
    known = set(known)
    for name in sorted(names(expression) - known):
        if name.startswith(("dot(", "force(")):
            _refuse_rate(expression, name, known, where)
        near = difflib.get_close_matches(name, sorted(known), n=3)
        hint = f" Did you mean {' or '.join(near)}?" if near else ""
        raise ModelError(
            f"{where}: expression {expression!r} uses the unknown name {name!r}.{hint} Declare it "
            f'where it belongs: a constant or coefficient as Parameter("{name}", value, "unit"), a '
            f'logged command as Input("{name}", "unit"), an intermediate result as signals='
            f'{{"{name}": "..."}}. Known here: {", ".join(sorted(known))}.'
        )
    check_calls(expression, where=where, tables=tables)


def check_calls(
    expression: str,
    *,
    where: str,
    tables: Mapping[str, Table | Function] = MappingProxyType({}),
    complete: bool = True,
) -> None:
    """Raise :class:`ModelError` if an expression calls what is no function, or wrongly.

    ``complete=False``: a function that is not known yet may be one that the model declares.
    """
    calls = [call for call in _calls(expression) if complete or call[0] in {*FUNCTIONS, *tables}]
    for name in sorted(set(dict(calls)) - set(FUNCTIONS) - set(tables)):
        raise ModelError(
            f"{where}: expression {expression!r} calls the unknown function {name!r}. "
            f"Known functions: {', '.join(FUNCTIONS)}."
        )
    for name, count in calls:
        expected = n_arguments(tables[name]) if name in tables else ARGUMENT_COUNT.get(name, 1)
        if count != expected and not (name in MANY and count > expected):
            raise ModelError(
                f"{where}: {name} in {expression!r} got {count} arguments, expected {expected}."
            )


def _refuse_rate(expression: str, name: str, known: set[str], where: str) -> None:
    """Say why a rate or a force is not known here."""
    there = sorted(other for other in known if other.startswith(name.partition("(")[0] + "("))
    if not there:
        raise ModelError(
            f"{where}: expression {expression!r} uses {name}, which only outputs and sensor "
            "effects can see: there it would need its own result. Write the force out instead."
        )
    raise ModelError(
        f"{where}: expression {expression!r} uses {name}, which does not exist. "
        f"Known here: {', '.join(there)}."
    )


def to_casadi(
    expression: str, scope: Mapping[str, ca.SX], tables: Mapping[str, Any] | None = None
) -> ca.SX:
    """Evaluate an expression on CasADi symbols.

    Parameters
    ----------
    expression : str
        The expression.
    scope : mapping
        Symbols by name.
    tables : mapping, optional
        Tables and functions by name, see :mod:`oed_sysid.text.callables`.
    """
    known = SYMBOLIC | library(tables, symbolic=True) if tables else SYMBOLIC
    return ca.SX(walk(parse(expression), scope, known))


def to_numpy(
    expression: str, scope: Mapping[str, Any], tables: Mapping[str, Any] | None = None
) -> np.ndarray:
    """Evaluate an expression on numbers or arrays.

    >>> float(to_numpy("2*w*abs(w) if w < 0 and w > -pi else 0", {"w": -3.0}))
    -18.0
    """
    known = NUMERIC | library(tables, symbolic=False) if tables else NUMERIC
    # As arrays, so that a division by zero gives infinity and no exception.
    numbers = {name: np.asarray(value) for name, value in scope.items()}
    return np.asarray(walk(parse(expression), numbers, known))


def to_text(expression: str) -> str:
    """Readable form of an expression.

    >>> to_text("Z_absww*w*abs(w) - m*g*sin(theta)**2")
    'Z_absww w |w| - m g sin(theta)²'
    >>> to_text("-u*sin(theta) + -w"), to_text("a/b*c - (b - c)")
    ('-u sin(theta) - w', 'a c/b - b + c')
    """
    return typeset.TextPrinter().sum(parse(expression))


def to_latex(expression: str) -> str:
    r"""LaTeX of an expression, without dollar signs.

    >>> print(to_latex("Z_absww*w_r*abs(w_r) - W*sin(theta)/2"))
    Z_{w|w|} \, w_{r} \, \left|w_{r}\right| - \frac{W \, \sin\left(\theta\right)}{2}
    """
    return typeset.LatexPrinter().sum(parse(expression))
