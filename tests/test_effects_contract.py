"""Every effect that the package ships keeps the contract."""

from __future__ import annotations

import numpy as np
import pytest
from vehicles import (
    DIVING_INPUTS,
    DIVING_MIRROR,
    DIVING_START,
    ROLL_MIRROR,
    SHIP_INPUTS,
    SHIP_MIRROR,
    SHIP_START,
    remus,
    roll_oscillator,
    ship,
)

from oed_sysid import physics as effects
from oed_sysid.physics import Actuator, Effect, Force, Sensor
from oed_sysid.physics.parameters import Parameter
from oed_sysid.testing import check_effect

DIVING = effects.diving_plane_effects()
SHIP = effects.surface_ship_effects()
ROLL = effects.roll_effects(inertia=2.0, frequency=1.0)

# What breaks the mirror outright, and what keeps it if its amplitude is mirrored too.
ODD = {
    *("excess_buoyancy", "cg_offset_x", "hull_asymmetry_heave", "hull_asymmetry_pitch"),
    *("current_vertical", "wave_heave_force", "fin_offset", "bias_w", "bias_q", "bias_theta"),
    *("dvl_misalignment", "rudder_neutral_angle", "single_screw_asymmetry", "wave_yaw_moment"),
    *("bias_r", "bias_psi", "log_misalignment", "heel_moment", "wave_roll_moment", "bias_phi"),
}
UNCLAIMED = {"hull_compressibility", "nonlinear_yaw_damping", "current", "wind"}


def claim(effect: Effect, mirror: tuple[str, ...]) -> dict:
    """Symmetry that an effect claims, as arguments of the check."""
    if effect.name in UNCLAIMED:
        return {}
    return {"mirror": mirror, "amplitude_sign": -1 if effect.name in ODD else 1}


def names(effect: Effect) -> str:
    """Test identifier of an effect."""
    return effect.name


@pytest.mark.parametrize("effect", DIVING, ids=names)
def test_diving_plane_effect(effect: Effect) -> None:
    """An effect of the diving plane keeps the contract on a REMUS-like vehicle."""
    check_effect(
        effect,
        remus(),
        rng=np.random.default_rng(3),
        initial=DIVING_START,
        inputs=DIVING_INPUTS,
        **claim(effect, DIVING_MIRROR),
    )


@pytest.mark.parametrize("effect", SHIP, ids=names)
def test_surface_ship_effect(effect: Effect) -> None:
    """An effect of the horizontal plane keeps the contract on a ship."""
    check_effect(
        effect,
        ship(),
        rng=np.random.default_rng(4),
        initial=SHIP_START,
        inputs=SHIP_INPUTS,
        **claim(effect, SHIP_MIRROR),
    )


@pytest.mark.parametrize("effect", ROLL, ids=names)
def test_roll_effect(effect: Effect) -> None:
    """An effect of rolling keeps the contract on an oscillator."""
    rng = np.random.default_rng(5)
    check_effect(effect, roll_oscillator(), rng=rng, **claim(effect, ROLL_MIRROR))


GENERIC = (
    effects.derivative("term", "Z_ww", scale=20.0),
    effects.actuator_gain_error("gain", "ds"),
    effects.sensor_delay("theta_delay", "theta", max_delay=0.5),
    effects.sensor_drift("drift", "z", "m/s", scale=0.01),
    effects.sensor_lag("gyro_lag", "q"),
    effects.added_mass_coupling("coupling", ("Z", "q"), ("M", "w"), scale=1.0),
    effects.added_mass_factor("loading", {("Z", "w"): "-Z_wdot", ("M", "q"): "-M_qdot"}),
    effects.cubic_damping("cubic", "M", "q", scale=200.0),
    effects.coupling("lift", "Z", "w_r", scale=5.0),
)


@pytest.mark.parametrize("effect", GENERIC, ids=names)
def test_generic_effect(effect: Effect) -> None:
    """A constructor outside the vocabularies keeps the contract too."""
    rng = np.random.default_rng(6)
    check_effect(effect, remus(), rng=rng, initial=DIVING_START, inputs=DIVING_INPUTS)


def test_wind_and_righting_arm() -> None:
    """Tabulated loads keep the contract."""
    angles = np.linspace(-np.pi, np.pi, 13)
    wind = effects.wind_load(
        "wind",
        {"X": (angles, np.cos(angles)), "Y": (angles, np.sin(angles))},
        speed=15.0,
        direction=1.0,
        area=900.0,
        length=160.0,
    )
    rng = np.random.default_rng(7)
    check_effect(wind, ship(), rng=rng, initial=SHIP_START, inputs=SHIP_INPUTS)
    arm = effects.righting_arm_table("gz", [-1.0, -0.33, 0.0, 0.33, 1.0], [0.2, -0.1, 0, 0.1, -0.2])
    check_effect(arm, roll_oscillator(), rng=rng, mirror=ROLL_MIRROR)


def test_vocabulary_is_complete() -> None:
    """The diving plane has the identifiers of the hidden-effect records, once each."""
    identifiers = [effect.name for effect in DIVING]
    assert len(identifiers) == len(set(identifiers)) == 40
    parameters = [p.name for effect in DIVING for p in effect.parameters]
    assert len(parameters) == len(set(parameters))
    single = [e for e in DIVING if e.name != "wave_heave_force"]
    assert all(e.amplitude_names == (f"E_{e.name}",) for e in single)
    assert len((remus() + DIVING).effects) == 42


@pytest.mark.parametrize(
    ("effect", "complaint"),
    [
        (Force("bare", {"Z": "E*w"}, (Parameter("E", 0.0, "kg/s", scale=1.0),)), "has no source"),
        (
            Force("wrong_unit", {"Z": "E*w"}, (Parameter("E", 0.0, "kg/m", scale=1.0),)),
            "'E\\*w' is in kg/s, expected N",
        ),
        (
            Actuator("present", {"ds": "ds*exp(E) + 0.01"}, (Parameter("E", 0.0, "1", scale=0.1),)),
            "is not absent at zero",
        ),
        (Sensor("inert", {"u": "u + 0*E"}, (Parameter("E", 0.0, "m/s", scale=1.0),)), "no output"),
        (
            Actuator("corner", {"ds": "max(ds, ds + E)"}, (Parameter("E", 0.0, "rad", scale=0.1),)),
            "sensitivity to E at zero",
        ),
        (
            Force("lopsided", {"Z": "E*w**2"}, (Parameter("E", 0.0, "kg/m", scale=9.0),)),
            "symmetric",
        ),
    ],
)
def test_contract_finds_fault(effect: Effect, complaint: str) -> None:
    """Each promise of the contract can be broken, and the message says which."""
    with pytest.raises(AssertionError, match=complaint):
        check_effect(
            effect,
            remus(),
            rng=np.random.default_rng(8),
            initial=DIVING_START,
            inputs=DIVING_INPUTS,
            mirror=DIVING_MIRROR,
        )
