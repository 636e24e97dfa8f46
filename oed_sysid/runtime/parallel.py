"""Many independent calculations: on all cores, on a cluster, and never twice.

Monte-Carlo runs, grids of a benchmark and multistarts are *cells*: a name, and
what one function needs to calculate it. joblib spreads them over processes;
inside ``joblib.parallel_config(backend="dask")`` the same call spreads them
over the machines of a dask cluster:

    from dask.distributed import Client
    with Client("scheduler:8786"), joblib.parallel_config(backend="dask"):
        run_cells(work, cells, store="out/study")

:func:`spread_over` is this context for everything that a program calculates within it.

Every process uses one thread for linear algebra: with a cell per core, more
threads only get in each other's way.
"""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Callable, Container, Generator, Iterator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import closing, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from oed_sysid.errors import OedSysidError
from oed_sysid.runtime.journal import CellStore
from oed_sysid.runtime.threads import one_thread

Cell = TypeVar("Cell")
Result = TypeVar("Result")


class ParallelError(OedSysidError):
    """Some cells could not be calculated."""


@dataclass(frozen=True)
class CellProgress:
    """What is told after each finished cell.

    Attributes
    ----------
    key : str
        The cell that has just finished.
    n_done, n_cells : int
        Cells that are there, and all cells.
    n_kept : int
        Cells that the store already held.
    seconds, seconds_left : float
        Since the beginning, and until the end if the others take as long.
    """

    key: str
    n_done: int
    n_cells: int
    n_kept: int
    seconds: float
    seconds_left: float

    def __str__(self) -> str:
        return f"{self.n_done}/{self.n_cells} {self.key} ({self.seconds_left / 60:.1f} min left)"


# Who is told of the cells of a program.
_told: ContextVar[Callable[[CellProgress], None] | None] = ContextVar("told", default=None)


@dataclass(frozen=True)
class _Outcome(Generic[Result]):
    """Result of one cell, or what went wrong there."""

    key: str
    result: Result | None
    error: str = ""


@contextmanager
def spread_over(
    cluster: str | None = None,
    *,
    n_jobs: int = 1,
    progress: Callable[[CellProgress], None] | None = None,
) -> Iterator[None]:
    """Spread the calculations that name no number of processes over cores or a cluster.

    Parameters
    ----------
    cluster : str, optional
        Address of a dask scheduler, such as ``tcp://10.0.0.5:8786``; its workers need the package.
    n_jobs : int
        Processes of this computer where there is no cluster.
    progress : callable, optional
        Told after every cell of theirs.

    Raises
    ------
    ParallelError
        If no scheduler answers there, or dask is not installed.

    Examples
    --------
    >>> with spread_over(n_jobs=1):
    ...     run_cells(abs, {"one": -1}, n_jobs=None)
    {'one': 1}
    """
    from joblib import parallel_config

    before = _told.set(progress)
    try:
        if cluster is None:
            with parallel_config(n_jobs=n_jobs):
                yield
        else:
            with _client(cluster), parallel_config(backend="dask"):
                yield
    finally:
        _told.reset(before)


def _client(cluster: str) -> Any:
    """A client of a dask cluster."""
    try:
        from distributed import Client

        return Client(cluster, timeout=10.0)
    except ImportError as error:
        raise ParallelError(
            "A cluster needs dask: pip install 'oed-sysid[dask]', here and on its workers."
        ) from error
    except (OSError, ValueError) as error:  # a timeout is an OSError
        raise ParallelError(
            f"No dask scheduler answers at {cluster!r} ({error}). Start one (dask scheduler), give "
            "its address, or leave the cluster out."
        ) from error


