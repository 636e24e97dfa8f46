"""C99 without dependencies: header, source, and a program that tests them against the package.

A Functional Mock-up Unit (FMI 2.0 and 3.0): the C code with the standard's functions, for
co-simulation, and for model exchange where no actuator or sensor has sampled memory.

The unit is compiled for this machine where a C compiler is found, and for the other platforms
where ``ziglang`` is installed, whose compiler crosses; its sources are always inside, so that any
importer that compiles can use it elsewhere. Between two communication points inputs are held; a
communication step equal to the sample time repeats the package's simulation of held inputs.
``resources/model.json`` has the covariance of the parameters.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import platform
import shutil
import subprocess
import sys
import tempfile
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from string import Template
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


@dataclass(frozen=True)
class Platform:
    """A platform that a unit can hold a library for.

    Attributes
    ----------
    folders : mapping of str to str
        Its folder in a unit, by version of the interface; missing where the standard has none.
    ending : str
        Of a shared library.
    target : str
        What zig's compiler calls it.
    """

    folders: Mapping[str, str]
    ending: str
    target: str


_PLATFORMS = {
    ("linux", "x86_64"): Platform(
        {"2.0": "linux64", "3.0": "x86_64-linux"}, ".so", "x86_64-linux-gnu"
    ),
    ("linux", "aarch64"): Platform(
        {"2.0": "aarch64-linux", "3.0": "aarch64-linux"}, ".so", "aarch64-linux-gnu"
    ),
    ("darwin", "x86_64"): Platform(
        {"2.0": "darwin64", "3.0": "x86_64-darwin"}, ".dylib", "x86_64-macos"
    ),
    ("darwin", "arm64"): Platform({"3.0": "aarch64-darwin"}, ".dylib", "aarch64-macos"),
    ("win32", "AMD64"): Platform(
        {"2.0": "win64", "3.0": "x86_64-windows"}, ".dll", "x86_64-windows-gnu"
    ),
}


def write_fmu(program: Program, path: Path, version: str = "2.0") -> tuple[Path, ...]:
    """Write a unit.

    Parameters
    ----------
    program : Program
        The model.
    path : Path
        ``name.fmu``, or a folder for ``NAME.fmu``.
    version : str
        Of the interface, ``"2.0"`` or ``"3.0"``.

    Returns
    -------
    tuple of Path
        The file.

    Raises
    ------
    FileError
        If a C compiler refuses the code.
    """
    name = program.identifier
    file = path if path.suffix == ".fmu" else path / f"{name}.fmu"
    code = source(program)
    guid = hashlib.sha256((code + header(program) + version).encode()).hexdigest()[:32]
    page = template("fmu.c").template.replace("$functions", template(f"fmi{version[0]}.c").template)
    texts = {
        f"{name}.h": header(program),
        f"{name}.c": code,
        f"{name}_fmu.c": Template(page).substitute(
            program.head, guid=guid, version=version, exchanges=int(_exchanges(program))
        ),
    }
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for title, text in texts.items():
            (place / title).write_text(text, encoding="utf-8")
        libraries = _compiled(place, name, version)
        if version == "3.0":  # in 2.0 the sources are listed in the description
            texts["buildDescription.xml"] = _xml(_build_description(name))
        with whole_file(file) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as unit:
            unit.writestr("modelDescription.xml", description(program, guid, version))
            for title, text in texts.items():
                unit.writestr(f"sources/{title}", text)
            unit.writestr("resources/model.json", json.dumps(program.describe(), indent=2))
            for library in libraries:
                unit.write(library, f"binaries/{library.parent.name}/{library.name}")
    return (file,)


def _exchanges(program: Program) -> bool:
    """Whether all memory is continuous states, which an importer can integrate."""
    return program.graph.n_actuator_memory + program.graph.n_sensor_memory == 0


def _compiled(place: Path, name: str, version: str) -> list[Path]:
    """Libraries for the platforms that compilers here know."""
    own = (sys.platform, platform.machine())
    compiler = next((one for one in ("cc", "gcc", "clang") if shutil.which(one)), None)
    crosses = importlib.util.find_spec("ziglang") is not None
    found = []
    for key, known in _PLATFORMS.items():
        if version not in known.folders or not (crosses or (compiler and key == own)):
            continue
        target = place / known.folders[version] / f"{name}{known.ending}"
        target.parent.mkdir()
        if compiler and key == own:
            command = [compiler, "-fPIC"]
        else:
            command = [sys.executable, "-m", "ziglang", "cc", "-target", known.target]
        command += ["-O2", "-std=c99", "-shared", "-fvisibility=hidden"]
        command += [str(place / f"{name}.c"), str(place / f"{name}_fmu.c"), "-o", str(target)]
        command += [] if key[0] == "win32" else ["-lm"]
        done = subprocess.run(command, capture_output=True, check=False)
        if done.returncode:
            last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise FileError(f"{command[0]} refuses the code of the FMU: {' '.join(last)}")
        found.append(target)
    if not found:
        warnings.warn(
            "The FMU holds sources only, because no C compiler was found for this machine. "
            "Importers that compile (FMPy: fmpy compile) can use it.",
            stacklevel=4,
        )
    return found


# Name, unit, start value and attributes of a variable.
Variable = tuple[str, str, float | None, dict[str, str]]


def _variables(program: Program) -> list[Variable]:
    """Every variable but the time, in the order of the C code."""
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
    first, local = len(rows), {"causality": "local", **moving}
    rows += [(name, "", None, local) for name in names.states]
    if _exchanges(program):
        states = enumerate(names.states, start=first)
        rows += [(f"der({name})", "", None, local | {"of": str(k)}) for k, name in states]
    return rows


def description(program: Program, guid: str, version: str = "2.0") -> str:
    """Text of ``modelDescription.xml``.

    Parameters
    ----------
    program : Program
        The model.
    guid : str
        Digest of the code, which the library compares.
    version : str
        Of the interface.
    """
    words = {
        "fmiVersion": version,
        "modelName": safe(program.model.name),
        "guid" if version == "2.0" else "instantiationToken": f"{{{guid}}}",
        "description": program.origin,
        "generationTool": f"oed_sysid {__version__}",
        "generationDateAndTime": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "variableNamingConvention": "flat",
    }
    root = ElementTree.Element("fmiModelDescription", words)
    if version == "2.0":
        root.set("numberOfEventIndicators", "0")
    state = "FMUstate" if version == "2.0" else "FMUState"
    able = {"modelIdentifier": program.identifier}
    able |= {f"canGetAndSet{state}": "true", f"canSerialize{state}": "true"}
    steps = {"canHandleVariableCommunicationStepSize": "true"}
    kinds = {"ModelExchange": able} if _exchanges(program) else {}
    for kind, can in (kinds | {"CoSimulation": able | steps}).items():
        unit = ElementTree.SubElement(root, kind, can)
        if version == "2.0":
            files = ElementTree.SubElement(unit, "SourceFiles")
            for title in _sources(program.identifier):
                ElementTree.SubElement(files, "File", name=title)
    rows = _variables(program)
    if stated := sorted({unit_text for _, unit_text, _, _ in rows} - {""}):
        units = ElementTree.SubElement(root, "UnitDefinitions")
        for text in stated:
            ElementTree.SubElement(units, "Unit", name=text)
    (_add_variables if version == "2.0" else _add_variables_3)(root, rows)
    return _xml(root)


def _sources(name: str) -> tuple[str, str]:
    return f"{name}.c", f"{name}_fmu.c"


def _build_description(name: str) -> ElementTree.Element:
    """Which files an importer compiles, as FMI 3.0 says it."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    unit = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = ElementTree.SubElement(unit, "SourceFileSet", language="C99")
    for title in _sources(name):
        ElementTree.SubElement(files, "SourceFile", name=title)
    return root


