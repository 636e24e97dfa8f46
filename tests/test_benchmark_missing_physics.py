"""The benchmark of hidden effects: its simulator, its cases and its arithmetic."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from benchmarks.missing_physics.cases import CONDITIONS, Draw, case, draws
from benchmarks.missing_physics.measures import as_markdown, measures
from benchmarks.missing_physics.simulator import (
    PRIORS,
    TEST,
    TRAIN,
    Case,
    Noise,
    simulate,
)
from benchmarks.truth import NOISE

SHARED = Path(os.environ.get("OED_SYSID_DATA", "")) / "hidden_effects"


@pytest.mark.slow
@pytest.mark.skipif(
    not (SHARED / "answers.json").exists(), reason="OED_SYSID_DATA holds no records"
)
def test_simulator_reproduces_records_of_another_simulator() -> None:
    """With the stated truth and the same commands, what is left of 70 records is their noise."""
    answers = json.loads((SHARED / "answers.json").read_text())
    cases = [Case(a["case"], a["true_parameters"], a["hidden_effects"]) for a in answers]
    manoeuvres = (*TRAIN, *TEST)
    data = np.array(
        [
            [
                np.loadtxt(SHARED / c.name / f"{m.name}.csv", delimiter=",", skiprows=1)
                for c in cases
            ]
            for m in manoeuvres
        ]
    )
    replayed = simulate(cases, manoeuvres, commands=data[..., 1:3])
    free = simulate(cases, manoeuvres)
    same = 0
    for rows, records, own in zip(data, replayed, free, strict=True):
        size = np.sqrt(np.mean(((rows[..., 3:] - records.clean) / NOISE) ** 2, axis=1))
        # A fin lag is integrated a little differently there, which shows as a tenth in pitch.
        assert size.max() < 1.15
        assert abs(size.mean() - 1.0) < 0.02
        # The last command acts on nothing.
        gap = np.abs(own.inputs - rows[..., 1:3])[:, :-1].max(axis=(1, 2))
        same += int(np.sum(gap < 1e-5))
    # A relay that sees the same pitch reverses at the same samples, but for ties in rounding.
    assert same > 0.9 * data.shape[0] * data.shape[1]


def test_noise_is_what_was_asked_for_and_differs_between_records() -> None:
    """Size, colour and independence of sensor noise, over records and cases."""
    cases = [Case(f"{i}", PRIORS, noise=Noise(colour=0.5), seed=i) for i in range(6)]
    records = simulate(cases, TRAIN)
    noise = np.stack([r.outputs - r.clean for r in records]) / NOISE
    assert np.std(noise) == pytest.approx(1.0, abs=0.02)
    assert np.mean(noise[:, :, 1:] * noise[:, :, :-1]) == pytest.approx(0.5, abs=0.02)
    rows = noise.reshape(len(TRAIN) * len(cases), -1)
    between = np.corrcoef(rows) - np.eye(len(rows))
    assert np.abs(between).max() < 0.12


def test_cases_can_be_drawn_again() -> None:
    """A case follows from its name alone, and every effect has its turn."""
    draw = Draw("pair", "white", 17)
    assert case(draw) == case(draw)
    assert case(draw) != case(draw, attempt=1)
    hidden = {name for d in draws("single/white:40") for name in case(d).effects}
    assert len(hidden) == 40
    mixed = [draw.key for draw in draws("none/white:4 pair/white:2")]
    assert mixed[:3] == ["none/white/0", "pair/white/0", "none/white/1"]
    assert case(Draw("none", "gust_mid", 0)).noise == CONDITIONS["gust_mid"]
    with pytest.raises(ValueError, match="Unknown kind"):
        draws("single/green:3")


def entry(key: str, hidden: list[str], added: list[str], **changes: object) -> dict:
    """A finished case."""
    kind, condition, _ = key.split("/")
    step = {"evidence": 30.0, "needed": 10.0, "test_gain": 5.0}
    return {
        "key": key,
        "hidden": kind,
        "condition": condition,
        "effects": dict.fromkeys(hidden, 1.0),
        "steps": [{"added": n, "equation": "M", "group": [n], **step} for n in added],
        "order": added,
        "rejected": [],
        "detectable": True,
        "true_gains": dict.fromkeys(hidden, 25.0),
        "final_error": {"train": 1.0, "test": 1.0},
        "true_test_error": 1.0,
        "processor_seconds": 4.0,
    } | changes


def test_measures_count_what_they_say() -> None:
    """Rates from cases whose outcome is known by construction."""
    entries = [
        entry("single/white/0", ["a"], ["a"]),
        entry("single/white/1", ["a"], ["b"]),
        entry("single/white/2", ["b"], [], detectable=False),
        entry("none/white/0", [], []),
        entry("none/white/1", [], ["a"]),
        entry("pair/white/0", ["a", "b"], ["b", "a"]),
        entry("unknown/white/0", ["unknown_cubic_pitch_damping"], ["term_M_qqq"]),
        entry("unknown/white/1", ["unknown_cubic_drag"], ["term_M_qqq"]),
        {"key": "single/white/3", "hidden": "single", "condition": "white", "error": "broken"},
    ]
    found = measures(entries)
    rates = {rate["name"]: rate for rate in found["rates"]}
    first = rates["single, detectable: right effect first"]
    assert (first["value"], first["count"]) == (0.5, 2)
    assert first["low"] < 0.5 < first["high"]
    assert rates["nothing hidden: false claims"]["value"] == 0.5
    assert rates["two, both detectable: both found"]["value"] == 1.0
    assert rates["unknown effect: only the right equation is changed"]["value"] == 0.5
    assert [failure["case"] for failure in found["failures"]] == ["single/white/1", "none/white/1"]
    assert found["broken"] == [{"case": "single/white/3", "error": "broken"}]
    assert "single/white/1" in as_markdown(found)
