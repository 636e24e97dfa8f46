"""Pictures show what the result holds; reports are one file that needs nothing else."""

from __future__ import annotations

import base64
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser

import matplotlib as mpl
import matplotlib.pyplot
import numpy as np
import pytest
from matplotlib.axes import Axes

mpl.use("Agg")

from oed_sysid import (
    Dataset,
    Experiment,
    Fit,
    Input,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    State,
)
from oed_sysid import (
    results as report,
)
from oed_sysid.errors import DataError
from oed_sysid.experiments.manoeuvres import TurningCircle, ZigZag
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.multistart import profile
from oed_sysid.runtime.display import rounded

SHIP = Model(
    "ferry",
    states=(
        State("x", "m", scale=100.0),
        State("y", "m", scale=100.0),
        State("psi", "rad"),
        State("r", "rad/s", scale=0.05),
    ),
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
    return Dataset(tuple(simulate(TRUTH, run, rng=rng) for run in runs))


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
    mpl.pyplot.close("all")


def line(ax: Axes, name: str) -> np.ndarray:
    """Ordinates of the line with a label."""
    (found,) = [drawn for drawn in ax.get_lines() if drawn.get_label() == name]
    return np.asarray(found.get_ydata(), dtype=float)


def test_output_plot_shows_data_model_and_band(fit: Fit, data: Dataset) -> None:
    """The dots are the record, the line the prediction, the band 1.96 noise levels."""
    ax = report.plot_output(fit, "psi", record="circle")
    predicted = np.degrees(fit.predictions[1][:, 2])
    np.testing.assert_allclose(line(ax, "measured"), np.degrees(data["circle"].output("psi")))
    np.testing.assert_allclose(line(ax, "model"), predicted)
    (band,) = ax.collections
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx(predicted.max() + 1.96 * np.degrees(0.003))
    assert ax.get_ylabel() == "heading $\\psi$ [deg]"
    size = fit.rms["psi"] / fit.sigma[2]
    assert report.finding(ax) == f"circle: residuals of psi are {size:.3g} times its noise."
    assert ax.get_xlabel() == "time $t$ [s]"


def test_residual_plot_has_the_noise_band(fit: Fit) -> None:
    """The residuals are measured minus predicted."""
    ax = report.plot_residual(fit, "r", record="zigzag")
    np.testing.assert_allclose(line(ax, "measured − model"), np.degrees(fit.residuals[0][:, 3]))
    assert "[deg/s]" in ax.get_ylabel()


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
    heading = line(ax, "$\\psi$ measured")
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
    ax = report.plot_phase(data["zigzag"], [fit], across="psi", along="r")
    np.testing.assert_allclose(line(ax, "measured"), np.degrees(data["zigzag"].output("r")))
    np.testing.assert_allclose(line(ax, "model 1"), np.degrees(fit.predictions[0][:, 3]))
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
    with pytest.raises(DataError, match="no 'Q'"):
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
    from PIL import Image

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
    from matplotlib import pyplot as plt

    before, figures = dict(mpl.rcParams), plt.get_fignums()
    figure, axes = report.style.new_figure(2, 3, size=(9, 6))
    places = axes.flat
    assert report.plot_output(fit, "r", ax=places[0]) is places[0]
    report.plot_residual(fit, "r", ax=places[1])
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


def test_report_is_one_file_that_fetches_nothing(fit: Fit, tmp_path) -> None:
    """Pictures are embedded and every reference stays inside the page."""
    file = report.fit_page(fit).write(tmp_path / "new" / "fit.html")
    text = file.read_text(encoding="utf-8")
    parser = _References()
    parser.feed(text)
    assert {"script", "link", "iframe"}.isdisjoint(parser.tags)
    assert all(target.startswith(("data:", "#")) for target in parser.targets)
    assert parser.tags.count("img") == 5
    picture = re.search(r'src="data:image/svg\+xml;base64,([^"]+)"', text)
    assert picture is not None
    assert b"<svg" in base64.b64decode(picture[1])
    for name, value in fit.values.items():
        assert f"<td>{name}</td><td>{rounded(value, fit.std_errors[name])}</td>" in text


def test_report_escapes_what_the_user_wrote(fit: Fit) -> None:
    """A record called like a tag does not become one."""
    page = report.Page("<b>bold</b>", "", ("a < b",))
    assert "<b>" not in page.html()
    assert "a &lt; b" in page.html()


def test_same_fit_same_picture(fit: Fit) -> None:
    """Two reports on one fit are equal to the byte, so that they can be compared."""
    first, second = (report.Picture.of(report.figure_fit(fit), "fit").source for _ in range(2))
    assert first == second


def test_verdict_tells_misfit_from_noise(fit: Fit, better: Fit, data: Dataset) -> None:
    """The wrong model is said to lack something; the right one is not.

    Process noise may take what is missing: whole runs are then stated, several times worse.
    """
    white = MultipleShooting(disturbances="none").fit(SHIP, data)
    assert "lacks something" in white.document().answer
    assert "whole runs are off" in fit.document().answer
    assert fit.whole_runs.ratio > 2.0
    assert "lacks something" not in better.document().answer


def test_plain_import_does_not_load_matplotlib() -> None:
    """`import oed_sysid` alone does not load matplotlib; the report does."""
    code = (
        "import sys, oed_sysid; a = 'matplotlib' in sys.modules; "
        "import oed_sysid.results; print(a, 'matplotlib' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "False True", done.stderr


def test_a_fit_says_nothing_of_records_it_has_not_seen(fit: Fit, data: Dataset) -> None:
    """The message names the records that it knows and the way to a prediction."""
    with pytest.raises(DataError, match=r"not fitted to record 'stranger'.*fit\.predict"):
        report.plot_track(replace(data["circle"], name="stranger"), [fit])


def test_unmeasured_output_is_a_dash_in_every_rendering(data: Dataset) -> None:
    """An output without a sample is a dash in text, LaTeX and page: no row says nan."""
    records = []
    for record in data:
        outputs = record.outputs.copy()
        outputs[:, 3] = np.nan
        records.append(record.with_outputs(outputs))
    document = MultipleShooting(disturbances="none").fit(SHIP, Dataset(tuple(records))).document()
    page = document.html()
    for said in (document.text(), document.latex(), page[page.index("<main>") :]):
        assert not re.search(r"\bnan\b|[0-9]e\+0[2-5]\b", re.sub(r'src="[^"]*"', "", said))
        assert "–" in said
