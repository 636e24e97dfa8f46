"""What the commands say: text, tables, notes, progress, and results as JSON.

Results go to standard output, everything about the way there to standard
error, so that ``oed-sysid fit ... > fit.txt`` holds the report and no more.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oed_sysid.files import write_text

if TYPE_CHECKING:
    from oed_sysid.fitting.gauss_newton import Progress


def say(text: str = "") -> None:
    """Print a result."""
    print(text)


def note(text: str) -> None:
    """Print something worth knowing that is not the result."""
    print(text, file=sys.stderr)


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


def store(result: Mapping[str, Any], path: Path | None) -> None:
    """Write a result as JSON where the user asked for it.

    Numbers that JSON cannot hold (NaN, infinity) become ``null``.
    """
    if path is None:
        return
    write(json.dumps(_plain(result), indent=2, allow_nan=False) + "\n", path)


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
