"""One look without adding anything."""

from __future__ import annotations

import json

from oed_sysid import load_problem, read_csv
from oed_sysid.evidence.compare import diagnose
from oed_sysid.experiments.problem import catalogue_folder


def test_the_hidden_effect_of_the_shipped_records_leads() -> None:
    """On the shipped records the heave equation is accused and its cross-flow drag leads."""
    problem = load_problem("remus_diving_plane")
    folder = catalogue_folder() / "remus_diving_plane" / "data"
    records = read_csv(sorted(folder.glob("train_*.csv")), problem.channels)
    found = diagnose(problem.model, records, candidates=problem.effects)
    assert found.best is not None
    assert found.best.name == "heave_crossflow_drag"
    assert found.group == ("heave_crossflow_drag",)
    assert found.location.best == "force Z"
    assert problem.model.effect_names == (problem.model + found.best).effect_names[:-1]
    assert json.loads(json.dumps(found.to_dict()))["ranking"][0]["effect"] == found.best.name
    assert "heave_crossflow_drag" in found.report()
