"""Check of logs before any model."""
from oed_sysid.compatibility.check import check, quick_check
from oed_sysid.compatibility.result import Finding, LogCheck
__all__ = ["Finding", "LogCheck", "check", "quick_check"]
