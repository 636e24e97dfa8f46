"""Candidate effects of vehicles with bodies, each with the contract of an effect."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Input, Model
from oed_sysid.physics import Effect
from oed_sysid.physics.bodies import catamaran_effects, rigid_body, underwater_vehicle_effects
from oed_sysid.testing import check_effect

MEASURED = ("u", "v", "w", "p", "q", "r", "phi", "theta")
BODY = rigid_body(
    6,
    mass=30.0,
    inertia=(0.2, 3.4, 3.4),
    added_mass={"X_udot": -1.0, "Y_vdot": -35.0, "Z_wdot": -35.0, "M_qdot": -5.0, "N_rdot": -5.0},
    centre_of_gravity=(0.0, 0.0, 0.02),
    weight=299.0,
)
AUV = BODY.model(
    "auv",
    inputs=(Input("ds", "rad"), Input("dr", "rad"), Input("T", "N")),
    effects=(
        BODY.thruster("propeller", "T"),
        BODY.hull({"X_absuu": -2.0, "Y_absvv": -100.0}),
        BODY.fin("stern", "ds", at=(-0.6, 0, 0), normal="horizontal", lift=5.0),
        BODY.fin("rudder", "dr", at=(-0.6, 0, 0), normal="vertical", lift=5.0),
    ),
    step=0.05,
)
UNDERWATER = underwater_vehicle_effects(
    BODY, length=1.33, speed=1.5, diameter=0.19, outputs=MEASURED, step=0.05
)
HULLS = rigid_body(
    3, mass=55.0, inertia=20.0, added_mass={"X_udot": -5.0, "Y_vdot": -80.0, "N_rdot": -30.0}
)
CATAMARAN = HULLS.model(
    "catamaran",
    inputs=(Input("T_port", "N"), Input("T_starboard", "N")),
    effects=(
        HULLS.thruster("port", "T_port", at=(0, -0.4, 0)),
        HULLS.thruster("starboard", "T_starboard", at=(0, 0.4, 0)),
        HULLS.hull({"X_absuu": -20.0, "Y_v": -100.0, "N_r": -50.0}),
    ),
    step=0.05,
)
SURFACE = catamaran_effects(
    HULLS, length=2.0, speed=1.5, draught=0.25, outputs=("u", "v", "r"), step=0.05
)


def check(effect: Effect, model: Model, initial: dict[str, float]) -> None:
    """Short trajectories at ordinary speed."""
    inputs = {name: (-0.2, 0.2) for name in ("ds", "dr")}
    inputs |= {name: (5.0, 15.0) for name in ("T", "T_port", "T_starboard")}
    inputs = {name: span for name, span in inputs.items() if name in model.input_names}
    rng = np.random.default_rng(5)
    check_effect(effect, model, rng=rng, initial=initial, inputs=inputs, n_times=20, n_points=1)


@pytest.mark.slow
@pytest.mark.parametrize("effect", UNDERWATER, ids=lambda effect: effect.name)
def test_underwater_effects_keep_the_contract(effect: Effect) -> None:
    """Each candidate of an underwater vehicle has units, derivatives and a zero."""
    check(effect, AUV, {"u": 1.5, "z": 5.0})


@pytest.mark.slow
@pytest.mark.parametrize("effect", SURFACE, ids=lambda effect: effect.name)
def test_catamaran_effects_keep_the_contract(effect: Effect) -> None:
    """Each candidate of a catamaran has units, derivatives and a zero."""
    check(effect, CATAMARAN, {"u": 1.5})


def test_all_candidates_fit_their_model_together() -> None:
    """A model with all candidates at zero has one amplitude for each at least."""
    for model, effects in ((AUV, UNDERWATER), (CATAMARAN, SURFACE)):
        full = model + [effect.absent() for effect in effects]
        assert len(full.effect_names) == len(set(full.effect_names))
        assert len(full.free_names) >= len(model.free_names) + len(effects)


def test_plane_bodies_get_plane_candidates() -> None:
    """A body without heave and pitch is not offered effects in them."""
    plane = rigid_body(("surge", "heave", "pitch"), mass=30.0, inertia=3.4)
    found = underwater_vehicle_effects(plane, length=1.3, speed=1.5, diameter=0.19, fins=("ds",))
    axes = {str(key)[0] for effect in found if effect.stage == "force" for key in effect.terms}
    assert axes == {"X", "Z", "M"}
