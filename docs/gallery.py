"""Pictures of the site: each function draws one; those of the gallery show their lines, too.

    python docs/gallery.py

writes ``docs/gallery/`` (pictures and page); ``make docs`` runs it. A caption is what the picture
itself says it shows (:func:`oed_sysid.results.finding`), numbers included.
"""

from __future__ import annotations

import inspect
import re
import runpy
import textwrap
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from sources import changed, digest

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
    compare,
    improve,
    load_problem,
    new_problem,
    simulate,
)
from oed_sysid import (
    results as report,
)
from oed_sysid.baselines.benchmark import benchmark
from oed_sysid.baselines.online import RecursiveLSSVM
from oed_sysid.design import (
    Budget,
    Levels,
    ProgrammeSearch,
    Search,
    Trial,
    design_experiment,
    design_programme,
)
from oed_sysid.evidence.check import check
from oed_sysid.evidence.frequency import compare_frequency
from oed_sysid.experiments.manoeuvres import TurningCircle, ZigZag
from oed_sysid.export import export
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
        Dataset(tuple(r for r in data if r.name.startswith(k))[:2]) for k in ("train", "test")
    )
    found = improve(problem.model, train, test, candidates=problem.effects[:8])
    return SimpleNamespace(problem=problem, train=train, test=test, found=found)


# -- the log ---------------------------------------------------------------------------


def record_as_logged() -> Figure:
    """A record as it was logged."""
    return report.figure_record(dive().train[0])


def log_with_a_fault() -> Figure:
    """A log whose yaw rate counts the other way."""
    return report.figure_check(_faulty())


def equations_between_signals() -> Axes:
    """What the equations between signals leave, before and after the fault is undone."""
    return report.plot_balances(_faulty())


def one_equation() -> Axes:
    """One equation between signals, over time."""
    return report.plot_balance(_faulty().balances[-1], "zigzag")


@cache
def _faulty():  # type: ignore[no-untyped-def]
    """The ferry's zigzag with a yaw rate of the other sign."""
    good = ferry().data["zigzag"]
    spoilt = good.with_outputs(good.outputs * [1.0, 1.0, 1.0, -1.0])
    return check(Dataset((spoilt,)), FERRY)


# -- the fit ---------------------------------------------------------------------------


def measured_and_model() -> Figure:
    """Measured and model."""
    return report.figure_fit(dive().found.base_fit)


def estimates_with_intervals() -> Axes:
    """Estimates with their 95 % intervals."""
    found = dive().found
    return report.plot_intervals([found.base_fit, found.fit], labels=["nominal", "improved"])


def correlation_of_estimates() -> Axes:
    """Which derivatives are known only together."""
    return report.plot_correlation(dive().found.fit)


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


def whiteness_of_all_outputs() -> Figure:
    """Whether the residuals are white."""
    return report.figure_whiteness(dive().found.base_fit)


def autocorrelation_of_an_output() -> Axes:
    """The autocorrelation of one output's residuals."""
    return report.plot_autocorrelation(dive().found.base_fit, "q")


def estimates_on_line() -> Axes:
    """A time constant that is estimated while the run goes on."""
    record = ferry().data["zigzag"]
    rate, rudder = record.output("r")[::4], record.input("rudder")[::4]
    rows, targets, machine = np.column_stack([rate, rudder])[:-1], np.diff(rate), RecursiveLSSVM()
    machine.start(rows[:2], targets[:2])
    times, found = [], []
    for number, (row, target) in enumerate(zip(rows[2:], targets[2:], strict=True)):
        machine.update(row, target)
        times.append(2.0 * (number + 3))
        found.append(-2.0 / machine.coefficients[0])
    return report.plot_history(
        np.array(times), np.array(found), name="T", unit="s", reference=FERRY.values["T"]
    )


# -- where the model fails, and what is missing ----------------------------------------


def misfit_of_two_models() -> Axes:
    """Two models on records that neither was fitted to."""
    return report.plot_comparison(_compared())


def frequency_responses() -> Figure:
    """Over which frequencies a model holds."""
    return report.figure_frequency(compare_frequency(_compared()), "q")


