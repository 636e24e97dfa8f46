"""The browser application in tests: pages as a user sees them, and a vehicle to visit them with."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from oed_sysid import load_problem, new_problem
from oed_sysid.app.jobs import Desk, Job, Request, _name, said_of
from oed_sysid.cli.study import Study
from oed_sysid.cli.terminal import Shown

testing = pytest.importorskip("streamlit.testing.v1", reason="needs the extra 'app'")
PATIENCE = 300.0  # s, for a loaded computer; a free one needs a tenth


def script(problem: str | None) -> None:
    """What streamlit runs."""
    from oed_sysid.app.frame import show

    show(problem)


def session(problem: object = None):
    """The application before its first page is drawn."""
    given = {"problem": problem and str(problem)}
    return testing.AppTest.from_function(script, kwargs=given, default_timeout=PATIENCE)


def opened(problem: object):
    """The application, first page drawn."""
    return fine(session(problem).run())


def fine(app):
    """The application, once nobody is told that anything is wrong."""
    assert not app.exception
    assert not app.error, [error.value for error in app.error]
    return app


def following(app):
    """The next page, as the evidence asks for it."""
    return fine(app.button(key="next").click().run())


def went(app, title: str):
    """A page, by the rail."""
    app.session_state["going"] = title, False
    app = app.run()
    assert app.header[0].value == title
    return app


def at_fit(app):
    """The page Fit, the check of the log behind it."""
    app = fine(checked(app))
    assert app.header[0].value == "Check the log"
    return went(app, "Fit")


def records_for(app, use: str):
    """The choice of records for training or validation."""
    return next(choice for choice in app.multiselect if choice.label == f"{use} records")


def uploaded(problem: object, kind: str, *files: tuple[str, bytes]):
    """The first page with files of the user: ``"CSV files"`` or ``"logs"``."""
    app = opened(problem)
    app.button_group[0].set_value(f"My {kind}").run()
    app.file_uploader[0].set_value([(*file, "text/csv") for file in files]).run()
    return app


def checked(app):
    """The page Check with its result."""
    from oed_sysid.app.visit import desk

    app = went(app, "Check the log")
    desk().wait()
    app = app.run()
    assert not app.exception
    return app


def done(app, button: str):
    """The page after the work behind a button."""
    from oed_sysid.app.visit import desk

    app.button(key=f"ask:{button}").click().run()
    desk().wait()
    return fine(app.run())


def text_of(app) -> str:
    """Everything that reports say on a page."""
    return "\n".join(part.value for part in app.get("html") if "<style>" not in part.value)


def typed(folder: Path):
    """The application in a new session, in which the path of a problem has been typed."""
    app = session()
    app.session_state["keep:source"] = str(folder)
    return app.run()


def reopened(app, problem: object = None):
    """Another session at the address of a study, as after a reload."""
    again = session(problem)
    again.query_params["study"] = app.session_state["study"]
    return again.run()


def waited(still: Callable[[], bool], seconds: float = PATIENCE) -> bool:
    """Whether something has ended within some time."""
    deadline = time.monotonic() + seconds
    while still() and time.monotonic() < deadline:
        time.sleep(0.005)
    return not still()


class DeskHere(Desk):
    """Does the work of pages in a thread of this process, which has everything imported."""

    def _run(self, job: Job, key: str, request: Request) -> None:
        try:
            outcome = request.task(request.study(), Shown(), request.options)
            self._store.write(_name(key), outcome.drawn())
            job.result = self._read(key)
            job.end("done")
        except Exception as error:
            job.fail(said_of(error))


@pytest.fixture(autouse=True, scope="module")
def own_shelf(tmp_path_factory):
    """Studies and results of these tests, not the user's."""
    folder = tmp_path_factory.mktemp("private")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("oed_sysid.app.visit.private_cache", lambda: folder)
        patch.setattr("oed_sysid.app.visit.Desk", DeskHere)
        from oed_sysid.app.visit import desk

        desk.clear()
        yield
        desk.clear()


@pytest.fixture(name="ship", scope="module")
def ship_folder(tmp_path_factory) -> Path:
    """The folder that `oed-sysid new` writes."""
    return new_problem(tmp_path_factory.mktemp("app") / "my_ship")


@pytest.fixture(name="study")
def study_of_ship(ship: Path) -> Study:
    """Its records, the last one validation."""
    problem = load_problem(ship)
    train, test = problem.data().split(test="zigzag_20_20")
    return Study(str(ship), "default", problem, train, test)
