"""Criteria, families of commands and efforts by the names that people choose them with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from oed_sysid.design.criteria import AOptimal, DOptimal, EOptimal
from oed_sysid.design.waveforms import Levels, Multisines, Pulses
from oed_sysid.errors import DesignError, located

CRITERIA: Mapping[str, Callable[[], Any]] = {"D": DOptimal, "A": AOptimal, "E": EOptimal}
FAMILIES: Mapping[str, Callable[..., Any]] = {
    "levels": Levels,
    "multisine": Multisines,
    "pulses": Pulses,
}
# Starts that are refined, rough manoeuvres tried, and steps of refinement.
EFFORTS = {"quick": (1, 30, 8), "normal": (2, 60, 20), "thorough": (4, 120, 40)}
T = TypeVar("T")


def named(what: str, name: str, choices: Mapping[str, T]) -> T:
    """Return what a name stands for.

    Examples
    --------
    >>> named("effort", "quick", EFFORTS)
    (1, 30, 8)

    Raises
    ------
    DesignError
        If it stands for nothing; the message lists the names.
    """
    located(DesignError, f"This package has no {what}", [name], choices)
    return choices[name]
