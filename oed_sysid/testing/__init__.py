"""Contracts that every extension fulfils, to be called in a test of one's own."""

from oed_sysid.testing.criterion_contract import check_criterion
from oed_sysid.testing.effect_contract import check_effect
from oed_sysid.testing.estimator_contract import EstimatorCheck, check_estimator
from oed_sysid.testing.problem_contract import check_problem

__all__ = [
    "EstimatorCheck",
    "check_criterion",
    "check_effect",
    "check_estimator",
    "check_problem",
]
