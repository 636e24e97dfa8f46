"""Pictures show what the result holds; reports are one file that needs nothing else."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from motion import states
from PIL import Image
from starter import improved, starter
from test_design import ship
from test_sensitivity import oscillator, roll_test

from oed_sysid import Dataset, Experiment, Fit, Limits, Record, TurningCircle, ZigZag, load_problem
from oed_sysid import results as report
from oed_sysid.baselines import MultipleShooting, profile
from oed_sysid.design import Levels, Search, Trial, design_experiment
from oed_sysid.errors import DataError
from oed_sysid.evidence.compare import Comparison, compare
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information import rank_parameters
from oed_sysid.physics.channels import Input, Output
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.results.chart import Chart, Mark
from oed_sysid.runtime.display import rounded

mpl.use("Agg")


SHIP = Model(
    "ferry",
    states=states("x y psi r", x=100.0, y=100.0, r=0.05),
    inputs=(Input("rudder", "rad", "rudder angle"),),
    outputs=(
        Output("x", "m", "north", noise_std=1.0),
        Output("y", "m", "east", noise_std=1.0),
        Output("psi", "rad", "heading", noise_std=0.003),
        Output("r", "rad/s", "yaw rate", noise_std=0.001),
    ),
    kinematics={
        "x": "U*cos(psi)",
        "y": "U*sin(psi)",
        "psi": "r",
        "r": "(K*rudder - r - A*r*abs(r))/T",
    },
    parameters=(
        Parameter("U", 5.0, "m/s", fixed=True),
        Parameter("K", 0.1, "1/s", prior_std=0.05),
        Parameter("T", 8.0, "s", lower=0.1),
        Parameter("A", 0.0, "s", scale=1.0, fixed=True),
    ),
)
TRUTH = SHIP.with_values({"A": 4.0})


@pytest.fixture(name="data", scope="module")
def _data() -> Dataset:
    """A zigzag and a turning circle of a ship with damping that the model lacks."""
    rng = np.random.default_rng(5)
    runs = (
        Experiment("zigzag", ZigZag("rudder", 0.35, 0.35), duration=120.0, sample_time=0.5),
        Experiment("circle", TurningCircle("rudder", 0.5), duration=120.0, sample_time=0.5),
    )
    return Dataset(simulate(TRUTH, run, rng=rng) for run in runs)


@pytest.fixture(name="fit", scope="module")
def _fit(data: Dataset) -> Fit:
    """A fit of the model without the damping."""
    return MultipleShooting().fit(SHIP, data)


@pytest.fixture(name="better", scope="module")
def _better(data: Dataset) -> Fit:
    """A fit of the model with the damping."""
    return MultipleShooting().fit(SHIP.free("A"), data)


@pytest.fixture(autouse=True)
def _close_figures():
    """Leave no figure behind."""
    yield
    plt.close("all")


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are made but not written: what a page says does not depend on their pixels."""
    monkeypatch.setattr(mpl.figure.Figure, "savefig", lambda *_, **__: None)


def line(ax: Axes, name: str) -> np.ndarray:
    """Ordinates of the line with a label."""
    (found,) = [drawn for drawn in ax.get_lines() if drawn.get_label() == name]
    return np.asarray(found.get_ydata(), dtype=float)


def test_output_plot_shows_data_model_and_band(fit: Fit, data: Dataset) -> None:
    """The dots are the record, the line the prediction, the band 1.96 noise levels."""
    ax = report.plot_prediction(fit, "psi", record="circle", labels=["model"])
    predicted = np.degrees(fit.predictions[1][:, 2])
    np.testing.assert_allclose(line(ax, "measured"), np.degrees(data["circle"].output("psi")))
    np.testing.assert_allclose(line(ax, "model"), predicted)
    (band,) = ax.collections
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx(predicted.max() + 1.96 * np.degrees(0.003))
    assert ax.get_ylabel() == "heading $\\psi$ [deg]"
    size = np.sqrt(np.mean((fit.residuals[1][:, 2] / fit.sigma[2]) ** 2))
    assert float(report.finding(ax).split()[-4]) == pytest.approx(size, rel=5e-3)
    assert ax.get_xlabel() == "time $t$ [s]"