@cache
def _compared():  # type: ignore[no-untyped-def]
    """The dive's validation records, and two models."""
    found = dive().found
    return compare({"nominal": found.base_fit, "improved": found.fit}, dive().test)


def where_the_model_fails() -> Axes:
    """Where the model fails."""
    return report.plot_located(dive().found.location)


def where_and_what() -> Figure:
    """Where the model fails, and what would explain it."""
    found = dive().found
    return report.figure_diagnosis(found.location, found.ranking)


def residual_force() -> Axes:
    """The force that is missing, over time."""
    located = dive().found.location
    return report.plot_residual_force(located, "Z")


def force_against_motion() -> Axes:
    """The force that is missing, against the motion."""
    located = dive().found.location
    return report.plot_force_against(located, "Z", dive().train, "w")


def force_that_was_found() -> Axes:
    """The force that is missing, and what the effect that was found would leave there."""
    return report.plot_force_found(dive().found, dive().train)


def force_against_everything() -> Figure:
    """The force that is missing, over time and against every signal."""
    return report.figure_force(dive().found.location, "Z", dive().train)


def ranking_of_candidates() -> Axes:
    """Which effect is missing."""
    return report.plot_ranking(dive().found.ranking)


def fall_of_the_error() -> Axes:
    """The error falls on records not used in fitting."""
    return report.plot_error_fall(dive().found)


# -- predictions -----------------------------------------------------------------------


def prediction_with_its_band() -> Axes:
    """A prediction with its band."""
    prediction = dive().found.fit.predict(dive().test)
    return report.plot_prediction(prediction, "theta")


def error_of_a_prediction() -> Axes:
    """What two predictions leave."""
    found = dive().found
    said = [fit.predict(dive().test) for fit in (found.base_fit, found.fit)]
    return report.plot_prediction_error(said, "theta", labels=["nominal", "improved"])


def before_and_after() -> Figure:
    """All outputs, predicted before and after the effect was added."""
    found = dive().found
    said = [fit.predict(dive().test) for fit in (found.base_fit, found.fit)]
    return report.figure_predictions(said, labels=["nominal", "improved"])


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


def sailing_polar() -> Axes:
    """The speed polar of a sailing drone."""
    problem = load_problem("sailboat")
    angles = np.radians(np.arange(45.0, 166.0, 15.0))
    sheets = np.radians(np.arange(10.0, 81.0, 10.0))
    return report.plot_polar(
        speed_polar(problem.model, wind_speed=6.0, angles=angles, sheets=sheets)
    )


# -- the next trial --------------------------------------------------------------------


def sensitivity_bars() -> Axes:
    """What a manoeuvre identifies."""
    problem = dive().problem
    return report.plot_sensitivity(rank_parameters(problem.model, dive().train))


def designed_run() -> Figure:
    """A designed run beside standard manoeuvres."""
    design = _designed()
    return report.figure_design(design)


def designed_orders() -> Axes:
    """The orders of a designed run."""
    return report.plot_orders(_designed())


def accuracy_to_expect() -> Axes:
    """What errors a designed run leaves, beside standard manoeuvres."""
    return report.plot_accuracy(_designed())


def sea_room() -> Axes:
    """How much sea room a run may take."""
    return report.plot_tracks(_designed().card().tracks)


def card_for_those_on_board() -> Figure:
    """The card for those on board."""
    design = _designed()
    return report.figure_card(design.card())


def programme_of_runs() -> Figure:
    """A programme of several runs."""
    return report.figure_programme(
        design_programme(
            FERRY.free("A"),
            Experiment("run", ZigZag("rudder", 0.35, 0.35), duration=90.0, sample_time=1.0),
            limits=Limits(inputs={"rudder": (-0.35, 0.35)}, signals={"psi": (-1.5, 1.5)}),
            budget=Budget(n_runs=3),
            rng=np.random.default_rng(0),
            search=ProgrammeSearch(n_rounds=0),
        )
    )


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
        search=Search(family=Levels(12), n_starts=1),
    )


# -- estimators ------------------------------------------------------------------------


