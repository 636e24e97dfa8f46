"""Sentences of a search: every row that is asked for is there, and has its facts."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from string import Formatter

import pytest

import oed_sysid
from oed_sysid.evidence.sentences import SAYS, say

ROOM = Path(oed_sysid.__file__).parent / "evidence"


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