def test_error_of_a_fit_is_drawn_in_units_of_the_noise(fit: Fit) -> None:
    """The residuals are measured minus predicted; in the figure of a fit they have their unit."""
    drawn = line(report.plot_prediction_error(fit, "r", record="zigzag"), "model 1")
    np.testing.assert_allclose(drawn, fit.residuals[0][:, 3] / fit.sigma[3])
    (own,) = [ax for ax in report.figure_fit(fit).axes if ax.get_ylabel() == "residual [deg/s]"]
    np.testing.assert_allclose(line(own, "model"), np.degrees(fit.residuals[0][:, 3]))


def test_autocorrelation_leaves_the_band_only_for_the_wrong_model(fit: Fit, better: Fit) -> None:
    """White residuals stay inside the 95 % band about 95 % of the time; a misfit does not."""
    outside = []
    for one in (fit, better):
        ax = report.plot_autocorrelation(one, "r")
        half = 1.96 / np.sqrt(241)
        values = np.concatenate(
            [drawn.get_ydata() for drawn in ax.get_lines() if drawn.get_label() == "records"]
        )
        outside.append(np.mean(np.abs(values) > half))
    assert outside[0] > 0.3
    assert outside[1] < 0.15


def test_interval_plot_is_relative_to_the_prior(fit: Fit, better: Fit) -> None:
    """Each estimate is drawn at its value over the prior mean, with 1.96 standard errors."""
    ax = report.plot_intervals([fit, better], truth={"K": 0.1, "T": 8.0})
    names = [text.get_text() for text in ax.get_yticklabels()]
    assert names == ["$K$", "$T$", "$A$"]
    point, _, (bars,) = ax.containers[0]
    assert point.get_xdata()[0] == pytest.approx(fit.values["K"] / 0.1)
    (low, _), (high, _) = bars.get_segments()[0]
    assert high - low == pytest.approx(2 * 1.96 * fit.std_errors["K"] / 0.1)


def test_correlation_plot_shows_the_matrix(better: Fit) -> None:
    """The picture is the correlation matrix on a scale from -1 to 1."""
    ax = report.plot_correlation(better)
    (picture,) = ax.get_images()
    np.testing.assert_allclose(np.asarray(picture.get_array()), better.correlation)
    assert picture.get_clim() == (-1, 1)


