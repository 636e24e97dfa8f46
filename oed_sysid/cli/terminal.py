"""What the commands say: text, tables, notes, progress, and results as JSON.

Results go to standard output, everything about the way there to standard
error, so that ``oed-sysid fit ... > fit.txt`` holds the report and no more.
"""

from __future__ import annotations

import json
import math
import os
import shlex
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from oed_sysid.cli import INTERRUPTED
from oed_sysid.cli.options import SHARED
from oed_sysid.runtime.constants import IMMATERIAL, PATIENCE
from oed_sysid.runtime.display import plain
from oed_sysid.runtime.files import write_text

if TYPE_CHECKING:
    from oed_sysid.cli.study import Outcome
    from oed_sysid.data.dataset import Dataset
    from oed_sysid.likelihood.gauss_newton import Progress
    from oed_sysid.runtime.display import Figure
    from oed_sysid.runtime.journal import Journal

# A file name that means standard output.
STANDARD = Path("-")
# Bold red, and back.
_RED, _PLAIN = "\x1b[1;31m", "\x1b[0m"


def out(text: str) -> None:
    """Print on standard output, or on standard error where ``--json -`` has the former.

    Whoever reads may stop, as ``head`` does: the rest is left unsaid, and files are written all
    the same.
    """
    put(text, sys.stderr if asked("json_file") == STANDARD else sys.stdout)


