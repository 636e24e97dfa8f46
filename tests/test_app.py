"""The browser application, driven as a user drives it, and its parts without a browser."""

from __future__ import annotations

import io
import json
import shlex
import sys
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest

from oed_sysid import Fit, load_problem, new_problem, read_csv
from oed_sysid.app import commands, plans, tasks
from oed_sysid.app.jobs import Desk
from oed_sysid.app.launch import orders
from oed_sysid.app.records import archive, likely_test, read_uploads, simulated
from oed_sysid.app.study import Study
from oed_sysid.cli import BAD_INPUT, DONE, main
from oed_sysid.errors import OedSysidError

testing = pytest.importorskip("streamlit.testing.v1", reason="needs the extra 'app'")
PATIENCE = 120.0


def script(problem: str | None) -> None:
    """What streamlit runs."""
    from oed_sysid.app.frame import show

    show(problem)


def opened(problem: object):
    """The application, first page drawn."""
    app = testing.AppTest.from_function(
        script, kwargs={"problem": str(problem)}, default_timeout=PATIENCE
    )
    return fine(app.run())


def fine(app):
    """The application, once nobody is told that anything is wrong."""
    assert not app.exception
    assert not app.error, [error.value for error in app.error]
    return app


def following(app):
    """The next page."""
    return fine(app.button(key="next").click().run())


def at_fit(app):
    """The page Fit, the check of the log behind it."""
    from oed_sysid.app.panels import desk

    app = following(app)
    assert app.header[0].value == "Check the log"
    desk().wait()
    return following(fine(app.run()))


def done(app, button: str):
    """The page after the work behind a button."""
    from oed_sysid.app.panels import desk

    app.button(key=f"ask:{button}").click().run()
    desk().wait()
    return fine(app.run())


def text_of(app) -> str:
    """Everything that reports say on a page."""
    return "\n".join(part.value for part in app.get("html") if "<style>" not in part.value)


@pytest.fixture(name="ship", scope="module")
def _ship(tmp_path_factory) -> Path:
    """The folder that `oed-sysid new` writes."""
    return new_problem(tmp_path_factory.mktemp("app") / "my_ship")


@pytest.fixture(name="study")
def _study(ship: Path) -> Study:
    """Its records, the last one validation."""
    problem = load_problem(ship)
    train, test = problem.data().split(test="zigzag_20_20")
    return Study(str(ship), "default", problem, train, test)


