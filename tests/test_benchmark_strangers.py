"""The frozen exam: its SciPy truth against the package's simulation, and its scores."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from marks import slow

from benchmarks import strangers
from oed_sysid import Dataset, improve, simulate_inputs


@pytest.mark.parametrize("kind", [strangers.KINDS[0], *slow(*strangers.KINDS[1:])])
def test_a_candidate_is_what_is_hidden(kind: str) -> None:
    """The nominal model with the candidate at the hidden size runs as SciPy's truth does."""
    truth = strangers.Stranger.drawn(np.random.default_rng(4))
    values, excitation = truth.estimated(), strangers.EXCITATIONS[len(kind) % 2]
    inputs, plain = truth.run(excitation, 7, {}, values)
    level = plain.std(axis=0)
    key, effect = next(
        (k, e) for k, e in strangers.candidates(truth, level).items() if k[0] == kind
    )
    size = effect.parameters[0].magnitude * (-1.0 if kind == "quadratic" else 1.0)
    inputs, hidden = truth.run(excitation, 7, {key: size}, values)
    model = strangers.nominal(truth, values, np.ones(len(level))) + effect
    model = model.with_values({effect.parameters[0].name: size})
    run = simulate_inputs(
        model, truth.times, inputs=inputs, initial=dict.fromkeys(model.state_names, 0.0)
    )
    assert np.max(np.abs(hidden - plain) / level) > 0.02
    assert np.max(np.abs(run.outputs - hidden) / level) < 0.01


@pytest.mark.slow
def test_what_a_sea_hides_counts_as_hidden() -> None:
    """Rows that a sea makes are white in the unit that an effect is measured in; calm, in sensors.

    An effect is worth less at sea than the sensors alone would say.
    """
    rng = np.random.default_rng(21)
    truth = strangers.Stranger.drawn(rng)
    assert (truth.spring > 0).tolist() == [False, True]  # both kinds of equation, and no more
    values, none = truth.estimated(), np.zeros(len(truth.gain))
    calm = replace(truth, coupling=none)
    level = 0.02 * calm.run("steps", 1, {}, values)[1].std(axis=0)
    still = {key: 0.0 for key in values if key[0] == "b"}
    made = [calm.run("sea", seed, {}, values | still, exact=False)[1] for seed in range(8)]
    rows = np.stack(made, axis=-1) + level[:, None] * rng.standard_normal((*made[0].shape, 8))
    assert np.std(rows / level[:, None]) > 3.0
    white = strangers.whitened(calm, rows, level, sea=True)
    assert np.std(white) == pytest.approx(1.0, abs=0.03)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.03
    np.testing.assert_allclose(
        strangers.whitened(calm, rows, level, sea=False) * level[:, None], rows
    )
    hidden = {("offset", 0): 0.05}
    seen = {e: strangers.shown(calm, [(e, 5)], hidden, level) for e in ("steps", "sea")}
    assert 1.0 < seen["sea"] < 0.3 * seen["steps"]
    assert strangers.shown(calm, [("sea", 5)], {}, level) == np.inf


def test_the_page_has_the_rates_of_the_store() -> None:
    """Those of the last date by excitation, those of the others together, are of stored cases."""
    stored = [json.loads(line) for line in strangers.STORE.read_text("utf-8").splitlines()]
    last = max(row["seed"] for row in stored)
    page = (Path(__file__).parents[1] / "docs" / "diagnosis.md").read_text("utf-8")
    assert f"--seed {last} --cases {sum(row['seed'] == last for row in stored)}" in page
    assert strangers.table([row for row in stored if row["seed"] == last]) in page
    assert strangers.dates([row for row in stored if row["seed"] != last]) in page


@pytest.mark.slow
def test_a_lag_that_nobody_named_is_found_among_the_usual_effects() -> None:
    """Without it noise of the input would stand in the place of every force."""
    entry, model, (*train, last), offered = strangers.drawn(20261129, 13)
    found = improve(model, Dataset(train), Dataset((last,)), candidates=offered)
    (lag,), (true,) = (step.effect for step in found.steps), entry["sizes"].values()
    assert found.fit.values[lag.parameters[0].name] == pytest.approx(true, rel=0.1)
    assert found.remains.kind == "adequate"
