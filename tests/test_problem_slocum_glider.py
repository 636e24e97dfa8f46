"""The glider's log as described, and the published model recovered from it."""

from __future__ import annotations

import os

import numpy as np
import pytest

from oed_sysid import Dataset, MultipleShooting, Problem, improve, load_problem
from oed_sysid.text.expressions import to_numpy

pytestmark = pytest.mark.skipif("OED_SYSID_DATA" not in os.environ, reason="measured data absent")


@pytest.fixture(scope="module")
def problem() -> Problem:
    """The problem as shipped."""
    return load_problem("slocum_glider")


@pytest.fixture(scope="module")
def split(problem: Problem) -> tuple[Dataset, Dataset]:
    """Three dives to learn from, eight to judge by."""
    data = problem.data()
    return data.split(test=[name for name in data.names if name.startswith("test")])


def test_records_are_dives(split: tuple[Dataset, Dataset]) -> None:
    """Eleven dives, irregular in time, each with a speed at once and on the way down only."""
    train, test = split
    assert (len(train), len(test)) == (3, 8)
    for record in (*train, *test):
        speed, pitch = record.output("speed"), record.input("pitch")
        measured = np.isfinite(speed)
        assert measured[0]
        assert 200 < measured.sum() < 250
        assert np.all(pitch[measured] < 0.01)
        assert np.diff(record.times).max() < 10.0
        assert not record.is_uniform


def test_inertia_at_one_is_the_published_mass(problem: Problem) -> None:
    """Amplitude 1 makes mass and added mass as published, the settling mass included."""
    terms = problem.effect("inertia").terms
    values = {
        "E_inertia": 1.0, "m_g": 70.0, "m_settle": 14.0, "k_along": 0.2, "k_across": 0.98
    }  # fmt: skip
    for theta in (-0.4, 0.0, 0.7):
        scope = {**values, "theta": theta}
        horizontal, vertical, coupled = (
            to_numpy(terms[key], scope) for key in (("X", "u"), ("Z", "w"), ("X", "w"))
        )
        matrix = np.array([[horizontal + 14.0, coupled], [coupled, vertical + 14.0]])
        expected = np.array([70.0 * 1.2, 70.0 * 1.98])
        assert np.linalg.eigvalsh(matrix) == pytest.approx(expected)


def test_published_model_is_recovered(problem: Problem, split: tuple[Dataset, Dataset]) -> None:
    """Drag and mass agree with the literature, and inertia halves the error of speed."""
    train, test = split
    steady = problem.variant("corrected_pitch").model
    moving = (steady + problem.effect("inertia")).with_values({"E_inertia": 1.0})
    before = MultipleShooting(disturbances="none").fit(steady, train)
    after = MultipleShooting(disturbances="none").fit(moving.fix("E_inertia"), train)
    assert before.status.ok
    assert after.status.ok
    assert after.values["C_D0"] == pytest.approx(problem.published["C_D0, dynamic"], abs=0.004)
    assert after.values["m_g"] == pytest.approx(problem.published["m_g, dynamic, kg"], abs=0.02)
    errors = [fit.predict(test).rms["speed"] for fit in (before, after)]
    assert errors[1] < 0.0125
    assert errors[0] > 1.6 * errors[1]


def test_pitch_scale_agrees_with_the_authors(
    problem: Problem, split: tuple[Dataset, Dataset]
) -> None:
    """From the logged pitch the scale comes out as the correction that the authors applied."""
    effects = [problem.effect("inertia"), problem.effect("pitch_scale")]
    fit = MultipleShooting(disturbances="none").fit(problem.model + effects, split[0])
    difference = fit.values["E_pitch_scale"] - (0.86 - 1.0)
    assert abs(difference) < 2 * fit.std_errors["E_pitch_scale"] < 0.05


@pytest.mark.slow
def test_inertia_is_found_first(problem: Problem, split: tuple[Dataset, Dataset]) -> None:
    """Among eleven candidates inertia explains most, and the validation dives agree.

    Disturbance forces that last as long as a dive would explain what inertia does.
    """
    found = improve(
        problem.model, *split, candidates=problem.effects, max_effects=1, disturbances="none"
    )
    assert [step.added for step in found.steps] == ["inertia"]
    assert found.steps[0].test_gain > 0
