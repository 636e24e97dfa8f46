"""The starter folder's ship and its search, made once for all tests that look at them."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from oed_sysid import Dataset, Problem, improve, load_problem, new_problem
from oed_sysid.evidence.improvement import Improvement


@cache
def starter() -> tuple[Problem, Dataset, Dataset]:
    """The problem, its training records, and its turning circle for validation."""
    with TemporaryDirectory() as folder:
        problem = load_problem(new_problem(Path(folder) / "my_ship"))
        return problem, *problem.data().split(test=["turning_circle"])


@cache
def improved() -> Improvement:
    """The damping that its records hide, found among its candidates."""
    problem, train, test = starter()
    return improve(problem.model, train, test, candidates=problem.effects, known_noise=True)