def errors_of_estimators() -> Figure:
    """Estimators where the truth is known."""
    names = ("multiple_shooting", "output_error", "equation_error", "ls_svm")
    return report.figure_benchmark(benchmark(["online_ship"], names, noise=(0.5, 3.0), seeds=2))


# -- the first guide: the starter folder of `oed-sysid new` --------------------------------


@cache
def starter():  # type: ignore[no-untyped-def]
    """What is missing from the ship of the starter folder."""
    with TemporaryDirectory() as folder:
        problem = load_problem(new_problem(Path(folder) / "my_vehicle"))
        data = problem.data()
    train, test = (
        Dataset(tuple(run for run in data if run.name.startswith("zigzag") == fitted))
        for fitted in (True, False)
    )
    found = improve(problem.model, train, test, candidates=problem.effects)
    return SimpleNamespace(found=found, test=test)


def first_fit() -> Figure:
    """A first fit."""
    return report.figure_fit(starter().found.base_fit)


def first_circle() -> Axes:
    """The turning circle that was not fitted, before and after."""
    found, test = starter().found, starter().test
    said = [fit.predict(test) for fit in (found.base_fit, found.fit)]
    return report.plot_prediction(said, "psi", labels=["nominal", "improved"])


def first_candidates() -> Axes:
    """What is missing from the starter folder."""
    return report.plot_ranking(starter().found.ranking)


# -- pages of the documents --------------------------------------------------------------


def signal_chain() -> Axes:
    """The chain from a command to the log."""
    stages = ("command", "actuators", "flow", "forces", "inertia", "states", "sensors", "log")
    acts = ("", "lag, backlash", "current, wind", "drag, lift", "added mass", "", "bias, delay", "")
    _, grid = report.new_figure(1, 1, size=(9.0, 1.5))
    ax = grid[0, 0]
    for place, (stage, example) in enumerate(zip(stages, acts, strict=True)):
        ax.text(place, 0.0, stage, ha="center", va="center", fontsize=10,
                bbox={"boxstyle": "round,pad=0.45", "fc": "#e8f1f8", "ec": "#0072B2"})  # fmt: skip
        ax.text(place, -0.75, example, ha="center", va="center", fontsize=8.5, color="0.35")
        if place:
            ends = (place - 0.38, 0.0), (place - 0.62, 0.0)
            ax.annotate("", *ends, arrowprops={"arrowstyle": "->"})
    ax.set(xlim=(-0.6, len(stages) - 0.4), ylim=(-1.1, 0.7))
    ax.axis("off")
    ax.set_label(
        "From a command to the log: every effect acts at one stage, and below each stage stand "
        "two examples."
    )
    return ax


def exported_circle() -> Axes:
    """The exported model at work, with the uncertainty of its parameters."""
    with TemporaryDirectory() as folder:
        (file,) = export(ferry().better, "python", folder)
        ship = SimpleNamespace(**runpy.run_path(str(file)))
    times = np.arange(0.0, 120.0, 0.5)
    rudder = np.full((len(times), 1), 0.5)
    drawn = ship.sample_parameters(50, np.random.default_rng(0))
    runs = ship.simulate(times, rudder, {}, drawn)
    x, y = runs[:, ship.OUTPUTS.index("x")], runs[:, ship.OUTPUTS.index("y")]
    _, grid = report.new_figure(1, 1, size=(4.8, 4.4))
    ax = grid[0, 0]
    ax.plot(y, x, color=report.model_style(1).colour, lw=0.6, alpha=0.5)
    ax.set(xlabel="east $y$ [m]", ylabel="north $x$ [m]", aspect="equal")
    ax.grid(True, color="0.9")
    ax.set_label(
        f"Fifty turning circles of the exported ferry, parameters drawn from their covariance: the "
        f"end of the run scatters by {np.hypot(np.std(x[-1]), np.std(y[-1])):.2g} m."
    )
    return ax


def table_of(page: str, *columns: str) -> list[list[str]]:
    """Rows of the first table of a page that has these columns, those columns only."""
    rows: list[list[str]] = []
    places: list[int] = []
    for line in (HERE / page).read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.replace("\\|", "/").split("|")[1:-1]]
        if not cells and rows:
            break
        if places and len(cells) > max(places) and set(line) - set("|-: "):
            rows.append([cells[place] for place in places])
        elif not places and all(any(cell.startswith(c) for cell in cells) for c in columns):
            places = [next(i for i, x in enumerate(cells) if x.startswith(c)) for c in columns]
    return rows


