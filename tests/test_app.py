"""The pages in a browser: study, check, consent, jobs."""

from __future__ import annotations

import io
import operator
import pickle
import shlex
import shutil
import socket
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from app_pages import (  # noqa: F401
    PATIENCE,
    at_fit,
    checked,
    done,
    fine,
    following,
    opened,
    own_shelf,
    records_for,
    reopened,
    session,
    ship_folder,
    study_of_ship,
    text_of,
    typed,
    uploaded,
    waited,
    went,
)

from oed_sysid import Dataset, Fit, OedSysidError, load_problem, read_csv, write_csv
from oed_sysid.app import pages, trust
from oed_sysid.app.choices import likely_test, read_uploads, simulated
from oed_sysid.app.jobs import Desk, Request
from oed_sysid.app.launch import orders, start
from oed_sysid.app.panels import zipped
from oed_sysid.app.takeaway import write_records
from oed_sysid.app.trust import SECRET, NotTrustedError, check_trusted, consent
from oed_sysid.app.visit import Asked, Left, Shelf, desk, new_id
from oed_sysid.cli import BAD_INPUT, DONE, main
from oed_sysid.cli.options import line_of
from oed_sysid.cli.study import Study
from oed_sysid.cli.tasks import TASKS
from oed_sysid.cli.terminal import Shown
from oed_sysid.runtime.journal import CellStore


