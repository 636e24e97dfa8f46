"""Each of the five published papers works from its folder, by one command."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
# What the last lines of each say; longer ones are slow.
PAPERS = {
    "auv_diving_plane": "'Simpson': 4, 'trapezoid': 5, 'Euler': 12",
    "online_ship": "settle after about 60 samples",
    "nomoto_sparse_heading": "in 3 of 12 rows",
    "sailboat": "posterior means and the closed form differ by 0.0",
    "torpedo": "the largest error at 3 % noise is 7 %",
}
QUICK = ("auv_diving_plane", "online_ship")


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[] if n in QUICK else [pytest.mark.slow]) for n in PAPERS],
)
def test_paper_runs_and_concludes(name: str, tmp_path: Path) -> None:
    """The script of a problem prints its published headline next to what is found."""
    done = subprocess.run(
        [sys.executable, ROOT / "problems" / name / "paper.py"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    assert PAPERS[name] in done.stdout