def rates(page: str) -> Axes:
    """Rates of a page with their 95 % intervals, and the targets as strokes."""
    found = [
        (name, float(value), *map(float, interval.split(" to ")), target)
        for name, value, interval, target in table_of(page, "measure", "value", "95 %", "target")
        if " to " in interval
    ]
    places = np.arange(len(found))[::-1]
    _, grid = report.new_figure(1, 1, size=(8.4, 0.9 + 0.27 * len(found)))
    ax, look = grid[0, 0], report.model_style(1)
    values, low, high = np.array([row[1:4] for row in found]).T
    ax.hlines(places, low, high, color=look.colour, lw=2.0, alpha=0.45)
    ax.plot(values, places, "o", color=look.colour, ms=5.0, label="measured, 95 % interval")
    aims = [(place, row[4].split()) for place, row in zip(places, found, strict=True) if row[4]]
    at = [(float(words[-1]), place) for place, words in aims]
    ax.plot(*np.transpose(at), "|", color="black", ms=12, mew=1.6, label="target")
    ax.set_yticks(places, [row[0] for row in found], fontsize=8.5)
    ax.set(xlim=(-0.03, 1.03), xlabel="share of the cases")
    ax.grid(True, axis="x", color="0.9")
    ax.legend(frameon=False, fontsize=9, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    ax.set_label(f"{found[0][0]}: {values[0]:.3g} of the cases; {len(found)} rates in all.")
    return ax


def how_often_missing_physics_is_found() -> Axes:
    """How often missing physics is found."""
    return rates("missing_physics.md")


def how_often_on_other_vehicles() -> Axes:
    """How often, on vehicles that nothing was tuned for."""
    return rates("other_vehicles.md")


def bars_of(rows: list[tuple[str, float]], label: str, said: str) -> Axes:
    """Bars with a line at one, on a logarithmic axis."""
    places = np.arange(len(rows))[::-1]
    _, grid = report.new_figure(1, 1, size=(7.6, 0.9 + 0.34 * len(rows)))
    ax, values = grid[0, 0], [value for _, value in rows]
    ax.barh(places, values, height=0.6, color=report.model_style(1).colour)
    for place, value in zip(places, values, strict=True):
        ax.text(value, place, f" {value:.3g}", va="center", fontsize=8.5)
    ax.axvline(1.0, color="black", lw=1.0, ls=":")
    ax.set_yticks(places, [name for name, _ in rows], fontsize=9)
    ax.set(xscale="log", xlabel=label, xlim=(min(*values, 1.0) / 1.6, max(*values, 1.0) * 2.2))
    ax.grid(True, axis="x", color="0.9")
    ax.set_axisbelow(True)
    ax.set_label(said)
    return ax


def error_on_measured_data() -> Axes:
    """How far the error on measured validation data falls."""
    rows = []
    for name, error in table_of("measured_data.md", "problem", "error"):
        numbers = re.match(r"([\d.]+) to ([\d.]+)", error)
        if numbers:
            rows.append((name.partition(", `")[0], float(numbers[2]) / float(numbers[1])))
    best = min(rows, key=lambda row: row[1])
    said = f"The error falls most on {best[0]}: to {best[1]:.2g} of what it was."
    return bars_of(rows, "error with what was found, over the error without [-]", said)


def times_of_peers() -> Axes:
    """The same fit by other libraries."""
    peers = [
        (f"{name}, {start}", float(over.replace(",", "")))
        for name, start, over in table_of("performance.md", "peer", "start", "over ours")
        if re.fullmatch(r"[\d.,]+", over)
    ]
    said = f"Other libraries take {min(peers, key=lambda r: r[1])[1]:.3g} times as long, or longer."
    return bars_of(peers, "time over that of MultipleShooting [-]", said)


def outcomes_of(counts: Mapping[str, Mapping[str, int]], label: str, said: str) -> Axes:
    """Stacked bars: a row for each name, a colour for each outcome."""
    _, grid = report.new_figure(1, 1, size=(7.6, 1.4 + 0.34 * len(counts)))
    ax, places = grid[0, 0], np.arange(len(counts))[::-1]
    left = np.zeros(len(counts))
    for index, outcome in enumerate(dict.fromkeys(o for row in counts.values() for o in row)):
        width = np.array([row.get(outcome, 0) for row in counts.values()])
        look = report.model_style(index)
        ax.barh(places, width, 0.6, left, color=look.colour, hatch="/" * (index > 1), label=outcome)
        left += width
    ax.set_yticks(places, list(counts), fontsize=9)
    ax.set_xlabel(label)
    ax.legend(frameon=False, fontsize=9, ncols=5, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    ax.set_label(said)
    return ax


def outcomes_of_damaged_logs() -> Axes:
    """What becomes of damaged logs of other programs."""
    outcomes = ("read", "refused in words", "ended by the limits", "crash", "uncaught")
    rows = table_of("reliability.md", "format", *outcomes)
    found = {name: dict(zip(outcomes, map(int, cells), strict=True)) for name, *cells in rows}
    crashed, uncaught = (sum(row[key] for row in found.values()) for key in ("crash", "uncaught"))
    files = sum(map(sum, (row.values() for row in found.values())))
    said = f"Of {files} damaged files {crashed} crashed a parser, in a process of its own, and "
    said += f"{uncaught} raised what no one caught."
    return outcomes_of(found, "files", said)


def verdicts_on_papers() -> Axes:
    """How many claims of five papers reproduce."""
    found: dict[str, dict[str, int]] = {}
    text = (HERE / "published.md").read_text(encoding="utf-8")
    for title, part in re.findall(r"^## \d ([^,]+), .*?$(.*?)(?=^## )", text, re.M | re.S):
        cells = [line.split("|")[-2].strip() for line in part.splitlines() if line.endswith("|")]
        found[title] = {
            sign: sum(re.match(rf"{sign}\b", cell) is not None for cell in cells)
            for sign in ("yes", "partly", "no", "open")
        }
    yes = sum(row["yes"] for row in found.values())
    said = f"{yes} of {sum(map(sum, (row.values() for row in found.values())))} claims reproduce."
    return outcomes_of(found, "claims", said)


def error_beside_the_laboratorys() -> Axes:
    """Errors on the Esso Osaka, over those of the laboratory's own simulator."""
    text = (HERE / "scoreboard.md").read_text(encoding="utf-8")
    found = re.findall(r"^\| Esso Osaka, (\w+), mean ratio \| ([\d.]+) \|", text, re.M)
    rows = [(name, float(ours)) for name, ours in found]
    mean = float(np.mean([ratio for _, ratio in rows]))
    said = f"On logs that nothing was fitted to the error is {mean:.2f} of the laboratory's."
    return bars_of(rows, "error over that of the laboratory's simulator [-]", said)


SECTIONS: dict[str, tuple[Callable[[], Axes | Figure], ...]] = {
    "The log": (
        record_as_logged, log_with_a_fault, equations_between_signals, one_equation,
    ),
    "Missing physics": (
        fall_of_the_error, where_the_model_fails, ranking_of_candidates, force_against_motion,
        force_that_was_found,
        residual_force, where_and_what, force_against_everything, misfit_of_two_models,
        frequency_responses,
    ),
    "The fit": (
        measured_and_model, estimates_with_intervals, correlation_of_estimates,
        information_ellipses, profile_of_a_parameter, starts_of_a_multistart,
        whiteness_of_all_outputs, autocorrelation_of_an_output, estimates_on_line,
    ),
    "Predictions": (
        prediction_with_its_band, before_and_after, error_of_a_prediction, zigzag_with_overshoots,
        track_of_a_circle, phase_plane, sailing_polar,
    ),
    "The next trial": (
        designed_run, accuracy_to_expect, sensitivity_bars, designed_orders, sea_room,
        programme_of_runs, card_for_those_on_board,
    ),
    "Estimators": (errors_of_estimators,),
}  # fmt: skip
# Pictures of guides that no function of the package draws alone.
OTHERS: tuple[Callable[[], Axes | Figure], ...] = (
    first_fit, first_circle, first_candidates, signal_chain, exported_circle,
    how_often_missing_physics_is_found, how_often_on_other_vehicles, error_on_measured_data,
    times_of_peers, outcomes_of_damaged_logs, verdicts_on_papers, error_beside_the_laboratorys,
)  # fmt: skip
# Pages of whose tables pictures are drawn.
PAGES = (
    "missing_physics.md", "other_vehicles.md", "measured_data.md", "performance.md",
    "reliability.md", "published.md", "scoreboard.md",
)  # fmt: skip
# Sections whose pictures are of the dive come first; its search is made in one process.
OF_THE_DIVE = 4
HEAD = """# Gallery

Choose a picture to see the lines that draw it. A caption is what the picture says of itself, for
those who cannot see it. Each `plot_...` draws into axes of yours (`ax=`) and returns them.
The ferry and the dive are made in `docs/gallery.py`, which `make docs` runs.
"""


def drawn_here(draw: Callable[[], Axes | Figure], folder: Path) -> str:
    """Draw a picture, and return the Markdown that shows it and says what it shows."""
    picture = draw()
    figure = picture if isinstance(picture, Figure) else picture.figure
    said, file = report.finding(picture), f"{draw.__name__}.png"
    assert said, draw.__name__
    figure.savefig(folder / file, dpi=90, bbox_inches="tight")
    plt.close(figure)
    text = f"![{said}]({file})\n\n{said}\n"
    # Guides include a picture with what it says.
    (folder / f"{draw.__name__}.txt").write_text(text, encoding="utf-8")
    return text


def drawn_in_turn(names: Sequence[str], folder: Path) -> dict[str, str]:
    """Markdown of some pictures, by the function that draws each."""
    return {name: drawn_here(globals()[name], folder) for name in names}


def all_drawn(folder: Path) -> dict[str, str]:
    """Markdown of all pictures, drawn in two processes: what each calculates serves its own."""
    sections = [*SECTIONS.values(), OTHERS]
    shares = [
        [draw.__name__ for draws in half for draw in draws]
        for half in (sections[:OF_THE_DIVE], sections[OF_THE_DIVE:])
    ]
    with ProcessPoolExecutor(len(shares)) as pool:
        first, second = pool.map(partial(drawn_in_turn, folder=folder), shares)
    return first | second


def main(folder: Path = HERE / "gallery") -> None:
    """Draw all pictures and write their pages, unless those that are there are of these sources."""
    folder.mkdir(exist_ok=True)
    now = digest(Path(__file__), *(HERE / name for name in PAGES))
    if not changed(stamp := folder / "sources.sha256", now):
        return
    index, shown = [HEAD], all_drawn(folder)
    for section, pictures in SECTIONS.items():
        index += [f"## {section}", "", "::::{grid} 2 3 3 4", ":gutter: 2"]
        index += [":class-container: gallery", ""]
        for draw in pictures:
            lines = textwrap.dedent("\n".join(inspect.getsource(draw).splitlines()[2:]))
            title, picture = str(draw.__doc__).rstrip("."), shown[draw.__name__]
            page = f"---\norphan: true\n---\n# {title}\n\n{picture}\n```python\n{lines}\n```\n"
            used = ", ".join(
                f"{{func}}`~oed_sysid.results.{name}`"
                for name in dict.fromkeys(re.findall(r"report\.((?:plot|figure)_\w+)", lines))
            )
            page += f"\nSee {used}; all pictures: [gallery](index.md).\n"
            (folder / f"{draw.__name__}.md").write_text(page, encoding="utf-8")
            index += [f":::{{grid-item-card}} {title}", f":img-top: {draw.__name__}.png"]
            index += [f":link: {draw.__name__}", ":link-type: doc", ":::"]
        index += ["::::", ""]
    (folder / "index.md").write_text("\n".join(index), encoding="utf-8")
    stamp.write_text(now, encoding="utf-8")


if __name__ == "__main__":
    main()
