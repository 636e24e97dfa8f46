"""The commands that judge and improve a model, on a folder as `oed-sysid new` writes it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from oed_sysid.cli import BAD_INPUT, DONE, main

HIDDEN = "yaw_quadratic_damping"


@pytest.fixture(name="ship", scope="module")
def _ship(tmp_path_factory) -> Path:
    """The starter folder; its data hides a damping that the model lacks."""
    folder = tmp_path_factory.mktemp("cli") / "my_ship"
    assert main(["new", str(folder)]) == DONE
    return folder


def split(ship: Path) -> list[str]:
    """Command line that learns from the zigzags and judges with the circle."""
    data = ship / "data"
    zigzags = [str(data / f"zigzag_{angle}.csv") for angle in ("10_10", "20_20")]
    return [*zigzags, "--validate", str(data / "turning_circle.csv")]


@pytest.fixture(name="improved", scope="module")
def _improved(ship: Path, tmp_path_factory) -> tuple[dict, str]:
    """What `improve` stores and the report that it writes."""
    place = tmp_path_factory.mktemp("improved")
    files = ["--json", str(place / "out.json"), "--html", str(place / "out.html")]
    assert main(["improve", str(ship), *split(ship), "--known-noise", *files]) == DONE
    stored = json.loads((place / "out.json").read_text())
    return stored, (place / "out.html").read_text(encoding="utf-8")


def test_improve_finds_what_was_hidden(improved: tuple[dict, str]) -> None:
    """The hidden effect is added, and the error on the validation circle falls to the noise."""
    stored, _ = improved
    assert stored["verdict"] == "missing"
    assert [step["added"] for step in stored["steps"]] == [HIDDEN]
    assert stored["base_error"]["test"] > 3.0
    assert stored["final_error"]["test"] == pytest.approx(1.0, abs=0.1)
    assert stored["ranking"][0]["effect"] == HIDDEN
    (amplitude,) = [one for one in stored["parameters"] if one["name"] == "E_yaw"]
    assert abs(amplitude["value"] - 1.5) < 4 * amplitude["std_error"]


def test_improve_report_says_the_same(improved: tuple[dict, str]) -> None:
    """The page names the effect and both errors, and refers to nothing outside."""
    stored, page = improved
    assert f"lacks {HIDDEN}" in page
    assert f"{stored['base_error']['test']:.3g} × noise" in page
    assert f"{stored['final_error']['test']:.3g} × noise" in page
    assert "http://" not in page
    assert "https://" not in page


def test_improve_without_untouched_records_makes_no_claim_on_them(ship: Path, tmp_path) -> None:
    """Without --validate the search still runs; errors on validation records are absent."""
    given = split(ship)
    stored = tmp_path / "out.json"
    arguments = ["improve", str(ship), *given[: given.index("--validate")], "--json", str(stored)]
    assert main(arguments) == DONE
    assert json.loads(stored.read_text())["final_error"]["test"] is None


@pytest.mark.slow
def test_improve_without_listed_candidates(ship: Path, tmp_path: Path) -> None:
    """A problem that lists no candidate effects gets usual ones, and what is hidden is found."""
    bare = tmp_path / "bare"
    bare.mkdir()
    text = (ship / "problem.py").read_text().replace("    effects=effects,\n", "")
    text = text.replace(', "E_yaw": 1.5', "")
    (bare / "problem.py").write_text(text)
    stored = tmp_path / "found.json"
    assert main(["improve", str(bare), *split(ship), "--json", str(stored)]) == DONE
    found = json.loads(stored.read_text())
    assert [step["added"] for step in found["steps"]] == ["quadratic_r_r"]
    assert found["final_error"]["test"] < 1.2 < 100 < found["base_error"]["test"]
    # The names are known to what comes next.
    compared = tmp_path / "compare.json"
    arguments = ["compare", str(bare), *split(ship), "--with", "quadratic_r_r", "--json"]
    assert main([*arguments, str(compared)]) == DONE
    models = {one["label"]: one for one in json.loads(compared.read_text())["models"]}
    assert models["with quadratic_r_r"]["relative"] < 1.2 < models["nominal"]["relative"]


def test_compare_judges_models_on_untouched_records(ship: Path, tmp_path: Path, capsys) -> None:
    """The nominal model misses the circle; with the right effect only noise is left."""
    stored = tmp_path / "compare.json"
    page = tmp_path / "compare.html"
    extra = [
        "--with",
        HIDDEN,
        f"rudder_offset+{HIDDEN}",
        "--json",
        str(stored),
        "--html",
        str(page),
    ]
    assert main(["compare", str(ship), *split(ship), *extra]) == DONE
    models = {one["label"]: one for one in json.loads(stored.read_text())["models"]}
    assert models["nominal"]["relative"] > 3.0
    assert models[f"with {HIDDEN}"]["relative"] < 1.1
    assert models[f"with rudder_offset and {HIDDEN}"]["relative"] < 1.2
    assert f"Closest: with {HIDDEN}" in capsys.readouterr().out
    assert "turning_circle" in page.read_text(encoding="utf-8")


def test_compare_refuses_an_unknown_candidate(ship: Path, capsys) -> None:
    """A misspelt candidate is answered with the nearest one."""
    arguments = ["compare", str(ship), *split(ship), "--with", "yaw_quadratic_dampin"]
    assert main(arguments) == BAD_INPUT
    assert f"Did you mean {HIDDEN!r}?" in capsys.readouterr().err


def test_saved_fit_and_report_of_a_fit(ship: Path, tmp_path: Path) -> None:
    """--save keeps a fit that loads again, --html writes its report."""
    from oed_sysid import Fit

    page, saved = tmp_path / "a" / "fit.html", tmp_path / "b" / "fit.json"
    arguments = ["fit", str(ship), str(ship / "data"), "--html", str(page), "--save", str(saved)]
    assert main(arguments) == DONE
    assert "K" in Fit.load(saved).values
    assert page.read_text(encoding="utf-8").startswith("<!doctype html>")


def test_report_of_a_saved_fit_predicts_other_records(ship: Path, tmp_path: Path, capsys) -> None:
    """`report` needs nothing but the saved fit, and adds the records it is shown."""
    saved, page = tmp_path / "fit.json", tmp_path / "fit.html"
    zigzag, circle = (
        str(ship / "data" / f"{name}.csv") for name in ("zigzag_10_10", "turning_circle")
    )
    assert main(["fit", str(ship), zigzag, "--save", str(saved)]) == DONE
    capsys.readouterr()
    assert main(["report", str(saved), "--validate", circle, "--out", str(page)]) == DONE
    assert "heading deviates" in capsys.readouterr().out
    text = page.read_text(encoding="utf-8")
    assert "zigzag_10_10" in text
    assert "turning_circle" in text
    assert main(["report", str(tmp_path / "missing.json")]) == BAD_INPUT
    assert main(["report", zigzag]) == BAD_INPUT


def test_diagnose_locates_and_ranks_without_adding(ship: Path, tmp_path: Path, capsys) -> None:
    """`diagnose` names the candidate from the training records alone, on paper and page."""
    given = split(ship)
    stored, page = tmp_path / "look.json", tmp_path / "look.html"
    files = ["--json", str(stored), "--html", str(page), "--known-noise"]
    assert main(["diagnose", str(ship), *given[: given.index("--validate")], *files]) == DONE
    assert json.loads(stored.read_text())["best"] == HIDDEN
    assert HIDDEN in capsys.readouterr().out
    assert f"lacks {HIDDEN}" in page.read_text(encoding="utf-8")
