"""C99 without dependencies: header, source, and a program that tests them against the package."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np

from oed_sysid.compiled.graph import GAMMA, STAGES
from oed_sysid.export.dialects import IN_C
from oed_sysid.export.program import Example, Program, Routine, example
from oed_sysid.runtime.files import write_text

# A self-test fails beyond this, relative to the largest value of each output.
TOLERANCE = 1e-9


def write_c(program: Program, folder: Path) -> tuple[Path, ...]:
    """Write ``NAME.h``, ``NAME.c`` and ``NAME_test.c``.

    Parameters
    ----------
    program : Program
        The model.
    folder : Path
        Where the files go.

    Returns
    -------
    tuple of Path
        The files.
    """
    name = program.identifier
    texts = {
        f"{name}.h": header(program),
        f"{name}.c": source(program),
        f"{name}_test.c": self_test(program, example(program)),
    }
    for file, text in texts.items():
        write_text(folder / file, text)
    return tuple(folder / file for file in texts)


def header(program: Program) -> str:
    """Text of the header: sizes, names, and what can be called."""
    return template("model.h").substitute(
        origin=program.origin,
        name=program.identifier,
        upper=program.identifier.upper(),
        nx=len(program.state_names),
        nz=program.n_full,
        nu=len(program.model.inputs),
        ny=len(program.model.outputs),
        np=len(program.model.all_parameters),
        nf=len(program.free),
        own=program.n_own,
        step=repr(program.model.step),
    )


def source(program: Program) -> str:
    """Text of the source: the model's functions, and the loop around them."""
    model = program.model
    steps = template("implicit.c" if program.implicit else "explicit.c")
    loop = steps.substitute(
        gamma=repr(GAMMA), weights=", ".join(repr(w) for row in STAGES for w in row)
    )
    return template("model.c").substitute(
        origin=program.origin,
        name=program.identifier,
        upper=program.identifier.upper(),
        na=program.n_actuator,
        ns=program.n_sensor,
        nd=program.n_signals,
        linear=", ".join(str(int(one)) for one in program.linear_inputs) or "0",
        any_linear=int(any(program.linear_inputs)),
        functions="\n\n".join(_function(one) for one in program.routines),
        advance=loop,
        state_names=_strings(program.names.states),
        input_names=_strings(program.names.inputs),
        output_names=_strings(program.names.outputs),
        parameter_names=_strings(program.names.parameters),
        estimated_names=_strings(program.names.free),
        values=_numbers(model.value_vector),
        covariance=_numbers(program.covariance),
    )


def self_test(program: Program, run: Example) -> str:
    """Text of a program that repeats a trajectory of the package."""
    return template("self_test.c").substitute(
        origin=program.origin,
        name=program.identifier,
        upper=program.identifier.upper(),
        n=len(run.times),
        times=_numbers(run.times),
        inputs=_numbers(run.inputs),
        own=_numbers(run.own),
        parameters=_numbers(run.parameters),
        expected=_numbers(run.outputs),
        tolerance=repr(TOLERANCE),
    )


def _function(routine: Routine) -> str:
    arguments = [
        f"double {name}" if name in ("t", "h") else f"const double *{name}"
        for name, _ in routine.arguments
    ]
    results = [f"double *{name}" for name, _ in routine.results]
    used = sorted({one.target[0] for one in routine.operations if one.word != "output"})
    lines = [f"static void {routine.name}({', '.join([*arguments, *results])})", "{"]
    for first in range(0, len(used), 16):
        lines.append("    double " + ", ".join(f"w{i}" for i in used[first : first + 16]) + ";")
    unused = [name for name, _ in (*routine.arguments, *routine.results)]
    lines.append("    " + " ".join(f"(void){name};" for name in unused))
    lines += [f"    {line}" for line in IN_C.lines(routine)]
    return "\n".join([*lines, "}"])


def _numbers(values: Iterable[float] | np.ndarray) -> str:
    flat = np.ravel(np.asarray(values, dtype=float))
    texts = [repr(float(value)).replace("nan", "NAN").replace("inf", "INFINITY") for value in flat]
    rows = [", ".join(texts[i : i + 6]) for i in range(0, len(texts), 6)]
    return ",\n    ".join(rows) or "0.0"


def _strings(names: Iterable[str]) -> str:
    return ", ".join(f'"{name}"' for name in names) or '""'


def template(name: str) -> Template:
    """Text around the functions, kept in a file of its own."""
    return Template(files("oed_sysid.export").joinpath("templates", name).read_text("utf-8"))
