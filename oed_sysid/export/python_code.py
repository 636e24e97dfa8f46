"""A Python module that needs NumPy only."""

from __future__ import annotations

from pathlib import Path

from oed_sysid.compiled.graph import GAMMA, STAGES
from oed_sysid.export.c_code import template
from oed_sysid.export.dialects import IN_PYTHON
from oed_sysid.export.program import Program, Routine
from oed_sysid.runtime.files import write_text
from oed_sysid.text.typeset import safe


def write_python(program: Program, path: Path) -> tuple[Path, ...]:
    """Write a module.

    Parameters
    ----------
    program : Program
        The model.
    path : Path
        ``name.py``, or a folder for ``NAME.py``.

    Returns
    -------
    tuple of Path
        The file.
    """
    file = path if path.suffix == ".py" else path / f"{program.identifier}.py"
    write_text(file, python_text(program))
    return (file,)


def python_text(program: Program) -> str:
    """Text of the module."""
    model, names = program.model, program.names
    rows = [
        f"    {name!r}: {float(value)!r},  # {unit}"
        for name, unit, value in zip(
            names.parameters, names.parameter_units, model.value_vector, strict=True
        )
    ]
    step = template("implicit.py.txt" if program.implicit else "explicit.py.txt").substitute(
        gamma=repr(GAMMA), weights=", ".join(repr(w) for row in STAGES for w in row)
    )
    return template("model.py.txt").substitute(
        origin=program.origin,
        title=repr(safe(model.name)),
        states=names.states,
        inputs=names.inputs,
        input_units=names.input_units,
        linear=program.linear_inputs,
        outputs=names.outputs,
        output_units=names.output_units,
        own=program.n_own,
        na=program.n_actuator,
        ns=program.n_sensor,
        step=repr(model.step),
        parameters="\n".join(rows),
        estimated=names.free,
        covariance=program.covariance.tolist(),
        functions="\n\n\n".join(_function(one) for one in program.routines),
        step_function=step,
    )


def _function(routine: Routine) -> str:
    names = ", ".join(name for name, _ in routine.arguments)
    lines = [f"def {routine.name}({names}):"]
    lines += [f"    {name} = [0.0] * {length}" for name, length in routine.results]
    lines += [f"    {line}" for line in IN_PYTHON.lines(routine)]
    return "\n".join([*lines, f"    return {', '.join(name for name, _ in routine.results)}"])
