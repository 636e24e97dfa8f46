"""Pictures and reports of a comparison and of a search for missing physics."""

from __future__ import annotations

import re

import matplotlib as mpl
import matplotlib.pyplot
import numpy as np
import pytest

mpl.use("Agg")

from oed_sysid import Dataset, MultipleShooting, load_problem, new_problem
from oed_sysid import results as report
from oed_sysid.errors import DataError
from oed_sysid.evidence.compare import Comparison, compare
from oed_sysid.evidence.improve import improve
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.runtime.display import told

HIDDEN = "yaw_quadratic_damping"


@pytest.fixture(name="story", scope="module")
def _story(tmp_path_factory) -> tuple[Improvement, Comparison, Dataset]:
    """The starter problem improved, compared on its circle, with its training records."""
    problem = load_problem(new_problem(tmp_path_factory.mktemp("report") / "my_ship"))
    train, test = problem.data().split(test=["turning_circle"])
    found = improve(problem.model, train, test, candidates=problem.effects, known_noise=True)
    fits = {
        "nominal": MultipleShooting().fit(problem.model, train),
        "improved": MultipleShooting().fit(found.model, train),
    }
    return found, compare(fits, test), train


@pytest.fixture(autouse=True)
def _close_figures():
    """Leave no figure behind."""
    yield
    mpl.pyplot.close("all")


def test_ranking_plot_shows_gains_in_order(story) -> None:
    """The bars are the gains after refits, the hidden effect's is the longest and on top."""
    ranking = story[0].ranking
    ax = report.plot_ranking(ranking)
    names = [text.get_text() for text in ax.get_yticklabels()]
    assert names[0] == HIDDEN.replace("_", " ")
    widths = sorted((bar.get_width() for bar in ax.patches), reverse=True)
    gains = sorted((max(refit.gain, 0.0) for refit in ranking.refits), reverse=True)
    np.testing.assert_allclose(widths, gains)


def test_located_plot_shows_the_gains(story) -> None:
    """One bar per place, as long as it is behind the best; the last is no disturbance at all."""
    located = story[0].location
    ax = report.plot_located(located, n_shown=3)
    widths = [bar.get_width() for group in ax.containers for bar in group]
    gains = [located.gains[place.name] for place in located.places[:3]]
    best = max(*located.gains.values(), 0.0)
    np.testing.assert_allclose(widths, [*(best - np.array(gains)), best])
    assert min(widths) == 0.0
    assert report.finding(ax) == located.verdict


def test_error_plot_falls_to_one(story) -> None:
    """The errors on the validation records are drawn from the nominal model to the last step."""
    found = story[0]
    ax = report.plot_error_fall(found)
    (line,) = [one for one in ax.get_lines() if one.get_label() == "validation records"]
    expected = [found.base_error["test"], *(step.test_error for step in found.steps)]
    np.testing.assert_allclose(line.get_ydata(), expected)
    assert ax.get_xticklabels()[0].get_text() == "nominal"


def test_residual_force_plot_has_its_band(story) -> None:
    """The band around the residual force is 1.96 standard errors wide on either side."""
    located = story[0].location
    ax = report.plot_residual_force(located, located.force_names[0], record=1)
    series = located.forces[1]
    (band,) = ax.collections
    top = band.get_paths()[0].vertices[:, 1].max()
    assert top == pytest.approx((series.values + 1.96 * series.std)[:, 0].max(), rel=1e-6)
    with pytest.raises(DataError, match=re.escape(located.force_names[0])):
        report.plot_residual_force(located, "no such equation")


def test_force_against_yaw_rate_shows_the_missing_damping(story) -> None:
    """Against the yaw rate the slice means bend as a damping that a line cannot replace."""
    found, _, train = story
    ax = report.plot_force_against(found.location, found.location.force_names[0], train, "r")
    means = ax.containers[0].lines[0]
    x, y = np.asarray(means.get_xdata()), np.asarray(means.get_ydata())
    # r|r| less the straight line that the free time constant absorbs: odd, and bent.
    outer, inner = np.abs(x) > 0.7 * np.abs(x).max(), np.abs(x) < 0.6 * np.abs(x).max()
    assert np.mean((np.sign(x) * y)[outer]) < np.mean((np.sign(x) * y)[inner])
    assert ax.get_xlabel() == "yaw rate $r$ [deg/s]"
    logged = np.degrees(np.concatenate([record.output("r") for record in train]))
    assert x.min() >= np.nanmin(logged)
    assert x.max() > 0.5 * np.nanmax(logged)


def test_force_figure_draws_every_record_and_varying_signal(story) -> None:
    """Two training records over time, and three signals that vary."""
    found, _, train = story
    figure = report.figure_force(found.location, found.location.force_names[0], train)
    drawn = [ax for ax in figure.get_axes() if ax.axison]
    assert len(drawn) == 2 + 3


def test_comparison_plot_shows_ratio_and_spread(story) -> None:
    """Each bar is an output's error over its noise."""
    comparison = story[1]
    ax = report.plot_comparison(comparison)
    heights = [bar.get_height() for bar in ax.patches]
    expected = [one.relative for part in comparison.models for one in part.outputs]
    np.testing.assert_allclose(heights, expected)


def test_prediction_plot_shows_the_uncertain_band(story) -> None:
    """The band of a prediction is wider than the noise: parameters are uncertain."""
    prediction = story[1].models[1].prediction
    ax = report.plot_prediction(prediction, "psi")
    (band,) = ax.collections
    top = band.get_paths()[0].vertices[:, 1].max()
    expected = (prediction.outputs[0] + 1.96 * prediction.std[0])[:, 0].max()
    assert top == pytest.approx(np.degrees(expected), rel=1e-6)
    assert expected > (prediction.outputs[0] + 1.96 * prediction.sigma)[:, 0].max()
    errors = report.plot_prediction_error(prediction, "psi").get_lines()[-1].get_ydata()
    np.testing.assert_allclose(errors, prediction.residuals[0][:, 0] / prediction.sigma[0])


def test_report_tells_the_story(story) -> None:
    """Verdict, numbers, evidence and equations of the improved model are on the page."""
    found, comparison, train = story
    page = report.improvement_page(found, comparison, train=train, title="My ship")
    titles = [section.title for section in page.sections]
    parts = dict(zip(titles, page.sections, strict=True))
    told = parts["What to believe, and what to do next at sea"].paragraphs
    assert all(any(line.strip(" -") in p for p in told) for line in found.advice)
    assert [row[1] for row in parts["Errors"].tables[0].rows][:2] == ["training", "validation"]
    assert {"What is missing", "Where the nominal model fails", "Candidates"} < set(titles)
    assert HIDDEN in page.answer
    assert page.verdict[-1].startswith("Verdict")
    html = page.html()
    assert "<h1>My ship</h1>" in html
    assert "E_yaw r |r|" in html
    assert not re.search(r'(src|href)="(?!data:|#)', html)


def test_comparison_report_says_where_models_fail(story) -> None:
    """The verdict of every model is on the page, with a table each."""
    comparison = story[1]
    page = report.comparison_page(comparison)
    assert set(map(told, comparison.verdict.splitlines())) <= set(page.verdict)
    assert [len(one.tables) for one in page.sections[:2]] == [1, 1]
