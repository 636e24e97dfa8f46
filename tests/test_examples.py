"""Every example runs, as its reader would run it, and ends with a conclusion."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
# Examples that take more than a few seconds.
SLOW: tuple[str, ...] = (
    "programme_for_a_tanker",
    "programme_for_an_auv",
    "cascaded_tanks",
    "esso_osaka_wind",
    "find_missing_physics",
    "slocum_glider",
    "tanker_turning_circle",
)
# Examples on measured data of third parties, which is not shipped.
MEASURED = (
    "esso_osaka_wind",
    "roll_decay",
    "silverbox",
    "cascaded_tanks",
    "slocum_glider",
    "tanker_gain_and_time_constant",
    "tanker_held_out_zigzag",
    "tanker_on_line",
    "tanker_turning_circle",
)
MAXIMUM_LINES = 80


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=[pytest.mark.slow] if path.stem in SLOW else [], id=path.stem)
        for path in EXAMPLES
    ],
)
def test_example_runs_and_concludes(path: Path, tmp_path: Path) -> None:
    """An example asks a question, stays short, and prints its answer."""
    if path.stem in MEASURED and "OED_SYSID_DATA" not in os.environ:
        pytest.skip("measured data absent")
    text = path.read_text(encoding="utf-8")
    assert text.startswith('"""Question: '), f"{path.name} begins with its question"
    assert len(text.splitlines()) <= MAXIMUM_LINES
    done = subprocess.run(
        [sys.executable, path],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONWARNINGS": "error::DeprecationWarning:__main__"},
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.strip().splitlines()) >= 2


def test_slow_examples_exist() -> None:
    """A renamed example does not stay in the list of slow ones."""
    assert {path.stem for path in EXAMPLES} >= set(SLOW)
