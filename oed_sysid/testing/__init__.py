"""Contracts that every extension fulfils, to be called in a test of one's own."""

from oed_sysid.testing.effect_contract import check_effect
from oed_sysid.testing.estimator_contract import EstimatorCheck, check_estimator

__all__ = ["EstimatorCheck", "check_effect", "check_estimator"]
