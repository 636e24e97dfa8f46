"""What a text can call by name: tables of one or two arguments, and the user's own functions.

A table is a plain tuple, ``(x (n,), y (n,))`` or ``(x (n,), y (m,), values (n, m))``,
linear (bilinear) between its points and continued with the slope of its end pieces.
A :class:`Function` is built from a Python function of CasADi symbols, which is called
once; what is kept is the list of its elementary operations. That list can be printed,
compared, stored and read back without executing anybody's code.
"""

from __future__ import annotations

import hashlib
import inspect
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import islice
from typing import Any

import casadi as ca
import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.text import SAYS

Table = tuple[np.ndarray, ...]

# Elementary operations that a function may consist of: the word stored, its meaning.
_OPERATIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    "copy": (ca.OP_ASSIGN, lambda a: a),
    "div": (ca.OP_DIV, operator.truediv),
    "pow": (ca.OP_POW, ca.power),
    "sq": (ca.OP_SQ, lambda a: a * a),
    "twice": (ca.OP_TWICE, lambda a: 2 * a),
    "inv": (ca.OP_INV, lambda a: 1 / a),
    "abs": (ca.OP_FABS, ca.fabs),
    "not": (ca.OP_NOT, ca.logic_not),
    "and": (ca.OP_AND, ca.logic_and),
    "or": (ca.OP_OR, ca.logic_or),
    "if": (ca.OP_IF_ELSE_ZERO, lambda c, a: ca.if_else(c, a, 0)),
    # Python's operators are called as CasADi calls them.
    **{
        word: (getattr(ca, f"OP_{word.upper()}"), getattr(operator, word))
        for word in ("add", "sub", "mul", "neg", "lt", "le", "eq", "ne")
    },
    # CasADi calls these alike in both places.
    **{
        word: (getattr(ca, f"OP_{word.upper()}"), getattr(ca, word))
        for word in (
            *("exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
            *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "erf", "sign", "floor", "ceil"),
            *("fmod", "copysign", "remainder", "hypot", "log1p", "expm1", "fmin", "fmax"),
            "constpow",
        )
    },
}
# Words by CasADi's code, for whoever writes a function in another language.
OPERATION_WORDS = {code: word for word, (code, _) in _OPERATIONS.items()}


@dataclass(frozen=True)
class Function:
    """The user's own function of CasADi symbols, callable in texts by its name.

    Smoothness is the user's concern: gradients are exact derivatives of what is
    written, so a kink or a jump gives a one-sided or a zero derivative there.

    Parameters
    ----------
    name : str
        Name in texts.
    definition : callable or str
        Python function of scalar CasADi symbols that returns one scalar (a CasADi
        ``Function`` will do), called once at construction; or the operations that
        another instance has stored.
    arguments : tuple of str, optional
        Names of the arguments; by default those of the Python function.

    Raises
    ------
    ModelError
        If the function cannot be called with symbols, or its result is not one scalar.

    Examples
    --------
    >>> import casadi as ca
    >>> thrust = Function("thrust", lambda n, u: n * ca.fabs(n) - 0.1 * ca.fabs(n) * u)
    >>> thrust.arguments, float(thrust.evaluate(2.0, 1.0))
    (('n', 'u'), 3.8)
    >>> Function("thrust", thrust.definition, thrust.arguments) == thrust
    True
    """

    name: str
    definition: str | Callable[..., Any]
    arguments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name.isidentifier()):
            raise ModelError(f"Function name {self.name!r} is no identifier.")
        if isinstance(self.definition, str):
            object.__setattr__(self, "arguments", tuple(self.arguments))
            _rebuilt(self.definition, len(self.arguments))
            return
        arguments = tuple(self.arguments) or argument_names(self.name, self.definition)
        symbols = [ca.SX.sym(argument) for argument in arguments]
        try:
            result = ca.SX(self.definition(*symbols))
        except Exception as error:
            raise ModelError(
                f"Function {self.name!r} cannot be called with CasADi symbols: "
                f"{type(error).__name__}: {error}. Use arithmetic and casadi functions "
                "(casadi.sin, casadi.if_else ...) instead of numpy, math, if and for loops "
                "that depend on values."
            ) from None
        if result.shape != (1, 1):
            raise ModelError(SAYS["no_scalar"].format(self, result=result))
        object.__setattr__(self, "definition", _recorded(self.name, symbols, result))
        object.__setattr__(self, "arguments", arguments)

    def __getstate__(self) -> dict[str, Any]:
        """Functions of CasADi that are called go along to another process."""
        digests = [step.split()[1] for step in str(self.definition).split("; ") if "=call " in step]
        return self.__dict__ | {"called": {one: _CALLED[one].serialize() for one in digests}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for digest, text in state.pop("called", {}).items():
            if digest not in _CALLED:
                _CALLED[digest] = ca.Function.deserialize(text)
        self.__dict__.update(state)

    def symbolic(self, *values: ca.SX) -> ca.SX:
        """Return the function of CasADi symbols."""
        return _rebuilt(str(self.definition), len(self.arguments))(*values)

    def evaluate(self, *values: Any) -> np.ndarray:
        """Return the function of numbers or arrays that NumPy can broadcast."""
        arrays = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in values))
        rows = [ca.DM(array.reshape(1, -1)) for array in arrays]
        result = _rebuilt(str(self.definition), len(self.arguments))(*rows)
        return np.asarray(result, dtype=float).reshape(arrays[0].shape)


