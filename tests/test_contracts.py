"""Contracts of problems and criteria: shipped ones keep them, broken ones are named."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from oed_sysid import (
    Experiment,
    Input,
    Model,
    Output,
    Parameter,
    State,
    design,
    list_problems,
    new_problem,
)
from oed_sysid.design.criteria import Measure, Setting
from oed_sysid.experiments.manoeuvres import Doublet
from oed_sysid.testing import check_criterion, check_problem

SHIP = Model(
    "yaw",
    (State("psi", "rad"), State("r", "rad/s")),
    (Input("delta", "rad"),),
    (Output("psi", "rad", noise_std=0.01), Output("r", "rad/s", noise_std=0.002)),
    {"psi": "r", "r": "(K*delta - r)/T - D*r*abs(r)"},
    parameters=(
        Parameter("K", 0.2, "1/s"),
        Parameter("T", 15.0, "s"),
        Parameter("D", 0.5, "1/rad"),
    ),
)
TURN = Experiment("turn", Doublet("delta", 0.2, pulse_time=5.0), duration=20.0, sample_time=0.5)
# Criterion, whether it is invariant under a change of units, whether information never harms.
SHIPPED = (
    (design.DOptimal(), True, True),
    (design.DsOptimal(("K",)), True, True),
    (design.VOptimal((TURN,)), True, True),
    (design.GOptimal((TURN,)), True, True),
    (design.AOptimal(), False, True),
    (design.EOptimal(), False, True),
)


@pytest.mark.parametrize(("criterion", "invariant", "monotone"), SHIPPED)
def test_shipped_criteria_keep_the_contract(
    criterion: design.DOptimal, invariant: bool, monotone: bool
) -> None:
    """Derivatives, monotony and invariance are as each criterion claims."""
    rng = np.random.default_rng(1)
    check_criterion(criterion, SHIP, rng=rng, invariant=invariant, monotone=monotone)


@dataclass(frozen=True)
class Roundest:
    """The inverse condition number, which information may harm."""

    name: str = "inverse condition"

    def bind(self, setting: Setting) -> Measure:
        """Return the log of the ratio of the eigenvalues at the ends, and its derivative."""

        def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
            sizes, axes = np.linalg.eigh(matrix)
            ends = [np.outer(axes[:, i], axes[:, i]) / sizes[i] for i in (0, -1)]
            return float(np.log(sizes[0] / sizes[-1])), ends[0] - ends[1]

        return measure


def test_claims_that_do_not_hold_are_found() -> None:
    """A is not invariant under a change of units; a condition number may fall."""
    with pytest.raises(AssertionError, match="in other units"):
        check_criterion(design.AOptimal(), SHIP, rng=np.random.default_rng(2), invariant=True)
    with pytest.raises(AssertionError, match="one more measurement"):
        check_criterion(Roundest(), SHIP, rng=np.random.default_rng(2), n_points=8)


@dataclass(frozen=True)
class Broken:
    """A trace criterion with one fault."""

    fault: str
    name: str = "trace"

    def bind(self, setting: Setting) -> Measure:
        """Return the trace, and its derivative."""

        def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
            if self.fault == "the matrix":
                matrix[0, 0] += 1.0
            gradient = np.eye(len(matrix))
            if self.fault == "states the slope":
                gradient = 2.0 * gradient
            if self.fault == "not symmetric":
                gradient[0, 1] = 1.0
            sign = -1.0 if self.fault == "falls" else 1.0
            if self.fault == "where nothing is known" and matrix[0, 0] == 0.0:
                return -np.inf, gradient
            return sign * float(np.trace(matrix)), sign * gradient

        return measure


@pytest.mark.parametrize(
    "fault", ["the matrix", "states the slope", "not symmetric", "falls", "where nothing is known"]
)
def test_broken_criteria_are_named(fault: str) -> None:
    """Each fault is reported in its own words; without one the criterion passes."""
    check_criterion(Broken("none"), SHIP, rng=np.random.default_rng(3))
    with pytest.raises(AssertionError, match=fault):
        check_criterion(Broken(fault), SHIP, rng=np.random.default_rng(3))


def _checked(name: str, *, effects: bool) -> None:
    # Without the folder of third-party data its records are left out.
    here = "OED_SYSID_DATA" in os.environ
    check_problem(name, rng=np.random.default_rng(4), effects=effects, records=here)


@pytest.mark.parametrize("name", ["nomoto_sparse_heading", "online_ship", "torpedo"])
def test_quick_problems_keep_the_contract(name: str) -> None:
    """Problems that simulate their data, with their candidates."""
    _checked(name, effects=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", list_problems())
def test_every_shipped_problem_keeps_the_contract(name: str) -> None:
    """All of them: README, dimensions, experiments, records, parameters, candidates."""
    _checked(name, effects=True)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("(K*rudder - r)/T", "(K*rudder - r)*T", "rate of 'r'"),
        ("(K*rudder - r)/T", "(K*rudder - r)/T*(K1/K1)", "does not load"),
        ("(K*rudder - r)/T", "(K*rudder - r)/(T + extra - extra)", "not identifiable"),
    ],
)
def test_broken_problems_are_named(tmp_path: Path, old: str, new: str, words: str) -> None:
    """A wrong unit, an unknown name, and a parameter that does nothing."""
    folder = new_problem(tmp_path / "my_ship")
    file = folder / "problem.py"
    text = file.read_text(encoding="utf-8")
    assert old in text
    text = text.replace(old, new, 1)
    if "extra" in new:
        first = text.index("Parameter(\n") if "Parameter(\n" in text else text.index('Parameter("')
        text = text[:first] + 'Parameter("extra", 1.0, "s"),\n        ' + text[first:]
    file.write_text(text, encoding="utf-8")
    with pytest.raises(AssertionError, match=words):
        check_problem(folder, rng=np.random.default_rng(5), effects=False)


def test_a_folder_without_words_or_data_is_named(tmp_path: Path) -> None:
    """The README says what success means; records have to be there."""
    folder = new_problem(tmp_path / "my_ship")
    check_problem(folder, rng=np.random.default_rng(6))
    (folder / "README.md").write_text("# A ship\n", encoding="utf-8")
    for file in (folder / "data").glob("*.csv"):
        file.unlink()
    with pytest.raises(AssertionError) as caught:
        check_problem(folder, rng=np.random.default_rng(6), effects=False)
    told = str(caught.value)
    assert "what success means" in told
    assert "where it comes from" in told
    assert "records cannot be read" in told
