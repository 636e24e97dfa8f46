"""What the commands say: text, tables, notes, progress, and results as JSON.

Results go to standard output, everything about the way there to standard
error, so that ``oed-sysid fit ... > fit.txt`` holds the report and no more.
"""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oed_sysid.files import write_text

if TYPE_CHECKING:
    from oed_sysid.batch.journal import Journal
    from oed_sysid.compatibility import LogCheck
    from oed_sysid.data.dataset import Dataset
    from oed_sysid.fitting.gauss_newton import Progress

# Exit code of a command that Ctrl-C ended.
INTERRUPTED = 130


def say(text: str = "") -> None:
    """Print a result."""
    print(text)


def note(text: str) -> None:
    """Print something worth knowing that is not the result."""
    print(text, file=sys.stderr)


def say_log(log: LogCheck) -> None:
    """Print, above a result, what speaks against the log that it is made from."""
    warning = log.warning()
    if warning:
        say(warning)
        say()


def table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows of text as a table; the last column wraps at the window's width."""
    from rich.console import Console
    from rich.table import Table

    wide = None if sys.stdout.isatty() else 200
    grid = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
    for index, header in enumerate(headers):
        grid.add_column(header, no_wrap=index < len(headers) - 1)
    for row in rows:
        grid.add_row(*row)
    Console(width=wide, highlight=False, markup=False).print(grid)


class Shown:
    """A line on the terminal that says what is being done.

    Parameters
    ----------
    update : callable
        Shows a text.
    what : str
        What is being done.
    """

    def __init__(self, update: Callable[[str], None], what: str) -> None:
        self._update = update
        self._what = what

    def say(self, what: str) -> None:
        """Tell what is being done from now on."""
        self._what = what[:1].upper() + what[1:]
        self._update(self._what)

    def iteration(self, state: Progress) -> None:
        """Tell how far a fit is; an estimator's ``progress``."""
        self._update(f"{self._what}: iteration {state.iteration}, cost {state.cost:.6g}")


@contextmanager
def progress(what: str) -> Iterator[Shown]:
    """Show what is being done, and for how long, on a terminal; nothing in a pipe.

    Parameters
    ----------
    what : str
        What is being done first.

    Yields
    ------
    Shown
        To be told how things go on.
    """
    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what, total=None)
        yield Shown(lambda text: bar.update(task, description=text), what)


@contextmanager
def journal(folder: Path | None, fresh: bool) -> Iterator[Journal]:
    """Keep finished steps of a command until everything it was asked for is written.

    Parameters
    ----------
    folder : Path or None
        Where; None means the user's cache.
    fresh : bool
        Whether what an earlier call has kept is forgotten.

    Yields
    ------
    Journal
        For the calculation.
    """
    import typer

    from oed_sysid.batch.journal import Journal, unfinished_folder

    try:
        place = folder or unfinished_folder()
    except OSError as error:
        place = None
        note(f"Finished steps are not kept: {error}. Give a folder with --journal.")
    kept = Journal(place, fresh=fresh, tell=note)
    try:
        yield kept
    except typer.Exit as end:
        if end.exit_code != INTERRUPTED:
            kept.close()
            raise
        _say_kept(kept)
        raise
    except BaseException:
        _say_kept(kept)
        raise
    kept.close()


def _say_kept(kept: Journal) -> None:
    if kept.n_steps:
        steps = "step is" if kept.n_steps == 1 else "steps are"
        note(f"{kept.n_steps} finished {steps} kept: the same command goes on from there.")


def store(
    result: Mapping[str, Any], path: Path | None, *, records: Iterable[Dataset | None] = ()
) -> None:
    """Write a result as JSON where the user asked for it, and beside it how it was made.

    Numbers that JSON cannot hold (NaN, infinity) become ``null``.

    Parameters
    ----------
    result : mapping
        The result.
    path : Path or None
        The file; ``None`` writes nothing.
    records : iterable of Dataset or None
        What the result depends on; their hashes are written.
    """
    if path is None:
        return
    from oed_sysid.fitting.saved import made_by

    command, settings = invocation()
    present = [dataset for dataset in records if dataset is not None]
    made = made_by(present, command=command, settings=settings)
    text = json.dumps(_plain({**result, "oed_sysid": made}), indent=2, allow_nan=False)
    write(text + "\n", path)


def invocation() -> tuple[str, dict[str, Any]]:
    """Return the command line that is being worked on, and every option of it."""
    try:  # typer carries its own copy of click since 0.20
        from typer._click.globals import get_current_context
    except ImportError:
        from click import get_current_context  # type: ignore[no-redef]

    context = get_current_context(silent=True)
    if context is None:
        return "", {}
    settings = {name: _plain(value) for name, value in context.params.items()}
    given = context.find_root().obj or ()
    return shlex.join(["oed-sysid", *given]), settings


def write(text: str, path: Path) -> None:
    """Write a text file and say so."""
    write_text(path, text)
    note(f"Written: {path}")


def _plain(value: Any) -> Any:
    """Turn tuples, NumPy values and paths into what JSON has."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)
