"""The builder of rigid bodies: what it refuses, what it keeps free, and a fit with a quaternion."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Experiment, Input, Model, MultipleShooting, Parameter
from oed_sysid.errors import ModelError
from oed_sysid.experiments.manoeuvres import ZigZag, ZigZagLike
from oed_sysid.experiments.simulation import simulate
from oed_sysid.physics.bodies import RigidBody, rigid_body


def plain(parts: RigidBody) -> Model:
    """The bare body as a model."""
    return parts.model("body", inputs=(Input("T", "N"),))


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"dof": 5}, "Choose 3, 4, 6"),
        ({"dof": ("surge", "dive")}, "Unknown motion 'dive'"),
        ({"added_mass": {"Y_rdot": 1.0, "N_vdot": 1.0}}, "same entry of a symmetric"),
        ({"added_mass": {"Y_vdot": 3.0}}, "derivatives are negative"),
        ({"added_mass": {"Y_v": 3.0}}, "no acceleration derivative"),
        ({"dof": 3, "added_mass": {"Z_wdot": -3.0}}, "does not belong"),
        ({"inertia": (1.0, 0.0, 2.0)}, "I_yy is 0"),
        ({"inertia": 1.0}, "One moment of inertia for 3"),
        ({"dof": 3, "attitude": "quaternion"}, "needs roll, pitch and yaw"),
        ({"buoyancy": 300.0}, "no weight"),
        ({"metacentric_height": 0.5}, "needs the weight"),
        ({"dof": 3, "position": ("z",)}, "does not change"),
    ],
)
def test_wrong_bodies_are_refused(changes: dict, complaint: str) -> None:
    """What does not fit together is refused with what to do."""
    given = {"dof": 6, "mass": 30.0, "inertia": (0.4, 3.6, 3.4)} | changes
    with pytest.raises(ModelError, match=complaint):
        rigid_body(given.pop("dof"), **given)


def test_parameters_may_be_free() -> None:
    """A Parameter given to the builder keeps its prior under the standard name."""
    parts = rigid_body(
        3,
        mass=Parameter("any", 30.0, prior_std=1.0),
        inertia=3.4,
        added_mass=[Parameter("Y_vdot", -30.0, prior_std=3.0)],
    )
    assert plain(parts).free_names == ("m", "Y_vdot")
    assert plain(parts).parameter("Y_vdot").unit == "kg"


@pytest.mark.parametrize("disturbances", ["none", pytest.param("auto", marks=pytest.mark.slow)])
def test_quaternion_model_can_be_fitted(disturbances: str) -> None:
    """From wrong values and unknown start states a fit with a quaternion finds the truth."""
    parts = rigid_body(
        6,
        mass=40.0,
        inertia=(0.4, 6.0, 6.0),
        centre_of_gravity=(0, 0, 0.02),
        added_mass={"X_udot": -1.5, "Y_vdot": -45.0, "Z_wdot": -45.0, "M_qdot": -7.0},
        weight=392.0,
        attitude="quaternion",
        position=("z",),
    )
    hull = parts.hull({"X_absuu": -3.5, "Y_uv": -25.0, "Z_uw": -25.0, "M_uq": -20.0, "N_ur": -20.0})
    known = Parameter("K_p", -0.6, fixed=True)
    fins = (
        parts.fin("stern", "ds", at=(-0.8, 0, 0), normal="horizontal", lift=14.0),
        parts.fin("rudder", "dr", at=(-0.8, 0, 0), normal="vertical", lift=14.0),
    )
    noise = {**dict.fromkeys("uvw", 0.02), **dict.fromkeys("pqr", 0.004), "z": 0.03}
    noise |= {"phi": 0.005, "theta": 0.004, "psi": 0.005}
    model = parts.model(
        "auv",
        inputs=(Input("ds", "rad"), Input("dr", "rad"), Input("T", "N")),
        effects=(hull, parts.hull([known], name="roll"), *fins, parts.thruster("screw", "T")),
        noise=noise,
        step=0.05,
    )
    run_ = Experiment(
        "run",
        (ZigZagLike("ds", 0.12, 0.09), ZigZag("dr", 0.17, 0.17, sign=-1)),
        duration=40.0,
        sample_time=0.2,
        constants={"T": 8.0},
        initial=parts.start(u=1.5, z=20.0, psi=0.7),
    )
    record = simulate(model, run_, rng=np.random.default_rng(3))
    wrong = model.with_values({name: 1.1 * model.values[name] for name in model.free_names})
    fit = MultipleShooting(disturbances=disturbances).fit(wrong, Dataset((record,)))
    assert fit.status.ok
    # The length of the start's quaternion moves nothing, and nothing goes after it.
    assert fit.iterations < 60
    for name in fit.names:
        low, high = fit.interval(name, 0.9999)
        assert low < model.values[name] < high, name
