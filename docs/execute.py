"""Notebooks of ``examples/notebooks`` with their results, for the site.

    python docs/execute.py

writes ``docs/notebooks/``; ``make docs`` runs it.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import nbformat
from sources import ROOT, changed, digest

HERE = Path(__file__).resolve().parent


def main(folder: Path = HERE / "notebooks", *, run: bool = True) -> None:
    """Execute those notebooks that have changed, or all where the package has."""
    folder.mkdir(exist_ok=True)
    for source in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb")):
        stamp, now = folder / f"{source.stem}.sha256", digest(source) if run else "not executed"
        if changed(stamp, now):
            book = nbformat.read(source, 4)
            # That cell is for those who have no package.
            book.cells = [cell for cell in book.cells if cell.get("id") != "install"]
            if run:
                execute(book)
            nbformat.write(book, folder / source.name)
            stamp.write_text(now, encoding="utf-8")


def execute(book: nbformat.NotebookNode) -> None:
    """Run all cells in a folder of their own."""
    import nbclient

    with TemporaryDirectory() as here:
        nbclient.execute(book, cwd=here, kernel_name="python3")


if __name__ == "__main__":
    main()
