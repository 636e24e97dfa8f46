"""One thread for linear algebra.

Matrices here have some ten to a hundred columns. Threads gain nothing on them,
and where other programs keep the cores busy they wait for each other: an
estimation was measured to take up to five times as long with two threads.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

from threadpoolctl import ThreadpoolController


def one_thread() -> AbstractContextManager[Any]:
    """Context in which BLAS and OpenMP use one thread in this process.

    >>> with one_thread():
    ...     pass
    """
    return _controller().limit(limits=1)


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  (its own BLAS has to be loaded to be found)

    return ThreadpoolController()
