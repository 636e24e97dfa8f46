"""What is promised of plans: the oracles that measure it are right themselves."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.plans import best_by_trial, described, errors_by_differences
from oed_sysid.information import identifiable_subset, information_of
from oed_sysid.information.identifiability import ASSUMED, COLLINEARITY_LIMIT
from oed_sysid.likelihood.information import Information


@pytest.mark.parametrize("seed", range(4))
def test_sets_are_those_of_all_sets(seed: int) -> None:
    """Nearly dependent columns: size and collinearity of the best of all sets."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((30, 7)) @ np.diag([9, 5, 3, 1, 30, 12, 2.0])
    rows[:, 5] = rows[:, 4] + 0.2 * rows[:, 5]
    rows[:, 6] = rows[:, :2].sum(axis=1) + 1e-3 * rows[:, 6]
    names = tuple("abcdefg")
    found = identifiable_subset(Information.from_jacobian(names, rows), dict.fromkeys(names, 1.0))
    size, index = best_by_trial(rows.T @ rows, ASSUMED, COLLINEARITY_LIMIT)
    assert found.size == size < 7
    assert found.collinearity == pytest.approx(index)


def test_errors_are_those_of_differences() -> None:
    """The errors of the set of a ship, the others fixed, by differences of simulations."""
    model, runs = described("online_ship", None, "zigzag_5_5")
    information = information_of(model, runs, priors=None)
    values = {name: model.values[name] for name in information.names}
    own = [place for place in identifiable_subset(information, values).places if place.free]
    found = errors_by_differences(model, runs, [place.name for place in own])
    stated = [place.error * abs(values[place.name]) for place in own]
    assert found == pytest.approx(stated, rel=1e-4)
