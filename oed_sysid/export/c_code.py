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
from typing import Any

import jinja2

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
from oed_sysid.runtime.constants import ROUNDING
from oed_sysid.runtime.files import whole_file
from oed_sysid.runtime.version import __version__
from oed_sysid.text.typeset import safe

# -- C99 without dependencies ----------------------------------------------------------


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
        program,
        "model.c",
        IN_C,
        nd=len(program.model.actuator_signals),
        any_linear=int(any(program.graph.linear_inputs)),
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
        tolerance=repr(ROUNDING),
    )


# -- a Functional Mock-up Unit ---------------------------------------------------------


@dataclass(frozen=True)
class Platform:
    """A platform that a unit can hold a library for.

    Attributes
    ----------
    folder_2, folder_3 : str
        Its folder in a unit of FMI 2.0 and of 3.0; empty where the standard has none.
    ending : str
        Of a shared library.
    target : str
        What zig's compiler calls it.
    """

    folder_2: str
    folder_3: str
    ending: str
    target: str


_PLATFORMS = {
    ("linux", "x86_64"): Platform("linux64", "x86_64-linux", ".so", "x86_64-linux-gnu"),
    ("linux", "aarch64"): Platform("aarch64-linux", "aarch64-linux", ".so", "aarch64-linux-gnu"),
    ("darwin", "x86_64"): Platform("darwin64", "x86_64-darwin", ".dylib", "x86_64-macos"),
    ("darwin", "arm64"): Platform("", "aarch64-darwin", ".dylib", "aarch64-macos"),
    ("win32", "AMD64"): Platform("win64", "x86_64-windows", ".dll", "x86_64-windows-gnu"),
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
            texts["buildDescription.xml"] = _xml("build", name=name, sources=_sources(name))
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
    found = []
    for key, command in _compilers().items():
        known = _PLATFORMS[key]
        if folder := known.folder_2 if version == "2.0" else known.folder_3:
            target = place / folder / f"{name}{known.ending}"
            target.parent.mkdir()
            sources = [str(place / one) for one in _sources(name)]
            mathematics = [] if key[0] == "win32" else ["-lm"]
            _run([*command, *_FLAGS, *sources, "-o", str(target), *mathematics])
            found.append(target)
    if not found:
        warnings.warn(
            "The FMU holds sources only, because no C compiler was found for this machine. "
            "Importers that compile (FMPy: fmpy compile) can use it.",
            stacklevel=4,
        )
    return found


_FLAGS = ("-O2", "-std=c99", "-shared", "-fvisibility=hidden")


def _compilers() -> dict[tuple[str, str], list[str]]:
    """Commands that compile, by platform: zig's for all, this machine's own for it."""
    found = {}
    if importlib.util.find_spec("ziglang") is not None:
        zig = [sys.executable, "-m", "ziglang", "cc", "-target"]
        found = {key: [*zig, known.target] for key, known in _PLATFORMS.items()}
    own = (sys.platform, platform.machine())
    compiler = next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    if compiler is not None and own in _PLATFORMS:
        found[own] = [compiler, "-fPIC"]
    return found


def _run(command: list[str]) -> None:
    """Run a compiler; what it refuses is an error."""
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise FileError(f"{command[0]} refuses the code of the FMU: {' '.join(last)}")


@dataclass(frozen=True)
class Variable:
    """A variable of a unit.

    Attributes
    ----------
    name, unit : str
    start : float or None
        Value before the first step.
    words : mapping of str to str
        What the interface calls it: causality, variability and so on.
    of : int or None
        Number of the variable that it is the derivative of.
    """

    name: str
    unit: str
    start: float | None
    words: Mapping[str, str]
    of: int | None = None


def _variables(program: Program) -> list[Variable]:
    """Every variable but the time, in the order of the C code."""
    names, moving = program.names, {"variability": "continuous", "initial": "calculated"}
    exact = {"causality": "parameter", "initial": "exact"}
    rows: list[Variable] = []
    for name, unit, linear in zip(
        names["inputs"], names["input_units"], program.graph.linear_inputs, strict=True
    ):
        held = "continuous" if linear else "discrete"
        rows.append(Variable(name, unit, 0.0, {"causality": "input", "variability": held}))
    for name, unit in zip(names["outputs"], names["output_units"], strict=True):
        title = f"{name}_measured" if name in names["states"] else name  # beside the state itself
        rows.append(Variable(title, unit, None, {"causality": "output", **moving}))
    values = program.model.value_vector.tolist()
    for name, unit, value in zip(
        names["parameters"], names["parameter_units"], values, strict=True
    ):
        rows.append(Variable(name, unit, value, {"variability": "tunable", **exact}))
    for name in names["states"][: program.graph.n_own]:
        words = {"description": f"{name} at the start", "variability": "fixed", **exact}
        rows.append(Variable(f"{name}_start", "", 0.0, words))
    first, local = len(rows), {"causality": "local", **moving}
    rows += [Variable(name, "", None, local) for name in names["states"]]
    if _exchanges(program):
        states = enumerate(names["states"], start=first)
        rows += [Variable(f"der({name})", "", None, local, k) for k, name in states]
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
    rows = _variables(program)
    *titles, time = distinct([*(one.name for one in rows), "time"])
    outputs = [k for k, one in enumerate(rows) if one.words["causality"] == "output"]
    slopes = {k: one.of for k, one in enumerate(rows) if one.of is not None}
    unknown = [*outputs, *slopes.values(), *slopes]
    own = len(rows) - len(slopes)
    return _xml(
        "model",
        version=version,
        guid=guid,
        model=safe(program.model.name),
        name=program.identifier,
        origin=program.origin,
        tool=f"oed_sysid {__version__}",
        now=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        kinds=["ModelExchange"] * _exchanges(program) + ["CoSimulation"],
        sources=_sources(program.identifier),
        units=sorted({one.unit for one in rows} - {""}),
        variables=list(zip(titles, rows, strict=True)),
        time=time,
        # The C code counts a derivative for each state, whether the importer may ask for it or not.
        time_number=own + len(program.names["states"]),
        structure=[
            ("Outputs", "Output", outputs),
            ("Derivatives", "ContinuousStateDerivative", list(slopes)),
            ("InitialUnknowns", "InitialUnknown", unknown),
        ],
    )


def _sources(name: str) -> tuple[str, str]:
    return f"{name}.c", f"{name}_fmu.c"


def _xml(kind: str, **words: object) -> str:
    """Text of the description of a model, or of how it is built."""
    settings: dict[str, Any] = {"trim_blocks": True, "undefined": jinja2.StrictUndefined}
    environment = jinja2.Environment(autoescape=True, **settings)
    return environment.from_string(template(f"{kind}Description.xml.j2").template).render(words)
