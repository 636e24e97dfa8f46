"""The command line: what it reads, prints, writes and refuses."""

from __future__ import annotations

import json
import runpy
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import told
from marks import slow
from plain_pages import plain_pages  # noqa: F401

from benchmarks.tables import tables
from oed_sysid import Fit, load_problem, new_problem, replayed, simulate, write_csv
from oed_sysid.cli import BAD_INPUT, DONE, NO_RESULT, SUSPECT, UNEXPECTED, main
from oed_sysid.cli.arguments import spread
from oed_sysid.cli.tasks import write_runs
from oed_sysid.cli.terminal import answer
from oed_sysid.errors import DataError, FileError, ProblemError
from oed_sysid.runtime.files import check_place, make_folder, write_text

TABLES = tables(__file__)
NOMOTO = """
from oed_sysid import Experiment, Input, Model, Output, Parameter, Problem, State
from oed_sysid.experiments.manoeuvres import ZigZag

model = Model(
    name="Nomoto",
    states=(State("psi", "rad"), State("r", "rad/s", scale=0.05)),
    inputs=(Input("rudder", "rad"),),
    outputs=(Output("psi", "rad", noise_std=0.003), Output("r", "rad/s", noise_std=0.001)),
    kinematics={"psi": "r", "r": "(K*rudder - r)/T"},
    parameters=(Parameter("K", 0.1, "1/s"), Parameter("T", 8.0, "s", lower=0.1)),
)
experiments = {
    name: Experiment(name, ZigZag("rudder", angle, angle), duration=80.0, sample_time=0.5)
    for name, angle in (("zigzag_10", 0.17), ("zigzag_20", 0.35))
}
problem = Problem("ferry", model, title="A ferry", experiments=experiments)
"""


@pytest.fixture(name="ferry")
def _ferry(tmp_path: Path) -> Path:
    """A user's own problem folder."""
    folder = tmp_path / "ferry"
    folder.mkdir()
    (folder / "problem.py").write_text(NOMOTO)
    return folder


@pytest.mark.parametrize(("given", "expected"), TABLES["spread"].items())
def test_values_after_one_option_are_spread(given: str, expected: str) -> None:
    """An option in front of several values is repeated before each, and nothing else changes."""
    older = {"--train": "", "--records": "", "--test": "--limit"}
    assert spread(given.split(), ["--with", "--limit"], older) == expected.split()


def test_simulate_then_fit_recovers_the_model(ferry: Path, tmp_path: Path, capsys) -> None:
    """What `simulate` writes, `fit` reads, and the intervals hold the simulated values."""
    runs, results = tmp_path / "runs", tmp_path / "results"
    assert main(["simulate", str(ferry), "--out", str(runs), "--seed", "3"]) == DONE
    files = sorted(str(file) for file in runs.glob("*.csv"))
    assert [Path(file).stem for file in files] == ["zigzag_10", "zigzag_20"]
    capsys.readouterr()
    result = told(results, ["fit", ferry, *files])
    printed = capsys.readouterr()
    assert "converged" in printed.out
    assert str(results / "told.json") in printed.err
    assert result["records"] == ["zigzag_10", "zigzag_20"]
    for parameter, truth in zip(result["parameters"], (0.1, 8.0), strict=True):
        assert abs(parameter["value"] - truth) < 5 * parameter["std_error"]
        assert parameter["std_error"] < 0.05 * truth


def test_one_experiment_goes_to_one_file(ferry: Path, tmp_path: Path, capsys) -> None:
    """--out names a file for one experiment and is refused for two, with the way out."""
    file = tmp_path / "one.csv"
    arguments = ["simulate", str(ferry), "--out", str(file)]
    assert main(arguments) == BAD_INPUT
    assert "--experiment" in capsys.readouterr().err
    assert not file.exists()
    assert main([*arguments, "--experiment", "zigzag_20"]) == DONE
    assert file.read_text().startswith("t [s],rudder [rad],psi [rad],r [rad/s]")


def test_problems_lists_and_describes(ferry: Path, tmp_path: Path, capsys) -> None:
    """A problem of the user's own is described with its equations and experiments."""
    assert told(tmp_path, ["problems", ferry])["free_parameters"] == ["K", "T"]
    printed = capsys.readouterr().out
    assert "r' = (K rudder - r)/T" in printed
    assert "zigzag_20" in printed
    assert main(["problems"]) == DONE
    assert "remus_diving_plane" in capsys.readouterr().out


