"""Behaviour that stays: fits with process noise."""

from __future__ import annotations

import pytest
from golden_cases import SHIPPED, SIMULATED, facts, fit_of
from golden_files import FILTERED, check


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_records(name: str) -> None:
    """Process noise is chosen and estimated from shipped records."""
    check("process_noise", name, facts(fit_of(name, disturbances="auto")), FILTERED)


@pytest.mark.parametrize("name", SIMULATED)
def test_disturbed_records(name: str) -> None:
    """Process noise is found where it acts."""
    found = facts(fit_of(name, disturbed=True, disturbances="auto"))
    check("process_noise", name, found, FILTERED)
