"""Physics written as text: ``"Z_absww * w_r * abs(w_r)"``.

An expression is ordinary Python arithmetic over names. It is parsed once with
:mod:`ast`, checked against a closed list of functions, and then evaluated on
CasADi symbols, on NumPy arrays, as readable text, as LaTeX or as physical
dimensions. Text makes a model printable, comparable, storable and safe to
load, and lets a user write physics without knowing CasADi.

Functions: ``sin cos tan asin acos atan atan2 sinh cosh tanh sqrt exp log abs
sign min max where`` and the tables that an effect declares.
"""

from __future__ import annotations

import ast
import difflib
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.language import typeset

_CASADI: dict[str, Callable[..., Any]] = {
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
    "min": ca.fmin,
    "max": ca.fmax,
    "where": ca.if_else,
}
_NUMPY: dict[str, Callable[..., Any]] = {
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
    "min": np.minimum,
    "max": np.maximum,
    "where": np.where,
}
FUNCTIONS = tuple(_CASADI)
_ARGUMENT_COUNT = {"atan2": 2, "min": 2, "max": 2, "where": 3}


@lru_cache(maxsize=4096)
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
    try:
        tree = ast.parse(expression.strip(), mode="eval").body
    except SyntaxError as error:
        raise ModelError(
            f"Expression {expression!r} cannot be read ({error.msg}). "
            "Write ordinary arithmetic, for instance 'Z_absww*w*abs(w)'."
        ) from None
    for node in ast.walk(tree):
        if not isinstance(
            node,
            ast.BinOp
            | ast.UnaryOp
            | ast.Call
            | ast.Name
            | ast.Constant
            | ast.Compare
            | ast.operator
            | ast.unaryop
            | ast.cmpop
            | ast.expr_context,
        ):
            raise ModelError(
                f"Expression {expression!r} uses {type(node).__name__}, which is not arithmetic. "
                f"Use + - * / **, comparisons and the functions {', '.join(FUNCTIONS)}."
            )
        if isinstance(node, ast.Call) and (not isinstance(node.func, ast.Name) or node.keywords):
            raise ModelError(f"Expression {expression!r} calls something that is not a function.")
        if isinstance(node, ast.Constant) and not isinstance(node.value, int | float):
            raise ModelError(f"Expression {expression!r} holds {node.value!r}: expected numbers.")
    return tree


@lru_cache(maxsize=4096)
def names(expression: str) -> frozenset[str]:
    """Names that an expression refers to, functions excluded.

    >>> sorted(names("Z_absww*w*abs(w)"))
    ['Z_absww', 'w']
    """
    tree = parse(expression)
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return frozenset(
        node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called
    )


def functions(expression: str) -> frozenset[str]:
    """Names of the functions that an expression calls."""
    return frozenset(name for name, _ in _calls(expression))


@lru_cache(maxsize=4096)
def _calls(expression: str) -> tuple[tuple[str, int], ...]:
    """Name and number of arguments of every call in an expression."""
    return tuple(
        (node.func.id, len(node.args))
        for node in ast.walk(parse(expression))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    )


def check(expression: str, known: Iterable[str], *, where: str, tables: Iterable[str] = ()) -> None:
    """Raise :class:`ModelError` if an expression uses an unknown name or function."""
    known = set(known)
    for name in sorted(names(expression) - known):
        near = difflib.get_close_matches(name, sorted(known), n=3)
        hint = f" Did you mean {' or '.join(near)}?" if near else ""
        raise ModelError(
            f"{where}: expression {expression!r} uses the unknown name {name!r}.{hint} "
            f"Known here: {', '.join(sorted(known))}."
        )
    for name in sorted(functions(expression) - set(FUNCTIONS) - set(tables)):
        raise ModelError(
            f"{where}: expression {expression!r} calls the unknown function {name!r}. "
            f"Known functions: {', '.join(FUNCTIONS)}."
        )
    for name, count in _calls(expression):
        expected = _ARGUMENT_COUNT.get(name, 1)
        if count != expected:
            raise ModelError(
                f"{where}: {name} in {expression!r} got {count} arguments, expected {expected}."
            )


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


def _walk(node: ast.expr, scope: Mapping[str, Any], library: Mapping[str, Callable]) -> Any:
    match node:
        case ast.Constant():
            return float(node.value)  # type: ignore[arg-type]
        case ast.Name():
            return scope[node.id]
        case ast.UnaryOp():
            value = _walk(node.operand, scope, library)
            return -value if isinstance(node.op, ast.USub) else value
        case ast.BinOp():
            if isinstance(node.op, ast.Pow) and isinstance(node.right, ast.Constant):
                base, power = _walk(node.left, scope, library), node.right.value
                # Products have simpler derivatives than a general power.
                return base * base if power == 2 else base**power
            operator = _BINARY.get(type(node.op))
            if operator is None:
                raise ModelError(f"Operator {type(node.op).__name__} is not known in expressions.")
            return operator(_walk(node.left, scope, library), _walk(node.right, scope, library))
        case ast.Compare():
            if len(node.ops) != 1 or type(node.ops[0]) not in _COMPARE:
                raise ModelError("Write one comparison at a time, with <, <=, > or >=.")
            return _COMPARE[type(node.ops[0])](
                _walk(node.left, scope, library), _walk(node.comparators[0], scope, library)
            )
        case ast.Call():
            function = library[node.func.id]  # type: ignore[attr-defined]
            return function(*(_walk(argument, scope, library) for argument in node.args))
    raise ModelError(f"Expression node {type(node).__name__} is not known.")


def to_casadi(
    expression: str,
    scope: Mapping[str, ca.SX],
    tables: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> ca.SX:
    """Evaluate an expression on CasADi symbols.

    Parameters
    ----------
    expression : str
        The expression.
    scope : mapping
        Symbols by name.
    tables : mapping, optional
        ``name -> (abscissae (n,), ordinates (n,))``, linear between points and
        extrapolated with the end slopes.
    """
    library = dict(_CASADI)
    for name, (abscissae, ordinates) in (tables or {}).items():
        library[name] = lambda x, a=abscissae, o=ordinates: ca.pw_lin(
            x, ca.DM(np.asarray(a, float)), ca.DM(np.asarray(o, float))
        )
    return ca.SX(_walk(parse(expression), scope, library))


def _interpolate(x: Any, abscissae: np.ndarray, ordinates: np.ndarray) -> Any:
    """Linear between points, with the end slopes beyond, as in the compiled model."""
    a, o = np.asarray(abscissae, float), np.asarray(ordinates, float)
    i = np.clip(np.searchsorted(a, x, side="right") - 1, 0, len(a) - 2)
    return o[i] + (x - a[i]) * (o[i + 1] - o[i]) / (a[i + 1] - a[i])


def to_numpy(
    expression: str,
    scope: Mapping[str, Any],
    tables: Mapping[str, tuple[np.ndarray, np.ndarray]] | None = None,
) -> np.ndarray:
    """Evaluate an expression on numbers or arrays.

    >>> float(to_numpy("2*w*abs(w)", {"w": -3.0}))
    -18.0
    """
    library = dict(_NUMPY)
    for name, (abscissae, ordinates) in (tables or {}).items():
        library[name] = lambda x, a=abscissae, o=ordinates: _interpolate(x, a, o)
    return np.asarray(_walk(parse(expression), scope, library))


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
