"""Documents, examples, notebooks and the demo: everything in them runs."""

from __future__ import annotations

import ast
import inspect
import json
import os
import re
import runpy
import shlex
import sys
import textwrap
import warnings
from pathlib import Path

import numpy as np
import pytest
import typer

from benchmarks.tables import tables
from oed_sysid import Record, load_problem, results, simulate_inputs, write_csv
from oed_sysid.cli import DONE, main
from oed_sysid.cli.application import app
from oed_sysid.data.mapping import parse
from oed_sysid.text.expressions import FUNCTIONS

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/*.md", "docs/walks/*.md", "problems/**/*.md", "oed_sysid/*.md")
    for path in ROOT.glob(pattern)
)


def blocks(path: Path, language: str) -> list[str]:
    """Fenced blocks of a page in a language; those of no language are plain."""
    every = re.findall(r"```(.*?)\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)
    return [text for kind, text in every if kind == language]


def commands(page: Path) -> list[list[str]]:
    """What follows the program's name in the command lines of a page, word by word."""
    lines = "\n".join(blocks(page, "")).replace("\\\n", " ").splitlines()
    return [shlex.split(line)[1:] for line in lines if line.startswith("oed-sysid ")]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(path: Path) -> None:
    """Every relative link names a file that exists."""
    text = re.sub(r"```.*?```|`[^`]*`", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    targets = [target.partition("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", text)]
    lost = [
        target
        for target in targets
        if target and not re.match(r"\w+:", target) and not (path.parent / target).exists()
    ]
    assert not lost


def test_index_names_every_page() -> None:
    """docs/README.md, and the site's first page, list all pages beside them."""
    pages = {p.name for p in (ROOT / "docs").glob("*.md")} - {"README.md", "index.md"}
    listed = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    assert not {name for name in pages if f"({name})" not in listed}
    first = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").splitlines()
    assert not {name for name in pages if name.removesuffix(".md") not in first}


def test_command_line_page_names_every_command() -> None:
    """The table of commands is that of the program."""
    page = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    table = page.split("## The JSON")[0]
    documented = set(re.findall(r"`([a-z]+) [^`]*`", "\n".join(re.findall(r"^\|.*", table, re.M))))
    assert set(typer.main.get_command(app).commands) == documented


def test_map_names_every_module() -> None:
    """oed_sysid/README.md, the map, has every module and folder of the package."""
    text = (ROOT / "oed_sysid" / "README.md").read_text(encoding="utf-8")
    entries = {
        path.stem
        for path in (ROOT / "oed_sysid").iterdir()
        if (path.suffix == ".py" or (path / "__init__.py").exists() or any(path.glob("*.py")))
        and not path.name.startswith("_")
    }
    assert [name for name in sorted(entries) if not re.search(rf"`{name}/?`", text)] == []


def test_quick_start_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """The first code of the README works on files as it describes them."""
    monkeypatch.chdir(tmp_path)
    code = blocks(ROOT / "README.md", "python")[0]
    names: dict = {}
    exec(code.split("train = ")[0], names)
    _zigzags(names["ship"], tmp_path)
    exec(code, names)
    assert abs(names["fit"].values["K"] - 0.1) < 5 * names["fit"].std_errors["K"]
    assert "converged" in capsys.readouterr().out


@pytest.mark.slow
def test_search_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """The second code of the README finds something in the records that are shipped."""
    monkeypatch.chdir(tmp_path)
    for record in load_problem("remus_diving_plane").data():
        write_csv(record, tmp_path / f"{record.name}.csv")
    names: dict = {}
    exec(blocks(ROOT / "README.md", "python")[1], names)
    assert names["found"].steps
    assert set(names["better"].effect_names) > set(names["problem"].model.effect_names)
    assert "effect added" in capsys.readouterr().out


def _zigzags(model, folder: Path) -> None:
    """Two records with a little noise, as the quick start reads them."""
    rng = np.random.default_rng(2)
    times = np.arange(0.0, 100.0, 0.5)
    for angle in (10, 20):
        rudder = np.radians(angle) * np.sign(np.sin(2 * np.pi * times / 40 + 1e-9))[:, None]
        run = simulate_inputs(model.with_values({"K": 0.1, "T": 12.0}), times, inputs=rudder)
        noisy = run.outputs + rng.standard_normal(run.outputs.shape) * (0.002, 0.001)
        record = Record(f"zigzag_{angle}", times, rudder, noisy, model.channels)
        write_csv(record, folder / f"zigzag_{angle}.csv")


def _numbers(words: list[str]) -> list[float]:
    """Numbers among words."""
    found = [re.fullmatch(r"\(?([-+]?\d[\d.]*(?:e[-+]?\d+)?)", word) for word in words]
    return [float(one[1]) for one in found if one]


@pytest.mark.slow
def test_tutorial_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """Every command of the tutorial ends well and prints the numbers that the page shows."""
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "tutorial.md"
    assert len(commands(page)) >= 6
    for command in commands(page):
        assert main(command) == DONE, command
    printed = capsys.readouterr().out
    # Rows of the page's tables, number by number: rounding may differ by machine.
    shown = [line.split() for block in blocks(page, "") for line in block.splitlines()]
    told = [line.split() for line in printed.splitlines()]
    rows = [row for row in shown if len(row) >= 4 and _numbers(row[1:])]
    assert len(rows) >= 10
    for row in rows:
        like = [one for one in told if len(one) == len(row) and one[0] == row[0]]
        close = [np.allclose(_numbers(one), _numbers(row), rtol=0.03) for one in like]
        assert any(close), " ".join(row)
    (code,) = blocks(page, "python")
    exec(code, {})
    assert "yaw_quadratic_damping" in capsys.readouterr().out


def test_own_vehicle_page_runs(capsys) -> None:
    """The problem of the page takes at most 25 lines, and its code runs and prints an equation."""
    page = ROOT / "docs" / "own_vehicle.md"
    first, second, third = blocks(page, "python")
    lines = [line for line in first.splitlines() if line.strip()]
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 100
    names: dict = {}
    exec(first, names)
    assert len(names["model"].state_names) == 10
    assert names["problem"].experiments
    exec(second, names)
    assert "blade(u_r, T, E_blade)" in capsys.readouterr().out
    exec(third, names)
    assert names["yaw"].functions[-1].arguments == ("r", "delta", "K", "T")


def test_export_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """The code of the page on exports writes a module and draws a band of it."""
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for code in blocks(ROOT / "docs" / "export.md", "python"):
        exec(code, names)
    assert "REMUS_six_degrees_of_freedom.py" in capsys.readouterr().out
    assert names["many"].shape == (40, 10, 50)


def test_logs_page_maps_a_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mapping of the page is understood, key by key."""
    (text,) = blocks(ROOT / "docs" / "logs.md", "toml")
    mapping = parse(text)
    assert (mapping.problem, mapping.by_commands.threshold) == ("my_boat", 0.05)
    assert mapping.outputs["psi"].delay == 0.08


def test_language_of_the_page_is_that_of_the_package() -> None:
    """The table of functions on the page names every function of the language."""
    text = (ROOT / "docs" / "own_vehicle.md").read_text(encoding="utf-8")
    table = text.split("## 4. What a text may say")[1].split("Everything is checked")[0]
    assert [name for name in FUNCTIONS if not re.search(rf"\b{name}\b", table)] == []


@pytest.mark.slow
def test_own_vehicle_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands of the page end well, the log of the second being one of the first's."""
    monkeypatch.chdir(tmp_path)
    every = commands(ROOT / "docs" / "own_vehicle.md")
    assert len(every) == 5
    for command in every:
        if "--from" in command:
            record = load_problem(tmp_path / "my_auv").data()[0]
            write_csv(record, tmp_path / "log.csv")
            command = [part if part != "rudder" else "dr" for part in command]
        assert main(command) == DONE, command


def test_every_drawing_function_has_a_picture() -> None:
    """The gallery draws each public picture of the package; its page of the reference shows it."""
    drawn = set(re.findall(r"report\.(\w+)\(", (ROOT / "docs" / "gallery.py").read_text("utf-8")))
    public = {name for name in results.__all__ if name.startswith(("plot_", "figure_"))}
    assert not public - drawn


def test_every_public_name_is_documented(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of each: what it is; of a function what it returns and raises; an example or a picture."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    from public_names import found_at, named

    lacking = []
    for package, names in named().items():
        for name in names:
            thing, last = found_at(package, name), name.rpartition(".")[2]
            said = inspect.cleandoc(thing.__doc__ or "")
            drawn = last.startswith(("plot_", "figure_"))  # the gallery has them
            wanted = [] if drawn else [r"^Examples$|>>> "]
            if inspect.isfunction(thing):
                code = ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0]
                raises = any(isinstance(node, ast.Raise) for node in ast.walk(code))
                gives = inspect.signature(thing).return_annotation not in (None, "None")
                wanted += ["^(Returns|Yields)$"] * gives + ["^Raises$|:class:.*Error"] * raises
            lacking += [(name, one) for one in wanted if not re.search(one, said, re.MULTILINE)]
    assert not lacking


NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
MOST_CELLS = 16


def test_every_tutorial_has_a_notebook() -> None:
    """Tanker, AUV, a log and an effect of one's own; the page of notebooks names them all."""
    assert {path.stem for path in NOTEBOOKS} == {"tanker", "auv", "own_log", "own_effect"}
    page = (ROOT / "docs" / "notebooks.md").read_text(encoding="utf-8")
    assert not [path.name for path in NOTEBOOKS if path.name not in page]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_small_and_holds_no_results(path: Path) -> None:
    """A notebook is text to be run: no outputs, few cells, a title, and a conclusion."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert len(cells) <= MOST_CELLS
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert not [cell for cell in code if cell["outputs"] or cell["execution_count"]]
    assert "".join(cells[0]["source"]).startswith("# ")
    assert "Conclusion" in "".join(code[-1]["source"])


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_imports_present_names(path: Path) -> None:
    """What a notebook imports from the package exists, under a name that is not an old one."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    text = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    lines = re.findall(r"^(?:from oed_sysid\S* import .*|import oed_sysid\S*)$", text, re.MULTILINE)
    assert lines
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        for line in lines:
            exec(line, {})


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every cell runs in a fresh kernel; tables, pictures and numbers come out."""
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    monkeypatch.delenv("MPLBACKEND", raising=False)  # left by other tests, it hides pictures
    book = nbformat.read(path, as_version=4)
    runner = client.NotebookClient(
        book, timeout=900, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    runner.execute()
    kinds = [kind for cell in book.cells for out in cell.get("outputs", ())
             for kind in out.get("data", ())]  # fmt: skip
    assert "text/html" in kinds
    assert "image/png" in kinds or path.stem == "own_log"
    said = "".join(out.get("text", "") for out in book.cells[-1]["outputs"])
    assert said.startswith("Conclusion: ")
    assert any(character.isdigit() for character in said)


EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SLOW, MEASURED = (tables(__file__)[kind] for kind in ("slow", "measured"))
MAXIMUM_LINES = 80


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=[pytest.mark.slow] if path.stem in SLOW else [], id=path.stem)
        for path in EXAMPLES
    ],
)
def test_example_runs_and_concludes(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """An example asks a question, stays short, and prints its answer."""
    if path.stem in MEASURED and "OED_SYSID_DATA" not in os.environ:
        pytest.skip("measured data absent")
    text = path.read_text(encoding="utf-8")
    assert text.startswith('"""Question: '), f"{path.name} begins with its question"
    assert len(text.splitlines()) <= MAXIMUM_LINES
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path)])
    with warnings.catch_warnings():
        warnings.filterwarnings("error", category=DeprecationWarning, module="__main__")
        runpy.run_path(str(path), run_name="__main__")
    assert len(capsys.readouterr().out.strip().splitlines()) >= 2


def test_slow_examples_exist() -> None:
    """A renamed example does not stay in the list of slow ones."""
    assert {path.stem for path in EXAMPLES} >= set(SLOW)


@pytest.mark.slow
def test_demonstration_ends_in_noise(tmp_path: Path, capsys, monkeypatch) -> None:
    """The command of `make demo` finds the hidden effect and writes its report."""
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8")
    line = re.search(r"oed-sysid (improve .*)", recipe)[1].replace("$(RUNS)", "problems/{0}/data")
    words = shlex.split(line.format("remus_diving_plane"))
    given = [part for word in words for part in (sorted(map(str, ROOT.glob(word))) or [word])]
    monkeypatch.chdir(tmp_path)
    assert main([*given, "--json", "found.json"]) == DONE
    found = json.loads(Path("found.json").read_text(encoding="utf-8"))
    assert [step["added"] for step in found["steps"]] == ["heave_crossflow_drag"]
    assert found["remains"]["kind"] == "adequate"
    assert Path("out/demo/report.html").stat().st_size > 100_000
