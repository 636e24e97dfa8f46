"""The catalogues of bad input, each with the message that it gets today, as tables.

python -m benchmarks.bad_input                # counts
python -m benchmarks.bad_input --write        # puts the messages into docs/errors.md
"""

from __future__ import annotations

import re
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.harness import ROOT, Row, command, markdown, table_of, write_page
from oed_sysid import OedSysidError, load_problem, read_csv

sys.path.insert(0, str(ROOT / "tests"))
from bad_input import csv_files, folder_of, problem_files, written

NOTED_AND_REFUSED = (*csv_files.REFUSED, *csv_files.NOTED)
PAGE = ROOT / "docs" / "errors.md"
_LONGEST = 260


def csv_message(content: str | bytes) -> str:
    """What is said about a file: the refusal, or what is noted."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        try:
            read_csv(written(Path(folder) / "log.csv", content), csv_files.CHANNELS)
        except OedSysidError as error:
            return f"{type(error).__name__}: {error}"
        return "Note: " + " ".join(str(one.message) for one in noted) if noted else ""


def problem_message(files: Mapping[str, str | bytes]) -> str:
    """What is said about a problem folder when it is loaded; empty if nothing."""
    with tempfile.TemporaryDirectory() as folder:
        place = folder_of(Path(folder).resolve() / "ferry", files)
        try:
            load_problem(place)
        except OedSysidError as error:
            return _without_places(f"{type(error).__name__}: {error}", place.parent)
        return ""


def _without_places(message: str, folder: Path) -> str:
    """The message without folders and names that differ from one machine to the next."""
    for place in (folder, ROOT):
        message = message.replace(str(place), "…")
    return re.sub(r"(oed_sysid_problem_ferry)_\w+", r"\1", message)


def table(rows: Iterable[tuple[str, str]]) -> str:
    """Rows of kind and message as Markdown."""
    cells = []
    for kind, message in rows:
        short = message if len(message) <= _LONGEST else message[: _LONGEST - 1] + "…"
        for sign, plain in (("\n", " "), ("|", "\\|"), ("<", "&lt;"), ("*", "\\*")):
            short = short.replace(sign, plain)
        cells.append((kind, short))
    return "\n".join(markdown(("what", "answer"), cells))


def sections() -> dict[str, str]:
    """The tables by the name of their place in the page."""
    return {
        "CSV files": table((kind, csv_message(content)) for kind, content, _ in NOTED_AND_REFUSED),
        "problem folders": table(
            (kind, problem_message(files)) for kind, files, _ in problem_files.REFUSED
        ),
    }


CATALOGUES: tuple[tuple[str, Any, Callable[[Any], str]], ...] = (
    ("CSV files to be refused", csv_files.REFUSED, csv_message),
    ("CSV files to be read, with a note", csv_files.NOTED, csv_message),
    ("problem folders to be refused", problem_files.REFUSED, problem_message),
)


def counted() -> list[Row]:
    """Entries of each catalogue, those with the message that they must get, and silent ones."""
    rows = list[Row]()
    for what, entries, say in CATALOGUES:
        answers = [(say(content), words) for _, content, words in entries]
        right = sum(all(word in answer for word in words) for answer, words in answers)
        silent = sum(not answer for answer, _ in answers)
        rows.append({"catalogue": what, "entries": len(entries), "right": right, "silent": silent})
    return rows


def main(*, write: bool = False) -> None:
    """Count the messages that are right.

    Parameters
    ----------
    write : bool
        write docs/errors.md
    """
    print("\n".join(table_of(counted())))
    for name, content in sections().items() if write else ():
        write_page(PAGE, content, name)


if __name__ == "__main__":
    command(main)
