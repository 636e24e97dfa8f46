"""Contracts that every extension fulfils, to be called in a test of one's own."""

from oed_sysid.runtime.version import exported
from oed_sysid.testing.method_contract import EstimatorCheck, check_criterion, check_estimator
from oed_sysid.testing.problem_contract import check_effect, check_problem

__all__ = exported(globals())
