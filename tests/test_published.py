"""What docs/published.md says beyond the problems' own tests, and that what it cites exists."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.documents.published import paper

ROOT = Path(__file__).resolve().parent.parent


def cited() -> list[tuple[str, str]]:
    """File and name of every test that the document cites; '::name' is in the file before."""
    text = (ROOT / "docs" / "published.md").read_text(encoding="utf-8")
    found, file = [], ""
    for name, test in re.findall(r"`(test_\w+\.py)?::(test_\w+)`", text):
        file = name or file
        found.append((file, test))
    return found


@pytest.mark.parametrize(("file", "test"), cited())
def test_cited_tests_exist(file: str, test: str) -> None:
    """Every line of the table can be run."""
    assert f"def {test}(" in (ROOT / "tests" / file).read_text(encoding="utf-8")


def test_headings_against_the_truth() -> None:
    """Errors of K and T against the truth, and predictions, of sparse headings and curves."""
    script = paper("nomoto_sparse_heading")
    case = next(iter(script.CASES))
    signed, headings = script.signed(case), script.prediction(case)
    error = {
        way: float(np.sqrt(np.mean((heading - headings["truth"]) ** 2)))
        for way, heading in headings.items()
    }
    assert signed["0.1 s"] == pytest.approx((-2.25, -18.08), abs=0.01)
    assert signed["spiral"] == pytest.approx((0.31, -18.20), abs=0.01)
    assert error["spiral"] == pytest.approx(0.0215, abs=1e-4)
    assert error["cubic"] == pytest.approx(0.0227, abs=1e-4)
    assert error["0.5 s"] == pytest.approx(0.0799, abs=1e-4)
    assert signed["shooting"] == pytest.approx((2.24, -0.65), abs=0.01)
    assert np.abs(signed["fine rudder"]).max() < 0.1
