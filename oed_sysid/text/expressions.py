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
"""

from __future__ import annotations

import ast
import difflib
from collections.abc import Iterable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import casadi as ca
import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.text import typeset
from oed_sysid.text.callables import numeric_library, symbolic_library
from oed_sysid.text.grammar import (
    ARGUMENT_COUNT,
    CONSTANTS,
    FUNCTIONS,
    MANY,
    NUMERIC,
    SYMBOLIC,
    parse,
    walk,
)


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
    tables: Mapping[str, int] = MappingProxyType({}),
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
            f"{where}: expression {expression!r} uses the unknown name {name!r}.{hint} "
            f"Known here: {', '.join(sorted(known))}."
        )
    check_calls(expression, where=where, tables=tables)


def check_calls(
    expression: str,
    *,
    where: str,
    tables: Mapping[str, int] = MappingProxyType({}),
    complete: bool = True,
) -> None:
    """Raise :class:`ModelError` if an expression calls what is no function, or wrongly.

    ``complete=False``: a function that is not known yet may be one that the model declares.
    """
    calls = [call for call in _calls(expression) if complete or call[0] in {*FUNCTIONS, *tables}]
    for name in sorted({name for name, _ in calls} - set(FUNCTIONS) - set(tables)):
        raise ModelError(
            f"{where}: expression {expression!r} calls the unknown function {name!r}. "
            f"Known functions: {', '.join(FUNCTIONS)}."
        )
    for name, count in calls:
        expected = tables[name] if name in tables else ARGUMENT_COUNT.get(name, 1)
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
    library = SYMBOLIC | symbolic_library(tables) if tables else SYMBOLIC
    return ca.SX(walk(parse(expression), scope, library))


def to_numpy(
    expression: str, scope: Mapping[str, Any], tables: Mapping[str, Any] | None = None
) -> np.ndarray:
    """Evaluate an expression on numbers or arrays.

    >>> float(to_numpy("2*w*abs(w) if w < 0 and w > -pi else 0", {"w": -3.0}))
    -18.0
    """
    library = NUMERIC | numeric_library(tables) if tables else NUMERIC
    # As arrays, so that a division by zero gives infinity and no exception.
    numbers = {name: np.asarray(value) for name, value in scope.items()}
    return np.asarray(walk(parse(expression), numbers, library))


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
