"""Long work beside the page: each job in a process of its own, its result kept on disk.

A page asks for a job and is drawn again and again while it runs; a click, a change of page or a
reload of the browser does not disturb it. Nobody waits for somebody else's job, and a job that is
stopped ends at once, whatever it is calculating. Results are kept by what was asked
(:class:`~oed_sysid.runtime.journal.CellStore`), so that the same question is answered once.

The process is ``python -m oed_sysid.app.jobs``: the request comes over standard input, words on
progress go over standard output, and the result into a store that only this user's processes can
write to. When standard input ends, the page is gone, and so is the work.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import traceback
import weakref
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cloudpickle

from oed_sysid import OedSysidError, load_problem
from oed_sysid.cli.study import Study
from oed_sysid.cli.terminal import Shown
from oed_sysid.runtime.constants import PATIENCE
from oed_sysid.runtime.journal import CellStore, package_digest

# Results held in memory, and on disk; the longest unused go first.
_HELD = 100


@dataclass(frozen=True, eq=False)
class Request:
    """Work to do, in a form that another process understands.

    Parameters
    ----------
    task : callable
        A :class:`~oed_sysid.cli.study.Task`, or a function ``(study, show, options)``.
    options : mapping
        Its options.
    about : Study
        Without its problem, which is loaded anew, not sent.
    """

    task: Callable[..., Any]
    options: Mapping[str, Any]
    about: Study

    @classmethod
    def of(cls, study: Study, task: Callable[..., Any], options: Mapping[str, Any]) -> Request:
        """Ask for a task on a study."""
        return cls(task, options, replace(study, problem=None))  # type: ignore[arg-type]

    def study(self) -> Study:
        """The study, its problem loaded here."""
        problem = load_problem(self.about.source, variant=self.about.variant)
        return replace(self.about, problem=problem)


@dataclass(eq=False)
class Job:
    """One piece of work.

    Attributes
    ----------
    state : str
        ``"running"``, ``"done"``, ``"failed"`` or ``"stopped"``.
    doing : str
        What it told last.
    end_expected : float or None
        When it ends, as it told last, on the clock of ``began``.
    result : object
        What it returned, once done.
    failure : str
        What went wrong, in words.
    ended : threading.Event
        Set with the outcome.
    """

    state: str = "running"
    doing: str = "Starting"
    result: Any = None
    failure: str = ""
    began: float = field(default_factory=time.monotonic)
    end_expected: float | None = None
    ended: threading.Event = field(default_factory=threading.Event)
    _process: subprocess.Popen[bytes] | None = None

    @property
    def at_work(self) -> bool:
        """Whether there is no outcome yet."""
        return self.state == "running"

    @property
    def seconds(self) -> float:
        """How long it has been asked for, s."""
        return time.monotonic() - self.began

    @property
    def share(self) -> float | None:
        """Share of its time that is over; None where it does not tell."""
        if self.end_expected is None:
            return None
        return min(self.seconds / max(self.end_expected - self.began, 1e-9), 1.0)

    def stop(self, *, wait: bool = True) -> None:
        """End it now, with every process that it started; they may take a moment to be gone."""
        if self.at_work:
            self.end("stopped")
            if self._process is not None and wait:
                _terminate(self._process)
            elif self._process is not None:
                threading.Thread(target=_terminate, args=(self._process,)).start()

    def take(self, process: subprocess.Popen[bytes]) -> None:
        """Be done by a process, which ends at once if the job was stopped before it began."""
        self._process = process
        if self.state == "stopped":
            _terminate(process)

    def follow(self, process: subprocess.Popen[bytes], fetch: Callable[[], Any]) -> None:
        """Listen to what a process tells until it ends; ``fetch`` reads its result.

        While it works it tells pairs: what it is doing, and the seconds that are left or None. Its
        last words are what went wrong, or empty where the result is in the store.
        """
        assert process.stdout is not None
        said: Any = None
        with suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                said = pickle.load(process.stdout)
                if isinstance(said, tuple) and len(said) == 2:
                    words, left = said
                    self.doing = words[:1].upper() + words[1:]
                    self.end_expected = None if left is None else time.monotonic() + left
        code = process.wait()
        if self.state == "stopped":
            return
        if not isinstance(said, str):
            self.fail(
                f"The work ended without a result (exit code {code}). It was ended from outside, "
                "or the memory did not suffice: take fewer or shorter records, or try again."
            )
        elif said or (result := fetch()) is None:
            self.fail(said or "The result could not be read back. Try again.")
        else:
            self.result = result
            self.end("done")

    def fail(self, why: str) -> None:
        """End without a result."""
        self.failure = why
        self.end("failed")

    def end(self, state: str) -> None:
        """Have an outcome."""
        self.state = state
        self.ended.set()


class Desk:
    """Starts jobs, and keeps their results.

    Parameters
    ----------
    folder : Path
        Where results are kept; only this user may write there.
    """

    def __init__(self, folder: Path) -> None:
        self._store = CellStore(folder, pickler=cloudpickle.Pickler)
        self._jobs: dict[tuple[str, str], Job] = {}
        self._lock = threading.Lock()
        # Work that nobody can look at any more ends with the program.
        weakref.finalize(self, _stop_all, self._jobs)

    def find(self, owner: str, key: str) -> Job | None:
        """Job that one study asked for under a key, or a result that is there already."""
        job = self._jobs.get((owner, key))
        if job is not None and job.state in ("running", "done"):
            return job
        with self._lock:
            kept = self._read(key)
            return job if kept is None else self._hold(owner, key, Job("done", result=kept))

    def ask(self, owner: str, key: str, request: Request) -> Job:
        """Return the job of a key; a new one unless it is at work or done.

        Parameters
        ----------
        owner : str
            Which study asks: another one neither waits for this job nor stops it.
        key : str
            What the result depends on.
        request : Request
            The work.
        """
        if (found := self.find(owner, key)) is not None and found.state in ("running", "done"):
            return found
        with self._lock:
            job = self._hold(owner, key, Job())
        threading.Thread(target=self._run, args=(job, key, request), daemon=True).start()
        return job

    def wait(self) -> None:
        """Wait until nothing is being worked on."""
        for job in list(self._jobs.values()):
            job.ended.wait()

    def running(self, owner: str) -> int:
        """How many jobs of a study are at work."""
        return sum(j.at_work for (who, _), j in list(self._jobs.items()) if who == owner)

    def results(self) -> list[Any]:
        """Results that are held in memory."""
        return [job.result for job in self._jobs.values() if job.state == "done"]

    def _run(self, job: Job, key: str, request: Request) -> None:
        try:
            process = subprocess.Popen(
                [sys.executable, "-m", "oed_sysid.app.jobs"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=os.name == "posix",  # its own group: stopped as one
            )
            assert process.stdin is not None
            # Before the request is written: that waits until a large one is read, seconds later.
            job.take(process)
            # The pipe stays open: its end tells the process that the page is gone.
            with suppress(BrokenPipeError):  # it was stopped, or ended: `follow` says so
                work = str(self._store.folder), _name(key), request
                cloudpickle.dump(work, process.stdin)
                process.stdin.flush()
            job.follow(process, lambda: self._read(key))
            _prune(self._store.folder)
        except Exception as error:
            job.fail(said_of(error))

    def _read(self, key: str) -> Any:
        """The kept result; None where there is none, or what it is made of has changed since."""
        with suppress(OSError):
            os.utime(self._store.path(_name(key)))
        return self._store.find([_name(key)]).get(_name(key))

    def _hold(self, owner: str, key: str, job: Job) -> Job:
        self._jobs[owner, key] = job
        if job.state == "done":
            job.ended.set()
        for old in [k for k, j in self._jobs.items() if not j.at_work][:-_HELD]:
            del self._jobs[old]
        return job


def said_of(error: Exception) -> str:
    """Say what went wrong; what is not the user's fault is said to be the program's.

    >>> print(said_of(OedSysidError("Name one.")), said_of(ValueError("no number"))[:41])
    Name one. Unexpected error: ValueError: no number.
    """
    if isinstance(error, OedSysidError):
        return str(error)
    return (
        f"Unexpected error: {type(error).__name__}: {error}. This is a fault of the program. The "
        "terminal in which it was started shows where; please report it."
    )


def _name(key: str) -> str:
    """Name of a result: what was asked, and the program that answered."""
    return f"{key} {package_digest()}"


def _prune(folder: Path) -> None:
    """Forget the results that were not looked at for longest."""
    with suppress(OSError):
        for file in sorted(folder.glob("*.cell"), key=lambda file: file.stat().st_mtime)[:-_HELD]:
            file.unlink(missing_ok=True)


def _terminate(process: subprocess.Popen[bytes]) -> None:
    """End a process and those that it started, kindly first."""
    for number in (signal.SIGTERM, getattr(signal, "SIGKILL", signal.SIGTERM)):
        if process.poll() is not None:
            return  # its number may be another's by now
        with suppress(OSError):
            if os.name == "posix":
                os.killpg(process.pid, number)
            else:
                process.kill()
        with suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE)


def _stop_all(jobs: dict[tuple[str, str], Job]) -> None:
    for job in list(jobs.values()):
        job.stop()


# -- the process -------------------------------------------------------------------------


def main() -> None:
    """Do the work that standard input asks for."""
    voice = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is for the terminal
    lock = threading.Lock()

    def say(what: Any) -> None:
        with lock, suppress(BrokenPipeError):
            pickle.dump(what, voice)
            voice.flush()

    with suppress(AttributeError, OSError):
        os.nice(2)  # the page stays quick
    folder, name, request = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_leave_with_the_page, daemon=True).start()
    try:
        say((getattr(request.task, "doing", "") or "Starting", None))
        shown = Shown(told=lambda words, left: say((words, left)))
        outcome = request.task(request.study(), shown, request.options)
        say(("drawing", None))
        CellStore(Path(folder), pickler=cloudpickle.Pickler).write(name, outcome.drawn())
        say("")
    except Exception as error:
        if not isinstance(error, OedSysidError):
            traceback.print_exc()  # for the terminal; the page says it in words
        say(said_of(error))
    voice.close()
    sys.stderr.flush()
    os._exit(0)  # everything is said and written; what libraries left open is of no concern


def _leave_with_the_page() -> None:
    """End this process when the page's end of the pipe is closed."""
    while os.read(0, 1024):  # not the buffered reader, which Python cannot shut down in mid-read
        pass
    with suppress(AttributeError, OSError):
        os.killpg(os.getpgrp(), signal.SIGTERM)  # its own helpers too
    os._exit(1)


if __name__ == "__main__":
    # Named as the desk knows it, so that what is pickled here is found there.
    from oed_sysid.app.jobs import main as run

    run()