def argument_names(name: str, definition: Callable[..., Any]) -> tuple[str, ...]:
    """Names of the arguments of a Python or CasADi function."""
    if isinstance(definition, ca.Function):
        return tuple(definition.name_in())
    try:
        parameters = inspect.signature(definition).parameters.values()
    except (TypeError, ValueError):
        parameters = ()  # type: ignore[assignment]
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    found = tuple(p.name for p in parameters if p.kind in kinds and p.default is p.empty)
    if not found:
        raise ModelError(SAYS["no_arguments"].format(name=name))
    return found


def elements(
    function: ca.Function, symbols: Mapping[str, Sequence[str]], results: Sequence[str]
) -> dict[str, Function]:
    """Elements of the first result of a function of columns, each of the scalars that it needs.

    Parameters
    ----------
    function : casadi.Function
        Its arguments are columns, named as the ``symbols`` or in their order.
    symbols : mapping of str to sequence of str
        Names of the elements of each column.
    results : sequence of str
        Names of the elements of the result.
    """
    columns = _columns(function, symbols, results)
    try:
        flat = function.expand()
    except RuntimeError:
        flat = function
    found = ca.densify(ca.vec(flat.call([ca.vertcat(*one) for one in columns])[0]))
    scalars = [one for column in columns for one in column]
    title, elements = function.name(), {}
    for key, result in zip(results, ca.vertsplit(found), strict=True):
        needed = [one for one in scalars if ca.depends_on(result, one)] or scalars[:1]
        definition = ca.Function("f", needed, [result], {"allow_free": True})
        elements[key] = Function(f"{title}_{key}", definition, tuple(one.name() for one in needed))
    return elements


def _columns(
    function: ca.Function, symbols: Mapping[str, Sequence[str]], results: Sequence[str]
) -> list[list[ca.SX]]:
    """Symbols of every argument, checked against what the function takes and returns."""
    title, given = function.name(), function.name_in()
    order = given if set(given) <= set(symbols) else list(symbols)[: len(given)]
    columns = [[ca.SX.sym(name) for name in symbols[key]] for key in order]
    sizes = [function.size_in(i) for i in range(function.n_in())]
    wanted = [(len(column), 1) for column in columns if column]
    if [size for size in sizes if 0 not in size] != wanted:
        expected = ", ".join(f"{key} ({len(symbols[key])}, 1)" for key in symbols)
        raise ModelError(
            SAYS["shapes_of_arguments"].format(title=title, sizes=sizes, expected=expected)
        )
    if function.numel_out(0) != len(results):
        raise ModelError(
            f"CasADi's function {title!r} returns {function.numel_out(0)} numbers; expected "
            f"{len(results)}, one for each of {', '.join(results)}."
        )
    return columns


def call_text(function: Function) -> str:
    """Call of a function with its own arguments, or the one that it hands on, as an expression."""
    one = ca.SX.sym("one")
    if function.definition == _recorded(function.name, [one], one):
        return function.arguments[0]
    return f"{function.name}({', '.join(function.arguments)})"


