"""The browser application, driven as a user drives it, and its parts without a browser."""

from __future__ import annotations

import io
import json
import shlex
import socket
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from app_pages import (  # noqa: F401
    PATIENCE,
    at_fit,
    done,
    fine,
    following,
    opened,
    own_shelf,
    reopened,
    script,
    ship_folder,
    study_of_ship,
    testing,
    text_of,
)

from oed_sysid import Fit, load_problem, read_csv
from oed_sysid.app import commands, plans
from oed_sysid.app.launch import orders, start
from oed_sysid.app.records import archive, likely_test, read_uploads, simulated
from oed_sysid.app.study import Study
from oed_sysid.cli import BAD_INPUT, DONE, main
from oed_sysid.errors import OedSysidError


@pytest.mark.slow
def test_a_study_from_problem_to_report(ship: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    """The whole flow: fit, compare, improve, step back, rank; and the commands repeat it."""
    problem = load_problem(ship)
    app = opened(ship)
    assert app.header[0].value == problem.title
    app = done(at_fit(app), "fit")
    assert "The estimation converged." in text_of(app)
    app = done(following(app), "compare")
    assert "in 95 % band" in text_of(app)
    app = done(following(app), "improve")
    assert "records that nothing was fitted to" in text_of(app)
    effect = problem.effects[0].name
    keep = next(w for w in app.multiselect if w.label == "Effects to keep")
    app = done(fine(keep.set_value([effect]).run()), "kept")
    assert f"with {effect}" in text_of(app)
    app = done(following(app), "rank")
    assert "estimated together" in text_of(app)
    app = following(app)
    assert app.header[0].value == "Report"
    offered = {button.label for button in app.get("download_button")}
    assert {"Records (ZIP)", "Everything (ZIP)", "Report (HTML)"} <= offered
    lines = app.code[0].value.splitlines()
    verbs = [line.split()[1] for line in lines]
    assert verbs == ["check", "fit", "report", "compare", "improve", "compare", "rank"]

    from oed_sysid.app.visit import desk

    mine = [outcome.result for outcome in desk().results()]
    fits = [result for result in mine if isinstance(result, Fit)]
    here = next(result for result in fits if result.model.name == problem.model.name)
    train, test = problem.data().split(test=likely_test(problem.data().names))
    with zipfile.ZipFile(io.BytesIO(archive(train, test))) as packed:
        packed.extractall(tmp_path)
    monkeypatch.chdir(tmp_path)
    for line in (lines[0], lines[1], lines[-1]):
        assert main(shlex.split(line)[1:]) == DONE
    capsys.readouterr()
    there = Fit.load(tmp_path / "fit.json")
    np.testing.assert_allclose(there.estimates, here.estimates, rtol=1e-6)
    assert (tmp_path / "rank.html").is_file()


def test_shipped_problem_with_other_records() -> None:
    """Other records of a shipped problem can be chosen; fit and report are of these."""
    app = opened("nomoto_sparse_heading")
    for part, names in (("Validation records", []), ("Training records", ["fast_rudder"])):
        next(w for w in app.multiselect if w.label == part).set_value(names).run()
    app = done(at_fit(app), "fit")
    assert app.caption[0].value == "Fitted by multiple shooting to fast_rudder"
    while app.header[0].value != "Report":
        app = app.button(key="next").click().run()
    fine(app)
    offered = {button.label for button in app.get("download_button")}
    assert {"Fit (nominal.json)", "Problem folder (ZIP)", "Script (study.py)"} <= offered
    assert "estimator.fit(problem.model, train)" in app.code[-1].value


def test_files_of_the_user(ship: Path) -> None:
    """Uploaded files become records or say why not, and stay when the page is left."""
    good = (ship / "data" / "turning_circle.csv").read_bytes()
    app = opened(ship)
    app.button_group[0].set_value("My CSV files").run()
    bad = ("bad.csv", b"t,rudder\n0,1\n", "text/csv")
    files = [("circle.csv", good, "text/csv"), bad]
    app.file_uploader[0].set_value(files).run()
    assert not app.exception
    assert [error.value for error in app.error if "**bad.csv** was refused" in error.value]
    learn = next(w for w in app.multiselect if w.label == "Training records")
    assert list(learn.options) == ["circle"]
    app = app.button(key="next").click().run()
    app.button(key="next").click().run()
    assert [button.key for button in app.button if button.key == "ask:fit"]
    assert any("circle" in caption.value for caption in app.caption)


def test_columns_are_mapped_by_choice(ship: Path) -> None:
    """A log with other names becomes a record by choosing columns, and is there after a reload."""
    problem = load_problem(ship)
    record = problem.data()["turning_circle"]
    psi = record.output("psi")
    rows = zip(record.times, np.degrees(psi) % 360.0, record.input("rudder"), strict=True)
    lines = ["clock,compass [deg],helm [rad]", *(f"{1000 * t},{h},{u}" for t, h, u in rows)]
    app = opened(ship)
    app.button_group[0].set_value("My logs").run()
    content = "\n".join(lines).encode()
    app.file_uploader[0].set_value([("circle.csv", content, "text/csv")]).run()
    fine(app)
    assert app.info[0].value.startswith("Choose the column")
    key = f"keep:map:{ship}"
    app.selectbox(key=f"{key}:time").set_value("clock").run()
    app.selectbox(key=f"{key}:time unit").set_value("ms").run()
    assert app.selectbox(key=f"{key}:psi:field").value == "circle.compass [deg]"  # by its name
    app.selectbox(key=f"{key}:psi:field").set_value("not logged").run()
    fine(app)
    assert app.info[0].value.startswith("No output is mapped yet")
    app.selectbox(key=f"{key}:psi:field").set_value("circle.compass [deg]").run()
    assert app.text_input(key=f"{key}:psi:unit").value == "deg"
    app.checkbox(key=f"{key}:psi:wrap").check().run()
    app.selectbox(key=f"{key}:rudder:field").set_value("circle.helm [rad]").run()
    fine(app)
    again = fine(reopened(app, ship))
    assert again.selectbox(key=f"{key}:psi:field").value == "circle.compass [deg]"
    assert again.session_state[f"{key}:psi:wrap"] is True
    learn = next(w for w in again.multiselect if w.label == "Training records")
    assert learn.value == ["circle"]


def test_file_that_is_taken_back(ship: Path) -> None:
    """A file is forgotten when it is taken out, and only then."""
    content = (ship / "data" / "turning_circle.csv").read_bytes()
    app = opened(ship)
    app.button_group[0].set_value("My CSV files").run()
    app.file_uploader[0].set_value([("one.csv", content, "text/csv")]).run()
    assert app.session_state[f"files:{ship}"] == {"one.csv": content}
    for _ in range(2):
        app.run()
    assert app.session_state[f"files:{ship}"] == {"one.csv": content}
    app.file_uploader[0].set_value([("two.csv", content, "text/csv")]).run()
    assert set(app.session_state[f"files:{ship}"]) == {"two.csv"}


def test_nothing_is_downloaded_unasked(tmp_path: Path, monkeypatch) -> None:
    """A problem on records of others waits until the user wants them."""
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    monkeypatch.setattr(
        "oed_sysid.data.third_party._download", lambda *_: pytest.fail("a download")
    )
    app = opened("kvlcc2")
    assert app.button_group[0].value == "My CSV files"
    assert app.button_group[0].options[0] == "With the problem"


def test_a_record_cannot_be_learnt_from_and_judged_with(ship: Path) -> None:
    """Choosing one record for both is said in words."""
    app = opened(ship)
    for part in ("Training records", "Validation records"):
        next(w for w in app.multiselect if w.label == part).set_value(["zigzag_10_10"]).run()
    assert not app.exception
    assert "chosen for training and for validation" in app.error[0].value


def test_problem_that_does_not_exist(tmp_path: Path) -> None:
    """A wrong folder is answered with the package's own message."""
    app = testing.AppTest.from_function(
        script, kwargs={"problem": str(tmp_path / "none")}, default_timeout=PATIENCE
    ).run()
    assert not app.exception
    assert "There is no problem" in app.error[0].value


def test_uploads_are_checked_as_on_the_command_line(ship: Path, tmp_path: Path, capsys) -> None:
    """The message about a file is that of the command line."""
    content = b"t [s],rudder [deg]\n0,1\n1,x\n"
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    assert main(["fit", str(ship), str(path)]) == BAD_INPUT
    said = capsys.readouterr().err.removeprefix("Error: ").strip()
    records, refused, _ = read_uploads(load_problem(ship), {"log.csv": content})
    assert records is None
    assert refused["log.csv"] == said.replace(f"{tmp_path}/", "")


def test_records_survive_the_archive(study: Study, tmp_path: Path) -> None:
    """What is downloaded reads back as the same numbers."""
    with zipfile.ZipFile(io.BytesIO(archive(study.train, study.test))) as packed:
        packed.extractall(tmp_path)
    again = read_csv(tmp_path / "train", study.problem.channels)
    assert set(again.names) == set(study.training().names)
    for record in again:
        np.testing.assert_array_equal(record.outputs, study.training()[record.name].outputs)


def test_simulated_records_are_those_of_the_command(ship: Path, tmp_path: Path, capsys) -> None:
    """Simulated records equal what `oed-sysid simulate --truth` writes."""
    problem = load_problem(ship)
    assert main(["simulate", str(ship), "--truth", "--out", str(tmp_path)]) == DONE
    capsys.readouterr()
    theirs = read_csv(tmp_path, problem.channels)
    for record in simulated(problem):
        np.testing.assert_array_equal(record.outputs, theirs[record.name].outputs)


def test_design_command_finds_the_same_trial(study: Study, tmp_path: Path, monkeypatch) -> None:
    """The command shown for a design writes the commands that the page offers."""
    wish = plans.DesignWish(
        "zigzag_10_10",
        40.0,
        (("rudder", -np.radians(10), np.radians(10)),),
        (("rudder", np.radians(3)),),
    )
    outcome = plans.design(study, wish, lambda text: None)
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(commands.design(study, wish))[1:]) == DONE
    tables = [
        np.genfromtxt(io.BytesIO(text), delimiter=",", skip_header=1)
        for text in (plans.commands_csv(outcome.result), (tmp_path / "design.csv").read_bytes())
    ]
    np.testing.assert_allclose(*tables, atol=1e-6)
    assert np.abs(tables[0][:, 1]).max() <= np.radians(10) * (1 + 1e-9)
    assert outcome.result.assurance is not None