def test_zigzag_diagram_is_in_degrees_with_overshoots(fit: Fit, data: Dataset) -> None:
    """The diagram uses degrees and writes the overshoot angles of the measured heading."""
    ax = report.plot_zigzag(data["zigzag"], [fit])
    heading = line(ax, "measured")
    np.testing.assert_allclose(heading, np.degrees(data["zigzag"].output("psi")))
    words = [text.get_text() for text in ax.texts]
    assert len(words) == 2
    first = float(re.findall(r"overshoot ([\d.]+)°", words[0])[0])
    assert first == pytest.approx(heading[: len(heading) // 2].max() - 20.0, abs=1.5)
    # The stroke beside the words is as long as the overshoot; the model's is said as well.
    strokes = [one.get_ydata() for one in ax.get_lines() if one.get_marker() == "_"]
    assert len(strokes) == 2
    assert abs(np.ptp(strokes[0]) - first) < 1.0
    assert re.search(
        rf"measured: overshoots {first}° and .* model 1: overshoots", report.finding(ax)
    )


def test_a_circle_has_no_overshoots(data: Dataset) -> None:
    """Where the indices do not exist nothing is written."""
    assert not report.plot_zigzag(data["circle"]).texts


def test_track_keeps_proportions(fit: Fit, data: Dataset) -> None:
    """East is to the right, north is up, and a circle looks like one."""
    ax = report.plot_track(data["circle"], [fit])
    assert ax.get_aspect() == 1.0
    np.testing.assert_array_equal(line(ax, "measured"), data["circle"].output("x"))
    assert "east" in ax.get_xlabel()


def test_phase_plane_shows_one_signal_over_another(fit: Fit, data: Dataset) -> None:
    """Yaw rate over heading, both in degrees, measured and as the model goes."""
    ax = report.plot_track(data["zigzag"], [fit], across="psi", along="r")
    np.testing.assert_allclose(line(ax, "measured"), np.degrees(data["zigzag"].output("r")))
    np.testing.assert_allclose(line(ax, "model 1"), np.degrees(fit.predictions[0][:, 3]))
    assert ax.get_aspect() == "auto"
    assert "[deg]" in ax.get_xlabel()
    assert "[deg/s]" in ax.get_ylabel()


def test_shadow_of_an_ellipse_is_the_interval(fit: Fit) -> None:
    """On each axis an ellipse is as wide as the 95 % interval of that parameter."""
    centre = (fit.values["K"], fit.values["T"])
    ax = report.plot_ellipses(
        [fit.information], ("K", "T"), centres=[centre], labels=["fit"], units=("1/s", "s")
    )
    assert ax.get_ylabel().endswith("[s]")
    (edge,) = [one for one in ax.get_lines() if one.get_label() == "fit"]
    errors = np.sqrt(np.diag(fit.information.covariance))
    for values, name, middle in (
        (edge.get_xdata(), "K", centre[0]),
        (edge.get_ydata(), "T", centre[1]),
    ):
        error = errors[fit.information.names.index(name)]
        assert np.ptp(values) == pytest.approx(2 * 1.96 * error, rel=1e-3)
        assert np.mean((values.min(), values.max())) == pytest.approx(middle)
    with pytest.raises(DataError, match="no parameter 'Q'"):
        report.plot_ellipses([fit.information], ("K", "Q"))


def test_profile_shows_curve_and_interval(fit: Fit) -> None:
    """The curve reaches the threshold at the ends of the interval that its finding names."""
    found = profile(fit, "T")
    ax = report.plot_profile(found)
    np.testing.assert_array_equal(line(ax, "profile"), found.rises)
    ends = [
        one.get_xdata()[0] for one in ax.get_lines() if one.get_xdata()[0] == one.get_xdata()[-1]
    ]
    assert {found.lower, found.upper, found.estimate} <= set(ends)
    for end in (found.lower, found.upper):
        rise = np.interp(end, found.values, found.rises)
        assert rise == pytest.approx(found.threshold, rel=0.02)
    assert report.finding(ax) == found.report()


def test_findings_are_written_into_files(fit: Fit, tmp_path) -> None:
    """The description of a picture file is what the picture shows."""
    ax = report.plot_intervals(fit)
    report.save_figure(ax.figure, tmp_path / "fit.png")
    half = {n: 1.96 * fit.std_errors[n] / abs(v) for n, v in fit.values.items()}
    worst = max(half, key=half.get)
    said = Image.open(tmp_path / "fit.png").text["Description"]
    assert f"least certain is {worst}, ± {100 * half[worst]:.2g} % (95 %)" in said


def test_same_place_same_look(fit: Fit, better: Fit, data: Dataset) -> None:
    """A model keeps its colour and dashes from figure to figure, and differs from the next."""
    ax = report.plot_zigzag(data["zigzag"], [fit, better], labels=["a", "b"])
    looks = {drawn.get_label(): drawn for drawn in ax.get_lines()}
    assert looks["a"].get_color() == report.model_style(0).colour
    assert looks["b"].get_color() == report.model_style(1).colour
    assert looks["a"].get_linestyle() != looks["b"].get_linestyle()


def test_plots_use_given_axes_and_leave_settings_alone(fit: Fit, data: Dataset) -> None:
    """With ax= no figure is made, and matplotlib's settings are as before."""
    before, figures = dict(mpl.rcParams), plt.get_fignums()
    figure, axes = report.style.new_figure(2, 3, size=(9, 6))
    places = axes.flat
    assert report.plot_prediction(fit, "r", ax=places[0]) is places[0]
    report.plot_prediction_error(fit, "r", ax=places[1])
    report.plot_autocorrelation(fit, "r", ax=places[2])
    report.plot_intervals(fit, ax=places[3])
    report.plot_correlation(fit, ax=places[4])
    report.plot_track(data["circle"], [fit], ax=places[5])
    report.figure_fit(fit)
    assert dict(mpl.rcParams) == before
    assert plt.get_fignums() == figures
    assert len(figure.axes) == 7  # six and the colour bar


class _References(HTMLParser):
    """Collects everything that a page would fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.targets: list[str] = []

    def handle_starttag(self, tag: str, attrs: list) -> None:
        """Note links and sources."""
        self.tags.append(tag)
        self.targets += [value for key, value in attrs if key in ("src", "href", "srcset")]


@pytest.mark.usefixtures("unrendered")
def test_report_is_one_file_that_fetches_nothing(fit: Fit, tmp_path) -> None:
    """Pictures are embedded and every reference stays inside the page."""
    file = fit.document().write(tmp_path / "new" / "fit.html")
    text = file.read_text(encoding="utf-8")
    parser = _References()
    parser.feed(text)
    assert {"script", "link", "iframe"}.isdisjoint(parser.tags)
    assert all(target.startswith(("data:", "#")) for target in parser.targets)
    assert parser.tags.count("img") == 5
    for name, value in fit.values.items():
        assert f"<td>{name}</td><td>{rounded(value, fit.std_errors[name])}</td>" in text


def test_report_escapes_what_the_user_wrote(fit: Fit) -> None:
    """A record called like a tag does not become one."""
    page = report.Report("<b>bold</b>", "", ("a < b",))
    assert "<b>" not in page.html()
    assert "a &lt; b" in page.html()


def test_same_fit_same_picture(fit: Fit) -> None:
    """Two pictures of one fit are equal to the byte, so that reports can be compared."""
    first, second = (
        report.Picture.of(report.plot_prediction(fit, "r").figure, "fit").source for _ in range(2)
    )
    assert first == second
    assert b"<svg" in base64.b64decode(first.removeprefix("data:image/svg+xml;base64,"))


def test_verdict_tells_misfit_from_noise(fit: Fit, better: Fit, data: Dataset) -> None:
    """The wrong model is said to lack something; the right one is not.

    Process noise may take what is missing: whole runs are then stated, several times worse.
    """
    white = MultipleShooting(disturbances="none").fit(SHIP, data)
    assert "lacks something" in white.document().answer
    assert "whole runs are off" in fit.document().answer
    assert fit.whole_runs.ratio > 2.0
    assert "lacks something" not in better.document().answer


def test_a_fit_says_nothing_of_records_it_has_not_seen(fit: Fit, data: Dataset) -> None:
    """The message names the records that it knows and the way to a prediction."""
    with pytest.raises(DataError, match=r"not fitted to record 'stranger'.*fit\.predict"):
        report.plot_track(replace(data["circle"], name="stranger"), [fit])


@pytest.mark.usefixtures("unrendered")
def test_unmeasured_output_is_a_dash_in_every_rendering(data: Dataset) -> None:
    """An output without a sample is a dash in text, LaTeX and page: no row says nan."""
    records = []
    for record in data:
        outputs = record.outputs.copy()
        outputs[:, 3] = np.nan
        records.append(record.with_outputs(outputs))
    document = MultipleShooting(disturbances="none").fit(SHIP, Dataset(records)).document()
    page = document.html()
    for said in (document.text(), document.latex(), page[page.index("<main>") :]):
        assert not re.search(r"\bnan\b|[0-9]e\+0[2-5]\b", re.sub(r'src="[^"]*"', "", said))
        assert "–" in said


def test_sensitivity_plot_has_a_row_for_each_parameter() -> None:
    """Rows are the parameters, best on top, at their errors."""
    ranking = rank_parameters(oscillator(), roll_test())
    ax = report.plot_sensitivity(ranking)
    assert len(ax.get_yticklabels()) == len(ranking.rows)
    dots = [line.get_xdata()[0] for line in ax.lines if line.get_label() == "estimated together"]
    np.testing.assert_allclose(dots, [min(r.error, dots[i]) for i, r in
                                      enumerate(ranking.rows)])  # fmt: skip
    assert dots[0] == pytest.approx(ranking.rows[0].error)


@pytest.mark.slow
def test_design_figure_draws_commands_limits_and_errors(tmp_path: Path) -> None:
    """The figure can be written, and the accuracy shown is the design's."""
    limits = Limits(inputs={"rudder": (-0.35, 0.35)}, signals={"psi": (-0.6, 0.6)})
    design = design_experiment(
        ship(),
        Trial(limits=limits, duration=30.0, sample_time=0.5),
        rng=np.random.default_rng(0),
        search=Search(family=Levels(8), n_starts=1, n_candidates=5, n_steps=3, n_workers=1),
    )
    figure = report.figure_design(design)
    figure.savefig(tmp_path / "design.png", dpi=30)
    assert (tmp_path / "design.png").stat().st_size > 3_000
    (ours,) = [
        line for line in report.plot_accuracy(design).lines if line.get_label() == "designed"
    ]
    np.testing.assert_allclose(np.sort(ours.get_xdata()), np.sort(design.relative_errors))


HIDDEN = "yaw_quadratic_damping"


@pytest.fixture(name="story", scope="module")
def _story() -> tuple[Improvement, Comparison, Dataset]:
    """The starter problem improved, compared on its circle, with its training records."""
    (problem, train, test), found = starter(), improved()
    estimator = MultipleShooting(disturbances="none")
    fits = {
        "nominal": estimator.fit(problem.model, train),
        "improved": estimator.fit(found.model, train),
    }
    return found, compare(fits, test), train


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


def test_names_of_many_steps_do_not_run_into_each_other() -> None:
    """Names under a picture are folded to the room that each has."""
    names = (
        "nominal",
        "+ yaw drift yaw",
        "+ sway crossflow",
        "+ yaw rudder stall",
        "+ rudder drag",
    )
    line = Mark(range(5), np.ones(5), dashes="-")
    ax = Chart((line,), "", "error", "", names=names).on()
    ax.figure.draw_without_rendering()
    boxes = [one.get_window_extent() for one in ax.get_xticklabels()]
    gaps = [right.x0 - left.x1 for left, right in pairwise(boxes)]
    assert len(gaps) == 4
    assert min(gaps) > 0.0


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


@pytest.mark.usefixtures("unrendered")
def test_report_tells_the_story(story) -> None:
    """Verdict, numbers, evidence and equations of the improved model are on the page."""
    found, comparison, train = story
    page = found.document(comparison, train=train, title="My ship")
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


def test_band_is_196_standard_errors() -> None:
    """The band reaches 1.96 standard errors to either side of the estimate."""
    times = np.arange(3.0)
    ax = report.plot_history(times, np.full(3, 5.0), np.full(3, 2.0), name="Z_w", unit="kg/s")
    corners = ax.collections[0].get_paths()[0].vertices
    assert corners[:, 1].min() == pytest.approx(5.0 - 3.92)
    assert corners[:, 1].max() == pytest.approx(5.0 + 3.92)
    assert "Z_{w}" in ax.get_ylabel()
    assert "kg/s" in ax.get_ylabel()
    plt.close(ax.figure)


def test_early_wild_estimates_do_not_set_the_scale() -> None:
    """The axis shows the later half, so that the first samples do not flatten it."""
    values = np.where(np.arange(40) < 3, 1e6, 2.0)
    ax = report.plot_history(np.arange(40.0), values, np.full(40, 0.1), name="K")
    low, high = ax.get_ylim()
    assert 1.0 < low < 2.0 < high < 3.0


def test_record_is_drawn_in_degrees_without_what_was_not_measured() -> None:
    """Every signal has an axis, angles are in degrees, a missing output has none."""
    problem = load_problem("remus_diving_plane")
    record = problem.data()[0]
    outputs = np.array(record.outputs)
    outputs[:, 1] = np.nan
    bare = Record(
        "run", record.times, record.inputs, outputs, record.channels, missing_outputs=("w",)
    )
    shown = [ax for ax in report.figure_record(bare).axes if ax.get_visible()]
    assert len(shown) == len(problem.model.inputs) + len(problem.model.outputs) - 1
    pitch = next(ax for ax in shown if "pitch angle" in ax.get_ylabel())
    assert "[deg]" in pitch.get_ylabel()
    np.testing.assert_allclose(pitch.lines[0].get_ydata(), np.degrees(record.output("theta")))
    assert sum("time" in ax.get_xlabel() for ax in shown) == 2
