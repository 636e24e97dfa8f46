"""The waterfall plot of a multistart."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from oed_sysid import Dataset, Fit, Model, MultipleShooting, Output, Parameter, Record, State
from oed_sysid.errors import DataError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.multistart import Multistart
from oed_sysid.results import plot_waterfall
from oed_sysid.results.estimator_plots import plateaus

OSCILLATOR = Model(
    "oscillator",
    (State("x", "m"), State("v", "m/s")),
    (),
    (Output("x", "m", noise_std=0.02),),
    kinematics={"x": "v", "v": "-omega**2*x"},
    parameters=(Parameter("omega", 0.8, "rad/s", lower=0.5, upper=3.0),),
)


@pytest.fixture(scope="module")
def best() -> Fit:
    """Single shooting from twelve starts: the true valley and side valleys."""
    true = OSCILLATOR.with_values({"omega": 1.3})
    times = np.arange(0.0, 50.0, 0.1)
    run = simulate_inputs(true, times, inputs={}, initial={"x": 1.0})
    noise = 0.02 * np.random.default_rng(0).standard_normal(run.outputs.shape)
    record = Record("free", times, run.inputs, run.outputs + noise, OSCILLATOR.channels)
    single = MultipleShooting(
        interval=np.inf, start="near", noise="given", disturbances="none", coloured="never"
    )
    return Multistart(single, n_starts=12, n_jobs=1).fit(OSCILLATOR, Dataset((record,)))


def test_every_start_is_drawn_and_the_plateau_is_marked(best: Fit) -> None:
    """Points are the sorted objectives; those of the best optimum are as many as arrived."""
    ax = plot_waterfall(best)
    drawn = {line.get_label(): line.get_ydata() for line in ax.lines}
    assert 1 <= len(drawn["the best optimum"]) == best.attempts.arrived < 12
    above = np.sort(best.attempts.objectives) - np.min(best.attempts.objectives)
    marked = [drawn[k] for k in ("the best optimum", "other optima", "did not converge")
              if k in drawn]  # fmt: skip
    assert np.sort(np.concatenate(marked)) == pytest.approx(above)
    assert float(drawn["the model's own values"][0]) == pytest.approx(
        best.attempts.objectives[0] - np.min(best.attempts.objectives)
    )
    assert f"{best.attempts.arrived} of 12 starts" in ax.get_title(loc="left")
    plt.close(ax.figure)


def test_starts_that_diverged_are_counted(best: Fit) -> None:
    """An infinite objective is in the title, not in the picture."""
    objectives = best.attempts.objectives.copy()
    objectives[np.argmax(objectives)] = np.inf
    ax = plot_waterfall(replace(best, attempts=replace(best.attempts, objectives=objectives)))
    assert "1 diverged" in ax.get_title(loc="left")
    assert np.isfinite(ax.get_ylim()).all()
    plt.close(ax.figure)


def test_a_slope_is_no_plateau() -> None:
    """Small steps that add up are told from one optimum found again."""
    assert plateaus(0.015 * np.arange(4)) == [(0, 1), (2, 3)]
    assert plateaus([0.0, np.inf, np.inf]) == [(0, 0)]


def test_one_start_has_no_waterfall(best: Fit) -> None:
    """A plain fit says how to make one with starts."""
    with pytest.raises(DataError, match="Multistart"):
        plot_waterfall(replace(best, attempts=None))
