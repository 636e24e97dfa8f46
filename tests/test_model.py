"""Models: composition, values, equations and the errors of a wrong one."""

from __future__ import annotations

from dataclasses import replace

import pytest
from vehicles import remus

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
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter

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
        ({"states": ()}, "at least one state"),
        ({"kinematics": {}}, "has 0 equations"),
        ({"kinematics": {"x": "1", "y": "2"}}, "unknown state 'y'"),
        ({"kinematics": {"x": "-kk*x"}}, "Did you mean k"),
        ({"outputs": (Output("depth", "m"),)}, "unknown name 'depth'"),
        ({"step": 0.0}, "Give seconds above zero"),
        ({"inputs": (Input("x", "m"),)}, "for two things"),
        ({"parameters": (Parameter("k", 1.0), Parameter("h", 1.0))}, "reserved"),
        ({"parameters": (Parameter("k", 1.0), Parameter("k", 2.0))}, "twice"),
        ({"inertia": {("Z", "w"): "1"}}, "does not belong"),
        ({"effects": (Force("f", {"Z": "1"}),)}, "no force effect can change"),
        ({"effects": (Actuator("a", {"push": "push + nothing"}),)}, "unknown name 'nothing'"),
        ({"effects": (Inertia("i", {("X", "x"): "1"}),)}, "no inertia effect can change"),
        ({"effects": (Sensor("s", {"x": "x + bias"}),)}, "unknown name 'bias'"),
    ],
)
def test_wrong_model_is_refused(changes: dict, complaint: str) -> None:
    """Every inconsistency is named, with what to do."""
    with pytest.raises(ModelError, match=complaint):
        decay(**changes)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: Effect("e", {"Z": "1"}), "Use one of"),
        (lambda: Force("e", {}), "contributes nothing"),
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
