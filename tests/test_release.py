"""What a release promises: files that say who, a package that works away from its sources."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

import oed_sysid.testing
from oed_sysid import __version__, list_problems

ROOT = Path(__file__).resolve().parent.parent

TOP_LEVEL = re.compile(r"^from (\w+)[\w.]* import |^import (\w+)", re.MULTILINE)
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def run(*words: object, **where: object) -> str:
    """Run a program that has to end well and return what it printed."""
    done = subprocess.run(
        [str(word) for word in words], capture_output=True, text=True, check=False, **where
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_version_is_the_same_everywhere() -> None:
    """Package, pyproject.toml and the citation name one version, which the changelog leads with."""
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.+)$", citation, re.MULTILINE)[1] == __version__
    assert PROJECT["version"] == __version__
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## .*$", changelog, re.MULTILINE)[0].find(__version__) > 0


def test_citation_has_what_the_format_demands() -> None:
    """The keys that the Citation File Format 1.2.0 requires are there."""
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    keys = re.findall(r"^([a-z-]+):", text, re.MULTILINE)
    assert {"cff-version", "message", "title", "authors"} <= set(keys)
    assert "cff-version: 1.2.0" in text


def test_conda_recipe_asks_for_what_the_package_needs() -> None:
    """Version, oldest Python and oldest libraries of the recipe are those of pyproject.toml."""
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    assert recipe["context"]["version"] == __version__
    asked = {one.replace(" ", "").replace("matplotlib-base", "matplotlib")
             for one in recipe["requirements"]["run"]}  # fmt: skip
    assert asked == {*PROJECT["dependencies"], f"python{PROJECT['requires-python']}"}


def test_workflows_run_what_exists() -> None:
    """Three systems and every admitted Python are tested; targets of make and files are there."""
    folder = ROOT / ".github" / "workflows"
    flows = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8"))
             for path in folder.iterdir()}  # fmt: skip
    matrix = flows["test"]["jobs"]["systems"]["strategy"]["matrix"]
    assert {one.partition("-")[0] for one in matrix["os"]} == {"ubuntu", "windows", "macos"}
    assert f">={matrix['python'][0]}" == PROJECT["requires-python"]
    steps = [step.get("run", "") for flow in flows.values() for job in flow["jobs"].values()
             for step in job["steps"]]  # fmt: skip
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert {word for step in steps for word in re.findall(r"make ([a-z-]+)", step)} <= targets
    assert ".ci/run" in steps


def test_paper_cites_what_its_list_holds() -> None:
    """Each citation is in the bibliography and each entry is cited; links lead to files."""
    text = (ROOT / "paper" / "paper.md").read_text(encoding="utf-8")
    entries = re.findall(r"^@\w+\{(\w+),", (ROOT / "paper" / "paper.bib").read_text(), re.MULTILINE)
    assert set(re.findall(r"@(\w+)", text)) == set(entries)
    for link in re.findall(r"\]\((\.\./[\w./]+\.md)\)", text):
        assert (ROOT / "paper" / link).is_file(), link


def test_contributing_promises_checks_that_exist() -> None:
    """Every check that CONTRIBUTING names is in oed_sysid.testing, and no other is left out."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    promised = set(re.findall(r"`(check_\w+)`", text))
    there = {name for name in oed_sysid.testing.__all__ if name.startswith("check_")}
    assert promised == there
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"(?:^|`)make ([a-z-]+)", text, re.MULTILINE)) <= targets


def test_lowest_versions_cover_every_dependency() -> None:
    """Each dependency states its oldest version, and nothing is imported that is not declared."""
    assert all(re.fullmatch(r"[\w-]+>=[\d.]+", one) for one in PROJECT["dependencies"])
    extras = [one for group in PROJECT["optional-dependencies"].values() for one in group]
    declared = {
        re.match(r"[\w.-]+", one)[0].lower().replace("-", "_")
        for one in [*PROJECT["dependencies"], *extras]
    }
    named = {"sklearn": "scikit_learn", "yaml": "pyyaml"}
    for path in (ROOT / "oed_sysid").rglob("*.py"):
        for head in map("".join, TOP_LEVEL.findall(path.read_text(encoding="utf-8"))):
            if head not in sys.stdlib_module_names and head != "oed_sysid":
                assert named.get(head, head) in declared, f"{path}: {head}"


@pytest.fixture(name="built", scope="module")
def _built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the archive of the sources, and the wheel made of that archive."""
    pytest.importorskip("build")
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT)
    return folder


@pytest.mark.slow
def test_archives_hold_what_they_should(built: Path) -> None:
    """The wheel has code, C sources, templates and problems; the sources all that tests need."""
    (wheel,), (sources,) = built.glob("*.whl"), built.glob("*.tar.gz")
    names = zipfile.ZipFile(wheel).namelist()
    for problem in list_problems():
        assert f"oed_sysid/_problems/{problem}/problem.py" in names
    for pattern in (
        r"compiled/.*\.c$",
        r"results/templates/.*\.j2$",
        r"cli/study.py.j2$",
        r"starter_files/.*\.txt$",
    ):
        assert [name for name in names if re.search(pattern, name)], pattern
    assert not [name for name in names if name.startswith(("tests/", "benchmarks/", "docs/"))]
    with tarfile.open(sources) as archive:
        kept = {name.partition("/")[2] for name in archive.getnames()}
    assert {"CHANGELOG.md", "CITATION.cff", "SECURITY.md", "LICENSE", "Makefile"} <= kept
    assert "tests/test_release.py" in kept
    assert not [name for name in kept if name.startswith(("out/", ".venv"))]


@pytest.mark.slow
def test_installed_package_works_away_from_the_checkout(built: Path, tmp_path: Path) -> None:
    """Installed from the wheel, the command simulates, fits and reports in an empty folder."""
    (wheel,) = built.glob("*.whl")
    site = tmp_path / "site"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", site]
    run(*pip, wheel)
    work = tmp_path / "work"
    work.mkdir()
    # No threads of linear algebra beside those of other tests.
    where = {"cwd": work, "env": os.environ | {"PYTHONPATH": str(site)}}
    found = run(sys.executable, "-c", "import oed_sysid; print(oed_sysid.__file__)", **where)
    assert Path(found.strip()).is_relative_to(site)
    command = [sys.executable, "-m", "oed_sysid.cli"]
    listed = run(*command, "problems", "--quiet", **where).split()
    assert set(listed) == set(list_problems())
    run(*command, "new", "my_vehicle", **where)
    data = [f"my_vehicle/data/zigzag_{angle}.csv" for angle in ("10_10", "20_20")]
    answer = run(*command, "fit", "my_vehicle", *data, "--html", "fit.html", "--quiet", **where)
    assert "2 parameters estimated" in answer
    assert (work / "fit.html").stat().st_size > 50_000
