"""Linear algebra on one thread, and as many as before afterwards."""

from __future__ import annotations

from threadpoolctl import threadpool_info, threadpool_limits

import oed_sysid
from oed_sysid.runtime.threads import one_thread, single_threaded


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
