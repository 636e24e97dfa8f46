"""Contracts that every extension fulfils, to be called in a test of one's own."""

from oed_sysid.testing.effect_contract import check_effect

__all__ = ["check_effect"]
