"""The measured roll decay: the data as described, and the conclusions its README draws."""

from __future__ import annotations

import os

import numpy as np
import pytest

from oed_sysid import Dataset, MultipleShooting, Problem, load_problem

pytestmark = pytest.mark.skipif("OED_SYSID_DATA" not in os.environ, reason="measured data absent")


@pytest.fixture(scope="module")
def problem() -> Problem:
    """The problem as shipped."""
    return load_problem("roll_decay")


@pytest.fixture(scope="module")
def split(problem: Problem) -> tuple[Dataset, Dataset]:
    """Training and test part of the one decay."""
    return problem.data().split(test="test_small")


def test_record_begins_after_the_release(split: tuple[Dataset, Dataset]) -> None:
    """Crests fall from the first sample on, and no sample belongs to both parts."""
    train, test = split
    phi = np.degrees(train[0].output("phi"))
    crests = [phi[i] for i in range(1, len(phi) - 1) if phi[i - 1] < phi[i] >= phi[i + 1]]
    assert 9.0 < max(crests) < 9.5
    assert np.all(np.diff(crests) <= 0.02)
    assert abs(np.degrees(test[0].outputs)).max() < 4.7


def test_hydrostatics_give_a_credible_inertia(
    problem: Problem, split: tuple[Dataset, Dataset]
) -> None:
    """The radius of gyration, added inertia included, is 0.35 to 0.50 of the beam."""
    fit = MultipleShooting(disturbances="none").fit(problem.model, split[0])
    mass, beam = 312653.0 / 68.0**3 * 1000.0, 58.0 / 68.0
    assert 0.35 < np.sqrt(fit.values["I_xx"] / mass) / beam < 0.50


def test_quadratic_damping_as_published(problem: Problem, split: tuple[Dataset, Dataset]) -> None:
    """With linear stiffness the coefficient is the literature's 0.117 1/rad, within its error."""
    fit = MultipleShooting(disturbances="none").fit(
        problem.model + problem.effect("roll_quadratic_damping"), split[0]
    )
    name = "E_roll_quadratic_damping"
    published = -problem.published["quadratic damping over inertia, 1/rad, 0 kn"]
    inertia = fit.values["I_xx"]
    assert abs(fit.values[name] / inertia - published) < 2 * fit.std_errors[name] / inertia
