"""Physical effects: the words in which a model and its deficiencies are written."""

from oed_sysid.effects.base import (
    STAGES,
    Actuator,
    Effect,
    Environment,
    ExtraState,
    Force,
    Inertia,
    Memory,
    Sensor,
)

__all__ = [
    "STAGES",
    "Actuator",
    "Effect",
    "Environment",
    "ExtraState",
    "Force",
    "Inertia",
    "Memory",
    "Sensor",
]