@pytest.mark.slow
def test_a_study_from_problem_to_report(ship: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    """The whole flow: fit, compare, improve, step back, rank; and the commands repeat it."""
    problem = load_problem(ship)
    app = opened(ship)
    assert app.header[0].value == problem.title
    app = done(at_fit(app), "fit")
    assert "parameters estimated" in text_of(app)
    assert "What is missing" in app.button(key="next").label
    app = done(went(app, "Where it fails"), "compare")
    assert "more than noise is left" in text_of(app)
    app = following(app)  # begins the search
    desk().wait()
    app = fine(app.run())
    assert "error on the validation records" in text_of(app)
    effect = problem.effects[0].name
    keep = next(w for w in app.multiselect if w.label == "Effects to keep")
    app = done(fine(keep.set_value([effect]).run()), "kept")
    assert f"with {effect}" in text_of(app)
    app = went(app, "Plan the next trial")
    planned = next(box for box in app.selectbox if box.label == "Planned for the")
    assert planned.value == "improved model"
    app = done(fine(app.button_group[0].set_value("Rank").run()), "rank")
    assert "estimated together" in text_of(app)
    app = following(app)
    assert app.header[0].value == "Export"
    app = went(app, "Report")
    offered = {button.label for button in app.get("download_button")}
    assert {"Records (ZIP)", "Everything (ZIP)", "Report (HTML)"} <= offered
    lines = app.code[1].value.splitlines()
    verbs = [line.split()[1] for line in lines]
    assert verbs == ["check", "fit", "compare", "improve", "compare", "rank"]

    mine = [outcome.result for outcome in desk().results()]
    fits = [result for result in mine if isinstance(result, Fit)]
    here = next(result for result in fits if result.model.name == problem.model.name)
    train, test = problem.data().split(test=likely_test(problem.data().names))
    write_records(Study(str(ship), "default", problem, train, test), tmp_path)
    monkeypatch.chdir(tmp_path)
    for line in (lines[0], lines[1], lines[3], lines[-1]):  # the last is planned for the improved
        assert main(shlex.split(line)[1:]) == DONE
    capsys.readouterr()
    there = Fit.load(tmp_path / "fit.json")
    np.testing.assert_allclose(there.estimates, here.estimates, rtol=1e-6)
    assert (tmp_path / "rank.html").is_file()


def test_files_of_the_user(ship: Path) -> None:
    """Uploaded files become records or say why not, and stay when the page is left."""
    good = (ship / "data" / "turning_circle.csv").read_bytes()
    app = uploaded(ship, "CSV files", ("circle.csv", good), ("bad.csv", b"t,rudder\n0,1\n"))
    assert not app.exception
    assert [error.value for error in app.error if "**bad.csv** was refused" in error.value]
    assert list(records_for(app, "Training").options) == ["circle"]
    app = went(app, "Check the log")
    app = went(app, "Fit")
    assert [button.key for button in app.button if button.key == "ask:fit"]
    assert any("circle" in caption.value for caption in app.caption)


def test_columns_are_mapped_by_choice(ship: Path) -> None:
    """A log with other names becomes a record by choosing columns, and is there after a reload."""
    problem = load_problem(ship)
    record = problem.data()["turning_circle"]
    psi = record.output("psi")
    rows = zip(record.times, np.degrees(psi) % 360.0, record.input("rudder"), strict=True)
    lines = ["clock,compass [deg],helm [rad]", *(f"{1000 * t},{h},{u}" for t, h, u in rows)]
    app = fine(uploaded(ship, "logs", ("circle.csv", "\n".join(lines).encode())))
    key = f"keep:map:{ship}"
    assert app.selectbox(key=f"{key}:clock unit").value == "ms"  # no ship takes an hour a turn
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
    assert records_for(again, "Training").value == ["circle"]


def test_file_that_is_taken_back(ship: Path) -> None:
    """A file is forgotten when it is taken out, and only then."""
    content = (ship / "data" / "turning_circle.csv").read_bytes()
    app = uploaded(ship, "CSV files", ("one.csv", content))
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
    for use in ("Training", "Validation"):
        records_for(app, use).set_value(["zigzag_10_10"]).run()
    assert not app.exception
    assert "chosen for training and for validation" in app.error[0].value


def test_problem_that_does_not_exist(tmp_path: Path) -> None:
    """A wrong folder is answered with the package's own message."""
    app = session(tmp_path / "none").run()
    assert not app.exception
    assert "There is no problem" in app.error[0].value


def test_uploads_are_checked_as_on_the_command_line(ship: Path, tmp_path: Path, capsys) -> None:
    """The message about a file is that of the command line."""
    content = b"t [s],rudder [deg]\n0,1\n1,x\n"
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    assert main(["fit", str(ship), str(path)]) == BAD_INPUT
    said = capsys.readouterr().err.removeprefix("Error: ").strip()
    stock = read_uploads(load_problem(ship), {"log.csv": content})
    records, refused = stock.records, stock.refused
    assert records is None
    assert refused["log.csv"] == said.replace(f"{tmp_path}/", "")


def test_records_survive_the_archive(study: Study, tmp_path: Path) -> None:
    """What is downloaded reads back as the same numbers."""
    content = zipped(lambda place: write_records(study, place))
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
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
    limit = ("rudder=-10:10", "rudder-rate=3")
    wish = {"like": "zigzag_10_10", "duration": 40.0, "limit": limit}
    outcome = TASKS["design"](study, Shown(), wish)
    monkeypatch.chdir(tmp_path)
    assert main(shlex.split(line_of(TASKS["design"], study, wish))[1:]) == DONE
    tables = [
        np.genfromtxt(io.BytesIO(text), delimiter=",", skip_header=1)
        for text in (pages.commands_csv(outcome, study), (tmp_path / "design.csv").read_bytes())
    ]
    np.testing.assert_allclose(*tables, atol=1e-6)
    assert np.abs(tables[0][:, 1]).max() <= np.radians(10) * (1 + 1e-9)
    assert outcome.result.assurance is not None


def test_commands_name_model_noise_and_records(study: Study) -> None:
    """Commands carry every choice that changes the result."""
    odd = Study("my ship", "norrbin", study.problem, study.train, None, known_noise=True)
    words = shlex.split(line_of(TASKS["improve"], odd, {"max_effects": 2}))
    assert words[:6] == ["oed-sysid", "improve", "my ship", "--model", "norrbin", "train"]
    assert words[words.index("--max-effects") + 1] == "2"
    assert "--known-noise" in words
    assert "--validate" not in words


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


def test_check_page_names_a_wrong_log_and_offers_copies(ship: Path) -> None:
    """Swapped columns are named on the page Check, with corrected copies to take away."""
    table = (ship / "data" / "zigzag_20_20.csv").read_text().splitlines()
    names = table[0].split(",")
    first, second = (next(i for i, n in enumerate(names) if n.startswith(k)) for k in ("psi", "r "))
    swapped = names.copy()
    swapped[first] = (
        names[first].replace("psi", "r").replace("deg", "deg/s").replace("rad", "rad/s")
    )
    swapped[second] = names[second].replace("r [", "psi [").replace("/s", "")
    content = "\n".join([",".join(swapped), *table[1:]]) + "\n"
    app = checked(uploaded(ship, "CSV files", ("log.csv", content.encode())))
    assert "Log suspect" in app.error[0].value
    assert "swap" in app.error[0].value
    assert "Corrected copies (ZIP)" in {one.label for one in app.get("download_button")}
    assert not app.warning


@pytest.mark.slow
def test_check_page_says_what_it_does_not_correct(ship: Path) -> None:
    """A heading of another run is no fault that a copy could undo."""
    channels = load_problem(ship).channels
    runs = read_csv([ship / "data" / f"zigzag_{k}.csv" for k in ("10_10", "20_20")], channels)
    n = min(len(run.times) for run in runs)
    run = runs[0].window(runs[0].times[0], runs[0].times[n - 1])
    outputs = run.outputs.copy()
    psi = run.channels.output_names.index("psi")
    outputs[:, psi] = runs[1].outputs[:n, psi][::-1]
    wrong = ship / "wrong.csv"
    write_csv(run.with_outputs(outputs), wrong)
    app = checked(uploaded(ship, "CSV files", ("log.csv", wrong.read_bytes())))
    assert any(one.value.startswith("Not corrected: ") for one in app.warning)


def _other_folder(ship: Path, folder: Path, mark: Path) -> Path:
    """A copy of a problem that leaves a mark when it is run."""
    shutil.copytree(ship, folder)
    file = folder / "problem.py"
    file.write_text(f"open({str(mark)!r}, 'a').write('x')\n" + file.read_text())
    return folder


def test_a_strangers_problem_is_run_only_after_consent(ship: Path, tmp_path: Path) -> None:
    """A typed folder shows its program and waits for a button; other pages do not run it."""
    mark = tmp_path / "ran"
    folder = _other_folder(ship, tmp_path / "ferry", mark)
    app = typed(folder)
    assert not app.exception
    assert not mark.exists()
    assert "is run with your rights" in app.warning[0].value
    assert any("open(" in one.value for one in app.code)
    app = went(app, "Check the log")
    assert not mark.exists()
    assert "Agree to that on the page Data" in app.error[0].value
    app = typed(folder)
    app.button(key="agree").click().run()
    assert mark.exists()
    assert fine(app).header[0].value == load_problem(folder).title


def test_consent_ends_where_others_can_write(ship: Path, tmp_path: Path) -> None:
    """In a folder that others can change, every change of the program asks again."""
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
    monkeypatch.setenv(SECRET, "right")
    app = session("remus_diving_plane")
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
    problem = load_problem(ship)
    good = (ship / "data" / "turning_circle.csv").read_bytes()
    names = ["../../out.csv", "..", "a/b\\c.csv", "x\0y.csv", "n" * 300 + ".csv"]
    stock = read_uploads(problem, dict.fromkeys(names, good))
    records, refused = stock.records, stock.refused
    assert refused == {}
    assert not any(set("/\\\0") & set(name) for name in records.names)
    monkeypatch.setattr(trust, "MOST_BYTES", 10)
    with pytest.raises(OedSysidError, match="takes up to"):
        trust.check_uploads({"a.csv": b"x" * 11})
    assert "--server.maxUploadSize=200" in orders("remus_diving_plane")


def test_job_is_done_once_and_kept(study: Study, tmp_path: Path) -> None:
    """Asking twice does it once, and the result outlives the desk; each study has its own job."""
    train = Dataset([record.window(0.0, 20.0) for record in study.training()][:1])
    request = Request.of(replace(study, train=train), TASKS["check"], {})
    first = Desk(tmp_path)
    job = first.ask("one", "check", request)
    assert first.ask("one", "check", request) is job
    assert first.running("one") == 1
    assert first.running("two") == 0
    job.ended.wait(PATIENCE)
    assert job.state == "done"
    verdict = job.result.result.verdict
    again = Desk(tmp_path).find("two", "check")
    assert again.result.result.verdict == verdict
    assert Desk(tmp_path).find("two", "other") is None


@pytest.mark.slow
def test_job_stops_at_once_and_for_nobody_else(study: Study, tmp_path: Path) -> None:
    """Stop ends the process of one study at once; the same work of another goes on."""
    desk = Desk(tmp_path)
    request = Request.of(study, TASKS["improve"], {"max_effects": 2})
    mine, theirs = (desk.ask(who, "improve", request) for who in ("one", "two"))
    assert waited(lambda: "Starting" in (mine.doing, theirs.doing))
    began = time.monotonic()
    mine.stop()
    assert time.monotonic() - began < 2.5
    assert mine.state == "stopped"
    assert mine._process.poll() is not None
    assert theirs.at_work
    assert theirs._process.poll() is None
    theirs.stop()
    assert theirs._process.poll() is not None
    assert desk.ask("one", "improve", request) is not mine
    desk.find("one", "improve").stop()


def test_job_stops_before_it_has_read_what_to_do(study: Study, tmp_path: Path) -> None:
    """A large request is read seconds after the process began; Stop does not wait for that."""
    desk = Desk(tmp_path)
    large = bytes(2**22)  # more than a pipe holds
    job = desk.ask("one", "improve", Request.of(study, TASKS["improve"], {"large": large}))
    assert waited(lambda: job._process is None)
    began = time.monotonic()
    job.stop()
    assert time.monotonic() - began < 2.5
    assert job._process.poll() is not None
    assert job.state == "stopped"


def test_job_that_fails_says_why(study: Study, tmp_path: Path) -> None:
    """Bad input, a fault of the program and a killed process are told apart, in words."""
    desk = Desk(tmp_path)
    alone = Study(study.source, "default", study.problem, study.train, None)
    wrong = desk.ask("one", "compare", Request.of(alone, TASKS["compare"], {}))
    broken = desk.ask("one", "broken", Request.of(study, operator.truediv, {}))
    killed = desk.ask("one", "improve", Request.of(study, TASKS["improve"], {"max_effects": 2}))
    assert waited(lambda: killed._process is None)
    killed._process.kill()
    desk.wait()
    assert (wrong.state, wrong.result) == ("failed", None)
    assert "validation record" in wrong.failure
    assert "Unexpected error: TypeError" in broken.failure
    assert "ended without a result" in killed.failure


def test_work_ends_with_the_program(ship: Path, tmp_path: Path) -> None:
    """A program that is killed leaves no work behind."""
    code = (
        "import sys, time\nfrom pathlib import Path\n"
        "from oed_sysid import load_problem\n"
        "from oed_sysid.app.jobs import Desk, Request\n"
        "from oed_sysid.cli.study import Study\nfrom oed_sysid.cli.tasks import TASKS\n"
        f"problem = load_problem({str(ship)!r})\n"
        f"study = Study({str(ship)!r}, 'default', problem, problem.data())\n"
        "request = Request.of(study, TASKS['improve'], {'max_effects': 2})\n"
        f"job = Desk(Path({str(tmp_path)!r})).ask('a', 'b', request)\n"
        "while job.doing == 'Starting': time.sleep(0.05)\n"
        "print(job._process.pid, flush=True)\ntime.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as run:
        number = int(run.stdout.readline())
        assert _alive(number)
        run.kill()
    assert waited(lambda: _alive(number), 10.0)


def _alive(number: int) -> bool:
    """Whether a process runs; one that has ended and was not collected does not."""
    try:
        state = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_studies_are_kept_for_the_user_alone(tmp_path: Path) -> None:
    """What was chosen, given and asked comes back; a planted or torn study is none."""
    shelf, name = Shelf(tmp_path / "studies"), new_id()
    left = Left(
        "Ship",
        {"keep:train": ["a"], "keep:most": 3},
        {"/my/ship": True},
        {"fit 1": Asked("Fit", "fit", "oed-sysid fit ship train")},
        {"/my/ship": {"a b.csv": b"1,2"}},
    )
    shelf.keep(name, left)
    back = shelf.find(name)
    assert (back.title, back.choices, back.agreed) == (left.title, left.choices, left.agreed)
    assert (back.asked, back.files) == (left.asked, left.files)
    assert list(shelf.recent()) == [name]
    assert (tmp_path / "studies").stat().st_mode & 0o077 == 0
    assert shelf.find("../" + name) is None
    (tmp_path / "studies" / name).chmod(0o777)
    assert shelf.find(name) is None
    (tmp_path / "studies" / name).chmod(0o700)
    cell = CellStore(tmp_path / "studies" / name).path("study")
    whole = cell.read_bytes()
    for torn in (b"{", whole[:-1], whole[:32] + pickle.dumps(("study", left))):
        cell.write_bytes(torn)
        assert shelf.find(name) is None
    cell.write_bytes(whole)
    assert shelf.find(name) == left
    shelf.forget(name)
    assert shelf.recent() == {}


def test_reload_finds_the_study_again(ship: Path) -> None:
    """After a reload the files, the choice of records, the consent and the results are there."""
    content = (ship / "data" / "turning_circle.csv").read_bytes()
    app = typed(ship)
    app.button(key="agree").click().run()
    app.button_group[0].set_value("My CSV files").run()
    files = [(name, content, "text/csv") for name in ("one.csv", "two.csv")]
    app.file_uploader[0].set_value(files).run()
    records_for(app, "Validation").set_value([]).run()
    app = fine(reopened(app))
    assert app.session_state["keep:source"] == str(ship)
    assert [records_for(app, use).value for use in ("Training", "Validation")] == [["one"], []]


def test_choices_outlive_their_widgets(ship: Path) -> None:
    """What streamlit forgets of widgets that are not drawn, as beside a job, is chosen still."""
    app = opened(ship)
    records_for(app, "Training").set_value(["zigzag_10_10"]).run()
    app = following(app)
    for side in ("train", "test"):
        del app.session_state[f"keep:{side}:{ship}:default:With the problem"]
    app = fine(app.run())
    assert any(caption.value == "Training records: zigzag_10_10" for caption in app.caption)


@pytest.mark.slow
def test_reload_in_mid_job_waits_for_the_same_job(ship: Path) -> None:
    """A job goes on while the browser is away, and its result is found by the same address."""
    app = following(opened(ship))
    mine = [j for (who, _), j in desk()._jobs.items() if who == app.session_state["study"]]
    again = fine(checked(reopened(app, ship)))
    assert "agree with each other" in text_of(again)
    assert [job.state for job in mine] == ["done"]
    assert mine[0] in desk()._jobs.values()


@pytest.mark.slow
def test_two_tabs_are_two_studies(ship: Path) -> None:
    """A choice in one tab changes nothing in the other, and both are found again."""
    one, two = opened(ship), opened(ship)
    assert one.session_state["study"] != two.session_state["study"]
    for app, name in ((one, "zigzag_10_10"), (two, "turning_circle")):
        records_for(app, "Training").set_value([name]).run()
    for app, name in ((one, "zigzag_10_10"), (two, "turning_circle")):
        assert records_for(fine(reopened(app, ship)), "Training").value == [name]
