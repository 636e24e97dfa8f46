"""Long work beside the page: one job after another, kept by what was asked.

A page asks for a job and is drawn again and again while it runs; a click, a
change of page or a reload of the browser does not disturb it.
"""

from __future__ import annotations

import queue
import threading
import time
import traceback
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any

from oed_sysid.errors import OedSysidError

Tell = Callable[[str], None]
# Results that are kept; the oldest go first.
_KEPT = 40
# Seconds after which a session that no longer looks has gone.
_AWAY = 10.0


class StoppedError(Exception):
    """The user does not want to wait any longer."""


@dataclass(eq=False)
class Job:
    """One piece of work.

    Attributes
    ----------
    work : callable
        ``(tell) -> result``; it tells in words what it is doing.
    state : str
        ``"waiting"``, ``"running"``, ``"done"``, ``"failed"`` or ``"stopped"``.
    doing : str
        What it told last.
    result : object
        What it returned, once done.
    failure : str
        What went wrong, in words.
    """

    work: Callable[[Tell], Any]
    state: str = "waiting"
    doing: str = "Waiting for the work before"
    result: Any = None
    failure: str = ""
    began: float = field(default_factory=time.monotonic)
    ended: threading.Event = field(default_factory=threading.Event)
    _stop: bool = False
    _seen: dict[str, float] = field(default_factory=dict)

    @property
    def at_work(self) -> bool:
        """Whether there is no outcome yet."""
        return self.state in ("waiting", "running")

    @property
    def seconds(self) -> float:
        """How long it has been asked for, s."""
        return time.monotonic() - self.began

    def look(self, who: str) -> None:
        """Note that a session waits for it."""
        self._seen[who] = time.monotonic()

    def stop(self, who: str = "") -> bool:
        """End it when it next tells what it is doing, unless another session waits for it too.

        Returns
        -------
        bool
            Whether it will end.
        """
        self._seen.pop(who, None)
        now = time.monotonic()
        if all(now - last > _AWAY for last in self._seen.values()):
            self._stop = True
        return self._stop

    def tell(self, what: str) -> None:
        """Note what is being done; ends the work if it is to stop."""
        if self._stop:
            raise StoppedError
        self.doing = what[:1].upper() + what[1:]

    def run(self) -> None:
        """Do the work; whatever happens ends up in ``state``."""
        try:
            self.state = "running"
            self.tell("starting")
            self.result = self.work(self.tell)
            self.state = "done"
        except StoppedError:
            self.state = "stopped"
        except OedSysidError as error:
            self.failure, self.state = str(error), "failed"
        except Exception as error:
            traceback.print_exc()  # for the terminal; the page says it in words
            self.failure = unexpected(error)
            self.state = "failed"
        finally:
            self.ended.set()


class Desk:
    """Does jobs one after another in a thread of its own, and keeps their results."""

    def __init__(self) -> None:
        self._jobs: dict[Hashable, Job] = {}
        self._queue: queue.Queue[Job] = queue.Queue()
        self._lock = threading.Lock()
        # A daemon: the program ends when the user ends it, whatever is being worked on.
        threading.Thread(target=self._work, daemon=True, name="oed_sysid jobs").start()

    def find(self, key: Hashable) -> Job | None:
        """Job that was asked for under a key, if any."""
        return self._jobs.get(key)

    def ask(self, key: Hashable, work: Callable[[Tell], Any]) -> Job:
        """Return the job of a key; a new one unless it is at work or done."""
        with self._lock:
            job = self._jobs.get(key)
            if job is None or job.state in ("failed", "stopped"):
                job = self._jobs[key] = Job(work)
                self._queue.put(job)
                for old in [k for k, j in self._jobs.items() if not j.at_work][:-_KEPT]:
                    del self._jobs[old]
            return job

    def wait(self) -> None:
        """Wait until nothing is being worked on."""
        for job in list(self._jobs.values()):
            job.ended.wait()

    def _work(self) -> None:
        while True:
            self._queue.get().run()


def unexpected(error: Exception) -> str:
    """Say that something happened which is not the user's fault."""
    return (
        f"Unexpected error: {type(error).__name__}: {error}. This is a fault of the program. The "
        "terminal in which it was started shows where; please report it."
    )
