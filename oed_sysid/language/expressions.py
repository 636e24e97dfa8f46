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


# Beyond these a text is not what a person wrote, and would exhaust the stack.
MOST_CHARACTERS, DEEPEST = 20_000, 150
_INSTEAD = {
    ast.BitXor: "Write ** for a power.",
    ast.Mod: "Write where(...) or a sine for what repeats.",
    ast.FloorDiv: "Write / for a quotient.",
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
    if isinstance(node, ast.UnaryOp) and not isinstance(node.op, ast.USub | ast.UAdd):
        raise ModelError(f"{shown} uses {type(node.op).__name__}. Use + - * / and **.")
    if isinstance(node, ast.Compare) and (len(node.ops) != 1 or type(node.ops[0]) not in _COMPARE):
        raise ModelError(
            f"{shown}: write one comparison at a time, with <, <=, > or >=, for instance "
            "(a < b)*(b < c)."
        )


def _constant(node: ast.AST, shown: str) -> float | None:
    """Value of a part without names; refused where it is no finite real number."""
    parts = [
        _constant(child, shown)
        for child in ast.iter_child_nodes(node)
        if isinstance(child, ast.expr) and child is not getattr(node, "func", None)
    ]
    if isinstance(node, ast.Name) or any(part is None for part in parts):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div) and parts[1] == 0.0:
            raise ModelError(f"{shown} divides by zero.")
        return None
    if isinstance(node, ast.Call) and node.func.id not in FUNCTIONS:  # type: ignore[attr-defined]
        return None
    try:
        with np.errstate(all="ignore"):
            value = _walk(node, {}, _NUMPY)  # type: ignore[arg-type]
        number = complex(value)
    except (ArithmeticError, TypeError, ValueError):  # the number of arguments is checked later
        number = complex("nan") if not isinstance(node, ast.Call) else 0j
    if number.imag or not np.isfinite(number.real):
        raise ModelError(
            f"{shown} contains {ast.unparse(node):.60}, which is no finite real number."
        )
    return number.real


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
        node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in called
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
    check_calls(expression, where=where, tables=tables)


def check_calls(expression: str, *, where: str, tables: Iterable[str] = ()) -> None:
    """Raise :class:`ModelError` if an expression calls what is no function, or wrongly."""
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
    # As arrays, so that a division by zero gives infinity and no exception.
    numbers = {name: np.asarray(value) for name, value in scope.items()}
    return np.asarray(_walk(parse(expression), numbers, library))


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
