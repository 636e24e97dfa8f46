"""A MATLAB function file that runs in Octave too; no toolbox is needed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.export.c_code import template
from oed_sysid.export.dialects import IN_MATLAB
from oed_sysid.export.program import Program, Routine, identifier
from oed_sysid.runtime.files import write_text


def write_matlab(program: Program, path: Path) -> tuple[Path, ...]:
    """Write a function file, named as MATLAB wants it: after its function.

    Parameters
    ----------
    program : Program
        The model; explicit only.
    path : Path
        Folder for ``NAME.m``, or ``NAME.m`` itself.

    Returns
    -------
    tuple of Path
        The file.

    Raises
    ------
    ModelError
        If the model is stiff: MATLAB has solvers of its own for such.
    """
    if program.implicit:
        raise ModelError(
            f"Model {program.model.name!r} is stiff (integrator='implicit'), which is not written "
            "for MATLAB. Export it as c, python or fmu."
        )
    name = identifier(path.stem) if path.suffix == ".m" else program.identifier
    file = path.with_name(f"{name}.m") if path.suffix == ".m" else path / f"{name}.m"
    write_text(file, matlab_text(program, name))
    return (file,)


def matlab_text(program: Program, name: str) -> str:
    """Text of the function file."""
    model, names = program.model, program.names
    return template("model.m.txt").substitute(
        origin=program.origin,
        name=name,
        states=_strings(names.states),
        inputs=_strings(names.inputs),
        input_units=_strings(names.input_units),
        linear=" ".join(str(int(one)) for one in program.linear_inputs),
        outputs=_strings(names.outputs),
        output_units=_strings(names.output_units),
        own=program.n_own,
        na=program.n_actuator,
        ns=program.n_sensor,
        step=repr(model.step),
        parameters=_strings(names.parameters),
        values="\n".join(repr(float(value)) for value in model.value_vector),
        estimated=_strings(names.free),
        covariance="\n".join(
            " ".join(map(repr, row)) for row in np.array(program.covariance).tolist()
        ),
        functions="\n\n".join(_function(one) for one in program.routines),
    )


def _strings(names: Iterable[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _function(routine: Routine) -> str:
    results = ", ".join(name for name, _ in routine.results)
    arguments = ", ".join(name for name, _ in routine.arguments)
    lines = [f"function [{results}] = {routine.name}({arguments})"]
    lines += [f"{name} = zeros({length}, 1);" for name, length in routine.results]
    return "\n".join([*lines, *IN_MATLAB.lines(routine), "end"])
