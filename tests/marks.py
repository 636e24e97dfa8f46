"""Marks of tests and of cases in a table of them."""

from __future__ import annotations

import os
from typing import Any

import pytest

MEASURED = pytest.mark.skipif("OED_SYSID_DATA" not in os.environ, reason="measured data absent")


def slow(*cases: Any) -> list[Any]:
    """Cases that only `make test-slow` runs; one of several arguments is a tuple."""
    return [
        pytest.param(*(one if isinstance(one, tuple) else (one,)), marks=pytest.mark.slow)
        for one in cases
    ]
