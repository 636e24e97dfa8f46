"""Linear algebra on one thread, and as many as before afterwards."""

from __future__ import annotations

from threadpoolctl import threadpool_info, threadpool_limits

from oed_sysid.threads import one_thread


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
