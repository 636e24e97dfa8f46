"""Elementary operations as they are written in C, Python, MATLAB and SymPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from oed_sysid.export.program import Routine

_ARITHMETIC = {
    "copy": "{0}", "add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0}*{1}", "div": "{0}/{1}",
    "neg": "-{0}", "sq": "{0}*{0}", "twice": "2*{0}", "inv": "1/{0}",
}  # fmt: skip
_SAME = (
    "exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "floor", "ceil", "erf", "log1p", "expm1",
)  # fmt: skip
C = _ARITHMETIC | {word: f"{word}({{0}})" for word in _SAME} | {
    "pow": "pow({0}, {1})", "constpow": "pow({0}, {1})", "atan2": "atan2({0}, {1})",
    "abs": "fabs({0})", "sign": "({0} > 0) - ({0} < 0)", "fmod": "fmod({0}, {1})",
    "copysign": "copysign({0}, {1})", "remainder": "remainder({0}, {1})",
    "hypot": "hypot({0}, {1})", "fmin": "fmin({0}, {1})", "fmax": "fmax({0}, {1})",
    "lt": "{0} < {1}", "le": "{0} <= {1}", "eq": "{0} == {1}", "ne": "{0} != {1}",
    "not": "!{0}", "and": "{0} && {1}", "or": "{0} || {1}", "if": "{0} ? {1} : 0.0",
}  # fmt: skip
PYTHON = _ARITHMETIC | {word: f"np.{word}({{0}})" for word in _SAME} | {
    "asin": "np.arcsin({0})", "acos": "np.arccos({0})", "atan": "np.arctan({0})",
    "asinh": "np.arcsinh({0})", "acosh": "np.arccosh({0})", "atanh": "np.arctanh({0})",
    "erf": "_erf({0})", "pow": "np.power({0}, {1})", "constpow": "np.power({0}, {1})",
    "atan2": "np.arctan2({0}, {1})", "abs": "np.abs({0})", "sign": "np.sign({0})",
    "fmod": "np.fmod({0}, {1})", "copysign": "np.copysign({0}, {1})",
    "remainder": "{0} - {1}*np.rint({0}/{1})", "hypot": "np.hypot({0}, {1})",
    "fmin": "np.fmin({0}, {1})", "fmax": "np.fmax({0}, {1})",
    "lt": "1.0*({0} < {1})", "le": "1.0*({0} <= {1})", "eq": "1.0*({0} == {1})",
    "ne": "1.0*({0} != {1})", "not": "1.0*({0} == 0)", "and": "1.0*(({0} != 0) & ({1} != 0))",
    "or": "1.0*(({0} != 0) | ({1} != 0))", "if": "np.where({0} != 0, {1}, 0.0)",
}  # fmt: skip
MATLAB = _ARITHMETIC | {word: f"{word}({{0}})" for word in _SAME} | {
    "pow": "power({0}, {1})", "constpow": "power({0}, {1})", "atan2": "atan2({0}, {1})",
    "abs": "abs({0})", "sign": "sign({0})", "fmod": "rem({0}, {1})",
    "copysign": "abs({0})*(1 - 2*({1} < 0))", "remainder": "{0} - {1}*round({0}/{1})",
    "hypot": "hypot({0}, {1})", "fmin": "min({0}, {1})", "fmax": "max({0}, {1})",
    "lt": "double({0} < {1})", "le": "double({0} <= {1})", "eq": "double({0} == {1})",
    "ne": "double({0} ~= {1})", "not": "double({0} == 0)",
    "and": "double({0} ~= 0 && {1} ~= 0)", "or": "double({0} ~= 0 || {1} ~= 0)",
    "if": "choose({0}, {1})",
}  # fmt: skip
_SYMBOLIC = {word: f"sp.{word}({{0}})" for word in _SAME} | {"ceil": "sp.ceiling({0})"}
SYMPY = _ARITHMETIC | _SYMBOLIC | {
    "pow": "{0}**{1}", "constpow": "{0}**{1}", "atan2": "sp.atan2({0}, {1})",
    "abs": "sp.Abs({0})", "sign": "sp.sign({0})", "hypot": "sp.sqrt({0}**2 + {1}**2)",
    "fmin": "sp.Min({0}, {1})", "fmax": "sp.Max({0}, {1})", "log1p": "sp.log(1 + {0})",
    "expm1": "(sp.exp({0}) - 1)", "fmod": "({0} - {1}*sp.sign({0}*{1})*sp.floor(sp.Abs({0}/{1})))",
    "copysign": "sp.Abs({0})*sp.sign({1})", "remainder": "({0} - {1}*sp.floor({0}/{1} + 0.5))",
    "lt": "sp.Piecewise((1, {0} < {1}), (0, True))",
    "le": "sp.Piecewise((1, {0} <= {1}), (0, True))",
    "eq": "sp.Piecewise((1, sp.Eq({0}, {1})), (0, True))",
    "ne": "sp.Piecewise((0, sp.Eq({0}, {1})), (1, True))",
    "not": "sp.Piecewise((1, sp.Eq({0}, 0)), (0, True))",
    "and": "({0})*({1})", "or": "sp.Max({0}, {1})",
    "if": "sp.Piecewise(({1}, sp.Ne({0}, 0)), (0, True))",
}  # fmt: skip


@dataclass(frozen=True)
class Dialect:
    """How a language writes straight-line code.

    Parameters
    ----------
    formats : mapping of str to str
        Right-hand side of every operation.
    argument, result : callable
        ``(name, length, index)`` to the text of an element of an argument or result.
    end : str
        End of a statement.
    """

    formats: dict[str, str]
    argument: Callable[[str, int, int], str]
    result: Callable[[str, int, int], str]
    end: str

    def lines(self, routine: Routine) -> list[str]:
        """Statements of a function, without its head.

        Parameters
        ----------
        routine : Routine
            The function.
        """
        lines = []
        for one in routine.operations:
            if one.word == "const":
                right = repr(one.value)
                if right in ("inf", "-inf", "nan"):
                    right = {"inf": "(1e308*10)", "-inf": "(-1e308*10)"}.get(right, "(0.0/0.0)")
                lines.append(f"w{one.target[0]} = {right}{self.end}")
            elif one.word == "input":
                name, length = routine.arguments[one.operands[0]]
                text = self.argument(name, length, one.operands[1])
                lines.append(f"w{one.target[0]} = {text}{self.end}")
            elif one.word == "output":
                name, length = routine.results[one.target[0]]
                text = self.result(name, length, one.target[1])
                lines.append(f"{text} = w{one.operands[0]}{self.end}")
            else:
                operands = [f"w{index}" for index in one.operands]
                right = self.formats[one.word].format(*operands)
                lines.append(f"w{one.target[0]} = {right}{self.end}")
        return lines


_SCALARS = ("t", "h")


def _from_zero(name: str, length: int, index: int) -> str:
    return name if name in _SCALARS else f"{name}[{index}]"


def _from_one(name: str, length: int, index: int) -> str:
    return name if name in _SCALARS else f"{name}({index + 1})"


IN_C = Dialect(C, _from_zero, _from_zero, ";")
IN_PYTHON = Dialect(PYTHON, _from_zero, _from_zero, "")
IN_MATLAB = Dialect(MATLAB, _from_one, _from_one, ";")
IN_SYMPY = Dialect(SYMPY, _from_zero, _from_zero, "")