def put(text: str, stream: IO[str]) -> None:
    """Print on a stream that may have been closed at its other end."""
    try:
        print(text, file=stream, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def say(text: str = "") -> None:
    """Print a result."""
    if not quiet():
        out(text)


def answer(text: str, report: str = "") -> None:
    """Print the answer in one line, and below it what it rests on.

    Parameters
    ----------
    text : str
        One line that answers the question of the command; all that ``--quiet`` leaves.
    report : str
        Everything else.
    """
    out(alarming(text))
    if report and not quiet():
        out(f"\n{report}")


def asked(name: str) -> Any:
    """Where the user wants a file of the command that is being worked on; None if nowhere."""
    return getattr(_context(), "params", {}).get(name)


def deliver(outcome: Outcome, records: Iterable[Dataset | None] = (), *, text: str = "") -> None:
    """Print an outcome, and write what the user asked for: numbers, a page, a picture.

    Parameters
    ----------
    outcome : Outcome
        The answer of its report is printed first.
    records : iterable of Dataset or None
        What the result depends on.
    text : str
        What is printed below the answer; by default the text of the report.
    """
    if outcome.above:
        say(f"{outcome.above}\n")
    if asked("form") == "latex":
        out(outcome.said.latex())
    else:
        answer(outcome.said.answer, text or outcome.said.text())
    store(outcome.facts, records=records)
    if (place := asked("html_file")) is not None:
        note(f"Written: {outcome.document().write(place)}")
    if outcome.figure is not None:
        draw(outcome.figure, asked("picture"))
    for line in outcome.notes:
        note(line)


def alarming(text: str) -> str:
    """Return a line in red and bold if it warns of danger and a person reads it on a terminal.

    Files and pipes get plain text, and so does everybody who has set ``NO_COLOR``
    (https://no-color.org).
    """
    if not text.startswith("DANGER") or os.environ.get("NO_COLOR") or not sys.stdout.isatty():
        return text
    return f"{_RED}{text}{_PLAIN}"


def note(text: str) -> None:
    """Print something worth knowing that is not the result."""
    if not quiet():
        put(text, sys.stderr)


def quiet() -> bool:
    """Whether the command that is being worked on was asked for its answer alone."""
    return bool(asked("quiet"))


class Shown:
    """What is being done, and for how much longer.

    Parameters
    ----------
    what : str
        What is being done.
    clock : callable
        Returns seconds.
    journal : Journal, optional
        Where finished steps are kept.
    told : callable, optional
        Called with words, and the seconds that are left or None, when something else is being
        done, or more is known.
    """

    def __init__(
        self,
        what: str = "",
        clock: Callable[[], float] = time.monotonic,
        *,
        journal: Journal | None = None,
        told: Callable[[str, float | None], None] | None = None,
    ) -> None:
        from oed_sysid.runtime.journal import Journal

        self.journal = Journal() if journal is None else journal
        self.note = note
        self._told = told
        self._clock = clock
        self._began = clock()
        self._what = what
        self._detail = ""
        self._fitting = False
        self._first: tuple[float, float] | None = None
        self._end: float | None = None  # when the work will be done, by the clock
        self._left_of = ""  # of which part, and whether that is a bound
        self._reached = (self._began, 0.0)  # when the present pass began, and the share done then
        self._done = 0.0

    def say(self, what: str) -> None:
        """Tell what is being done from now on."""
        self._what, self._detail, self._first = what[:1].upper() + what[1:], "", None
        if self._fitting:
            self._end, self._fitting = None, False
        self._tell()

    def iteration(self, state: Progress, tolerance: float = 1e-6) -> None:
        """Tell how far a fit is; an estimator's ``progress``.

        The decrease that the next step promises falls about as fast from step to step, so its
        logarithm tells how far it is to the tolerance.
        """
        self._detail = f"iteration {state.iteration}, cost {state.cost:.6g}"
        now, here = self._clock(), math.log(state.decrement) if state.decrement > 0 else math.inf
        if state.iteration <= 1 or self._first is None or self._first[1] < here < math.inf:
            self._first = (now, here)
        began, top = self._first
        if now > began and top - here > 1.0:
            speed = (top - here) / (now - began)
            self._end = now + max(0.0, (here - math.log(tolerance)) / speed)
            self._left_of, self._fitting = "", True
        self._tell()

    def share(self, done: float, *, at_most: bool = False, of: str = "") -> None:
        """Tell which share of the work is done; one that falls begins another pass.

        Parameters
        ----------
        done : float
            Between 0 and 1.
        at_most : bool
            Whether the work may end earlier.
        of : str
            Of which part of the work, if others may follow.
        """
        now = self._clock()
        if done < self._done:
            # Passes before tell nothing of this one, which may weigh more vehicles.
            self._reached, self._end = (now, done), None
        self._done = done
        began, before = self._reached
        if before < done <= 1.0:
            seconds = (now - began) * (1.0 - done) / (done - before)
            self.left(seconds, at_most=at_most, of=of)

    def left(self, seconds: float, *, at_most: bool = False, of: str = "") -> None:
        """Tell how many seconds are left."""
        self._end = self._clock() + seconds
        self._left_of = f" of {of}" * bool(of) + ", or less" * at_most
        self._tell()

    def _tell(self) -> None:
        if self._told is not None:
            self._told(", ".join(filter(None, (self.doing, self.remaining))), self._seconds)

    @property
    def doing(self) -> str:
        """What is being done."""
        return f"{self._what}: {self._detail}" if self._detail else self._what

    @property
    def _seconds(self) -> float | None:
        """How many seconds are left; None where that is not known, or was said and is over."""
        left = 0.0 if self._end is None else self._end - self._clock()
        return left if left > 0.0 else None

    @property
    def remaining(self) -> str:
        """How much longer it takes; empty where nothing was ever told of that.

        Rounds that are left are a bound, their length is not: later ones may take longer.
        """
        if self._end is None:
            return ""
        if (left := self._seconds) is None:
            return "time left not known"
        return f"about {_duration(left)} left{self._left_of}"

    @property
    def line(self) -> str:
        """What is being done, with the time since the beginning and the time left."""
        times = (_duration(self._clock() - self._began), self.remaining)
        return f"{self.doing} ({', '.join(filter(None, times))})"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 90 else f"{minutes / 60:.1f} h"


@contextmanager
def progress(what: str, journal: Journal | None = None) -> Iterator[Shown]:
    """Show what is being done and for how much longer, once it takes two seconds.

    On a terminal in one line that goes away; elsewhere as plain lines on standard error, the
    more seldom the longer it takes.

    Parameters
    ----------
    what : str
        What is being done first.
    journal : Journal, optional
        Where finished steps are kept.

    Yields
    ------
    Shown
        To be told how things go on.
    """
    shown = Shown(what, journal=journal)
    if quiet():
        yield shown
        return
    ended = threading.Event()
    stream = sys.stderr
    lasting = not stream.isatty()

    def tell() -> None:
        width, wait, begun = 0, PATIENCE, time.monotonic()
        while not ended.wait(wait):
            line = shown.line
            try:
                if lasting:
                    print(line, file=stream, flush=True)
                else:
                    line = line[: shutil.get_terminal_size().columns - 1]
                    print(f"\r{line:<{width}}", end="", file=stream, flush=True)
                    width = len(line)
            except (OSError, ValueError):  # the stream is closed
                return
            # Lines that stay come the more seldom the longer it takes.
            wait = max(PATIENCE, IMMATERIAL * (time.monotonic() - begun)) if lasting else 0.2
        if width:
            print(f"\r{'':<{width}}\r", end="", file=stream, flush=True)

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield shown
    finally:
        ended.set()
        teller.join(timeout=1.0)


@contextmanager
def journal(folder: Path | None, fresh: bool = False, *, keeping: bool = True) -> Iterator[Journal]:
    """Keep finished steps of a command until everything it was asked for is written.

    Parameters
    ----------
    folder : Path or None
        Where; None means the user's cache.
    fresh : bool
        Whether what an earlier call has kept is forgotten.
    keeping : bool
        Whether anything is kept.

    Yields
    ------
    Journal
        For the calculation.
    """
    import typer

    from oed_sysid.runtime.journal import Journal, unfinished_folder

    try:
        place = (folder or unfinished_folder()) if keeping else None
    except OSError as error:
        place = None
        note(f"Finished steps are not kept: {error}. Give a folder with --journal.")
    kept = Journal(place, fresh=fresh, tell=note)
    try:
        yield kept
    except BaseException as end:
        if isinstance(end, typer.Exit) and end.exit_code != INTERRUPTED:
            kept.close()
        elif kept.n_steps:
            steps = "step is" if kept.n_steps == 1 else "steps are"
            note(f"{kept.n_steps} finished {steps} kept: the same command goes on from there.")
        raise
    kept.close()


def store(
    result: Mapping[str, Any], path: Path | None = None, *, records: Iterable[Dataset | None] = ()
) -> None:
    """Write a result as JSON where the user asked for it, and beside it how it was made.

    Numbers that JSON cannot hold (NaN, infinity) become ``null``.

    Parameters
    ----------
    result : mapping
        The result.
    path : Path, optional
        The file, by default that of ``--json``; nothing is written where that is not given.
    records : iterable of Dataset or None
        What the result depends on; their hashes are written.
    """
    if (path := path or asked("json_file")) is None:
        return
    from oed_sysid.likelihood.archive import made_by

    command, settings = invocation()
    present = [dataset for dataset in records if dataset is not None]
    made = made_by(present, command=command, settings=settings)
    text = json.dumps(plain({**result, "oed_sysid": made}), indent=2, allow_nan=False)
    if path == STANDARD:
        put(text, sys.stdout)
    else:
        write(text + "\n", path)


def invocation() -> tuple[str, dict[str, Any]]:
    """Return the command line that is being worked on, and every option of it."""
    context = _context()
    if context is None:
        return "", {}
    own = (one for one in context.params.items() if one[0] not in SHARED)
    settings = {name: plain(value) for name, value in own}
    given = context.find_root().obj or ()
    return shlex.join(["oed-sysid", *given]), settings


def _context() -> Any:
    """The call that is being worked on; None outside of one."""
    try:  # typer carries its own copy of click since 0.20
        from typer._click.globals import get_current_context
    except ImportError:
        from click import get_current_context  # type: ignore[no-redef]

    return get_current_context(silent=True)


def draw(figure: Figure, path: Path | None) -> None:
    """Draw a figure of a document where the user asked for it, and say so."""
    if path is None:
        return
    from oed_sysid.results import save_figure
    from oed_sysid.results.page import draw as drawn

    save_figure(drawn(figure), path, dpi=150, bbox_inches="tight")
    note(f"Written: {path}")


def write(text: str, path: Path) -> None:
    """Write a text file and say so."""
    write_text(path, text)
    note(f"Written: {path}")
