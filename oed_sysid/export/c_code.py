"""C99 without dependencies: header, source, and a program that tests them against the package.

A Functional Mock-up Unit (FMI 2.0, co-simulation): the C code with the standard's functions.

The unit is compiled for this machine where a C compiler is found; its sources are always inside,
so that any importer that compiles can use it elsewhere. Between two communication points inputs
are held; a communication step equal to the sample time repeats the package's simulation of held
inputs. ``resources/model.json`` has the covariance of the parameters.
"""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
import subprocess
import sys
import tempfile
import warnings
import zipfile
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

from oed_sysid.errors import FileError
from oed_sysid.export.program import (
    IN_C,
    Example,
    Program,
    distinct,
    example,
    filled,
    numbers_in_c,
    template,
)
from oed_sysid.runtime.files import whole_file
from oed_sysid.runtime.version import __version__
from oed_sysid.text.typeset import safe

# -- C99 without dependencies ----------------------------------------------------------


# A self-test fails beyond this, relative to the largest value of each output.
TOLERANCE = 1e-9


def header(program: Program, file: Path | None = None) -> str:
    """Text of the header: sizes, names, and what can be called."""
    return template("model.h").substitute(
        **program.head,
        nu=len(program.model.inputs),
        ny=len(program.model.outputs),
        np=len(program.model.all_parameters),
        nf=len(program.free),
    )


def source(program: Program, file: Path | None = None) -> str:
    """Text of the source: the model's functions, and the loop around them."""
    return filled(
        program, "model.c", IN_C, nd=program.n_signals, any_linear=int(any(program.linear_inputs))
    )


def example_test(program: Program, file: Path | None = None) -> str:
    """Text of a program that repeats a trajectory of the package on another machine."""
    return self_test(program, example(program))


def self_test(program: Program, run: Example) -> str:
    """Text of a program that repeats one trajectory."""
    return template("self_test.c").substitute(
        **program.head | {"own": numbers_in_c(run.own)},
        n=len(run.times),
        times=numbers_in_c(run.times),
        inputs=numbers_in_c(run.inputs),
        parameters=numbers_in_c(run.parameters),
        expected=numbers_in_c(run.outputs),
        tolerance=repr(TOLERANCE),
    )


# -- a Functional Mock-up Unit ---------------------------------------------------------


_PLATFORMS = {
    ("linux", "x86_64"): ("linux64", ".so"),
    ("linux", "aarch64"): ("aarch64-linux", ".so"),
    ("darwin", "x86_64"): ("darwin64", ".dylib"),
    ("darwin", "arm64"): ("darwin64", ".dylib"),
    ("win32", "AMD64"): ("win64", ".dll"),
}


def write_fmu(program: Program, path: Path) -> tuple[Path, ...]:
    """Write a unit.

    Parameters
    ----------
    program : Program
        The model.
    path : Path
        ``name.fmu``, or a folder for ``NAME.fmu``.

    Returns
    -------
    tuple of Path
        The file.

    Raises
    ------
    FileError
        If the C compiler refuses the code.
    """
    name = program.identifier
    file = path if path.suffix == ".fmu" else path / f"{name}.fmu"
    code = source(program)
    guid = hashlib.sha256((code + header(program)).encode()).hexdigest()[:32]
    texts = {
        f"{name}.h": header(program),
        f"{name}.c": code,
        f"{name}_fmu.c": template("fmu.c").substitute(**program.head, guid=guid),
    }
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for title, text in texts.items():
            (place / title).write_text(text, encoding="utf-8")
        library = _compiled(place, name)
        with whole_file(file) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as unit:
            unit.writestr("modelDescription.xml", description(program, guid))
            for title, text in texts.items():
                unit.writestr(f"sources/{title}", text)
            unit.writestr("resources/model.json", json.dumps(program.describe(), indent=2))
            if library is not None:
                unit.write(library, f"binaries/{library.parent.name}/{library.name}")
    return (file,)


