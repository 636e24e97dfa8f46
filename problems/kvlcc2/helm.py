"""The rudder's zero differs from run to run."""

from __future__ import annotations

from oed_sysid import Actuator, Parameter

# The neutral angle of this single-screw ship is about one degree (HSVA's report on the
# sister model), and the tests begin at the geometric zero: anything within about
# two degrees is credible.
HELM_ZERO = Actuator(
    "helm_zero",
    {"delta": "delta + E_helm_zero"},
    (
        Parameter(
            "E_helm_zero",
            0.0,
            "rad",
            prior_mean=0.0,
            prior_std=0.02,
            lower=-0.2,
            upper=0.2,
            scale=0.005,
            per_record=True,
            description="angle by which the recorded rudder angle is short of the effective one",
        ),
    ),
    description="neutral angle of the single screw and the calibration of each run's rudder",
    source="HSVA report of the tests: the rudder starts from the geometric zero.",
    needs="nothing: one number per run",
)
