"""The notebooks of examples/notebooks: small, without results in them, and they run."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
MOST_CELLS = 16


def test_every_tutorial_has_a_notebook() -> None:
    """Tanker, AUV, a log and an effect of one's own; the page of notebooks names them all."""
    assert {path.stem for path in NOTEBOOKS} == {"tanker", "auv", "own_log", "own_effect"}
    page = (ROOT / "docs" / "notebooks.md").read_text(encoding="utf-8")
    assert not [path.name for path in NOTEBOOKS if path.name not in page]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_small_and_holds_no_results(path: Path) -> None:
    """A notebook is text to be run: no outputs, few cells, a title, and a conclusion."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert len(cells) <= MOST_CELLS
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert not [cell for cell in code if cell["outputs"] or cell["execution_count"]]
    assert "".join(cells[0]["source"]).startswith("# ")
    assert "Conclusion" in "".join(code[-1]["source"])


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every cell runs in a fresh kernel; tables, pictures and numbers come out."""
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(paths))
    monkeypatch.delenv("MPLBACKEND", raising=False)  # left by other tests, it hides pictures
    book = nbformat.read(path, as_version=4)
    runner = client.NotebookClient(
        book, timeout=900, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    runner.execute()
    kinds = [kind for cell in book.cells for out in cell.get("outputs", ())
             for kind in out.get("data", ())]  # fmt: skip
    assert "text/html" in kinds
    assert "image/png" in kinds or path.stem == "own_log"
    said = "".join(out.get("text", "") for out in book.cells[-1]["outputs"])
    assert said.startswith("Conclusion: ")
    assert any(character.isdigit() for character in said)
