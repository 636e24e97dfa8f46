"""Structures that zigzags hardly tell apart, and what is asked of them: circles.

Two families, each with terms more and fewer: the modified Abkowitz model, fitted by one-step
regression, and the MMG model, fitted to whole runs with the records at three weights against
the priors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from oed_sysid import Fit, Model, MultipleShooting
from oed_sysid.estimators import EquationError
from oed_sysid.predictions.structures import Structure
from oed_sysid.predictions.turning_circle import turning_circle

from .manoeuvring import MMG
from .mavmm import MAVMM, wake
from .missing import manoeuvring_effects
from .particulars import APPROACH_SPEED, LENGTH, RUDDER_RATE

# The local cubic spans two seconds at 2 Hz.
REGRESSION = EquationError(window=5)
CIRCLES = ("advance", "transfer", "tactical_diameter", "steady_diameter")
SCORED = ("advance", "tactical_diameter")
HORIZON = 40.0  # s
SIDES = ("starboard", "port")


def without(model: Model, *parameters: str) -> Model:
    """Return the model with some derivatives held at zero."""
    fewer = model.with_values(dict.fromkeys(parameters, 0.0)).fix(*parameters)
    return replace(fewer, name=f"{model.name} without {', '.join(parameters)}")


def weighed(factor: float) -> MultipleShooting:
    """Estimator whose records weigh less by the square of a factor."""
    levels = [factor * float(output.noise_std or 0.0) for output in MMG.outputs]
    return MultipleShooting(disturbances="none", noise=levels)


def candidates() -> tuple[Structure, ...]:
    """Structures to average."""
    full = MAVMM.with_values(wake())
    found = [
        Structure("MAVMM", full, REGRESSION),
        Structure(
            "MAVMM symmetric",
            without(full, "Y_u_prime", "N_u_prime", "Y_T_prime", "N_T_prime"),
            REGRESSION,
        ),
        Structure("MAVMM, rudder outside the race", without(full, "N_deltaT_prime"), REGRESSION),
        Structure(
            "MAVMM, no loss of speed in yaw", without(full, "Y_ur_prime", "N_ur_prime"), REGRESSION
        ),
    ]
    effects = {effect.name: effect for effect in manoeuvring_effects()}
    plain = MMG + [
        effects[name] for name in ("helm_zero", "rudder_lift_shape", "propeller_wake_by_drift")
    ]
    race = effects["race_from_thrust"].parameters[0].name
    screw = plain + [effects["race_from_thrust"], effects["single_screw_asymmetry"]]
    screw = screw.with_values({race: 1.0}).fix(race)
    for label, model in (("MMG", plain), ("MMG, race from the thrust", screw)):
        for factor in (1.0, 4.0, 10.0):
            name = label if factor == 1.0 else f"{label}, levels x {factor:g}"
            found.append(Structure(name, model, weighed(factor)))
    return tuple(found)


def circles(fit: Fit) -> Mapping[str, float]:
    """Quantities of the 35 degree circles in ship lengths."""
    found = turning_circle(
        fit,
        speed=APPROACH_SPEED,
        rate=math.radians(RUDDER_RATE),
        length=LENGTH,
        n_draws=0,
    )
    return {name: value / LENGTH for name, value in found.quantities(*CIRCLES).items()}
