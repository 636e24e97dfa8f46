"""Work that the browser application gives away: done once, stopped, found again."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from app_pages import (  # noqa: F401
    PATIENCE,
    at_fit,
    done,
    fine,
    following,
    opened,
    own_shelf,
    reopened,
    ship_folder,
    study_of_ship,
    text_of,
    typed,
)

from oed_sysid.app import tasks
from oed_sysid.app.jobs import Desk
from oed_sysid.app.shelf import Asked, Left, Shelf, new_id
from oed_sysid.app.study import Study
from oed_sysid.app.work import Request


def test_job_is_done_once_and_kept(study: Study, tmp_path: Path) -> None:
    """Asking twice does it once, and the result outlives the desk; each study has its own job."""
    request = Request.of(study, tasks.check)
    first = Desk(tmp_path)
    job = first.ask("one", "check", request)
    assert first.ask("one", "check", request) is job
    assert first.running("one") == 1
    assert first.running("two") == 0
    job.ended.wait(PATIENCE)
    assert job.state == "done"
    verdict = job.result.result.verdict
    again = Desk(tmp_path).find("two", "check")
    assert again is not None
    assert again.result.result.verdict == verdict
    assert Desk(tmp_path).find("two", "other") is None


def test_job_stops_at_once_and_for_nobody_else(study: Study, tmp_path: Path) -> None:
    """Stop ends the process of one study at once; the same work of another goes on."""
    desk = Desk(tmp_path)
    request = Request.of(study, tasks.improve, 2)
    mine, theirs = (desk.ask(who, "improve", request) for who in ("one", "two"))
    deadline = time.monotonic() + PATIENCE
    while "Starting" in (mine.doing, theirs.doing) and time.monotonic() < deadline:
        time.sleep(0.1)
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
    job = desk.ask("one", "improve", Request.of(study, tasks.improve, large))
    deadline = time.monotonic() + PATIENCE
    while job._process is None and time.monotonic() < deadline:
        time.sleep(0.001)
    began = time.monotonic()
    job.stop()
    assert time.monotonic() - began < 2.5
    assert job._process.poll() is not None
    assert job.state == "stopped"


def test_job_that_fails_says_why(study: Study, tmp_path: Path) -> None:
    """Bad input, a fault of the program and a killed process are told apart, in words."""
    import operator

    desk = Desk(tmp_path)
    alone = Study(study.source, "default", study.problem, study.train, None)
    wrong = desk.ask("one", "compare", Request.of(alone, tasks.compare, ()))
    wrong.ended.wait(PATIENCE)
    assert (wrong.state, wrong.result) == ("failed", None)
    assert "validation record" in wrong.failure
    broken = desk.ask("one", "broken", Request.of(study, operator.truediv))
    broken.ended.wait(PATIENCE)
    assert "Unexpected error: TypeError" in broken.failure
    killed = desk.ask("one", "improve", Request.of(study, tasks.improve, 2))
    deadline = time.monotonic() + PATIENCE
    while killed._process is None and time.monotonic() < deadline:
        time.sleep(0.05)
    killed._process.kill()
    killed.ended.wait(PATIENCE)
    assert "ended without a result" in killed.failure


def test_work_ends_with_the_program(ship: Path, tmp_path: Path) -> None:
    """A program that is killed leaves no work behind."""
    import subprocess

    code = (
        "import sys, time\nfrom pathlib import Path\n"
        "from oed_sysid import load_problem\n"
        "from oed_sysid.app import tasks\nfrom oed_sysid.app.jobs import Desk\n"
        "from oed_sysid.app.study import Study\nfrom oed_sysid.app.work import Request\n"
        f"problem = load_problem({str(ship)!r})\n"
        f"study = Study({str(ship)!r}, 'default', problem, problem.data())\n"
        f"job = Desk(Path({str(tmp_path)!r})).ask('a', 'b', Request.of(study, tasks.improve, 2))\n"
        "while job.doing == 'Starting': time.sleep(0.05)\n"
        "print(job._process.pid, flush=True)\ntime.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as run:
        number = int(run.stdout.readline())
        assert _alive(number)
        run.kill()
    deadline = time.monotonic() + 10.0
    while _alive(number) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not _alive(number)


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
    (tmp_path / "studies" / name / "study.json").write_text("{")
    assert shelf.find(name) is None
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
    next(w for w in app.multiselect if w.label == "Validation records").set_value([]).run()
    app = fine(reopened(app))
    assert app.session_state["keep:source"] == str(ship)
    chosen = {w.label: w.value for w in app.multiselect}
    assert chosen["Training records"] == ["one"]
    assert chosen["Validation records"] == []


def test_choices_outlive_their_widgets(ship: Path) -> None:
    """What streamlit forgets of widgets that are not drawn, as beside a job, is chosen still."""
    app = opened(ship)
    learn = next(w for w in app.multiselect if w.label == "Training records")
    learn.set_value(["zigzag_10_10"]).run()
    app = following(app)
    for side in ("train", "test"):
        del app.session_state[f"keep:{side}:{ship}:default:With the problem"]
    app = fine(app.run())
    assert any(caption.value == "Training records: zigzag_10_10" for caption in app.caption)


def test_reload_in_mid_job_waits_for_the_same_job(ship: Path) -> None:
    """A job goes on while the browser is away, and its result is found by the same address."""
    from oed_sysid.app.visit import desk

    app = at_fit(opened(ship))
    assert not text_of(app)
    app.button(key="ask:fit").click().run()
    (job,) = [j for (who, key), j in desk()._jobs.items()
              if who == app.session_state["study"] and key.startswith("fit ")]  # fmt: skip
    again = at_fit(reopened(app, ship))
    assert "The estimation converged." in text_of(again)
    assert job.state == "done"
    assert job in desk()._jobs.values()


def test_two_tabs_are_two_studies(ship: Path) -> None:
    """A choice in one tab changes nothing in the other, and both are found again."""
    one, two = opened(ship), opened(ship)
    assert one.session_state["study"] != two.session_state["study"]
    for app, name in ((one, "zigzag_10_10"), (two, "turning_circle")):
        next(w for w in app.multiselect if w.label == "Training records").set_value([name]).run()
    for app, name in ((one, "zigzag_10_10"), (two, "turning_circle")):
        again = fine(reopened(app, ship))
        learn = next(w for w in again.multiselect if w.label == "Training records")
        assert learn.value == [name]
