"""SymPy expressions in a Python module; the equations as LaTeX, with letters and with numbers."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from oed_sysid.export.program import IN_SYMPY, Program, python_function, template
from oed_sysid.physics.model import Model, force_text, inertia_terms
from oed_sysid.text import notation
from oed_sysid.text.expressions import to_latex
from oed_sysid.text.typeset import safe, safe_unit


def module_text(program: Program, file: Path) -> str:
    """Text of the module."""
    model = program.model

    def symbols(names: tuple[str, ...]) -> str:
        inside = ", ".join(f'sp.Symbol("{name}", real=True)' for name in names)
        return f"({inside},)" if names else "()"

    known = program.names
    used = {"t", "h", *known.states, *known.parameters}
    signals = tuple(name if name not in used else f"{name}_signal" for name in known.signals)
    return template("sympy.py.txt").substitute(
        origin=program.origin,
        states=symbols(known.states),
        inputs=symbols(known.inputs),
        signals=symbols(signals),
        parameters=symbols(known.parameters),
        outputs=known.outputs,
        memory_a=symbols(tuple(f"actuator_memory_{i}" for i in range(program.n_actuator))),
        memory_s=symbols(tuple(f"sensor_memory_{i}" for i in range(program.n_sensor))),
        values=[float(value) for value in model.value_vector],
        estimated=known.free,
        covariance=program.covariance.tolist(),
        functions="\n\n\n".join(
            python_function(IN_SYMPY, one, "sp.S(0)") for one in program.routines
        ),
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
        rows.append(rf"${_name(name)}$ & ${value:.5g}$ & {interval} & {unit} \\")
    return template("page.tex.txt").substitute(
        origin=program.origin,
        title=safe(model.name).replace("_", r"\_"),
        letters=" \\\\\n".join(_equations(program, {})),
        numbers=" \\\\\n".join(_equations(program, values)),
        rows="\n".join(rows),
    )


def _name(name: str) -> str:
    return notation.latex(name) if notation.is_derivative(name) else to_latex(name)


def _equations(program: Program, values: Mapping[str, float]) -> Iterator[str]:
    """Every equation of the model, in the order of the chain from command to sensor."""
    model = program.model

    def write(text: str) -> str:
        return to_latex(_with_numbers(text, values))

    def line(left: str, text: str) -> str:
        return f"{left} &= {write(text)}"

    def replaced(stage: str) -> Iterator[str]:
        for effect in model.effects:
            for signal, text in effect.terms.items() if effect.stage == stage else ():
                yield f"{to_latex(str(signal))} &\\leftarrow {write(text)}"

    named = {name: text for name, text in model.actuator_signals.items() if text != name}
    yield from (line(to_latex(name), text) for name, text in named.items())
    yield from replaced("actuator")
    yield from (line(to_latex(name), text) for name, text in model.signals.items())
    yield from replaced("environment")
    for effect in model.effects:
        yield from (line(to_latex(name), text) for name, text in effect.definitions.items())
    for axis in model.axes:
        yield f"{_inertia(model, axis, write)} &= {write(force_text(model, axis))}"
    for state, rate in model.kinematics.items():
        added = force_text(model, state)
        yield line(rf"\dot{{{to_latex(state)}}}", rate if added == "0" else f"{rate} + {added}")
    for effect in model.effects:
        for extra in effect.states:
            yield line(rf"\dot{{{to_latex(extra.name)}}}", extra.rate)
    for output in model.outputs:
        yield line(rf"{to_latex(output.name)}_{{\text{{measured}}}}", output.source)


def _inertia(model: Model, axis: str, write: Callable[[str], str]) -> str:
    """Left-hand side of the equation of an axis."""
    parts = []
    for velocity, texts in inertia_terms(model, axis):
        factor = write(" + ".join(f"({text})" for text in texts)) if texts else ""
        rate = rf"\dot{{{to_latex(velocity)}}}"
        parts.append(rf"\left({factor}\right) {rate}" if texts else rate)
    return " + ".join(parts)


class _Numbers(ast.NodeTransformer):
    """Put numbers in the place of names."""

    def __init__(self, values: Mapping[str, float]) -> None:
        self.values = values

    def visit_Call(self, node: ast.Call) -> ast.Call:  # names of functions stay
        node.args = [self.visit(argument) for argument in node.args]
        return node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id not in self.values:
            return node
        return ast.Constant(float(f"{self.values[node.id]:.4g}"))


def _with_numbers(text: str, values: Mapping[str, float]) -> str:
    if not values:
        return text
    tree = ast.parse(text.strip(), mode="eval")
    return ast.unparse(_Numbers(values).visit(tree))
