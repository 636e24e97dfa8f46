"""Parts of the browser application without a browser: columns, pictures, exports, the script."""

from __future__ import annotations

import io
import shlex
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from oed_sysid import (
    Channels,
    Dataset,
    Fit,
    Input,
    Output,
    Record,
    load_problem,
    rank_parameters,
    read_csv,
)

pytest.importorskip("streamlit", reason="needs the extra 'app'")
pytest.importorskip("plotly", reason="needs the extra 'app'")

from oed_sysid.app import advice, charts, mapping, pages, takeaway
from oed_sysid.app.choices import at_hand, measured_sets
from oed_sysid.app.jobs import Job
from oed_sysid.app.visit import Asked
from oed_sysid.cli import BAD_INPUT, main
from oed_sysid.cli.limit_words import with_limits
from oed_sysid.cli.options import line_of
from oed_sysid.cli.script import part_of, whole
from oed_sysid.cli.study import Outcome, Study, Task, grouped, options_of
from oed_sysid.cli.tasks import TASKS, known
from oed_sysid.cli.terminal import Shown
from oed_sysid.data.logs import LogMapping, Source
from oed_sysid.design.assurance import Assurance
from oed_sysid.errors import OedSysidError
from oed_sysid.evidence.locate import Located, Series
from oed_sysid.experiments.catalogue import catalogue_folder
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.disturbances import Place
from oed_sysid.results.chart import Chart, Mark
from oed_sysid.results.fit_plots import Said
from oed_sysid.results.improvement_plots import clearest
from oed_sysid.results.style import COLOURS, model_style

CHANNELS = Channels(
    (Input("rudder", "rad"),), (Output("psi", "rad", "heading"), Output("r", "rad/s"))
)


@pytest.fixture(name="study", scope="module")
def _study() -> Study:
    """A small problem with one simulated record on each side."""
    problem = load_problem("nomoto_sparse_heading")
    rng = np.random.default_rng(4)
    first, second = [
        simulate(problem.model, one, rng=rng, name=name)
        for name, one in list(problem.experiments.items())[:2]
    ]
    return Study("nomoto_sparse_heading", "default", problem, Dataset((first,)), Dataset((second,)))


@pytest.fixture(name="outcome", scope="module")
def _outcome(study: Study) -> Outcome:
    """Its fit, as the page keeps it."""
    return TASKS["fit"](study, Shown(), {})


def log_of(psi: np.ndarray, r: np.ndarray, rudder: np.ndarray, name: str = "run.csv") -> bytes:
    """A table with other names, units, signs and a heading within one turn."""
    lines = ["clock;compass [deg];gyro [deg/s];helm"]
    for index, (h, rate, helm) in enumerate(zip(psi, r, rudder, strict=True)):
        turned = np.degrees(h) % 360.0
        lines.append(f"{500 * index};{turned:.9f};{-np.degrees(rate):.9f};{1500 + 1000 * helm:.6f}")
    return "\n".join(lines).encode()


def test_columns_become_channels() -> None:
    """Names, units, signs, a servo's pulses and a wrapped heading come out as they went in."""
    t = 0.5 * np.arange(60)
    psi, r, rudder = 0.2 * t, np.full(60, 0.2), 0.1 * np.sign(np.sin(t))
    files = {name: log_of(psi, r, rudder) for name in ("run.csv", "again.csv")}
    opened = mapping.open_files(files, ("clock", "ms"))
    asked = LogMapping(
        {"rudder": Source("run.helm", unit="rad", factor=0.001, trim=1500.0)},
        {
            "psi": Source("run.compass [deg]", wrap=True),
            "r": Source("run.gyro [deg/s]", sign=-1),
        },
    )
    stock = mapping.imported(opened, asked, CHANNELS)
    records, refused = stock.records, stock.refused
    assert refused == {}
    assert records.names == ("run", "again")
    for record in records:
        np.testing.assert_allclose(record.times, t)
        np.testing.assert_allclose(record.output("psi"), psi, atol=1e-8)
        np.testing.assert_allclose(record.output("r"), r, atol=1e-8)
        np.testing.assert_allclose(record.input("rudder"), rudder, atol=1e-8)


