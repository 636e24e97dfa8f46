"""Every problem folder of the catalogue is refused when it is loaded, in its own words."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from bad_input.problem_files import REFUSED, SOUND

from oed_sysid.errors import ProblemError
from oed_sysid.experiments.definition import faults
from oed_sysid.experiments.problem import list_problems, load_problem


def write(folder: Path, source: str | dict[str, str | bytes]) -> Path:
    """Make the folder of an entry."""
    place = folder / "ferry"
    for name, content in ({"problem.py": source} if isinstance(source, str) else source).items():
        target = place / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content.encode() if isinstance(content, str) else content)
    return place


def test_sound_problem_loads(tmp_path: Path) -> None:
    """The problem that the faulty ones are made from is without fault."""
    problem = load_problem(write(tmp_path, SOUND))
    assert problem.model.free_names == ("K", "T")
    assert [effect.name for effect in problem.effects] == ["drag", "bias"]


@pytest.mark.parametrize(
    ("source", "words"), [one[1:] for one in REFUSED], ids=[one[0] for one in REFUSED]
)
def test_refused_when_loaded(
    tmp_path: Path, source: str | dict[str, str | bytes], words: tuple[str, ...]
) -> None:
    """A faulty folder ends in a ProblemError that names the file and what is wrong."""
    with pytest.raises(ProblemError) as caught:
        load_problem(write(tmp_path, source))
    message = str(caught.value)
    assert "ferry" in message
    for word in words:
        assert word in message


def test_catalogue_is_large_enough() -> None:
    """At least 66 folders are refused, each another one."""
    assert len({one[0] for one in REFUSED}) == len(REFUSED) >= 66
    sources = [str(one[1]) for one in REFUSED]
    assert len(set(sources)) == len(sources)


def test_a_problem_does_not_move_the_process(tmp_path: Path) -> None:
    """What a problem does to the working folder ends with its loading."""
    here = os.getcwd()
    load_problem(write(tmp_path, SOUND + "import os\nos.chdir('/')\n"))
    assert os.getcwd() == here


@pytest.mark.parametrize("name", ["", "  ", 7, None, "a\0b"])
def test_what_is_no_name_is_refused(name: object) -> None:
    """Something else than a name or a folder is refused in words."""
    with pytest.raises(ProblemError):
        load_problem(name)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", list_problems())
def test_shipped_problems_are_sound(name: str) -> None:
    """No shipped problem has an error of dimension, or a candidate that is there at zero."""
    problem = load_problem(name)
    for one in (problem, *problem.others.values()):
        assert faults(one.name, one.models, one.effects) == ()
    assert problem.notes() == ()  # their numbers have no units of their own
