"""The cascaded tanks: saturated samples, overflow and what the README claims."""

from __future__ import annotations

import os

import numpy as np
import pytest

from oed_sysid import Dataset, Problem, compare, improve, load_problem
from oed_sysid.text.expressions import to_numpy

pytestmark = pytest.mark.skipif("OED_SYSID_DATA" not in os.environ, reason="measured data absent")


@pytest.fixture(scope="module")
def problem() -> Problem:
    """The problem as shipped."""
    return load_problem("cascaded_tanks")


@pytest.fixture(scope="module")
def split(problem: Problem) -> tuple[Dataset, Dataset]:
    """First and second half."""
    return problem.data().split(test="test_second_half")


def test_saturated_readings_are_missing(split: tuple[Dataset, Dataset]) -> None:
    """No reading at the end of the range is taken for a level, and each half has such ones."""
    for half in split:
        level = half[0].output("level")
        assert half[0].n_samples == 512
        assert 10 < np.isnan(level).sum() < 40
        assert np.nanmax(level) < 10.0


def test_gravity_outflow_leads_from_linear_to_square_root(problem: Problem) -> None:
    """With amplitude 1 the lower tank's balance is that of square-root outflows."""
    effect = problem.effect("gravity_outflow")
    scope = {**problem.model.values, "E_gravity": 1.0, "upper": 7.0, "lower": 2.0}
    scope |= {"drain_upper": 0.3, "drain_lower": 0.2}
    linear = 0.3 * 7.0 - 0.2 * 2.0
    root = 0.3 * np.sqrt(5.0 * 7.0) - 0.2 * np.sqrt(5.0 * 2.0)
    assert linear + to_numpy(effect.terms["lower"], scope) == pytest.approx(root)
    inside = {**scope, "E_gravity": 0.0}
    assert to_numpy(effect.terms["lower"], inside) == 0.0


@pytest.mark.slow
def test_the_error_falls_and_what_is_left_is_called_structure(
    problem: Problem, split: tuple[Dataset, Dataset]
) -> None:
    """One level hardly separates the candidates: the error falls, nothing is called complete."""
    train, test = split
    found = improve(problem.model, train, test, candidates=problem.effects)
    names = [step.added for step in found.steps]
    assert "upper_overflow" in names
    assert len(set(names)) == len(names)
    assert found.remains.kind == "structure missing"
    check = compare({"before": found.base, "after": found.model}, test)
    before, after = (part.prediction.rms["level"] for part in check.models)
    assert after < 0.4 * before