def test_a_wrong_unit_is_refused_for_its_file_only() -> None:
    """A file that does not fit says why, and the others are read."""
    rows = "\n".join(f"{0.5 * n},{n}" for n in range(20))
    good = f"t [s],compass [deg]\n{rows}\n".encode()
    opened = mapping.open_files({"a.csv": good, "b.csv": good.replace(b"[deg]", b"[m]"),
                                 "c.csv": b""})  # fmt: skip
    still = {"rudder": Source(constant=0.0, unit="rad")}
    asked = LogMapping(still, {"psi": Source("a.compass [deg]")})
    stock = mapping.imported(opened, asked, CHANNELS)
    records, refused = stock.records, stock.refused
    assert records is not None, refused
    assert records.names == ("a",)
    assert set(refused) == {"b.csv", "c.csv"}
    assert "empty" in refused["c.csv"]


def test_axes_are_in_degrees_and_share_their_time() -> None:
    """Angles are drawn in degrees with that unit, every axis follows the last one's time."""
    t = np.arange(5.0)
    psi = np.linspace(0.0, np.pi, 5)
    record = Record("a", t, np.full((5, 1), 0.1), np.column_stack([psi, 0 * t]), CHANNELS)
    rows, noise = np.column_stack([psi, 0 * t]), np.full((5, 2), np.radians(1.0))
    said = Said(record, rows, noise, 0.0 * rows, noise[0], "nominal", model_style(0))
    figure = charts.signals(record, [said])
    by_name = {trace.name: trace for trace in reversed(figure.data)}
    np.testing.assert_allclose(by_name["measured"].y, np.degrees(psi))
    band = np.asarray(by_name["95 % (nominal)"].y)
    np.testing.assert_allclose(band[:5] - band[:4:-1], 2 * 1.96, rtol=1e-3)
    titles = [figure.layout[f"yaxis{n}"].title.text for n in ("", 2, 3)]
    assert titles == ["psi [deg]", "r [deg/s]", "[deg]"]
    assert [one.text for one in figure.layout.annotations][-1].startswith("rudder")
    assert figure.layout.xaxis.matches == figure.layout.xaxis2.matches == "x3"


def test_replay_moves_every_vehicle() -> None:
    """Each frame places measured and modelled vehicles where they are then, and turns them."""
    channels = Channels(
        (Input("rudder", "rad"),), (Output("x", "m"), Output("y", "m"), Output("psi", "rad"))
    )
    t = np.arange(11.0)
    rows = np.column_stack([t, 2 * t, np.full(11, np.pi / 2)])
    record = Record("a", t, np.zeros((11, 1)), rows, channels)
    figure = charts.replay(record, {"nominal": np.add(rows, (0.0, 1.0, -0.1))}, frames=3)
    middle = figure.frames[1]
    marks = [part for part in middle.data if part.type == "scatter"]
    hulls = [part for part in middle.data if part.type == "scatter3d"]
    assert [float(part.x[0]) for part in marks] == [10.0, 11.0]
    assert [float(part.y[0]) for part in marks] == [5.0, 5.0]
    assert float(marks[0].marker.angle) == pytest.approx(90.0)
    # The bow of a vehicle that heads east points east, that of the other 0.1 rad further north.
    bows = np.array([(part.x[0], part.y[0], part.z[0]) for part in hulls])
    ahead = 0.5 * np.array([(1.0, 0.0, 0.0), (np.cos(0.1), np.sin(0.1), 0.0)])
    np.testing.assert_allclose(bows, ahead, atol=1e-12)
    assert "heading 84.3°" in middle.layout.annotations[0].text
    alone = Record("b", t, np.zeros((11, 1)), rows[:, 2:], Channels(
        channels.inputs, channels.outputs[2:]))  # fmt: skip
    assert charts.track_axes(alone) is None
    assert {part.type for part in charts.replay(alone, {}, frames=3).data} == {"scatter3d"}


