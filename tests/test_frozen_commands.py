"""Behaviour that stays: keys and types of what every command writes with ``--json``."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import pytest
import typer
from golden_files import check, shape
from test_walks import mapping_of, write_log

from oed_sysid import new_problem
from oed_sysid.cli import main
from oed_sysid.cli.application import app

RUNS = "ship/data/zigzag_10_10.csv ship/data/zigzag_20_20.csv"
JUDGED = f"{RUNS} --validate ship/data/turning_circle.csv"
PLAN = "--patterns zigzag_10_10 --duration 90 --uncertainty 0.1"
LINES = {
    "problems": "problems",
    "problem": "problems ship",
    "check": f"check ship {RUNS}",
    "rank": f"rank ship {RUNS}",
    "rank of experiments": "rank ship --experiment zigzag_10_10",
    "fit": f"fit ship {JUDGED}",
    "compare": f"compare ship {JUDGED} --with rudder_offset",
    "reduce": f"reduce ship {JUDGED} --known-noise",
    "diagnose": f"diagnose ship {RUNS}",
    "improve": f"improve ship {JUDGED} --known-noise",
    "design": "design ship --duration 30",
    "programme": f"programme ship --runs 2 --hours 1 {PLAN} --max-rudder 15 --rounds 0",
    "campaign": f"campaign trial --problem ship --goal all=3 --hours 5 {PLAN}",
    "watch": "watch online_ship --source tanker/zigzag_10_10.csv --silence 0.2",
    "import list": "import trial.ulg --list",
    "import": "import trial.ulg --map ship.toml --problem my_ship --out sea",
    "benchmark estimators": "benchmark estimators --problems online_ship --noise 1 --seeds 1"
    " --estimators output_error --jobs 1 --out bench",
    "benchmark missing-physics": "benchmark missing-physics none/white:1 --jobs 1 --out hidden",
}


@pytest.fixture(name="place", scope="module")
def _place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a starter problem, its records, and a log of its own kind."""
    folder = tmp_path_factory.mktemp("commands")
    new_problem(folder / "ship")
    new_problem(folder / "my_ship", template="ship")
    write_log("ship", folder)
    line = ["simulate", "online_ship", "--out", str(folder / "tanker")]
    assert main([*line, "--experiment", "zigzag_10_10"]) == 0
    (folder / "ship.toml").write_text(mapping_of("ship"))
    return folder


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow if "missing-physics" in n else ()) for n in LINES],
)
def test_json_of(name: str, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Exit status, keys and types of one command."""
    monkeypatch.chdir(place)
    status = main([*shlex.split(LINES[name]), "--json", "told.json"])
    told = shape(json.loads(Path("told.json").read_text(encoding="utf-8")))
    check("commands", name, {"status": status, "told": told})


def test_every_command_with_json_is_frozen() -> None:
    """No command that writes JSON is without its line."""
    commands = typer.main.get_command(app).commands
    commands |= {f"benchmark {n}": one for n, one in commands.pop("benchmark").commands.items()}
    told = {
        name
        for name, one in commands.items()
        if any("--json" in parameter.opts for parameter in one.params)
    }
    frozen = {line.split(" --")[0] for line in LINES.values()}
    assert all(any(line.startswith(name) for line in frozen) for name in told), told
