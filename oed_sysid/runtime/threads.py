"""Threads: one for linear algebra, all cores for passes of compiled code.

Matrices here have some ten to a hundred columns. Threads gain nothing on them,
and where other programs keep the cores busy they wait for each other: an
estimation was measured to take up to five times as long with two threads.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import lru_cache, wraps
from types import CodeType
from typing import Any, ParamSpec, TypeVar

import numpy as np
from threadpoolctl import ThreadpoolController

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_Job = TypeVar("_Job")
_inside = threading.local()
# Seconds below which a job is short, and what a job of each code took last.
SHORT = 4e-3
_lasted: dict[CodeType | None, float] = {}


def one_thread() -> AbstractContextManager[Any]:
    """Context in which BLAS and OpenMP use one thread in this process.

    >>> with one_thread():
    ...     pass
    """
    return _controller().limit(limits=1)


def single_threaded(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Let a function run with one thread for linear algebra.

    >>> @single_threaded
    ... def half(value: float) -> float:
    ...     return value / 2
    >>> half(3.0)
    1.5
    """

    @wraps(function)
    def run(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        with one_thread():
            return function(*args, **kwargs)

    return run


def both_cores(work: Callable[[_Job], _Result], jobs: Sequence[_Job]) -> list[_Result]:
    """Do jobs that run in compiled code side by side; in order where already inside one.

    Jobs that were short when their code ran last are done in order too: handing them over
    takes as long as it saves.

    >>> both_cores(lambda n: n * n, [1, 2, 3])
    [1, 4, 9]
    """
    if len(jobs) < 2 or getattr(_inside, "busy", False):
        return [work(job) for job in jobs]
    code: CodeType | None = getattr(work, "__code__", None)
    if _lasted.get(code, np.inf) < SHORT:
        began = time.perf_counter()
        done = [work(job) for job in jobs]
        _lasted[code] = (time.perf_counter() - began) / len(jobs)
        return done

    def marked(job: _Job) -> tuple[_Result, float]:
        _inside.busy = True
        began = time.perf_counter()
        return work(job), time.perf_counter() - began

    found = list(_pool().map(marked, jobs))
    if code is not None:
        _lasted[code] = min(seconds for _, seconds in found)
    return [result for result, _ in found]


def in_chunks(work: Callable[[int], _Result], size: int, n_workers: int) -> list[_Result]:
    """Results of ``work`` for ``0 .. size - 1``, in order, over as many threads.

    A few chunks for each thread: short jobs cost less than handing them over one by one.

    >>> in_chunks(lambda n: n * n, 4, 2)
    [0, 1, 4, 9]
    """
    if n_workers == 1 or size == 1:
        return [work(index) for index in range(size)]
    chunks = np.array_split(np.arange(size), min(size, 4 * n_workers))
    with ThreadPoolExecutor(n_workers) as pool:
        parts = pool.map(lambda chunk: [work(index) for index in chunk.tolist()], chunks)
        return [result for part in parts for result in part]


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max_workers=os.cpu_count() or 1)


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  (its own BLAS has to be loaded to be found)

    return ThreadpoolController()
