"""What a search reads: a part kept for validation, and fewer samples of very long logs."""

from __future__ import annotations

import numpy as np
import pytest
from turning_ship import CANDIDATES, CUBIC, SHIP, dataset

from oed_sysid import Dataset, Record
from oed_sysid.evidence.improve import improve
from oed_sysid.evidence.preparation import coarser, prepared
from oed_sysid.experiments.simulation import simulate_inputs


def long_dive(n_samples: int, step: float, *, noise: float, period: float = 20.0) -> Record:
    """A ship that steers to and fro by the clock, with cubic damping, sampled fast."""
    truth = (SHIP + CUBIC).with_values({"K": 0.5, "T": 4.0, "n3": -15.0})
    times = step * np.arange(n_samples)
    rudder = 0.5 * np.sign(np.sin(2 * np.pi * times / period))
    run = simulate_inputs(truth, times, inputs={"rudder": rudder})
    random = np.random.default_rng(3).standard_normal(run.outputs.shape)
    scale = noise * np.array([0.01, 0.004])
    return Record("dive", times, run.inputs, run.outputs + random * scale, SHIP.channels)


def test_of_a_single_record_the_end_is_kept_for_validation() -> None:
    """Every sample is on one side, in order, and the words name the time of the cut."""
    record = dataset(1)[0]
    ready = prepared(Dataset((record,)), None)
    assert ready.validation is not None
    times = [*ready.train[0].times, *ready.validation[0].times]
    assert times == list(record.times)
    assert ready.train.n_samples == pytest.approx(0.6 * record.n_samples, abs=1)
    assert f"{ready.validation[0].times[0]:.4g} s" in ready.notes[0]


def test_several_records_and_short_ones_stay_as_they_are() -> None:
    """Nobody's choice of records is changed, and nothing is cut from what is short."""
    several = dataset(1)
    assert prepared(several, None).validation is None
    short = Dataset((several[0].window(0.0, 30.0),))
    assert prepared(short, None).train is short


def test_mean_inputs_keep_the_trajectory() -> None:
    """With fewer samples of the inputs the ship moves as it did, unlike with every fifth one."""
    record = long_dive(3000, 0.02, noise=0.0, period=7.3)
    few = coarser(record, 5)
    truth = (SHIP + CUBIC).with_values({"K": 0.5, "T": 4.0, "n3": -15.0})
    errors = []
    for inputs in (few.inputs, record.thin(5).inputs):
        run = simulate_inputs(truth, few.times, inputs={"rudder": inputs[:, 0]})
        errors.append(np.abs(run.outputs - few.outputs).max(axis=0))
    assert np.all(errors[0] < 0.2 * errors[1])


def test_stride_is_bounded_by_what_the_signal_does() -> None:
    """A log without noise that bends within a few samples is read more finely than a calm one."""
    calm = prepared(Dataset((long_dive(3000, 0.02, noise=1.0),)), None, enough=100)
    quick = long_dive(3000, 0.4, noise=0.001, period=5.0)
    fine = prepared(Dataset((quick,)), None, enough=100)
    assert calm.train[0].sample_time == pytest.approx(0.02 * 30)
    assert fine.train[0].sample_time < 4 * 0.4


def test_a_long_log_is_searched_in_fewer_samples_and_the_effect_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The hidden damping comes out of a thinned log with its value, and the result says so."""
    monkeypatch.setattr(prepared, "__kwdefaults__", {"enough": 1500})
    log = Dataset((long_dive(6000, 0.05, noise=1.0),))
    found = improve(SHIP, log, candidates=CANDIDATES)
    assert [step.added for step in found.steps] == ["cubic_damping"]
    row = next(row for row in found.parameters if row["name"] == "n3")
    assert abs(row["value"] + 15.0) < 4 * row["std_error"]
    assert found.fit.dataset.n_samples == 900
    assert len(found.notes) >= 2
