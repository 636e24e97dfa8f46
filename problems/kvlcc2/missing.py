"""What the MMG standard model may leave out for this tanker."""

from __future__ import annotations

from oed_sysid import Environment, Force, Parameter
from oed_sysid.physics import (
    Effect,
    actuator_lag,
    added_mass_coupling,
    amplitude,
    crossed_drag,
    deflection_drag,
    quadratic_drag,
    rudder_neutral_angle,
    sensor_bias,
    sensor_lag,
    sensor_lever_arm,
    sensor_misalignment,
    sensor_scale,
    single_screw_asymmetry,
)

from .helm import HELM_ZERO
from .manoeuvring import HULL_CUBIC, SOURCE
from .particulars import LENGTH

TOXOPEUS = "Toxopeus (2011), Practical application of viscous-flow calculations, MARIN."
# Prime scale of a force, rho/2 L d, in kg/m; of a moment it is L times that.
FORCE = 0.5 * 1000.0 * LENGTH * 0.455


def small(effect: str, unit: str, scale: float, description: str = "") -> Parameter:
    """Amplitude with a prior of its typical size: present to that degree, if at all."""
    size = amplitude(effect, unit, scale=scale, description=description)
    return Parameter(
        size.name,
        0.0,
        unit,
        lower=size.lower,
        upper=size.upper,
        prior_mean=0.0,
        prior_std=scale,
        scale=scale,
        description=description,
    )


LIFT_SHAPE = Environment(
    "rudder_lift_shape",
    {"lift": "lift*(1 + E_rudder_lift_shape*sin(alpha_R)**2)"},
    (small("rudder_lift_shape", "1", 0.4),),
    description="rudder lift is no sine of the angle of attack: stall below zero, flap above",
    source=SOURCE,
    needs="small and large rudder angles",
)
# [1]: 1 + (1 - exp(-C_1 |beta_P|)) (C_2 - 1), C_1 = 2.0, C_2 = 1.6 and 1.1 by side, which is
# 0.35 even and 0.25 odd. It levels off, so that it may be used beyond the drift of the data.
_OUT_OF_THE_WAKE = "(1 + (1 - exp(-2*abs(beta_P)))*(E_{0}_even + E_{0}_odd*tanh(beta_P/0.05)))"
PROPELLER_WAKE = Environment(
    "propeller_wake_by_drift",
    {"u_P": f"u_P*{_OUT_OF_THE_WAKE.format('propeller_wake')}"},
    (small("propeller_wake_even", "1", 0.35), small("propeller_wake_odd", "1", 0.25)),
    description="drift at the stern moves the propeller out of the hull's wake: thrust changes",
    source=SOURCE,
    needs="large drift to both sides; the measured thrust shows it",
)
RUDDER_WAKE = Environment(
    "rudder_wake_by_drift",
    {"u_W": f"u_W*{_OUT_OF_THE_WAKE.format('rudder_wake')}"},
    (small("rudder_wake_even", "1", 0.35), small("rudder_wake_odd", "1", 0.25)),
    description="drift at the stern moves the rudder out of the hull's wake",
    source=SOURCE,
    needs="large drift to both sides",
)
# Freeing the propeller slipstream factor kappa, 0.5 in [1], by a fifth: it multiplies what the
# propeller slipstream adds.
PROPELLER_RACE = Environment(
    "propeller_race",
    {"race": "1 + (race - 1)*(1 + E_propeller_race)"},
    (small("propeller_race", "1", 0.2),),
    description="the rudder feels more or less of the propeller slipstream than published",
    source=SOURCE,
    needs="the speed loss of strong and weak zigzags, which tells it from the wake ratio epsilon",
)
# With the thrust that the propeller has in the turn instead of that of the straight course. Its
# share is 1 where it is taken over whole; it is a part of a model, seldom a number to be found.
RACE_FROM_THRUST = Environment(
    "race_from_thrust",
    {"K_W": "K_W + E_race_from_thrust*(thrust/(rho*n_P**2*D_P**4) - K_W)"},
    (small("race_from_thrust", "1", 1.0),),
    description="the propeller slipstream at the rudder is that of the thrust in the turn",
    source=SOURCE,
    needs="large drift, which changes the thrust",
)
STRAIGHTENING = Environment(
    "flow_straightening_by_side",
    {"gamma_R": "gamma_R*(1 + E_flow_straightening_by_side*tanh(beta_R/0.05))"},
    (small("flow_straightening_by_side", "1", 0.25),),
    description="the propeller's swirl straightens the flow differently on either side",
    source=SOURCE,
    needs="turns to both sides",
)
HULL_ASYMMETRY = Force(
    "hull_asymmetry",
    {"Y": "Q*U*U*E_hull_asymmetry_Y", "N": "Q*L*U*U*E_hull_asymmetry_N"},
    (small("hull_asymmetry_Y", "1", 0.002), small("hull_asymmetry_N", "1", 0.001)),
    description="side force and moment on a straight course",
    source=SOURCE,
    needs="long runs, to both sides",
)
EVEN_HULL = Force(
    "even_hull_forces",
    {
        "Y": "Q*(E_even_Y_rr*L*L*r*r + E_even_Y_vv*v*v)",
        "N": "Q*L*(E_even_N_rr*L*L*r*r + E_even_N_vv*v*v)",
    },
    (
        small("even_Y_rr", "1", 0.02),
        small("even_Y_vv", "1", 0.2),
        small("even_N_rr", "1", 0.005),
        small("even_N_vv", "1", 0.05),
    ),
    description="hull forces that do not change sign with the side of the turn",
    source=TOXOPEUS,
    needs="turns to both sides",
)


def manoeuvring_effects() -> tuple[Effect, ...]:
    """Candidates for the model with a linear hull; the cubic hull is the first of them."""
    return (
        HULL_CUBIC,
        HELM_ZERO,
        rudder_neutral_angle(scale=0.01),
        LIFT_SHAPE,
        PROPELLER_WAKE,
        RUDDER_WAKE,
        PROPELLER_RACE,
        RACE_FROM_THRUST,
        STRAIGHTENING,
        HULL_ASYMMETRY,
        EVEN_HULL,
        single_screw_asymmetry(thrust="thrust", arm=0.5 * LENGTH, scale=0.02),
        quadratic_drag("sway_crossflow", "Y", "v", scale=0.3 * FORCE),
        quadratic_drag("yaw_crossflow", "N", "r", scale=0.01 * FORCE * LENGTH**3),
        quadratic_drag("yaw_crossflow_of_drift", "N", "v", scale=0.05 * FORCE * LENGTH),
        crossed_drag("sway_drift_yaw", "Y", "v", "r", scale=0.1 * FORCE * LENGTH),
        crossed_drag("yaw_yaw_drift", "N", "r", "v", scale=0.05 * FORCE * LENGTH**2),
        deflection_drag("rudder_drag", "delta", scale=0.01 * FORCE, velocity="u"),
        added_mass_coupling(
            "sway_yaw_inertia", ("Y", "r"), ("N", "v"), scale=0.01 * FORCE * LENGTH**2
        ),
        actuator_lag("rudder_lag", "delta", scale=0.5),
        sensor_lever_arm("lever_arm", "v", "r", scale=0.25),
        sensor_misalignment("misalignment", "u", "v", scale=0.01),
        sensor_bias("bias_v", "v", "m/s", scale=0.005),
        sensor_bias("bias_r", "r", "rad/s", scale=0.001),
        sensor_scale("scale_r", "r", scale=0.02),
        sensor_lag("yaw_rate_lag", "r", scale=0.3),
    )
