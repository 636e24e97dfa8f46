"""The demonstration tells its story from a plain call and in the time that was promised."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest


@pytest.fixture(name="told", scope="module")
def _told(tmp_path_factory) -> tuple[Path, str, float]:
    """The demonstration, run once as a user runs it."""
    place = tmp_path_factory.mktemp("demo")
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "oed_sysid.demo"],
        capture_output=True,
        text=True,
        cwd=place,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return place, done.stdout, time.perf_counter() - began


@pytest.mark.slow
def test_story_names_an_effect_and_ends_in_noise(told) -> None:
    """The error on untouched records falls to the noise, and a verdict is printed."""
    _, printed, _ = told
    assert "Missing was " in printed
    assert "Verdict: the remaining misfit is noise" in printed
    assert "improved: the misfit is noise" in printed


@pytest.mark.slow
def test_story_leaves_pictures_and_one_report(told) -> None:
    """What the story says it has written is there."""
    place, printed, _ = told
    folder = place / "out" / "demo"
    assert str(folder) in printed
    assert (folder / "report.html").stat().st_size > 100_000
    for name in ("located", "ranking", "error", "outputs", "prediction"):
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_story_takes_less_than_two_minutes(told) -> None:
    """`make demo` keeps its promise on two cores."""
    assert told[2] < 120.0
