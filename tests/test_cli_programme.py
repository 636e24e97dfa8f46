"""The commands that plan several runs, and decide after each."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from oed_sysid import Experiment, Limits, load_problem, write_csv
from oed_sysid.cli import BAD_INPUT, DONE, main
from oed_sysid.experiments.simulation import simulate


@pytest.fixture(name="ship", scope="module")
def _ship(tmp_path_factory) -> Path:
    """The starter folder."""
    folder = tmp_path_factory.mktemp("cli") / "my_ship"
    assert main(["new", str(folder)]) == DONE
    return folder


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


def test_campaign_goes_on_until_enough_is_known(ship: Path, tmp_path: Path, capsys) -> None:
    """Begun, broken off and resumed, it proposes runs that a hidden ship does, then stops."""
    folder, stored = tmp_path / "trial", tmp_path / "d.json"
    begin = ["campaign", str(folder), "--problem", str(ship), "--goal", "all=3", "--hours", "5"]
    begin += ["--patterns", "zigzag_10_10", "--duration", "90", "--uncertainty", "0.1"]
    assert main([*begin, "--json", str(stored)]) == DONE
    assert json.loads(stored.read_text())["action"] == "go on"
    assert main(begin) == BAD_INPUT
    problem = load_problem(ship)
    truth = problem.model.with_values(
        {p.name: 1.08 * p.value for p in problem.model.free_parameters}
    )
    rng = np.random.default_rng(0)
    actions = []
    for number in range(4):
        journal = json.loads((folder / "journal.json").read_text())
        proposed = next(
            one["experiment"]
            for one in journal["candidates"]
            if one["experiment"]["name"] == journal["proposed"]
        )
        experiment = replace(Experiment.from_dict(proposed), limits=Limits())
        log = tmp_path / f"log_{number}.csv"
        write_csv(simulate(truth, experiment, rng=rng), log)
        arguments = ["campaign", str(folder), "--record", str(log), "--json", str(stored)]
        assert main(arguments) == DONE
        decision = json.loads(stored.read_text())
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
    assert main(["campaign", str(folder), "--json", str(stored)]) == DONE
    assert json.loads(stored.read_text())["action"] == "enough"
    assert main(["campaign", str(folder), "--record", str(log)]) == BAD_INPUT
    assert len(json.loads((folder / "journal.json").read_text())["records"]) == len(actions)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["programme", "{ship}"], "--hours and --runs"),
        (["programme", "{ship}", "--runs", "2", "--sea", "wild"], "Say still"),
        (["programme", "{ship}", "--runs", "2", "--criterion", "Q"], "Choose one of D, A"),
        (["programme", "{ship}", "--runs", "2", "--sensor", "r"], "write NAME=NUMBER"),
        (["campaign", "{folder}"], "Begin one with --problem"),
        (["campaign", "{folder}", "--problem", "{ship}", "--goal", "all=x"], "write NAME=NUMBER"),
    ],
)
def test_what_is_missing_is_named(
    arguments: list[str], words: str, ship: Path, tmp_path: Path, capsys
) -> None:
    """A wrong choice is answered with the right ones."""
    filled = [one.format(ship=ship, folder=tmp_path / "trial") for one in arguments]
    if filled[0] == "programme":
        filled += ["--patterns", "zigzag_10_10", "--duration", "60", "--rounds", "0"]
    assert main(filled) == BAD_INPUT
    assert words in capsys.readouterr().err
