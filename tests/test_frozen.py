"""Behaviour that stays: fits with process noise, checks, claims, designs, every `--json`."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from golden_cases import (
    SHIPPED,
    SIMULATED,
    diagnosed_diver,
    facts,
    fit_of,
    improved_diver,
    problem,
    records,
)
from golden_files import FILTERED, check, shape
from marks import slow
from plain_pages import plain_pages  # noqa: F401
from test_walks import mapping_of, write_log
from turning_ship import CANDIDATES, SHIP, dataset, improved

import oed_sysid
from benchmarks.spoilt_logs import spoil
from oed_sysid import Dataset, DOptimal, Limits, design_experiment, improve, new_problem
from oed_sysid.cli import main
from oed_sysid.cli.application import app
from oed_sysid.design import Levels, Search, Trial

AUV = "remus_diving_plane"
SPOILT = ("spikes", "fin_sign", "theta_sign", "q_deg", "q_bias", "u_scale", "z_late", "w_lever")


def findings(data: Dataset) -> dict[str, Any]:
    """What the check says of records of the diving vehicle, without its words."""
    found = oed_sysid.check(data, problem(AUV))
    return {
        "suspect": found.suspect,
        "findings": sorted(
            f"{one.name}{'' if one.suspect else ' (note)'}" for one in found.findings
        ),
    }


@pytest.mark.parametrize("name", [*SPOILT[:1], *slow("nothing", *SPOILT[1:])])
def test_findings_of_the_check(name: str) -> None:
    """Kinds and signals of the findings, in good records and in spoilt copies of them."""
    data = records(AUV)
    check("check", name, findings(data if name == "nothing" else spoil(data, name)))


def claim(found: Any) -> dict[str, Any]:
    """What an improvement claims, with the numbers on which it rests."""
    told = found.to_dict()
    return {
        "verdict": found.verdict,
        "explained": bool(found.explained),
        "steps": told["steps"],
        "first_candidates": told["ranking"][:4],
        "base_error": told["base_error"],
        "final_error": told["final_error"],
        "remains": told["remains"]["kind"],
        "parameters": {
            one["name"]: {"value": one["value"], "std_error": one["std_error"]}
            for one in told["parameters"]
        },
    }


@pytest.mark.slow
def test_claim_on_the_shipped_vehicle() -> None:
    """The hidden drag of the diving vehicle; the claims of a turning ship are frozen next."""
    check("improve", AUV, claim(improved_diver()), FILTERED)


@pytest.mark.parametrize(
    ("name", "options"),
    [("cubic damping", {}), ("process noise", {"force": 0.02}), *slow(("nothing missing", {}))],
)
def test_claim_on_a_turning_ship(name: str, options: dict[str, float]) -> None:
    """What a ship lacks whose truth is known."""
    if name == "cubic damping":
        found = improved()
    else:
        found = improve(SHIP, dataset(11, **options), dataset(12, **options), candidates=CANDIDATES)
    check("improve", name, claim(found), FILTERED)


@pytest.mark.slow
def test_diagnosis() -> None:
    """Where the model fails and the ranking of all candidates."""
    found = diagnosed_diver().to_dict()
    found["ranking"] = found["ranking"][:6]
    check("diagnose", AUV, found, FILTERED)


def test_design() -> None:
    """A short design: its commands, its value and the errors that it promises."""
    limits = Limits(
        inputs={"rudder": (-0.35, 0.35)}, rates={"rudder": 0.2}, signals={"psi": (-0.6, 0.6)}
    )
    found = design_experiment(
        SHIP,
        Trial(limits=limits, duration=40.0, sample_time=0.5),
        rng=np.random.default_rng(5),
        criterion=DOptimal(),
        search=Search(family=Levels(n_levels=8), n_starts=1, n_candidates=12, n_steps=6),
        caution=None,
    )
    told = found.to_dict()
    kept = {key: told[key] for key in ("criterion", "parametrisation", "value", "parameters")}
    commands = found.experiment.commands(SHIP.input_names)
    check("design", "turning ship", kept | {"commands": commands[::5].tolist()}, FILTERED)


QUICK = ("kvlcc2",)
# The torpedo's likelihood is flat: its last steps follow the rounding of the compiler's flags.
LATER = ("sailboat", "torpedo")


@pytest.mark.parametrize("name", [*QUICK, *slow(*(one for one in SHIPPED if one not in QUICK))])
def test_shipped_records(name: str) -> None:
    """Process noise is chosen and estimated from shipped records."""
    check("process_noise", name, facts(fit_of(name, disturbances="auto")), FILTERED)


@pytest.mark.parametrize("name", [*(one for one in SIMULATED if one not in LATER), *slow(*LATER)])
def test_disturbed_records(name: str) -> None:
    """Process noise is found where it acts."""
    found = facts(fit_of(name, disturbed=True, disturbances="auto"))
    check("process_noise", name, found, FILTERED)


RUNS = "ship/data/zigzag_10_10.csv ship/data/zigzag_20_20.csv"
JUDGED = f"{RUNS} --validate ship/data/turning_circle.csv"
PLAN = "--patterns zigzag_10_10 --duration 90 --uncertainty 0.1"
LINES = {
    "problems": "problems",
    "problem": "problems ship",
    "new": "new my_boat",
    "simulate": "simulate ship --experiment zigzag_10_10 --out simulated",
    "report": "report fit.json --validate ship/data/turning_circle.csv",
    "export": "export fit.json --as python",
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


# What takes seconds, and is read by the tests of these commands as well.
LONG = ("report", "import", "watch", "benchmark missing-physics")


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
    records = [str(folder / run) for run in RUNS.split()]
    assert main(["fit", str(folder / "ship"), *records, "--save", str(folder / "fit.json")]) == 0
    return folder


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n in LONG else ()) for n in LINES]
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
