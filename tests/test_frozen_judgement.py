"""Behaviour that stays: what the check of logs finds, what `improve` claims, a design."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from golden_cases import diagnosed_diver, improved_diver, problem, records
from golden_files import FILTERED, check
from turning_ship import CANDIDATES, SHIP, dataset, improved

import oed_sysid
from benchmarks.compatibility import spoil
from oed_sysid import Dataset, DOptimal, Limits, design_experiment, improve
from oed_sysid.design import Levels, Search, Trial

AUV = "remus_diving_plane"
SPOILT = ("theta_sign", "q_deg", "spikes", "fin_sign", "q_bias", "u_scale", "z_late", "w_lever")


def findings(data: Dataset) -> dict[str, Any]:
    """What the check says of records of the diving vehicle, without its words."""
    found = oed_sysid.check(data, problem(AUV))
    return {
        "suspect": found.suspect,
        "findings": sorted(
            f"{one.name}{'' if one.suspect else ' (note)'}" for one in found.findings
        ),
    }


@pytest.mark.parametrize("name", ["nothing", *SPOILT])
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


def test_claim_on_the_shipped_vehicle() -> None:
    """The hidden drag of the diving vehicle."""
    check("improve", AUV, claim(improved_diver()), FILTERED)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("cubic damping", {}),
        ("nothing missing", {}),
        ("process noise", {"force": 0.02}),
    ],
)
def test_claim_on_a_turning_ship(name: str, options: dict[str, float]) -> None:
    """What a ship lacks whose truth is known."""
    if name == "cubic damping":
        found = improved()
    else:
        found = improve(SHIP, dataset(11, **options), dataset(12, **options), candidates=CANDIDATES)
    check("improve", name, claim(found), FILTERED)


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