def _xml(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + text + "\n"


def _started(row: Variable) -> dict[str, str]:
    """Unit and start value of a variable, where it has them."""
    given = {"unit": row[1], "start": "" if row[2] is None else repr(float(row[2]))}
    return {what: text for what, text in given.items() if text}


def _structure(rows: list[Variable]) -> dict[str, list[int]]:
    """Numbers of outputs, of derivatives, and of what an importer solves for at the start."""
    outputs = [k for k, row in enumerate(rows) if row[-1]["causality"] == "output"]
    slopes = {k: int(row[-1]["of"]) for k, row in enumerate(rows) if "of" in row[-1]}
    unknown = [*outputs, *slopes.values(), *slopes]
    return {"Outputs": outputs, "Derivatives": list(slopes), "InitialUnknowns": unknown}


def _add_variables(root: ElementTree.Element, rows: list[Variable]) -> None:
    """Add the variables, and which of them are outputs, as FMI 2.0 counts them: from one."""
    variables = ElementTree.SubElement(root, "ModelVariables")
    titles = distinct(title for title, _, _, _ in rows)
    for number, (title, row) in enumerate(zip(titles, rows, strict=True)):
        more = {key: text for key, text in row[-1].items() if key != "of"}
        known = {"name": title, "valueReference": str(number), **more}
        one = ElementTree.SubElement(variables, "ScalarVariable", known)
        slope = {"derivative": str(int(row[-1]["of"]) + 1)} if "of" in row[-1] else {}
        ElementTree.SubElement(one, "Real", _started(row) | slope)
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind, numbers in _structure(rows).items():
        if numbers:
            listed = ElementTree.SubElement(structure, kind)
            for number in numbers:
                ElementTree.SubElement(listed, "Unknown", index=str(number + 1))


_IN_3 = {
    "Outputs": "Output",
    "Derivatives": "ContinuousStateDerivative",
    "InitialUnknowns": "InitialUnknown",
}


def _add_variables_3(root: ElementTree.Element, rows: list[Variable]) -> None:
    """Add the variables and the time, as FMI 3.0 names them: by value references."""
    variables = ElementTree.SubElement(root, "ModelVariables")
    # The C code counts a derivative for each state, whether the importer may ask for it or not.
    own = [row for row in rows if "of" not in row[-1]]
    time = len(own) + sum(row[-1]["causality"] == "local" for row in own)
    titles = distinct([*(title for title, _, _, _ in rows), "time"])
    for number, (title, row) in enumerate(zip(titles, rows, strict=False)):
        more = {"derivative" if key == "of" else key: text for key, text in row[-1].items()}
        known = {"name": title, "valueReference": str(number), **more, **_started(row)}
        ElementTree.SubElement(variables, "Float64", known)
    free = {"causality": "independent", "variability": "continuous"}
    ElementTree.SubElement(
        variables, "Float64", {"name": titles[-1], "valueReference": str(time), **free}
    )
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind, numbers in _structure(rows).items():
        for number in numbers:
            ElementTree.SubElement(structure, _IN_3[kind], valueReference=str(number))
