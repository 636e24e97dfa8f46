"""Models whose expressions hold bare numbers: read with a note, refused only where nothing helps.

Seven folders as people write them stand in ``test_bare_numbers.toml``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.tables import tables
from oed_sysid import load_problem
from oed_sysid.errors import ModelError, ProblemError
from oed_sysid.testing import check_problem
from oed_sysid.text.dimensions import Deduction, dimension_of
from oed_sysid.text.units import Dimension, dimension

HEAD = "from oed_sysid import Force, Input, Model, Output, Parameter, Problem, Sensor, State\n"
TABLES = tables(__file__)
FOLDERS = TABLES["folders"]
SHIP, FLOAT = (FOLDERS[kind]["text"] for kind in ("ship", "float"))


def write(folder: Path, text: str) -> Path:
    """A folder with this problem."""
    place = folder / "folder"
    place.mkdir()
    (place / "problem.py").write_text(HEAD + text)
    return place


@pytest.mark.parametrize("kind", FOLDERS)
def test_folder_loads_and_says_how_it_was_read(tmp_path: Path, kind: str) -> None:
    """A folder with bare numbers loads, and notes say which number got which unit."""
    problem = load_problem(write(tmp_path, FOLDERS[kind]["text"]))
    said = "\n".join(problem.notes())
    for words in FOLDERS[kind]["notes"]:
        assert words in said
    assert f"note: {problem.notes()[0]}" in problem.describe()


@pytest.mark.parametrize(
    ("text", "old", "new", "words"),
    [(one["text"], *change) for one in FOLDERS.values() for change in one["changes"]],
)
def test_what_no_number_mends_is_refused(
    tmp_path: Path, text: str, old: str, new: str, words: str
) -> None:
    """The same folders, each with one fault that stands in the declared units."""
    assert text.count(old) >= 1
    with pytest.raises(ProblemError) as caught:
        load_problem(write(tmp_path, text.replace(old, new, 1)))
    assert words in str(caught.value)


def test_contract_prints_notes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The check of a folder prints how its bare numbers were read."""
    with pytest.raises(AssertionError, match=r"has no README\.md"):
        check_problem(write(tmp_path, FLOAT), rng=np.random.default_rng(0), effects=False)
    assert "512.0 is read as kg." in capsys.readouterr().out


@pytest.mark.parametrize(("text", "notes"), TABLES["notes"].items())
def test_notes_of_an_expression(text: str, notes: list[str]) -> None:
    """A number is named where only a unit makes it fit, and not where none is needed."""
    units = {"w": "m/s", "q": "rad/s", "theta": "rad", "h": "m"}
    known = {name: dimension(unit) for name, unit in units.items()}
    found = Deduction()
    form = found.form(text, known, where="here")
    if form is not None:
        assert found.equal(form, dimension("m/s"))
    said = [line.removeprefix("here: ").removesuffix(".") for line in found.notes()]
    assert [line.replace("-", "") for line in said] == notes


@pytest.mark.parametrize(
    "text",
    ["sin(h)", "3*h + 2*sin(h)", "w**h", "(w + q)*3", "w + q + 3.0", "2**w", "w > q", "min(w, h)"],
)
def test_expression_that_no_number_mends(text: str) -> None:
    """Unlike dimensions do not meet, and a number beside the fault does not excuse it."""
    known = {"h": dimension("m"), "w": dimension("m/s"), "q": dimension("rad/s")}
    with pytest.raises(ModelError, match="meets"):
        dimension_of(text, known)


def test_number_in_a_signal_is_read_where_the_signal_is_used(tmp_path: Path) -> None:
    """Numbers of one model have one unit each, however far from where it shows."""
    text = SHIP.replace("0.5*1025*2500*U*v*Y_v", "Q*2500*v/U*Y_v").replace(
        "sqrt(u**2 + v**2)", 'sqrt(u**2 + v**2)", "Q": "512.5*U**2'
    )
    problem = load_problem(write(tmp_path, text.replace('"Y_v", -0.01', '"Y_v", -0.01, "m^2"')))
    assert "signal 'Q': 512.5" in "\n".join(problem.notes())


UNITS = {"w": "m/s", "h": "m", "q": "rad/s", "m": "kg", "F": "N", "a": "1"}


def draw(rng: np.random.Generator, unit: Dimension, depth: int) -> str:
    """An expression in a unit, written by somebody who knows what their numbers stand for."""
    name = str(rng.choice(list(UNITS)))
    if depth == 0:
        # A number in whatever unit is needed, or one that brings a name into it.
        power = int(rng.choice([-2, -1, 1, 2]))
        return str(
            rng.choice([f"{rng.uniform(3, 99):.3g}", f"{rng.uniform(3, 99):.3g}*{name}**{power}"])
        )
    match rng.integers(7):
        case 0:
            parts = [draw(rng, unit, depth - 1) for _ in range(2)]
            return f"({parts[0]} + {parts[1]})"
        case 1:
            other = dimension(UNITS[name])
            return f"{name}*({draw(rng, unit / other, depth - 1)})"
        case 2:
            other = dimension(UNITS[name])
            return f"({draw(rng, unit * other, depth - 1)})/{name}"
        case 3:
            inner = draw(rng, Dimension(), depth - 1)
            return f"({draw(rng, unit, depth - 1)})*{rng.choice(['tanh', 'atan'])}({inner})"
        case 4:
            return f"max({draw(rng, unit, depth - 1)}, {draw(rng, unit, depth - 1)})"
        case 5:
            return f"sqrt({draw(rng, unit**2, depth - 1)})"
    condition = f"{draw(rng, unit, depth - 1)} > {draw(rng, unit, depth - 1)}"
    return f"where({condition}, {draw(rng, unit, depth - 1)}, 0)"


@pytest.mark.parametrize("seed", range(6))
def test_whatever_can_be_right_loads(seed: int) -> None:
    """Expressions drawn with a unit in mind have a solution, whichever of their units is stated."""
    rng = np.random.default_rng(seed)
    known = {name: dimension(unit) for name, unit in UNITS.items()}
    for _ in range(60):
        unit = dimension(str(rng.choice(list(UNITS.values()))))
        text = draw(rng, unit, int(rng.integers(1, 5)))
        stated = {n: form if rng.random() < 0.8 else None for n, form in known.items()}
        units = Deduction()
        form = units.form(text, stated)
        assert form is None or units.equal(form, unit), text


@pytest.mark.parametrize("seed", range(3))
def test_a_clash_of_declared_units_is_found_at_any_depth(seed: int) -> None:
    """One clash between names alone makes an expression wrong, whatever surrounds it."""
    rng = np.random.default_rng(seed)
    known = {name: dimension(unit) for name, unit in UNITS.items()}
    for _ in range(40):
        one, other = rng.choice(["w", "h", "m", "F"], 2, replace=False)
        text = draw(rng, dimension("N"), 2)
        clash = str(rng.choice([f"({one} + {other})", f"sin({one})", f"max({one}, {other}*a)"]))
        with pytest.raises(ModelError, match="meets"):
            dimension_of(f"({text})*{clash}", known)


def test_unknown_name_says_how_to_declare_it(tmp_path: Path) -> None:
    """A name that nobody declared is refused with the line that would declare it."""
    text = SHIP.replace("0.5*1025*2500*U*v*Y_v", "0.5*rho*2500*U*v*Y_v")
    with pytest.raises(ProblemError, match=r'Parameter\("rho", value, "unit"\)'):
        load_problem(write(tmp_path, text))