def _compiled(place: Path, name: str) -> Path | None:
    """The library for this machine; None without a compiler."""
    known = _PLATFORMS.get((sys.platform, platform.machine()))
    compiler = next((one for one in ("cc", "gcc", "clang") if shutil.which(one)), None)
    if known is None or compiler is None:
        warnings.warn(
            "The FMU holds sources only, because no C compiler was found for this machine. "
            "Importers that compile (FMPy: fmpy compile) can use it.",
            stacklevel=4,
        )
        return None
    folder, ending = known
    target = place / folder / f"{name}{ending}"
    target.parent.mkdir()
    sources = [str(place / f"{name}.c"), str(place / f"{name}_fmu.c")]
    command = [compiler, "-O2", "-std=c99", "-fPIC", "-shared", "-fvisibility=hidden", *sources]
    done = subprocess.run([*command, "-lm", "-o", str(target)], capture_output=True, check=False)
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise FileError(f"{compiler} refuses the code of the FMU: {' '.join(last)}")
    return target


Variable = tuple[str, str, float | None, dict[str, str]]


def _variables(program: Program) -> list[Variable]:
    """Name, unit, start value and attributes of every variable, in the order of the C code."""
    names, moving = program.names, {"variability": "continuous", "initial": "calculated"}
    exact = {"causality": "parameter", "initial": "exact"}
    rows: list[Variable] = []
    for name, unit, linear in zip(
        names.inputs, names.input_units, program.linear_inputs, strict=True
    ):
        held = "continuous" if linear else "discrete"
        rows.append((name, unit, 0.0, {"causality": "input", "variability": held}))
    for name, unit in zip(names.outputs, names.output_units, strict=True):
        title = f"{name}_measured" if name in names.states else name  # beside the state itself
        rows.append((title, unit, None, {"causality": "output", **moving}))
    values = program.model.value_vector
    for name, unit, value in zip(names.parameters, names.parameter_units, values, strict=True):
        rows.append((name, unit, value, {"variability": "tunable", **exact}))
    for name in names.states[: program.graph.n_own]:
        words = {"description": f"{name} at the start"}
        rows.append((f"{name}_start", "", 0.0, {"variability": "fixed", **exact, **words}))
    return [*rows, *((name, "", None, {"causality": "local", **moving}) for name in names.states)]


def description(program: Program, guid: str) -> str:
    """Text of ``modelDescription.xml``.

    Parameters
    ----------
    program : Program
        The model.
    guid : str
        Digest of the code, which the library compares.
    """
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=safe(program.model.name),
        guid=f"{{{guid}}}",
        description=program.origin,
        generationTool=f"oed_sysid {__version__}",
        generationDateAndTime=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    unit = ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=program.identifier,
        canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    files = ElementTree.SubElement(unit, "SourceFiles")
    for title in (f"{program.identifier}.c", f"{program.identifier}_fmu.c"):
        ElementTree.SubElement(files, "File", name=title)
    rows = _variables(program)
    if stated := sorted({unit_text for _, unit_text, _, _ in rows} - {""}):
        units = ElementTree.SubElement(root, "UnitDefinitions")
        for text in stated:
            ElementTree.SubElement(units, "Unit", name=text)
    _add_variables(root, rows)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + text + "\n"


def _add_variables(root: ElementTree.Element, rows: list[Variable]) -> None:
    """Add the variables, and which of them are outputs, counted from one."""
    variables = ElementTree.SubElement(root, "ModelVariables")
    titles = distinct(title for title, _, _, _ in rows)
    for number, (title, (_, unit_text, start, more)) in enumerate(zip(titles, rows, strict=True)):
        known = {"name": title, "valueReference": str(number), **more}
        one = ElementTree.SubElement(variables, "ScalarVariable", known)
        given = {"unit": unit_text, "start": "" if start is None else repr(float(start))}
        ElementTree.SubElement(one, "Real", {what: text for what, text in given.items() if text})
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind in ("Outputs", "InitialUnknowns"):
        listed = ElementTree.SubElement(structure, kind)
        for number, row in enumerate(rows, start=1):
            if row[-1]["causality"] == "output":
                ElementTree.SubElement(listed, "Unknown", index=str(number))