def _recorded(name: str, symbols: list[ca.SX], result: ca.SX) -> str:
    """Operations of an expression, operands before what is made of them, as text."""
    place = {symbol.element_hash(): f"input {i}" for i, symbol in enumerate(symbols)}
    root = ca.cse(ca.densify(result))
    steps, done, waiting = list[str](), dict[int, int](), [root]
    while waiting:
        node = waiting[-1]
        if (key := node.element_hash()) in done:
            waiting.pop()
            continue
        # A result of a called function depends on the call, whose operands are its arguments.
        source = node.dep(0) if node.is_output() else node
        operands = [source.dep(i) for i in range(source.n_dep())]
        if missing := [one for one in operands if one.element_hash() not in done]:
            waiting += missing
            continue
        done[key] = len(steps)
        numbers = "".join(f" {done[one.element_hash()]}" for one in operands)
        steps.append(f"{len(steps)}={_word(name, node, source, place)}{numbers}")
        waiting.pop()
    return "; ".join([*steps, f"result {done[root.element_hash()]}"])


def _word(name: str, node: ca.SX, source: ca.SX, place: Mapping[int, str]) -> str:
    """What is stored of one operation, before the numbers of its operands."""
    if node.is_constant():
        return f"const {float(node)!r}"
    if node.is_output():
        return f"call {_remembered(name, source.which_function())} {node.which_output()}"
    if node.is_symbolic() and node.element_hash() not in place:
        raise ModelError(f"Function {name!r} uses {node}, which is none of its arguments.")
    word = place.get(node.element_hash()) or OPERATION_WORDS.get(node.op())
    if word is None:
        raise ModelError(SAYS["no_elementary_function"].format(name=name, operation=node.op()))
    return word


# CasADi functions that recorded operations call: interpolants, integrators, external code.
_CALLED: dict[str, ca.Function] = {}


def _remembered(name: str, function: ca.Function) -> str:
    """Digest under which a called CasADi function is known in this process.

    It is never stored with a model: reading back a function of CasADi may load a library, and a
    file must not run code.
    """
    try:
        text = function.serialize()
        # A callback of Python is written without complaint, but cannot be read back.
        ca.Function.deserialize(text)
    except RuntimeError as error:
        raise ModelError(
            f"Function {name!r} calls CasADi's {function.name()!r}, which cannot be copied to "
            f"other processes ({str(error).splitlines()[-1]}). Use functions that CasADi can "
            "serialize, no callbacks of Python."
        ) from None
    digest = hashlib.sha256(text.encode()).hexdigest()[:24]
    _CALLED[digest] = function
    return digest


def _called(digest: str, result: int, arguments: list[ca.SX]) -> ca.SX:
    """One scalar result of a called CasADi function of scalar arguments."""
    if digest not in _CALLED:
        raise ModelError(SAYS["function_not_stored"].format(digest=digest))
    function, rest, parts = _CALLED[digest], iter(arguments), list[ca.SX]()
    for i in range(function.n_in()):
        own = ca.vertcat(*islice(rest, function.nnz_in(i)))
        parts.append(ca.SX(function.sparsity_in(i), own))
    return ca.vertcat(*(part.nz[:] for part in function.call(parts)))[result]


@lru_cache(maxsize=256)
def _rebuilt(text: str, n_arguments: int) -> ca.Function:
    """CasADi function of recorded operations."""
    symbols = [ca.SX.sym(f"a{i}") for i in range(n_arguments)]
    work: dict[str, ca.SX] = {}
    special: dict[str, Callable[..., ca.SX]] = {
        "const": lambda number: ca.SX(float(number)),
        "input": lambda index: symbols[int(index)],
        "call": lambda one, place, *operands: _called(one, int(place), [work[i] for i in operands]),
        "result": lambda index: work[index],
    }
    try:
        for step in text.split("; "):
            # The result alone has no target: it is kept under the empty one.
            target, _, operation = step.rpartition("=")
            word, *operands = operation.split()
            if word in special:
                work[target] = special[word](*operands)
            else:
                work[target] = ca.SX(_OPERATIONS[word][1](*(work[i] for i in operands)))
        return ca.Function("f", symbols, [work[""]])
    except ModelError:
        raise
    except (KeyError, IndexError, ValueError, TypeError):
        raise ModelError(f"{text[:40]!r} is not a function that Function has stored.") from None


