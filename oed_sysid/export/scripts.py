r"""A model as scripts for Python, MATLAB, CasADi, python-control, SymPy and LaTeX.

A Python module that needs NumPy only. A MATLAB function file that runs in Octave too; no toolbox
is needed.

CasADi functions as files that any CasADi of the same or a later version loads.

``rates``, ``actuate``, ``observe`` and ``start`` are those of the model; ``advance`` is one
integration step and ``sample`` one measurement, which sensors with memory take between any two
steps. ``model.json`` has names, values and covariance.

A linear model for python-control, about a trim.

.. math:: \dot x = A x + B u, \qquad y = C x + D u,

all being deviations from the trim; actuators and sensors are settled. The covariance
:math:`\Sigma` of the parameters becomes standard errors of the entries of A and B, through their
derivatives :math:`J` by the parameters (the trim moves with them), :math:`J \Sigma J^T`.

SymPy expressions in a Python module; the equations as LaTeX, with letters and with numbers.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.errors import ModelError, SimulationError
from oed_sysid.experiments.steady import equilibrium, linearise
from oed_sysid.export.program import (
    IN_MATLAB,
    IN_PYTHON,
    IN_SYMPY,
    Program,
    filled,
    template,
)
from oed_sysid.physics.model import Model, latex_lines
from oed_sysid.runtime.files import whole_file, write_text
from oed_sysid.text import notation
from oed_sysid.text.typeset import safe, safe_unit

# -- a Python module that needs NumPy only ---------------------------------------------


def python_text(program: Program, file: Path) -> str:
    """Text of the module."""
    model, names = program.model, program.names
    rows = [
        f"    {name!r}: {float(value)!r},  # {unit}"
        for name, unit, value in zip(
            names["parameters"], names["parameter_units"], model.value_vector, strict=True
        )
    ]
    return filled(
        program, "model.py.txt", IN_PYTHON, title=repr(safe(model.name)), parameters="\n".join(rows)
    )


# -- a MATLAB function file that runs in Octave too ------------------------------------


def matlab_text(program: Program, file: Path) -> str:
    """Text of the function file, whose function has the name of the file.

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
    return filled(program, "model.m.txt", IN_MATLAB, name=file.stem)


# -- CasADi functions as files that any CasADi of the same or a later version loads ----


