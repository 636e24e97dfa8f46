"""The Silverbox: input between samples, and the hardening spring."""

from __future__ import annotations

import os

import numpy as np
import pytest

from oed_sysid import Dataset, Fit, Model, MultipleShooting, Problem, Record, load_problem
from oed_sysid.evidence.rank import rank
from oed_sysid.evidence.study import Study

pytestmark = pytest.mark.skipif("OED_SYSID_DATA" not in os.environ, reason="measured data absent")

ESTIMATOR = MultipleShooting(disturbances="none")
FINER = 4  # input values per measured output


@pytest.fixture(scope="module")
def problem() -> Problem:
    """The problem as shipped."""
    return load_problem("silverbox")


@pytest.fixture(scope="module")
def split(problem: Problem) -> tuple[Dataset, Dataset]:
    """Two realisations."""
    return problem.data().split(test="test_third_realisation")


def _error(fit: Fit, test: Dataset) -> float:
    """Error on validation samples in mV."""
    return 1e3 * fit.predict(test).rms["y"]


def test_finer_input_passes_through_the_samples(split: tuple[Dataset, Dataset]) -> None:
    """Interpolated input has no power beyond 200 Hz, where the measured one has none either."""
    record = split[0][0]
    u = record.input("u")[: FINER * 1024] * np.hanning(FINER * 1024)
    power = np.abs(np.fft.rfft(u)) ** 2
    frequency = np.fft.rfftfreq(len(u), record.sample_time)
    assert power[frequency > 210.0].sum() < 1e-4 * power.sum()
    assert record.sample_time == pytest.approx(1.0 / (FINER * 610.3515625))
    assert np.isfinite(record.output("y")).sum() == 1500


@pytest.fixture(scope="module")
def cubic(problem: Problem) -> Model:
    """The model with cubic stiffness and an offset."""
    missing = [problem.effect("cubic_stiffness"), problem.effect("constant_force")]
    return problem.model + missing


@pytest.fixture(scope="module")
def better(cubic: Model, split: tuple[Dataset, Dataset]) -> Fit:
    """Its fit."""
    return ESTIMATOR.fit(cubic, split[0])


def test_hardening_spring_and_offset(
    problem: Problem, split: tuple[Dataset, Dataset], better: Fit
) -> None:
    """Cubic stiffness and an offset bring another realisation from 9 to below 0.4 mV."""
    train, test = split
    assert _error(ESTIMATOR.fit(problem.model, train), test) > 8.0
    assert _error(better, test) < 0.4
    assert better.values["E_cubic_stiffness"] > 100 * better.std_errors["E_cubic_stiffness"]


def test_coarse_input_costs_accuracy(
    cubic: Model, split: tuple[Dataset, Dataset], better: Fit
) -> None:
    """With straight lines between the measured inputs the same model errs twice as much."""
    rough = []
    for data in split:
        r = data[0]
        parts = (one[::FINER] for one in (r.times, r.inputs, r.outputs))
        rough.append(Dataset((Record(r.name, *parts, r.channels),)))
    rough_error = _error(ESTIMATOR.fit(cubic, rough[0]), rough[1])
    assert rough_error > 2.0 * _error(better, split[1])


def test_cubic_stiffness_ranks_first(problem: Problem, split: tuple[Dataset, Dataset]) -> None:
    """Among springs, dampers, offsets and a lag the cubic spring explains most."""
    study, fit = Study.begin(problem.model, split[0], None, problem.effects, known_noise=False)
    assert rank(study, fit, study.candidates).refits[0].name == "cubic_stiffness"