def test_efforts_are_those_of_the_command_line() -> None:
    """The same word means the same search."""
    from oed_sysid.cli.commands_plan import EFFORTS

    assert plans.EFFORTS == EFFORTS


def test_commands_name_model_noise_and_records(study: Study) -> None:
    """Commands carry every choice that changes the result."""
    odd = Study("my ship", "norrbin", study.problem, study.train, None, known_noise=True)
    line = commands.improve(odd, 2)
    assert shlex.split(line)[:5] == ["oed-sysid", "improve", "my ship", "--model", "norrbin"]
    assert "--known-noise" in line
    assert "--validate" not in line


def test_key_changes_with_content(study: Study) -> None:
    """Equal records have an equal key, other numbers another."""
    again = Study(study.source, "default", study.problem, study.train, study.test)
    swapped = Study(study.source, "default", study.problem, study.test, study.train)
    assert again.key == study.key
    assert swapped.key != study.key


def test_a_port_that_is_taken_is_said_before_an_address() -> None:
    """Nobody is sent to an address where another program answers."""
    with socket.socket() as other:
        other.bind(("localhost", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(OedSysidError, match=f"Port {port} is taken"):
            start(port=port, browser=False)


def test_server_answers_this_computer_only_and_reports_to_nobody() -> None:
    """No address but localhost, no usage statistics."""
    given = orders("remus_diving_plane", port=9000)
    assert "--server.address=localhost" in given
    assert "--browser.gatherUsageStats=false" in given
    assert given[-2:] == ["--", "remus_diving_plane"]
    assert Path(given[1]).is_file()


@pytest.mark.parametrize("arguments", [["--port", "80"], ["no_such_problem"]])
def test_command_that_cannot_start_says_so(arguments: list[str], capsys) -> None:
    """A wrong port or problem is bad input, before any server runs."""
    assert main(["app", "--no-browser", *arguments]) == BAD_INPUT
    assert capsys.readouterr().err.startswith("Error: ")


def test_missing_extra_is_named(monkeypatch, capsys) -> None:
    """Without streamlit the command says what to install."""
    monkeypatch.setitem(sys.modules, "streamlit", None)
    monkeypatch.setattr("oed_sysid.app.launch.find_spec", lambda name: None)
    assert main(["app"]) == BAD_INPUT
    assert 'pip install "oed_sysid[app]"' in capsys.readouterr().err


def test_application_is_not_imported_with_the_package() -> None:
    """Naming the commands costs no streamlit."""
    import subprocess

    code = (
        "import sys, json, oed_sysid.cli.application; print(json.dumps('streamlit' in sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(run.stdout) is False