def check_table(name: str, table: Table) -> Table:
    """Return a table as arrays, or raise :class:`ModelError` if it is not one."""
    try:
        arrays = tuple(np.asarray(part, dtype=float) for part in table)
    except (TypeError, ValueError):
        raise ModelError(
            f"Table {name!r} is {table!r:.80}; expected rows of numbers, (x, y) or (x, y, values)."
        ) from None
    if len(arrays) not in (2, 3):
        raise ModelError(SAYS["parts_of_table"].format(name=name, n=len(arrays)))
    *grids, values = arrays
    for place, grid in zip(("first", "second"), grids, strict=False):
        _check_grid(f"Table {name!r}: its {place} argument", grid)
    expected = tuple(len(grid) for grid in grids)
    if values.shape != expected:
        raise ModelError(
            SAYS["values_of_table"].format(name=name, values=values, expected=expected)
        )
    if not np.all(np.isfinite(values)):
        raise ModelError(f"Table {name!r} has a value that is not finite. Fill the gap.")
    return arrays


def _check_grid(what: str, grid: np.ndarray) -> None:
    if grid.ndim != 1 or len(grid) < 2:
        raise ModelError(f"{what} has shape {grid.shape}; expected at least two values in one row.")
    if not np.all(np.isfinite(grid)) or np.any(np.diff(grid) <= 0):
        raise ModelError(
            f"{what} does not increase strictly. Sort the rows and remove repetitions."
        )


def n_arguments(entry: Table | Function) -> int:
    """Number of arguments of a table or a function."""
    return len(entry.arguments) if isinstance(entry, Function) else len(entry) - 1


def digest(entry: Table | Function) -> tuple[str, ...]:
    """Everything that shapes the code of a table or a function."""
    if isinstance(entry, Function):
        return (str(entry.definition), *entry.arguments)
    return tuple(np.asarray(part, float).tobytes().hex() for part in entry)


def library(entries: Mapping[str, Any], *, symbolic: bool) -> dict[str, Callable[..., Any]]:
    """Tables and functions as functions of CasADi symbols, or else of numbers or arrays."""
    called, looked_up = "evaluate", interpolate
    if symbolic:
        called, looked_up = "symbolic", _symbolic_table
    return {
        name: getattr(one, called) if isinstance(one, Function) else partial(looked_up, one)
        for name, one in entries.items()
    }


def _symbolic_table(table: Table, *arguments: Any) -> ca.SX:
    # A number may be an argument too; CasADi interpolates at symbols alone.
    x = [ca.SX(one) for one in arguments]
    first = ca.DM(np.asarray(table[0], float))
    if len(table) == 2:
        return ca.pw_lin(x[0], first, ca.DM(np.asarray(table[1], float)))
    second = ca.DM(np.asarray(table[1], float))
    # Along the second argument in every row, then along the first between the rows.
    rows = [ca.pw_lin(x[1], second, ca.DM(row)) for row in np.asarray(table[2], float)]
    return ca.pw_lin(x[0], ca.SX(first), ca.vertcat(*rows))


def interpolate(table: Table, *x: Any) -> Any:
    """Linear or bilinear between points, with the end slopes beyond.

    >>> float(interpolate(([0.0, 1.0], [0.0, 2.0], [[0.0, 2.0], [1.0, 5.0]]), 0.5, 1.0))
    2.0
    """
    grid, values = np.asarray(table[0], float), np.asarray(table[-1], float)
    i, s = _place(grid, x[0])
    if len(table) == 2:
        return values[i] + s * (values[i + 1] - values[i])
    j, r = _place(np.asarray(table[1], float), x[1])
    low = values[i, j] + r * (values[i, j + 1] - values[i, j])
    high = values[i + 1, j] + r * (values[i + 1, j + 1] - values[i + 1, j])
    return low + s * (high - low)


def _place(grid: np.ndarray, x: Any) -> tuple[np.ndarray, np.ndarray]:
    """Piece of the grid that a value lies in, and where in the piece."""
    i = np.clip(np.searchsorted(grid, x, side="right") - 1, 0, len(grid) - 2)
    return i, (x - grid[i]) / (grid[i + 1] - grid[i])