def test_a_study_from_problem_to_report(ship: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    """The whole flow: fit, compare, improve, step back, rank; and the commands repeat it."""
    app = opened(ship)
    assert app.header[0].value == load_problem(ship).title
    app = done(at_fit(app), "fit")
    assert "The estimation converged." in text_of(app)
    app = done(following(app), "compare")
    assert "in 95 % band" in text_of(app)
    app = done(following(app), "improve")
    assert "records that nothing was fitted to" in text_of(app)
    effect = load_problem(ship).effects[0].name
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

    from oed_sysid.app.panels import desk

    mine = [job.result.result for job in desk()._jobs.values() if job.state == "done"]
    problem = load_problem(ship)
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


def test_shipped_problem_with_other_records(monkeypatch) -> None:
    """On a shipped problem, fewer records can be chosen, and the fit is of these."""
    monkeypatch.setattr(tasks, "MultipleShooting", _Quick)
    app = opened("remus_diving_plane")
    learn = next(w for w in app.multiselect if w.label == "Learn from")
    assert learn.value == ["train_steps", "train_zigzag_10_10", "train_zigzag_5_5"]
    learn.set_value(["train_zigzag_5_5"]).run()
    app = done(at_fit(app), "fit")
    assert app.caption[0].value == "Fitted by multiple shooting to train_zigzag_5_5"
    assert "Z_uw" in text_of(app)


class _Quick:
    """Multiple shooting that stops early: here only the way to it is tested."""

    def __init__(self, **settings) -> None:
        from oed_sysid import MultipleShooting

        self.fit = MultipleShooting(max_iterations=3, **settings).fit


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
    learn = next(w for w in app.multiselect if w.label == "Learn from")
    assert list(learn.options) == ["circle"]
    app = app.button(key="next").click().run()
    app.button(key="next").click().run()
    assert [button.key for button in app.button if button.key == "ask:fit"]
    assert any("circle" in caption.value for caption in app.caption)


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
    for part in ("Learn from", "Judge with"):
        next(w for w in app.multiselect if w.label == part).set_value(["zigzag_10_10"]).run()
    assert not app.exception
    assert "chosen to learn from and to judge with" in app.error[0].value


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


def test_job_is_done_once_and_kept() -> None:
    """Asking twice for the same work does it once; a failure can be tried again."""
    desk, calls = Desk(), []

    def work(tell) -> int:
        calls.append(1)
        if len(calls) == 2:
            raise OedSysidError("The file is empty. Give another.")
        return len(calls)

    for _ in range(2):
        desk.ask("a", work).ended.wait()
    assert desk.ask("a", work).result == 1
    failed = desk.ask("b", work)
    failed.ended.wait()
    assert (failed.state, failed.failure) == ("failed", "The file is empty. Give another.")
    assert desk.ask("b", work) is not failed


def test_job_stops_when_asked(capsys) -> None:
    """A job ends when it next tells what it does; a fault of the program is said in words."""
    desk, begun, go_on = Desk(), threading.Event(), threading.Event()

    def work(tell) -> None:
        begun.set()
        go_on.wait()
        tell("next")

    job = desk.ask("long", work)
    begun.wait()
    job.stop()
    go_on.set()
    job.ended.wait()
    assert job.state == "stopped"
    broken = desk.ask("broken", lambda tell: 1 / 0)
    broken.ended.wait()
    assert "ZeroDivisionError" in broken.failure
    assert "ZeroDivisionError" in capsys.readouterr().err


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


def test_check_page_names_a_wrong_log_and_offers_copies(ship: Path) -> None:
    """Swapped columns are named on the page Check, with corrected copies to take away."""
    from oed_sysid.app.panels import desk

    app = opened(ship)
    app.button_group[0].set_value("My CSV files").run()
    table = (ship / "data" / "zigzag_20_20.csv").read_text().splitlines()
    names = table[0].split(",")
    first, second = (next(i for i, n in enumerate(names) if n.startswith(k)) for k in ("psi", "r "))
    swapped = names.copy()
    swapped[first] = (
        names[first].replace("psi", "r").replace("deg", "deg/s").replace("rad", "rad/s")
    )
    swapped[second] = names[second].replace("r [", "psi [").replace("/s", "")
    content = "\n".join([",".join(swapped), *table[1:]]) + "\n"
    app.file_uploader[0].set_value([("log.csv", content.encode(), "text/csv")]).run()
    app = following(app)
    desk().wait()
    app = app.run()
    assert not app.exception
    assert "Log suspect" in app.error[0].value
    assert "swap" in app.error[0].value
    assert "Corrected copies (ZIP)" in {one.label for one in app.get("download_button")}


def _other_folder(ship: Path, folder: Path, mark: Path) -> Path:
    """A copy of a problem that leaves a mark when it is run."""
    import shutil

    shutil.copytree(ship, folder)
    file = folder / "problem.py"
    file.write_text(f"open({str(mark)!r}, 'a').write('x')\n" + file.read_text())
    return folder


def typed(folder: Path):
    """The application in a new session, in which the path of a problem has been typed."""
    app = testing.AppTest.from_function(script, kwargs={"problem": None}, default_timeout=PATIENCE)
    app.session_state["keep:source"] = str(folder)
    return app.run()


def test_a_strangers_problem_is_run_only_after_consent(ship: Path, tmp_path: Path) -> None:
    """A typed folder shows its program and waits for a button; other pages do not run it."""
    mark = tmp_path / "ran"
    folder = _other_folder(ship, tmp_path / "ferry", mark)
    app = typed(folder)
    assert not app.exception
    assert not mark.exists()
    assert "is run with your rights" in app.warning[0].value
    assert any("open(" in one.value for one in app.code)
    app.button(key="next").click().run()
    assert not mark.exists()
    assert "Agree to that on the page Problem" in app.error[0].value
    app = typed(folder)
    app.button(key="agree").click().run()
    assert mark.exists()
    assert fine(app).header[0].value == load_problem(folder).title


def test_consent_ends_where_others_can_write(ship: Path, tmp_path: Path) -> None:
    """In a folder that others can change, every change of the program asks again."""
    from oed_sysid.app.trust import NotTrustedError, check_trusted, consent

    folder = _other_folder(ship, tmp_path / "ferry", tmp_path / "ran")
    agreed = {consent(str(folder)): True}
    check_trusted(str(folder), agreed)
    (folder / "problem.py").write_text("import os\n")
    check_trusted(str(folder), agreed)
    folder.chmod(0o777)
    with pytest.raises(NotTrustedError):
        check_trusted(str(folder), agreed)
    agreed = {consent(str(folder)): True}
    check_trusted(str(folder), agreed)
    (folder / "problem.py").write_text("import sys\n")
    with pytest.raises(NotTrustedError, match=r"problem\.py"):
        check_trusted(str(folder), agreed)


def test_consent_of_one_session_is_none_of_another(ship: Path, tmp_path: Path) -> None:
    """What one window agreed to and uploaded is not there in the next."""
    mark = tmp_path / "ran"
    folder = _other_folder(ship, tmp_path / "ferry", mark)
    first = typed(folder)
    first.button(key="agree").click().run()
    second = typed(folder)
    assert "is run with your rights" in second.warning[0].value
    assert f"files:{folder}" not in second.session_state


def test_address_without_the_key_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever does not know the secret of this run sees no page and runs nothing."""
    from oed_sysid.app.trust import SECRET

    monkeypatch.setenv(SECRET, "right")
    app = testing.AppTest.from_function(
        script, kwargs={"problem": "remus_diving_plane"}, default_timeout=PATIENCE
    )
    for wrong in (None, "wrong"):
        if wrong:
            app.query_params["key"] = wrong
        app.run()
        assert "does not carry the key" in app.error[0].value
        assert not app.header
        assert not app.selectbox
    app.query_params["key"] = "right"
    assert fine(app.run()).header[0].value == load_problem("remus_diving_plane").title


def test_uploads_are_limited_and_stay_in_their_folder(ship: Path, monkeypatch) -> None:
    """Too many bytes are refused in words, and no name leads out of the folder."""
    from oed_sysid.app import trust

    problem = load_problem(ship)
    good = (ship / "data" / "turning_circle.csv").read_bytes()
    names = ["../../out.csv", "..", "a/b\\c.csv", "x\0y.csv", "n" * 300 + ".csv"]
    records, refused, _ = read_uploads(problem, dict.fromkeys(names, good))
    assert records is not None
    assert refused == {}
    assert not any(set("/\\\0") & set(name) for name in records.names)
    monkeypatch.setattr(trust, "MOST_BYTES", 10)
    with pytest.raises(OedSysidError, match="takes up to"):
        trust.check_uploads({"a.csv": b"x" * 11})
    assert "--server.maxUploadSize=200" in orders("remus_diving_plane")


def test_stop_leaves_what_another_window_waits_for() -> None:
    """A job ends when nobody waits for it any more."""
    from oed_sysid.app.jobs import Job

    job = Job(lambda tell: None)
    job.look("one")
    job.look("two")
    assert not job.stop("one")
    assert job.stop("two")
    assert job.state == "waiting"
    job.run()
    assert job.state == "stopped"
