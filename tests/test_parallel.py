"""Cells on cores and clusters: each once, none lost; linear algebra on one thread."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import oed_sysid
from oed_sysid.runtime.journal import CellStore, unsealed
from oed_sysid.runtime.parallel import CellProgress, ParallelError, run_cells
from oed_sysid.runtime.threads import one_thread, single_threaded

CELLS = {f"seed {seed}": seed for seed in range(6)}


def draw(seed: int) -> float:
    """One reproducible number."""
    return float(np.random.default_rng(seed).standard_normal())


def traced(cell: tuple[Path, int]) -> int:
    """Leave a mark of every calculation."""
    folder, number = cell
    (folder / f"{number}-{os.getpid()}-{time.time_ns()}").touch()
    return number**2


def threads(_: object) -> int:
    """Return the most threads that any linear algebra library of this process may use."""
    a = np.ones((50, 50))
    a @ a
    return max(info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas")


def fail_at_two(number: int) -> int:
    """Fail for one of the cells."""
    if number == 2:
        raise ArithmeticError("two is too much")
    return number


def die_once(cell: tuple[Path, int]) -> int:
    """Take the worker along, the first time that cell 3 is calculated."""
    folder, number = cell
    flag = folder / "died"
    if number == 3 and not flag.exists():
        flag.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return traced(cell)


def die(_: object) -> None:
    """Take the worker along."""
    os.kill(os.getpid(), signal.SIGKILL)


def slow(cell: tuple[Path, int, np.ndarray]) -> tuple[int, int, float]:
    """Calculate for half a second; return what it was, where, and from all of the data."""
    folder, number, data = cell
    traced((folder, number))
    time.sleep(0.5)
    return number, os.getpid(), float(data.sum()) + number


def test_processes_give_what_a_loop_gives() -> None:
    """Two processes return the results of a plain loop, in the order of the cells."""
    plain = {key: draw(seed) for key, seed in CELLS.items()}
    found = run_cells(draw, CELLS, n_jobs=2)
    assert found == plain
    assert list(found) == list(CELLS)
    assert run_cells(draw, CELLS, n_jobs=1) == plain
    assert run_cells(draw, {}, n_jobs=1) == {}


def test_finished_cells_are_never_calculated_again(tmp_path: Path) -> None:
    """A second call with more cells calculates the new ones only."""
    marks, store = tmp_path / "marks", tmp_path / "store"
    marks.mkdir()
    cells = {str(n): (marks, n) for n in range(4)}
    run_cells(traced, cells, store=store, n_jobs=1)
    more = cells | {"9": (marks, 9)}
    seen: list[CellProgress] = []
    assert run_cells(traced, more, store=store, n_jobs=1, progress=seen.append)["9"] == 81
    assert sorted(int(p.name.split("-")[0]) for p in marks.iterdir()) == [0, 1, 2, 3, 9]
    assert [(p.key, p.n_done, p.n_cells, p.n_kept) for p in seen] == [("9", 5, 5, 4)]
    assert CellStore(store).find([*more, "none"]).keys() == more.keys()


def test_every_process_uses_one_thread_for_linear_algebra() -> None:
    """Within a cell BLAS has one thread, in this process and in others."""
    assert run_cells(threads, {"here": None}, n_jobs=1) == {"here": 1}
    assert set(run_cells(threads, {"a": 0, "b": 1}, n_jobs=2).values()) == {1}


def test_errors_name_the_cell_and_spare_the_others(tmp_path: Path) -> None:
    """With a store all other cells finish and are kept; without, the first error ends the run."""
    cells = {str(n): n for n in range(5)}
    with pytest.raises(ParallelError, match=r"1 of 5 cells failed. '2': ArithmeticError: two is"):
        run_cells(fail_at_two, cells, store=tmp_path, n_jobs=1)
    assert CellStore(tmp_path).find(cells) == {"0": 0, "1": 1, "3": 3, "4": 4}
    with pytest.raises(ParallelError, match="Give store="):
        run_cells(fail_at_two, cells, n_jobs=1)


@pytest.mark.parametrize("damage", ["empty", "half", "flipped"])
def test_torn_files_are_calculated_again(tmp_path: Path, damage: str) -> None:
    """A file that was not written to its end counts as missing."""
    run_cells(draw, CELLS, store=tmp_path, n_jobs=1)
    store = CellStore(tmp_path)
    path = store.path("seed 3")
    content = path.read_bytes()
    torn = {"empty": b"", "half": content[: len(content) // 2], "flipped": content[:-1] + b"!"}
    path.write_bytes(torn[damage])
    assert "seed 3" not in store.find(CELLS)
    assert run_cells(draw, CELLS, store=tmp_path, n_jobs=1)["seed 3"] == draw(3)
    assert store.find(["seed 3"]) == {"seed 3": draw(3)}


def test_several_writers_and_a_reader_never_see_half_a_file(tmp_path: Path) -> None:
    """While two processes write the same cells over and over, every read is whole."""
    code = (
        "import sys, numpy as np; from pathlib import Path; "
        "from oed_sysid.runtime.journal import CellStore; s = CellStore(Path(sys.argv[1]))\n"
        "for n in range(60): s.write(f'{n % 3}', np.full(20000, n % 3))"
    )
    writers = [subprocess.Popen([sys.executable, "-c", code, str(tmp_path)]) for _ in range(2)]
    store, n_read = CellStore(tmp_path), 0
    try:
        while any(writer.poll() is None for writer in writers):
            for key, value in store.find(["0", "1", "2"]).items():
                assert np.array_equal(value, np.full(20000, int(key)))
                n_read += 1
            for path in tmp_path.glob("*.cell"):
                assert unsealed(path.read_bytes()) is not None
    finally:
        codes = [writer.wait() for writer in writers]
    assert codes == [0, 0]
    assert n_read > 0
    assert not list(tmp_path.glob("*.part"))


def test_a_killed_process_costs_no_finished_cell(tmp_path: Path) -> None:
    """When a worker process dies, its cell is calculated by another one."""
    cells = {str(n): (tmp_path, n) for n in range(6)}
    found = run_cells(die_once, cells, store=tmp_path / "store", n_jobs=2)
    assert found == {str(n): n**2 for n in range(6)}
    assert (tmp_path / "died").exists()


@pytest.mark.slow
def test_a_deadly_cell_is_reported() -> None:
    """Workers that die again and again end in an error with advice, not in a hang."""
    with pytest.raises(ParallelError, match=r"died again and again with 1 of 1 .*lower n_jobs"):
        run_cells(die, {"deadly": 0}, n_jobs=2)


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Return a client of a local dask cluster with two worker processes."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as local,
        distributed.Client(local) as client,
    ):
        yield client


@pytest.mark.slow
def test_dask_runs_the_same_call(cluster: Any, tmp_path: Path) -> None:
    """On a dask cluster the same call gives the same results, and fills the same store."""
    with joblib.parallel_config(backend="dask"):
        found = run_cells(draw, CELLS, store=tmp_path)
    assert found == run_cells(draw, CELLS, n_jobs=1)
    assert CellStore(tmp_path).find(CELLS).keys() == CELLS.keys()
    assert len(cluster.scheduler_info()["workers"]) == 2


@pytest.mark.slow
def test_dask_loses_nothing_with_a_worker(cluster: Any, tmp_path: Path) -> None:
    """One of two workers is killed in mid-run: all results arrive, none is calculated twice
    but what that worker had in hand.
    """
    marks = tmp_path / "marks"
    marks.mkdir()
    data = np.arange(20_000.0)  # large enough to be held by the workers themselves
    cells = {str(n): (marks, n, data) for n in range(12)}
    victims: list[int] = []
    mine = set(cluster.run(os.getpid).values())

    def kill_one(progress: CellProgress) -> None:
        if progress.n_done == 3:
            victims.append(min(mine))
            os.kill(victims[0], signal.SIGKILL)

    with joblib.parallel_config(backend="dask"):
        found = run_cells(slow, cells, store=tmp_path / "store", progress=kill_one)
    assert victims
    assert [number for number, _, _ in found.values()] == list(range(12))
    assert [total for *_, total in found.values()] == [data.sum() + n for n in range(12)]
    assert len({pid for _, pid, _ in found.values()} - set(victims)) >= 1
    counts = np.bincount([int(p.name.split("-")[0]) for p in marks.iterdir()], minlength=12)
    assert counts.min() == 1
    assert counts.sum() <= 12 + 3


def counts() -> set[int]:
    """Threads of every linear algebra library of this process."""
    return {info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas"}


def test_one_thread_inside_and_as_before_outside() -> None:
    """The limit holds within the context only, also after an error."""
    one_thread()  # loads the libraries that are counted
    with threadpool_limits(2):
        before = counts()
        try:
            with one_thread():
                assert counts() == {1}
                raise KeyError
        except KeyError:
            pass
        assert counts() == before


def test_decorated_function_runs_on_one_thread() -> None:
    """The limit holds during the call, results and names pass through."""

    @single_threaded
    def inside(value: float) -> tuple[float, set[int]]:
        return value, counts()

    one_thread()
    with threadpool_limits(2):
        assert inside(3.0) == (3.0, {1})
        assert counts() != {1}
    assert inside.__name__ == "inside"


def test_long_public_calls_are_single_threaded() -> None:
    """What a user calls and waits for does not let threads compete for small matrices."""
    for verb in ("improve", "diagnose", "compare", "design_experiment", "rank_parameters"):
        assert hasattr(getattr(oed_sysid, verb), "__wrapped__"), verb
