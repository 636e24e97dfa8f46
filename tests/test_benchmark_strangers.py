"""The frozen exam: its SciPy truth against the package's simulation, and its scores."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from marks import slow

from benchmarks.strangers import (
    EXCITATIONS,
    KINDS,
    STORE,
    Stranger,
    accepted,
    candidates,
    nominal,
    table,
)
from oed_sysid.experiments.simulation import simulate_inputs


@pytest.mark.parametrize("kind", [KINDS[0], *slow(*KINDS[1:])])
def test_a_candidate_is_what_is_hidden(kind: str) -> None:
    """The nominal model with the candidate at the hidden size runs as SciPy's truth does."""
    truth = Stranger.drawn(np.random.default_rng(4))
    values, excitation = truth.estimated(), EXCITATIONS[len(kind) % 2]
    inputs, plain = truth.run(excitation, 7, {}, values)
    level = plain.std(axis=0)
    key, effect = next((k, e) for k, e in candidates(truth, level).items() if k[0] == kind)
    size = effect.parameters[0].magnitude * (-1.0 if kind == "quadratic" else 1.0)
    inputs, hidden = truth.run(excitation, 7, {key: size}, values)
    model = nominal(truth, values, np.ones(len(level))) + effect
    model = model.with_values({effect.parameters[0].name: size})
    run = simulate_inputs(
        model,
        truth.times,
        inputs=inputs,
        initial=dict.fromkeys(model.state_names, 0.0),
    )
    assert np.max(np.abs(hidden - plain) / level) > 0.02
    assert np.max(np.abs(run.outputs - hidden) / level) < 0.01


def test_all_and_nothing_else_is_accepted() -> None:
    """Groups count for one effect; one claim too many, or too few, is not accepted."""
    row: dict[str, list] = {"effects": ["a", "b"], "steps": []}
    row["steps"] = [{"added": "c", "group": ["c", "b"]}, {"added": "a", "group": ["a"]}]
    assert accepted(row)
    assert not accepted({**row, "effects": ["a"]})
    assert not accepted({**row, "steps": row["steps"][:1]})
    assert accepted({"effects": [], "steps": []})


@pytest.mark.parametrize(("seed", "cases"), [(20261126, 111), (20261127, 73), (20261128, 120)])
def test_the_page_has_the_rates_of_the_store(seed: int, cases: int) -> None:
    """Every rate of the page is that of the stored cases of its seed."""
    stored = [json.loads(line) for line in STORE.read_text("utf-8").splitlines()]
    rows = [row for row in stored if row["seed"] == seed]
    assert len(rows) == cases
    page = Path(__file__).parents[1] / "docs" / "diagnosis.md"
    assert table(rows) in page.read_text("utf-8")
