"""The demonstration tells its story from a plain call and in the time that was promised."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest


def tell(place: Path, data: str | None) -> tuple[str, float]:
    """Run the demonstration as a user does, with or without a folder of measured data."""
    environment = {key: value for key, value in os.environ.items() if key != "OED_SYSID_DATA"}
    environment["OED_SYSID_DATA"] = str(place / "nothing") if data is None else data
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "oed_sysid.cli.demo"],
        capture_output=True,
        text=True,
        cwd=place,
        env=environment,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout, time.perf_counter() - began


@pytest.fixture(name="told", scope="module")
def _told(tmp_path_factory) -> tuple[Path, str, float]:
    """The demonstration without measured data, run once."""
    place = tmp_path_factory.mktemp("demo")
    return place, *tell(place, None)


@pytest.mark.slow
def test_story_names_an_effect_and_ends_in_noise(told) -> None:
    """The error on validation records falls to the noise, and a verdict is printed."""
    _, printed, _ = told
    assert "Missing was " in printed
    assert "Verdict: the remaining misfit is noise" in printed
    assert "improved: the misfit is noise" in printed
    assert "tanker's story is left out" in printed


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
@pytest.mark.skipif(
    not os.environ.get("OED_SYSID_DATA"), reason="needs measured data, OED_SYSID_DATA"
)
def test_tanker_is_told_where_its_records_are(tmp_path: Path) -> None:
    """With the tank's records the hull's nonlinear forces are missed and found."""
    printed, _ = tell(tmp_path, os.environ["OED_SYSID_DATA"])
    assert "Missing was hull_cubic" in printed
    assert (tmp_path / "out" / "demo" / "tanker" / "zigzag.png").is_file()
