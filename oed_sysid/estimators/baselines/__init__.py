"""The literature's estimators, behind the same interface as multiple shooting."""
