"""The commands that design, plan, judge and improve, on a folder of `oed-sysid new`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import told
from plain_pages import plain_pages  # noqa: F401

from oed_sysid import (
    Doublet,
    Experiment,
    Limits,
    MultipleShooting,
    load_problem,
    read_csv,
    simulate,
    write_csv,
)
from oed_sysid.cli import BAD_INPUT, DONE, main
from oed_sysid.cli.limit_words import with_limits
from oed_sysid.design.decision import Logbook
from oed_sysid.errors import DesignError
from oed_sysid.evidence.chance import threshold


@pytest.fixture(name="ship", scope="module")
def _ship(tmp_path_factory) -> Path:
    """The starter folder."""
    folder = tmp_path_factory.mktemp("cli") / "my_ship"
    assert main(["new", str(folder)]) == DONE
    return folder


def test_design_keeps_limits_and_beats_the_zigzags(ship: Path, tmp_path: Path, capsys) -> None:
    """The commands stay in range, and the expected errors are below those of a zigzag."""
    commands, card, page = (tmp_path / name for name in ("next.csv", "card.txt", "next.html"))
    files = ["--out", commands, "--card", card, "--html", page]
    arguments = ["design", ship, "--like", "zigzag_10_10", "--duration", "60", *files]
    result = told(tmp_path, arguments)
    assert "limits met" in capsys.readouterr().out
    table = np.genfromtxt(commands, delimiter=",", names=True)
    times, rudder = table["t_s"], table["rudder_rad"]
    assert times[-1] == 60.0
    assert np.abs(rudder).max() <= np.radians(35) * (1 + 1e-6)
    assert np.abs(np.diff(rudder) / np.diff(times)).max() <= np.radians(5) * (1 + 1e-6)
    assert "SEA TRIAL CARD" in card.read_text()
    assert "SEA TRIAL CARD" in page.read_text(encoding="utf-8")
    assert all(one["after"] < one["before"] for one in result["parameters"])
    assert all(reference["mean_gain"] > 1.0 for reference in result["references"])


def test_limits_in_words_of_the_trade_and_files_for_those_on_board(
    ship: Path, tmp_path: Path, capsys
) -> None:
    """A largest rudder and rate in degrees are kept in every file that one command writes."""
    pytest.importorskip("rosbags")
    names = ("next.csv", "next.png", "card.pdf", "o.csv", "run.lua", "bag")
    commands, picture, card, pulses, script, bag = (tmp_path / name for name in names)
    arguments = ["design", str(ship), "--duration", "30", "--max-rudder", "8", "--max-rate=3"]
    arguments += ["--max-heading", "20", "--out", str(commands), "--picture", str(picture)]
    arguments += ["--length", "7", "--card", str(card), "--bag", str(bag)]
    arguments += ["--overrides", str(pulses), "--servo", "rudder=2"]
    assert main([*arguments, "--controller", f"ardupilot={script}"]) == DONE
    said = capsys.readouterr().out
    for words in ("rudder upper limit 8 deg", "rudder rate limit 3 deg/s", "limits kept on"):
        assert words in said
    assert picture.stat().st_size > 10_000
    table = np.genfromtxt(commands, delimiter=",", names=True)
    assert np.abs(table["rudder_rad"]).max() == pytest.approx(np.radians(8), rel=1e-3)
    slopes = np.abs(np.diff(table["rudder_rad"]) / np.diff(table["t_s"]))
    assert slopes.max() <= np.radians(3) * (1 + 1e-6)
    assert "SRV_Channels" in script.read_text()
    assert card.read_bytes()[:5] == b"%PDF-"
    table = np.genfromtxt(pulses, delimiter=",", skip_header=1)
    assert table[-1, 0] == 30_000
    assert table[:, 1].min() >= 1100
    assert table[:, 1].max() <= 1900
    assert (bag / "metadata.yaml").is_file()


def test_a_file_that_cannot_hold_a_run_costs_no_other(ship: Path, tmp_path: Path, capsys) -> None:
    """Ramps of half a second are no mission; the words of the same run are written all the same."""
    mission, words, commands = (tmp_path / name for name in ("m.waypoints", "w.txt", "o.csv"))
    arguments = ["design", str(ship), "--duration", "20", "--servo", "rudder=1"]
    arguments += ["--controller", f"mission={mission}", f"words={words}", "--out", str(commands)]
    assert main(arguments) == BAD_INPUT
    said = capsys.readouterr().err
    assert "orders 0.5 s apart" in said
    assert "kind=" not in said
    assert not mission.exists()
    assert "20 s" in words.read_text(encoding="utf-8").splitlines()[0]
    assert np.genfromtxt(commands, delimiter=",", names=True)["t_s"][-1] == 20.0


def test_limit_words_find_their_channels() -> None:
    """Words of the trade, names and ranges become limits of the right channel, in SI units."""
    model = load_problem("auv_diving_plane").model
    given = ["max:fin=10", "max:rate=2.5", "min:depth=80", "pitch=-20:15", "max:fin-rate=2"]
    limits, said = with_limits(model, Limits(signals={"z": (0.0, 120.0)}), given)
    assert limits.inputs["delta_s"] == pytest.approx((-np.radians(10), np.radians(10)))
    assert limits.rates["delta_s"] == pytest.approx(np.radians(2))
    assert limits.signals["z"] == (80.0, 120.0)
    assert limits.signals["theta"] == pytest.approx((-np.radians(20), np.radians(15)))
    assert said[0] == "fin is delta_s (stern plane angle)"
    for wrong, words in (
        ("max:rudder=10", "possible are .*--max-fin"),
        ("max:fin=ten", "no number"),
        ("max:depth-rate=1", "rate of 'z'"),
        ("fin", "not understood"),
        ("depth=90:80", "leaves nothing"),
        ("max:fin=0", "leaves nothing between 0 and 0 rad.*constants"),
        ("max:pitch=0", "leaves nothing"),
    ):
        with pytest.raises(DesignError, match=words):
            with_limits(model, Limits(), [wrong])


@pytest.mark.slow
def test_programme_is_planned_and_written(ship: Path, tmp_path: Path, capsys) -> None:
    """Runs, hours and limits in words of the trade are kept; tables, page and JSON are written."""
    stored, page, runs = tmp_path / "p.json", tmp_path / "p.html", tmp_path / "runs"
    arguments = ["programme", str(ship), "--runs", "3", "--hours", "1", "--sea", "calm,time=8"]
    arguments += ["--patterns", "zigzag_10_10", "--duration", "90", "--max-rudder", "15"]
    arguments += ["--rounds", "0", "--uncertainty", "0.1", "--out", str(runs)]
    assert main([*arguments, "--json", str(stored), "--html", str(page)]) == DONE
    said = capsys.readouterr()
    first = said.out.splitlines()[0]
    found = json.loads(stored.read_text())
    assert f"{len(found['runs'])} runs, {found['hours']:.3g} h: " in first
    assert "limits on" in first or "no limit on the motion" in first
    assert "ship time" in said.out.replace("\n", " ")
    assert "Disturbance forces:" in said.err
    found = json.loads(stored.read_text())
    assert 1 <= len(found["runs"]) <= 3
    assert found["hours"] <= 1.0 + 1e-9
    assert found["gap"] <= 2e-3
    assert found["value"] <= found["bound"] + 1e-9
    assert all(p["relative_error"] < 0.5 for p in found["parameters"])
    tables = sorted(runs.glob("*.csv"))
    assert len(tables) == len(found["runs"])
    for table in tables:
        rudder = np.genfromtxt(table, delimiter=",", names=True)["rudder_rad"]
        assert np.abs(rudder).max() <= np.radians(15) * (1 + 1e-6)
    assert "What to run" in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_campaign_goes_on_until_enough_is_known(ship: Path, tmp_path: Path, capsys) -> None:
    """Begun, broken off and resumed, it proposes runs that a hidden ship does, then stops."""
    folder = tmp_path / "trial"
    begin = ["campaign", str(folder), "--problem", str(ship), "--goal", "all=3", "--hours", "5"]
    begin += ["--patterns", "zigzag_10_10", "--duration", "90", "--uncertainty", "0.1"]
    assert told(tmp_path, begin)["action"] == "go on"
    assert main(begin) == BAD_INPUT
    problem = load_problem(ship)
    truth = problem.model.with_values(
        {p.name: 1.08 * p.value for p in problem.model.free_parameters}
    )
    rng = np.random.default_rng(0)
    actions = []
    for number in range(4):
        journal = Logbook.open(folder)
        proposed = next(one for one in journal.candidates if one.name == journal.proposed)
        experiment = replace(proposed.experiment, limits=Limits())
        log = tmp_path / f"log_{number}.csv"
        write_csv(simulate(truth, experiment, rng=rng), log)
        decision = told(tmp_path, ["campaign", folder, "--record", log])
        actions.append(decision["action"])
        assert decision["seconds"] < 20
        if decision["action"] != "go on":
            break
    assert actions[-1] == "enough"
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("GO ON: ") and " next (" in line for line in lines)
    assert any(
        line.startswith(f"STOP after {len(actions)} run") and "everything" in line for line in lines
    )
    assert all(one["now"] <= 0.03 for one in decision["goals"])
    # Asked again without a new log, the answer is the same; the same log twice is refused.
    assert told(tmp_path, ["campaign", folder])["action"] == "enough"
    assert main(["campaign", str(folder), "--record", str(log)]) == BAD_INPUT
    assert len(Logbook.open(folder).records) == len(actions)


HIDDEN = "yaw_quadratic_damping"


def split(ship: Path) -> list[str]:
    """Command line that learns from the zigzags and judges with the circle."""
    data = ship / "data"
    zigzags = [str(data / f"zigzag_{angle}.csv") for angle in ("10_10", "20_20")]
    return [*zigzags, "--validate", str(data / "turning_circle.csv")]


@pytest.mark.slow
def test_improve_without_untouched_records_makes_no_claim_on_them(ship: Path, tmp_path) -> None:
    """Without --validate the search still runs; errors on validation records are absent."""
    given = split(ship)
    found = told(tmp_path, ["improve", ship, *given[: given.index("--validate")]])
    assert found["final_error"]["test"] is None


@pytest.mark.slow
def test_improve_without_listed_candidates(ship: Path, tmp_path: Path) -> None:
    """A problem that lists no candidate effects gets usual ones, and what is hidden is found."""
    bare = tmp_path / "bare"
    bare.mkdir()
    text = (ship / "problem.py").read_text().replace("    effects=effects,\n", "")
    text = text.replace(', "E_yaw": 1.5', "")
    (bare / "problem.py").write_text(text)
    found = told(tmp_path, ["improve", bare, *split(ship)])
    assert [step["added"] for step in found["steps"]] == ["quadratic_r_r"]
    assert found["final_error"]["test"] < 1.2 < 100 < found["base_error"]["test"]
    # The names are known to what comes next.
    compared = told(tmp_path, ["compare", bare, *split(ship), "--with", "quadratic_r_r"])
    models = {one["label"]: one for one in compared["models"]}
    assert models["with quadratic_r_r"]["relative"] < 1.2 < models["nominal"]["relative"]


def test_compare_judges_models_on_untouched_records(ship: Path, tmp_path: Path, capsys) -> None:
    """The nominal model misses the circle; with the right effect only noise is left."""
    page = tmp_path / "compare.html"
    extra = ["--with", HIDDEN, f"rudder_offset+{HIDDEN}", "--disturbances", "none", "--html", page]
    compared = told(tmp_path, ["compare", ship, *split(ship), *extra])
    models = {one["label"]: one for one in compared["models"]}
    assert models["nominal"]["relative"] > 3.0
    assert models[f"with {HIDDEN}"]["relative"] < 1.1
    assert models[f"with rudder_offset and {HIDDEN}"]["relative"] < 1.2
    assert f"Closest: with {HIDDEN}" in capsys.readouterr().out
    assert "turning_circle" in page.read_text(encoding="utf-8")


def test_diagnose_locates_and_ranks_without_adding(ship: Path, tmp_path: Path, capsys) -> None:
    """`diagnose` names the candidate from the training records alone, on paper and page."""
    given = split(ship)
    page = tmp_path / "look.html"
    line = ["diagnose", ship, *given[: given.index("--validate")], "--known-noise", "--html", page]
    assert told(tmp_path, line)["best"] == HIDDEN
    assert HIDDEN in capsys.readouterr().out
    assert f"lacks {HIDDEN}" in page.read_text(encoding="utf-8")


def test_what_records_cannot_tell_is_fixed_and_checked(tmp_path: Path) -> None:
    """Of sway and yaw that keep one ratio some are fixed; the loss is that of two fits."""
    problem = load_problem("online_ship")
    run = Experiment(
        "doublet", Doublet("delta", 0.1, pulse_time=8.0), duration=32.0, sample_time=0.1
    )
    rng = np.random.default_rng(0)
    paths = [str(tmp_path / f"{i}.csv") for i in (1, 2)]
    for path in paths:
        write_csv(simulate(problem.model, run, rng=rng), path)
    line = ["reduce", "online_ship", paths[0], "--validate", paths[1], "--known-noise"]
    found = told(tmp_path, line)
    assert found["fixed"] == [one["name"] for one in found["subset"]["parameters"]
                              if one["advice"] == "fix"]  # fmt: skip
    assert found["fixed"]
    fits = {}
    for name in ("nominal", "reduced"):
        model = problem.model if name == "nominal" else problem.model.fix(*found["fixed"])
        data = read_csv(paths[:1], model.channels)
        fits[name] = MultipleShooting(noise="given").fit(model, data)
    lost = 2 * (fits["nominal"].log_likelihood - fits["reduced"].log_likelihood)
    assert found["lost"] == pytest.approx(lost, rel=1e-3, abs=1e-3)
    assert lost < threshold(1, len(found["fixed"]))
