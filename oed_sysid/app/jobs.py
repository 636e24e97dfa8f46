"""Long work beside the page: each job in a process of its own, its result kept on disk.

A page asks for a job and is drawn again and again while it runs; a click, a change of page or a
reload of the browser does not disturb it. Nobody waits for somebody else's job, and a job that is
stopped ends at once, whatever it is calculating. Results are kept by what was asked
(:class:`~oed_sysid.runtime.journal.CellStore`), so that the same question is answered once.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

from oed_sysid.app.work import Done, Failed, Request, unexpected, unpacked
from oed_sysid.errors import OedSysidError
from oed_sysid.runtime.journal import CellStore
from oed_sysid.runtime.version import __version__

Tell = Callable[[str], None]
# Results held in memory; the oldest go first, and are read again from the disk when asked for.
_HELD = 40
# Results on disk, the longest unused go first.
_STORED = 400
# Seconds that a stopped process is given before it is killed.
_GRACE = 2.0


@dataclass(eq=False)
class Job:
    """One piece of work.

    Attributes
    ----------
    state : str
        ``"running"``, ``"done"``, ``"failed"`` or ``"stopped"``.
    doing : str
        What it told last.
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

    def stop(self) -> None:
        """End it now, with every process that it started."""
        if not self.at_work:
            return
        self._end("stopped")
        if self._process is not None:
            _terminate(self._process)

    def take(self, process: subprocess.Popen[bytes]) -> None:
        """Be done by a process, which ends at once if the job was stopped before it began."""
        self._process = process
        if self.state == "stopped":
            _terminate(process)

    def follow(self, process: subprocess.Popen[bytes], settle: Callable[[Job], None]) -> None:
        """Listen to what a process tells until it ends; ``settle`` fetches its result."""
        assert process.stdout is not None
        said: Any = None
        with suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                said = pickle.load(process.stdout)
                if isinstance(said, str):
                    self.doing = said[:1].upper() + said[1:]
        code = process.wait()
        if self.state == "stopped":
            return
        if isinstance(said, Done):
            settle(self)
            self._end("done" if self.result is not None else "failed")
        elif isinstance(said, Failed):
            self.failure = said.words
            self._end("failed")
        else:
            self.failure = (
                f"The work ended without a result (exit code {code}). It was ended from outside, "
                "or the memory did not suffice: take fewer or shorter records, or try again."
            )
            self._end("failed")

    def _end(self, state: str) -> None:
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
        self._store = CellStore(folder)
        self._jobs: dict[tuple[str, str], Job] = {}
        self._lock = threading.Lock()
        # Work that nobody can look at any more ends with the program.
        weakref.finalize(self, _stop_all, self._jobs)

    def find(self, owner: str, key: str) -> Job | None:
        """Job that one study asked for under a key, or a result that is there already."""
        job = self._jobs.get((owner, key))
        if job is not None and job.state != "failed" and job.state != "stopped":
            return job
        with self._lock:
            kept = self._read(key)
            if kept is None:
                return job
            return self._hold(owner, key, Job("done", result=kept))

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
        found = self.find(owner, key)
        if found is not None and found.state in ("running", "done"):
            return found
        with self._lock:
            job = self._hold(owner, key, Job())
        threading.Thread(
            target=self._run, args=(job, key, request), daemon=True, name="oed_sysid job"
        ).start()
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
                [sys.executable, "-m", "oed_sysid.app.work"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=os.name == "posix",  # its own group: stopped as one
            )
            assert process.stdin is not None
            # Before the request is written: that waits until a large one is read, seconds later.
            job.take(process)
            # The pipe stays open: its end tells the process that the page is gone.
            with suppress(BrokenPipeError):  # it was stopped, or ended: `follow` says so
                pickle.dump((str(self._store.folder), _name(key), request), process.stdin)
                process.stdin.flush()
            job.follow(process, partial(self._settle, key))
        except OedSysidError as error:
            job.failure = str(error)
            job._end("failed")
        except Exception as error:
            job.failure = unexpected(error)
            job._end("failed")

    def _settle(self, key: str, job: Job) -> None:
        job.result = self._read(key)
        if job.result is None:
            job.failure = "The result could not be read back. Try again."
        _prune(self._store.folder)

    def _read(self, key: str) -> Any:
        place = self._store.path(_name(key))
        if not place.is_file():
            return None
        with suppress(OSError):
            os.utime(place)
        packed = self._store.find([_name(key)]).get(_name(key))
        return None if packed is None else unpacked(packed)

    def _hold(self, owner: str, key: str, job: Job) -> Job:
        self._jobs[owner, key] = job
        if job.state == "done":
            job.ended.set()
        for old in [k for k, j in self._jobs.items() if not j.at_work][:-_HELD]:
            del self._jobs[old]
        return job


def _name(key: str) -> str:
    """Name of a result: what was asked, and the program that answered."""
    return f"{key} {_edition()}"


@cache
def _edition() -> str:
    """Version of the package, and when its files were last changed."""
    root = Path(__file__).parents[1]
    newest = max((file.stat().st_mtime_ns for file in root.rglob("*.py")), default=0)
    return f"{__version__} {newest}"


def _prune(folder: Path) -> None:
    """Forget the results that were not looked at for longest."""
    with suppress(OSError):
        found = sorted(folder.glob("*.cell"), key=lambda file: file.stat().st_mtime)
        for file in found[:-_STORED]:
            file.unlink(missing_ok=True)


def _terminate(process: subprocess.Popen[bytes]) -> None:
    """End a process and those that it started."""
    _signal(process, signal.SIGTERM)
    with suppress(subprocess.TimeoutExpired):
        process.wait(_GRACE)
        return
    _signal(process, getattr(signal, "SIGKILL", signal.SIGTERM))


def _signal(process: subprocess.Popen[bytes], number: int) -> None:
    if process.poll() is not None:
        return  # its number may be another's by now
    with suppress(OSError):
        if os.name == "posix":
            os.killpg(process.pid, number)
        else:
            process.kill()


def _stop_all(jobs: dict[tuple[str, str], Job]) -> None:
    for job in list(jobs.values()):
        job.stop()
