"""Structures that zigzags hardly tell apart, and what is asked of them: circles.

Two families, each with terms more and fewer: the modified Abkowitz model and the MMG model. Each
is fitted to predict one step, 10 s and 40 s ahead, the MMG model also whole runs, with the records
at three weights against its priors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from oed_sysid import Dataset, Fit, Model, MultipleShooting
from oed_sysid.baselines import EquationError
from oed_sysid.prediction.turning_circle import turning_circle

from .averaging import Structure
from .manoeuvring import MMG
from .mavmm import MAVMM, wake
from .missing import manoeuvring_effects
from .particulars import APPROACH_SPEED, LENGTH, RUDDER_RATE

# The local cubic spans two seconds at 2 Hz.
REGRESSION = EquationError(window=5)
CIRCLES = ("advance", "transfer", "tactical_diameter", "steady_diameter")
SCORED = ("advance", "tactical_diameter")
HORIZON = 40.0  # s, of the segments that judge
HORIZONS = (10.0, 40.0)  # s, of fits; one step is the regression
SIDES = ("starboard", "port")


def without(model: Model, *parameters: str) -> Model:
    """Return the model with some derivatives held at zero."""
    fewer = model.with_values(dict.fromkeys(parameters, 0.0)).fix(*parameters)
    return replace(fewer, name=f"{model.name} without {', '.join(parameters)}")


def weighed(factor: float) -> MultipleShooting:
    """Estimator of whole runs whose records weigh less by the square of a factor."""
    levels = [factor * float(output.noise_std or 0.0) for output in MMG.outputs]
    return MultipleShooting(disturbances="none", noise=levels)


def ahead(horizon: float) -> MultipleShooting:
    """Estimator of predictions some seconds ahead."""
    return MultipleShooting(disturbances="none", noise="given", horizon=horizon)


def variants(
    full: Model, mechanical: Mapping[str, Model], dataset: Dataset
) -> tuple[Structure, ...]:
    """The candidates of the rule: a modified Abkowitz model and models of the MMG kind.

    Searches begin where the regression, or the fit that looks 10 s ahead, ended; these values are
    no priors.

    Parameters
    ----------
    full : Model
        Modified Abkowitz model with all its terms.
    mechanical : mapping of str to Model
        Models of the MMG kind, by name.
    dataset : Dataset
        Records that give the start values.
    """
    full = REGRESSION.fit(full, dataset).model
    mechanical = {
        label: ahead(HORIZONS[0]).fit(model, dataset).model for label, model in mechanical.items()
    }
    symmetric = without(full, "Y_u_prime", "N_u_prime", "Y_T_prime", "N_T_prime")
    found = []
    for label, model in (("MAVMM", full), ("MAVMM symmetric", symmetric)):
        found.append(Structure(label, model, REGRESSION))
        found += [Structure(f"{label}, {h:g} s ahead", model, ahead(h)) for h in HORIZONS]
    for label, dropped in (
        ("MAVMM, rudder outside the propeller slipstream", ("N_deltaT_prime",)),
        ("MAVMM, no loss of speed in yaw", ("Y_ur_prime", "N_ur_prime")),
    ):
        found.append(Structure(label, without(full, *dropped), REGRESSION))
    for label, model in mechanical.items():
        found += [Structure(f"{label}, {h:g} s ahead", model, ahead(h)) for h in HORIZONS]
        for factor in (1.0, 4.0, 10.0):
            name = f"{label}, whole runs" + ("" if factor == 1.0 else f", levels x {factor:g}")
            found.append(Structure(name, model, weighed(factor)))
    return tuple(found)


def candidates(dataset: Dataset) -> tuple[Structure, ...]:
    """Structures to average."""
    effects = {effect.name: effect for effect in manoeuvring_effects()}
    plain = MMG + [
        effects[name] for name in ("helm_zero", "rudder_lift_shape", "propeller_wake_by_drift")
    ]
    race = effects["race_from_thrust"].parameters[0].name
    screw = plain + effects["race_from_thrust"] + effects["single_screw_asymmetry"]
    screw = screw.with_values({race: 1.0}).fix(race)
    return variants(
        MAVMM.with_values(wake()), {"MMG": plain, "MMG, slipstream from the thrust": screw}, dataset
    )


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