def test_rotation_turns_body_axes_into_north_east_down() -> None:
    """Orthonormal, right-handed; one angle alone turns about its own axis in the sense of SNAME."""
    turned = charts.rotation(0.3, -0.7, 2.1)
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turned) == pytest.approx(1.0)
    starboard_down = charts.rotation(np.pi / 2, 0.0, 0.0) @ (0.0, 1.0, 0.0)
    bow_up = charts.rotation(0.0, np.pi / 2, 0.0) @ (1.0, 0.0, 0.0)
    bow_east = charts.rotation(0.0, 0.0, np.pi / 2) @ (1.0, 0.0, 0.0)
    np.testing.assert_allclose(starboard_down, (0.0, 0.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(bow_up, (0.0, 0.0, -1.0), atol=1e-12)
    np.testing.assert_allclose(bow_east, (0.0, 1.0, 0.0), atol=1e-12)


def test_chain_is_coloured_by_gain() -> None:
    """The likeliest place is the darkest, one that chance explains has no colour."""
    places = (Place("force", "Z", "N"), Place("sensor", "theta", "rad"), Place("actuator", "fin"))
    gains = {"force Z": 4000.0, "sensor theta": 900.0, "actuator fin": 3.0}
    located = Located(places, gains, dict.fromkeys(gains, 0.1), (), (), {}, {})
    html = charts.chain(located)
    assert 'class="place l4 best" title="force Z' in html
    assert 'class="place l1" title="sensor theta' in html
    assert 'class="place l0" title="actuator fin' in html
    assert html.index("fin<") < html.index("Z<") < html.index("theta<")
    assert html.index("<h4>forces</h4>") < html.index("3,100 behind")


def test_design_that_leaves_its_limits_is_named() -> None:
    """More vehicles outside than may be is a risk, fewer is none."""
    stated = Assurance(150, 200, None, 0.3, {"z": 50}, {}, True)

    class Design:
        assurance = stated

    assert "DANGER: on 25% of the vehicles" in pages.risk(Design())
    Design.assurance = replace(stated, n_kept=196)
    assert pages.risk(Design()) == ""
    Design.assurance = replace(stated, n_kept=196, wanted=0.99)
    assert "Left first: z" in pages.risk(Design())


def test_corridor_reaches_the_limits(study: Study) -> None:
    """A slider's corridor, in degrees, replaces that of the problem; the command has its words."""
    problem = load_problem("remus_diving_plane")
    low, high = np.degrees((-0.2, 0.2))
    wish = {"like": "steps", "limit": (f"theta={low:.12g}:{high:.12g}",)}
    limits, _ = with_limits(problem.model, problem.limits, wish["limit"])
    assert limits.signals["theta"] == pytest.approx((-0.2, 0.2))
    assert limits.signals["z"] == problem.limits.signals["z"]
    line = line_of(TASKS["design"], replace(study, problem=problem), wish)
    assert f"--limit theta={low:.12g}:{high:.12g} " in line


def test_saved_fit_and_exports_are_the_fit(outcome: Outcome, tmp_path: Path) -> None:
    """The fit file loads as the same fit, and the exported model repeats its simulation."""
    fit = takeaway.fits_of([(Asked("Fit", "fit", ""), outcome)])["nominal"]
    (tmp_path / "nominal.json").write_bytes(takeaway.written("fit.json", fit.save))
    back = Fit.load(tmp_path / takeaway.file_of("nominal"))
    np.testing.assert_array_equal(back.estimates, fit.estimates)
    with zipfile.ZipFile(io.BytesIO(takeaway.model_archive(fit, "python"))) as packed:
        packed.extractall(tmp_path / "python")
    (module,) = (tmp_path / "python").glob("*.py")
    space: dict = {"__name__": "exported", "__file__": str(module)}
    exec(compile(module.read_text(), module.name, "exec"), space)
    assert space["simulate"](np.arange(3.0), np.full((3, 1), 0.1)).shape[0] == 3
    with pytest.raises(OedSysidError, match="no export"):
        takeaway.model_archive(fit, "fortran")


def test_problem_folder_carries_records_and_fits(
    study: Study, outcome: Outcome, tmp_path: Path
) -> None:
    """The folder opens as the same problem, its records and fits beside it; so does everything."""
    done = [(Asked("Fit", "fit", ""), outcome)]
    fits = takeaway.fits_of(done)
    with zipfile.ZipFile(io.BytesIO(takeaway.problem_archive(study, fits))) as packed:
        packed.extractall(tmp_path)
    folder = tmp_path / study.problem.name
    problem = load_problem(folder)
    assert problem.model.equations() == study.problem.model.equations()
    assert read_csv(folder / "train", problem.channels).names == study.training().names
    assert Fit.load(folder / "nominal.json").names == outcome.result.names
    takeaway.write_all(study, done, tmp_path / "all")
    written = {file.name for file in (tmp_path / "all").iterdir()}
    assert {"train", "study.py", "commands.sh", "nominal.json"} <= written


def script(study: Study, asked: dict[str, dict]) -> str:
    """A whole script that asks for tasks with their options."""
    return whole(study, [part_of(TASKS[name], study, options) for name, options in asked.items()])


@pytest.mark.slow
def test_script_repeats_the_study(study: Study, outcome: Outcome, tmp_path: Path) -> None:
    """The script runs beside the records and finds the same estimates."""
    takeaway.write_records(study, tmp_path)
    asked = {"check": {}, "fit": {}, "compare": {}, "rank": {"experiment": ("fast_rudder",)}}
    (tmp_path / "study.py").write_text(script(study, asked))
    run = subprocess.run(
        [sys.executable, tmp_path / "study.py"], capture_output=True, text=True, cwd="/"
    )
    assert run.returncode == 0, run.stderr
    again = Fit.load(tmp_path / "fit.json")
    np.testing.assert_allclose(again.estimates, outcome.result.estimates, rtol=1e-6)


@pytest.mark.slow
def test_script_of_every_task_runs(tmp_path: Path) -> None:
    """Search, diagnosis and a design, as the script says them, run to their end."""
    problem = load_problem("remus_diving_plane")
    train, test = problem.data().split(test=("test_steps", "test_zigzag_15_12"))
    small = Study("remus_diving_plane", "default", problem, Dataset((train[0],)), test)
    takeaway.write_records(small, tmp_path)
    wish = {"like": "steps", "duration": 30.0, "limit": ("theta=-20:20",)}
    plan = {"runs": 2, "patterns": ("steps",), "duration": 30.0, "rounds": 0}
    asked = {"diagnose": {}, "improve": {"max_effects": 1}, "design": wish, "programme": plan}
    (tmp_path / "study.py").write_text(script(small, asked))
    run = subprocess.run([sys.executable, tmp_path / "study.py"], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert Fit.load(tmp_path / "improved.json").dataset.names == small.training().names
    table = np.genfromtxt(tmp_path / "design.csv", delimiter=",", skip_header=1)
    assert table[-1, 0] >= 29.0


def test_next_step_follows_the_evidence(study: Study) -> None:
    """A misfit leads to a search, a right model to a trial, rivals to the trial that tells."""

    def after(**results: object) -> str:
        return advice.following(study, {n: SimpleNamespace(result=r, comparison=c)
                                        for n, (r, c) in results.items()}).page  # fmt: skip

    def predicted(relative: float) -> SimpleNamespace:
        best = SimpleNamespace(relative=relative, is_noise=relative < 1.1)
        return SimpleNamespace(best=best)

    def search(verdict: str, kind: str, *groups: tuple[str, ...]) -> SimpleNamespace:
        steps = [SimpleNamespace(group=group) for group in groups]
        return SimpleNamespace(verdict=verdict, remains=SimpleNamespace(kind=kind), steps=steps)

    fine, wrong = SimpleNamespace(suspect=False), SimpleNamespace(suspect=True)
    checked = {"check": (fine, None)}
    assert advice.following(replace(study, train=None), {}).page == advice.DATA
    assert after() == advice.CHECK
    assert after(check=(wrong, None)) == advice.DATA
    assert after(**checked) == advice.FIT
    assert after(**checked, fit=(None, predicted(134.0))) == advice.MISSING
    assert after(**checked, fit=(None, predicted(1.0))) == advice.PLAN
    found = search("missing", "adequate", ("drag",))
    assert after(**checked, improve=(found, None)) == advice.EXPORT
    alike = search("missing", "adequate", ("drag", "lag"))
    assert after(**checked, improve=(alike, None)) == advice.PLAN
    assert after(**checked, improve=(alike, None), design=(None, None)) == advice.EXPORT
    left = search("unexplained", "structure missing")
    assert after(**checked, improve=(left, None)) == advice.PLAN


def test_a_chart_is_the_same_in_print_and_on_screen() -> None:
    """One description: marks, errors and the line across have the same numbers in both."""
    texts = ["134", "1.07"]
    marks = (Mark([0, 1], [134.0, 1.07], "validation", COLOURS[1], "-", "o", texts=texts),
             Mark([0.0, 0.5], [2.0, 3.0], "mean", COLOURS[0], "", "o", [0.5, 0.25]))  # fmt: skip
    made = Chart(marks, "", "error", "It falls.", level=1.0, band=0.05, logarithmic=True,
                 names=["nominal", "+ drag"])  # fmt: skip
    ax, figure = made.on(), charts.drawn(made)
    printed = [line.get_xydata() for line in ax.lines if len(line.get_xdata()) == 2]
    for trace in figure.data:
        shown = np.column_stack([trace.x, trace.y])
        assert any(np.array_equal(shown, drawn) for drawn in printed)
    bars = ax.containers[0][2][0].get_segments()
    np.testing.assert_allclose(
        [0.5 * (end[1] - start[1]) for start, end in bars], figure.data[1].error_y.array
    )
    assert [tick.get_text() for tick in ax.get_xticklabels()] == list(figure.layout.xaxis.ticktext)
    assert ax.get_yscale() == figure.layout.yaxis.type == "log"
    assert [(one.y0, one.y1) for one in figure.layout.shapes] == [(0.95, 1.05), (1.0, 1.0)]


def test_what_was_found_is_carried_on(study: Study, outcome: Outcome) -> None:
    """A trial is planned for the fit at hand; without one, for a fit of the training records."""
    fit = next(iter(outcome.fits.values()))
    held = replace(study, saved={"improved.json": fit})
    assert known(held, Path("improved.json"), Shown()) is fit
    assert known(held, None, Shown()) is study.problem.model
    again = known(held, Path("fit.json"), Shown())
    assert isinstance(again, Fit)
    np.testing.assert_allclose(again.estimates, fit.estimates, rtol=1e-6)
    asked = {"experiment": ("fast_rudder",), "after": Path("improved.json")}
    ranking = TASKS["rank"](held.without_records(), Shown(), asked).result
    run = study.problem.experiment("fast_rudder")
    expected = rank_parameters(fit.model, [run])
    assert ranking.to_dict() == expected.to_dict()
    assert ranking.to_dict() != rank_parameters(study.problem.model, [run]).to_dict()


def test_a_job_tells_its_share() -> None:
    """Of a job that told that 30 s are left, after 10 s a quarter is over."""
    job = Job(began=time.monotonic() - 10.0)
    assert job.share is None
    job.end_expected = job.began + 40.0
    assert job.share == pytest.approx(0.25, abs=0.01)


def test_measured_sets_are_known_where_they_are(tmp_path: Path, monkeypatch) -> None:
    """A problem names its measured files; they are at hand when all of them are there."""
    folder = catalogue_folder() / "roll_decay"
    files = measured_sets(folder)
    assert files
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    assert not at_hand(folder)
    for file in files:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).touch()
    assert at_hand(folder)
    assert at_hand(catalogue_folder() / "remus_diving_plane")
    assert not at_hand(catalogue_folder() / "nomoto_sparse_heading")


def test_residual_force_is_first_shown_against_the_signal_that_explains_it() -> None:
    """A force that is cubic in one of two signals stands against that one."""
    rng = np.random.default_rng(3)
    times = np.linspace(0.0, 60.0, 601)
    speed, other = np.sin(0.7 * times), np.cos(0.31 * times)
    force = (speed**3 + 0.05 * rng.standard_normal(times.size))[:, None]
    series = Series(times, force, np.full_like(force, 0.05))
    places = (Place("force", "Z", "N"),)
    located = Located(places, {"force Z": 90.0}, {"force Z": 0.1}, ("Z",), (series,), {}, {})
    assert clearest(located, "Z", {"other": other, "speed": speed}) == "speed"
    assert clearest(located, "Z", {"speed": speed, "other": other}) == "speed"


@pytest.mark.parametrize(
    ("task", "wish"),
    [
        ("improve", {"max_effects": 2}),
        ("compare", {"added": ("a", "b+c")}),
        ("rank", {"experiment": ("fast_rudder",)}),
        ("design", {"like": "fast_rudder", "duration": 40.5, "limit": ("rudder=-10:10",),
                    "discriminate": ("a", "b"), "effort": "normal", "certainty": 0.9, "seed": 3}),
        ("programme", {"runs": 3, "hours": 1.5, "turnaround": 5.0, "criterion": "D",
                       "sea": "calm", "after": Path("fit.json")}),
    ],
)  # fmt: skip
def test_the_command_that_is_shown_asks_for_the_same(
    task: str, wish: dict, study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command line reads from the shown command what the page was given."""
    asked: list[tuple[Study, dict]] = []

    def work(row: Task, about: Study, show: object, options: dict) -> None:
        asked.append((about, options))
        raise OedSysidError("asked for")

    monkeypatch.setattr(Task, "__call__", work)
    monkeypatch.chdir(tmp_path)
    takeaway.write_records(study, tmp_path)
    assert main(shlex.split(line_of(TASKS[task], study, wish))[1:]) == BAD_INPUT
    ((about, options),) = asked
    defaults = {one.name: one.default for one in options_of(TASKS[task].run)}
    assert grouped(TASKS[task].run, options) == grouped(TASKS[task].run, {**defaults, **wish})
    if "files" in TASKS[task].reads:
        assert about.training().names == study.training().names
