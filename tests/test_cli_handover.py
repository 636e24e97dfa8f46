"""What one command keeps, the next one reads: every pair of --save and reader."""

from __future__ import annotations

import json
import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest

from oed_sysid import Fit
from oed_sysid.cli import BAD_INPUT, DONE, NO_RESULT, main

SAVERS = ("fit", "improve")
READERS = ("report", "export", "compare", "design", "programme")


@pytest.fixture(name="ship", scope="module")
def _ship(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The starter folder with a fit, an improved fit, and what else the commands write."""
    folder = tmp_path_factory.mktemp("cli") / "my_ship"
    assert main(["new", str(folder)]) == DONE
    zigzags = [str(folder / "data" / f"zigzag_{angle}.csv") for angle in ("10_10", "20_20")]
    circle = str(folder / "data" / "turning_circle.csv")
    for command in SAVERS:
        line = [command, str(folder), *zigzags, "--validate", circle, "--known-noise", "--quiet"]
        files = [f"--{kind}" for kind in ("save", "json", "html")]
        ends = ("saved.json", "numbers.json", "page.html")
        for option, end in zip(files, ends, strict=True):
            line += [option, str(folder / f"{command}_{end}")]
        assert main(line) in (DONE, NO_RESULT)
    return folder


def read(reader: str, ship: Path, saved: Path, out: Path) -> int:
    """Let a command go on from a file; what it finds goes to ``out``."""
    data = ship / "data"
    circle = str(data / "turning_circle.csv")
    shared = ["--patterns", "zigzag_10_10", "--rounds", "0", "--runs", "1"]
    lines = {
        "report": ["report", saved, "--validate", circle, "--out", out.with_suffix(".html")],
        "export": ["export", saved, "--as", "python", "--out", out.with_suffix(".py")],
        "compare": ["compare", ship, data / "zigzag_10_10.csv", "--validate", circle,
                    "--with", saved, "--known-noise", "--json", out],
        "design": ["design", ship, "--after", saved, "--duration", "40", "--json", out],
        "programme": ["programme", ship, "--after", saved, *shared, "--duration", "60",
                      "--json", out],
    }  # fmt: skip
    return main([*map(str, lines[reader]), "--quiet"])


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("saver", SAVERS)
def test_saved_model_goes_on(saver: str, reader: str, ship: Path, tmp_path: Path) -> None:
    """A reader of a saved fit works with its parameters, those that were found included."""
    saved, out = ship / f"{saver}_saved.json", tmp_path / "out.json"
    fit = Fit.load(saved)
    assert (saver == "improve") == ("E_yaw" in fit.values)
    assert read(reader, ship, saved, out) == DONE
    if reader == "report":
        page = out.with_suffix(".html").read_text(encoding="utf-8")
        assert all(name in page for name in ("turning_circle", "zigzag_20_20"))
        assert ("E_yaw" in page) == (saver == "improve")
    elif reader == "export":
        module = runpy.run_path(str(out.with_suffix(".py")))
        written = module["PARAMETERS"]
        assert {name: written[name] for name in fit.values} == pytest.approx(fit.values)
    elif reader == "compare":
        models = {one["label"]: one["relative"] for one in json.loads(out.read_text())["models"]}
        better = models[f"{saver}_saved"] < 1.2
        assert better == (saver == "improve")
        assert models["nominal"] > 3.0
    else:
        found = {one["name"]: one for one in json.loads(out.read_text())["parameters"]}
        assert set(found) == set(fit.names)
        if reader == "design":
            before = {name: one["before"] for name, one in found.items()}
            assert before == pytest.approx(fit.std_errors, rel=0.01)


@pytest.mark.parametrize("reader", ["report", "export", "compare", "design"])
@pytest.mark.parametrize("kind", ["improve_numbers.json", "improve_page.html", "data"])
def test_other_files_are_refused_in_words(
    reader: str, kind: str, ship: Path, tmp_path: Path, capsys
) -> None:
    """Numbers, pages and folders hold no model: the message says which file would."""
    assert read(reader, ship, ship / kind, tmp_path / "out.json") == BAD_INPUT
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert str(ship / kind) in said or Path(kind).name in said
    assert "--save" in said or "folder" in said


def test_numbers_of_a_fit_are_reported_without_pictures(ship: Path, tmp_path: Path) -> None:
    """`report` reads what `fit --json` wrote as well, as a page of numbers."""
    page = tmp_path / "numbers.html"
    numbers = ship / "fit_numbers.json"
    assert main(["report", str(numbers), "--out", str(page), "--quiet"]) == DONE
    value = json.loads(numbers.read_text())["parameters"][0]["value"]
    assert f"{value:.4g}"[:5] in page.read_text(encoding="utf-8")


def test_saved_model_of_another_vehicle_is_refused(ship: Path, tmp_path: Path, capsys) -> None:
    """A fit with other channels cannot be compared on these records, and is told so."""
    other = tmp_path / "other"
    shutil.copytree(ship, other)
    text = (other / "problem.py").read_text()
    (other / "problem.py").write_text(text.replace('Output("r"', 'Output("yaw_rate_sensor"'))
    assert np.count_nonzero(text != (other / "problem.py").read_text()) == 1
    line = ["compare", str(other), str(other / "data"), "--validate", str(other / "data")]
    assert main([*line, "--with", str(ship / "fit_saved.json")]) == BAD_INPUT
    assert capsys.readouterr().err
