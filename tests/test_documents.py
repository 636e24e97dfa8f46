"""Pages whose numbers are measured: the frame, and numbers of `docs/measured_data.md`."""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path

import jinja2
import numpy as np
import pytest

from benchmarks.documents import measured_data, page
from benchmarks.documents.__main__ import PAGES, main
from benchmarks.documents.page import Page, Unfounded

ROOT = Path(__file__).resolve().parent.parent
TEXTS = sorted(
    path.relative_to(ROOT)
    for folder in (".", "docs", "docs/walks", "oed_sysid", "problems/*", "examples")
    for path in ROOT.glob(f"{folder}/*.md")
)
MEASURED = pytest.mark.skipif("OED_SYSID_DATA" not in os.environ, reason="measured data absent")


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Page:
    """A page of its own, of two sections, in a folder of its own."""
    for name in ("docs", "templates"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(page, "TEMPLATES", tmp_path / "templates")
    monkeypatch.setattr(page, "RESULTS", tmp_path)
    monkeypatch.setattr(page.Page, "target", property(lambda self: tmp_path / "docs" / "small.md"))
    (tmp_path / "templates" / "small.md").write_text(
        'Gain {{ law.K | number(".2f") }}, {{ stands("stable", law.T > 0) }}, '
        '{{ runs.errors | spanned(".1f") }} in {{ measured.law.revision }}\n'
    )
    sections = {
        "law": lambda: {"K": np.float64(-0.125), "T": np.array(3.0)},
        "runs": lambda: {"errors": np.array([3.0, 1.0, 2.0])},
    }
    return Page("small", sections)


def test_numbers_are_kept_by_section(small: Page) -> None:
    """What was measured comes back as plain numbers, and a section leaves the others."""
    small.measure("runs")
    law = small.measure("law")
    kept = small.stored()
    assert list(kept) == ["law", "runs"]
    assert kept["law"]["numbers"] == {"K": -0.125, "T": 3.0}
    assert kept["runs"]["numbers"]["errors"] == [3.0, 1.0, 2.0]
    assert law["revision"] == page.revision(*page.CODE)
    assert small.text() == f"Gain -0.12, stable, 1.0 to 3.0 in {law['revision']}\n"


def test_a_page_without_its_numbers_is_refused(small: Page) -> None:
    """A section that was never measured is named."""
    small.measure("law")
    with pytest.raises(Unfounded, match="runs"):
        small.text()


def test_words_that_numbers_do_not_carry_are_refused(small: Page) -> None:
    """A verdict falls with its number; a number that nobody measured is no blank."""
    small.measure("law")
    small.measure("runs")
    kept = small.stored()
    kept["law"]["numbers"]["T"] = -3.0
    small.kept.write_text(json.dumps(kept), encoding="utf-8")
    with pytest.raises(Unfounded, match="stable"):
        small.text()
    kept["law"]["numbers"].pop("T")
    small.kept.write_text(json.dumps(kept), encoding="utf-8")
    with pytest.raises(jinja2.UndefinedError, match="T"):
        small.text()


def test_what_json_cannot_hold_is_refused(small: Page) -> None:
    """An object among the numbers is named rather than written as its address."""
    odd = Page("small", {"law": lambda: {"fit": object()}})
    with pytest.raises(TypeError, match="object"):
        odd.measure("law")
    assert not odd.kept.exists()


@pytest.mark.parametrize("name", PAGES)
def test_pages_are_as_measured(name: str) -> None:
    """Every page in the documents is its template with the numbers kept."""
    assert main([name]) == 0


def test_the_end_of_the_numbers_decides(capsys: pytest.CaptureFixture) -> None:
    """Asked for what there is not, the command says what there is."""
    for wrong in (["weather"], ["measured_data", "--only", "weather"]):
        with pytest.raises(SystemExit):
            main(wrong)
        assert "roll_decay" in (text := capsys.readouterr().err) or "measured_data" in text


@pytest.mark.parametrize("path", TEXTS, ids=str)
def test_rows_have_the_cells_of_their_table(path: Path) -> None:
    """A row of a table has as many cells as its head: none stands in a table of another kind."""
    wrong, cells, code = [], 0, False
    for number, line in enumerate((ROOT / path).read_text(encoding="utf-8").splitlines(), 1):
        code ^= line.startswith("```")
        if code or not line.startswith("|"):
            cells = 0
            continue
        plain = re.sub(r"`[^`]*`", "", line.replace(r"\|", ""))
        cells = cells or plain.count("|")
        if plain.count("|") != cells:
            wrong.append(number)
    assert wrong == []


@MEASURED
def test_roll_decay_is_measured_again() -> None:
    """The kept numbers of the quickest section come again."""
    kept = measured_data.PAGE.stored()["roll_decay"]["numbers"]
    now = measured_data.roll_decay()
    assert [s["names"] for s in now["found"]["steps"]] == [
        s["names"] for s in kept["found"]["steps"]
    ]
    for one, other in zip(now["found"]["steps"], kept["found"]["steps"], strict=True):
        assert one["gain"] == pytest.approx(other["gain"], rel=0.02)
    assert now["errors"] == pytest.approx(kept["errors"], rel=0.02)
    assert math.degrees(now["errors"]["improved"]) < 0.03
    assert not now["tail"]["nonlinear"]


@MEASURED
def test_noise_is_measured_again() -> None:
    """White levels of the measured signals come again."""
    kept = measured_data.PAGE.stored()["noise"]["numbers"]
    for name, found in measured_data.noise().items():
        assert found["level"] == pytest.approx(kept[name]["level"], rel=1e-6)
        assert found["seen"] == kept[name]["seen"]
