"""Score public benchmarks and write the table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.harness import command, known, markdown
from benchmarks.scoreboard import (
    drive,
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
    "drive": drive.score,
}
TARGET = Path(__file__).resolve().parent.parent.parent / "docs" / "scoreboard.md"
HEAD = """# Scoreboard

Public benchmarks with their official splits, beside the published figures. Each section is written
by `python -m benchmarks.scoreboard NAME`, all of them without a name. What says *missing* is
scored as soon as its file lies in the data folder (`OED_SYSID_DATA`); what is wrong with a file
that cannot be scored stands in its row, and all other rows are as without it. No parameter was
fitted to a record that is scored as a test, and official test records chose no structure either;
where a validation part of our own confirmed the effects (`improve`), the note says so.

```{include} gallery/error_beside_the_laboratorys.txt
:relative-images:
```
"""


def written(rows: dict[str, list[Row]], page: str) -> str:
    """The page with the sections of these boards written anew, the others as they are."""
    sections = dict.fromkeys(BOARDS, "")
    for part in page.split("\n## ")[1:]:
        name, _, body = part.partition("\n")
        sections[name] = body.strip()
    for name, found in rows.items():
        head = ("benchmark", "ours", "published", "note")
        sections[name] = "\n".join(markdown(head, (row.cells() for row in found)))
    body = (f"\n## {name}\n\n{text}\n" for name, text in sections.items() if text)
    return HEAD + "".join(body)


def main(names: Sequence[str] = (), *, output: Path = TARGET) -> None:
    """Run the boards that are named, or all.

    Parameters
    ----------
    names : sequence of str
        silverbox, tanks, esso_osaka, roll_decay, drive
    output : Path
        page that has the tables
    """
    for name in [known(name, BOARDS, "board") for name in names] or BOARDS:
        found = attempted(name, "-", f"the board {name}", BOARDS[name])
        for row in found:
            print(f"{name}: " + " | ".join(row.cells()), flush=True)
        page = output.read_text(encoding="utf-8") if output.is_file() else ""
        output.write_text(written({name: found}, page), encoding="utf-8")


if __name__ == "__main__":
    command(main)
