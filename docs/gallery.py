"""Pictures of the gallery page: each function draws one, and its lines are shown beside it.

    python docs/gallery.py

writes ``docs/gallery/`` (pictures and page); ``make docs`` runs it. A caption is what the picture
itself says it shows (:func:`oed_sysid.results.finding`), numbers included.
"""

from __future__ import annotations

import hashlib
import inspect
import textwrap
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed_sysid import (
    Dataset,
    Experiment,
    Input,
    Limits,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    State,
    improve,
    load_problem,
    simulate,
)
from oed_sysid import (
    results as report,
)
from oed_sysid.design import Levels, Search, Trial, design_experiment
from oed_sysid.experiments.manoeuvres import TurningCircle, ZigZag
from oed_sysid.information import rank_parameters
from oed_sysid.likelihood.multistart import Multistart, profile
from oed_sysid.prediction.speed_polar import speed_polar

HERE = Path(__file__).resolve().parent
FERRY = Model(
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


@cache
def ferry() -> SimpleNamespace:
    """A ferry with quadratic yaw damping, and a model without that damping."""
    truth, rng = FERRY.with_values({"A": 4.0}), np.random.default_rng(5)
    runs = (
        Experiment("zigzag", ZigZag("rudder", 0.35, 0.35), duration=120.0, sample_time=0.5),
        Experiment("circle", TurningCircle("rudder", 0.5), duration=120.0, sample_time=0.5),
    )
    data = Dataset(tuple(simulate(truth, run, rng=rng) for run in runs))
    zigzag = Dataset((data["zigzag"],))
    fit = MultipleShooting(disturbances="none").fit(FERRY, zigzag)
    better = MultipleShooting().fit(FERRY.free("A"), zigzag)
    return SimpleNamespace(data=data, zigzag=zigzag, fit=fit, better=better)


@cache
def dive() -> SimpleNamespace:
    """The diving plane of a small AUV, of which something is missing."""
    problem = load_problem("remus_diving_plane")
    data = problem.data()
    train, test = (
        Dataset(tuple(r for r in data if r.name.startswith(kind))) for kind in ("train", "test")
    )
    found = improve(problem.model, train, test, candidates=problem.effects[:8])
    return SimpleNamespace(problem=problem, train=train, test=test, found=found)


def measured_and_model() -> Figure:
    """Measured and model."""
    return report.figure_fit(dive().found.base_fit)


def where_the_model_fails() -> Axes:
    """Where the model fails."""
    return report.plot_located(dive().found.location)


def residual_force() -> Axes:
    """The force that is missing, over time."""
    located = dive().found.location
    return report.plot_residual_force(located, "Z")


def ranking_of_candidates() -> Axes:
    """Which effect is missing."""
    return report.plot_ranking(dive().found.ranking)


def fall_of_the_error() -> Axes:
    """The error falls on records not used in fitting."""
    return report.plot_error_fall(dive().found)


def prediction_with_its_band() -> Axes:
    """A prediction with its band."""
    prediction = dive().found.fit.predict(dive().test)
    return report.plot_prediction(prediction, "theta")


def correlation_of_estimates() -> Axes:
    """Which derivatives are known only together."""
    return report.plot_correlation(dive().found.fit)


def sensitivity_bars() -> Axes:
    """What a manoeuvre identifies."""
    problem = dive().problem
    return report.plot_sensitivity(rank_parameters(problem.model, dive().train))


def zigzag_with_overshoots() -> Axes:
    """A zigzag and its overshoots."""
    ship = ferry()
    return report.plot_zigzag(
        ship.data["zigzag"], [ship.fit, ship.better], labels=["linear", "with quadratic damping"]
    )


def track_of_a_circle() -> Axes:
    """A turning circle that nobody fitted."""
    ship = ferry()
    circle = Dataset((ship.data["circle"],))
    said = [fit.predict(circle) for fit in (ship.fit, ship.better)]
    return report.plot_track(circle[0], said, labels=["linear", "with quadratic damping"])


def phase_plane() -> Axes:
    """The phase plane."""
    ship = ferry()
    return report.plot_track(ship.data["zigzag"], [ship.better], across="psi", along="r")


def information_ellipses() -> Axes:
    """What two models make of the same zigzag."""
    ship = ferry()
    both = [ship.fit, ship.better]
    return report.plot_ellipses(
        [fit.information for fit in both],
        ("K", "T"),
        centres=[(fit.values["K"], fit.values["T"]) for fit in both],
        labels=["linear", "with quadratic damping"],
        units=("1/s", "s"),
        truth=(0.1, 8.0),
    )


def profile_of_a_parameter() -> Axes:
    """A profile of the likelihood."""
    return report.plot_profile(profile(ferry().better, "T"))


def starts_of_a_multistart() -> Axes:
    """The waterfall of a multistart."""
    ship = ferry()
    single = MultipleShooting(interval=np.inf, start="near", noise="given", disturbances="none")
    return report.plot_waterfall(Multistart(single, n_starts=12, n_jobs=1).fit(FERRY, ship.zigzag))


def designed_run() -> Figure:
    """A designed run beside standard manoeuvres."""
    design = _designed()
    return report.figure_design(design)


def card_for_those_on_board() -> Figure:
    """The card for those on board."""
    design = _designed()
    return report.figure_card(design.card())


@cache
def _designed():  # type: ignore[no-untyped-def]
    """Ninety seconds of rudder that identify the ferry best within 20 degrees of either."""
    return design_experiment(
        FERRY.free("A"),
        Trial(
            limits=Limits(inputs={"rudder": (-0.35, 0.35)}, signals={"psi": (-0.6, 0.6)}),
            duration=90.0,
            sample_time=0.5,
        ),
        rng=np.random.default_rng(0),
        search=Search(family=Levels(12), n_starts=2),
    )


def sailing_polar() -> Axes:
    """The speed polar of a sailing drone."""
    problem = load_problem("sailboat")
    angles = np.radians(np.arange(45.0, 166.0, 15.0))
    sheets = np.radians(np.arange(10.0, 81.0, 10.0))
    return report.plot_polar(
        speed_polar(problem.model, wind_speed=6.0, angles=angles, sheets=sheets)
    )


PICTURES: tuple[Callable[[], Axes | Figure], ...] = (
    measured_and_model,
    where_the_model_fails,
    residual_force,
    ranking_of_candidates,
    fall_of_the_error,
    prediction_with_its_band,
    correlation_of_estimates,
    sensitivity_bars,
    zigzag_with_overshoots,
    track_of_a_circle,
    phase_plane,
    information_ellipses,
    profile_of_a_parameter,
    starts_of_a_multistart,
    designed_run,
    card_for_those_on_board,
    sailing_polar,
)
HEAD = """# Gallery

Every picture of this page is drawn when the page is built, by the lines below it
(`docs/gallery.py`, which also has the ferry and the dive they speak of). The caption is what the
picture says of itself; it goes into files as their description, and into pages as alternative text.
Each `plot_...` draws into axes of yours (`ax=`) and returns them.
"""


def digest() -> str:
    """Of all that the pictures depend on: this file, the package, the problems, Matplotlib."""
    said = hashlib.sha256(matplotlib.__version__.encode())
    root = HERE.parent
    parts = [path for part in ("oed_sysid", "problems") for path in (root / part).rglob("*.*")]
    for path in [Path(__file__), *sorted(parts)]:
        if path.suffix in (".py", ".c", ".csv", ".toml", ".txt"):
            said.update(path.name.encode() + path.read_bytes())
    return said.hexdigest()


def main(folder: Path = HERE / "gallery") -> None:
    """Draw all pictures and write the page, unless those that are there are of these sources."""
    folder.mkdir(exist_ok=True)
    page: list[str] = []
    cards, now, drawn_from = (
        ["::::{grid} 2 3 3 4", ":gutter: 2", ""],
        digest(),
        folder / "sources.sha256",
    )
    if drawn_from.exists() and drawn_from.read_text(encoding="utf-8") == now:
        return
    for draw in PICTURES:
        drawn = draw()
        figure = drawn if isinstance(drawn, Figure) else drawn.figure
        said = report.finding(drawn)
        file = f"{draw.__name__}.png"
        figure.savefig(folder / file, dpi=90, bbox_inches="tight")
        figure.clear()
        lines = inspect.getsource(draw).splitlines()[2:]
        title, picture = str(draw.__doc__).rstrip("."), f"![{said}]({file})\n\n{said}\n"
        # Guides include a picture with what it says.
        (folder / f"{draw.__name__}.txt").write_text(picture, encoding="utf-8")
        cards += [f":::{{grid-item-card}} {title}", f":img-bottom: {file}"]
        cards += [f":link: picture-{draw.__name__}", ":link-type: ref", ":::"]
        page += [
            f"(picture-{draw.__name__})=\n## {title}\n",
            picture,
            f"```python\n{textwrap.dedent(chr(10).join(lines))}\n```\n",
        ]
    text = "\n".join([HEAD, *cards, "::::\n", *page])
    (folder / "index.md").write_text(text, encoding="utf-8")
    drawn_from.write_text(now, encoding="utf-8")


if __name__ == "__main__":
    main()
