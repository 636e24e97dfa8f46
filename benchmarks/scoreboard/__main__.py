"""Score public benchmarks and write the table."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.scoreboard import (
    esso_osaka,
    roll_decay,
    silverbox,
    tanks,
)
from benchmarks.scoreboard.row import Row, attempted

BOARDS: dict[str, Callable[[], list[Row]]] = {
    "silverbox": silverbox.score,
    "tanks": tanks.score,
    "esso_osaka": esso_osaka.score,
    "roll_decay": roll_decay.score,
}
TARGET = Path(__file__).resolve().parent.parent.parent / "docs" / "scoreboard.md"
HEAD = """# Scoreboard

Public benchmarks with their official splits, beside the published figures. Each section is written
by `python -m benchmarks.scoreboard NAME`, all of them without a name. What says *missing* is
scored as soon as its file lies in the data folder (`OED_SYSID_DATA`); what is wrong with a file
that cannot be scored stands in its row, and all other rows are as without it. No parameter was
fitted to a record that is scored as a test, and official test records chose no structure either;
where a validation part of our own confirmed the effects (`improve`), the note says so.
"""
TABLE = "| benchmark | ours | published | note |\n|---|---|---|---|\n"


def written(rows: dict[str, list[Row]], page: str) -> str:
    """The page with the sections of these boards written anew, the others as they are."""
    sections = dict.fromkeys(BOARDS, "")
    for part in page.split("\n## ")[1:]:
        name, _, body = part.partition("\n")
        sections[name] = body.strip()
    for name, found in rows.items():
        lines = ["| " + " | ".join(row.cells()) + " |" for row in found]
        sections[name] = TABLE + "\n".join(lines)
    body = (f"\n## {name}\n\n{text}\n" for name, text in sections.items() if text)
    return HEAD + "".join(body)


def main(arguments: list[str] | None = None) -> None:
    """Run the boards that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="name", help=", ".join(BOARDS))
    parser.add_argument("--output", type=Path, default=TARGET, help="docs/scoreboard.md")
    given = parser.parse_args(arguments)
    if unknown := [name for name in given.names if name not in BOARDS]:
        parser.error(f"there is no board {unknown[0]}; choose from {', '.join(BOARDS)}")
    for name in given.names or BOARDS:
        began = time.perf_counter()
        print(f"{name}:", flush=True)
        found = attempted(name, "-", f"the board {name}", BOARDS[name])
        for row in found:
            print("  " + " | ".join(row.cells()), flush=True)
        print(f"  ({time.perf_counter() - began:.0f} s)", flush=True)
        page = given.output.read_text(encoding="utf-8") if given.output.is_file() else ""
        given.output.write_text(written({name: found}, page), encoding="utf-8")


if __name__ == "__main__":
    main()
