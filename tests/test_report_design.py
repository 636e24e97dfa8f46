"""Figures of rankings and designs show what the results say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_design import ship
from test_sensitivity import oscillator, roll_test

from oed_sysid import Limits
from oed_sysid.design import Levels, Search, Trial, design_experiment
from oed_sysid.information import rank_parameters
from oed_sysid.results import figure_design, plot_accuracy, plot_sensitivity


def test_sensitivity_plot_has_a_row_for_each_parameter() -> None:
    """Rows are the parameters, best on top, at their errors."""
    ranking = rank_parameters(oscillator(), roll_test())
    ax = plot_sensitivity(ranking)
    assert len(ax.get_yticklabels()) == len(ranking.rows)
    dots = [line.get_xdata()[0] for line in ax.lines if line.get_label() == "estimated together"]
    np.testing.assert_allclose(dots, [min(r.error, dots[i]) for i, r in
                                      enumerate(ranking.rows)])  # fmt: skip
    assert dots[0] == pytest.approx(ranking.rows[0].error)


def test_design_figure_draws_commands_limits_and_errors(tmp_path: Path) -> None:
    """The figure can be written, and the accuracy shown is the design's."""
    limits = Limits(inputs={"rudder": (-0.35, 0.35)}, signals={"psi": (-0.6, 0.6)})
    design = design_experiment(
        ship(),
        Trial(limits=limits, duration=30.0, sample_time=0.5),
        rng=np.random.default_rng(0),
        search=Search(family=Levels(8), n_starts=1, n_candidates=5, n_steps=3, n_workers=1),
    )
    figure = figure_design(design)
    figure.savefig(tmp_path / "design.png")
    assert (tmp_path / "design.png").stat().st_size > 10_000
    (ours,) = [line for line in plot_accuracy(design).lines if line.get_label() == "designed"]
    np.testing.assert_allclose(np.sort(ours.get_xdata()), np.sort(design.relative_errors))
