r"""A model as a program: its functions as lists of elementary operations, and everything around.

The functions are those of :mod:`oed_sysid.compiled.graph`,

=========  ==========================  ==================================
function   arguments                   results
=========  ==========================  ==================================
actuate    memory, inputs, p, t, h     signals, next memory
rates      states, signals, p, t       rates of the states
observe    states, signals, memory,    outputs, next memory
           p, t, h
start      own states, inputs, p, t    full state z
slopes     states, signals, p, t       derivatives of the rates by the
                                       states (implicit models only)
=========  ==========================  ==================================

and what a language adds is the loop around them: a step of the Runge-Kutta method, steps no longer
than ``step`` between two samples, measurements at the samples; memory of sensors takes in the
beginning of every step.

Elementary operations as they are written in C, Python, MATLAB and SymPy.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.resources import files
from string import Template

import casadi as ca
import numpy as np

from oed_sysid.compiled.graph import GAMMA, STAGES, Graph, build
from oed_sysid.errors import ModelError
from oed_sysid.experiments.trajectory import simulate_inputs
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.channels import Input, Output
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.display import as_dict
from oed_sysid.runtime.tables import tables
from oed_sysid.runtime.version import __version__
from oed_sysid.text.callables import OPERATION_WORDS
from oed_sysid.text.typeset import safe, safe_unit

# -- a model as a program --------------------------------------------------------------


# Words that end or begin a block in MATLAB and are no words of Python.
_MATLAB_WORDS = ("case", "end", "function", "otherwise", "parfor", "spmd", "switch")


@dataclass(frozen=True)
class Operation:
    """One elementary operation on numbered scalars.

    Parameters
    ----------
    word : str
        ``"const"``, ``"input"``, ``"output"``, or a word such as ``"add"``.
    target : tuple of int
        Number of the result; of an output, which result and which element.
    operands : tuple of int
        Numbers of the operands; of an input, which argument and which element.
    value : float
        Of a constant.
    """

    word: str
    target: tuple[int, ...]
    operands: tuple[int, ...]
    value: float = 0.0


@dataclass(frozen=True)
class Routine:
    """One function of a model.

    Parameters
    ----------
    name : str
        ``actuate``, ``rates``, ``observe``, ``start`` or ``slopes``.
    arguments, results : tuple of (str, int)
        Names and lengths, in order.
    operations : tuple of Operation
        Straight-line code.
    """

    name: str
    arguments: tuple[tuple[str, int], ...]
    results: tuple[tuple[str, int], ...]
    operations: tuple[Operation, ...] = field(repr=False)


@dataclass(frozen=True, eq=False)
class Program:
    """Everything that a model needs to run elsewhere.

    Parameters
    ----------
    model : Model
        At its estimated values.
    fit : Fit, optional
        Where these come from.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> program = Program(load_problem("nomoto_sparse_heading").model)
    >>> program.model.name
    'first-order Nomoto'
    """

    model: Model
    fit: Fit | None = None

    @property
    def identifier(self) -> str:
        """Name of the model as an identifier."""
        return identifier(self.model.name)

    @cached_property
    def graph(self) -> Graph:
        """The model as functions, and what their arguments hold."""
        return build(self.model)

    @property
    def free(self) -> tuple[str, ...]:
        """Estimated parameters that all records share."""
        names = () if self.fit is None else self.fit.names
        return tuple(name for name in names if not self.model.parameter(name).per_record)

    @property
    def covariance(self) -> np.ndarray:
        """Theirs, ``(n_free, n_free)``; empty for a model without a fit."""
        if self.fit is None:
            return np.zeros((0, 0))
        rows = [self.fit.names.index(name) for name in self.free]
        return np.asarray(self.fit.covariance[np.ix_(rows, rows)])

    @cached_property
    def routines(self) -> tuple[Routine, ...]:
        """Functions of the model, operation by operation."""
        graph = self.graph
        functions = [graph.actuate, graph.rates, graph.observe, graph.start]
        functions += [_slopes(graph.rates)] if self.implicit else []
        return tuple(map(_routine, functions))

    @property
    def implicit(self) -> bool:
        """Whether the integration step is implicit."""
        return self.model.integrator != "explicit"

    @property
    def names(self) -> dict[str, tuple[str, ...]]:
        """Names and units that may stand in code of any language: ASCII letters, digits, few signs.

        Those of ``states inputs outputs parameters signals``, of ``free`` (the estimated
        parameters), and ``input_units output_units parameter_units``, which
        :func:`oed_sysid.text.units.dimension` reads back; all in the order of the program.
        """
        model = self.model
        parts: dict[str, Sequence[Input | Output | Parameter]]
        parts = {"input": model.inputs, "output": model.outputs, "parameter": model.all_parameters}
        found = {f"{kind}s": distinct(one.name for one in part) for kind, part in parts.items()}
        for kind, part in parts.items():
            found[f"{kind}_units"] = tuple(safe_unit(one.unit) for one in part)
        written = dict(zip(model.parameter_names, found["parameters"], strict=True))
        return found | {
            "states": distinct(self.graph.state_names),
            "free": tuple(written[name] for name in self.free),
            "signals": distinct(model.actuator_signals),
        }

    @property
    def origin(self) -> str:
        """Words for the head of a file: what the model is and where it comes from."""
        origin = f"{safe(self.model.name)}, written by oed_sysid {__version__}"
        if self.fit is None:
            return origin
        records = ", ".join(map(safe, self.fit.dataset.names))
        return f"{origin}; fitted to {records} ({safe(self.fit.estimator)})"

    @property
    def head(self) -> dict[str, object]:
        """What templates of every language fill in: origin, names and sizes."""
        name, graph = self.identifier, self.graph
        return {
            "origin": self.origin, "name": name, "upper": name.upper(),
            "step": repr(self.model.step), "own": graph.n_own, "nz": graph.n_full,
            "na": graph.n_actuator_memory, "ns": graph.n_sensor_memory, "nx": graph.n_states,
        }  # fmt: skip

    @property
    def std_errors(self) -> dict[str, float]:
        """Standard errors of the estimated parameters."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return dict(zip(self.free, errors.tolist(), strict=True))

    @property
    def is_plain(self) -> bool:
        """Whether code can carry every name as it is."""
        model, records = self.model, () if self.fit is None else self.fit.dataset.names
        channels = (*model.input_names, *model.output_names, *model.parameter_names)
        names = (model.name, *records, *self.graph.state_names, *channels)
        return all(safe(name, "(),") == name for name in names)

    def describe(self) -> dict[str, object]:
        """Names, units, values and covariance as plain data, for a file beside the code."""
        model = self.model
        std = self.std_errors
        return {
            "model": model.name,
            "made_by": f"oed_sysid {__version__}",
            "fitted_to": [] if self.fit is None else list(self.fit.dataset.names),
            "step": model.step,
            "integrator": model.integrator,
            "states": list(self.graph.state_names),
            "inputs": list(map(as_dict("name", "unit", "interpolation"), model.inputs)),
            "outputs": list(map(as_dict("name", "unit"), model.outputs)),
            "parameters": [
                {"name": name, "value": float(value), "unit": model.parameter(name).unit,
                 "std_error": std.get(name)}
                for name, value in zip(model.parameter_names, model.value_vector, strict=True)
            ],
            "estimated": list(self.free),
            "covariance": self.covariance.tolist(),
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Example:
    """A trajectory of the package that an exported model has to repeat.

    Attributes
    ----------
    times, inputs, own, parameters, outputs : ndarray
        As the exported simulation takes and gives them.
    """

    times: np.ndarray
    inputs: np.ndarray
    own: np.ndarray
    parameters: np.ndarray
    outputs: np.ndarray


def program_of(source: Fit | Model) -> Program:
    """Turn a fit or a model into a program.

    Parameters
    ----------
    source : Fit or Model
        What is exported; a fit brings its covariance.

    Returns
    -------
    Program

    Raises
    ------
    ModelError
        If it is neither.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> program = program_of(load_problem("nomoto_sparse_heading").model)
    >>> [routine.name for routine in program.routines], program.graph.n_full
    (['actuate', 'rates', 'observe', 'start'], 2)
    """
    fit = source if isinstance(source, Fit) else None
    model = fit.model if fit is not None else source
    if not isinstance(model, Model):
        raise ModelError(f"A {type(source).__name__} cannot be exported. Give a Fit or a Model.")
    return Program(model, fit)


def identifier(name: str) -> str:
    """Name as an identifier of C, Python and MATLAB.

    >>> identifier("REMUS 100 (6-DOF)")
    'REMUS_100_6_DOF'
    """
    text = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "model"
    text = text if text[0].isalpha() else f"model_{text}"
    return f"{text}_" if keyword.iskeyword(text) or text in _MATLAB_WORDS else text[:48]


def distinct(names: Iterable[str]) -> tuple[str, ...]:
    """Safe forms of names, no two alike."""
    found: list[str] = []
    for name in names:
        text = safe(name)
        while text in found:
            text += "_"
        found.append(text)
    return tuple(found)


_ARGUMENTS = {
    "actuate": (("memory", "u", "p", "t", "h"), ("d", "next")),
    "rates": (("x", "d", "p", "t"), ("dx",)),
    "slopes": (("x", "d", "p", "t"), ("jac",)),
    "observe": (("x", "d", "memory", "p", "t", "h"), ("y", "next")),
    "start": (("own", "u", "p", "t"), ("z",)),
}


def _routine(function: ca.Function) -> Routine:
    """Operations of a CasADi function of dense arguments."""
    name = function.name()
    arguments, results = _ARGUMENTS[name]
    flat = function.expand() if not function.is_a("SXFunction") else function
    operations = []
    for k in range(flat.n_instructions()):
        code = flat.instruction_id(k)
        inputs, outputs = flat.instruction_input(k), flat.instruction_output(k)
        if code == ca.OP_CONST:
            value = float(flat.instruction_constant(k))
            operations.append(Operation("const", tuple(outputs), (), value))
            continue
        word = {ca.OP_INPUT: "input", ca.OP_OUTPUT: "output"}.get(code, OPERATION_WORDS.get(code))
        if code == ca.OP_CALL:
            called = {one.name() for one in flat.find_functions()}
            raise ModelError(
                f"The model calls CasADi's function {', '.join(sorted(called)) or 'of its own'}, "
                "which has no elementary operations to export. Export it as casadi, control or "
                "latex, give its table or its formula, or generate C with CasADi from kernel "
                "functions (oed_sysid.compiled.graph.build)."
            )
        if word is None:
            raise ModelError(f"The model uses CasADi's operation {code}, which is not exported.")
        operations.append(Operation(word, tuple(outputs), tuple(inputs)))
    return Routine(
        name,
        tuple((text, flat.nnz_in(i)) for i, text in enumerate(arguments)),
        tuple((text, flat.nnz_out(i)) for i, text in enumerate(results)),
        tuple(operations),
    )


def _slopes(rates: ca.Function) -> ca.Function:
    """Dense derivatives of the rates by the states, row by row."""
    symbols = rates.sx_in()
    jacobian = ca.densify(ca.jacobian(rates.call(symbols)[0], symbols[0]))
    return ca.Function("slopes", symbols, [ca.vec(jacobian.T)], {"cse": True})


def example(program: Program) -> Example:
    """A trajectory of the package: the first record of the fit, or steps of every input.

    Parameters
    ----------
    program : Program
        Whose trajectory.
    """
    model, fit = program.model, program.fit
    if fit is not None:
        record = fit.dataset[0]
        keep = slice(0, 400)
        times, inputs = np.array(record.times[keep]), np.array(record.inputs[keep])
        own = np.array(fit.initial_states[0][: program.graph.n_own])
        model = model.with_values(dict(fit.local_values[0])) if fit.local_values[0] else model
    else:
        times = np.arange(60) * 2.5 * model.step
        phases = 2 * np.pi * np.outer(times / (20 * model.step), 1 + np.arange(len(model.inputs)))
        inputs = 0.1 * np.sign(np.sin(phases + 0.3))
        own = np.array([0.01 * state.scale for state in model.states])
    run = simulate_inputs(model, times, inputs=inputs, initial=own, throw=False)
    good = len(times) if run.ok else run.failed_at
    return Example(times[:good], inputs[:good], own, model.value_vector, run.outputs[:good])


# -- elementary operations as they are written in C ------------------------------------


_SAME = (
    "exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "floor", "ceil", "erf", "log1p", "expm1",
)  # fmt: skip
_TABLE = tables(__file__, "operations")


def _formats(language: str) -> dict[str, str]:
    """Right-hand side of every operation in a language."""
    own = dict(_TABLE[language])
    prefix = own.pop("prefix")
    return _TABLE["every"] | {word: f"{prefix}{word}({{0}})" for word in _SAME} | own


# Every language divides by zero and overflows alike, but spells infinity in its own way.
_NOT_FINITE = {"inf": "(1e308*10)", "-inf": "(-1e308*10)", "nan": "(0.0/0.0)"}


@dataclass(frozen=True)
class Dialect:
    """How a language writes straight-line code.

    Parameters
    ----------
    formats : mapping of str to str
        Right-hand side of every operation.
    element : callable
        ``(name, index)`` to the text of an element of an argument or result.
    end : str
        End of a statement.
    """

    formats: dict[str, str]
    element: Callable[[str, int], str]
    end: str
    head: Callable[[Routine], list[str]]
    tail: Callable[[Routine], str]
    indent: str = "    "
    gap: str = "\n\n\n"
    strings: Callable[[Iterable[str]], str] = lambda names: repr(tuple(names))
    flags: Callable[[Iterable[bool]], str] = lambda values: repr(tuple(values))
    numbers: Callable[[np.ndarray], str] = lambda values: str(values.tolist())
    loop: str = ".py.txt"

    def lines(self, routine: Routine) -> list[str]:
        """Statements of a function, without its head.

        Parameters
        ----------
        routine : Routine
            The function.
        """
        lines = []
        for one in routine.operations:
            left, right = f"w{one.target[0]}", ""
            if one.word == "const":
                right = _NOT_FINITE.get(repr(one.value), repr(one.value))
            elif one.word == "input":
                right = self.element(routine.arguments[one.operands[0]][0], one.operands[1])
            elif one.word == "output":
                left = self.element(routine.results[one.target[0]][0], one.target[1])
                right = f"w{one.operands[0]}"
            else:
                right = self.formats[one.word].format(*(f"w{index}" for index in one.operands))
            lines.append(f"{left} = {right}{self.end}")
        return lines

    def function(self, routine: Routine) -> str:
        """Text of a function."""
        inside = [f"{self.indent}{line}" for line in self.lines(routine)]
        return "\n".join([*self.head(routine), *inside, self.tail(routine)])


def template(name: str) -> Template:
    """Text around the functions, kept in a file of its own."""
    return Template(files("oed_sysid.export").joinpath("templates", name).read_text("utf-8"))


def filled(program: Program, page: str, language: Dialect, /, **more: object) -> str:
    """Text of a template, with names, numbers and functions as a language writes them."""
    words = {key: language.strings(names) for key, names in program.names.items()}
    step = template(f"{'implicit' if program.implicit else 'explicit'}{language.loop}")
    weights = ", ".join(repr(w) for row in STAGES for w in row)
    return template(page).substitute(
        program.head
        | words
        | {
            "linear": language.flags(program.graph.linear_inputs),
            "values": language.numbers(program.model.value_vector),
            "covariance": language.numbers(np.array(program.covariance)),
            "functions": language.gap.join(map(language.function, program.routines)),
            "advance": step.substitute(gamma=repr(GAMMA), weights=weights),
        }
        | more
    )


_SCALARS = ("t", "h")


def _from_zero(name: str, index: int) -> str:
    return name if name in _SCALARS else f"{name}[{index}]"


def _from_one(name: str, index: int) -> str:
    return name if name in _SCALARS else f"{name}({index + 1})"


def _listed(parts: Iterable[tuple[str, int]]) -> str:
    return ", ".join(name for name, _ in parts)


def _head_of_c(routine: Routine) -> list[str]:
    arguments = [
        f"double {name}" if name in _SCALARS else f"const double *{name}"
        for name, _ in routine.arguments
    ]
    results = [f"double *{name}" for name, _ in routine.results]
    used = sorted({one.target[0] for one in routine.operations if one.word != "output"})
    lines = [f"static void {routine.name}({', '.join([*arguments, *results])})", "{"]
    for first in range(0, len(used), 16):
        lines.append("    double " + ", ".join(f"w{i}" for i in used[first : first + 16]) + ";")
    unused = [name for name, _ in (*routine.arguments, *routine.results)]
    return [*lines, "    " + " ".join(f"(void){name};" for name in unused)]


def numbers_in_c(values: Iterable[float] | np.ndarray) -> str:
    """Numbers of an initialiser, row by row."""
    flat = np.ravel(np.asarray(values, dtype=float))
    texts = [repr(float(value)).replace("nan", "NAN").replace("inf", "INFINITY") for value in flat]
    rows = [", ".join(texts[i : i + 6]) for i in range(0, len(texts), 6)]
    return ",\n    ".join(rows) or "0.0"


def _head_of_python(zero: str) -> Callable[[Routine], list[str]]:
    def head(routine: Routine) -> list[str]:
        lines = [f"def {routine.name}({_listed(routine.arguments)}):"]
        return lines + [f"    {name} = [{zero}] * {length}" for name, length in routine.results]

    return head


def _tail_of_python(routine: Routine) -> str:
    return f"    return {_listed(routine.results)}"


def _head_of_matlab(routine: Routine) -> list[str]:
    call = f"{routine.name}({_listed(routine.arguments)})"
    lines = [f"function [{_listed(routine.results)}] = {call}"]
    return lines + [f"{name} = zeros({length}, 1);" for name, length in routine.results]


IN_C = Dialect(
    _formats("c"), _from_zero, ";", _head_of_c, lambda routine: "}", gap="\n\n",
    strings=lambda names: ", ".join(f'"{name}"' for name in names) or '""',
    flags=lambda values: ", ".join(str(int(one)) for one in values) or "0",
    numbers=numbers_in_c, loop=".c",
)  # fmt: skip
IN_PYTHON = Dialect(_formats("python"), _from_zero, "", _head_of_python("0.0"), _tail_of_python)
IN_MATLAB = Dialect(
    _formats("matlab"), _from_one, ";", _head_of_matlab, lambda routine: "end", "", "\n\n",
    strings=lambda names: ", ".join(f"'{name}'" for name in names),
    flags=lambda values: " ".join(str(int(one)) for one in values),
    numbers=lambda values: "\n".join(" ".join(map(repr, np.ravel(row).tolist())) for row in values),
)  # fmt: skip
IN_SYMPY = Dialect(_formats("sympy"), _from_zero, "", _head_of_python("sp.S(0)"), _tail_of_python)