def write_casadi(program: Program, folder: Path) -> tuple[Path, ...]:
    """Write one file per function, and ``model.json``.

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
    files, words = [], {}
    for name in ("rates", "actuate", "observe", "start", "advance", "sample"):
        function = getattr(program.graph, name)
        files.append(folder / f"{name}.casadi")
        with whole_file(files[-1]) as part:
            function.save(str(part))
        shapes = [list(function.size_in(i)) for i in range(function.n_in())]
        words[name] = {"arguments": function.name_in(), "shapes": shapes}
    text = json.dumps(program.describe() | {"functions": words}, indent=2)
    write_text(folder / "model.json", text + "\n")
    return (*files, folder / "model.json")


# -- a linear model for python-control -------------------------------------------------


def control_text(program: Program, file: Path, trim: Mapping[str, float] | None = None) -> str:
    """Text of a Python file that makes a ``control.StateSpace``.

    Parameters
    ----------
    program : Program
        The model.
    file : Path
        The file.
    trim : mapping of str to float, optional
        Inputs and states that are given there; inputs that are left out are zero, states are
        solved for.

    Raises
    ------
    ModelError
        If a name is unknown or there is no equilibrium.
    """
    model = program.model
    matrices, point = _linear(model, dict(trim or {}))
    slopes: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for name, step in program.std_errors.items():
        # A thousandth of the standard error is far below the curvature and above rounding.
        size = 1e-3 * step or 1e-9
        moved = (model.with_values({name: model.values[name] + by}) for by in (size, -size))
        up, down = (_linear(one, dict(trim or {}), guess=point)[0] for one in moved)
        for k, found in enumerate(slopes):
            found.append((up[k] - down[k]) / (2 * size))
    spread = []
    for matrix, found in zip(matrices, slopes, strict=False):
        by = np.array(found).reshape(-1, *matrix.shape)
        square = np.einsum("iab,ij,jab->ab", by, program.covariance, by)
        spread.append(np.sqrt(np.maximum(square, 0.0)))
    names, values = program.names, [float(value) for value in model.value_vector]
    return template("linear.py.txt").substitute(
        origin=program.origin,
        file=safe(file.name),
        states=dict(zip(names["states"], point.states.values(), strict=False)),
        inputs=dict(zip(names["inputs"], point.inputs.values(), strict=True)),
        **dict(zip("abcd", map(_rows, matrices), strict=True)),
        a_std=_rows(spread[0]),
        b_std=_rows(spread[1]),
        parameters=dict(zip(names["parameters"], values, strict=True)),
        estimated=names["free"],
        covariance=program.covariance.tolist(),
        input_names=list(names["inputs"]),
        output_names=list(names["outputs"]),
        state_names=list(names["states"]),
        name=repr(program.identifier),
    )


def _linear(
    model: Model, trim: dict[str, float], guess: Any = None
) -> tuple[tuple[np.ndarray, ...], Any]:
    """Matrices and equilibrium of a model."""
    inputs = {name: trim.pop(name, 0.0) for name in model.input_names}
    start = dict(guess.states) if guess is not None else None
    try:
        point = equilibrium(model, inputs=inputs, fixed=trim, guess=start)
        system = linearise(model, point)
    except SimulationError as error:
        raise ModelError(
            f"There is no trim to linearise about. {error} Inputs that are not given are zero: "
            "give them, or states to be held, with --at NAME=VALUE or trim={...}."
        ) from None
    return (system.A, system.B, system.C, system.D), point


def _rows(matrix: np.ndarray) -> str:
    rows = [str([float(value) for value in row]) for row in np.atleast_2d(matrix)]
    return "[\n    " + ",\n    ".join(rows) + ",\n]"


# -- SymPy expressions, and equations with a table of values as a LaTeX document -------


def module_text(program: Program, file: Path) -> str:
    """Text of the module."""

    def symbols(names: tuple[str, ...]) -> str:
        inside = ", ".join(f'sp.Symbol("{name}", real=True)' for name in names)
        return f"({inside},)" if names else "()"

    known, graph = program.names, program.graph
    used = {"t", "h", *known["states"], *known["parameters"]}
    signals = tuple(name if name not in used else f"{name}_signal" for name in known["signals"])
    return filled(
        program,
        "sympy.py.txt",
        IN_SYMPY,
        states=symbols(known["states"]),
        inputs=symbols(known["inputs"]),
        signals=symbols(signals),
        parameters=symbols(known["parameters"]),
        memory_a=symbols(tuple(f"actuator_memory_{i}" for i in range(graph.n_actuator_memory))),
        memory_s=symbols(tuple(f"sensor_memory_{i}" for i in range(graph.n_sensor_memory))),
    )


def latex_text(program: Program, file: Path) -> str:
    """The equations and a table of values as a LaTeX document."""
    model = program.model
    values = dict(zip(model.parameter_names, map(float, model.value_vector), strict=True))
    rows = []
    for name, value in values.items():
        interval = ""
        if program.fit is not None and name in program.std_errors:
            low, high = program.fit.interval(name)
            interval = f"${low:.4g}$ to ${high:.4g}$"
        unit = safe_unit(model.parameter(name).unit).replace("^", r"\^{}")
        rows.append(rf"${notation.latex(name)}$ & ${value:.5g}$ & {interval} & {unit} \\")
    return template("page.tex.txt").substitute(
        origin=program.origin,
        title=safe(model.name).replace("_", r"\_"),
        letters=" \\\\\n".join(latex_lines(model)),
        numbers=" \\\\\n".join(latex_lines(model, values)),
        rows="\n".join(rows),
    )
