"""Errors between records whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import t as student
from turning_ship import SHIP, record

from benchmarks.disjoint import PAGE, simulated
from benchmarks.harness import between

BEGIN, END = "<!-- disjoint: begin -->", "<!-- disjoint: end -->"


@pytest.mark.parametrize("variation", [0.0, 0.15])
def test_simulated_truth(variation: float) -> None:
    """Errors between records hold with one ship and with five, those of the fit less often then."""
    rng = np.random.default_rng(1)
    logs = [record(f"run_{i}", rng) for i in range(5)]
    trial = simulated(SHIP, logs, variation, 25)
    size, between = np.abs(trial.errors), trial.between
    held = np.mean(size < student.ppf(0.975, 4) * between)
    ratio = np.sqrt(np.mean(trial.errors**2 / np.mean(between**2, axis=0)))
    assert held > 0.85
    assert 0.6 < ratio < 1.3
    stated = np.mean(size < 1.96 * trial.stated)
    assert trial.told < 0.2
    if variation:
        assert stated < held
    else:
        assert stated > 0.85
    assert f"{100 * stated:.0f} %" in " ".join(map(str, trial.row("ships")))


def test_the_page_has_the_tables() -> None:
    """The command writes between the marks of the page and nowhere else."""
    page = PAGE.read_text(encoding="utf-8")
    assert page.count(BEGIN) == page.count(END) == 1
    new = between(page, BEGIN, END, ["| new |"])
    assert "| new |" in new
    assert new.partition(BEGIN)[0] == page.partition(BEGIN)[0]
    assert new.partition(END)[2] == page.partition(END)[2]
