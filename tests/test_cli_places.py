"""Places that cannot be written to are refused in words, before the work where it is long."""

from __future__ import annotations

from pathlib import Path

import pytest

from oed_sysid.cli import BAD_INPUT, DONE, main
from oed_sysid.errors import FileError, ProblemError
from oed_sysid.experiments.problem import new_problem
from oed_sysid.runtime.files import check_place, make_folder, write_text

SHIP = "nomoto_sparse_heading"


@pytest.fixture(name="place")
def _place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with a file in the way, an empty folder and a short log."""
    monkeypatch.chdir(tmp_path)
    Path("afile").write_text("in the way")
    Path("folder").mkdir()
    rows = [f"{0.5 * i},{0.1 * (i % 7 > 3)},{0.01 * i % 0.3}" for i in range(40)]
    Path("log.csv").write_text("\n".join(["t [s],delta [rad],psi [rad]", *rows]) + "\n")
    return tmp_path


def names(folder: Path) -> set[str]:
    """Everything below a folder."""
    return {str(one.relative_to(folder)) for one in folder.rglob("*")}


@pytest.mark.parametrize(
    "line",
    [
        f"check {SHIP} log.csv --fix afile",
        f"check {SHIP} log.csv --fix afile/copies",
        f"simulate {SHIP} --out afile/runs/",
        f"simulate {SHIP} --experiment zigzag_15_15 --out afile/x.csv",
        "import log.csv --map no.toml --out afile",
        f"design {SHIP} --out afile/x.csv",
        f"design {SHIP} --bag afile/bag",
        f"programme {SHIP} --runs 2 --out afile",
        f"campaign afile/trial --problem {SHIP} --goal all=5",
        f"fit {SHIP} log.csv --save afile/fit.json",
        f"fit {SHIP} log.csv --journal afile",
        f"improve {SHIP} log.csv --save afile/fit.json",
        f"diagnose {SHIP} log.csv --html afile/page.html",
        f"rank {SHIP} --json afile/rank.json",
        "report no.json --out afile/report.html",
        "new afile/boat",
    ],
)
def test_file_where_a_folder_is_needed(line: str, place: Path, capsys) -> None:
    """A file in the way is named, and nothing is written or calculated."""
    before = names(place)
    assert main(line.split()) == BAD_INPUT
    said = capsys.readouterr().err
    assert "afile' is a file where a folder is needed. Move it away" in said
    assert names(place) == before


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"fit {SHIP} log.csv --save folder", "it is a folder. Give a file in it"),
        (f"design {SHIP} --html folder", "it is a folder. Give a file in it"),
        (f"fit {SHIP} log.csv --picture x.gif", "Choose .png, .pdf, .svg"),
        (f"simulate {SHIP} --picture picture", "does not end as a picture does"),
        (f"design {SHIP} --card x.doc", "Choose .txt, .html, .pdf"),
        (f"simulate {SHIP} --out /proc/there/", "/proc"),
        (f"design {SHIP} --json /proc/there/x.json", "nothing can be made in '/proc'"),
        (f"check {SHIP} log.csv --fix /proc/there", "nothing can be made in '/proc'"),
    ],
)
def test_other_places_that_take_no_result(line: str, words: str, place: Path, capsys) -> None:
    """A folder for a file, an ending that is no picture and a system's own folder are refused."""
    before = names(place)
    assert main(line.split()) == BAD_INPUT
    assert words in capsys.readouterr().err
    assert names(place) == before


@pytest.mark.parametrize(
    "line",
    [f"simulate {SHIP} --seed -3", f"design {SHIP} --seed -1", f"programme {SHIP} --seed -1"],
)
def test_seed_below_zero(line: str, place: Path, capsys) -> None:
    """A generator takes no negative seed: the option says so."""
    assert main(line.split()) == BAD_INPUT
    assert "--seed" in capsys.readouterr().err


def test_device_is_a_place(place: Path) -> None:
    """What is no regular file, such as /dev/null, takes a result."""
    line = f"rank {SHIP} --experiment zigzag_15_15 --json /dev/null --quiet"
    assert main(line.split()) == DONE


def test_files_say_what_stands_in_the_way(place: Path) -> None:
    """Files, folders and problems below a file have the same words."""
    words = "'.*afile' is a file where a folder is needed"
    with pytest.raises(FileError, match=words):
        write_text("afile/x/y.txt", "text")
    with pytest.raises(FileError, match=words):
        make_folder("afile/x")
    with pytest.raises(FileError, match=words):
        make_folder("afile")
    with pytest.raises(ProblemError, match=words):
        new_problem("afile/boat")


def test_check_leaves_nothing_behind(place: Path) -> None:
    """A place that can be written to passes, be it there or not, and stays as it was."""
    before = names(place)
    check_place("new/deep/fit.json")
    check_place("new/deep", folder=True)
    check_place("log.csv")
    check_place("folder", folder=True)
    assert names(place) == before


def test_no_permission(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that the user may not write to is named."""
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(FileError, match=r"you have no permission to write in '.*folder'"):
        check_place("folder/fit.json")
    with pytest.raises(FileError, match=r"'log\.csv' cannot be written: it is write-protected"):
        check_place("log.csv")


def test_device_is_no_folder(place: Path) -> None:
    """Files cannot be put below /dev/null."""
    with pytest.raises(FileError, match="'/dev/null' is no folder, and one is needed there"):
        check_place("/dev/null/x.csv")