def test_model_that_diverges_is_said(ferry: Path, tmp_path: Path, capsys) -> None:
    """A model that runs off to 1e49 is bad input: its state, when, and what to look for."""
    unstable = NOMOTO.replace("(K*rudder - r)/T", "(K*rudder + r*11)/T")
    (ferry / "problem.py").write_text(unstable)
    out = tmp_path / "runs"
    assert main(["simulate", str(ferry), "--experiment", "zigzag_10", "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "'Nomoto' diverged between t = " in said
    assert "Check signs of damping and stiffness" in said
    assert not list(out.glob("*.csv"))


def test_debug_shows_the_traceback(ferry: Path, capsys) -> None:
    """--debug works at any place and shows where the error arose."""
    assert main(["fit", str(ferry), "--debug", "missing.csv"]) == BAD_INPUT
    assert "Traceback" in capsys.readouterr().err


def test_unexpected_error_tells_how_to_report(ferry: Path, capsys, monkeypatch) -> None:
    """An error that is the program's own fault has its own code and mentions --debug."""

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("broken inside")

    monkeypatch.setattr("oed_sysid.experiments.problem.load_problem", fail)
    assert main(["problems", str(ferry)]) == UNEXPECTED
    printed = capsys.readouterr().err
    assert "broken inside" in printed
    assert "--debug" in printed
    assert "Traceback" not in printed


def test_fit_that_does_not_converge_has_its_own_code(ferry: Path, tmp_path: Path) -> None:
    """A record without any excitation and a hopeless model give no usable result: code 1."""
    text = (ferry / "problem.py").read_text()
    # A growing mode of 1/s cannot follow 80 s of a stable ship from any start state.
    hopeless = text.replace("(K*rudder - r)/T", "(K*rudder - r)/T + 100*r/T + 3*T*r**3")
    file = tmp_path / "one.csv"
    assert main(["simulate", str(ferry), "--experiment", "zigzag_20", "--out", str(file)]) == DONE
    (ferry / "problem.py").write_text(hopeless)
    assert main(["fit", str(ferry), str(file)]) == NO_RESULT


def test_several_experiments_after_one_option(ferry: Path, tmp_path: Path, capsys) -> None:
    """--experiment takes one name or many, and all by default."""
    one, both, every = (
        told(tmp_path, ["rank", ferry, *given])["ranking"]
        for given in (["--experiment", "zigzag_10"], ["--experiment", "zigzag_10", "zigzag_20"], [])
    )
    assert both["runs"] == ["zigzag_10", "zigzag_20"]
    assert every == both
    errors = [{row["name"]: row["error"] for row in r["parameters"]} for r in (one, both)]
    # The second zigzag adds information on each parameter.
    assert all(errors[0][name] > errors[1][name] for name in ("K", "T"))


def test_rank_at_sea_with_other_noise_and_priors(ferry: Path, tmp_path, capsys) -> None:
    """Twice the noise doubles the errors, a sea enlarges them, priors bound them."""
    arguments = ["rank", str(ferry), "--experiment", "zigzag_10"]
    errors = []
    outputs = load_problem(ferry).model.outputs
    double = [f"{output.name}={2 * output.noise_std}" for output in outputs]
    for more in ([], ["--noise", *double], ["--sea", "moderate"], ["--priors", "1e-6"]):
        result = told(tmp_path, [*arguments, *more])
        errors.append({row["name"]: row["error"] for row in result["ranking"]["parameters"]})
        assert result["subset"]["identifiable"]
    assert {n: 2 * e for n, e in errors[0].items()} == pytest.approx(errors[1], rel=1e-6)
    assert all(errors[2][name] > errors[0][name] for name in errors[0])
    assert all(error <= 1e-6 for error in errors[3].values())
    for wrong in (["--noise", "nothing=1"], ["--noise", "r"], ["--priors", "much"]):
        assert main([*arguments, *wrong]) != DONE


def test_rank_of_records_equals_rank_of_their_experiments(ferry: Path, tmp_path, capsys) -> None:
    """A noise-free record tells as much as the experiment that gave it."""
    file = tmp_path / "zigzag_10.csv"
    simulated = ["simulate", str(ferry), "--experiment", "zigzag_10", "--no-noise"]
    assert main([*simulated, "--out", str(file)]) == DONE
    errors = []
    for runs in ([str(file)], ["--experiment", "zigzag_10"]):
        rows = told(tmp_path, ["rank", ferry, *runs])["ranking"]["parameters"]
        errors.append({row["name"]: row["error"] for row in rows})
    assert errors[0] == pytest.approx(errors[1], rel=0.05)
    arguments = ["rank", str(ferry), str(file), "--experiment", "zigzag_10"]
    assert main(arguments) == BAD_INPUT


def test_advice_on_noise_names_the_option(ferry: Path, tmp_path: Path, capsys) -> None:
    """A model whose noise is not known is simulated with the option that its error names."""
    code = NOMOTO.replace(", noise_std=0.003", "").replace(", noise_std=0.001", "")
    (ferry / "problem.py").write_text(code)
    line = ["simulate", str(ferry), "--out", str(tmp_path / "runs")]
    assert main(line) == BAD_INPUT
    assert "--no-noise" in capsys.readouterr().err
    assert main([*line, "--no-noise"]) == DONE


def test_suspect_log_ends_with_4_report_page_and_copies(tmp_path: Path, capsys) -> None:
    """A wrong sign ends with 4, names the line, and its corrected copies pass."""
    problem = load_problem("remus_diving_plane")
    run = problem.experiments["zigzag_10_10"]
    record = simulate(problem.model, replace(run, duration=45.0), rng=np.random.default_rng(8))
    turned = np.where(np.array(problem.model.output_names) == "theta", -1.0, 1.0)
    log = tmp_path / "zigzag.csv"
    write_csv(record.with_outputs(turned * record.outputs), log)
    page, fixed = tmp_path / "check.html", tmp_path / "fixed"
    command = ["check", "remus_diving_plane", log, "--html", page, "--fix", fixed]
    stored = told(tmp_path, command, SUSPECT)
    said = capsys.readouterr()
    assert 'Output("theta", "rad", sign=-1)' in said.out
    assert "Corrected in the copies" in said.err
    assert stored["findings"][0]["kind"] == "sign"
    assert stored["findings"][0]["signals"] == ["theta"]
    assert "theta has the wrong sign" in page.read_text(encoding="utf-8")
    assert main(["check", "remus_diving_plane", str(fixed)]) == 0


@pytest.mark.parametrize(
    ("text", "terminal", "no_color", "red"),
    [
        ("DANGER: limits are left.", True, None, True),
        ("DANGER: limits are left.", True, "", True),
        ("DANGER: limits are left.", True, "1", False),
        ("DANGER: limits are left.", False, None, False),
        ("Two runs.", True, None, False),
    ],
)
def test_danger_is_red_on_a_terminal_only(
    text: str, terminal: bool, no_color: str | None, red: bool, monkeypatch, capsys
) -> None:
    """Files, pipes and readers who set NO_COLOR get the plain line, and the report stays plain."""
    monkeypatch.delenv("NO_COLOR", raising=False)
    if no_color is not None:
        monkeypatch.setenv("NO_COLOR", no_color)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal, raising=False)
    answer(text, "The rest.")
    first, _, rest = capsys.readouterr().out.partition("\n")
    assert first == (f"\x1b[1;31m{text}\x1b[0m" if red else text)
    assert rest == "\nThe rest.\n"


SHIP = "nomoto_sparse_heading"


@pytest.fixture(name="place")
def _place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with a file in the way, an empty folder and a short log."""
    monkeypatch.chdir(tmp_path)
    Path("afile").write_text("in the way")
    Path("folder").mkdir()
    rows = [f"{0.5 * i},{0.1 * (i % 7 > 3)},{0.01 * i % 0.3}" for i in range(40)]
    Path("log.csv").write_text("\n".join(["t [s],delta [rad],psi [rad]", *rows]) + "\n")
    return tmp_path


def names(folder: Path) -> set[str]:
    """Everything below a folder."""
    return {str(one.relative_to(folder)) for one in folder.rglob("*")}


A_FILE = "afile' is a file where a folder is needed. Move it away"
REFUSED = [*((line, A_FILE) for line in TABLES["below_a_file"]), *TABLES["refused"].items()]


@pytest.mark.parametrize(("line", "words"), REFUSED)
def test_refused_in_words(line: str, words: str, ship: Path, place: Path, capsys) -> None:
    """A mistake is said in words with the right choices and status 2; nothing is made of it."""
    before = names(place)
    assert main(line.format(ship=ship).split()) == BAD_INPUT
    said = capsys.readouterr().err
    assert words in said
    assert "Traceback" not in said
    assert names(place) == before


def test_device_is_a_place(place: Path) -> None:
    """What is no regular file, such as /dev/null, takes a result."""
    line = f"rank {SHIP} --experiment zigzag_15_15 --json /dev/null --quiet"
    assert main(line.split()) == DONE


def test_files_say_what_stands_in_the_way(place: Path) -> None:
    """Files, folders and problems below a file have the same words."""
    words = "'.*afile' is a file where a folder is needed"
    with pytest.raises(FileError, match=words):
        write_text("afile/x/y.txt", "text")
    with pytest.raises(FileError, match=words):
        make_folder("afile/x")
    with pytest.raises(FileError, match=words):
        make_folder("afile")
    with pytest.raises(ProblemError, match=words):
        new_problem("afile/boat")


def test_check_leaves_nothing_behind(place: Path) -> None:
    """A place that can be written to passes, be it there or not, and stays as it was."""
    before = names(place)
    check_place("new/deep/fit.json")
    check_place("new/deep", folder=True)
    check_place("log.csv")
    check_place("folder", folder=True)
    assert names(place) == before


def test_no_permission(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that the user may not write to is named."""
    monkeypatch.setattr("os.access", lambda path, mode: False)
    with pytest.raises(FileError, match=r"you have no permission to write in '.*folder'"):
        check_place("folder/fit.json")
    with pytest.raises(FileError, match=r"'log\.csv' cannot be written: it is write-protected"):
        check_place("log.csv")


def test_device_is_no_folder(place: Path) -> None:
    """Files cannot be put below /dev/null."""
    with pytest.raises(FileError, match="'/dev/null' is no folder, and one is needed there"):
        check_place("/dev/null/x.csv")


SAVERS = ("fit", "improve")
READERS = ("report", "export", "compare", "design", "programme")


@pytest.fixture(name="ship", scope="module")
def _ship(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The starter folder with a fit, an improved fit, and what else the commands write."""
    folder = tmp_path_factory.mktemp("cli") / "my_ship"
    assert main(["new", str(folder)]) == DONE
    zigzags = [str(folder / "data" / f"zigzag_{angle}.csv") for angle in ("10_10", "20_20")]
    circle = str(folder / "data" / "turning_circle.csv")
    for command in SAVERS:
        line = [command, str(folder), *zigzags, "--validate", circle, "--known-noise", "--quiet"]
        line += ["--save", str(folder / f"{command}_saved.json")]
        line += ["--json", str(folder / f"{command}_numbers.json")]
        page = ["--html", str(folder / "improve_page.html")] if command == "improve" else []
        assert main([*line, *page]) in (DONE, NO_RESULT)
    return folder


def read(reader: str, ship: Path, saved: Path, out: Path) -> int:
    """Let a command go on from a file; what it finds goes to ``out``."""
    data = ship / "data"
    circle = str(data / "turning_circle.csv")
    shared = ["--patterns", "zigzag_10_10", "--rounds", "0", "--runs", "1"]
    lines = {
        "report": ["report", saved, "--validate", circle, "--out", out.with_suffix(".html")],
        "export": ["export", saved, "--as", "python", "--out", out.with_suffix(".py")],
        "compare": ["compare", ship, data / "zigzag_10_10.csv", "--validate", circle,
                    "--with", saved, "--known-noise", "--disturbances", "none", "--json", out],
        "design": ["design", ship, "--after", saved, "--duration", "40", "--json", out],
        "programme": ["programme", ship, "--after", saved, *shared, "--duration", "60",
                      "--json", out],
    }  # fmt: skip
    return main([*map(str, lines[reader]), "--quiet"])


def test_improve_finds_what_was_hidden(ship: Path) -> None:
    """The hidden effect is added, and the error on the validation circle falls to the noise."""
    stored = json.loads((ship / "improve_numbers.json").read_text())
    hidden = "yaw_quadratic_damping"
    assert stored["verdict"] == "missing"
    assert [step["added"] for step in stored["steps"]] == [hidden]
    assert stored["base_error"]["test"] > 3.0
    assert stored["final_error"]["test"] == pytest.approx(1.0, abs=0.1)
    assert stored["ranking"][0]["effect"] == hidden
    (amplitude,) = [one for one in stored["parameters"] if one["name"] == "E_yaw"]
    assert abs(amplitude["value"] - 1.5) < 4 * amplitude["std_error"]
    page = (ship / "improve_page.html").read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>")


@pytest.mark.parametrize(
    ("saver", "reader"),
    [
        *(("improve", reader) for reader in READERS[:3]),
        *slow(*(("improve", reader) for reader in READERS[3:])),
        *slow(*(("fit", reader) for reader in READERS)),
    ],
)
def test_saved_model_goes_on(saver: str, reader: str, ship: Path, tmp_path: Path) -> None:
    """A reader of a saved fit works with its parameters, those that were found included."""
    saved, out = ship / f"{saver}_saved.json", tmp_path / "out.json"
    fit = Fit.load(saved)
    assert (saver == "improve") == ("E_yaw" in fit.values)
    assert read(reader, ship, saved, out) == DONE
    if reader == "report":
        page = out.with_suffix(".html").read_text(encoding="utf-8")
        assert all(name in page for name in ("turning_circle", "zigzag_20_20"))
        assert ("E_yaw" in page) == (saver == "improve")
    elif reader == "export":
        module = runpy.run_path(str(out.with_suffix(".py")))
        written, runs = module["PARAMETERS"], replayed(fit).values
        assert {name: written[name] for name in runs} == pytest.approx(runs)
    elif reader == "compare":
        models = {one["label"]: one["relative"] for one in json.loads(out.read_text())["models"]}
        better = models[f"{saver}_saved"] < 1.2
        assert better == (saver == "improve")
        assert models["nominal"] > 3.0
    else:
        found = {one["name"]: one for one in json.loads(out.read_text())["parameters"]}
        assert set(found) == set(fit.names)
        if reader == "design":
            before = {name: one["before"] for name, one in found.items()}
            assert before == pytest.approx(fit.std_errors, rel=0.01)


@pytest.mark.parametrize("reader", ["report", "export", "compare", "design"])
@pytest.mark.parametrize("kind", ["improve_numbers.json", "improve_page.html", "data"])
def test_other_files_are_refused_in_words(
    reader: str, kind: str, ship: Path, tmp_path: Path, capsys
) -> None:
    """Numbers, pages and folders hold no model: the message says which file would."""
    assert read(reader, ship, ship / kind, tmp_path / "out.json") == BAD_INPUT
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert str(ship / kind) in said or Path(kind).name in said
    assert "--save" in said or "folder" in said


def test_saved_model_of_another_vehicle_is_refused(ship: Path, tmp_path: Path, capsys) -> None:
    """A fit with other channels cannot be compared on these records, and is told so."""
    other = tmp_path / "other"
    shutil.copytree(ship, other)
    text = (other / "problem.py").read_text()
    (other / "problem.py").write_text(text.replace('Output("r"', 'Output("yaw_rate_sensor"'))
    assert np.count_nonzero(text != (other / "problem.py").read_text()) == 1
    line = ["compare", str(other), str(other / "data"), "--validate", str(other / "data")]
    assert main([*line, "--with", str(ship / "fit_saved.json")]) == BAD_INPUT
    assert capsys.readouterr().err
    for absent in ("data/zigzag_10_10.csv", "missing.json"):
        assert main(["report", str(ship / absent)]) == BAD_INPUT


def test_two_records_never_share_a_file(tmp_path: Path) -> None:
    """Names that differ only in what a file name cannot hold are refused, nothing is written."""
    problem = load_problem(SHIP)
    run = next(iter(problem.experiments.values()))
    one = simulate(problem.model, run, noise=False)
    with pytest.raises(DataError, match="would be one file"):
        write_runs([one.rename("a/b"), one.rename("a_b")], tmp_path / "runs")
    assert not (tmp_path / "runs").exists()
    assert [file.name for file in write_runs([one.rename("a/b")], tmp_path)] == ["a_b.csv"]


def test_a_fit_of_held_samples_counts_what_was_measured(ferry: Path, tmp_path: Path) -> None:
    """A heading that is held for five samples reaches the estimation once in five."""
    study = load_problem(ferry)
    rng = np.random.default_rng(1)
    record = simulate(study.model, study.experiments["zigzag_20"], rng=rng)
    outputs = record.outputs.copy()
    outputs[:, 0] = np.repeat(outputs[::5, 0], 5)[: len(outputs)]
    log, saved = tmp_path / "held.csv", tmp_path / "fit.json"
    write_csv(replace(record, outputs=outputs), log)
    assert main(["fit", str(ferry), str(log), "--save", str(saved)]) == DONE
    heading, rate = np.isfinite(Fit.load(saved).dataset[0].outputs).sum(axis=0)
    assert heading == -(-len(outputs) // 5)
    assert rate == len(outputs)
