"""Levels and times as unknowns: steps that leave what the records tell."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid.likelihood.levels import Levels
from oed_sysid.likelihood.noise_model import NoiseModel


def _levels(*, own_times: bool) -> Levels:
    noise = NoiseModel(
        white=np.array([0.1, 0.2]),
        colour=np.array([0.0, 0.3]),
        force=np.array([2.0, 5.0]),
        colour_time=np.array([1.0, 1.0]),
        force_time=np.array([1.0, 0.0]),
        outputs=("u", "q"),
        places=("force Z", "input ds"),
    )
    unit = NoiseModel(
        noise.white, np.ones(2), np.ones(2), np.ones(2), np.ones(2), noise.outputs, noise.places
    )
    return Levels.of(
        noise,
        unit,
        ["disturbance_force_Z", "disturbance_actuator_ds"],
        white=np.array([True, False]),
        colour=np.array([False, True]),
        force=np.array([True, True]),
        own_times=own_times,
    )


@pytest.mark.parametrize("own_times", [False, True])
@pytest.mark.parametrize("power", [1.0, -1.0])
def test_a_step_in_time_alone_keeps_to_the_curve(own_times: bool, power: float) -> None:
    """A force and a coloured sensor keep what their power says; white input noise stays."""
    levels = _levels(own_times=own_times)
    start = levels.vector()
    step = np.zeros(len(levels))
    names = list(levels.names)
    longer = [i for i, name in enumerate(names) if name.endswith("time")]
    step[longer] = 0.7
    # The straight part of that curve, d(sigma^2) = a sigma^2 d(ln tau), is part of the step.
    lasting = [names.index("force Z level"), names.index("colour of q level")]
    step[lasting] = 0.7 * power * start[lasting]
    moved = levels.moved(start, step, np.full(len(levels), power))
    noise, begin = levels.at(moved), levels.noise
    kept = noise.force[0] ** 2 / noise.force_time[0] ** power
    assert kept == pytest.approx(begin.force[0] ** 2 / begin.force_time[0] ** power)
    kept = noise.colour[1] ** 2 / noise.colour_time[1] ** power
    assert kept == pytest.approx(begin.colour[1] ** 2 / begin.colour_time[1] ** power)
    # What is white from step to step has no time.
    assert noise.force[1] == begin.force[1]


def test_small_steps_are_straight_to_second_order() -> None:
    """A step a tenth as long departs from the straight one a hundredth as much."""
    levels = _levels(own_times=False)
    start = levels.vector()
    rng = np.random.default_rng(0)
    step = rng.normal(size=len(levels)) * np.maximum(np.abs(start), 0.1)
    power = rng.uniform(-1.0, 1.0, len(levels))
    away = [
        float(np.abs(levels.moved(start, size * step, power) - (start + size * step)).max())
        for size in (1e-2, 1e-3)
    ]
    assert away[1] < 0.02 * away[0]


def test_what_ends_at_zero_gets_there_in_a_straight_step() -> None:
    """Where nothing of a level is left, the step stays straight; bounds do the rest."""
    levels = _levels(own_times=False)
    start = levels.vector()
    step = np.zeros(len(levels))
    step[0] = -1.5 * start[0]
    moved = levels.moved(start, step, np.ones(len(levels)))
    assert moved[0] == pytest.approx(-0.5 * start[0])


@pytest.mark.parametrize(("slope", "power"), [(1.0, 1.0), (-1.0, -1.0), (9.0, 2.0)])
def test_levels_follow_their_time_as_the_information_says(slope: float, power: float) -> None:
    """Of records that tell only ``sigma^2 tau^-a``, the power is ``a``, within its bounds."""
    levels = _levels(own_times=True)
    start = levels.vector()
    names = list(levels.names)
    level, time = names.index("force Z level"), names.index("force Z time")
    row = np.zeros(len(levels))
    row[level], row[time] = 1.0 / start[level], -slope
    information = np.outer(row, row) + 1e-9 * np.eye(len(levels))
    found = levels.following(information, start)
    assert found[level] == pytest.approx(power, rel=1e-6)
    assert np.count_nonzero(found) == 1
