"""Score public benchmarks and write the table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.harness import ROOT, command, known, markdown, write_page
from benchmarks.scoreboard import drive, esso_osaka, roll_decay, silverbox, tanks
from benchmarks.scoreboard.row import Row, attempted

BOARDS: dict[str, Callable[[], list[Row]]] = {
    "silverbox": silverbox.score,
    "tanks": tanks.score,
    "esso_osaka": esso_osaka.score,
    "roll_decay": roll_decay.score,
    "drive": drive.score,
}
TARGET = ROOT / "docs" / "scoreboard.md"
HEAD = ("benchmark", "ours", "published", "note")


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
        write_page(output, "\n".join(markdown(HEAD, (row.cells() for row in found))), name)


if __name__ == "__main__":
    command(main)
