"""The ten hidden effects of the vehicle with six degrees of freedom."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.other_vehicles import ten
from benchmarks.other_vehicles.cases import draws, single_effect
from benchmarks.speed import six_degrees_task


@pytest.mark.slow
def test_ten_different_effects_are_detectable() -> None:
    """The ten cases hide ten effects, each visible to a filter that knows the truth."""
    said: list[str] = []
    hiding, empty = ten.chosen(tell=said.append)
    cases = {draw.number: draw for draw in draws([ten.VEHICLE], ten.MOST)}
    assert len({single_effect(cases[number]) for number in hiding}) == ten.COUNT
    assert all(cases[number].hidden == "none" for number in empty)
    assert all(int(line.split()[-1]) >= 36 for line in said)


def test_problem_of_the_times_has_its_size() -> None:
    """Twelve states, twenty-five free parameters and 36,030 samples."""
    model, train, _ = six_degrees_task()
    assert (len(model.state_names), len(model.free_names)) == (12, 25)
    assert sum(record.outputs.size for record in train) == 36030
