"""Pictures of records, and the report on what experiments tell."""

from __future__ import annotations

import numpy as np

from oed_sysid import load_problem, rank_parameters
from oed_sysid.data.dataset import Record
from oed_sysid.results import figure_record, ranking_page, style_sheet
from oed_sysid.runtime.display import share


def test_record_is_drawn_in_degrees_without_what_was_not_measured() -> None:
    """Every signal has an axis, angles are in degrees, a missing output has none."""
    problem = load_problem("remus_diving_plane")
    record = problem.data()[0]
    outputs = np.array(record.outputs)
    outputs[:, 1] = np.nan
    bare = Record(
        "run", record.times, record.inputs, outputs, record.channels, missing_outputs=("w",)
    )
    shown = [ax for ax in figure_record(bare).axes if ax.get_visible()]
    assert len(shown) == len(problem.model.inputs) + len(problem.model.outputs) - 1
    pitch = next(ax for ax in shown if "pitch angle" in ax.get_ylabel())
    assert "[deg]" in pitch.get_ylabel()
    np.testing.assert_allclose(pitch.lines[0].get_ydata(), np.degrees(record.output("theta")))
    assert sum("time" in ax.get_xlabel() for ax in shown) == 2


def test_ranking_page_states_the_worst_parameter() -> None:
    """Numbers of the page are those of the ranking, and its parts hold them."""
    problem = load_problem("remus_diving_plane")
    runs = [problem.experiment("steps")]
    ranking = rank_parameters(problem.model, runs)
    page = ranking_page(ranking)
    worst = ranking.rows[-1]
    assert (f"std. error, worst: {worst.name}", share(worst.error)) in page.numbers
    assert share(worst.error) in page.summary_html()
    assert worst.name in page.sections[0].html()
    assert page.drawn().sections[0].html().strip() in page.html()
    assert ".verdict" in style_sheet()