def run_cells(
    work: Callable[[Cell], Result],
    cells: Mapping[str, Cell],
    *,
    store: str | Path | None = None,
    n_jobs: int | None = -1,
    progress: Callable[[CellProgress], None] | None = None,
) -> dict[str, Result]:
    """Calculate all cells, those that are not in the store.

    Parameters
    ----------
    work : callable
        From a cell to its result; the same cell must give the same result, so
        random numbers come from a seed in the cell.
    cells : mapping of str to cell
        What each calculation needs, by a name that says what shapes its result.
    store : path, optional
        Folder that keeps the result of every finished cell (see
        :class:`~oed_sysid.runtime.journal.CellStore`). A later call, also after a
        crash or with more cells, calculates only what is missing. Without a
        store an error in one cell ends everything; with one, the others finish.
    n_jobs : int or None
        Processes; all cores, or all of the cluster, by default. 1 stays in
        this process; None is what :func:`spread_over` says, this process without it.
    progress : callable, optional
        Called in this process after every cell with a :class:`CellProgress`; by default whoever
        :func:`spread_over` names.

    Returns
    -------
    dict
        Results by name, in the order of ``cells``.

    Raises
    ------
    ParallelError
        If the work fails in some cells, or workers die over and over.

    Examples
    --------
    >>> run_cells(abs, {"one": -1, "two": 2}, n_jobs=1)
    {'one': 1, 'two': 2}
    """
    progress = progress or _told.get()
    keeper = None if store is None else CellStore(Path(store))
    results: dict[str, Result] = keeper.find(cells) if keeper else {}
    n_kept, began = len(results), time.perf_counter()
    failures: dict[str, str] = {}
    with closing(_outcomes(work, cells, results.copy(), keeper, n_jobs)) as outcomes:
        for outcome in outcomes:
            if outcome.error:
                failures[outcome.key] = outcome.error
                if keeper is None:
                    break
                continue
            results[outcome.key] = cast(Result, outcome.result)
            if progress is not None:
                seconds, n_done = time.perf_counter() - began, len(results)
                left = seconds / (n_done - n_kept) * (len(cells) - n_done)
                progress(CellProgress(outcome.key, n_done, len(cells), n_kept, seconds, left))
    if failures:
        raise ParallelError(_explain(failures, len(cells), keeper))
    return {key: results[key] for key in cells}


def _outcomes(
    work: Callable[[Cell], Result],
    cells: Mapping[str, Cell],
    kept: Container[str],
    keeper: CellStore | None,
    n_jobs: int | None,
) -> Generator[_Outcome[Result], None, None]:
    """Yield outcomes of all cells that are not kept, and keep them; go on where workers die."""
    left = {key: cell for key, cell in cells.items() if key not in kept}
    before = -1
    while True:
        try:
            with closing(_calculate(work, left.copy(), keeper, n_jobs)) as outcomes:
                for outcome in outcomes:
                    del left[outcome.key]
                    if keeper is not None and not outcome.error:
                        keeper.write(outcome.key, outcome.result)
                    yield outcome
            return
        except _lost_worker() as error:
            # A worker may die of something outside; cells that take theirs along twice will again.
            if len(left) == before:
                raise ParallelError(
                    f"Worker processes died again and again with {len(left)} of {len(cells)} cells "
                    f"left ({str(error).partition('. ')[0]}). Memory is the usual reason: lower "
                    "n_jobs, or make cells smaller."
                ) from error
            before = len(left)


def _calculate(
    work: Callable[[Cell], Result],
    cells: Mapping[str, Cell],
    keeper: CellStore | None,
    n_jobs: int | None,
) -> Generator[_Outcome[Result], None, None]:
    """Yield outcomes as they arrive."""
    from joblib import Parallel, delayed  # a fifth of a second that most programs do not need

    elsewhere: dict[str, Result] = {}

    def tasks() -> Iterator[Any]:
        # joblib takes tasks when it needs them: meanwhile another run on the same
        # store may have finished some.
        for key, cell in cells.items():
            found = keeper.find([key]) if keeper is not None else {}
            elsewhere.update(found)
            if not found:
                yield delayed(_call)(work, key, cell)

    if cells:
        yield from Parallel(n_jobs=n_jobs, return_as="generator_unordered")(tasks())
    for key, result in elsewhere.items():
        yield _Outcome(key, result)


def _call(work: Callable[[Cell], Result], key: str, cell: Cell) -> _Outcome[Result]:
    """One cell, on one thread; errors travel as text, which every process can read."""
    try:
        with one_thread():
            return _Outcome(key, work(cell))
    except Exception as error:  # whatever the work raises
        where = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(where.filename).name}, line {where.lineno}"
        return _Outcome(key, None, f"{type(error).__name__}: {error} ({place})")


def _lost_worker() -> tuple[type[BaseException], ...]:
    """Exceptions that tell of a worker that is gone, from joblib and, if in use, dask."""
    kinds: list[type[BaseException]] = [BrokenExecutor, CancelledError]
    if "distributed" in sys.modules:
        from distributed import KilledWorker
        from distributed.client import FutureCancelledError

        kinds += [KilledWorker, FutureCancelledError]
    return tuple(kinds)


def _explain(failures: Mapping[str, str], n_cells: int, keeper: CellStore | None) -> str:
    shown = "; ".join(f"{key!r}: {text}" for key, text in list(failures.items())[:3])
    kept = (
        "Give store= to keep what other cells have calculated."
        if keeper is None
        else f"All others are kept in {keeper.folder}; mend these and call again."
    )
    return f"{len(failures)} of {n_cells} cells failed. {shown}. {kept}"
