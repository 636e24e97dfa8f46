"""What is promised of plans: the oracles that measure it are right themselves."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.plans import best_by_trial, bias_of, described, errors_by_differences
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


def test_a_bias_is_that_of_a_fit() -> None:
    """Of a ship in a zigzag, one parameter fixed ten per cent off after the other."""
    row = bias_of("ship", "online_ship", None, "zigzag_5_5")
    assert len(row["stated"]) > 3
    assert row["stated"] == pytest.approx(row["fitted"], rel=0.2)


def test_weak_and_alike_are_told_apart() -> None:
    """A column of its own that is small is no one else's; one that is nearly a sum is shared."""
    rng = np.random.default_rng(1)
    rows = np.linalg.qr(rng.standard_normal((20, 4)))[0] @ np.diag([50.0, 50.0, 2.0, 0.0])
    rows[:, 3] = rows[:, 0] + rows[:, 1] + 1e-3 * rng.standard_normal(20)
    found = identifiable_subset(
        Information.from_jacobian(tuple("abcd"), rows), dict.fromkeys("abcd", 1.0)
    )
    reasons = {one.split(":")[0] for one in found.reasons}
    assert "These runs hardly depend on c" in reasons
    assert any(one.startswith("These runs hardly separate") for one in reasons)
