"""Tables of sentences: every row that is asked for is there, and has its facts."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from string import Formatter

import pytest

import oed_sysid
from oed_sysid import data, experiments, text
from oed_sysid.design import criteria
from oed_sysid.evidence.sentences import SAYS, say
from oed_sysid.information import response
from oed_sysid.physics import channels

PACKAGE = Path(oed_sysid.__file__).parent
ROOM = PACKAGE / "evidence"
PAGES = {
    "data": data.SAYS,
    "design": criteria.SAYS,
    "experiments": experiments.SAYS,
    "information": response.SAYS,
    "physics": channels.SAYS,
    "text": text.SAYS,
}


def _asked() -> Iterator[tuple[str, str, set[str | None]]]:
    """Table, row and names of facts of every sentence that the sources name."""
    for path in sorted(ROOM.glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "say":
                match node.args:
                    case [ast.Constant(value=str(about)), ast.Constant(value=str(row))]:
                        yield about, row, {one.arg for one in node.keywords}


@pytest.mark.parametrize(("about", "row", "given"), [*_asked()])
def test_sentences_have_their_facts(about: str, row: str, given: set[str | None]) -> None:
    """A sentence that is asked for by name is in the table, and all that it says is given."""
    needed = {field for _, field, _, _ in Formatter().parse(SAYS[about][row]) if field}
    assert None in given or needed <= given


def test_every_kind_of_what_is_left_has_its_sentence() -> None:
    """The five kinds of a verdict, and the three of an answer, are rows."""
    kinds = {"log suspect", "structure missing", "not known", "disturbance", "adequate"}
    assert set(SAYS["remains"]) == kinds
    assert {"missing", "unexplained", "nothing_missing"} <= set(SAYS["answer"])
    assert say("search", "better", times=2.345).endswith("2.3 times better.")


def _said(room: str) -> Iterator[tuple[str, set[str] | None]]:
    """Row, and names of facts where the row takes any, of every ``SAYS[...]`` of a package."""
    for path in sorted((PACKAGE / room).glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        formed = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "format":
                keywords = {one.arg for one in node.keywords}
                if None not in keywords:  # facts by **, which only a run shows
                    facts = {*map(str, range(len(node.args))), *filter(None, keywords)}
                    formed[id(node.func.value)] = facts  # type: ignore[attr-defined]
        for node in ast.walk(tree):
            match node:
                case ast.Subscript(ast.Name("SAYS"), ast.Constant(str(row))):
                    yield row, formed.get(id(node))


@pytest.mark.parametrize("room", PAGES)
def test_what_is_refused_has_its_sentence(room: str) -> None:
    """Every row that a package says is in its table, once, and all facts of it are given."""
    asked = list(_said(room))
    assert {row for row, _ in asked} <= set(PAGES[room])
    for row, facts in asked:
        if facts is not None:
            fields = [field for _, field, _, _ in Formatter().parse(PAGES[room][row])]
            assert {re.split(r"[.\[]", one)[0] for one in fields if one} == facts, row
