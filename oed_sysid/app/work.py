"""The process in which a job runs: it is told the work, tells how far it is, keeps the result.

Run as ``python -m oed_sysid.app.work`` by :mod:`oed_sysid.app.jobs`: the request comes over
standard input, words on progress go over standard output, and the result into a store that only
this user's processes can write to. When standard input ends, the page is gone, and so is the work.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle

from oed_sysid.app.study import Study
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import OedSysidError
from oed_sysid.experiments.problem import load_problem
from oed_sysid.runtime.journal import CellStore


@dataclass(frozen=True)
class Done:
    """The result is in the store."""


@dataclass(frozen=True)
class Failed:
    """What went wrong, in words."""

    words: str


@dataclass(frozen=True, eq=False)
class Request:
    """Work to do, in a form that another process understands.

    Parameters
    ----------
    task : callable
        ``(study, *arguments, tell) -> Outcome``: a function of a module.
    arguments : tuple
        What it is given beside the study.
    source, variant : str
        Problem and which of its models; it is loaded anew, not sent.
    train, test : Dataset or None
        Records.
    known_noise : bool
        As in :class:`~oed_sysid.app.study.Study`.
    """

    task: Callable[..., Any]
    arguments: tuple[Any, ...]
    source: str
    variant: str
    train: Dataset | None
    test: Dataset | None
    known_noise: bool

    @classmethod
    def of(cls, study: Study, task: Callable[..., Any], *arguments: Any) -> Request:
        """Ask for a task on a study."""
        return cls(
            task,
            arguments,
            study.source,
            study.variant,
            study.train,
            study.test,
            study.known_noise,
        )

    def study(self) -> Study:
        """The study, its problem loaded here."""
        variant = None if self.variant == "default" else self.variant
        problem = load_problem(self.source, variant=variant)
        return Study(self.source, self.variant, problem, self.train, self.test, self.known_noise)


def packed(result: Any) -> bytes:
    """A result as bytes, functions of a problem's own file included."""
    content: bytes = cloudpickle.dumps(result)
    return content


def unpacked(content: bytes) -> Any:
    """The result, or None where what it is made of has changed since.

    >>> unpacked(packed((1, "two"))), unpacked(b"torn")
    ((1, 'two'), None)
    """
    try:
        return pickle.loads(content)
    except Exception:  # a class that was renamed, a problem that is not loaded
        return None


def unexpected(error: Exception) -> str:
    """Say that something happened which is not the user's fault.

    >>> print(unexpected(ValueError("no number"))[:41])
    Unexpected error: ValueError: no number.
    """
    return (
        f"Unexpected error: {type(error).__name__}: {error}. This is a fault of the program. The "
        "terminal in which it was started shows where; please report it."
    )


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
        say("starting")
        outcome = request.task(request.study(), *request.arguments, say)
        CellStore(Path(folder)).write(name, packed(outcome))
        say(Done())
    except OedSysidError as error:
        say(Failed(str(error)))
    except Exception as error:
        traceback.print_exc()  # for the terminal; the page says it in words
        say(Failed(unexpected(error)))
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
    # Named as jobs know it, so that what is pickled here is found there.
    from oed_sysid.app.work import main as run

    run()
