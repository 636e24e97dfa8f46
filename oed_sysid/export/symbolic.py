"""SymPy expressions in a Python module; the equations as LaTeX, with letters and with numbers."""

from __future__ import annotations

from pathlib import Path

from oed_sysid.export.program import IN_SYMPY, Program, filled, template
from oed_sysid.physics.model import latex_lines
from oed_sysid.text import notation
from oed_sysid.text.typeset import safe, safe_unit


def module_text(program: Program, file: Path) -> str:
    """Text of the module."""

    def symbols(names: tuple[str, ...]) -> str:
        inside = ", ".join(f'sp.Symbol("{name}", real=True)' for name in names)
        return f"({inside},)" if names else "()"

    known, graph = program.names, program.graph
    used = {"t", "h", *known.states, *known.parameters}
    signals = tuple(name if name not in used else f"{name}_signal" for name in known.signals)
    return filled(
        program,
        "sympy.py.txt",
        IN_SYMPY,
        states=symbols(known.states),
        inputs=symbols(known.inputs),
        signals=symbols(signals),
        parameters=symbols(known.parameters),
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
