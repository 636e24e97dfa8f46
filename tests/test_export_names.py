"""Names of people in exported code: none of them ends a comment or a string, or begins code."""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from marks import slow
from test_export import compiled, loaded
from yaw_vehicle import NOISE, yaw_data, yaw_model

from benchmarks.tables import tables
from oed_sysid import Dataset, Fit, Input, Model, MultipleShooting, Output, Parameter, State
from oed_sysid.errors import ModelError
from oed_sysid.export import export, identifier, program_of
from oed_sysid.text.typeset import safe, safe_unit
from oed_sysid.text.units import dimension

COMPILER = shutil.which("cc") or shutil.which("gcc")
HOSTILE = tuple(tables(__file__)["hostile"])


@pytest.fixture(scope="module", name="fit")
def _fit() -> Fit:
    return MultipleShooting(noise=NOISE, disturbances="none").fit(yaw_model(), yaw_data(1))


@pytest.fixture(scope="module", name="plain")
def _plain(tmp_path_factory: pytest.TempPathFactory, fit: Fit) -> dict[str, str]:
    return written(called(fit, "a plain name"), tmp_path_factory.mktemp("plain"))


def written(fit: Fit, folder: Path) -> dict[str, str]:
    """Every text that is exported, by file."""
    kinds = ("c", "python", "matlab", "sympy", "control", "casadi")
    files = [file for kind in kinds for file in export(fit, kind, folder)]
    return {file.name: file.read_text("utf-8") for file in files if file.suffix != ".casadi"}


def called(fit: Fit, name: str) -> Fit:
    """The same fit with another name of its first record."""
    first, *others = fit.dataset
    return replace(fit, dataset=Dataset((replace(first, name=name), *others)))


def code(text: str) -> str:
    """C without its comments, as a compiler removes them: trigraphs, spliced lines, comments."""
    text = text.replace("??/", "\\")
    text = re.sub(r"\\\r?\n", "", text)
    return re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.DOTALL)


@pytest.mark.parametrize("name", [*HOSTILE[::4], *slow(*sorted({*HOSTILE} - {*HOSTILE[::4]}))])
def test_name_stays_in_its_comment(
    tmp_path: Path, fit: Fit, plain: dict[str, str], name: str
) -> None:
    """Code in every language is that of a record with a plain name; JSON has the name itself."""
    for file, text in written(called(fit, name), tmp_path).items():
        if file.endswith(".json"):
            assert json.loads(text)["fitted_to"][0] == name
            continue
        tame = plain[file]
        if file.endswith((".c", ".h")):
            assert code(text) == code(tame)
        elif file.endswith(".py"):
            assert ast.dump(ast.Module(ast.parse(text).body[1:], [])) == ast.dump(
                ast.Module(ast.parse(tame).body[1:], [])
            )
        else:  # a line of comment of its own
            assert len(text.splitlines()) == len(tame.splitlines())
            marked = [line for line in text.splitlines() if not line.startswith("%")]
            assert marked == [line for line in tame.splitlines() if not line.startswith("%")]
        assert text.isascii()


@pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
def test_hostile_records_are_compiled_and_run(
    tmp_path: Path, fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All names at once: the C test passes, the module loads, the unit is valid, none is run."""
    monkeypatch.chdir(tmp_path)
    first = fit.dataset[0]
    records = Dataset(replace(first, name=name) for name in HOSTILE)
    told = (replace(one, description="".join(HOSTILE)) for one in fit.model.parameters)
    model = replace(fit.model, parameters=tuple(told))
    whole = MultipleShooting(disturbances="none").fit(model, records)
    program = program_of(whole)
    assert all(character not in program.origin for character in "*/\\\"'\n%?<&")
    export(whole, "c", tmp_path)
    done = compiled(tmp_path, "yaw")
    assert done.returncode == 0, done.stdout
    assert loaded(export(whole, "python", tmp_path)[0]).NAME == "yaw"
    (file,) = export(whole, "fmu", tmp_path)
    with zipfile.ZipFile(file) as unit:
        root = ElementTree.fromstring(unit.read("modelDescription.xml"))
        assert json.loads(unit.read("resources/model.json"))["fitted_to"] == list(HOSTILE)
    script, _ = export(whole, "matlab", tmp_path)
    lines = [line.split("%")[0] for line in script.read_text("utf-8").splitlines()]
    assert not any(word in line for line in lines for word in ("system('", 'open("', "open('"))
    assert not list(tmp_path.rglob("stolen"))
    assert safe(HOSTILE[0]) in root.attrib["description"]
    assert not list(root.iter("stolen"))


@pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
def test_hostile_model_is_compiled_and_runs(tmp_path: Path) -> None:
    """Names of a model, of signals in other letters, and units with signs."""
    names = ("ψ", "а", "a", "u03c8")
    model = Model(
        "*\\\n/ int stolen; /* \"''' end",
        tuple(State(name, "rad", scale=0.1) for name in names[:3]),
        (Input("δ", "°"),),
        (Output("y", "m²·kg/\n(s V)", "", "K*a"),),
        {"ψ": "a", "а": "-а", "a": "T*δ - a"},
        parameters=(Parameter("K", 1.0), Parameter("T", 2.0, "µm\n²"), Parameter(names[3], 1.0)),
    )
    export(model, "c", tmp_path)
    name = program_of(model).identifier
    done = compiled(tmp_path, name)
    assert done.returncode == 0, done.stdout
    text = (tmp_path / f"{name}.c").read_text("utf-8")
    assert '{"u03c8", "u0430", "a"}' in text
    module = loaded(export(model, "python", tmp_path / "python")[0])
    assert module.STATES == ("u03c8", "u0430", "a")
    (file,) = export(model, "fmu", tmp_path)
    root = ElementTree.fromstring(zipfile.ZipFile(file).read("modelDescription.xml"))
    variables = [one.attrib["name"] for one in root.iter("ScalarVariable")]
    assert len(set(variables)) == len(variables)
    for unit in root.find("UnitDefinitions") or ():
        assert dimension(unit.attrib["name"]) is not None
    built = subprocess.run(
        [str(COMPILER), "-std=c99", "-trigraphs", "-Wall", "-Wextra", "-Werror", "-fsyntax-only",
         tmp_path / f"{name}.c"], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert not built.returncode, built.stderr


@pytest.mark.parametrize(("unit", "written"), [("kg*m²/s²", "kg m^2/s^2"), ("%", "percent"),
                                               ("µV/°", "uV/deg"), ("m\n**2", "m ^2")])  # fmt: skip
def test_unit_stays_readable(unit: str, written: str) -> None:
    """A unit in few signs means what it meant."""
    assert safe_unit(unit) == written
    assert dimension(written) == dimension(unit)


@pytest.mark.parametrize("name", ["end", "function", "for", "int", "9", "*/", "ψ", "a" * 200])
def test_identifier_of_a_model(name: str) -> None:
    """A file's name is an identifier in all languages."""
    text = identifier(name)
    assert re.fullmatch(r"[A-Za-z]\w{0,48}", text, re.ASCII)
    assert text not in ("end", "function", "for")


def test_names_that_no_expression_can_hold_are_refused() -> None:
    """Signals and parameters are identifiers, so that only letters can be strange in them."""
    for name in HOSTILE:
        with pytest.raises(ModelError):
            State(name, "m")
        with pytest.raises(ModelError):
            Parameter(name, 1.0)
