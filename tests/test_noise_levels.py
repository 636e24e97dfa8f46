"""Levels and times as unknowns: steps that leave what the records tell."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid.noise.levels import Levels
from oed_sysid.noise.model import NoiseModel


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
def test_a_step_in_time_alone_keeps_to_the_curve_of_equal_intensity(own_times: bool) -> None:
    """Both a force and a coloured sensor keep their intensity; white input noise stays."""
    levels = _levels(own_times=own_times)
    start = levels.vector()
    step = np.zeros(len(levels))
    names = [levels.name_of(*entry) for entry in levels.entries]
    longer = [i for i, name in enumerate(names) if name.endswith("time")]
    step[longer] = 0.7
    # The straight part of that curve, d(sigma^2) = sigma^2 d(ln tau), is part of the step.
    lasting = [names.index("force Z level"), names.index("colour of q level")]
    step[lasting] = 0.7 * start[lasting]
    noise, begin = levels.at(levels.moved(start, step)), levels.noise
    intensity = noise.force[0] ** 2 / noise.force_time[0]
    assert intensity == pytest.approx(begin.force[0] ** 2 / begin.force_time[0])
    intensity = noise.colour[1] ** 2 / noise.colour_time[1]
    assert intensity == pytest.approx(begin.colour[1] ** 2 / begin.colour_time[1])
    # What is white from step to step has no time.
    assert noise.force[1] == begin.force[1]


def test_small_steps_are_straight_to_second_order() -> None:
    """A step a tenth as long departs from the straight one a hundredth as much."""
    levels = _levels(own_times=False)
    start = levels.vector()
    step = np.random.default_rng(0).normal(size=len(levels)) * np.maximum(np.abs(start), 0.1)
    away = [
        float(np.abs(levels.moved(start, size * step) - (start + size * step)).max())
        for size in (1e-2, 1e-3)
    ]
    assert away[1] < 0.02 * away[0]


def test_what_ends_at_zero_gets_there_in_a_straight_step() -> None:
    """Where no intensity is left, the step stays straight; bounds do the rest."""
    levels = _levels(own_times=False)
    start = levels.vector()
    step = np.zeros(len(levels))
    step[0] = -1.5 * start[0]
    assert levels.moved(start, step)[0] == pytest.approx(-0.5 * start[0])
