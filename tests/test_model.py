"""Models and contracts of problems and criteria: shipped ones keep them."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from marks import slow
from motion import small
from vehicles import remus

from oed_sysid import Doublet, Experiment, Input, Output, State, design, list_problems, new_problem
from oed_sysid.design.criteria import Measure, Setting
from oed_sysid.errors import ModelError
from oed_sysid.physics import (
    Actuator,
    Effect,
    ExtraState,
    Force,
    Inertia,
    Memory,
    Sensor,
    actuator_offset,
    added_mass_error,
    quadratic_drag,
)
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.testing import check_criterion, check_problem

DRAG = quadratic_drag("drag", "Z", "w_r", value=-100.0)


def decay(**changes: object) -> Model:
    """First-order decay with one input, changed as stated."""
    parts: dict = {
        "name": "decay",
        "states": (State("x", "m"),),
        "inputs": (Input("push", "m/s"),),
        "outputs": (Output("x", "m"),),
        "kinematics": {"x": "push - k*x"},
        "parameters": (Parameter("k", 0.5, "1/s"),),
    }
    return Model(**(parts | changes))


def test_adding_and_removing_an_effect() -> None:
    """A model with an effect is a new model; removing it gives the old one back."""
    model = remus()
    more = model + DRAG
    assert "drag" in more.effect_names
    assert "drag" not in model.effect_names
    assert more.without("drag") == model
    both = (DRAG, actuator_offset("offset", "ds"))
    assert (model + both).effect_names[-2:] == ("drag", "offset")
    with pytest.raises(ModelError, match="already has the effect 'drag'"):
        more + DRAG


def test_values_and_freedom() -> None:
    """Values, fixing and freeing change parameters by name, wherever they live."""
    model = (remus() + DRAG).with_values({"E_drag": -50.0, "m": 31.0})
    assert model.values["E_drag"] == -50.0
    assert model.parameter("m").value == 31.0
    assert "E_drag" not in model.fix("E_drag").free_names
    assert "m" in model.free("m").free_names
    assert model.with_parameter(Parameter("m", 32.0, "kg")).values["m"] == 32.0
    with pytest.raises(ModelError, match="no parameter 'mass'"):
        model.with_values({"mass": 1.0})


def test_structure_key_ignores_values_only() -> None:
    """Values do not shape compiled code; terms, freedom and effects do."""
    model = remus()
    assert model.with_values({"zgW": 6.0}).structure_key() == model.structure_key()
    assert model.fix("zgW").structure_key() != model.structure_key()
    assert (model + DRAG).structure_key() != model.structure_key()
    other = quadratic_drag("drag", "Z", "q", value=-100.0)
    assert (model + DRAG).structure_key() != (model + other).structure_key()


def test_equations_read_well() -> None:
    """The printed model is what one writes on paper."""
    added = (
        DRAG,
        actuator_offset("offset", "ds"),
        added_mass_error("added", "Z", "w", scale=8.0),
        Sensor("bias", {"q": "q + b"}, (Parameter("b", 0.0),)),
    )
    lines = (remus() + added).equations().splitlines()
    assert "ds <- ds + E_offset   [offset]" in lines
    assert "z' = -u sin(theta) + w cos(theta)" in lines
    assert (
        "(m - Z_wdot + E_added) w' - Z_qdot q' = "
        "m u q + Z_uw u_r w_r + Z_uq u_r q + Z_uuds u_r² ds + E_drag |w_r| w_r"
    ) in lines
    assert "measured q <- q + b   [bias]" in lines
    assert decay().equations() == "x' = push - k x\nmeasured x = x"
    forced = decay() + Force("leak", {"x": "-k*x**2"})
    assert forced.equations().startswith("x' = push - k x - k x²")


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"parameters": (Parameter("k", 1.0), Parameter("h", 1.0))}, "reserved"),
        ({"inertia": {("Z", "w"): "1"}}, "does not belong"),
        ({"effects": (Force("f", {"Z": "1"}),)}, "no force effect can change"),
        ({"effects": (Actuator("a", {"push": "push + nothing"}),)}, "unknown name 'nothing'"),
        ({"effects": (Inertia("i", {("X", "x"): "1"}),)}, "no inertia effect can change"),
        ({"effects": (Sensor("s", {"x": "x + bias"}),)}, "unknown name 'bias'"),
    ],
)
def test_wrong_model_is_refused(changes: dict, complaint: str) -> None:
    """What a problem file cannot show is named too; the others are in the table of those files."""
    with pytest.raises(ModelError, match=complaint):
        decay(**changes)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: Effect("e", {"Z": "1"}), "Use one of"),
        (lambda: Force("e", {"Z": "1"}, memory=(Memory("a", "a", "0"),)), "cannot keep memory"),
        (lambda: Sensor("e", {"x": "x"}, states=(ExtraState("a", "1", "0"),)), "cannot add states"),
        (lambda: Force("e", {"Z": "E"}, amplitudes=("E",)), "names the amplitude 'E'"),
        (lambda: Force("e", {"Z": "E +"}), "cannot be read"),
    ],
)
def test_wrong_effect_is_refused(make, complaint: str) -> None:
    """An effect that cannot work says so when it is made."""
    with pytest.raises(ModelError, match=complaint):
        make()


def test_absent_effect_has_zero_amplitude_only() -> None:
    """Absence sets amplitudes to zero and leaves shapes alone."""
    wave = Force(
        "wave",
        {"x": "E*cos(omega*t)"},
        (Parameter("E", 2.0), Parameter("omega", 1.0)),
        amplitudes=("E",),
    )
    assert wave.shape_names == ("omega",)
    assert [p.value for p in wave.absent().parameters] == [0.0, 1.0]


def test_model_is_frozen_and_comparable() -> None:
    """Models are values: equal when their parts are."""
    assert decay() == decay()
    assert decay() != replace(decay(), step=0.2)


SHIP = small(
    "yaw",
    "psi [rad], r [rad/s] <- delta [rad]",
    {"psi": "r", "r": "(K*delta - r)/T - D*r*abs(r)"},
    {"K [1/s]": 0.2, "T [s]": 15.0, "D [1/rad]": 0.5},
    {"psi": 0.01, "r": 0.002},
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


def test_claims_that_do_not_hold_are_found() -> None:
    """A is not invariant under a change of units; what falls with information is found."""
    with pytest.raises(AssertionError, match="in other units"):
        check_criterion(design.AOptimal(), SHIP, rng=np.random.default_rng(2), invariant=True)
    with pytest.raises(AssertionError, match="one more measurement"):
        check_criterion(Broken("falls"), SHIP, rng=np.random.default_rng(2))


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


QUICK = ("nomoto_sparse_heading", "online_ship", "torpedo")


@pytest.mark.parametrize(
    "name", [*QUICK, *slow(*(name for name in list_problems() if name not in QUICK))]
)
def test_every_shipped_problem_keeps_the_contract(name: str) -> None:
    """All of them: README, dimensions, experiments, records, parameters, candidates."""
    # Without the folder of third-party data its records are left out.
    here = "OED_SYSID_DATA" in os.environ
    check_problem(name, rng=np.random.default_rng(4), records=here)


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
